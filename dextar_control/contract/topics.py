"""The topic contract: one table, from which the nodes create their entities.

Names are relative (they follow a namespace and can be remapped); ``/diagnostics`` is absolute
by ROS convention. States and commands are published reliable so that readers of either kind
match, and read best effort on the control path.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Topic:
    """One topic.

    Attributes:
        name: relative name, as published.
        type: ROS type, ``package/msg/Type``.
        publisher: the node that publishes it.
        depth: history depth of the publisher (KEEP_LAST).
        latched: transient-local durability.
        rate: nominal rate in Hz; 0 for on change.
        meaning: fields, units, stamp.
    """

    name: str
    type: str
    publisher: str
    depth: int
    latched: bool
    rate: float
    meaning: str


# A reliable writer can repair a reader that was away for as long as its history reaches.
STREAM_DEPTH = 1000

JOINT_STATES = Topic(
    "joint_states", "sensor_msgs/msg/JointState", "rig or plant", STREAM_DEPTH, False, 1000.0,
    "q11, q21 by name: position (rad), velocity (rad/s), effort applied since the last state (N m); stamp of the sample",
)  # fmt: skip
JOINT_COMMANDS = Topic(
    "joint_commands", "sensor_msgs/msg/JointState", "controller", STREAM_DEPTH, False, 1000.0,
    "q11, q21 by name: effort (N m); stamp of the state it answers",
)  # fmt: skip
EXTERNAL_POSE = Topic(
    "external_pose", "geometry_msgs/msg/PoseStamped", "camera or plant", STREAM_DEPTH, False, 0.0,
    "measured end effector position (m) in frame base, at the sensor's own rate; stamp of the instant when it was true",
)  # fmt: skip
TRAJECTORY = Topic(
    "trajectory", "trajectory_msgs/msg/MultiDOFJointTrajectory", "trajectory server", 1, True, 0.0,
    "end effector (m, m/s, m/s^2) over time_from_start; stamp 0 starts at once; no points means stop",
)  # fmt: skip
CONTROLLER_STATE = Topic(
    "controller_state", "trajectory_msgs/msg/JointTrajectory", "controller", STREAM_DEPTH, False, 1000.0,
    "x, y: points[0] reference (m, m/s, m/s^2), [1] estimate (m, m/s), [2] error (m, m/s), "
    "[3] output (auxiliary acceleration m/s^2, effort = J_inv^T tau in N); stamp of the state",
)  # fmt: skip
CRITERION = Topic(
    "criterion", "sensor_msgs/msg/JointState", "controller", STREAM_DEPTH, False, 1000.0,
    "position by name: residual (N), s (1), sigma_min (1), projection_weight (1), assembly_mode (+1/-1), phase (enum), "
    "mode_confidence (in the assembly mode, 0.5 to 1), verdict (on the planned crossing that began last: 0 undecided, "
    "1 crossed, 2 bounced); stamp of the state",
)  # fmt: skip
SIM_END_EFFECTOR = Topic(
    "sim/end_effector", "nav_msgs/msg/Odometry", "plant", STREAM_DEPTH, False, 1000.0,
    "true position (m) and velocity (m/s), both in frame base; stamp of the state",
)  # fmt: skip
SIM_JOINT_STATES = Topic(
    "sim/joint_states", "sensor_msgs/msg/JointState", "plant", STREAM_DEPTH, False, 1000.0,
    "q11, q12, q21, q22: true position (rad; passive joints relative to their proximal link), velocity (rad/s), "
    "applied effort (N m, 0 on passive joints); stamp of the state",
)  # fmt: skip
DIAGNOSTICS = Topic(
    "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "all nodes", 10, False, 1.0, "health of each node",
)  # fmt: skip

TOPICS = (
    JOINT_STATES, JOINT_COMMANDS, EXTERNAL_POSE, TRAJECTORY, CONTROLLER_STATE, CRITERION, SIM_END_EFFECTOR,
    SIM_JOINT_STATES, DIAGNOSTICS,
)  # fmt: skip

CRITERION_NAMES = (
    "residual", "s", "sigma_min", "projection_weight", "assembly_mode", "phase", "mode_confidence", "verdict",
)  # fmt: skip
MAX_TRAJECTORY_POINTS = 50_000
PLATFORM_NAMES = ("x", "y")
END_EFFECTOR_NAME = "end_effector"
BASE_FRAME = "base"
