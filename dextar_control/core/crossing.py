"""A motion from or to the locus as numbers: polynomials from a crossing's state, and what a candidate costs.

Each half runs from the state at a crossing (position, velocity, acceleration, jerk) to a state at its end, by a
polynomial of degree 7 per coordinate, bent by two bumps that vanish at both ends with three derivatives. The two
halves of a crossing share its state, so that the torque has its finite limit there; the two halves of a leg between
crossings share the state at their meeting.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dextar_control.core.compiled import njit
from dextar_control.core.dynamics import inertia, wrenches
from dextar_control.core.kinematics import singular_values, state_of_platform
from dextar_control.core.locus import locus_position
from dextar_control.core.model import Array, Model
from dextar_control.core.trajectory import evaluate_segment

_POWERS = np.arange(4.0, 8.0)
_END = np.linalg.inv(
    np.array([_POWERS**0, _POWERS, _POWERS * (_POWERS - 1), _POWERS * (_POWERS - 1) * (_POWERS - 2)])
)  # of the four highest powers, from what position, velocity, acceleration and jerk lack at the end
_BUMP = 256.0 * np.array([[1.0, -4.0, 6.0, -4.0, 1.0, 0.0], [-1.0, 6.0, -14.0, 16.0, -9.0, 2.0]])  # powers 4 to 9
ROWS = 10  # coefficients of a half

HALF_SAMPLES = 24  # of each half while optimising, none of them on the locus
DENSITY = 0.35  # spacing of those samples at the crossing over their mean spacing
SOFT_MAXIMUM = 12  # exponent of the mean that stands for the peak torque
NEAR = 0.15  # |s| that counts as near the locus
NEAR_EMPHASIS = 0.5  # how much more a torque on the locus counts than one away from it
DIFFERENCE = 1e-6  # of the scaled variables in the gradient
UNREACHABLE = 20.0  # cost of a half that a leg does not reach, before how far it misses
IMPOSSIBLE = 1e6  # cost of a place where the locus does not close
SPEED_SHARE = 0.95  # of the speed limits that costs nothing

SPLIT_LEAST = 0.2  # fraction of the time on either side of the crossing
SPAN_MOST = 2.0  # logarithm of a leg's half over its scale

START, GOAL, PLACE, SPLIT = (0, 1), (2, 3), (4,), (5,)  # indices of a crossing's variables z, see ``halves``
VELOCITY, FREE, JERK, BENDS = (6, 7), (8,), (9, 10), tuple(range(12, 20))
STATE = VELOCITY + FREE + JERK
MEETING, SPANS = tuple(range(8)), (10, 11)  # indices of a leg's variables
VARIABLES = 20


class Limits(NamedTuple):
    """What costs one, and what must hold."""

    torque: float  # peak torque that costs one, N m
    near_time: float  # s near the locus that costs ``near_weight``
    near_weight: float
    time: float  # s of a leg that costs one
    joint_speed: float  # rad/s
    platform_speed: float  # m/s
    type1: float  # distance to Type 1
    end_s: float  # |s| at the ends


class Task(NamedTuple):
    """What is given of a crossing or of a leg between two crossings."""

    leg: bool
    family: float  # of the locus, for a crossing
    branch: float
    full: bool  # w_d = 0 at the crossing, not only its component along t_s
    sign: float  # of s after the crossing, or during the leg
    duration: float  # s, of the crossing; the scale of a leg
    length: float  # m, scale
    towards: Array  # (2,) unit direction of the velocity at the crossing; zero leaves it open
    left: Array  # (4, 2) x, x_dot, x_ddot, jerk at the crossing that a leg leaves
    reached: Array  # (4, 2) at the crossing that a leg reaches
    limits: Limits


class Halves(NamedTuple):
    """Two polynomials in the time from a crossing; the one that runs backwards has a negative span."""

    first: Array  # (10, 2) by rising power
    first_span: float  # s
    second: Array
    second_span: float


class Instant(NamedTuple):
    """What one instant asks of the robot."""

    reached: bool
    elbow: float  # larger |cos| of the legs' elbow angles; above 1 when a leg does not reach
    s: float
    tau: tuple[float, float]  # N m, by Eq. 4
    joint_speed: float  # the faster joint's, rad/s


@njit
def half(state: Array, end: Array, span: float, bends: Array) -> Array:
    """Coefficients (10, 2) from state (4, 2) at time 0 to end (4, 2) at ``span``, s (may be < 0).

    Args:
        state, end: rows x, x_dot, x_ddot, jerk.
        bends: (2, 2) heights of the bumps, m, one row a bump.
    """
    coefficients = np.empty((ROWS, 2))
    power2, power3 = span * span, span * span * span
    for axis in range(2):
        c1, c2, c3 = state[1, axis] * span, 0.5 * state[2, axis] * power2, state[3, axis] * power3 / 6.0
        lack0 = end[0, axis] - state[0, axis] - c1 - c2 - c3
        lack1 = end[1, axis] * span - c1 - 2.0 * c2 - 3.0 * c3
        lack2 = end[2, axis] * power2 - 2.0 * c2 - 6.0 * c3
        lack3 = end[3, axis] * power3 - 6.0 * c3
        power = power2 * power2
        for row in range(6):
            value = bends[0, axis] * _BUMP[0, row] + bends[1, axis] * _BUMP[1, row]
            if row < 4:
                value += _END[row, 0] * lack0 + _END[row, 1] * lack1 + _END[row, 2] * lack2 + _END[row, 3] * lack3
            coefficients[4 + row, axis] = value / power
            power *= span
        coefficients[0, axis] = state[0, axis]
        coefficients[1, axis] = state[1, axis]
        coefficients[2, axis] = 0.5 * state[2, axis]
        coefficients[3, axis] = state[3, axis] / 6.0
    return coefficients


@njit
def crossing_acceleration(model: Model, x: Array, x_dot: Array, free: float, full: bool) -> Array:
    """x_ddot (2,) with t_s.w_d = 0 and ``free`` along v_1, or, when ``full``, with w_d = 0 altogether."""
    kin = state_of_platform(model, x, x_dot)
    vectors = singular_values(kin.A_r)
    if not full:
        partial = free * vectors.v1
        _, w_d = wrenches(model, kin, partial)
        along = vectors.v2[0] * w_d[0] + vectors.v2[1] * w_d[1]
        return partial - along / model.M_x * vectors.v2
    terms = inertia(model, kin)
    _, w_d = wrenches(model, kin, np.zeros(2))
    matrix = terms.M_ax.T @ kin.J_inv
    matrix[0, 0] += terms.M_x
    matrix[1, 1] += terms.M_x
    determinant = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    return -np.array(
        [
            (matrix[1, 1] * w_d[0] - matrix[0, 1] * w_d[1]) / determinant,
            (-matrix[1, 0] * w_d[0] + matrix[0, 0] * w_d[1]) / determinant,
        ]
    )


@njit
def crossing_state(model: Model, task: Task, z: Array) -> Array:
    """State (4, 2) at the crossing of a candidate."""
    state = np.empty((4, 2))
    unit = task.length / task.duration
    state[0] = locus_position(model, task.family, task.branch, z[4])[1:3]
    state[1] = z[6:8] * unit
    if task.towards[0] != 0.0 or task.towards[1] != 0.0:
        state[1] = task.towards * (z[6] * unit)
    state[2] = crossing_acceleration(model, state[0], state[1], z[8] * unit / task.duration, task.full)
    state[3] = z[9:11] * (unit / task.duration**2)
    return state


@njit
def halves(model: Model, task: Task, z: Array) -> Halves:
    """Both halves of a candidate.

    Args:
        z: (20,), lengths over ``task.length`` and times over ``task.duration``. Of a crossing: start, goal, tracing angle
            on the locus, fraction of the time before the crossing, velocity (or speed and one unused), acceleration
            along v_1, jerk, one unused, bends of the first half and of the second. Of a leg: the state where its halves
            meet, two unused, logarithms of the spans, bends.
    """
    bends = z[12:20].reshape(4, 2) * task.length
    end = np.zeros((4, 2))
    if task.leg:
        scale = task.length
        for row in range(4):
            end[row] = z[2 * row : 2 * row + 2] * scale
            scale /= task.duration
        span, back = np.exp(min(z[10], SPAN_MOST)) * task.duration, -np.exp(min(z[11], SPAN_MOST)) * task.duration
        return Halves(half(task.left, end, span, bends[:2]), span, half(task.reached, end, back, bends[2:]), back)
    state = crossing_state(model, task, z)
    before = min(max(z[5], SPLIT_LEAST), 1.0 - SPLIT_LEAST) * task.duration
    end[0] = z[0:2] * task.length
    first = half(state, end, -before, bends[:2])
    end[0] = z[2:4] * task.length
    return Halves(first, -before, half(state, end, task.duration - before, bends[2:]), task.duration - before)


@njit
def instant(model: Model, point: Array) -> Instant:
    """Inverse dynamics of rows x, x_dot, x_ddot (3, 2) in scalars: the search's inner loop."""
    x, y, vx, vy, ax, ay = point[0, 0], point[0, 1], point[1, 0], point[1, 1], point[2, 0], point[2, 1]
    worst = 0.0
    for i in range(2):
        dx, dy, l1, l2 = x - model.base[i, 0], y - model.base[i, 1], model.l1[i], model.l2[i]
        worst = max(worst, abs(dx * dx + dy * dy - l1 * l1 - l2 * l2) / (2.0 * l1 * l2))
    if not worst < 1.0:
        return Instant(False, worst, 0.0, (0.0, 0.0), 0.0)
    w0 = model.M_x * ax - model.platform_mass * model.gravity[0]
    w1 = model.M_x * ay - model.platform_mass * model.gravity[1]
    rx, ry, B, base_torque, fastest = (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), 0.0
    for i in range(2):
        dx, dy, l1, l2 = x - model.base[i, 0], y - model.base[i, 1], model.l1[i], model.l2[i]
        distance = np.sqrt(dx * dx + dy * dy)
        cosine = (distance * distance + l1 * l1 - l2 * l2) / (2.0 * l1 * distance)
        sine = model.working_mode[i] * np.sqrt(max(1.0 - cosine * cosine, 0.0))
        ux, uy = (dx * cosine - dy * sine) / distance, (dy * cosine + dx * sine) / distance
        r_x, r_y = dx - l1 * ux, dy - l1 * uy
        b_i = -l1 * (r_y * ux - r_x * uy)
        speed = -(r_x * vx + r_y * vy) / b_i
        slip_x, slip_y = vx + l1 * uy * speed, vy - l1 * ux * speed
        bias = slip_x * slip_x + slip_y * slip_y + speed * speed * l1 * (r_x * ux + r_y * uy)
        acceleration = -(r_x * ax + r_y * ay + bias) / b_i
        coupling = model.m_Px[i] * l1
        w0 += -coupling * (uy * acceleration + ux * speed * speed)
        w1 += coupling * (ux * acceleration - uy * speed * speed)
        torque = model.M_a[i] * acceleration + coupling * (ux * ay - uy * ax)
        torque -= model.joint_moment[i] * (model.gravity[1] * ux - model.gravity[0] * uy)
        torque += model.viscous[i] * speed
        if model.coulomb[i] > 0.0:
            torque += model.coulomb[i] * np.tanh(speed / model.coulomb_speed)
        fastest = max(fastest, abs(speed))
        if i == 0:
            rx, ry, B, base_torque = (r_x, 0.0), (r_y, 0.0), (b_i, 0.0), (torque, 0.0)
        else:
            rx, ry, B, base_torque = (rx[0], r_x), (ry[0], r_y), (B[0], b_i), (base_torque[0], torque)
    determinant = rx[0] * ry[1] - ry[0] * rx[1]
    tau = (
        base_torque[0] - B[0] * (ry[1] * w0 - rx[1] * w1) / determinant,
        base_torque[1] - B[1] * (rx[0] * w1 - ry[0] * w0) / determinant,
    )
    return Instant(True, worst, determinant / (model.l2[0] * model.l2[1]), tau, fastest)


