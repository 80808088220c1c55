"""One way between two given places on two sides of the locus, rest to rest."""

from __future__ import annotations

import numpy as np

from dextar_control.contract.errors import GeometryError, TrajectoryError
from dextar_control.contract.robot import RobotParameters
from dextar_control.model.robot import AnyRobot
from dextar_control.planning.attempts import Best, scale_of
from dextar_control.planning.certificate import Plan
from dextar_control.planning.locus import (
    MIN_END_S,
    LocusPoint,
    beside,
    nearest_point,
    place_of,
)
from dextar_control.planning.regions import find_way, make_regions
from dextar_control.planning.regular import side_of
from dextar_control.planning.search import (
    BENDS,
    LOCUS_TIME,
    CrossingCriterion,
    Problem,
    Progress,
    crossing_problem,
    silent,
)
from dextar_control.planning.trajectory import in_words, lengths_along
from dextar_control.symbols.record import Record
from dextar_control.symbols.types import Array

# m along the locus, of the places where a crossing is tried
SHIFTS = (0.0, 0.025, -0.025)
DETOUR = 1.05  # length of a way over the straight one above which the guess is bent
# what the search chooses, beside where to cross if that is open
OPEN = ("split", "velocity", "strong", "jerk")


def check_ends(robot: AnyRobot, start: Array, goal: Array) -> tuple[float, float]:
    """Return s at start and goal, both checked.

    Args:
        robot: that is to move.
        start, goal: positions of the end effector, (2,), m.

    Raises:
        GeometryError: one is unreachable or too near to Type 1 or Type 2.
        TrajectoryError: both lie on one side.
    """
    sides = []
    for name, x in (("start", start), ("goal", goal)):
        s = side_of(robot, name, x)
        if abs(s) < MIN_END_S:
            near = f"{name} {in_words(x)} is too near to the Type 2 locus"
            raise GeometryError(f"{near}: |s| = {abs(s):.3f}; the limit is {MIN_END_S}")
        sides.append(s)
    if sides[0] * sides[1] > 0.0:
        raise TrajectoryError(
            "start and goal lie on the same side of the Type 2 locus (s ="
            f" {sides[0]:.3f} and {sides[1]:.3f}); they must lie on two"
        )
    return sides[0], sides[1]


def plan_crossing(
    robot: AnyRobot,
    start: Array,
    goal: Array,
    duration: float | None = None,
    *,
    point: LocusPoint | Array | None = None,
    criterion: CrossingCriterion = CrossingCriterion.RECIPROCAL,
    locus_time: float = LOCUS_TIME,
    progress: Progress = silent,
) -> Plan:
    """Plan one way from start to goal, rest to rest, through the locus once.

    Args:
        robot: of any mechanism.
        start, goal: (n,), m, on two sides of the Type 2 locus.
        duration: s; chosen when None, so that the peak torque is TORQUE_SHARE of the
            limit.
        point: of the locus where to cross; chosen when None (of a locus that is not
            traced: the nearest to the middle).
        criterion: what is imposed at the crossing.
        locus_time: s near the locus that cost as much as a peak torque of TORQUE_SHARE:
            with more the robot passes more slowly and with less torque; with less what
            is not modelled acts for less time where it cannot be controlled.
        progress: called with the fraction done and what is being tried.

    Raises:
        GeometryError: start or goal is unreachable or too near to Type 1 or Type 2, or
            the point is off the locus.
        TrajectoryError: both lie on one side, Type 1 parts them, or no way within the
            limits was found; the message names the limit that the best one breaks and
            the nearest duration that works.
    """
    start, goal = np.asarray(start, np.float64), np.asarray(goal, np.float64)
    sides = check_ends(robot, start, goal)
    place = None if point is None else place_of(robot, point)
    before, after = _parts(robot, start, goal, sides, place)
    length = float(lengths_along(np.vstack([before, after]))[-1])
    scale = scale_of(duration, length)
    middle = place or nearest_point(robot, 0.5 * (before[-1] + after[0]))
    moved = place is None and isinstance(robot, RobotParameters)
    free = (*OPEN, "place") if moved else OPEN
    direct = length < DETOUR * float(np.linalg.norm(goal - start))
    attempts: list[tuple[LocusPoint | None, bool]] = [(middle, False)] if direct else []
    attempts += [
        (beside(robot, middle, shift) if moved else middle, True)
        for shift in (SHIFTS if moved else (0.0,))
    ]
    best = Best(robot)
    for row, (at, bent) in enumerate(attempts):
        if at is None:
            continue
        progress(row / len(attempts), f"crossing near {in_words(at.x)}")
        opened = (*free, *BENDS) if bent else free
        problem = crossing_problem(
            robot,
            at,
            float(np.sign(sides[1])),
            scale,
            criterion,
            opened,
            0.0,
            locus_time=locus_time,
        )
        if best.offer(problem, _guess(problem, at, before, after, bent)):
            break
    best.restart(lambda found: found.plan is not None, progress)
    return best.outcome(
        f"way from {in_words(start)} to {in_words(goal)}", duration is None
    )


