"""Where a five-bar's distal links align: folds in the joints' motion that tell lengths.

With aligned links the elbows are l2_left + l2_right apart (stretched), or l2_left - l2_right along the links (folded), whatever the
platform does: the path of the two encoders touches that distance and turns back, where s passes zero and where it bounces off.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.signal import find_peaks

from dextar_control.identification.linkage import DISTAL, Linkage
from dextar_control.mechanisms.five_bar_locus import Family
from dextar_control.symbols.types import Array

NEAR = 0.02  # of the sum of the distal lengths: how far from touching a turning point of the description's distance may be
DROP = {Family.STRETCHED: 0.006, Family.FOLDED: 0.03}  # of that sum: change of the distance over either half of a fold's window
LONGEST = 0.15  # s, of either half
FEWEST = 9  # samples in either half
GAP = 0.01  # s between samples, beyond which a window ends
DEGREE = 4  # of the polynomials of time that smooth the elbows' vector in a window
STEPS = 8  # of Newton's method for the instant of a fold
LEAST_DEVIATION = 3e-7  # m, of a smoothed distance: what the polynomials leave


class Fold(NamedTuple):
    """One place where the joints turn back.

    Attributes:
        bag: number of the recording.
        family: how the links align.
        time: s of the recording, of its middle.
        instants: (n,) of the samples, -1 to 1.
        readings: (n, 2) of the encoders, rad.
        smoother: (DEGREE + 1, n) from samples to the polynomials' coefficients.
        working_mode: of the legs.
    """

    bag: int
    family: Family
    time: float
    instants: Array
    readings: Array
    smoother: Array
    working_mode: tuple[int, int]


class Touch(NamedTuple):
    """What a fold says of a linkage.

    Attributes:
        gap: the elbows' distance along the links, less that of aligned ones, m; nan where the joints do not turn back.
        gradient: (10,) of the gap.
        deviation: standard, of the gap by the samples' own scatter, m.
    """

    gap: float
    gradient: Array
    deviation: float


def find_folds(linkage: Linkage, numbers: Array, working_mode: tuple[int, int], time: Array, readings: Array, bag: int = 0,
               time_of: float = 0.0) -> list[Fold]:  # fmt: skip
    """The folds of a recording, in order of time.

    Args:
        linkage: its functions.
        numbers: (10,) of the description.
        working_mode: of the legs.
        time: (n,) s, rising.
        readings: (n, 2) of the encoders, rad.
        bag: number of the recording.
        time_of: s that the recording's time begins with.
    """
    distance = np.hypot(*linkage.between(numbers, readings)[0].T)
    total = float(numbers[list(DISTAL)].sum())
    least = abs(float(numbers[DISTAL[0]] - numbers[DISTAL[1]]))
    found = []
    for family, curve, height in (
        (Family.STRETCHED, distance, (1.0 - NEAR) * total), (Family.FOLDED, -distance, -least - NEAR * total)
    ):
        drop = DROP[family] * total
        for peak in find_peaks(curve, height=height, prominence=drop)[0]:
            fold = _window(curve, int(peak), drop, time)
            if fold is None:
                continue
            rows = slice(*fold)
            middle, half = 0.5 * (time[rows][0] + time[rows][-1]), 0.5 * (time[rows][-1] - time[rows][0])
            instants = (time[rows] - middle) / half
            smoother = np.linalg.pinv(_powers(instants))
            found.append(Fold(bag, family, float(middle) - time_of, instants, readings[rows], smoother, working_mode))
    return sorted(found, key=lambda fold: fold.time)


def _window(curve: Array, peak: int, drop: float, time: Array) -> tuple[int, int] | None:
    """First row, and the one after the last, about a peak: until the curve has dropped on either side; None where it does not."""
    ends = []
    for step in (-1, 1):
        row = peak
        while True:
            following = row + step
            if not 0 <= following < len(curve) or abs(time[following] - time[row]) > GAP:
                return None
            if abs(time[following] - time[peak]) > LONGEST:
                return None
            row = following
            if curve[peak] - curve[row] >= drop and abs(row - peak) >= FEWEST:
                break
        ends.append(row)
    return ends[0], ends[1] + 1


def _powers(instants: Array) -> Array:
    return np.vander(np.atleast_1d(instants), DEGREE + 1, increasing=True)


def touch(linkage: Linkage, numbers: Array, fold: Fold) -> Touch:
    """What a fold says of these numbers (10,)."""
    between, slopes = linkage.between(numbers, fold.readings)
    coefficients = fold.smoother @ between
    derivative = coefficients[1:] * np.arange(1, DEGREE + 1)[:, None]
    curvature = derivative[1:] * np.arange(1, DEGREE)[:, None]
    instant = 0.0
    for _ in range(STEPS):
        powers = _powers(instant)[0]
        E, E_dot, E_ddot = powers @ coefficients, powers[:-1] @ derivative, powers[:-2] @ curvature
        slope = float(E_dot @ E_dot + E @ E_ddot)
        if slope * fold.family.value >= 0.0:  # a largest distance is wanted where the links are stretched, a least where folded
            return Touch(np.nan, np.zeros(len(numbers)), np.nan)
        instant -= float(E @ E_dot) / slope
        if not abs(instant) <= 1.0:
            return Touch(np.nan, np.zeros(len(numbers)), np.nan)
    powers = _powers(instant)[0]
    E, E_dot = powers @ coefficients, powers[:-1] @ derivative
    d = E / np.hypot(*E) if fold.family is Family.STRETCHED else _along(linkage, numbers, fold, E_dot, instant)
    weights = powers @ fold.smoother
    aligned = float(numbers[DISTAL[0]] + fold.family.value * numbers[DISTAL[1]])
    gradient = np.einsum("i,ijk,j->k", weights, slopes, d)
    gradient[list(DISTAL)] -= 1.0, fold.family.value
    scatter = (between - _powers(fold.instants) @ coefficients) @ d
    free = len(scatter) - DEGREE - 1
    variance = float(scatter @ scatter) / max(free, 1)
    repeats = float(scatter[1:] @ scatter[:-1]) / max(float(scatter @ scatter), 1e-30)
    repeats = min(max(repeats, 0.0), 0.9)  # counts that last for several samples are not independent
    deviation = np.sqrt(variance * float(weights @ weights) * (1.0 + repeats) / (1.0 - repeats) + LEAST_DEVIATION**2)
    return Touch(float(E @ d) - aligned, gradient, float(deviation))


def _along(linkage: Linkage, numbers: Array, fold: Fold, E_dot: Array, instant: float) -> Array:
    """Direction of folded links, from the elbows to the end effector, which the elbows' motion across it tells but for its sign."""
    normal = np.array([-E_dot[1], E_dot[0]]) / np.hypot(*E_dot)
    middle = int(np.argmin(np.abs(fold.instants - instant)))
    u = linkage.proximal(numbers, fold.readings[middle])
    side = float(u[0] * normal[1] - u[1] * normal[0])
    return -normal * np.sign(side) * fold.working_mode[0] if side else normal
