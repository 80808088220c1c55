"""The state of a plant, what all plants offer, and what is checked before one is
built.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple, Protocol

from dextar_control.contract.errors import ParameterError, StateError
from dextar_control.contract.robot import LegParameters, RobotParameters
from dextar_control.symbols.record import Field, Layout, Record
from dextar_control.symbols.types import Array, Numbers

_FRICTION_STABILITY = 1.0
"""Share of a joint's speed that friction may take away in one substep; beyond 2 it
would swing up.
"""


PlantState = Record
"""True state of a plant, of its ``state_layout``, in numbers of its own."""


@lru_cache
def state_layout(n: int, m: int) -> Layout:
    """Return the layout of the state of a plant with n active joints and m in all, each
    relative to its parent, in the order of the mechanism's bodies.
    """
    return Layout(
        "plant_state",
        n,
        (
            Field("time", "s", "steps taken times the period"),
            Field("q_a", "rad (m)", "active joints", "n"),
            Field("q_a_dot", "rad/s (m/s)", "their velocities", "n"),
            Field("joints", "rad (m)", "all joints", m),
            Field("joints_dot", "rad/s (m/s)", "their velocities", m),
            Field("x", "m", "platform", "n"),
            Field("x_dot", "m/s", "its velocity", "n"),
            Field(
                "loop_gap",
                "m",
                "largest distance of two places that are pinned together",
            ),
        ),
    )


class AnyPlant(Protocol):
    """What all plants offer."""

    robot: RobotParameters
    period: float
    substeps: int
    max_torque: float

    def reset(self, x: Numbers, x_dot: Numbers = (0.0, 0.0)) -> PlantState:
        """Put the end effector at x, (2,), m, with velocity x_dot, (2,), m/s, in the
        robot's working mode, at time 0.
        """

    def reset_joints(
        self,
        q_a: Numbers,
        assembly_mode: int,
        x_dot: Numbers = (0.0, 0.0),
    ) -> PlantState:
        """Put the active joints at q_a, (2,), rad, in the given assembly mode, at time
        0.
        """

    def step(
        self,
        torque: Numbers,
        earlier: Numbers | None = None,
        late: int = 0,
    ) -> Array:
        """Advance one period under torques, (2,), N m; they act after ``late`` substeps
        under the earlier ones. Return the motor torques at its end, (2,), N m.
        """

    def take_up(self, mass: float) -> None:
        """Load the end effector with a mass, kg, that moves with it."""

    def encoder_angles(self) -> list[float]:
        """Return the angles of the encoders' discs, (2,), rad."""

    def apply_impulse(self, impulse: Numbers) -> None:
        """Strike the end effector with an impulse, (2,), N s, during the next step's
        first substep.
        """

    def state(self) -> PlantState:
        """Return the true state now."""

    def close(self) -> None:
        """Let go of what the plant holds."""


class Motor(NamedTuple):
    """A motor as its friction loads it.

    Attributes:
        name: of its side.
        steepness: friction over speed at rest, N m s/rad (N s/m).
        inertia: of what it moves alone, kg m^2 (kg).
    """

    name: str
    steepness: float
    inertia: float


def proximal_inertia(leg: LegParameters) -> float:
    """Return the inertia that a motor moves alone, kg m^2."""
    return (
        leg.proximal_inertia
        + leg.rotor_inertia
        + leg.proximal_mass * (leg.proximal_center * leg.proximal_length) ** 2
    )


def leg_motors(robot: RobotParameters) -> list[Motor]:
    """List the motors of a five-bar."""
    return [
        Motor(
            side,
            leg.viscous_friction + leg.coulomb_friction / robot.coulomb_speed,
            proximal_inertia(leg),
        )
        for side, leg in zip(robot.sides, robot.legs, strict=True)
    ]


def check_steps(period: float, substeps: int, motors: Sequence[Motor]) -> None:
    """Refuse a period or substeps out of range, and explicit friction that would turn a
    joint round within one substep.

    Args:
        period: duration of one step, s.
        substeps: physics steps in one step.
        motors: of the robot.

    Raises:
        ParameterError: period or substeps out of range, friction too steep for the
            substep.
    """
    if not (period > 0.0 and math.isfinite(period)):
        raise ParameterError(f"period = {period} s; it must be > 0")
    if substeps < 1:
        raise ParameterError(f"substeps = {substeps}; it must be >= 1")
    substep = period / substeps
    for side, slope, inertia in motors:
        if slope * substep > _FRICTION_STABILITY * inertia:
            raise ParameterError(
                f"{side} joint friction of {slope:g} N m s/rad at rest is too steep for"
                f" {inertia:g} kg m^2 and substeps of {substep:g} s; substeps must be"
                f" >= {math.ceil(slope * period / (_FRICTION_STABILITY * inertia))}, or"
                " coulomb_speed larger"
            )


def saturated(torque: Numbers, limit: float) -> tuple[float, ...]:
    """Return motor torques within the limit, N m.

    Raises:
        StateError: a torque is not finite.
    """
    wanted = list(map(float, torque))
    if all([-limit <= value <= limit for value in wanted]):
        return tuple(wanted)
    if not all(map(math.isfinite, wanted)):
        raise StateError(
            f"motor torque ({', '.join(map(str, wanted))}) N m is not finite"
        )
    return tuple(
        [
            limit if value > limit else -limit if value < -limit else value
            for value in wanted
        ]
    )
