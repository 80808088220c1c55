"""Rate, jitter and longest interval of recurring events, over a sliding window."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dextar_control.symbols.types import Array


class Regularity(NamedTuple):
    """Statistics of the intervals in a window; nan without any.

    Attributes:
        rate: of their mean, Hz.
        jitter: their standard deviation, s.
        p99: their 99th percentile, s.
        longest: of them, s.
    """

    rate: float
    jitter: float
    p99: float
    longest: float


class Window:
    """The last numbers of a series, without growing."""

    def __init__(self, size: int) -> None:
        self._numbers = np.zeros(size)
        self.clear()

    def add(self, number: float) -> None:
        """Add a number, in the place of the oldest once the window is full."""
        self._numbers[self._count % len(self._numbers)] = number
        self._count += 1

    def clear(self) -> None:
        """Forget all numbers."""
        self._count = 0
        self._found = 0, Regularity(math.nan, math.nan, math.nan, math.nan)

    @property
    def numbers(self) -> Array:
        """The numbers (m,), in the series' unit (intervals: s), in no
        particular order.
        """
        return self._numbers[: min(self._count, len(self._numbers))]

    def percentiles(self, *percents: float) -> list[float]:
        """Return percentiles of the numbers; nan without any."""
        return (
            np.percentile(self.numbers, percents).tolist()
            if self._count
            else [math.nan] * len(percents)
        )

    def regularity(self) -> Regularity:
        """Return the statistics of intervals, s, computed once for the same ones."""
        if self._found[0] != self._count:
            numbers = self.numbers
            mean = float(numbers.mean())
            rate = 1.0 / mean if mean > 0.0 else math.nan
            p99 = self.percentiles(99.0)[0]
            self._found = (
                self._count,
                Regularity(rate, float(numbers.std()), p99, float(numbers.max())),
            )
        return self._found[1]
