"""Plans through the Type 2 locus, rest to rest, with the criterion imposed at the
crossing.

The crossing lies on the locus, and its acceleration follows from t_s.w_d = 0
(``candidate``). What that leaves open (where on the locus, how fast, the free
acceleration, the jerk, when, and for ``plan_through`` both ends) is chosen by
minimising the peak torque and the time near the locus (``search``). Every plan is
certified.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial

import numpy as np

from dextar_control.contract.errors import TrajectoryError
from dextar_control.contract.robot import RobotParameters
from dextar_control.model.robot import AnyRobot
from dextar_control.planning.attempts import scalable
from dextar_control.planning.between import plan_crossing
from dextar_control.planning.certificate import PLAN_RESIDUAL, Plan
from dextar_control.planning.checks import certify
from dextar_control.planning.locus import MIN_END_S, LocusPoint, place_of
from dextar_control.planning.model import planning_model
from dextar_control.planning.regular import MIN_APPROACH_S, plan_approach
from dextar_control.planning.search import (
    LOCUS_TIME,
    CrossingCriterion,
    Progress,
    silent,
)
from dextar_control.planning.through import plan_through
from dextar_control.planning.trajectory import Trajectory, hold, join
from dextar_control.symbols.types import Array

__all__ = [
    "MIN_APPROACH_S",
    "MIN_END_S",
    "PLAN_RESIDUAL",
    "CrossingCriterion",
    "Plan",
    "plan_approach",
    "plan_crossing",
    "plan_return_trip",
    "plan_return_trip_through",
    "plan_through",
    "robot_at",
]


def robot_at(robot: RobotParameters, point: LocusPoint) -> RobotParameters:
    """Return the robot in the working mode of a locus point."""
    return robot.replace(working_mode=point.working_mode)


def plan_return_trip(
    robot: AnyRobot,
    start: Array,
    goal: Array,
    duration: float | None,
    dwell: float,
    repeat: int = 1,
    *,
    point: LocusPoint | Array | None = None,
    criterion: CrossingCriterion = CrossingCriterion.RECIPROCAL,
    locus_time: float = LOCUS_TIME,
    progress: Progress = silent,
) -> Plan:
    """Plan start -> goal -> start, ``repeat`` times, with rests before, between and
    after.

    Args:
        robot: of any mechanism.
        start, goal: (n,), m, on two sides of the locus.
        duration: of one way, s; chosen when None.
        dwell: of each rest, s.
        repeat: return trips.
        point, criterion, locus_time, progress: as ``plan_crossing``.

    Raises:
        GeometryError, TrajectoryError: as ``plan_crossing``.
    """
    _check_trip(repeat, dwell)
    way = partial(
        plan_crossing,
        robot,
        duration=duration,
        point=point,
        criterion=criterion,
        locus_time=locus_time,
        progress=progress,
    )
    return _there_and_back(robot, way(start, goal).trajectory, dwell, repeat, way)


def plan_return_trip_through(
    robot: AnyRobot,
    point: LocusPoint | Array,
    direction: int | Array,
    duration: float | None,
    dwell: float,
    repeat: int = 1,
    *,
    criterion: CrossingCriterion = CrossingCriterion.RECIPROCAL,
    locus_time: float = LOCUS_TIME,
    progress: Progress = silent,
) -> Plan:
    """Plan out through a given point of the locus and back, ``repeat`` times, with
    rests before, between and after.

    Args:
        robot: in the working mode of the point.
        point: a locus point, or its position (n,), m.
        direction: the sign of s after the crossing, or the direction (n,) there.
        duration: of one way, s; chosen when None.
        dwell: of each rest, s.
        repeat: return trips.
        criterion, locus_time, progress: as ``plan_through``.

    Raises:
        GeometryError, TrajectoryError: as ``plan_through``.
    """
    _check_trip(repeat, dwell)
    place = place_of(robot, point)
    out = plan_through(
        robot,
        place,
        direction,
        duration,
        criterion=criterion,
        locus_time=locus_time,
        progress=progress,
    )
    back = partial(
        plan_crossing,
        robot,
        duration=duration,
        point=place,
        criterion=criterion,
        locus_time=locus_time,
        progress=progress,
    )
    return _there_and_back(robot, out.trajectory, dwell, repeat, back)


def _check_trip(repeat: int, dwell: float) -> None:
    if repeat < 1:
        raise TrajectoryError(f"repeat = {repeat}; it must be >= 1")
    if not (np.isfinite(dwell) and dwell > 0.0):
        raise TrajectoryError(f"dwell = {dwell} s; it must be > 0")


def _there_and_back(
    robot: AnyRobot,
    out: Trajectory,
    dwell: float,
    repeat: int,
    way: Callable[[Array, Array], Plan],
) -> Plan:
    """Return the plan out and back: by the time reversal of the way out where that is
    allowed, by a way of its own otherwise.
    """
    start, goal = out.at(0.0).x, out.at(out.duration).x

    def trip(back: Trajectory) -> Plan:
        lap = [out, hold(goal, dwell), back, hold(start, dwell)]
        whole = join([hold(start, dwell)] + lap * repeat)
        residual, crossings = PLAN_RESIDUAL, 2 * repeat
        return Plan(
            whole, certify(robot, whole, max_residual=residual, crossings=crossings)
        )

    if scalable(planning_model(robot), out):
        # the motors' friction may ask for more torque on the way back
        with suppress(TrajectoryError):
            return trip(out.reversed())
    return trip(way(goal, start).trajectory)
