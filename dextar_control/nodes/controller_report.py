"""The state of the controller's loop is told as values for /diagnostics."""

from __future__ import annotations

import math

from dextar_control.control.loop import ControlLoop
from dextar_control.control.phases import Phase
from dextar_control.nodes.reference import ReferenceReader


def loop_values(
    loop: ControlLoop, begun: int, largest_error: float
) -> dict[str, object]:
    """Return where the robot is and what became of its crossings; m, s.

    Args:
        loop: that answers the states.
        begun: how many planned crossings have begun.
        largest_error: between reference and estimate while the last trajectory was
            tracked, m.
    """
    tick = loop.tick
    x, y = tick.x_hat.tolist() if tick is not None else (math.nan, math.nan)
    words = [passed.verdict.name.lower() for passed in loop.passed]
    confidences = [f"{passed.confidence:.3f}" for passed in loop.passed]
    return {
        "x": x,
        "y": y,
        "s": tick.s if tick else math.nan,
        "distance_to_locus": distance_to_locus(loop),
        "assembly_mode": tick.assembly_mode if tick else 0,
        "mode_confidence": tick.confidence if tick else math.nan,
        "mode_known": loop.mode_known,
        "crossings": len(words),
        "begun": begun,
        "crossed": words.count("crossed"),
        "bounced": words.count("bounced"),
        "verdicts": " ".join(words),
        "confidences": " ".join(confidences),
        "largest_error": largest_error,
        "completed": loop.completed,
        "stopped": loop.phase is Phase.SAFE_STOP and loop.stopped is not None,
        "reference_time": tick.reference_time if tick else 0.0,
        "duration": loop.certificate.duration if loop.certificate else 0.0,
        **{
            f"watch_{name}": f"{value:.4g} of {limit:.4g}"
            for name, (value, limit) in loop.watches.items()
        },
    }


def distance_to_locus(loop: ControlLoop) -> float:
    """Return the distance to the Type 2 locus to first order, |s| over the length of
    its gradient, m; nan before the first state.
    """
    if loop.tick is None:
        return math.nan
    slope = math.hypot(*loop.model.place(loop.tick.x_hat).gradient)
    return round(abs(loop.tick.s) / slope, 5) if slope > 0.0 else math.nan


def waiting_for(reader: ReferenceReader) -> str:
    """Return what an accepted trajectory waits for; empty when none does."""
    if reader.waiting is None:
        return ""
    return "its start" if reader.waiting.scheduled else "the enabling"
