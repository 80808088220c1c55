"""Plans a way through the Type 2 locus, rest to rest, with the criterion imposed at the crossing.

Position, velocity and acceleration at the crossing are imposed (``crossing``): the point lies on the locus and the
acceleration follows from t_s.w_d = 0. What that leaves open (where on the locus, how fast, the free acceleration, the
jerk, when, and for ``plan_through`` both ends) is chosen by minimising the peak torque and the time near the locus
(``search``). A plan is certified before it is served, and kept by content (``plan_cache``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dextar_control.contract.errors import GeometryError, TrajectoryError
from dextar_control.contract.robot import RobotParameters
from dextar_control.core.certificate import PLAN_RESIDUAL, Plan, certify, measure
from dextar_control.core.crossing import BENDS, GOAL, PLACE, SPLIT, START, STATE, VARIABLES, half
from dextar_control.core.locus import (
    MIN_CROSSING_TYPE1,
    MIN_END_S,
    LocusPoint,
    locus_point,
    make_point,
    trace_locus,
)
from dextar_control.core.model import Array, make_model
from dextar_control.core.plan_cache import answered
from dextar_control.core.regions import find_way, make_regions
from dextar_control.core.regular import MIN_APPROACH_S, plan_approach, side_of
from dextar_control.core.search import (
    GOOD,
    TORQUE_SHARE,
    Criterion,
    Problem,
    Progress,
    crossing_problem,
    descend,
    guesses_through,
    trajectory_of,
)
from dextar_control.core.trajectory import Trajectory, hold, join

__all__ = [
    "MIN_APPROACH_S", "MIN_END_S", "PLAN_RESIDUAL", "Criterion", "Plan", "crossing_polynomial", "plan_approach", "plan_crossing",
    "plan_return_trip", "plan_return_trip_through", "plan_through", "robot_at",
]  # fmt: skip

MIN_SLOPE = 0.1  # sine of the angle between a crossing's direction and the locus
BASE_DURATION, PACE = 0.25, 0.8  # s and m/s: duration over a way's length at which a way of open duration is searched
SHIFTS = (0.0, 0.025, -0.025)  # m along the locus, of the places where a crossing is tried
NEIGHBOURS = (0.005, -0.005, 0.01, -0.01, 0.02, -0.02, 0.04, -0.04)  # m along the locus, where another point is looked for
RESTARTS, RESTART_SPREAD = 6, 0.15  # from the best so far where it is not good, and by how much it is shaken
DETOUR = 1.05  # length of a way over the straight one above which the guess is bent
BISECTIONS = 3  # of the nearest duration
HEADROOM = 1.002  # of a duration over the one at which the limit is met
LONGEST_STRETCH = 20.0  # of the duration, that is offered instead
STRETCHES = 4  # of a way of open duration, each to what its torque asks for
SETTLED = 0.01  # of the duration, below which it is not stretched again


def crossing_polynomial(
    start: Array, goal: Array, x: Array, x_dot: Array, x_ddot: Array, before: float, after: float, jerk: Array | None = None
) -> Trajectory:
    """Rest (zero jerk too) at start, given state at the crossing, rest at goal.

    Args:
        start, goal: (2,) m.
        x, x_dot, x_ddot: (2,) at the crossing.
        before, after: durations from the start to the crossing and from there to the goal, s.
        jerk: (2,) at the crossing, m/s^3; the one that both ends ask for on average when None.
    """
    ends = [np.vstack([end, np.zeros((3, 2))]) for end in (np.asarray(start, float), np.asarray(goal, float))]
    if jerk is None:
        gaps = [end[0] - x - x_dot * t - 0.5 * x_ddot * t**2 for end, t in zip(ends, (-before, after), strict=True)]
        jerk = np.mean([6.0 * gap / t**3 for gap, t in zip(gaps, (-before, after), strict=True)], axis=0)
    state = np.vstack([x, x_dot, x_ddot, jerk])
    pieces = [half(state, end, span, np.zeros((2, 2))) for end, span in zip(ends, (-before, after), strict=True)]
    return Trajectory(np.array([0.0, before, before + after]), np.array([before, before]), np.stack(pieces))


def robot_at(robot: RobotParameters, point: LocusPoint) -> RobotParameters:
    """The robot in the working mode of a locus point."""
    return robot.replace(working_mode=point.working_mode)


def _checked(robot: RobotParameters) -> Callable[[Trajectory], Plan]:
    return lambda trajectory: Plan(trajectory, certify(robot, trajectory, max_residual=PLAN_RESIDUAL, crossings=1))


def _timed(duration: float | None) -> None:
    if duration is not None and not (np.isfinite(duration) and duration > 0.0):
        raise TrajectoryError(f"duration = {duration} s; it must be > 0")


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
    norm = float(np.hypot(*towards)) if towards.shape == (2,) else float("nan")
    if not (np.isfinite(norm) and norm > 0.0):
        raise TrajectoryError(f"direction = {towards.tolist()}; it must be a vector of two finite numbers, not zero")
    slope = float(point.gradient @ towards) / norm / float(np.hypot(*point.gradient))
    if abs(slope) < MIN_SLOPE:
        normal = point.gradient / np.hypot(*point.gradient)
        raise TrajectoryError(
            f"the direction ({towards[0]:.3f}, {towards[1]:.3f}) runs along the locus at ({point.x[0]:.4f}, {point.x[1]:.4f}) m:"
            f" the sine of its angle to the locus is {abs(slope):.3f}, a crossing needs {MIN_SLOPE}; straight across is"
            f" ({normal[0]:.3f}, {normal[1]:.3f})"
        )
    return float(np.sign(slope)), towards / norm


class _Best:
    """The best candidate so far: certified ones first, then by cost."""

    def __init__(self, robot: RobotParameters) -> None:
        self._check = _checked(robot)
        self.cost = np.inf
        self.plan: Plan | None = None
        self.problem: Problem | None = None
        self.z: Array | None = None
        self.error: TrajectoryError | None = None

    def offer(self, problem: Problem, guess: Array) -> bool:
        """Descend from a guess; True when the plan is good enough to stop."""
        cost, z = descend(problem, guess)
        plan, error = None, None
        try:
            plan = self._check(trajectory_of(problem, z))
            cost += max(0.0, plan.certificate.peak_torque / problem.task.limits.torque - GOOD)
        except TrajectoryError as refusal:
            error = refusal
        better = cost < self.cost if (plan is None) == (self.plan is None) else plan is not None
        if better:
            self.cost, self.plan, self.problem, self.z, self.error = cost, plan, problem, z, error
        return self.plan is not None and self.cost < GOOD


def _stretched(robot: RobotParameters, problem: Problem, z: Array) -> Plan:
    """A candidate at the duration at which its peak torque is TORQUE_SHARE of the limit."""
    duration = problem.task.duration
    trajectory = trajectory_of(problem, z)
    for _ in range(STRETCHES):
        seen = measure(problem.model, trajectory)
        factor = max(
            np.sqrt(seen.peak_torque / (TORQUE_SHARE * robot.max_torque)),
            seen.peak_joint_speed / robot.max_joint_speed,
            seen.peak_platform_speed / robot.max_platform_speed,
        )
        factor = float(np.clip(factor, 0.5, 2.0))
        if abs(factor - 1.0) < SETTLED:
            break
        duration *= factor
        if robot.gravity == (0.0, 0.0):
            trajectory = trajectory.scaled(factor)
        else:
            problem = problem._replace(task=problem.task._replace(duration=duration))
            z = descend(problem, z)[1]
            trajectory = trajectory_of(problem, z)
    return _checked(robot)(trajectory)


def _nearest_duration(robot: RobotParameters, best: _Best) -> float | None:
    """A duration at which the best candidate's way works, when only its torque or speed is in the way."""
    if best.problem is None or best.z is None:
        return None
    problem, z = best.problem, best.z
    seen = measure(problem.model, trajectory_of(problem, z))
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
        moved = problem._replace(task=problem.task._replace(duration=duration))
        for candidate in (z, descend(moved, z)[1]):
            try:
                _checked(robot)(trajectory_of(moved, candidate))
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


