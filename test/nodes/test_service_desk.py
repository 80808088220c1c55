"""Services that no executor serves, over real DDS: how many are served, in which order,
and what a broken call does.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
from patience import PATIENCE
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from std_srvs.srv import Trigger
from unserved import Unserved

from dextar_control.contract.node_parameters import RECORDER
from dextar_control.nodekit.node import DextarNode


class _Unserved(DextarNode):
    NAME, PARAMETERS, ROBOT = "recorder", RECORDER, False


class _Desk(Unserved):
    """A node with two services of its own, which the executor has too.

    Attributes:
        asked: which of the two were called, in order.
    """

    def __init__(self) -> None:
        super().__init__(lambda: _Unserved(served=False))
        self.asked: list[str] = []
        for name in ("one", "two"):
            self.node.create_service(
                Trigger,
                f"~/{name}",
                lambda _, response, name=name: self._on_call(name, response),
            )
        self.executor.add_node(self.node)

    def _on_call(self, name: str, response: Any) -> Any:
        self.asked.append(name)
        return response

    def poll(self) -> None:
        """Have the node serve one request, as soon as there is one."""
        deadline = time.monotonic() + PATIENCE
        while not self.node.polled_services.poll(1):
            assert time.monotonic() < deadline


@pytest.fixture
def desk() -> Iterator[_Desk]:
    desk = _Desk()
    yield desk
    desk.close()


def test_an_executor_serves_none_and_a_poll_at_most_its_limit(desk: _Desk) -> None:
    futures = [desk.call(Trigger, "one") for _ in range(8)]
    read = [
        desk.call(GetParameters, "get_parameters", names=["output"]) for _ in range(8)
    ]
    desk.arrive("one", "get_parameters")
    for _ in range(20):
        desk.executor.spin_once(timeout_sec=0.01)
    assert not desk.asked
    served = [desk.node.polled_services.poll(3)]
    while desk.node.polled_services.served < len(futures) + len(read):
        served.append(desk.node.polled_services.poll(3))
    assert max(served) == 3
    assert len(desk.asked) == len(futures)
    desk.finish(*futures, *read)
    assert read[0].result().values[0].string_value


def test_a_flood_on_one_service_does_not_keep_another_waiting(desk: _Desk) -> None:
    futures = [desk.call(Trigger, "one") for _ in range(8)]
    futures.append(desk.call(Trigger, "two"))
    desk.arrive("one", "two")
    desk.node.polled_services.poll(2)
    assert sorted(desk.asked) == ["one", "two"]
    while len(desk.asked) < len(futures):
        desk.node.polled_services.poll(2)
    desk.finish(*futures)


def test_a_malformed_request_is_answered_and_ends_nothing(desk: _Desk) -> None:
    """A type that does not exist raises inside rclpy's own parameter service."""
    wrong = ParameterMessage(name="output", value=ParameterValue(type=200))
    future = desk.call(SetParameters, "set_parameters", parameters=[wrong])
    desk.poll()
    assert len(desk.finish(future).results) == 0
    good = ParameterMessage(
        name="output",
        value=ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="x"),
    )
    future = desk.call(SetParameters, "set_parameters", parameters=[good])
    desk.poll()
    assert "fixed while the node runs" in desk.finish(future).results[0].reason
