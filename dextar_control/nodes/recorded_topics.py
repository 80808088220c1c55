"""Each recorded topic has its reader and its count of losses."""

from __future__ import annotations

import importlib
from collections import deque

from rclpy.qos import QoSProfile, ReliabilityPolicy

from dextar_control.bags.mcap_file import SerializedMessage
from dextar_control.bags.message_definitions import definition, type_hash
from dextar_control.contract.topics import Topic
from dextar_control.nodekit.loss_count import LossCount
from dextar_control.nodekit.node import DextarNode, Take, qos

HISTORY = 10000  # samples each reader holds between two polls: 10 s at 1 kHz
# Hz; a slower topic is always asked for reliably, which costs nothing there.
SLOW = 100.0

PARAMETER_EVENTS = Topic(
    "/parameter_events",
    "rcl_interfaces/msg/ParameterEvent",
    "all nodes",
    "It tells of live parameter changes.",
    HISTORY,
    rate=0.0,
)
ALONGSIDE = (
    PARAMETER_EVENTS,
    Topic(
        "/rosout",
        "rcl_interfaces/msg/Log",
        "all nodes",
        "It tells what the nodes log.",
        HISTORY,
        latched=True,
        rate=0.0,
    ),
)
"""The topics that are recorded beside those of the contract."""


class RecordedTopic:
    """One recorded topic.

    Args:
        node: that subscribes, by polling.
        topic: name, type and whether it is latched.
        profile: of the subscription.

    Attributes:
        name: in full.
        kept: the last sample of a topic that says its state once, so that a later
            recording has it too.

    Raises:
        BagError: no definition of the type is installed.
    """

    def __init__(
        self,
        node: DextarNode,
        topic: Topic,
        profile: QoSProfile,
    ) -> None:
        definition(topic.type), type_hash(topic.type)
        package, _, short = topic.type.split("/")
        message_type = getattr(importlib.import_module(f"{package}.msg"), short)
        subscription = node.create_polled_subscription(
            message_type, topic.name, profile, raw=True
        )
        self.topic = topic
        self.name: str = subscription.topic_name
        self.type = topic.type
        self.message_type = message_type
        self.losses = LossCount(lambda: node.count_publishers(self.name))
        self.take: Take = subscription.handle.take_message
        self.kept: deque[SerializedMessage] | None = (
            deque(maxlen=1) if topic.latched and profile.depth == 1 else None
        )


def profile_of(topic: Topic, reliable: bool) -> QoSProfile:
    """Return how a topic is read: latched ones as they are offered, streams with a long
    history.
    """
    one = topic.latched and topic.depth == 1
    return qos(
        topic,
        reliable=reliable or topic.latched or topic.rate < SLOW,
        depth=1 if one else HISTORY,
    )


def found_topic(
    name: str, type_name: str, offered: list[QoSProfile]
) -> tuple[Topic, QoSProfile]:
    """Return a topic that was found, and a profile that matches all its publishers."""
    reliable = all(
        profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered
    )
    latched = bool(offered) and all(
        profile.durability.name == "TRANSIENT_LOCAL" for profile in offered
    )
    topic = Topic(name, type_name, "", "", HISTORY, latched, 0.0)
    return topic, qos(topic, reliable=reliable, depth=HISTORY)
