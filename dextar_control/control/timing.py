"""How regularly something comes: mean rate, jitter and the tail of its intervals over a sliding window."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np


class Regularity(NamedTuple):
    """Of the intervals in a window; nan without any.

    Attributes:
        rate: Hz, of their mean.
        jitter: their standard deviation, s.
        p99: of them, s.
        longest: s.
    """

    rate: float
    jitter: float
    p99: float
    longest: float


class Window:
    """The last numbers of a series, without growing."""

    def __init__(self, size: int) -> None:
        self._numbers = np.zeros(size)
        self._count = 0

    def add(self, number: float) -> None:
        """One more; the oldest goes once the window is full."""
        self._numbers[self._count % len(self._numbers)] = number
        self._count += 1

    def clear(self) -> None:
        """Forget all."""
        self._count = 0

    @property
    def numbers(self) -> np.ndarray:
        """(n,), in no particular order."""
        return self._numbers[: min(self._count, len(self._numbers))]

    def percentile(self, percent: float) -> float:
        """Nan without numbers."""
        return float(np.percentile(self.numbers, percent)) if self._count else math.nan

    def regularity(self) -> Regularity:
        """Of intervals, s."""
        if not self._count:
            return Regularity(math.nan, math.nan, math.nan, math.nan)
        numbers = self.numbers
        mean = float(numbers.mean())
        rate = 1.0 / mean if mean > 0.0 else math.nan
        return Regularity(rate, float(numbers.std()), self.percentile(99.0), float(numbers.max()))
