"""Cartesian computed-torque laws: an auxiliary acceleration u, turned into input torques.

All three share u = x_ddot_ref + K_d e_dot + K_p e + K_i int(e) and the wrenches w_b, w_d that u asks
for. They differ in lambda, the multipliers with w_d = A_r^T lambda, where A_r loses rank:

- ``classic``: lambda = A_r^-T w_d everywhere (Eq. 4). Grows as 1/s under any tracking error.
- ``projected``: the paper. In a band around the locus w_u is projected on the image of A_r^T and the
  torque of least norm (Eq. 9) is taken: bounded, but the torque jumps at the band's edges.
- ``consistent``: ours. With A_r = U S V^T the strong direction follows the feedback everywhere; along
  the weak one the multiplier that the trajectory itself needs (finite on the locus when the criterion
  holds) takes over smoothly, so that nothing jumps and no internal force is lost.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from dextar_control.core.compiled import njit
from dextar_control.core.dynamics import multipliers, wrenches
from dextar_control.core.kinematics import Kinematics, singular_values, singular_vectors, singularity
from dextar_control.core.model import Array, Model


class Law(IntEnum):
    """Which multipliers near the locus."""

    CLASSIC = 0
    PROJECTED = 1
    CONSISTENT = 2


class Enforcement(NamedTuple):
    """Input torque of one tick and what the enforcement of the criterion did to it."""

    tau: Array  # (2,) N m, before friction and saturation
    residual: float  # t_s.w_d that u asks for, N: what the enforcement takes away on the locus
    s: float  # singularity measure at the estimate
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
        kin: estimated state.
        u: (2,) m/s^2.
        lambda_ref: (2,) multipliers of the reference, N/m.
        law: a ``Law``.
        zone: |s| in the middle of the transition (``projected``: the band's edge).
        width: of the transition in |s|.
    """
    w_b, w_d = wrenches(model, kin, u)
    A = singular_values(kin.A_r)
    s = singularity(model, kin.A_r)
    strong = (A.v1[0] * w_d[0] + A.v1[1] * w_d[1]) / A.sigma1
    residual = A.v2[0] * w_d[0] + A.v2[1] * w_d[1]
    sigma_min = abs(A.sigma2) / np.sqrt(model.l2[0] * model.l2[1])
    if law == 0:
        return Enforcement(w_b - kin.B * multipliers(kin, w_d), residual, s, sigma_min, 1.0)
    if law == 1:
        if abs(s) > zone:
            return Enforcement(w_b - kin.B * multipliers(kin, w_d), residual, s, sigma_min, 1.0)
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
