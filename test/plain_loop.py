"""plan -> estimate -> control -> plant in a plain ``for``, for a robot of any mechanism; exact, or PyBullet's bodies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.model.model import Model
from dextar_control.model.robot import Robot
from dextar_control.planning.certificate import NEAR_LOCUS, Plan
from dextar_sim.body_plant import BodyPlant

PERIOD = 1e-3  # s
SUBSTEPS = 4  # of Runge and Kutta's method, a period
AFTER = 0.1  # s of holding after the trip
TURN = 2.0 * np.pi / 2**17  # rad, of an encoder's count


class ExactPlant:
    """The mechanism's own forward dynamics, regular on the Type 2 locus, at rest in x (n,); joints through an encoder."""

    def __init__(self, robot: Robot, x: np.ndarray, resolution: float = TURN) -> None:
        self.model, self.resolution = Model.of(robot), resolution
        self.x, self.x_dot = x.copy(), np.zeros(self.model.n)

    def joints(self) -> np.ndarray:
        """(n,) as the encoders count them."""
        return np.round(self.model.place(self.x).q_a / self.resolution) * self.resolution

    def turn(self) -> None:
        """The velocity along t_s turns round."""
        t_s = self.model.place(self.x).t_s
        self.x_dot = self.x_dot - 2.0 * (t_s @ self.x_dot) * t_s

    def step(self, tau: np.ndarray) -> None:
        """One period under torques (n,)."""
        def rate(state: np.ndarray) -> np.ndarray:
            x, x_dot = np.split(state, 2)
            return np.concatenate([x_dot, self.model.platform_dynamics(self.model.place(x).q_a, x, x_dot, tau).x_ddot])

        state, h = np.concatenate([self.x, self.x_dot]), PERIOD / SUBSTEPS
        for _ in range(SUBSTEPS):
            k1 = rate(state)
            k2 = rate(state + 0.5 * h * k1)
            k3 = rate(state + 0.5 * h * k2)
            k4 = rate(state + h * k3)
            state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        self.x, self.x_dot = np.split(state, 2)

    def close(self) -> None:
        """Nothing is held."""


class PyBulletPlant:
    """The mechanism's bodies in PyBullet with the surface of ``ExactPlant``."""

    def __init__(self, robot: Robot, x: np.ndarray, resolution: float = TURN) -> None:
        self.model, self.resolution = Model.of(robot), resolution
        self._plant = BodyPlant(robot.mechanism, robot.numbers, period=PERIOD, substeps=SUBSTEPS, max_torque=robot.max_torque)
        self.close = self._plant.close
        self._plant.reset(x)

    @property
    def x(self) -> np.ndarray:
        """(n,) of the bodies."""
        return self._plant.state().x

    def joints(self) -> np.ndarray:
        """(n,) as the encoders count them."""
        return np.round(self._plant.state().q_a / self.resolution) * self.resolution

    def turn(self) -> None:
        """The velocity along t_s turns round."""
        state, t_s = self._plant.state(), self.model.place(self.x).t_s
        self._plant.reset(state.x, state.x_dot - 2.0 * (t_s @ state.x_dot) * t_s)

    def step(self, tau: np.ndarray) -> None:
        """One period under torques (n,)."""
        self._plant.step(tau)


class Run(NamedTuple):
    """A row each sample."""

    loop: ControlLoop
    x: np.ndarray  # true
    x_ref: np.ndarray
    x_hat: np.ndarray
    s: np.ndarray  # true
    tau: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """True distance from the reference, m."""
        return np.linalg.norm(self.x_ref - self.x, axis=1)

    @property
    def near_torque(self) -> float:
        """The largest torque near the locus."""
        return float(np.abs(self.tau[np.abs(self.s) < NEAR_LOCUS]).max())

    @property
    def sides(self) -> list[float]:
        """Signs of the true s, in turn."""
        signs = np.sign(self.s)
        return [signs[0], *signs[1:][np.diff(signs) != 0.0]]


def drive(
    robot: Robot, plan: Plan, built: Robot | None = None, resolution: float = TURN, *, turned: float | None = None,
    plant_of: type[ExactPlant] | type[PyBulletPlant] = ExactPlant, **changes: object,
) -> Run:  # fmt: skip
    """One trip of a robot as built, in the hands of a controller that knows it as ``robot``; over where a leg passes Type 1.

    Args:
        turned: moment, s, at which a blow turns the motion along t_s round, which the joints do not show on the locus.
        plant_of: what makes the plant.
    """
    start = plan.trajectory.at(0.0).x
    plant = plant_of(built or robot, start, resolution)
    s = float(plant.model.place(start).s[0])
    loop = ControlLoop(robot, default_settings(estimator="observer", **changes), 1 if s > 0.0 else -1, near=start)
    loop.accept(plan.trajectory)
    rows = []
    for k in range(round((plan.trajectory.duration + AFTER) / PERIOD)):
        q_a = plant.joints()
        if not np.isfinite(q_a).all():  # through Type 1, where the model of this working mode ends
            break
        tau = loop.step(k * PERIOD, q_a)
        tick = loop.tick
        assert tick is not None
        rows.append([plant.x, tick.reference.x, tick.estimate.x, tau, np.full(len(tau), plant.model.place(plant.x).s[0])])
        rows[-1] = [np.array(part) for part in rows[-1]]
        if turned is not None and abs(k * PERIOD - turned) < 0.5 * PERIOD:
            plant.turn()
        plant.step(tau)
    plant.close()
    x, x_ref, x_hat, torque, side = (np.array(part) for part in zip(*rows, strict=True))
    return Run(loop, x, x_ref, x_hat, side[:, 0], torque)


def heavier(robot: Robot, share: float) -> Robot:
    """The robot with all its masses and inertias times a share."""
    return robot.replace(**{
        key: share * value for key, value in robot.numbers.items() if key.endswith(("mass", "inertia"))
    })  # fmt: skip
