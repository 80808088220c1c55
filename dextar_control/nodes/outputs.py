"""The controller sends commands, and what it computed from the state that
they answer.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from dextar_control.contract.robot import JOINT_NAMES
from dextar_control.contract.topics import (
    CONTROLLER_STATE,
    CRITERION,
    EFFORT_COMMANDS,
    JOINT_COMMANDS,
)
from dextar_control.control.phases import Tick, indices_of
from dextar_control.nodekit.cdr import NANOSECONDS, canonical, places_in
from dextar_control.nodekit.layouts import template
from dextar_control.nodekit.node import DextarNode, qos
from dextar_control.nodes.readable import Readable

STATE = (
    "reference.x",
    "reference.x_dot",
    "reference.x_ddot",
    "estimate.x",
    "estimate.x_dot",
    "output.error",
    "output.error_dot",
    "output.u",
    "output.force",
)
JUDGED = (
    "output.residual",
    "output.s",
    "output.sigma_min",
    "output.weight",
    "estimate.assembly_mode",
    "estimate.confidence",
    "output.limit",
    "estimate.innovation_square",
    "estimate.innovation",
    "estimate.b",
    "estimate.d",
)
"""The quantities of a tick that are published on ``controller_state`` (STATE) and on
``criterion`` (JUDGED), where phase and verdict stand about the confidence.
"""


class EffortArray:
    """Packs effort_commands as CDR bytes; where the two numbers lie is found, not
    assumed.
    """

    def __init__(self) -> None:
        message = Float64MultiArray(data=[0.0, 0.0])
        raw, (place, _) = canonical(message), places_in(message)["data.0"]
        self._head, self._tail = raw[:place], raw[place + 16 :]

    def pack(self, effort: Sequence[float]) -> bytes:
        """Return the CDR bytes of these torques, (2,), N m."""
        return self._head + struct.pack("<2d", *effort) + self._tail


class Outputs:
    """The publishers of one configured controller; the command goes out first.

    Args:
        node: that publishes.
        array: whether the torques go out as ``effort_commands`` too.
        readable: whether state and criterion go out in messages of
            ``dextar_interfaces`` too.

    Attributes:
        stamp: of the state answered last, ns; negative before the first.
    """

    def __init__(self, node: DextarNode, *, array: bool, readable: bool) -> None:
        self._node = node
        self._commands_out = template(JOINT_COMMANDS)
        self._state_out = template(CONTROLLER_STATE)
        self._criterion_out = template(CRITERION)
        self._commands = node.create_publisher(
            JointState, JOINT_COMMANDS.name, qos(JOINT_COMMANDS)
        )
        self._states = node.create_publisher(
            JointTrajectory, CONTROLLER_STATE.name, qos(CONTROLLER_STATE)
        )
        self._criterion = node.create_publisher(
            JointState, CRITERION.name, qos(CRITERION)
        )
        self._array_out = EffortArray() if array else None
        self._efforts = (
            node.create_publisher(
                Float64MultiArray, EFFORT_COMMANDS.name, qos(EFFORT_COMMANDS)
            )
            if array
            else None
        )
        self._command_topics = [
            p.topic_name for p in (self._commands, self._efforts) if p is not None
        ]
        self._readable = Readable(node) if readable else None
        self._state_of, self._judged_of = (
            indices_of(len(JOINT_NAMES), *fields) for fields in (STATE, JUDGED)
        )
        self._read = True, True
        self._last = (b"", b"")
        self.stamp = -1

    @property
    def can_repeat(self) -> bool:
        """Whether there is a command to repeat."""
        return bool(self._last[0])

    def command(self, stamp: int, torque: Sequence[float]) -> None:
        """Publish the command that answers a state.

        Args:
            stamp: of the state, ns.
            torque: of the motors, (2,), N m.
        """
        self.stamp = stamp
        self._send(
            self._commands_out.pack(stamp, torque),
            self._array_out.pack(torque) if self._array_out is not None else b"",
        )

    def tell(self, stamp: int, tick: Tick, verdict: float) -> None:
        """Publish what was computed from a state, to those who read it.

        Args:
            stamp: of the state, ns.
            tick: the loop's quantities.
            verdict: on the planned crossing that began last, as ``criterion`` carries
                it.
        """
        states_read, criterion_read = self._read
        state, judged, reference_time = [], [], round(tick.reference_time * NANOSECONDS)
        if states_read:
            state = tick.numbers[self._state_of].tolist()
            self._states.publish(self._state_out.pack(stamp, state, reference_time))
        if criterion_read:
            judged = tick.numbers[self._judged_of].tolist()
            judged[5:6] = float(tick.phase), judged[5], verdict
            self._criterion.publish(self._criterion_out.pack(stamp, judged))
        if self._readable is not None:
            self._readable.publish(stamp, state, reference_time, judged)

    def look(self) -> None:
        """Find out which topics are read; for others no message is made. It takes about
        10 us.
        """
        if self._readable is None:  # which needs both
            self._read = (
                self._states.get_subscription_count() > 0,
                self._criterion.get_subscription_count() > 0,
            )

    def repeat(self) -> None:
        """Publish the last command once more."""
        self._send(*self._last)

    def release(self) -> None:
        """Command no torque, in answer to the last state once more; nothing is sent
        before the first.
        """
        if self.stamp >= 0:
            self.command(self.stamp, [0.0, 0.0])

    def forget(self) -> None:
        """Forget the last command, as before the first state."""
        self._last, self.stamp = (b"", b""), -1

    def _send(self, command: bytes, array: bytes) -> None:
        self._last = (command, array)
        self._commands.publish(command)
        if self._efforts is not None:
            self._efforts.publish(array)

    def others(self) -> str:
        """Return which other nodes publish commands, in words; empty when none does. It
        takes about 5 us for each topic.
        """
        for name in self._command_topics:
            if told := self._node.too_many_publishers(name):
                return told
        return ""

    def close(self) -> None:
        """Destroy the publishers."""
        publishers = [self._commands, self._states, self._criterion, self._efforts]
        if self._readable is not None:
            publishers += self._readable.publishers
        for publisher in publishers:
            if publisher is not None:
                self._node.destroy_publisher(publisher)
