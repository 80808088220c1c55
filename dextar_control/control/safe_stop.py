"""The safe stop of a robot after a watch has tripped or on request.

It uses the measured joints, whatever the estimate is: |s| follows from the joints alone
where the mechanism can tell, the same on both sides of the locus, and a torque
-K q_a_dot with a positive definite K takes energy from the robot on either side.

Where the robot is decides which torque acts:

- |s| < coast_below_abs_s, or farther, but braked from now on it would come to rest at
  |s| < rest_above_abs_s: none; it coasts on with all its speed. No torque acts along
  t_s there, and slowed in the other direction alone it might come to rest on the locus.
- Elsewhere, with a known side: braking, every direction alike, -M_q q_a_dot /
  brake_time_constant with M_q = J_inv^-T M J_inv^-1, scaled into the limit.
- Elsewhere, on a side not known: braking, damping in the joints, -brake_gain q_a_dot,
  scaled into the limit.
- At rest for rest_time, or after coast_time of coasting, or brake_time after the begin:
  none, for good.

The limit is that of the law when the stop began. A stop on request finishes a crossing
first, under the law, where the robot could not come to rest before it. A watch that
trips begins the stop at once, and where it shows that the estimate is wrong (not
finite, a joint that jumped, joints far from the estimate) the side counts as not known.
A fault gives no torque at all. A robot with gravity in its plane sinks once its torque
is gone: it needs a brake.
"""

from __future__ import annotations

import math
from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple

import casadi as ca

from dextar_control.contract.settings import Settings
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.model.model import Model, equations_of
from dextar_control.symbols.functions import Library, cache_folder, named
from dextar_control.symbols.record import Field, Layout, Record
from dextar_control.symbols.smooth import HUGE, smooth_step
from dextar_control.symbols.types import Array

# rad/s of each joint, below which the robot counts as at rest: 9 mm/s at an elbow
REST_SPEED = 0.1
# rad/s of the faster joint, over which braking fades: an encoder of 2^17 at rest shows
# the lower one
FADE = 0.006, 0.02

BRAKE = (
    Field("gain", "N m s/rad", "of damping in the joints"),
    Field("constant", "s", "time constant of braking"),
    Field("coast_s", "1", "|s| within which it coasts"),
    Field("stop_s", "1", "least |s| at which it may come to rest"),
)
STOP = (
    Field("s", "1", "|s| by the joints"),
    Field("rate", "1/s", "of |s|"),
    Field("tau", "N m", "braking torques", "n"),
    Field("lasting", "s", "the braking distance over the present velocity"),
    Field("force", "N", "J_inv^T tau", "n"),
    Field("sigma_min", "1", "least singular value of A_r over the singularity length"),
    Field("speed", "rad/s", "of the faster joint"),
)


class Stage(IntEnum):
    """The stages of a safe stop."""

    COAST = 0  # no torque near the locus
    BRAKE = 1
    OVER = 2  # no torque any more


class Stopped(NamedTuple):
    """The end of a safe stop."""

    time: float  # since its begin, s
    at_rest: bool
    s: float  # |s| by the joints
    joint_speed: float  # the larger one, rad/s
    peak_torque: float  # N m
    coasted: float  # s


