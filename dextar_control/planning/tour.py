"""Tours: many crossings one after the other, joined without stopping where possible.

Each crossing is planned by itself (``plan_through``). From one crossing the robot flows
to the next along a leg that keeps to its side of the locus, with the states at both
crossings given; where no such leg keeps the limits it rests and goes round by regular
motion. Sides alternate: a crossing towards s > 0 is followed by one towards s < 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from dextar_control.contract.errors import (
    GeometryError,
    ParameterError,
    TrajectoryError,
)
from dextar_control.contract.robot import RobotParameters
from dextar_control.planning.certificate import PLAN_RESIDUAL, Plan
from dextar_control.planning.checks import certify
from dextar_control.planning.locus import LocusPoint, place_of, sample_locus
from dextar_control.planning.model import planning_model
from dextar_control.planning.regions import find_way, make_regions, region_of
from dextar_control.planning.regular import plan_approach, side_of
from dextar_control.planning.search import (
    LOCUS_TIME,
    CrossingCriterion,
    Problem,
    Progress,
    descend,
    leg_problem,
    silent,
    trajectory_of,
)
from dextar_control.planning.through import plan_through
from dextar_control.planning.trajectory import Trajectory, hold, in_words, join
from dextar_control.symbols.record import Record
from dextar_control.symbols.types import Array

DWELL = 0.2  # s of rest before and after a tour
REGULAR_SPEED = 0.3  # m/s, peak, of regular motion
SAME_PLACE = 1e-6  # m, closer needs no motion
# times the count asked for, among which the points of one pair of regions are found
MOST_SAMPLED = 40
# a leg's time over that of its length at the crossings' speed, one guess each
LEG_STRETCHES = (1.0, 1.6)
LEAST_LEG = 0.08  # s, of a leg's half
MEETING_SPEED = 1.2  # of the mean speed, where the halves of a leg meet
BEYOND = 0.6  # of the distal length: how far off a turn between neighbours is tried


class TourCrossing(NamedTuple):
    """One crossing of a tour."""

    point: LocusPoint
    sign: float  # of s after it


TourPoint = LocusPoint | Array | tuple[LocusPoint | Array, int]


def spread_points(
    robot: RobotParameters, count: int, seed: int = 0
) -> list[LocusPoint]:
    """Return crossable points spread over the locus of the robot's working mode,
    between the same two regions.

    Each is followed by its nearest neighbour, from the leftmost on.

    Args:
        robot: whose locus it is.
        count: of points; below zero, as many in reversed order.
        seed: of the spread.

    Raises:
        ParameterError: count is 0.
        GeometryError: there are not that many.
    """
    if count == 0:
        raise ParameterError(
            "tour = 0 points; it must be >= 1, or <= -1 for the other way round"
        )
    if count < 0:
        return spread_points(robot, -count, seed)[::-1]
    regions = make_regions(robot)
    for sampled in range(count, MOST_SAMPLED * count + 1, max(1, count // 2)):
        points = sample_locus(robot, sampled, seed, working_modes=(robot.working_mode,))
        pairs = [
            (region_of(regions, point.x, -1.0), region_of(regions, point.x, 1.0))
            for point in points
        ]
        main = max(set(pairs), key=pairs.count)
        points = [
            point
            for point, pair in zip(points, pairs, strict=True)
            if pair == main and 0 not in pair
        ]
        if len(points) >= count:
            break
    else:
        raise GeometryError(
            f"tour = {count} points; working mode {list(robot.working_mode)} offers"
            f" {len(points)}"
        )
    rows = np.linspace(0, len(points) - 1, count).round().astype(int)
    left = [points[row] for row in rows]
    ordered = [left.pop(int(np.argmin([point.x[0] for point in left])))]
    while left:
        gaps = [np.hypot(*(point.x - ordered[-1].x)) for point in left]
        ordered.append(left.pop(int(np.argmin(gaps))))
    return ordered


def _side(sign: float) -> str:
    return f"s {'>' if sign > 0 else '<'} 0"


def _stops(
    robot: RobotParameters,
    points: Sequence[TourPoint],
    repeat: int,
    start: Array | None,
) -> list[TourCrossing]:
    """Return the crossings of a tour in their order, with their directions.

    Raises:
        GeometryError: a point is off the locus, or borders other regions than the one
            before.
        TrajectoryError: the directions asked for do not alternate, or the start lies on
            the wrong side.
    """
    if len(points) == 0:
        raise ParameterError("the tour has no points; it needs at least one")
    places: list[LocusPoint] = []
    ways: list[int | None] = []
    for row, wish in enumerate(points, 1):
        where, way = (
            wish
            if isinstance(wish, tuple) and not isinstance(wish, LocusPoint)
            else (wish, None)
        )
        if way not in (None, -1, 1):
            raise TrajectoryError(
                f"direction = {way} at point {row} of the tour; it must be +1 or -1"
            )
        places.append(place_of(robot, where))
        ways.append(way)
    first = next(
        (way * (-1) ** row for row, way in enumerate(ways) if way is not None), None
    )
    if start is not None:
        side = float(np.sign(side_of(robot, "start", start)))
        if first is not None and first == side:
            raise TrajectoryError(
                f"the start {in_words(start)} lies at {_side(side)}, and the first"
                f" crossing goes there too (direction {first:+d}); it must start on the"
                " other side"
            )
        first = int(-side)
    stops = [
        TourCrossing(places[row % len(places)], float(first or 1) * (-1.0) ** row)
        for row in range(len(places) * repeat)
    ]
    for row, (way, stop) in enumerate(zip(ways, stops, strict=False)):
        if way is not None and way != stop.sign:
            raise TrajectoryError(
                f"point {row + 1} of the tour asks for direction {way:+d}, but the"
                f" crossings before it leave the robot at {_side(-stop.sign)}:"
                " directions must alternate"
            )
    regions = make_regions(robot)
    for row, (stop, after) in enumerate(
        zip(stops[: len(places)], stops[1:], strict=False), 1
    ):
        if region_of(regions, stop.point.x, stop.sign) != region_of(
            regions, after.point.x, stop.sign
        ):
            raise GeometryError(
                f"points {row} and {row % len(places) + 1} of the tour border different"
                f" regions at {_side(stop.sign)}: Type 1 lies between them in working"
                f" mode {list(robot.working_mode)}"
            )
    return stops


def _piece(trajectory: Trajectory, row: int) -> Trajectory:
    """Return one half of a crossing as a trajectory from time 0."""
    begin, own = trajectory.knots[row], slice(row, row + 1)
    return Trajectory(
        trajectory.knots[row : row + 2] - begin,
        trajectory.origins[own] - begin,
        trajectory.coefficients[own],
    )


def _state(trajectory: Trajectory) -> Array:
    """Return the state (n, 4) at the crossing: columns x, m, x_dot, x_ddot and jerk."""
    return np.asarray(trajectory.coefficients[1, :4].T * np.array([1.0, 1.0, 2.0, 6.0]))


def _leg_guesses(
    robot: RobotParameters, left: Array, reached: Array, sign: float
) -> list[tuple[Problem, Record]]:
    """Return problems and guesses of legs between two crossings' states (n, 4), that
    follow the way on the grid, or swing out where the crossings are neighbours.
    """
    unit = planning_model(robot).length
    (begin, leaving), (end, arriving) = left.T[:2], reached.T[:2]
    found = find_way(make_regions(robot), begin, sign, end, sign, 0.5)
    speed = 0.5 * float(np.hypot(*leaving) + np.hypot(*arriving))
    middles = [
        0.5 * (begin + end)
        + BEYOND * unit * 0.5 * (leaving - arriving) / max(speed, 1e-6)
    ]
    if found is not None:
        middles.insert(0, found[0][len(found[0]) // 2])
    guesses = []
    for stretch in LEG_STRETCHES:
        for middle in middles:
            lengths = np.hypot(*(middle - begin)), np.hypot(*(end - middle))
            slowest = [stretch * one / max(speed, 0.05) * 1.5 for one in lengths]
            spans = np.maximum(slowest, LEAST_LEG)
            scale, along = 0.5 * float(spans.sum()), end - begin
            problem = leg_problem(robot, left, reached, sign, scale)
            speed_there = MEETING_SPEED * sum(lengths) / spans.sum()
            swift = speed_there * along / max(float(np.hypot(*along)), 0.02)
            guess = problem.variables.make(
                x=middle / unit,
                x_dot=swift * scale / unit,
                spans=np.log(spans / scale),
            )
            guesses.append((problem, guess))
    return guesses


def _flow(
    robot: RobotParameters, before: Trajectory, after: Trajectory, sign: float
) -> Trajectory | None:
    """Return a leg from the crossing of one way to that of the next without stopping;
    None when none keeps the limits.
    """
    best: tuple[float, Trajectory] | None = None
    for problem, guess in _leg_guesses(robot, _state(before), _state(after), sign):
        cost, z = descend(problem, guess)
        if best is not None and cost >= best[0]:
            continue
        leg = trajectory_of(problem, z)
        try:
            certify(
                robot,
                join([_piece(before, 0), leg, _piece(after, 1)]),
                max_residual=PLAN_RESIDUAL,
                crossings=2,
            )
        except TrajectoryError:
            continue
        best = (cost, leg)
    return None if best is None else best[1]


def _around(robot: RobotParameters, begin: Array, end: Array) -> list[Trajectory]:
    """Return regular motion between places (2,), m, rest to rest; none where they are
    one.
    """
    return (
        [plan_approach(robot, begin, end, REGULAR_SPEED)]
        if np.linalg.norm(end - begin) > SAME_PLACE
        else []
    )


def plan_tour(
    robot: RobotParameters,
    points: int | Sequence[TourPoint],
    repeat: int = 1,
    seed: int = 0,
    *,
    start: Array | None = None,
    duration: float | None = None,
    dwell: float = DWELL,
    flow: bool = True,
    criterion: CrossingCriterion = CrossingCriterion.RECIPROCAL,
    locus_time: float = LOCUS_TIME,
    progress: Progress = silent,
) -> Plan:
    """Plan crossings at several points of the locus one after the other, certified as
    a whole.

    The tour starts at rest, and ends at rest in the same place where the number of
    crossings is even, on the other side of the locus where it is odd. With an odd
    number of points every other lap runs through them in the other direction.

    Args:
        robot: whose working mode the points belong to.
        points: locus points, or positions (2,), m, each alone or with its direction
            (the sign of s after it); or a number of points that ``spread_points``
            chooses.
        repeat: laps.
        seed: of the spread.
        start: where it starts, (2,), m; chosen when None.
        duration: of each crossing where it is planned by itself, s; chosen when None.
        dwell: of the rests at both ends, s.
        flow: pass from one crossing to the next without stopping where possible.
        criterion: what is imposed at the crossings.
        locus_time: s near the locus that costs as much as a peak torque of
            TORQUE_SHARE; see ``plan_crossing``.
        progress: called with the fraction done and what is being planned.

    Raises:
        ParameterError: no points, or repeat < 1.
        GeometryError: a point is off the locus or cannot be reached from the one
            before.
        TrajectoryError: directions do not alternate, or a crossing or motion has no
            plan within the limits.
    """
    if repeat < 1:
        raise ParameterError(f"repeat = {repeat}; it must be >= 1")
    if not (np.isfinite(dwell) and dwell > 0.0):
        raise ParameterError(f"dwell = {dwell} s; it must be > 0")
    begin = None if start is None else np.asarray(start, dtype=np.float64)
    stops = _stops(
        robot,
        spread_points(robot, points, seed) if isinstance(points, int) else points,
        repeat,
        begin,
    )

    count = len(stops) // repeat

    @cache
    def way(index: int, sign: float) -> Trajectory:
        return plan_through(
            robot,
            stops[index].point,
            int(sign),
            duration,
            criterion=criterion,
            locus_time=locus_time,
        ).trajectory

    @cache
    def between(index: int, sign: float) -> list[Trajectory]:
        before, after = way(index, sign), way((index + 1) % count, -sign)
        leg = _flow(robot, before, after, sign) if flow else None
        if leg is not None:
            return [leg]
        rests = before.at(before.duration).x, after.at(0.0).x
        return [_piece(before, 1), *_around(robot, *rests), _piece(after, 0)]

    legs: list[Trajectory] = []
    for row, stop in enumerate(stops):
        progress(
            row / len(stops),
            f"crossing {row + 1} of {len(stops)} at {in_words(stop.point.x)}",
        )
        if row > 0:
            legs += between((row - 1) % count, -stop.sign)
    first, last = way(0, stops[0].sign), way((len(stops) - 1) % count, stops[-1].sign)
    begins, ends = first.at(0.0).x, last.at(last.duration).x
    origin = begins if begin is None else begin
    back = _around(robot, ends, origin) if len(stops) % 2 == 0 else []
    progress(1.0, "certifying")
    tour = join(
        [
            hold(origin, dwell),
            *_around(robot, origin, begins),
            _piece(first, 0),
            *legs,
            _piece(last, 1),
            *back,
            hold(origin if back else ends, dwell),
        ]
    )
    certificate = certify(robot, tour, max_residual=PLAN_RESIDUAL, crossings=len(stops))
    for row, (crossing, stop) in enumerate(
        zip(certificate.crossings, stops, strict=True), 1
    ):
        gap = float(np.linalg.norm(np.array(crossing.x) - stop.point.x))
        if gap > SAME_PLACE or crossing.sign != stop.sign:
            raise TrajectoryError(
                f"crossing {row} of the tour is {1e3 * gap:.3f} mm from its point,"
                f" direction {crossing.sign:+d}; it must be there with"
                f" {int(stop.sign):+d}"
            )
    return Plan(tour, certificate)