def _refuse(robot: RobotParameters, what: str, best: _Best, other_point: Callable[[], LocusPoint | None]) -> TrajectoryError:
    """What stands in the way, by how much, and what would work instead."""
    duration = best.problem.task.duration if best.problem is not None else float("nan")
    text = f"no {what} within {duration:.4g} s was found: {best.error}"
    nearest = _nearest_duration(robot, best)
    if nearest is not None:
        return TrajectoryError(f"{text}; the nearest duration that works is {nearest:.4f} s")
    point = other_point()
    if point is not None:
        return TrajectoryError(f"{text}; the nearest point that works is ({point.x[0]:.4f}, {point.x[1]:.4f}) m")
    return TrajectoryError(f"{text}; neither a longer duration nor a point nearby was found to work")


def _beside(robot: RobotParameters, point: LocusPoint, shift: float) -> LocusPoint | None:
    """The locus point at a signed distance along its arc, m; None where the arc ends."""
    for arc in trace_locus(robot, (robot.working_mode,), robot.min_type1_distance):
        inside = arc.angles[0] <= point.angle <= arc.angles[-1]
        if arc.family is point.family and arc.branch == point.branch and inside:
            place = float(np.interp(point.angle, arc.angles, arc.length)) + shift
            if 0.0 <= place <= arc.length[-1]:
                angle = float(np.interp(place, arc.length, arc.angles))
                return make_point(robot, arc.working_mode, arc.family, arc.branch, angle)
    return None


