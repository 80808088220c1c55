"""What every plant says about itself, and what it checks before it is built."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from dextar_control.contract.errors import ParameterError, StateError
from dextar_control.contract.robot import RobotParameters

_FRICTION_STABILITY = 1.0
"""Share of a joint's speed that friction may take away in one substep; beyond 2 it would swing up."""


class PlantState(NamedTuple):
    """True state of the plant.

    Attributes:
        time: steps taken times the period, s.
        q_a, q_a_dot: the n active joints, rad (m) and rad/s (m/s), shape (n,).
        joints, joints_dot: all m joints in the order of the mechanism's bodies, each relative to its parent, shape (m,).
        x, x_dot: of the platform, m and m/s, shape (n,).
        loop_gap: the largest distance of two places that are pinned together, m.
    """

    time: float
    q_a: np.ndarray  # (n,)
    q_a_dot: np.ndarray  # (n,)
    joints: np.ndarray  # (m,)
    joints_dot: np.ndarray  # (m,)
    x: np.ndarray  # (n,)
    x_dot: np.ndarray  # (n,)
    loop_gap: float


def state_of(time: float, flat: np.ndarray, n: int) -> PlantState:
    """A state whose arrays are views of one.

    Args:
        time: s.
        flat: shape (4 n + 2 m + 1,): all of the state but the time, in its order.
        n: active joints.
    """
    a, c = 2 * n, len(flat) - 2 * n - 1
    b, d = (a + c) // 2, c + n
    return PlantState(time, flat[:n], flat[n:a], flat[a:b], flat[b:c], flat[c:d], flat[d:-1], float(flat[-1]))


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


class Motor(NamedTuple):
    """A motor as its friction sees it.

    Attributes:
        name: of its side.
        steepness: friction over speed at rest, N m s/rad (N s/m).
        inertia: of what it moves alone, kg m^2 (kg).
    """

    name: str
    steepness: float
    inertia: float


def leg_motors(robot: RobotParameters) -> list[Motor]:
    """Those of a five-bar."""
    return [
        Motor(side, leg.viscous_friction + leg.coulomb_friction / robot.coulomb_speed,
              leg.proximal_inertia + leg.rotor_inertia + leg.proximal_mass * (leg.proximal_center * leg.proximal_length) ** 2)
        for side, leg in zip(robot.sides, robot.legs, strict=True)
    ]  # fmt: skip


def check_steps(period: float, substeps: int, motors: Sequence[Motor]) -> None:
    """Refuse steps that are none, and an explicit friction that would turn a joint round within one substep.

    Args:
        period: duration of one step, s.
        substeps: physics steps in one step.
        motors: of the robot.

    Raises:
        ParameterError: period or substeps out of range, friction too steep for the substep.
    """
    if not (period > 0.0 and math.isfinite(period)):
        raise ParameterError(f"period = {period} s; it must be > 0")
    if substeps < 1:
        raise ParameterError(f"substeps = {substeps}; it must be >= 1")
    substep = period / substeps
    for side, slope, inertia in motors:
        if slope * substep > _FRICTION_STABILITY * inertia:
            raise ParameterError(
                f"{side} joint friction of {slope:g} N m s/rad at rest is too steep for {inertia:g} kg m^2 and "
                f"substeps of {substep:g} s; substeps must be >= "
                f"{math.ceil(slope * period / (_FRICTION_STABILITY * inertia))}, or coulomb_speed larger"
            )


def saturated(torque: Sequence[float], limit: float) -> tuple[float, ...]:
    """Motor torques within the limit, N m.

    Raises:
        StateError: a torque is not finite.
    """
    wanted = list(map(float, torque))
    if not all(map(math.isfinite, wanted)):
        raise StateError(f"motor torque ({', '.join(map(str, wanted))}) N m is not finite")
    return tuple([limit if value > limit else -limit if value < -limit else value for value in wanted])
