"""What the figures share that Matplotlib draws: the plane to scale, a panel over time,
a figure as part of a page.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple, TypedDict, cast

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import offset_copy

from dextar_control.analysis.curves import Around, Panel
from dextar_control.analysis.plane import Place, Plane, crossing_title, numbers_in_words
from dextar_control.analysis.run import Floats
from dextar_control.analysis.thin import thin, thin_path
from dextar_control.contract import style
from dextar_control.contract.style import LIGHT, LINES, MARKS, Line

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

# sizes of the axis label from the frame to the legend: numbers and label lie between
LEGEND_DROP = 4.0
FEW, SEVERAL = 3, 6  # most numbers on a small and on a large axis
ACROSS = 6  # small figures side by side
BESIDE = 4.5  # px, of a word from its mark
APART = 0.04  # of the size of what is drawn, within which crossings share a label
PLACES = ((1, 1), (1, -1), (-1, 1), (-1, -1))  # beside a mark, where a word may lie
INSTANT = Line("mid", style.DOTTED, 0.9)


class LineProperties(TypedDict, total=False):
    """The arguments of Matplotlib's ``plot`` that say how a line looks."""

    color: str
    linestyle: str | tuple[float, Sequence[float]]
    linewidth: float
    zorder: float
    alpha: float
    marker: str
    markersize: float


class Look(NamedTuple):
    """How large and in which colours a figure is drawn.

    Attributes:
        scale: points for a pixel of the style's widths.
        palette: the colours.
    """

    scale: float = 0.75
    palette: dict[str, str] = LIGHT

    def line(self, line: Line, **more: float | str) -> LineProperties:
        """Return how Matplotlib's ``plot`` draws a line, with some more of its
        arguments.
        """
        properties = style.matplotlib_line(line, self.palette, self.scale) | more
        return cast(LineProperties, properties)

    @contextmanager
    def settings(self, size: float = 9.0, **more: float | str) -> Iterator[None]:
        """Draw with Matplotlib's settings for such a figure.

        Args:
            size: of the font, points.
            more: of the settings.
        """
        settings = style.matplotlib_settings(self.palette, size) | more
        with matplotlib.rc_context(cast("dict[RcKeyType, object]", settings)):
            yield


SCREEN, PAPER = Look(), Look(0.42)  # of a page's width, of a column of a paper


def _points(axes: Axes) -> float:
    return axes.xaxis.label.get_fontproperties().get_size_in_points()


def draw_plane(axes: Axes, plane: Plane, look: Look = SCREEN) -> None:
    """Draw a path to scale with locus, linkage, crossings and t_s, and a legend under
    it.

    Args:
        axes: matplotlib's.
        plane: what is there.
        look: of it.
    """
    if plane.empty:
        axes.set_axis_off()
        axes.text(
            0.5,
            0.5,
            "no position of the end effector in the bag",
            ha="center",
            transform=axes.transAxes,
        )
        return
    draw_locus(axes, plane.locus, look)
    if len(plane.linkage):
        name = "robot at a crossing" if plane.places else "robot"
        draw_line(axes, plane.linkage, LINES["linkage", 0], name, look, zorder=2)
        mark(axes, plane.linkage, "o", 2.6, look, zorder=2)
        mark(axes, plane.motors, "^", 4.0, look, fill="ink", zorder=4)
    draw_line(axes, plane.planned, LINES["planned", 0], "planned", look, zorder=2.5)
    kind, x = (
        ("true", plane.true) if len(plane.true) else ("estimated", plane.estimated)
    )
    draw_line(axes, x, LINES[kind, 0], kind, look, zorder=3)
    draw_places(axes, plane.places, plane.ends, look)
    axes.set_xlim(plane.low[0], plane.high[0])
    axes.set_ylim(plane.low[1], plane.high[1])
    finish_plane(axes)


def draw_locus(axes: Axes, locus: Sequence[tuple[str, Floats]], look: Look) -> None:
    """Draw the arcs of the Type 2 locus: (family, points (n, 2), m) each."""
    for family, arc in locus:
        draw_line(axes, arc, LINES[family, 0], f"Type 2 locus, {family}", look)


