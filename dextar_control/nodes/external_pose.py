"""External measurements of the end effector are read at the controller without waiting;
a sentence tells why one is refused.
"""

from __future__ import annotations

from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message

from dextar_control.contract.errors import StateError
from dextar_control.contract.topics import EXTERNAL_POSE
from dextar_control.estimation.estimate import ExternalPosition
from dextar_control.nodekit.cdr import NANOSECONDS, from_time
from dextar_control.nodekit.layouts import template
from dextar_control.nodekit.node import DextarNode, qos
from dextar_control.nodes import messages

# measurements that may wait: one is taken with each joint state, the oldest first
DEPTH = 5


class ExternalPoseReader:
    """Reads ``external_pose`` by polling.

    Args:
        node: that subscribes.

    Attributes:
        received, refused: messages so far; a refused one is not in the base frame or
            not finite.
        note: why the last one was refused; empty when it was not.
    """

    def __init__(self, node: DextarNode) -> None:
        profile = qos(EXTERNAL_POSE, reliable=False, depth=DEPTH)
        self._node = node
        self._subscription = node.create_polled_subscription(
            PoseStamped, EXTERNAL_POSE.name, profile, raw=True
        )
        self._take = self._subscription.handle.take_message
        self._template = template(EXTERNAL_POSE)
        self.received = 0
        self.refused = 0
        self.note = ""

    def take(self) -> ExternalPosition | None:
        """Return the oldest measurement that waits; None when there is none or it is
        refused.
        """
        taken = self._take(PoseStamped, True)
        if taken is None:
            return None
        self.received += 1
        try:
            pose = self.read(bytes(taken[0]))
        except StateError as error:
            self.refused += 1
            self.note = str(error)
            return None
        self.note = ""
        return pose

    def read(self, raw: bytes) -> ExternalPosition:
        """Return the measurement in a message's bytes.

        Raises:
            StateError: another frame than base, or a coordinate that is not finite.
        """
        known = self._template.unpack(raw)
        if known is not None:
            stamp, values = known
            return ExternalPosition(
                stamp / NANOSECONDS, messages.finite_position(values[0], values[1])
            )
        message = deserialize_message(raw, PoseStamped)
        position = messages.position_in_base(message)
        self._template.learn(raw)
        return ExternalPosition(from_time(message.header.stamp) / NANOSECONDS, position)

    def close(self) -> None:
        """Destroy the subscription."""
        self._node.destroy_subscription(self._subscription)
