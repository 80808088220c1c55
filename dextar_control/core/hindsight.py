"""A position that was true a while ago, taken as if it had arrived in time.

The past samples are kept in a ring, each with the filters' state after it. A position is taken where
its stamp lies: the filters go back to the sample at or before it, are predicted up to the stamp,
corrected there, and take all later samples again. What comes out is what a filter would have that got the
position without delay. The cost is one sample's for each sample of the delay.

**Which assembly mode.** The joints leave two places for the end effector, mirror images about the line of the
elbows. A position that fits neither is no place of the robot's at all, so it is refused, however often it is
repeated: a blow shows in the joints, a bumped camera does not. The exception is a blow along t_s near the
locus, which hardly shows there: of a camera that was believed until then a position that is off along t_s
alone is taken for one. One that fits only the image counts against the
estimate by the ratio of the two likelihoods, bounded by SIGHT, as one position may always be a blunder;
when enough has been counted (``Passage.log_odds``) the estimate moves to the image. Near the locus, where the
assembly mode counts as unknown anyway, it does so at once; and what was seen there does not count for later.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dextar_control.core.compiled import njit
from dextar_control.core.dynamics import apply, inverse
from dextar_control.core.kinematics import singular_values, state_of_platform
from dextar_control.core.model import Array, Model
from dextar_control.core.observer import (
    ARMED,
    BELIEF,
    FILTER,
    LOG_ODDS,
    LONG,
    MODE,
    SEEN,
    SWAPS,
    TESTING,
    Bank,
    Gauss,
    Noise,
    Passage,
    copy,
    correct_position,
    log_odds_of_side,
    mirror,
    observe,
    predict_all,
    side,
    unpack_bank,
    unpack_filter,
    unpack_tuning,
)

LENGTH = 160  # samples and positions that are kept
SAME_TIME = 1e-6  # s within which two stamps are one: a double holds the seconds since 1970 to a quarter of it
SIGHT = 6.0  # log-odds that one position can give: one in four hundred may be a blunder
SURPRISE = 13.8  # squared normalised distance that one good position in a thousand exceeds
BLIND = 0.02  # s before a position in which at most a blow near the locus may have gone unseen
TAKEN, STRUCK, AGAINST, SWAPPED, EARLY, TOO_OLD, JUMP = range(7)


class Sight(NamedTuple):
    """What the filter is told of the positions."""

    deviation: float  # of each coordinate, m
    gate: float  # squared normalised distance beyond which none is taken


class History(NamedTuple):
    """The ring: what came in, and the filters after it."""

    time: Array  # (LENGTH,) s, of a clock that begins with the estimator
    dt: Array  # (LENGTH,) since the entry before, s
    tau: Array  # (LENGTH, 2) N m
    q_meas: Array  # (LENGTH, 2) rad
    filters: Array  # (LENGTH, 3, FILTER)
    belief: Array  # (LENGTH, BELIEF)
    ends: NDArray[np.int64]  # (2,) newest row, number of rows


def make_history() -> History:
    """An empty one."""
    return History(
        np.zeros(LENGTH), np.zeros(LENGTH), np.zeros((LENGTH, 2)), np.zeros((LENGTH, 2)), np.zeros((LENGTH, 3, FILTER)),
        np.zeros((LENGTH, BELIEF)), np.zeros(2, dtype=np.int64),
    )  # fmt: skip


def begin(history: History, filters: Array, belief: Array) -> None:
    """Forget everything but the filters' present state."""
    history.ends[:] = 0, 1
    history.time[0], history.dt[0] = 0.0, 0.0
    history.filters[0], history.belief[0] = filters, belief


