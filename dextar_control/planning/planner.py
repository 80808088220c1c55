"""Plans a way through the Type 2 locus, rest to rest, with the criterion imposed at the crossing.

Position, velocity and acceleration at the crossing are imposed (``candidate``): the point lies on the locus and the
acceleration follows from t_s.w_d = 0. What that leaves open (where on the locus, how fast, the free acceleration, the
jerk, when, and for ``plan_through`` both ends) is chosen by minimising the peak torque and the time near the locus
(``search``). A plan is certified before it is served.
"""

from __future__ import annotations

import numpy as np

from dextar_control.contract.errors import TrajectoryError
from dextar_control.contract.robot import RobotParameters
from dextar_control.model.robot import AnyRobot
from dextar_control.planning.attempts import weightless
from dextar_control.planning.between import plan_crossing
from dextar_control.planning.certificate import PLAN_RESIDUAL, Plan
from dextar_control.planning.checks import certify
from dextar_control.planning.locus import MIN_END_S, LocusPoint, place_of
from dextar_control.planning.model import planning_model
from dextar_control.planning.regular import MIN_APPROACH_S, plan_approach
from dextar_control.planning.search import Criterion, Progress, coefficients_over, silent
from dextar_control.planning.through import plan_through
from dextar_control.planning.trajectory import Trajectory, hold, join
from dextar_control.symbols.types import Array

__all__ = [
    "MIN_APPROACH_S", "MIN_END_S", "PLAN_RESIDUAL", "Criterion", "Plan", "crossing_polynomial", "plan_approach", "plan_crossing",
    "plan_return_trip", "plan_return_trip_through", "plan_through", "robot_at",
]


def crossing_polynomial(
    robot: AnyRobot, start: Array, goal: Array, x: Array, x_dot: Array, x_ddot: Array, before: float, after: float,
    jerk: Array | None = None,
) -> Trajectory:
    """Rest (zero jerk too) at start, given state at the crossing, rest at goal.

    Args:
        start, goal: (n,) m.
        x, x_dot, x_ddot: (n,) at the crossing.
        before, after: durations from the start to the crossing and from there to the goal, s.
        jerk: (n,) at the crossing, m/s^3; the one that both ends ask for on average when None.
    """
    ends = [np.asarray(end, dtype=np.float64) for end in (start, goal)]
    if jerk is None:
        gaps = [end - x - x_dot * t - 0.5 * x_ddot * t**2 for end, t in zip(ends, (-before, after), strict=True)]
        jerk = np.mean([6.0 * gap / t**3 for gap, t in zip(gaps, (-before, after), strict=True)], axis=0)
    state = np.column_stack([x, x_dot, x_ddot, jerk])
    spans, pieces = (-before, after), []
    for end, span in zip(ends, spans, strict=True):
        rest = np.column_stack([end, np.zeros((len(end), 3))])
        (half,) = planning_model(robot).half(state.ravel("F"), rest.ravel("F"), span, 0.0)
        pieces.append(coefficients_over(half, span))
    return Trajectory(np.array([0.0, before, before + after]), np.array([before, before]), np.stack(pieces))


def robot_at(robot: RobotParameters, point: LocusPoint) -> RobotParameters:
    """The robot in the working mode of a locus point."""
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
    criterion: Criterion = Criterion.RECIPROCAL,
    progress: Progress = silent,
) -> Plan:
    """start -> goal -> start, ``repeat`` times, with rests before, between and after.

    The way back is the time reversal of the way out when there is no gravity; with gravity it is planned by itself.

    Args:
        duration: of one way, s.
        dwell: of each rest, s.
        repeat: return trips.
        point, criterion, progress: as ``plan_crossing``.

    Raises:
        GeometryError, TrajectoryError: as ``plan_crossing``.
    """
    _repeated(repeat, dwell)

    def one_way(begin: Array, end: Array) -> Trajectory:
        return plan_crossing(
            robot, begin, end, duration, point=point, criterion=criterion, progress=progress
        ).trajectory

    out = one_way(start, goal)
    back = out.reversed() if weightless(planning_model(robot), out) else one_way(goal, start)
    return _there_and_back(robot, out, back, dwell, repeat)


def plan_return_trip_through(
    robot: AnyRobot,
    point: LocusPoint | Array,
    direction: int | Array,
    duration: float | None,
    dwell: float,
    repeat: int = 1,
    *,
    criterion: Criterion = Criterion.RECIPROCAL,
    progress: Progress = silent,
) -> Plan:
    """Out through a given point of the locus and back, ``repeat`` times, with rests before, between and after.

    Args:
        duration: of one way, s; chosen when None.
        dwell: of each rest, s.
        repeat: return trips.
        point, direction, criterion, progress: as ``plan_through``.

    Raises:
        GeometryError, TrajectoryError: as ``plan_through``.
    """
    _repeated(repeat, dwell)
    place = place_of(robot, point)
    out = plan_through(robot, place, direction, duration, criterion=criterion, progress=progress).trajectory
    back = out.reversed()
    if not weightless(planning_model(robot), out):
        ends = out.at(out.duration).x, out.at(0.0).x
        back = plan_crossing(
            robot, *ends, duration, point=place, criterion=criterion, progress=progress
        ).trajectory
    return _there_and_back(robot, out, back, dwell, repeat)


def _repeated(repeat: int, dwell: float) -> None:
    if repeat < 1:
        raise TrajectoryError(f"repeat = {repeat}; it must be >= 1")
    if not (np.isfinite(dwell) and dwell > 0.0):
        raise TrajectoryError(f"dwell = {dwell} s; it must be > 0")


def _there_and_back(robot: AnyRobot, out: Trajectory, back: Trajectory, dwell: float, repeat: int) -> Plan:
    start, goal = out.at(0.0).x, out.at(out.duration).x
    trip = join([hold(start, dwell)] + [out, hold(goal, dwell), back, hold(start, dwell)] * repeat)
    return Plan(trip, certify(robot, trip, max_residual=PLAN_RESIDUAL, crossings=2 * repeat))
