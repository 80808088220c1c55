"""Plant, controller, trajectory server and recorder for one return trip through the singularity."""

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_prefix, get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    LogInfo,
    RegisterEventHandler,
    SetEnvironmentVariable,
    Shutdown,
)
from launch.event_handlers import OnProcessExit
from launch.events.process import ProcessExited
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

WARMUP = Path(get_package_prefix("dextar")) / "lib" / "dextar" / "warmup"
CONFIG = Path(get_package_share_directory("dextar")) / "config"
SWITCH = ["true", "false"]
DISCOVERY = "ROS_AUTOMATIC_DISCOVERY_RANGE"

ARGUMENTS = [
    DeclareLaunchArgument("law", default_value="", description="near the locus; empty: params_file's",
                          choices=["", "consistent", "projected", "classic", "multi_model", "joint_space"]),
    DeclareLaunchArgument("estimator", default_value="", choices=["", "observer", "dgm", "plain", "external"],
                          description="of the platform state; external needs poses, of a camera or the plant's pose_rate;"
                          " empty: params_file's"),
    DeclareLaunchArgument("tour", default_value="", description="crossings spread over the locus; empty: params_file's"),
    DeclareLaunchArgument("lockstep", default_value="false", choices=SWITCH,
                          description="each simulated step waits for its command: repeatable, not in real time"),
    DeclareLaunchArgument("duration", default_value="", description="of one way, s; empty: params_file's"),
    DeclareLaunchArgument("window", default_value="false", choices=SWITCH, description="PyBullet's own window"),
    DeclareLaunchArgument("record", default_value="true", choices=SWITCH, description="start the recorder"),
    DeclareLaunchArgument("markers", default_value="false", choices=SWITCH, description="draw for RViz and Foxglove"),
    DeclareLaunchArgument("output", default_value="", description="the recording, .mcap; empty: params_file's"),
    DeclareLaunchArgument("autostart", default_value="true", choices=SWITCH,
                          description="serve the trip as soon as it is planned"),
    DeclareLaunchArgument("activate", default_value="true", choices=SWITCH,
                          description="configure and activate the controller at its start; false: ros2 lifecycle set does"),
    DeclareLaunchArgument("plant", default_value="true", choices=SWITCH,
                          description="start the simulated rig; false where a real one publishes the joint states"),
    DeclareLaunchArgument("namespace", default_value="/", description="of all nodes, e.g. /left: two robots in one domain"),
    DeclareLaunchArgument("robot_file", default_value=str(CONFIG / "dextar.yaml"),
                          description="parameter file of the robot"),
    DeclareLaunchArgument("params_file", default_value=str(CONFIG / "crossing.yaml"),
                          description="parameter file of the nodes"),
    DeclareLaunchArgument("enclaves", default_value="false", choices=SWITCH,
                          description="each node in its enclave of config/sros2/policy.xml; with ROS_SECURITY_ENABLE=true"),
    DeclareLaunchArgument("discovery_range", default_value=EnvironmentVariable(DISCOVERY, default_value="LOCALHOST"),
                          choices=["LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT"],
                          description="who may see and command the nodes; LOCALHOST: this machine only"),
]  # fmt: skip


def nodes(context: LaunchContext) -> list[Node]:
    """The nodes; only arguments that were given override the parameter files."""

    def value(argument: str) -> str:
        return LaunchConfiguration(argument).perform(context)

    def on(argument: str) -> bool:
        return value(argument) == "true"

    overrides: dict[str, dict[str, Any]] = {
        "plant": {"mode": "lockstep" if on("lockstep") else "realtime", "window": on("window")},
        "controller": {"lockstep": on("lockstep"), "autostart": on("activate")},
        "trajectory_server": {"autostart": on("autostart")},
        "recorder": {},
        "markers": {},
    }
    if value("law"):
        overrides["controller"]["law"] = value("law")
    if value("law") == "multi_model":
        overrides["trajectory_server"]["criterion"] = "zero_wrench"
    if value("estimator"):
        overrides["controller"]["estimator"] = value("estimator")
    if value("tour"):
        overrides["trajectory_server"]["tour"] = int(value("tour"))
    if value("duration"):
        overrides["trajectory_server"]["duration"] = float(value("duration"))
    if value("output"):
        overrides["recorder"]["output"] = value("output")
    unwanted = {"plant": not on("plant"), "recorder": not on("record"), "markers": not on("markers")}
    namespace = value("namespace").rstrip("/")
    return [
        Node(
            package="dextar",
            executable=name,
            name=name,
            namespace=value("namespace"),  # a full name lets an override win over the node's own section of params_file
            parameters=[value("robot_file"), value("params_file"), overrides[name]],
            ros_arguments=["--enclave", f"{namespace}/dextar/{name}"] if on("enclaves") else None,
            output="screen",
            on_exit=None if name == "markers" else Shutdown(reason=f"{name} has ended"),  # a display is nobody's need
        )
        for name in overrides
        if not unwanted.get(name)
    ]


def after_warmup(event: ProcessExited, context: LaunchContext) -> list[Any]:
    """The nodes once the model is compiled: they could not answer before."""
    if event.returncode != 0:
        return [Shutdown(reason="the model could not be compiled")]
    return nodes(context)


def generate_launch_description() -> LaunchDescription:
    """What ``ros2 launch dextar crossing.launch.py`` starts."""
    warmup = ExecuteProcess(cmd=[str(WARMUP)], name="warmup", output="screen")
    return LaunchDescription(
        [
            *ARGUMENTS,
            SetEnvironmentVariable(DISCOVERY, LaunchConfiguration("discovery_range")),
            LogInfo(msg="loading the model; the first start compiles it, about a minute"),
            RegisterEventHandler(OnProcessExit(target_action=warmup, on_exit=after_warmup)),
            warmup,
        ]
    )
