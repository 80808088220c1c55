"""One self-contained HTML page of a run: it opens offline, and its figures zoom.

``templates/figures.js`` draws them: the code of a plotting library (Bokeh's is 1.3 MB)
would be many times the rest of the page.
"""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from itertools import chain
from typing import NamedTuple, TypeVar

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from dextar_control.analysis.clock import clock_in_words
from dextar_control.analysis.crossings import (
    CROSSING_METRICS,
    CrossingMetrics,
    crossed_in_words,
)
from dextar_control.analysis.curves import around, checked_plan, observer_panels, panels
from dextar_control.analysis.differences import nodes_of, shown_name
from dextar_control.analysis.margins import LAGS, Innovation, Margin, Margins
from dextar_control.analysis.metrics import METRICS, Metrics, saturated
from dextar_control.analysis.plane import plane_of
from dextar_control.analysis.registry import number, signed
from dextar_control.analysis.run import Run, TopicCounts
from dextar_control.analysis.thin import POINTS
from dextar_control.analysis.timing import (
    Spread,
    lockstep,
    periods,
    round_trips,
    within,
)
from dextar_control.analysis.tracking import tracked
from dextar_control.analysis.web_figures import (
    WebFigure,
    histogram,
    in_plane,
    over_time,
    phase_band,
    residuals,
)
from dextar_control.analysis.web_figures import around as around_crossings
from dextar_control.bags.damage import (
    hole_in_words,
    missing_end_in_words,
    unreadable_lines,
)
from dextar_control.contract import style
from dextar_control.contract.former_names import former_names
from dextar_control.contract.node_parameters import parameters_of_node
from dextar_control.contract.topics import TOPICS
from dextar_control.contract.words import counted
from dextar_control.planning.certificate import NEAR_LOCUS, Certificate

T = TypeVar("T")
NO_TRUTH = "needs truth"
MOST_PLAN_LINES = 40  # crossings in the plan's table
TICK = 1.5e-3  # s
# correlation of successive innovations above which something is not modelled
LACKING = 0.5
WORDS = {
    True: ("good", "Success."),
    False: ("bad", "Failed."),
    None: ("", "Not decidable."),
}
# keys of the record that the page shows in places of their own
PRINTED = {
    "version",
    "versions",
    "started",
    "ended",
    "certificate",
    "parameters_missing",
    "parameter_changes",
    "name",
    "notes",
    "tags",
    "law",
    "estimator",
    "robot_description",
    "parameter_changes_not_listed",
}


class Column(NamedTuple):
    """The heading of a column of a table."""

    name: str
    unit: str = ""
    text: bool = False


class Cell(NamedTuple):
    """A cell of a table."""

    text: str
    bad: bool = False


