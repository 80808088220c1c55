"""The phases of the loop, and the record of one of its samples."""

from __future__ import annotations

from enum import IntEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dextar_control.control.law import OUTPUT
from dextar_control.estimation.records import ESTIMATE, REFERENCE
from dextar_control.symbols.record import Layout, Record
from dextar_control.symbols.types import Array, Slice


class Phase(IntEnum):
    """The phases of the controller."""

    IDLE = 0  # no torque, by request
    APPROACH = 1  # tracks a trajectory without a crossing
    HOLD = 2  # holds a point
    TRACK = 3  # tracks a crossing trajectory, away from the locus
    CROSSING = 4  # tracks it near the locus
    SAFE_STOP = 5  # coasts, brakes, then no torque: ``control.safe_stop``
    FAULT = 6  # no torque


WITHOUT_LAW = (Phase.IDLE, Phase.FAULT, Phase.SAFE_STOP)  # in which no law acts
MOVING = (Phase.APPROACH, Phase.TRACK, Phase.CROSSING)


@lru_cache
def frame_of(n: int) -> dict[str, tuple[Slice, Layout]]:
    """Return the places and layouts of reference, estimate and output in a ``Frame``,
    for n degrees of freedom.
    """
    places, start = {}, 0
    for name, fields in (
        ("reference", REFERENCE),
        ("estimate", ESTIMATE),
        ("output", OUTPUT),
    ):
        layout = Layout(name, n, fields)
        places[name] = slice(start, start + layout.size), layout
        start += layout.size
    return places


class Frame:
    """Reference, estimate and output of one sample, in one array.

    Args:
        n: degrees of freedom.
        numbers: the array, (size,); zeros when None.
    """

    __slots__ = ("n", "numbers")

    def __init__(self, n: int, numbers: Array | None = None) -> None:
        self.n = n
        self.numbers = (
            np.zeros(max(place.stop for place, _ in frame_of(n).values()))
            if numbers is None
            else numbers
        )

    def _part(self, name: str) -> Record:
        place, layout = frame_of(self.n)[name]
        return layout.of(self.numbers[place])

    reference = property(
        lambda self: self._part("reference"),
        doc="Record of ``estimation.records.REFERENCE``.",
    )
    estimate = property(
        lambda self: self._part("estimate"),
        doc="Record of ``estimation.records.ESTIMATE``.",
    )
    output = property(
        lambda self: self._part("output"), doc="Record of ``control.law.OUTPUT``."
    )


def indices_of(n: int, *fields: str) -> NDArray[np.int64]:
    """Return the indices (k,), 1, in a frame of these fields' numbers, each PART.NAME,
    in this order.
    """
    every = np.arange(max(within.stop for within, _ in frame_of(n).values()))
    found = []
    for part, name in (field.split(".") for field in fields):
        within, layout = frame_of(n)[part]
        found.append(np.atleast_1d(every[within][layout.places[name][0]]))
    return np.concatenate(found)


def _field(part: str, name: str, doc: str) -> property:
    return property(lambda self: getattr(self._part(part), name), doc=doc)


class Tick(Frame):
    """One sample of the loop with its answer.

    Attributes:
        time: of the state, s.
        reference_time: since the trajectory's start, s.
        phase: of the loop.
    """

    __slots__ = ("phase", "reference_time", "time")

    def __init__(
        self, time: float, reference_time: float, phase: Phase, frame: Frame
    ) -> None:
        self.time, self.reference_time, self.phase = time, reference_time, phase
        self.n, self.numbers = frame.n, frame.numbers.copy()

    tau = _field("output", "tau", "(n,) N m.")
    x_ref = _field("reference", "x", "(n,) m.")
    x_hat = _field("estimate", "x", "(n,) m.")
    error = _field("output", "error", "(n,) x_ref - x_hat, m.")
    s = _field("output", "s", "Singularity measure at the model's state.")
    residual = _field("output", "residual", "t_s.w_d that u asks for, N.")
    confidence = _field("estimate", "confidence", "In the assembly mode, 0.5 to 1.")
    assembly_mode = property(
        lambda self: int(self.estimate.assembly_mode), doc="Believed sign of s."
    )
