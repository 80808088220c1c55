"""The injector between rig and controller passes states one way and commands the other,
each through a faulty link.

The rig's topics are remapped to ``rig/joint_states`` and ``rig/joint_commands``; the
controller keeps the contract's. Messages pass as the bytes they are; only one that gets
another shape is decoded.

In lockstep the rig waits at each state. The injector delivers what is due at the
state's stamp, waits for the controller's answers to it, delivers the commands that are
due, and acknowledges the state where none of them answers it. Delays are then in
simulated time, and nothing depends on how fast the machine is.
"""

from __future__ import annotations

import math
import time

from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from dextar_control.contract.topics import JOINT_COMMANDS, JOINT_STATES
from dextar_control.experiments.faults.link import (
    ENCODER_STEP,
    NON_FINITE,
    STAMP_EARLINESS,
    STAMP_SHIFT,
    Delivery,
    MessageLink,
    MessageShape,
)
from dextar_control.nodekit.cdr import NANOSECONDS, CdrTemplate, from_time, to_time
from dextar_control.nodekit.node import qos

RIG_STATES = f"rig/{JOINT_STATES.name}"
RIG_COMMANDS = f"rig/{JOINT_COMMANDS.name}"
REMAPPINGS = (
    f"{JOINT_STATES.name}:={RIG_STATES}",
    f"{JOINT_COMMANDS.name}:={RIG_COMMANDS}",
)
# states that a controller answers
ANSWERED = (
    None,
    MessageShape.STEP,
    MessageShape.STAMP_FUTURE,
    MessageShape.STAMP_EARLY,
)
PATIENCE = 2.0  # s on the steady clock for an answer of a controller that answers
# s for one of a controller that did not answer last, or to a state that need not be
# answered
SHORT_PATIENCE = 0.01


def stamp_of(raw: bytes) -> int:
    """Return the stamp, ns, of a message whose first field is a header."""
    seconds = int.from_bytes(raw[4:8], "little", signed=True)
    return seconds * NANOSECONDS + int.from_bytes(raw[8:12], "little")


def reshape(raw: bytes, shape: MessageShape, began: int) -> bytes:
    """Return a joint state or command in another shape; ``began`` is the frozen stamp,
    ns.
    """
    message = deserialize_message(raw, JointState)
    values = list(message.position if len(message.position) else message.effort)
    stamp = from_time(message.header.stamp)
    stamps = {
        MessageShape.STAMP_BACK: max(stamp - STAMP_SHIFT, 0),
        MessageShape.STAMP_FUTURE: stamp + STAMP_SHIFT,
        MessageShape.STAMP_EARLY: max(stamp - STAMP_EARLINESS, 0),
        MessageShape.STAMP_FROZEN: began,
    }
    if shape in stamps:
        message.header.stamp = to_time(stamps[shape])
    elif shape is MessageShape.NAN:
        values[0] = math.nan
    elif shape is MessageShape.INFINITY:
        values[1] = math.inf
    elif shape is MessageShape.NAMES:
        message.name = ["joint_1", "joint_2"]
    elif shape is MessageShape.SIZES:
        values = values[:1]
    elif shape is MessageShape.STEP:
        values[0] += ENCODER_STEP
    if len(message.position):
        message.position = values
    else:
        message.effort = values
    return bytes(serialize_message(message))


