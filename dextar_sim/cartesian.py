"""The five-bar in platform coordinates as a second plant: exact constraints, fourth-order steps. No ROS here.

Principle of virtual power with the end effector's position x as the coordinates. Each leg's links turn at
theta_1 (proximal) and theta_2 (distal) from the x axis; u is the unit vector along a link, n = (-u_y, u_x),
delta = theta_2 - theta_1. From x_dot = l1 n_1 theta_1_dot + l2 n_2 theta_2_dot, multiplied by u_2 and u_1:

    theta_1_dot = j_1 . x_dot,  j_1 =  u_2 / (l1 sin delta)
    theta_2_dot = j_2 . x_dot,  j_2 = -u_1 / (l2 sin delta)

and once more for x_ddot, with j_i . x_ddot + g_i for the accelerations. A body of mass m and inertia I whose
centre has the Jacobian J and the velocity-dependent acceleration b adds J^T m J + I j j^T to the platform's
inertia and J^T m (gravity - b) - I j g to its force; a motor adds j_1 tau. The Jacobians are regular where the
distal links are parallel (Type 2) and grow without bound where a leg is stretched or folded (Type 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numba
import numpy as np

from dextar_control.contract.errors import StateError
from dextar_control.contract.robot import RobotParameters
from dextar_sim import geometry
from dextar_sim.state import PlantState, check_steps, plant_state, saturated

_LEAST_SINE = 0.01
"""|sin| of an elbow angle below which the motion is not followed: at 40 rad/s a joint turns by this in 0.25 ms."""

Pair = tuple[float, float]
Row = tuple[float, ...]

_compiled = numba.njit(cache=True, error_model="numpy", nogil=True)


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
def _acceleration(
    x: float, y: float, vx: float, vy: float, motors: Pair, push: Pair, legs: tuple[Row, Row], shared: Row
) -> tuple[float, float, float]:
    """Platform acceleration (m/s^2) and the smaller |sin delta|.

    Args:
        x, y, vx, vy: of the end effector, m and m/s.
        motors: torques before friction, N m.
        push: force on the end effector, N.
        legs: a row for each leg as ``_leg_row`` makes it.
        shared: end effector mass, gravity x, gravity y, coulomb speed.
    """
    mass, gx, gy, coulomb_speed = shared
    m_xx, m_xy, m_yy = mass, 0.0, mass
    f_x, f_y = push[0] + mass * gx, push[1] + mass * gy
    least = 1.0
    for i in range(2):
        base, side, l1, m1, c1, i1, l2, m2, c2, i2, viscous, coulomb = legs[i]
        cos_1, sin_1, cos_2, sin_2 = _elbow(x, y, base, l1, l2, side)
        cos_d, sin_d = cos_1 * cos_2 + sin_1 * sin_2, cos_1 * sin_2 - sin_1 * cos_2
        if not abs(sin_d) >= least:
            least = abs(sin_d)
        j1x, j1y = cos_2 / (l1 * sin_d), sin_2 / (l1 * sin_d)
        j2x, j2y = -cos_1 / (l2 * sin_d), -sin_1 / (l2 * sin_d)
        w1, w2 = j1x * vx + j1y * vy, j2x * vx + j2y * vy
        inward_1, inward_2 = w1 * w1, w2 * w2
        g1 = (l1 * inward_1 * cos_d + l2 * inward_2) / (l1 * sin_d)
        g2 = -(l1 * inward_1 + l2 * inward_2 * cos_d) / (l2 * sin_d)
        torque = motors[i] - viscous * w1 - coulomb * math.tanh(w1 / coulomb_speed)
        f_x += j1x * (torque - i1 * g1) - j2x * i2 * g2
        f_y += j1y * (torque - i1 * g1) - j2y * i2 * g2
        m_xx += i1 * j1x * j1x + i2 * j2x * j2x
        m_xy += i1 * j1x * j1y + i2 * j2x * j2y
        m_yy += i1 * j1y * j1y + i2 * j2y * j2y
        for body in range(2):
            if body == 0:
                m, arm_1, arm_2 = m1, c1, 0.0
            else:
                m, arm_1, arm_2 = m2, l1, c2
            xx = -arm_1 * sin_1 * j1x - arm_2 * sin_2 * j2x
            xy = -arm_1 * sin_1 * j1y - arm_2 * sin_2 * j2y
            yx = arm_1 * cos_1 * j1x + arm_2 * cos_2 * j2x
            yy = arm_1 * cos_1 * j1y + arm_2 * cos_2 * j2y
            b_x = -arm_1 * (sin_1 * g1 + cos_1 * inward_1) - arm_2 * (sin_2 * g2 + cos_2 * inward_2)
            b_y = arm_1 * (cos_1 * g1 - sin_1 * inward_1) + arm_2 * (cos_2 * g2 - sin_2 * inward_2)
            m_xx += m * (xx * xx + yx * yx)
            m_xy += m * (xx * xy + yx * yy)
            m_yy += m * (xy * xy + yy * yy)
            f_x += m * (xx * (gx - b_x) + yx * (gy - b_y))
            f_y += m * (xy * (gx - b_x) + yy * (gy - b_y))
    determinant = m_xx * m_yy - m_xy * m_xy
    return (m_yy * f_x - m_xy * f_y) / determinant, (m_xx * f_y - m_xy * f_x) / determinant, least


@_compiled
def _advance(
    platform: np.ndarray, joints: np.ndarray, joints_dot: np.ndarray, first: Pair, last: Pair, late: int, blow: Pair,
    substep: float, substeps: int, legs: tuple[Row, Row], shared: Row,
) -> float:  # fmt: skip
    """Runge-Kutta steps of fourth order over one period, in place; the smallest |sin delta| met, nan when lost.

    Args:
        platform: x, y, x_dot, y_dot, m and m/s, shape (4,).
        joints, joints_dot: q11, q12, q21, q22, rad and rad/s, shape (4,).
        first, last: motor torques of the first ``late`` substeps and of the others, N m.
        late: substeps.
        blow: force on the end effector over the first substep, N.
        substep: s.
        substeps: how many.
        legs, shared: of ``_acceleration``.
    """
    x, y, vx, vy = platform
    h, half = substep, 0.5 * substep
    least = 1.0
    for index in range(substeps):
        motors = first if index < late else last
        push = blow if index == 0 else (0.0, 0.0)
        ax1, ay1, sine_1 = _acceleration(x, y, vx, vy, motors, push, legs, shared)
        vx2, vy2 = vx + half * ax1, vy + half * ay1
        ax2, ay2, sine_2 = _acceleration(x + half * vx, y + half * vy, vx2, vy2, motors, push, legs, shared)
        vx3, vy3 = vx + half * ax2, vy + half * ay2
        ax3, ay3, sine_3 = _acceleration(x + half * vx2, y + half * vy2, vx3, vy3, motors, push, legs, shared)
        vx4, vy4 = vx + h * ax3, vy + h * ay3
        ax4, ay4, sine_4 = _acceleration(x + h * vx3, y + h * vy3, vx4, vy4, motors, push, legs, shared)
        x += h / 6.0 * (vx + 2.0 * (vx2 + vx3) + vx4)
        y += h / 6.0 * (vy + 2.0 * (vy2 + vy3) + vy4)
        vx += h / 6.0 * (ax1 + 2.0 * (ax2 + ax3) + ax4)
        vy += h / 6.0 * (ay1 + 2.0 * (ay2 + ay3) + ay4)
        for sine in (sine_1, sine_2, sine_3, sine_4):
            if not sine >= least:
                least = sine
    platform[0], platform[1], platform[2], platform[3] = x, y, vx, vy
    for i in range(2):
        base, side, l1, l2 = legs[i][0], legs[i][1], legs[i][2], legs[i][6]
        cos_1, sin_1, cos_2, sin_2 = _elbow(x, y, base, l1, l2, side)
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


class CartesianPlant:
    """The same surface as ``dextar_sim.plant.Plant`` over the platform's own equations of motion.

    The working mode that a reset gives stays: where a leg comes close to being stretched or folded the
    coordinates end, and so does the run.

    Args:
        robot: the description.
        period: duration of one step, s.
        substeps: Runge-Kutta steps in one step.
        max_torque: at which the motors saturate, N m; the robot's when None.

    Raises:
        ParameterError: period or substeps out of range, friction too steep for the substep.
    """

    def __init__(
        self,
        robot: RobotParameters,
        *,
        period: float = 1.0e-3,
        substeps: int = 4,
        max_torque: float | None = None,
    ) -> None:
        check_steps(robot, period, substeps)
        self.robot = robot
        self.period = period
        self.substeps = substeps
        self.max_torque = robot.max_torque if max_torque is None else max_torque
        self._substep = period / substeps
        self._shared = (robot.end_effector_mass, *robot.gravity, robot.coulomb_speed)
        self._legs = (_leg_row(robot, 0, 1.0), _leg_row(robot, 1, 1.0))
        self._platform, self._joints, self._joints_dot = np.zeros(4), np.zeros(4), np.zeros(4)
        self._steps = 0
        self._push: tuple[float, float] = (0.0, 0.0)
        self._state: PlantState | None = None

    def reset(self, x: Sequence[float], x_dot: Sequence[float] = (0.0, 0.0)) -> PlantState:
        """Put the end effector at x with velocity x_dot, in the robot's working mode, at time 0.

        Args:
            x: end effector position, m, shape (2,).
            x_dot: end effector velocity, m/s, shape (2,).

        Raises:
            GeometryError: a leg does not reach x, or cannot move at x_dot there.
            StateError: a leg is stretched or folded.
        """
        return self._place(geometry.joints_at(self.robot, x), x_dot)

    def reset_joints(
        self, q_a: Sequence[float], assembly_mode: int, x_dot: Sequence[float] = (0.0, 0.0)
    ) -> PlantState:
        """Put the active joints at q_a (rad, shape (2,)) in the given assembly mode, at time 0.

        Args:
            q_a: active angles q11, q21.
            assembly_mode: sign of r_1 x r_2, r_i from elbow i to the end effector.
            x_dot: end effector velocity, m/s, shape (2,).

        Raises:
            GeometryError: the distal links do not meet there, or the elbows coincide.
            StateError: a leg is stretched or folded.
        """
        return self._place(geometry.joints_of(self.robot, q_a, assembly_mode), x_dot)

    def _place(self, joints: Sequence[float], x_dot: Sequence[float]) -> PlantState:
        """An elbow lies left of the line base -> end effector (+1) where the distal link turns back right."""
        self._joints_dot[:] = geometry.joints_dot_at(self.robot, joints, x_dot)
        self._joints[:] = joints
        sines = [math.sin(joints[1]), math.sin(joints[3])]
        self._check(min(map(abs, sines)), 0.0)
        self._legs = (_leg_row(self.robot, 0, -sines[0]), _leg_row(self.robot, 1, -sines[1]))
        tips = [
            geometry.tip(leg, base, joints[start : start + 2], (0.0, 0.0))
            for leg, base, start in zip(self.robot.legs, geometry.bases(self.robot), (0, 2), strict=True)
        ]
        self._platform[:] = (0.5 * (tips[0][0] + tips[1][0]), 0.5 * (tips[0][1] + tips[1][1]), *x_dot)
        self._steps = 0
        self._push = (0.0, 0.0)
        self._state = None
        return self.state()

    def apply_impulse(self, impulse: Sequence[float]) -> None:
        """Strike the end effector with an impulse (N s, shape (2,)) during the next step's first substep."""
        self._push = float(impulse[0]) / self._substep, float(impulse[1]) / self._substep

    def step(self, torque: Sequence[float], earlier: Sequence[float] | None = None, late: int = 0) -> np.ndarray:
        """Advance one period under constant motor torques.

        Args:
            torque: of the motors q11, q21, N m, shape (2,).
            earlier: torque of the first ``late`` substeps.
            late: substeps before the torque acts.

        Returns:
            Motor torque after saturation, before friction, at the end of the period, N m, shape (2,).

        Raises:
            StateError: a torque is not finite, or a leg comes close to being stretched or folded.
        """
        net = saturated(torque, self.max_torque)
        first = saturated(earlier, self.max_torque) if earlier is not None and late else net
        least = _advance(self._platform, self._joints, self._joints_dot, first, net, late, self._push, self._substep,
                         self.substeps, self._legs, self._shared)  # fmt: skip
        self._steps += 1
        self._push = (0.0, 0.0)
        self._state = None
        if not least >= _LEAST_SINE:
            self._check(least, self._steps * self.period)
        return np.array(net)

    def _check(self, sine: float, time: float) -> None:
        if not sine >= _LEAST_SINE:
            raise StateError(
                f"at {time:g} s a leg is stretched or folded: |sin| of its elbow angle is {sine:.3g}; platform "
                f"coordinates need >= {_LEAST_SINE:g}, the PyBullet plant needs none"
            )

    def state(self) -> PlantState:
        """The true state now."""
        if self._state is None:
            self._state = plant_state(self._steps * self.period, self._joints.tolist(), self._joints_dot.tolist(),
                                      self._platform.tolist(), 0.0)  # fmt: skip
        return self._state

    def close(self) -> None:
        """Nothing is held."""


def _leg_row(robot: RobotParameters, index: int, side: float) -> tuple[float, ...]:
    """What ``_acceleration`` needs of a leg.

    Returns:
        Base x (m), elbow side (+1 left of the line base -> end effector), then of the proximal and the distal link
        length (m), mass (kg), centre (m), inertia about it (kg m^2; the proximal one with the rotor), then viscous
        (N m s/rad) and Coulomb (N m) friction.
    """
    leg, base = robot.legs[index], geometry.bases(robot)[index][0]
    return (
        base, math.copysign(1.0, side),
        leg.proximal_length, leg.proximal_mass, leg.proximal_center * leg.proximal_length,
        leg.proximal_inertia + leg.rotor_inertia,
        leg.distal_length, leg.distal_mass, leg.distal_center * leg.distal_length, leg.distal_inertia,
        leg.viscous_friction, leg.coulomb_friction,
    )  # fmt: skip
