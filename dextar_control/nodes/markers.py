"""The marker node shows the robot live in RViz and Foxglove; nothing on the control
path waits for it.
"""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Mapping

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from visualization_msgs.msg import Marker, MarkerArray

from dextar_control.contract.errors import DextarError
from dextar_control.contract.node_parameters import PARAMETERS
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.topics import JOINT_STATES, MARKERS
from dextar_control.nodekit.node import DextarNode, qos, run_node
from dextar_control.nodekit.scheduling import stand_back
from dextar_control.nodes.newest import NewestSamples
from dextar_control.nodes.scene import Scene, View, to_array, wipe
from dextar_control.symbols.types import Array

STILL_PERIOD = 1.0  # s
DIAGNOSTICS_PERIOD = 1.0  # s


class MarkerNode(DextarNode):
    """Draws the robot for RViz and Foxglove: the newest of what the topics say, at its
    own pace on the steady clock.

    Its readers keep one sample and ask for no repetition; with ``enabled`` false there
    are none.
    """

    NAME = "markers"
    PARAMETERS = PARAMETERS[NAME]

    def __init__(self) -> None:
        super().__init__()
        self._scene = Scene(self.robot)
        self._publisher = self.create_publisher(MarkerArray, MARKERS.name, qos(MARKERS))
        self._newest = NewestSamples(self)
        self._still_at = -np.inf
        self._trail: deque[tuple[float, Array]] = deque()
        self._drawn = 0
        self._complaint = ""
        self._apply(self.values["enabled"])
        self.create_timer(
            1.0 / self.values["rate"], self._draw, clock=self.steady_clock
        )
        self.create_timer(DIAGNOSTICS_PERIOD, self._diagnose, clock=self.steady_clock)
        self.get_logger().info(f"drawing on {self._publisher.topic_name}")

    def on_parameters(self, changes: Mapping[str, ParameterValue]) -> None:
        """Switch the display on or off."""
        if "enabled" in changes:
            self._apply(changes["enabled"])

    def _apply(self, enabled: bool) -> None:
        if enabled and not self._newest:
            self._newest.open()
        elif not enabled and self._newest:
            self._newest.close()
            self._trail.clear()
            self._scene.set_path(None)
            self._publish(wipe())

    def _draw(self) -> None:
        if not self._newest:
            return
        now = time.monotonic()
        try:
            if (taken := self._newest.take()) is not None:
                self._scene.set_path(*taken)
                self._still_at = -np.inf
            view = self._view(now)
        except DextarError as error:
            self._complaint = str(error)
            self.get_logger().warning(self._complaint, throttle_duration_sec=5.0)
            return
        drawing = []
        if now - self._still_at >= STILL_PERIOD:
            self._still_at = now
            drawing += self._scene.still()
        if view is not None:
            drawing += self._scene.moving(
                view, [x for _, x in self._trail], text=self.values["text"]
            )
        if drawing:
            self._publish(drawing)
            self._drawn += 1

    def _view(self, now: float) -> View | None:
        """Return what the samples say; None before the first joint state."""
        view = self._newest.view()
        if view is None:
            return None
        self._complaint = (
            f"no joint states for {now - self._newest.arrival:.1f} s"
            if view.stale
            else ""
        )
        if not view.stale and self.values["trail"] > 0.0:
            self._trail.append((now, self._scene.platform(view)))
        while self._trail and now - self._trail[0][0] > self.values["trail"]:
            self._trail.popleft()
        return view

    def _publish(self, markers: list[Marker]) -> None:
        self._publisher.publish(to_array(markers, self.get_clock().now().to_msg()))

    def _diagnose(self) -> None:
        if not self._newest:
            state = "switched off"
        elif JOINT_STATES.name not in self._newest.seen:
            state = (
                f"no joint states on {self.resolve_topic_name(JOINT_STATES.name)} yet"
            )
        else:
            state = self._complaint or "drawing"
        level = DiagnosticStatus.WARN if self._complaint else DiagnosticStatus.OK
        self.publish_diagnostics(
            level, state, {"drawn": self._drawn, "rate": self.values["rate"]}
        )

    def close(self) -> None:
        """Clear the display."""
        self._publish(wipe())
        self._diagnose()


def main(args: list[str] | None = None) -> int:
    """Draw until a signal, at a priority that does not interrupt what moves the robot;
    return the exit code.
    """
    stand_back()
    return run_node(MarkerNode, args)


if __name__ == "__main__":
    sys.exit(main())
