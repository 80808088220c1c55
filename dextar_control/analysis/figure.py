"""A run as the paper's Figure 4, with the truth beside the estimate."""

from __future__ import annotations

import math
import textwrap
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dextar_control.analysis.curves import panels
from dextar_control.analysis.drawing import ACCENT, BLACK, GREY, VERDICT_MARKS, draw_panel, draw_plane
from dextar_control.analysis.metrics import Metrics
from dextar_control.analysis.plane import plane_of
from dextar_control.analysis.run import Run

SIZE = (13.0, 8.6)  # inches
SCALE = 1.6  # of lines and marks
VERDICT_HEIGHT = -0.92  # of the marks of the estimator's verdicts, on the axis of s
MOST_REASONS = 3
SETTINGS: Any = {"font.size": 9.0, "legend.fontsize": 8.0}


def draw_run(run: Run, metrics: Metrics) -> Figure:
    """The figure of one run: path to scale, torques, errors, criterion and s over time."""
    shown = panels(run, metrics)
    with matplotlib.rc_context(SETTINGS):
        figure = Figure(figsize=SIZE, layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(max(len(shown), 1), 2, width_ratios=(1.0, 1.25))
        path = figure.add_subplot(grid[:, 0])
        draw_plane(path, plane_of(run, metrics), SCALE)
        path.set_title("(a) path to scale", loc="left", fontsize=9.0)
        instants = [crossing.planned_time for crossing in metrics.crossings]
        first: Any = None
        for row, panel in enumerate(shown):
            axes = figure.add_subplot(grid[row, 1], sharex=first)
            first = first or axes
            if panel.key == "s":
                axes.axhline(0.0, color=GREY, linewidth=0.8)
                _verdicts(axes, metrics)
            draw_panel(axes, panel, instants, row == len(shown) - 1, SCALE)
            if panel.key == "torque" and run.robot is not None and run.robot.max_torque < panel.high:
                for limit in (-run.robot.max_torque, run.robot.max_torque):
                    axes.axhline(limit, color=GREY, linewidth=0.8)
            axes.set_ylabel(panel.label)
        if first is not None:
            first.set_xlim(0.0, metrics.duration if math.isfinite(metrics.duration) else metrics.tracked_until)
            first.set_title("(b)", loc="left", fontsize=9.0)
            axes.set_xlabel("time since the trajectory's start (s); dotted: planned crossings")
        else:
            empty = figure.add_subplot(grid[0, 1])
            empty.set_axis_off()
            empty.text(0.5, 0.5, "nothing to draw over time: no tracked trajectory in the bag", ha="center")
        colour = ACCENT if metrics.success is False else BLACK
        figure.suptitle(_title(metrics), fontsize=10, color=colour, parse_math=False)
    return figure


def _verdicts(axes: Any, metrics: Metrics) -> None:
    """When the estimator said what of the crossings."""
    for verdict in ("crossed", "bounced"):
        times = [crossing.verdict_time for crossing in metrics.crossings if crossing.verdict == verdict]
        if times:
            axes.plot(times, [VERDICT_HEIGHT] * len(times), VERDICT_MARKS[verdict], color=BLACK, markerfacecolor="white",
                      markersize=5, label=f"says {verdict}")  # fmt: skip


def _title(metrics: Metrics) -> str:
    law = f"{metrics.robot or 'robot unknown'}, law: {metrics.law or 'unknown'}, estimator: {metrics.estimator or 'unknown'}"
    verdict = {True: "crossed as planned", False: "FAILED", None: "not decidable"}[metrics.success]
    lines = [f"{law} - {verdict}", *metrics.reasons[:MOST_REASONS]]
    if len(metrics.reasons) > MOST_REASONS:
        lines[-1] += f" (and {len(metrics.reasons) - MOST_REASONS} more)"
    return "\n".join(textwrap.shorten(line, 150) for line in lines)
