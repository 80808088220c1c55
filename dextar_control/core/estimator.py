"""Estimators behind one interface: where the platform is, in which assembly mode, and how sure that is.

- ``plain``: the direct model everywhere.
- ``dgm``: the paper's, the direct model with its precautions around the locus (``core.dgm``). It takes
  the reference's assembly mode for the robot's: after a crossing it is not sure at all.
- ``observer``: a filter over the Cartesian dynamics (``core.observer``); tells crossed from bounced.
- ``external``: the observer fused with an external position measurement (``core.external``).
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from dextar_control.contract.robot import RobotParameters
from dextar_control.core import dgm, observer
from dextar_control.core.compiled import njit
from dextar_control.core.dgm import JointMemory
from dextar_control.core.kinematics import kinematics, singularity, state_of_platform
from dextar_control.core.law import CONFIDENCE, ESTIMATE, MODE_HAT, Q_HAT, Q_REF, S_REF, X_HAT, X_REF
from dextar_control.core.model import Array, Model, make_model, pack, unpack
from dextar_control.core.observer import BELIEF, CERTAIN, FILTER, LOG_ODDS, MODE, REST_SPEED, SWAPS, Bank, Gauss, Noise, Passage
from dextar_control.core.settings import Estimation, Settings


class Pose(NamedTuple):
    """An external measurement of the end effector."""

    time: float  # when it was true, in the time of the samples, s
    x: Array  # (2,) m


class Estimator(Protocol):
    """What the loop asks of an estimator; ``row`` is laid out as ``law.X_HAT`` and the following say.

    Attributes:
        row: the estimate: x, x_dot, q_a, q_a_dot, assembly mode, confidence in it (0.5 to 1).
        s: singularity measure of the estimate.
        note: what there is to say of the external measurements; empty when they are taken as they come.
    """

    row: Array
    s: float
    note: str

    @property
    def mode_known(self) -> bool:
        """Whether the assembly mode is known well enough to begin a motion from."""

    @property
    def unknown_s(self) -> float:
        """|s| of the locus within which a robot at rest is on no known side, whatever was told."""

    def configure(self, settings: Settings) -> None:
        """Take the settings that concern it, also while running."""

    def start(self, x: Array, q_a: Array, assembly_mode: int) -> None:
        """The robot rests at x (2,) with joints q_a (2,), in a known assembly mode."""

    def tell_mode(self, assembly_mode: int, q_a: Array) -> None:
        """Somebody looked: the robot is in this assembly mode, with joints q_a (2,); it may move."""

    def rebase(self, q_a: Array) -> None:
        """The reference is at rest at q_a (2,) from now on, without the robot having moved."""

    def release(self, crossing: bool) -> None:
        """There is no reference from now on; it ends while crossing or not."""

    def track(self, dt: float, q_a: Array, tau: Array, reference: Array, zone: float, width: float) -> None:
        """One sample while a law acts: joints q_a measured, tau acted since the last one, dt ago."""

    def coast(self, dt: float, q_a: Array, tau: Array) -> None:
        """One sample without a reference."""

    def take_pose(self, pose: Pose, time: float) -> None:
        """An external measurement that has arrived at ``time``; ignored by estimators without use for it."""


@njit
def _track_dgm(
    packed: Array, memory: JointMemory, reference: Array, zone: float, width: float, time_outside: float,
    time_return: float, bandwidth: float, dt: float, q_meas: Array, mode: float, row: Array,
) -> float:  # fmt: skip
    model = unpack(packed)
    planned = kinematics(model, reference[Q_REF : Q_REF + 2], reference[X_REF : X_REF + 2], reference[X_REF + 2 : X_REF + 4])
    dgm.filter_joints(memory, q_meas, planned.q_a, planned.q_a_dot, dt, bandwidth)
    estimate = dgm.estimate_platform(
        model, memory, planned, reference[S_REF], zone, width, time_outside, time_return, mode
    )
    return _fill(model, memory, estimate.x, estimate.x_dot, row)


@njit
def _coast_dgm(packed: Array, memory: JointMemory, bandwidth: float, dt: float, q_meas: Array, mode: float, row: Array) -> float:
    model = unpack(packed)
    dgm.filter_joints(memory, q_meas, memory.q_ref, np.zeros(2), dt, bandwidth)
    memory.q_ref[:] = memory.q
    estimate = dgm.direct_estimate(model, memory, mode)
    return _fill(model, memory, estimate.x, estimate.x_dot, row)


@njit
def _fill(model: Model, memory: JointMemory, x: Array, x_dot: Array, row: Array) -> float:
    row[X_HAT : X_HAT + 2] = x
    row[X_HAT + 2 : X_HAT + 4] = x_dot
    row[Q_HAT : Q_HAT + 2] = memory.q
    row[Q_HAT + 2 : Q_HAT + 4] = memory.q_dot
    return singularity(model, kinematics(model, memory.q, x, x_dot).A_r)


class DirectEstimator:
    """``dgm`` and, with ``held`` false, ``plain``."""

    def __init__(self, robot: RobotParameters, settings: Settings, *, held: bool) -> None:
        self._packed = pack(make_model(robot))
        self._held = held
        self._memory = JointMemory(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2))
        self._mode = 1.0
        self._outside = np.inf
        self.row = np.zeros(ESTIMATE)
        self.s = np.nan
        self.mode_known = True
        self.note = ""
        self.configure(settings)

    def configure(self, settings: Settings) -> None:
        """See ``Estimator``."""
        self._bandwidth, self._return_time = settings.filter_bandwidth, settings.return_time
        self.unknown_s = settings.hold_zone

    def start(self, x: Array, q_a: Array, assembly_mode: int) -> None:
        """See ``Estimator``."""
        self._memory.q[:] = q_a
        self._memory.q_dot[:] = 0.0
        self.rebase(q_a)
        self.tell_mode(assembly_mode, q_a)

    def tell_mode(self, assembly_mode: int, q_a: Array) -> None:
        """See ``Estimator``."""
        self._mode = float(assembly_mode)
        self.row[MODE_HAT], self.row[CONFIDENCE] = self._mode, 1.0
        self.mode_known = True

    def rebase(self, q_a: Array) -> None:
        """See ``Estimator``."""
        self._memory.q_ref[:] = q_a
        self._memory.q_ref_dot[:] = 0.0
        self._outside = np.inf

    def release(self, crossing: bool) -> None:
        """See ``Estimator``."""
        self.mode_known = self.mode_known and not crossing
        self._memory.q_ref[:] = self._memory.q
        self._memory.q_ref_dot[:] = 0.0

    def track(self, dt: float, q_a: Array, tau: Array, reference: Array, zone: float, width: float) -> None:
        """See ``Estimator``."""
        s_ref = reference[S_REF]
        if s_ref * self._mode < 0.0:  # the reference has crossed: the direct model's branch changes with it
            self._mode = -self._mode
            self.row[MODE_HAT], self.row[CONFIDENCE] = self._mode, 0.5
        self.s = _track_dgm(
            self._packed, self._memory, reference, zone if self._held else 0.0, width, self._outside,
            self._return_time, self._bandwidth, dt, q_a, self._mode, self.row,
        )  # fmt: skip
        self._outside = self._outside + dt if abs(s_ref) > zone else 0.0

    def coast(self, dt: float, q_a: Array, tau: Array) -> None:
        """See ``Estimator``."""
        self.s = _coast_dgm(self._packed, self._memory, self._bandwidth, dt, q_a, self._mode, self.row)
        if not abs(self.s) >= self.unknown_s:
            self.mode_known = False
            self.row[CONFIDENCE] = 0.5

    def take_pose(self, pose: Pose, time: float) -> None:
        """See ``Estimator``."""


@njit
def _begin(packed: Array, noise: Noise, x: Array, speed: float, bank: Bank) -> None:
    observer.begin(unpack(packed), noise, x, speed, bank.main)
    observer.copy(bank.main, bank.same)


@njit
def _observe(
    packed: Array, tuning: Array, filters: Array, belief: Array, tau: Array, dt: float, q_meas: Array, row: Array
) -> float:
    model = unpack(packed)
    noise, passage = observer.unpack_tuning(tuning)
    bank = observer.unpack_bank(filters)
    observer.observe(model, noise, passage, bank, belief, tau, dt, q_meas)
    return row_of(model, bank.main, belief, row)


@njit
def row_of(model: Model, main: Gauss, belief: Array, row: Array) -> float:
    """Write the estimate's row of a filter and a belief; s of it."""
    kin = state_of_platform(model, main.mean[0:2], main.mean[2:4])
    row[X_HAT : X_HAT + 4] = main.mean[0:4]
    for i in range(2):
        row[Q_HAT + i] = kin.q_a[i] + main.mean[4 + i]
    row[Q_HAT + 2 : Q_HAT + 4] = kin.q_a_dot
    row[MODE_HAT] = belief[MODE]
    odds = belief[LOG_ODDS]
    if odds >= 0.0:
        row[CONFIDENCE] = 1.0 / (1.0 + np.exp(-odds))
    else:  # the image is the likelier one
        row[MODE_HAT] = -belief[MODE]
        row[CONFIDENCE] = 1.0 / (1.0 + np.exp(odds))
    return singularity(model, kin.A_r)


