"""Late external positions, taken as out-of-sequence measurements.

The past samples are kept, each with the filters' state after it. A position is taken at
its stamp: the filters go back to the sample at or before it, are predicted up to the
stamp, corrected there, and take all later samples again. The result is that of a filter
that got the position without delay. The cost is one sample's for each sample of the
delay.

**Which assembly mode.** The joints leave two places for the end effector, mirror images
about the line of the elbows. A position that fits neither is refused, however often it
is repeated: a blow shows in the joints, a bumped camera does not. The exception is a
blow along t_s near the locus, which hardly shows there: where the position before was
used, a position that is off along t_s alone is explained by such a blow. A position
that fits only the image counts against the estimate by the ratio of the two
likelihoods, bounded by MOST_TOLD, as one position may always be wrong. When enough has
been counted (``crossing_test.log_odds``) the estimate moves to the image. Near the
locus, where the assembly mode is unknown anyway, it does so at once, and such positions
do not count later.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from dextar_control.estimation.belief import Belief, log_odds_of_side
from dextar_control.estimation.observer import LONG, Observer
from dextar_control.symbols.record import Record
from dextar_control.symbols.types import Array

LENGTH = 160  # samples and positions that are kept
# s within which two stamps are one: a double holds the seconds since 1970 to a quarter
# of it
SAME_TIME = 1e-6
# log-odds that one position can give: one in four hundred may be wrong
MOST_TOLD = 6.0
# squared normalised distance that one good position in a thousand exceeds
SURPRISE = 13.8


class PositionOutcome(IntEnum):
    """The outcome of an external position."""

    TAKEN = 0
    STRUCK = 1  # explained by a blow along t_s near the locus
    AGAINST = 2  # fits the mirror image alone: counts against the assembly mode
    SWAPPED = 3  # has made the estimate move to the mirror image
    EARLY = 4  # from before the first sample, or before a long gap
    TOO_OLD = 5  # from before the samples that are kept
    JUMP = 6  # fits neither the estimate nor its mirror image
    NOT_FINITE = 7
    OUT_OF_ORDER = 8
    FUTURE = 9


USED = (
    PositionOutcome.TAKEN,
    PositionOutcome.STRUCK,
    PositionOutcome.AGAINST,
    PositionOutcome.SWAPPED,
)


class PositionLimits(NamedTuple):
    """The noise of external positions."""

    deviation: float  # of each coordinate, m
    gate: float  # squared normalised distance beyond which none is taken


class Distances(NamedTuple):
    """The distances of a position from what was expected."""

    estimate: float  # from the estimate, standard deviations
    image: float  # from its mirror image, standard deviations
    length: float  # from the estimate, m


class _Entry:
    """One sample or position, and the filters' state after it."""

    __slots__ = ("belief", "dt", "filters", "q_meas", "tau", "time")

    def __init__(
        self, time: float, dt: float, tau: Array, q_meas: Array, observer: Observer
    ) -> None:
        self.time, self.dt, self.tau, self.q_meas = time, dt, tau, q_meas
        self.keep(observer)

    def keep(self, observer: Observer) -> None:
        """Keep the filters' state."""
        self.filters = (
            observer.main.numbers.copy(),
            observer.same.numbers.copy(),
            observer.image.numbers.copy(),
        )
        self.belief = observer.belief.copy()

    def give(self, observer: Observer) -> None:
        """Restore the filters' state."""
        for record, numbers in zip(
            (observer.main, observer.same, observer.image), self.filters, strict=True
        ):
            record.numbers[:] = numbers
        observer.belief = self.belief.copy()
        observer.look_again()


