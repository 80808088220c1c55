"""QoS profiles are written as rosbag2 (version 9) writes them."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.qos import QoSProfile

INFINITE = {"sec": 9223372036, "nsec": 854775807}


def describe(profile: QoSProfile) -> dict[str, object]:
    """Return the profile as the mapping that stands in a bag's
    ``offered_qos_profiles``.
    """
    return {
        "history": profile.history.name.lower(),
        "depth": profile.depth,
        "reliability": profile.reliability.name.lower(),
        "durability": profile.durability.name.lower(),
        "deadline": _duration(profile.deadline),
        "lifespan": _duration(profile.lifespan),
        "liveliness": profile.liveliness.name.lower(),
        "liveliness_lease_duration": _duration(profile.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
    }


def _duration(duration: Duration) -> dict[str, int]:
    """Return a duration as rosbag2 writes it; 0, which means "not set" to rclpy, is
    infinite.
    """
    total = duration.nanoseconds
    if total <= 0 or total >= INFINITE["sec"] * 10**9 + INFINITE["nsec"]:
        return dict(INFINITE)
    return {"sec": total // 10**9, "nsec": total % 10**9}
