"""The five-bar as a PyBullet plant: motors in, joint and end-effector states out. No ROS here."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence

import numpy as np
import pybullet as p

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.robot import RobotParameters
from dextar_sim import geometry, world
from dextar_sim.state import STATE, PlantState, check_steps, saturated


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
        check_steps(robot, period, substeps)
        self.robot = robot
        self.period = period
        self.substeps = substeps
        self.max_torque = robot.max_torque if max_torque is None else max_torque
        self._substep = period / substeps
        if window and not os.environ.get("DISPLAY"):
            raise ParameterError("window = true needs a display; DISPLAY is not set")
        self._window = window
        self._client = world.connect(window)
        self._shape = geometry.shape(robot)
        self._friction = [(leg.viscous_friction, leg.coulomb_friction) for leg in robot.legs]
        self._has_friction = any(any(pair) for pair in self._friction)
        self._divisible = substeps & (substeps - 1) == 0 and not self._has_friction
        self._divided = False
        self._steps = 0
        self._impulse: tuple[float, float] | None = None
        loop = world.load(self._client, robot, self._substep, window)
        self._body, self._joints = loop.body, loop.joints
        self._active, self._tips = self._joints[::2], self._joints[1::2]
        self._read()

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

    def step(self, torque: Sequence[float], earlier: Sequence[float] | None = None, late: int = 0) -> np.ndarray:
        """Advance one period under constant motor torques.

        A torque that holds over the whole period without friction is one call of PyBullet, which divides the
        period itself; bit for bit that is the same as a call for each substep where the substep is an exact part
        of the period (by a power of two).

        Args:
            torque: of the motors q11, q21, N m, shape (2,).
            earlier: torque of the first ``late`` substeps.
            late: substeps before the torque acts.

        Returns:
            Motor torque after saturation, before friction, at the end of the period, N m, shape (2,).

        Raises:
            StateError: a torque is not finite.
        """
        net = saturated(torque, self.max_torque)
        first = saturated(earlier, self.max_torque) if earlier is not None and late else net
        if self._divisible and self._impulse is None and first == net:
            if not self._divided:
                self._divide(True)
            p.setJointMotorControlArray(self._body, self._active, p.TORQUE_CONTROL, forces=net, physicsClientId=self._client)
            p.stepSimulation(self._client)
        else:
            self._step_each(first, net, late)
        self._steps += 1
        self._read()
        return np.array(net)

    def _step_each(self, first: tuple[float, float], last: tuple[float, float], late: int) -> None:
        """One call of PyBullet for each substep, the first ``late`` of them under another torque.

        Friction is viscous q_dot + coulomb tanh(q_dot / coulomb_speed), N m.
        """
        if self._divided:
            self._divide(False)
        client, body, active = self._client, self._body, self._active
        if self._impulse is not None:
            self._strike(self._impulse)
            self._impulse = None
        (left_viscous, left_coulomb), (right_viscous, right_coulomb) = self._friction
        speed, tanh = self.robot.coulomb_speed, math.tanh
        left, right = self._joints_dot[0], self._joints_dot[2]
        for substep in range(self.substeps):
            net = first if substep < late else last
            if self._has_friction:
                if substep:
                    moving = p.getJointStates(body, active, client)
                    left, right = moving[0][1], moving[1][1]
                net = (
                    net[0] - left_viscous * left - left_coulomb * tanh(left / speed),
                    net[1] - right_viscous * right - right_coulomb * tanh(right / speed),
                )
            p.setJointMotorControlArray(body, active, p.TORQUE_CONTROL, forces=net, physicsClientId=client)
            p.stepSimulation(client)

    def _divide(self, divided: bool) -> None:
        """Whether one call of PyBullet is a whole period or a substep."""
        self._divided = divided
        if divided:
            world.set_step(self._client, self.period, self.substeps)
        else:
            world.set_step(self._client, self._substep)

    def _strike(self, impulse: tuple[float, float]) -> None:
        """Half of the impulse on each tip, as a force over the coming substep."""
        force = [0.5 * value / self._substep for value in impulse] + [0.0]
        for link, (x, y, _, _) in zip(self._tips, geometry.tips(self._shape, self._angles, self._joints_dot), strict=True):
            p.applyExternalForce(self._body, link, force, [x, y, 0.0], p.WORLD_FRAME, physicsClientId=self._client)

    def _read(self) -> None:
        first, second, third, fourth = p.getJointStates(self._body, self._joints, self._client)
        half = 0.5 * self._substep
        self._joints_dot = (first[1], second[1], third[1], fourth[1])
        self._angles = (
            first[0] - half * first[1], second[0] - half * second[1],
            third[0] - half * third[1], fourth[0] - half * fourth[1],
        )  # fmt: skip
        self._state: PlantState | None = None

    def state(self) -> PlantState:
        """The true state now."""
        if self._state is None:
            now = self._steps * self.period
            self._state = STATE.of(geometry.state_at(now, self._shape, self._angles, self._joints_dot))
        return self._state

    def close(self) -> None:
        """Leave PyBullet; harmless when repeated."""
        if self._client >= 0:
            world.release(self._client, self._window)
        self._client = -1
