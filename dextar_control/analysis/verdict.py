"""When a run counts as a success."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from dextar_control.bags.damage import in_words

MAX_ERROR = 5.0e-3  # m, true, while tracking
FINAL_ERROR = 1.0e-3  # m, true, at the end
LEAST_TRUTH = 0.95  # share of the tracked ticks whose truth is recorded
END_MARGIN = 0.02  # s that may be missing at the trajectory's end
# share of the steps without a command in time; a run with fewer did not fail by that
MOST_LATE = 0.2


class Verdict(NamedTuple):
    """success is None when the bag cannot tell; reasons are sentences with number and
    limit.
    """

    success: bool | None
    reasons: list[str]


def judge(
    values: Mapping[str, Any],
    *,
    has_truth: bool,
    tracked: bool,
    problem: str = "",
    exciting: bool = False,
) -> Verdict:
    """The verdict on a run.

    Args:
        values: the fields of ``Metrics``.
        has_truth: the bag holds the true motion.
        tracked: a trajectory was tracked.
        problem: why the plan could not be computed.
        exciting: the motion was to tell masses and friction: it has no crossing, and
            how far off it was, or that torques were at their limit, says nothing
            against it.
    """
    verdict = _judge(values, has_truth, tracked, problem, exciting)
    late = late_in_words(values)
    return (
        verdict._replace(reasons=[late, *verdict.reasons])
        if late and verdict.success is False
        else verdict
    )


def late_share(late_ticks: int | None, steps: int | None, by_stamps: float) -> float:
    """Share of the steps without a command in time, nan where it is not known.

    Args:
        late_ticks, steps: as the plant counted; None where it did not.
        by_stamps: the share by the recorded times, or nan; the greater counts.
    """
    counted = late_ticks / steps if late_ticks is not None and steps else math.nan
    return max(
        (share for share in (counted, by_stamps) if math.isfinite(share)),
        default=math.nan,
    )


def late_in_words(values: Mapping[str, Any]) -> str:
    """That commands came too late for a run to be judged by it, and what to do; ""
    where they did not, or nothing was late.
    """
    timing, share = values["timing"], values["late_share"]
    if timing.lockstep or not share >= MOST_LATE:
        return ""
    trip, period = 1e3 * timing.round_trip.median, 1e3 * timing.stamp_period
    worst = 1e3 * timing.round_trip.maximum
    took = (
        f"; from a state to its command it took {trip:.1f} ms (median), {worst:.1f} ms"
        f" at worst, and a step is {period:.1f} ms"
    )
    return (
        f"commands came too late: {share:.0%} of the steps had none in time (below"
        f" {MOST_LATE:.0%} a run can do without){took if trip > 0.0 else ''}. The"
        " machine was too busy for real time: free it, or let each simulated step wait"
        " for its command, as the demo does without --real-time"
    )


def _judge(
    values: Mapping[str, Any],
    has_truth: bool,
    tracked: bool,
    problem: str,
    exciting: bool,
) -> Verdict:
    reasons: list[str] = []
    stopped = values["phase"] in ("SAFE_STOP", "FAULT")
    if stopped:
        reasons.append(
            f"the controller ended in {values['phase']}:"
            f" {values['reason'] or 'no reason recorded'}"
        )
    if not tracked and not values["phase"]:
        reasons.append(
            "the bag holds no phase of the controller: whether a trajectory was tracked"
            " is not known"
        )
        return Verdict(None, reasons)
    if not tracked:
        reasons.append("no trajectory was tracked")
        return Verdict(False, reasons)
    short = values["tracked_until"] < values["duration"] - END_MARGIN
    inside = [
        hole
        for hole in values["holes"]
        if hole.meets(
            values["start_stamp"], _stamp(values, "duration", "tracked_until")
        )
    ]
    gone = any(
        hole.meets(_stamp(values, "tracked_until"), _stamp(values, "duration"))
        for hole in inside
    )
    unseen = (
        short and (values["truncated"] or gone) and not stopped
    )  # the run may have gone on
    cut = unseen and values["truncated"]
    if short and not unseen:
        reasons.append(
            f"tracking ended at {values['tracked_until']:.3f} s of"
            f" {values['duration']:.3f} s"
        )
    if values["saturated"] and not exciting:
        reasons.append(f"saturated commands: {values['saturated']}; the limit is 0")
    if values["drive_saturated"]:
        reasons.append(
            f"steps in which the drives saturated: {values['drive_saturated']}; the"
            " limit is 0"
        )
    broken = bool(reasons)
    for hole in inside:
        reasons.append(
            f"{in_words(hole)}, while it was tracked: what happened then is not known"
        )
    if cut:
        reasons.append(
            f"the bag breaks off at {values['tracked_until']:.3f} s of"
            f" {values['duration']:.3f} s: what came then is not known"
        )
    if exciting and not values["crossings"]:
        return Verdict(None if reasons and not broken else not broken, reasons)
    for index, crossing in enumerate(values["crossings"], start=1):
        if crossing.crossed is False:
            reasons.append(
                f"crossing {index}, planned at {crossing.planned_time:.4f} s, did not"
                f" happen: s has not changed its sign to {crossing.sign:+d}"
            )
        if crossing.verdict_correct is False:
            reasons.append(
                f"the estimator says of crossing {index}: {crossing.verdict}"
                f" (confidence {crossing.verdict_confidence:.4f}, at"
                f" {crossing.verdict_time:.4f} s), and the true robot was on the other"
                " side"
            )
    for key, limit, name in (
        ("max_true_error", MAX_ERROR, "the largest true error"),
        ("final_true_error", FINAL_ERROR, "the true error at the end"),
    ):
        if (
            has_truth
            and not values[key] < limit
            and not (unseen and key == "final_true_error")
        ):
            found = (
                f"{1e3 * values[key]:.3f} mm"
                if math.isfinite(values[key])
                else "unknown"
            )
            reasons.append(f"{name} is {found}; the limit is {1e3 * limit:g} mm")
    if has_truth and values["truth_share"] < LEAST_TRUTH:
        reasons.append(
            f"only {values['truth_share']:.1%} of the ticks have a truth;"
            f" {LEAST_TRUTH:.0%} are needed"
        )
    if math.isnan(values["planned_peak_torque"]):
        problem = (
            problem or "no trajectory in the bag, or no robot (--robot FILE gives it)"
        )
        reasons.append(f"the plan cannot be computed: {problem}")
        return Verdict(False if broken else None, reasons)
    if not values["crossings"]:
        reasons.append("the trajectory crosses no singularity")
        return Verdict(False, reasons)
    if not has_truth:
        reasons.append(
            "the bag holds no true motion: encoders alone cannot tell a crossing from a"
            " bounce"
        )
        return Verdict(False if broken else None, reasons)
    if len(reasons) == len(inside) + cut > 0:
        return Verdict(None, reasons)
    return Verdict(not reasons, reasons)


def _stamp(values: Mapping[str, Any], *names: str) -> float:
    """Of the latest of some times since the trajectory's start, ns."""
    times = [float(values[name]) for name in names if math.isfinite(values[name])]
    return values["start_stamp"] + 1e9 * max(times, default=math.nan)
