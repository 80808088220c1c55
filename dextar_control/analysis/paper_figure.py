"""A run as a figure that fits a paper's column, or its page: (a) path to scale, (b)
torques, error, residual over time.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dextar_control.analysis.curves import Panel, panels
from dextar_control.analysis.drawing import PAPER, draw_panel, draw_plane
from dextar_control.analysis.metrics import Metrics
from dextar_control.analysis.plane import plane_of
from dextar_control.analysis.run import Run
from dextar_control.contract.errors import bag_errors

FORMATS = ("png", "svg", "pdf")
COLUMN = 88.0  # mm, a column of a two-column page
WIDE = 130.0  # mm, from which on (a) and (b) stand side by side
INCH = 25.4  # mm
PANEL = 27.0  # mm, height of a panel over time
LEGEND = 22.0  # mm, under the path
FONT = 7.0  # points
RESOLUTION = 600  # dots per inch, of the PNG
SETTINGS: dict[str, float | str] = {
    "legend.fontsize": 6.0,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "pdf.fonttype": 42,  # TrueType, embedded: publishers refuse Type 3
    "svg.fonttype": "path",  # outlines: the same everywhere
    "svg.hashsalt": "dextar",
}
SHORT = {"seen by the controller": "seen", "τ1 commanded": "τ1", "τ2 commanded": "τ2"}
KEYS = {"torque", "error", "residual"}


def draw_paper(run: Run, metrics: Metrics, width: float = COLUMN) -> Figure:
    """Draw a run as the paper's Figure 4, ``width`` mm wide; without a tracked
    trajectory the path alone.
    """
    shown = [_shortened(panel) for panel in panels(run, metrics) if panel.key in KEYS]
    plane = plane_of(run, metrics)
    span = np.maximum(plane.high - plane.low, 1e-3)
    beside = width >= WIDE and bool(shown)
    path = (
        min(0.86 * (0.42 if beside else 1.0) * width * span[1] / span[0], 1.2 * width)
        + LEGEND
    )
    over_time = PANEL * len(shown) + 6.0 * bool(shown)
    with PAPER.settings(FONT, **SETTINGS):
        height = max(path, over_time) if beside else path + over_time
        figure = Figure(figsize=(width / INCH, height / INCH), layout="constrained")
        if beside:
            grid = figure.add_gridspec(len(shown), 2, width_ratios=(0.75, 1.0))
            places = [grid[:, 0], *(grid[row, 1] for row in range(len(shown)))]
        else:
            grid = figure.add_gridspec(
                1 + len(shown), 1, height_ratios=[path, *[PANEL] * len(shown)]
            )
            places = [grid[row, 0] for row in range(1 + len(shown))]
        axes = figure.add_subplot(places[0])
        draw_plane(axes, plane, PAPER)
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.set_title("(a)", loc="left", fontsize=7.0, pad=2.0)
        instants = [crossing.planned_time for crossing in metrics.crossings]
        first: Axes | None = None
        for place, panel in zip(places[1:], shown, strict=True):
            axes = figure.add_subplot(place, sharex=first)
            first = first or axes
            draw_panel(axes, panel, instants, panel is shown[-1], PAPER)
        if first is not None:
            axes.set_xlabel("time (s)")
            first.set_xlim(0.0, metrics.length)
            first.set_title("(b)", loc="left", fontsize=7.0, pad=2.0)
            figure.align_ylabels()
    return figure


def _shortened(panel: Panel) -> Panel:
    return panel._replace(
        label=panel.label.removeprefix("tracking "),
        curves=[
            curve._replace(name=SHORT.get(curve.name, curve.name))
            for curve in panel.curves
        ],
    )


def write_paper(
    run: Run, metrics: Metrics, folder: Path, formats: list[str], width: float = COLUMN
) -> list[Path]:
    """Write ``paper.<format>`` for each format, and return the files.

    Raises:
        BagError: a file cannot be written.
    """
    figure = draw_paper(run, metrics, width)
    files = [folder / f"paper.{name}" for name in formats]
    with PAPER.settings(FONT, **SETTINGS):
        for file in files:
            dated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}[
                file.suffix[1:]
            ]
            with bag_errors(f"write {file}"):
                figure.savefig(file, dpi=RESOLUTION, metadata=dated)
    return files
