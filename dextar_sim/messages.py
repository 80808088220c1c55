"""The plant's messages as CDR bytes, and motor commands read back from them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header

from dextar_control.contract.cdr import CdrTemplate, from_time
from dextar_control.contract.errors import StateError
from dextar_control.contract.robot import JOINT_NAMES, SIM_JOINT_NAMES
from dextar_control.contract.topics import BASE_FRAME, EFFORT_COMMANDS, END_EFFECTOR_NAME, JOINT_COMMANDS
from dextar_sim.sensors import Acknowledgement, Command
from dextar_sim.state import PlantState


def joint_state(stamp: Time, names: Sequence[str], values: Sequence[float]) -> JointState:
    """Positions, velocities and efforts of the named joints, one after the other in values."""
    count = len(names)
    return JointState(
        header=Header(stamp=stamp),
        name=list(names),
        position=list(values[:count]),
        velocity=list(values[count : 2 * count]),
        effort=list(values[2 * count :]),
    )


def joint_command(stamp: Time, torque: Sequence[float]) -> JointState:
    """Motor torques (N m) in the contract's order of joints."""
    return JointState(header=Header(stamp=stamp), name=list(JOINT_NAMES), effort=list(torque))


def end_effector(stamp: Time, values: Sequence[float]) -> Odometry:
    """Position (m) and velocity (m/s); its frame never turns against the base, so both are in base."""
    message = Odometry(header=Header(stamp=stamp, frame_id=BASE_FRAME), child_frame_id=END_EFFECTOR_NAME)
    message.pose.pose.position.x, message.pose.pose.position.y = values[0], values[1]
    message.twist.twist.linear.x, message.twist.twist.linear.y = values[2], values[3]
    return message


def external_pose(stamp: Time, values: Sequence[float]) -> PoseStamped:
    """Position (m) in base, not turned."""
    message = PoseStamped(header=Header(stamp=stamp, frame_id=BASE_FRAME))
    message.pose.position.x, message.pose.position.y = values
    return message


class StateWriter:
    """CDR bytes of the plant's state topics."""

    def __init__(self) -> None:
        self._measured = CdrTemplate(lambda stamp, values: joint_state(stamp, JOINT_NAMES, values), 6)
        self._true = CdrTemplate(lambda stamp, values: joint_state(stamp, SIM_JOINT_NAMES, values), 12)
        self._platform = CdrTemplate(end_effector, 4)
        self._pose = CdrTemplate(external_pose, 2)
        self._clock = CdrTemplate(lambda stamp, _: Clock(clock=stamp), 0)

    def measured(self, stamp: int, q_a: np.ndarray, q_a_dot: np.ndarray, torque: np.ndarray) -> bytes:
        """``joint_states``: encoder position (rad) and velocity (rad/s), applied torque (N m), each (2,)."""
        return self._measured.pack(stamp, [*q_a.tolist(), *q_a_dot.tolist(), *torque.tolist()])

    def true_joints(self, stamp: int, state: PlantState, torque: np.ndarray) -> bytes:
        """``sim/joint_states``."""
        first, second = torque.tolist()
        return self._true.pack(stamp, [*state.joints.tolist(), *state.joints_dot.tolist(), first, 0.0, second, 0.0])

    def true_end_effector(self, stamp: int, state: PlantState) -> bytes:
        """``sim/end_effector``."""
        return self._platform.pack(stamp, [*state.x.tolist(), *state.x_dot.tolist()])

    def external_pose(self, stamp: int, x: Sequence[float]) -> bytes:
        """``external_pose``: measured end effector position (m), shape (2,), at the stamp (ns) when it was true."""
        return self._pose.pack(stamp, x)


    def clock(self, stamp: int) -> bytes:
        """``clock``: simulated time, ns."""
        return self._clock.pack(stamp, ())


def read_efforts(raw: bytes) -> tuple[float, float]:
    """Torques (N m) of q11 and q21 from the raw bytes of ``effort_commands``; its layout field is not looked at.

    Raises:
        StateError: not two numbers, or one that is not finite.
    """
    efforts = list(deserialize_message(raw, Float64MultiArray).data)
    if len(efforts) != len(JOINT_NAMES):
        raise StateError(f"{EFFORT_COMMANDS.name}: {len(efforts)} efforts; expected {len(JOINT_NAMES)}: {list(JOINT_NAMES)}")
    if not all(math.isfinite(value) for value in efforts):
        raise StateError(f"{EFFORT_COMMANDS.name}: effort {efforts} N m is not finite")
    return efforts[0], efforts[1]


class CommandReader:
    """Motor commands from the raw bytes of ``joint_commands``: quickly when laid out as expected."""

    def __init__(self) -> None:
        self._template = CdrTemplate(joint_command, 2)

    def read(self, raw: bytes, *, lockstep: bool = False) -> Command | Acknowledgement:
        """The command, its torques in the contract's order of joints.

        Args:
            raw: CDR bytes of the message.
            lockstep: a message without joints and numbers is an acknowledgement; otherwise it is refused.

        Raises:
            StateError: the joints are not the motors, sizes differ or a torque is not finite.
        """
        fast = self._template.unpack(raw)
        if fast is not None:
            stamp, torque = fast
        else:
            message = deserialize_message(raw, JointState)
            if lockstep and not any((message.name, message.position, message.velocity, message.effort)):
                return Acknowledgement(from_time(message.header.stamp))
            stamp, torque = self._read_message(raw, message)
        if not all(math.isfinite(value) for value in torque):
            raise StateError(f"{JOINT_COMMANDS.name}: effort {list(torque)} N m is not finite")
        return Command(stamp, (torque[0], torque[1]))

    def _read_message(self, raw: bytes, message: JointState) -> tuple[int, list[float]]:
        names = list(message.name)
        if sorted(names) != sorted(JOINT_NAMES):
            raise StateError(f"{JOINT_COMMANDS.name}: joints {names}; expected {list(JOINT_NAMES)} in any order")
        if len(message.effort) != len(names):
            raise StateError(f"{JOINT_COMMANDS.name}: {len(message.effort)} efforts for {len(names)} joints")
        if names == list(JOINT_NAMES) and not message.position and not message.velocity:
            self._template.learn(raw)
        return from_time(message.header.stamp), [message.effort[names.index(name)] for name in JOINT_NAMES]
