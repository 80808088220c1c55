"""The controller with two faults of its own: it answers a state that it cannot use with
a torque, and says nothing of it.
"""

from __future__ import annotations

import sys
from typing import Any

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from dextar_control.nodekit.cdr import from_time
from dextar_control.nodekit.node import run_node
from dextar_control.nodes.controller import ControllerNode, spin


class BadController(ControllerNode):
    """Neither counts nor faults."""

    def _on_state(self, raw: bytes) -> None:
        self._raw = raw
        super()._on_state(raw)

    def _refuse(self, loop: Any, error: Exception) -> None:
        stamp = from_time(deserialize_message(self._raw, JointState).header.stamp)
        self._outputs.command(stamp, [0.05, -0.05])


if __name__ == "__main__":
    sys.exit(run_node(BadController, spin=spin))
