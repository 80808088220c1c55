"""Numbers with the nouns that they count, and without one."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dextar_control.analysis.metrics import Metrics


def counted(number: int, noun: str) -> str:
    """``1 crossing``, ``2 crossings``; a noun of more words ends in the one that is counted."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def saturated(metrics: Metrics) -> str:
    """How many commands were, or why that is not known."""
    if math.isnan(metrics.peak_torque):
        return "no command while tracking"
    return str(metrics.saturated) if metrics.robot or metrics.saturated else "unknown without a limit"
