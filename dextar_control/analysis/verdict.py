"""When a run counts as a success."""

from __future__ import annotations

import math

from dextar_control.analysis.metrics import Metrics
from dextar_control.analysis.timing import MOST_LATE
from dextar_control.bags.damage import hole_in_words

MAX_ERROR = 5.0e-3  # m, true, while tracking
END_ERROR = 1.0e-3  # m, true, at the end
LEAST_TRUTH = 0.95  # share of the tracked ticks whose truth is recorded
END_MARGIN = 0.02  # s that may be missing at the trajectory's end


def judge(
    metrics: Metrics, *, has_truth: bool, problem: str = "", exciting: bool = False
) -> tuple[bool | None, list[str]]:
    """Judge a run by its numbers.

    Args:
        metrics: of the run; its own ``success`` and ``reasons`` are not read.
        has_truth: the bag holds the true motion.
        problem: why the plan could not be computed.
        exciting: the motion was made to tell masses and friction: it has no crossing,
            and neither its error nor saturated torques say anything against it.

    Returns:
        Whether it is a success, None when the bag cannot tell, and why not: sentences
        with number and limit.
    """
    success, reasons = _judge(metrics, has_truth, problem, exciting)
    late = late_in_words(metrics)
    return success, [late, *reasons] if late and success is False else reasons


def late_in_words(metrics: Metrics) -> str:
    """Say that commands came too late for a run to be judged by it, and what to do;
    return "" where they did not.
    """
    timing, share = metrics.timing, metrics.late_share
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
    metrics: Metrics, has_truth: bool, problem: str, exciting: bool
) -> tuple[bool | None, list[str]]:
    reasons: list[str] = []
    stopped = metrics.phase in ("SAFE_STOP", "FAULT")
    if stopped:
        reasons.append(
            f"the controller ended in {metrics.phase}:"
            f" {metrics.reason or 'no reason recorded'}"
        )
    start = metrics.start_stamp
    if start is None and not metrics.phase:
        reasons.append(
            "the bag holds no phase of the controller: whether a trajectory was tracked"
            " is not known"
        )
        return None, reasons
    if start is None:
        reasons.append("no trajectory was tracked")
        return False, reasons
    last = max(metrics.tracked_until, metrics.length)
    until, end = (start + 1e9 * time for time in (metrics.tracked_until, last))
    short = metrics.tracked_until < metrics.duration - END_MARGIN
    inside = [hole for hole in metrics.holes if hole.meets(start, end)]
    gone = any(hole.meets(until, end) for hole in inside)
    # the run may have gone on
    unseen = short and (metrics.truncated or gone) and not stopped
    cut = unseen and metrics.truncated
    if short and not unseen:
        reasons.append(
            f"tracking ended at {metrics.tracked_until:.3f} s of"
            f" {metrics.duration:.3f} s"
        )
    if metrics.saturated and not exciting:
        reasons.append(f"saturated commands: {metrics.saturated}; the limit is 0")
    if metrics.drive_saturated:
        reasons.append(
            f"steps in which the drives saturated: {metrics.drive_saturated}; the"
            " limit is 0"
        )
    broken = bool(reasons)
    for hole in inside:
        what = hole_in_words(hole)
        reasons.append(f"{what}, while it was tracked: what happened then is not known")
    if cut:
        reasons.append(
            f"the bag breaks off at {metrics.tracked_until:.3f} s of"
            f" {metrics.duration:.3f} s: what came then is not known"
        )
    if exciting and not metrics.crossings:
        return None if reasons and not broken else not broken, reasons
    for index, crossing in enumerate(metrics.crossings, start=1):
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
    end_error = "the true error at the end", metrics.final_true_error, END_ERROR
    errors = [("the largest true error", metrics.max_true_error, MAX_ERROR)]
    errors += [] if unseen else [end_error]
    for name, error, limit in errors:
        if has_truth and not error < limit:
            found = f"{1e3 * error:.3f} mm" if math.isfinite(error) else "unknown"
            reasons.append(f"{name} is {found}; the limit is {1e3 * limit:g} mm")
    if has_truth and metrics.truth_share < LEAST_TRUTH:
        reasons.append(
            f"only {metrics.truth_share:.1%} of the ticks have a truth;"
            f" {LEAST_TRUTH:.0%} are needed"
        )
    if math.isnan(metrics.planned_peak_torque):
        problem = (
            problem or "no trajectory in the bag, or no robot (--robot FILE gives it)"
        )
        reasons.append(f"the plan cannot be computed: {problem}")
        return False if broken else None, reasons
    if not metrics.crossings:
        reasons.append("the trajectory crosses no singularity")
        return False, reasons
    if not has_truth:
        reasons.append(
            "the bag holds no true motion: encoders alone cannot tell a crossing from a"
            " bounce"
        )
        return False if broken else None, reasons
    if len(reasons) == len(inside) + cut > 0:
        return None, reasons
    return not reasons, reasons
