"""A rig in a plain loop: a plant, and what stands between it and its controller. No ROS
here.

After a reset, again and again: ``sample = rig.read()``, then ``rig.write(torque)`` with
the controller's answer, or None where the sample was lost.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import fields
from typing import NamedTuple

import numpy as np

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.robot import RobotParameters
from dextar_control.symbols.types import Array, Numbers
from dextar_sim.cartesian import CartesianPlant
from dextar_sim.disturbances import Disturbances
from dextar_sim.effects import Effects
from dextar_sim.plant import Plant
from dextar_sim.sensors import (
    CommandDelay,
    CommandHold,
    Encoder,
    PoseSensor,
    StampError,
    TorqueCommand,
    check_probability,
)
from dextar_sim.state import PlantState

PLANTS: dict[str, type[Plant] | type[CartesianPlant]] = {
    "pybullet": Plant,
    "cartesian": CartesianPlant,
}
_NANOSECONDS = 1.0e9


class MeasuredPose(NamedTuple):
    """An external measurement of the end effector.

    Attributes:
        time: at which it was true, s.
        x: measured position, m, shape (2,).
    """

    time: float
    x: Array  # (2,)


class ControllerInput(NamedTuple):
    """What reaches the controller in one period.

    Attributes:
        time: at which the sample was taken, as its stamp tells it, s.
        q_a: measured active joints, rad, shape (2,).
        pose: newest external measurement that has arrived and was in no sample before.
    """

    time: float
    q_a: Array  # (2,)
    pose: MeasuredPose | None


class Rig:
    """Simulates a plant behind encoders, a lossy line, drives with a delay and a
    watchdog, and perhaps a camera.

    A run repeats bit for bit from its seed: each reset starts all chance anew.

    Args:
        robot: the true robot, which need not be the controller's model.
        plant: a name in ``PLANTS``.
        period: of the control loop, s.
        substeps: physics steps in one period.
        encoder_resolution: counts per revolution; 0 is exact.
        position_noise: standard deviation before quantisation, rad.
        command_delay: s, rounded to periods.
        sample_loss: probability that a sample does not reach the controller.
        jitter: share of the period up to which a command is late within it, evenly
            distributed and rounded to substeps; the command before it acts until then.
        command_timeout: age of the state that a command answers, without the delay,
            beyond which the drives give no torque, s.
        max_torque: saturation of the drives, N m; the robot's when None.
        seed: of all noise and loss.
        pose_rate: external measurements per second; 0 is none.
        pose_delay: from the instant when a pose was true to its arrival, s.
        pose_noise: standard deviation of each coordinate, m.
        pose_dropout: probability that an external measurement is missing.
        pose_outages: spans (from, to) without external measurements, s.
        homing_error: by which each encoder is off, to one side or the other at random,
            rad.
        eccentricity: amplitude of each encoder's error over a turn, rad.
        stamp_error: up to which a sample's time is told wrong, at random, s.
        payload: mass that the end effector takes up, kg, at ``payload_time``, s.
        effects: of drives and friction, by the names of ``effects.Effects``.

    Attributes:
        samples_lost: that did not reach the controller since the reset.

    Raises:
        ParameterError: a value is out of its range.
    """

    def __init__(
        self,
        robot: RobotParameters,
        *,
        plant: str = "pybullet",
        period: float = 1.0e-3,
        substeps: int = 4,
        encoder_resolution: int = 2**17,
        position_noise: float = 0.0,
        command_delay: float = 0.0,
        sample_loss: float = 0.0,
        jitter: float = 0.0,
        command_timeout: float = 0.02,
        max_torque: float | None = None,
        seed: int = 0,
        pose_rate: float = 0.0,
        pose_delay: float = 0.0,
        pose_noise: float = 0.0,
        pose_dropout: float = 0.0,
        pose_outages: Sequence[tuple[float, float]] = (),
        homing_error: float = 0.0,
        eccentricity: float = 0.0,
        stamp_error: float = 0.0,
        payload: float = 0.0,
        payload_time: float = 0.0,
        **effects: str | float,
    ) -> None:
        if plant not in PLANTS:
            raise ParameterError(
                f"plant = {plant!r}; it must be one of {', '.join(PLANTS)}"
            )
        if seed < 0:
            raise ParameterError(f"seed = {seed}; it must be >= 0")
        check_probability("sample_loss", sample_loss)
        check_probability("jitter", jitter)
        unknown = sorted(set(effects) - {field.name for field in fields(Effects)})
        if unknown:
            raise ParameterError(f"unknown option '{unknown[0]}' of a rig")
        self.plant: Plant | CartesianPlant = PLANTS[plant](
            robot,
            period=period,
            substeps=substeps,
            max_torque=max_torque,
            effects=Effects(**effects),  # type: ignore[arg-type]  # checks each
        )
        self.period = period
        self._period_ns = round(_NANOSECONDS * period)
        self._loss, self._jitter = sample_loss, jitter * substeps
        seeds = [int(word) for word in np.random.SeedSequence(seed).generate_state(5)]
        self._new_chance = lambda: (
            Encoder(
                period,
                resolution=encoder_resolution,
                position_noise=position_noise,
                offset=robot.encoder_offset,
                homing_error=homing_error,
                eccentricity=eccentricity,
                seed=seeds[0],
            ),
            PoseSensor(
                period,
                rate=pose_rate,
                delay=pose_delay,
                noise=pose_noise,
                dropout=pose_dropout,
                outages=pose_outages,
                seed=seeds[1],
            ),
            StampError(stamp_error, period, seeds[4]),
            random.Random(seeds[2]),
            random.Random(seeds[3]),
        )
        self._disturbances = Disturbances(payload=payload, payload_time=payload_time)
        self._delay: CommandDelay[TorqueCommand] = CommandDelay(
            round(command_delay / period)
        )
        self._delay_ns = self._delay.periods * self._period_ns
        self._timeout = round(_NANOSECONDS * command_timeout)
        self._has_pose = pose_rate > 0.0
        self._begin()

    def _begin(self) -> None:
        """Renew what stands between plant and controller, and take the first sample."""
        self._encoder, self._camera, self._stamps, self._losses, self._lateness = (
            self._new_chance()
        )
        self._delay.reset()
        self._hold = CommandHold(self._timeout, self.plant.max_torque)
        self._newest: TorqueCommand | None = None
        self._applied = (0.0, 0.0)
        self._index = 0
        self._pose: MeasuredPose | None = None
        self.samples_lost = 0
        self._measure()

    @property
    def time(self) -> float:
        """Time of the present sample, s."""
        return self._index * self.period

    @property
    def saturated(self) -> int:
        """Periods since the reset in which a command exceeded the drives' limit."""
        return self._hold.saturated

    @property
    def refused(self) -> int:
        """Commands since the reset that were not finite, in whose place the one before
        went on.
        """
        return self._hold.refused

    @property
    def trips(self) -> int:
        """Times since the reset that the drives let go of a command grown too old."""
        return self._hold.trips

    def reset(self, x: Numbers, x_dot: Numbers = (0.0, 0.0)) -> PlantState:
        """Put the end effector at x, (2,), m, with velocity x_dot, (2,), m/s, in the
        robot's working mode, at time 0.

        Raises:
            GeometryError: a leg does not reach x, or cannot move at x_dot there.
        """
        self._disturbances.reset(self.plant)
        state = self.plant.reset(x, x_dot)
        self._begin()
        return state

    def reset_joints(
        self, q_a: Numbers, assembly_mode: int, x_dot: Numbers = (0.0, 0.0)
    ) -> PlantState:
        """Put the active joints at q_a, (2,), rad, in the given assembly mode, at time
        0.

        Where the true geometry is not the model's, this is how a rig starts where its
        encoders say.

        Raises:
            GeometryError: the distal links do not meet there, or the elbows coincide.
        """
        self._disturbances.reset(self.plant)
        state = self.plant.reset_joints(q_a, assembly_mode, x_dot)
        self._begin()
        return state

    def _measure(self) -> None:
        state = self.plant.state()
        if self._has_pose:
            arrived = self._camera.sense(self._index, state.x.tolist())
            if arrived is not None:
                self._pose = MeasuredPose(
                    arrived.sample * self.period, np.array(arrived.x)
                )
        q_a = self._encoder.position(self.plant.encoder_angles())
        told = self._index * self.period + self._stamps.next()
        if self._loss and self._losses.random() < self._loss:
            self.samples_lost += 1
            self._sample: ControllerInput | None = None
        else:
            self._sample = ControllerInput(told, np.array(q_a), self._pose)
            self._pose = None

    def read(self) -> ControllerInput | None:
        """Return the present sample; None when it was lost."""
        return self._sample

    def write(self, torque: Numbers | None) -> Array:
        """Give the command that answers the present sample, and let one period pass.

        Args:
            torque: of the motors q11, q21, N m, shape (2,); None when there is no
                answer: the last command goes on.

        Returns:
            Torque of the drives at the end of the period, N m, shape (2,).
        """
        now = self._index * self._period_ns
        if torque is not None:
            self._newest = TorqueCommand(now, (float(torque[0]), float(torque[1])))
        delayed = self._delay.shift(self._newest)
        if delayed is not None:
            if self._delay_ns:
                delayed = TorqueCommand(delayed.stamp + self._delay_ns, delayed.torque)
            self._hold.receive(delayed)
        before, self._applied = self._applied, self._hold.torque(now)
        late = round(self._jitter * self._lateness.random()) if self._jitter else 0
        self._disturbances.before(self._index * self.period, self.plant)
        applied = self.plant.step(self._applied, before, late)
        self._index += 1
        self._measure()
        return applied

    def strike(self, impulse: Numbers) -> None:
        """Strike the end effector with an impulse, (2,), N s, during the coming
        period's first substep.
        """
        self.plant.apply_impulse(impulse)

    def truth(self) -> PlantState:
        """Return the true state now."""
        return self.plant.state()

    def close(self) -> None:
        """Let go of the plant; repeating it does no harm."""
        self.plant.close()
