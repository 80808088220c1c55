"""The five-bar's numbers as the compiled core takes them: one flat record of arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dextar_control.contract.robot import RobotParameters
from dextar_control.core.compiled import njit

Array = NDArray[np.float64]


class Model(NamedTuple):
    """Lumped parameters of L (see ``dynamics``); index or row i is the leg i (left, right).

    With a distal rod of mass m, centre at the fraction c from its elbow and inertia I about it, seen
    from its two ends P_i and x: T = m_PP/2 |P_dot|^2 + m_Px P_dot.x_dot + m_xx/2 |x_dot|^2.
    """

    base: Array  # (2, 2) motor axes e_i, m
    l1: Array  # (2,) proximal lengths, m
    l2: Array  # (2,) distal lengths, m
    working_mode: Array  # (2,) +1 or -1
    M_a: Array  # (2,) proximal link, rotor and m_PP l1^2 about the motor axis, kg m^2
    m_Px: Array  # (2,) kg
    M_x: float  # sum of m_xx and the end effector, kg
    joint_moment: Array  # (2,) first mass moment about the motor axis, kg m
    platform_mass: float  # mass whose weight acts at x, kg
    gravity: Array  # (2,) m/s^2
    viscous: Array  # (2,) N m s/rad
    coulomb: Array  # (2,) N m
    coulomb_speed: float  # rad/s
    min_type1: float  # least |sin| of an elbow angle


def make_model(robot: RobotParameters) -> Model:
    """The compiled core's record of a robot description."""
    legs = robot.legs

    def column(name: str) -> Array:
        return np.array([getattr(leg, name) for leg in legs], dtype=np.float64)

    l1, l2 = column("proximal_length"), column("distal_length")
    m_p, c_p, i_p = column("proximal_mass"), column("proximal_center"), column("proximal_inertia")
    m_d, c_d, i_d = column("distal_mass"), column("distal_center"), column("distal_inertia")
    m_PP = m_d * (1.0 - c_d) ** 2 + i_d / l2**2  # kg
    m_Px = m_d * c_d * (1.0 - c_d) - i_d / l2**2  # kg
    m_xx = m_d * c_d**2 + i_d / l2**2  # kg
    half = 0.5 * robot.base_distance
    return Model(
        base=np.array([[-half, 0.0], [half, 0.0]]),
        l1=l1,
        l2=l2,
        working_mode=np.array(robot.working_mode, dtype=np.float64),
        M_a=i_p + m_p * (c_p * l1) ** 2 + column("rotor_inertia") + m_PP * l1**2,
        m_Px=m_Px,
        M_x=float(m_xx.sum()) + robot.end_effector_mass,
        joint_moment=m_p * c_p * l1 + m_d * (1.0 - c_d) * l1,
        platform_mass=float((m_d * c_d).sum()) + robot.end_effector_mass,
        gravity=np.array(robot.gravity, dtype=np.float64),
        viscous=column("viscous_friction"),
        coulomb=column("coulomb_friction"),
        coulomb_speed=robot.coulomb_speed,
        min_type1=robot.min_type1_distance,
    )


class JointRange(NamedTuple):
    """Of the active joints, on a circle: a range of a whole turn is no bound."""

    middle: Array  # (2,) rad
    half: Array  # (2,) rad


def joint_range(robot: RobotParameters) -> JointRange:
    """The active joints' range of a robot."""
    low, high = (np.array([getattr(leg, key) for leg in robot.legs]) for key in ("min_angle", "max_angle"))
    return JointRange(0.5 * (low + high), 0.5 * (high - low))


@njit
def beyond_range(bounds: JointRange, q_a: Array) -> Array:
    """How far each active joint (..., 2), rad, on any turn, is outside its range, rad; negative inside."""
    off = q_a - bounds.middle
    off = off - 2.0 * np.pi * np.floor((off + np.pi) / (2.0 * np.pi))
    return np.abs(off) - bounds.half


def pack(model: Model) -> Array:
    """The record as one vector: what a compiled function called at 1 kHz takes instead of fourteen arguments."""
    return np.concatenate([np.ravel(part) for part in model])


@njit
def unpack(packed: Array) -> Model:
    """The record of a packed vector; its arrays are views."""
    v = packed
    return Model(
        v[0:4].reshape(2, 2), v[4:6], v[6:8], v[8:10], v[10:12], v[12:14], v[14], v[15:17], v[17], v[18:20],
        v[20:22], v[22:24], v[24], v[25],
    )  # fmt: skip