class SampleHistory:
    """The past samples of an observer, into which positions are taken.

    Args:
        observer: which takes its samples through ``take_sample``.
    """

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._entries: list[_Entry] = []
        self._spare = observer.layout.make()
        self.distances = Distances(0.0, 0.0, 0.0)

    def begin(self) -> None:
        """Forget all samples but the filters' present state."""
        nothing = np.zeros(self._observer.n)
        self._entries = [_Entry(0.0, 0.0, nothing, nothing, self._observer)]

    @property
    def reach(self) -> float:
        """The age of the oldest sample that is kept, s."""
        return self._entries[-1].time - self._entries[0].time

    def take_sample(self, tau: Array, dt: float, q_meas: Array) -> None:
        """Take a sample of the joints q_meas (n,), rad, after torques tau (n,), N m,
        over dt, s.
        """
        self._observe(tau, dt, q_meas)
        time, observer = self._entries[-1].time + dt, self._observer
        self._append(_Entry(time, dt, tau.copy(), q_meas.copy(), observer))

    def _append(self, entry: _Entry) -> None:
        self._entries.append(entry)
        del self._entries[:-LENGTH]

    def _observe(self, tau: Array, dt: float, q_meas: Array) -> None:
        """Take a sample as ``Observer.observe`` does, and bound ``Belief.seen`` by the
        log-odds of the side on which the main filter is.

        The bound is zero where the robot may turn round without a trace in the joints:
        there past positions say little about the present side.
        """
        observer = self._observer
        swaps = observer.belief.swaps
        observer.observe(tau, dt, q_meas)
        belief = observer.belief
        if belief.swaps > swaps:
            belief.seen = -belief.seen
        s, folded = abs(observer.told.s), observer.is_folded()
        if belief.seen != 0.0 and s < observer.crossing_test.begin_below_abs_s:
            known = s >= observer.crossing_test.unknown_below_abs_s or folded
            most = log_odds_of_side(s, observer.told.s_variance) if known else 0.0
            belief.seen = min(max(belief.seen, -most), most)
        if belief.armed and not folded:
            belief.log_odds = belief.seen

    def take_position(
        self, limits: PositionLimits, age: float, x_meas: Array, trusted: bool
    ) -> PositionOutcome:
        """Take a position of ``age`` before the newest sample, and the later samples
        again; the outcome.

        Args:
            limits: the noise of the positions.
            age: s, not negative, and less than that of the position before.
            x_meas: the position, (n,), m.
            trusted: whether the position before was used.
        """
        entries, observer = self._entries, self._observer
        stamp = entries[-1].time - age
        row = len(entries) - 1
        while row >= 0 and entries[row].time > stamp + SAME_TIME:
            if entries[row].dt > LONG:
                return PositionOutcome.EARLY
            row -= 1
        if row < 0 and len(entries) < LENGTH:
            return PositionOutcome.EARLY
        if row <= 0 and len(entries) >= LENGTH:
            return PositionOutcome.TOO_OLD
        later = entries[row + 1 :]
        entries[row].give(observer)
        gap = stamp - entries[row].time
        if gap > SAME_TIME and later:
            observer.predict_all(later[0].tau, gap)
            observer.look_again()
        else:
            gap = 0.0
        outcome = self._take_now(limits, x_meas, trusted)
        if outcome is PositionOutcome.JUMP:
            entries[-1].give(observer)
            return outcome
        del entries[row + 1 :]
        time, torque = entries[row].time + gap, np.zeros(observer.n)
        self._append(_Entry(time, gap, torque, x_meas, observer))
        for step, entry in enumerate(later):
            if step == 0:
                entry.dt -= gap
            self._observe(entry.tau, entry.dt, entry.q_meas)
            entry.keep(observer)
            self._append(entry)
        return outcome

    def _take_now(
        self, limits: PositionLimits, x_meas: Array, trusted: bool
    ) -> PositionOutcome:
        """Take a position (n,), m, into the filters in their present state; the
        outcome.
        """
        observer, spare = self._observer, self._spare
        main, belief = observer.main, observer.belief
        square, spread, length = self._distance(main, x_meas, limits)
        has_image = observer.mirror(main, spare)
        square_image, spread_image, _ = (
            self._distance(spare, x_meas, limits) if has_image else (math.inf, 0.0, 0.0)
        )
        self.distances = Distances(math.sqrt(square), math.sqrt(square_image), length)
        surprising = square > SURPRISE and not square_image <= SURPRISE
        if (
            belief.armed
            and not observer.is_folded()
            and trusted
            and surprising
            and self._explained_by_blow(limits, x_meas)
        ):
            return PositionOutcome.STRUCK
        fits = square <= limits.gate
        if not fits and not square_image <= limits.gate:
            return PositionOutcome.JUMP
        ratio = 0.5 * (square_image + spread_image - square - spread)
        told = min(max(ratio, -MOST_TOLD), MOST_TOLD)
        decisive = observer.crossing_test.log_odds
        seen = min(max(belief.seen + told, -decisive), decisive)
        if belief.testing:
            belief.log_odds += seen - belief.seen
        else:
            belief.log_odds = seen if seen < 0.0 else max(belief.log_odds, seen)
        belief.seen = seen
        if fits:
            observer.correct_position(main, x_meas, limits.deviation)
            observer.look_again()
            return PositionOutcome.TAKEN
        if belief.armed:
            seen = told
        elif seen > -decisive:
            return PositionOutcome.AGAINST
        self._move_to_image(belief, seen, x_meas, limits)
        return PositionOutcome.SWAPPED

    def _distance(
        self, state: Record, x_meas: Array, limits: PositionLimits
    ) -> tuple[float, float, float]:
        """Return (squared normalised distance of a position (n,), m, from a filter's,
        ln det of its covariance, distance, m).
        """
        return self._observer.correct_position(state.copy(), x_meas, limits.deviation)

    def _explained_by_blow(self, limits: PositionLimits, x_meas: Array) -> bool:
        """Return whether a blow along t_s explains the position, which is then taken
        so.
        """
        observer, spare = self._observer, self._spare
        spare.take(observer.main)
        observer.allow_for_unseen_blow(spare)
        if (
            not observer.correct_position(spare, x_meas, limits.deviation)[0]
            <= SURPRISE
        ):
            return False
        observer.main.take(spare)
        observer.look_again()
        observer.belief.seen = observer.belief.log_odds = 0.0
        return True

    def _move_to_image(
        self, belief: Belief, seen: float, x_meas: Array, limits: PositionLimits
    ) -> None:
        """Move the main filter to the mirror image, and correct it with the
        position.
        """
        observer, spare = self._observer, self._spare
        observer.mirror(observer.main, spare)
        observer.correct_position(spare, x_meas, limits.deviation)
        observer.main.take(spare)
        observer.same.take(spare)
        observer.look_again()
        belief.mode = -belief.mode
        belief.testing = False
        belief.seen = belief.log_odds = -seen
        belief.swaps += 1
