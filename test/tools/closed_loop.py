"""The one closed loop of tests and studies: plan -> estimate -> control -> rig in a plain
``for``; and blows to strike the robot with.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.control.phases import Phase
from dextar_control.estimation.estimate import ExternalPosition
from dextar_control.model.model import Model
from dextar_control.planning.planner import Plan
from dextar_sim.rig import ControllerInput, Rig

AFTER = 0.2  # s of holding after the trip
PERIOD = 1e-3  # s, of a plant without a rig
TURN = 2.0 * np.pi / 2**17  # rad, of an encoder's count

ran: list[ControlLoop] = []
"""The loops that ran in the present test, for what is told where it fails."""


class Bare:
    """A plant as a rig: encoders that count steps of ``resolution``, rad, exact with 0,
    and drives that give at once what they are told.
    """

    def __init__(self, plant: Any, resolution: float = 0.0) -> None:
        self.plant, self.resolution, self.truth = plant, resolution, plant.state
        self._begin, self._periods = float(plant.state().time), 0

    @property
    def time(self) -> float:
        """It goes on where the plant is put elsewhere, s."""
        return self._begin + self._periods * PERIOD

    def read(self) -> ControllerInput:
        q_a = np.array(self.plant.state().q_a)
        if self.resolution:
            q_a = np.round(q_a / self.resolution) * self.resolution
        return ControllerInput(self.time, q_a, None)

    def write(self, tau: np.ndarray) -> None:
        self.plant.step(tau)
        self._periods += 1


class Moment(NamedTuple):
    """A sample, and the answer to it, which the robot has not got yet."""

    sample: ControllerInput
    tau: np.ndarray  # (n,)


def running(
    loop: ControlLoop,
    rig: Any,
    *,
    until: float = np.inf,
    count: float = np.inf,
    seen: Callable[[ControllerInput], ControllerInput] = lambda sample: sample,
) -> Iterator[Moment]:
    """The closed loop: one period after the other, and what the caller does between
    happens before the robot goes on. Samples that are lost are left out; it ends where
    the joints are no numbers, behind a leg's Type 1 singularity.

    Args:
        loop: of the controller; it has its trajectory, or holds.
        rig: a simulator's, or a ``Bare`` plant; it is where the robot begins.
        until: time of the rig at which to end, s.
        count: of periods after which to end.
        seen: the sample as the controller sees it.
    """
    if loop not in ran:
        ran.append(loop)
    while rig.time < until and count > 0:
        sample, count = rig.read(), count - 1
        if sample is None:
            rig.write(None)
            continue
        if not np.isfinite(sample.q_a).all():
            return
        shown = seen(sample)
        pose = (
            None
            if shown.pose is None
            else ExternalPosition(shown.pose.time, shown.pose.x)
        )
        tau = loop.step(shown.time, shown.q_a, pose)
        yield Moment(sample, tau)
        rig.write(tau)


def advance(loop: ControlLoop, rig: Any, **span: float) -> np.ndarray:
    """Go through all of ``running``; the last torque."""
    tau = np.zeros(loop.model.n)
    for moment in running(loop, rig, **span):
        tau = moment.tau
    return tau


def told(loop: ControlLoop) -> str:
    """What to look at where a closed loop did not do what it should."""
    if loop.tick is None:
        return "it made no tick"
    tick = loop.tick
    verdicts = ", ".join(passed.verdict.name for passed in loop.passed) or "none"
    return (
        f"at {tick.time:.3f} s in {loop.phase.name}, s {float(np.ravel(tick.s)[0]):.3f},"
        f" assembly mode {tick.assembly_mode:+.0f} with confidence"
        f" {tick.confidence:.3f}; verdicts {verdicts}; {loop.completed} trips completed"
        f"; reason: {loop.reason or 'none'}; refusal: {loop.refusal or 'none'};"
        f" estimator: {getattr(loop.estimator, 'note', '') or 'nothing to tell'}"
    )


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
    s: np.ndarray  # estimated
    phases: list[Phase]
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
    rows, phases, notes = [], [], [""]

    def seen(sample: ControllerInput) -> ControllerInput:
        pose = sample.pose
        return sample._replace(pose=pose and pose._replace(x=pose.x + camera_off))

    try:
        rig.reset_joints(
            loop.model.inverse_geometric_model(plan.trajectory.at(0.0).x), 1
        )
        loop.accept(plan.trajectory)
        count = round((until or plan.trajectory.duration + AFTER) / rig.period)
        for sample, tau in running(loop, rig, count=count, seen=seen):
            truth, tick = rig.truth(), loop.tick
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
                    tick.s,
                ]
            )
            phases.append(tick.phase)
            if blow is not None and abs(sample.time - blow.time) < 0.5 * rig.period:
                rig.strike(blow.impulse)
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
        t[:, 14],
        phases,
        notes,
    )