@njit
def _observe(
    model: Model, noise: Noise, passage: Passage, bank: Bank, belief: Array, tau: Array, dt: float, q_meas: Array
) -> None:
    """``observer.observe``, and what was seen is worth no more than the certainty of the side on which main is.

    Nothing where the robot may turn round without a trace in the joints: where it was seen says little about later.
    """
    swaps = belief[SWAPS]
    observe(model, noise, passage, bank, belief, tau, dt, q_meas)
    if belief[SWAPS] > swaps:
        belief[SEEN] = -belief[SEEN]
    s, stretched = side(model, bank.main)
    if belief[SEEN] != 0.0 and abs(s) < passage.begin:
        known = abs(s) >= passage.armed or not stretched
        most = log_odds_of_side(model, bank.main, s) if known else 0.0
        belief[SEEN] = min(max(belief[SEEN], -most), most)
    if belief[ARMED] > 0.0 and stretched:
        belief[LOG_ODDS] = belief[SEEN]


@njit
def take_sample(
    model: Model, tuning: Array, filters: Array, belief: Array, history: History, tau: Array, dt: float, q_meas: Array
) -> None:
    """One sample of the joints; see ``observer.observe``."""
    noise, passage = unpack_tuning(tuning)
    _observe(model, noise, passage, unpack_bank(filters), belief, tau, dt, q_meas)
    before, count = history.ends
    row = (before + 1) % LENGTH
    history.time[row] = history.time[before] + dt
    history.dt[row], history.tau[row], history.q_meas[row] = dt, tau, q_meas
    history.ends[0], history.ends[1] = row, min(count + 1, LENGTH)
    history.filters[row], history.belief[row] = filters, belief


@njit
def _distance(state: Gauss, x_meas: Array, deviation: float) -> tuple[float, float]:
    """Squared normalised distance of a position from a filter's, and ln det of the covariance of the difference."""
    S = state.covariance[0:2, 0:2].copy()
    S[0, 0] += deviation**2
    S[1, 1] += deviation**2
    difference = x_meas - state.mean[0:2]
    weighted = apply(inverse(S), difference)
    square = difference[0] * weighted[0] + difference[1] * weighted[1]
    return square, np.log(S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0])


@njit
def _allow_for_unseen_blow(model: Model, noise: Noise, state: Gauss) -> None:
    """A blow along t_s at any time in the last BLIND, which b may have been taken for; see ``observer.allow_for_shock``."""
    t_s = singular_values(state_of_platform(model, state.mean[0:2].copy(), np.zeros(2)).A_r).v2
    for i in range(2):
        for j in range(2):
            variance = noise.shock_speed**2 * t_s[i] * t_s[j]
            state.covariance[i, j] += variance * BLIND**2 / 3.0
            state.covariance[i, 2 + j] += variance * BLIND / 2.0
            state.covariance[2 + i, j] += variance * BLIND / 2.0
            state.covariance[2 + i, 2 + j] += variance
        state.covariance[4 + i, 4 + i] += noise.bias**2


