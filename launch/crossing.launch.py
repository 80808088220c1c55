"""Plant, controller, trajectory server and recorder for one return trip through the
singularity.
"""

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_prefix, get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
    Shutdown,
)
from launch.event_handlers import OnProcessExit
from launch.events.process import ProcessExited
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from dextar_control.experiments.launch_arguments import (
    ARGUMENTS,
    changes,
    check_nodes,
    misspelt,
    read,
)

WARMUP = Path(get_package_prefix("dextar")) / "lib" / "dextar" / "warmup"
CONFIG = Path(get_package_share_directory("dextar")) / "config"
OPTIONAL = "markers", "panel", "go_server"  # the robot needs none
DISCOVERY = "ROS_AUTOMATIC_DISCOVERY_RANGE"

DEFAULTS: dict[str, Any] = {
    "robot_file": str(CONFIG / "dextar.yaml"),
    "params_file": str(CONFIG / "crossing.yaml"),
}


def declared(name: str, default: Any) -> DeclareLaunchArgument:
    """One argument; what it may be is checked in ``check``, by a message that names
    it.
    """
    return DeclareLaunchArgument(
        name, default_value=default, description=ARGUMENTS[name].told
    )


def given(context: LaunchContext) -> dict[str, Any]:
    """The arguments' values, checked."""
    return read(
        {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    )


def check(context: LaunchContext) -> list[Any]:
    """Before anything is compiled or started; raises what launch prints as one line."""
    values = given(context)
    check_nodes(values)
    context.launch_configurations["discovery_range"] = (
        values["discovery_range"] or "LOCALHOST"
    )  # the variable was empty
    return [LogInfo(msg=text) for text in misspelt(context.launch_configurations)]


def nodes(context: LaunchContext) -> list[Node]:
    """The nodes; only arguments that were given override the parameter files."""
    values = given(context)
    overrides = changes(values)
    if output := overrides.get("recorder", {}).get("output"):
        overrides["recorder"]["output"] = ParameterValue(
            output, value_type=str
        )  # a text, whatever YAML makes of it
    namespace = values["namespace"].rstrip("/")
    return [
        Node(
            package="dextar",
            executable=name,
            name=name,
            namespace=values[
                "namespace"
                # a full name lets an override win over the node's own section of
                # params_file
            ],
            parameters=[values["robot_file"], values["params_file"], overrides[name]],
            ros_arguments=(
                ["--enclave", f"{namespace}/dextar/{name}"]
                if values["enclaves"]
                else None
            ),
            output="screen",
            on_exit=None if name in OPTIONAL else Shutdown(reason=f"{name} has ended"),
        )
        for name in overrides
    ]


def after_warmup(event: ProcessExited, context: LaunchContext) -> list[Any]:
    """The nodes once the equations are compiled, so that not each of them compiles."""
    if event.returncode != 0:
        return [Shutdown(reason="the equations could not be prepared")]
    return nodes(context)


def generate_launch_description() -> LaunchDescription:
    """What ``ros2 launch dextar crossing.launch.py`` starts."""
    warmup = ExecuteProcess(cmd=[str(WARMUP)], name="warmup", output="screen")
    return LaunchDescription(
        [
            *(
                declared(name, DEFAULTS.get(name, argument.default))
                for name, argument in ARGUMENTS.items()
                if name != "discovery_range"
            ),
            DeclareLaunchArgument(
                "discovery_range",
                default_value=EnvironmentVariable(DISCOVERY, default_value="LOCALHOST"),
                description=ARGUMENTS["discovery_range"].told,
            ),
            OpaqueFunction(function=check),
            SetEnvironmentVariable(DISCOVERY, LaunchConfiguration("discovery_range")),
            LogInfo(
                msg=(
                    "preparing the equations; the first start compiles them, some"
                    " seconds"
                )
            ),
            RegisterEventHandler(
                OnProcessExit(target_action=warmup, on_exit=after_warmup)
            ),
            warmup,
        ]
    )