@lru_cache
def stops_of(mechanism: Mechanism) -> Library:
    """Return the function ``stop``: (p, brake, q_a, q_a_dot, x_hat, mode, limit) -> the
    record STOP of braking now.
    """
    n = mechanism.n
    vector, p = mechanism.symbols()
    brake_vector, brake = Layout("brake", n, BRAKE).symbols()
    q_a, q_a_dot, x_hat = (ca.SX.sym(name, n) for name in ("q_a", "q_a_dot", "x_hat"))
    mode, limit = ca.SX.sym("mode"), ca.SX.sym("limit")
    equations = equations_of(mechanism)
    known = mode != 0.0
    x = mechanism.direct_geometric_model(q_a, ca.if_else(known, mode, 1.0), p)
    # several blocks may be on different sides
    x = x_hat if x is None or equations.s_blocks.numel() > 1 else x
    J = ca.inv(equations.at(vector, q_a, x, ca.SX.zeros(n)).J_inv)
    e = equations.at(vector, q_a, x, J @ q_a_dot)
    s = mechanism.singularity_of_joints(q_a, p)
    if s is None:  # by the estimate
        s = ca.fabs(e.s)
        places, speeds = (
            ca.vertcat(equations.q_a, equations.x),
            ca.vertcat(q_a_dot, e.x_dot),
        )
        rate = ca.jtimes(equations.s, places, speeds)
        here = [equations.p, equations.q_a, equations.x], [vector, q_a, x]
        rate = ca.sign(e.s) * ca.substitute([rate], *here)[0]
    else:
        rate = ca.if_else(s > 0.0, ca.jtimes(s, q_a, q_a_dot), 0.0)
    momentum = J.T @ (e.M @ e.x_dot)
    damping = -brake["gain"] * q_a_dot
    size = ca.norm_2(damping)
    unknown = ca.norm_2(momentum) / ca.fmax(size, 1e-12)
    constant = ca.if_else(known, brake["constant"], unknown)
    speed = ca.mmax(ca.fabs(q_a_dot))
    wanted = ca.if_else(known, -momentum / brake["constant"], damping)
    tau = wanted * smooth_step(speed, *FADE)
    peak = ca.mmax(ca.fabs(tau))
    share = ca.if_else(peak > limit, limit / ca.if_else(peak > 0.0, peak, 1.0), 1.0)
    stretch = share + 1.0 / ca.if_else(share > 0.0, share, 1.0)
    lasting = ca.if_else(share > 0.0, 0.5 * constant * stretch, HUGE)
    found = {
        "s": s,
        "rate": rate,
        "tau": share * tau,
        "lasting": lasting,
        "force": e.J_inv.T @ (share * tau),
        "sigma_min": (
            ca.mmin(ca.fabs(e.singular.sigma_weak)) / mechanism.singularity_length(p)
        ),
        "speed": speed,
    }
    arguments = {
        "p": vector,
        "brake": brake_vector,
        "q_a": q_a,
        "q_a_dot": q_a_dot,
        "x_hat": x_hat,
        "mode": mode,
        "limit": limit,
    }
    return Library(
        [named("stop", arguments, {"stop": Layout("stop", n, STOP).join(found)})],
        cache_folder(),
    )


