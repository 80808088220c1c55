"""Nonlinear least squares for a five-bar's geometry: folds of the joints' motion, and places of the end effector where they are known.

What folds alone do not tell is kept: where the motors' midpoint lies and how everything is turned together (the mean of the
encoders' offsets), the scale (the sum of the distal lengths), and without a folded crossing the difference of the distal lengths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dextar_control.identification.folds import Fold, touch
from dextar_control.identification.linkage import NAMES, Linkage
from dextar_control.mechanisms.five_bar_locus import Family
from dextar_control.symbols.types import Array

LARGEST = 4.0  # deviations, beyond which a fold or a pose is an outlier
CLOSEST = 5e-6  # m, of a fold's gap that is no outlier whatever the deviation
ROUNDS = 30  # of weights that forget outliers, and then of those without them
STEPS = 12  # of Gauss and Newton's method
CONVERGED = 1e-10  # m or rad, of a step
POSE_NOISE = 2e-4  # m, of a measured coordinate, until the poses' own scatter tells
POSE_FLOOR = 5e-6  # m, of a pose beside its noise: clock, interpolation
NORMAL_MEDIAN = 1.4826  # standard deviations of a normal distribution in a median of absolute values


class Direction(NamedTuple):
    """A change of the numbers that is looked for.

    Attributes:
        name: of the quantity.
        unit: m or rad.
        change: (10,) of the numbers, by one unit.
    """

    name: str
    unit: str
    change: Array


def _direction(name: str, **changes: float) -> Direction:
    vector = np.zeros(len(NAMES))
    for key, value in changes.items():
        vector[NAMES.index(key.replace("__", "."))] = value
    return Direction(name, "rad" if "offset" in name else "m", vector)


LENGTHS = tuple(_direction(f"{side}.proximal_length", **{f"{side}__proximal_length": 1.0}) for side in ("left", "right"))
BASE = tuple(
    _direction(f"base {axis}", **{f"left__axis__{axis}": -0.5, f"right__axis__{axis}": 0.5}) for axis in ("x", "y")
)
OFFSETS = _direction("difference of the encoder offsets", left__encoder_offset=-0.5, right__encoder_offset=0.5)
SPLIT = _direction("difference of the distal lengths", left__distal_length=0.5, right__distal_length=-0.5)
SINGLE = tuple(_direction(name, **{name.replace(".", "__"): 1.0}) for name in NAMES)
FEWEST_FOLDED = 2  # folds with folded links that tell the difference of the distal lengths


class Poses(NamedTuple):
    """Where the end effector was.

    Attributes:
        readings: (m, 2) of the encoders then, rad.
        x: (m, 2) measured, m.
    """

    readings: Array
    x: Array


@dataclass(frozen=True)
class Fit:
    """What was found.

    Attributes:
        numbers: (10,) in the order of ``NAMES``.
        covariance: (10, 10) of them; zero where they are kept.
        directions: what was looked for.
        deviations: per direction, standard.
        gaps: (k,) of the folds, m; nan where one turned out to be none.
        scatter: (k,) standard deviation of each, m.
        used: (k,) whether it counts.
        unmodelled: standard deviation of the folds beside that of their samples, m.
        pose_noise: standard deviation of a measured coordinate, m; nan without poses.
        poses_used: how many count.
    """

    numbers: Array
    covariance: Array
    directions: tuple[Direction, ...]
    deviations: Array
    gaps: Array
    scatter: Array
    used: NDArray[np.bool_]
    unmodelled: float
    pose_noise: float
    poses_used: int


def directions_of(folds: Sequence[Fold], poses: Poses | None) -> tuple[Direction, ...]:
    """What can be looked for: with poses every number, else what the folds tell."""
    if poses is not None:
        return SINGLE
    folded = sum(fold.family is Family.FOLDED for fold in folds)
    return (*LENGTHS, *BASE, OFFSETS, *((SPLIT,) if folded >= FEWEST_FOLDED else ()))


class _Equations:
    """Residuals and their derivatives along the directions."""

    def __init__(self, linkage: Linkage, folds: Sequence[Fold], poses: Poses | None, directions: Sequence[Direction]) -> None:
        self.linkage, self.folds, self.poses = linkage, folds, poses
        self.along = np.column_stack([direction.change for direction in directions])
        self.pose_noise = POSE_NOISE

    def touches(self, numbers: Array) -> tuple[Array, Array, Array]:
        """(gaps, derivatives, deviations) of the folds."""
        found = [touch(self.linkage, numbers, fold) for fold in self.folds]
        gradients = np.array([one.gradient for one in found]).reshape(-1, len(NAMES))
        return np.array([one.gap for one in found]), gradients @ self.along, np.array([one.deviation for one in found])

    def placed(self, numbers: Array) -> tuple[Array, Array]:
        """(residuals (2 m,) in standard deviations, derivatives) of the poses."""
        assert self.poses is not None
        found = self.linkage.closure(numbers, self.poses.readings, self.poses.x)
        rods = found.rods
        covariance = self.pose_noise**2 * rods @ rods.transpose(0, 2, 1) + POSE_FLOOR**2 * np.eye(2)
        whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        residuals = np.einsum("mij,mj->mi", whiten, found.gaps)
        return residuals, whiten @ (found.slopes @ self.along)


def fit(
    linkage: Linkage, numbers: Array, folds: Sequence[Fold], poses: Poses | None = None,
    directions: Sequence[Direction] | None = None,
) -> Fit:  # fmt: skip
    """The numbers that explain the folds, and the poses, best.

    Bounced and turned robots' folds, and poses that jump, are outliers: found by their own residuals, and left out.

    Args:
        linkage: its functions.
        numbers: (10,) of the description, where the search begins and what is kept.
        folds: of the recordings.
        poses: of the end effector, in the robot's frame.
        directions: what to look for; ``directions_of`` when None.
    """
    wanted = tuple(directions_of(folds, poses) if directions is None else directions)
    equations = _Equations(linkage, folds, poses, wanted)
    now, used = numbers.copy(), np.ones(len(folds), dtype=bool)
    kept = np.ones(0 if poses is None else len(poses.x), dtype=bool)
    unmodelled = np.nan
    for turn in range(2 * ROUNDS):
        before = now.copy(), used.copy()
        gaps, slopes, deviations = equations.touches(now)
        valid = np.isfinite(gaps)
        if turn < ROUNDS:  # weights that fall with the residual's square: outliers hardly pull
            typical = NORMAL_MEDIAN * float(np.median(np.abs(gaps[valid]))) if valid.any() else 0.0
            wide = np.where(valid, np.maximum(typical, CLOSEST), np.inf)
            weights = np.where(valid, 1.0 / (wide * np.sqrt(1.0 + np.square(np.nan_to_num(gaps) / wide))), 0.0)
            unmodelled = typical
        else:
            unmodelled = _unmodelled(gaps[used], deviations[used], len(wanted) if poses is None else 0)
            weights = np.where(used, 1.0 / np.hypot(np.nan_to_num(deviations, nan=1.0), unmodelled), 0.0)
        rows, right = [slopes * weights[:, None]], [np.nan_to_num(gaps) * weights]
        if poses is not None:
            residuals, bends = equations.placed(now)
            size = np.abs(residuals).max(axis=1)
            scale = NORMAL_MEDIAN * float(np.median(np.abs(residuals)))
            kept = size <= LARGEST * max(scale, 1.0)
            rows.append(bends[kept].reshape(-1, len(wanted)))
            right.append(residuals[kept].reshape(-1))
            equations.pose_noise = max(equations.pose_noise * scale, POSE_FLOOR)
        A, b = np.vstack(rows), np.concatenate(right)
        step, *_ = np.linalg.lstsq(A, -b, rcond=1e-12)
        now = now + equations.along @ step
        if turn >= ROUNDS:
            leverage = np.square(A[: len(folds)] @ np.linalg.pinv(A.T @ A) * A[: len(folds)]).sum(axis=1) if False else np.einsum(
                "ij,jk,ik->i", A[: len(folds)], np.linalg.pinv(A.T @ A), A[: len(folds)])
            free = np.sqrt(np.clip(1.0 - leverage, 0.05, 1.0))
            spread = np.hypot(np.nan_to_num(deviations, nan=1.0), unmodelled)
            used = valid & (np.abs(np.nan_to_num(gaps)) <= np.maximum(LARGEST * spread * np.where(used, free, 1.0), CLOSEST))
        elif turn == ROUNDS - 1:
            spread = np.maximum(LARGEST * np.hypot(np.nan_to_num(deviations, nan=1.0), _inner(gaps[valid], len(wanted))), CLOSEST)
            used = valid & (np.abs(np.nan_to_num(gaps)) <= spread)
        if turn > ROUNDS and np.abs(now - before[0]).max() < CONVERGED and (used == before[1]).all():
            break
    gaps, slopes, deviations = equations.touches(now)
    spread = np.hypot(deviations, unmodelled)
    inverse = np.linalg.pinv(A.T @ A, rcond=1e-14, hermitian=True)
    return Fit(
        numbers=now,
        covariance=equations.along @ inverse @ equations.along.T,
        directions=wanted,
        deviations=np.sqrt(np.diag(inverse)),
        gaps=gaps,
        scatter=spread,
        used=used,
        unmodelled=float(unmodelled),
        pose_noise=equations.pose_noise if poses is not None else np.nan,
        poses_used=int(kept.sum()),
    )


def _inner(gaps: Array, unknowns: int) -> float:
    """Standard deviation of most of some residuals, whose outliers do not count."""
    count = len(gaps)
    return NORMAL_MEDIAN * float(np.median(np.abs(gaps))) * np.sqrt(count / max(count - unknowns, 1)) if count else 0.0


def _unmodelled(gaps: Array, deviations: Array, unknowns: int) -> float:
    """Standard deviation, beside their own, with which the residuals are as large as they should be; 0 where they are smaller."""
    free = max(len(gaps) - unknowns, 1)
    low, high = 0.0, float(np.abs(gaps).max(initial=0.0)) * np.sqrt(max(len(gaps), 1))

    def excess(more: float) -> float:
        return float(np.square(gaps / np.hypot(deviations, more)).sum()) - free

    if not len(gaps) or excess(0.0) <= 0.0:
        return 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > 0.0 else (low, middle)
    return 0.5 * (low + high)
