"""The contract is one table of topics and one of services, from which the nodes create
their entities.

Names are relative (they follow a namespace and can be remapped); ``/diagnostics`` is
absolute by ROS convention. Everything is published reliable, so that readers of either
kind match, and states and commands are read best effort on the control path. Joints are
always taken by name.
"""

from __future__ import annotations

from dataclasses import dataclass

from dextar_control.contract.robot import JOINT_NAMES, SIM_JOINT_NAMES

# A reliable writer can repair a reader that was away for as long as its history
# reaches.
STREAM_DEPTH = 5000


@dataclass(frozen=True)
class TimeOut:
    """How long a reader does without a topic, and what follows then.

    Attributes:
        node: the node that enforces it.
        parameter: of that node, in seconds; its default stands in
            ``config/crossing.yaml``.
        outcome: what happens then.
    """

    node: str
    parameter: str
    outcome: str


@dataclass(frozen=True)
class Topic:
    """One topic.

    Attributes:
        name: relative name, as published.
        type: ROS type, ``package/msg/Type``.
        publisher: who publishes it.
        meaning: fields and units, in sentences.
        depth: history depth of the publisher (KEEP_LAST).
        latched: transient-local durability, offered and asked for.
        rate: nominal rate in Hz, the highest where publishers differ; 0 for on change.
        subscriber: who reads it.
        reliable: whether the publisher offers reliability.
        read_reliable: whether the control path asks for it (in lockstep it always
            does).
        unit: of the numbers, one for each field that carries some.
        joints: names in the order in which this package writes them; readers go by name
            where the type has names.
        stamp: what the header's stamp means; "none" where the type has none.
        timeouts: without it, enforced by its readers.
        rate_text: the rate in words where a number does not say it.
        switch: ``node.parameter`` that brings the topic into being where plant,
            controller and trajectory server alone do not publish it; empty otherwise.
    """

    name: str
    type: str
    publisher: str
    meaning: str
    depth: int = STREAM_DEPTH
    latched: bool = False
    rate: float = 1000.0
    subscriber: str = "anyone"
    reliable: bool = True
    read_reliable: bool = True
    unit: str = ""
    joints: tuple[str, ...] = ()
    stamp: str = ""
    timeouts: tuple[TimeOut, ...] = ()
    rate_text: str = ""
    switch: str = ""

    @property
    def optional(self) -> bool:
        """Whether nobody publishes it unless its switch is set."""
        return bool(self.switch)


@dataclass(frozen=True)
class Ends:
    """The topics that one node publishes and reads.

    Attributes:
        publishes, reads: some of these only where a parameter asks for it.
    """

    publishes: tuple[Topic, ...]
    reads: tuple[Topic, ...]


@dataclass(frozen=True)
class Service:
    """One service.

    Attributes:
        name: relative name: node, slash, service.
        type: ROS type, ``package/srv/Type``.
        meaning: what it does, in a sentence.
    """

    name: str
    type: str
    meaning: str

    @property
    def node(self) -> str:
        """The node that offers it."""
        return self.name.partition("/")[0]


PLATFORM_NAMES = ("x", "y")
CRITERION_NAMES = (
    "residual",
    "s",
    "sigma_min",
    "projection_weight",
    "assembly_mode",
    "phase",
    "mode_confidence",
    "verdict",
    "torque_limit",
    "innovation_square",
    *(
        f"{name}_{joint}"
        for name in ("innovation", "bias", "disturbance")
        for joint in JOINT_NAMES
    ),
)
MAX_TRAJECTORY_POINTS = 50_000
END_EFFECTOR_NAME = "end_effector"
BASE_FRAME = "base"

PHASES = {
    "idle": "no torque, by request",
    "approach": "tracks a trajectory without a crossing",
    "hold": "holds a point",
    "track": "tracks a crossing trajectory, away from the locus",
    "crossing": "tracks it near the locus",
    "safe_stop": "brakes, then no torque",
    "fault": "no torque until it is reset",
}
"""The controller's phases in the order of their numbers, which ``criterion`` carries;
the first is 0.
"""

