"""The search for a crossing or a leg: guesses, and a quasi-Newton descent from each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from dextar_control.contract.robot import RobotParameters
from dextar_control.core.crossing import (
    BENDS,
    SPANS,
    VARIABLES,
    VELOCITY,
    Limits,
    Task,
    cost_and_gradient,
    crossing_state,
    halves,
)
from dextar_control.core.locus import REST_REACH, REST_S, LocusPoint, rests_around
from dextar_control.core.model import Array, Model, make_model
from dextar_control.core.trajectory import Trajectory

TORQUE_SHARE = 0.3  # of max_torque: the peak torque that costs one, and that a way of open duration has
NEAR_TIME = 0.05  # s near the locus that costs NEAR_WEIGHT
NEAR_WEIGHT = 1.0
SOFT_TYPE1 = 0.12  # distance to Type 1 that a plan keeps where it can
SOFT_END_S = 0.45  # |s| of ends that the planner chooses
LEG_TIME = 2.0  # s of a leg between two crossings that costs one
GOOD = 1.5  # cost below which no further guess is tried
ITERATIONS = 80  # of one descent
TOLERANCE = 1e-3  # on the gradient
GUESSES = 3
HURRIED, HURRY = 2, 2.5  # of them that are tried with a velocity so many times larger
VISIT = 0.9  # cosine of the angle between the ways of two guesses that are taken as one

Progress = Callable[[float, str], None]


class Criterion(Enum):
    """What holds at the crossing: t_s.w_d = 0 (Eq. 5), or w_d = 0 altogether (the paper's [10])."""

    RECIPROCAL = "reciprocal"
    ZERO_WRENCH = "zero_wrench"


class Problem(NamedTuple):
    """A crossing or leg whose open variables are searched."""

    model: Model
    task: Task
    free: Array  # indices of the open variables


def soft_limits(robot: RobotParameters, end_s: float) -> Limits:
    """What the search aims at, inside the robot's limits."""
    return Limits(
        TORQUE_SHARE * robot.max_torque, NEAR_TIME, NEAR_WEIGHT, LEG_TIME, robot.max_joint_speed, robot.max_platform_speed,
        max(SOFT_TYPE1, 1.2 * robot.min_type1_distance), end_s,
    )  # fmt: skip


def crossing_problem(
    robot: RobotParameters,
    point: LocusPoint,
    sign: float,
    duration: float,
    criterion: Criterion,
    free: Sequence[int],
    end_s: float = SOFT_END_S,
    towards: Array | None = None,
) -> Problem:
    """A crossing near a locus point.

    Args:
        sign: of s after the crossing.
        duration: s.
        free: indices of the variables that are open, ``crossing.START`` and so on.
        end_s: |s| that the ends keep.
        towards: (2,) unit direction of the velocity at the crossing; open when None.
    """
    model = make_model(robot)
    nothing = np.zeros((4, 2))
    task = Task(
        False, float(point.family.value), float(point.branch), criterion is Criterion.ZERO_WRENCH, sign, float(duration),
        float(model.l2.mean()), np.zeros(2) if towards is None else towards, nothing, nothing, soft_limits(robot, end_s),
    )  # fmt: skip
    open_ones = set(free) - ({VELOCITY[1]} if towards is not None else set())
    return Problem(model, task, np.array(sorted(open_ones), dtype=np.int64))


def leg_problem(robot: RobotParameters, left: Array, reached: Array, sign: float, duration: float) -> Problem:
    """A leg on the side ``sign`` between two crossing states (4, 2), about ``duration`` s long."""
    model = make_model(robot)
    task = Task(
        True, 1.0, 1.0, False, sign, float(duration), float(model.l2.mean()), np.zeros(2), left, reached,
        soft_limits(robot, SOFT_END_S),
    )  # fmt: skip
    return Problem(model, task, np.array([*range(8), *SPANS, *BENDS], dtype=np.int64))


def trajectory_of(problem: Problem, z: Array) -> Trajectory:
    """The candidate z as a trajectory from time 0."""
    pair = halves(problem.model, problem.task, z)
    coefficients = np.stack([pair.first, pair.second])
    first, second = abs(pair.first_span), abs(pair.second_span)
    origins = np.array([0.0, first + second]) if problem.task.leg else np.array([first, first])
    return Trajectory(np.array([0.0, first, first + second]), origins, coefficients)


def state_at_crossing(problem: Problem, z: Array) -> Array:
    """Rows x, x_dot, x_ddot, jerk (4, 2) at the crossing of a candidate."""
    return crossing_state(problem.model, problem.task, z)


def descend(problem: Problem, guess: Array, iterations: int = ITERATIONS) -> tuple[float, Array]:
    """The cost and the variables at the end of one descent."""
    z = guess.copy()

    def value(free: Array) -> tuple[float, Array]:
        z[problem.free] = free
        found: tuple[float, Array] = cost_and_gradient(problem.model, problem.task, z, problem.free)
        return found

    found = minimize(value, guess[problem.free], jac=True, method="BFGS", options={"maxiter": iterations, "gtol": TOLERANCE})
    best = guess.copy()
    best[problem.free] = found.x
    return float(found.fun), best


def guesses_through(problem: Problem, point: LocusPoint, towards: Array | None = None) -> list[Array]:
    """Guesses with rests straight ahead of the point on both sides, as much in line as can be."""
    model, x, length, sign = problem.model, point.x, problem.task.length, problem.task.sign
    clear, reach = problem.task.limits.type1, REST_REACH * length
    starts = rests_around(model, x, -sign, clear, REST_S, reach)
    goals = rests_around(model, x, sign, clear, REST_S, reach)
    if len(starts) == 0 or len(goals) == 0:
        return []
    before, after = x - starts[:, :2], goals[:, :2] - x
    far_before, far_after = np.hypot(*before.T), np.hypot(*after.T)
    aligned = (before / far_before[:, None]) @ (after / far_after[:, None]).T
    total = far_before[:, None] + far_after[None]
    clearance = np.minimum(starts[:, 3][:, None], goals[:, 3][None])
    score = 1.0 - aligned + np.abs(total / (0.7 * length) - 1.0) + 0.5 * np.maximum(0.0, 1.0 - clearance / 0.3)
    if towards is not None:
        score = score - 2.0 * (after / far_after[:, None] @ towards)[None]
        score = score - 2.0 * (before / far_before[:, None] @ towards)[:, None]
    chosen: list[Array] = []
    found: list[Array] = []
    for index in np.argsort(score, axis=None):
        row, column = np.unravel_index(index, score.shape)
        way = goals[column, :2] - starts[row, :2]
        direction = way / np.hypot(*way)
        if any(direction @ other > VISIT for other in chosen):
            continue
        chosen.append(direction)
        z = np.zeros(VARIABLES)
        z[0:2], z[2:4] = starts[row, :2] / length, goals[column, :2] / length
        z[4] = point.angle
        z[5] = np.clip(far_before[row] / total[row, column], 0.35, 0.65)
        z[6:8] = 2.0 * (way if towards is None else np.array([np.hypot(*way), 0.0])) / length
        found.append(z)
        if len(found) == GUESSES:
            break
    hurried = [guess.copy() for guess in found[:HURRIED]]
    for guess in hurried:
        guess[6:8] *= HURRY
    return found + hurried
