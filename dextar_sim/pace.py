"""The pace of the plant node: in step with the commander in lockstep, and with the
steady clock unless it runs as fast as possible.

Deadlines lie one period apart on the steady clock. What is late is made up for by
shorter periods, so that simulated time keeps up with the clock; only a machine that was
away for longer than ``MOST_BEHIND`` loses that time.
"""

from __future__ import annotations

# Share of the period below which two deadlines never come together, however late the
# samples are.
SHORTEST = 0.75
# The same while the command for the last sample is awaited: making up must not make
# commands late.
PATIENT = 0.95
# Share of the period by which a sample may miss its deadline and not move the next one.
JITTER = 0.25
# s after which timers and services are served where the loop does not sleep.
SERVED_EACH = 0.01
MOST_BEHIND = 50_000_000  # ns up to which lateness is made up for


# Real-time factor below which a real-time plant is too slow: the rate that its states
# then miss is warned of there too.
LEAST_FACTOR = 0.95
# Share of the steps without their command in time, above which that is told: a held
# command is an older one.
MOST_LATE = 0.1
JUDGED = 500_000_000  # ns of running from which on they are judged


def keeping_pace(steps: int, late: int, ran: int, period: int) -> list[str]:
    """Say what is wrong with the pace of a real-time plant over some time, each with
    number, limit and meaning.

    Args:
        steps: that were simulated.
        late: of them, without their command in time.
        ran: for which it ran, ns; pauses do not count.
        period: of the steps, ns.
    """
    if ran < JUDGED:
        return []
    told = []
    factor, share = steps * period / ran, late / max(steps, 1)
    if factor < LEAST_FACTOR:
        told.append(
            f"real-time factor {factor:.2f} over the last {1e-9 * ran:.1f} s; the limit"
            f" is {LEAST_FACTOR:g}: this machine is too slow or too busy, states come"
            " too seldom"
        )
    if share > MOST_LATE:
        told.append(
            f"{100 * share:.0f} % of the steps without their command in time; the limit"
            f" is {100 * MOST_LATE:.0f} %: the drives go on under an older one"
        )
    return told


class Schedule:
    """Knows when the samples of a periodic task are due, ns of the steady clock.

    The due times lie whole periods apart. A sample that is late does not move the later
    ones: their deadlines follow it by ``SHORTEST`` periods at least, by ``PATIENT``
    ones where its command is awaited, until one is on time again; no two samples come
    closer than half a period. Lateness beyond ``MOST_BEHIND`` (and beyond a period) is
    dropped: the due times move by all of it.

    Args:
        period: ns.

    Attributes:
        running: between ``start`` and ``stop``.
        overruns: samples out by more than half a period after they might have been.
        longest: the largest of these delays, ns.
        behind: how long after it was due the last sample came, ns.
        slip: lateness that was dropped, ns: so much simulated time has fallen behind
            the clock.
    """

    def __init__(self, period: int) -> None:
        self._period = period
        self._shortest = round(SHORTEST * period)
        self._patient = round(PATIENT * period)
        self._most_behind = max(MOST_BEHIND, period)
        self._due = 0
        self._last = 0
        self._begun = 0
        self._ran = 0
        self.running = False
        self.overruns = 0
        self.longest = 0
        self.behind = 0
        self.slip = 0
        self._work = 0.0
        self._served = 0

    def start(self, now: int, wait: int) -> None:
        """Run again; the first sample is due in ``wait`` ns."""
        self.running = True
        self._begun, self._due = now, now + wait
        self._last = self._due - self._period

    def stop(self, now: int) -> None:
        """Pause: nothing is due until ``start``, and the time until then is no overrun
        and does not count as run.
        """
        self._ran = self.ran(now)
        self.running = False
        self.behind = 0

    def ran(self, now: int) -> int:
        """Return the steady clock without the pauses, ns since the first ``start``."""
        return self._ran + now - self._begun if self.running else self._ran

    def deadline(self, awaited: bool) -> int:
        """Return the deadline of the coming sample: when it is due, or some time after
        the last one, whose command is awaited or not.
        """
        return max(
            self._due, self._last + (self._patient if awaited else self._shortest)
        )

    def left(self, now: int, awaited: bool) -> float:
        """Return the seconds until the deadline, 0 when it has passed."""
        return max(0.0, 1.0e-9 * (self.deadline(awaited) - now))

    def left_to_work(self, now: int, awaited: bool) -> float:
        """Return the seconds until the work for the deadline must begin, 0 when that
        has passed.
        """
        reserve = min(self._work, 0.6e-9 * self._period)
        return max(0.0, self.left(now, awaited) - reserve)

    def serve(self, now: int) -> bool:
        """Tell whether timers and services are to be served now, once each
        ``SERVED_EACH``.
        """
        if now - self._served < 1.0e9 * SERVED_EACH:
            return False
        self._served = now
        return True

    def worked(self, duration: int) -> None:
        """Take one measured duration of the work, ns, into its running mean."""
        self._work += 0.05 * (1.0e-9 * duration - self._work)

    def met(self, now: int, awaited: bool) -> None:
        """Note that the sample that was due is out; the command for the one before it
        is awaited or not.
        """
        deadline = self.deadline(awaited)
        missed, self.behind = now - deadline, max(0, now - self._due)
        if 2 * missed > self._period:
            self.overruns += 1
            self.longest = max(self.longest, missed)
        if self.behind > self._most_behind:
            self.slip += self.behind
            self._due, self.behind = now, 0
        self._due += self._period
        self._last = deadline if missed <= JITTER * self._period else now
