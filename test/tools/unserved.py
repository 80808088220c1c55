"""A node whose services nobody serves until it is told to, and a caller of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import rclpy
from patience import PATIENCE
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from dextar_control.nodekit.node import DextarNode


class Unserved:
    """Starts ROS, makes the node and a caller of its services.

    Attributes:
        node: that is called.
        caller: the other one.
        executor: serves the caller.
    """

    def __init__(self, make: Callable[[], DextarNode], *arguments: str) -> None:
        words = ["--ros-args", *arguments] if arguments else []
        rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
        self.node: Any = make()
        self.caller = Node("caller")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.caller)
        self._clients: dict[str, Any] = {}

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        """The answer to come of a service of the node."""
        full = f"{self.node.get_name()}/{name}"
        client = self._clients.get(name) or self.caller.create_client(kind, full)
        self._clients[name] = client
        assert client.wait_for_service(PATIENCE)
        return client.call_async(kind.Request(**fields))

    def arrive(self, *names: str) -> None:
        """Wait until a request lies at each of these services, without taking it."""
        handles = [
            service.handle
            for service in self.node._services
            if service.service_name.rpartition("/")[2] in names
        ]
        assert len(handles) == len(names)
        for handle in handles:
            waits = rclpy_implementation.WaitSet(
                0, 0, 0, 0, 1, 0, self.node.context.handle
            )
            with handle:
                waits.clear_entities()
                waits.add_service(handle)
                waits.wait(round(PATIENCE * 1e9))
                assert waits.get_ready_entities("service")

    def finish(self, *futures: Any) -> Any:
        """The first answer, once all have come; ``turn`` has the node serve."""
        deadline = time.monotonic() + PATIENCE
        while not all(future.done() for future in futures):
            self.turn()
            self.executor.spin_once(timeout_sec=0.01)
            assert time.monotonic() < deadline
        return futures[0].result()

    def turn(self) -> None:
        """Have the node do something; by itself it does nothing."""

    def close(self) -> None:
        """End both nodes; the one that is called must be gone before the caller."""
        self.executor.shutdown()
        name = self.node.get_name()
        self.node.close()
        self.node.destroy_node()
        left = [other for other in self.caller.get_node_names() if other == name]
        self.caller.destroy_node()
        rclpy.try_shutdown()
        assert left == [], "a destroyed node stays in the graph"
