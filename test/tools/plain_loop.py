"""plan -> estimate -> control -> plant in a plain ``for``, for a robot of any
mechanism; exact, or PyBullet's bodies.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from closed_loop import PERIOD, TURN, Bare, running

from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.model.exact_plant import ExactPlant
from dextar_control.model.model import Model
from dextar_control.model.robot import Robot
from dextar_control.planning.certificate import NEAR_LOCUS, Plan
from dextar_sim.body_plant import BodyPlant

SUBSTEPS = 4  # of PyBullet, a period
AFTER = 0.1  # s of holding after the trip
PlantOf = Callable[[Robot], Any]


def exact_plant(robot: Robot) -> ExactPlant:
    """The robot's own forward dynamics."""
    return ExactPlant(robot, PERIOD)


def pybullet_plant(robot: Robot) -> BodyPlant:
    """The mechanism's bodies in PyBullet."""
    return BodyPlant(
        robot.mechanism,
        robot.numbers,
        period=PERIOD,
        substeps=SUBSTEPS,
        max_torque=robot.max_torque,
    )


def turn_round(model: Model, plant: Any, blocks: tuple[int, ...]) -> None:
    """The velocity along t_s of these blocks of A_r turns round."""
    state = plant.state()
    t_s = model.place(state.x).t_s.reshape(model.n, -1)[:, list(blocks)]
    plant.reset(state.x, state.x_dot - 2.0 * t_s @ (t_s.T @ state.x_dot))


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
    plant_of: PlantOf = exact_plant,
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
    start, model = plan.trajectory.at(0.0).x, Model.of(built or robot)
    plant = plant_of(built or robot)
    plant.reset(start)
    loop = ControlLoop(
        robot,
        default_settings(estimator="observer", **changes),
        1 if float(model.place(start).s[0]) > 0.0 else -1,
        near=start,
    )
    loop.accept(plan.trajectory)
    count, rows = round((plan.trajectory.duration + AFTER) / PERIOD), []
    try:
        for sample, tau in running(loop, Bare(plant, resolution), count=count):
            x, tick = plant.state().x, loop.tick
            rows.append(
                [
                    np.array(part)
                    for part in (
                        x,
                        tick.reference.x,
                        tick.estimate.x,
                        model.place(x).s_blocks,
                        tau,
                    )
                ]
            )
            if turned is not None and abs(sample.time - turned) < 0.5 * PERIOD:
                turn_round(model, plant, turned_blocks)
    finally:
        getattr(plant, "close", lambda: None)()
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
