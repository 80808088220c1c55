"""The exciting motion for the identification of masses and friction: loops from rest
to rest, on one side of the locus.

In each loop each coordinate is a finite Fourier series about the start that begins and
ends at rest without acceleration. Of many random loops those are taken, and then
improved, whose torques together have the largest determinant of the information matrix
of the unknowns of ``model.regressor``, each counted by its own size. No two loops are
alike, so that what is not modelled (the teeth of a gear, a belt) does not err the same
way each time.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from dextar_control.contract.errors import TrajectoryError
from dextar_control.contract.robot import RobotParameters, flatten
from dextar_control.mechanisms import DETAILED_FIVE_BAR
from dextar_control.model.regressor import regressors, sizes_of
from dextar_control.planning.certificate import PLAN_RESIDUAL, Plan, measure
from dextar_control.planning.checks import beyond_range, certify
from dextar_control.planning.locus import MIN_END_S
from dextar_control.planning.model import states_model
from dextar_control.planning.regular import side_of
from dextar_control.planning.search import Progress, silent
from dextar_control.planning.trajectory import Trajectory, hold, in_words, join, quintic
from dextar_control.symbols.types import Array

CLEAR_S = 0.3  # |s| that the motion keeps
HARMONICS = 5
TORQUE, SPEED = 0.4, 0.5  # shares of the limits that the motion takes at most
LEAST_PERIOD, LONGEST_PERIOD = 1.0, 5.0  # s
SAMPLES = 120  # of one period, by which candidates are judged
KNOT = 0.01  # s between the knots of what is served, and less where a period is short
RANDOM = 200  # candidates
# improvements that are tried of all loops together, and by which share at first
IMPROVED, SHAKE = 200, 0.25
# m, the largest amplitude, and how often it is halved towards the largest that is clear
WIDEST, HALVINGS = 0.2, 9
# N m, the noise of a torque, and 1/s, how often a torque counts as measured anew
NOISE, RATE = 0.005, 25.0
# rad/s of a joint, below which friction has no sure sign and an instant does not count
SLOW = 0.2
# distance to Type 1 that the motion keeps: nearer, the torques depend more on errors of
# the geometry than on masses
CLEAR_TYPE1 = 0.25
ELSEWHERE = (
    "give another task.start (dextar demo: -p trajectory_server.task.start:=[X, Y])"
)
HEADROOM = 1.02  # of |s|, for what lies between samples


class ExcitingLoop(NamedTuple):
    """A candidate loop.

    Attributes:
        coefficients: (2, HARMONICS, n) of cosines and sines, m.
        period: s.
        information: matrix (k, k) of the unknowns, of one run of it.
    """

    coefficients: Array
    period: float
    information: Array


def plan_excitation(
    robot: RobotParameters,
    start: Array,
    duration: float,
    dwell: float,
    progress: Progress = silent,
    seed: int = 0,
) -> Plan:
    """Plan the exciting motion: rest, loops that take about ``duration`` together,
    rest.

    Args:
        robot: as far as it is known.
        start: where it begins and ends, (2,), m.
        duration: s.
        dwell: of the rests at both ends, s.
        seed: of the candidates.

    Raises:
        GeometryError: the start cannot be reached.
        TrajectoryError: the start is near the locus, or there is no room about it.
    """
    start = np.asarray(start, dtype=np.float64)
    s = side_of(robot, "start", start)
    if abs(s) < MIN_END_S:
        raise TrajectoryError(
            f"an exciting motion starts at |s| >= {MIN_END_S} of the Type 2 locus, and"
            f" its start {in_words(start)} has {abs(s):.3f}; {ELSEWHERE}"
        )
    search = _Search(robot, start, float(np.sign(s)))
    generator, found = np.random.default_rng(seed), list[ExcitingLoop]()
    for row in range(RANDOM):
        progress(0.5 * row / RANDOM, f"exciting loop {row + 1} of {RANDOM}")
        orders = np.arange(1, HARMONICS + 1)[None, :, None]
        found += search.loop(generator.normal(size=(2, HARMONICS, 2)) / orders)
    if not found:
        raise TrajectoryError(
            f"there is no room for an exciting motion about {in_words(start)};"
            f" {ELSEWHERE}"
        )
    chosen, total = list[ExcitingLoop](), np.eye(len(found[0].information))
    # one loop is the shortest motion
    least = max(duration - 0.5 * LEAST_PERIOD, np.finfo(float).tiny)
    while sum(loop.period for loop in chosen) < least and len(chosen) < len(found):
        worths = [
            -np.inf if any(loop is one for one in chosen) else _worth(total, loop)
            for loop in found
        ]
        chosen.append(found[int(np.argmax(worths))])
        total = total + chosen[-1].information
    for step in range(IMPROVED):
        progress(
            0.5 + 0.5 * step / IMPROVED,
            f"improving the loops, {step + 1} of {IMPROVED}",
        )
        row = step % len(chosen)
        old = chosen[row]
        size = SHAKE * (1.0 - step / IMPROVED) * float(np.abs(old.coefficients).mean())
        shaken = generator.normal(size=old.coefficients.shape)
        others = total - old.information
        for new in search.loop(old.coefficients + size * shaken):
            better = _worth(others, new) > _worth(others, old)
            if better and new.period <= 1.2 * old.period:
                chosen[row], total = new, others + new.information
    motion = join([hold(start, dwell), *map(search.motion, chosen), hold(start, dwell)])
    return Plan(motion, certify(robot, motion, max_residual=PLAN_RESIDUAL, crossings=0))


def _worth(known: Array, loop: ExcitingLoop) -> float:
    """Return the growth of ln det of the information (k, k) that a loop brings, over
    its period, 1/s.
    """
    grown = np.linalg.slogdet(known + loop.information)[1] - np.linalg.slogdet(known)[1]
    return float(grown / loop.period)


class _Search:
    """Candidate loops of one robot about one start."""

    def __init__(self, robot: RobotParameters, start: Array, sign: float) -> None:
        self._robot, self._start, self._sign = robot, start, sign
        self._p = DETAILED_FIVE_BAR.values(flatten(robot))
        self._slopes = partial(regressors(DETAILED_FIVE_BAR).batch("planned"), self._p)
        self._sizes = sizes_of(DETAILED_FIVE_BAR, self._p)
        self._phases = 2.0 * np.pi * np.arange(SAMPLES + 1) / SAMPLES
        self._harmonics = np.arange(1, HARMONICS + 1)

    def loop(self, raw: Array) -> list[ExcitingLoop]:
        """Return the loop with these coefficients (2, HARMONICS, n), as wide, m, and as
        fast as the limits allow; none where none is clear.
        """
        a, b = raw
        k = self._harmonics[:, None]
        # without acceleration, and without speed, at the ends
        a = a - k**2 * (k**2 * a).sum(axis=0) / (k**4).sum()
        b = b - k * (k * b).sum(axis=0) / (k**2).sum()
        unit = np.stack([a, b])
        x, _, _ = self._table(unit, self._phases)
        unit = unit / float(np.linalg.norm(x, axis=1).max())
        low, high = 0.0, WIDEST
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._clear(middle * unit) else (low, middle)
        if low <= 0.0:
            return []
        wide = low * unit
        period = self._period(wide)
        if not period <= LONGEST_PERIOD:
            return []
        x, x_dot, x_ddot = self._table(wide, self._phases[:-1])
        rate = 2.0 * np.pi / period
        found = self._slopes(self._start + x, rate * x_dot, rate**2 * x_ddot)
        sure = np.abs(found.rates).min(axis=1) >= SLOW
        rows = (found.torque_slopes[sure] * (self._sizes / NOISE)).reshape(
            -1, len(self._sizes)
        )
        return [ExcitingLoop(wide, period, rows.T @ rows * (RATE * period / SAMPLES))]

    def motion(self, loop: ExcitingLoop) -> Trajectory:
        """Return a loop as a trajectory, from rest to rest."""
        count = max(int(np.ceil(loop.period / KNOT)), SAMPLES)
        rate, phases = 2.0 * np.pi / loop.period, 2.0 * np.pi * np.arange(count + 1)
        x, x_dot, x_ddot = self._table(loop.coefficients, phases / count)
        x_dot[[0, -1]] = x_ddot[[0, -1]] = 0.0  # up to rounding they are
        x[[0, -1]] = 0.0
        return quintic(
            np.linspace(0.0, loop.period, count + 1),
            self._start + x,
            rate * x_dot,
            rate**2 * x_ddot,
        )

    def _table(self, coefficients: Array, phases: Array) -> tuple[Array, Array, Array]:
        """Return (places from the start (m, n), m, first and second derivative by
        the phase).
        """
        a, b = coefficients
        k = self._harmonics
        cosines, sines = np.cos(np.outer(phases, k)), np.sin(np.outer(phases, k))
        return (
            (cosines - 1.0) @ a + sines @ b,
            (-sines * k) @ a + (cosines * k) @ b,
            -(cosines * k**2) @ a - (sines * k**2) @ b,
        )

    def _clear(self, coefficients: Array) -> bool:
        x, _, _ = self._table(coefficients, self._phases)
        found = states_model(self._robot).sides(self._start + x)
        s, type1 = found.s[:, 0] * self._sign, found.type1[:, 0]
        return bool(
            np.isfinite(s).all()
            and s.min() >= HEADROOM * CLEAR_S
            and type1.min() >= max(CLEAR_TYPE1, self._robot.min_type1_distance)
            and beyond_range(self._robot, found.q_a).max() <= 0.0
        )

    def _period(self, coefficients: Array) -> float:
        """Return the shortest period, s, at which the motion keeps its shares of the
        limits; inf where there is none.
        """
        period = LEAST_PERIOD
        for _ in range(6):
            motion = self.motion(ExcitingLoop(coefficients, period, np.zeros((0, 0))))
            seen = measure(self._robot, motion, period / SAMPLES)
            factor = max(
                float(np.sqrt(seen.peak_torque / (TORQUE * self._robot.max_torque))),
                seen.peak_joint_speed / (SPEED * self._robot.max_joint_speed),
                seen.peak_platform_speed / (SPEED * self._robot.max_platform_speed),
            )
            if not factor > 1.0:
                return period
            period *= 1.001 * factor
        return np.inf
