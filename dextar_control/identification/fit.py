"""Nonlinear least squares for a five-bar's geometry by folds of the joints' motion, and
by places of the end effector, if seen.

Folds alone tell nothing of where the robot stands (the motors' midpoint is kept) and
how it is turned (the mean of the encoder offsets), of its scale (the distal lengths'
sum), and without folded links nothing of the distal lengths' difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dextar_control.identification.folds import Fold, Touch, touch
from dextar_control.identification.linkage import COMPLIANCE, NAMES, PER_TURN, Linkage
from dextar_control.mechanisms.five_bar_locus import SIDES, Family
from dextar_control.symbols.types import Array

LARGEST = 4.0  # standard deviations; a fold or a place beyond is an outlier
LEAST_SIZE = 1.5e-6  # m of a fold's gap that says nothing
ROUNDS = 25  # with weights that forget outliers, and as many without the outliers
CONVERGED = 1e-7  # largest step, in the sizes of ``ONE``, at which the search ends
NEARBY = 10.0  # of these sizes: how far the numbers are looked for at first
PLACE_NOISE = 2e-4  # m, of a coordinate, until the places' own scatter tells it
PLACE_FLOOR = 5e-6  # m, of a place beside its noise: clocks, interpolation
# standard deviations of a normal distribution in the median of its absolute values
MEDIAN = 1.4826
# folds with folded links that tell the difference of the distal lengths
FEWEST_FOLDED = 2
# rad: the errors once a turn among which the likeliest is taken
ENCODER_ERRORS = (0.0, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3)
# rad, the standard deviation of errors once a turn where places of the end effector
# tell them
SEEN_ERROR = 3e-4
# m: the errors beside the samples' scatter among which the likeliest is taken
UNMODELLED = (0.0, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4)
# share of the largest singular value below which a direction is not seen at all
BOUND = 1e-9
ONE = {"m": 1e-4, "rad": 1e-3, "rad/(N m)": 1e-2}  # what counts as one, per unit
# rad/(N m), the standard deviation of a transmission's compliance where places tell it
SEEN_COMPLIANCE = 3e-2


class Direction(NamedTuple):
    """A quantity that is looked for, as a change of the numbers.

    Attributes:
        name: of the quantity.
        unit: m or rad.
        change: (16,) of the numbers where the quantity changes by one.
    """

    name: str
    unit: str
    change: Array


def _direction(name: str, unit: str, changes: dict[str, float]) -> Direction:
    return Direction(
        name, unit, np.array([changes.get(number, 0.0) for number in NAMES])
    )


def _single(name: str) -> Direction:
    unit = "rad" if "encoder" in name else "m"
    if name.endswith(COMPLIANCE):
        unit = "rad/(N m)"
    return _direction(name, unit, {name: 1.0})


def _difference(name: str, unit: str, quantity: str) -> Direction:
    return _direction(name, unit, {f"left.{quantity}": -0.5, f"right.{quantity}": 0.5})


ENCODERS = tuple(
    _single(name) for name in NAMES if name.endswith((*PER_TURN, COMPLIANCE))
)
EVERY = tuple(
    _single(name) for name in NAMES if not name.endswith((*PER_TURN, COMPLIANCE))
)
BY_STRETCHED = (
    *(_single(f"{side}.proximal_length") for side in SIDES),
    *(
        _difference(f"right.axis - left.axis, {axis}", "m", f"axis.{axis}")
        for axis in "xy"
    ),
    _difference("right.encoder_offset - left.encoder_offset", "rad", "encoder_offset"),
)
BY_FOLDED = _difference(
    "right.distal_length - left.distal_length", "m", "distal_length"
)


class Places(NamedTuple):
    """Where the end effector was seen.

    Attributes:
        readings: (m, 2) of the encoders then, rad.
        passed: (m, 2) on to the links, N m.
        x: (m, 2) in the robot's frame, m.
    """

    readings: Array
    passed: Array
    x: Array


@dataclass(frozen=True)
class Fit:
    """The numbers that explain the folds best, and how well they are known.

    Attributes:
        numbers: (16,) in the order of ``NAMES``.
        covariance: (16, 16) of them; zero where they are kept.
        directions: that were looked for.
        deviations: per direction, standard; inf where the recordings do not tell it.
        touches: of the folds.
        spreads: per fold, standard deviation of its gap with all that is not modelled,
            m.
        used: per fold, whether it counts.
        encoder_error: standard deviation of the encoders' error once a turn, or by a
            tenth of a N m passed on, that was allowed for, rad.
        place_noise: standard deviation of a seen coordinate, m; nan without places.
        places: how many count.
    """

    numbers: Array
    covariance: Array
    directions: tuple[Direction, ...]
    deviations: Array
    touches: list[Touch]
    spreads: Array
    used: NDArray[np.bool_]
    encoder_error: float
    place_noise: float
    places: int

    @property
    def gaps(self) -> Array:
        """Gaps of the folds, (k,), m."""
        return np.array([one.gap for one in self.touches])


def directions_of(
    folds: Sequence[Fold], places: Places | None
) -> tuple[Direction, ...]:
    """List the quantities that can be looked for."""
    if places is not None:
        return EVERY
    folded = sum(fold.family is Family.FOLDED for fold in folds)
    return (*BY_STRETCHED, *((BY_FOLDED,) if folded >= FEWEST_FOLDED else ()))


class _Problem:
    """The least squares problem of folds and places, linear about some numbers."""

    def __init__(
        self,
        linkage: Linkage,
        folds: Sequence[Fold],
        places: Places | None,
        wanted: tuple[Direction, ...],
    ) -> None:
        self.linkage, self.folds, self.places = linkage, folds, places
        self.scales = np.array(
            [ONE[direction.unit] for direction in (*wanted, *ENCODERS)]
        )
        self.along = (
            np.column_stack([direction.change for direction in (*wanted, *ENCODERS)])
            * self.scales
        )
        self.place_noise, self.count = PLACE_NOISE, len(wanted)

    def at(self, numbers: Array) -> None:
        """Linearise about some numbers (16,)."""
        self.touches = [touch(self.linkage, numbers, fold) for fold in self.folds]
        gaps = np.array([one.gap for one in self.touches])
        deviations = np.array([one.deviation for one in self.touches])
        self.valid = np.isfinite(gaps)
        self.gaps = np.where(self.valid, gaps, 0.0)
        self.deviations = np.where(self.valid, deviations, 1.0)
        self.slopes = (
            np.array([one.gradient for one in self.touches]).reshape(-1, len(NAMES))
            @ self.along
        )
        self.seen, self.seen_slopes = np.zeros(0), np.zeros((0, self.along.shape[1]))
        self.kept = np.zeros(0, dtype=bool)
        if self.places is None:
            return
        found = self.linkage.closures(numbers, *self.places)
        noise = self.place_noise**2 * found.rods @ found.rods.transpose(
            0, 2, 1
        ) + PLACE_FLOOR**2 * np.eye(2)
        whiten = np.linalg.inv(np.linalg.cholesky(noise))
        residuals = np.einsum("mij,mj->mi", whiten, found.gaps)
        scale = MEDIAN * float(np.median(np.abs(residuals)))
        self.kept = np.abs(residuals).max(axis=1) <= LARGEST * max(scale, 1.0)
        self.place_noise = max(self.place_noise * scale, PLACE_FLOOR)
        self.seen = residuals[self.kept].ravel()
        self.seen_slopes = (whiten @ found.slopes @ self.along)[self.kept].reshape(
            -1, self.along.shape[1]
        )

    def size(self) -> float:
        """Return the standard deviation of most gaps, m."""
        gaps = np.abs(self.gaps[self.valid])
        return (
            max(MEDIAN * float(np.median(gaps)), LEAST_SIZE)
            if len(gaps)
            else LEAST_SIZE
        )

    def step(self, weights: Array, moved: Array, hold: Array) -> tuple[Array, Array]:
        """Solve for (step along the directions, its covariance), in their scales.

        Args:
            weights: (k,) of the folds, 1/m.
            moved: along the directions until now.
            hold: how tightly each of the first of them is held to where it began, one
                over its standard deviation; 0 is free. What is beyond them does not
                move.
        """
        free = len(hold)
        A = np.vstack(
            [
                np.vstack([self.slopes * weights[:, None], self.seen_slopes])[:, :free],
                np.diag(hold),
            ]
        )
        b = np.concatenate([self.gaps * weights, self.seen, hold * moved[:free]])
        # R of a QR decomposition holds all that the many rows say
        R = np.asarray(np.linalg.qr(np.column_stack([A, b]), mode="r"))
        A, b = R[:, :free], R[:, free]
        _, values, V = np.linalg.svd(A)
        values = np.maximum(
            np.pad(values, (0, free - len(values))),
            BOUND * max(float(values.max(initial=0.0)), 1e-100),
        )
        covariance = np.zeros((self.along.shape[1],) * 2)
        covariance[:free, :free] = (V.T / values**2) @ V
        step = np.zeros(self.along.shape[1])
        step[:free] = -np.linalg.lstsq(A, b, rcond=BOUND)[0]
        return step, covariance

    def variances(self, used: NDArray[np.bool_], moved: Array) -> tuple[float, float]:
        """Find the likeliest (error of the encoders, rad, unmodelled error, m) by the
        folds that count, whatever the numbers are.
        """
        J, G = self.slopes[used, : self.count], self.slopes[used, self.count :]
        # orthogonal to all that the numbers can explain
        free = np.linalg.svd(J, full_matrices=True)[0][:, np.linalg.matrix_rank(J) :].T
        gaps, G = (
            free @ (self.gaps[used] - G @ moved[self.count :]),
            free @ G / ONE["rad"],
        )
        best = -np.inf, 0.0, 0.0
        for encoder_error in ENCODER_ERRORS:
            for unmodelled in UNMODELLED:
                noise = (
                    free * (self.deviations[used] ** 2 + unmodelled**2) @ free.T
                    + encoder_error**2 * G @ G.T
                )
                likelihood = (
                    -0.5
                    * (
                        np.linalg.slogdet(noise)[1]
                        + gaps @ np.linalg.solve(noise, gaps)
                    )
                    if len(gaps)
                    else 0.0
                )
                best = max(best, (float(likelihood), -encoder_error, -unmodelled))
        return -best[1], -best[2]


def fit(
    linkage: Linkage,
    numbers: Array,
    folds: Sequence[Fold],
    places: Places | None = None,
    directions: Sequence[Direction] | None = None,
) -> Fit:
    """The numbers that explain the folds, and the places, best.

    Where a robot bounced off, or turned before it touched the locus, its fold is known
    by its own gap and left out, as are places that jump.

    Args:
        linkage: its functions.
        numbers: (16,) of the description, in m, rad and rad/(N m), where the search
            begins; what is not looked for stays.
        folds: of the recordings.
        places: of the end effector.
        directions: to look for; ``directions_of`` when None.
    """
    wanted = tuple(directions_of(folds, places) if directions is None else directions)
    problem = _Problem(linkage, folds, places, wanted)
    moved, encoder_error, unmodelled = np.zeros(problem.along.shape[1]), 0.0, 0.0
    used = np.ones(len(folds), dtype=bool)
    problem.at(numbers)
    for turn in range(2 * ROUNDS):
        size = problem.size()
        if turn < ROUNDS:
            weights = problem.valid / (
                size * np.sqrt(1.0 + np.square(problem.gaps / size))
            )
            # outliers must not carry the numbers far away
            hold = np.full(len(wanted), 1.0 / NEARBY)
        else:
            if turn > ROUNDS:
                encoder_error, unmodelled = problem.variances(used, moved)
            else:
                unmodelled = size * np.sqrt(
                    len(folds) / max(len(folds) - len(wanted), 1)
                )
            by_encoders = (
                encoder_error
                / ONE["rad"]
                * np.linalg.norm(problem.slopes[:, problem.count :], axis=1)
            )
            # a gap of ordinary size always counts
            spreads = np.sqrt(
                problem.deviations**2 + max(unmodelled, size) ** 2 + by_encoders**2
            )
            used = problem.valid & (np.abs(problem.gaps) <= LARGEST * spreads)
            weights = used / np.hypot(problem.deviations, unmodelled)
            hold = np.zeros(len(wanted))
            allowed = (
                encoder_error if places is None else max(encoder_error, SEEN_ERROR)
            )
            if allowed:
                loose = (
                    allowed / ONE["rad"],
                    (
                        SEEN_COMPLIANCE / ONE["rad/(N m)"]
                        if places
                        else allowed / ONE["rad"]
                    ),
                )
                hold = np.concatenate(
                    [hold, [1.0 / loose[one.unit != "rad"] for one in ENCODERS]]
                )
        step, covariance = problem.step(weights, moved, hold)
        moved = moved + step
        problem.at(numbers + problem.along @ moved)
        if turn > ROUNDS + 2 and np.abs(step).max() < CONVERGED:
            break
    return Fit(
        numbers=numbers + problem.along @ moved,
        covariance=problem.along @ covariance @ problem.along.T,
        directions=wanted,
        deviations=np.sqrt(np.diag(covariance)[: len(wanted)])
        * problem.scales[: len(wanted)],
        touches=problem.touches,
        spreads=spreads,
        used=used,
        encoder_error=encoder_error,
        place_noise=problem.place_noise if places is not None else np.nan,
        places=int(problem.kept.sum()),
    )