def plan_through(
    robot: RobotParameters,
    point: LocusPoint | Array,
    direction: int | Array,
    duration: float | None = None,
    *,
    criterion: Criterion = Criterion.RECIPROCAL,
    cache: bool = True,
    progress: Progress | None = None,
) -> Plan:
    """One way through a given point of the locus, rest to rest; the planner chooses both ends.

    Args:
        robot: in the working mode of the point (``robot_at``).
        point: a locus point, or its position (2,), m.
        direction: the sign of s after the crossing, or the direction (2,) of the velocity there.
        duration: s; chosen when None, so that the peak torque is TORQUE_SHARE of the limit.
        criterion: what holds at the crossing.
        cache: look the plan up, and keep it.
        progress: called with the fraction done and what is being tried.

    Raises:
        GeometryError: the point is off the locus or has no room for a rest on both sides.
        TrajectoryError: the direction does not cross, or no way within the limits was found; says what binds and
            which duration or point would do.
    """
    _timed(duration)
    place = _place(robot, point)
    sign, towards = _way(place, direction)

    def compute() -> Plan:
        return _through(robot, place, sign, towards, duration, criterion, progress)

    if not cache:
        return compute()
    request = {
        "plan": "through", "family": place.family, "branch": place.branch, "angle": place.angle, "sign": sign,
        "towards": towards, "duration": duration, "criterion": criterion,
    }  # fmt: skip
    return answered(robot, request, compute, _checked(robot))


