"""Messages become quantities of planning and control here, and the other way round;
every refusal names the value and the limit.
"""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import PoseStamped, Transform, Twist, Vector3
from nav_msgs.msg import Path
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from dextar_control.contract.errors import StateError, TrajectoryError
from dextar_control.contract.robot import joint_positions
from dextar_control.contract.topics import BASE_FRAME, END_EFFECTOR_NAME
from dextar_control.nodekit.cdr import NANOSECONDS, to_duration, to_time
from dextar_control.planning.trajectory import Trajectory, quintic
from dextar_control.symbols.types import Array


def finite_position(x: float, y: float) -> Array:
    """Return a measured position, (2,), m.

    Raises:
        StateError: a number is not finite.
    """
    if not math.isfinite(x + y):
        raise StateError(f"external pose ({x}, {y}) m is not finite")
    return np.array([x, y])


def position_in_base(message: PoseStamped) -> Array:
    """Return the position, (2,), m, of an external pose.

    Raises:
        StateError: another frame than base, or a number that is not finite.
    """
    if message.header.frame_id != BASE_FRAME:
        raise StateError(
            f"external pose in frame '{message.header.frame_id}'; it must be in frame"
            f" '{BASE_FRAME}'"
        )
    return finite_position(message.pose.position.x, message.pose.position.y)


def active_joints(message: JointState) -> Array:
    """Return the positions of q11 and q21, (2,), rad, by name.

    Raises:
        StateError: a name is missing, sizes differ or a number is not finite.
    """
    return np.array(joint_positions(list(message.name), message.position))


def to_trajectory(message: MultiDOFJointTrajectory) -> Trajectory:
    """Return the trajectory of a message.

    Raises:
        TrajectoryError: another joint, missing fields, times not rising, or a number
            that is not finite.
    """
    if list(message.joint_names) != [END_EFFECTOR_NAME]:
        raise TrajectoryError(
            f"trajectory joint_names are {list(message.joint_names)}; expected"
            f" ['{END_EFFECTOR_NAME}']"
        )
    rows = []
    for index, point in enumerate(message.points):
        for field in ("transforms", "velocities", "accelerations"):
            if len(getattr(point, field)) != 1:
                raise TrajectoryError(
                    f"trajectory point {index} has {len(getattr(point, field))}"
                    f" {field}; expected 1"
                )
        p = point.transforms[0].translation
        v, a = point.velocities[0].linear, point.accelerations[0].linear
        time = point.time_from_start.sec + point.time_from_start.nanosec / NANOSECONDS
        rows.append((time, p.x, p.y, v.x, v.y, a.x, a.y))
    table = np.array(rows).reshape(-1, 7)
    return quintic(table[:, 0], table[:, 1:3], table[:, 3:5], table[:, 5:7])


def from_trajectory(
    trajectory: Trajectory, times: Array, stamp: int = 0
) -> MultiDOFJointTrajectory:
    """Return the message of a trajectory.

    Args:
        trajectory: of the end effector.
        times: of its points, (m,), s, each rounded to a nanosecond before it is
            sampled.
        stamp: of its start, ns; 0 is at once.
    """
    times = np.round(np.asarray(times) * NANOSECONDS) / NANOSECONDS
    message = MultiDOFJointTrajectory(
        header=Header(stamp=to_time(stamp), frame_id=BASE_FRAME),
        joint_names=[END_EFFECTOR_NAME],
    )
    for time, p, v, a in zip(times, *trajectory.table(times), strict=True):
        message.points.append(
            MultiDOFJointTrajectoryPoint(
                transforms=[Transform(translation=Vector3(x=p[0], y=p[1]))],
                velocities=[Twist(linear=Vector3(x=v[0], y=v[1]))],
                accelerations=[Twist(linear=Vector3(x=a[0], y=a[1]))],
                time_from_start=to_duration(round(float(time) * NANOSECONDS)),
            )
        )
    return message


def stop_trajectory() -> MultiDOFJointTrajectory:
    """Return a trajectory without points, which means stop."""
    return MultiDOFJointTrajectory(
        header=Header(frame_id=BASE_FRAME), joint_names=[END_EFFECTOR_NAME]
    )


def to_path(trajectory: Trajectory, times: Array) -> Path:
    """Return a trajectory as a Path whose poses are stamped with the time from its
    start.

    Args:
        trajectory: of the end effector.
        times: of the poses, (m,), s.
    """
    path = Path(header=Header(frame_id=BASE_FRAME))
    for time, p in zip(times, trajectory.table(times)[0], strict=True):
        pose = PoseStamped(
            header=Header(
                stamp=to_time(round(float(time) * NANOSECONDS)), frame_id=BASE_FRAME
            )
        )
        pose.pose.position.x, pose.pose.position.y = float(p[0]), float(p[1])
        path.poses.append(pose)
    return path
