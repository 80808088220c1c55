"""Judge what became of a faulted crossing, and what must never happen, by the robot's
truth and the topics at the rig.

Nothing here asks the controller: the torque is the one the drives applied, the side of
the locus that of the true joints, and when a commander was last heard is read from its
commands. Stamps are ns, torques N m.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from dextar_control.contract.robot import RobotParameters
from dextar_control.experiments.faults.events import Checks
from dextar_control.symbols.types import Array

Stamps = NDArray[np.int64]

DEAD_AFTER = 0.1  # s without a usable command from which on there must be no torque
NO_TORQUE = 1e-9  # N m
ROUNDING = 1e-9  # of a torque limit that went through a message
NANOSECONDS = 1e9


class Outcome(str, Enum):
    """What became of one faulted crossing."""

    # the true robot is on the planned side, and the controller goes on
    CROSSED = "crossed"
    # what was asked for was refused, and the robot crossed all the same
    REFUSED = "refused, crossed"
    SAFE_STOP = "safe stop"
    FAULT = "fault"
    NO_TORQUE = "no torque"  # the commander is gone, and the robot without torque
    # the true robot is not on the planned side, and the controller goes on: never
    # expected
    MISSED = "missed"
    # the machine itself stopped the rig's states for longer than the controller allows
    DISTURBED = "disturbed"

    def __str__(self) -> str:
        return self.value


class Check(str, Enum):
    """What must never happen."""

    TORQUE_AFTER_DEATH = "torque 100 ms after the commander died"
    TORQUE_LIMIT = "torque beyond the limit"
    NOT_FINITE = "command from a non-finite number"
    UNREPORTED = "fault not reported"
    BAG = "bag not readable up to its last complete chunk"

    def __str__(self) -> str:
        return self.value


@dataclass
class Tally:
    """Counts how often each check was made, and where it failed."""

    looked: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys((check.value for check in Check), 0)
    )
    violations: list[tuple[str, str]] = field(default_factory=list)

    def count(self, check: Check, looked: int, violations: Iterable[str]) -> None:
        """Take the result of one check."""
        self.looked[check.value] += looked
        self.violations += [(check.value, text) for text in violations]

    def told(self, case: str) -> Checks:
        """Return the event that tells of it; the case is empty at a session's end."""
        return Checks(
            event="checks", case=case, looked=self.looked, violations=self.violations
        )


@dataclass(frozen=True)
class Evidence:
    """What was seen on the rig's topics during one trip.

    Attributes:
        stamps: of the true states, ns, shape (n,).
        joints: true q11, q12, q21, q22, rad, shape (n, 4).
        torque: applied in the period before each state, N m, shape (n, 2).
        command_stamps: of the commands that reached the rig, ns, shape (m,).
        command_torque: N m, shape (m, 2).
        period: between two states, ns.
    """

    stamps: Stamps
    joints: Array
    torque: Array
    command_stamps: Stamps
    command_torque: Array
    period: int


def true_side(joints: Array) -> Array:
    """Return the assembly mode, (n,), the sign of r_1 x r_2 with r_i along distal link
    i, of joints, (n, 4), rad.
    """
    return np.sign(
        np.sin((joints[:, 2] + joints[:, 3]) - (joints[:, 0] + joints[:, 1]))
    )


def true_position(robot: RobotParameters, joints: Array) -> Array:
    """Return the end effector, (n, 2), m, of joints, (n, 4), rad, along the left
    leg.
    """
    first, second = joints[:, 0], joints[:, 0] + joints[:, 1]
    near, far = robot.left.proximal_length, robot.left.distal_length
    reached = near * np.column_stack(
        [np.cos(first), np.sin(first)]
    ) + far * np.column_stack([np.cos(second), np.sin(second)])
    return reached + robot.left.axis


def largest_torque(evidence: Evidence) -> float:
    """Return the largest applied torque, N m; 0 without states."""
    return float(np.abs(evidence.torque).max(initial=0.0))


