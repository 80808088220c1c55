"""The Type 2 locus: both families, traced in closed form, in every working mode.

The distal links are aligned on the locus: r_1 = l2_1 d and r_2 = -+l2_2 d with a unit vector d, so that
P_2 - P_1 = (l2_1 +- l2_2) d. Opposite links (stretched) give the coupler curve of the four-bar e_1 P_1 P_2 e_2;
links that point the same way (folded) give, for equal distal links, the circle about the elbows' common point,
where the direct model is undefined, and else the coupler curve of a four-bar with a short coupler.

At a stretched point s changes along t_s (by 2/l2 for equal links). At a folded one with equal distal links t_s is
tangent to the locus: s changes only along v_1, radially.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from dextar_control.contract.errors import GeometryError, ParameterError
from dextar_control.contract.robot import RobotParameters
from dextar_control.core.compiled import njit
from dextar_control.core.kinematics import (
    inverse_model,
    singular_values,
    singularity,
    singularity_of_platform,
    state_of_platform,
    type1_distance,
)
from dextar_control.core.model import Array, Model, make_model

WORKING_MODES = ((1, -1), (1, 1), (-1, 1), (-1, -1))
TRACE = 1440  # samples of a full turn of the tracing angle
MIN_CROSSING_TYPE1 = 0.2  # distance to Type 1 of a point that is offered for crossing
THIN = 6  # trace samples that share one look at their surroundings
ON_LOCUS = 1e-3  # m, a point this near is taken as the locus point beside it
DIFFERENCE = 1e-6  # m, step of the gradient of s
MIN_END_S = 0.4  # |s| at start and goal: there the direct model holds the estimate again (hold_zone + hold_width)
REST_S = 0.5  # |s| of a rest that the planner offers itself
REST_REACH = 1.0  # of the mean distal length: how far from the locus such a rest is looked for
DIRECTIONS, STEPS = 24, 24  # of that search


class Family(Enum):
    """How the distal links align: the value is the sign in l2_1 +- l2_2."""

    STRETCHED = 1
    FOLDED = -1


class LocusPoint(NamedTuple):
    """A point of the locus in one working mode, with what a crossing there needs."""

    x: Array  # (2,) m
    working_mode: tuple[int, int]
    family: Family
    t_s: Array  # (2,) unit kernel of A_r
    gradient: Array  # (2,) of s, 1/m: a crossing towards s > 0 moves along it
    type1: float  # distance to Type 1
    branch: int  # +1 or -1: which of the two closures of the four-bar
    angle: float  # along the branch, rad: of the left motor (stretched), of d (folded)


class Arc(NamedTuple):
    """A connected piece of the locus in one working mode, traced."""

    working_mode: tuple[int, int]
    family: Family
    branch: int
    angles: Array  # (m,) rising, rad
    x: Array  # (m, 2) m
    length: Array  # (m,) from the arc's begin, m


@njit
def locus_position(model: Model, family: float, branch: float, angle: float) -> Array:
    """Elbow and end effector (q_1, x, y, B_1, B_2) of the locus at a tracing angle; nan where it does not close."""
    out = np.full(5, np.nan)
    coupler = model.l2[0] + family * model.l2[1]
    turn = np.array([np.cos(angle), np.sin(angle)])
    if family > 0.0:
        center, radius, other = model.base[0] + model.l1[0] * turn, coupler, model.l1[1]
    else:
        center, radius, other = model.base[0] + coupler * turn, model.l1[0], model.l1[1]
    dx, dy = model.base[1, 0] - center[0], model.base[1, 1] - center[1]
    distance = np.sqrt(dx * dx + dy * dy)
    along = 0.5 * (distance + (radius**2 - other**2) / distance)
    height2 = radius**2 - along * along
    if not height2 >= 0.0:
        return out
    height = branch * np.sqrt(height2)
    P2 = np.array([center[0] + (along * dx - height * dy) / distance, center[1] + (along * dy + height * dx) / distance])
    if family > 0.0:
        P1 = center
        direction = (P2 - P1) / coupler
    else:
        P1 = P2 - coupler * turn
        direction = turn
    x = P1 + model.l2[0] * direction
    out[0] = np.arctan2(P1[1] - model.base[0, 1], P1[0] - model.base[0, 0])
    out[1:3] = x
    for i in range(2):
        P = P1 if i == 0 else P2
        u = (P - model.base[i]) / model.l1[i]
        out[3 + i] = -model.l1[i] * ((x[1] - P[1]) * u[0] - (x[0] - P[0]) * u[1])
    return out


@njit
def singularity_gradient(model: Model, x: Array) -> Array:
    """Gradient of s (2,), 1/m, by central differences in the model's working mode."""
    gradient = np.empty(2)
    for axis in range(2):
        step = np.zeros(2)
        step[axis] = DIFFERENCE
        after = singularity(model, state_of_platform(model, x + step, np.zeros(2)).A_r)
        before = singularity(model, state_of_platform(model, x - step, np.zeros(2)).A_r)
        gradient[axis] = (after - before) / (2.0 * DIFFERENCE)
    return gradient


