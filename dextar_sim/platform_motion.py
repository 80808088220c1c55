"""Equations of motion of the five-bar in platform coordinates, and their fourth-order steps: compiled.

Principle of virtual power with the end effector's position x as the coordinates. Each leg's links turn at
theta_1 (proximal) and theta_2 (distal) from the x axis; u is the unit vector along a link, n = (-u_y, u_x),
delta = theta_2 - theta_1. From x_dot = l1 n_1 theta_1_dot + l2 n_2 theta_2_dot, multiplied by u_2 and u_1:

    theta_1_dot = j_1 . x_dot,  j_1 =  u_2 / (l1 sin delta)
    theta_2_dot = j_2 . x_dot,  j_2 = -u_1 / (l2 sin delta)

and once more for x_ddot, with j_i . x_ddot + g_i for the accelerations. A body of mass m and inertia I whose
centre has the Jacobian J and the velocity-dependent acceleration b adds J^T m J + I j j^T to the platform's
inertia and J^T m (gravity - b) - I j g to its force; a motor adds j_1 tau. The Jacobians are regular where the
distal links are parallel (Type 2) and grow without bound where a leg is stretched or folded (Type 1). Around
such a pose that leg's theta_1, theta_2 are the coordinates z instead: x = x(z), x_ddot = G z_ddot + c, and the
same sum over the bodies; the leg passes, as a real one does.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from dextar_control.contract.compiler import compiler
from dextar_control.contract.robot import RobotParameters
from dextar_sim.geometry import bases

_OWN_SINE = 0.2
"""|sin delta| below which a leg's own angles are the coordinates; at 100 rad/s it turns by half of that in 1 ms."""
PLATFORM = -1
"""No leg's angles: the end effector's position is the coordinates."""

Pair = tuple[float, float]
Row = tuple[float, ...]

_compiled = compiler(Path(__file__).resolve().parent, "_compiled", error_model="numpy")


@_compiled
def _elbow(
    x: float, y: float, base: float, proximal: float, distal: float, side: float
) -> tuple[float, float, float, float]:
    """cos and sin of theta_1 and theta_2 with the elbow on a side of the line base -> (x, y); nan out of reach."""
    dx = x - base
    square = dx * dx + y * y
    along = 0.5 * (proximal * proximal - distal * distal + square) / square
    across = side * math.sqrt(proximal * proximal / square - along * along)
    ex, ey = along * dx - across * y, along * y + across * dx
    return ex / proximal, ey / proximal, (dx - ex) / distal, (y - ey) / distal


