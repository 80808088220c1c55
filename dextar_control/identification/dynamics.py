"""Weighted least squares for masses, inertias, friction and gravity by recorded
motions.

The equation is that of ``model.regressor``, on the platform: regular on the locus. Each
instant counts by what is known of its torques and accelerations, so that where the
encoders do not tell the platform's acceleration nothing is learnt from it. What no
motion tells stays as described: each number is held to its description, loosely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.optimize import lsq_linear

from dextar_control.contract.robot import RobotParameters, flatten
from dextar_control.identification.fit import MEDIAN
from dextar_control.identification.motion import BLOCK, SmoothMotion
from dextar_control.identification.quantities import UNITS
from dextar_control.mechanisms import DETAILED_FIVE_BAR
from dextar_control.model.regressor import Unknown, regressors, sizes_of, unknowns_of
from dextar_control.symbols.types import Array

# sizes of a number, and of a mass or inertia, by which it may differ from the
# description where nothing tells it
PRIOR, PRIOR_BODY = 5.0, 0.5
DELAY = 5e-3  # s, the same of the time from command to drive
ROUNDS, CONVERGED = 10, 1e-4  # of the prior deviations, of a step
LARGEST = 4.0  # standard deviations, beyond which an instant is an outlier
# share of its prior deviation below which a combination of numbers counts as told
TOLD = 0.25
ALONE = 0.25  # the same of a number by itself
# share of a described mass or inertia that is left of it at least: no body has none
LEAST_BODY = 0.02
# rad/s over which friction changes its sign at most, whatever speed the description
# smooths it over
SHARP = 0.01
NOTHING = 5e-4  # N m of unexplained torque that makes no outlier
LEAST_TORQUE = 2e-4  # N m of unexplained torque that says nothing
# share of a combination below which another number does not belong to it
NEGLIGIBLE = 1e-3


class BaseParameter(NamedTuple):
    """A sum of numbers that the torques show together only.

    Attributes:
        name: of the sum, in words, of the numbers in the units of ``UNITS``.
        unit: of its first number.
        factors: (k,) of the numbers.
        before, after, deviation: of the sum.
    """

    name: str
    unit: str
    factors: Array
    before: float
    after: float
    deviation: float


@dataclass(frozen=True)
class DynamicFit:
    """The numbers that explain recorded torques best, and how well they are known.

    Attributes:
        unknowns: (k) numbers that were looked for.
        before, numbers: (k,) of the description and as found.
        deviations: (k,) standard.
        prior: (k,) that they were held to the description by.
        combinations: that are told.
        bound: names of numbers that would lie beyond their bound and were kept on it.
        delay, delay_deviation: from command to drive, s, per motion.
        which: (m,) motion of each instant.
        torque: (m, n) commanded then, N m.
        rates: (m, n) of the joints, rad/s.
        rest_before, rest: (m, n) of the torques, by the description and by what was
            found.
        used: (m,) whether an instant counts.
    """

    unknowns: tuple[Unknown, ...]
    before: Array
    numbers: Array
    deviations: Array
    prior: Array
    combinations: tuple[BaseParameter, ...]
    bound: tuple[str, ...]
    delay: Array
    delay_deviation: Array
    which: NDArray[np.int64]
    torque: Array
    rates: Array
    rest_before: Array
    rest: Array
    used: NDArray[np.bool_]

    @property
    def alone(self) -> NDArray[np.bool_]:
        """(k,) whether a number is told by itself."""
        return np.asarray(self.deviations <= ALONE * self.prior)

    @property
    def combined(self) -> NDArray[np.bool_]:
        """(k,) whether a number is part of a combination that is told."""
        factors = [one.factors for one in self.combinations]
        return np.any(factors, axis=0) if factors else np.zeros(len(self.prior), bool)

    def value(self, name: str) -> tuple[float, float]:
        """Return (value, standard deviation) of a number."""
        row = [one.name for one in self.unknowns].index(name)
        return float(self.numbers[row]), float(self.deviations[row])


class _Rows(NamedTuple):
    """The filtered equation: gap (m, n), slopes (m, n, k), J_inv (m, n, n), inertia (m,
    n, n), late (m, n) of J_inv^T tau_dot.
    """

    gap: Array
    slopes: Array
    J_inv: Array
    inertia: Array
    late: Array


def rows_of(p: Array, motion: SmoothMotion) -> _Rows:
    """Evaluate the equation along a motion for some numbers p (k,), in SI units."""
    found = regressors(DETAILED_FIVE_BAR).batch("gap")(
        p, motion.q_a, motion.x, motion.x_dot, motion.x_ddot, motion.tau
    )
    late = np.einsum("mji,mj->mi", found.J_inv, motion.tau_dot)
    parts = (found.gap, found.slopes, found.J_inv, found.inertia, late)
    return _Rows(*(motion.filtered(part) for part in parts))


def rest_of(rows: _Rows, gap: Array) -> Array:
    """Convert a gap (m, n), N on the platform, to torques of the joints (m, n), N m."""
    return np.asarray(
        np.linalg.solve(rows.J_inv.transpose(0, 2, 1), gap[:, :, None])[:, :, 0]
    )


def fit_dynamics(robot: RobotParameters, motions: Sequence[SmoothMotion]) -> DynamicFit:
    """Find the numbers that explain the motions best.

    Args:
        robot: as described, where the search begins.
        motions: of it, at least one of which has instants.
    """
    p = DETAILED_FIVE_BAR.values(flatten(robot))
    unknowns, sizes = unknowns_of(DETAILED_FIVE_BAR), sizes_of(DETAILED_FIVE_BAR, p)
    columns, k, count = [one.row for one in unknowns], len(unknowns), len(motions)
    before, turn_over = p[columns], DETAILED_FIVE_BAR.rows().get("coulomb_speed")
    which = np.concatenate(
        [np.full(len(motion.tells), row) for row, motion in enumerate(motions)]
    )
    time = np.concatenate([motion.time[motion.tells] for motion in motions])
    blocks = np.unique(
        np.stack([which, np.floor(time / BLOCK).astype(np.int64)]),
        axis=1,
        return_inverse=True,
    )[1].ravel()
    jitter = np.concatenate(
        [np.tile(motion.jitter, (len(motion.tells), 1)) for motion in motions]
    )
    loose = [PRIOR_BODY if one.unit.startswith("kg") else PRIOR for one in unknowns]
    prior = np.concatenate([loose * sizes, np.full(count, DELAY)])
    least = [
        (
            max(one.minimum, LEAST_BODY * float(p[one.row]))
            if one.unit.startswith("kg")
            else one.minimum
        )
        for one in unknowns
    ]
    low = np.concatenate([least, np.full(count, -np.inf)])
    numbers, delay, spread = before.copy(), np.zeros(count), np.full(2, 0.02)
    used, rest_before = np.ones(len(which), dtype=bool), np.zeros(0)
    for turn in range(ROUNDS):
        p = p.copy()
        p[columns], p[turn_over] = numbers, np.minimum(p[turn_over], SHARP)
        every = [rows_of(p, motion) for motion in motions]
        rows = _Rows(*(np.concatenate(parts) for parts in zip(*every, strict=True)))
        gap = rows.gap - rows.late * delay[which, None]
        rest = rest_of(rows, gap)
        if turn == 0:
            rest_before = rest
        else:
            spread = np.maximum(
                MEDIAN * np.median(np.abs(rest[used]), axis=0), LEAST_TORQUE
            )
        whiten = _whitening(rows, spread, jitter)
        misfit = np.einsum("mij,mj->mi", whiten, gap)
        scale = max(MEDIAN * float(np.median(np.abs(misfit[used]))), 1e-9)
        whiten, misfit = whiten / scale, misfit / scale
        if turn > 1:
            used = (np.abs(misfit).max(axis=1) <= LARGEST) | (
                np.abs(rest).max(axis=1) <= NOTHING
            )
        slopes = np.zeros((*gap.shape, k + count))
        slopes[:, :, :k] = rows.slopes
        slopes[np.arange(len(which)), :, k + which] = -rows.late
        scaled = np.einsum("mij,mjk->mik", whiten, slopes) * prior
        flat = scaled[used].reshape(-1, k + count)
        now = np.concatenate([numbers, delay])
        away = (np.concatenate([before, np.zeros(count)]) - now) / prior
        A, b = (
            np.vstack([flat, np.eye(k + count)]),
            np.concatenate([-misfit[used].ravel(), away]),
        )
        small = np.asarray(qr(np.column_stack([A, b]), mode="r")[0])[: k + count + 1]
        A, b = small[:, :-1], small[:, -1]
        free = np.linalg.lstsq(A, b, rcond=None)[0]
        step = (
            lsq_linear(A, b, ((low - now) / prior - 1e-12, np.inf), method="bvls").x
            if turn
            else free
        )
        wanted = now + prior * free
        now = np.maximum(now + prior * step, low)
        numbers, delay = now[:k], now[k:]
        if turn > 2 and np.abs(step).max() < CONVERGED:
            break
    posterior = np.linalg.inv(flat.T @ flat + np.eye(k + count))
    # outliers widen the deviations
    scores = np.zeros((blocks.max() + 1, k + count))
    np.add.at(
        scores,
        blocks,
        np.einsum("mik,mi->mk", scaled, np.clip(misfit, -LARGEST, LARGEST)),
    )
    covariance = posterior @ (scores.T @ scores + np.eye(k + count)) @ posterior
    deviations = np.sqrt(np.diag(covariance)) * prior
    held = now[:k] <= low[:k] + 1e-12
    beyond = held & (wanted[:k] < low[:k] - 2.0 * deviations[:k])
    return DynamicFit(
        unknowns=unknowns,
        before=before,
        numbers=numbers,
        deviations=deviations[:k],
        prior=prior[:k],
        combinations=_combinations(
            unknowns, flat[:, :k], prior[:k], before, numbers, covariance[:k, :k]
        ),
        bound=tuple(unknowns[row].name for row in np.flatnonzero(beyond)),
        delay=delay,
        delay_deviation=deviations[k:],
        which=which,
        torque=np.concatenate([motion.filtered(motion.tau) for motion in motions]),
        rates=np.concatenate([motion.rates for motion in motions]),
        rest_before=rest_before,
        rest=rest,
        used=used,
    )


def _whitening(rows: _Rows, spread: Array, jitter: Array) -> Array:
    """Return (m, n, n) that scale a gap's errors to one: those of the torques, spread
    (n,), and those of the accelerations, jitter (m, n).
    """
    by_torque, by_motion = (
        rows.J_inv.transpose(0, 2, 1) * spread,
        rows.inertia * jitter[:, None, :],
    )
    errors = by_torque @ by_torque.transpose(0, 2, 1) + by_motion @ by_motion.transpose(
        0, 2, 1
    )
    return np.asarray(np.linalg.inv(np.linalg.cholesky(errors)))


def _combinations(
    unknowns: Sequence[Unknown],
    flat: Array,
    prior: Array,
    before: Array,
    numbers: Array,
    covariance: Array,
) -> tuple[BaseParameter, ...]:
    """Find the base parameters: the numbers whose torques can be told apart, from the
    last on, each with its share of the others.
    """
    R = np.asarray(qr(flat, mode="r")[0])[: flat.shape[1]]
    base, across = list[int](), np.zeros((len(R), 0))
    for column in reversed(range(len(prior))):
        own = R[:, column] - across @ (across.T @ R[:, column])
        if (size := np.linalg.norm(own)) >= 1.0 / TOLD:
            base.insert(0, column)
            across = np.column_stack([across, own / size])
    shares = np.linalg.lstsq(R[:, base], R, rcond=None)[0]
    found = []
    for first, own_shares in zip(base, shares, strict=True):
        factors = own_shares * prior[first] / prior
        factors[np.abs(own_shares) < NEGLIGIBLE] = 0.0
        shown = factors * [
            UNITS[unknowns[first].unit][1] / UNITS[one.unit][1] for one in unknowns
        ]
        others = [
            f"{shown[i]:+.3g} {unknowns[i].name}"
            for i in np.flatnonzero(factors).tolist()
            if i != first
        ]
        scale = factors * prior
        found.append(
            BaseParameter(
                " ".join([unknowns[first].name, *others]),
                unknowns[first].unit,
                factors,
                float(factors @ before),
                float(factors @ numbers),
                float(np.sqrt(scale @ covariance @ scale)),
            )
        )
    return tuple(found)
