"""How a run went by the system clock: rates, jitter, round trips, unanswered states,
phases.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from dextar_control.analysis.clock import LEAST_SYSTEM_STEP
from dextar_control.analysis.registry import Metric
from dextar_control.analysis.run import Floats, Joints, Phase, Run, Stamps, seconds
from dextar_control.analysis.tracking import Tracked
from dextar_control.bags.damage import Hole

# share of the steps without a command in time; a run with fewer did not fail by that
MOST_LATE = 0.2


@dataclass(frozen=True)
class Spread:
    """The distribution of a measured quantity, in five numbers; nan when nothing was
    measured.

    Attributes:
        count: of the values.
        median, p95, p99, maximum: percentiles by linear interpolation, in the
            quantity's unit.
        deviation: standard deviation (of the population), in the quantity's unit.
    """

    count: int
    median: float
    p95: float
    p99: float
    maximum: float
    deviation: float

    @staticmethod
    def of(values: Floats) -> Spread:
        """Summarise the finite ones of values (n,) of a quantity; its unit is kept, as
        s.
        """
        finite = values[np.isfinite(values)]
        if len(finite) == 0:
            return Spread(0, *(math.nan,) * 5)
        middle, p95, p99 = np.percentile(finite, (50.0, 95.0, 99.0)).tolist()
        largest, deviation = float(finite.max()), float(finite.std())
        return Spread(len(finite), middle, p95, p99, largest, deviation)


@dataclass(frozen=True)
class Timing:
    """The stream of states and its answers while a trajectory was tracked, or over the
    whole run when none was.

    By the system clocks, not by the stamps. Publishers on one machine share a clock; on
    two, the round trip is only as true as their clocks are alike.
    """

    lockstep: Annotated[
        bool | None,
        Metric(
            "lockstep",
            "",
            "Whether the plant waited for each command, so that the rates say how "
            "fast the simulation ran; null where it is not known.",
        ),
    ]
    state_period: Annotated[
        Spread,
        Metric(
            "period of the states",
            "s",
            "From one state to the next, by the times at which they were published.",
            ".0f",
            "µs",
        ),
    ]
    command_period: Annotated[
        Spread,
        Metric("period of the commands", "s", "The same of the commands.", ".0f", "µs"),
    ]
    round_trip: Annotated[
        Spread,
        Metric(
            "round trip",
            "s",
            "From the publishing of a state to the publishing of the command with "
            "its stamp.",
            ".0f",
            "µs",
        ),
    ]
    stamp_period: Annotated[
        float,
        Metric(
            "period of the stamps",
            "s",
            "Median period of the states' stamps: that with which the robot was "
            "sampled.",
            ".3f",
            "ms",
        ),
    ]
    missed_runs: Annotated[
        list[int],
        Metric(
            "runs of states without a command",
            "",
            "Lengths of the stretches of successive states without a command, in "
            "the order of the run.",
        ),
    ]
    longest_miss: Annotated[
        int,
        Metric(
            "longest run of such states",
            "",
            "The longest of these stretches, in states; 0 where every state was "
            "answered.",
            "d",
        ),
    ]
    late_share: Annotated[
        float,
        Metric(
            "share of the states without a command in time",
            "1",
            "Share of the states whose command was published later than one of "
            "the robot's sample periods after them, or never; null where time is "
            "not known to be real, and without commands.",
            ".3f",
        ),
    ]


@dataclass(frozen=True)
class PhaseSpan:
    """A stretch of time in one phase of the controller.

    Attributes:
        phase: of the controller.
        start, end: s since the trajectory's start (since the first state where nothing
            was tracked); a phase ends where the next one starts.
        ticks: recorded in it.
    """

    phase: str
    start: float
    end: float
    ticks: int


def round_trips(run: Run, stamps: Stamps) -> tuple[Stamps, Floats]:
    """Measure the time from the publishing of each state to that of its command.

    Args:
        run: that was recorded.
        stamps: (m,) ns, of the states that count.

    Returns:
        The stamps (k,), ns, of those that were answered, and the times (k,), s, nan
        where the clock stepped.
    """
    states, state_rows, command_rows = np.intersect1d(
        run.states.stamps, run.commands.stamps, assume_unique=True, return_indices=True
    )
    wanted = np.isin(states, stamps)
    trips = seconds(
        run.commands.published[command_rows] - run.states.published[state_rows]
    )
    if run.clock_steps and len(trips):
        trips[np.abs(trips - np.median(trips)) > 0.5 * min(run.clock_steps)] = np.nan
    return np.asarray(states[wanted], dtype=np.int64), trips[wanted]


def periods(joints: Joints, stamps: Stamps, holes: Sequence[Hole] = ()) -> Floats:
    """Measure the time from the publishing of a message to that of the next, (k,), s,
    among those that have one of the stamps (m,), ns.

    Not across a hole of the bag, nor where the system clock stepped back.
    """
    mine = np.isin(joints.stamps, stamps)
    published, own = joints.published[mine], joints.stamps[mine]
    stretch = (
        np.concatenate([[0], np.cumsum(np.diff(published) < -LEAST_SYSTEM_STEP)])
        if len(published)
        else published
    )
    order = np.lexsort((published, stretch))
    spans = seconds(np.diff(published[order]))
    known = np.diff(stretch[order]) == 0
    seen: Floats = spans[known & recorded(own[order][:-1], holes, own[order][1:])]
    return seen


def recorded(
    stamps: Stamps, holes: Sequence[Hole], until: Stamps | None = None
) -> NDArray[np.bool_]:
    """Tell which stamps, or stretches, are not touched by a hole of the bag.

    Args:
        stamps: (n,) ns, where each begins.
        holes: of the bag.
        until: (n,) ns, where each ends; at its stamp when None.

    Returns:
        (n,) whether none meets it.
    """
    known = np.ones(len(stamps), dtype=bool)
    until = stamps if until is None else until
    for hole in holes:
        after = (
            np.zeros(len(stamps), dtype=bool)
            if hole.begin is None
            else until <= hole.begin
        )
        known &= after if hole.end is None else after | (stamps >= hole.end)
    return known


def measure_timing(run: Run, track: Tracked | None) -> Timing:
    """Measure the timing of a run."""
    asked = run.states.stamps if track is None else within(run.states.stamps, track)
    told = run.commands.stamps if track is None else within(run.commands.stamps, track)
    missed = ~np.isin(asked, run.commands.stamps) & recorded(asked, run.holes)
    edges = np.flatnonzero(
        np.diff(np.concatenate([[False], missed, [False]]).astype(int))
    )
    lengths = (edges[1::2] - edges[::2]).tolist()
    trips = round_trips(run, asked)[1]
    stamp_period = (
        float(np.median(np.diff(asked))) * 1e-9 if len(asked) > 1 else math.nan
    )
    waits, late = lockstep(run), int(missed.sum()) + int((trips > stamp_period).sum())
    return Timing(
        lockstep=waits,
        state_period=Spread.of(periods(run.states, asked, run.holes)),
        command_period=Spread.of(periods(run.commands, told, run.holes)),
        round_trip=Spread.of(trips),
        stamp_period=stamp_period,
        missed_runs=lengths,
        longest_miss=max(lengths, default=0),
        late_share=late / len(asked) if waits is False and len(trips) else math.nan,
    )


def late_share(late_ticks: int | None, steps: int | None, by_stamps: float) -> float:
    """Compute the share of the steps without a command in time; nan where it is not
    known.

    Args:
        late_ticks, steps: as the plant counted; None where it did not.
        by_stamps: the share by the recorded times, or nan; the greater counts.
    """
    counted = late_ticks / steps if late_ticks is not None and steps else math.nan
    return max(
        (share for share in (counted, by_stamps) if math.isfinite(share)),
        default=math.nan,
    )


def lockstep(run: Run) -> bool | None:
    """Tell whether the plant waited for its commands; None when neither its diagnostics
    nor a node's parameters say so.
    """
    mode = run.parameter("plant", "mode")
    mode = mode or run.diagnostics.get("plant", {}).get("mode")
    waits = run.parameter("controller", "lockstep")
    if mode is None and waits is None:
        return None
    return mode == "lockstep" or (mode is None and bool(waits))


def within(stamps: Stamps, track: Tracked) -> Stamps:
    """Choose the stamps (m,), ns, from the first to the last tracked tick."""
    inside = (stamps >= track.stamps[0]) & (stamps <= track.stamps[-1])
    return np.asarray(stamps[inside])


def phase_spans(run: Run, track: Tracked | None) -> list[PhaseSpan]:
    """List the controller's phases one after the other."""
    phases, stamps = run.criterion.phase, run.criterion.stamps
    if len(phases) == 0:
        return []
    zero = track.start if track else int(run.states.stamps[0])
    begins = np.concatenate([[0], np.flatnonzero(np.diff(phases)) + 1])
    ends = np.append(begins[1:], len(phases) - 1)
    counts = np.diff(np.append(begins, len(phases)))
    return [
        PhaseSpan(
            phase_name(int(phases[begin])),
            float(stamps[begin] - zero) * 1e-9,
            float(stamps[end] - zero) * 1e-9,
            int(n),
        )
        for begin, end, n in zip(begins, ends, counts, strict=True)
    ]


def phase_name(number: int) -> str:
    """Return a phase's name, or its number where this version knows none."""
    try:
        return Phase(number).name
    except ValueError:
        return f"phase {number}"
