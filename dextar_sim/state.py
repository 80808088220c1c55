"""The state of a plant, and what is checked before one is built."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

from dextar_control.contract.errors import ParameterError, StateError
from dextar_control.contract.robot import LegParameters, RobotParameters
from dextar_control.symbols.record import Field, Layout, Record
from dextar_control.symbols.types import Numbers

# Share of a joint's speed that friction may take away in one substep; beyond 2 it would
# swing up.
_FRICTION_STABILITY = 1.0


# True state of a plant, of its ``state_layout``, in numbers of its own.
PlantState = Record


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
