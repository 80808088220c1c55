"""Attempts at a way: the best so far, its stretching in time, and why there is none."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dextar_control.contract.errors import TrajectoryError
from dextar_control.model.model import Model
from dextar_control.model.robot import AnyRobot
from dextar_control.planning.certificate import (
    PLAN_RESIDUAL,
    Certificate,
    Plan,
    measure,
)
from dextar_control.planning.checks import certify
from dextar_control.planning.locus import MIN_END_S, LocusPoint
from dextar_control.planning.search import (
    BENDS,
    GOOD,
    TORQUE_SHARE,
    Problem,
    Progress,
    descend,
    trajectory_of,
)
from dextar_control.planning.trajectory import Trajectory, in_words
from dextar_control.symbols.record import Record

# s and m/s: a way of open duration is searched at BASE_DURATION + length / PACE
BASE_DURATION, PACE = 0.25, 0.8
# from the best so far where it is not good, and by how much it is shaken
RESTARTS, RESTART_SPREAD = 24, 0.15
BISECTIONS = 3  # of the nearest duration
HEADROOM = 1.002  # of a duration over the one at which the limit is met
LONGEST_STRETCH = 20.0  # of the duration, that is offered instead
STRETCHES = 4  # of a way of open duration, each to what its torque asks for
SETTLED = 0.01  # of the duration, below which it is not stretched again


def scale_of(duration: float | None, length: float) -> float:
    """Return the duration, s, at which a way of some length, m, is searched: the
    duration asked for, or where it is open one for the length.

    Raises:
        TrajectoryError: the one asked for is not positive.
    """
    if duration is None:
        return BASE_DURATION + length / PACE
    if not (np.isfinite(duration) and duration > 0.0):
        raise TrajectoryError(f"duration = {duration} s; it must be > 0")
    return duration


class Attempt(NamedTuple):
    """Where a descent ended: a plan, or the error that says why it is none."""

    problem: Problem
    z: Record
    cost: float
    plan: Plan | None
    error: TrajectoryError | None

    @property
    def good(self) -> bool:
        """Whether it is a plan at which the search stops."""
        return self.plan is not None and self.cost < GOOD


class Best:
    """The best attempt so far: certified ones first, then by cost."""

    def __init__(self, robot: AnyRobot) -> None:
        self.robot = robot
        self.found: Attempt | None = None

    def offer(self, problem: Problem, guess: Record) -> bool:
        """Descend from a guess; True when the best so far is good enough to stop at."""
        cost, z = descend(problem, guess)
        plan, error = None, None
        try:
            plan = _checked(self.robot, trajectory_of(problem, z))
            share = plan.certificate.peak_torque / problem.limits.torque
            cost += max(0.0, share - GOOD)
        except TrajectoryError as refusal:
            error = refusal
        new, old = Attempt(problem, z, cost, plan, error), self.found
        if old is None or ((new.plan is None, new.cost) < (old.plan is None, old.cost)):
            self.found = new
        return self.found is not None and self.found.good

    def restart(self, enough: Callable[[Attempt], bool], progress: Progress) -> None:
        """Descend from the best attempt with bends open, first as it is, then shaken,
        until ``enough`` of the best attempt holds.
        """
        generator = np.random.default_rng(0)
        for row in range(RESTARTS):
            if self.found is None or enough(self.found):
                break
            progress(row / RESTARTS, f"restart {row + 1} of {RESTARTS}")
            problem, guess = self.found.problem.opened(*BENDS), self.found.z.copy()
            guess.numbers[problem.free] += (
                RESTART_SPREAD * (row > 0) * generator.normal(size=len(problem.free))
            )
            self.offer(problem, guess)
        certified = self.found is not None and self.found.plan is not None
        progress(1.0, "certified" if certified else "not found")

    def outcome(
        self,
        what: str,
        stretch: bool,
        other_point: Callable[[], LocusPoint | None] = lambda: None,
    ) -> Plan:
        """Return the best plan.

        Args:
            what: is planned, in messages.
            stretch: to the duration at which its peak torque is TORQUE_SHARE of the
                limit.
            other_point: finds a point nearby that works.

        Raises:
            TrajectoryError: there is none; says what stands in the way, by how much,
                and what would work instead.
        """
        assert self.found is not None
        if stretch:
            return _stretched(self.robot, self.found)
        if self.found.plan is not None:
            return self.found.plan
        text = (
            f"no {what} within {self.found.problem.task.duration:.4g} s was found:"
            f" {self.found.error}"
        )
        nearest = _nearest_duration(self.robot, self.found)
        if nearest is not None:
            raise TrajectoryError(
                f"{text}; the nearest duration that works is {nearest:.4f} s",
                duration=nearest,
            )
        point = other_point()
        if point is not None:
            raise TrajectoryError(
                f"{text}; the nearest point that works is {in_words(point.x)}",
                point=point.x.tolist(),
            )
        raise TrajectoryError(
            f"{text}; neither a longer duration nor a point nearby was found to work"
        )


def scalable(model: Model, trajectory: Trajectory) -> bool:
    """Return whether a trajectory keeps the criterion when its time is scaled or
    reversed: the robot needs no torque at rest where it starts and ends, and its
    passive joints have no friction.
    """
    rest, motion = np.zeros(model.n), np.ones(model.n)
    for x in (trajectory.at(0.0).x, trajectory.at(trajectory.duration).x):
        still, there, back = (
            model.wrenches(model.place(x).q_a, x, x_dot, rest)
            for x_dot in (rest, motion, -motion)
        )
        for name in ("w_b", "w_d"):
            turned = getattr(there, name) != getattr(back, name)
            if getattr(still, name).any() or turned.any():
                return False
    return True


def _checked(robot: AnyRobot, trajectory: Trajectory) -> Plan:
    certificate = certify(robot, trajectory, max_residual=PLAN_RESIDUAL, crossings=1)
    least = float(np.abs(certificate.profile.s[[0, -1]]).min())
    if not least >= MIN_END_S:
        raise TrajectoryError(
            f"the way ends at |s| = {least:.3g} of the Type 2 locus; a rest needs"
            f" {MIN_END_S}"
        )
    return Plan(trajectory, certificate)


def _needed(robot: AnyRobot, seen: Certificate, torque: float) -> float:
    """Return the factor of its duration at which a way keeps a torque, N m, and the
    speed limits.
    """
    return max(
        float(np.sqrt(seen.peak_torque / torque)),
        HEADROOM * seen.peak_joint_speed / robot.max_joint_speed,
        HEADROOM * seen.peak_platform_speed / robot.max_platform_speed,
    )


def _stretched(robot: AnyRobot, found: Attempt) -> Plan:
    """Return the plan of an attempt at the duration at which its peak torque is
    TORQUE_SHARE of the limit.
    """
    problem, z = found.problem, found.z
    duration, trajectory = problem.task.duration, trajectory_of(problem, z)
    torque = TORQUE_SHARE * robot.max_torque
    for _ in range(STRETCHES):
        needed = _needed(robot, measure(robot, trajectory), torque)
        factor = float(np.clip(needed, 0.5, 2.0))
        if 1.0 - SETTLED < factor <= 1.0:
            break
        duration *= factor
        if scalable(problem.model, trajectory):
            trajectory = trajectory.scaled(factor)
        else:
            problem = problem.lasting(duration)
            z = descend(problem, z)[1]
            trajectory = trajectory_of(problem, z)
    return _checked(robot, trajectory)


def _nearest_duration(robot: AnyRobot, found: Attempt) -> float | None:
    """Return the least duration, s, at which an attempt's way works; None where more
    than its torque or speed is in the way.
    """
    problem, z = found.problem, found.z
    seen = measure(robot, trajectory_of(problem, z))
    sound = np.isfinite(seen.profile.torque).all() and len(seen.crossing_times) == 1
    if not sound or seen.least_type1 < robot.min_type1_distance:
        return None
    low: float = problem.task.duration
    high = min(_needed(robot, seen, robot.max_torque) * HEADROOM, LONGEST_STRETCH) * low

    def works(duration: float) -> bool:
        moved = problem.lasting(duration)
        for candidate in (z, descend(moved, z)[1]):
            try:
                _checked(robot, trajectory_of(moved, candidate))
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
