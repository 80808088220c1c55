"""Geometry and first- and second-order kinematics of the five-bar.

Frame: origin midway between the motor axes, x towards the right one. Leg i runs from the motor axis
e_i over the elbow P_i = e_i + l1 u_i to the end effector x, with u_i = (cos q_i, sin q_i),
n_i = (-sin q_i, cos q_i) and r_i = x - P_i, |r_i| = l2.

The compiled functions here do not raise: what does not exist is nan. ``inverse_model`` and
``direct_model`` are their checked counterparts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dextar_control.contract.errors import GeometryError
from dextar_control.core.compiled import njit
from dextar_control.core.model import Array, Model


class Kinematics(NamedTuple):
    """One state of the mechanism: positions, velocities and the matrices of Eqs. (2), (11), (12)."""

    q_a: Array  # (2,) active joints, rad
    x: Array  # (2,) end effector, m
    q_a_dot: Array  # (2,) rad/s
    x_dot: Array  # (2,) m/s
    u: Array  # (2, 2) rows u_i
    n: Array  # (2, 2) rows n_i
    A_r: Array  # (2, 2) rows r_i, m                    Eq. 2
    B: Array  # (2,) diagonal of B, -l1 r_i.n_i, m^2    Eq. 2
    J_inv: Array  # (2, 2) -B^-1 A_r, rad/m             Eq. 8
    b: Array  # (2,) m^2/s^2                            Eq. 11
    g: Array  # (2,) -B^-1 b, rad/s^2                   Eq. 12


class Singular(NamedTuple):
    """A_r = U diag(sigma) V^T with U and V rotations: sigma_2 carries the sign of det A_r.

    On the locus sigma_2 = 0, v_2 = t_s spans the kernel of A_r, and nothing here changes sign or
    jumps there. v_2 is oriented along r_1 turned by +90 degrees.
    """

    u1: Array  # (2,) strong left vector
    u2: Array  # (2,) weak left vector
    sigma1: float  # m
    sigma2: float  # m, signed
    v1: Array  # (2,) strong right vector
    v2: Array  # (2,) weak right vector; t_s on the locus


@njit
def inverse_geometric_model(model: Model, x: Array) -> Array:
    """Active joints (2,) of a platform position in the model's working mode; nan when unreachable."""
    q_a = np.empty(2)
    for i in range(2):
        dx = x[0] - model.base[i, 0]
        dy = x[1] - model.base[i, 1]
        distance2 = dx * dx + dy * dy
        l1, l2 = model.l1[i], model.l2[i]
        cosine = (distance2 + l1 * l1 - l2 * l2) / (2.0 * l1 * np.sqrt(distance2))
        if not abs(cosine) <= 1.0:
            q_a[i] = np.nan
        else:
            angle = np.arctan2(dy, dx) + model.working_mode[i] * np.arccos(cosine)
            q_a[i] = angle - 2.0 * np.pi * np.floor((angle + np.pi) / (2.0 * np.pi))
    return q_a


@njit
def elbows(model: Model, q_a: Array) -> Array:
    """Elbow positions P_i, rows of (2, 2), m."""
    P = np.empty((2, 2))
    for i in range(2):
        P[i, 0] = model.base[i, 0] + model.l1[i] * np.cos(q_a[i])
        P[i, 1] = model.base[i, 1] + model.l1[i] * np.sin(q_a[i])
    return P


@njit
def direct_geometric_model(model: Model, q_a: Array, assembly_mode: float) -> Array:
    """Platform position (2,) with sign(s) = assembly_mode, from the two circles about the elbows.

    On the locus noise can part the circles: the root is clamped at zero there (the point on the line
    of the elbows), never complex. Coinciding elbows (folded) define no point: nan.
    """
    P = elbows(model, q_a)
    dx = P[1, 0] - P[0, 0]
    dy = P[1, 1] - P[0, 1]
    distance = np.sqrt(dx * dx + dy * dy)
    along = 0.5 * (distance + (model.l2[0] ** 2 - model.l2[1] ** 2) / distance)
    height = np.sqrt(max(model.l2[0] ** 2 - along * along, 0.0))
    x = np.empty(2)
    x[0] = P[0, 0] + (along * dx - assembly_mode * height * dy) / distance
    x[1] = P[0, 1] + (along * dy + assembly_mode * height * dx) / distance
    return x


