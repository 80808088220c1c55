"""Dynamics of the five-bar: Eqs. (1)-(14) of the paper, with two corrections.

The Lagrangian is written in (q_a, x) with each distal rod seen from its two ends, so that
w_b = M_a q_a_ddot + M_ax x_ddot + c_a and w_d = M_ax^T q_a_ddot + M_x x_ddot + c_x.

Note:
    Eq. (10) drops the cross terms M_ax, which do not vanish for links with distributed mass, and
    Eq. (14) as printed misses M_a on B^-1 b. Both are restored here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dextar_control.core.compiled import njit
from dextar_control.core.kinematics import Kinematics, singular_values
from dextar_control.core.model import Array, Model


class Inertia(NamedTuple):
    """Terms of the two wrenches at one state."""

    M_a: Array  # (2,) diagonal, kg m^2
    M_ax: Array  # (2, 2) rows m_Px l1 n_i, kg m
    M_x: float  # kg, times the identity
    c_a: Array  # (2,) N m
    c_x: Array  # (2,) N


@njit
def inertia(model: Model, kin: Kinematics) -> Inertia:
    """M_a, M_ax, M_x, c_a, c_x at one state (Eq. 10 with its cross terms)."""
    M_ax = np.empty((2, 2))
    c_a = np.empty(2)
    c_x = -model.platform_mass * model.gravity
    for i in range(2):
        coupling = model.m_Px[i] * model.l1[i]  # kg m
        M_ax[i, 0] = coupling * kin.n[i, 0]
        M_ax[i, 1] = coupling * kin.n[i, 1]
        weight = model.gravity[0] * kin.n[i, 0] + model.gravity[1] * kin.n[i, 1]  # m/s^2
        c_a[i] = -model.joint_moment[i] * weight
        c_x[0] -= coupling * kin.u[i, 0] * kin.q_a_dot[i] ** 2
        c_x[1] -= coupling * kin.u[i, 1] * kin.q_a_dot[i] ** 2
    return Inertia(model.M_a, M_ax, model.M_x, c_a, c_x)


@njit
def joint_acceleration(kin: Kinematics, x_ddot: Array) -> Array:
    """q_a_ddot (2,) of a platform acceleration (Eq. 12)."""
    return apply(kin.J_inv, x_ddot) + kin.g


@njit
def wrenches(model: Model, kin: Kinematics, x_ddot: Array) -> tuple[Array, Array]:
    """w_b (2,), N m, and w_d (2,), N, of a platform acceleration (Eqs. 3, 10, 12)."""
    terms = inertia(model, kin)
    q_a_ddot = joint_acceleration(kin, x_ddot)
    w_b = terms.M_a * q_a_ddot + apply(terms.M_ax, x_ddot) + terms.c_a
    w_d = apply(terms.M_ax.T, q_a_ddot) + terms.M_x * x_ddot + terms.c_x
    return w_b, w_d


@njit
def friction(model: Model, q_a_dot: Array) -> Array:
    """Friction torque of the active joints (2,), N m, opposing q_a_dot."""
    return model.viscous * q_a_dot + model.coulomb * np.tanh(q_a_dot / model.coulomb_speed)


@njit
def multipliers(kin: Kinematics, w_d: Array) -> Array:
    """lambda (2,), N/m, with w_d = A_r^T lambda (Eq. 1); grows as 1/s unless the criterion holds."""
    A_r = kin.A_r
    determinant = A_r[0, 0] * A_r[1, 1] - A_r[0, 1] * A_r[1, 0]
    return np.array(
        [
            (A_r[1, 1] * w_d[0] - A_r[1, 0] * w_d[1]) / determinant,
            (-A_r[0, 1] * w_d[0] + A_r[0, 0] * w_d[1]) / determinant,
        ]
    )


@njit
def inverse_dynamics(model: Model, kin: Kinematics, x_ddot: Array) -> Array:
    """tau (2,), N m, by Eq. (4): w_b - B^T A_r^-T w_d. Valid off the locus."""
    w_b, w_d = wrenches(model, kin, x_ddot)
    return w_b - kin.B * multipliers(kin, w_d) + friction(model, kin.q_a_dot)


@njit
def platform_dynamics(model: Model, kin: Kinematics) -> tuple[Array, Array]:
    """Mass matrix (2, 2), kg, and bias (2,), N, of the dynamics in platform coordinates.

    mass x_ddot + bias = J_inv^T (tau - friction), mass = J^T M_a J + J^T M_ax + M_ax^T J + M_x:
    positive definite and regular on the Type 2 locus.
    """
    terms = inertia(model, kin)
    J, M_ax = kin.J_inv, terms.M_ax
    mass = np.zeros((2, 2))
    bias = terms.c_x.copy()
    for i in range(2):
        mass[i, i] = terms.M_x
    for leg in range(2):
        joint = terms.M_a[leg] * kin.g[leg] + terms.c_a[leg]  # N m
        for i in range(2):
            for j in range(2):
                mass[i, j] += J[leg, i] * terms.M_a[leg] * J[leg, j] + J[leg, i] * M_ax[leg, j] + M_ax[leg, i] * J[leg, j]
            bias[i] += J[leg, i] * joint + M_ax[leg, i] * kin.g[leg]
    return mass, bias


@njit
def inverse(matrix: Array) -> Array:
    """Of a regular 2 x 2 matrix."""
    determinant = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    found = np.empty((2, 2))
    found[0, 0], found[0, 1] = matrix[1, 1] / determinant, -matrix[0, 1] / determinant
    found[1, 0], found[1, 1] = -matrix[1, 0] / determinant, matrix[0, 0] / determinant
    return found


@njit
def apply(matrix: Array, vector: Array) -> Array:
    """2 x 2 matrix times vector (2,), without the call of a library."""
    product = np.empty(2)
    product[0] = matrix[0, 0] * vector[0] + matrix[0, 1] * vector[1]
    product[1] = matrix[1, 0] * vector[0] + matrix[1, 1] * vector[1]
    return product


@njit
def forward_dynamics(model: Model, kin: Kinematics, tau: Array) -> Array:
    """x_ddot (2,), m/s^2, under the input torques; regular on the Type 2 locus."""
    mass, bias = platform_dynamics(model, kin)
    return apply(inverse(mass), apply(kin.J_inv.T, tau - friction(model, kin.q_a_dot)) - bias)


@njit
def criterion(model: Model, kin: Kinematics, x_ddot: Array) -> float:
    """t_s.w_d, N (Eq. 5), with t_s the weak right singular vector of A_r, its kernel on the locus."""
    _, w_d = wrenches(model, kin, x_ddot)
    t_s = singular_values(kin.A_r).v2
    return t_s[0] * w_d[0] + t_s[1] * w_d[1]


@njit
def criterion_acceleration(model: Model, kin: Kinematics, free: float) -> Array:
    """The platform acceleration (2,) with t_s.w_d = 0 and a given component normal to t_s.

    Along t_s the joints do not move (J_inv t_s = 0 on the locus), so that component of w_d is
    M_x times the acceleration there: always solvable.

    Args:
        kin: a state on the locus.
        free: acceleration along v_1, the direction normal to t_s, m/s^2.
    """
    vectors = singular_values(kin.A_r)
    partial = free * vectors.v1
    _, w_d = wrenches(model, kin, partial)
    along = vectors.v2[0] * w_d[0] + vectors.v2[1] * w_d[1]
    return partial - along / model.M_x * vectors.v2


def inverse_dynamics_minimum_norm(model: Model, kin: Kinematics, x_ddot: Array) -> Array:
    """tau (2,), N m, by Eq. (14) corrected: M x_ddot + h with the Moore-Penrose inverse of J_inv^T.

    Equal to ``inverse_dynamics`` off the locus. On it, this is the torque of least norm, which is not
    the limit of Eq. (4): the internal force along the distal links is lost.
    """
    mass, bias = platform_dynamics(model, kin)
    pseudo_inverse = np.linalg.pinv(kin.J_inv.T)
    torque: Array = pseudo_inverse @ (mass @ x_ddot + bias) + friction(model, kin.q_a_dot)
    return torque
