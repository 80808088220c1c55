"""A run whose clock stepped back: its stamps put in the order of record, and what of it
is one run.

The order of record does not step. Where the states' stamps fall back and go on from
there, the same robot was stamped by a clock that was set back, or another run begins in
the same bag. It is the same run where the joints go on from where they were, without a
pause; unless its stamps begin anew as well, by a clock that only the robot has, and a
trajectory is served again.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dextar_control.analysis.run import Floats, Stamps
from dextar_control.bags.series import RecordedColumns, Series
from dextar_control.contract.errors import BagError
from dextar_control.contract.robot import JOINT_NAMES
from dextar_control.contract.words import counted

# messages on either side of a step whose medians are compared: fewer are single wrong
# times
SIDE = 5
# ns by which the system clock must fall before it counts as one that was set back
LEAST_SYSTEM_STEP = 10_000_000
ALIKE = 20_000_000  # ns within which two clocks fell by the same; or a tenth
ANEW = 10  # periods within which stamps begin where they began before
# ns that the recorder's clock may have gone on while the stamps fell
LONGEST_PAUSE = 500_000_000
LEAST_JUMP = 0.01  # rad from one state to the next, beside three times what is usual
MOST_UNSEEN = 20.0  # periods between the two for which the joints may have gone on
# messages from one step to the next: fewer are those of two publishers in turn
LEAST_STRETCH = 10


class Clock(NamedTuple):
    """The stamps of the states on a clock that does not step back.

    Attributes:
        places: (n,) of the states among all messages of the bag; rising.
        stamps: (n,) on that clock, ns.
        offsets: (n,) what was added to each, ns.
        steps, system_steps: by how much their own clock, and the recorder's system
            clock, stepped back each time, s.
    """

    places: Stamps
    stamps: Stamps
    offsets: Stamps
    steps: list[float]
    system_steps: list[float]

    def steady(self, stamps: Stamps, places: Stamps) -> Stamps:
        """Put other stamps on that clock, each with the one of the offsets near its
        place in the bag that brings it nearest to the state beside it.

        Args:
            stamps: (m,) of messages that answer the states, ns.
            places: (m,) of these among all messages of the bag.

        Returns:
            (m,) ns.
        """
        rows = np.clip(
            np.searchsorted(self.places, places, side="right") - 1,
            0,
            len(self.places) - 1,
        )
        known = np.unique(self.offsets)
        own = np.searchsorted(known, self.offsets[rows])
        found = np.asarray(stamps + known[own])
        for neighbour in (own - 1, own + 1):
            other = stamps + known[np.clip(neighbour, 0, len(known) - 1)]
            nearer = np.abs(other - self.stamps[rows]) < np.abs(
                found - self.stamps[rows]
            )
            found[nearer] = other[nearer]
        return found


def clock_of(states: Series, served: Sequence[int]) -> Clock:
    """Put a run's states on one clock.

    Args:
        states: of its joints, with at least one message.
        served: places in the bag of the messages of its trajectory.

    Raises:
        BagError: these are two runs, or the states of two publishers.
    """
    nothing = np.zeros(0, dtype=np.int64)
    if states.rising and not states.fallen:
        return Clock(nothing, nothing, nothing, [], [])
    found = states.recorded([f"position.{joint}" for joint in JOINT_NAMES])
    fell = _fallen(found.logged)
    system = [
        drop
        for drop in (found.logged[fell] - found.logged[fell + 1]).tolist()
        if drop >= LEAST_SYSTEM_STEP
    ]
    rows = nothing if states.rising else _fallen(found.stamps)
    _check(states.topic, found, rows, served)
    offsets = np.zeros(len(found.stamps), dtype=np.int64)
    ordinary = _period(found.stamps)
    for row in rows.tolist():
        gap = int(found.logged[row + 1] - found.logged[row])
        gap = gap if ordinary < gap < LONGEST_PAUSE else ordinary
        offsets[row + 1 :] += int(found.stamps[row] - found.stamps[row + 1]) + gap
    drops = found.stamps[rows] - found.stamps[rows + 1]
    return Clock(
        found.places,
        found.stamps + offsets,
        offsets,
        [1e-9 * drop for drop in drops.tolist()],
        [1e-9 * drop for drop in system],
    )


def clock_in_words(stamp_steps: Sequence[float], clock_steps: Sequence[float]) -> str:
    """Say how often and by how much a run's clocks stepped back, without a full stop;
    return "" where none did.
    """
    done = "the states are taken in the order of record"
    if stamp_steps and clock_steps:
        text = (
            f"the clock of the stamps stepped back {_times(stamp_steps)}, the system"
            f" clock {_times(clock_steps)}: {done}"
        )
    elif stamp_steps:
        text = f"the clock of the stamps stepped back {_times(stamp_steps)}: {done}"
    elif clock_steps:
        text = (
            f"the system clock stepped back {_times(clock_steps)} while it was recorded"
        )
    else:
        return ""
    return text + (
        ", and rates and round trips leave these moments out" if clock_steps else ""
    )


def _times(steps: Sequence[float]) -> str:
    if len(steps) == 1:
        return f"once, by {steps[0]:.3f} s"
    return f"{counted(len(steps), 'time')}, by {min(steps):.3f} to {max(steps):.3f} s"


def _fallen(times: Stamps) -> Stamps:
    """Find the rows after which times fall back, and stay there."""
    rows = np.flatnonzero(np.diff(times) < 0)
    rows = rows[(rows >= SIDE // 2) & (rows < len(times) - 1 - SIDE // 2)]
    if len(rows) == 0:
        return rows
    before = times[np.clip(rows[:, None] - np.arange(SIDE), 0, None)]
    after = times[np.clip(rows[:, None] + 1 + np.arange(SIDE), None, len(times) - 1)]
    return np.asarray(
        rows[np.median(after, axis=1) < np.median(before, axis=1)], dtype=np.int64
    )


def _period(stamps: Stamps) -> int:
    spans = np.diff(stamps)
    return int(np.median(spans[spans > 0])) if (spans > 0).any() else 1


def _check(
    topic: str, found: RecordedColumns, rows: Stamps, served: Sequence[int]
) -> None:
    """Refuse states that are not those of one run."""
    stamps, count = found.stamps, len(found.stamps)
    if len(rows) > 2 and np.median(np.diff(rows)) < LEAST_STRETCH:
        raise BagError(
            f"the stamps of {topic} go back and forth, {counted(len(rows), 'time')} in"
            f" {counted(count, 'message')}: two publishers send it, as when two plants"
            " run at once; record one robot alone"
        )
    period, usual = _period(stamps), _usual_change(found.values)
    for row in rows.tolist():
        drop, gap = (
            int(stamps[row] - stamps[row + 1]),
            int(found.logged[row + 1] - found.logged[row]),
        )
        # the recorder's clock was set back as well
        alike = abs(gap + drop) < max(ALIKE, drop // 10)
        while_unseen = min(max(gap / period, 1.0), MOST_UNSEEN)
        change = float(
            np.nan_to_num(np.abs(found.values[row + 1] - found.values[row])).max()
        )
        anew = abs(int(stamps[row + 1] - stamps[0])) < ANEW * period
        again = any(place > found.places[row] - 1 for place in served) or stamps[0] == 0
        why = ""
        if change > LEAST_JUMP + 3.0 * usual * while_unseen:
            why = f"the joints jump by {change:.3f} rad there"
        elif anew and again and not alike:
            why = "they begin there as they began before"
        elif gap > LONGEST_PAUSE and not alike:
            why = f"no state came for {gap * 1e-9:.3f} s there"
        if why:
            raise BagError(
                f"the stamps of {topic.rpartition('/')[2]} fall back by"
                f" {drop * 1e-9:.3f} s after {row + 1} of {count} messages: two runs in"
                f" one bag, or a plant that was reset ({why}); record each run into a"
                " bag of its own"
            )


def _usual_change(values: Floats) -> float:
    """Return the 99th percentile of the change from one state to the next, rad."""
    changes = np.abs(np.diff(values, axis=0)).max(axis=1)
    changes = changes[np.isfinite(changes)]
    return float(np.percentile(changes, 99.0)) if len(changes) else 0.0