@njit
def kinematics(model: Model, q_a: Array, x: Array, x_dot: Array) -> Kinematics:
    """Matrices of the loop closure at a position (q_a and x given) and a platform velocity."""
    u = np.empty((2, 2))
    n = np.empty((2, 2))
    A_r = np.empty((2, 2))
    B = np.empty(2)
    J_inv = np.empty((2, 2))
    q_a_dot = np.empty(2)
    b = np.empty(2)
    g = np.empty(2)
    for i in range(2):
        cosine, sine = np.cos(q_a[i]), np.sin(q_a[i])
        u[i, 0], u[i, 1] = cosine, sine
        n[i, 0], n[i, 1] = -sine, cosine
        l1 = model.l1[i]
        A_r[i, 0] = x[0] - model.base[i, 0] - l1 * cosine
        A_r[i, 1] = x[1] - model.base[i, 1] - l1 * sine
        B[i] = -l1 * (A_r[i, 0] * n[i, 0] + A_r[i, 1] * n[i, 1])
        J_inv[i, 0] = -A_r[i, 0] / B[i]
        J_inv[i, 1] = -A_r[i, 1] / B[i]
        q_a_dot[i] = J_inv[i, 0] * x_dot[0] + J_inv[i, 1] * x_dot[1]
        vx = x_dot[0] - l1 * n[i, 0] * q_a_dot[i]
        vy = x_dot[1] - l1 * n[i, 1] * q_a_dot[i]
        b[i] = vx * vx + vy * vy + q_a_dot[i] ** 2 * l1 * (A_r[i, 0] * cosine + A_r[i, 1] * sine)
        g[i] = -b[i] / B[i]
    return Kinematics(q_a, x, q_a_dot, x_dot, u, n, A_r, B, J_inv, b, g)


@njit
def singularity(model: Model, A_r: Array) -> float:
    """s = det(A_r) / (l2_1 l2_2): sine of the angle between the distal links, zero on the Type 2 locus."""
    return (A_r[0, 0] * A_r[1, 1] - A_r[0, 1] * A_r[1, 0]) / (model.l2[0] * model.l2[1])


@njit
def type1_distance(model: Model, kin: Kinematics) -> float:
    """Least |sin| of the angle between a leg's proximal and distal link: zero at a Type 1 singularity."""
    return min(abs(kin.B[0]) / (model.l1[0] * model.l2[0]), abs(kin.B[1]) / (model.l1[1] * model.l2[1]))


@njit
def singular_vectors(A: Array, towards: Array) -> Singular:
    """Singular value decomposition of a 2 x 2 matrix in closed form, continuous through rank one.

    Args:
        A: (2, 2).
        towards: (2,) v_2 is oriented so that v_2 . towards >= 0.
    """
    gram_sum = A[0, 0] * A[0, 1] + A[1, 0] * A[1, 1]
    gram_difference = A[0, 0] ** 2 + A[1, 0] ** 2 - A[0, 1] ** 2 - A[1, 1] ** 2
    angle = 0.5 * np.arctan2(2.0 * gram_sum, gram_difference)
    v1 = np.array([np.cos(angle), np.sin(angle)])
    if -v1[1] * towards[0] + v1[0] * towards[1] < 0.0:
        v1 = -v1
    v2 = np.array([-v1[1], v1[0]])
    ax = A[0, 0] * v1[0] + A[0, 1] * v1[1]
    ay = A[1, 0] * v1[0] + A[1, 1] * v1[1]
    sigma1 = np.sqrt(ax * ax + ay * ay)
    u1 = np.array([ax / sigma1, ay / sigma1])
    u2 = np.array([-u1[1], u1[0]])
    sigma2 = (A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]) / sigma1
    return Singular(u1, u2, sigma1, sigma2, v1, v2)


@njit
def singular_values(A_r: Array) -> Singular:
    """Singular vectors of A_r; t_s is ``v2``."""
    return singular_vectors(A_r, np.array([-A_r[0, 1], A_r[0, 0]]))


@njit
def state_of_platform(model: Model, x: Array, x_dot: Array) -> Kinematics:
    """Kinematics of a platform position and velocity in the model's working mode."""
    return kinematics(model, inverse_geometric_model(model, x), x, x_dot)


def inverse_model(model: Model, x: Array) -> Array:
    """Active joints (2,), rad, of the platform position x (2,), m.

    Raises:
        GeometryError: a leg cannot reach x; names the distance and the limits.
    """
    x = np.asarray(x, dtype=np.float64)
    q_a = inverse_geometric_model(model, x)
    if not np.isfinite(q_a).all():
        side = int(not np.isfinite(q_a[1]) and np.isfinite(q_a[0]))
        distance = float(np.hypot(*(x - model.base[side])))
        l1, l2 = model.l1[side], model.l2[side]
        raise GeometryError(
            f"point ({x[0]:.4f}, {x[1]:.4f}) m is {distance:.4f} m from the {('left', 'right')[side]} motor axis; "
            f"the leg reaches {abs(l1 - l2):.4f} to {l1 + l2:.4f} m"
        )
    return q_a


def direct_model(model: Model, q_a: Array, assembly_mode: int) -> Array:
    """Platform position (2,), m, of the active joints q_a (2,), rad, with sign(s) = assembly_mode.

    Raises:
        GeometryError: the distal links cannot meet, or the elbows coincide.
    """
    q_a = np.asarray(q_a, dtype=np.float64)
    P = elbows(model, q_a)
    distance = float(np.hypot(*(P[1] - P[0])))
    low, high = abs(model.l2[0] - model.l2[1]), model.l2[0] + model.l2[1]
    if not low <= distance <= high or distance == 0.0:
        raise GeometryError(f"the elbows are {distance:.6f} m apart; the distal links close {low:.6f} to {high:.6f} m")
    return direct_geometric_model(model, q_a, float(assembly_mode))


def singularity_of_platform(model: Model, x: Array) -> float:
    """s of a platform position in the model's working mode; nan when unreachable."""
    return float(singularity(model, state_of_platform(model, x, np.zeros(2)).A_r))
