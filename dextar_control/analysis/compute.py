"""The numbers of a run, computed from what was recorded of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dextar_control.analysis.crossings import judge_crossings, largest
from dextar_control.analysis.margins import measure_margins
from dextar_control.analysis.metrics import Metrics
from dextar_control.analysis.run import Floats, Phase, Run, number_of
from dextar_control.analysis.timing import (
    late_share,
    measure_timing,
    periods,
    phase_name,
    phase_spans,
    recorded,
    within,
)
from dextar_control.analysis.tracking import Tracked, plan_of, tracked
from dextar_control.analysis.verdict import judge
from dextar_control.contract.errors import DextarError
from dextar_control.contract.robot import JOINT_NAMES
from dextar_control.planning.certificate import NEAR_LOCUS

SATURATED = 1.0 - 1e-9  # of the torque limit


def compute_metrics(run: Run) -> Metrics:
    """Compute every number of a run, and judge it."""
    problem = ""
    try:
        plan = plan_of(run)
    except DextarError as refusal:
        plan, problem = None, str(refusal)
    track = tracked(run)
    crossings = judge_crossings(run, plan, track) if plan and track else []
    near = np.abs(track.torque_s) < NEAR_LOCUS if track else np.zeros(0, dtype=bool)
    torque = track.torque if track else np.zeros((0, len(JOINT_NAMES)))
    error = track.true_error[np.isfinite(track.true_error)] if track else np.zeros(0)
    planned_peak = plan.peak_torque if plan else math.nan
    planned_near = plan.peak_torque_near if plan else math.nan
    limit = _torque_limit(run, planned_peak)
    asked = run.states.stamps if track is None else within(run.states.stamps, track)
    spans = periods(run.states, asked, run.holes)
    asked = asked[recorded(asked, run.holes)]
    answered = int(np.isin(asked, run.commands.stamps).sum())
    estimated = track.estimated_error if track else np.zeros(0)
    phase = phase_name(int(run.criterion.phase[-1])) if len(run.criterion.phase) else ""
    controller = run.diagnostics.get("controller", {})
    stopped = phase in (Phase.SAFE_STOP.name, Phase.FAULT.name)
    reason = (
        str(controller.get("reason") or controller.get("message") or "")
        if stopped
        else ""
    )
    plant = run.diagnostics.get("plant", {})
    late_ticks, steps = _whole(plant.get("late_ticks")), _whole(plant.get("steps"))
    timing = measure_timing(run, track)
    late = late_share(late_ticks, steps, timing.late_share)
    metrics = Metrics(
        success=None,
        reasons=[],
        bag=str(run.path),
        version=run.version,
        robot=run.robot.name if run.robot else "",
        law=str(run.parameter("controller", "law") or ""),
        estimator=str(run.parameter("controller", "estimator") or ""),
        truncated=run.truncated,
        holes=run.holes,
        phase=phase,
        reason=reason,
        crossings=crossings,
        start_stamp=track.start if track else None,
        duration=plan.duration if plan else math.nan,
        tracked_until=float(track.time[-1]) if track else math.nan,
        max_true_error=largest(error),
        rms_true_error=_rms(error),
        final_true_error=float(error[-1]) if len(error) else math.nan,
        max_estimated_error=largest(estimated),
        rms_estimated_error=_rms(estimated[np.isfinite(estimated)]),
        peak_torque=largest(torque),
        planned_peak_torque=planned_peak,
        torque_ratio=_ratio(largest(torque), planned_peak),
        peak_torque_near=largest(torque[near]),
        planned_peak_torque_near=planned_near,
        torque_ratio_near=_ratio(largest(torque[near]), planned_peak),
        truth_share=(
            float(np.isfinite(track.true_error).sum() / len(track.stamps))
            if track
            else 0.0
        ),
        drive_saturated=_whole(plant.get("saturated_ticks")),
        saturated=_saturated(run, track, limit) if track else 0,
        loop_rate=_ratio(1.0, float(np.median(spans))) if len(spans) else math.nan,
        mean_rate=_ratio(1.0, float(np.mean(spans))) if len(spans) else math.nan,
        states=len(asked),
        answered=answered,
        missed=len(asked) - answered,
        late_commands=_whole(plant.get("late_commands")),
        late_ticks=late_ticks,
        plant_steps=steps,
        timing=timing,
        margins=measure_margins(run, track, plan, timing, limit, late),
        late_share=late,
        phases=phase_spans(run, track),
        unreadable=run.unreadable,
        stamp_steps=run.stamp_steps,
        clock_steps=run.clock_steps,
        lost={
            topic: _add(count.get("lost"), count.get("dropped"))
            for topic, count in run.losses.items()
        },
    )
    exciting = bool(run.parameter("trajectory_server", "task.excite"))
    success, reasons = judge(
        metrics, has_truth=run.truth is not None, problem=problem, exciting=exciting
    )
    return replace(metrics, success=success, reasons=reasons)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _ratio(value: float, plan: float) -> float:
    return value / plan if plan > 0.0 else math.nan


def _whole(value: object) -> int | None:
    number = number_of(value)
    return int(number) if math.isfinite(number) else None


def _add(lost: int | None, dropped: int | None) -> int | None:
    return None if lost is None else lost + (dropped or 0)


def _saturated(run: Run, track: Tracked, otherwise: float) -> int:
    """Count the commands at their limit: the recorded one where the bag has it, else
    ``otherwise``, N m.
    """
    stamps = track.start + np.round(1e9 * track.torque_time).astype(np.int64)
    rows = np.minimum(
        np.searchsorted(run.criterion.stamps, stamps), len(run.criterion.stamps) - 1
    )
    recorded = run.criterion.torque_limit[rows]
    limits = np.where(
        (run.criterion.stamps[rows] == stamps) & (recorded > 0.0), recorded, otherwise
    )
    return int(
        (np.abs(track.torque).max(axis=1, initial=0.0) >= limits * SATURATED).sum()
    )


def _torque_limit(run: Run, planned_peak: float) -> float:
    """Return the torque, N m, at which the controller held its commands while tracking:
    the motors' limit, or a nearer one that follows from the plan.
    """
    limit = run.robot.max_torque if run.robot else math.inf
    ratio, least = (
        number_of(run.parameter("controller", name))
        for name in ("torque_limit.peak_ratio", "torque_limit.min_torque")
    )
    watched = max(ratio * planned_peak, least)
    return min(limit, watched) if math.isfinite(ratio * planned_peak + least) else limit
