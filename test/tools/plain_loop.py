"""plan -> estimate -> control -> plant in a plain ``for``, for a robot of any
mechanism; exact, or PyBullet's bodies.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.model import exact_plant
from dextar_control.model.model import Model
from dextar_control.model.robot import Robot
from dextar_control.planning.certificate import NEAR_LOCUS, Plan
from dextar_sim.body_plant import BodyPlant

PERIOD = 1e-3  # s
SUBSTEPS = 4  # of Runge and Kutta's method, a period
AFTER = 0.1  # s of holding after the trip
TURN = 2.0 * np.pi / 2**17  # rad, of an encoder's count


class ExactPlant:
    """The package's, at rest in x (n,); joints through an encoder."""

    def __init__(self, robot: Robot, x: np.ndarray, resolution: float = TURN) -> None:
        self.resolution, self._plant = resolution, exact_plant.ExactPlant(robot, PERIOD)
        self.model, self.step = self._plant.model, self._plant.step
        self._plant.reset(x)

    @property
    def x(self) -> np.ndarray:
        """(n,) of the platform."""
        return self._plant.state().x

    def joints(self) -> np.ndarray:
        """(n,) as the encoders count them."""
        return np.round(self._plant.state().q_a / self.resolution) * self.resolution

    def turn(self, blocks: tuple[int, ...]) -> None:
        """The velocity along t_s of these blocks of A_r turns round."""
        state = self._plant.state()
        self._plant.reset(state.x, _turned(self.model, state.x, state.x_dot, blocks))

    def close(self) -> None:
        """Nothing is held."""


class PyBulletPlant:
    """The mechanism's bodies in PyBullet with the surface of ``ExactPlant``."""

    def __init__(self, robot: Robot, x: np.ndarray, resolution: float = TURN) -> None:
        self.model, self.resolution = Model.of(robot), resolution
        self._plant = BodyPlant(
            robot.mechanism,
            robot.numbers,
            period=PERIOD,
            substeps=SUBSTEPS,
            max_torque=robot.max_torque,
        )
        self.close = self._plant.close
        self._plant.reset(x)

    @property
    def x(self) -> np.ndarray:
        """(n,) of the bodies."""
        return self._plant.state().x

    def joints(self) -> np.ndarray:
        """(n,) as the encoders count them."""
        return np.round(self._plant.state().q_a / self.resolution) * self.resolution

    def turn(self, blocks: tuple[int, ...]) -> None:
        """The velocity along t_s of these blocks of A_r turns round."""
        state = self._plant.state()
        self._plant.reset(state.x, _turned(self.model, state.x, state.x_dot, blocks))

    def step(self, tau: np.ndarray) -> None:
        """One period under torques (n,)."""
        self._plant.step(tau)


def _turned(
    model: Model, x: np.ndarray, x_dot: np.ndarray, blocks: tuple[int, ...]
) -> np.ndarray:
    t_s = model.place(x).t_s.reshape(model.n, -1)[:, list(blocks)]
    return x_dot - 2.0 * t_s @ (t_s.T @ x_dot)


class Run(NamedTuple):
    """A row each sample."""

    loop: ControlLoop
    x: np.ndarray  # true
    x_ref: np.ndarray
    x_hat: np.ndarray
    s_blocks: np.ndarray  # true, of each block of A_r
    tau: np.ndarray

    @property
    def s(self) -> np.ndarray:
        """True, of the nearest block."""
        return self.s_blocks[
            np.arange(len(self.s_blocks)), np.abs(self.s_blocks).argmin(axis=1)
        ]

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
        """Signs of the true s of the first block, in turn."""
        return self.sides_of(0)

    def sides_of(self, block: int) -> list[float]:
        """The same of any block."""
        signs = np.sign(self.s_blocks[:, block])
        return [signs[0], *signs[1:][np.diff(signs) != 0.0]]


def drive(
    robot: Robot,
    plan: Plan,
    built: Robot | None = None,
    resolution: float = TURN,
    *,
    turned: float | None = None,
    turned_blocks: tuple[int, ...] = (0,),
    plant_of: type[ExactPlant] | type[PyBulletPlant] = ExactPlant,
    **changes: object,
) -> Run:
    """One trip of a robot as built, in the hands of a controller that knows it as
    ``robot``; over where a leg passes Type 1.

    Args:
        turned: moment, s, at which a blow turns the motion along t_s round, which the
            joints do not show on the locus.
        turned_blocks: of A_r, whose motion that is.
        plant_of: what makes the plant.
    """
    start = plan.trajectory.at(0.0).x
    plant = plant_of(built or robot, start, resolution)
    s = float(plant.model.place(start).s[0])
    loop = ControlLoop(
        robot,
        default_settings(estimator="observer", **changes),
        1 if s > 0.0 else -1,
        near=start,
    )
    loop.accept(plan.trajectory)
    rows = []
    for k in range(round((plan.trajectory.duration + AFTER) / PERIOD)):
        q_a = plant.joints()
        if not np.isfinite(
            q_a
        ).all():  # through Type 1, where the model of this working mode ends
            break
        tau = loop.step(k * PERIOD, q_a)
        tick = loop.tick
        assert tick is not None
        rows.append(
            [
                plant.x,
                tick.reference.x,
                tick.estimate.x,
                plant.model.place(plant.x).s_blocks,
                tau,
            ]
        )
        rows[-1] = [np.array(part) for part in rows[-1]]
        if turned is not None and abs(k * PERIOD - turned) < 0.5 * PERIOD:
            plant.turn(turned_blocks)
        plant.step(tau)
    plant.close()
    return Run(loop, *(np.array(part) for part in zip(*rows, strict=True)))


def heavier(robot: Robot, share: float) -> Robot:
    """The robot with all its masses and inertias times a share."""
    return robot.replace(
        **{
            key: share * value
            for key, value in robot.numbers.items()
            if key.endswith(("mass", "inertia"))
        }
    )
