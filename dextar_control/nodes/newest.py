"""Nodes that show the robot keep the newest sample of its topics and take it at a pace
of their own: nothing on the control path waits for it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import (
    JointTrajectory,
    JointTrajectoryPoint,
    MultiDOFJointTrajectory,
)

from dextar_control.contract.topics import (
    CONTROLLER_STATE,
    CRITERION,
    JOINT_STATES,
    PLATFORM_NAMES,
    TRAJECTORY,
)
from dextar_control.nodekit.cdr import read_message
from dextar_control.nodekit.node import DextarNode, qos
from dextar_control.nodes import messages
from dextar_control.nodes.scene import View
from dextar_control.planning.trajectory import Trajectory
from dextar_control.symbols.types import Array

STREAMS = {
    JOINT_STATES.name: JointState,
    CRITERION.name: JointState,
    CONTROLLER_STATE.name: JointTrajectory,
}
STALE_AFTER = 1.0  # s on the steady clock without a joint state
UNKNOWN = np.full(2, np.nan)


class NewestSamples:
    """Readers that keep one sample and ask for no repetition; there are none while it
    is closed.

    Args:
        node: that shows it.

    Attributes:
        seen: the last message of each topic, by name.
        arrival: of the last joint state, s on the steady clock.
    """

    def __init__(self, node: DextarNode) -> None:
        self._node = node
        self._readers: dict[str, Subscription] = {}
        self.seen: dict[str, JointState | JointTrajectory] = {}
        self.arrival = -np.inf

    def __bool__(self) -> bool:
        return bool(self._readers)

    def open(self) -> None:
        """Begin to read."""
        newest = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=1,
            reliability=ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.VOLATILE,
        )
        for name, kind in STREAMS.items():
            self._readers[name] = self._node.create_polled_subscription(
                kind, name, newest
            )
        self._readers[TRAJECTORY.name] = self._node.create_polled_subscription(
            MultiDOFJointTrajectory, TRAJECTORY.name, qos(TRAJECTORY), raw=True
        )

    def close(self) -> None:
        """Stop reading, and forget all samples."""
        for reader in self._readers.values():
            self._node.destroy_subscription(reader)
        self._readers.clear()
        self.seen.clear()

    def take(self) -> tuple[Trajectory | None] | None:
        """Keep the newest sample of each topic in ``seen``.

        Returns:
            The trajectory that has come, or None for a stop, in a tuple; None where
            nothing has come.

        Raises:
            TrajectoryError: that trajectory is none.
        """
        for name, kind in STREAMS.items():
            taken = self._last(name, kind, raw=False)
            if taken is not None:
                self.seen[name] = taken
                if name == JOINT_STATES.name:
                    self.arrival = time.monotonic()
        raw = self._last(TRAJECTORY.name, MultiDOFJointTrajectory, raw=True)
        return None if raw is None else (_trajectory(bytes(raw)),)

    def _last(
        self, name: str, kind: type[object], *, raw: bool
    ) -> JointState | JointTrajectory | bytes | None:
        newest = None
        while (taken := self._readers[name].handle.take_message(kind, raw)) is not None:
            newest = taken[0]
        return newest

    def view(self) -> View | None:
        """Return what the samples say of the robot; None before the first joint state.

        Raises:
            StateError: a joint state cannot be used.
        """
        joints = self.seen.get(JOINT_STATES.name)
        if joints is None:
            return None
        criterion = self.seen.get(CRITERION.name)
        scalars = (
            {}
            if criterion is None
            else dict(zip(criterion.name, criterion.position, strict=False))
        )
        points = getattr(self.seen.get(CONTROLLER_STATE.name), "points", ())
        x_ref, x_hat = (_position(points, row) for row in (0, 1))
        q_a = messages.active_joints(joints) - self._node.robot.encoder_offset
        return View(
            q_a, x_hat, x_ref, scalars, time.monotonic() - self.arrival > STALE_AFTER
        )


def _trajectory(raw: bytes) -> Trajectory | None:
    message: MultiDOFJointTrajectory = read_message(raw, TRAJECTORY.type)
    return messages.to_trajectory(message) if len(message.points) else None


def _position(points: Sequence[JointTrajectoryPoint], row: int) -> Array:
    if len(points) <= row or len(points[row].positions) != len(PLATFORM_NAMES):
        return UNKNOWN
    return np.array(points[row].positions)
