"""What the figures of a run share, drawn by matplotlib: the plane to scale, and a panel over time.

Read in grey as in colour: line styles, widths and marks differ, not only shades.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.transforms import offset_copy

from dextar_control.analysis.curves import Panel
from dextar_control.analysis.plane import Plane
from dextar_control.analysis.thin import thin, thin_path

BLACK, GREY, LIGHT, ACCENT = "#000000", "#6b6b6b", "#b8b8b8", "#a3260f"
BAND = "#e8bfb7"  # what was planned lies as a wide light band under what was measured
LINES: dict[tuple[str, int], tuple[str, Any, float]] = {
    ("commanded", 0): (BLACK, "-", 0.9),
    ("commanded", 1): (BLACK, "--", 0.9),
    ("planned", 0): (BAND, "-", 2.6),
    ("planned", 1): (BAND, (0, (1.2, 0.8)), 2.6),
    ("true", 0): (BLACK, "-", 0.9),
    ("estimated", 0): (GREY, "--", 0.8),
    ("seen", 0): (BLACK, "-", 0.8),
    ("confidence", 0): (GREY, "-.", 0.7),
}  # of a curve's kind and part: colour, style, width in points of a figure one column wide
VERDICT_MARKS = {"crossed": "o", "bounced": "X", "undecided": "s", "": "D"}
NUMBER_SIZE = 5.5  # points, of the crossings' numbers
LEGEND_DROP = 4.0  # of the axis label's size, from the frame to the legend: numbers and label lie between
MOST_NUMBERS = 6  # of crossings at one place, the rest as dots


def draw_plane(axes: Any, plane: Plane, scale: float = 1.0) -> None:
    """Path to scale with locus, linkage, crossings and t_s; its legend lies under it.

    Args:
        axes: matplotlib's.
        plane: what is there.
        scale: of lines and marks; 1 for a figure one column wide.
    """
    if plane.empty:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no position of the end effector in the bag", ha="center", transform=axes.transAxes)
        return
    named: set[str] = set()

    def once(name: str) -> str | None:
        new = name not in named
        named.add(name)
        return name if new else None

    def line(x: np.ndarray, color: str, style: str, width: float, name: str | None = None, **more: Any) -> None:
        axes.plot(*x.T, color=color, linestyle=style, linewidth=width * scale, label=name, **more)

    for family, arc in plane.locus:
        line(arc, GREY, "--" if family == "stretched" else ":", 0.8, once(f"Type 2 locus, {family}"))
    if len(plane.linkage):
        line(plane.linkage, LIGHT, "-", 1.8, zorder=1, marker="o", markersize=2.0 * scale)
        line(plane.linkage[[0, 4]], BLACK, "none", 0.0, marker="^", markersize=4.5 * scale, zorder=4)
    if len(plane.planned):
        line(plane.planned[thin_path(plane.planned)], *LINES["planned", 0], "planned")
    path, style, name = (plane.true, "-", "true") if len(plane.true) else (plane.estimated, "--", "estimated")
    if len(path):
        line(path[thin_path(path)], BLACK, style, 0.7, name)
    for place in plane.places:
        line(place.t_s, BLACK, "-", 1.6, once("$t_s$ at a crossing"), zorder=3)
        label = f"crossing, estimator: {place.verdict}" if place.verdict else "planned crossing"
        line(place.x[None], BLACK, "none", 0.0, once(label), marker=VERDICT_MARKS[place.verdict], markerfacecolor="white",
             markersize=3.4 * scale, markeredgewidth=0.7 * scale, zorder=5)  # fmt: skip
        if len(plane.places) > 1:
            shown = ", ".join(map(str, place.numbers[:MOST_NUMBERS])) + (" ..." if len(place.numbers) > MOST_NUMBERS else "")
            _say(axes, shown, place.x, scale, fontsize=NUMBER_SIZE * scale)
    for name, point in _ends(plane):
        line(point[None], BLACK, "none", 0.0, marker="o", markersize=2.5 * scale, zorder=5)
        _say(axes, name, point, scale, weight="bold")
    axes.set_aspect("equal", anchor="N")
    axes.set_xlim(plane.low[0], plane.high[0])
    axes.set_ylim(plane.low[1], plane.high[1])
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    if named or len(plane.planned) or len(path):
        under = offset_copy(axes.transAxes, axes.figure, y=-LEGEND_DROP * axes.xaxis.label.get_size(), units="points")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), bbox_transform=under, frameon=False, ncols=2, handlelength=2.6,
                    labelspacing=0.25, columnspacing=1.2, borderaxespad=0.0)  # fmt: skip


def _ends(plane: Plane) -> list[tuple[str, np.ndarray]]:
    """A and B of a trip as in the paper; the start of a tour."""
    if not len(plane.planned):
        return []
    if len(plane.places) > 1:
        return [("start", plane.planned[0])]
    far = plane.planned[np.hypot(*(plane.planned - plane.planned[0]).T).argmax()]
    return [("A", plane.planned[0]), ("B", far)]


def _say(axes: Any, words: str, point: np.ndarray, scale: float, **more: Any) -> None:
    axes.annotate(words, point, xytext=(2.6 * scale, 2.0 * scale), textcoords="offset points", annotation_clip=True, zorder=6,
                  **more)  # fmt: skip


def draw_panel(
    axes: Any, panel: Panel, instants: Sequence[float], last: bool, scale: float = 1.0, names: dict[str, str] | None = None
) -> None:
    """Curves over time with their legend above, where it hides none; dotted lines at some instants, s.

    Args:
        axes: matplotlib's.
        panel: what it shows.
        instants: of the planned crossings, s.
        last: it carries the time axis' numbers.
        scale: of the lines; 1 for a figure one column wide.
        names: shorter ones of curves.
    """
    for instant in instants:
        axes.axvline(instant, color=GREY, linewidth=0.5 * scale, linestyle=(0, (1, 2)))
    for curve in panel.curves:
        rows = thin(curve.time, curve.values, instants)
        color, style, width = LINES[curve.kind, curve.part]
        axes.plot(curve.time[rows], curve.values[rows], color=color, linestyle=style, linewidth=width * scale,
                  label=(names or {}).get(curve.name, curve.name))  # fmt: skip
    if math.isfinite(panel.high):
        axes.set_ylim(panel.low, panel.high)
    axes.grid(color="#e6e6e6", linewidth=0.4 * scale)
    axes.tick_params(labelbottom=last)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5, frameon=False, handlelength=2.2, columnspacing=1.0,
                borderaxespad=0.0, borderpad=0.15)  # fmt: skip
