"""Draw the outcome shares of each fault, and the torque after the controller's
death.
"""

from __future__ import annotations

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dextar_control.contract.style import LIGHT, matplotlib_settings
from dextar_control.experiments.faults.judgement import DEAD_AFTER, Outcome
from dextar_control.experiments.faults.table import Summary

SHADES = {
    Outcome.CROSSED: (LIGHT["wash"], ""),
    Outcome.REFUSED: (LIGHT["wash"], "..."),
    Outcome.SAFE_STOP: (LIGHT["link"], ""),
    Outcome.FAULT: (LIGHT["mid"], ""),
    Outcome.NO_TORQUE: (LIGHT["soft"], ""),
    Outcome.MISSED: (LIGHT["ink"], "xxx"),
    Outcome.DISTURBED: (LIGHT["paper"], "///"),
}
ROW = 0.2  # inches
INK = LIGHT["ink"]


@matplotlib.rc_context(matplotlib_settings(LIGHT))
def draw(summary: Summary, timeout: float) -> Figure:
    """Draw a run; ``timeout`` is that of the drives, s."""
    cases = [case for case in summary.cases.values() if case.outcomes]
    figure = Figure(
        figsize=(13.0, max(4.5, 1.4 + ROW * len(cases))), layout="constrained"
    )
    FigureCanvasAgg(figure)
    shares, torque = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    for row, case in enumerate(cases):
        total, left = sum(case.outcomes.values()), 0.0
        for outcome, (colour, hatch) in SHADES.items():
            share = 100.0 * case.outcomes[outcome.value] / total
            if share:
                shares.barh(
                    row,
                    share,
                    left=left,
                    color=colour,
                    hatch=hatch,
                    edgecolor=INK,
                    linewidth=0.5,
                    height=0.75,
                )
                left += share
        shares.text(101.0, row, str(total), va="center", fontsize=7)
    shares.set_yticks(
        range(len(cases)), [case.title for case in cases], fontsize=7, parse_math=False
    )
    shares.set_ylim(len(cases) - 0.4, -0.6)
    shares.set_xlim(0.0, 100.0)
    shares.set_xlabel("faulted crossings (%), and how many")
    used = {name for case in cases for name in case.outcomes}
    for outcome, (colour, hatch) in SHADES.items():
        if outcome.value in used:
            shares.bar(
                0.0,
                0.0,
                color=colour,
                hatch=hatch,
                edgecolor=INK,
                linewidth=0.5,
                label=outcome.value,
            )
    figure.legend(loc="outside upper center", ncols=7, fontsize=8, frameon=False)
    curves = [curve for case in cases for curve in case.curves]
    for curve in curves:
        torque.plot(
            [1e3 * t for t, _ in curve],
            [value for _, value in curve],
            color=INK,
            linewidth=0.6,
            alpha=0.5,
        )
    torque.axvline(1e3 * timeout, color=INK, linestyle="--", linewidth=1.0)
    torque.axvline(1e3 * DEAD_AFTER, color=INK, linewidth=1.5)
    top = (
        max([value for curve in curves for _, value in curve], default=0.1) * 1.1 or 0.1
    )
    torque.text(
        1e3 * timeout + 1.0, 0.97 * top, "drives' time-out", va="top", fontsize=8
    )
    torque.text(
        1e3 * DEAD_AFTER - 1.0,
        0.9 * top,
        "no torque from here",
        va="top",
        ha="right",
        fontsize=8,
    )
    torque.set_ylim(0.0, top)
    torque.set_xlim(-20.0, 120.0)
    torque.set_xlabel("ms after the controller's last command")
    torque.set_ylabel("largest applied torque (N m)")
    torque.set_title(f"{len(curves)} killed controllers", fontsize=10)
    return figure
