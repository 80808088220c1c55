"""A page says why a robot has no torque and what mends that, and how near its watches
are to their limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypedDict

GREATER = ("locus",)  # watches whose value is to stay above the limit
SILENT = 2.0  # s without a joint state that are told
WITH_TORQUE = ("APPROACH", "HOLD", "TRACK", "CROSSING")


class ShownMargin(TypedDict):
    """How near a watch is to its limit: value and limit as told, and the share used."""

    name: str
    value: str
    limit: str
    unit: str
    used: float  # 0 to 1


def trouble_and_remedy(
    namespace: str,
    told: Mapping[str, str],
    nodes: Mapping[str, object],
    listening: bool = False,
) -> tuple[str, str]:
    """Return why there is no torque, or none that follows the robot, and the panel's
    command that mends it; else empty texts.

    Args:
        namespace: of the robot.
        told: by the controller lately; empty where it is silent.
        nodes: that have told of themselves lately.
        listening: the panel began to listen so lately that nobody may have spoken yet.
    """
    if not told and listening:
        return (
            "The panel has just begun to listen: nodes tell of themselves each second.",
            "",
        )
    if not told:
        others = ", ".join(sorted(set(nodes) - {"panel"}))
        robot = f" in {namespace}" if namespace.strip("/") else ""
        heard = f"; heard of: {others}" if others else ""
        why = f"No controller is heard of{robot}{heard}"
        return f"{why}. Start it: this page goes on by itself.", ""
    lifecycle, phase, reason = (
        told.get(key, "") for key in ("lifecycle", "phase", "reason")
    )
    if lifecycle != "active":
        return (
            f"The controller is {lifecycle}: it answers no joint state.",
            "activate" if lifecycle != "finalized" else "",
        )
    if phase in WITH_TORQUE:
        age = float(told.get("state_age", "nan"))
        silent = (
            f"No joint state has come for {age:.0f} s: the plant or the driver is"
            " paused or has ended. See that it runs."
        )
        return silent if age > SILENT else "", ""
    because = f": {reason}" if reason else ""
    if phase == "SAFE_STOP" and told.get("stopped") != "True":
        return f"The robot is being brought to rest{because}.", ""
    if phase in ("SAFE_STOP", "FAULT"):
        what = phase.capitalize().replace("_", " ")
        return (
            f"{what}{because}. The torque is gone until it is reset and enabled.",
            "reset",
        )
    if told.get("enabling") == "waiting":
        trouble = told.get("last_trouble", "")
        last = f" (last trouble: {trouble})" if trouble else ""
        return (
            "The controller waits for joint states to be healthy,"
            f" {told.get('healthy', '0')} s so far{last}; it gives torque by itself"
            " then."
        ), ""
    if told.get("enabling", "").startswith("refused"):
        return f"Torque was {told['enabling']}.", "enable"
    return f"The torque is switched off{because}.", "enable"


def shown_margins(
    told: Mapping[str, str], units: Mapping[str, str]
) -> list[ShownMargin]:
    """Return the margin of each watch that the controller tells, the smallest first.

    Args:
        told: by the controller.
        units: of the watches, by their names.
    """
    rows: list[ShownMargin] = []
    for key, text in told.items():
        if not key.startswith("watch_"):
            continue
        value, _, limit = text.partition(" of ")
        name = key.removeprefix("watch_")
        rows.append(
            {
                "name": name,
                "value": value,
                "limit": limit,
                "unit": units.get(name, ""),
                "used": _used(name, value, limit),
            }
        )
    return sorted(rows, key=lambda row: -row["used"])


def _used(name: str, value: str, limit: str) -> float:
    try:
        number, bound = float(value), float(limit)
    except ValueError:
        return 0.0
    share = (
        bound / number
        if name in GREATER and number > 0.0
        else number / bound
        if bound > 0.0
        else float(number > 0.0)
    )
    return min(max(share, 0.0), 1.0) if share == share else 1.0