JOINT_STATES = Topic(
    "joint_states",
    "sensor_msgs/msg/JointState",
    "rig or plant",
    "It tells of q11 and q21, by name, position (rad), velocity (rad/s) and the effort"
    " applied since the last state (N m).",
    subscriber="controller",
    read_reliable=False,
    unit="rad, rad/s, N m",
    joints=JOINT_NAMES,
    stamp="of the sample",
    timeouts=(TimeOut("controller", "joint_states.timeout", "fault, no torque"),),
)
JOINT_COMMANDS = Topic(
    "joint_commands",
    "sensor_msgs/msg/JointState",
    "controller",
    "It gives q11 and q21, by name, an effort (N m) and nothing else. There is one"
    " publisher: with a second one nobody's commands are taken. In lockstep a message"
    " without joints acknowledges the state and commands nothing.",
    subscriber="rig or plant",
    read_reliable=False,
    unit="N m",
    joints=JOINT_NAMES,
    stamp="of the state it answers",
    timeouts=(TimeOut("plant", "drive.command_timeout", "no torque"),),
)
EFFORT_COMMANDS = Topic(
    "effort_commands",
    "std_msgs/msg/Float64MultiArray",
    "controller",
    "The data are the efforts (N m) of q11 and q21 in this order, the layout of the"
    " `~/commands` of forward_command_controller and JointGroupEffortController. The"
    " type has no stamp, so no reader can tell how old a command is: it counts from its"
    " arrival. It carries the same torques as joint_commands, in the same tick; a robot"
    " reads one of the two.",
    subscriber="rig or plant",
    read_reliable=False,
    unit="N m",
    joints=JOINT_NAMES,
    stamp="none",
    timeouts=(TimeOut("plant", "drive.command_timeout", "no torque"),),
    switch="controller.publish.effort_array",
)
EXTERNAL_POSE = Topic(
    "external_pose",
    "geometry_msgs/msg/PoseStamped",
    "camera or plant",
    "It tells the measured end effector position (m) in frame base, at the sensor's own"
    " rate.",
    rate=0.0,
    subscriber="controller",
    read_reliable=False,
    unit="m",
    stamp="when it was true",
    rate_text="the sensor's",
    timeouts=(TimeOut("controller", "external.timeout", "a warning"),),
    switch="plant.external_pose.rate",
)
TRAJECTORY = Topic(
    "trajectory",
    "trajectory_msgs/msg/MultiDOFJointTrajectory",
    "trajectory server",
    "It gives the end effector's motion (m, m/s, m/s^2) over time_from_start; no points"
    " mean stop.",
    depth=1,
    latched=True,
    rate=0.0,
    subscriber="controller",
    unit="m, m/s, m/s²",
    joints=(END_EFFECTOR_NAME,),
    stamp="of the start, 0 is now",
)
CONTROLLER_STATE = Topic(
    "controller_state",
    "trajectory_msgs/msg/JointTrajectory",
    "controller",
    "It tells of x and y, in points[0] the reference (m, m/s, m/s^2), [1] the estimate"
    " (m, m/s), [2] the error (m, m/s) and [3] the output (auxiliary acceleration,"
    " m/s^2, and effort J_inv^T tau, N).",
    unit="m, m/s, m/s², N",
    joints=PLATFORM_NAMES,
    stamp="of the state",
)
CRITERION = Topic(
    "criterion",
    "sensor_msgs/msg/JointState",
    "controller",
    "It tells, as positions by name, residual (N), s (1), sigma_min (1),"
    " projection_weight (1), assembly_mode (+1/-1), phase (enum), mode_confidence (in"
    " the assembly mode, 0.5 to 1), verdict (on the planned crossing that began last: 0"
    " undecided, 1 crossed, 2 bounced), torque_limit (at which the torques are cut, N"
    " m); of the observer innovation_JOINT (rad), innovation_square (over its"
    " covariance, 2 on average where the observer is right), bias_JOINT (of a wrong"
    " geometry, rad) and disturbance_JOINT (torque that the model lacks, N m), 0 with"
    " other estimators.",
    unit="SI, by name",
    stamp="of the state",
)
SIM_END_EFFECTOR = Topic(
    "sim/end_effector",
    "nav_msgs/msg/Odometry",
    "plant",
    "It tells the true position (m) and velocity (m/s) in frame base.",
    subscriber="analysis only",
    unit="m, m/s",
    stamp="of the state",
)
SIM_JOINT_STATES = Topic(
    "sim/joint_states",
    "sensor_msgs/msg/JointState",
    "plant",
    "It tells the true position (rad; of passive joints relative to their proximal"
    " link), velocity (rad/s) and applied effort (N m, 0 on passive joints) of q11,"
    " q12, q21 and q22.",
    subscriber="analysis only",
    unit="rad, rad/s, N m",
    joints=SIM_JOINT_NAMES,
    stamp="of the state",
)
ROBOT_DESCRIPTION = Topic(
    "robot_description",
    "std_msgs/msg/String",
    "plant",
    "It holds the URDF of both legs with joints q11, q12, q21, q22, as"
    " robot_state_publisher and RViz read it. The loop is not closed in it.",
    depth=1,
    latched=True,
    rate=0.0,
    unit="SI, in the text",
    stamp="none",
    joints=SIM_JOINT_NAMES,
)
CLOCK = Topic(
    "clock",
    "rosgraph_msgs/msg/Clock",
    "plant",
    "It tells simulated time, that of the states' stamps, to nodes with use_sim_time,"
    " in lockstep only.",
    rate=100.0,
    unit="s",
    stamp="none",
    switch="plant.simulation.clock_rate",
)
MARKERS = Topic(
    "markers",
    "visualization_msgs/msg/MarkerArray",
    "markers",
    "It draws linkage, end effector, reference, trail, t_s and text at the rate of the"
    " display, and base, locus, path and crossings once a second (m, in frame base).",
    depth=10,
    rate=25.0,
    unit="m",
    stamp="of the drawing",
    switch="markers.enabled",
)
DIAGNOSTICS = Topic(
    "/diagnostics",
    "diagnostic_msgs/msg/DiagnosticArray",
    "all nodes",
    "It tells the health of each node.",
    depth=10,
    rate=5.0,
    unit="by key",
    stamp="when published",
    rate_text="5 Hz controller, 1 Hz others",
)

