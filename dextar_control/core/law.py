"""Laws: from an error to input torques through a configuration where A_r loses rank.

The Cartesian laws ask for the platform acceleration u = x_ddot_ref + K_d e_dot + K_p e + K_i int(e)
(section 3) at the estimated state, which takes the wrenches w_b and w_d; then tau = w_b - B^T lambda
(Eq. 1). They differ in lambda, the multipliers with w_d = A_r^T lambda; A_r = U S V^T:

- ``classic``: lambda = A_r^-T w_d everywhere (Eq. 4). Grows as 1/s under any tracking error.
- ``projected``: the paper. Within |s| < band w_u is projected on the image of A_r^T and the torque of
  least norm is taken (Eq. 9, with J_inv of rank one in the whole band as it is on the locus): bounded, but it
  jumps at the band's edges, where the internal force along the distal links is dropped.
- ``consistent``: ours. lambda = u1 (v1.w_d)/sigma1 + u2 [(1 - phi) u2.lambda_ref + phi (v2.w_d)/sigma2], phi
  rising from 0 to 1 over |s| = zone -+ width/2. The strong direction follows the feedback everywhere; along
  the weak one the multiplier that the trajectory itself needs (finite on the locus when the criterion
  holds) takes over, so that nothing jumps and no internal force is lost. Its limit: along t_s there is
  no feedback inside the zone, where no torque could give any.
- ``multi_model``: the paper's [10]. Within |s| < band the reduced model tau = w_b of w_d = 0, in the joints:
  q_a_ddot = q_a_ddot_ref + K_d e_q_dot + K_p e_q; Eq. (4) outside. Needs trajectories planned for w_d = 0; the
  models differ at the band's edge by what w_d is there, and w_d = 0 depends on how L was written.
- ``joint_space``: the paper's future work, without any platform estimate. Matrices are taken on the reference;
  the joint acceleration a = K_d e_q_dot + K_p e_q is split by J_inv = U S V^T: its part along u1 is realised
  everywhere, its part along u2 fades with phi, because no finite platform acceleration gives it on the
  locus; u = x_ddot_ref + v1 (u1.a)/sigma1 + phi v2 (u2.a)/sigma2, then ``consistent``'s multipliers. What can be shown:
  with an exact model the error along u1 obeys e_ddot + K_d e_dot + K_p e = 0 everywhere but for a hundredth or so
  of the feedback (how the matrices change with the error), about a point at rest outside the zone both do to
  first order; inside, the platform's error along t_s only coasts, and the law never knows it.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from dextar_control.core.compiled import njit
from dextar_control.core.dynamics import friction, inertia, joint_acceleration, multipliers, wrenches
from dextar_control.core.kinematics import Kinematics, singular_values, singular_vectors, singularity, state_of_platform
from dextar_control.core.model import Array, Model, unpack


class Law(IntEnum):
    """Which torques near the locus."""

    CLASSIC = 0
    PROJECTED = 1
    CONSISTENT = 2
    MULTI_MODEL = 3
    JOINT_SPACE = 4


CLASSIC, PROJECTED, CONSISTENT, MULTI_MODEL, JOINT_SPACE = (int(law) for law in Law)  # as the compiled code sees them


class Enforcement(NamedTuple):
    """Input torque of one tick and what the enforcement of the criterion did to it."""

    tau: Array  # (2,) N m, before friction and saturation
    residual: float  # t_s.w_d that u asks for, N: what the enforcement takes away on the locus
    s: float  # singularity measure at the state of the model
    sigma_min: float  # smallest singular value of A_r over the distal length
    weight: float  # 1 where the weak direction follows the feedback, 0 where it follows the plan


@njit
def smooth_step(value: float, low: float, high: float) -> float:
    """0 below low, 1 above high, a quintic with two zero derivatives at both ends between."""
    if high <= low:
        return 1.0 if value >= high else 0.0
    z = min(max((value - low) / (high - low), 0.0), 1.0)
    return z * z * z * (10.0 + z * (6.0 * z - 15.0))


@njit
def enforce(
    model: Model, kin: Kinematics, u: Array, lambda_ref: Array, law: int, zone: float, width: float
) -> Enforcement:
    """Input torque (2,) that gives the platform the acceleration u as far as the criterion allows.

    Args:
        kin: the state whose matrices are used.
        u: (2,) m/s^2.
        lambda_ref: (2,) multipliers of the reference, N/m.
        law: a ``Law``; those in the joints have ``consistent``'s multipliers.
        zone: |s| in the middle of the transition; for ``projected`` and ``multi_model`` the band's edge.
        width: of the transition in |s|.
    """
    w_b, w_d = wrenches(model, kin, u)
    A = singular_values(kin.A_r)
    s = singularity(model, kin.A_r)
    strong = (A.v1[0] * w_d[0] + A.v1[1] * w_d[1]) / A.sigma1
    residual = A.v2[0] * w_d[0] + A.v2[1] * w_d[1]
    sigma_min = abs(A.sigma2) / np.sqrt(model.l2[0] * model.l2[1])
    if law == CLASSIC or ((law == PROJECTED or law == MULTI_MODEL) and abs(s) > zone):
        return Enforcement(w_b - kin.B * multipliers(kin, w_d), residual, s, sigma_min, 1.0)
    if law == PROJECTED:
        projected = w_d - residual * A.v2
        J = singular_vectors(kin.J_inv, A.v2)
        force = kin.J_inv.T @ w_b + projected
        tau = J.u1 * ((J.v1[0] * force[0] + J.v1[1] * force[1]) / J.sigma1)
        return Enforcement(tau, residual, s, sigma_min, 0.0)
    weight = smooth_step(abs(s), zone - 0.5 * width, zone + 0.5 * width)
    weak = (1.0 - weight) * (A.u2[0] * lambda_ref[0] + A.u2[1] * lambda_ref[1])
    if weight > 0.0:
        weak += weight * residual / A.sigma2
    lam = strong * A.u1 + weak * A.u2
    return Enforcement(w_b - kin.B * lam, residual, s, sigma_min, weight)


@njit
def reduced_model(model: Model, kin: Kinematics, q_a_ddot: Array, x_ddot: Array) -> Array:
    """Input torque (2,) where w_d = 0: tau = w_b of given joint and platform accelerations (Eq. 10)."""
    terms = inertia(model, kin)
    return terms.M_a * q_a_ddot + terms.M_ax @ x_ddot + terms.c_a


@njit
def joint_feedback(reference: Kinematics, a: Array, weight: float) -> Array:
    """Platform acceleration (2,) that realises the joint acceleration a (2,): along u2 only by ``weight``."""
    J = singular_vectors(reference.J_inv, np.array([-reference.A_r[0, 1], reference.A_r[0, 0]]))
    u = J.v1 * ((J.u1[0] * a[0] + J.u1[1] * a[1]) / J.sigma1)
    if weight > 0.0:
        u = u + J.v2 * (weight * (J.u2[0] * a[0] + J.u2[1] * a[1]) / J.sigma2)
    return u


class Gains(NamedTuple):
    """What the law takes of the settings."""

    K_p: float
    K_d: float
    K_i: float
    zone: float
    zone_width: float
    friction_compensation: float


X_REF, Q_REF, S_REF, LAMBDA_REF, REFERENCE = 0, 6, 10, 11, 13
"""Rows of a reference: x, x_dot, x_ddot; q_a, q_a_dot; s; lambda; its size."""
X_HAT, Q_HAT, MODE_HAT, CONFIDENCE, ESTIMATE = 0, 4, 8, 9, 10
"""Rows of an estimate: x, x_dot; q_a, q_a_dot; assembly mode and how sure; its size."""
TAU, ERROR, U, FORCE, SCALARS, FINITE, OUTPUT = 0, 2, 6, 8, 10, 14, 15
"""Rows of an output: torque; e, e_dot; u; J_inv^T tau; residual, s, sigma_min, weight; all finite; its size."""


@njit
def control(
    packed: Array, gains: Gains, law: int, reference: Array, estimate: Array, integral: Array, limit: float, dt: float,
    out: Array,
) -> None:  # fmt: skip
    """One tick of a law: from a reference and an estimate to a saturated torque, written into ``out``.

    Args:
        packed: the model.
        integral: (2,) of the platform error, m s, changed in place outside the transition.
        limit: of each torque, N m.
        dt: since the last tick, s.
    """
    model = unpack(packed)
    error = reference[X_REF : X_REF + 2] - estimate[X_HAT : X_HAT + 2]
    error_dot = reference[X_REF + 2 : X_REF + 4] - estimate[X_HAT + 2 : X_HAT + 4]
    x_ddot_ref = reference[X_REF + 4 : X_REF + 6]
    lambda_ref = reference[LAMBDA_REF : LAMBDA_REF + 2]
    kin = state_of_platform(model, estimate[X_HAT : X_HAT + 2], estimate[X_HAT + 2 : X_HAT + 4])
    if abs(reference[S_REF]) > gains.zone + gains.zone_width:
        integral += dt * error
    u = x_ddot_ref + gains.K_d * error_dot + gains.K_p * error + gains.K_i * integral
    if law == JOINT_SPACE or law == MULTI_MODEL:
        planned = state_of_platform(model, reference[X_REF : X_REF + 2], reference[X_REF + 2 : X_REF + 4])
        a = np.empty(2)
        for i in range(2):
            angle = reference[Q_REF + i] - estimate[Q_HAT + i]
            angle -= 2.0 * np.pi * np.floor((angle + np.pi) / (2.0 * np.pi))
            a[i] = gains.K_p * angle + gains.K_d * (reference[Q_REF + 2 + i] - estimate[Q_HAT + 2 + i])
        if law == JOINT_SPACE:
            kin = planned
            low, high = gains.zone - 0.5 * gains.zone_width, gains.zone + 0.5 * gains.zone_width
            u = x_ddot_ref + joint_feedback(planned, a, smooth_step(abs(reference[S_REF]), low, high))
    enforced = enforce(model, kin, u, lambda_ref, law, gains.zone, gains.zone_width)
    tau, weight = enforced.tau, enforced.weight
    if law == MULTI_MODEL and abs(enforced.s) <= gains.zone:
        tau, weight = reduced_model(model, kin, joint_acceleration(planned, x_ddot_ref) + a, x_ddot_ref), 0.0
    tau = tau + gains.friction_compensation * friction(model, reference[Q_REF + 2 : Q_REF + 4])
    for i in range(2):
        out[TAU + i] = min(max(tau[i], -limit), limit) if np.isfinite(tau[i]) else np.nan
        out[ERROR + i] = error[i]
        out[ERROR + 2 + i] = error_dot[i]
        out[U + i] = u[i]
    for i in range(2):
        out[FORCE + i] = kin.J_inv[0, i] * out[TAU] + kin.J_inv[1, i] * out[TAU + 1]
    out[SCALARS] = enforced.residual
    out[SCALARS + 1] = enforced.s
    out[SCALARS + 2] = enforced.sigma_min
    out[SCALARS + 3] = weight
    out[FINITE] = 1.0 if np.isfinite(out[:FINITE]).all() else 0.0
