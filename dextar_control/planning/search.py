"""The search for a crossing or a leg: guesses, and a quasi-Newton descent from each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dextar_control.contract.errors import TrajectoryError
from dextar_control.model.robot import AnyRobot
from dextar_control.planning.locus import REST_S, LocusPoint, rests_around
from dextar_control.planning.model import PlanningModel, planning_model
from dextar_control.planning.trajectory import Trajectory
from dextar_control.symbols.functions import Results
from dextar_control.symbols.record import Layout, Record
from dextar_control.symbols.types import Array

# of max_torque: the peak torque that costs one, and that a way of open duration has
TORQUE_SHARE = 0.3
LOCUS_TIME = 0.05  # s near the locus that costs one, where nothing else is asked for
LOCUS_TIMES = 0.005, 5.0  # s, between which that lies
SOFT_TYPE1 = 0.12  # distance to Type 1 that a plan keeps where it can
SOFT_END_S = 0.45  # |s| of ends that the planner chooses
LEG_TIME = 2.0  # s of a leg between two crossings that costs one
GOOD = 1.5  # cost below which no further guess is tried
ITERATIONS = 200  # of one descent
TOLERANCE = 1e-3  # on the gradient
# descents, each from where the one before ended (at a kink of the cost as a rule), as
# long as each gains this share
DESCENTS, GAIN = 3, 0.01
GUESSES = 3  # in the plane
HURRIED, HURRY = 2, 2.5  # of them that are also tried with a so many times larger speed
SPACE = 4  # times as many guesses for each dimension more
IMPOSSIBLE = 1e12  # cost of a candidate without a finite one
# the variables of a crossing that are closed where straight ways are tried
BENDS = ("first_bends", "second_bends")
VISIT = 0.9  # cosine of the angle between the ways of two guesses that are taken as one

Progress = Callable[[float, str], None]


def silent(fraction: float, stage: str) -> None:
    """Report no progress."""


class CrossingCriterion(Enum):
    """What is imposed at the crossing: t_s.w_d = 0 (Eq. 5), or w_d = 0 altogether (the
    paper's [10]).
    """

    RECIPROCAL = "reciprocal"
    ZERO_WRENCH = "zero_wrench"


class Problem(NamedTuple):
    """A crossing or leg whose open variables are searched.

    Attributes:
        model: of the robot.
        leg: whether it is a leg between two crossings.
        limits, task: the limits and what is given; see ``candidate.layouts``.
        free: indices of the open variables.
    """

    model: PlanningModel
    leg: bool
    limits: Record
    task: Record
    free: NDArray[np.int64]

    @property
    def variables(self) -> Layout:
        """The layout of a candidate's variables."""
        return self.model.layouts.leg if self.leg else self.model.layouts.crossing

    def lasting(self, duration: float) -> Problem:
        """Return the same problem with another duration, s."""
        task = self.task.copy()
        task.duration = duration
        return self._replace(task=task)

    def opened(self, *names: str) -> Problem:
        """Return the same problem with these variables open too."""
        return self._replace(free=np.union1d(self.free, self.variables.indices(*names)))

    def costs(self, z: Record) -> tuple[float, Array]:
        """Return a candidate's cost and its gradient over all variables (size,), 1."""
        function = self.model.leg_cost if self.leg else self.model.crossing_cost
        found = function(self.limits.numbers, self.task.numbers, z.numbers)
        cost, gradient = float(found.cost[0]), found.gradient
        if np.isfinite(cost) and np.isfinite(gradient).all():
            return cost, gradient
        return IMPOSSIBLE, np.zeros(len(gradient))

    def halves(self, z: Record) -> Results:
        """Return the halves of a candidate, first and second (n, ROWS), and their spans
        (2,), s.
        """
        function = self.model.leg if self.leg else self.model.crossing
        return function(self.limits.numbers, self.task.numbers, z.numbers)


def soft_limits(
    robot: AnyRobot, end_s: float, locus_time: float = LOCUS_TIME
) -> Record:
    """Return the limits that the search aims at, inside the robot's."""
    return planning_model(robot).layouts.limits.make(
        torque=TORQUE_SHARE * robot.max_torque,
        near_time=locus_time,
        time=LEG_TIME,
        joint_speed=robot.max_joint_speed,
        platform_speed=robot.max_platform_speed,
        type1=max(SOFT_TYPE1, 1.2 * robot.min_type1_distance),
        end_s=end_s,
    )


def crossing_problem(
    robot: AnyRobot,
    point: LocusPoint,
    sign: float,
    duration: float,
    criterion: CrossingCriterion,
    free: Sequence[str],
    end_s: float = SOFT_END_S,
    towards: Array | None = None,
    locus_time: float = LOCUS_TIME,
) -> Problem:
    """Return the problem of a crossing near a locus point.

    Args:
        robot: in the working mode of the point.
        point: of the locus.
        sign: of s after the crossing.
        duration: s.
        criterion: what is imposed at the crossing.
        free: names of the variables that are open.
        end_s: |s| that the ends keep.
        towards: unit direction of the velocity at the crossing, (n,), 1; open when
            None.
        locus_time: s near the locus that costs as much as a peak torque of
            TORQUE_SHARE.

    Raises:
        TrajectoryError: locus_time is out of its range.
    """
    least, most = LOCUS_TIMES
    if not least <= locus_time <= most:
        raise TrajectoryError(
            f"locus_time = {locus_time} s; it must lie in {least} to {most} s"
        )
    model = planning_model(robot)
    directions = np.eye(model.n)
    if towards is not None:
        directions = np.column_stack([towards, np.zeros((model.n, model.n - 1))])
    family = 0 if point.family is None else point.family.value
    task = model.layouts.crossing_task.make(
        duration=duration,
        length=model.length,
        sign=sign,
        family=family,
        branch=point.branch,
        zero_wrench=criterion is CrossingCriterion.ZERO_WRENCH,
        directions=directions,
        point=point.x,
    )
    return Problem(
        model,
        False,
        soft_limits(robot, end_s, locus_time),
        task,
        model.layouts.crossing.indices(*free),
    )


def leg_problem(
    robot: AnyRobot, left: Array, reached: Array, sign: float, duration: float
) -> Problem:
    """Return the problem of a leg between two crossings.

    Args:
        robot: in their working mode.
        left, reached: states at the two crossings, (n, 4): columns x, m, x_dot, x_ddot
            and jerk.
        sign: of s on the leg.
        duration: about how long it takes, s.
    """
    model = planning_model(robot)
    task = model.layouts.leg_task.make(
        duration=duration, length=model.length, sign=sign, left=left, reached=reached
    )
    return Problem(
        model,
        True,
        soft_limits(robot, SOFT_END_S),
        task,
        np.arange(model.layouts.leg.size),
    )


def trajectory_of(problem: Problem, z: Record) -> Trajectory:
    """Return the trajectory of a candidate, from time 0."""
    pair = problem.halves(z)
    first, second = np.abs(pair.spans)
    origins = np.array([0.0, first + second] if problem.leg else [first, first])
    pieces = [
        coefficients_over(*half)
        for half in zip((pair.first, pair.second), pair.spans, strict=True)
    ]
    return Trajectory(np.array([0.0, first, first + second]), origins, np.stack(pieces))


def coefficients_over(half: Array, span: float) -> Array:
    """Return coefficients (ROWS, n) by rising power of time, s, of a half (n, ROWS) by
    rising power of the share of its span, s.
    """
    return np.asarray(half.T / float(span) ** np.arange(half.shape[1])[:, None])


def descend(problem: Problem, guess: Record) -> tuple[float, Record]:
    """Return the least cost that descents from a guess find, and its variables."""
    from scipy.optimize import minimize  # here: it takes longer to load than all else

    z = guess.copy()
    cost = np.inf

    def value(free: Array) -> tuple[float, Array]:
        z.numbers[problem.free] = free
        cost, gradient = problem.costs(z)
        return cost, gradient[problem.free]

    options = {"maxiter": ITERATIONS, "gtol": TOLERANCE}
    for _ in range(DESCENTS):
        found = minimize(
            value, z.numbers[problem.free], jac=True, method="BFGS", options=options
        )
        z.numbers[problem.free] = found.x
        gained, cost = found.fun < (1.0 - GAIN) * cost, float(found.fun)
        if not gained:
            break
    return cost, z


def guesses_through(
    problem: Problem, point: LocusPoint, towards: Array | None = None
) -> list[Record]:
    """Return guesses with rests straight ahead of the point on both sides, as much in
    line as can be.

    Args:
        problem: of the crossing.
        point: of the locus.
        towards: unit direction of the velocity there, (n,), 1; open when None.
    """
    model, x = problem.model, point.x
    length, sign = problem.task.length, problem.task.sign
    rests = rests_around(model, x[None], problem.limits.type1, REST_S)[0]
    n, side = model.n, rests[:, -2] * sign
    first, last = rests[side < 0.0], rests[side > 0.0]
    if len(first) == 0 or len(last) == 0:
        return []
    starts, goals = first[:, :n], last[:, :n]
    far_before = np.linalg.norm(x - starts, axis=1)
    far_after = np.linalg.norm(goals - x, axis=1)
    before, after = (x - starts) / far_before[:, None], (goals - x) / far_after[:, None]
    total = far_before[:, None] + far_after
    clearance = np.minimum(first[:, None, -1], last[:, -1])
    score = (
        1.0
        - before @ after.T
        + np.abs(total / (0.7 * length) - 1.0)
        + 0.5 * np.maximum(0.0, 1.0 - clearance / 0.3)
    )
    if towards is not None:
        score = score - 2.0 * (after @ towards) - 2.0 * (before @ towards)[:, None]
    chosen: list[Array] = []
    found: list[Record] = []
    for index in np.argsort(score, axis=None):
        row, column = np.unravel_index(index, score.shape)
        way = goals[column] - starts[row]
        distance = float(np.linalg.norm(way))
        direction = way / distance
        if any(direction @ other > VISIT for other in chosen):
            continue
        chosen.append(direction)
        moved = way if towards is None else distance * np.eye(n)[0]
        found.append(
            problem.variables.make(
                start=starts[row] / length,
                goal=goals[column] / length,
                place=point.angle,
                split=np.clip(far_before[row] / total[row, column], 0.35, 0.65),
                velocity=2.0 * moved / length,
            )
        )
        if len(found) == GUESSES * SPACE ** (n - 2):
            break
    hurried = [guess.copy() for guess in found[: HURRIED * SPACE ** (n - 2)]]
    for guess in hurried:
        guess.velocity *= HURRY
    return found + hurried