TOPICS = (
    JOINT_STATES,
    JOINT_COMMANDS,
    EFFORT_COMMANDS,
    EXTERNAL_POSE,
    TRAJECTORY,
    CONTROLLER_STATE,
    CRITERION,
    SIM_END_EFFECTOR,
    SIM_JOINT_STATES,
    ROBOT_DESCRIPTION,
    CLOCK,
    MARKERS,
    DIAGNOSTICS,
)

INTERFACES = "dextar_interfaces"
"""The package beside this one that is built for the following; everything else does
without.
"""
WITHOUT_INTERFACES = (
    f"the package {INTERFACES} is not to be found: type make interfaces, then"
    " . install/setup.bash (docs/interfaces.md)"
)
READABLE_STATE = Topic(
    f"{CONTROLLER_STATE.name}/readable",
    f"{INTERFACES}/msg/ControllerState",
    "controller",
    "It is controller_state with a name for each vector.",
    unit=CONTROLLER_STATE.unit,
    joints=PLATFORM_NAMES,
    stamp="of the state",
    switch="controller.publish.readable",
)
READABLE_CRITERION = Topic(
    f"{CRITERION.name}/readable",
    f"{INTERFACES}/msg/Criterion",
    "controller",
    "It is criterion with a field for each name.",
    unit="SI",
    stamp="of the state",
    switch="controller.publish.readable",
)
GO = "go"
"""The action's name; its type is ``dextar_interfaces/action/Go``, and the node
go_server offers it.
"""