def draw_line(
    axes: Axes, x: Floats, line: Line, name: str, look: Look, **more: float
) -> None:
    """Draw a path x (n, 2), m, and name it once in the legend."""
    if len(x):
        label = style.mathtext(name)
        named = label in axes.get_legend_handles_labels()[1]
        axes.plot(
            *x[thin_path(x)].T,
            label=None if named else label,
            **look.line(line, **more),
        )


def draw_places(
    axes: Axes, places: Sequence[Place], ends: Sequence[tuple[str, Floats]], look: Look
) -> None:
    """Draw crossings with their numbers and t_s, and the path's ends; each word stands
    where no other does.

    Args:
        axes: matplotlib's.
        places: of the crossings.
        ends: (name, point (2,), m) each.
        look: of the figure.
    """
    taken = [place.x for place in places] + [point for _, point in ends]
    for place in places:
        draw_line(axes, place.t_s, LINES["t_s", 0], "t_s at a crossing", look, zorder=4)
        label = (
            f"crossing, estimator: {place.verdict}"
            if place.verdict
            else "planned crossing"
        )
        mark(axes, place.x[None], MARKS[place.verdict], 4.5, look, label)
    for _, point in ends:
        mark(axes, point[None], "o", 3.0, look, fill="ink")
    span = float(np.ptp(axes.dataLim.get_points(), axis=0).max()) or 1.0
    for words, point in [*_labels(places, APART * span), *ends]:
        if np.isfinite(point).all():
            _write(axes, words, point, span, taken, look)


def _labels(places: Sequence[Place], apart: float) -> list[tuple[str, Floats]]:
    """Number crossings; those nearer to each other than ``apart``, m, share a label,
    for two would lie over each other.
    """
    found: list[tuple[list[int], Floats]] = []
    for place in places:
        near = (own for own, x in found if np.hypot(*(place.x - x)) < apart)
        if (numbers := next(near, None)) is not None:
            numbers += place.numbers
        else:
            found.append((list(place.numbers), place.x))
    return [(numbers_in_words(sorted(numbers)), x) for numbers, x in found]


def mark(
    axes: Axes,
    x: Floats,
    shape: str,
    size: float,
    look: Look,
    name: str = "",
    fill: str = "paper",
    zorder: float = 5,
) -> None:
    """Draw marks at places x (n, 2), m, whose half width is ``size`` pixels."""
    named = not name or name in axes.get_legend_handles_labels()[1]
    axes.plot(
        *x.T,
        linestyle="none",
        marker=shape,
        markersize=2.0 * size * look.scale,
        markerfacecolor=look.palette[fill],
        markeredgecolor=look.palette["ink"],
        markeredgewidth=1.2 * look.scale,
        zorder=zorder,
        label=None if named else name,
    )


def _write(
    axes: Axes,
    words: str,
    point: Floats,
    span: float,
    taken: list[Floats],
    look: Look,
) -> None:
    """Write words beside a point, on the side that is farthest from all that is
    there.
    """
    size = 0.8 * _points(axes)
    aside = 0.03 * span * np.array([1.0 + 0.35 * len(words), 1.0])
    gaps = [
        min(
            (
                float(np.hypot(*(point + aside * side - other)))
                for other in taken
                if other is not point
            ),
            default=span,
        )
        for side in PLACES
    ]
    best = int(np.argmax(np.minimum(gaps, 0.08 * span)))
    right, up = PLACES[best]
    taken.append(point + aside * PLACES[best])
    axes.annotate(
        words,
        (point[0], point[1]),
        xytext=(BESIDE * right * look.scale, BESIDE * up * look.scale),
        textcoords="offset points",
        ha="left" if right > 0 else "right",
        va="bottom" if up > 0 else "top",
        fontsize=size,
        weight="bold",
        zorder=6,
        annotation_clip=True,
        bbox={
            "boxstyle": "square,pad=0.05",
            "facecolor": look.palette["paper"],
            "edgecolor": "none",
            "alpha": 0.7,
        },
    )


