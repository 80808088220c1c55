"""Draw success, error and torque against each perturbation, by law and estimator."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypedDict

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dextar_control.contract.style import LIGHT, matplotlib_settings
from dextar_control.experiments.campaign.config import CampaignConfig, sweep_case
from dextar_control.experiments.campaign.summary import Group

BLACK, GREY, LINE = (LIGHT[name] for name in ("ink", "soft", "line"))
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "h", "p", "*")
FILLS = tuple(LIGHT[name] for name in ("link", "paper", "soft", "band"))
BAND = 0.8  # of a case's height, for its combinations
ERROR_RANGE = (1e-2, 1e3)  # mm
TORQUE_RANGE = (1e-1, 1e2)


class MarkerStyle(TypedDict, total=False):
    """How matplotlib draws the markers of one combination."""

    marker: str
    markerfacecolor: str
    markeredgecolor: str
    markersize: float
    markeredgewidth: float
    color: str


@matplotlib.rc_context(matplotlib_settings(LIGHT))
def draw_summary(config: CampaignConfig, groups: Sequence[Group], plant: str) -> Figure:
    """Draw one plant: a row for each case, a marker for each combination, a line for
    each bar.
    """
    groups = [group for group in groups if group.plant == plant]
    names = [
        name for name in config.cases if any(group.case == name for group in groups)
    ]
    combinations = list(dict.fromkeys(group.name for group in groups))
    height = 1.6 + max(len(names), 1) * max(0.45, 0.11 * len(combinations))
    figure = Figure(figsize=(13.0, height), layout="constrained")
    FigureCanvasAgg(figure)
    success, error, torque = figure.subplots(
        1, 3, sharey=True, width_ratios=(1.0, 1.35, 1.0)
    )
    styles = _styles(combinations, f"{config.default.law}/{config.default.estimator}")
    for group in groups:
        style = styles[group.name]
        y = names.index(group.case) + _offset(
            combinations.index(group.name), len(combinations)
        )
        _point(success, y, 100.0 * group.success, style)
        _range(error, y, 1e3 * group.median_error, 1e3 * group.max_error, style)
        # the axis ends there
        _point(
            torque,
            y,
            min(max(group.peak_ratio_near, TORQUE_RANGE[0]), TORQUE_RANGE[1]),
            style,
        )
        if group.judged:
            _bars(
                success,
                error,
                torque,
                names.index(group.case),
                config.cases[group.case].bars,
            )
    for axes in (success, error, torque):
        _bands(axes, len(names))
    success.set_yticks(
        range(len(names)),
        [config.cases[name].title or name for name in names],
        parse_math=False,
    )
    success.set_ylim(len(names) - 0.5, -0.5)
    success.set_xlim(-4.0, 104.0)
    success.set_xlabel("successful trials (%)", fontsize=9)
    _log(error, ERROR_RANGE, "largest true error (mm): median, line to the worst trial")
    _log(torque, TORQUE_RANGE, "largest torque within |s| < 0.1, × planned peak")
    for name in combinations:
        success.plot(
            [], [], linestyle="", label=name.replace("/", " / "), **styles[name]
        )
    success.plot(
        [],
        [],
        color=BLACK,
        linewidth=2.0,
        label=f"bar for {config.default.law} / {config.default.estimator}",
    )
    figure.legend(loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    # ticks take their colours when they are first drawn
    figure.draw_without_rendering()
    return figure


@matplotlib.rc_context(matplotlib_settings(LIGHT))
def draw_frontier(config: CampaignConfig, groups: Sequence[Group]) -> Figure:
    """Draw the share of the trials that crossed, and that were ok, over the levels of
    each sweep, by the default combination.
    """
    default, columns = config.default, 3
    found = {
        group.case: group
        for group in groups
        if (group.law, group.estimator, group.plant)
        == (default.law, default.estimator, default.plant)
    }
    rows = math.ceil(len(config.sweeps) / columns)
    figure = Figure(figsize=(8.4, 0.7 + 2.1 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    every = figure.subplots(rows, columns, sharey=True, squeeze=False).reshape(-1)
    for axes, (name, sweep) in zip(every, config.sweeps.items(), strict=False):
        levels = [level for level in sweep.levels if sweep_case(name, level) in found]
        places = [sweep.scale * level for level in levels]
        for share, label, style, fill in (
            ("crossed", "crossed", "o-", BLACK),
            ("success", "ok", "s--", LIGHT["paper"]),
        ):
            values = [
                100.0 * getattr(found[sweep_case(name, level)], share)
                for level in levels
            ]
            axes.plot(
                places,
                values,
                style,
                color=BLACK,
                markerfacecolor=fill,
                markersize=5,
                linewidth=1.2,
                label=label,
                clip_on=False,
            )
        if sweep.asked is not None:
            axes.axvline(
                sweep.scale * sweep.asked,
                color=GREY,
                linestyle=":",
                linewidth=1.6,
                label="asked for",
            )
        if places and max(places) > 10.0 * min(places) > 0.0:
            axes.set_xscale("log")
        axes.set_xticks(places, [sweep.shown(level) for level in levels], fontsize=7)
        axes.set_xticks([], minor=True)
        axes.set_ylim(-4.0, 104.0)
        axes.tick_params(axis="y", labelsize=7)
        axes.grid(axis="y", color=LINE, linewidth=0.6)
        axes.set_title(sweep.title, fontsize=9, parse_math=False)
        axes.set_xlabel(sweep.unit, fontsize=8, parse_math=False)
    for axes in every[len(config.sweeps) :]:
        axes.set_visible(False)
    for axes in every[::columns]:
        axes.set_ylabel("of the trials (%)", fontsize=8)
    labelled = {
        label: line
        for axes in every
        for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        labelled.values(),
        labelled.keys(),
        loc="outside upper center",
        ncols=3,
        fontsize=8,
        frameon=False,
    )
    # ticks take their colours when they are first drawn
    figure.draw_without_rendering()
    return figure


def _styles(combinations: Sequence[str], default: str) -> dict[str, MarkerStyle]:
    styles: dict[str, MarkerStyle] = {}
    others = [name for name in combinations if name != default]
    for index, name in enumerate(others):
        styles[name] = {
            "marker": MARKERS[1 + index % (len(MARKERS) - 1)],
            "markerfacecolor": FILLS[index % len(FILLS)],
            "markeredgecolor": BLACK,
            "color": GREY,
            "markersize": 5.5,
            "markeredgewidth": 0.8,
        }
    styles[default] = {
        "marker": MARKERS[0],
        "markerfacecolor": BLACK,
        "markeredgecolor": BLACK,
        "color": BLACK,
        "markersize": 6.5,
    }
    return styles


def _offset(index: int, count: int) -> float:
    return BAND * ((index + 0.5) / count - 0.5)


def _point(axes: Axes, y: float, value: float, style: MarkerStyle) -> None:
    if math.isfinite(value):
        axes.plot([value], [y], linestyle="", clip_on=False, zorder=4, **style)


def _range(axes: Axes, y: float, low: float, high: float, style: MarkerStyle) -> None:
    if math.isfinite(low):
        axes.plot([low, high], [y, y], color=style["color"], linewidth=1.0, zorder=3)
        axes.plot([high], [y], marker="|", color=style["color"], markersize=6, zorder=3)
        axes.plot([low], [y], linestyle="", zorder=4, **style)


def _bars(
    success: Axes, error: Axes, torque: Axes, row: int, bars: dict[str, float]
) -> None:
    scaled: list[tuple[str, Axes, Callable[[float], float], str]] = [
        ("min_success", success, lambda limit: 100.0 * limit, "-"),
        ("max_error", error, lambda limit: 1e3 * limit, "-"),
        ("median_error", error, lambda limit: 1e3 * limit, ":"),
        ("max_peak_near", torque, lambda limit: limit, "-"),
    ]
    for bar, axes, scale, line in scaled:
        if bar in bars:
            axes.plot(
                [scale(bars[bar])] * 2,
                [row - 0.45, row + 0.45],
                color=BLACK,
                linewidth=2.0,
                linestyle=line,
                zorder=2,
            )


def _bands(axes: Axes, count: int) -> None:
    for row in range(0, count, 2):
        axes.axhspan(row - 0.5, row + 0.5, color=LIGHT["wash"], zorder=0)
    axes.grid(axis="x", color=LINE, linewidth=0.6, zorder=1)
    axes.tick_params(axis="y", length=0)


def _log(axes: Axes, limits: tuple[float, float], label: str) -> None:
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    low = min(max(10.0 ** math.floor(math.log10(low)), limits[0]), limits[1] / 10.0)
    axes.set_xlim(
        low, max(min(10.0 ** math.ceil(math.log10(high)), limits[1]), 10.0 * low)
    )
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_xlabel(label, fontsize=9)
