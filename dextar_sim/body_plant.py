"""A PyBullet plant of any mechanism: motor torques go in, joint and platform states
come out. No ROS here.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np
import pybullet as p

from dextar_control.contract.errors import GeometryError, ParameterError
from dextar_control.mechanisms.bodies import Bodies
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.symbols.functions import Fast
from dextar_control.symbols.types import Array, Numbers
from dextar_sim import world
from dextar_sim.effects import JointEffects
from dextar_sim.state import Motor, PlantState, check_steps, saturated, state_layout
from dextar_sim.tree import functions_of
from dextar_sim.urdf import bodies_of


class BodyPlant:
    """Simulates the bodies that a mechanism describes.

    PyBullet's semi-implicit Euler (kick, then drift) is the second-order leapfrog seen
    half a drift later. The positions it holds are therefore half a substep ahead, q +
    q_dot h/2; ``reset`` and ``state`` convert, which leaves a first-order error in the
    velocity-dependent forces only.

    Args:
        mechanism: the description.
        values: of its parameters, by their dotted names.
        period: duration of one step, s.
        substeps: physics steps in one step; friction is evaluated in each.
        window: open PyBullet's own window.
        max_torque: at which the motors saturate, N m (N).
        sides: what the motors are called; as their joints when None.
        effects: what acts at the joints instead of constant torques; the mechanism has
            no friction then.

    Raises:
        ParameterError: period or substeps out of range, friction too steep for the
            substep, no display, or the mechanism does not say of which bodies it is
            made.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        values: Mapping[str, object],
        *,
        period: float = 1.0e-3,
        substeps: int = 4,
        window: bool = False,
        max_torque: float = math.inf,
        sides: Sequence[str] | None = None,
        effects: JointEffects | None = None,
    ) -> None:
        self.mechanism = mechanism
        self.period = period
        self.substeps = substeps
        self.max_torque = max_torque
        self._p = mechanism.values(values)
        bodies = bodies_of(mechanism, values)
        joints = [link.joint for link in bodies.links]
        self._motors = [joints.index(joint.name) for joint in mechanism.joints]
        moved = [bodies.links[motor] for motor in self._motors]
        self._friction = [(float(link.viscous), float(link.coulomb)) for link in moved]
        self._coulomb_speed = float(bodies.coulomb_speed)
        self._has_friction = any(map(any, self._friction))
        check_steps(
            period,
            substeps,
            [
                Motor(
                    side,
                    viscous + coulomb / self._coulomb_speed,
                    float(
                        link.mass
                        if link.prismatic
                        else link.inertia + link.mass * ca.sumsqr(link.center)
                    ),
                )
                for side, (viscous, coulomb), link in zip(
                    sides or [link.joint for link in moved],
                    self._friction,
                    moved,
                    strict=True,
                )
            ],
        )
        self._fast = {
            name: Fast(function) for name, function in functions_of(mechanism).items()
        }
        self._substep = period / substeps
        self._truth = self._fast["truth"]
        self._layout = state_layout(mechanism.n, len(joints))
        self._truth.arguments.p[:] = self._p
        self._truth.arguments.lead[:] = 0.5 * self._substep
        if window and not os.environ.get("DISPLAY"):
            raise ParameterError("window = true needs a display; DISPLAY is not set")
        self._window = window
        self._client = world.connect(window)
        self._effects = effects
        self._divisible = (
            substeps & (substeps - 1) == 0
            and not self._has_friction
            and effects is None
        )
        self._divided = False
        self._steps = 0
        self._impulse: Array | None = None
        self._load(bodies)

    def _load(self, bodies: Bodies) -> None:
        loop = world.load(self._client, bodies, self._substep, self._window)
        self._body, self._joints = loop.body, loop.joints
        self._active = [self._joints[motor] for motor in self._motors]
        self._divided = False
        self._read()

    def become(self, values: Mapping[str, object]) -> None:
        """Keep positions and speeds, and take other values of the mechanism's
        parameters, its friction excepted.
        """
        held = self._states
        bodies = bodies_of(self.mechanism, values)
        self._p[:] = self.mechanism.values(values)
        self._truth.arguments.p[:] = self._p
        world.clear(self._client)
        self._load(bodies)
        self._hold([state[0] for state in held], [state[1] for state in held])
        self._read()

    def reset(self, x: Numbers, x_dot: Numbers = ()) -> PlantState:
        """Put the platform at x with velocity x_dot, in the robot's working mode, at
        time 0.

        Args:
            x: of the platform, shape (n,).
            x_dot: its velocity, shape (n,); at rest when empty.

        Raises:
            GeometryError: a leg does not reach x, or cannot move at x_dot there.
        """
        closed = self._fast["closed"](
            self._p, x, x_dot if len(x_dot) else np.zeros(self.mechanism.n)
        )
        if not np.isfinite(closed.joints).all():
            raise GeometryError(
                self.mechanism.unreached(
                    np.asarray(x), closed.q_a, self.mechanism.named(self._p)
                )
            )
        if not np.isfinite(closed.joints_dot).all():
            raise GeometryError(
                f"a leg cannot move at x_dot = {x_dot}: it is stretched or folded at x"
                f" = {x}"
            )
        return self._place(closed.joints.tolist(), closed.joints_dot.tolist())

    def _place(self, joints: Numbers, joints_dot: Numbers) -> PlantState:
        self._hold(
            [
                angle + 0.5 * self._substep * rate
                for angle, rate in zip(joints, joints_dot, strict=True)
            ],
            joints_dot,
        )
        if self._effects is not None:
            self._effects.reset(
                *([of[motor] for motor in self._motors] for of in (joints, joints_dot))
            )
        self._steps = 0
        self._impulse = None
        self._read()
        return self.state()

    def _hold(self, held: Numbers, joints_dot: Numbers) -> None:
        for index, angle, rate in zip(self._joints, held, joints_dot, strict=True):
            p.resetJointState(
                self._body, index, angle, rate, physicsClientId=self._client
            )

    def encoder_angles(self) -> list[float]:
        """Return the angles of the encoders' discs, (n,), rad (m)."""
        q_a: list[float] = self.state().q_a.tolist()
        return q_a if self._effects is None else self._effects.encoder_angles(q_a)

    def apply_impulse(self, impulse: Numbers) -> None:
        """Strike the platform with an impulse along its coordinates, (n,), N s, during
        the next step's first substep.
        """
        self._impulse = np.array(impulse, dtype=np.float64)

    def step(
        self, torque: Numbers, earlier: Numbers | None = None, late: int = 0
    ) -> Array:
        """Advance one period under constant motor torques.

        A torque that holds over the whole period without friction is one call of
        PyBullet, which divides the period itself; bit for bit that is the same as a
        call for each substep where the substep is an exact part of the period (by a
        power of two).

        Args:
            torque: of the motors, N m (N), shape (n,).
            earlier: torque of the first ``late`` substeps.
            late: substeps before the torque acts.

        Returns:
            Motor torque after saturation, before friction, at the end of the period, N
            m (N), shape (n,).

        Raises:
            StateError: a torque is not finite.
        """
        net = saturated(torque, self.max_torque)
        first = (
            saturated(earlier, self.max_torque) if earlier is not None and late else net
        )
        if self._effects is not None:
            self._step_under(self._effects, first, net, late)
            net = tuple(self._effects.motor_torque)
        elif self._divisible and self._impulse is None and first == net:
            if not self._divided:
                self._divide(True)
            p.setJointMotorControlArray(
                self._body,
                self._active,
                p.TORQUE_CONTROL,
                forces=net,
                physicsClientId=self._client,
            )
            p.stepSimulation(self._client)
        else:
            self._step_each(first, net, late)
        self._steps += 1
        self._read()
        return np.array(net)

    def _step_each(self, first: Numbers, last: Numbers, late: int) -> None:
        """Call PyBullet for each substep, the first ``late`` of them under another
        torque.

        Friction is viscous q_dot + coulomb tanh(q_dot / coulomb_speed), N m (N).
        """
        if self._divided:
            self._divide(False)
        client, body, active = self._client, self._body, self._active
        friction, speed, tanh = self._friction, self._coulomb_speed, math.tanh
        states = [self._states[motor] for motor in self._motors]
        for substep in range(self.substeps):
            net = first if substep < late else last
            if self._has_friction:
                if substep:
                    states = p.getJointStates(body, active, client)
                net = [
                    torque - viscous * state[1] - coulomb * tanh(state[1] / speed)
                    for torque, state, (viscous, coulomb) in zip(net, states, friction)  # noqa: B905  in each substep
                ]
            if self._impulse is None:
                p.setJointMotorControlArray(
                    body, active, p.TORQUE_CONTROL, forces=net, physicsClientId=client
                )
            else:
                self._strike(self._impulse, net)
                self._impulse = None
            p.stepSimulation(client)

    def _step_under(
        self, effects: JointEffects, first: Numbers, last: Numbers, late: int
    ) -> None:
        """Call PyBullet for each substep, under the torques of the effects at the
        joints.
        """
        client = self._client
        body = self._body
        joints = self._joints
        states = self._states
        for substep in range(self.substeps):
            if substep:
                states = p.getJointStates(body, joints, client)
            effects.joints[:] = [state[0] for state in states]
            effects.joints_dot[:] = [state[1] for state in states]
            effects.act(first if substep < late else last)
            forces = effects.forces
            if self._impulse is not None:
                forces = forces + self._pushed(self._impulse)
                self._impulse = None
            p.setJointMotorControlArray(
                body,
                joints,
                p.TORQUE_CONTROL,
                forces=forces.tolist(),
                physicsClientId=client,
            )
            p.stepSimulation(client)

    def _divide(self, divided: bool) -> None:
        """Let one call of PyBullet be a whole period, or a substep."""
        self._divided = divided
        if divided:
            world.set_step(self._client, self.period, self.substeps)
        else:
            world.set_step(self._client, self._substep)

    def _strike(self, impulse: Array, net: Numbers) -> None:
        """Apply a force on the platform over the coming substep, and the motor
        torques.
        """
        forces = self._pushed(impulse)
        forces[self._motors] += net
        p.setJointMotorControlArray(
            self._body,
            self._joints,
            p.TORQUE_CONTROL,
            forces=forces.tolist(),
            physicsClientId=self._client,
        )

    def _pushed(self, impulse: Array) -> Array:
        """Return the torques at all joints, where PyBullet holds them, that a force on
        the platform over a substep equals.
        """
        forces: Array = self._fast["push"](
            self._p, [state[0] for state in self._states], impulse / self._substep
        ).forces
        return forces

    def _read(self) -> None:
        self._states = p.getJointStates(self._body, self._joints, self._client)
        self._state: PlantState | None = None

    def state(self) -> PlantState:
        """Return the true state now."""
        if self._state is None:
            truth = self._truth
            truth.arguments.held[:] = [state[0] for state in self._states]
            truth.arguments.joints_dot[:] = [state[1] for state in self._states]
            truth.arguments.time[0] = self._steps * self.period
            truth.run()
            self._state = self._layout.of(truth.results.state.copy())
        return self._state

    def close(self) -> None:
        """Leave PyBullet; repeating it does no harm."""
        if self._client >= 0:
            world.release(self._client, self._window)
        self._client = -1
