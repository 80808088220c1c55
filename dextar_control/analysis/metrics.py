"""What a run achieved, as numbers, and whether that is a crossing."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass
from typing import Annotated

from dextar_control.analysis.crossings import CrossingMetrics
from dextar_control.analysis.margins import Margins
from dextar_control.analysis.registry import Metric, metrics_of
from dextar_control.analysis.timing import PhaseSpan, Timing
from dextar_control.bags.damage import Hole, Unreadable
from dextar_control.contract.plain_data import Plain, as_plain


@dataclass(frozen=True)
class Metrics:
    """A run's numbers, in SI units; nan where the bag does not tell.

    Each can be computed again from the bag alone. The *tracked ticks* are the stamps
    that both ``criterion`` (in phase TRACK or CROSSING, or APPROACH where there is none
    of these) and ``controller_state`` (with a time) have, of the last trajectory: those
    whose start, stamp less time, is within 1 ms of the last one's. Time zero is the
    median of their starts.

    Attributes:
        crossings: each planned one, in order.
        timing: rates, jitter and round trips.
        margins: how near the run came to what is watched.
        phases: the controller's, one after the other.
        holes: what is missing in the middle of the bag.
        unreadable: per topic name, what could not be decoded of what is needed; it
            counts as not recorded.
    """

    bag: Annotated[str, Metric("bag", "", "Path of the bag.")]
    version: Annotated[
        str, Metric("version", "", "Version of dextar that recorded it.")
    ]
    robot: Annotated[str, Metric("robot", "", "Name of the robot's description.")]
    law: Annotated[str, Metric("law", "", "Name of the control law.")]
    estimator: Annotated[str, Metric("estimator", "", "Name of the estimator.")]
    truncated: Annotated[
        bool, Metric("truncated", "", "Whether the end of the bag is missing.")
    ]
    phase: Annotated[str, Metric("phase", "", "The controller's last phase.")]
    reason: Annotated[
        str, Metric("reason", "", "Why a safe stop or a fault was its last phase.")
    ]
    success: Annotated[
        bool | None,
        Metric(
            "verdict",
            "",
            "Whether the run is a success; null where the bag cannot tell.",
        ),
    ]
    reasons: Annotated[
        list[str], Metric("reasons", "", "Why the run is none, or why nobody can know.")
    ]
    crossings: list[CrossingMetrics]
    start_stamp: Annotated[
        int | None,
        Metric(
            "start",
            "ns",
            "Time zero of the trajectory: the median of the tracked ticks' starts.",
        ),
    ]
    duration: Annotated[
        float,
        Metric(
            "duration of the trajectory",
            "s",
            "From the first to the last point of the served trajectory.",
            ".3f",
        ),
    ]
    tracked_until: Annotated[
        float,
        Metric(
            "tracked until",
            "s",
            "Time of the last tracked tick since the trajectory's start.",
            ".3f",
        ),
    ]
    max_true_error: Annotated[
        float,
        Metric(
            "true error, largest",
            "m",
            "Largest distance between the reference and the true end effector of "
            "the same stamp over the tracked ticks that have a truth.",
            ".3f",
            "mm",
            truth=True,
        ),
    ]
    rms_true_error: Annotated[
        float,
        Metric(
            "true error, RMS",
            "m",
            "Root of the mean square of that distance over these ticks.",
            ".4f",
            "mm",
            truth=True,
        ),
    ]
    final_true_error: Annotated[
        float,
        Metric(
            "true error at the end",
            "m",
            "That distance at the last of these ticks.",
            ".3f",
            "mm",
            truth=True,
        ),
    ]
    max_estimated_error: Annotated[
        float,
        Metric(
            "estimated error, largest",
            "m",
            "Largest distance between reference and estimate over all tracked ticks.",
            ".3f",
            "mm",
        ),
    ]
    rms_estimated_error: Annotated[
        float,
        Metric(
            "estimated error, RMS",
            "m",
            "Root of the mean square of that distance.",
            ".4f",
            "mm",
        ),
    ]
    peak_torque: Annotated[
        float,
        Metric(
            "peak torque",
            "N m",
            "Largest magnitude of either motor's command from the first tracked "
            "tick to the last.",
            ".4f",
        ),
    ]
    planned_peak_torque: Annotated[
        float, Metric("planned peak torque", "N m", "The same of the plan.", ".4f")
    ]
    torque_ratio: Annotated[
        float,
        Metric(
            "peak torque over the plan's",
            "1",
            "peak_torque over planned_peak_torque.",
            ".3f",
        ),
    ]
    peak_torque_near: Annotated[
        float,
        Metric(
            "peak torque within |s| < 0.1",
            "N m",
            "Largest magnitude of a command within |s| < 0.1.",
            ".4f",
        ),
    ]
    planned_peak_torque_near: Annotated[
        float,
        Metric(
            "planned peak torque within |s| < 0.1",
            "N m",
            "The same of the plan.",
            ".4f",
        ),
    ]
    torque_ratio_near: Annotated[
        float,
        Metric(
            "peak within |s| < 0.1 over the plan's",
            "1",
            "peak_torque_near over the planned peak of the whole trajectory.",
            ".3f",
        ),
    ]
    saturated: Annotated[
        int,
        Metric(
            "saturated commands",
            "",
            "Commands at the controller's torque limit while tracking: the "
            "recorded limit, else torque_limit.peak_ratio times the planned peak, or "
            "the motors' own limit.",
            "d",
        ),
    ]
    drive_saturated: Annotated[
        int | None,
        Metric(
            "steps with saturated drives",
            "",
            "Steps whose torque the plant's drives clipped, over its whole run; "
            "null where it did not count them.",
            "d",
        ),
    ]
    truth_share: Annotated[
        float,
        Metric(
            "share of the ticks with a truth",
            "1",
            "Share of the tracked ticks that have a recorded truth.",
            ".3f",
        ),
    ]
    loop_rate: Annotated[
        float,
        Metric(
            "rate of the states, median",
            "Hz",
            "One over the median period of the states while tracking, by the "
            "system clock and not by their stamps.",
            ".0f",
        ),
    ]
    mean_rate: Annotated[
        float,
        Metric(
            "rate of the states, mean",
            "Hz",
            "One over the mean of these periods.",
            ".0f",
        ),
    ]
    states: Annotated[
        int,
        Metric(
            "states",
            "",
            "Recorded states while tracking, but not those beside a hole of the bag.",
            "d",
        ),
    ]
    answered: Annotated[
        int,
        Metric(
            "states with a command",
            "",
            "Those of them with a command of their stamp.",
            "d",
        ),
    ]
    missed: Annotated[int, Metric("states without a command", "", "The others.", "d")]
    late_commands: Annotated[
        int | None,
        Metric(
            "late commands",
            "",
            "Commands that came too late for their step, as the plant counted "
            "over its whole run; null where it did not.",
            "d",
        ),
    ]
    late_ticks: Annotated[
        int | None,
        Metric(
            "steps without a command in time",
            "",
            "Steps that the plant took without their command, by the same count.",
            "d",
        ),
    ]
    plant_steps: Annotated[
        int | None,
        Metric(
            "steps of the plant",
            "",
            "All steps that the plant took, by the same count.",
            "d",
        ),
    ]
    late_share: Annotated[
        float,
        Metric(
            "share of the steps without a command in time",
            "1",
            "late_ticks of plant_steps, or timing.late_share where that is greater.",
            ".3f",
        ),
    ]
    timing: Timing
    margins: Margins
    phases: list[PhaseSpan]
    lost: Annotated[
        dict[str, int | None],
        Metric(
            "samples lost in recording",
            "",
            "Samples lost per topic, as the recorder counted last; null where it "
            "is not known. What a damaged or cut-off file no longer holds is not "
            "counted.",
            "d",
        ),
    ]
    holes: list[Hole]
    unreadable: dict[str, Unreadable]
    stamp_steps: Annotated[
        list[float],
        Metric(
            "steps of the stamps' clock",
            "s",
            "By how much the clock of the stamps stepped back, each time.",
        ),
    ]
    clock_steps: Annotated[
        list[float],
        Metric(
            "steps of the system clock",
            "s",
            "By how much the recorder's system clock stepped back, each time.",
        ),
    ]

    @property
    def length(self) -> float:
        """The plan's duration, s; without a plan, that of what was tracked."""
        known = math.isfinite(self.duration)
        return self.duration if known else self.tracked_until

    @property
    def title(self) -> str:
        """Robot, law and estimator, in words."""
        return (
            f"{self.robot or 'robot unknown'}, law {self.law or 'unknown'}, estimator"
            f" {self.estimator or 'unknown'}"
        )

    def shown(self, name: str, missing: str = "-") -> str:
        """Format one of the numbers with its unit, as people read it; ``missing``
        stands for one that is not known.
        """
        return METRICS[name].text(getattr(self, name), missing)

    def to_dict(self) -> dict[str, Plain]:
        """Return plain data for JSON, None where a number is not finite."""
        values: dict[str, object] = dataclasses.asdict(self)
        return as_plain(values)

    def to_json(self) -> str:
        """Return strict JSON, null where a number is not finite."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)


METRICS = metrics_of(Metrics) | {
    f"timing.{name}": metric for name, metric in metrics_of(Timing).items()
}
"""Each number of a run by its place in ``metrics.json``."""


def saturated(metrics: Metrics) -> str:
    """Say how many commands were saturated, or why that is not known."""
    if math.isnan(metrics.peak_torque):
        return "no command while tracking"
    return (
        str(metrics.saturated)
        if metrics.robot or metrics.saturated
        else "unknown without a limit"
    )
