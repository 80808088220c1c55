"""The monitor of a stack under faults: it keeps every text of the nodes and every
sample at the rig.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import JointState

from dextar_control.contract.topics import (
    CRITERION,
    CRITERION_NAMES,
    JOINT_COMMANDS,
    SIM_JOINT_STATES,
    Topic,
)
from dextar_control.experiments.faults.injector import RIG_COMMANDS, Injector
from dextar_control.nodekit.cdr import from_time
from dextar_control.nodekit.client import NodeClient
from dextar_control.nodekit.layouts import template
from dextar_control.nodekit.node import make_executor, qos
from dextar_control.symbols.types import Array

POLL_PERIOD = 0.004  # s between two looks into the readers
HISTORY = 4000  # samples that each of them holds meanwhile
IDLE_WAIT = 0.02  # s
SERVICE_PATIENCE = 30.0  # s
KEPT_COMMANDS = 300  # samples of commands that are kept from trip to trip
PHASE = CRITERION_NAMES.index("phase")


class SampleReader:
    """Reads the samples of one topic, and decodes them as they come.

    Args:
        monitor: that subscribes.
        topic: whose samples these are.
        name: of the topic where it is remapped.

    Attributes:
        stamps, sent: of each sample, and when its publisher sent it, ns.
        rows: its numbers.
    """

    def __init__(self, monitor: StackMonitor, topic: Topic, name: str = "") -> None:
        self._subscription = monitor.create_polled_subscription(
            name or topic.name, qos(topic, depth=HISTORY)
        )
        self._take = self._subscription.handle.take_message
        self._template = template(topic)
        self.stamps: list[int] = []
        self.sent: list[int] = []
        self.rows: list[list[float]] = []

    def poll(self) -> None:
        """Take what has come."""
        while (taken := self._take(JointState, True)) is not None:
            raw, info = taken
            known = self._template.unpack(raw) or self._read(raw)
            if known is not None:
                self.stamps.append(known[0])
                self.rows.append(known[1])
                self.sent.append(info["source_timestamp"])

    def _read(self, raw: bytes) -> tuple[int, list[float]] | None:
        message = deserialize_message(raw, JointState)
        values = [*message.position, *message.velocity, *message.effort]
        if len(message.name) and len(values) in (2, len(CRITERION_NAMES), 12):
            self._template.learn(raw)
            return from_time(message.header.stamp), values
        return None

    def drop(self, keep: int) -> None:
        """Forget all but the last samples."""
        first = max(len(self.stamps) - keep, 0)
        del self.stamps[:first], self.rows[:first], self.sent[:first]

    def table(self, width: int) -> tuple[NDArray[np.int64], Array]:
        """Return the stamps, (n,), ns, and the numbers, (n, width), in the topic's
        units.
        """
        return np.array(self.stamps, dtype=np.int64), np.array(self.rows).reshape(
            -1, width
        )


class StackMonitor(NodeClient):
    """Watches the nodes of one robot, and passes messages on where an injector stands
    between rig and controller.

    Args:
        injector: whether one does.
        lockstep: whether the rig waits for its commands.

    Attributes:
        texts: all values of each ``node.key`` of the diagnostics since ``forget``.
        injector: between rig and controller; None without one.
        truth, commands, at_rig, criterion: samples of the true joints, of the
            controller's commands, of those that reach the rig, and of its answers.
    """

    def __init__(self, *, injector: bool, lockstep: bool) -> None:
        self._polled: set[int] = set()
        super().__init__("operator")
        self.texts: dict[str, list[str]] = {}
        self.patience = SERVICE_PATIENCE, SERVICE_PATIENCE
        self.injector = Injector(self, lockstep=lockstep) if injector else None
        self.truth = SampleReader(self, SIM_JOINT_STATES)
        self.commands = SampleReader(self, JOINT_COMMANDS)
        self.at_rig = (
            SampleReader(self, JOINT_COMMANDS, RIG_COMMANDS)
            if injector
            else self.commands
        )
        self.criterion = SampleReader(self, CRITERION)
        self._taps = dict.fromkeys(
            (self.truth, self.commands, self.at_rig, self.criterion)
        )
        self._polled_at = 0.0
        self._executor = make_executor()
        self._executor.add_node(self)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """What the executor serves: not the polled ones."""
        return (
            entity for entity in super().subscriptions if id(entity) not in self._polled
        )

    def create_polled_subscription(
        self, name: str, profile: QoSProfile
    ) -> Subscription:
        """Subscribe to the bytes of a JointState topic that no executor serves."""
        subscription = self.create_subscription(
            JointState, name, lambda _: None, profile, raw=True
        )
        self._polled.add(id(subscription))
        return subscription

    def on_status(self, name: str, values: dict[str, str]) -> None:
        """Keep all that one node tells of itself."""
        super().on_status(name, values)
        for key, value in values.items():
            texts = self.texts.setdefault(f"{name}.{key}", [])
            if not texts or texts[-1] != value:
                texts.append(value)

    @property
    def phase(self) -> int:
        """The controller's phase by its last answered state; -1 before the first."""
        return int(self.criterion.rows[-1][PHASE]) if self.criterion.rows else -1

    @property
    def now(self) -> int:
        """The rig's clock, ns: the stamp of the last true state; 0 before the first."""
        return self.truth.stamps[-1] if self.truth.stamps else 0

    def turn(self) -> None:
        """Serve the injector and the executor, and take what has come."""
        injector = self.injector
        if injector is not None:
            injector.poll()
            self._executor.spin_once(timeout_sec=min(injector.left(), IDLE_WAIT))
        else:
            self._executor.spin_once(timeout_sec=POLL_PERIOD)
        if time.monotonic() - self._polled_at >= POLL_PERIOD:
            for tap in self._taps:
                tap.poll()
            self._polled_at = time.monotonic()

    def forget(self) -> None:
        """Forget samples and texts; the last commands stay, since what is held answers
        to them.
        """
        for tap in self._taps:
            tap.drop(KEPT_COMMANDS if tap in (self.commands, self.at_rig) else 1)
        self.texts = {
            f"{name}.{key}": [value]
            for name, values in self.status.items()
            for key, value in values.items()
        }

    def change_parameters(self, node: str, **values: bool | int | float) -> list[str]:
        """Set a node's parameters one by one (``__`` is a dot); why each was refused,
        empty where it was not.
        """
        answer: SetParameters.Response = self.ask(
            SetParameters, f"{node}/set_parameters", parameters=parameters(values)
        )
        return [
            "" if result.successful else result.reason or "refused"
            for result in answer.results
        ]

    def close(self) -> None:
        """Leave the executor and ROS."""
        self._executor.remove_node(self)
        self._executor.shutdown()
        self.destroy_node()
        try_shutdown()


def parameters(values: Mapping[str, bool | int | float]) -> list[ParameterMessage]:
    """Return the messages of parameters by name, in which ``__`` is a dot."""
    return [
        Parameter(name.replace("__", "."), value=value).to_parameter_msg()
        for name, value in values.items()
    ]
