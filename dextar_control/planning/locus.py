"""The Type 2 locus of a robot, traced where it has a closed form, and its points."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dextar_control.contract.errors import GeometryError, ParameterError
from dextar_control.contract.robot import RobotParameters
from dextar_control.mechanisms.five_bar import FiveBar
from dextar_control.mechanisms.five_bar_locus import Family as Family
from dextar_control.mechanisms.five_bar_locus import FiveBarLocus
from dextar_control.model.robot import AnyRobot, Robot
from dextar_control.planning.model import PlanningModel, planning_model
from dextar_control.planning.trajectory import in_words, lengths_along
from dextar_control.symbols.types import Array

WORKING_MODES = FiveBar.working_modes
TRACE = 1440  # samples of a full turn of the tracing angle
MIN_CROSSING_TYPE1 = 0.2  # distance to Type 1 of a point that is offered for crossing
THIN = 6  # trace samples of which one is looked at for its surroundings
ON_LOCUS = 1e-3  # m, a point this near is taken as the locus point beside it
# |s| at start and goal, where the direct model gives the estimate again
# (dgm.hold_below_abs_s + dgm.fade_width_abs_s)
MIN_END_S = 0.4
REST_S = 0.5  # |s| of a rest that the planner chooses
REST_REACH = 1.0  # of the mechanism's length: how far such a rest is from the locus
DIRECTIONS, STEPS = 24, 24  # of that search, in the plane
# steps to the nearest point of a locus that is not traced, and then to zero s
PROJECTIONS, POLISHES = 60, 4
LONGEST_STEP = 0.2  # of the mechanism's length, of one such step
LOCUS_S = 1e-12  # |s| of such a point
TRIES = 1000  # places near which the locus is looked for, to spread points over it

Mode = tuple[int, ...]


class LocusPoint(NamedTuple):
    """A point of the locus in one working mode, with what a crossing there needs."""

    x: Array  # (n,) m
    working_mode: Mode
    family: Family | None  # None where the mechanism has one
    t_s: Array  # (n,) unit kernel of A_r
    gradient: Array  # (n,) of s, 1/m: a crossing towards s > 0 moves along it
    type1: float  # distance to Type 1
    branch: int  # +1 or -1: which of the family's two
    angle: float  # along the branch, rad; 0 where the locus is not traced


class Arc(NamedTuple):
    """A connected piece of the locus in one working mode, traced."""

    working_mode: Mode
    family: Family
    branch: int
    angles: Array  # (m,) rising, rad
    x: Array  # (m, n) m
    length: Array  # (m,) from the arc's begin, m


def rests_around(
    model: PlanningModel, points: Array, clear: float, least_s: float
) -> list[Array]:
    """Return places for a rest straight ahead of locus points: of each point, (k, n +
    2) x, m, s and distance to Type 1.

    The straight line from the point to a place keeps the sign of s and the distance
    ``clear`` from Type 1; in each direction the farthest place within REST_REACH counts
    and the nearest one with |s| >= least_s.

    Args:
        model: of the robot.
        points: of the locus, (m, n), m.
        clear: least distance to Type 1.
        least_s: least |s|.
    """
    away = REST_REACH * model.length * np.arange(1, STEPS + 1) / STEPS
    places = points[:, None, None] + away[:, None] * _directions(model.n)[:, None]
    found = model.sides(places.reshape(-1, model.n))
    s, type1 = (values.reshape(places.shape[:3]) for values in (found.s, found.type1))
    blocks = found.s_blocks.reshape(*places.shape[:3], -1)
    with np.errstate(invalid="ignore"):
        side = s[:, :, :1, None]  # of each line at its first step
        kept = (blocks * side > 0.0).all(axis=3) & (type1 >= clear)
        seen = np.logical_and.accumulate(kept, axis=2) & (np.abs(s) >= least_s)
    ends = np.zeros_like(seen)
    rows, directions = np.nonzero(seen.any(axis=2))
    lines = seen[rows, directions]
    for step in (lines.argmax(axis=1), STEPS - 1 - lines[:, ::-1].argmax(axis=1)):
        ends[rows, directions, step] = True
    table = np.concatenate([places, s[..., None], type1[..., None]], axis=3)
    return [table[row][ends[row]] for row in range(len(points))]


@lru_cache
def _directions(n: int) -> Array:
    """Return the unit vectors (k, n), 1, in all directions: evenly in the plane, at
    random but always the same in more dimensions.
    """
    if n == 2:
        turns = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        return np.stack([np.cos(turns), np.sin(turns)], axis=1)
    vectors = np.random.default_rng(0).normal(size=(DIRECTIONS * 3 ** (n - 2), n))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


def are_crossable(
    model: PlanningModel, points: Array, clear: float
) -> NDArray[np.bool_]:
    """Return whether there is a place for a rest straight ahead on both sides of each
    locus point (m, n), m.
    """
    sides = [rests[:, -2] for rests in rests_around(model, points, clear, REST_S)]
    return np.array([bool((s > 0.0).any() and (s < 0.0).any()) for s in sides], bool)


@lru_cache(maxsize=64)
def trace_locus(
    robot: RobotParameters,
    working_modes: tuple[Mode, ...] = WORKING_MODES,
    type1: float = MIN_CROSSING_TYPE1,
    crossable: bool = False,
) -> list[Arc]:
    """Return the locus in connected arcs, each in one working mode and at least
    ``type1`` from Type 1.

    Args:
        robot: whose working mode does not matter.
        working_modes: of the arcs.
        type1: least distance to Type 1.
        crossable: only points with a place for a rest straight ahead on both sides.
    """
    model = planning_model(robot)
    mechanism = model.mechanism
    assert isinstance(mechanism, FiveBarLocus)
    angles = np.linspace(-np.pi, np.pi, TRACE + 1)
    arcs = []
    for family in Family:
        for branch in (1, -1):
            traced = model.locus([family.value], [branch], angles[:, None])
            modes: list[Mode] = [
                tuple(mode) for mode in mechanism.modes(traced.type1_sines).tolist()
            ]
            with np.errstate(invalid="ignore"):
                fit = np.abs(traced.type1_sines).min(axis=1) >= type1
                fit &= traced.closing[:, 0] >= 0.0
            fit &= np.array([mode in working_modes for mode in modes])
            if crossable:
                fit &= _passable(robot, traced.x, modes, fit, type1)
            for (fits, mode), rows in itertools.groupby(
                enumerate(zip(fit, modes, strict=True)), lambda row: row[1]
            ):
                own = [row for row, _ in rows]
                if fits and len(own) > 1:
                    x = traced.x[own]
                    arcs.append(
                        Arc(mode, family, branch, angles[own], x, lengths_along(x))
                    )
    return arcs


def _passable(
    robot: RobotParameters,
    x: Array,
    modes: list[Mode],
    fit: NDArray[np.bool_],
    type1: float,
) -> NDArray[np.bool_]:
    """Return which traced points (m, n), m, lie between two thinned ones that can be
    crossed.
    """
    seen = np.zeros(len(x), dtype=bool)
    thinned = np.arange(0, len(x), THIN)
    for mode in set(modes):
        rows = [k for k in thinned if fit[k] and modes[k] == mode]
        if rows:
            model = planning_model(robot.replace(working_mode=mode))
            seen[rows] = are_crossable(model, x[rows], type1)
    every = np.arange(len(x))
    before = every // THIN * THIN
    after = np.minimum(-(-every // THIN) * THIN, thinned[-1])
    return np.asarray(seen[before] & seen[after])


def _point_on_arc(robot: RobotParameters, arc: Arc, length: float) -> LocusPoint:
    """Return the point of an arc at a length from its begin, m."""
    return _point_at(robot, arc, float(np.interp(length, arc.length, arc.angles)))


def _point_at(robot: RobotParameters, arc: Arc, angle: float) -> LocusPoint:
    """Return the point of an arc at a tracing angle, rad."""
    model = planning_model(robot.replace(working_mode=arc.working_mode))
    x = _position(model, arc, angle)
    at = model.place(x)
    own = arc.working_mode, arc.family
    type1 = float(at.type1[0])
    return LocusPoint(x, *own, at.t_s, at.gradient, type1, arc.branch, angle)


def _position(model: PlanningModel, arc: Arc, angle: float) -> Array:
    """Return the point (n,), m, of an arc at a tracing angle, rad."""
    x: Array = model.locus([arc.family.value], [arc.branch], np.array([[angle]])).x[0]
    return x


def nearest_point(robot: AnyRobot, x: Array, type1: float | None = None) -> LocusPoint:
    """Return the point of the locus nearest to x (n,), m, in the robot's working mode.

    Where the locus is not traced the point is found along the gradient of s, which
    leads to the nearest one from near it.

    Raises:
        GeometryError: the working mode has no locus that is ``type1`` from Type 1, or
            no point was found.
    """
    # here: it takes longer to load than all else
    from scipy.optimize import minimize_scalar

    x, model = np.asarray(x, dtype=np.float64), planning_model(robot)
    if x.shape != (model.n,) or not np.isfinite(x).all():
        raise GeometryError(
            f"place {np.round(x, 6).tolist()}; it must be {model.n} finite numbers, m"
        )
    limit = robot.min_type1_distance if type1 is None else type1
    if not isinstance(robot, RobotParameters):
        return _nearest_by_gradient(robot, x, limit)
    arcs = trace_locus(robot, (robot.working_mode,), limit)
    if not arcs:
        raise GeometryError(
            f"working mode {list(robot.working_mode)} has no Type 2 locus at least"
            f" {limit} from Type 1"
        )
    arc = min(arcs, key=lambda arc: float(np.linalg.norm(arc.x - x, axis=1).min()))
    row = int(np.argmin(np.linalg.norm(arc.x - x, axis=1)))
    bounds = arc.angles[max(row - 1, 0)], arc.angles[min(row + 1, len(arc.angles) - 1)]

    def gap(angle: float) -> float:
        return float(np.linalg.norm(_position(model, arc, angle) - x))

    found = minimize_scalar(
        gap, bounds=bounds, method="bounded", options={"xatol": 1e-12}
    )
    return _point_at(robot, arc, float(found.x))


def _nearest_by_gradient(robot: Robot, x: Array, type1: float) -> LocusPoint:
    """Return the point near x (n,), m, by projections on the tangent of the locus,
    until s is zero to rounding.
    """
    model, place = planning_model(robot), x
    longest = LONGEST_STEP * model.length
    found = model.place(place)
    for row in range(PROJECTIONS + POLISHES):
        beside = x - place if row < PROJECTIONS else np.zeros(model.n)
        gradient = found.gradient
        missing = float(found.s[0]) + float(gradient @ beside)
        step = beside - missing / float(gradient @ gradient) * gradient
        length = max(float(np.linalg.norm(step)), 1e-300)
        place = place + step * min(1.0, longest / length)
        found = model.place(place)
    if not abs(found.s[0]) <= LOCUS_S:
        raise GeometryError(
            f"no place of the Type 2 locus was found near {in_words(x)}: the search"
            f" ended in {in_words(place)}"
        )
    if found.type1[0] < type1:
        raise GeometryError(
            f"the Type 2 locus near {in_words(x)}, in {in_words(place)}, is"
            f" {float(found.type1[0]):.3f} from Type 1; the limit is {type1}"
        )
    clear = float(found.type1[0])
    mode = robot.working_mode
    return LocusPoint(place, mode, None, found.t_s, found.gradient, clear, 1, 0.0)


def spread_places(
    robot: AnyRobot,
    low: Array,
    high: Array,
    count: int,
    *,
    type1: float = MIN_CROSSING_TYPE1,
    seed: int = 0,
) -> list[LocusPoint]:
    """Return points of the locus that can be crossed, far from each other, of any
    mechanism.

    Args:
        robot: of any mechanism, in its working mode.
        low, high: corners of the box in which they lie, (n,), m.
        count: of points.
        type1: least distance to Type 1.
        seed: of the places near which the locus is looked for.

    Raises:
        GeometryError: there are not so many.
    """
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    model = planning_model(robot)
    found: list[LocusPoint] = []
    for near in np.random.default_rng(seed).uniform(low, high, (TRIES, model.n)):
        try:
            point = nearest_point(robot, near, type1)
        except GeometryError:
            continue
        if (point.x >= low).all() and (point.x <= high).all():
            found.append(point)
    chosen: list[LocusPoint] = []
    distance = np.full(len(found), np.inf)
    while len(chosen) < count and (distance > 0.0).any():
        row = int(np.argmax(distance))
        if are_crossable(model, found[row].x[None], type1)[0]:
            chosen.append(found[row])
            gaps = [float(np.linalg.norm(point.x - found[row].x)) for point in found]
            distance = np.minimum(distance, gaps)
        distance[row] = 0.0
    if len(chosen) < count:
        raise GeometryError(
            f"{len(chosen)} places of the Type 2 locus that can be crossed were found"
            f" there; {count} are wanted"
        )
    return chosen


def locus_point(robot: AnyRobot, x: Array) -> LocusPoint:
    """Return the locus point at x (n,), m, in the robot's working mode.

    Raises:
        GeometryError: x is unreachable or farther than ON_LOCUS from the locus; names
            |s| and the nearest point.
    """
    x = np.asarray(x, dtype=np.float64)
    model = planning_model(robot)
    model.inverse_geometric_model(x)
    nearest = nearest_point(robot, x)
    gap = float(np.linalg.norm(nearest.x - x))
    if gap > ON_LOCUS:
        s = abs(model.s(x))
        raise GeometryError(
            f"point {in_words(x)} is off the Type 2 locus: |s| = {s:.4f}; the nearest"
            f" point of the locus that is clear of Type 1 is {in_words(nearest.x)},"
            f" {1e3 * gap:.1f} mm away",
            point=nearest.x.tolist(),
        )
    return nearest


def place_of(robot: AnyRobot, point: LocusPoint | Array) -> LocusPoint:
    """Return a locus point as it is, or that at a position (n,), m, in the robot's
    working mode.

    Raises:
        GeometryError: the position is off the locus, or the point belongs to another
            working mode.
    """
    if not isinstance(point, LocusPoint):
        return locus_point(robot, point)
    if point.working_mode != robot.working_mode:
        raise GeometryError(
            f"the locus point {in_words(point.x)} belongs to working mode"
            f" {list(point.working_mode)}, the robot is in {list(robot.working_mode)}:"
            " set robot.working_mode"
        )
    return point


def beside(robot: AnyRobot, point: LocusPoint, shift: float) -> LocusPoint | None:
    """Return the locus point at a signed distance, m, along the arc of another; None
    where the arc ends or the locus is not traced.
    """
    if not isinstance(robot, RobotParameters):
        return None
    for arc in trace_locus(robot, (robot.working_mode,), robot.min_type1_distance):
        inside = arc.angles[0] <= point.angle <= arc.angles[-1]
        if arc.family is point.family and arc.branch == point.branch and inside:
            place = float(np.interp(point.angle, arc.angles, arc.length)) + shift
            if 0.0 <= place <= arc.length[-1]:
                return _point_on_arc(robot, arc, place)
    return None


def _shares(lengths: Array, count: int, least: Array) -> Array:
    """Return shares (m,) of ``count`` in proportion to lengths (m,), m, each at least
    that of ``least`` (m,), by largest remainders.
    """
    share = np.maximum(least, 0)
    while share.sum() < count:
        wanted = count * lengths / lengths.sum() - share
        share[int(np.argmax(wanted))] += 1
    return share


def sample_locus(
    robot: RobotParameters,
    count: int,
    seed: int = 0,
    *,
    folded: int = 0,
    working_modes: Sequence[Mode] = WORKING_MODES,
) -> list[LocusPoint]:
    """Return points spread evenly over the locus where it can be crossed, in several
    working modes.

    They are spread by arc length within each family of each working mode, with a random
    phase; each working mode that reaches the locus has at least one point.

    Args:
        robot: whose working mode does not matter.
        count: of points.
        seed: of the phases.
        folded: least number of folded points.
        working_modes: of the points.

    Raises:
        ParameterError: count is smaller than what folded and the working modes ask for.
        GeometryError: no working mode reaches the locus, or none reaches a folded point
            and some are asked for.
    """
    strata: dict[tuple[Family, Mode], list[Arc]] = {}
    for arc in trace_locus(robot, tuple(map(tuple, working_modes)), crossable=True):
        strata.setdefault((arc.family, arc.working_mode), []).append(arc)
    if not strata:
        raise GeometryError(
            f"no Type 2 locus lies at least {MIN_CROSSING_TYPE1} from Type 1 in the"
            " working modes asked for"
        )
    keys = sorted(strata, key=lambda key: (key[0].value, key[1]))
    lengths = np.array([sum(arc.length[-1] for arc in strata[key]) for key in keys])
    is_folded = np.array([key[0] is Family.FOLDED for key in keys])
    if folded > 0 and not is_folded.any():
        raise GeometryError(
            f"folded = {folded}, but the robot has no folded Type 2 locus clear of"
            " Type 1"
        )
    least = np.zeros(len(keys), dtype=int)
    if folded > 0:
        none = np.zeros(int(is_folded.sum()), dtype=int)
        least[is_folded] = _shares(lengths[is_folded], folded, none)
    for mode in {key[1] for key in keys}:
        rows = [row for row, key in enumerate(keys) if key[1] == mode]
        if least[rows].sum() == 0:
            least[max(rows, key=lambda row: lengths[row])] = 1
    if least.sum() > count:
        raise ParameterError(
            f"count = {count}; {folded} folded points and each working mode need at"
            f" least {least.sum()}"
        )
    generator = np.random.default_rng(seed)
    points = []
    for key, share in zip(keys, _shares(lengths, count, least), strict=True):
        phase = generator.uniform()
        arcs = strata[key]
        ends = np.cumsum([arc.length[-1] for arc in arcs])
        for k in range(share):
            place = (k + phase) / share * ends[-1]
            row = min(int(np.searchsorted(ends, place)), len(arcs) - 1)
            begin = ends[row] - arcs[row].length[-1]
            points.append(_point_on_arc(robot, arcs[row], place - begin))
    return points
