"""A client of one robot's nodes hears what they tell of themselves and calls their
services.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Protocol, TypeVar, cast

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.client import Client
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import try_shutdown

from dextar_control.contract.errors import DextarError, NodesError, ParameterError
from dextar_control.contract.signals import StopSignal
from dextar_control.contract.topics import DIAGNOSTICS
from dextar_control.nodekit.domain import discovery
from dextar_control.nodekit.node import qos
from dextar_control.nodekit.services import ServiceType

DISCOVERY = 5.0  # s in which a node that runs is heard of
ANSWER = 10.0  # s in which a service answers that does not plan
# s without a word of a node that speaks each second, after which it counts as gone
SILENCE = 10.0
TICK = 0.05  # s
C = TypeVar("C", bound=Node)


class StopRequest(Protocol):
    """True from when on what is under way is to end."""

    def __bool__(self) -> bool: ...

    def check(self) -> None:
        """Raise ``Interrupted`` where it is to end."""


class Reply(Protocol):
    """What Trigger and SetBool answer."""

    success: bool
    message: str


class NodeClient(Node):
    """Hears what the nodes of one robot tell of themselves, and calls their services.

    Args:
        name: of this node.
        namespace: of the robot's nodes.
        stop: what asks for an end, as the signals to a command's process; None asks
            for none.

    Attributes:
        status: of each node, by its name in the namespace: the values that it told
            last, with its ``message`` and ``level``.
        heard: when each node told of itself last, s of the monotonic clock.
        patience: how long a service may take to be found, and then to answer, s.
    """

    def __init__(
        self, name: str, namespace: str = "", stop: StopRequest | None = None
    ) -> None:
        super().__init__(
            name,
            namespace=namespace,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self.stop = stop
        self.status: dict[str, dict[str, str]] = {}
        self.heard: dict[str, float] = {}
        self.patience = DISCOVERY, ANSWER
        self._clients_of: dict[str, Client] = {}
        self.create_subscription(
            DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, qos(DIAGNOSTICS)
        )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            space, _, name = status.name.rpartition("/")
            if space == self.get_namespace().rstrip("/"):
                values = {item.key: item.value for item in status.values}
                told = {"message": status.message, "level": str(status.level[0])}
                self.heard[name] = time.monotonic()
                self.on_status(name, values | told)

    def on_status(self, name: str, values: dict[str, str]) -> None:
        """Take what one node tells of itself."""
        self.status[name] = values

    def get(self, node: str, key: str) -> str:
        """Return a node's last diagnostics value; empty when it is unknown."""
        return self.status.get(node, {}).get(key, "")

    def full(self, name: str) -> str:
        """Return a node's or service's name with the namespace."""
        return f"{self.get_namespace().rstrip('/')}/{name}"

    def turn(self) -> None:
        """Hear for a moment."""
        rclpy.spin_once(self, timeout_sec=TICK)

    def until(
        self, condition: Callable[[], object], seconds: float, *, through: bool = False
    ) -> bool:
        """Hear until something holds; return False where it does not in time.

        Args:
            condition: true once it holds.
            seconds: at most.
            through: whether to go on after a signal.

        Raises:
            Interrupted: a signal came.
        """
        deadline = time.monotonic() + seconds
        while not condition():
            if self.stop and not through:
                self.stop.check()
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

    def begin(
        self, kind: ServiceType, name: str, *, through: bool = False, **fields: object
    ) -> Future:
        """Call a service; return its answer as a future.

        Args:
            kind: the service's type.
            name: of the service, relative to the namespace.
            through: whether to go on after a signal.
            fields: of the request.

        Raises:
            NodesError: nobody offers it.
        """
        client, (found, _) = self.client(kind, name), self.patience
        if not self.until(client.service_is_ready, found, through=through):
            raise NodesError(self.missing(name.partition("/")[0]))
        return client.call_async(kind.Request(**fields))

    def ask(
        self, kind: ServiceType, name: str, *, through: bool = False, **fields: object
    ) -> object:
        """Return the answer of a service; the arguments are those of ``begin``.

        Raises:
            NodesError: nobody offers it, or no answer comes.
        """
        future = self.begin(kind, name, through=through, **fields)
        client, (_, seconds) = self.client(kind, name), self.patience
        over = self.until(
            lambda: future.done() or not client.service_is_ready(),
            seconds,
            through=through,
        )
        if not future.done():
            client.remove_pending_request(future)
            why = "and it has ended" if over else f"within {seconds:.0f} s"
            raise NodesError(
                f"no answer of {self.full(name)} {why}; see that its node runs, then"
                " try again"
            )
        return future.result()

    def call(
        self, kind: ServiceType, name: str, *, through: bool = False, **fields: object
    ) -> Reply:
        """Return the answer of a Trigger or a SetBool, as ``ask`` does."""
        return cast(Reply, self.ask(kind, name, through=through, **fields))

    def missing(self, name: str) -> str:
        """Return that a node is not heard of, what else is, and what to do."""
        nodes = self.get_node_names_and_namespaces()
        others = {space for node, space in nodes if node == name}
        others.discard(self.get_namespace())
        if others:
            return (
                f"{self.full(name)} does not run, but there is one in"
                f" {', '.join(sorted(others))}: choose by --namespace"
            )
        where = discovery()
        if name in [node for node, _ in nodes]:
            return (
                f"no word of {self.full(name)} for {SILENCE:.0f} s, though it is there"
                f" ({where}): see its log"
            )
        return (
            f"no word of {self.full(name)} within {self.patience[0]:g} s ({where}):"
            " start the nodes (ros2 launch dextar crossing.launch.py, or each alone),"
            " or set ROS_DOMAIN_ID to theirs; dextar demo starts its own and tells its"
            " domain first"
        )


def start_ros() -> None:
    """Start ROS in this process, which deals with signals itself."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)


@contextmanager
def monitoring(name: str) -> Iterator[NodeClient]:
    """Run ROS in this process, with a client of this name, while the context lasts."""
    start_ros()
    monitor = NodeClient(name)
    try:
        yield monitor
    finally:
        monitor.destroy_node()
        try_shutdown()


@contextmanager
def client_node(make: Callable[[StopSignal], C]) -> Iterator[tuple[C, StopSignal]]:
    """Give a command's own node, and the signals as a flag, until the context ends.

    Args:
        make: builds the node.

    Raises:
        ParameterError: a name that the node is given is none.
    """
    stop = StopSignal()
    stop.starting = False
    with ExitStack() as ending:
        ending.callback(stop.restore)
        ending.callback(try_shutdown)
        try:
            start_ros()
            node = make(stop)
        except DextarError:
            raise
        except Exception as error:  # rcl raises its own types for bad names
            text = " ".join(str(error).replace("^", "").split())
            raise ParameterError(text) from error
        ending.callback(node.destroy_node)
        yield node, stop
