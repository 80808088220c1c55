"""The health of the stream of joint states: for how long it has had no gap, and
whether one publisher alone sends it.
"""

from __future__ import annotations

import math

from dextar_control.contract.errors import StateError

NANOSECONDS = 1_000_000_000
UNNUMBERED = (0, 2**64 - 1)
"""The numbers of messages that the middleware does not count."""
MIXED = 2.0
"""s for which a number that steps back shows a second publisher; a plant in lockstep
repeats a message each 0.5 s.
"""


class StateStream:
    """The time since the last gap, refusal, repetition or step back of the states: the
    healthy time.

    It is counted by their stamps, and where arrivals on a steady clock are given by the
    shorter of the two spans: states that arrive in a burst show no more than the burst
    lasted.

    Attributes:
        trouble: what ended the healthy time last; empty when nothing did.
    """

    def __init__(self) -> None:
        self.trouble = ""
        self._first = self._last = -1  # ns, stamps
        self._first_arrival = self._last_arrival = math.nan  # s
        self._number: int | None = None
        self._stepped_back = -math.inf  # s

    def hear(self, number: int | None, now: float) -> None:
        """Note the number of a state that has come, used or not. Each publisher numbers
        its own, so that a number that does not rise is another publisher's.

        Args:
            number: None or one of ``UNNUMBERED`` where there is none.
            now: on the steady clock, s.
        """
        if number is None or number in UNNUMBERED:
            return
        if self._number is not None and number <= self._number:
            self._stepped_back = now
        self._number = number

    def mixed(self, now: float) -> bool:
        """Return whether a state of another publisher, or of one that was started
        again, came within the last ``MIXED`` before ``now``, s.
        """
        return now - self._stepped_back <= MIXED

    def take(self, stamp: int, limit: float, arrival: float | None = None) -> None:
        """Take a state that can be used.

        Args:
            stamp: ns.
            limit: longest gap, s.
            arrival: on the steady clock, s; None where states may come at any pace.
        """
        at = math.nan if arrival is None else arrival
        if self._last >= 0:
            gap = (stamp - self._last) / NANOSECONDS
            late = at - self._last_arrival
            if gap <= 0.0:
                self.spoil(f"a state of {stamp} ns after one of {self._last} ns")
            elif gap > limit or late > limit:
                self.spoil(
                    f"no state for {1e3 * (gap if gap > limit else late):.1f} ms; the"
                    f" limit is {1e3 * limit:.1f} ms"
                )
        if self._first < 0:
            self._first, self._first_arrival = stamp, at
        self._last, self._last_arrival = stamp, at

    def spoil(self, trouble: str) -> None:
        """Begin the healthy time again with the next state, because of a trouble."""
        self.trouble = trouble
        self._first = self._last = -1

    def healthy_for(self, limit: float, now: float | None = None) -> float:
        """Return the healthy time, s; 0 where the last state is older than ``limit``,
        s, on the steady clock ``now``, s.
        """
        if self._first < 0:
            return 0.0
        span = (self._last - self._first) / NANOSECONDS
        if now is None or math.isnan(self._last_arrival):
            return span
        if now - self._last_arrival > limit:
            return 0.0
        return min(span, self._last_arrival - self._first_arrival)

    def check(self, needed: float, limit: float, now: float | None = None) -> None:
        """Check that the states have been healthy for long enough.

        Args:
            needed: s; 0 asks only that the last state, if there was one, is not stale.
            limit: age of the last state beyond which it is, s.
            now: on the steady clock, s; None where states may come at any pace.

        Raises:
            StateError: they have not; names the healthy time, the needed one and the
                last trouble.
        """
        age = math.nan if now is None or self._last < 0 else now - self._last_arrival
        if age > limit:
            told = f"no state for {1e3 * age:.0f} ms; the limit is {1e3 * limit:.1f} ms"
            raise StateError(f"{told}: see that the rig or plant runs")
        healthy = self.healthy_for(limit, now)
        if healthy < needed:
            cause = f" (last: {self.trouble})" if self.trouble else ""
            raise StateError(
                f"healthy states for {healthy:.2f} s; {needed:g} s are needed{cause}"
            )