@njit
def _filter(memory: JointMemory, q_meas: Array, dt: float, bandwidth: float, row: Array) -> None:
    """The joints' own motion, in place of the one that the platform's estimate implies; begun anew where that was none."""
    if not np.isfinite(memory.q + memory.q_dot).all():
        memory.q[:] = q_meas
        memory.q_dot[:] = 0.0
    dgm.filter_joints(memory, q_meas, memory.q_ref, np.zeros(2), dt, bandwidth)
    row[Q_HAT : Q_HAT + 2] = memory.q
    row[Q_HAT + 2 : Q_HAT + 4] = memory.q_dot


class ObserverEstimator:
    """``observer``."""

    def __init__(self, robot: RobotParameters, settings: Settings) -> None:
        self._packed = pack(make_model(robot))
        self._filters = np.zeros((3, FILTER))
        self._bank = observer.unpack_bank(self._filters)
        self._belief = np.zeros(BELIEF)
        self._joints = JointMemory(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2))
        self.row = np.zeros(ESTIMATE)
        self.s = np.nan
        self.note = ""
        self.configure(settings)

    def configure(self, settings: Settings) -> None:
        """See ``Estimator``."""
        self._noise = Noise(
            settings.encoder_deviation, settings.bias_deviation, settings.bias_walk, settings.torque_deviation,
            settings.acceleration_deviation, settings.shock_gate**2, settings.shock_speed,
        )  # fmt: skip
        tight = self._noise._replace(
            encoder=settings.passage_encoder_deviation, torque=settings.passage_torque_deviation,
            acceleration=settings.passage_acceleration_deviation,
        )  # fmt: skip
        passage = Passage(settings.passage_armed, settings.passage_begin, settings.passage_log_odds, tight)
        self._tuning = observer.pack_tuning(self._noise, passage)
        self.unknown_s = settings.passage_armed
        self._sure, self._bandwidth = settings.verdict_confidence, settings.filter_bandwidth

    @property
    def mode_known(self) -> bool:
        """See ``Estimator``."""
        return bool(self.row[CONFIDENCE] >= self._sure)

    @property
    def swaps(self) -> int:
        """How often the test has found the robot on the other side than believed."""
        return int(self._belief[SWAPS])

    @property
    def bias(self) -> Array:
        """b (2,), rad: the joint angles that the model's geometry does not explain."""
        return self._bank.main.mean[4:6].copy()

    def start(self, x: Array, q_a: Array, assembly_mode: int) -> None:
        """See ``Estimator``."""
        self._begin(x, q_a, assembly_mode, REST_SPEED)

    def _begin(self, x: Array, q_a: Array, assembly_mode: int, speed: float) -> None:
        _begin(self._packed, self._noise, x, speed, self._bank)
        self._joints.q[:] = q_a
        self._joints.q_dot[:] = 0.0
        self._belief[:] = 0.0
        self._belief[MODE], self._belief[LOG_ODDS] = float(assembly_mode), CERTAIN
        self.row[MODE_HAT], self.row[CONFIDENCE] = float(assembly_mode), 1.0

    def tell_mode(self, assembly_mode: int, q_a: Array) -> None:
        """See ``Estimator``."""
        x = dgm.direct_geometric_model(unpack(self._packed), q_a, float(assembly_mode))
        self._begin(x, q_a, assembly_mode, self._noise.shock_speed)

    def rebase(self, q_a: Array) -> None:
        """See ``Estimator``."""

    def release(self, crossing: bool) -> None:
        """See ``Estimator``."""
        self._joints.q[:] = self.row[Q_HAT : Q_HAT + 2]
        self._joints.q_dot[:] = self.row[Q_HAT + 2 : Q_HAT + 4]

    def _advance(self, dt: float, q_a: Array, tau: Array) -> None:
        self.s = _observe(self._packed, self._tuning, self._filters, self._belief, tau, dt, q_a, self.row)

    def track(self, dt: float, q_a: Array, tau: Array, reference: Array, zone: float, width: float) -> None:
        """See ``Estimator``."""
        self._advance(dt, q_a, tau)

    def coast(self, dt: float, q_a: Array, tau: Array) -> None:
        """See ``Estimator``: what brakes are the joints themselves, wherever the platform is thought to be."""
        self._advance(dt, q_a, tau)
        _filter(self._joints, q_a, dt, self._bandwidth, self.row)

    def take_pose(self, pose: Pose, time: float) -> None:
        """See ``Estimator``."""


def make_estimator(robot: RobotParameters, settings: Settings) -> Estimator:
    """The estimator that the settings name."""
    from dextar_control.core.external import ExternalEstimator

    if settings.estimator in (Estimation.PLAIN, Estimation.DGM):
        return DirectEstimator(robot, settings, held=settings.estimator is Estimation.DGM)
    if settings.estimator is Estimation.EXTERNAL:
        return ExternalEstimator(robot, settings)
    return ObserverEstimator(robot, settings)