@_compiled
def acceleration(
    z: Pair, z_dot: Pair, chart: int, sides: Pair, motors: Pair, push: Pair, legs: tuple[Row, Row], shared: Row
) -> tuple[float, float, float]:
    """z_ddot and the least |sin delta| of the legs outside the coordinates.

    Args:
        z, z_dot: x and y, m and m/s, or theta_1 and theta_2 of one leg, rad and rad/s.
        chart: that leg, or ``PLATFORM``.
        sides: of the elbows, +1 left of the line base -> end effector.
        motors: torques before friction, N m.
        push: force on the end effector, N.
        legs: a row for each leg as ``leg_row`` makes it.
        shared: end effector mass, gravity x, gravity y, coulomb speed.
    """
    mass, gx, gy, coulomb_speed = shared
    x, y = z
    vx, vy = z_dot
    g_xx, g_xy, g_yx, g_yy, c_x, c_y = 1.0, 0.0, 0.0, 1.0, 0.0, 0.0
    if chart != PLATFORM:
        l1, l2 = legs[chart][1], legs[chart][5]
        w1, w2 = z_dot
        cos_1, sin_1, cos_2, sin_2 = math.cos(z[0]), math.sin(z[0]), math.cos(z[1]), math.sin(z[1])
        x, y = legs[chart][0] + l1 * cos_1 + l2 * cos_2, l1 * sin_1 + l2 * sin_2
        g_xx, g_xy, g_yx, g_yy = -l1 * sin_1, -l2 * sin_2, l1 * cos_1, l2 * cos_2
        vx, vy = g_xx * w1 + g_xy * w2, g_yx * w1 + g_yy * w2
        c_x, c_y = -l1 * cos_1 * w1 * w1 - l2 * cos_2 * w2 * w2, -l1 * sin_1 * w1 * w1 - l2 * sin_2 * w2 * w2
    least = 1.0
    m_11 = mass * (g_xx * g_xx + g_yx * g_yx)
    m_12 = mass * (g_xx * g_xy + g_yx * g_yy)
    m_22 = mass * (g_xy * g_xy + g_yy * g_yy)
    p_x, p_y = push[0] + mass * (gx - c_x), push[1] + mass * (gy - c_y)
    f_1, f_2 = g_xx * p_x + g_yx * p_y, g_xy * p_x + g_yy * p_y
    for i in range(2):
        base, l1, m1, c1, i1, l2, m2, c2, i2, viscous, coulomb = legs[i]
        if i == chart:
            cos_1, sin_1, cos_2, sin_2 = math.cos(z[0]), math.sin(z[0]), math.cos(z[1]), math.sin(z[1])
            j11, j12, j21, j22 = 1.0, 0.0, 0.0, 1.0
            w1, w2 = z_dot
            inward_1, inward_2 = w1 * w1, w2 * w2
            g1, g2 = 0.0, 0.0
        else:
            cos_1, sin_1, cos_2, sin_2 = _elbow(x, y, base, l1, l2, sides[i])
            cos_d, sin_d = cos_1 * cos_2 + sin_1 * sin_2, cos_1 * sin_2 - sin_1 * cos_2
            if not abs(sin_d) >= least:
                least = abs(sin_d)
            j1x, j1y = cos_2 / (l1 * sin_d), sin_2 / (l1 * sin_d)
            j2x, j2y = -cos_1 / (l2 * sin_d), -sin_1 / (l2 * sin_d)
            w1, w2 = j1x * vx + j1y * vy, j2x * vx + j2y * vy
            inward_1, inward_2 = w1 * w1, w2 * w2
            g1 = (l1 * inward_1 * cos_d + l2 * inward_2) / (l1 * sin_d) + j1x * c_x + j1y * c_y
            g2 = -(l1 * inward_1 + l2 * inward_2 * cos_d) / (l2 * sin_d) + j2x * c_x + j2y * c_y
            j11, j12 = j1x * g_xx + j1y * g_yx, j1x * g_xy + j1y * g_yy
            j21, j22 = j2x * g_xx + j2y * g_yx, j2x * g_xy + j2y * g_yy
        torque = motors[i] - viscous * w1 - coulomb * math.tanh(w1 / coulomb_speed)
        f_1 += j11 * (torque - i1 * g1) - j21 * i2 * g2
        f_2 += j12 * (torque - i1 * g1) - j22 * i2 * g2
        m_11 += i1 * j11 * j11 + i2 * j21 * j21
        m_12 += i1 * j11 * j12 + i2 * j21 * j22
        m_22 += i1 * j12 * j12 + i2 * j22 * j22
        for body in range(2):
            if body == 0:
                m, arm_1, arm_2 = m1, c1, 0.0
            else:
                m, arm_1, arm_2 = m2, l1, c2
            x1, x2 = -arm_1 * sin_1 * j11 - arm_2 * sin_2 * j21, -arm_1 * sin_1 * j12 - arm_2 * sin_2 * j22
            y1, y2 = arm_1 * cos_1 * j11 + arm_2 * cos_2 * j21, arm_1 * cos_1 * j12 + arm_2 * cos_2 * j22
            b_x = -arm_1 * (sin_1 * g1 + cos_1 * inward_1) - arm_2 * (sin_2 * g2 + cos_2 * inward_2)
            b_y = arm_1 * (cos_1 * g1 - sin_1 * inward_1) + arm_2 * (cos_2 * g2 - sin_2 * inward_2)
            m_11 += m * (x1 * x1 + y1 * y1)
            m_12 += m * (x1 * x2 + y1 * y2)
            m_22 += m * (x2 * x2 + y2 * y2)
            f_1 += m * (x1 * (gx - b_x) + y1 * (gy - b_y))
            f_2 += m * (x2 * (gx - b_x) + y2 * (gy - b_y))
    determinant = m_11 * m_22 - m_12 * m_12
    return (m_22 * f_1 - m_12 * f_2) / determinant, (m_11 * f_2 - m_12 * f_1) / determinant, least


@_compiled
def elbow_sides(joints: np.ndarray) -> Pair:
    """An elbow lies left of the line base -> end effector (+1) where the distal link turns right."""
    return -np.sign(math.sin(joints[1])), -np.sign(math.sin(joints[3]))


@_compiled
def _chart(joints: np.ndarray) -> int:
    """The leg whose angles are the coordinates, or ``PLATFORM``."""
    left, right = abs(math.sin(joints[1])), abs(math.sin(joints[3]))
    if min(left, right) >= _OWN_SINE:
        return PLATFORM
    return 0 if left < right else 1


