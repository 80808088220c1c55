"""A monitor beside a stack hears what the nodes tell of themselves and calls their
services.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.client import Client
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import try_shutdown

from dextar_control.contract.topics import DIAGNOSTICS
from dextar_control.experiments.processes import NodesError
from dextar_control.nodekit.node import qos
from dextar_control.nodekit.services import ServiceType

TURN = 0.1  # s that one turn waits for something to hear
SERVICE_PATIENCE = 30.0  # s


class Reply(NamedTuple):
    """What Trigger and SetBool answer."""

    success: bool
    message: str


class Monitor(Node):
    """Hears every node's diagnostics.

    Args:
        name: of this node.

    Attributes:
        status: of each node, by its name without namespace, the values that it told
            last, with its ``message``.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name, enable_rosout=False, start_parameter_services=False)
        self.status: dict[str, dict[str, str]] = {}
        self._clients_of: dict[str, Client] = {}
        self.create_subscription(
            DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, qos(DIAGNOSTICS)
        )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            values["message"] = status.message
            self.on_status(status.name.rpartition("/")[2], values)

    def on_status(self, name: str, values: dict[str, str]) -> None:
        """Take what one node tells of itself."""
        self.status[name] = values

    def get(self, node: str, key: str) -> str:
        """Return a node's last diagnostics value; empty when it is unknown."""
        return self.status.get(node, {}).get(key, "")

    def turn(self) -> None:
        """Hear for a moment."""
        rclpy.spin_once(self, timeout_sec=TURN)

    def until(self, condition: Callable[[], object], patience: float) -> bool:
        """Hear until something holds; False when it does not within ``patience``, s."""
        deadline = time.monotonic() + patience
        while not condition():
            if time.monotonic() > deadline:
                return False
            self.turn()
        return True

    def wait(self, seconds: float) -> None:
        """Hear for some time, s."""
        self.until(lambda: False, seconds)

    def client(self, kind: ServiceType, name: str) -> Client:
        """Return the client of one service, made once."""
        if name not in self._clients_of:
            self._clients_of[name] = self.create_client(kind, name)
        return self._clients_of[name]

    def ask(
        self, kind: ServiceType, name: str, patience: float, **fields: object
    ) -> Future:
        """Call a service and wait for its answer, a future that is done.

        Raises:
            NodesError: nobody offers it, or no answer comes within ``patience``, s.
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
        return future

    def call(
        self,
        kind: ServiceType,
        name: str,
        patience: float = SERVICE_PATIENCE,
        **fields: object,
    ) -> Reply:
        """Return the answer of a Trigger or a SetBool.

        Raises:
            NodesError: nobody offers it, or no answer comes within ``patience``, s.
        """
        answer = self.ask(kind, name, patience, **fields).result()
        return Reply(answer.success, answer.message)

    def close(self) -> None:
        """Leave ROS with the whole process."""
        self.destroy_node()
        try_shutdown()


def start_ros() -> None:
    """Start ROS in this process, which deals with signals itself."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)


@contextlib.contextmanager
def monitoring(name: str) -> Iterator[Monitor]:
    """Run ROS in this process, with a monitor of this name, while the context lasts."""
    start_ros()
    with contextlib.closing(Monitor(name)) as monitor:
        yield monitor