class Injector:
    """Passes messages through its two links.

    Args:
        node: on which the entities are made; its executor drives the injector.
        lockstep: whether the rig waits for each state's answer.

    Attributes:
        states, commands: the links.
        now: stamp of the rig's last state, ns; -1 before the first.
        bad_stamps: of the states that were delivered with numbers that are not finite,
            ns.
    """

    def __init__(self, node: Node, *, lockstep: bool) -> None:
        self.states: MessageLink[bytes] = MessageLink()
        self.commands: MessageLink[bytes] = MessageLink()
        self.now = -1
        self.bad_stamps: list[int] = []
        self._lockstep = lockstep
        self._arrived = 0
        self._waiting: bytes | None = None  # the rig's state that has no answer yet
        self._expected: set[int] = set()
        self._deadline = 0.0
        self._answers = True
        self._newest_delivered = -1
        self._answered_at_rig = False
        self._empty = CdrTemplate(JointState())
        self._to_controller = node.create_publisher(
            JointState, JOINT_STATES.name, qos(JOINT_STATES)
        )
        self._to_rig = node.create_publisher(
            JointState, RIG_COMMANDS, qos(JOINT_COMMANDS)
        )
        node.create_subscription(
            JointState,
            RIG_STATES,
            self._on_state,
            qos(JOINT_STATES, reliable=lockstep),
            raw=True,
        )
        node.create_subscription(
            JointState,
            JOINT_COMMANDS.name,
            self._on_command,
            qos(JOINT_COMMANDS, reliable=lockstep),
            raw=True,
        )

    def clock(self) -> int:
        """Return the links' time, ns: the rig's, in real time with what has passed
        since its last state.
        """
        return (
            self.now
            if self._lockstep
            else self.now + time.monotonic_ns() - self._arrived
        )

    def clear(self) -> None:
        """Forget windows and what is under way, as after a restart of the rig."""
        self.states.clear()
        self.commands.clear()
        self.bad_stamps.clear()

    def forget_rig(self) -> None:
        """Begin anew with a rig that was restarted, whose stamps do."""
        self.clear()
        self.now = -1
        self._waiting, self._newest_delivered = None, -1
        self._expected.clear()

    def _on_state(self, raw: bytes) -> None:
        stamp = stamp_of(raw)
        self._arrived = time.monotonic_ns()
        # the rig repeats itself: what answered it was lost or has not come
        if stamp <= self.now:
            if self._lockstep and self._waiting is None:
                self._acknowledge(stamp)
            return
        self.now = stamp
        self.states.send(stamp, raw)
        if self._lockstep:
            self._waiting, self._answered_at_rig = raw, False
            self._expected.clear()
        self._deliver_states()
        if self._lockstep:
            self._settle()

    def _on_command(self, raw: bytes) -> None:
        self.commands.send(self.clock(), raw)
        if not self._lockstep or self._waiting is None:
            self._deliver_commands()
            return
        stamp = stamp_of(raw)
        self._answers = True
        self._expected.discard(stamp)
        if not self._expected:
            self._deadline = 0.0
        self._settle()

    def poll(self) -> None:
        """Pass on what is due by time alone; this is called in each turn of the
        loop.
        """
        if not self._lockstep:
            self._deliver_states()
            self._deliver_commands()
        elif self._waiting is not None:
            self._settle()

    def left(self) -> float:
        """Return the seconds until ``poll`` has something to do, at most 0.05."""
        if self._lockstep:
            return (
                0.05
                if self._waiting is None
                else min(max(self._deadline - time.monotonic(), 0.0), 0.05)
            )
        dues = [
            due
            for due in (self.states.next_due(), self.commands.next_due())
            if due is not None
        ]
        return min(max(1e-9 * (min(dues) - self.clock()), 0.0), 0.05) if dues else 0.05

    def _deliver_states(self) -> None:
        patience = 0.0
        for delivery in self.states.due(self.clock()):
            raw = self._shaped(delivery)
            stamp = stamp_of(raw)
            if delivery.shape in NON_FINITE:
                self.bad_stamps.append(stamp)
            self._to_controller.publish(raw)
            whole = delivery.shape in ANSWERED and stamp > self._newest_delivered
            if whole:
                self._newest_delivered = stamp
                self._expected.add(stamp)
            patience = max(
                patience, PATIENCE if whole and self._answers else SHORT_PATIENCE
            )
        self._deadline = time.monotonic() + patience

    def _deliver_commands(self) -> None:
        for delivery in self.commands.due(self.clock()):
            raw = self._shaped(delivery)
            self._to_rig.publish(raw)
            self._answered_at_rig |= (
                delivery.shape in (None, MessageShape.STEP)
                and stamp_of(raw) == self.now
            )

    def _settle(self) -> None:
        """Let the rig go on once the answers are there, or are not going to come."""
        if time.monotonic() < self._deadline:
            return
        if self._expected:
            self._answers = False
            self._expected.clear()
        self._deliver_commands()
        self._waiting = None
        if not self._answered_at_rig:
            self._acknowledge(self.now)

    def _acknowledge(self, stamp: int) -> None:
        self._to_rig.publish(self._empty.pack(stamp, ()))

    @staticmethod
    def _shaped(delivery: Delivery[bytes]) -> bytes:
        return (
            delivery.item
            if delivery.shape is None
            else reshape(delivery.item, delivery.shape, delivery.began)
        )
