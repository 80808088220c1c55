"""The controller's log, ``dextar demo`` and ``dextar go`` tell how far a trip is and
what became of it in the same words.
"""

from __future__ import annotations

from collections.abc import Mapping


def crossing_line(index: int, total: int, verdict: str, confidence: str) -> str:
    """Return what became of a planned crossing, counted from 0, as the controller's log
    and ``dextar go`` tell it.
    """
    return (
        f"crossing {index + 1} of {total}: {verdict.upper()} (confidence {confidence})"
    )


def trip_line(crossed: int, total: int, largest_error: float) -> str:
    """Return what became of a trajectory that was tracked; the largest error is by the
    estimate, m.
    """
    crossings = f"crossed {crossed} of {total} planned, " if total else ""
    return f"{crossings}largest error {1e3 * largest_error:.3f} mm"


def crossings(told: Mapping[str, str]) -> str:
    """Return how many of the planned crossings have begun, by the controller's
    diagnostics.
    """
    total = told.get("crossings") or "0"
    return f"crossing {told.get('begun') or '0'} of {total}" if total != "0" else ""


def unhealthy(told: Mapping[str, str]) -> str:
    """Return why the controller still waits to enable itself, by its diagnostics; empty
    when it does not.
    """
    if told.get("enabling") != "waiting":
        return ""
    return (
        f": healthy states for {told.get('healthy', '')} s only;"
        f" {told.get('last_trouble', '')}"
    )
