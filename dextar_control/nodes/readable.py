"""controller_state and criterion can be published in messages of ``dextar_interfaces``
too, where each number has a name.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Protocol

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.topics import (
    INTERFACES,
    READABLE_CRITERION,
    READABLE_STATE,
    WITHOUT_INTERFACES,
)
from dextar_control.nodekit.cdr import to_duration, to_time
from dextar_control.nodekit.node import DextarNode, qos


class _Message(Protocol):
    def get_fields_and_field_types(self) -> dict[str, str]: ...


class Readable:
    """Publishes state and criterion in messages of ``dextar_interfaces``.

    Attributes:
        publishers: of the state and of the criterion.

    Raises:
        ParameterError: the package is not installed.
    """

    def __init__(self, node: DextarNode) -> None:
        try:
            types = importlib.import_module(f"{INTERFACES}.msg")
        except ImportError as error:
            raise ParameterError(
                f"publish.readable = true: {WITHOUT_INTERFACES}, or leave it false"
            ) from error
        self._messages = types.ControllerState(), types.Criterion()
        self.publishers = [
            node.create_publisher(type(message), topic.name, qos(topic))
            for message, topic in zip(
                self._messages, (READABLE_STATE, READABLE_CRITERION), strict=True
            )
        ]

    def publish(
        self,
        stamp: int,
        state: Sequence[float],
        reference_time: int,
        criterion: Sequence[float],
    ) -> None:
        """Publish what controller_state and criterion tell.

        Args:
            stamp: of the state that was answered, ns.
            state: as ``nodekit.layouts.template`` of controller_state takes them.
            reference_time: since the trajectory's start, ns.
            criterion: in the order of CRITERION_NAMES.
        """
        self._messages[0].reference_time = to_duration(reference_time)
        for publisher, message, values in zip(
            self.publishers, self._messages, (state, criterion), strict=True
        ):
            message.header.stamp = to_time(stamp)
            fill(message, values)
            publisher.publish(message)


def fill(message: _Message, values: Sequence[float]) -> None:
    """Put numbers into a message's fields in their order; a field of two takes two."""
    left = iter(values)
    for name, kind in message.get_fields_and_field_types().items():
        if kind == "double":
            setattr(message, name, next(left))
        elif kind == "double[2]":
            setattr(message, name, [next(left), next(left)])
        elif kind in ("int8", "uint8"):
            setattr(message, name, int(next(left)))