def finish_plane(axes: Axes) -> None:
    """Set the axes to scale, name them and put the legend under them."""
    axes.set_aspect("equal", anchor="N")
    axes.grid(linewidth=0.4)
    axes.set_axisbelow(True)
    axes.xaxis.set_major_locator(MaxNLocator(SEVERAL))
    axes.set_xlabel(style.label("x"))
    axes.set_ylabel(style.label("y"))
    under = offset_copy(
        axes.transAxes,
        cast(Figure, axes.figure),
        y=-LEGEND_DROP * _points(axes),
        units="points",
    )
    axes.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        bbox_transform=under,
        ncols=2,
        handlelength=2.6,
        labelspacing=0.25,
        columnspacing=1.2,
        borderaxespad=0.0,
    )


def draw_panel(
    axes: Axes, panel: Panel, instants: Sequence[float], last: bool, look: Look = SCREEN
) -> None:
    """Draw curves over time with a legend above them, where it hides none, and dotted
    lines at some instants.

    Args:
        axes: matplotlib's.
        panel: what it shows.
        instants: of the planned crossings, s.
        last: it carries the time axis' numbers.
        look: of it.
    """
    for instant in instants:
        axes.axvline(instant, **look.line(INSTANT))
    for curve in panel.curves:
        rows = thin(curve.time, curve.values, instants)
        axes.plot(
            curve.time[rows],
            curve.values[rows],
            label=style.mathtext(curve.name),
            **look.line(LINES[curve.kind, curve.part]),
        )
    if math.isfinite(panel.limit) and panel.limit < panel.high:
        for limit in (-panel.limit, panel.limit):
            axes.axhline(limit, **look.line(LINES["limit", 0]))
    if math.isfinite(panel.high):
        axes.set_ylim(panel.low, panel.high)
    axes.grid(linewidth=0.4)
    axes.tick_params(labelbottom=last)
    axes.set_ylabel(style.mathtext(panel.label))
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=5,
        handlelength=2.2,
        columnspacing=1.0,
        borderaxespad=0.0,
        borderpad=0.15,
    )


def draw_around(
    figure: Figure | SubFigure,
    found: Around,
    outcomes: Sequence[str],
    look: Look = SCREEN,
) -> None:
    """Draw each crossing by itself over the mean of all, in a figure of small ones.
    Their places are given, for a layout would take seconds.
    """
    rows = -(-len(found.each) // ACROSS)
    for number, (own, outcome) in enumerate(
        zip(found.each, outcomes, strict=False), start=1
    ):
        row, column = divmod(number - 1, ACROSS)
        wide, tall = 0.93 / ACROSS, 0.88 / rows
        axes = figure.add_axes(
            (0.07 + wide * column, 0.89 - tall * (row + 0.92), 0.86 * wide, 0.66 * tall)
        )
        axes.plot(1e3 * found.time, found.mean, **look.line(LINES["mean", 0]))
        axes.plot(1e3 * found.time, own, **look.line(LINES["each", 0]))
        axes.axvline(0.0, **look.line(INSTANT))
        axes.set_title(
            crossing_title(number, outcome), fontsize=7.0, pad=1.5, loc="center"
        )
        axes.tick_params(
            labelbottom=False, labelleft=column == 0, labelsize=7.0, length=2.0
        )
        axes.set_ylim(0.0, found.high)
        axes.yaxis.set_major_locator(MaxNLocator(FEW))
    figure.text(
        0.02,
        0.93,
        f"{found.label}, {1e3 * found.time[-1]:.0f} ms around each crossing; wide: the"
        " mean",
    )


def svg(figure: Figure) -> str:
    """Return a figure that was drawn in the light palette as part of a page, whose
    colours it takes.
    """
    stream = io.StringIO()
    figure.savefig(stream, format="svg")
    text = stream.getvalue()
    for name, color in LIGHT.items():
        text = text.replace(color, f"var(--{name})")
    return text[text.index("<svg") :]
