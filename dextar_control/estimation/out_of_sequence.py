"""A position that was true a while ago, taken as if it had arrived in time: an
out-of-sequence measurement.

The past samples are kept in a ring, each with the filters' state after it. A position
is taken where its stamp lies: the filters go back to the sample at or before it, are
predicted up to the stamp, corrected there, and take all later samples again. What comes
out is what a filter would have that got the position without delay. The cost is one
sample's for each sample of the delay.

**Which assembly mode.** The joints leave two places for the end effector, mirror images
about the line of the elbows. A position that fits neither is no place of the robot's at
all, so it is refused, however often it is repeated: a blow shows in the joints, a
bumped camera does not. The exception is a blow along t_s near the locus, which hardly
shows there: of a camera that was believed until then a position that is off along t_s
alone is taken for one. One that fits only the image counts against the estimate by the
ratio of the two likelihoods, bounded by SIGHT, as one position may always be a blunder;
when enough has been counted (``Passage.log_odds``) the estimate moves to the image.
Near the locus, where the assembly mode counts as unknown anyway, it does so at once;
and what was seen there does not count for later.
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
SIGHT = 6.0  # log-odds that one position can give: one in four hundred may be a blunder
SURPRISE = (
    13.8  # squared normalised distance that one good position in a thousand exceeds
)


class Fate(IntEnum):
    """What became of a position."""

    TAKEN = 0
    STRUCK = 1  # shows a blow along t_s near the locus
    # fits the mirror image of the estimate alone: counts against its assembly mode
    AGAINST = 2
    SWAPPED = (
        3  # did so often enough, or near the locus: the estimate has moved to the image
    )
    EARLY = 4  # from before the first sample, or before a long gap
    TOO_OLD = 5  # from before the samples that are kept
    JUMP = 6  # fits neither
    NOT_FINITE = 7
    OUT_OF_ORDER = 8
    FUTURE = 9


USED = (Fate.TAKEN, Fate.STRUCK, Fate.AGAINST, Fate.SWAPPED)


class Sight(NamedTuple):
    """What the filter is told of the positions."""

    deviation: float  # of each coordinate, m
    gate: float  # squared normalised distance beyond which none is taken


class Distances(NamedTuple):
    """How far a position was off."""

    estimate: float  # from the estimate, standard deviations
    image: float  # from its mirror image, standard deviations
    length: float  # from the estimate, m


class _Entry:
    """What came in at one instant, and the filters after it."""

    __slots__ = ("belief", "dt", "filters", "q_meas", "tau", "time")

    def __init__(
        self, time: float, dt: float, tau: Array, q_meas: Array, observer: Observer
    ) -> None:
        self.time, self.dt, self.tau, self.q_meas = time, dt, tau, q_meas
        self.keep(observer)

    def keep(self, observer: Observer) -> None:
        """The filters as they are now."""
        self.filters = (
            observer.main.numbers.copy(),
            observer.same.numbers.copy(),
            observer.image.numbers.copy(),
        )
        self.belief = observer.belief.copy()

    def give(self, observer: Observer) -> None:
        """Make the filters what they were."""
        for record, numbers in zip(
            (observer.main, observer.same, observer.image), self.filters, strict=True
        ):
            record.numbers[:] = numbers
        observer.belief = self.belief.copy()
        observer.look_again()


class History:
    """The past of an observer, and positions taken into it.

    Args:
        observer: whose samples come through ``take_sample``.
    """

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._entries: list[_Entry] = []
        self._spare = observer.layout.make()
        self.distances = Distances(0.0, 0.0, 0.0)

    def begin(self) -> None:
        """Forget everything but the filters' present state."""
        nothing = np.zeros(self._observer.n)
        self._entries = [_Entry(0.0, 0.0, nothing, nothing, self._observer)]

    @property
    def reach(self) -> float:
        """Age of the oldest sample that is kept, s."""
        return self._entries[-1].time - self._entries[0].time

    def take_sample(self, tau: Array, dt: float, q_meas: Array) -> None:
        """One sample of the joints; see ``Observer.observe``."""
        self._observe(tau, dt, q_meas)
        self._append(
            _Entry(
                self._entries[-1].time + dt,
                dt,
                tau.copy(),
                q_meas.copy(),
                self._observer,
            )
        )

    def _append(self, entry: _Entry) -> None:
        self._entries.append(entry)
        del self._entries[:-LENGTH]

    def _observe(self, tau: Array, dt: float, q_meas: Array) -> None:
        """``Observer.observe``, and what was seen is worth no more than the certainty
        of the side on which main is.

        Nothing where the robot may turn round without a trace in the joints: where it
            was seen says little about later.
        """
        observer = self._observer
        swaps = observer.belief.swaps
        observer.observe(tau, dt, q_meas)
        belief = observer.belief
        if belief.swaps > swaps:
            belief.seen = -belief.seen
        s, folded = abs(observer.told.s), observer.is_folded()
        if belief.seen != 0.0 and s < observer.passage.begin:
            known = s >= observer.passage.armed or folded
            most = log_odds_of_side(s, observer.told.s_variance) if known else 0.0
            belief.seen = min(max(belief.seen, -most), most)
        if belief.armed and not folded:
            belief.log_odds = belief.seen

    def take_position(
        self, sight: Sight, age: float, x_meas: Array, trusted: bool
    ) -> Fate:
        """A position that was true ``age`` before the newest sample; the later samples
        are taken again.

        Args:
            sight: what is told of the positions.
            age: s, not negative, and less than that of the position before.
            x_meas: (n,) m.
            trusted: whether the position before was taken.
        """
        entries, observer = self._entries, self._observer
        stamp = entries[-1].time - age
        row = len(entries) - 1
        while row >= 0 and entries[row].time > stamp + SAME_TIME:
            if entries[row].dt > LONG:
                return Fate.EARLY
            row -= 1
        if row < 0 and len(entries) < LENGTH:
            return Fate.EARLY
        if row <= 0 and len(entries) >= LENGTH:
            return Fate.TOO_OLD
        later = entries[row + 1 :]
        entries[row].give(observer)
        gap = stamp - entries[row].time
        if gap > SAME_TIME and later:
            observer.predict_all(later[0].tau, gap)
            observer.look_again()
        else:
            gap = 0.0
        fate = self._see(sight, x_meas, trusted)
        if fate is Fate.JUMP:
            entries[-1].give(observer)
            return fate
        del entries[row + 1 :]
        self._append(
            _Entry(entries[row].time + gap, gap, np.zeros(observer.n), x_meas, observer)
        )
        for step, entry in enumerate(later):
            if step == 0:
                entry.dt -= gap
            self._observe(entry.tau, entry.dt, entry.q_meas)
            entry.keep(observer)
            self._append(entry)
        return fate

    def _see(self, sight: Sight, x_meas: Array, trusted: bool) -> Fate:
        """Take a position into the filters as they stand; says what became of it."""
        observer, spare = self._observer, self._spare
        main, belief = observer.main, observer.belief
        square, spread, length = self._distance(main, x_meas, sight)
        has_image = observer.mirror(main, spare)
        square_image, spread_image, _ = (
            self._distance(spare, x_meas, sight) if has_image else (math.inf, 0.0, 0.0)
        )
        self.distances = Distances(math.sqrt(square), math.sqrt(square_image), length)
        surprising = square > SURPRISE and not square_image <= SURPRISE
        if (
            belief.armed
            and not observer.is_folded()
            and trusted
            and surprising
            and self._seen_as_blow(sight, x_meas)
        ):
            return Fate.STRUCK
        fits = square <= sight.gate
        if not fits and not square_image <= sight.gate:
            return Fate.JUMP
        told = min(
            max(0.5 * (square_image + spread_image - square - spread), -SIGHT), SIGHT
        )
        decisive = observer.passage.log_odds
        seen = min(max(belief.seen + told, -decisive), decisive)
        if belief.testing:
            belief.log_odds += seen - belief.seen
        else:
            belief.log_odds = seen if seen < 0.0 else max(belief.log_odds, seen)
        belief.seen = seen
        if fits:
            observer.correct_position(main, x_meas, sight.deviation)
            observer.look_again()
            return Fate.TAKEN
        if belief.armed:
            seen = told
        elif seen > -decisive:
            return Fate.AGAINST
        self._move_to_image(belief, seen, x_meas, sight)
        return Fate.SWAPPED

    def _distance(
        self, state: Record, x_meas: Array, sight: Sight
    ) -> tuple[float, float, float]:
        """Squared normalised distance of a position from a filter's, ln det of its
        covariance, and the distance, m.
        """
        return self._observer.correct_position(state.copy(), x_meas, sight.deviation)

    def _seen_as_blow(self, sight: Sight, x_meas: Array) -> bool:
        """Whether a blow along t_s explains the position; then it is taken so."""
        observer, spare = self._observer, self._spare
        spare.take(observer.main)
        observer.allow_for_unseen_blow(spare)
        if not observer.correct_position(spare, x_meas, sight.deviation)[0] <= SURPRISE:
            return False
        observer.main.take(spare)
        observer.look_again()
        observer.belief.seen = observer.belief.log_odds = 0.0
        return True

    def _move_to_image(
        self, belief: Belief, seen: float, x_meas: Array, sight: Sight
    ) -> None:
        """The robot is the mirror image of what was believed."""
        observer, spare = self._observer, self._spare
        observer.mirror(observer.main, spare)
        observer.correct_position(spare, x_meas, sight.deviation)
        observer.main.take(spare)
        observer.same.take(spare)
        observer.look_again()
        belief.mode = -belief.mode
        belief.testing = False
        belief.seen = belief.log_odds = -seen
        belief.swaps += 1
