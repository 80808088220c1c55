"""The one who watches: every word of the nodes, every sample at the rig, and the
services an operator calls.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from dextar_control.contract.topics import (
    CRITERION,
    CRITERION_NAMES,
    DIAGNOSTICS,
    JOINT_COMMANDS,
    SIM_JOINT_STATES,
    Topic,
)
from dextar_control.experiments.faults.injector import RIG_COMMANDS, Injector
from dextar_control.experiments.processes import NodesError
from dextar_control.nodekit.cdr import CdrTemplate, from_time
from dextar_control.nodekit.layouts import template
from dextar_control.nodekit.node import make_executor, qos

POLL_PERIOD = 0.004  # s between two looks into the readers
HISTORY = 4000  # samples that each of them holds meanwhile
IDLE_WAIT = 0.02
SERVICE_PATIENCE = 30.0
PHASE = CRITERION_NAMES.index("phase")


class Tap:
    """The samples of one topic, decoded as they come.

    Attributes:
        stamps, sent: of each sample, and when its publisher sent it, ns.
        rows: its numbers.
    """

    def __init__(
        self, node: Any, topic: Topic, template: CdrTemplate, name: str = ""
    ) -> None:
        self._subscription = node.create_polled_subscription(
            JointState, name or topic.name, qos(topic, depth=HISTORY), raw=True
        )
        self._take = self._subscription.handle.take_message
        self._template = template
        self.stamps: list[int] = []
        self.sent: list[int] = []
        self.rows: list[list[float]] = []

    def poll(self) -> None:
        """Take what has come."""
        while (taken := self._take(JointState, True)) is not None:
            raw, info = taken
            known = self._template.unpack(raw)
            if known is None:
                known = self._read(raw)
                if known is None:
                    continue
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

    def table(self, width: int) -> tuple[np.ndarray, np.ndarray]:
        """(stamps (n,), rows (n, width))."""
        return np.array(self.stamps, dtype=np.int64), np.array(self.rows).reshape(
            -1, width
        )


class Operator(Node):
    """Watches the nodes of one robot and calls their services.

    Args:
        injector: whether one stands between rig and controller.
        lockstep: whether the rig waits for its commands.
    """

    def __init__(self, *, injector: bool, lockstep: bool) -> None:
        self._polled: set[int] = set()
        super().__init__(
            "operator", enable_rosout=False, start_parameter_services=False
        )
        self.status: dict[str, dict[str, str]] = {}
        self.texts: dict[str, list[str]] = {}
        self.heard: dict[str, float] = {}
        self.injector = Injector(self, lockstep=lockstep) if injector else None
        self.truth = Tap(self, SIM_JOINT_STATES, template(SIM_JOINT_STATES))
        self.commands = Tap(self, JOINT_COMMANDS, template(JOINT_COMMANDS))
        self.at_rig = self.commands
        if injector:
            self.at_rig = Tap(
                self, JOINT_COMMANDS, template(JOINT_COMMANDS), RIG_COMMANDS
            )
        self.criterion = Tap(self, CRITERION, template(CRITERION))
        self.create_subscription(
            DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, qos(DIAGNOSTICS)
        )
        self._known: dict[tuple[type, str], Any] = {}
        self._polled_at = 0.0
        self._executor = make_executor()
        self._executor.add_node(self)

    @property
    def taps(self) -> list[Tap]:
        """All of them, each once."""
        return list(
            dict.fromkeys((self.truth, self.commands, self.at_rig, self.criterion))
        )

    @property
    def subscriptions(self) -> Any:
        """What the executor serves: not the polled ones."""
        return (
            entity for entity in super().subscriptions if id(entity) not in self._polled
        )

    def create_polled_subscription(
        self, kind: type, name: str, profile: Any, *, raw: bool
    ) -> Any:
        """A subscription that no executor serves."""
        subscription = self.create_subscription(
            kind, name, lambda _: None, profile, raw=raw
        )
        self._polled.add(id(subscription))
        return subscription

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name = status.name.rpartition("/")[2]
            values = {item.key: item.value for item in status.values} | {
                "message": status.message
            }
            self.status[name] = values
            self.heard[name] = time.monotonic()
            for key, value in values.items():
                texts = self.texts.setdefault(f"{name}.{key}", [])
                if not texts or texts[-1] != value:
                    texts.append(value)

    @property
    def phase(self) -> int:
        """The controller's, by its last answered state; -1 before the first."""
        return int(self.criterion.rows[-1][PHASE]) if self.criterion.rows else -1

    @property
    def now(self) -> int:
        """The rig's clock, ns: the stamp of the last true state; 0 before the first."""
        return self.truth.stamps[-1] if self.truth.stamps else 0

    def get(self, node: str, key: str) -> str:
        """A node's last diagnostics value, empty when unknown."""
        return self.status.get(node, {}).get(key, "")

    def turn(self) -> None:
        """One turn of the loop."""
        injector = self.injector
        if injector is not None:
            injector.poll()
            self._executor.spin_once(timeout_sec=min(injector.left(), IDLE_WAIT))
        else:
            self._executor.spin_once(timeout_sec=POLL_PERIOD)
        if time.monotonic() - self._polled_at >= POLL_PERIOD:
            for tap in self.taps:
                tap.poll()
            self._polled_at = time.monotonic()

    def until(self, condition: Callable[[], Any], patience: float) -> bool:
        """Turn until something holds; False when it does not within ``patience`` s."""
        deadline = time.monotonic() + patience
        while not condition():
            if time.monotonic() > deadline:
                return False
            self.turn()
        return True

    def forget(self) -> None:
        """Samples and words count from here on; the last commands stay, since what is
        held answers to them.
        """
        for tap in self.taps:
            tap.drop(300 if tap in (self.commands, self.at_rig) else 1)
        self.texts = {
            f"{name}.{key}": [value]
            for name, values in self.status.items()
            for key, value in values.items()
        }

    def client(self, kind: Any, name: str) -> Any:
        """A client of one service, made once."""
        if (kind, name) not in self._known:
            self._known[kind, name] = self.create_client(kind, name)
        return self._known[kind, name]

    def call(
        self, kind: Any, name: str, patience: float = SERVICE_PATIENCE, **fields: Any
    ) -> Any:
        """The answer of one service.

        Raises:
            NodesError: there is none.
        """
        client = self.client(kind, name)
        if not self.until(client.service_is_ready, patience):
            raise NodesError(f"nobody offers the service {name}")
        future = client.call_async(kind.Request(**fields))
        if not self.until(future.done, patience):
            client.remove_pending_request(future)
            raise NodesError(
                f"the service {name} did not answer within {patience:.0f} s"
            )
        return future.result()

    def change_parameters(self, node: str, **values: Any) -> list[str]:
        """Set a node's parameters one by one (``__`` is a dot); why each was refused,
        empty where it was not.
        """
        asked = [
            parameter(name.replace("__", "."), value) for name, value in values.items()
        ]
        answer = self.call(SetParameters, f"{node}/set_parameters", parameters=asked)
        return [
            "" if result.successful else result.reason or "refused"
            for result in answer.results
        ]

    def close(self) -> None:
        """Leave the executor and ROS."""
        self._executor.remove_node(self)
        self._executor.shutdown()
        self.destroy_node()
        rclpy.try_shutdown()


def parameter(name: str, value: Any) -> ParameterMessage:
    """One parameter as its service wants it."""
    if isinstance(value, bool):
        typed = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=value)
    elif isinstance(value, int):
        typed = ParameterValue(
            type=ParameterType.PARAMETER_INTEGER, integer_value=value
        )
    elif isinstance(value, str):
        typed = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
    else:
        typed = ParameterValue(
            type=ParameterType.PARAMETER_DOUBLE, double_value=float(value)
        )
    return ParameterMessage(name=name, value=typed)
