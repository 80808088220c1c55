"""Figures for a page that zoom: what ``curves`` and ``plane`` say, drawn by Bokeh.

Read in grey as in colour: line styles and widths differ, and the shades differ in lightness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from bokeh.core.properties import value
from bokeh.models import (
    BoxZoomTool,
    ColumnDataSource,
    CrosshairTool,
    DataRange1d,
    FactorRange,
    FixedTicker,
    HoverTool,
    PanTool,
    Range1d,
    ResetTool,
    SaveTool,
    WheelZoomTool,
)
from bokeh.models.annotations import Span
from bokeh.plotting import figure
from numpy.typing import NDArray

from dextar_control.analysis.curves import Curve, Panel
from dextar_control.analysis.metrics import Metrics
from dextar_control.analysis.plane import Plane
from dextar_control.analysis.run import Floats
from dextar_control.analysis.thin import thin, thin_path
from dextar_control.analysis.timing import PhaseSpan

BLACK, GREY, LIGHT, ACCENT, BLUE = "#111111", "#767676", "#c4c4c4", "#b3260f", "#2f6fb5"
BAND = "#e8bfb7"  # what was planned lies as a wide light band under what was measured
FONT = "system-ui, -apple-system, 'Segoe UI', Helvetica, Arial, sans-serif"
HEIGHT = 200  # px, of a panel over time
LAST = 40  # px more for the one with the axis
PLANE_WIDTH, PLANE_REST = 450, 170  # px, of the frame in the plane, and beside its height for axis and legend
VERDICT_MARKS = {"crossed": ("circle", 10), "bounced": ("x", 13), "undecided": ("square", 10), "": ("diamond", 12)}
DASHES = {"solid": "", "dashed": "6", "dotted": "2 4", "dotdash": "2 4 6 4"}  # as Bokeh draws them
BINS = 80  # of a histogram


class Style(NamedTuple):
    """How a line is drawn."""

    color: str
    dash: str
    width: float


STYLES = {
    ("commanded", 0): Style(BLACK, "solid", 1.8),
    ("commanded", 1): Style(BLACK, "dashed", 1.8),
    ("planned", 0): Style(BAND, "solid", 5.0),
    ("planned", 1): Style(BAND, "dashed", 5.0),
    ("true", 0): Style(BLACK, "solid", 1.8),
    ("estimated", 0): Style(BLUE, "dashed", 1.4),
    ("seen", 0): Style(BLACK, "solid", 1.6),
    ("confidence", 0): Style(GREY, "dotdash", 1.4),
}
RUN_STYLES = (
    Style(BLACK, "solid", 1.8), Style(ACCENT, "dashed", 1.6), Style(BLUE, "dotdash", 1.6), Style(GREY, "dotted", 2.0),
    Style("#1b7f5c", "solid", 1.0), Style("#7a4fa3", "dashed", 1.0),
)  # fmt: skip


def run_tag(index: int) -> str:
    """What all curves of one of several runs carry, so that the page's key can show and hide them together."""
    return f"run {index}"


def run_keys(names: Sequence[str]) -> list[dict[str, Any]]:
    """One key of several runs for all their figures: name, tag of the curves, and how they are drawn."""
    styles = [RUN_STYLES[index % len(RUN_STYLES)] for index in range(len(names))]
    return [
        {"name": name, "tag": run_tag(index), "color": style.color, "dash": DASHES[style.dash], "width": style.width}
        for index, (name, style) in enumerate(zip(names, styles, strict=True))
    ]


