"""What every plant says about itself, and what it checks before it is built."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from dextar_control.contract.errors import ParameterError, StateError
from dextar_control.contract.robot import RobotParameters
from dextar_control.symbols.record import Field, Layout, Record

_FRICTION_STABILITY = 1.0
"""Share of a joint's speed that friction may take away in one substep; beyond 2 it would swing up."""


STATE = Layout("plant_state", 2, (
    Field("time", "s", "steps taken times the period"),
    Field("q_a", "rad", "active joints q11, q21", 2),
    Field("q_a_dot", "rad/s", "their velocities", 2),
    Field("joints", "rad", "q11, q12, q21, q22, passive joints relative to their proximal link", 4),
    Field("joints_dot", "rad/s", "their velocities", 4),
    Field("x", "m", "end effector, the mean of both distal tips", 2),
    Field("x_dot", "m/s", "its velocity", 2),
    Field("loop_gap", "m", "distance of the distal tips"),
))
PlantState = Record  # of STATE: the true state of a plant, in numbers of its own


class AnyPlant(Protocol):
    """The surface that all plants share."""

    robot: RobotParameters
    period: float
    substeps: int
    max_torque: float

    def reset(self, x: Sequence[float], x_dot: Sequence[float] = (0.0, 0.0)) -> PlantState:
        """Put the end effector at x with velocity x_dot, in the robot's working mode, at time 0."""

    def reset_joints(
        self, q_a: Sequence[float], assembly_mode: int, x_dot: Sequence[float] = (0.0, 0.0)
    ) -> PlantState:
        """Put the active joints at q_a in the given assembly mode, at time 0."""

    def step(self, torque: Sequence[float], earlier: Sequence[float] | None = None, late: int = 0) -> np.ndarray:
        """Advance one period; the torque acts after ``late`` substeps under the earlier one."""

    def apply_impulse(self, impulse: Sequence[float]) -> None:
        """Strike the end effector with an impulse during the next step's first substep."""

    def state(self) -> PlantState:
        """The true state now."""

    def close(self) -> None:
        """Let go of what the plant holds."""


def check_steps(robot: RobotParameters, period: float, substeps: int) -> None:
    """Refuse steps that are none, and an explicit friction that would turn a joint round within one substep.

    Args:
        robot: the description.
        period: duration of one step, s.
        substeps: physics steps in one step.

    Raises:
        ParameterError: period or substeps out of range, friction too steep for the substep.
    """
    if not (period > 0.0 and math.isfinite(period)):
        raise ParameterError(f"period = {period} s; it must be > 0")
    if substeps < 1:
        raise ParameterError(f"substeps = {substeps}; it must be >= 1")
    substep = period / substeps
    for side, leg in (("left", robot.left), ("right", robot.right)):
        slope = leg.viscous_friction + leg.coulomb_friction / robot.coulomb_speed
        inertia = (
            leg.proximal_inertia + leg.rotor_inertia + leg.proximal_mass * (leg.proximal_center * leg.proximal_length) ** 2
        )
        if slope * substep > _FRICTION_STABILITY * inertia:
            raise ParameterError(
                f"{side} joint friction of {slope:g} N m s/rad at rest is too steep for {inertia:g} kg m^2 and "
                f"substeps of {substep:g} s; substeps must be >= "
                f"{math.ceil(slope * period / (_FRICTION_STABILITY * inertia))}, or coulomb_speed larger"
            )


def saturated(torque: Sequence[float], limit: float) -> tuple[float, float]:
    """Motor torques within the limit, N m.

    Raises:
        StateError: a torque is not finite.
    """
    first, second = torque
    if -limit <= first <= limit and -limit <= second <= limit:
        return float(first), float(second)
    if not (math.isfinite(first) and math.isfinite(second)):
        raise StateError(f"motor torque ({first}, {second}) N m is not finite")
    return float(max(-limit, min(limit, first))), float(max(-limit, min(limit, second)))
