"""A command has a node of its own for as long as it asks others."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TypeVar

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from dextar_control.contract.errors import DextarError, ParameterError
from dextar_control.contract.signals import StopSignal

C = TypeVar("C", bound=Node)


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
            rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
            node = make(stop)
        except DextarError:
            raise
        except Exception as error:  # rcl raises its own types for bad names
            text = " ".join(str(error).replace("^", "").split())
            raise ParameterError(text) from error
        ending.callback(node.destroy_node)
        yield node, stop
