"""Platform state by the direct geometric model, the paper's estimator, with its precautions (section 4.2).

Away from the locus the direct model gives the platform. Near it that amplifies any joint error along
t_s and, at folded points, does not exist. The precautions:

- the joint angles are filtered about the reference's own motion, which gives a velocity usable with a
  quantised encoder without the lag of a plain filter;
- inside the zone the direct model is not called: the strong direction of J_inv is corrected from the
  joints, the weak one follows the reference;
- after the zone the direct model takes over again over a time, on the assembly mode behind the crossing;
- the direct model's root is clamped at zero, its branch is chosen by the assembly mode, which changes
  only where the reference crosses: noise can flip neither.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dextar_control.core.compiled import njit
from dextar_control.core.kinematics import (
    Kinematics,
    direct_geometric_model,
    inverse_geometric_model,
    kinematics,
    singular_vectors,
)
from dextar_control.core.law import smooth_step
from dextar_control.core.model import Array, Model

REFINEMENTS = 2  # Newton steps of the strong direction inside the zone


class JointMemory(NamedTuple):
    """The joint filter's state, changed in place."""

    q: Array  # (2,) filtered angle, rad
    q_dot: Array  # (2,) filtered velocity, rad/s
    q_ref: Array  # (2,) reference at the last sample, rad
    q_ref_dot: Array  # (2,) rad/s


class Estimate(NamedTuple):
    """Platform state."""

    x: Array  # (2,) m
    x_dot: Array  # (2,) m/s


@njit
def wrap(angle: float) -> float:
    """An angle difference in [-pi, pi), rad."""
    return angle - 2.0 * np.pi * np.floor((angle + np.pi) / (2.0 * np.pi))


@njit
def filter_joints(
    memory: JointMemory, q_meas: Array, q_ref: Array, q_ref_dot: Array, dt: float, bandwidth: float
) -> None:
    """One step of a critically damped second-order tracker of q_meas - q_ref.

    Args:
        q_meas: (2,) rad, on any turn.
        q_ref, q_ref_dot: (2,) of the reference now.
        dt: since the last sample, s.
        bandwidth: rad/s.
    """
    decay = np.exp(-bandwidth * dt)
    for i in range(2):
        error_dot = memory.q_dot[i] - memory.q_ref_dot[i]
        predicted = memory.q[i] + wrap(q_ref[i] - memory.q_ref[i]) + dt * error_dot
        innovation = wrap(q_meas[i] - predicted)
        memory.q[i] = predicted + (1.0 - decay * decay) * innovation
        memory.q_dot[i] = q_ref_dot[i] + error_dot + (1.0 - decay) ** 2 / dt * innovation
        memory.q_ref[i] = q_ref[i]
        memory.q_ref_dot[i] = q_ref_dot[i]


@njit
def held_estimate(model: Model, memory: JointMemory, reference: Kinematics) -> Estimate:
    """The reference, corrected along the strong direction of J_inv so that the joints agree there."""
    x = reference.x.copy()
    x_dot = reference.x_dot.copy()
    towards = np.array([-reference.A_r[0, 1], reference.A_r[0, 0]])
    J = singular_vectors(reference.J_inv, towards)
    for _ in range(REFINEMENTS):
        q_a = inverse_geometric_model(model, x)
        correction = (J.u1[0] * wrap(memory.q[0] - q_a[0]) + J.u1[1] * wrap(memory.q[1] - q_a[1])) / J.sigma1
        x = x + correction * J.v1
    kin = kinematics(model, inverse_geometric_model(model, x), x, x_dot)
    J = singular_vectors(kin.J_inv, towards)
    missing = memory.q_dot - kin.q_a_dot
    x_dot = x_dot + (J.u1[0] * missing[0] + J.u1[1] * missing[1]) / J.sigma1 * J.v1
    return Estimate(x, x_dot)


@njit
def direct_estimate(model: Model, memory: JointMemory, assembly_mode: float) -> Estimate:
    """The direct model and its velocity, x_dot = J_inv^-1 q_a_dot."""
    x = direct_geometric_model(model, memory.q, assembly_mode)
    J = kinematics(model, memory.q, x, np.zeros(2)).J_inv
    determinant = J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]
    q_dot = memory.q_dot
    x_dot = np.array(
        [
            (J[1, 1] * q_dot[0] - J[0, 1] * q_dot[1]) / determinant,
            (-J[1, 0] * q_dot[0] + J[0, 0] * q_dot[1]) / determinant,
        ]
    )
    return Estimate(x, x_dot)


@njit
def estimate_platform(
    model: Model, memory: JointMemory, reference: Kinematics, s_ref: float, zone: float, width: float,
    time_outside: float, time_return: float, assembly_mode: float,
) -> Estimate:  # fmt: skip
    """Platform state (2,), (2,) from the filtered joints.

    Args:
        reference: state of the reference now.
        s_ref: its singularity measure.
        zone: |s| below which the direct model is not called; 0 for the plain direct model.
        width: of the transition outside the zone, in |s|.
        time_outside: since the reference left the zone, s.
        time_return: over which the direct model takes over again, s.
        assembly_mode: sign of s.
    """
    trust = smooth_step(abs(s_ref), zone, zone + width) * smooth_step(time_outside, 0.0, time_return)
    if zone <= 0.0:
        trust = 1.0
    if trust <= 0.0:
        return held_estimate(model, memory, reference)
    direct = direct_estimate(model, memory, assembly_mode)
    if trust >= 1.0:
        return direct
    held = held_estimate(model, memory, reference)
    return Estimate(held.x + trust * (direct.x - held.x), held.x_dot + trust * (direct.x_dot - held.x_dot))
