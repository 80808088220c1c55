"""The lines of the report."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum


class Result(Enum):
    """Of one line."""

    PASS = "PASS"
    FAIL = "FAIL"
    SKIP = "SKIP"


@dataclass(frozen=True)
class Line:
    """One requirement and what was found.

    Attributes:
        name: of the requirement, one of ``LINES``.
        result: whether it is met; SKIP where it could not be tried.
        measured: in words, with unit.
        limit: in words, with unit.
        numbers: the measured ones, SI units, for machines.
    """

    name: str
    result: Result
    measured: str
    limit: str = ""
    numbers: dict[str, float] = field(default_factory=dict)


LINES = {
    "topics": "states have one publisher, commands a subscriber",
    "types": "of both topics",
    "QoS": "states are offered reliably, commands are received from a reliable, volatile publisher",
    "only commander": "nobody else publishes commands",
    "states": "a stream of new states, in real time",
    "joint names": "q11 and q21, each once, in any order",
    "array sizes": "as many positions as names; velocities and efforts too, or none",
    "finite numbers": "no NaN, no infinity",
    "rate": "mean, by arrival",
    "jitter": "99th percentile of how far an interval between arrivals is from the period",
    "longest gap": "between two arrivals",
    "stamps rise": "strictly",
    "stamp age": "median at arrival, against the system clock",
    "stamp period": "the same as that of the arrivals",
    "closes": "the distal links can meet at the measured angles",
    "velocity": "the integral of the velocity is the change of position",
    "effort feedback": "of both motors, in each state",
    "response q11": "effort follows a small torque and the joint moves its way, both signs",
    "response q21": "effort follows a small torque and the joint moves its way, both signs",
    "watchdog": "commands stop, the torque goes within the declared time",
    "refuses NaN": "a NaN command changes nothing, and the driver goes on",
}
"""Every line of a report, in this order, and what it asks for."""

TORQUE_LINES = ("response q11", "response q21", "watchdog", "refuses NaN")
"""Those that need torque on the robot."""


def passed(name: str, measured: str, limit: str = "", **numbers: float) -> Line:
    """The requirement is met."""
    return Line(name, Result.PASS, measured, limit, numbers)


def failed(name: str, measured: str, limit: str = "", **numbers: float) -> Line:
    """The requirement is not met."""
    return Line(name, Result.FAIL, measured, limit, numbers)


def skipped(name: str, reason: str) -> Line:
    """The requirement could not be tried, and why."""
    return Line(name, Result.SKIP, reason)


def judged(ok: bool, name: str, measured: str, limit: str = "", **numbers: float) -> Line:
    """PASS or FAIL."""
    return Line(name, Result.PASS if ok else Result.FAIL, measured, limit, numbers)


def has_failed(lines: Iterable[Line]) -> bool:
    """Whether any line failed."""
    return any(line.result is Result.FAIL for line in lines)


def in_order(lines: Iterable[Line]) -> list[Line]:
    """Sorted as in ``LINES``."""
    order = list(LINES)
    return sorted(lines, key=lambda line: order.index(line.name))
