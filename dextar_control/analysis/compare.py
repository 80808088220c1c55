"""Several runs side by side: the same quantities with their differences, and their
curves over each other.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

from rich.measure import Measurement
from rich.table import Table

from dextar_control.analysis.clock import clock_in_words
from dextar_control.analysis.compute import compute_metrics
from dextar_control.analysis.crossings import CROSSING_METRICS, CrossingMetrics
from dextar_control.analysis.curves import Curve, Panel, beyond, error_height, panels
from dextar_control.analysis.differences import Difference, differing, shown_name
from dextar_control.analysis.load import load_run
from dextar_control.analysis.metrics import METRICS, Metrics, saturated
from dextar_control.analysis.page import NO_TRUTH, Cell, Column, render
from dextar_control.analysis.plane import plane_of
from dextar_control.analysis.registry import Metric, number, signed
from dextar_control.analysis.run import Run
from dextar_control.analysis.web_figures import WebFigure, in_plane, over_time, run_tag
from dextar_control.bags.damage import damage_lines
from dextar_control.bags.scan import Progress
from dextar_control.contract.errors import BagError, bag_errors
from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.style import RUNS
from dextar_control.contract.terminal import Terminal, title
from dextar_control.contract.words import counted

Measured = TypeVar("Measured", Metrics, CrossingMetrics)
Value = float | int | str | None
DECIDED = ("crossed", "bounced")  # verdicts


@dataclass(frozen=True)
class Compared(Generic[Measured]):
    """A number that runs, or their crossings, are compared by.

    Attributes:
        metric: its name, unit and format.
        of: its value, in the shown unit, from a run's metrics or from a crossing's.
    """

    metric: Metric
    of: Callable[[Measured], Value]


def _field(
    metrics: Mapping[str, Metric], place: str, statistic: str = "", name: str = ""
) -> Compared[Measured]:
    """Compare a number that is a field, or a statistic of one under a name of its
    own.
    """
    metric = metrics[place]
    get = attrgetter(f"{place}.{statistic}" if statistic else place)

    def shown(results: object) -> Value:
        value: Value = get(results)
        return metric.scaled(value) if isinstance(value, float) else value

    return Compared(metric._replace(name=name or metric.name), shown)


COMPARED: tuple[Compared[Metrics], ...] = (
    Compared(
        METRICS["success"],
        lambda m: {True: "success", False: "failed", None: "not decidable"}[m.success],
    ),
    Compared(METRICS["law"], lambda m: m.law or "unknown"),
    Compared(METRICS["estimator"], lambda m: m.estimator or "unknown"),
    Compared(
        Metric("planned crossings", "", "Crossings of the plan.", "d"),
        lambda m: _planned(m, len(m.crossings)),
    ),
    Compared(
        Metric("crossed", "", "Those that were crossed.", "d", truth=True),
        lambda m: _planned(m, _count([c.crossed for c in m.crossings])),
    ),
    Compared(
        Metric("estimator's verdicts", "", "Crossings that the estimator judged.", "d"),
        lambda m: _planned(m, sum(c.verdict in DECIDED for c in m.crossings)),
    ),
    Compared(
        Metric("of these right", "", "Those judged rightly.", "d", truth=True),
        lambda m: _planned(m, _count(_checked(m))),
    ),
    _field(METRICS, "max_true_error"),
    _field(METRICS, "rms_true_error"),
    _field(METRICS, "final_true_error"),
    _field(METRICS, "max_estimated_error"),
    _field(METRICS, "rms_estimated_error"),
    _field(METRICS, "peak_torque"),
    _field(METRICS, "torque_ratio"),
    _field(METRICS, "peak_torque_near"),
    _field(METRICS, "torque_ratio_near"),
    Compared(
        METRICS["saturated"],
        lambda m: m.saturated if saturated(m).isdigit() else None,
    ),
    _field(METRICS, "duration"),
)
OF_THE_MACHINE: tuple[Compared[Metrics], ...] = (
    _field(METRICS, "missed"),
    _field(METRICS, "timing.longest_miss"),
    _field(METRICS, "loop_rate"),
    _field(METRICS, "timing.state_period", "p99", "period of the states, 99 %"),
    _field(METRICS, "timing.round_trip", "median", "round trip, median"),
    _field(METRICS, "timing.round_trip", "p99", "round trip, 99 %"),
    Compared(
        METRICS["lost"],
        lambda m: sum(n or 0 for n in m.lost.values()) if m.lost else None,
    ),
)
OF_CROSSINGS: tuple[Compared[CrossingMetrics], ...] = (
    _field(CROSSING_METRICS, "outcome"),
    Compared(CROSSING_METRICS["verdict"], lambda c: c.verdict or "not recorded"),
    _field(CROSSING_METRICS, "planned_time"),
    _field(CROSSING_METRICS, "true_time"),
    _field(CROSSING_METRICS, "speed"),
    _field(CROSSING_METRICS, "estimated_speed"),
    _field(CROSSING_METRICS, "residual"),
    _field(CROSSING_METRICS, "sigma_min"),
    _field(CROSSING_METRICS, "peak_torque"),
    _field(CROSSING_METRICS, "torque_step"),
    _field(CROSSING_METRICS, "error_before"),
    _field(CROSSING_METRICS, "error_after"),
    _field(CROSSING_METRICS, "estimated_error_before"),
    _field(CROSSING_METRICS, "estimated_error_after"),
)
# labels of the panels that can be either
TRUE_OR_ESTIMATED = {"error": "{} error (mm)", "s": "{} s, 0 on the locus (1)"}
MOST_HEADING = 80  # characters
MOST_CROSSINGS = 24  # written out one by one; the JSON has them all
MOST_DIFFERENCES = 40  # that the page and the text list; the JSON has them all
# ratio of two runs' numbers from which on the page counts them as different
MATTERS = 1.02
WAYS_TO_NAME = 3  # differences that may be part of a run's name


class ComparisonRow(NamedTuple):
    """A number of every run, side by side.

    Attributes:
        metric: its name, unit and format.
        values: per run, in the shown unit; None where the bag does not tell.
        differences: of each further run to the first; None where one of the two is not
            a number.
        missing: per run, what stands for a value that is not there.
    """

    metric: Metric
    values: list[Value]
    differences: list[float | None]
    missing: list[str]

    @property
    def matter(self) -> float:
        """How much the runs differ in it: infinity where words differ, else the largest
        ratio of two numbers, which is 1 where all are equal.
        """
        known = [value for value in self.values if isinstance(value, (int, float))]
        if len(known) < len(self.values):
            return math.inf if len(set(self.values)) > 1 else 1.0
        low, high = min(map(abs, known)), max(map(abs, known))
        if min(known) < 0.0 < max(known) or low == 0.0:
            return math.inf if high > 0.0 else 1.0
        return high / low


@dataclass(frozen=True)
class Comparison:
    """Runs side by side; the others are compared with the first.

    Attributes:
        names: of the runs, all different.
        runs, metrics: of each.
        lines: of the whole runs.
        machine: of the machine that ran them, not of the robot.
        crossings: lines per crossing number, of those that every run has planned.
        remarks: what makes the runs less comparable.
        differences: of bags, laws, estimators, robots and parameters; those in which
            all runs agree are left out.
    """

    names: list[str]
    runs: list[Run]
    metrics: list[Metrics]
    lines: list[ComparisonRow]
    machine: list[ComparisonRow]
    crossings: list[list[ComparisonRow]]
    remarks: list[str]
    differences: list[Difference]

    def to_json(self) -> str:
        """Return strict JSON, null where something is not known."""
        return json.dumps(
            {
                "runs": [
                    {"name": name, "bag": str(run.path)}
                    for name, run in zip(self.names, self.runs, strict=True)
                ],
                "differences": [one._asdict() for one in self.differences],
                "remarks": self.remarks,
                "quantities": [_entry(line) for line in (*self.lines, *self.machine)],
                "crossings": [
                    [_entry(line) for line in lines] for lines in self.crossings
                ],
            },
            indent=2,
            allow_nan=False,
            ensure_ascii=False,
        )

    def to_markdown(self) -> str:
        """Return the tables as Markdown."""
        text = ["# Comparison", ""]
        text += [
            f"- **{name}**: `{run.path}`"
            for name, run in zip(self.names, self.runs, strict=True)
        ]
        differences = [[one.name, *one.values] for one in self.shown_differences]
        more = len(self.differences) - len(differences)
        text += ["", "## What differs", "", *_rows(["", *self.names], differences)]
        text += [f"\n... and {more} more in comparison.json." if more else ""]
        text += ["", "## Side by side", "", "Differences (Δ) are to the first run."]
        text += [*[f"\n{remark}" for remark in self.remarks], ""]
        text += _markdown(self, [*self.lines, *self.machine])
        for index, lines in enumerate(self.crossings[:MOST_CROSSINGS], start=1):
            text += ["", f"## Crossing {index}", "", *_markdown(self, lines)]
        if (more := len(self.crossings) - MOST_CROSSINGS) > 0:
            text += ["", f"... and {more} more crossings in comparison.json."]
        return "\n".join(text) + "\n"

    @property
    def shown_differences(self) -> list[Difference]:
        """The differences that the page and the text have room for."""
        return self.differences[:MOST_DIFFERENCES]


def compare_runs(
    runs: Sequence[Run], metrics: Sequence[Metrics], names: Sequence[str] | None = None
) -> Comparison:
    """Put runs side by side.

    Raises:
        BagError: fewer than two runs.
    """
    if len(runs) < 2:
        raise BagError(f"{counted(len(runs), 'run')}; a comparison needs at least two")
    truths = [run.truth is not None for run in runs]
    lines, of_the_machine = (
        [_line(one, metrics, truths) for one in compared]
        for compared in (COMPARED, OF_THE_MACHINE)
    )
    common = min(len(one.crossings) for one in metrics)
    crossings = [
        [
            _line(compared, [one.crossings[index] for one in metrics], truths)
            for compared in OF_CROSSINGS
        ]
        for index in range(common)
    ]
    differences = differing(runs, metrics)
    names = list(names) if names is not None else name_runs(runs, metrics, differences)
    return Comparison(
        names,
        list(runs),
        list(metrics),
        lines,
        of_the_machine,
        crossings,
        _remarks(names, runs, metrics),
        differences,
    )


def compare_bags(
    paths: Sequence[str | Path],
    progress: Callable[[str], None] = lambda stage: None,
    namespace: str | None = None,
    reading: Progress | None = None,
    robot: RobotParameters | None = None,
) -> Comparison:
    """Load the bags and put them side by side; ``namespace``, ``reading`` and ``robot``
    as in ``load_run``.

    Raises:
        BagError: a bag cannot be read, or there are fewer than two.
    """
    runs, metrics = [], []
    for path in paths:
        progress(f"reading {path}")
        runs.append(load_run(path, namespace, reading, robot))
        progress(f"computing the metrics of {path}")
        metrics.append(compute_metrics(runs[-1]))
    return compare_runs(runs, metrics)


def write_comparison(comparison: Comparison, folder: Path) -> None:
    """Write ``comparison.html``, ``comparison.md`` and ``comparison.json``.

    Raises:
        BagError: they cannot be written.
    """
    with bag_errors(f"write the comparison to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        for kind, text in (
            ("json", comparison.to_json() + "\n"),
            ("md", comparison.to_markdown()),
            ("html", render_comparison(comparison)),
        ):
            file = folder / f"comparison.{kind}"
            file.write_text(text, encoding="utf-8", errors="replace")


def render_comparison(comparison: Comparison) -> str:
    """Render the comparison as one self-contained page."""
    figures: dict[str, WebFigure] = {}
    over = overlaid(comparison)
    if over:
        lengths = (one.length for one in comparison.metrics)
        duration = max(filter(math.isfinite, lengths), default=1.0)
        instants = [
            crossing.planned_time for crossing in comparison.metrics[0].crossings
        ]
        drawn = over_time(over, instants, duration, comparison.names)
        figures = {f"time-{index}": one for index, one in enumerate(drawn)}
    planes = [
        plane_of(run, one)
        for run, one in zip(comparison.runs, comparison.metrics, strict=True)
    ]
    if not planes[0].empty:
        figures["plane"] = in_plane(planes, comparison.names)
    first, *others = comparison.names
    columns = [Column("", text=True), Column(first)]
    for name in others:
        columns += [Column(name), Column("Δ")]
    shown = comparison.crossings[:MOST_CROSSINGS]
    heading = f"{first} against {', '.join(others)}"
    if len(heading) > MOST_HEADING:
        heading = f"{first} against {counted(len(others), 'other run')}"
    told = {"verdict", *(one.name for one in comparison.differences)}
    matter, alike = by_matter(
        [line for line in comparison.lines if line.metric.name not in told]
    )
    return render(
        "comparison.html",
        figures,
        title=heading,
        heading=heading,
        notes=[f"{panel.label}: {panel.note}" for panel in over if panel.note],
        bags=[
            {
                "name": name,
                "path": shown_name(run),
                "verdict": line,
                "reasons": one.reasons,
                "kind": {True: "good", False: "bad", None: ""}[one.success],
            }
            for name, run, one, line in zip(
                comparison.names,
                comparison.runs,
                comparison.metrics,
                comparison.lines[0].values,
                strict=True,
            )
        ],
        remarks=comparison.remarks,
        differences=(
            [
                Column("", text=True),
                *(Column(name, text=True) for name in comparison.names),
            ],
            [
                [Cell(one.name), *map(Cell, one.values)]
                for one in comparison.shown_differences
            ],
        ),
        more_differences=len(comparison.differences)
        - len(comparison.shown_differences),
        keys=[
            {"name": name, "tag": run_tag(index), "line": RUNS[index % len(RUNS)]}
            for index, name in enumerate(comparison.names)
        ],
        columns=columns,
        lines={
            name: [_cells(line, joined=True) for line in lines]
            for name, lines in (
                ("matter", matter),
                ("alike", alike),
                ("machine", comparison.machine),
            )
        },
        crossings=[[_cells(line, joined=True) for line in lines] for lines in shown],
        more=len(comparison.crossings) - len(shown),
        footer=(
            "Made by dextar compare. Δ: difference to the first run. All numbers stand"
            " in comparison.json beside this page."
        ),
    )


def by_matter(
    lines: Sequence[ComparisonRow],
) -> tuple[list[ComparisonRow], list[ComparisonRow]]:
    """Part what the runs differ in, the most first, from what they agree in."""
    differ = sorted(
        (line for line in lines if line.matter >= MATTERS),
        key=lambda line: -line.matter,
    )
    return differ, [line for line in lines if line.matter < MATTERS]


def overlaid(comparison: Comparison) -> list[Panel]:
    """Lay the runs' measured curves over each other: each motor's torque, error,
    residual and s. The kind of a curve is its run's number.

    Error and s are the true ones where every run holds them, else the estimated ones of
    all; the label says which.
    """
    shown = [
        panels(run, one)
        for run, one in zip(comparison.runs, comparison.metrics, strict=True)
    ]
    found: dict[str, Panel] = {}
    for index, (name, own) in enumerate(zip(comparison.names, shown, strict=True)):
        for panel in own:
            kind = _kind(panel.key, shown)
            for curve in (curve for curve in panel.curves if curve.kind == kind):
                key = panel.key
                label = TRUE_OR_ESTIMATED.get(key, panel.label).format(kind)
                if key == "torque":
                    key, label = f"torque{curve.part}", f"τ{curve.part + 1} (N m)"
                before = found.get(key, Panel(key, label, [], panel.low, panel.high))
                found[key] = before._replace(
                    curves=[
                        *before.curves,
                        Curve(name, curve.time, curve.values, str(index)),
                    ],
                    low=_widest(min, before.low, panel.low),
                    high=_widest(max, before.high, panel.high),
                )
    if "error" in found:
        found["error"] = found["error"]._replace(
            high=error_height(found["error"].curves)
        )
    torques = sorted(key for key in found if key.startswith("torque"))
    ordered = [found[key] for key in (*torques, "error", "residual", "s")]
    return [panel._replace(note=beyond(panel)) for panel in ordered]


def summary_table(comparison: Comparison, width: int = 80) -> Table:
    """Make the comparison a table for a terminal of ``width`` columns, with the
    differences where there is room for them.
    """
    table = _table(comparison, differences=True)
    console = Terminal(width=10 * width)
    return (
        table
        if Measurement.get(console, console.options, table).maximum <= width
        else _table(comparison, differences=False)
    )


def _table(comparison: Comparison, differences: bool) -> Table:
    keys = [
        f"{number}: {name}" for number, name in enumerate(comparison.names, start=1)
    ]
    table = Table(
        title=title(*keys, *(["Δ: difference to 1"] if differences else [])),
        title_justify="left",
    )
    table.add_column("", no_wrap=True)
    for index in range(len(comparison.names)):
        table.add_column(str(index + 1), justify="right", overflow="fold")
        if index and differences:
            table.add_column("Δ", justify="right", no_wrap=True)
    step = 1 if differences else 2
    for line in (*comparison.lines, *comparison.machine):
        name, first, *others = (cell.text for cell in _cells(line, joined=True))
        table.add_row(name, first, *others[::step])
    return table


def name_runs(
    runs: Sequence[Run], metrics: Sequence[Metrics], differences: Sequence[Difference]
) -> list[str]:
    """Give the runs short names that differ: by law and estimator, by whether the truth
    is known, by what else differs, by folder, or by number.
    """
    folders = [run.path.absolute().parent.name for run in runs]
    names = [
        run.record.get("name", "")
        or (
            f"{one.law or 'law unknown'} / {one.estimator or 'estimator unknown'}"
            if one.law or one.estimator
            else folder
        )
        for run, one, folder in zip(runs, metrics, folders, strict=True)
    ]
    told = [
        [f"{one.name.partition('.')[2]} {value}" for value in one.values]
        for one in differences
        if one.parameter
    ][:WAYS_TO_NAME]
    # what may stand behind each name, per way
    behind: list[list[list[str]]] = [
        [[] for _ in runs],
        [["simulation" if run.truth else "no truth"] for run in runs],
        *(
            [[words[row] for words in told[:count]] for row in range(len(runs))]
            for count in range(1, len(told) + 1)
        ),
        [
            [folder] * (folder != name)
            for name, folder in zip(names, folders, strict=True)
        ],
        [[str(number)] for number in range(1, len(runs) + 1)],
    ]
    ways = (
        [", ".join([name, *more]) for name, more in zip(names, way, strict=True)]
        for way in behind
    )
    return next(way for way in ways if len(set(way)) == len(way))


def _remarks(
    names: Sequence[str], runs: Sequence[Run], metrics: Sequence[Metrics]
) -> list[str]:
    remarks = [
        f"{name}: no true motion in the bag; what needs it is marked."
        for name, run in zip(names, runs, strict=True)
        if run.truth is None
    ]
    if remarks and len(remarks) < len(runs):
        remarks.append(
            "Error, s and path are drawn as estimated for all runs, for not every bag"
            " holds the true ones. |s| < 0.1 goes by the true s where the bag holds it,"
            " else by the estimated one."
        )
    for name, one in zip(names, metrics, strict=True):
        untracked = "no trajectory was tracked; it has no curves"
        told = [
            *[untracked] * (one.start_stamp is None),
            *damage_lines(one.holes, one.truncated, one.unreadable),
            clock_in_words(one.stamp_steps, one.clock_steps),
        ]
        remarks += [f"{name}: {text}." for text in told if text]
    if len({run.robot for run in runs if run.robot is not None}) > 1:
        remarks.append("The runs have different robots.")
    counts = [len(one.crossings) for one in metrics]
    if len(set(counts)) > 1:
        planned = ", ".join(
            f"{name}: {count}" for name, count in zip(names, counts, strict=True)
        )
        first = (
            f"the first {min(counts)} one by one" if min(counts) else "none one by one"
        )
        remarks.append(
            f"The numbers of planned crossings differ ({planned}); compared are"
            f" {first}."
        )
    elif any(
        abs(a.planned_time - b.planned_time) > 1e-3
        for other in metrics[1:]
        for a, b in zip(metrics[0].crossings, other.crossings, strict=True)
    ):
        remarks.append(
            "The plans differ: their crossings are not at the same instants."
        )
    return remarks


def _checked(metrics: Metrics) -> list[bool | None]:
    """Return of each verdict whether it is right; undecided ones do not count."""
    return [
        crossing.verdict_correct
        for crossing in metrics.crossings
        if crossing.verdict in DECIDED
    ]


def _planned(metrics: Metrics, count: int | None) -> int | None:
    return count if math.isfinite(metrics.planned_peak_torque) else None


def _count(values: Sequence[bool | None]) -> int | None:
    return None if None in values else sum(map(bool, values))


def _line(
    compared: Compared[Measured], of: Sequence[Measured], truths: Sequence[bool]
) -> ComparisonRow:
    metric = compared.metric
    lacking = [metric.truth and not known for known in truths]
    values = [
        None if lacks else compared.of(one)
        for one, lacks in zip(of, lacking, strict=True)
    ]
    values = [
        None if isinstance(value, float) and not math.isfinite(value) else value
        for value in values
    ]
    first = values[0]
    differences = [
        (
            value - first
            if isinstance(value, (int, float)) and isinstance(first, (int, float))
            else None
        )
        for value in values[1:]
    ]
    missing = [NO_TRUTH if lacks else "-" for lacks in lacking]
    return ComparisonRow(metric, values, differences, missing)


def _entry(line: ComparisonRow) -> dict[str, object]:
    return {
        "name": line.metric.name,
        "unit": line.metric.shown_unit,
        "values": line.values,
        "differences": line.differences,
        "truth": line.metric.truth,
    }


def _cells(line: ComparisonRow, joined: bool = False) -> list[Cell]:
    """Make cells of name, unit, and each run's value with its difference; name and unit
    share one where they are joined.
    """
    name, unit, form = line.metric.name, line.metric.shown_unit, line.metric.form
    shown = f"{name} ({unit})" if unit not in ("", "1") else name
    cells = [Cell(shown)] if joined else [Cell(name), Cell(unit)]
    for index, value in enumerate(line.values):
        missing = line.missing[index]
        known = value if isinstance(value, str) else number(value, form, missing)
        cells.append(Cell(known))
        if index:
            difference = line.differences[index - 1]
            cells.append(Cell("" if difference is None else signed(difference, form)))
    return cells


def _markdown(comparison: Comparison, lines: Sequence[ComparisonRow]) -> list[str]:
    head = ["", "unit"]
    for index, name in enumerate(comparison.names):
        head += [name, "Δ"] if index else [name]
    return _rows(
        head, [[cell.text for cell in _cells(line)] for line in lines], numbers_from=2
    )


def _rows(
    head: Sequence[str], rows: Sequence[Sequence[str]], numbers_from: int = 1000
) -> list[str]:
    marks = ["---:" if column >= numbers_from else "---" for column in range(len(head))]
    return [
        f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |"
        for row in (head, marks, *rows)
    ]


def _kind(key: str, shown: Sequence[Sequence[Panel]]) -> str:
    """Choose the kind of curve that every run with this panel holds."""
    if key not in TRUE_OR_ESTIMATED:
        return {"torque": "commanded", "residual": "seen"}[key]
    own = [panel for run in shown for panel in run if panel.key == key]
    return (
        "true"
        if all(any(curve.kind == "true" for curve in panel.curves) for panel in own)
        else "estimated"
    )


def _widest(pick: Callable[[float, float], float], one: float, other: float) -> float:
    return pick(one, other) if math.isfinite(one) and math.isfinite(other) else math.nan