@njit
def cost(model: Model, task: Task, z: Array) -> float:
    """What a candidate costs: its peak torque, its time near the locus, and what it breaks."""
    limits = task.limits
    pair = halves(model, task, z)
    if not np.isfinite(pair.first[9, 0] + pair.second[9, 0]):
        return IMPOSSIBLE
    elbow_limit = np.sqrt(max(1.0 - limits.type1**2, 0.0))
    peak, near_time, broken, total = 0.0, 0.0, 0.0, 0.0
    for side in range(2):
        span = pair.first_span if side == 0 else pair.second_span
        coefficients = pair.first if side == 0 else pair.second
        wanted = -task.sign if side == 0 and not task.leg else task.sign
        for k in range(HALF_SAMPLES + 1):
            share = (k + 0.5) / HALF_SAMPLES if k < HALF_SAMPLES else 1.0
            fraction = share * (DENSITY + (1.0 - DENSITY) * share * share)
            step = abs(span) * (DENSITY + 3.0 * (1.0 - DENSITY) * share * share) / HALF_SAMPLES
            point = evaluate_segment(coefficients, fraction * span)
            at = instant(model, point)
            if at.elbow > elbow_limit:
                broken += 100.0 * (at.elbow - elbow_limit)
            if not at.reached:
                broken += UNREACHABLE / HALF_SAMPLES
                continue
            s = wanted * at.s
            if k == HALF_SAMPLES:
                broken += 20.0 * max(0.0, limits.end_s - s)
                continue
            broken += 10.0 * max(0.0, min(0.3 * fraction, 0.1) - s)
            near = np.exp(-((s / NEAR) ** 2))
            near_time += near * step
            weight = (1.0 + NEAR_EMPHASIS * near) / limits.torque
            peak += step * ((weight * at.tau[0]) ** SOFT_MAXIMUM + (weight * at.tau[1]) ** SOFT_MAXIMUM)
            total += step
            speed = np.sqrt(point[1, 0] ** 2 + point[1, 1] ** 2)
            broken += max(0.0, speed / limits.platform_speed - SPEED_SHARE)
            broken += max(0.0, at.joint_speed / limits.joint_speed - SPEED_SHARE)
    found = (peak / max(total, 1e-9)) ** (1.0 / SOFT_MAXIMUM) + limits.near_weight * near_time / limits.near_time + broken
    if task.leg:
        found += 10.0 * (max(0.0, abs(z[10]) - SPAN_MOST) + max(0.0, abs(z[11]) - SPAN_MOST))
        found += (abs(pair.first_span) + abs(pair.second_span)) / limits.time
    else:
        found += 10.0 * max(0.0, abs(z[5] - 0.5) - (0.5 - SPLIT_LEAST))
    return found if np.isfinite(found) else IMPOSSIBLE


@njit
def cost_and_gradient(model: Model, task: Task, z: Array, free: Array) -> tuple[float, Array]:
    """``cost`` and its central differences over the variables at the indices ``free``."""
    count = free.shape[0]
    values = np.empty(2 * count + 1)
    moved = z.copy()
    for k in range(2 * count + 1):
        if k < 2 * count:
            moved[free[k // 2]] = z[free[k // 2]] + (DIFFERENCE if k % 2 == 0 else -DIFFERENCE)
        values[k] = cost(model, task, moved)
        if k < 2 * count:
            moved[free[k // 2]] = z[free[k // 2]]
    return values[2 * count], (values[0 : 2 * count : 2] - values[1 : 2 * count : 2]) / (2.0 * DIFFERENCE)
