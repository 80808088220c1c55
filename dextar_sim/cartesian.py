"""A second plant of the five-bar, in platform coordinates: its constraints are exact
and its steps of fourth order. No ROS here.
"""

from __future__ import annotations

import math

import numpy as np

from dextar_control.contract.errors import StateError
from dextar_control.contract.robot import RobotParameters
from dextar_control.symbols.types import Array, Numbers
from dextar_sim.effects import (
    NO_EFFECTS,
    Effects,
    JointEffects,
    has_joint_effects,
    without_rotors,
)
from dextar_sim.geometry import FiveBarPlacing, joints_dot_at, tip_of
from dextar_sim.platform_motion import PlatformMotion
from dextar_sim.state import PlantState, check_steps, leg_motors, saturated

# |sin delta| of a leg outside the coordinates below which the motion is not followed:
# both legs stretched or folded.
_LEAST_SINE = 0.01


class CartesianPlant(FiveBarPlacing):
    """Offers what ``dextar_sim.plant.Plant`` does, over the platform's own equations of
    motion.

    Args:
        robot: the description.
        period: duration of one step, s.
        substeps: Runge-Kutta steps in one step.
        max_torque: at which the motors saturate, N m; the robot's when None.
        effects: of drives and friction, beside what the robot's description says.

    Raises:
        ParameterError: period or substeps out of range, friction or a transmission too
            quick for the substep.
    """

    def __init__(
        self,
        robot: RobotParameters,
        *,
        period: float = 1.0e-3,
        substeps: int = 4,
        max_torque: float | None = None,
        effects: Effects = NO_EFFECTS,
    ) -> None:
        self._effects: JointEffects | None = None
        if has_joint_effects(robot, effects):
            self._effects = JointEffects(robot, effects, period, substeps, ahead=False)
        else:
            check_steps(period, substeps, leg_motors(robot))
        self.robot = robot
        self.period = period
        self.substeps = substeps
        self.max_torque = robot.max_torque if max_torque is None else max_torque
        self._substep = period / substeps
        if self._effects is None:
            self._motion = PlatformMotion(robot, substeps, self._substep)
        else:
            self._motion = PlatformMotion(
                without_rotors(robot, effects), 1, self._substep, torques=4
            )
        self._steps = 0
        self._push: tuple[float, float] = (0.0, 0.0)
        self._state: PlantState | None = None

    def _begin_at(self, joints: Numbers, x_dot: Numbers) -> PlantState:
        joints_dot = joints_dot_at(self.robot, joints, x_dot)
        self._check(max(abs(math.sin(joints[1])), abs(math.sin(joints[3]))), 0.0)
        self._motion.place(joints, joints_dot, tip_of(self.robot, joints), x_dot)
        if self._effects is not None:
            self._effects.reset(joints[::2], joints_dot[::2])
        self._steps = 0
        self._push = (0.0, 0.0)
        self._state = None
        return self.state()

    def take_up(self, mass: float) -> None:
        """Load the end effector with a mass, kg, that moves with it."""
        self.robot = self.robot.replace(
            end_effector_mass=self.robot.end_effector_mass + mass
        )
        self._motion.carry(self.robot.end_effector_mass)

    def encoder_angles(self) -> list[float]:
        """Return the angles of the encoders' discs, (2,), rad."""
        q_a: list[float] = self.state().q_a.tolist()
        return q_a if self._effects is None else self._effects.encoder_angles(q_a)

    def apply_impulse(self, impulse: Numbers) -> None:
        """Strike the end effector with an impulse, (2,), N s, during the next step's
        first substep.
        """
        self._push = (
            float(impulse[0]) / self._substep,
            float(impulse[1]) / self._substep,
        )

    def step(
        self, torque: Numbers, earlier: Numbers | None = None, late: int = 0
    ) -> Array:
        """Advance one period under constant motor torques.

        Args:
            torque: of the motors q11, q21, N m, shape (2,).
            earlier: torque of the first ``late`` substeps.
            late: substeps before the torque acts.

        Returns:
            Motor torque after saturation, before friction, at the end of the period, N
            m, shape (2,).

        Raises:
            StateError: a torque is not finite, or both legs come close to being
                stretched or folded.
        """
        net = saturated(torque, self.max_torque)
        first = (
            saturated(earlier, self.max_torque) if earlier is not None and late else net
        )
        if self._effects is None:
            least = self._motion.advance(first, net, late, self._push)
        else:
            least = self._step_each(self._effects, first, net, late)
        self._steps += 1
        self._push = (0.0, 0.0)
        self._state = None
        if not least >= _LEAST_SINE:
            self._check(least, self._steps * self.period)
        return np.array(net) if self._effects is None else self._effects.motor_torque

    def _step_each(
        self, effects: JointEffects, first: Numbers, last: Numbers, late: int
    ) -> float:
        """Step through the substeps, each under the torques of the effects; return the
        least |sin delta| met.
        """
        now, push, least = self._motion.state, self._push, 1.0
        for substep in range(self.substeps):
            effects.joints[:], effects.joints_dot[:] = now.joints, now.joints_dot
            effects.act(first if substep < late else last)
            forces = effects.forces.tolist()
            met = self._motion.advance(forces, forces, 0, push)
            least = met if not met >= least else least
            push = (0.0, 0.0)
        return least

    def acceleration(self, torque: Numbers) -> Array:
        """Return the platform's acceleration now, (2,), m/s^2, of a plant without
        effects off Type 1.

        Args:
            torque: of the motors, N m, shape (2,), saturated first.
        """
        return self._motion.acceleration(saturated(torque, self.max_torque))

    def _check(self, sine: float, time: float) -> None:
        if not sine >= _LEAST_SINE:
            raise StateError(
                f"at {time:g} s both legs are stretched or folded: the larger |sin| of"
                f" their elbow angles is {sine:.3g}; this plant needs >="
                f" {_LEAST_SINE:g}, the PyBullet plant does not"
            )

    def state(self) -> PlantState:
        """Return the true state now."""
        if self._state is None:
            self._motion.state.time = self._steps * self.period
            self._state = self._motion.state.copy()
        return self._state

    def close(self) -> None:
        """Do nothing: this plant holds nothing."""
