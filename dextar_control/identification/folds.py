"""Where a five-bar's distal links align: folds of the joints' motion, which tell
lengths.

With aligned links the elbows are l2_left + l2_right apart (stretched), or l2_left -
l2_right along the links (folded). The joints touch that distance and turn back from it,
whether the platform crosses there or bounces off.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.signal import find_peaks

from dextar_control.identification.linkage import DISTAL, NAMES, Linkage
from dextar_control.mechanisms.five_bar_locus import Family
from dextar_control.symbols.types import Array

# share of the distal lengths' sum by which an extreme of the elbows' distance may miss
# that of aligned links, by the description
NEAR = 0.02
# share of that sum by which the distance changes over either half of a window
DROP = {Family.STRETCHED: 0.006, Family.FOLDED: 0.03}
LONGEST = 0.15  # s, of either half
FEWEST = 9  # samples in either half
GAP = 0.01  # s between samples at which a window ends
DEGREE = 4  # of the polynomials of time that smooth the elbows' motion in a window
STEPS = 8  # of Newton's method for the instant of a fold
SMOOTHING = 3e-7  # m, what these polynomials leave


class Fold(NamedTuple):
    """A place where the joints turn back.

    Attributes:
        bag: number of the recording.
        family: how the links align.
        time: of the window's middle, on the recording's clock, s.
        instants: (n,) of the samples, -1 to 1 in the window.
        readings: (n, 2) of the encoders, rad.
        passed: (n, 2) on to the links, N m.
        smoother: (DEGREE + 1, n) from samples to coefficients of the polynomials.
        working_mode: of the legs.
    """

    bag: int
    family: Family
    time: float
    instants: Array
    readings: Array
    passed: Array
    smoother: Array
    working_mode: tuple[int, int]


class Touch(NamedTuple):
    """What a fold says of some numbers.

    Attributes:
        gap: the elbows' distance along the links less that of aligned links, m; nan
            where the joints do not turn back.
        gradient: (16,) of the gap by the numbers.
        deviation: standard, of the gap by the samples' own scatter, m.
        x: (2,) of the end effector, m.
    """

    gap: float
    gradient: Array
    deviation: float
    x: Array


NONE = Touch(np.nan, np.zeros(len(NAMES)), np.nan, np.full(2, np.nan))


def find_folds(
    linkage: Linkage,
    numbers: Array,
    working_mode: tuple[int, int],
    time: Array,
    readings: Array,
    bag: int = 0,
    passed: Array | None = None,
) -> list[Fold]:
    """Find the folds of a recording, in order of time.

    Args:
        linkage: its functions.
        numbers: (16,) of the description.
        working_mode: of the legs.
        time: (n,) rising, s.
        readings: (n, 2) of the encoders, rad.
        bag: number of the recording.
        passed: (n, 2) on to the links, N m; none when None.
    """
    passed = np.zeros_like(readings) if passed is None else passed
    distance = np.hypot(*linkage.elbows(numbers, readings, passed).between.T)
    left, right = numbers[list(DISTAL)]
    total = float(left + right)
    found = []
    for family in Family:
        curve = family.value * (distance - abs(left + family.value * right))
        drop = DROP[family] * total
        for peak in find_peaks(curve, height=-NEAR * total, prominence=drop)[0]:
            first, last = (_end(curve, int(peak), step, drop, time) for step in (-1, 1))
            if first is None or last is None:
                continue
            rows = slice(first, last + 1)
            middle = 0.5 * (time[last] + time[first])
            half = 0.5 * (time[last] - time[first])
            instants = (time[rows] - middle) / half
            smoother = np.asarray(np.linalg.pinv(_powers(instants)), dtype=np.float64)
            samples = instants, readings[rows], passed[rows], smoother
            found.append(Fold(bag, family, float(middle), *samples, working_mode))
    return sorted(found, key=lambda fold: fold.time)


def _end(curve: Array, peak: int, step: int, drop: float, time: Array) -> int | None:
    """Find the row on one side of a peak where the curve has dropped enough; None where
    it does not, or samples are missing.
    """
    row = peak
    while abs(row - peak) < FEWEST or curve[peak] - curve[row] < drop:
        if (
            not 0 <= row + step < len(curve)
            or abs(time[row + step] - time[row]) > GAP
            or abs(time[row] - time[peak]) > LONGEST
        ):
            return None
        row += step
    return row


def _powers(instants: Array) -> Array:
    return np.vander(instants, DEGREE + 1, increasing=True)


def touch(linkage: Linkage, numbers: Array, fold: Fold) -> Touch:
    """Evaluate what a fold says of some numbers (16,), in m, rad and rad/(N m)."""
    elbows = linkage.elbows(numbers, fold.readings, fold.passed)
    coefficients = fold.smoother @ elbows.between
    slopes = coefficients[1:] * np.arange(1, DEGREE + 1)[:, None]
    bends = slopes[1:] * np.arange(1, DEGREE)[:, None]
    instant = 0.0
    for _ in range(STEPS):
        powers = _powers(np.array([instant]))[0]
        E, E_dot = powers @ coefficients, powers[:-1] @ slopes
        E_ddot = powers[:-2] @ bends
        bend = float(E_dot @ E_dot + E @ E_ddot)
        # the distance is largest where links are stretched, least where they are folded
        if bend * fold.family.value >= 0.0:
            return NONE
        instant -= float(E @ E_dot) / bend
        if not abs(instant) <= 1.0:
            return NONE
    powers = _powers(np.array([instant]))[0]
    E, E_dot = powers @ coefficients, powers[:-1] @ slopes
    nearest = int(np.abs(fold.instants - instant).argmin())
    d = (
        E / np.hypot(*E)
        if fold.family is Family.STRETCHED
        else _across(E_dot, elbows.u[nearest], fold.working_mode[0])
    )
    weights = powers @ fold.smoother
    gradient = np.einsum("n,nij,i->j", weights, elbows.slopes, d)
    gradient[list(DISTAL)] -= 1.0, fold.family.value
    scatter = (elbows.between - _powers(fold.instants) @ coefficients) @ d
    variance = float(scatter @ scatter) / (len(scatter) - DEGREE - 1)
    repeated = float(scatter[1:] @ scatter[:-1]) / max(float(scatter @ scatter), 1e-30)
    # an encoder count that lasts for some samples is one error, not a new one each time
    repeated = min(max(repeated, 0.0), 0.9)
    return Touch(
        gap=float(E @ d - numbers[DISTAL[0]] - fold.family.value * numbers[DISTAL[1]]),
        gradient=gradient,
        deviation=float(
            np.sqrt(
                variance * (weights @ weights) * (1.0 + repeated) / (1.0 - repeated)
                + SMOOTHING**2
            )
        ),
        x=elbows.left[nearest] + numbers[DISTAL[0]] * d,
    )


def _across(E_dot: Array, u: Array, working_mode: int) -> Array:
    """Direction (2,) of folded links, from the elbows to the end effector.

    Where the elbows' distance is least, the links lie across the elbows' motion E_dot;
    which way the working mode tells: the distal link bends to the right of the proximal
    one, along u, where the elbow is on the left.
    """
    normal = np.array([-E_dot[1], E_dot[0]]) / np.hypot(*E_dot)
    bends = np.sign(u[0] * normal[1] - u[1] * normal[0])
    return np.asarray(-working_mode * bends * normal)