class SafeStop:
    """The safe stops of one robot, one after the other.

    Args:
        model: of the robot, as the controller knows it.

    Attributes:
        began: time at which the last one began, s.
        stage: of the last one; OVER before the first.
        ended: how the last one ended; None while it lasts, and where it was abandoned.
    """

    def __init__(self, model: Model) -> None:
        self.began = math.nan
        self.stage = Stage.OVER
        self.ended: Stopped | None = None
        self._brake = Layout("brake", model.n, BRAKE).make()
        self._now = Layout("stop", model.n, STOP).make()
        self._braking = stops_of(model.mechanism).fast(
            "stop", p=model.p, brake=self._brake.numbers, stop=self._now.numbers
        )
        self._limit = 0.0
        self._trusted = True
        self._coasted = self._rested = self._peak = 0.0

    def configure(self, settings: Settings) -> None:
        """Take the settings that concern it, also while it lasts."""
        self._told = told = settings.safe_stop
        brake = self._brake
        brake.gain, brake.constant = told.brake_gain, told.brake_time_constant
        brake.coast_s, brake.stop_s = told.coast_below_abs_s, told.rest_above_abs_s

    def begin(self, time: float, limit: float, *, trusted: bool, over: bool) -> None:
        """Begin a stop.

        Args:
            time: of the sample, s.
            limit: of each torque, N m.
            trusted: whether a side that the estimator knows is the robot's.
            over: whether there is no torque from the begin on.
        """
        self.began, self._limit, self._trusted = time, limit, trusted
        self.stage, self.ended = (Stage.OVER if over else Stage.BRAKE), None
        self._coasted = self._rested = self._peak = 0.0

    def abandon(self) -> None:
        """End the stop without torque, wherever the robot is."""
        self.stage = Stage.OVER

    def braking(
        self, q_a: Array, q_a_dot: Array, x_hat: Array, mode: float, limit: float
    ) -> Record:
        """Return the record STOP of braking now, which the next call overwrites.

        Args:
            q_a, q_a_dot: filtered joints, (n,), rad, rad/s.
            x_hat: estimate, (n,), m, for mechanisms whose joints alone do not tell the
                platform position.
            mode: sign of s; 0 where it is not known.
            limit: of each torque, N m.
        """
        given = self._braking.arguments
        given.q_a[:], given.q_a_dot[:], given.x_hat[:] = q_a, q_a_dot, x_hat
        given.mode[0], given.limit[0] = mode, limit
        self._braking.run()
        return self._now

    def comes_to_rest(self, estimate: Record, mode: float, limit: float) -> bool:
        """Return whether a robot that brakes from now on comes to rest clear of the
        locus; for the arguments see ``braking``.
        """
        q_a, q_a_dot = estimate.q_a, estimate.q_a_dot
        return self._clear(self.braking(q_a, q_a_dot, estimate.x, mode, limit))

    def _clear(self, now: Record) -> bool:
        s, brake = now.s, self._brake
        at_rest = s + now.rate * now.lasting
        return bool(s >= brake.coast_s and at_rest >= brake.stop_s)

    def step(
        self, time: float, dt: float, estimate: Record, mode_known: bool, out: Record
    ) -> str:
        """Take a sample, and write its torque into ``out``.

        Args:
            time: of the sample, s.
            dt: since the last one, s.
            estimate: of the estimator, with the joints as they are measured.
            mode_known: whether the estimator knows the assembly mode.
            out: record of the law's output.

        Returns:
            How the stop ended, in words, at the sample where it does; else "".
        """
        mode = estimate.assembly_mode if mode_known and self._trusted else 0.0
        over = self.stage is Stage.OVER
        q_a, q_a_dot = estimate.q_a, estimate.q_a_dot
        now = self.braking(q_a, q_a_dot, estimate.x, mode, self._limit)
        out.numbers[:] = 0.0
        out.finite, out.sigma_min = 1.0, now.sigma_min
        out.s = -now.s if mode < 0.0 else now.s
        if over:
            return ""
        peak = float(abs(now.tau).max())
        self.stage = (
            Stage.BRAKE if self._clear(now) and math.isfinite(peak) else Stage.COAST
        )
        if self.stage is Stage.BRAKE:
            out.tau, out.force = now.tau, now.force
            self._peak = max(self._peak, peak)
        else:
            self._coasted += dt
        resting = now.speed < REST_SPEED and now.s >= self._brake.stop_s
        self._rested = self._rested + dt if resting else 0.0
        at_rest = self._rested >= self._told.rest_time
        lasted = time - self.began
        spent = (
            lasted >= self._told.brake_time or self._coasted >= self._told.coast_time
        )
        if not (at_rest or spent):
            return ""
        self.stage = Stage.OVER
        out.tau, out.force = 0.0, 0.0
        peak, coasted = self._peak, self._coasted
        self.ended = Stopped(lasted, at_rest, now.s, now.speed, peak, coasted)
        how = f"at rest after {lasted:.2f} s"
        if not at_rest:
            how = f"let go after {lasted:.2f} s at {now.speed:.2f} rad/s"
        side = "known" if mode_known else "not known"
        return f"{how}, |s| = {now.s:.2f}, side {side}"