@njit
def _trace(model: Model, family: float, branch: float, count: int) -> Array:
    rows = np.empty((count + 1, 5))
    for k in range(count + 1):
        rows[k] = locus_position(model, family, branch, -np.pi + 2.0 * np.pi * k / count)
    return rows


@njit
def rests_around(model: Model, x: Array, sign: float, clear: float, least_s: float, reach: float) -> Array:
    """Places (n, 4) x, y, s, distance to Type 1 around a locus point, straight ahead of it on the side of ``sign``.

    The straight line from the point to each keeps the sign of s and the distance ``clear`` from Type 1; along each of the
    directions the farthest place within ``reach``, m, and the first one with |s| >= least_s count.
    """
    found = np.empty((2 * DIRECTIONS, 4))
    count = 0
    for k in range(DIRECTIONS):
        angle = 2.0 * np.pi * k / DIRECTIONS
        first = True
        last = np.zeros(4)
        for j in range(1, STEPS + 1):
            place = x + reach * j / STEPS * np.array([np.cos(angle), np.sin(angle)])
            kin = state_of_platform(model, place, np.zeros(2))
            s = sign * singularity(model, kin.A_r)
            type1 = type1_distance(model, kin)
            if not (s > 0.0 and type1 >= clear):
                break
            if s >= least_s:
                row = np.array([place[0], place[1], sign * s, type1])
                if first:
                    found[count] = row
                    count += 1
                    first = False
                last = row
        if not first:
            found[count] = last
            count += 1
    return found[:count]


def is_crossable(model: Model, x: Array, clear: float) -> bool:
    """Whether a rest lies straight ahead on both sides of the locus point x (2,)."""
    reach = REST_REACH * float(model.l2.mean())
    return all(len(rests_around(model, x, sign, clear, REST_S, reach)) > 0 for sign in (-1.0, 1.0))


def _mode(row: Array) -> tuple[int, int]:
    """Working mode of B: a leg with B > 0 has its elbow on the left."""
    return (1 if row[3] > 0.0 else -1, 1 if row[4] > 0.0 else -1)


@lru_cache(maxsize=64)
def trace_locus(
    robot: RobotParameters,
    working_modes: tuple[tuple[int, int], ...] = WORKING_MODES,
    type1: float = MIN_CROSSING_TYPE1,
    crossable: bool = False,
) -> list[Arc]:
    """The locus in connected arcs, each in one working mode and at least ``type1`` from Type 1.

    Args:
        robot: whose working mode does not matter.
        working_modes: the ones wanted.
        type1: least distance to Type 1.
        crossable: only where a rest lies straight ahead on both sides, that far from Type 1.
    """
    model = make_model(robot)
    models = {mode: make_model(robot.replace(working_mode=mode)) for mode in working_modes}
    scale = model.l1 * model.l2
    angles = np.linspace(-np.pi, np.pi, TRACE + 1)
    arcs = []
    for family in Family:
        for branch in (1, -1):
            rows = _trace(model, float(family.value), float(branch), TRACE)
            with np.errstate(invalid="ignore"):
                clear = (np.abs(rows[:, 3:5]) / scale).min(axis=1) >= type1
            modes: list[tuple[int, int] | None] = [
                _mode(row) if good and _mode(row) in working_modes else None for row, good in zip(rows, clear, strict=True)
            ]
            if crossable:
                seen = range(0, len(rows), THIN)
                passable = {
                    k for k in seen if (at := modes[k]) is not None and is_crossable(models[at], rows[k, 1:3], type1)
                }
                modes = [
                    mode if k // THIN * THIN in passable and -(-k // THIN) * THIN in passable else None
                    for k, mode in enumerate(modes)
                ]
            begin = 0
            for k in range(1, len(rows) + 1):
                if k < len(rows) and modes[k] == modes[begin]:
                    continue
                mode = modes[begin]
                if mode is not None and k - begin > 1:
                    x = rows[begin:k, 1:3]
                    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(x, axis=0).T))])
                    arcs.append(Arc(mode, family, branch, angles[begin:k], x, length))
                begin = k
    return arcs


def point_on_arc(robot: RobotParameters, arc: Arc, length: float) -> LocusPoint:
    """The point of an arc at a length from its begin, m."""
    return make_point(robot, arc.working_mode, arc.family, arc.branch, float(np.interp(length, arc.length, arc.angles)))


def make_point(
    robot: RobotParameters, working_mode: tuple[int, int], family: Family, branch: int, angle: float
) -> LocusPoint:
    """The point of the locus at a tracing angle, rad, of one branch."""
    model = make_model(robot.replace(working_mode=working_mode))
    x = locus_position(model, float(family.value), float(branch), angle)[1:3]
    kin = state_of_platform(model, x, np.zeros(2))
    return LocusPoint(
        x=x, working_mode=working_mode, family=family, t_s=singular_values(kin.A_r).v2,
        gradient=singularity_gradient(model, x), type1=float(type1_distance(model, kin)), branch=branch, angle=angle,
    )  # fmt: skip