@_compiled
def advance(
    platform: np.ndarray, joints: np.ndarray, joints_dot: np.ndarray, first: Pair, last: Pair, late: int, blow: Pair,
    substep: float, substeps: int, legs: tuple[Row, Row], shared: Row,
) -> float:  # fmt: skip
    """Runge-Kutta steps of fourth order over one period, in place; the least |sin delta| met, nan when lost.

    Args:
        platform: x, y, x_dot, y_dot, m and m/s, shape (4,).
        joints, joints_dot: q11, q12, q21, q22, rad and rad/s, shape (4,).
        first, last: motor torques of the first ``late`` substeps and of the others, N m.
        late: substeps.
        blow: force on the end effector over the first substep, N.
        substep: s.
        substeps: how many.
        legs, shared: of ``acceleration``.
    """
    chart, sides = _chart(joints), elbow_sides(joints)
    a, b, a_dot, b_dot = platform
    if chart != PLATFORM:
        a, a_dot = joints[2 * chart], joints_dot[2 * chart]
        b, b_dot = a + joints[2 * chart + 1], a_dot + joints_dot[2 * chart + 1]
    h, half = substep, 0.5 * substep
    least = 1.0
    for index in range(substeps):
        motors = first if index < late else last
        push = blow if index == 0 else (0.0, 0.0)
        a1, b1, sine_1 = acceleration((a, b), (a_dot, b_dot), chart, sides, motors, push, legs, shared)
        va2, vb2 = a_dot + half * a1, b_dot + half * b1
        z = a + half * a_dot, b + half * b_dot
        a2, b2, sine_2 = acceleration(z, (va2, vb2), chart, sides, motors, push, legs, shared)
        va3, vb3 = a_dot + half * a2, b_dot + half * b2
        z = a + half * va2, b + half * vb2
        a3, b3, sine_3 = acceleration(z, (va3, vb3), chart, sides, motors, push, legs, shared)
        va4, vb4 = a_dot + h * a3, b_dot + h * b3
        z = a + h * va3, b + h * vb3
        a4, b4, sine_4 = acceleration(z, (va4, vb4), chart, sides, motors, push, legs, shared)
        a += h / 6.0 * (a_dot + 2.0 * (va2 + va3) + va4)
        b += h / 6.0 * (b_dot + 2.0 * (vb2 + vb3) + vb4)
        a_dot += h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
        b_dot += h / 6.0 * (b1 + 2.0 * (b2 + b3) + b4)
        for sine in (sine_1, sine_2, sine_3, sine_4):
            if not sine >= least:
                least = sine
    x, y, vx, vy = a, b, a_dot, b_dot
    if chart != PLATFORM:
        base, l1, l2 = legs[chart][0], legs[chart][1], legs[chart][5]
        x, y = base + l1 * math.cos(a) + l2 * math.cos(b), l1 * math.sin(a) + l2 * math.sin(b)
        vx, vy = -l1 * math.sin(a) * a_dot - l2 * math.sin(b) * b_dot, l1 * math.cos(a) * a_dot + l2 * math.cos(b) * b_dot
    platform[0], platform[1], platform[2], platform[3] = x, y, vx, vy
    for i in range(2):
        if i == chart:
            joints[2 * i], joints[2 * i + 1] = a, b - a
            joints_dot[2 * i], joints_dot[2 * i + 1] = a_dot, b_dot - a_dot
            continue
        base, l1, l2 = legs[i][0], legs[i][1], legs[i][5]
        cos_1, sin_1, cos_2, sin_2 = _elbow(x, y, base, l1, l2, sides[i])
        cos_d, sin_d = cos_1 * cos_2 + sin_1 * sin_2, cos_1 * sin_2 - sin_1 * cos_2
        if not abs(sin_d) >= least:
            least = abs(sin_d)
        old_1, old_d = joints[2 * i], joints[2 * i + 1]
        turn_1, turn_d = math.atan2(sin_1, cos_1) - old_1, math.atan2(sin_d, cos_d) - old_d
        joints[2 * i] = old_1 + turn_1 - 2.0 * math.pi * np.round(turn_1 / (2.0 * math.pi))
        joints[2 * i + 1] = old_d + turn_d - 2.0 * math.pi * np.round(turn_d / (2.0 * math.pi))
        w1 = (cos_2 * vx + sin_2 * vy) / (l1 * sin_d)
        joints_dot[2 * i] = w1
        joints_dot[2 * i + 1] = -(cos_1 * vx + sin_1 * vy) / (l2 * sin_d) - w1
    return least


def leg_row(robot: RobotParameters, index: int) -> Row:
    """What ``acceleration`` needs of a leg.

    Returns:
        Base x (m), then of the proximal and the distal link length (m), mass (kg), centre (m), inertia about it
        (kg m^2; the proximal one with the rotor), then viscous (N m s/rad) and Coulomb (N m) friction.
    """
    leg, base = robot.legs[index], bases(robot)[index][0]
    return (
        base,
        leg.proximal_length, leg.proximal_mass, leg.proximal_center * leg.proximal_length,
        leg.proximal_inertia + leg.rotor_inertia,
        leg.distal_length, leg.distal_mass, leg.distal_center * leg.distal_length, leg.distal_inertia,
        leg.viscous_friction, leg.coulomb_friction,
    )  # fmt: skip
