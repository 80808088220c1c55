"""The report has these lines."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum


class Result(Enum):
    """What is said of one requirement."""

    PASS = "PASS"
    FAIL = "FAIL"
    SKIP = "SKIP"
    NOTE = "NOTE"


@dataclass(frozen=True)
class CheckLine:
    """One requirement and what was found.

    Attributes:
        name: of the requirement, one of ``LINES``.
        result: whether it is met; SKIP where it could not be tried, NOTE where it is
            not met and the controller does without.
        measured: in words, with unit.
        limit: in words, with unit.
        numbers: the measured ones, SI units, for machines.
    """

    name: str
    result: Result
    measured: str
    limit: str = ""
    numbers: dict[str, float] = field(default_factory=dict)


# Every line of a report, in this order, and what it asks for.
LINES = {
    "topics": "states have one publisher, commands a subscriber",
    "types": "of both topics",
    "QoS": (
        "states can be read, reliably too; commands are received from a reliable,"
        " volatile publisher"
    ),
    "only commander": "nobody else publishes commands",
    "states": "a stream of new states, in real time",
    "joint names": (
        "q11 and q21 in each state, each once, in any order, beside other joints or not"
    ),
    "array sizes": "as many positions as names; velocities and efforts too, or none",
    "finite numbers": "the positions of q11 and q21 are neither NaN nor infinite",
    "rate": "mean, by arrival",
    "jitter": (
        "99th percentile of how far an interval between arrivals is from the period"
    ),
    "longest gap": "between two arrivals, and between their stamps",
    "stamps rise": "from each state to the next",
    "stamp age": "median at arrival, against the system clock",
    "stamp period": "the same as that of the arrivals",
    "closes": "the distal links can meet at the measured angles",
    "mode and range": (
        "the measured angles are those of the robot's working mode, and in the joints'"
        " ranges"
    ),
    "velocity": "the integral of the velocity is the change of position",
    "effort feedback": "of both motors, in each state",
    "response q11": (
        "effort follows a small torque and the joint moves its way, both signs"
    ),
    "response q21": (
        "effort follows a small torque and the joint moves its way, both signs"
    ),
    "watchdog": "commands stop, the torque goes within the declared time",
    "refuses NaN": "a NaN command changes nothing, and the driver goes on",
}

# The lines that need torque on the robot.
TORQUE_LINES = ("response q11", "response q21", "watchdog", "refuses NaN")


def passed(name: str, measured: str, limit: str = "", **numbers: float) -> CheckLine:
    """Return the line of a requirement that is met."""
    return CheckLine(name, Result.PASS, measured, limit, numbers)


def failed(name: str, measured: str, limit: str = "", **numbers: float) -> CheckLine:
    """Return the line of a requirement that is not met."""
    return CheckLine(name, Result.FAIL, measured, limit, numbers)


def skipped(name: str, reason: str) -> CheckLine:
    """Return the line of a requirement that could not be tried, and why."""
    return CheckLine(name, Result.SKIP, reason)


def noted(name: str, measured: str, limit: str = "", **numbers: float) -> CheckLine:
    """Return the line of a requirement that is not met, though the controller does
    without.
    """
    return CheckLine(name, Result.NOTE, measured, limit, numbers)


def judged(
    ok: bool, name: str, measured: str, limit: str = "", **numbers: float
) -> CheckLine:
    """Return a line that passed or failed."""
    return CheckLine(name, Result.PASS if ok else Result.FAIL, measured, limit, numbers)


def has_failed(lines: Iterable[CheckLine]) -> bool:
    """Return whether any line failed."""
    return any(line.result is Result.FAIL for line in lines)


def in_order(lines: Iterable[CheckLine]) -> list[CheckLine]:
    """Return the lines in the order of ``LINES``."""
    order = list(LINES)
    return sorted(lines, key=lambda line: order.index(line.name))
