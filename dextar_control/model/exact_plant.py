"""A robot that is exactly its model: the forward dynamics, integrated."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dextar_control.model.model import Model
from dextar_control.model.robot import AnyRobot
from dextar_control.symbols.types import Array, Numbers

SUBSTEPS = 4  # of Runge and Kutta's method in a period


class ExactState(NamedTuple):
    """The state of the plant."""

    time: float  # since it was reset, s
    q_a: Array  # (n,) rad (m); nan where a leg does not reach
    x: Array  # (n,) m
    x_dot: Array  # (n,) m/s


class ExactPlant:
    """A robot for a plain loop, integrated by the forward dynamics of its model.

    These are regular on the Type 2 locus. A model of other numbers than the
    controller's makes a robot that the controller knows badly.

    Args:
        robot: as it was built.
        period: of a step, s.
    """

    def __init__(self, robot: AnyRobot, period: float = 1e-3) -> None:
        self.model, self.period = Model.of(robot), period
        self.reset(np.zeros(self.model.n))

    def reset(self, x: Numbers, x_dot: Numbers = ()) -> None:
        """Put the platform at x (n,), m, with velocity x_dot (n,), m/s (at rest when
        empty), at time 0.
        """
        velocity = x_dot if len(x_dot) else np.zeros(self.model.n)
        self._steps, self._state = 0, np.concatenate([x, velocity])

    def state(self) -> ExactState:
        """The present state."""
        x, x_dot = np.split(self._state, 2)
        return ExactState(self._steps * self.period, self.model.place(x).q_a, x, x_dot)

    def step(self, torque: Numbers) -> None:
        """Advance one period under constant torques (n,), N m (N)."""
        state, h, tau = self._state, self.period / SUBSTEPS, np.asarray(torque)
        for _ in range(SUBSTEPS):
            k1 = self._rate(state, tau)
            k2 = self._rate(state + 0.5 * h * k1, tau)
            k3 = self._rate(state + 0.5 * h * k2, tau)
            k4 = self._rate(state + h * k3, tau)
            state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        self._steps, self._state = self._steps + 1, state

    def _rate(self, state: Array, tau: Array) -> Array:
        """The rate of (x, x_dot), (2n,), under torques (n,), N m (N)."""
        x, x_dot = np.split(state, 2)
        q_a = self.model.place(x).q_a
        x_ddot = self.model.platform_dynamics(q_a, x, x_dot, tau).x_ddot
        return np.concatenate([x_dot, x_ddot])
