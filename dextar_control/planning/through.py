"""One way through a given point of the locus, rest to rest; the planner chooses both
ends.
"""

from __future__ import annotations

import numpy as np

from dextar_control.contract.errors import GeometryError, TrajectoryError
from dextar_control.contract.robot import RobotParameters
from dextar_control.model.robot import AnyRobot
from dextar_control.planning.attempts import Best, scale_of
from dextar_control.planning.certificate import Plan
from dextar_control.planning.locus import (
    MIN_CROSSING_TYPE1,
    MIN_END_S,
    LocusPoint,
    beside,
    place_of,
    trace_locus,
)
from dextar_control.planning.model import planning_model
from dextar_control.planning.search import (
    LOCUS_TIME,
    CrossingCriterion,
    Progress,
    crossing_problem,
    guesses_through,
    silent,
)
from dextar_control.planning.trajectory import in_words
from dextar_control.symbols.types import Array

MIN_SLOPE = 0.1  # sine of the angle between a crossing's direction and the locus
# m along the locus, where another point is looked for
NEIGHBOURS = (0.005, -0.005, 0.01, -0.01, 0.02, -0.02, 0.04, -0.04)
# what the search chooses
OPEN = ("start", "goal", "split", "velocity", "strong", "jerk")


def _sign_and_direction(
    point: LocusPoint, direction: int | float | Array
) -> tuple[float, Array | None]:
    """Return the sign of s after the crossing, and the unit direction (n,) of the
    velocity where one is given.
    """
    if np.ndim(direction) == 0:
        if float(direction) not in (-1.0, 1.0):
            raise TrajectoryError(
                f"direction = {direction}; it must be +1 or -1 (the sign of s after the"
                " crossing) or a vector"
            )
        return float(direction), None
    towards = np.asarray(direction, dtype=np.float64)
    norm = float(np.linalg.norm(towards))
    if towards.shape != point.x.shape or not (np.isfinite(norm) and norm > 0.0):
        raise TrajectoryError(
            f"direction = {towards.tolist()}; it must be a vector of {len(point.x)}"
            " finite numbers, not zero"
        )
    steepest = float(np.linalg.norm(point.gradient))
    slope = float(point.gradient @ towards) / norm / steepest
    if abs(slope) < MIN_SLOPE:
        normal = point.gradient / steepest
        raise TrajectoryError(
            f"the direction ({', '.join(f'{part:.3f}' for part in towards)}) runs along"
            f" the locus at {in_words(point.x)}: the sine of its angle to the locus is"
            f" {abs(slope):.3f}, a crossing needs {MIN_SLOPE}; straight across is"
            f" ({', '.join(f'{part:.3f}' for part in normal)})"
        )
    return float(np.sign(slope)), towards / norm


def plan_through(
    robot: AnyRobot,
    point: LocusPoint | Array,
    direction: int | Array,
    duration: float | None = None,
    *,
    criterion: CrossingCriterion = CrossingCriterion.RECIPROCAL,
    locus_time: float = LOCUS_TIME,
    progress: Progress = silent,
) -> Plan:
    """Plan one way through a given point of the locus, rest to rest; the planner
    chooses both ends.

    Args:
        robot: in the working mode of the point (``robot_at``).
        point: a locus point, or its position (n,), m.
        direction: the sign of s after the crossing, or the direction (n,) of the
            velocity there.
        duration: s; chosen when None, so that the peak torque is TORQUE_SHARE of the
            limit.
        criterion: what is imposed at the crossing.
        locus_time: s near the locus that costs as much as a peak torque of
            TORQUE_SHARE; see ``plan_crossing``.
        progress: called with the fraction done and what is being tried.

    Raises:
        GeometryError: the point is off the locus or has no room for a rest on both
            sides.
        TrajectoryError: the direction does not cross, or no way within the limits was
            found; says what binds and which duration or point would do.
    """
    place = place_of(robot, point)
    sign, towards = _sign_and_direction(place, direction)
    scale = scale_of(duration, planning_model(robot).length)
    best = Best(robot)

    def attempt(at: LocusPoint, most: int | None, into: Best) -> None:
        problem = crossing_problem(
            robot,
            at,
            sign,
            scale,
            criterion,
            OPEN,
            towards=towards,
            locus_time=locus_time,
        )
        guesses = guesses_through(problem, at, towards)[:most]
        for row, guess in enumerate(guesses):
            progress(
                row / len(guesses),
                f"guess {row + 1} of {len(guesses)} at {in_words(at.x)}",
            )
            if into.offer(problem, guess):
                break

    attempt(place, None, best)
    if best.found is None:
        near = _nearest_with_room(robot, place)
        other = (
            "" if near is None else f"; the nearest point that has is {in_words(near)}"
        )
        raise GeometryError(
            f"the locus point {in_words(place.x)} has no room for a rest with |s| >="
            f" {MIN_END_S} straight ahead on both sides (distance to Type 1:"
            f" {place.type1:.3f}){other}",
            **({} if near is None else {"point": near.tolist()}),
        )
    best.restart(lambda found: found.good, progress)

    def other_point() -> LocusPoint | None:
        for shift in NEIGHBOURS:
            near, other = beside(robot, place, shift), Best(robot)
            if near is not None:
                attempt(near, 1, other)
                if other.found is not None and other.found.plan is not None:
                    return near
        return None

    return best.outcome(
        f"way through {in_words(place.x)}", duration is None, other_point
    )


def _nearest_with_room(robot: AnyRobot, place: LocusPoint) -> Array | None:
    """Return the nearest point (2,), m, of the locus that has room for a rest on both
    sides; None when there is none.
    """
    if not isinstance(robot, RobotParameters):
        return None
    arcs = trace_locus(robot, (robot.working_mode,), MIN_CROSSING_TYPE1, crossable=True)
    if not arcs:
        return None
    x = np.vstack([arc.x for arc in arcs])
    nearest: Array = x[int(np.argmin(np.linalg.norm(x - place.x, axis=1)))]
    return nearest