def _through(
    robot: RobotParameters,
    place: LocusPoint,
    sign: float,
    towards: Array | None,
    duration: float | None,
    criterion: Criterion,
    progress: Progress | None,
) -> Plan:
    free = START + GOAL + SPLIT + STATE
    scale = BASE_DURATION + float(make_model(robot).l2.mean()) / PACE if duration is None else duration
    best = _Best(robot)

    def attempt(at: LocusPoint, most: int | None, into: _Best) -> bool:
        problem = crossing_problem(robot, at, sign, scale, criterion, free, towards=towards)
        guesses = guesses_through(problem, at, towards)[:most]
        for row, guess in enumerate(guesses):
            if progress is not None:
                progress(row / len(guesses), f"guess {row + 1} of {len(guesses)} at ({at.x[0]:.4f}, {at.x[1]:.4f}) m")
            if into.offer(problem, guess):
                return True
        bent = problem._replace(free=np.append(problem.free, BENDS))
        generator = np.random.default_rng(0)
        for row in range(RESTARTS if most is None else 0):
            if into.z is None:
                break
            if progress is not None:
                progress(row / RESTARTS, f"restart {row + 1} of {RESTARTS} at ({at.x[0]:.4f}, {at.x[1]:.4f}) m")
            shake = generator.normal(size=VARIABLES) * RESTART_SPREAD * (row > 0)
            shake[list(PLACE)] = 0.0
            if into.offer(bent, into.z + shake):
                break
        return len(guesses) > 0

    if not attempt(place, None, best):
        raise GeometryError(
            f"the locus point ({place.x[0]:.4f}, {place.x[1]:.4f}) m has no room for a rest with |s| >= {MIN_END_S} straight"
            f" ahead on both sides (distance to Type 1: {place.type1:.3f}){_nearest_with_room(robot, place)}"
        )
    if progress is not None:
        progress(1.0, "certified" if best.plan is not None else "not found")
    if duration is None and best.problem is not None and best.z is not None:
        return _stretched(robot, best.problem, best.z)
    if best.plan is not None:
        return best.plan

    def other_point() -> LocusPoint | None:
        for shift in NEIGHBOURS:
            near = _beside(robot, place, shift)
            other = _Best(robot)
            if near is not None and attempt(near, 1, other) and other.plan is not None:
                return near
        return None

    raise _refuse(robot, f"way through ({place.x[0]:.4f}, {place.x[1]:.4f}) m", best, other_point)


def _ends(robot: RobotParameters, start: Array, goal: Array) -> tuple[float, float]:
    """s at start and goal, both checked.

    Raises:
        GeometryError: one is unreachable or too near to Type 1 or Type 2.
        TrajectoryError: both lie on one side.
    """
    model = make_model(robot)
    sides = []
    for name, x in (("start", start), ("goal", goal)):
        s = side_of(model, name, x, robot)
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
    return sides[0], sides[1]


def plan_crossing(
    robot: RobotParameters,
    start: Array,
    goal: Array,
    duration: float | None = None,
    *,
    point: LocusPoint | Array | None = None,
    criterion: Criterion = Criterion.RECIPROCAL,
    cache: bool = True,
    progress: Progress | None = None,
) -> Plan:
    """One way from start to goal, rest to rest, through the locus once.

    Args:
        start, goal: (2,) m, on two sides of the Type 2 locus.
        duration: s; chosen when None, so that the peak torque is TORQUE_SHARE of the limit.
        point: of the locus where to cross; chosen when None.
        criterion: what holds at the crossing.
        cache: look the plan up, and keep it.
        progress: called with the fraction done and what is being tried.

    Raises:
        GeometryError: start or goal is unreachable or too near to Type 1 or Type 2, or the point is off the locus.
        TrajectoryError: both lie on one side, Type 1 parts them, or no way within the limits was found; the
            message names the limit that the best one breaks and the nearest duration that works.
    """
    _timed(duration)
    start, goal = np.asarray(start, dtype=np.float64), np.asarray(goal, dtype=np.float64)
    sides = _ends(robot, start, goal)
    place = None if point is None else _place(robot, point)

    def compute() -> Plan:
        return _between(robot, start, goal, sides, place, duration, criterion, progress)

    if not cache:
        return compute()
    request = {
        "plan": "crossing", "start": start, "goal": goal, "duration": duration, "criterion": criterion,
        "point": None if place is None else [place.family.value, place.branch, place.angle],
    }  # fmt: skip
    return answered(robot, request, compute, _checked(robot))


def _parts(
    robot: RobotParameters, start: Array, goal: Array, sides: tuple[float, float], place: LocusPoint | None
) -> tuple[Array, Array]:
    """The places of a way from start to goal before and after its crossing.

    Raises:
        TrajectoryError: Type 1 parts start and goal.
    """
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
    through = "crosses the Type 2 locus once" if place is None else f"leads through ({place.x[0]:.4f}, {place.x[1]:.4f}) m"
    raise TrajectoryError(
        f"Type 1 parts start ({start[0]:.4f}, {start[1]:.4f}) and goal ({goal[0]:.4f}, {goal[1]:.4f}) m: no way between them"
        f" {through} and keeps {robot.min_type1_distance} from Type 1 in working mode {list(robot.working_mode)}"
    )


