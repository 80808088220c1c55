"""How sure the estimators said they were, and how often they were right."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dextar_control.contract.style import LIGHT, matplotlib_settings
from dextar_control.experiments.campaign.rows import Row, number, text
from dextar_control.experiments.campaign.trial import CONFIDENCE_BINS
from dextar_control.symbols.types import Array

SURE = 1.96  # deviations of a 95 % interval
END = 3e-4  # chance to be wrong by which the axes' end, 1, is away
TICKS = (0.0, 0.5, 0.8, 0.9, 0.99, 0.999, 1.0)
INK, PAPER, MID = (LIGHT[name] for name in ("ink", "paper", "mid"))
MARKERS = (("o", INK), ("s", PAPER), ("^", LIGHT["link"]), ("v", LIGHT["soft"]))
VERDICTS = "verdicts"


class Bin(NamedTuple):
    """The stated confidences of one range.

    Attributes:
        low, high: of the range, from and below.
        stated: mean of those that fell into it.
        runs: that stated one; verdicts where it is of these.
        right: share, of the time of each run while it stated one, that the side was
            right.
        least, most: 95 % interval of that share (Wilson).
    """

    low: float
    high: float
    stated: float
    runs: int
    right: float
    least: float
    most: float


def wilson(right: float, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share that was found in a number of trials."""
    z = SURE * SURE / count
    middle = right + 0.5 * z
    half = SURE * math.sqrt(right * (1.0 - right) / count + 0.25 * z / count)
    return max((middle - half) / (1.0 + z), 0.0), min((middle + half) / (1.0 + z), 1.0)


def reliability(rows: Iterable[Row]) -> dict[str, dict[str, Bin]]:
    """Collect, for each estimator that tells the side, the ranges that it stated, by
    their lower end, and its verdicts.
    """
    of: dict[str, list[Row]] = {}
    for row in rows:
        if row.get(f"said_{CONFIDENCE_BINS[0]:g}") is not None:
            of.setdefault(text(row, "estimator"), []).append(row)
    return {estimator: _bins(stated) for estimator, stated in of.items()}


def _bins(rows: Sequence[Row]) -> dict[str, Bin]:
    found = {}
    for low, high in zip(CONFIDENCE_BINS, (*CONFIDENCE_BINS[1:], 1.0), strict=True):
        stated = [row for row in rows if row[f"said_{low:g}"]]
        middle = 0.5 * (low + high)
        if stated:
            right = sum(number(row, f"right_{low:g}") for row in stated) / len(stated)
            means = [
                number(row, f"stated_{low:g}") if row.get(f"stated_{low:g}") else middle
                for row in stated
            ]
            found[f"{low:g}"] = Bin(
                low,
                high,
                sum(means) / len(means),
                len(stated),
                right,
                *wilson(right, len(stated)),
            )
    told = _count(rows, "called_crossed") + _count(rows, "called_bounced")
    if told:
        wrong = _count(rows, "false_alarms") + _count(rows, "missed_bounces")
        right = 1.0 - wrong / told
        found[VERDICTS] = Bin(
            CONFIDENCE_BINS[-1],
            1.0,
            1.0 - 0.5 * (1.0 - CONFIDENCE_BINS[-1]),
            told,
            right,
            *wilson(right, told),
        )
    return found


def _count(rows: Sequence[Row], column: str) -> int:
    return sum(int(row.get(column) or 0) for row in rows)


def in_words(estimator: str, bins: dict[str, Bin]) -> str:
    """Say in one sentence where an estimator is surer than it is right, beyond what
    chance explains.
    """
    over = [
        one for key, one in bins.items() if key != VERDICTS and one.most < one.stated
    ]
    if not over:
        return (
            f"{estimator} is nowhere surer than it is right, as far as"
            f" {sum(one.runs for one in bins.values())} cases tell."
        )
    worst = max(over, key=lambda one: (1.0 - one.right) / (1.0 - one.stated + END))
    return (
        f"{estimator} is too sure at confidences from"
        f" {', '.join(f'{one.low:g}' for one in over)}; worst from {worst.low:g}, where"
        f" it states {min(100.0 * worst.stated, 99.99):.2f} % on average and"
        f" {100.0 * worst.right:.2f} % is right (95 % interval"
        f" {100.0 * worst.least:.2f} to {100.0 * worst.most:.2f} %, {worst.runs} runs)."
    )


@matplotlib.rc_context(matplotlib_settings(LIGHT))
def draw_reliability(found: dict[str, dict[str, Bin]]) -> Figure:
    """Draw the share right over the stated confidence, both on a scale that is
    logarithmic in the chance to be wrong.
    """
    figure = Figure(figsize=(4.8, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for scale in (axes.set_xscale, axes.set_yscale):
        scale("function", functions=(_forward, _backward))
    lowest = min(
        (one.least for bins in found.values() for one in bins.values()), default=0.5
    )
    axes.plot(
        TICKS[1:],
        TICKS[1:],
        color=MID,
        linestyle="--",
        linewidth=1.2,
        label="as sure as right",
    )
    for index, (estimator, bins) in enumerate(found.items()):
        marker, fill = MARKERS[index % len(MARKERS)]
        for key, one in bins.items():
            axes.plot(
                [one.stated] * 2, [one.least, one.most], c=INK, linewidth=1.0, zorder=3
            )
            if key != VERDICTS:
                axes.plot(
                    [one.low, one.high], [one.right] * 2, c=MID, linewidth=1.0, zorder=2
                )
            shape, face = ("D", PAPER) if key == VERDICTS else (marker, fill)
            axes.plot(
                [one.stated],
                [one.right],
                shape,
                markersize=7,
                markerfacecolor=face,
                markeredgecolor=INK,
                zorder=4,
                clip_on=False,
            )
            axes.annotate(
                str(one.runs),
                (one.stated, one.least),
                xytext=(0, -3),
                textcoords="offset points",
                ha="center",
                va="top",
                fontsize=7,
                annotation_clip=False,
            )
        axes.plot(
            [],
            [],
            marker=marker,
            markerfacecolor=fill,
            markeredgecolor=INK,
            linestyle="",
            label=estimator,
        )
    axes.plot(
        [],
        [],
        marker="D",
        markerfacecolor=PAPER,
        markeredgecolor=INK,
        linestyle="",
        label="its verdicts",
    )
    beyond = 1.0 + 0.5 * END
    axes.set_xlim(0.47, beyond)
    axes.set_ylim(min(lowest, 0.47), beyond)
    for axis, low in ((axes.xaxis, 0.5), (axes.yaxis, min(lowest, 0.5))):
        axis.set_ticks(
            [tick for tick in TICKS if tick >= low],
            [f"{tick:g}" for tick in TICKS if tick >= low],
        )
        axis.set_ticks([], minor=True)
    axes.grid(color=LIGHT["line"], linewidth=0.6)
    axes.set_xlabel("confidence stated")
    axes.set_ylabel("share right (95 % intervals, number of runs)")
    figure.legend(loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    # ticks take their colours when they are first drawn
    figure.draw_without_rendering()
    return figure


def _forward(share: Array) -> Array:
    place: Array = -np.log10(np.maximum(1.0 - share + END, 0.1 * END))
    return place


def _backward(place: Array) -> Array:
    share: Array = 1.0 + END - 10.0**-place
    return share