NODES = {
    "plant": Ends(
        (
            JOINT_STATES,
            EXTERNAL_POSE,
            SIM_END_EFFECTOR,
            SIM_JOINT_STATES,
            ROBOT_DESCRIPTION,
            CLOCK,
            DIAGNOSTICS,
        ),
        (JOINT_COMMANDS, EFFORT_COMMANDS),
    ),
    "controller": Ends(
        (JOINT_COMMANDS, EFFORT_COMMANDS, CONTROLLER_STATE, CRITERION, DIAGNOSTICS),
        (JOINT_STATES, EXTERNAL_POSE, TRAJECTORY),
    ),
    "trajectory_server": Ends((TRAJECTORY, DIAGNOSTICS), (DIAGNOSTICS,)),
    "recorder": Ends((DIAGNOSTICS,), TOPICS),
    "markers": Ends(
        (MARKERS, DIAGNOSTICS), (JOINT_STATES, CRITERION, CONTROLLER_STATE, TRAJECTORY)
    ),
    "panel": Ends(
        (DIAGNOSTICS,), (JOINT_STATES, CRITERION, CONTROLLER_STATE, TRAJECTORY)
    ),
}
"""The package's nodes, by name."""

SERVICES = (
    Service(
        "plant/pause",
        "std_srvs/srv/SetBool",
        "True pauses the simulated time, false lets it run on.",
    ),
    Service(
        "plant/step",
        "std_srvs/srv/Trigger",
        "It advances a paused plant by `simulation.step_count` samples.",
    ),
    Service(
        "plant/reset",
        "std_srvs/srv/Trigger",
        "It puts the plant back to its start, at rest.",
    ),
    Service(
        "controller/enable",
        "std_srvs/srv/SetBool",
        "True switches the torque on, false off.",
    ),
    Service(
        "controller/stop",
        "std_srvs/srv/Trigger",
        "It begins a safe stop; a crossing that has begun is finished first.",
    ),
    Service(
        "controller/reset",
        "std_srvs/srv/Trigger",
        "It leaves a fault or a safe stop, without torque.",
    ),
    Service(
        "controller/change_state",
        "lifecycle_msgs/srv/ChangeState",
        "It configures, activates, deactivates, cleans up or shuts down.",
    ),
    Service(
        "controller/get_state",
        "lifecycle_msgs/srv/GetState",
        "It tells the state: unconfigured, inactive, active or finalized.",
    ),
    Service(
        "controller/get_available_states",
        "lifecycle_msgs/srv/GetAvailableStates",
        "It lists all states.",
    ),
    Service(
        "controller/get_available_transitions",
        "lifecycle_msgs/srv/GetAvailableTransitions",
        "It lists the transitions from here.",
    ),
    Service(
        "controller/get_transition_graph",
        "lifecycle_msgs/srv/GetAvailableTransitions",
        "It lists all transitions.",
    ),
    Service("recorder/start", "std_srvs/srv/Trigger", "It begins a new bag."),
    Service("recorder/stop", "std_srvs/srv/Trigger", "It finishes the bag."),
    Service(
        "trajectory_server/plan",
        "std_srvs/srv/Trigger",
        "It plans the trip or tour again.",
    ),
    Service(
        "trajectory_server/start",
        "std_srvs/srv/Trigger",
        "It serves the trip or tour from where the robot stands.",
    ),
    Service("trajectory_server/stop", "std_srvs/srv/Trigger", "It begins a safe stop."),
    Service(
        "trajectory_server/get_plan",
        "nav_msgs/srv/GetPlan",
        "It plans one way between two poses and tells its path.",
    ),
)
