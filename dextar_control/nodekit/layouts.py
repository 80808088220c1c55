"""The contract's fast topics are messages of fixed layout: here stands which numbers
vary in them, in which order.
"""

from __future__ import annotations

from collections.abc import Callable

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from dextar_control.contract.topics import (
    BASE_FRAME,
    CLOCK,
    CONTROLLER_STATE,
    CRITERION,
    CRITERION_NAMES,
    END_EFFECTOR_NAME,
    EXTERNAL_POSE,
    JOINT_COMMANDS,
    JOINT_STATES,
    PLATFORM_NAMES,
    SIM_END_EFFECTOR,
    SIM_JOINT_STATES,
    Topic,
)
from dextar_control.nodekit.cdr import CdrTemplate

IN_BASE = Header(frame_id=BASE_FRAME)
TWO = [0.0, 0.0]


def template(topic: Topic) -> CdrTemplate:
    """Return how messages of a topic are written and read.

    Their values are, in this order, of ``joint_states`` and ``sim/joint_states``
    position, velocity and effort of all joints; of ``joint_commands`` effort; of
    ``criterion`` CRITERION_NAMES; of ``controller_state`` x_ref, x_ref_dot, x_ref_ddot,
    x_hat, x_hat_dot, e, e_dot, u and force, each (2), and the reference's time as
    duration; of ``external_pose`` position (3) and orientation (4); of
    ``sim/end_effector`` position (2) and velocity (2); of ``clock`` none.

    Raises:
        KeyError: the topic is none of these.
    """
    return _TEMPLATES[topic.name](topic)


def _joint_states(topic: Topic) -> CdrTemplate:
    zeros = [0.0] * len(topic.joints)
    return CdrTemplate(
        JointState(
            name=list(topic.joints), position=zeros, velocity=zeros, effort=zeros
        )
    )


def _controller_state(_: Topic) -> CdrTemplate:
    reference = JointTrajectoryPoint(positions=TWO, velocities=TWO, accelerations=TWO)
    estimate = error = JointTrajectoryPoint(positions=TWO, velocities=TWO)
    output = JointTrajectoryPoint(accelerations=TWO, effort=TWO)
    points = [reference, estimate, error, output]
    message = JointTrajectory(
        header=IN_BASE, joint_names=list(PLATFORM_NAMES), points=points
    )
    return CdrTemplate(message, duration="points.0.time_from_start")


def _end_effector(topic: Topic) -> CdrTemplate:
    """Return the template of sim/end_effector, whose frame never turns against the
    base: position and velocity are both in base.
    """
    moving = [
        "pose.pose.position.x",
        "pose.pose.position.y",
        "twist.twist.linear.x",
        "twist.twist.linear.y",
    ]
    return CdrTemplate(
        Odometry(header=IN_BASE, child_frame_id=END_EFFECTOR_NAME), moving
    )


_TEMPLATES: dict[str, Callable[[Topic], CdrTemplate]] = {
    JOINT_STATES.name: _joint_states,
    SIM_JOINT_STATES.name: _joint_states,
    JOINT_COMMANDS.name: lambda topic: CdrTemplate(
        JointState(name=list(topic.joints), effort=TWO)
    ),
    CRITERION.name: lambda _: CdrTemplate(
        JointState(name=list(CRITERION_NAMES), position=[0.0] * len(CRITERION_NAMES))
    ),
    CONTROLLER_STATE.name: _controller_state,
    EXTERNAL_POSE.name: lambda _: CdrTemplate(PoseStamped(header=IN_BASE)),
    SIM_END_EFFECTOR.name: _end_effector,
    CLOCK.name: lambda _: CdrTemplate(Clock(), stamp="clock"),
}
