"""The safe stop: what becomes of a robot that a watch, or somebody, has stopped.

It rests on the measured joints, whatever the estimate is: |s| follows from the distance between the elbows, the same on
both sides of the locus, and a torque -K q_a_dot with a positive definite K takes energy from the robot on either side.

    where the robot is                          torque
    ------------------------------------------  ------------------------------------------------------------------------
    |s| < coast_s                               none, it coasts through: no torque acts along t_s there, and slowed in
                                                the other direction alone it might be left standing on the locus
    farther, but braked from now on it would    none: it coasts through, or farther away, with all its speed
    come to rest at |s| < stop_s
    elsewhere, side known                       braking, every direction alike: -M_q q_a_dot / brake_constant with
                                                M_q = J_inv^-T M J_inv^-1, scaled into the limit
    elsewhere, side not known                   braking, damping in the joints: -brake_gain q_a_dot, scaled into the limit
    at rest for rest_time, or after coast_time  none, for good
    of coasting, or brake_time after the begin

The limit is the one that the law had when the stop began. A stop that somebody asks for finishes a crossing first, under
the law, as far as it could not come to rest before it; a watch that trips lets go at once, and where it says that the
estimate is not the robot's (not finite, a joint that jumped, joints beside the estimate) the side counts as not known.
A fault gives no torque at all. A robot that weighs something in its plane sinks once its torque is gone: it needs a brake.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from dextar_control.core.compiled import njit
from dextar_control.core.dynamics import apply, inverse, platform_dynamics
from dextar_control.core.kinematics import direct_geometric_model, elbows, kinematics, singular_values
from dextar_control.core.law import FINITE, FORCE, MODE_HAT, Q_HAT, SCALARS, TAU, smooth_step
from dextar_control.core.model import Array, Model, pack, unpack
from dextar_control.core.settings import Settings

REST_SPEED = 0.1  # rad/s of each joint, below which the robot counts as at rest: 9 mm/s at an elbow
FADE = 0.006, 0.02  # rad/s of the faster joint, between which braking fades: an encoder of 2^17 at rest shows the lower one


class Stage(IntEnum):
    """Of a safe stop."""

    COAST = 0  # no torque, for the locus is near
    BRAKE = 1
    OVER = 2  # no torque any more


STAGES = tuple(Stage)
COAST, BRAKE, OVER = (int(stage) for stage in Stage)  # as the compiled code sees them


class Brake(NamedTuple):
    """What the safe stop takes of the settings."""

    gain: float  # N m s/rad
    constant: float  # s
    coast_s: float
    stop_s: float


class Stopped(NamedTuple):
    """How a safe stop ended."""

    time: float  # since its begin, s
    at_rest: bool
    s: float  # |s| by the joints
    joint_speed: float  # the larger one, rad/s
    peak_torque: float  # N m
    coasted: float  # s


@njit
def singularity_of_joints(model: Model, q_a: Array, q_a_dot: Array) -> tuple[float, float]:
    """|s| and its rate, 1/s, of the active joints (2,) and their velocities: the same in both assembly modes.

    The elbows' distance d gives the angle phi between the distal links, d^2 = l2_1^2 + l2_2^2 - 2 l2_1 l2_2 cos phi, and
    |s| = sin phi; zero where the links cannot meet.
    """
    P = elbows(model, q_a)
    dx, dy = P[1, 0] - P[0, 0], P[1, 1] - P[0, 1]
    vx = -model.l1[1] * np.sin(q_a[1]) * q_a_dot[1] + model.l1[0] * np.sin(q_a[0]) * q_a_dot[0]
    vy = model.l1[1] * np.cos(q_a[1]) * q_a_dot[1] - model.l1[0] * np.cos(q_a[0]) * q_a_dot[0]
    product = model.l2[0] * model.l2[1]
    cosine = 0.5 * (model.l2[0] ** 2 + model.l2[1] ** 2 - dx * dx - dy * dy) / product
    square = 1.0 - cosine * cosine
    if not square > 0.0:
        return 0.0, 0.0
    s = np.sqrt(square)
    return s, cosine * (dx * vx + dy * vy) / (product * s)


@njit
def braking(model: Model, brake: Brake, q_a: Array, q_a_dot: Array, mode: float, limit: float) -> tuple[Array, float]:
    """Braking torque (2,), N m, and for how long the present velocity would have to last to lead as far as rest, s.

    Args:
        mode: sign of s; 0 where it is not known.
        limit: of each torque, N m.
    """
    x = direct_geometric_model(model, q_a, mode if mode != 0.0 else 1.0)
    J = inverse(kinematics(model, q_a, x, np.zeros(2)).J_inv)
    kin = kinematics(model, q_a, x, apply(J, q_a_dot))
    mass, _ = platform_dynamics(model, kin)
    momentum = apply(J.T, apply(mass, kin.x_dot))
    if mode != 0.0:
        tau, constant = momentum * (-1.0 / brake.constant), brake.constant
    else:
        tau = -brake.gain * q_a_dot
        constant = np.hypot(momentum[0], momentum[1]) / max(np.hypot(tau[0], tau[1]), 1e-12)
    tau = tau * smooth_step(max(abs(q_a_dot[0]), abs(q_a_dot[1])), FADE[0], FADE[1])
    peak = max(abs(tau[0]), abs(tau[1]))
    share = limit / peak if peak > limit else 1.0
    return share * tau, 0.5 * constant * (share + 1.0 / share) if share > 0.0 else np.inf


@njit
def clear_rest(model: Model, brake: Brake, q_a: Array, q_a_dot: Array, mode: float, limit: float) -> bool:
    """Whether a robot that brakes from now on comes to rest clear of the locus."""
    s, rate = singularity_of_joints(model, q_a, q_a_dot)
    if s < brake.coast_s:
        return False
    _, lasting = braking(model, brake, q_a, q_a_dot, mode, limit)
    return bool(s + rate * lasting >= brake.stop_s)


@njit
def stop(packed: Array, brake: Brake, q_a: Array, q_a_dot: Array, mode: float, limit: float, over: bool, out: Array) -> int:
    """One sample of a safe stop: its torque, written into ``out`` (``law.TAU`` and following), and its stage.

    Args:
        q_a, q_a_dot: (2,) filtered, rad and rad/s.
        mode: sign of s; 0 where it is not known.
        limit: of each torque, N m.
        over: no torque any more.
    """
    model = unpack(packed)
    out[:] = 0.0
    out[FINITE] = 1.0
    x = direct_geometric_model(model, q_a, mode if mode != 0.0 else 1.0)
    kin = kinematics(model, q_a, x, np.zeros(2))
    out[SCALARS + 1], _ = singularity_of_joints(model, q_a, q_a_dot)
    if mode < 0.0:
        out[SCALARS + 1] = -out[SCALARS + 1]
    out[SCALARS + 2] = abs(singular_values(kin.A_r).sigma2) / np.sqrt(model.l2[0] * model.l2[1])
    if over:
        return OVER
    if not clear_rest(model, brake, q_a, q_a_dot, mode, limit):
        return COAST
    tau, _ = braking(model, brake, q_a, q_a_dot, mode, limit)
    if not np.isfinite(tau).all():
        return COAST
    out[TAU : TAU + 2] = tau
    for i in range(2):
        out[FORCE + i] = kin.J_inv[0, i] * tau[0] + kin.J_inv[1, i] * tau[1]
    return BRAKE


class SafeStop:
    """One stop after the other of one robot; before the first one it is over.

    Attributes:
        began: time of the last one's begin, s.
        stage: of it.
        ended: how it ended; None while it lasts, and where it was abandoned.
    """

    def __init__(self, model: Model) -> None:
        self._packed = pack(model)
        self.began = math.nan
        self.stage = Stage.OVER
        self.ended: Stopped | None = None
        self._limit = 0.0
        self._trusted = True
        self._coasted = self._rested = self._peak = 0.0

    def configure(self, settings: Settings) -> None:
        """Take the settings that concern it, also while it lasts."""
        self.brake = Brake(settings.brake_gain, settings.brake_constant, settings.coast_s, settings.stop_s)
        self._time, self._coast_time, self._rest_time = settings.brake_time, settings.coast_time, settings.rest_time

    def begin(self, time: float, limit: float, *, trusted: bool, over: bool) -> None:
        """The robot is let go.

        Args:
            time: of the sample, s.
            limit: of each torque, N m.
            trusted: where the estimator knows the side, it is the robot's.
            over: without any torque from now on.
        """
        self.began, self._limit, self._trusted = time, limit, trusted
        self.stage, self.ended = (Stage.OVER if over else Stage.BRAKE), None
        self._coasted = self._rested = self._peak = 0.0

    def abandon(self) -> None:
        """No torque any more, wherever the robot is."""
        self.stage = Stage.OVER

    def step(self, time: float, dt: float, estimate: Array, mode_known: bool, out: Array) -> str:
        """One sample, its torque written into ``out``; how the stop ended, in words, at the sample where it does.

        Args:
            time: of the sample, s.
            dt: since the last one, s.
            estimate: row, see ``law``.
            mode_known: whether the estimator knows the assembly mode.
        """
        q_a, q_a_dot = estimate[Q_HAT : Q_HAT + 2], estimate[Q_HAT + 2 : Q_HAT + 4]
        mode = float(estimate[MODE_HAT]) if mode_known and self._trusted else 0.0
        over = self.stage is Stage.OVER
        self.stage = STAGES[stop(self._packed, self.brake, q_a, q_a_dot, mode, self._limit, over, out)]
        if over:
            return ""
        s, tau_1, tau_2 = abs(float(out[SCALARS + 1])), abs(float(out[TAU])), abs(float(out[TAU + 1]))
        speed = max(abs(float(q_a_dot[0])), abs(float(q_a_dot[1])))
        self._peak = max(self._peak, tau_1, tau_2)
        self._coasted += dt if self.stage is Stage.COAST else 0.0
        self._rested = self._rested + dt if speed < REST_SPEED and s >= self.brake.stop_s else 0.0
        at_rest = self._rested >= self._rest_time
        lasted = time - self.began
        if not (at_rest or lasted >= self._time or self._coasted >= self._coast_time):
            return ""
        self.stage = Stage.OVER
        out[TAU : SCALARS] = 0.0
        self.ended = Stopped(lasted, at_rest, s, speed, self._peak, self._coasted)
        how = f"at rest after {lasted:.2f} s" if at_rest else f"let go after {lasted:.2f} s at {speed:.2f} rad/s"
        return f"{how}, |s| = {s:.2f}, side {'known' if mode_known else 'not known'}"