def render_report(run: Run, metrics: Metrics) -> str:
    """Render the page of one run."""
    plane = plane_of(run, metrics)
    figures: dict[str, WebFigure] = {} if plane.empty else {"plane": in_plane([plane])}
    shown = panels(run, metrics)
    duration = metrics.length
    instants = [crossing.planned_time for crossing in metrics.crossings]
    many = around(run, metrics)
    outcomes = [one.outcome or one.verdict or "" for one in metrics.crossings]
    for name, drawn in (
        ("time", over_time(shown, instants, duration)),
        ("timing", _timing_figures(run)),
        ("phases", [phase_band(metrics.phases)] if metrics.phases else []),
        (
            "observed",
            chain.from_iterable(
                over_time([panel], instants, duration)
                for panel in observer_panels(run, metrics)
            ),
        ),
        *(
            (f"around{index}", around_crossings(one, outcomes))
            for index, one in enumerate(many)
        ),
    ):
        figures |= {f"{name}-{index}": one for index, one in enumerate(drawn)}
    if (found := metrics.margins.innovation) is not None:
        figures["observed-white"] = residuals(
            np.array(found.correlations),
            np.full(len(found.correlations), 0.5 * found.bound),
            np.ones(len(found.correlations), dtype=bool),
            "correlation of the innovation (1)",
            "samples between",
        )
    plan = checked_plan(run)
    most = max(
        (len(curve.time) for panel in shown for curve in panel.curves), default=0
    )
    return render(
        "report.html",
        figures,
        title=(
            f"{metrics.robot or 'run'}: {metrics.law or 'law unknown'},"
            f" {verdict(metrics)['word']}"
        ),
        heading=(
            f"{metrics.robot or 'robot unknown'}: law {metrics.law or 'unknown'},"
            f" estimator {metrics.estimator or 'unknown'}"
        ),
        subheading=_subheading(run),
        verdict=verdict(metrics),
        tiles=_tiles(metrics),
        around=[
            {
                "label": one.label,
                "drawn": [key for key in figures if key.startswith(f"around{index}-")],
            }
            for index, one in enumerate(many)
        ],
        around_width=f"{1e3 * many[0].time[-1]:.0f} ms" if many else "",
        thinned=(
            f"Drawn are the extremes of {1e3 * 2 * duration / POINTS:.0f} ms bins and,"
            " about each crossing, every sample as far as there is room; the numbers"
            " below use every sample."
            if most > POINTS
            else ""
        ),
        notes=[f"{panel.label}: {panel.note}" for panel in shown if panel.note],
        margins=_margins(metrics.margins),
        crossings=_crossings(run, metrics),
        timing=_timing(metrics),
        recording=_recording(run),
        plan=_plan(run, plan),
        no_plan=next(
            (reason for reason in metrics.reasons if "plan" in reason),
            "The bag holds no trajectory.",
        ),
        versions=_versions(run),
        nodes=nodes_of(run),
        changes=_changes(run),
        footer=(
            f"Made by dextar analyze from {run.path.name}. Times are seconds since the"
            " trajectory's start unless said otherwise; all numbers stand in"
            " metrics.json beside this page."
        ),
    )


