"""What a run achieved, as numbers, and whether that is a crossing."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dextar_control.analysis.crossings import CrossingMetrics, judge_crossings, peak
from dextar_control.analysis.margins import Margins, measure_margins
from dextar_control.analysis.run import Floats, Phase, Run
from dextar_control.analysis.timing import (
    PhaseSpan,
    Timing,
    measure_timing,
    periods,
    phase_name,
    phase_spans,
    recorded,
    within,
)
from dextar_control.analysis.tracking import Tracked, plan_of, tracked
from dextar_control.analysis.verdict import Verdict, judge, late_share
from dextar_control.bags.damage import Hole, Unreadable
from dextar_control.contract.errors import DextarError
from dextar_control.contract.plain_data import as_plain
from dextar_control.contract.robot import JOINT_NAMES
from dextar_control.planning.certificate import NEAR_LOCUS

SATURATED = 1.0 - 1e-9  # of the torque limit


@dataclass(frozen=True)
class Metrics:
    """A run's numbers: m, N m, s, Hz; nan where the bag does not tell.

    Each can be computed again from the bag alone. The *tracked ticks* are the stamps
    that both ``criterion`` (in phase TRACK or CROSSING, or APPROACH where there is none
    of these) and ``controller_state`` (with a time) have, of the last trajectory: those
    whose start, stamp less time, is within 1 ms of the last one's. Time zero is the
    median of their starts.

    Attributes:
        law, estimator, phase, reason: of the controller; its last phase and why it is
            there.
        success: None without truth. ``reasons`` says why not, or why nobody can know.
        crossings: each planned one.
        start_stamp: time zero of the trajectory, ns.
        max_true_error, rms_true_error, final_true_error: distance between the reference
            and the true end effector of the same stamp over the tracked ticks that have
            a truth; rms is the root of the mean square.
        max_estimated_error, rms_estimated_error: the same between reference and
            estimate, over all tracked ticks.
        peak_torque: largest magnitude of either motor's command from the first tracked
            tick to the last; ``planned_peak_torque`` that of the plan, ``torque_ratio``
            the one over the other.
        peak_torque_near, planned_peak_torque_near, torque_ratio_near: the same within
            |s| < 0.1; the ratio is to the planned peak of the whole trajectory.
        saturated: commands at the controller's torque limit while tracking (as
            recorded; else ``torque_limit.peak_ratio`` x planned, or the motors');
            ``drive_saturated``: steps that the plant's drives clipped, over its whole
            run.
        truth_share: of the tracked ticks, those with a recorded truth.
        loop_rate: of the states while tracking on the system clock (not by their
            stamps), from their median period; ``mean_rate`` from the mean.
        states, answered, missed: recorded states while tracking, those with a command
            of their stamp, the others; not those beside a hole of the bag.
        late_commands, late_ticks, plant_steps: as the plant counted over its whole run
            (commands that came too late for their step, steps taken without their
            command); None when it did not.
        late_share: of the steps, those without a command in time: late_ticks of
            plant_steps, or timing.late_share where that is greater.
        lost: samples lost per topic, as the recorder counted last; None where not
            known. What a damaged or cut-off file no longer holds is not in it.
        truncated: the end of the bag is missing.
        holes: what is missing before.
        unreadable: per topic name, what could not be decoded of what is needed; it
            counts as not recorded.
        stamp_steps, clock_steps: by how much the clock of the stamps, and the
            recorder's system clock, stepped back each time, s.
        timing: rates, jitter and round trips.
        margins: how near the run came to what is watched.
        phases: the controller's, one after the other.
    """

    bag: str
    version: str
    robot: str
    law: str
    estimator: str
    truncated: bool
    phase: str
    reason: str
    success: bool | None
    reasons: list[str]
    crossings: list[CrossingMetrics]
    start_stamp: int | None
    duration: float
    tracked_until: float
    max_true_error: float
    rms_true_error: float
    final_true_error: float
    max_estimated_error: float
    rms_estimated_error: float
    peak_torque: float
    planned_peak_torque: float
    torque_ratio: float
    peak_torque_near: float
    planned_peak_torque_near: float
    torque_ratio_near: float
    saturated: int
    drive_saturated: int | None
    truth_share: float
    loop_rate: float
    mean_rate: float
    states: int
    answered: int
    missed: int
    late_commands: int | None
    late_ticks: int | None
    plant_steps: int | None
    late_share: float
    timing: Timing
    margins: Margins
    phases: list[PhaseSpan]
    lost: dict[str, int | None] = field(default_factory=dict)
    holes: list[Hole] = field(default_factory=list)
    unreadable: dict[str, Unreadable] = field(default_factory=dict)
    stamp_steps: list[float] = field(default_factory=list)
    clock_steps: list[float] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON: what is not a number is None."""
        plain: dict[str, Any] = as_plain(dataclasses.asdict(self))
        return plain

    def to_json(self) -> str:
        """Strict JSON: what is not a number is null."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)


def compute_metrics(run: Run) -> Metrics:
    """Every number of a run, and the verdict."""
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
    values: dict[str, Any] = {
        "bag": str(run.path),
        "version": run.version,
        "robot": run.robot.name if run.robot else "",
        "law": str(run.parameters.get("controller", {}).get("law", "")),
        "estimator": str(run.parameters.get("controller", {}).get("estimator", "")),
        "truncated": run.truncated,
        "holes": run.holes,
        "phase": phase,
        "reason": reason,
        "crossings": crossings,
        "start_stamp": track.start if track else None,
        "duration": plan.duration if plan else math.nan,
        "tracked_until": float(track.time[-1]) if track else math.nan,
        "max_true_error": peak(error),
        "rms_true_error": _rms(error),
        "final_true_error": float(error[-1]) if len(error) else math.nan,
        "max_estimated_error": peak(estimated),
        "rms_estimated_error": _rms(estimated[np.isfinite(estimated)]),
        "peak_torque": peak(torque),
        "planned_peak_torque": planned_peak,
        "torque_ratio": _ratio(peak(torque), planned_peak),
        "peak_torque_near": peak(torque[near]),
        "planned_peak_torque_near": planned_near,
        "torque_ratio_near": _ratio(peak(torque[near]), planned_peak),
        "truth_share": (
            float(np.isfinite(track.true_error).sum() / len(track.stamps))
            if track
            else 0.0
        ),
        "drive_saturated": _whole(plant.get("saturated_ticks")),
        "saturated": _saturated(run, track, limit) if track else 0,
        "loop_rate": _ratio(1.0, float(np.median(spans))) if len(spans) else math.nan,
        "mean_rate": _ratio(1.0, float(np.mean(spans))) if len(spans) else math.nan,
        "states": len(asked),
        "answered": answered,
        "missed": len(asked) - answered,
        "late_commands": _whole(plant.get("late_commands")),
        "late_ticks": late_ticks,
        "plant_steps": steps,
        "timing": timing,
        "margins": measure_margins(run, track, plan, timing, limit, late),
        "late_share": late,
        "phases": phase_spans(run, track),
        "unreadable": run.unreadable,
        "stamp_steps": run.stamp_steps,
        "clock_steps": run.clock_steps,
        "lost": {
            topic: _add(count.get("lost"), count.get("dropped"))
            for topic, count in run.losses.items()
        },
    }
    exciting = bool(run.parameters.get("trajectory_server", {}).get("task.excite"))
    verdict: Verdict = judge(
        values,
        has_truth=run.truth is not None,
        tracked=track is not None,
        problem=problem,
        exciting=exciting,
    )
    return Metrics(**values, success=verdict.success, reasons=verdict.reasons)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _ratio(value: float, plan: float) -> float:
    return value / plan if plan > 0.0 else math.nan


def _whole(text: Any) -> int | None:
    try:
        return int(float(text))
    except (TypeError, ValueError, OverflowError):
        return None


def _add(lost: int | None, dropped: int | None) -> int | None:
    return None if lost is None else lost + (dropped or 0)


def saturated(metrics: Metrics) -> str:
    """How many commands were, or why that is not known."""
    if math.isnan(metrics.peak_torque):
        return "no command while tracking"
    return (
        str(metrics.saturated)
        if metrics.robot or metrics.saturated
        else "unknown without a limit"
    )


def _saturated(run: Run, track: Tracked, otherwise: float) -> int:
    """How many commands were at their limit: the one that the controller had, where the
    bag tells, N m.
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
    """At which the controller held its commands while tracking, N m: the motors' limit,
    or nearer what was planned.
    """
    limit = run.robot.max_torque if run.robot else math.inf
    controller = run.parameters.get("controller", {})
    try:
        watched = max(
            float(controller["torque_limit.peak_ratio"]) * planned_peak,
            float(controller["torque_limit.min_torque"]),
        )
    except (KeyError, TypeError, ValueError):
        return limit
    return min(limit, watched) if math.isfinite(watched) else limit
