"""A run as a figure that fits a paper's column: (a) path to scale, (b) torques, error, residual over time."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dextar_control.analysis.curves import Panel, panels
from dextar_control.analysis.metrics import Metrics
from dextar_control.analysis.plane import Plane, plane_of
from dextar_control.analysis.run import Run
from dextar_control.analysis.thin import thin, thin_path
from dextar_control.contract.errors import BagError

FORMATS = ("png", "svg", "pdf")
COLUMN = 88.0  # mm, a column of a two-column page
INCH = 25.4  # mm
PANEL = 24.0  # mm, height of a panel over time
RESOLUTION = 600  # dots per inch, of the PNG
BLACK, GREY, LIGHT, ACCENT = "#000000", "#6b6b6b", "#b8b8b8", "#a3260f"
SETTINGS: Any = {
    "font.family": "DejaVu Sans", "font.size": 7.0, "axes.labelsize": 7.0, "legend.fontsize": 6.0, "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5, "axes.linewidth": 0.6, "xtick.major.width": 0.6, "ytick.major.width": 0.6,
    "pdf.fonttype": 42,  # TrueType, embedded: publishers refuse Type 3
    "svg.fonttype": "path",  # outlines: the same everywhere
    "svg.hashsalt": "dextar",
}  # fmt: skip
LINES = {
    ("commanded", 0): {"color": BLACK, "linestyle": "-", "linewidth": 0.9},
    ("commanded", 1): {"color": BLACK, "linestyle": "--", "linewidth": 0.9},
    ("planned", 0): {"color": ACCENT, "linestyle": ":", "linewidth": 0.7},
    ("planned", 1): {"color": ACCENT, "linestyle": "-.", "linewidth": 0.6},
    ("true", 0): {"color": BLACK, "linestyle": "-", "linewidth": 0.9},
    ("estimated", 0): {"color": GREY, "linestyle": "--", "linewidth": 0.7},
    ("seen", 0): {"color": BLACK, "linestyle": "-", "linewidth": 0.8},
}
SHORT = {"seen by the controller": "seen", "τ1 commanded": r"$\tau_1$", "τ2 commanded": r"$\tau_2$",
         "τ1 planned": r"$\tau_1$ planned", "τ2 planned": r"$\tau_2$ planned"}  # fmt: skip
LABELS = {"torque": "torque (N m)", "error": "error (mm)", "residual": r"$t_s \cdot w_d$ (N)"}


def draw_paper(run: Run, metrics: Metrics, width: float = COLUMN) -> Figure:
    """The paper's Figure 4 of a run, ``width`` mm wide; without a tracked trajectory the path alone."""
    shown = [panel for panel in panels(run, metrics) if panel.key in LABELS]
    plane = plane_of(run, metrics)
    span = np.maximum(plane.high - plane.low, 1e-3)
    path = min(0.86 * width * span[1] / span[0], 1.2 * width)
    with matplotlib.rc_context(SETTINGS):
        figure = Figure(figsize=(width / INCH, (path + PANEL * len(shown) + 12.0) / INCH), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(1 + len(shown), 1, height_ratios=[path, *[PANEL] * len(shown)])
        _plane(figure.add_subplot(grid[0]), plane)
        first: Any = None
        for row, panel in enumerate(shown, start=1):
            axes = figure.add_subplot(grid[row], sharex=first)
            first = first or axes
            _panel(axes, panel, metrics, last=row == len(shown))
        if first is not None:
            first.set_xlim(0.0, metrics.duration if math.isfinite(metrics.duration) else metrics.tracked_until)
            first.set_title("(b)", loc="left", fontsize=7.0, pad=2.0)
    return figure


def write_paper(run: Run, metrics: Metrics, folder: Path, formats: list[str], width: float = COLUMN) -> list[Path]:
    """Write ``paper.<format>`` for each format; the files.

    Raises:
        BagError: a file cannot be written.
    """
    figure = draw_paper(run, metrics, width)
    files = [folder / f"paper.{name}" for name in formats]
    with matplotlib.rc_context(SETTINGS):
        for file in files:
            dated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}[file.suffix[1:]]
            try:
                figure.savefig(file, dpi=RESOLUTION, metadata=dated)
            except OSError as error:
                raise BagError(f"cannot write {file}: {error.strerror or error}") from error
    return files


def _plane(axes: Any, plane: Plane) -> None:
    named = set()
    for family, arc in plane.locus:
        style = "--" if family == "stretched" else ":"
        label = None if family in named else f"locus, {family}"
        axes.plot(*arc.T, color=GREY, linestyle=style, linewidth=0.8, label=label)
        named.add(family)
    if len(plane.linkage):
        axes.plot(*plane.linkage.T, color=LIGHT, linewidth=1.8, marker="o", markersize=2.0, zorder=1)
        axes.plot(*plane.linkage[[0, 4]].T, "k^", markersize=4.5, zorder=4, linestyle="none")
    if len(plane.planned):
        axes.plot(*plane.planned[thin_path(plane.planned)].T, color=GREY, linewidth=2.2, alpha=0.5, label="planned")
    path, style, name = (plane.true, "-", "true") if len(plane.true) else (plane.estimated, "--", "estimated")
    if len(path):
        axes.plot(*path[thin_path(path)].T, color=BLACK, linestyle=style, linewidth=0.7, label=name)
    for row, place in enumerate(plane.places):
        axes.plot(*place.t_s.T, color=BLACK, linewidth=1.6, zorder=3, label="$t_s$" if row == 0 else None)
        axes.plot(*place.x, "s", color=BLACK, markerfacecolor="white", markersize=3.0, markeredgewidth=0.7, zorder=5)
    if len(plane.planned) and len(plane.places) == 1:
        far = plane.planned[np.hypot(*(plane.planned - plane.planned[0]).T).argmax()]
        for name, point in (("A", plane.planned[0]), ("B", far)):
            axes.plot(*point, "ko", markersize=2.5, zorder=5)
            axes.annotate(name, point, xytext=(3.0, 2.0), textcoords="offset points", weight="bold")
    axes.set_aspect("equal")
    axes.set_xlim(plane.low[0], plane.high[0])
    axes.set_ylim(plane.low[1], plane.high[1])
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.set_title("(a)", loc="left", fontsize=7.0, pad=2.0)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="upper right", frameon=False, handlelength=2.4, ncols=1, borderaxespad=0.1, labelspacing=0.25)


def _panel(axes: Any, panel: Panel, metrics: Metrics, last: bool) -> None:
    instants = [crossing.planned_time for crossing in metrics.crossings]
    for instant in instants:
        axes.axvline(instant, color=GREY, linewidth=0.5, linestyle=(0, (1, 2)))
    for curve in panel.curves:
        rows = thin(curve.time, curve.values, instants)
        axes.plot(curve.time[rows], curve.values[rows], label=SHORT.get(curve.name, curve.name), **LINES[curve.kind, curve.part])
    low, high = axes.get_ylim()
    low, high = (panel.low, panel.high) if math.isfinite(panel.high) else (low, high)
    axes.set_ylim(low, high + 0.28 * (high - low))
    axes.set_ylabel(LABELS[panel.key])
    axes.grid(color="#e6e6e6", linewidth=0.4)
    axes.tick_params(labelbottom=last)
    axes.legend(loc="upper right", ncols=4, frameon=False, handlelength=2.2, columnspacing=1.0, borderaxespad=0.1)
    if last:
        axes.set_xlabel("time (s)")
