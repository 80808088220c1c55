"""The search for a crossing: guesses around a locus point, and a quasi-Newton descent from each."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from dextar_control.contract.robot import RobotParameters
from dextar_control.core.crossing import candidate, cost_and_gradient, joined
from dextar_control.core.locus import REST_REACH, REST_S, LocusPoint, rests_around
from dextar_control.core.model import Array, Model, make_model
from dextar_control.core.trajectory import Trajectory

TORQUE_SHARE = 0.3  # of max_torque: the peak torque that costs one
NEAR_TIME = 0.05  # s near the locus that costs NEAR_WEIGHT
NEAR_WEIGHT = 0.3
SOFT_TYPE1 = 0.12  # distance to Type 1 that a plan keeps where it can
SOFT_END_S = 0.45  # |s| of ends that the planner chooses
GOOD = 1.0  # cost below which no further guess is tried
ITERATIONS, EVALUATIONS = 120, 200  # of one descent
GUESSES = 4
SPLIT_BOUNDS = (0.25, 0.75)  # fraction of the time before the crossing
START, GOAL, PLACE, SPLIT, STATE = (0, 1), (2, 3), (4,), (5,), (6, 7, 8, 9, 10)  # indices of ``crossing.candidate``'s z


class Criterion(Enum):
    """What holds at the crossing: t_s.w_d = 0 (Eq. 5), or w_d = 0 altogether (the paper's [10])."""

    RECIPROCAL = "reciprocal"
    ZERO_WRENCH = "zero_wrench"


class Problem(NamedTuple):
    """A crossing whose open variables are searched."""

    model: Model
    point: LocusPoint
    duration: float  # s
    length: float  # m, scale
    criterion: Criterion
    sign: float  # of s after the crossing
    limits: Array
    free: Array  # indices of the open variables


def make_problem(
    robot: RobotParameters, point: LocusPoint, sign: float, duration: float, criterion: Criterion, free: tuple[int, ...]
) -> Problem:
    """A problem in the robot's own limits."""
    model = make_model(robot)
    limits = np.array(
        [
            TORQUE_SHARE * robot.max_torque, NEAR_TIME, NEAR_WEIGHT, robot.max_joint_speed, robot.max_platform_speed,
            max(SOFT_TYPE1, 1.2 * robot.min_type1_distance), SOFT_END_S,
        ]
    )  # fmt: skip
    return Problem(
        model, point, duration, float(model.l2.mean()), criterion, sign, limits, np.array(sorted(free), dtype=np.int64)
    )


def trajectory_of(problem: Problem, z: Array) -> Trajectory:
    """The candidate z as a trajectory."""
    point = problem.point
    first, second, before = candidate(
        problem.model, float(point.family.value), float(point.branch), problem.duration, problem.length,
        problem.criterion is Criterion.ZERO_WRENCH, z,
    )  # fmt: skip
    return joined(first, second, before, problem.duration)


def descend(problem: Problem, guess: Array) -> tuple[float, Array]:
    """The cost and the variables at the end of one descent."""
    point, z = problem.point, guess.copy()
    full = problem.criterion is Criterion.ZERO_WRENCH

    def value(free: Array) -> tuple[float, Array]:
        z[problem.free] = free
        found: tuple[float, Array] = cost_and_gradient(
            problem.model, float(point.family.value), float(point.branch), problem.duration, problem.length, full,
            problem.sign, problem.limits, z, problem.free,
        )  # fmt: skip
        return found

    bounds = [SPLIT_BOUNDS if index in SPLIT else (None, None) for index in problem.free]
    found = minimize(
        value, guess[problem.free], jac=True, method="L-BFGS-B", bounds=bounds,
        options={"maxiter": ITERATIONS, "maxfun": EVALUATIONS},
    )  # fmt: skip
    best = guess.copy()
    best[problem.free] = found.x
    return float(found.fun), best


def guesses_through(problem: Problem, towards: Array | None = None) -> list[Array]:
    """Guesses with rests straight ahead of the point on both sides, as much in line as can be."""
    model, x, length = problem.model, problem.point.x, problem.length
    clear, reach = problem.limits[5], REST_REACH * problem.length
    starts = rests_around(model, x, -problem.sign, clear, REST_S, reach)
    goals = rests_around(model, x, problem.sign, clear, REST_S, reach)
    if len(starts) == 0 or len(goals) == 0:
        return []
    before, after = x - starts[:, :2], goals[:, :2] - x
    far_before, far_after = np.hypot(*before.T), np.hypot(*after.T)
    aligned = (before / far_before[:, None]) @ (after / far_after[:, None]).T
    total = far_before[:, None] + far_after[None]
    clearance = np.minimum(starts[:, 3][:, None], goals[:, 3][None])
    score = 1.0 - aligned + np.abs(total / (0.7 * length) - 1.0) + 0.5 * np.maximum(0.0, 1.0 - clearance / 0.3)
    if towards is not None:
        score -= 2.0 * (after / far_after[:, None] @ towards)[None] + 2.0 * (before / far_before[:, None] @ towards)[:, None]
    chosen: list[Array] = []
    found: list[Array] = []
    for index in np.argsort(score, axis=None):
        row, column = np.unravel_index(index, score.shape)
        way = goals[column, :2] - starts[row, :2]
        direction = way / np.hypot(*way)
        if any(direction @ other > 0.9 for other in chosen):
            continue
        chosen.append(direction)
        z = np.zeros(12)
        z[0:2], z[2:4] = starts[row, :2] / length, goals[column, :2] / length
        z[4] = problem.point.angle
        z[5] = np.clip(far_before[row] / total[row, column], 0.35, 0.65)
        z[6:8] = 2.0 * way / length
        found.append(z)
        if len(found) == GUESSES:
            break
    return found


def search(problem: Problem, guesses: list[Array]) -> tuple[float, Array] | None:
    """The best of the descents, which stop at the first good one."""
    best: tuple[float, Array] | None = None
    for guess in guesses:
        found = descend(problem, guess)
        if best is None or found[0] < best[0]:
            best = found
        if best[0] < GOOD:
            break
    return best
