"""Regular motion: from rest to rest on one side of the locus, straight or around it."""

from __future__ import annotations

import numpy as np

from dextar_control.contract.errors import GeometryError, TrajectoryError
from dextar_control.contract.robot import RobotParameters
from dextar_control.model.robot import AnyRobot
from dextar_control.planning.certificate import PLAN_RESIDUAL, measure
from dextar_control.planning.checks import beyond_range, certify
from dextar_control.planning.model import states_model
from dextar_control.planning.regions import SPACING, find_way, make_regions
from dextar_control.planning.trajectory import Trajectory, in_words, lengths_along
from dextar_control.symbols.types import Array

MIN_APPROACH_S = 0.2  # |s| that an approach keeps on its way
KEPT_S = 1.3  # times that, on the grid: what a spline may cut off corners
LEAST_DURATION = 0.1  # s, of a motion however short
SPLINE_DEGREE = 7
BUSY_TORQUE = 0.3  # of max_torque that a regular motion takes at most
# grid places from one spline point to the next: the first that keeps clear counts
STRIDES = (16, 10, 6, 4, 2)
COUNTS = {2: "two", 3: "three"}
TIGHTENINGS = 6  # of the pace, each to what the torque asks for


def side_of(robot: AnyRobot, name: str, x: Array) -> float:
    """Return s of the place where a motion starts or ends.

    Args:
        robot: of the motion.
        name: of the place, in messages.
        x: (n,), m.

    Raises:
        GeometryError: it is unreachable, too near to Type 1 or out of a joint's range.
    """
    model = states_model(robot)
    if not np.isfinite(x).all() or x.shape != (model.n,):
        raise GeometryError(
            f"{name} = {x.tolist()}; it must be {COUNTS.get(model.n, model.n)} finite"
            " numbers, m"
        )
    try:
        model.inverse_geometric_model(x)
    except GeometryError as error:
        raise GeometryError(f"{name}: {error}") from error
    found = model.side(x)
    distance = float(found.type1[0])
    if distance < robot.min_type1_distance:
        raise GeometryError(
            f"{name} {in_words(x)} is {distance:.4f} from Type 1; the limit is"
            f" {robot.min_type1_distance}"
        )
    beyond = beyond_range(robot, found.q_a)
    if beyond.max() > 0.0:
        leg, unit = int(np.argmax(beyond)), model.mechanism.joints[0].unit
        raise GeometryError(
            f"{name} {in_words(x)} takes the {robot.sides[leg]} joint to"
            f" {found.q_a[leg]:.4g} {unit}; the limits are"
            f" {robot.joint_range[0][leg]:.4g} and {robot.joint_range[1][leg]:.4g}"
            f" {unit}"
        )
    return float(found.s[0])


