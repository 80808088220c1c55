"""The registry of metrics: how each number of a run is called, shown and defined.

A field of a class of results carries its ``Metric`` in its annotation, so that a number
and its definition stand in one place; ``metrics_of`` lists them.
"""

from __future__ import annotations

import math
from typing import NamedTuple, get_type_hints

SCALES = {"mm": 1e3, "ms": 1e3, "µs": 1e6}  # of a shown unit, over the SI unit


def number(value: float | None, form: str, missing: str = "-") -> str:
    """Format a number; ``missing`` stands for one that is not known."""
    return missing if value is None or not math.isfinite(value) else format(value, form)


def signed(value: float, form: str) -> str:
    """Format a number with its sign, but without one where it rounds to zero."""
    text = format(value, f"+{form}")
    return text if text.strip("+-0.") else text[1:]


class Metric(NamedTuple):
    """What is known of one number of a run or of a crossing.

    Attributes:
        name: a few words, as tables have them.
        unit: SI, as in ``metrics.json``; "" of words and counts.
        definition: what the number is, and when it is not known.
        form: of the number as people read it, such as ``.3f``.
        shown: the unit in which people read it, where that is not ``unit``.
        truth: whether it needs the true motion.
    """

    name: str
    unit: str
    definition: str
    form: str = ""
    shown: str = ""
    truth: bool = False

    @property
    def shown_unit(self) -> str:
        """The unit in which people read the number."""
        return self.shown or self.unit

    def scaled(self, value: float) -> float:
        """Convert a value from ``unit`` to the shown one."""
        return SCALES[self.shown] * value if self.shown else value

    def number(self, value: float | None, missing: str = "-") -> str:
        """Format a value in the shown unit; ``missing`` stands for one that is not
        known.
        """
        return number(value and self.scaled(value), self.form, missing)

    def text(self, value: float | None, missing: str = "-") -> str:
        """Format a value with its unit; ``missing`` stands for one that is not
        known.
        """
        text = self.number(value, "")
        unit = "" if self.unit in ("", "1") else f" {self.shown_unit}"
        return f"{text}{unit}" if text else missing


def metrics_of(results: type) -> dict[str, Metric]:
    """List the metrics among the fields of a class of results, by the fields' names."""
    return {
        name: metric
        for name, hint in get_type_hints(results, include_extras=True).items()
        for metric in getattr(hint, "__metadata__", ())
        if isinstance(metric, Metric)
    }
