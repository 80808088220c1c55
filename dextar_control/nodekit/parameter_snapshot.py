"""A node can ask for the parameters of other nodes without ever waiting."""

from __future__ import annotations

from collections.abc import Iterable

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.task import Future

from dextar_control.contract.plain_data import ParameterValue

GIVE_UP_AFTER = 100  # asks without an answer before a request is made anew


class ParameterSnapshot:
    """All parameters of one node, asked for by its standard services; call ``ask`` now
    and then until ``values`` is there.

    Args:
        node: that asks.
        target: name of the node asked, relative to the asking node's namespace.

    Attributes:
        values: by name; None while they are not known.
    """

    def __init__(self, node: Node, target: str) -> None:
        self.target = target
        self.values: dict[str, ParameterValue] | None = None
        self._node = node
        self._list = node.create_client(ListParameters, f"{target}/list_parameters")
        self._get = node.create_client(GetParameters, f"{target}/get_parameters")
        self._age = 0

    def ask(self) -> None:
        """Send the next request that can be sent."""
        if self.values is not None:
            return
        if self._age:
            self._age = (self._age + 1) % (GIVE_UP_AFTER + 1)
            return
        if self._list.service_is_ready() and self._get.service_is_ready():
            self._age = 1
            self._list.call_async(ListParameters.Request()).add_done_callback(
                self._on_names
            )

    def renew(self) -> None:
        """Forget the values, to ask again."""
        self.values = None
        self._age = 0

    def _on_names(self, future: Future) -> None:
        names = sorted(future.result().result.names)
        request = GetParameters.Request(names=names)
        self._get.call_async(request).add_done_callback(
            lambda answer: self._on_values(names, answer)
        )

    def _on_values(self, names: list[str], future: Future) -> None:
        values = future.result().values
        if len(values) == len(names):
            self.values = dict(
                zip(names, map(parameter_value_to_python, values), strict=True)
            )


def unanswered(snapshots: Iterable[ParameterSnapshot]) -> list[str]:
    """Return the names of the nodes whose parameters are not known."""
    return [snapshot.target for snapshot in snapshots if snapshot.values is None]