@njit
def _see(
    model: Model, noise: Noise, passage: Passage, sight: Sight, bank: Bank, belief: Array, x_meas: Array, trusted: bool,
    distances: Array,
) -> int:  # fmt: skip
    """Take a position into the filters as they stand; says what became of it."""
    main, mirrored = bank.main, unpack_filter(np.empty(FILTER))
    square, spread = _distance(main, x_meas, sight.deviation)
    has_image = mirror(model, main, mirrored)
    square_image, spread_image = _distance(mirrored, x_meas, sight.deviation) if has_image else (np.inf, 0.0)
    distances[0], distances[1] = np.sqrt(square), np.sqrt(square_image)
    difference = x_meas - main.mean[0:2]
    distances[2] = np.sqrt(difference[0] ** 2 + difference[1] ** 2)
    _, stretched = side(model, main)
    if belief[ARMED] > 0.0 and stretched and trusted and square > SURPRISE and not square_image <= SURPRISE:
        copy(main, mirrored)
        _allow_for_unseen_blow(model, noise, mirrored)
        if _distance(mirrored, x_meas, sight.deviation)[0] <= SURPRISE:
            correct_position(mirrored, x_meas, sight.deviation)
            copy(mirrored, main)
            belief[SEEN], belief[LOG_ODDS] = 0.0, 0.0
            return STRUCK
    fits = square <= sight.gate
    if not fits and not square_image <= sight.gate:
        return JUMP
    told = min(max(0.5 * (square_image + spread_image - square - spread), -SIGHT), SIGHT)
    seen = min(max(belief[SEEN] + told, -passage.log_odds), passage.log_odds)
    if belief[TESTING] > 0.0:
        belief[LOG_ODDS] += seen - belief[SEEN]
    else:
        belief[LOG_ODDS] = seen if seen < 0.0 else max(belief[LOG_ODDS], seen)
    belief[SEEN] = seen
    if fits:
        correct_position(main, x_meas, sight.deviation)
        return TAKEN
    if belief[ARMED] > 0.0:
        seen = told
    elif seen > -passage.log_odds:
        return AGAINST
    correct_position(mirrored, x_meas, sight.deviation)
    copy(mirrored, main)
    copy(mirrored, bank.same)
    belief[MODE] = -belief[MODE]
    belief[TESTING] = 0.0
    belief[SEEN], belief[LOG_ODDS] = -seen, -seen
    belief[SWAPS] += 1.0
    return SWAPPED


@njit
def take_position(
    model: Model, tuning: Array, sight: Sight, filters: Array, belief: Array, history: History, age: float, x_meas: Array,
    trusted: bool, distances: Array,
) -> int:  # fmt: skip
    """A position that was true ``age`` before the newest sample; the later samples are taken again.

    Args:
        age: s, not negative, and less than that of the position before.
        x_meas: (2,) m.
        trusted: whether the position before was taken.
        distances: (3,) written: from the estimate and from its image, in standard deviations; from the estimate, m.

    Returns:
        TAKEN; STRUCK: it shows a blow near the locus; AGAINST: it fits the image alone and counts against the estimate;
        SWAPPED: once too often; EARLY: from before the estimator began, or began again after a long gap; TOO_OLD: from
        before the ring; JUMP: fits neither.
    """
    noise, passage = unpack_tuning(tuning)
    bank = unpack_bank(filters)
    newest, count = history.ends
    stamp = history.time[newest] - age
    later = 0
    while later < count and history.time[(newest - later) % LENGTH] > stamp + SAME_TIME:
        if history.dt[(newest - later) % LENGTH] > LONG:
            return EARLY
        later += 1
    if later >= count and count < LENGTH:
        return EARLY
    if later >= LENGTH - 1:
        return TOO_OLD
    row = (newest - later) % LENGTH
    following = (row + 1) % LENGTH
    filters[:], belief[:] = history.filters[row], history.belief[row]
    gap = stamp - history.time[row]
    if gap > SAME_TIME and later > 0:
        predict_all(model, noise, passage, bank, belief[TESTING] > 0.0, history.tau[following], gap)
    else:
        gap = 0.0
    fate = _see(model, noise, passage, sight, bank, belief, x_meas, trusted, distances)
    if fate == JUMP:
        filters[:], belief[:] = history.filters[newest], history.belief[newest]
        return fate
    for back in range(later):  # makes room for it behind its row
        old = (newest - back) % LENGTH
        new = (old + 1) % LENGTH
        history.time[new], history.dt[new] = history.time[old], history.dt[old]
        history.tau[new], history.q_meas[new] = history.tau[old], history.q_meas[old]
    history.time[following] = history.time[row] + gap
    history.ends[0], history.ends[1] = (newest + 1) % LENGTH, min(count + 1, LENGTH)
    history.filters[following], history.belief[following] = filters, belief
    for step in range(1, later + 1):
        again = (following + step) % LENGTH
        if step == 1:
            history.dt[again] -= gap
        _observe(model, noise, passage, bank, belief, history.tau[again], history.dt[again], history.q_meas[again])
        history.filters[again], history.belief[again] = filters, belief
    return fate