def torque_after_death(
    evidence: Evidence, dead_after: float = DEAD_AFTER
) -> tuple[int, list[str]]:
    """Find torque that acts although no usable command answers a state of the last
    ``dead_after`` seconds.

    Returns:
        How many states had no such command, and a line for each span of them with
        torque.
    """
    usable = np.sort(
        evidence.command_stamps[np.isfinite(evidence.command_torque).all(axis=1)]
    )
    place = np.searchsorted(usable, evidence.stamps, side="right") - 1
    newest = np.where(place >= 0, usable[place] if len(usable) else 0, -(2**62))
    # when the torque of this state began to act
    age = evidence.stamps - evidence.period - newest
    dead = age >= dead_after * NANOSECONDS
    bad = dead & (np.abs(evidence.torque).max(axis=1, initial=0.0) > NO_TORQUE)
    lines = [
        f"{np.abs(evidence.torque[first:last]).max():.3g} N m at"
        f" {evidence.stamps[first]} ns, "
        + (
            f"{age[first] / NANOSECONDS:.3f} s after the last command"
            if place[first] >= 0
            else "without any command"
        )
        for first, last in _spans(bad)
    ]
    return int(dead.sum()), lines


def torque_beyond(evidence: Evidence, limit: float) -> tuple[int, list[str]]:
    """Find applied torque beyond the limit, N m, or not a number; return how many
    states were looked at, and a line for each span.
    """
    size = np.abs(evidence.torque).max(axis=1, initial=0.0)
    bad = ~(size <= limit * (1.0 + ROUNDING))
    return len(size), [
        f"{size[first:last].max():.4g} N m at {evidence.stamps[first]} ns; the limit is"
        f" {limit:g} N m"
        for first, last in _spans(bad)
    ]


def not_finite(
    stamps: Stamps, torque: Array, bad_stamps: Iterable[int], limit: float
) -> tuple[int, list[str]]:
    """Find commands that are not finite or beyond the limit, or answer a state that was
    not finite with a torque.

    Args:
        stamps: of the controller's commands, ns, shape (n,).
        torque: of these, N m, shape (n, 2).
        bad_stamps: of states whose numbers were not finite, ns.
        limit: of a torque, N m.

    Returns:
        How many commands were looked at, and a line for each bad one.
    """
    size = np.abs(torque).max(axis=1, initial=0.0)
    finite = size <= limit * (1.0 + ROUNDING)
    poisoned = np.isin(stamps, np.fromiter(bad_stamps, dtype=np.int64)) & (
        size > NO_TORQUE
    )
    lines = [
        f"{torque[row].tolist()} N m at {stamps[row]} ns"
        for row in np.flatnonzero(~finite)
    ]
    lines += [
        f"{torque[row].tolist()} N m answer the bad state of {stamps[row]} ns"
        for row in np.flatnonzero(poisoned)
    ]
    return len(stamps), lines


def paused(times: Stamps, limit: float) -> bool:
    """Tell whether a publisher was silent for longer than the limit, s, by its times of
    publication, (n,), ns, ascending.
    """
    return bool(len(times) > 1 and np.diff(times).max() > limit * NANOSECONDS)


def _spans(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(
        np.diff(np.concatenate([[False], mask, [False]]).astype(int))
    )
    return [
        (int(first), int(last))
        for first, last in zip(edges[::2], edges[1::2], strict=True)
    ]


@dataclass(frozen=True)
class NodeReports:
    """What the nodes said during one trip.

    Attributes:
        before, after: diagnostics values by node and key, at its beginning and end.
        texts: all values of each ``node.key`` in between.
        exits: exit codes of the nodes that ended.
        logs: what each node printed since the beginning.
        answers: of services that were called as part of the fault.
        silent: nodes whose diagnostics no longer come.
    """

    before: Mapping[str, Mapping[str, str]]
    after: Mapping[str, Mapping[str, str]]
    texts: Mapping[str, Sequence[str]]
    exits: Mapping[str, int]
    logs: Mapping[str, str]
    answers: Sequence[str]
    silent: Collection[str] = ()

    def report(self, wanted: str) -> bool:
        """Tell whether one way of reporting (see ``cases.FaultCase``) was used."""
        place, _, words = wanted.partition("~")
        if place == "answer":
            return any(words in answer for answer in self.answers)
        kind, _, name = place.partition(".")
        if kind == "exit":
            return self.exits.get(name, 0) != 0
        if kind == "silent":
            return name in self.silent
        if kind == "log":
            return words in self.logs.get(name, "")
        if words:
            return any(words in text for text in self.texts.get(place, ()))
        return _number(self.after.get(kind, {}).get(name)) > _number(
            self.before.get(kind, {}).get(name)
        )

    def reports(self, wanted: Iterable[str]) -> list[str]:
        """List those ways of reporting that were used."""
        return [way for way in wanted if self.report(way)]


def _number(text: str | None) -> float:
    try:
        return float(text or 0.0)
    except ValueError:
        return 0.0
