"""What a run achieved, as numbers, and whether that is a crossing."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass, field
from typing import cast

from dextar_control.analysis.crossings import CrossingMetrics
from dextar_control.analysis.margins import Margins
from dextar_control.analysis.timing import PhaseSpan, Timing
from dextar_control.bags.damage import Hole, Unreadable
from dextar_control.contract.plain_data import as_plain


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
            recorded; else ``watch_ratio`` x planned, or the motors');
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

    @property
    def length(self) -> float:
        """The plan's duration, s; without a plan, that of what was tracked."""
        known = math.isfinite(self.duration)
        return self.duration if known else self.tracked_until

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON, None where a number is not finite."""
        return cast("dict[str, object]", as_plain(dataclasses.asdict(self)))

    def to_json(self) -> str:
        """Strict JSON: what is not a number is null."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)


def saturated(metrics: Metrics) -> str:
    """How many commands were, or why that is not known."""
    if math.isnan(metrics.peak_torque):
        return "no command while tracking"
    return (
        str(metrics.saturated)
        if metrics.robot or metrics.saturated
        else "unknown without a limit"
    )