def _nearest_on_locus(robot: RobotParameters, x: Array) -> LocusPoint:
    arcs = trace_locus(robot, (robot.working_mode,), robot.min_type1_distance)
    gaps = [np.hypot(*(arc.x - x).T) for arc in arcs]
    arc = arcs[int(np.argmin([gap.min() for gap in gaps]))]
    return make_point(robot, arc.working_mode, arc.family, arc.branch, float(arc.angles[np.argmin(np.hypot(*(arc.x - x).T))]))


def _nearest_with_room(robot: RobotParameters, place: LocusPoint) -> str:
    """In words, the point of the locus nearest to one without room that has some; nothing when there is none."""
    arcs = trace_locus(robot, (robot.working_mode,), MIN_CROSSING_TYPE1, crossable=True)
    if not arcs:
        return ""
    x = np.vstack([arc.x for arc in arcs])
    nearest = x[int(np.argmin(np.hypot(*(x - place.x).T)))]
    return f"; the nearest point that has is ({nearest[0]:.4f}, {nearest[1]:.4f}) m"


def _length(way: Array) -> float:
    return float(np.hypot(*np.diff(way, axis=0).T).sum())


def _guess(problem: Problem, point: LocusPoint, before: Array, after: Array) -> Array:
    """The variables of a way given by its places before and after the crossing."""
    unit = problem.task.length
    before, after = np.vstack([before, point.x]), np.vstack([point.x, after])
    lengths = _length(before), _length(after)
    z = np.zeros(VARIABLES)
    z[0:2], z[2:4], z[4] = before[0] / unit, after[-1] / unit, point.angle
    z[5] = np.clip(lengths[0] / sum(lengths), 0.3, 0.7)
    ahead = after[-1] - before[0] if len(before) < 4 or len(after) < 4 else after[3] - before[-4]
    normal = problem.task.sign * point.gradient / np.hypot(*point.gradient)
    ahead = ahead / np.hypot(*ahead)
    ahead = ahead + max(0.0, 0.4 - float(ahead @ normal)) * normal
    z[6:8] = 1.8 * sum(lengths) / unit * ahead / np.hypot(*ahead)
    for way, row in ((before, 12), (after, 14)):
        reached = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
        middle = np.array([np.interp(0.5 * reached[-1], reached, way[:, axis]) for axis in range(2)])
        z[row : row + 2] = (middle - 0.5 * (way[0] + way[-1])) / unit
    return z


def _between(
    robot: RobotParameters,
    start: Array,
    goal: Array,
    sides: tuple[float, float],
    place: LocusPoint | None,
    duration: float | None,
    criterion: Criterion,
    progress: Progress | None,
) -> Plan:
    before, after = _parts(robot, start, goal, sides, place)
    length = _length(np.vstack([before, after]))
    scale = BASE_DURATION + length / PACE if duration is None else duration
    middle = place or _nearest_on_locus(robot, 0.5 * (before[-1] + after[0]))
    free: tuple[int, ...] = SPLIT + STATE + (PLACE if place is None else ())
    direct = length < DETOUR * float(np.hypot(*(goal - start)))
    attempts: list[tuple[LocusPoint, bool]] = [(middle, False)] if direct else []
    shifted: Sequence[LocusPoint | None] = [_beside(robot, middle, shift) for shift in SHIFTS] if place is None else [middle]
    attempts += [(point, True) for point in shifted if point is not None]
    best = _Best(robot)
    for row, (point, bent) in enumerate(attempts):
        if progress is not None:
            progress(row / len(attempts), f"crossing near ({point.x[0]:.4f}, {point.x[1]:.4f}) m")
        problem = crossing_problem(robot, point, float(np.sign(sides[1])), scale, criterion, free + (BENDS if bent else ()), 0.0)
        guess = _guess(problem, point, before, after)
        if not bent:
            guess[list(BENDS)] = 0.0
        if best.offer(problem, guess):
            break
    generator = np.random.default_rng(0)
    for row in range(RESTARTS):
        if best.plan is not None or best.problem is None or best.z is None:
            break
        if progress is not None:
            progress(row / RESTARTS, f"restart {row + 1} of {RESTARTS}")
        shake = np.zeros(VARIABLES)
        shake[best.problem.free] = RESTART_SPREAD * generator.normal(size=len(best.problem.free))
        best.offer(best.problem, best.z + shake)
    if progress is not None:
        progress(1.0, "certified" if best.plan is not None else "not found")
    if duration is None and best.problem is not None and best.z is not None:
        return _stretched(robot, best.problem, best.z)
    if best.plan is not None:
        return best.plan
    what = f"way from ({start[0]:.4f}, {start[1]:.4f}) to ({goal[0]:.4f}, {goal[1]:.4f}) m"
    raise _refuse(robot, what, best, lambda: None)


