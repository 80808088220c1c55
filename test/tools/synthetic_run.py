"""A run made by hand, whose numbers are known without the code under test.

On the axis x = 0 the symmetric robot is stretched where both elbows are level with the
end effector: y = sqrt(l1^2 - (l2 - d/2)^2). The end effector goes A -> B -> A as y =
0.0825 + 0.0225 cos(2 pi t).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml
from rosbags.typesys import Stores, get_typestore

from dextar_control.bags.writer import BagWriter, SerializedMessage
from dextar_control.contract import resources
from dextar_control.contract.robot import RobotParameters, flatten, load_robot

TYPES = get_typestore(Stores.ROS2_JAZZY)
START = 1_700_000_000_000_000_000  # ns
TICKS = 1001
PERIOD = 1_000_000  # ns
MIDDLE, SWING = 0.0825, 0.0225  # m
LOCUS = math.sqrt(0.09**2 - (0.09 - 0.059) ** 2)  # y of the stretched posture, m
CROSSINGS = (
    math.acos((LOCUS - MIDDLE) / SWING) / (2.0 * math.pi),
    1.0 - math.acos((LOCUS - MIDDLE) / SWING) / (2.0 * math.pi),
)  # s
BASE_TORQUE, NEAR_TORQUE, FAR_TORQUE = 0.02, 0.05, 0.11  # N m
DECIDED = 0.05  # s after a crossing at which the estimator says what became of it
CONFIDENCE = 0.9999  # from then on; 0.5 between
MISSED = (500, 501, 502)  # ticks, at B
TRUE_OFFSET = 1.0e-4  # m, between reference and truth


def robot() -> RobotParameters:
    return load_robot(resources.config_file(resources.ROBOT_FILE))


def message(name: str, /, **fields: object) -> object:
    return TYPES.types[name](**fields)


def _time(stamp: int) -> object:
    return message(
        "builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9
    )


def _duration(seconds: float) -> object:
    total = round(seconds * 1e9)
    return message(
        "builtin_interfaces/msg/Duration", sec=total // 10**9, nanosec=total % 10**9
    )


def _header(stamp: int) -> object:
    return message("std_msgs/msg/Header", stamp=_time(stamp), frame_id="base")


def joint_state(
    stamp: int, names: list[str], position=(), velocity=(), effort=()
) -> object:
    return message(
        "sensor_msgs/msg/JointState",
        header=_header(stamp),
        name=names,
        position=np.array(position, float),
        velocity=np.array(velocity, float),
        effort=np.array(effort, float),
    )


def _vector(x: float, y: float) -> object:
    return message("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=0.0)


def _quaternion() -> object:
    return message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)


def _twist(x: float, y: float) -> object:
    return message(
        "geometry_msgs/msg/Twist", linear=_vector(x, y), angular=_vector(0, 0)
    )


def _served(times: np.ndarray) -> object:
    points = []
    for time in times:
        y, y_dot, y_ddot = path(float(time))
        points.append(
            message(
                "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
                transforms=[
                    message(
                        "geometry_msgs/msg/Transform",
                        translation=_vector(0, y),
                        rotation=_quaternion(),
                    )
                ],
                velocities=[_twist(0, y_dot)],
                accelerations=[_twist(0, y_ddot)],
                time_from_start=_duration(float(time)),
            )
        )
    return message(
        "trajectory_msgs/msg/MultiDOFJointTrajectory",
        header=_header(0),
        joint_names=["end_effector"],
        points=points,
    )


def path(time: float) -> tuple[float, float, float]:
    """y, y_dot, y_ddot."""
    rate = 2.0 * math.pi
    return (
        MIDDLE + SWING * math.cos(rate * time),
        -SWING * rate * math.sin(rate * time),
        -SWING * rate**2 * math.cos(rate * time),
    )


def joints_of(y: float) -> tuple[float, float]:
    """Active joints on the axis, elbows outwards, by the law of cosines."""
    distance = math.hypot(0.059, y)
    angle = math.acos(distance / 0.18)
    left = math.atan2(y, 0.059) + angle
    return left, math.pi - left


def _odometry(stamp: int, y: float, y_dot: float) -> object:
    pose = message(
        "geometry_msgs/msg/Pose",
        position=message("geometry_msgs/msg/Point", x=0.0, y=y, z=0.0),
        orientation=_quaternion(),
    )
    covariance = np.zeros(36)
    return message(
        "nav_msgs/msg/Odometry",
        header=_header(stamp),
        child_frame_id="base",
        pose=message(
            "geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance
        ),
        twist=message(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=_twist(0, y_dot),
            covariance=covariance,
        ),
    )


def _controller_state(
    stamp: int, time: float, y: float, y_dot: float, y_ddot: float
) -> object:
    def point(positions=(), velocities=(), accelerations=(), effort=()) -> object:
        arrays = {
            "positions": positions,
            "velocities": velocities,
            "accelerations": accelerations,
            "effort": effort,
        }
        return message(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            time_from_start=_duration(time),
            **{key: np.array(value, float) for key, value in arrays.items()},
        )

    points = [
        point((0, y), (0, y_dot), (0, y_ddot)),
        point((0, y), (0, y_dot)),
        point((0, 2e-5), (0, 0)),
        point(accelerations=(0, y_ddot), effort=(0, 1)),
    ]
    return message(
        "trajectory_msgs/msg/JointTrajectory",
        header=_header(stamp),
        joint_names=["x", "y"],
        points=points,
    )


def _diagnostics(node: str, words: str, values: dict[str, str]) -> object:
    pairs = [
        message("diagnostic_msgs/msg/KeyValue", key=key, value=value)
        for key, value in values.items()
    ]
    status = message(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=0,
        name=f"/{node}",
        message=words,
        hardware_id="",
        values=pairs,
    )
    return message(
        "diagnostic_msgs/msg/DiagnosticArray", header=_header(START), status=[status]
    )


def effort_at(tick: int) -> tuple[float, float]:
    """One peak far from the locus, one at the tick of the first crossing."""
    if tick == 0:
        return FAR_TORQUE, 0.0
    return (
        (-NEAR_TORQUE, 0.0)
        if tick == round(1e3 * CROSSINGS[0])
        else (-BASE_TORQUE, 0.0)
    )


def said_at(time: float, says: tuple[int, int]) -> tuple[float, float]:
    """(confidence, verdict on the crossing that began last)."""
    begun = [
        index for index, crossing in enumerate(CROSSINGS) if time >= crossing - 0.02
    ]
    if not begun:
        return 1.0, 0.0
    decided = time >= CROSSINGS[begun[-1]] + DECIDED
    return (CONFIDENCE, float(says[begun[-1]])) if decided else (0.5, 0.0)


def write_run(
    file: Path,
    *,
    bounce: bool = False,
    truth: bool = True,
    phase: int = 3,
    last_phase: int = 1,
    close: bool = True,
    says: tuple[int, int] | None = (1, 1),
    parameters: Mapping[str, Mapping[str, object]] | None = None,
    changes: Sequence[Mapping[str, object]] = (),
) -> BagWriter:
    """Record the run.

    Args:
        bounce: the end effector is reflected at the locus instead of passing it.
        says: the estimator's verdicts; None records none, as bags did before there were
            any.
        parameters: of each node as recorded, in place of the controller's law and
            estimator.
        changes: of parameters while it was recorded.
    """
    writer = BagWriter(file)
    clock = [START]

    def put(topic: str, content: object) -> None:
        kind = content.__msgtype__  # type: ignore[attr-defined]
        if not writer.has_topic(topic):
            writer.add_topic(topic, kind, [])
        clock[0] += 1000
        writer.add(
            SerializedMessage(
                clock[0], topic, clock[0], 1, bytes(TYPES.serialize_cdr(content, kind))
            )
        )

    flat = {
        f"robot.{key}": list(value) if isinstance(value, tuple) else value
        for key, value in flatten(robot()).items()
    }
    counts = {"/joint_states": {"received": TICKS, "lost": 2, "dropped": 1}}
    record = {
        "version": "9.9",
        "topics": json.dumps(counts),
        "parameter_changes": json.dumps(changes),
    }
    nodes = parameters or {"controller": {"law": "consistent", "estimator": "observer"}}
    for node, values in nodes.items():
        own = {**values, **flat} if node == "controller" else dict(values)
        record[f"parameters.{node}"] = yaml.safe_dump(own)
    writer.add_metadata("dextar", record)
    put("/trajectory", _served(np.arange(TICKS) * 1e-3))
    for tick in range(TICKS):
        stamp, time = START + tick * PERIOD, tick * 1e-3
        y, y_dot, y_ddot = path(time)
        y_true = y + TRUE_OFFSET
        if bounce and y_true < LOCUS:
            y_true = 2.0 * LOCUS - y_true
        q_a = joints_of(y_true)
        put(
            "/joint_states",
            joint_state(stamp, ["q21", "q11"], q_a[::-1], (0, 0), (0, 0)),
        )
        if tick not in MISSED:
            put(
                "/joint_commands",
                joint_state(stamp, ["q11", "q21"], effort=effort_at(tick)),
            )
        put("/controller_state", _controller_state(stamp, time, y, y_dot, y_ddot))
        mode = 1.0 if y > LOCUS else -1.0
        now = last_phase if tick == TICKS - 1 and last_phase > 4 else phase
        names = [
            "residual",
            "s",
            "sigma_min",
            "projection_weight",
            "assembly_mode",
            "phase",
        ]
        row = [0.25, 0.3 * mode, 0.5, 0.0, mode, now]
        if says is not None:
            names += ["mode_confidence", "verdict"]
            row += said_at(time, says)
        put("/criterion", joint_state(stamp, names, row))
        if truth:
            put("/sim/end_effector", _odometry(stamp, y_true, y_dot))
            sim = (q_a[0], 0.0, q_a[1], 0.0)
            put(
                "/sim/joint_states",
                joint_state(
                    stamp, ["q11", "q12", "q21", "q22"], sim, (0,) * 4, (0,) * 4
                ),
            )
    put("/diagnostics", _diagnostics("plant", "running", {"late_commands": "7"}))
    put(
        "/diagnostics",
        _diagnostics("controller", "stopped", {"reason": "no state for 20 ms"}),
    )
    if close:
        writer.close({"dextar": record})
    return writer