def render(template: str, figures: Mapping[str, WebFigure], **values: object) -> str:
    """Render a page with its figures, which it refers to by their names. The filter
    ``symbols`` typesets the symbols in its texts.
    """
    environment = Environment(
        loader=PackageLoader("dextar_control.analysis"),
        autoescape=select_autoescape(),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["symbols"] = lambda text: Markup(style.html(text))
    numbers = Markup(
        json.dumps(figures, allow_nan=False, separators=(",", ":")).replace(
            "<", "\\u003c"
        )
    )
    page = environment.get_template(template).render(
        figures=list(figures), numbers=numbers, colors=Markup(style.css()), **values
    )
    return f"{page}\n"


def verdict(metrics: Metrics) -> dict[str, object]:
    """Tell how a run went: in a word, in a sentence, and with the reasons."""
    kind, word = WORDS[metrics.success]
    planned = len(metrics.crossings)
    parts = []
    noun = "planned crossing" if planned == 1 else "planned crossings"
    if planned and (crossed := crossed_in_words(metrics.crossings, noun)):
        parts.append(f"Crossed {crossed}")
    elif planned:
        said = sum(crossing.verdict == "crossed" for crossing in metrics.crossings)
        parts.append(
            f"{counted(planned, 'planned crossing')}, {said} crossed by the estimator's"
            " own verdict"
        )
    if math.isfinite(metrics.max_true_error):
        largest, last = map(metrics.shown, ("max_true_error", "final_true_error"))
        parts.append(f"true error {largest} at most and {last} at the end")
    elif math.isfinite(metrics.max_estimated_error):
        parts.append(f"estimated error {metrics.shown('max_estimated_error')} at most")
    if math.isfinite(metrics.peak_torque):
        ratio = number(metrics.torque_ratio, ".2f", "")
        of_plan = f", {ratio} × the plan's" if ratio else ""
        parts.append(f"peak torque {metrics.shown('peak_torque')}{of_plan}")
    if saturated(metrics).isdigit():
        parts.append(
            f"{counted(metrics.saturated, 'command')} saturated"
            if metrics.saturated
            else "no command saturated"
        )
    reasons = list(metrics.reasons)
    reasons += [
        hole_in_words(hole)
        for hole in metrics.holes
        if not any(hole_in_words(hole) in reason for reason in reasons)
    ]
    if metrics.truncated:
        reasons.append(f"{missing_end_in_words()}.".capitalize())
    sentence = "; ".join(parts)
    sentence = f"{sentence[:1].upper()}{sentence[1:]}." if parts else ""
    return {"kind": kind, "word": word, "sentence": sentence, "reasons": reasons}


def _tiles(metrics: Metrics) -> list[dict[str, str]]:
    verdicts = [
        crossing.verdict_correct
        for crossing in metrics.crossings
        if crossing.verdict in ("crossed", "bounced")
    ]
    checked = [right for right in verdicts if right is not None]
    right = f"{sum(checked)} of {len(checked)} right" if checked else NO_TRUTH
    lost = sum(count or 0 for count in metrics.lost.values())
    if metrics.crossings:
        happened = crossed_in_words(metrics.crossings) or NO_TRUTH
    else:
        happened = "none" if math.isfinite(metrics.planned_peak_torque) else "no plan"
    pairs = [
        ("planned crossings crossed", happened),
        ("estimator's verdicts", right if verdicts else "none"),
    ]
    for name, missing in (
        ("max_true_error", NO_TRUTH),
        ("rms_true_error", NO_TRUTH),
        ("final_true_error", NO_TRUTH),
        ("max_estimated_error", "not recorded"),
        ("peak_torque", "not recorded"),
        ("torque_ratio", "no plan"),
        ("torque_ratio_near", "no plan"),
        ("duration", "no plan"),
    ):
        pairs.append((METRICS[name].name, metrics.shown(name, missing)))
    counted_lost = f"{lost}{', end unknown' * metrics.truncated}"
    pairs += [
        (METRICS["missed"].name, f"{metrics.missed} of {metrics.states}"),
        (METRICS["lost"].name, counted_lost if metrics.lost else "not counted"),
    ]
    return [{"name": name, "value": value} for name, value in pairs]


def _margins(margins: Margins) -> dict[str, object]:
    """Show limits as bars, the nearest first, and what the observer says of itself."""
    rows = [
        {
            "name": one.name.replace("_", " "),
            "what": one.what,
            "width": f"{100.0 * min(max(one.share, 0.0), 1.0):.1f}",
            "share": f"{100.0 * one.share:.3g} %",
            "bad": _passed(one),
            "told": _margin_in_words(one),
        }
        for one in margins.limits
    ]
    tiles = [
        {
            "name": "least confidence outside of crossings",
            "value": number(margins.least_confidence, ".5f", "not recorded"),
        }
    ]
    for name, values, scale, unit in (
        (
            "torque that the model lacks, largest at each joint",
            margins.disturbance,
            1e3,
            "mN m",
        ),
        ("angle by a wrong geometry, largest at each joint", margins.bias, 1e3, "mrad"),
    ):
        shown = ", ".join(f"{scale * value:.2g}" for value in values)
        tiles.append(
            {"name": name, "value": f"{shown} {unit}" if values else "not told"}
        )
    if (found := margins.innovation) is not None:
        tiles += [
            {
                "name": f"square of the innovation, mean; {found.expected:g} if right",
                "value": f"{found.square:.3g}",
            },
            {
                "name": "correlation with the next sample",
                "value": f"{found.correlation:+.2f}",
            },
            {
                "name": "scatter of the samples",
                "value": f"{1e6 * found.scatter:.3g} µrad",
            },
        ]
    return {
        "rows": rows,
        "unknown": margins.unknown,
        "tiles": tiles,
        "innovation": found and _innovation_in_words(found),
    }


def _passed(margin: Margin) -> bool:
    """Tell whether a limit was passed for longer than allowed; the tick at which a
    motion ends is no longer one under the law.
    """
    return (
        margin.share >= 1.0
        and margin.lasted >= margin.allowed - TICK
        and not margin.note
    )


def _margin_in_words(margin: Margin) -> str:
    value = number(margin.value, ".3g", "unknown")
    unit = f" {margin.unit}" if margin.unit not in ("", "1") else ""
    text = f"{value} of {margin.limit:.3g}{unit}"
    if margin.name == "locus":
        text = f"{value}, at least {margin.limit:.3g}"
    elif margin.name == "joint_range" and margin.value < 0.0:
        text = (
            f"inside by {-margin.value:.3g}{unit}, {margin.limit:.3g}{unit} beyond is"
            " the limit"
        )
    if margin.lasted > 0.0:
        text += (
            f", passed for {1e3 * margin.lasted:.3g} of {1e3 * margin.allowed:.3g} ms"
        )
    if math.isfinite(margin.time):
        text += (
            f"; at {margin.time:.3f} s, |s| = {number(abs(margin.s), '.2f', 'unknown')}"
        )
    return f"{text}; {margin.note}" if margin.note else text


def _innovation_in_words(found: Innovation) -> str:
    """Say whether the observer errs as it believes."""
    if found.square > found.high:
        said = (
            "it trusts its model more than this robot bears: something that it does not"
            " know acts on the robot"
        )
    elif found.square < found.low:
        said = (
            "it is told of more noise than there is, which costs precision and bears"
            " what the model lacks"
        )
    else:
        said = "it errs as it believes"
    white = (
        "innovations of successive samples hang together no more than noise does"
        if abs(found.correlation) < found.bound
        else (
            "innovations hang together over"
            f" {counted(found.correlated, 'sample')}"
            f"{' or more' * (found.correlated == LAGS)}"
        )
        + (
            ": what the model lacks shows in them"
            if found.correlation > LACKING
            else ""
        )
    )
    return (
        "The observer's innovation (the joints less those that it expected,"
        f" {1e6 * found.rms:.3g} µrad RMS) has a normalised square of"
        f" {found.square:.3g} on average over {found.samples} samples; {found.low:.2f}"
        f" to {found.high:.2f} would be right: {said}. Its {white} (95 % of white noise"
        f" within ±{found.bound:.3f})."
    )


def _seen(has_truth: bool) -> tuple[str, ...]:
    """Name a crossing's numbers that the controller saw, as the table shows them."""
    kind = "" if has_truth else "estimated_"
    at_crossing = f"{kind}speed", "residual", "sigma_min"
    return (
        *at_crossing,
        "peak_torque",
        "torque_step",
        *(f"{kind}error_{when}" for when in ("before", "after")),
    )


def _crossings(run: Run, metrics: Metrics) -> dict[str, object]:
    has_truth = run.truth is not None
    rows = [
        _crossing_row(
            index, crossing, has_truth, crossing.planned_time <= metrics.tracked_until
        )
        for index, crossing in enumerate(metrics.crossings, start=1)
    ]
    seen = [CROSSING_METRICS[name] for name in _seen(has_truth)]
    columns = [
        Column("no."),
        Column("planned", "s"),
        Column("true", "s"),
        Column("late by", "ms"),
        Column("outcome"),
        Column("estimator says"),
        Column("at", "s"),
        Column("confidence", "1"),
        Column("verdict is"),
        *(Column(metric.name, metric.shown_unit) for metric in seen),
    ]
    notes = [" ".join(f"{metric.name}: {metric.definition}" for metric in seen)]
    if not has_truth:
        notes.insert(
            0,
            "This bag holds no true motion: instant, outcome and the check of the"
            " verdict need it; errors and speed are the estimator's.",
        )
    return {
        "columns": columns,
        "rows": rows,
        "notes": notes,
        "empty": _no_crossings(metrics),
        "places": _crossed_places(metrics, has_truth),
    }


def _crossed_places(
    metrics: Metrics, has_truth: bool
) -> tuple[list[Column], list[list[Cell]]] | None:
    if not metrics.crossings:
        return None
    columns = [
        Column("crossing"),
        Column("place", "mm"),
        Column("crossed at", "s"),
        Column("outcome"),
        Column("estimator"),
    ]
    missing = "-" if has_truth else NO_TRUTH
    return columns, [
        [
            Cell(str(index)),
            Cell(", ".join(f"{1e3 * value:.1f}" for value in one.point)),
            Cell(number(one.true_time, ".3f", missing)),
            Cell(one.outcome or missing, one.outcome in ("bounced", "not reached")),
            Cell(one.verdict or "not recorded", one.verdict_correct is False),
        ]
        for index, one in enumerate(metrics.crossings, start=1)
    ]


def _no_crossings(metrics: Metrics) -> str:
    return next(
        (
            f"Not known: {reason}."
            for reason in metrics.reasons
            if math.isnan(metrics.planned_peak_torque)
        ),
        "The trajectory crosses no singularity.",
    )


def _crossing_row(
    index: int, crossing: CrossingMetrics, has_truth: bool, reached: bool
) -> list[Cell]:
    missing = "-" if has_truth else NO_TRUTH
    late = missing
    if crossing.true_time is not None:
        late = signed(1e3 * (crossing.true_time - crossing.planned_time), ".2f")
    unknown = "-" if has_truth or not crossing.verdict else NO_TRUTH
    right = {True: "right", False: "WRONG", None: unknown}[crossing.verdict_correct]
    # what was seen at the crossing is its own only where tracking reached it
    seen = [
        Cell(
            CROSSING_METRICS[name].number(
                getattr(crossing, name) if reached or column > 2 else None
            )
        )
        for column, name in enumerate(_seen(has_truth))
    ]
    return [
        Cell(str(index)),
        Cell(f"{crossing.planned_time:.4f}"),
        Cell(number(crossing.true_time, ".4f", missing)),
        Cell(late),
        Cell(
            crossing.outcome or missing, crossing.outcome in ("bounced", "not reached")
        ),
        Cell(crossing.verdict or "not recorded"),
        Cell(number(crossing.verdict_time, ".4f")),
        Cell(number(crossing.verdict_confidence, ".4f")),
        Cell(right, right == "WRONG"),
        *seen,
    ]


TIMING_COLUMNS = (
    Column("", text=True),
    Column("count"),
    Column("median", "µs"),
    Column("95\u00a0%", "µs"),
    Column("99\u00a0%", "µs"),
    Column("largest", "µs"),
    Column("standard deviation", "µs"),
    Column("rate, of the median", "Hz"),
)


def _timing(metrics: Metrics) -> dict[str, object]:
    timing = metrics.timing

    def row(name: str, spread: Spread, rate: bool) -> list[Cell]:
        numbers = (
            spread.median,
            spread.p95,
            spread.p99,
            spread.maximum,
            spread.deviation,
        )
        per_second = (
            number(1.0 / spread.median, ".0f") if rate and spread.median > 0.0 else ""
        )
        return [
            Cell(name),
            Cell(str(spread.count)),
            *(Cell(number(1e6 * value, ".0f")) for value in numbers),
            Cell(per_second),
        ]

    how = {
        True: (
            "Lockstep: the plant waited for each command, so these rates say how fast"
            " the simulation ran, and nothing about real time."
        ),
        False: "Real time.",
        None: "The bag does not say whether this was real time.",
    }[timing.lockstep]
    sampled = number(1e3 * timing.stamp_period, ".3f")
    misses = (
        f"States without a command of their stamp: {metrics.missed} of {metrics.states}"
    )
    if metrics.missed:
        misses += (
            f", in {counted(len(timing.missed_runs), 'gap')}, the longest of"
            f" {counted(timing.longest_miss, 'state')}"
        )
    late = (
        "As the plant counted over its whole run: steps without their command in time:"
        f" {metrics.late_ticks} of {metrics.plant_steps}; commands that came later:"
        f" {metrics.late_commands}."
        if metrics.late_ticks is not None
        else "No count of late commands by the plant is in the bag."
    )
    return {
        "sentence": (
            f"{how} By the system clock at publishing, not by the stamps, which are"
            f" {sampled} ms apart."
        ),
        "columns": TIMING_COLUMNS,
        "rows": [
            row("period of the states", timing.state_period, True),
            row("period of the commands", timing.command_period, True),
            row(
                "round trip, state published → its command published",
                timing.round_trip,
                False,
            ),
        ],
        "misses": f"{misses}. {late}",
    }


def _timing_figures(run: Run) -> list[WebFigure]:
    track = tracked(run)
    asked = run.states.stamps if track is None else within(run.states.stamps, track)
    drawn = []
    for values, label in (
        (periods(run.states, asked, run.holes), "period of the states (µs)"),
        (round_trips(run, asked)[1], "round trip (µs)"),
    ):
        if (values > 0.0).any():
            drawn.append(histogram(values, label))
    return drawn


def _recording(run: Run) -> dict[str, object]:
    rows = []
    for name, topic in sorted(run.topics.items()):
        count = run.losses.get(name)
        lost = dropped = "not counted"
        if count is not None:
            lost = "unknown" if count.get("lost") is None else str(count["lost"])
            dropped = str(count.get("dropped") or 0)
        rows.append(
            [
                Cell(name),
                Cell(topic.type),
                Cell(str(topic.count)),
                Cell(lost, lost not in ("0", "not counted", "unknown")),
                Cell(dropped, dropped not in ("0", "not counted")),
                *(Cell(number(rate, ".0f", "")) for rate in _rates(name, topic)),
            ]
        )
    began, ended = run.record.get("started", ""), run.record.get("ended", "")
    sentence = (
        f"Recorded from {_short(began)} to {_short(ended)} (UTC). "
        if began and ended
        else ""
    )
    told = [
        *map(hole_in_words, run.holes),
        *unreadable_lines(run.unreadable),
        clock_in_words(run.stamp_steps, run.clock_steps),
    ]
    sentence += "".join(f"{text[:1].upper()}{text[1:]}. " for text in told if text)
    if run.truncated:
        lost = f"{missing_end_in_words()}: what was lost after it is unknown. "
        sentence += lost.capitalize()
    if not run.losses:
        sentence += (
            "The bag was not written by this package's recorder: nobody counted its"
            " losses."
        )
    else:
        sentence += (
            "Lost: by the middleware's sequence numbers. Dropped: before the disk."
        )
    if lockstep(run):
        sentence += " In lockstep the mean rates are the simulation's own."
    columns = (
        Column("topic"),
        Column("type", text=True),
        Column("messages"),
        Column("lost"),
        Column("dropped"),
        Column("by contract", "Hz"),
        Column("mean, system clock", "Hz"),
    )
    return {"columns": columns, "rows": rows, "sentence": sentence}


def _rates(name: str, topic: TopicCounts) -> tuple[float | None, float | None]:
    """Return the nominal rate of a topic and its mean by the recorder's clock; None
    where the contract gives no single rate, because it comes in bursts.
    """
    longest = max(
        (own for own in TOPICS if f"/{name}".endswith(f"/{own.name.lstrip('/')}")),
        key=lambda own: len(own.name),
        default=None,
    )
    if longest is None or longest.type != topic.type:
        return None, None
    if longest.rate == 0.0 or longest.rate_text:
        return None, None
    span = (topic.last - topic.first + topic.fallen) * 1e-9
    return longest.rate, (topic.count - 1) / span if span > 0.0 else None


def _short(time: str) -> str:
    try:
        return (
            datetime.fromisoformat(time)
            .astimezone(timezone.utc)
            .strftime("%Y-%m-%d %H:%M:%S")
        )
    except ValueError:
        return time


def _subheading(run: Run) -> str:
    parts = [run.record["name"]] if run.record.get("name") else []
    parts += [shown_name(run), _short(run.record.get("started", ""))]
    simulated = run.truth is not None
    parts.append(
        "simulation: the true motion is in the bag"
        if simulated
        else "no true motion in the bag, as from a rig"
    )
    parts += [run.record[key] for key in ("notes", "tags") if run.record.get(key)]
    return " · ".join(part for part in parts if part)


def _versions(run: Run) -> list[tuple[str, str]]:
    recorded = {"dextar": run.version} | _parsed(run.record.get("versions", ""), dict)
    known = [
        (f"recorded with {name}", str(text)) for name, text in recorded.items() if text
    ] or [("recorded with", "unknown")]
    known += [
        (key, text)
        for key, text in sorted(run.record.items())
        if key not in PRINTED and 0 < len(text) < 200
    ]
    known += [("analysed with numpy", np.__version__)]
    return [*known, ("analysed with python", platform.python_version())]


def _parsed(text: str, kind: type[T]) -> T:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        value = None
    return value if isinstance(value, kind) else kind()


def _changes(run: Run) -> list[str]:
    track = tracked(run)
    zero = int(run.states.published[0])
    if track is not None:
        row = int(np.searchsorted(run.states.stamps, track.stamps[0]))
        zero = int(run.states.published[min(row, len(run.states.published) - 1)])
    lines = []
    for change in _parsed(run.record.get("parameter_changes", ""), list):
        try:
            moment = (int(change["time"]) - zero) * 1e-9
            name = change["name"]
            former = former_names(parameters_of_node(change["node"]))
            name = former.get(name, name)
            lines.append(
                f"{change['node']}.{name} was set to"
                f" {json.dumps(change['value'])} at {moment:+.3f} s"
            )
        except (AttributeError, KeyError, TypeError, ValueError):
            continue
    return lines


def _plan(run: Run, plan: Certificate | None) -> dict[str, object]:
    """Show extremes and crossings of the plan as computed anew, beside what was
    recorded of it and the robot's limits.
    """
    recorded = _parsed(run.record.get("certificate", ""), dict)
    crossings = recorded.get("crossings")
    listed = [
        one
        for one in (crossings if isinstance(crossings, list) else [])
        if isinstance(one, dict)
    ]
    rows = []
    names = "max_torque", "max_joint_speed", "max_platform_speed", "min_type1_distance"
    torque, speed, platform, type1 = (getattr(run.robot, name, None) for name in names)
    for name, words, unit, limit in (
        ("duration", "duration", "s", ""),
        ("peak_torque", "peak torque", "N m", number(torque, "g", "")),
        ("peak_torque_near", f"peak torque within |s| < {NEAR_LOCUS}", "N m", ""),
        ("peak_torque_rate", "peak torque rate", "N m/s", ""),
        ("peak_joint_speed", "peak joint speed", "rad/s", number(speed, "g", "")),
        (
            "peak_platform_speed",
            "peak platform speed",
            "m/s",
            number(platform, "g", ""),
        ),
        (
            "least_type1",
            "least distance to Type 1",
            "1",
            "" if type1 is None else f"at least {type1:g}",
        ),
    ):
        kept = recorded.get(name)
        texts = (
            number(getattr(plan, name, None), ".4g"),
            number(kept if isinstance(kept, (int, float)) else None, ".4g"),
        )
        rows.append([Cell(words), *map(Cell, texts), Cell(limit), Cell(unit)])
    columns = [
        Column("", text=True),
        Column("computed anew"),
        Column("recorded"),
        Column("limit"),
        Column("unit", text=True),
    ]
    text = ""
    if plan is not None and isinstance(recorded.get("peak_torque"), (int, float)):
        torque_gap = abs(plan.peak_torque - recorded["peak_torque"])
        gaps = [
            abs(one["time"] - time)
            for one, time in zip(listed, plan.crossing_times, strict=False)
            if isinstance(one.get("time"), (int, float))
        ]
        text = (
            f"Certificate recorded with the run: {counted(len(listed), 'crossing')}"
            f" listed; the plan computed anew differs by {torque_gap:.2g} N m in peak"
            " torque"
            + (
                f" and by at most {max(gaps):.2g} s in the instants of the crossings."
                if gaps
                else "."
            )
        )
    return {
        "table": (columns, rows) if plan is not None or recorded else None,
        "crossings": _planned_crossings(plan),
        "note": text,
        "more": max(len(plan.crossings) - MOST_PLAN_LINES, 0) if plan else 0,
    }


def _planned_crossings(
    plan: Certificate | None,
) -> tuple[list[Column], list[list[Cell]]] | None:
    if plan is None or not plan.crossings:
        return None
    columns = [
        Column("no."),
        Column("at", "s"),
        Column("locus", text=True),
        Column("to s"),
        Column("place", "mm"),
        Column("along t_s", "m/s"),
        Column(f"|s| < {NEAR_LOCUS}", "ms"),
        Column("|t_s·w_d|", "N"),
        Column("multiplier", "N/m"),
        Column("torque", plan.joint.effort_unit),
    ]

    def several(values: Sequence[float], form: str) -> Cell:
        return Cell(", ".join(format(value, form) for value in values))

    rows = [
        [
            Cell(str(index)),
            Cell(f"{one.time:.4f}"),
            Cell(one.family),
            Cell("> 0" if one.sign > 0 else "< 0"),
            several([1e3 * value for value in one.x], ".2f"),
            Cell(f"{one.speed:.3f}"),
            Cell(f"{1e3 * one.near_time:.0f}"),
            Cell(f"{one.residual:.1e}"),
            several(one.multipliers, ".3f"),
            several(one.torque, ".4f"),
        ]
        for index, one in enumerate(plan.crossings[:MOST_PLAN_LINES], start=1)
    ]
    return columns, rows