def _parts(
    robot: AnyRobot,
    start: Array,
    goal: Array,
    sides: tuple[float, float],
    place: LocusPoint | None,
) -> tuple[Array, Array]:
    """Return the places (m, n), m, of a way from start to goal before and after its
    crossing; the ends alone where there are no ``Regions``.

    Raises:
        TrajectoryError: Type 1 parts start and goal.
    """
    if not isinstance(robot, RobotParameters):
        return start[None], goal[None]
    regions = make_regions(robot)
    if place is None:
        found = find_way(regions, start, sides[0], goal, sides[1])
        if found is not None:
            way, turn = found
            return way[:turn], way[turn:]
    else:
        first = find_way(regions, start, sides[0], place.x, sides[0])
        second = find_way(regions, place.x, sides[1], goal, sides[1])
        if first is not None and second is not None:
            return first[0], second[0]
    through = (
        "crosses the Type 2 locus once"
        if place is None
        else f"leads through {in_words(place.x)}"
    )
    raise TrajectoryError(
        f"Type 1 parts start {in_words(start)} and goal {in_words(goal)}: no way"
        f" between them {through} and keeps {robot.min_type1_distance} from Type 1 in"
        f" working mode {list(robot.working_mode)}"
    )


def _guess(
    problem: Problem, point: LocusPoint, before: Array, after: Array, bent: bool
) -> Record:
    """Return the variables of a way given by its places (m, n), m, before and after the
    crossing, bent along them or straight.
    """
    unit = problem.task.length
    before, after = np.vstack([before, point.x]), np.vstack([point.x, after])
    lengths = lengths_along(before)[-1], lengths_along(after)[-1]
    ahead = (
        after[-1] - before[0]
        if len(before) < 4 or len(after) < 4
        else after[3] - before[-4]
    )
    normal = problem.task.sign * point.gradient / np.linalg.norm(point.gradient)
    ahead = ahead / np.linalg.norm(ahead)
    ahead = ahead + max(0.0, 0.4 - float(ahead @ normal)) * normal
    z = problem.variables.make(
        start=before[0] / unit,
        goal=after[-1] / unit,
        place=point.angle,
        split=np.clip(lengths[0] / sum(lengths), 0.3, 0.7),
        velocity=1.8 * sum(lengths) / unit * ahead / np.linalg.norm(ahead),
    )
    if bent:
        z.first_bends, z.second_bends = (_bends(way) / unit for way in (before, after))
    return z


def _bends(way: Array) -> Array:
    """Return bends (n, 2), m: the first bump takes the middle of the straight way to
    the middle of this way (m, n), m; the second is zero.
    """
    reached = lengths_along(way)
    middle = np.array([np.interp(0.5 * reached[-1], reached, along) for along in way.T])
    return np.column_stack([middle - 0.5 * (way[0] + way[-1]), np.zeros(len(middle))])
