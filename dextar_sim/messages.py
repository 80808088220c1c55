"""The plant's messages as CDR bytes, and motor commands that are read from such
bytes.
"""

from __future__ import annotations

import math

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from dextar_control.contract.errors import StateError
from dextar_control.contract.robot import JOINT_NAMES
from dextar_control.contract.topics import (
    CLOCK,
    EFFORT_COMMANDS,
    EXTERNAL_POSE,
    JOINT_COMMANDS,
    JOINT_STATES,
    SIM_END_EFFECTOR,
    SIM_JOINT_STATES,
)
from dextar_control.nodekit.cdr import from_time
from dextar_control.nodekit.layouts import template
from dextar_control.symbols.types import Array, Numbers
from dextar_sim.sensors import Acknowledgement, TorqueCommand
from dextar_sim.state import PlantState


class StateWriter:
    """Writes the CDR bytes of the plant's state topics; stamps are ns."""

    def __init__(self) -> None:
        self._measured = template(JOINT_STATES)
        self._true = template(SIM_JOINT_STATES)
        self._platform = template(SIM_END_EFFECTOR)
        self._pose = template(EXTERNAL_POSE)
        self._clock = template(CLOCK)

    def measured(self, stamp: int, q_a: Array, q_a_dot: Array, torque: Array) -> bytes:
        """Write ``joint_states``: encoder position (rad) and velocity (rad/s), and
        applied torque (N m), (2,) each.
        """
        return self._measured.pack(
            stamp, [*q_a.tolist(), *q_a_dot.tolist(), *torque.tolist()]
        )

    def true_joints(self, stamp: int, state: PlantState, torque: Array) -> bytes:
        """Write ``sim/joint_states``, with the applied torque, (2,), N m."""
        first, second = torque.tolist()
        return self._true.pack(
            stamp,
            [
                *state.joints.tolist(),
                *state.joints_dot.tolist(),
                first,
                0.0,
                second,
                0.0,
            ],
        )

    def true_end_effector(self, stamp: int, state: PlantState) -> bytes:
        """Write ``sim/end_effector``."""
        return self._platform.pack(stamp, [*state.x.tolist(), *state.x_dot.tolist()])

    def external_pose(self, stamp: int, x: Numbers) -> bytes:
        """Write ``external_pose``: the measured end effector position, (2,), m, at the
        stamp when it was true.
        """
        return self._pose.pack(stamp, (*x, 0.0, 0.0, 0.0, 0.0, 1.0))

    def clock(self, stamp: int) -> bytes:
        """Write ``clock``: the simulated time."""
        return self._clock.pack(stamp, ())


def read_efforts(raw: bytes) -> tuple[float, float]:
    """Return the torques of q11 and q21 (N m) in the bytes of ``effort_commands``,
    whose layout field is not looked at.

    Raises:
        StateError: not two numbers, or one that is not finite.
    """
    efforts = list(deserialize_message(raw, Float64MultiArray).data)
    if len(efforts) != len(JOINT_NAMES):
        raise StateError(
            f"{EFFORT_COMMANDS.name}: {len(efforts)} efforts; expected"
            f" {len(JOINT_NAMES)}: {list(JOINT_NAMES)}"
        )
    if not all(math.isfinite(value) for value in efforts):
        raise StateError(f"{EFFORT_COMMANDS.name}: effort {efforts} N m is not finite")
    return efforts[0], efforts[1]


class CommandReader:
    """Reads motor commands from the bytes of ``joint_commands``, quickly where they are
    laid out as expected.
    """

    def __init__(self) -> None:
        self._template = template(JOINT_COMMANDS)

    def read(
        self, raw: bytes, *, lockstep: bool = False
    ) -> TorqueCommand | Acknowledgement:
        """Return the command, its torques in the contract's order of joints.

        Args:
            raw: CDR bytes of the message.
            lockstep: a message without joints and numbers is an acknowledgement;
                otherwise it is refused.

        Raises:
            StateError: the joints are not the motors, sizes differ or a torque is not
                finite.
        """
        fast = self._template.unpack(raw)
        if fast is not None:
            stamp, torque = fast
        else:
            message = deserialize_message(raw, JointState)
            if lockstep and not any(
                (message.name, message.position, message.velocity, message.effort)
            ):
                return Acknowledgement(from_time(message.header.stamp))
            stamp, torque = self._read_message(raw, message)
        if not all(math.isfinite(value) for value in torque):
            raise StateError(
                f"{JOINT_COMMANDS.name}: effort {list(torque)} N m is not finite"
            )
        return TorqueCommand(stamp, (torque[0], torque[1]))

    def _read_message(self, raw: bytes, message: JointState) -> tuple[int, list[float]]:
        names = list(message.name)
        if sorted(names) != sorted(JOINT_NAMES):
            raise StateError(
                f"{JOINT_COMMANDS.name}: joints {names}; expected {list(JOINT_NAMES)}"
                " in any order"
            )
        if len(message.effort) != len(names):
            raise StateError(
                f"{JOINT_COMMANDS.name}: {len(message.effort)} efforts for {len(names)}"
                " joints"
            )
        if names == list(JOINT_NAMES) and not message.position and not message.velocity:
            self._template.learn(raw)
        return from_time(message.header.stamp), [
            message.effort[names.index(name)] for name in JOINT_NAMES
        ]
