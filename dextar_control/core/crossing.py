"""One crossing as numbers: two joined polynomials, and what a candidate costs.

Before and after the crossing the end effector follows a polynomial of degree 7 per coordinate: position,
velocity, acceleration and jerk at the crossing, and rest with zero jerk at the end. Both share the state at
the crossing, so that velocity, acceleration and jerk are continuous there and the torque has its finite limit.
"""

from __future__ import annotations

import numpy as np

from dextar_control.core.compiled import njit
from dextar_control.core.dynamics import friction, inertia, multipliers, wrenches
from dextar_control.core.kinematics import inverse_geometric_model, kinematics, singular_values, singularity
from dextar_control.core.locus import locus_position
from dextar_control.core.model import Array, Model
from dextar_control.core.trajectory import Trajectory, evaluate_segment

_POWERS = np.arange(4.0, 8.0)
_END = np.linalg.inv(
    np.array([_POWERS**0, _POWERS, _POWERS * (_POWERS - 1), _POWERS * (_POWERS - 1) * (_POWERS - 2)])
)  # of the four highest powers, from what position, velocity, acceleration and jerk lack at the end

HALF_SAMPLES = 24  # of each polynomial while optimising, none of them on the locus
SOFT_MAXIMUM = 12.0  # exponent of the mean that stands for the peak torque
NEAR = 0.15  # |s| that counts as near the locus
DIFFERENCE = 1e-6  # of the scaled variables in the gradient
UNREACHABLE = 20.0  # cost of a sample that a leg does not reach, before how far it misses


@njit
def half(x: Array, x_dot: Array, x_ddot: Array, jerk: Array, end: Array, duration: float) -> Array:
    """Coefficients (8, 2) by rising power, from a state at time 0 to rest at ``end`` at ``duration`` (may be < 0)."""
    scaled = np.empty((8, 2))
    coefficients = np.empty((8, 2))
    for axis in range(2):
        c0, c1 = x[axis], x_dot[axis] * duration
        c2, c3 = 0.5 * x_ddot[axis] * duration**2, jerk[axis] * duration**3 / 6.0
        lack = np.array(
            [end[axis] - c0 - c1 - c2 - c3, -c1 - 2.0 * c2 - 3.0 * c3, -2.0 * c2 - 6.0 * c3, -6.0 * c3]
        )
        scaled[0, axis], scaled[1, axis], scaled[2, axis], scaled[3, axis] = c0, c1, c2, c3
        for row in range(4):
            value = 0.0
            for column in range(4):
                value += _END[row, column] * lack[column]
            scaled[4 + row, axis] = value
    power = 1.0
    for row in range(8):
        coefficients[row] = scaled[row] / power
        power *= duration
    coefficients[0] = x
    coefficients[1] = x_dot
    coefficients[2] = 0.5 * x_ddot
    return coefficients


@njit
def crossing_acceleration(model: Model, x: Array, x_dot: Array, free: float, full: bool) -> Array:
    """x_ddot (2,) with t_s.w_d = 0 and ``free`` along v_1, or, when ``full``, with w_d = 0 altogether."""
    kin = kinematics(model, inverse_geometric_model(model, x), x, x_dot)
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
def candidate(
    model: Model, family: float, branch: float, duration: float, length: float, full: bool, z: Array
) -> tuple[Array, Array, float]:
    """Both halves (8, 2) and the time of the crossing, of scaled variables.

    Args:
        z: (12,) start and goal over length (4), tracing angle on the locus, fraction of the time before the crossing,
            velocity (2), acceleration along v_1, jerk (2), in units of length and duration; the last is unused.
    """
    x = locus_position(model, family, branch, z[4])[1:3]
    before = z[5] * duration
    x_dot = z[6:8] * (length / duration)
    x_ddot = crossing_acceleration(model, x, x_dot, z[8] * (length / duration**2), full)
    jerk = z[9:11] * (length / duration**3)
    first = half(x, x_dot, x_ddot, jerk, z[0:2] * length, -before)
    second = half(x, x_dot, x_ddot, jerk, z[2:4] * length, duration - before)
    return first, second, before


