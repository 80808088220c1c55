"""The five-bar as a PyBullet plant: motors in, joint and end-effector states out. No ROS here."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pybullet as p

from dextar_control.contract.errors import ParameterError, StateError
from dextar_control.contract.robot import RobotParameters
from dextar_sim import geometry, world

_FRICTION_STABILITY = 1.0
"""Share of a joint's speed that friction may take away in one substep; beyond 2 it would swing up."""


class PlantState(NamedTuple):
    """True state of the plant.

    Attributes:
        time: steps taken times the period, s.
        q_a, q_a_dot: active joints q11, q21, rad and rad/s, shape (2,).
        joints, joints_dot: q11, q12, q21, q22, passive joints relative to their proximal link, shape (4,).
        x, x_dot: end effector (mean of both distal tips), m and m/s, shape (2,).
        loop_gap: distance of the distal tips, m.
    """

    time: float
    q_a: np.ndarray  # (2,)
    q_a_dot: np.ndarray  # (2,)
    joints: np.ndarray  # (4,)
    joints_dot: np.ndarray  # (4,)
    x: np.ndarray  # (2,)
    x_dot: np.ndarray  # (2,)
    loop_gap: float


class Plant:
    """Two 2R legs and one point-to-point constraint at the end effector, headless by default.

    PyBullet's semi-implicit Euler (kick, then drift) is the second-order leapfrog seen half a drift
    later. The angles it holds are therefore half a substep ahead, q + q_dot h/2; ``reset`` and
    ``state`` convert, which leaves a first-order error in the velocity-dependent forces only.

    Args:
        robot: the description.
        period: duration of one step, s.
        substeps: physics steps in one step; friction is evaluated in each.
        window: open PyBullet's own window.
        max_torque: at which the motors saturate, N m; the robot's when None.

    Raises:
        ParameterError: period or substeps out of range, friction too steep for the substep, no display.
    """

    def __init__(
        self,
        robot: RobotParameters,
        *,
        period: float = 1.0e-3,
        substeps: int = 4,
        window: bool = False,
        max_torque: float | None = None,
    ) -> None:
        if not (period > 0.0 and math.isfinite(period)):
            raise ParameterError(f"period = {period} s; it must be > 0")
        if substeps < 1:
            raise ParameterError(f"substeps = {substeps}; it must be >= 1")
        self.robot = robot
        self.period = period
        self.substeps = substeps
        self.max_torque = robot.max_torque if max_torque is None else max_torque
        self._substep = period / substeps
        self._check_friction()
        if window and not os.environ.get("DISPLAY"):
            raise ParameterError("window = true needs a display; DISPLAY is not set")
        self._client = p.connect(p.GUI if window else p.DIRECT)
        if self._client < 0:
            raise ParameterError("PyBullet refused a connection" + (" with a window" if window else ""))
        self._bases = geometry.bases(robot)
        self._friction = [(leg.viscous_friction, leg.coulomb_friction) for leg in robot.legs]
        self._has_friction = any(any(pair) for pair in self._friction)
        self._steps = 0
        self._impulse: tuple[float, float] | None = None
        loop = world.load(self._client, robot, self._substep, window)
        self._body, self._joints = loop.body, loop.joints
        self._active, self._tips = self._joints[::2], self._joints[1::2]
        self._read()

    def _check_friction(self) -> None:
        """An explicit friction torque must not turn a joint round within one substep."""
        for side, leg in (("left", self.robot.left), ("right", self.robot.right)):
            slope = leg.viscous_friction + leg.coulomb_friction / self.robot.coulomb_speed
            inertia = (
                leg.proximal_inertia
                + leg.rotor_inertia
                + leg.proximal_mass * (leg.proximal_center * leg.proximal_length) ** 2
            )
            if slope * self._substep > _FRICTION_STABILITY * inertia:
                raise ParameterError(
                    f"{side} joint friction of {slope:g} N m s/rad at rest is too steep for {inertia:g} kg m^2 and "
                    f"substeps of {self._substep:g} s; substeps must be >= "
                    f"{math.ceil(slope * self.period / (_FRICTION_STABILITY * inertia))}, or coulomb_speed larger"
                )

    def reset(self, x: Sequence[float], x_dot: Sequence[float] = (0.0, 0.0)) -> PlantState:
        """Put the end effector at x with velocity x_dot, in the robot's working mode, at time 0.

        Args:
            x: end effector position, m, shape (2,).
            x_dot: end effector velocity, m/s, shape (2,).

        Raises:
            GeometryError: a leg does not reach x, or cannot move at x_dot there.
        """
        joints = geometry.joints_at(self.robot, x)
        return self._place(joints, geometry.joints_dot_at(self.robot, joints, x_dot))

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
        """
        joints = geometry.joints_of(self.robot, q_a, assembly_mode)
        return self._place(joints, geometry.joints_dot_at(self.robot, joints, x_dot))

    def _place(self, joints: Sequence[float], joints_dot: Sequence[float]) -> PlantState:
        for index, angle, rate in zip(self._joints, joints, joints_dot, strict=True):
            ahead = angle + 0.5 * self._substep * rate
            p.resetJointState(self._body, index, ahead, rate, physicsClientId=self._client)
        self._steps = 0
        self._impulse = None
        self._read()
        return self.state()

    def apply_impulse(self, impulse: Sequence[float]) -> None:
        """Strike the end effector with an impulse (N s, shape (2,)) during the next step's first substep."""
        self._impulse = (float(impulse[0]), float(impulse[1]))

    def step(self, torque: Sequence[float]) -> np.ndarray:
        """Advance one period under constant motor torques.

        Args:
            torque: of the motors q11, q21, N m, shape (2,).

        Returns:
            Motor torque after saturation, before friction, N m, shape (2,).

        Raises:
            StateError: a torque is not finite.
        """
        limit = self.max_torque
        first, second = float(torque[0]), float(torque[1])
        if not (math.isfinite(first) and math.isfinite(second)):
            raise StateError(f"motor torque ({first}, {second}) N m is not finite")
        first, second = max(-limit, min(limit, first)), max(-limit, min(limit, second))
        net = [first, second]
        client, body, active = self._client, self._body, self._active
        if self._impulse is not None:
            self._strike(self._impulse)
            self._impulse = None
        rates = [self._joints_dot[0], self._joints_dot[2]]
        for substep in range(self.substeps):
            if self._has_friction:
                if substep:
                    moving = p.getJointStates(body, active, physicsClientId=client)
                    rates = [moving[0][1], moving[1][1]]
                net = [first - self._drag(0, rates[0]), second - self._drag(1, rates[1])]
            p.setJointMotorControlArray(body, active, p.TORQUE_CONTROL, forces=net, physicsClientId=client)
            p.stepSimulation(physicsClientId=client)
        self._steps += 1
        self._read()
        return np.array((first, second))

    def _drag(self, joint: int, rate: float) -> float:
        """Friction torque of an active joint: viscous q_dot + coulomb tanh(q_dot / coulomb_speed), N m."""
        viscous, coulomb = self._friction[joint]
        return viscous * rate + coulomb * math.tanh(rate / self.robot.coulomb_speed)

    def _strike(self, impulse: tuple[float, float]) -> None:
        """Half of the impulse on each tip, as a force over the coming substep."""
        force = [0.5 * value / self._substep for value in impulse] + [0.0]
        for link, (x, y, _, _) in zip(self._tips, self._tip_states(), strict=True):
            p.applyExternalForce(self._body, link, force, [x, y, 0.0], p.WORLD_FRAME, physicsClientId=self._client)

    def _read(self) -> None:
        states = p.getJointStates(self._body, self._joints, physicsClientId=self._client)
        half = 0.5 * self._substep
        self._angles = [state[0] - half * state[1] for state in states]
        self._joints_dot = [state[1] for state in states]

    def _tip_states(self) -> list[tuple[float, ...]]:
        """x, y, x_dot, y_dot of the left and the right distal tip."""
        return [
            geometry.tip(leg, base, self._angles[start : start + 2], self._joints_dot[start : start + 2])
            for leg, base, start in zip(self.robot.legs, self._bases, (0, 2), strict=True)
        ]

    def state(self) -> PlantState:
        """The true state now."""
        left, right = self._tip_states()
        joints, joints_dot = np.array(self._angles), np.array(self._joints_dot)
        return PlantState(
            time=self._steps * self.period,
            q_a=joints[::2].copy(),
            q_a_dot=joints_dot[::2].copy(),
            joints=joints,
            joints_dot=joints_dot,
            x=np.array((0.5 * (left[0] + right[0]), 0.5 * (left[1] + right[1]))),
            x_dot=np.array((0.5 * (left[2] + right[2]), 0.5 * (left[3] + right[3]))),
            loop_gap=math.hypot(left[0] - right[0], left[1] - right[1]),
        )

    def close(self) -> None:
        """Leave PyBullet; harmless when repeated."""
        if self._client >= 0 and p.isConnected(self._client):
            p.disconnect(self._client)
        self._client = -1
