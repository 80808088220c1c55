"""Services that no executor serves, over real DDS: how many are served, in which order,
and what a broken call does.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from patience import PATIENCE
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from dextar_control.contract.node_parameters import RECORDER
from dextar_control.nodekit.node import DextarNode

WaitSet = rclpy_implementation.WaitSet


class _Unserved(DextarNode):
    NAME, PARAMETERS, ROBOT = "recorder", RECORDER, False


class _Desk:
    """A node whose services nobody serves but ``poll``, and a caller of them."""

    def __init__(self) -> None:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = _Unserved(served=False)
        self.caller = Node("caller")
        self.asked: list[str] = []
        for name in ("one", "two"):
            self.node.create_service(
                Trigger,
                f"~/{name}",
                lambda _, response, name=name: self._on_call(name, response),
            )
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._executor.add_node(self.caller)
        self._clients: dict[str, Any] = {}

    def _on_call(self, name: str, response: Any) -> Any:
        self.asked.append(name)
        return response

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self._clients.setdefault(
            name, self.caller.create_client(kind, f"recorder/{name}")
        )
        assert client.wait_for_service(PATIENCE)
        return client.call_async(request)

    def arrive(self, *names: str) -> None:
        """Wait until a request lies at each of these services, without taking it."""
        handles = [
            service.handle
            for service in self.node._services
            if service.service_name.rpartition("/")[2] in names
        ]
        assert len(handles) == len(names)
        for handle in handles:
            waits = WaitSet(0, 0, 0, 0, 1, 0, self.node.context.handle)
            with handle:
                waits.clear_entities()
                waits.add_service(handle)
                waits.wait(round(PATIENCE * 1e9))
                assert waits.get_ready_entities("service")

    def spin(self, futures: list[Any]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not all(future.done() for future in futures):
            self._executor.spin_once(timeout_sec=0.01)
            assert time.monotonic() < deadline

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        self.caller.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def desk() -> Iterator[_Desk]:
    desk = _Desk()
    yield desk
    desk.close()


def test_an_executor_serves_none_and_a_poll_at_most_its_limit(desk: _Desk) -> None:
    futures = [desk.call(Trigger, "one", Trigger.Request()) for _ in range(8)]
    read = [
        desk.call(
            GetParameters, "get_parameters", GetParameters.Request(names=["output"])
        )
        for _ in range(8)
    ]
    desk.arrive("one", "get_parameters")
    for _ in range(20):
        desk._executor.spin_once(timeout_sec=0.01)
    assert not desk.asked
    served = [desk.node.polled_services.poll(3)]
    while desk.node.polled_services.served < len(futures) + len(read):
        served.append(desk.node.polled_services.poll(3))
    assert max(served) == 3
    assert len(desk.asked) == len(futures)
    desk.spin(futures + read)
    assert read[0].result().values[0].string_value


def test_a_flood_on_one_service_does_not_keep_another_waiting(desk: _Desk) -> None:
    futures = [desk.call(Trigger, "one", Trigger.Request()) for _ in range(8)]
    futures.append(desk.call(Trigger, "two", Trigger.Request()))
    desk.arrive("one", "two")
    desk.node.polled_services.poll(2)
    assert sorted(desk.asked) == ["one", "two"]
    while len(desk.asked) < len(futures):
        desk.node.polled_services.poll(2)
    desk.spin(futures)


def test_a_malformed_request_is_answered_and_ends_nothing(desk: _Desk) -> None:
    """A type that does not exist raises inside rclpy's own parameter service."""
    wrong = ParameterMessage(name="output", value=ParameterValue(type=200))
    future = desk.call(
        SetParameters, "set_parameters", SetParameters.Request(parameters=[wrong])
    )
    deadline = time.monotonic() + PATIENCE
    while not desk.node.polled_services.poll(1):
        assert time.monotonic() < deadline
    desk.spin([future])
    assert len(future.result().results) == 0
    good = ParameterMessage(
        name="output",
        value=ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="x"),
    )
    future = desk.call(
        SetParameters, "set_parameters", SetParameters.Request(parameters=[good])
    )
    while not desk.node.polled_services.poll(1):
        assert time.monotonic() < deadline
    desk.spin([future])
    assert "fixed while the node runs" in future.result().results[0].reason
