"""What a session of faults tells, one JSON object a line."""

from __future__ import annotations

from typing import Literal, TypedDict


class Start(TypedDict):
    """A case begins."""

    event: Literal["start"]
    case: str


class _CrossingRecord(TypedDict):
    event: Literal["record"]
    case: str
    outcome: str
    expected: bool
    where: str
    offset: float
    reason: str
    true_error: float | None
    torque: float
    reported: list[str]
    answers: list[str]
    recovered: bool


class CrossingRecord(_CrossingRecord, total=False):
    """A faulted crossing: what became of it, where the fault began (s from the planned
    crossing), true error (m), largest torque (N m) and who reported it.

    The curve of a killed controller is torque (N m) over time (s) after its last word.
    """

    curve: list[list[float]]


class Checks(TypedDict):
    """How often each check was made in a trip, and what violated it."""

    event: Literal["checks"]
    case: str
    looked: dict[str, int]
    violations: list[tuple[str, str]]


class Said(TypedDict):
    """Something is said of a case; or it, with an empty name the session, could not go
    on.
    """

    event: Literal["note", "failed"]
    case: str
    text: str


class Network(TypedDict):
    """The session asks for a quality of the link, which is answered on its input."""

    event: Literal["network"]
    quality: dict[str, float]


Event = Start | CrossingRecord | Checks | Said | Network
