"""Whether joint states come as they should, for how long they have, and whether one
publisher alone sends them.
"""

from __future__ import annotations

import math

from dextar_control.contract.errors import StateError

NANOSECONDS = 1_000_000_000
UNNUMBERED = (0, 2**64 - 1)
"""What stands for a message's number where the middleware does not count them."""
MIXED = 2.0
"""s for which a number that steps back says that a second publisher speaks; a plant in
lockstep repeats each 0.5 s.
"""


class StateStream:
    """Counts healthy time: since the last gap, refusal, repetition or step back of the
    states.

    It counts by their stamps. Where arrivals are told, on a steady clock, it counts the
    shorter of the two spans: states that arrive in a burst prove no more than the burst
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
        """A state has come, used or not; each publisher numbers its own, so a number
        that does not rise is another's.

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
        """Whether another publisher's state came within the last ``MIXED``: a second
        one, or one that was started again.
        """
        return now - self._stepped_back <= MIXED

    def take(self, stamp: int, limit: float, arrival: float | None = None) -> None:
        """A state that can be used.

        Args:
            stamp: ns.
            limit: longest gap, s.
            arrival: on the steady clock, s; None where states may come at any pace.
        """
        if self._last >= 0:
            gap = (stamp - self._last) / NANOSECONDS
            late = math.nan if arrival is None else arrival - self._last_arrival
            if gap <= 0.0:
                self.spoil(f"a state of {stamp} ns after one of {self._last} ns")
            elif gap > limit or late > limit:
                self.spoil(
                    f"no state for {1e3 * (gap if gap > limit else late):.1f} ms; the"
                    f" limit is {1e3 * limit:.1f} ms"
                )
        if self._first < 0:
            self._first = stamp
            self._first_arrival = math.nan if arrival is None else arrival
        self._last = stamp
        self._last_arrival = math.nan if arrival is None else arrival

    def spoil(self, trouble: str) -> None:
        """The healthy time begins again, with the next state."""
        self.trouble = trouble
        self._first = self._last = -1

    def healthy_for(self, limit: float, now: float | None = None) -> float:
        """Healthy time, s; none where the last state is older than ``limit``, s, on the
        steady clock ``now``.
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
        """Whether the states have been healthy for long enough.

        Args:
            needed: s; 0 asks only that the last state, if there was one, is not stale.
            limit: age of the last state beyond which it is, s.
            now: on the steady clock, s; None where states may come at any pace.

        Raises:
            StateError: they have not; says for how long they have, how long is needed
                and what went wrong last.
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
