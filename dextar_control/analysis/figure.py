"""A run as the paper's Figure 4, with the truth beside the estimate."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from dextar_control.analysis.curves import Panel, around, panels
from dextar_control.analysis.drawing import (
    SCREEN,
    draw_around,
    draw_panel,
    draw_plane,
    mark,
)
from dextar_control.analysis.metrics import Metrics
from dextar_control.analysis.plane import plane_of
from dextar_control.analysis.run import Run
from dextar_control.contract import style
from dextar_control.contract.style import LIGHT, MARKS

WIDTH, PANEL = 12.0, 1.6  # inches: the figure's width, the height of a panel over time
LEFT = 0.44  # share of the width for the path
LINE = 0.2  # inches, of words
MOST_REASONS, MOST_PLACES = 3, 6


@SCREEN.settings()
def draw_run(run: Run, metrics: Metrics) -> Figure:
    """Draw one run: path to scale, torques, errors, criterion and s over time; where it
    has many crossings, each of them by itself too.
    """
    shown, many, plane = (
        panels(run, metrics),
        around(run, metrics),
        plane_of(run, metrics),
    )
    wide, tall = np.maximum(plane.high - plane.low, 1e-3)
    words = [] if many else _places(metrics)
    left = (
        min(LEFT * WIDTH * float(tall / wide), LEFT * WIDTH) + 1.3 + LINE * len(words)
    )
    over_time = PANEL * max(len(shown), 1)
    lines = _title(metrics).count("\n") + 2
    heights = (
        [LINE * lines, left, over_time]
        if many
        else [LINE * lines, max(left, over_time)]
    )
    figure = Figure(figsize=(WIDTH, sum(heights)), layout="constrained")
    head, *parts = figure.subfigures(
        len(heights), 1, height_ratios=heights, squeeze=False
    )[:, 0]
    color = {True: "good", False: "bad", None: "ink"}[metrics.success]
    head.text(
        0.012,
        0.35,
        _title(metrics),
        fontsize=11.0,
        color=LIGHT[color],
        weight="bold",
        va="center",
        parse_math=False,
    )
    beside, right = parts[0].subfigures(1, 2, width_ratios=(LEFT, 1.0 - LEFT))
    draw_plane(beside.subplots(), plane)
    low = max(1.0 - left / heights[1], 0.0) + 0.01
    beside.text(
        0.1, low, "\n".join(words), va="bottom", linespacing=1.5, parse_math=False
    )
    outcomes = [
        crossing.outcome or crossing.verdict or "" for crossing in metrics.crossings
    ]
    for place, one in zip(
        right.subfigures(max(len(many), 1), 1, squeeze=False)[:, 0], many, strict=False
    ):
        draw_around(place, one, outcomes)
    _over_time(parts[1] if many else right, shown, metrics)
    return figure


def _over_time(
    figure: Figure | SubFigure, shown: Sequence[Panel], metrics: Metrics
) -> None:
    if not shown:
        figure.text(
            0.5,
            0.5,
            "nothing to draw over time: no tracked trajectory in the bag",
            ha="center",
        )
        return
    every = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    instants = [crossing.planned_time for crossing in metrics.crossings]
    for axes, panel in zip(every, shown, strict=True):
        if panel.key == "s":
            axes.axhline(0.0, **SCREEN.line(style.Line("mid", (), 0.9)))
            _verdicts(axes, metrics)
        draw_panel(axes, panel, instants, panel is shown[-1])
    every[0].set_xlim(0.0, metrics.length)
    every[-1].set_xlabel(f"{style.label('time')}; dotted: planned crossings")
    figure.align_ylabels()


def _verdicts(axes: Axes, metrics: Metrics) -> None:
    for verdict in ("crossed", "bounced"):
        times = [
            crossing.verdict_time
            for crossing in metrics.crossings
            if crossing.verdict == verdict
        ]
        if times:
            mark(
                axes,
                np.stack([times, np.zeros(len(times))], axis=1),
                MARKS[verdict],
                4.0,
                SCREEN,
                f"says {verdict}",
            )


def _places(metrics: Metrics) -> list[str]:
    lines = [
        f"crossing {number} at ({1e3 * one.point[0]:.1f}, {1e3 * one.point[1]:.1f}) mm"
        + (
            f" planned at {one.planned_time:.3f} s"
            if one.true_time is None
            else f" at {one.true_time:.3f} s"
        )
        + f": {one.outcome or 'outcome unknown'}; estimator:"
        f" {one.verdict or 'nothing recorded'}"
        for number, one in enumerate(metrics.crossings, start=1)
    ]
    more = len(lines) - MOST_PLACES
    return lines[:MOST_PLACES] + [f"and {more} more"] * (more > 0)


def _title(metrics: Metrics) -> str:
    words = {True: "crossed as planned", False: "FAILED", None: "not decidable"}
    lines = [
        f"{metrics.title}: {words[metrics.success]}",
        *metrics.reasons[:MOST_REASONS],
    ]
    if len(metrics.reasons) > MOST_REASONS:
        lines[-1] += f" (and {len(metrics.reasons) - MOST_REASONS} more)"
    return "\n".join(textwrap.shorten(line, 150) for line in lines)