def over_time(panels: Sequence[Panel], instants: Sequence[float], duration: float, names: Sequence[str] = ()) -> list[Any]:
    """One figure for each panel, with a common time axis and cross-hair.

    Args:
        panels: of a run; or of several, each curve's ``kind`` then being the number of its run (see ``names``).
        instants: planned crossings, s.
        duration: of the time axis, s.
        names: of the runs, where there are several.
    """
    common: Any = Range1d(start=0.0, end=max(duration, 1e-3))
    hair = Span(dimension="height", line_color=GREY, line_width=1)
    drawn = []
    for index, panel in enumerate(panels):
        last = index == len(panels) - 1
        axes = _axes(panel.label, HEIGHT + LAST * last, common)
        if math.isfinite(panel.high):
            axes.y_range = Range1d(start=panel.low, end=panel.high)
        for instant in instants:
            axes.add_layout(Span(location=instant, dimension="height", line_color=GREY, line_dash="dotted", line_width=1))
        for curve in panel.curves:
            style = RUN_STYLES[int(curve.kind) % len(RUN_STYLES)] if names else STYLES[curve.kind, curve.part]
            _line(axes, curve, style, instants, legend=not names)
        axes.xaxis.visible = last
        if last:
            axes.xaxis.axis_label = "time since the trajectory's start (s)"
        axes.add_tools(CrosshairTool(overlay=hair), HoverTool(tooltips=[("", "$name"), ("s", "@x{0.0000}"), ("", "@y")],
                                                               mode="vline", line_policy="nearest"))  # fmt: skip
        _legend(axes)
        drawn.append(axes)
    return drawn


def in_plane(planes: Sequence[Plane], names: Sequence[str] = ()) -> Any:
    """The path to scale, with locus, linkage, crossings and t_s; the true paths of several runs where they have names."""
    plane = planes[0]
    width, height = np.maximum(plane.high - plane.low, 1e-3)
    pixels = min(PLANE_WIDTH * height / width + PLANE_REST, 4 * HEIGHT + LAST)
    axes = _axes("y (m)", round(pixels), DataRange1d(range_padding=0.0), plane=True)
    axes.y_range = DataRange1d(range_padding=0.0)
    axes.match_aspect = True
    axes.xaxis.axis_label = "x (m)"
    corners = axes.scatter(*np.stack([plane.low, plane.high]).T, alpha=0.0)
    axes.x_range.renderers = axes.y_range.renderers = [corners]
    for family, arc in plane.locus:
        dash = "dashed" if family == "stretched" else "dotted"
        _trace(axes, arc, Style(GREY, dash, 1.6), f"Type 2 locus, {family}")
    _trace(axes, plane.linkage, Style(LIGHT, "solid", 4.0), "linkage at a crossing" if plane.places else "linkage")
    if len(plane.linkage):
        axes.scatter(*plane.linkage[[0, 4]].T, marker="triangle", size=13, color=BLACK)
        axes.scatter(*plane.linkage[1:4].T, marker="circle", size=6, color=GREY)
    _trace(axes, plane.planned, STYLES["planned", 0], "planned, first run" if names else "planned")
    if names:
        true = all(len(other.true) or not len(other.estimated) for other in planes)
        for index, other in enumerate(planes):
            path = other.true if true else other.estimated
            _trace(axes, path, RUN_STYLES[index % len(RUN_STYLES)], tag=run_tag(index))
    elif len(plane.true):
        _trace(axes, plane.true, Style(BLACK, "solid", 1.6), "true")
    else:
        _trace(axes, plane.estimated, Style(BLUE, "dashed", 1.6), "estimated (no truth in this bag)")
    for place in plane.places:
        axes.line(*place.t_s.T, color=BLACK, line_width=3.0, legend_label="t_s at a crossing")
        verdict = "" if names else place.verdict
        marker, size = VERDICT_MARKS[verdict]
        axes.scatter([place.x[0]], [place.x[1]], marker=marker, size=size, fill_color="white", line_color=BLACK, line_width=1.5,
                     legend_label=f"crossing, estimator: {verdict}" if verdict else "planned crossing")  # fmt: skip
        text = ", ".join(map(str, place.numbers[:6])) + (" ..." if len(place.numbers) > 6 else "")
        axes.text([place.x[0]], [place.x[1]], text=[text], x_offset=10, y_offset=-6, text_font_size="12px", text_font=value(FONT))
    if len(plane.planned):
        axes.scatter(*plane.planned[:1].T, marker="circle", size=7, color=BLACK)
        axes.text(*plane.planned[:1].T, text=["start"], x_offset=8, y_offset=-4, text_font_size="12px", text_font=value(FONT))
    _legend(axes, "below", 2)
    return axes