def nearest_point(robot: RobotParameters, x: Array, type1: float | None = None) -> LocusPoint:
    """The point of the locus nearest to x (2,), m, in the robot's working mode.

    Raises:
        GeometryError: the working mode has no locus that far from Type 1.
    """
    x = np.asarray(x, dtype=np.float64)
    limit = robot.min_type1_distance if type1 is None else type1
    arcs = trace_locus(robot, (robot.working_mode,), limit)
    if not arcs:
        raise GeometryError(f"working mode {list(robot.working_mode)} has no Type 2 locus at least {limit} from Type 1")
    gaps = [np.hypot(*(arc.x - x).T) for arc in arcs]
    arc = arcs[int(np.argmin([gap.min() for gap in gaps]))]
    row = int(np.argmin(np.hypot(*(arc.x - x).T)))
    model = make_model(robot)
    found = minimize_scalar(
        lambda angle: float(np.hypot(*(locus_position(model, arc.family.value, arc.branch, angle)[1:3] - x))),
        bounds=(arc.angles[max(row - 1, 0)], arc.angles[min(row + 1, len(arc.angles) - 1)]),
        method="bounded", options={"xatol": 1e-12},
    )  # fmt: skip
    return make_point(robot, arc.working_mode, arc.family, arc.branch, float(found.x))


def locus_point(robot: RobotParameters, x: Array) -> LocusPoint:
    """The locus point at x (2,), m, in the robot's working mode.

    Raises:
        GeometryError: x is unreachable or farther than ON_LOCUS from the locus; names |s| and the nearest point.
    """
    x = np.asarray(x, dtype=np.float64)
    inverse_model(make_model(robot), x)
    nearest = nearest_point(robot, x)
    gap = float(np.hypot(*(nearest.x - x)))
    if gap > ON_LOCUS:
        s = abs(singularity_of_platform(make_model(robot), x))
        raise GeometryError(
            f"point ({x[0]:.4f}, {x[1]:.4f}) m is off the Type 2 locus: |s| = {s:.4f}; the nearest point of the locus that is"
            f" clear of Type 1 is ({nearest.x[0]:.4f}, {nearest.x[1]:.4f}) m, {1e3 * gap:.1f} mm away"
        )
    return nearest


def _shares(lengths: Array, count: int, least: Array) -> Array:
    """``count`` split in proportion to lengths, each part at least ``least``, by largest remainders."""
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
    working_modes: Sequence[tuple[int, int]] = WORKING_MODES,
) -> list[LocusPoint]:
    """Points spread evenly over the locus where it can be crossed, in several working modes.

    Points are spread by arc length within each family of each working mode, with a random phase; each working
    mode that reaches the locus has at least one point.

    Args:
        count: of points.
        seed: of the phases.
        folded: least number of folded points.
        working_modes: the ones to use.

    Raises:
        ParameterError: count is smaller than what folded and the working modes ask for.
        GeometryError: no working mode reaches the locus, or none reaches a folded point and some are asked for.
    """
    strata: dict[tuple[Family, tuple[int, int]], list[Arc]] = {}
    for arc in trace_locus(robot, tuple((left, right) for left, right in working_modes), crossable=True):
        strata.setdefault((arc.family, arc.working_mode), []).append(arc)
    if not strata:
        raise GeometryError(f"no Type 2 locus lies at least {MIN_CROSSING_TYPE1} from Type 1 in the working modes asked for")
    keys = sorted(strata, key=lambda key: (key[0].value, key[1]))
    lengths = np.array([sum(arc.length[-1] for arc in strata[key]) for key in keys])
    is_folded = np.array([key[0] is Family.FOLDED for key in keys])
    if folded > 0 and not is_folded.any():
        raise GeometryError(f"folded = {folded}, but the robot has no folded Type 2 locus clear of Type 1")
    least = np.zeros(len(keys), dtype=int)
    if folded > 0:
        least[is_folded] = _shares(lengths[is_folded], folded, np.zeros(int(is_folded.sum()), dtype=int))
    for mode in {key[1] for key in keys}:
        rows = [row for row, key in enumerate(keys) if key[1] == mode]
        if least[rows].sum() == 0:
            least[max(rows, key=lambda row: lengths[row])] = 1
    if least.sum() > count:
        raise ParameterError(f"count = {count}; {folded} folded points and each working mode need at least {least.sum()}")
    generator = np.random.default_rng(seed)
    points = []
    for key, share in zip(keys, _shares(lengths, count, least), strict=True):
        phase = generator.uniform()
        arcs = strata[key]
        ends = np.cumsum([arc.length[-1] for arc in arcs])
        for k in range(share):
            place = (k + phase) / share * ends[-1]
            row = min(int(np.searchsorted(ends, place)), len(arcs) - 1)
            points.append(point_on_arc(robot, arcs[row], place - (ends[row] - arcs[row].length[-1])))
    return points
