"""Each planned crossing of a run: whether it happened, how, and what the estimator made
of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from dextar_control.analysis.registry import Metric, metrics_of
from dextar_control.analysis.run import Floats, Run, rows_between, seconds
from dextar_control.analysis.timing import recorded
from dextar_control.analysis.tracking import Tracked
from dextar_control.control.verdicts import OPEN_BEFORE, Verdict
from dextar_control.planning.certificate import NEAR_LOCUS, Certificate
from dextar_control.planning.checks import clear_times

STEP_ZONE = 0.15  # |s| within which torque steps are looked for
CROSSED, UNDECIDED, NOT_BEGUN = "crossed", "undecided", "not begun"  # verdicts
FRESH = 2e-3  # s after a crossing has begun from which on a verdict is its own


@dataclass(frozen=True)
class CrossingMetrics:
    """What is known of one planned crossing.

    A number that is not known is nan, or None where that is said.
    """

    planned_time: Annotated[
        float,
        Metric(
            "planned instant",
            "s",
            "Where s of the served trajectory (a quintic between its points that "
            "meets their positions, velocities and accelerations) changes sign; "
            "since the trajectory's start.",
            ".4f",
        ),
    ]
    planned_stamp: Annotated[
        int,
        Metric(
            "planned stamp",
            "ns",
            "The planned instant on the clock of the states' stamps.",
        ),
    ]
    point: Annotated[
        tuple[float, float],
        Metric(
            "place",
            "m",
            "Where the end effector is at the planned instant, by the plan.",
            ".1f",
            "mm",
        ),
    ]
    sign: Annotated[
        int,
        Metric("planned sign", "1", "The planned sign of s after the crossing.", "+d"),
    ]
    true_time: Annotated[
        float | None,
        Metric(
            "true instant",
            "s",
            "Where the true s, a straight line between its stamps, is zero, "
            "nearest to the planned instant; null where it is zero nowhere "
            "between the sides. s = r_1 x r_2 / (l_1 l_2), with r_i from elbow i, "
            "by the true active joints, to the true end effector and l_i the "
            "distal lengths.",
            ".4f",
            truth=True,
        ),
    ]
    crossed: Annotated[
        bool | None,
        Metric(
            "crossed",
            "",
            "Whether the true s has the other sign before and the planned sign "
            "after the crossing, each where the plan is clear of the locus; null "
            "without truth, or where it is not recorded.",
            truth=True,
        ),
    ]
    outcome: Annotated[
        str | None,
        Metric(
            "outcome",
            "",
            "What became of it: crossed; bounced (it has not crossed by the time "
            "the plan is clear of the locus); not reached (tracking ended "
            "before); not recorded (the bag breaks off before, or has a hole "
            "there); null without truth.",
            truth=True,
        ),
    ]
    estimated_mode: Annotated[
        int | None,
        Metric(
            "estimated assembly mode",
            "1",
            "The assembly mode, +1 or -1, that the controller took afterwards; "
            "null where it is not recorded.",
            "+d",
        ),
    ]
    verdict: Annotated[
        str | None,
        Metric(
            "estimator says",
            "",
            "The estimator's last verdict: crossed, bounced or undecided; not begun "
            "where tracking ended before; null where it is not recorded.",
        ),
    ]
    verdict_time: Annotated[
        float,
        Metric(
            "verdict at",
            "s",
            "When that verdict fell, since the trajectory's start; null while it "
            "is undecided or not begun, and where the bag has a hole before it.",
            ".4f",
        ),
    ]
    verdict_confidence: Annotated[
        float,
        Metric(
            "confidence",
            "1",
            "The confidence in the assembly mode that the verdict rests on; null "
            "while it is undecided or not begun.",
            ".4f",
        ),
    ]
    verdict_correct: Annotated[
        bool | None,
        Metric(
            "verdict is right",
            "",
            "Whether the verdict agrees with the true side at its instant; null "
            "without truth or verdict.",
            truth=True,
        ),
    ]
    speed: Annotated[
        float,
        Metric(
            "true speed",
            "m/s",
            "Speed of the end effector at the true instant; the estimated one "
            "without truth.",
            ".3f",
            truth=True,
        ),
    ]
    estimated_speed: Annotated[
        float,
        Metric(
            "estimated speed",
            "m/s",
            "Estimated speed of the end effector at the planned instant.",
            ".3f",
        ),
    ]
    residual: Annotated[
        float,
        Metric(
            "|t_s·w_d| seen",
            "N",
            "Magnitude of the criterion's residual t_s.w_d that the controller "
            "saw at the planned instant.",
            ".4f",
        ),
    ]
    planned_residual: Annotated[
        float, Metric("|t_s·w_d| planned", "N", "The same of the plan.", ".1e")
    ]
    sigma_min: Annotated[
        float,
        Metric(
            "smallest σ",
            "1",
            "Smallest singular value of A_r over the distal length that the "
            "controller saw while the plan was not clear of the locus.",
            ".4f",
        ),
    ]
    peak_torque: Annotated[
        float,
        Metric(
            "peak torque",
            "N m",
            "Largest magnitude of a commanded torque within |s| < 0.1 of this "
            "crossing.",
            ".4f",
        ),
    ]
    torque_step: Annotated[
        float,
        Metric(
            "torque step",
            "N m",
            "Largest change of a commanded torque from one tick to the next "
            "within |s| < 0.15 of this crossing.",
            ".4f",
        ),
    ]
    error_before: Annotated[
        float,
        Metric(
            "true error before",
            "m",
            "Largest true tracking error from where the plan leaves |s| >= 0.3 to "
            "the planned instant; null without truth.",
            ".3f",
            "mm",
            truth=True,
        ),
    ]
    error_after: Annotated[
        float,
        Metric(
            "true error after",
            "m",
            "Largest true tracking error from the planned instant to where the "
            "plan is at |s| >= 0.3 again; null without truth.",
            ".3f",
            "mm",
            truth=True,
        ),
    ]
    estimated_error_before: Annotated[
        float,
        Metric(
            "estimated error before",
            "m",
            "Largest estimated tracking error before the planned instant, from "
            "where the true one is taken.",
            ".3f",
            "mm",
        ),
    ]
    estimated_error_after: Annotated[
        float,
        Metric(
            "estimated error after",
            "m",
            "Largest estimated tracking error after the planned instant, as far "
            "as the true one is taken.",
            ".3f",
            "mm",
        ),
    ]


CROSSING_METRICS = metrics_of(CrossingMetrics)
"""Each number of a crossing by its place in ``metrics.json``."""


def judge_crossings(
    run: Run, plan: Certificate, track: Tracked
) -> list[CrossingMetrics]:
    """Judge every planned crossing, in order."""
    criterion_time = seconds(run.criterion.stamps - track.start)
    control_time = seconds(run.control.stamps - track.start)
    motion_time = (
        control_time if run.truth is None else seconds(run.truth.stamps - track.start)
    )
    times = criterion_time, control_time, motion_time
    return [
        _crossing(run, plan, track, index, *times)
        for index in range(len(plan.crossing_times))
    ]


def crossed_in_words(crossings: Sequence[CrossingMetrics], planned: str = "") -> str:
    """Say how many of the planned crossings were crossed, with a noun for these; return
    "" without truth.
    """
    if any(crossing.outcome is None for crossing in crossings):
        return ""
    missing = sum(crossing.crossed is None for crossing in crossings)
    text = (
        f"{sum(bool(crossing.crossed) for crossing in crossings)} of"
        f" {len(crossings)}{planned and f' {planned}'}"
    )
    return f"{text}, {missing} not recorded" if missing else text


def _crossing(
    run: Run,
    plan: Certificate,
    track: Tracked,
    index: int,
    criterion_time: Floats,
    control_time: Floats,
    motion_time: Floats,
) -> CrossingMetrics:
    planned = float(plan.crossing_times[index])
    sign = int(plan.crossing_signs[index])
    before, after = clear_times(plan, index)
    crossed = outcome = None
    lost = any(hole.meets(*_stamps(track, before, after)) for hole in run.holes)
    if len(track.true_s):
        sides = (
            value_at(track.true_time, track.true_s, before) * sign,
            value_at(track.true_time, track.true_s, after) * sign,
        )
        crossed = bool(sides[0] < 0.0 < sides[1] and planned <= track.time[-1])
        outcome = "not reached" if planned > track.time[-1] else "bounced"
        if crossed:
            outcome = "crossed"
        if lost or (run.truncated and after > track.time[-1]):
            crossed, outcome = None, "not recorded"
    moment = None if lost else _true_instant(track, planned, before, after)
    mode = value_at(criterion_time, run.criterion.assembly_mode, after)
    velocity = run.control.estimate_dot if run.truth is None else run.truth.x_dot
    instant = planned if moment is None else moment
    mine = _own_part(plan, track.torque_time, index)
    torque, distance = track.torque[mine], np.abs(track.torque_s[mine])
    zone = distance < STEP_ZONE
    verdict, verdict_time, confidence = _verdict(
        run, plan, track, criterion_time, index
    )
    # about the crossing, and thus not where the bag has a hole
    measured = {
        "speed": math.hypot(
            *(value_at(motion_time, axis, instant) for axis in velocity.T)
        ),
        "estimated_speed": math.hypot(
            *(
                value_at(control_time, axis, planned)
                for axis in run.control.estimate_dot.T
            )
        ),
        "residual": abs(value_at(criterion_time, run.criterion.residual, planned)),
        "sigma_min": -largest_between(
            criterion_time, -np.abs(run.criterion.sigma_min), before, after
        ),
        "peak_torque": largest(torque[distance < NEAR_LOCUS]),
        "torque_step": largest(np.abs(np.diff(torque, axis=0))[zone[1:] & zone[:-1]]),
    }
    for when, span in (("before", (before, planned)), ("after", (planned, after))):
        measured |= {
            f"error_{when}": largest_between(track.true_time, track.true_error, *span),
            f"estimated_error_{when}": largest_between(
                track.time, track.estimated_error, *span
            ),
        }
    return CrossingMetrics(
        planned_time=planned,
        planned_stamp=track.start + round(planned * 1e9),
        point=(
            float(plan.crossing_points[index][0]),
            float(plan.crossing_points[index][1]),
        ),
        sign=sign,
        true_time=moment,
        crossed=crossed,
        outcome=outcome,
        estimated_mode=int(mode) if math.isfinite(mode) else None,
        verdict=verdict,
        verdict_time=verdict_time,
        verdict_confidence=confidence,
        verdict_correct=_correct(track, verdict, verdict_time, sign),
        planned_residual=float(abs(plan.residuals[index])),
        **(dict.fromkeys(measured, math.nan) if lost else measured),
    )


def _stamps(track: Tracked, first: float, last: float) -> tuple[float, float]:
    return track.start + 1e9 * first, track.start + 1e9 * last


def _verdict(
    run: Run, plan: Certificate, track: Tracked, time: Floats, index: int
) -> tuple[str | None, float, float]:
    """Find (last verdict, when it fell, confidence) on one crossing; after the last one
    the controller judged until the run ends.
    """
    verdicts = run.criterion.verdict
    if len(verdicts) == 0 or (
        np.isnan(verdicts[-1]) and np.isnan(verdicts).all()
    ):  # the last alone, as a rule
        return None, math.nan, math.nan
    begun = np.append(plan.crossing_times - OPEN_BEFORE, np.inf)
    if begun[index] > track.time[-1]:
        # where the bag breaks off nobody knows whether it was
        return UNDECIDED if run.truncated else NOT_BEGUN, math.nan, math.nan
    end = begun[index + 1] if begun[index + 1] <= track.time[-1] else np.inf
    first, last = np.searchsorted(time, (begun[index] + FRESH, end))
    until = time[-1] if math.isinf(end) else end
    lost = any(hole.meets(*_stamps(track, begun[index], until)) for hole in run.holes)
    said = np.flatnonzero(verdicts[first:last] > 0.0)
    if len(said) == 0:
        return None if lost else UNDECIDED, math.nan, math.nan
    final = verdicts[first + said[-1]]
    before = np.flatnonzero(verdicts[first : first + said[-1]] != final)
    row = first + (int(before[-1]) + 1 if len(before) else 0)
    begin, end = run.criterion.stamps[[max(row - 1, 0)]], run.criterion.stamps[[row]]
    unseen = lost and not recorded(begin, run.holes, end)[0]
    return (
        Verdict(int(verdicts[row])).name.lower(),
        math.nan if unseen else float(time[row]),
        float(run.criterion.mode_confidence[row]),
    )


def _correct(
    track: Tracked, verdict: str | None, moment: float, sign: int
) -> bool | None:
    side = value_at(track.true_time, track.true_s, moment)
    return None if math.isnan(side) else (side * sign > 0.0) == (verdict == CROSSED)


def _own_part(plan: Certificate, time: Floats, index: int) -> slice[int, int, None]:
    """Find the rows of times that are nearer to this crossing than to any other."""
    times = plan.crossing_times
    edges = np.concatenate([[-np.inf], 0.5 * (times[1:] + times[:-1]), [np.inf]])
    return rows_between(time, *edges[index : index + 2])


def _true_instant(
    track: Tracked, planned: float, before: float, after: float
) -> float | None:
    inside = rows_between(track.true_time, before, after)
    time, s = track.true_time[inside], track.true_s[inside]
    rows = np.flatnonzero((s[:-1] * s[1:] <= 0.0) & (s[:-1] != s[1:]))
    if len(rows) == 0:
        return None
    zeros = time[rows] - s[rows] * (time[rows + 1] - time[rows]) / (
        s[rows + 1] - s[rows]
    )
    return float(zeros[np.abs(zeros - planned).argmin()])


def value_at(time: Floats, values: Floats, moment: float) -> float:
    """Find the value recorded nearest to a moment; nan outside the recording.

    Args:
        time: (n,) rising, s.
        values: (n,) in a unit of their own.
        moment: s.
    """
    if len(values) == 0 or not time[0] <= moment <= time[-1]:
        return math.nan
    row = int(np.searchsorted(time, moment))
    return float(
        values[row - 1 if row and moment - time[row - 1] < time[row] - moment else row]
    )


def largest_between(time: Floats, values: Floats, first: float, last: float) -> float:
    """Find the largest finite value between two moments; nan where there is none.

    Args:
        time: (n,) rising, s.
        values: (n,) in a unit of their own.
        first, last: s, both inside.
    """
    begin = np.searchsorted(time, first, side="left")
    inside = values[begin : np.searchsorted(time, last, side="right")]
    finite = inside[np.isfinite(inside)]
    return float(finite.max()) if finite.size else math.nan


def largest(values: Floats) -> float:
    """Find the largest finite magnitude of values (n, ...), units alike; nan where
    there is none.
    """
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else math.nan