def histogram(values: Floats, label: str, unit: float = 1e6) -> Any:
    """Counts of durations (n,), s, on a logarithmic axis in microseconds."""
    good = values[np.isfinite(values) & (values > 0.0)] * unit
    low, high = math.floor(math.log10(max(good.min(), 1e-3)) * 4) / 4, math.ceil(math.log10(good.max()) * 4) / 4
    counts, edges = np.histogram(np.log10(good), bins=BINS, range=(low, max(high, low + 0.25)))
    top = max(2.0 * counts.max(), 2.0)
    axes = figure(height=HEIGHT, sizing_mode="stretch_width", x_axis_type="log", y_axis_type="log", toolbar_location=None,
                  tools="", y_range=Range1d(start=0.7, end=top))  # fmt: skip
    _dress(axes, "count")
    axes.xaxis.axis_label = label
    for axis, first, last in ((axes.xaxis, 10.0 ** edges[0], 10.0 ** edges[-1]), (axes.yaxis, 1.0, top)):
        ticks = log_ticks(first, last)
        axis.ticker = FixedTicker(ticks=ticks)
        axis.major_label_overrides = {tick: f"{tick:,.9g}".replace(",", "\u2009") for tick in ticks}
    axes.quad(top=np.maximum(counts, 0.7), bottom=0.7, left=10.0 ** edges[:-1], right=10.0 ** edges[1:], fill_color=LIGHT,
              line_color=GREY, line_width=0.5)  # fmt: skip
    for percent, dash in ((50.0, "solid"), (99.0, "dashed")):
        place = float(np.percentile(good, percent))
        axes.add_layout(Span(location=place, dimension="height", line_color=BLACK, line_dash=dash, line_width=1.5))
    return axes


def residuals(values: Floats, deviations: Floats, used: NDArray[np.bool_], label: str, name: str) -> Any:
    """What is left of some observations (n,), by number, two standard deviations (n,) either way; those used set the scale."""
    numbers = np.arange(1, len(values) + 1)
    axes = _axes(label, HEIGHT + LAST, DataRange1d())
    axes.xaxis.axis_label = name
    axes.add_layout(Span(location=0.0, dimension="width", line_color=GREY, line_width=1))
    low, high = values - 2.0 * deviations, values + 2.0 * deviations
    axes.segment(numbers, low, numbers, high, line_color=BLACK)
    for counts, marker in ((True, "square"), (False, "x")):
        rows = used == counts
        axes.scatter(numbers[rows], values[rows], marker=marker, size=7, color=BLACK if counts else ACCENT)
    if used.any():
        rest = 0.1 * float(np.ptp(np.concatenate([low[used], high[used], [0.0]])))
        axes.y_range = Range1d(start=min(0.0, float(low[used].min())) - rest, end=max(0.0, float(high[used].max())) + rest)
    return axes


def log_ticks(low: float, high: float) -> list[float]:
    """Round numbers for a logarithmic axis, as many as there is room for: about nine in three decades, one a decade beyond."""
    decades = math.log10(high / low)
    steps = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0) if decades <= 1.0 else (1.0, 2.0, 5.0) if decades <= 3.0 else (1.0,)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    return [tick for power in powers for step in steps if low <= (tick := round(step * 10.0**power, 9)) <= high]


