"""What a run's figures show over time: curves with their units, for paper, page and
comparison alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dextar_control.analysis.metrics import Metrics
from dextar_control.analysis.run import Floats, Run, rows_between, seconds
from dextar_control.analysis.tracking import Tracked, plan_of, tracked
from dextar_control.contract import style
from dextar_control.contract.errors import DextarError
from dextar_control.contract.robot import JOINT_NAMES
from dextar_control.planning.certificate import Certificate

HEADROOM = 1.25  # of the torque axis over the larger of plan and command
MOST_TORQUE = 3.0  # of the plan's peak, to which the axis reaches at most
MOST_RESIDUAL = 3.0  # the same for the criterion's residual
ERROR_CEILING = 10.0  # mm
TOGETHER = 20  # squares of innovations that are drawn as their mean
MANY = 4  # crossings; of more, each is shown by itself beside their mean
BESIDE = 3.0  # of a crossing's time within |s| < 0.1, shown before and after it
AROUND = 81  # points of a curve around a crossing
MOST_AROUND = 24  # crossings that are shown so


class Curve(NamedTuple):
    """A quantity over time, as one curve.

    Attributes:
        name: what it shows, as in a legend.
        time, values: (n,) s since the trajectory's start, and in the panel's unit.
        kind: commanded, planned, true, estimated, seen, confidence: how it is drawn.
        part: 0 for the first or only motor, 1 for the second.
    """

    name: str
    time: Floats
    values: Floats
    kind: str
    part: int = 0


class Panel(NamedTuple):
    """Curves that share an axis.

    Attributes:
        key: torque, error, residual or s.
        label: of the axis, with its unit.
        curves: in drawing order.
        low, high: of the axis; nan where the curves decide.
        note: what is missing and why; "" when nothing is.
        limit: which the values keep on either side, in the panel's unit; nan where
            there is none.
    """

    key: str
    label: str
    curves: list[Curve]
    low: float
    high: float
    note: str = ""
    limit: float = math.nan


class Around(NamedTuple):
    """A quantity about each crossing, as one curve each.

    Attributes:
        label: what it is, with its unit.
        time: (n,) s since the planned crossing.
        each: (n,) of each of the first MOST_AROUND crossings, in the label's unit; nan
            where nothing is known.
        mean: (n,) of all crossings.
        high: of the axis, which begins at 0.
    """

    label: str
    time: Floats
    each: list[Floats]
    mean: Floats
    high: float


def checked_plan(run: Run) -> Certificate | None:
    """Compute the plan; None where there is none or it cannot be computed, for which
    the metrics' reasons say why.
    """
    try:
        return plan_of(run)
    except DextarError:
        return None


def panels(run: Run, metrics: Metrics) -> list[Panel]:
    """Collect torques, tracking error, residual of the criterion and s over time;
    nothing where no trajectory was tracked.
    """
    track = tracked(run)
    if track is None:
        return []
    plan = checked_plan(run)
    return [
        _torque(run, metrics, track, plan),
        _error(run, track),
        _residual(run, track, plan),
        _singularity(run, track, plan),
    ]


def around(run: Run, metrics: Metrics) -> list[Around]:
    """Collect the largest torque and the error about each crossing of a run that has
    many of them. Both have no sign, so that they have a mean.
    """
    track, plan = tracked(run), checked_plan(run)
    if track is None or plan is None or len(metrics.crossings) <= MANY:
        return []
    instants = np.array([crossing.planned_time for crossing in metrics.crossings])
    least = 0.5 * float(np.diff(instants).min())
    width = min(
        BESIDE * float(np.median([crossing.near_time for crossing in plan.crossings])),
        max(least, 5e-3),
    )
    time = np.linspace(-width, width, AROUND)
    true = len(track.true_error) > 0
    error = (
        (track.true_time, 1e3 * track.true_error)
        if true
        else (track.time, 1e3 * track.estimated_error)
    )
    found = []
    for label, (clock, values) in (
        ("largest torque (N m)", (track.torque_time, np.abs(track.torque).max(axis=1))),
        (f"{'true' if true else 'estimated'} error (mm)", error),
    ):
        each = (
            [
                np.interp(instant + time, clock, values, math.nan, math.nan)
                for instant in instants
            ]
            if len(clock)
            else []
        )
        known = np.array([own for own in each if np.isfinite(own).any()])
        if len(known):
            high = 1.1 * max(float(np.nanmax(known)), 1e-6)
            counts = np.maximum(np.isfinite(known).sum(axis=0), 1)
            found.append(
                Around(
                    label,
                    time,
                    each[:MOST_AROUND],
                    np.nansum(known, axis=0) / counts,
                    high,
                )
            )
    return found


def observer_panels(run: Run, metrics: Metrics) -> list[Panel]:
    """Collect what the observer says that the model lacks, and its innovations beside
    what they should be; nothing where the bag does not tell.
    """
    track = tracked(run)
    found = metrics.margins
    if track is None or found.innovation is None:
        return []
    time = seconds(run.criterion.stamps - track.start)
    inside = _inside(time, track)
    panels = []
    if found.disturbance:
        torques = 1e3 * run.criterion.disturbance[inside]
        curves = [
            Curve(f"joint {name}", time[inside], torques[:, part], "commanded", part)
            for part, name in enumerate(JOINT_NAMES)
        ]
        panels.append(
            Panel("disturbance", style.label("disturbance"), curves, math.nan, math.nan)
        )
    square = np.convolve(
        run.criterion.innovation_square[inside],
        np.full(TOGETHER, 1.0 / TOGETHER),
        "same",
    )
    expected = Curve(
        "as its noise has it",
        track.time[[0, -1]],
        np.full(2, found.innovation.expected),
        "planned",
    )
    curves = [
        expected,
        Curve(f"mean of {TOGETHER} samples", time[inside], square, "seen"),
    ]
    return [
        *panels,
        Panel("innovation", style.label("innovation"), curves, math.nan, math.nan),
    ]


def _torque(
    run: Run, metrics: Metrics, track: Tracked, plan: Certificate | None
) -> Panel:
    drawn = [("commanded", track.torque_time, track.torque)]
    if plan is not None:
        drawn.insert(0, ("planned", plan.profile.time, plan.profile.torque))
    curves = [
        Curve(f"τ{part + 1} {kind}", time, torque[:, part], kind, part)
        for part in range(track.torque.shape[1])
        for kind, time, torque in drawn
    ]
    high = math.nan
    planned, found = metrics.planned_peak_torque, metrics.peak_torque
    if math.isfinite(planned) and math.isfinite(found):
        high = HEADROOM * min(max(planned, found), max(MOST_TORQUE * planned, 1e-6))
    limit = run.robot.max_torque if run.robot is not None else math.nan
    return _noted(
        Panel(
            "torque",
            style.label("torque"),
            curves,
            -high,
            high,
            "" if plan else "no plan to compare with",
            limit,
        )
    )


def _error(run: Run, track: Tracked) -> Panel:
    curves = [Curve("estimated", track.time, 1e3 * track.estimated_error, "estimated")]
    if len(track.true_error):
        shown = _inside(track.true_time, track)
        curves.append(
            Curve("true", track.true_time[shown], 1e3 * track.true_error[shown], "true")
        )
    note = (
        ""
        if run.truth is not None
        else "the true error needs the true motion, which this bag does not hold"
    )
    return _noted(
        Panel("error", style.label("error"), curves, 0.0, error_height(curves), note)
    )


def error_height(curves: Sequence[Curve]) -> float:
    """Return the upper end of an axis for curves of errors, mm."""
    together = np.concatenate([curve.values for curve in curves])
    finite = together[np.isfinite(together)]
    return 1.15 * min(
        max(float(finite.max()) if finite.size else 0.0, 1e-2), ERROR_CEILING
    )


def beyond(panel: Panel) -> str:
    """Say how far measured curves go where the axis does not follow them; return ""
    where it shows all of them.
    """
    if not math.isfinite(panel.high):
        return ""
    found = []
    for curve in panel.curves:
        finite = curve.values[np.isfinite(curve.values)]
        if finite.size and (finite.min() < panel.low or finite.max() > panel.high):
            found.append(f"{curve.name} from {finite.min():.3g} to {finite.max():.3g}")
    return f"curves that leave the axis: {', '.join(found)}" if found else ""


def _noted(panel: Panel) -> Panel:
    return panel._replace(
        note="; ".join(note for note in (panel.note, beyond(panel)) if note)
    )


def _inside(time: Floats, track: Tracked) -> slice[int, int, None]:
    return rows_between(time, track.time[0], track.time[-1] + 1e-9)


def _residual(run: Run, track: Tracked, plan: Certificate | None) -> Panel:
    time = seconds(run.criterion.stamps - track.start)
    inside = _inside(time, track)
    seen = run.criterion.residual[inside]
    curves = [Curve("seen by the controller", time[inside], seen, "seen")]
    low = high = math.nan
    if plan is not None:
        curves.insert(
            0, Curve("planned", plan.profile.time, plan.profile.residual, "planned")
        )
        ceiling = MOST_RESIDUAL * max(
            float(np.nanmax(np.abs(plan.profile.residual))), 1e-3
        )
        finite = np.concatenate([seen[np.isfinite(seen)], plan.profile.residual])
        low = 1.1 * max(float(finite.min()), -ceiling)
        high = 1.1 * min(float(finite.max()), ceiling)
    return _noted(Panel("residual", style.label("residual"), curves, low, high))


def _singularity(run: Run, track: Tracked, plan: Certificate | None) -> Panel:
    time = seconds(run.criterion.stamps - track.start)
    inside = _inside(time, track)
    curves = []
    confidence = run.criterion.mode_confidence[inside]
    if np.isfinite(confidence).any():
        curves.append(Curve("confidence", time[inside], confidence, "confidence"))
    if plan is not None:
        curves.append(Curve("planned", plan.profile.time, plan.profile.s, "planned"))
    curves.append(
        Curve("estimated", time[inside], run.criterion.s[inside], "estimated")
    )
    lacking = "robot description" if run.truth is not None else "true motion"
    note = f"the true s needs the {lacking}, which this bag does not hold"
    if len(track.true_s):
        shown = _inside(track.true_time, track)
        curves.append(
            Curve("true", track.true_time[shown], track.true_s[shown], "true")
        )
        note = ""
    return Panel("s", style.label("s"), curves, -1.05, 1.05, note)
