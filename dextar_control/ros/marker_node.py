"""The marker node: shows the robot live in RViz and Foxglove. It reads, and nothing on the control path waits for it."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from dextar_control.contract.cdr import read_message
from dextar_control.contract.errors import DextarError
from dextar_control.contract.node import DextarNode, qos, run_node
from dextar_control.contract.parameters import Parameter
from dextar_control.contract.topics import CONTROLLER_STATE, CRITERION, JOINT_STATES, MARKERS, PLATFORM_NAMES, TRAJECTORY
from dextar_control.ros import messages
from dextar_control.ros.scene import Scene, View, to_array, wipe
from dextar_control.symbols.types import Array

PARAMETERS = (
    Parameter("enabled", "draw; false reads nothing and clears the display", live=True),
    Parameter("rate", "of the drawing", 1.0, 60.0, unit="Hz"),
    Parameter("trail", "how long the way of the end effector stays", 0.0, 60.0, unit="s", live=True),
    Parameter("text", "write phase and scalars below the robot", live=True),
)

STREAMS = {JOINT_STATES.name: JointState, CRITERION.name: JointState, CONTROLLER_STATE.name: JointTrajectory}
STILL_PERIOD = 1.0  # s
DIAGNOSTICS_PERIOD = 1.0  # s
STALE_AFTER = 1.0  # s on the steady clock without a joint state
UNKNOWN = np.full(2, np.nan)


class MarkerNode(DextarNode):
    """Draws the robot for RViz and Foxglove: the newest of what the topics say, at its own pace on the steady clock.

    Its readers keep one sample and ask for no repetition; with ``enabled`` false there are none.
    """

    NAME = "markers"
    PARAMETERS = PARAMETERS

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._scene = Scene(self.robot)
        self._publisher = self.create_publisher(MarkerArray, MARKERS.name, qos(MARKERS))
        self._readers: dict[str, Any] = {}
        self._seen: dict[str, Any] = {}
        self._arrival = -np.inf
        self._still_at = -np.inf
        self._trail: deque[tuple[float, Array]] = deque()
        self._drawn = 0
        self._complaint = ""
        self._apply(self.values["enabled"])
        self.create_timer(1.0 / self.values["rate"], self._draw, clock=self.steady_clock)
        self.create_timer(DIAGNOSTICS_PERIOD, self._diagnose, clock=self.steady_clock)
        self.get_logger().info(f"drawing on {self._publisher.topic_name}")

    def on_parameters(self, changes: Mapping[str, Any]) -> None:
        """Switch the display on or off."""
        if "enabled" in changes:
            self._apply(changes["enabled"])

    def _apply(self, enabled: bool) -> None:
        if enabled and not self._readers:
            newest = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.BEST_EFFORT,
                                durability=DurabilityPolicy.VOLATILE)  # fmt: skip
            for name, kind in STREAMS.items():
                self._readers[name] = self.create_polled_subscription(kind, name, newest)
            self._readers[TRAJECTORY.name] = self.create_polled_subscription(
                MultiDOFJointTrajectory, TRAJECTORY.name, qos(TRAJECTORY), raw=True
            )
        elif not enabled and self._readers:
            for reader in self._readers.values():
                self.destroy_subscription(reader)
            self._readers.clear()
            self._seen.clear()
            self._trail.clear()
            self._scene.set_path(None)
            self._publish(wipe())

    def _draw(self) -> None:
        if not self._readers:
            return
        now = time.monotonic()
        try:
            self._take(now)
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
            drawing += self._scene.moving(view, [x for _, x in self._trail], text=self.values["text"])
        if drawing:
            self._publish(drawing)
            self._drawn += 1

    def _take(self, now: float) -> None:
        """The newest sample of each topic."""
        for name, kind in STREAMS.items():
            taken = _newest(self._readers[name], kind, raw=False)
            if taken is not None:
                self._seen[name] = taken
                if name == JOINT_STATES.name:
                    self._arrival = now
        raw = _newest(self._readers[TRAJECTORY.name], MultiDOFJointTrajectory, raw=True)
        if raw is not None:
            message = read_message(bytes(raw), TRAJECTORY.type)
            self._scene.set_path(messages.to_trajectory(message) if len(message.points) else None)
            self._still_at = -np.inf

    def _view(self, now: float) -> View | None:
        """What the samples say; None before the first joint state."""
        joints = self._seen.get(JOINT_STATES.name)
        if joints is None:
            return None
        q_a = messages.active_joints(joints) - self.robot.encoder_offset
        criterion = self._seen.get(CRITERION.name)
        scalars = {} if criterion is None else dict(zip(criterion.name, criterion.position, strict=False))
        points = getattr(self._seen.get(CONTROLLER_STATE.name), "points", ())
        x_ref, x_hat = (_position(points, row) for row in (0, 1))
        stale = now - self._arrival > STALE_AFTER
        self._complaint = f"no joint states for {now - self._arrival:.1f} s" if stale else ""
        view = View(q_a, x_hat, x_ref, scalars, stale)
        if not stale and self.values["trail"] > 0.0:
            self._trail.append((now, self._scene.platform(view)))
        while self._trail and now - self._trail[0][0] > self.values["trail"]:
            self._trail.popleft()
        return view

    def _publish(self, markers: list[Any]) -> None:
        self._publisher.publish(to_array(markers, self.get_clock().now().to_msg()))

    def _diagnose(self) -> None:
        if not self._readers:
            state = "switched off"
        elif JOINT_STATES.name not in self._seen:
            state = f"no joint states on {self.resolve_topic_name(JOINT_STATES.name)} yet"
        else:
            state = self._complaint or "drawing"
        level = DiagnosticStatus.WARN if self._complaint else DiagnosticStatus.OK
        self.publish_diagnostics(level, state, {"drawn": self._drawn, "rate": self.values["rate"]})

    def close(self) -> None:
        """Clear the display."""
        self._publish(wipe())
        self._diagnose()


def _newest(reader: Any, kind: Any, *, raw: bool) -> Any:
    newest = None
    while (taken := reader.handle.take_message(kind, raw)) is not None:
        newest = taken[0]
    return newest


def _position(points: Any, row: int) -> Array:
    if len(points) <= row or len(points[row].positions) != len(PLATFORM_NAMES):
        return UNKNOWN
    return np.array(points[row].positions)


def main(args: list[str] | None = None) -> int:
    """Console entry."""
    return run_node(MarkerNode, args)


if __name__ == "__main__":
    sys.exit(main())