def phase_band(spans: Sequence[PhaseSpan], metrics: Metrics) -> Any:
    """The phases one under the other over time."""
    names = list(dict.fromkeys(span.phase for span in spans))
    axes = figure(height=60 + 26 * len(names), sizing_mode="stretch_width", y_range=FactorRange(factors=names[::-1]),
                  toolbar_location="right",
                  tools=[PanTool(dimensions="width"), BoxZoomTool(dimensions="width"), ResetTool()],
                  x_axis_label="time since the trajectory's start (s)")  # fmt: skip
    _dress(axes, "")
    axes.toolbar.logo = None
    axes.toolbar.autohide = True
    shades = {"TRACK": GREY, "CROSSING": BLACK, "SAFE_STOP": ACCENT, "FAULT": ACCENT}
    source = ColumnDataSource(
        {
            "phase": [span.phase for span in spans], "left": [span.start for span in spans],
            "right": [max(span.end, span.start + 1e-3) for span in spans],
            "color": [shades.get(span.phase, LIGHT) for span in spans], "ticks": [span.ticks for span in spans],
        }
    )  # fmt: skip
    axes.hbar(y="phase", left="left", right="right", height=0.6, fill_color="color", line_color=None, source=source)
    shown = [("", "@phase"), ("from", "@left{0.000} s"), ("to", "@right{0.000} s"), ("ticks", "@ticks")]
    axes.add_tools(HoverTool(tooltips=shown))
    return axes


def _axes(label: str, height: int, x_range: Any, plane: bool = False) -> Any:
    dimensions: Any = "both" if plane else "width"
    axes = figure(
        height=height, sizing_mode="stretch_width", x_range=x_range, toolbar_location="right", output_backend="canvas",
        tools=[BoxZoomTool(dimensions="both", match_aspect=plane), PanTool(dimensions="both"),
               WheelZoomTool(dimensions=dimensions), ResetTool(), SaveTool()],
    )  # fmt: skip
    axes.toolbar.logo = None
    axes.toolbar.autohide = True
    _dress(axes, label)
    return axes


def _dress(axes: Any, label: str) -> None:
    axes.yaxis.axis_label = label
    axes.min_border_left = 76
    axes.grid.grid_line_color = "#ececec"
    axes.outline_line_color = "#bbbbbb"
    axes.axis.axis_label_text_font_style = "normal"
    for name in ("axis_label_text_font", "major_label_text_font"):
        setattr(axes.axis, name, FONT)
    axes.axis.axis_label_text_font_size = "12px"
    axes.axis.major_label_text_font_size = "11px"
    axes.axis.minor_tick_line_color = None


def _legend(axes: Any, side: str = "above", columns: int = 0) -> None:
    """The legend outside the frame, where it hides no curve."""
    if not axes.legend:
        return
    legend = axes.legend[0]
    axes.center.remove(legend)
    axes.add_layout(legend, side)
    axes.legend.location = "left" if side == "below" else "right"
    axes.legend.orientation = "horizontal"
    if columns:
        axes.legend.ncols = columns
    axes.legend.click_policy = "hide"
    axes.legend.label_text_font = FONT
    axes.legend.label_text_font_size = "11px"
    axes.legend.padding, axes.legend.margin, axes.legend.spacing = 1, 2, 10
    axes.legend.glyph_width = 34
    axes.legend.background_fill_alpha = 0.85
    axes.legend.border_line_color = None


def _line(axes: Any, curve: Curve, style: Style, instants: Sequence[float], legend: bool) -> None:
    rows = thin(curve.time, curve.values, instants)
    source = ColumnDataSource({"x": curve.time[rows].astype(np.float32), "y": curve.values[rows].astype(np.float32)})
    drawn = axes.line("x", "y", source=source, name=curve.name, color=style.color, line_dash=style.dash, line_width=style.width,
                      **({"legend_label": curve.name} if legend else {}))  # fmt: skip
    if not legend:
        drawn.tags = [run_tag(int(curve.kind))]


def _trace(axes: Any, x: Floats, style: Style, name: str = "", tag: str = "") -> None:
    if len(x) == 0:
        return
    shown = x[thin_path(x)].astype(np.float32)
    drawn = axes.line(shown[:, 0], shown[:, 1], color=style.color, line_dash=style.dash, line_width=style.width,
                      **({"legend_label": name} if name else {}))  # fmt: skip
    drawn.tags = [tag] if tag else []