def plan_return_trip(
    robot: RobotParameters,
    start: Array,
    goal: Array,
    duration: float | None,
    dwell: float,
    repeat: int = 1,
    *,
    point: LocusPoint | Array | None = None,
    criterion: Criterion = Criterion.RECIPROCAL,
    cache: bool = True,
    progress: Progress | None = None,
) -> Plan:
    """start -> goal -> start, ``repeat`` times, with rests before, between and after.

    The way back is the time reversal of the way out when there is no gravity; with gravity it is planned by itself.

    Args:
        duration: of one way, s.
        dwell: of each rest, s.
        repeat: return trips.
        point, criterion, cache, progress: as ``plan_crossing``.

    Raises:
        GeometryError, TrajectoryError: as ``plan_crossing``.
    """
    _repeated(repeat, dwell)

    def one_way(begin: Array, end: Array) -> Trajectory:
        return plan_crossing(
            robot, begin, end, duration, point=point, criterion=criterion, cache=cache, progress=progress
        ).trajectory

    out = one_way(start, goal)
    back = out.reversed() if robot.gravity == (0.0, 0.0) else one_way(goal, start)
    return _there_and_back(robot, out, back, dwell, repeat)


def plan_return_trip_through(
    robot: RobotParameters,
    point: LocusPoint | Array,
    direction: int | Array,
    duration: float | None,
    dwell: float,
    repeat: int = 1,
    *,
    criterion: Criterion = Criterion.RECIPROCAL,
    cache: bool = True,
    progress: Progress | None = None,
) -> Plan:
    """Out through a given point of the locus and back, ``repeat`` times, with rests before, between and after.

    Args:
        duration: of one way, s; chosen when None.
        dwell: of each rest, s.
        repeat: return trips.
        point, direction, criterion, cache, progress: as ``plan_through``.

    Raises:
        GeometryError, TrajectoryError: as ``plan_through``.
    """
    _repeated(repeat, dwell)
    place = _place(robot, point)
    out = plan_through(robot, place, direction, duration, criterion=criterion, cache=cache, progress=progress).trajectory
    back = out.reversed()
    if robot.gravity != (0.0, 0.0):
        ends = out.at(out.duration).x, out.at(0.0).x
        back = plan_crossing(
            robot, *ends, duration, point=place, criterion=criterion, cache=cache, progress=progress
        ).trajectory
    return _there_and_back(robot, out, back, dwell, repeat)


def _repeated(repeat: int, dwell: float) -> None:
    if repeat < 1:
        raise TrajectoryError(f"repeat = {repeat}; it must be >= 1")
    if not (np.isfinite(dwell) and dwell > 0.0):
        raise TrajectoryError(f"dwell = {dwell} s; it must be > 0")


def _there_and_back(robot: RobotParameters, out: Trajectory, back: Trajectory, dwell: float, repeat: int) -> Plan:
    start, goal = out.at(0.0).x, out.at(out.duration).x
    trip = join([hold(start, dwell)] + [out, hold(goal, dwell), back, hold(start, dwell)] * repeat)
    return Plan(trip, certify(robot, trip, max_residual=PLAN_RESIDUAL, crossings=2 * repeat))
