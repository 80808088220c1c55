"""The diagnostics tell how a controller's states come and what its ticks cost."""

from __future__ import annotations

import math
import time
from collections import deque

from dextar_control.control.timing import Window
from dextar_control.nodekit.cdr import NANOSECONDS

WINDOW = 1000  # states, a second of them
LATELY = 5  # reports over which a missed state is told as a warning: one second
SETTLED = 200  # intervals below which a rate says nothing
# of the nominal rate: what ros2_control tells of its own loop (5 Hz at 100 Hz)
RATE_TOLERANCE = 0.05
# of the period, by which a stamp may lie off it: at full speed that is 3 mrad of a
# joint
STAMP_TOLERANCE = 0.2
# standard deviation of the intervals over the period: states come in pairs from there
# on
JITTER_TOLERANCE = 0.5
RECENT = 200  # states, over which an answer's lateness is judged when a motion ends
# of the answers late by a period, above which that is told; the plant tells its late
# steps from there on
MOST_LATE = 0.1
LONG = 10.0  # periods: the lateness of a single one that is told
# s between a stamp and its arrival beyond which it is of another clock, as in simulated
# time
SAME_CLOCK = 10.0


class Statistics:
    """Counters since the node's start, and windows over the last second.

    Attributes:
        counts: states answered, missed (by their stamps), refused, repeated; stamps off
            the period; stalls on the steady clock.
    """

    def __init__(self) -> None:
        names = (
            "states",
            "missed_states",
            "refused_states",
            "repeated_states",
            "irregular_stamps",
            "stalls",
        )
        self.counts = dict.fromkeys(names, 0)
        self._intervals, self._latencies = Window(WINDOW), Window(WINDOW)
        self._work = Window(WINDOW)
        # s from the sending of the recent states to their answers, and between their
        # arrivals.
        self._ages: deque[float] = deque(maxlen=RECENT)
        self._gaps: deque[float] = deque(maxlen=RECENT)
        self._arrival = math.nan
        self._before: deque[dict[str, int]] = deque([dict(self.counts)], maxlen=LATELY)
        self._reported = (0, 0)

    def restart(self) -> None:
        """Begin with another stream of states: what is missing until it begins is not
        late.
        """
        self._arrival = math.nan
        kept = self._intervals, self._latencies, self._ages, self._gaps, self._before
        for numbers in kept:
            numbers.clear()
        self._before.append(dict(self.counts))

    @property
    def arrival(self) -> float:
        """When the last state was taken, s of ``time.perf_counter``; nan before the
        first.
        """
        return self._arrival

    def spaced(self, gap: float, period: float) -> None:
        """Count what lies between two states.

        Args:
            gap: between their stamps, s.
            period: the nominal one, s.
        """
        periods = round(gap / period)
        self.counts["missed_states"] += max(periods - 1, 0)
        self.counts["irregular_stamps"] += (
            abs(gap - max(periods, 1) * period) > STAMP_TOLERANCE * period
        )

    def arrived(self, stamp: int, now: float, published: int = 0) -> None:
        """Count a state that was answered.

        Args:
            stamp: of its header, ns.
            now: of ``time.perf_counter``, s.
            published: when its publisher sent it, ns of that machine's system clock; 0
                where the middleware does not tell.
        """
        self.counts["states"] += 1
        if not math.isnan(self._arrival):
            self._intervals.add(now - self._arrival)
            self._gaps.append(now - self._arrival)
        self._arrival = now
        answered = time.time_ns()
        latency = (answered - stamp) / NANOSECONDS
        if abs(latency) < SAME_CLOCK:
            self._latencies.add(latency)
        age = (answered - published) / NANOSECONDS if published else latency
        if abs(age) < SAME_CLOCK:
            self._ages.append(age)

    def worked(self, duration: float) -> None:
        """Note how long one state took, s."""
        self._work.add(duration)

    def warnings(self, period: float) -> list[str]:
        """Return what is wrong with the states' arrival, against the
        nominal period, s.
        """
        told = []
        found = self._intervals.regularity()
        if len(self._intervals.numbers) >= SETTLED:
            if abs(found.rate * period - 1.0) > RATE_TOLERANCE:
                told.append(
                    f"states come at {found.rate:.1f} Hz; {1.0 / period:g} Hz are"
                    " expected"
                )
            elif found.jitter > JITTER_TOLERANCE * period:
                limit = JITTER_TOLERANCE * period
                told.append(
                    f"the states' period varies by {1e3 * found.jitter:.2f} ms; the"
                    f" limit is {1e3 * limit:.2f} ms"
                )
        return told + self.missed_lately()

    def lateness(self, period: float) -> str:
        """Return whether commands came too late for the robot lately, in words with the
        numbers; empty where they did not.

        An answer is late by what it took longer than the promptest one from its state's
        sending, so that a clock of another machine that is ahead or behind counts for
        nothing. A state is late by what its arrival's distance exceeds a period.

        Args:
            period: the nominal one, s.
        """
        told = []
        delays = [age - min(self._ages) for age in self._ages]
        gaps = [gap - period for gap in self._gaps]
        for numbers, what in ((delays, "answers"), (gaps, "states")):
            late = sum(number > period for number in numbers)
            worst = max(numbers, default=0.0)
            if late > MOST_LATE * len(numbers) or worst > LONG * period:
                told.append(
                    f"{late} of the last {len(numbers)} {what}"
                    f" ({late / len(numbers):.0%}) were late by more than a period of"
                    f" {1e3 * period:g} ms, by {1e3 * worst:.1f} ms at most"
                )
        return f"commands came too late: {'; '.join(told)}" if told else ""

    def missed_lately(self) -> list[str]:
        """Return whether states were missed, or stamps were off the period, within the
        last LATELY reports.
        """
        lately = {
            name: self.counts[name] - self._before[0][name]
            for name in ("missed_states", "irregular_stamps")
        }
        words = ("states were missed", "stamps were off the period")
        return [
            f"{count} {what} lately"
            for count, what in zip(lately.values(), words, strict=True)
            if count > 0
        ]

    def report(self, saturated: int) -> dict[str, object]:
        """Return the values for /diagnostics.

        Args:
            saturated: ticks so far at a torque limit; begins again with each
                trajectory.
        """
        found = self._intervals.regularity()
        saturated_before, states_before = self._reported
        self._reported = (saturated, self.counts["states"])
        more = saturated - (saturated_before if saturated >= saturated_before else 0)
        ticks = self.counts["states"] - states_before
        self._before.append(dict(self.counts))
        values: dict[str, object] = {
            **self.counts,
            "rate": round(found.rate, 2),
            "jitter_us": _us(found.jitter),
            "interval_p99_us": _us(found.p99),
            "interval_max_us": _us(found.longest),
            "state_age": round(time.perf_counter() - self._arrival, 4),
            "saturated_ticks": saturated,
            "saturated_share": round(min(more / ticks, 1.0), 4) if ticks else 0.0,
        }
        for name, window in (
            ("callback", self._work),
            *([("latency", self._latencies)] if len(self._latencies.numbers) else []),
        ):
            middle, p99 = window.percentiles(50.0, 99.0)
            values |= {f"{name}_p50_us": _us(middle), f"{name}_p99_us": _us(p99)}
        return values


def _us(seconds: float) -> float:
    return round(1e6 * seconds, 1)
