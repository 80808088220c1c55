"""Figures for a page that zoom: what ``curves`` and ``plane`` say, as numbers for
``templates/figures.js``, which draws them.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dextar_control.analysis.curves import Around, Panel
from dextar_control.analysis.plane import Plane, crossing_title, numbers_in_words
from dextar_control.analysis.run import Floats
from dextar_control.analysis.thin import thin, thin_path
from dextar_control.analysis.timing import PhaseSpan
from dextar_control.contract import style
from dextar_control.contract.style import LINES, MARKS, RUNS, Line

WebFigure = dict[str, object]  # what ``templates/figures.js`` reads
HEIGHT, SMALL = 132, 52  # px, of the frame of a panel over time, and of one of many
TALLEST_PLANE = 560  # px
BINS = 80  # of a histogram
MARK, SQUARE = Line("ink", (), 1.4), 3.5  # of a crossing; px
INSTANT, ZERO = Line("mid", style.DOTTED, 1.0), Line("mid", (), 1.0)
PHASE_LINES = {"TRACK": "mid", "CROSSING": "ink", "SAFE_STOP": "bad", "FAULT": "bad"}


def run_tag(index: int) -> str:
    """Return what all curves of one of several runs are tagged with, so that one key
    shows and hides them together.
    """
    return f"run {index}"


def over_time(
    panels: Sequence[Panel],
    instants: Sequence[float],
    duration: float,
    names: Sequence[str] = (),
) -> list[WebFigure]:
    """Make one figure of each panel, with a common time axis and cross-hair.

    Args:
        panels: of a run; or of several, each curve's ``kind`` then being the number of
            its run (see ``names``).
        instants: planned crossings, s.
        duration: of the time axis, s.
        names: of the runs, where there are several.
    """
    drawn = []
    for index, panel in enumerate(panels):
        series = []
        for curve in panel.curves:
            rows = thin(curve.time, curve.values, instants)
            time, values = curve.time[rows], curve.values[rows]
            if names:
                line, tag = RUNS[int(curve.kind) % len(RUNS)], run_tag(int(curve.kind))
            else:
                line, tag = LINES[curve.kind, curve.part], f"{panel.key} {curve.name}"
            series.append(_series(time, values, line, curve.name, tag, not names))
        rules = [_rule("x", instants, INSTANT)]
        if math.isfinite(panel.limit) and panel.limit < panel.high:
            rules.append(_rule("y", [-panel.limit, panel.limit], LINES["limit", 0]))
        last = index == len(panels) - 1
        drawn.append(
            {
                "label": style.html(panel.label),
                "xlabel": style.label("time") if last else "",
                "height": HEIGHT,
                "bare": not last,
                "group": "time",
                "x": _range(0.0, duration),
                "y": _range(panel.low, panel.high),
                "series": series,
                "rules": rules,
            }
        )
    return drawn


def around(found: Around, outcomes: Sequence[str]) -> list[WebFigure]:
    """Make one small figure of each crossing: its own curve over the mean of all, with
    what became of it where it was not crossed.
    """
    mean = _series(found.time, found.mean, LINES["mean", 0], "mean of all")
    return [
        {
            "label": crossing_title(number, outcome),
            "height": SMALL,
            "left": 34,
            "bare": True,
            "group": "around",
            "x": _range(found.time[0], found.time[-1]),
            "y": [0.0, found.high],
            "rules": [_rule("x", [0.0], INSTANT)],
            "series": [
                mean,
                _series(found.time, own, LINES["each", 0], f"crossing {number}"),
            ],
        }
        for number, (own, outcome) in enumerate(
            zip(found.each, outcomes, strict=False), start=1
        )
    ]


def in_plane(planes: Sequence[Plane], names: Sequence[str] = ()) -> WebFigure:
    """Make a figure of the path to scale, with locus, linkage, crossings and t_s; of
    several runs, which have names, it shows the true paths.
    """
    plane, series = planes[0], []

    def path(
        x: Floats, line: Line, name: str, tag: str = "", legend: bool = True
    ) -> None:
        if len(x):
            shown = x[thin_path(x)]
            series.append(
                _series(shown[:, 0], shown[:, 1], line, name, tag or name, legend)
            )

    for family, arc in plane.locus:
        path(arc, LINES[family, 0], f"Type 2 locus, {family}")
    path(
        plane.linkage,
        LINES["linkage", 0],
        "robot at a crossing" if plane.places else "robot",
    )
    if len(plane.linkage):
        series.append(
            _marks(
                plane.linkage,
                "o",
                LINES["linkage", 0]._replace(width=1.4),
                3.0,
                "robot",
            )
        )
        series.append(_marks(plane.motors, "^", MARK, 5.0, "motor axis", fill="ink"))
    path(
        plane.planned, LINES["planned", 0], "planned, first run" if names else "planned"
    )
    if names:
        true = all(len(other.true) or not len(other.estimated) for other in planes)
        for index, other in enumerate(planes):
            path(
                other.true if true else other.estimated,
                RUNS[index % len(RUNS)],
                names[index],
                run_tag(index),
                legend=False,
            )
    elif len(plane.true):
        path(plane.true, LINES["true", 0], "true")
    else:
        path(plane.estimated, LINES["estimated", 0], "estimated (no truth in this bag)")
    for place in plane.places:
        series.append(
            _series(
                place.t_s[:, 0],
                place.t_s[:, 1],
                LINES["t_s", 0],
                "t_s at a crossing",
                "t_s",
                legend=True,
            )
        )
        verdict = "" if names else place.verdict
        name = f"crossing, estimator: {verdict}" if verdict else "planned crossing"
        series.append(
            _marks(
                place.x[None],
                MARKS[verdict],
                MARK,
                4.5,
                name,
                [numbers_in_words(place.numbers)],
                legend=True,
            )
        )
    for name, point in plane.ends:
        series.append(_marks(point[None], "o", MARK, 3.0, name, [name], fill="ink"))
    low = np.min([one.low for one in planes], axis=0)
    high = np.max([one.high for one in planes], axis=0)
    return {
        "label": "",
        "xlabel": f"{style.label('x')}, {style.label('y')} upwards",
        "height": TALLEST_PLANE,
        "to_scale": True,
        "x": _range(low[0], high[0]),
        "y": _range(low[1], high[1]),
        "series": series,
    }


def histogram(values: Floats, label: str, unit: float = 1e6) -> WebFigure:
    """Make a histogram of durations (n,), s, on a logarithmic axis in microseconds."""
    good = values[np.isfinite(values) & (values > 0.0)] * unit
    low, high = (
        math.floor(math.log10(max(good.min(), 1e-3)) * 4) / 4,
        math.ceil(math.log10(good.max()) * 4) / 4,
    )
    counts, edges = np.histogram(
        np.log10(good), bins=BINS, range=(low, max(high, low + 0.25))
    )
    edges, some = 10.0**edges, counts > 0
    under = np.full(int(some.sum()), 0.7)
    bars = _bars(
        edges[:-1][some], under, edges[1:][some], counts[some], Line("mid"), "count"
    )
    rules = [
        _rule("x", [float(np.percentile(good, percent))], Line("bad", dash, 1.6))
        for percent, dash in ((50.0, ()), (99.0, style.DASHED))
    ]
    return {
        "label": "count",
        "xlabel": label,
        "height": HEIGHT,
        "log": "xy",
        "x": _range(edges[0], edges[-1]),
        "y": [0.7, max(2.0 * float(counts.max()), 2.0)],
        "series": [bars],
        "rules": rules,
    }


def residuals(
    values: Floats, deviations: Floats, used: NDArray[np.bool_], label: str, name: str
) -> WebFigure:
    """Make a figure of what is left of some observations; those used set its scale.

    Args:
        values: (n,) in the unit that the label names.
        deviations: (n,) in that unit; bars of two of them go either way.
        used: (n,) whether each counts.
        label: of the values, with their unit.
        name: of what is counted along the other axis, units alike.
    """
    numbers = np.arange(1, len(values) + 1)
    low, high = values - 2.0 * deviations, values + 2.0 * deviations
    bars = np.stack([low, high, np.full(len(values), np.nan)], axis=1).ravel()
    series = [_series(np.repeat(numbers, 3), bars, Line("ink", (), 1.2))]
    for counts, mark, text in ((True, "s", "counts"), (False, "X", "does not count")):
        rows = used == counts
        if rows.any():
            series.append(
                _marks(
                    np.stack([numbers[rows], values[rows]], axis=1),
                    mark,
                    MARK if counts else Line("bad", (), 1.4),
                    SQUARE,
                    text,
                    fill="ink",
                    legend=not used.all(),
                )
            )
    span: list[float | None] = [None, None]
    if used.any():
        rest = 0.1 * float(np.ptp(np.concatenate([low[used], high[used], [0.0]])))
        span = _range(
            min(0.0, float(low[used].min())) - rest,
            max(0.0, float(high[used].max())) + rest,
        )
    return {
        "label": style.html(label),
        "xlabel": name,
        "height": HEIGHT,
        "x": [0.5, len(values) + 0.5],
        "y": span,
        "series": series,
        "rules": [_rule("y", [0.0], ZERO)],
    }


def phase_band(spans: Sequence[PhaseSpan]) -> WebFigure:
    """Make a figure of the phases, one under the other over time."""
    names = list(dict.fromkeys(span.phase for span in spans))[::-1]
    series = []
    for row, name in enumerate(names):
        own = [span for span in spans if span.phase == name]
        left = np.array([span.start for span in own])
        right = np.array([max(span.end, span.start + 1e-3) for span in own])
        under, line = np.full(len(own), row), Line(PHASE_LINES.get(name, "link"))
        series.append(_bars(left, under - 0.3, right, under + 0.3, line, name))
    ends = [span.start for span in spans] + [span.end for span in spans]
    return {
        "label": "",
        "xlabel": style.label("time"),
        "height": 26 * len(names),
        "left": 84,
        "names": names,
        "x": _range(min(ends), max(ends)),
        "y": [-0.5, len(names) - 0.5],
        "series": series,
    }


def _series(
    x: Floats,
    y: Floats,
    line: Line,
    name: str = "",
    tag: str = "",
    legend: bool = False,
) -> dict[str, object]:
    return {
        "name": style.html(name),
        "tag": tag,
        "legend": legend,
        "line": _line(line),
        "x": _packed(x),
        "y": _packed(y),
    }


def _bars(
    left: Floats, low: Floats, right: Floats, high: ArrayLike, line: Line, name: str
) -> dict[str, object]:
    more = {"x2": _packed(right), "y2": _packed(high), "fill": True}
    return _series(left, low, line, name) | more


def _marks(
    x: Floats,
    mark: str,
    line: Line,
    size: float,
    name: str,
    text: Sequence[str] = (),
    legend: bool = False,
    fill: str = "paper",
) -> dict[str, object]:
    return _series(x[:, 0], x[:, 1], line, name, name, legend) | {
        "mark": mark,
        "size": size,
        "text": list(text),
        "fill": fill,
    }


def _rule(axis: str, at: Sequence[float], line: Line) -> dict[str, object]:
    return {
        "axis": axis,
        "at": [float(place) for place in at if math.isfinite(place)],
        "line": _line(line),
    }


def _line(line: Line) -> dict[str, object]:
    return line._asdict() | {"dash": list(line.dash)}


def _range(low: float, high: float) -> list[float | None]:
    """Return the range of an axis; nulls where the curves decide."""
    return (
        [float(low), float(high)]
        if math.isfinite(low) and math.isfinite(high) and low < high
        else [None, None]
    )


def _packed(values: ArrayLike) -> str:
    return base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii")
