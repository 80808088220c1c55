"""What a run achieved, as numbers, and whether that is a crossing."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dextar_control.analysis.run import Floats, Phase, Run
from dextar_control.analysis.tracking import Tracked, plan_of, tracked
from dextar_control.analysis.verdict import Verdict, judge
from dextar_control.contract.errors import DextarError
from dextar_control.core.certificate import NEAR_LOCUS, Certificate

STEP_ZONE = 0.15  # |s| within which torque steps are looked for
SETTLED = 0.02  # s before and after a planned crossing at which the sign of s is read
SEARCH = 0.05  # s around a planned crossing in which the true one is looked for
SATURATED = 1.0 - 1e-9  # of max_torque


@dataclass(frozen=True)
class CrossingMetrics:
    """One planned crossing; times in s since the trajectory's start.

    Attributes:
        planned_time: of the plan; ``planned_stamp`` is the same instant in ns.
        point: planned, m.
        sign: planned sign of s afterwards.
        true_time: where the true s is zero, nearest to the plan; None when nowhere near.
        crossed: the true s has the other sign before and the planned sign after; None without truth.
        estimated_mode: assembly mode that the controller took afterwards; None when not recorded.
        speed: true speed at the crossing (estimated without truth), m/s.
        residual: |t_s.w_d| that the controller saw at the planned instant, N.
        planned_residual: |t_s.w_d| of the plan there, N.
        peak_torque: within |s| < 0.1 of this crossing, N m.
        torque_step: largest change in one tick within |s| < 0.15 of this crossing, N m.
    """

    planned_time: float
    planned_stamp: int
    point: tuple[float, float]
    sign: int
    true_time: float | None
    crossed: bool | None
    estimated_mode: int | None
    speed: float
    residual: float
    planned_residual: float
    peak_torque: float
    torque_step: float


@dataclass(frozen=True)
class Metrics:
    """A run's numbers: m, N m, s, Hz; nan where the bag does not tell.

    Attributes:
        law, phase, reason: of the controller; its last phase and why it is there.
        success: None without truth. ``reasons`` says why not, or why nobody can know.
        max_true_error, rms_true_error, final_true_error: reference against truth while tracking.
        max_estimated_error: reference against estimate while tracking.
        peak_torque, planned_peak_torque, torque_ratio: commanded and planned over the trajectory.
        peak_torque_near, planned_peak_torque_near, torque_ratio_near: the same within |s| < 0.1;
            the ratio is to the planned peak of the whole trajectory.
        saturated: commands at the torque limit while tracking; ``drive_saturated``: steps that the plant's
            drives clipped, over its whole run.
        truth_share: of the tracked ticks, those with a recorded truth.
        loop_rate: of the states while tracking on the system clock (not by their stamps), from their
            median period; ``mean_rate`` from the mean.
        states, answered, missed: recorded states while tracking, those with a command of their stamp, the others.
        late_commands, late_ticks, plant_steps: as the plant counted over its whole run (commands that
            came too late for their step, steps taken without their command); None when it did not.
        lost: samples lost per topic; None where not known.
    """

    bag: str
    version: str
    robot: str
    law: str
    truncated: bool
    phase: str
    reason: str
    success: bool | None
    reasons: list[str]
    crossings: list[CrossingMetrics]
    duration: float
    tracked_until: float
    max_true_error: float
    rms_true_error: float
    final_true_error: float
    max_estimated_error: float
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
    lost: dict[str, int | None] = field(default_factory=dict)

    def to_json(self) -> str:
        """Strict JSON: what is not a number is null."""
        return json.dumps(_plain(dataclasses.asdict(self)), indent=2, allow_nan=False)


def compute_metrics(run: Run) -> Metrics:
    """Every number of a run, and the verdict."""
    problem = ""
    try:
        plan = plan_of(run)
    except DextarError as refusal:
        plan, problem = None, str(refusal)
    track = tracked(run)
    crossings = [_crossing(run, plan, track, index) for index in range(len(plan.crossing_times))] if plan and track else []
    near = np.abs(track.torque_s) < NEAR_LOCUS if track else np.zeros(0, dtype=bool)
    torque = track.torque if track else np.zeros((0, 2))
    error = track.true_error[np.isfinite(track.true_error)] if track else np.zeros(0)
    planned_peak = plan.peak_torque if plan else math.nan
    planned_near = plan.peak_torque_near if plan else math.nan
    limit = run.robot.max_torque if run.robot else math.inf
    asked = run.states.stamps if track is None else _between(run.states.stamps, track)
    periods = np.diff(run.states.published[np.isin(run.states.stamps, asked)]) * 1e-9
    answered = int(np.isin(asked, run.commands.stamps).sum())
    estimated = _estimated_error(run, track)
    phase = Phase(int(run.criterion.phase[-1])) if len(run.criterion.phase) else None
    controller = run.diagnostics.get("controller", {})
    stopped = phase in (Phase.SAFE_STOP, Phase.FAULT)
    reason = str(controller.get("reason") or controller.get("message") or "") if stopped else ""
    values: dict[str, Any] = {
        "bag": str(run.path),
        "version": run.version,
        "robot": run.robot.name if run.robot else "",
        "law": str(run.parameters.get("controller", {}).get("law", "")),
        "truncated": run.truncated,
        "phase": phase.name if phase is not None else "",
        "reason": reason,
        "crossings": crossings,
        "duration": plan.duration if plan else math.nan,
        "tracked_until": float(track.time[-1]) if track else math.nan,
        "max_true_error": _peak(error),
        "rms_true_error": float(np.sqrt(np.mean(error**2))) if len(error) else math.nan,
        "final_true_error": float(error[-1]) if len(error) else math.nan,
        "max_estimated_error": _peak(estimated),
        "peak_torque": _peak(torque),
        "planned_peak_torque": planned_peak,
        "torque_ratio": _ratio(_peak(torque), planned_peak),
        "peak_torque_near": _peak(torque[near]),
        "planned_peak_torque_near": planned_near,
        "torque_ratio_near": _ratio(_peak(torque[near]), planned_peak),
        "truth_share": float(np.isfinite(track.true_error).sum() / len(track.stamps)) if track else 0.0,
        "drive_saturated": _whole(run.diagnostics.get("plant", {}).get("saturated_ticks")),
        "saturated": int((np.abs(torque) >= limit * SATURATED).any(axis=1).sum()),
        "loop_rate": float(1.0 / np.median(periods)) if len(periods) else math.nan,
        "mean_rate": float(1.0 / np.mean(periods)) if len(periods) else math.nan,
        "states": len(asked),
        "answered": answered,
        "missed": len(asked) - answered,
        **{
            name: _whole(run.diagnostics.get("plant", {}).get(key))
            for name, key in (("late_commands", "late_commands"), ("late_ticks", "late_ticks"), ("plant_steps", "steps"))
        },
        "lost": {topic: _add(count.get("lost"), count.get("dropped")) for topic, count in run.losses.items()},
    }
    verdict: Verdict = judge(values, has_truth=run.truth is not None, tracked=track is not None, problem=problem)
    return Metrics(**values, success=verdict.success, reasons=verdict.reasons)


def _crossing(run: Run, plan: Certificate, track: Tracked, index: int) -> CrossingMetrics:
    planned = float(plan.crossing_times[index])
    sign = int(plan.crossing_signs[index])
    before = _at(track.true_time, track.true_s, planned - SETTLED)
    after = _at(track.true_time, track.true_s, planned + SETTLED)
    crossed = None if not len(track.true_s) else bool(np.sign(after) == sign and np.sign(before) == -sign)
    moment = _true_instant(track, planned)
    criterion_time = (run.criterion.stamps - track.start) * 1e-9
    mode = _at(criterion_time, run.criterion.assembly_mode, planned + SETTLED)
    if run.truth is not None:
        speed_time, speeds = (run.truth.stamps - track.start) * 1e-9, np.hypot(*run.truth.x_dot.T)
    else:
        speed_time, speeds = (run.control.stamps - track.start) * 1e-9, np.hypot(*run.control.estimate_dot.T)
    mine = _own_part(plan, track.torque_time, index)
    near = mine & (np.abs(track.torque_s) < NEAR_LOCUS)
    zone = mine & (np.abs(track.torque_s) < STEP_ZONE)
    steps = np.abs(np.diff(track.torque, axis=0))[zone[1:] & zone[:-1]]
    return CrossingMetrics(
        planned_time=planned,
        planned_stamp=track.start + round(planned * 1e9),
        point=(float(plan.crossing_points[index][0]), float(plan.crossing_points[index][1])),
        sign=sign,
        true_time=moment,
        crossed=crossed,
        estimated_mode=int(mode) if math.isfinite(mode) else None,
        speed=_at(speed_time, speeds, planned if moment is None else moment),
        residual=abs(_at(criterion_time, run.criterion.residual, planned)),
        planned_residual=float(abs(plan.residuals[index])),
        peak_torque=_peak(track.torque[near]),
        torque_step=_peak(steps),
    )


def _own_part(plan: Certificate, time: Floats, index: int) -> np.ndarray:
    """Which times are nearer to this crossing than to any other."""
    if len(time) == 0:
        return np.zeros(0, dtype=bool)
    return np.abs(time[:, None] - np.asarray(plan.crossing_times)[None, :]).argmin(axis=1) == index


def _true_instant(track: Tracked, planned: float) -> float | None:
    time, s = track.true_time, track.true_s
    if len(s) < 2:
        return None
    rows = np.flatnonzero((s[:-1] * s[1:] <= 0.0) & (s[:-1] != s[1:]))
    if len(rows) == 0:
        return None
    zeros = time[rows] - s[rows] * (time[rows + 1] - time[rows]) / (s[rows + 1] - s[rows])
    best = float(zeros[np.abs(zeros - planned).argmin()])
    return best if abs(best - planned) <= SEARCH else None


def _at(time: np.ndarray, values: np.ndarray, moment: float) -> float:
    """The value recorded nearest to a moment; nan outside the recording."""
    if len(values) == 0 or not time[0] <= moment <= time[-1]:
        return math.nan
    return float(values[np.abs(time - moment).argmin()])


def _between(stamps: np.ndarray, track: Tracked) -> np.ndarray:
    return stamps[(stamps >= track.stamps[0]) & (stamps <= track.stamps[-1])]


def _estimated_error(run: Run, track: Tracked | None) -> Floats:
    if track is None:
        return np.zeros(0)
    return np.hypot(*run.control.error[np.isin(run.control.stamps, track.stamps)].T)


def _peak(values: Floats) -> float:
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else math.nan


def _ratio(value: float, plan: float) -> float:
    return value / plan if plan > 0.0 else math.nan


def _whole(text: Any) -> int | None:
    try:
        return int(float(text))
    except (TypeError, ValueError):
        return None


def _add(lost: int | None, dropped: int | None) -> int | None:
    return None if lost is None else lost + (dropped or 0)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