def straight(start: Array, goal: Array, speed: float) -> Trajectory:
    """x = start + (goal - start)(35 t^4 - 84 t^5 + 70 t^6 - 20 t^7): rest to rest, with
    zero jerk at both ends.

    Args:
        start, goal: (n,), m.
        speed: peak speed, m/s.
    """
    law = np.array([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
    duration = max(
        35.0 / 16.0 * float(np.linalg.norm(goal - start)) / speed, LEAST_DURATION
    )
    coefficients = np.outer(law / duration ** np.arange(8), goal - start)
    coefficients[0] += start
    return Trajectory(np.array([0.0, duration]), np.zeros(1), coefficients[None])


def spline(places: Array, speed: float) -> Trajectory:
    """Return the motion through places (m, 2), m, four at least, at a peak speed, m/s:
    rest to rest, with zero jerk at both ends.
    """
    # here: it takes longer to load than all else
    from scipy.interpolate import PPoly, make_interp_spline

    reached = lengths_along(places)
    share = reached / reached[-1]
    # the time law 10 t^3 - 15 t^4 + 6 t^5, inverted on a table, spreads the places as a
    # motion from rest to rest does
    table = np.linspace(0.0, 1.0, 1001)
    times = np.interp(share, table**3 * (10.0 - 15.0 * table + 6.0 * table**2), table)
    rest = [(1, 0.0), (2, 0.0), (3, 0.0)]
    splines = [
        make_interp_spline(times, along, k=SPLINE_DEGREE, bc_type=(rest, rest))
        for along in places.T
    ]
    curves = [PPoly.from_spline(along) for along in splines]
    pieces = np.diff(curves[0].x) > 0.0
    knots = np.append(curves[0].x[:-1][pieces], curves[0].x[-1])
    coefficients = np.stack([curve.c[::-1, pieces].T for curve in curves], axis=2)
    unit = Trajectory(knots - knots[0], knots[:-1] - knots[0], coefficients)
    _, x_dot, _ = unit.table(np.linspace(0.0, unit.duration, 200))
    fastest = float(np.hypot(*x_dot.T).max())
    return unit.scaled(max(fastest / speed, LEAST_DURATION))


def _clear(robot: AnyRobot, motion: Trajectory) -> bool:
    profile = measure(robot, motion, motion.duration / 400.0).profile
    return bool(
        np.isfinite(profile.s).all()
        and np.abs(profile.s).min() >= MIN_APPROACH_S
        and np.ptp(np.sign(profile.s)) == 0.0
        and profile.type1.min() >= robot.min_type1_distance
        and beyond_range(robot, profile.q_a).max() <= 0.0
    )


def _paced(robot: AnyRobot, motion: Trajectory) -> Trajectory:
    """Return the motion, slowed down until it takes BUSY_TORQUE of the torque limit (or
    as little as gravity lets it).
    """
    limit = BUSY_TORQUE * robot.max_torque
    for _ in range(TIGHTENINGS):
        peak = measure(robot, motion, motion.duration / 400.0).peak_torque
        if peak <= limit:
            break
        motion = motion.scaled(float(np.clip(np.sqrt(peak / limit), 1.05, 2.0)))
    return motion


def plan_approach(
    robot: AnyRobot, start: Array, goal: Array, speed: float
) -> Trajectory:
    """Plan from start to goal, rest to rest, on one side of the locus: a straight line,
    or for the five-bar a spline where that fails.

    Args:
        robot: of any mechanism.
        start, goal: (n,), m.
        speed: peak speed, m/s.

    Raises:
        GeometryError: start or goal is unreachable, too near to Type 1 or out of a
            joint's range.
        TrajectoryError: no way stays on one side, clear of Type 1 and in the joints'
            range.
    """
    start, goal = np.asarray(start, np.float64), np.asarray(goal, np.float64)
    if not speed > 0.0:
        raise TrajectoryError(f"speed = {speed} m/s; it must be > 0")
    before = np.sign(side_of(robot, "start", start))
    after = np.sign(side_of(robot, "goal", goal))
    line = straight(start, goal, speed)
    motion = line if _clear(robot, line) else None
    if motion is None and before == after and isinstance(robot, RobotParameters):
        least_s = KEPT_S * MIN_APPROACH_S
        found = find_way(make_regions(robot), start, before, goal, after, least_s)
        if found is not None:
            curves = (spline(_thinned(found[0], stride), speed) for stride in STRIDES)
            motion = next((curve for curve in curves if _clear(robot, curve)), None)
    if motion is None:
        least = np.abs(measure(robot, line).profile.s).min()
        raise TrajectoryError(
            f"the straight way from {in_words(start)} to {in_words(goal)} comes to |s|"
            f" = {least:.3f} of the Type 2 locus; an approach keeps {MIN_APPROACH_S},"
            " and no way around was found"
        )
    motion = _paced(robot, motion)
    certify(robot, motion, max_residual=PLAN_RESIDUAL, crossings=0)
    return motion


def _thinned(way: Array, stride: int) -> Array:
    """Return every ``stride``-th of the places (m, 2), m, with both ends: at least
    four, none closer to an end than a cell.
    """
    inner = way[1:-1][
        (np.hypot(*(way[1:-1] - way[0]).T) > SPACING)
        & (np.hypot(*(way[1:-1] - way[-1]).T) > SPACING)
    ]
    count = max(2, int(np.ceil(len(inner) / stride)))
    if len(inner) < 2:
        return np.linspace(way[0], way[-1], 4)
    rows = np.unique(
        np.linspace(0, len(inner) - 1, count + 2).round().astype(int)[1:-1]
    )
    return np.vstack([way[0], inner[rows if len(rows) > 1 else [0, -1]], way[-1]])
