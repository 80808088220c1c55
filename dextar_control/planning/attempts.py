"""Attempts at a way: the best one so far, at another duration, and in words why there is none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dextar_control.contract.errors import TrajectoryError
from dextar_control.model.model import Model
from dextar_control.model.robot import AnyRobot
from dextar_control.planning.certificate import PLAN_RESIDUAL, Plan, measure
from dextar_control.planning.checks import certify
from dextar_control.planning.locus import LocusPoint
from dextar_control.planning.search import GOOD, TORQUE_SHARE, Problem, descend, trajectory_of
from dextar_control.planning.trajectory import Trajectory, in_words
from dextar_control.symbols.record import Record

BASE_DURATION, PACE = 0.25, 0.8  # s and m/s: duration over a way's length at which a way of open duration is searched
RESTARTS, RESTART_SPREAD = 12, 0.15  # from the best so far where it is not good, and by how much it is shaken
BISECTIONS = 3  # of the nearest duration
HEADROOM = 1.002  # of a duration over the one at which the limit is met
LONGEST_STRETCH = 20.0  # of the duration, that is offered instead
STRETCHES = 4  # of a way of open duration, each to what its torque asks for
SETTLED = 0.01  # of the duration, below which it is not stretched again


def checked(robot: AnyRobot, trajectory: Trajectory) -> Plan:
    """A certified way with one crossing.

    Raises:
        TrajectoryError: it is none; names the value and the limit.
    """
    return Plan(trajectory, certify(robot, trajectory, max_residual=PLAN_RESIDUAL, crossings=1))


def check_duration(duration: float | None) -> None:
    """Raise TrajectoryError unless it is positive or None."""
    if duration is not None and not (np.isfinite(duration) and duration > 0.0):
        raise TrajectoryError(f"duration = {duration} s; it must be > 0")


def shaken(z: Record, free: NDArray[np.int64], generator: np.random.Generator, spread: float) -> Record:
    """Variables of a candidate, the open ones shaken."""
    other = z.copy()
    other.numbers[free] += spread * generator.normal(size=len(free))
    return other


class Best:
    """The best candidate so far: certified ones first, then by cost."""

    def __init__(self, robot: AnyRobot) -> None:
        self.robot = robot
        self.cost = np.inf
        self.plan: Plan | None = None
        self.problem: Problem | None = None
        self.z: Record | None = None
        self.error: TrajectoryError | None = None

    def offer(self, problem: Problem, guess: Record) -> bool:
        """Descend from a guess; True when the plan is good enough to stop."""
        cost, z = descend(problem, guess)
        plan, error = None, None
        try:
            plan = checked(self.robot, trajectory_of(problem, z))
            cost += max(0.0, plan.certificate.peak_torque / problem.limits.torque - GOOD)
        except TrajectoryError as refusal:
            error = refusal
        better = cost < self.cost if (plan is None) == (self.plan is None) else plan is not None
        if better:
            self.cost, self.plan, self.problem, self.z, self.error = cost, plan, problem, z, error
        return self.plan is not None and self.cost < GOOD


def weightless(model: Model, trajectory: Trajectory) -> bool:
    """Whether the robot needs no torque at rest where a trajectory starts and ends: then time may be scaled, and reversed."""
    for x in (trajectory.at(0.0).x, trajectory.at(trajectory.duration).x):
        found = model.wrenches(model.place(x).q_a, x, np.zeros(model.n), np.zeros(model.n))
        if found.w_b.any() or found.w_d.any():
            return False
    return True


def stretched(robot: AnyRobot, problem: Problem, z: Record) -> Plan:
    """A candidate at the duration at which its peak torque is TORQUE_SHARE of the limit."""
    duration = problem.task.duration
    trajectory = trajectory_of(problem, z)
    for _ in range(STRETCHES):
        seen = measure(robot, trajectory)
        factor = max(
            np.sqrt(seen.peak_torque / (TORQUE_SHARE * robot.max_torque)),
            seen.peak_joint_speed / robot.max_joint_speed,
            seen.peak_platform_speed / robot.max_platform_speed,
        )
        factor = float(np.clip(factor, 0.5, 2.0))
        if abs(factor - 1.0) < SETTLED:
            break
        duration *= factor
        if weightless(problem.model, trajectory):
            trajectory = trajectory.scaled(factor)
        else:
            problem = problem.lasting(duration)
            z = descend(problem, z)[1]
            trajectory = trajectory_of(problem, z)
    return checked(robot, trajectory)


def _nearest_duration(robot: AnyRobot, best: Best) -> float | None:
    """A duration at which the best candidate's way works, when only its torque or speed is in the way."""
    if best.problem is None or best.z is None:
        return None
    problem, z = best.problem, best.z
    seen = measure(robot, trajectory_of(problem, z))
    sound = np.isfinite(seen.profile.torque).all() and len(seen.crossing_times) == 1
    if not sound or seen.least_type1 < robot.min_type1_distance:
        return None
    factor = max(
        float(np.sqrt(seen.peak_torque / robot.max_torque)),
        seen.peak_joint_speed / robot.max_joint_speed,
        seen.peak_platform_speed / robot.max_platform_speed,
    )
    low, high = problem.task.duration, min(factor * HEADROOM, LONGEST_STRETCH) * problem.task.duration

    def works(duration: float) -> bool:
        moved = problem.lasting(duration)
        for candidate in (z, descend(moved, z)[1]):
            try:
                checked(robot, trajectory_of(moved, candidate))
            except TrajectoryError:
                continue
            return True
        return False

    if not works(high):
        return None
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if works(middle) else (middle, high)
    return high


def refuse(robot: AnyRobot, what: str, best: Best, other_point: Callable[[], LocusPoint | None]) -> TrajectoryError:
    """What stands in the way, by how much, and what would work instead."""
    duration = best.problem.task.duration if best.problem is not None else float("nan")
    text = f"no {what} within {duration:.4g} s was found: {best.error}"
    nearest = _nearest_duration(robot, best)
    if nearest is not None:
        return TrajectoryError(f"{text}; the nearest duration that works is {nearest:.4f} s")
    point = other_point()
    if point is not None:
        return TrajectoryError(f"{text}; the nearest point that works is {in_words(point.x)}")
    return TrajectoryError(f"{text}; neither a longer duration nor a point nearby was found to work")