@njit
def cost(
    model: Model, family: float, branch: float, duration: float, length: float, full: bool, sign: float,
    limits: Array, z: Array,
) -> float:
    """What a candidate costs: its peak torque, its time near the locus, and what it breaks.

    Args:
        sign: of s after the crossing.
        limits: torque that counts as one, N m; time near the locus that counts as one, s; its weight; joint speed, rad/s;
            platform speed, m/s; distance to Type 1; |s| at both ends.
    """
    first, second, before = candidate(model, family, branch, duration, length, full, z)
    if not np.isfinite(first[7, 0] + second[7, 0]):
        return 1e6
    torque_scale, near_scale, near_weight = limits[0], limits[1], limits[2]
    cosine_limit = np.sqrt(max(1.0 - limits[5] ** 2, 0.0))
    soft_peak, near_time, broken, total = 0.0, 0.0, 0.0, 0.0
    for side in range(2):
        span = -before if side == 0 else duration - before
        coefficients = first if side == 0 else second
        wanted = -sign if side == 0 else sign
        step = abs(span) / HALF_SAMPLES
        for k in range(HALF_SAMPLES + 1):
            fraction = (k + 0.5) / HALF_SAMPLES if k < HALF_SAMPLES else 1.0
            point = evaluate_segment(coefficients, fraction * span)
            missed = 0.0
            for i in range(2):
                dx, dy = point[0, 0] - model.base[i, 0], point[0, 1] - model.base[i, 1]
                l1, l2 = model.l1[i], model.l2[i]
                elbow = abs(dx * dx + dy * dy - l1 * l1 - l2 * l2) / (2.0 * l1 * l2)
                if elbow > cosine_limit:
                    broken += 100.0 * (elbow - cosine_limit)
                if elbow >= 1.0:
                    missed += 1.0
            if missed > 0.0:
                broken += UNREACHABLE * missed / HALF_SAMPLES
                continue
            kin = kinematics(model, inverse_geometric_model(model, point[0]), point[0], point[1])
            s = wanted * singularity(model, kin.A_r)
            if k == HALF_SAMPLES:
                broken += 20.0 * max(0.0, limits[6] - s)
                continue
            broken += 10.0 * max(0.0, min(0.3 * fraction, 0.1) - s)
            near = np.exp(-((s / NEAR) ** 2))
            near_time += near * step
            w_b, w_d = wrenches(model, kin, point[2])
            tau = w_b - kin.B * multipliers(kin, w_d) + friction(model, kin.q_a_dot)
            weight = step * (1.0 + 0.5 * near) ** SOFT_MAXIMUM
            soft_peak += weight * ((tau[0] / torque_scale) ** SOFT_MAXIMUM + (tau[1] / torque_scale) ** SOFT_MAXIMUM)
            total += step
            speed = np.sqrt(point[1, 0] ** 2 + point[1, 1] ** 2)
            broken += max(0.0, speed / limits[4] - 0.95)
            broken += max(0.0, max(abs(kin.q_a_dot[0]), abs(kin.q_a_dot[1])) / limits[3] - 0.95)
    peak = (soft_peak / max(total, 1e-9)) ** (1.0 / SOFT_MAXIMUM)
    return peak + near_weight * near_time / near_scale + broken


@njit
def cost_and_gradient(
    model: Model, family: float, branch: float, duration: float, length: float, full: bool, sign: float,
    limits: Array, z: Array, free: Array,
) -> tuple[float, Array]:
    """``cost`` and its central differences over the variables at the indices ``free``."""
    gradient = np.empty(free.shape[0])
    moved = z.copy()
    for row in range(free.shape[0]):
        index = free[row]
        moved[index] = z[index] + DIFFERENCE
        above = cost(model, family, branch, duration, length, full, sign, limits, moved)
        moved[index] = z[index] - DIFFERENCE
        below = cost(model, family, branch, duration, length, full, sign, limits, moved)
        moved[index] = z[index]
        gradient[row] = (above - below) / (2.0 * DIFFERENCE)
    return cost(model, family, branch, duration, length, full, sign, limits, z), gradient


def joined(first: Array, second: Array, before: float, duration: float) -> Trajectory:
    """Both halves as a trajectory from time 0."""
    return Trajectory(np.array([0.0, before, duration]), np.array([before, before]), np.stack([first, second]))
