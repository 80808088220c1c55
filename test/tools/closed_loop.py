"""plan -> estimate -> control -> rig in a plain ``for``, and blows to strike the robot
with.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.estimation.estimate import Pose
from dextar_control.model.model import Model
from dextar_control.planning.planner import Plan
from dextar_sim.rig import Rig

AFTER = 0.2  # s of holding after the trip


def state_of(model: Model, x: np.ndarray, x_dot: np.ndarray) -> SimpleNamespace:
    """Kinematics of a platform position and velocity (n,) in the model's working mode,
    with both.
    """
    q_a = model.place(x).q_a
    return SimpleNamespace(
        x=x, x_dot=x_dot, q_a=q_a, **model.state(q_a, x, x_dot)._asdict()
    )


def s_of(model: Model, x: np.ndarray) -> float:
    """Singularity measure of a platform position (n,)."""
    return float(model.place(x).s[0])


class Blow(NamedTuple):
    """An impulse on the end effector."""

    time: float  # s
    impulse: np.ndarray  # (2,) N s


class Run(NamedTuple):
    """A row each sample."""

    loop: ControlLoop
    time: np.ndarray
    x: np.ndarray  # true
    x_ref: np.ndarray
    x_hat: np.ndarray
    side: np.ndarray  # true sign of s
    mode: np.ndarray  # believed
    confidence: np.ndarray
    q_a: np.ndarray  # measured
    tau: np.ndarray  # commanded
    notes: list[str]  # in turn, each once

    @property
    def error(self) -> np.ndarray:
        """True distance from the reference, m."""
        return np.hypot(*(self.x_ref - self.x).T)

    @property
    def estimate_error(self) -> np.ndarray:
        """True distance from the estimate, m."""
        return np.hypot(*(self.x_hat - self.x).T)


def turn_round(
    robot: RobotParameters, plan: Plan, moment: float, restitution: float
) -> Blow:
    """A blow at a moment of the plan that turns the motion along t_s round, which the
    joints do not show.
    """
    point, model = plan.trajectory.at(moment), Model.of(robot)
    q_a, t_s = model.place(point.x).q_a, model.place(point.x).t_s
    mass = model.platform_dynamics(q_a, point.x, point.x_dot, np.zeros(2)).M
    return Blow(moment, -(1.0 + restitution) * mass @ ((t_s @ point.x_dot) * t_s))


def drive(
    robot: RobotParameters,
    plan: Plan,
    built: RobotParameters | None = None,
    *,
    blow: Blow | None = None,
    until: float | None = None,
    camera_off: float = 0.0,
    settings: dict | None = None,
    **rig_options,
) -> Run:
    """One trip; ``camera_off`` moves what the camera sees, m."""
    rig = Rig(built or robot, **rig_options)
    loop = ControlLoop(robot, default_settings(**(settings or {})), 1)
    rows, notes = [], [""]
    try:
        rig.reset_joints(
            loop.model.inverse_geometric_model(plan.trajectory.at(0.0).x), 1
        )
        loop.accept(plan.trajectory)
        for _ in range(round((until or plan.trajectory.duration + AFTER) / rig.period)):
            sample, truth = rig.read(), rig.truth()
            pose = (
                None
                if sample.pose is None
                else Pose(sample.pose.time, sample.pose.x + camera_off)
            )
            tau = loop.step(sample.time, sample.q_a, pose)
            tick = loop.tick
            if loop.estimator.note != notes[-1]:
                notes.append(loop.estimator.note)
            side = np.sign(loop.model.place(truth.x).s[0])
            rows.append(
                [
                    sample.time,
                    *truth.x,
                    *tick.x_ref,
                    *tick.x_hat,
                    side,
                    tick.assembly_mode,
                    tick.confidence,
                    *sample.q_a,
                    *tau,
                ]
            )
            if blow is not None and abs(sample.time - blow.time) < 0.5 * rig.period:
                rig.strike(blow.impulse)
            rig.write(tau)
    finally:
        rig.close()
    t = np.array(rows)
    return Run(
        loop,
        t[:, 0],
        t[:, 1:3],
        t[:, 3:5],
        t[:, 5:7],
        t[:, 7],
        t[:, 8],
        t[:, 9],
        t[:, 10:12],
        t[:, 12:14],
        notes,
    )
