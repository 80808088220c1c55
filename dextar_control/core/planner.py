"""Plans a way through the Type 2 locus, rest to rest, with the criterion imposed at the crossing.

One polynomial of degree 10 per coordinate: four conditions at each end (position; zero velocity,
acceleration and jerk) and three at the crossing (position on the locus, velocity, and the acceleration
whose component along t_s follows from t_s.w_d = 0). What that leaves open (where on the locus, how
fast, how much acceleration normal to t_s, when) is chosen by minimising the peak torque.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, minimize

from dextar_control.contract.errors import GeometryError, TrajectoryError
from dextar_control.contract.robot import RobotParameters
from dextar_control.core.certificate import Certificate, certify, measure
from dextar_control.core.dynamics import criterion_acceleration
from dextar_control.core.kinematics import (
    inverse_model,
    singular_values,
    singularity,
    singularity_of_platform,
    state_of_platform,
    type1_distance,
)
from dextar_control.core.locus import MIN_END_S, LocusPoint, locus_point
from dextar_control.core.model import Array, Model, make_model
from dextar_control.core.search import (
    GOAL,
    SPLIT,
    START,
    STATE,
    TORQUE_SHARE,
    Criterion,
    guesses_through,
    make_problem,
    search,
    trajectory_of,
)
from dextar_control.core.trajectory import Trajectory, hold, join

PLAN_RESIDUAL = 1e-9  # N, at the crossing of a plan
LINE_SAMPLES = 17  # at which the line through a candidate point is looked at for the locus
COARSE_SAMPLES = 60  # of a candidate while optimising
DEGREE = 10
MIN_SLOPE = 0.1  # sine of the angle between a crossing's direction and the locus
FIRST_DURATION = 0.4  # s, at which a way of open duration is searched
MIN_APPROACH_S = 0.2  # |s| that an approach keeps on its way


class Plan(NamedTuple):
    """A served trajectory and what was checked about it."""

    trajectory: Trajectory
    certificate: Certificate


def crossing_polynomial(
    start: Array, goal: Array, x: Array, x_dot: Array, x_ddot: Array, before: float, after: float
) -> Trajectory:
    """Rest (zero jerk too) at start, given state at the crossing, rest at goal.

    Args:
        start, goal: (2,) m.
        x, x_dot, x_ddot: (2,) at the crossing.
        before, after: durations from the start to the crossing and from there to the goal, s.

    The polynomial's argument is zero at the crossing, so that position, velocity and acceleration
    there are its first three coefficients, exactly.
    """
    scale = max(before, after)
    powers = np.arange(3, DEGREE + 1)
    rows, right = [], []
    for time, target in ((-before / scale, start), (after / scale, goal)):
        known = x + x_dot * scale * time + 0.5 * x_ddot * scale**2 * time**2
        known_dot = x_dot * scale + x_ddot * scale**2 * time
        rows += [
            time**powers,
            powers * time ** (powers - 1.0),
            powers * (powers - 1) * time ** (powers - 2.0),
            powers * (powers - 1) * (powers - 2) * time ** (powers - 3.0),
        ]
        right += [target - known, -known_dot, -x_ddot * scale**2, np.zeros(2)]
    free = np.linalg.solve(np.array(rows), np.array(right))
    coefficients = np.concatenate([[x, x_dot, 0.5 * x_ddot], free / scale ** powers[:, None]])
    return Trajectory(np.array([0.0, before + after]), np.array([before]), coefficients[None])


def _side(model: Model, name: str, x: Array, robot: RobotParameters) -> float:
    try:
        inverse_model(model, x)
    except GeometryError as error:
        raise GeometryError(f"{name}: {error}") from error
    kin = state_of_platform(model, x, np.zeros(2))
    distance = type1_distance(model, kin)
    if distance < robot.min_type1_distance:
        raise GeometryError(
            f"{name} ({x[0]:.4f}, {x[1]:.4f}) m is {distance:.4f} from Type 1; the limit is {robot.min_type1_distance}"
        )
    return float(singularity(model, kin.A_r))




def _on_locus(model: Model, start: Array, goal: Array, shift: float) -> Array | None:
    """The point of the locus on the line start -> goal, moved sideways by ``shift`` (m)."""
    normal = np.array([start[1] - goal[1], goal[0] - start[0]]) / np.hypot(*(goal - start))

    def value(fraction: float) -> float:
        return singularity_of_platform(model, start + fraction * (goal - start) + shift * normal)

    fractions = np.linspace(0.0, 1.0, LINE_SAMPLES)
    values = np.array([value(fraction) for fraction in fractions])
    changes = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    if len(changes) == 0:
        return None
    fraction = brentq(value, fractions[changes[0]], fractions[changes[0] + 1], xtol=1e-15, rtol=1e-14)
    return start + fraction * (goal - start) + shift * normal


def plan_crossing(
    robot: RobotParameters, start: Array, goal: Array, duration: float, *, seed: int = 0
) -> Plan:
    """One way from start to goal, rest to rest, through the locus once.

    Args:
        start, goal: (2,) m, on two sides of the Type 2 locus.
        duration: s, > 0.
        seed: of the search's starting points.

    Raises:
        GeometryError: start or goal is unreachable or too near to Type 1 or Type 2.
        TrajectoryError: both lie on one side, or no way within the limits was found; the message
            names the limit that the best one breaks.
    """
    model = make_model(robot)
    start, goal = np.asarray(start, dtype=np.float64), np.asarray(goal, dtype=np.float64)
    if not duration > 0.0:
        raise TrajectoryError(f"duration = {duration} s; it must be > 0")
    sides = []
    for name, x in (("start", start), ("goal", goal)):
        s = _side(model, name, x, robot)
        if abs(s) < MIN_END_S:
            raise GeometryError(
                f"{name} ({x[0]:.4f}, {x[1]:.4f}) m is too near to the Type 2 locus: |s| = {abs(s):.3f}; the limit is {MIN_END_S}"
            )
        sides.append(s)
    if sides[0] * sides[1] > 0.0:
        raise TrajectoryError(
            f"start and goal lie on the same side of the Type 2 locus (s = {sides[0]:.3f} and {sides[1]:.3f});"
            " they must lie on two"
        )
    length = float(np.hypot(*(goal - start)))
    direction = (goal - start) / length

    def candidate(z: Array) -> Trajectory | None:
        """shift/length, ln speed along t_s, speed normal to it, free acceleration, instant: all scaled."""
        x = _on_locus(model, start, goal, z[0] * length)
        if x is None or not 0.15 < z[4] < 0.85:
            return None
        kin = state_of_platform(model, x, np.zeros(2))
        vectors = singular_values(kin.A_r)
        along = np.sign(vectors.v2 @ direction) * vectors.v2
        speed = length / duration
        x_dot = speed * (np.exp(z[1]) * along + z[2] * vectors.v1)
        kin = state_of_platform(model, x, x_dot)
        x_ddot = criterion_acceleration(model, kin, z[3] * length / duration**2)
        return crossing_polynomial(start, goal, x, x_dot, x_ddot, z[4] * duration, (1.0 - z[4]) * duration)

    def cost(z: Array) -> float:
        trajectory = candidate(z)
        if trajectory is None:
            return 1e6
        measured = measure(model, trajectory, duration / COARSE_SAMPLES)
        profile = measured.profile
        if not np.isfinite(profile.s).all():
            return 1e5
        excess = max(0.0, 2.0 * robot.min_type1_distance - measured.least_type1)
        excess += max(0.0, measured.peak_joint_speed / robot.max_joint_speed - 1.0)
        excess += max(0.0, measured.peak_platform_speed / robot.max_platform_speed - 1.0)
        excess += abs(len(measured.crossing_times) - 1)
        peak = float(np.mean(np.abs(profile.torque / robot.max_torque) ** 12) ** (1.0 / 12.0))
        return peak + 100.0 * excess

    generator = np.random.default_rng(seed)
    best, best_cost = None, np.inf
    guesses = [np.array([0.0, 0.6, 0.0, 0.0, 0.5])]
    guesses += [guesses[0] + generator.normal(0.0, [0.1, 0.2, 0.3, 2.0, 0.05]) for _ in range(4)]
    for guess in guesses:
        simplex = guess + np.concatenate([np.zeros((1, 5)), np.diag([0.1, 0.2, 0.3, 3.0, 0.08])])
        found = minimize(
            cost, guess, method="Nelder-Mead",
            options={"initial_simplex": simplex, "maxfev": 250, "xatol": 1e-3, "fatol": 1e-4},
        )  # fmt: skip
        if found.fun < best_cost:
            best, best_cost = candidate(found.x), found.fun
        if best_cost < 1.0:
            break
    if best is None:
        raise TrajectoryError(
            f"no crossing point of the Type 2 locus lies between ({start[0]:.4f}, {start[1]:.4f})"
            f" and ({goal[0]:.4f}, {goal[1]:.4f}) m"
        )
    return Plan(best, certify(robot, best, max_residual=PLAN_RESIDUAL, crossings=1))


def plan_approach(robot: RobotParameters, start: Array, goal: Array, speed: float) -> Trajectory:
    """A straight line from start to goal, rest to rest, that does not touch the locus.

    Args:
        start, goal: (2,) m.
        speed: peak speed, m/s.

    Raises:
        TrajectoryError: the line would cross the locus or break a limit.
    """
    start, goal = np.asarray(start, dtype=np.float64), np.asarray(goal, dtype=np.float64)
    model = make_model(robot)
    for name, x in (("start", start), ("goal", goal)):
        _side(model, name, x, robot)
    distance = float(np.hypot(*(goal - start)))
    # x = start + (goal - start)(35 t^4 - 84 t^5 + 70 t^6 - 20 t^7): zero velocity, acceleration and jerk at both ends
    law = np.array([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
    duration = max(35.0 / 16.0 * distance / speed, 0.1)
    coefficients = np.outer(law / duration ** np.arange(8), goal - start)
    coefficients[0] += start
    line = Trajectory(np.array([0.0, duration]), np.zeros(1), coefficients[None])
    least = measure(model, line).profile.s
    if not np.abs(least).min() >= MIN_APPROACH_S:
        raise TrajectoryError(
            f"the straight way from ({start[0]:.4f}, {start[1]:.4f}) to ({goal[0]:.4f}, {goal[1]:.4f}) m comes to |s| ="
            f" {np.abs(least).min():.3f} of the Type 2 locus; an approach keeps {MIN_APPROACH_S}"
        )
    certify(robot, line, max_residual=PLAN_RESIDUAL, crossings=0)
    return line


def plan_return_trip(
    robot: RobotParameters, start: Array, goal: Array, duration: float, dwell: float, repeat: int = 1
) -> Plan:
    """start -> goal -> start, ``repeat`` times, with rests before, between and after.

    The way back is the time reversal of the way out when there is no gravity and no friction in the
    criterion; with gravity it is planned by itself.

    Args:
        duration: of one way, s.
        dwell: of each rest, s.

    Raises:
        GeometryError, TrajectoryError: as ``plan_crossing``.
    """
    if repeat < 1:
        raise TrajectoryError(f"repeat = {repeat}; it must be >= 1")
    out = plan_crossing(robot, start, goal, duration).trajectory
    back = out.reversed() if robot.gravity == (0.0, 0.0) else plan_crossing(robot, goal, start, duration).trajectory
    return _there_and_back(robot, out, back, dwell, repeat)


def robot_at(robot: RobotParameters, point: LocusPoint) -> RobotParameters:
    """The robot in the working mode of a locus point."""
    return robot.replace(working_mode=point.working_mode)


def _place(robot: RobotParameters, point: LocusPoint | Array) -> LocusPoint:
    if not isinstance(point, LocusPoint):
        return locus_point(robot, point)
    if point.working_mode != robot.working_mode:
        raise GeometryError(
            f"the locus point ({point.x[0]:.4f}, {point.x[1]:.4f}) m belongs to working mode {list(point.working_mode)}, the"
            f" robot is in {list(robot.working_mode)}: set robot.working_mode"
        )
    return point


def _way(point: LocusPoint, direction: int | float | Array) -> tuple[float, Array | None]:
    """The sign of s after the crossing and the unit direction of the velocity, if one was given."""
    if np.ndim(direction) == 0:
        if float(direction) not in (-1.0, 1.0):
            raise TrajectoryError(f"direction = {direction}; it must be +1 or -1 (the sign of s after the crossing) or a vector")
        return float(direction), None
    towards = np.asarray(direction, dtype=np.float64)
    norm = float(np.hypot(*towards))
    if not norm > 0.0:
        raise TrajectoryError(f"direction = {towards.tolist()}; it must not vanish")
    slope = float(point.gradient @ towards) / norm / float(np.hypot(*point.gradient))
    if abs(slope) < MIN_SLOPE:
        normal = point.gradient / np.hypot(*point.gradient)
        raise TrajectoryError(
            f"the direction ({towards[0]:.3f}, {towards[1]:.3f}) runs along the locus at ({point.x[0]:.4f}, {point.x[1]:.4f}) m:"
            f" the sine of its angle to the locus is {abs(slope):.3f}; a crossing needs {MIN_SLOPE}; across is"
            f" ({normal[0]:.3f}, {normal[1]:.3f})"
        )
    return float(np.sign(slope)), towards / norm


def plan_through(
    robot: RobotParameters,
    point: LocusPoint | Array,
    direction: int | Array,
    duration: float | None = None,
    *,
    criterion: Criterion = Criterion.RECIPROCAL,
) -> Plan:
    """One way through a given point of the locus, rest to rest; the planner chooses both ends.

    Args:
        robot: in the working mode of the point (``robot_at``).
        point: a locus point, or its position (2,), m.
        direction: the sign of s after the crossing, or the direction (2,) of the velocity there.
        duration: s; chosen when None, so that the peak torque is TORQUE_SHARE of the limit.
        criterion: what holds at the crossing.

    Raises:
        GeometryError: the point is off the locus or has no room for a rest on both sides.
        TrajectoryError: the direction does not cross, or no way within the limits was found.
    """
    place = _place(robot, point)
    sign, towards = _way(place, direction)
    problem = make_problem(robot, place, sign, duration or FIRST_DURATION, criterion, START + GOAL + SPLIT + STATE)
    guesses = guesses_through(problem, towards)
    found = search(problem, guesses)
    if found is None:
        raise GeometryError(
            f"the locus point ({place.x[0]:.4f}, {place.x[1]:.4f}) m has no room for a rest (|s| >= {MIN_END_S}) on both sides"
        )
    trajectory = trajectory_of(problem, found[1])
    if duration is None:
        peak = measure(problem.model, trajectory).peak_torque
        trajectory = trajectory.scaled(float(np.sqrt(peak / (TORQUE_SHARE * robot.max_torque))))
    return Plan(trajectory, certify(robot, trajectory, max_residual=PLAN_RESIDUAL, crossings=1))


def plan_return_trip_through(
    robot: RobotParameters,
    point: LocusPoint | Array,
    direction: int | Array,
    duration: float | None,
    dwell: float,
    repeat: int = 1,
    *,
    criterion: Criterion = Criterion.RECIPROCAL,
) -> Plan:
    """Out through a given point of the locus and back, ``repeat`` times, with rests before, between and after.

    Args:
        duration: of one way, s; chosen when None.
        dwell: of each rest, s.

    Raises:
        GeometryError, TrajectoryError: as ``plan_through``.
    """
    if repeat < 1:
        raise TrajectoryError(f"repeat = {repeat}; it must be >= 1")
    out = plan_through(robot, point, direction, duration, criterion=criterion).trajectory
    return _there_and_back(robot, out, out.reversed(), dwell, repeat)


def _there_and_back(robot: RobotParameters, out: Trajectory, back: Trajectory, dwell: float, repeat: int) -> Plan:
    start, goal = out.at(0.0).x, out.at(out.duration).x
    trip = join([hold(start, dwell)] + [out, hold(goal, dwell), back, hold(start, dwell)] * repeat)
    return Plan(trip, certify(robot, trip, max_residual=PLAN_RESIDUAL, crossings=2 * repeat))
