"""The control loop: estimate, law, limits and phases in one ``step(time, q_a) -> torque``.

It knows no ROS and no simulator; a rig, a node or a plain ``for`` calls it alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from dextar_control.contract.errors import ParameterError, StateError, TrajectoryError
from dextar_control.contract.robot import RobotParameters
from dextar_control.core.certificate import Certificate, certify, check_rest
from dextar_control.core.compiled import njit
from dextar_control.core.dynamics import friction
from dextar_control.core.estimator import JointMemory, direct_estimate, estimate_platform, filter_joints, wrap
from dextar_control.core.kinematics import direct_model, kinematics, singular_values, singularity, state_of_platform
from dextar_control.core.law import Law, enforce
from dextar_control.core.model import Array, Model, make_model
from dextar_control.core.trajectory import Trajectory, evaluate, hold


class Phase(IntEnum):
    """What the controller does."""

    IDLE = 0  # no torque, by request
    APPROACH = 1  # tracks a trajectory without a crossing
    HOLD = 2  # holds a point
    TRACK = 3  # tracks a crossing trajectory, away from the locus
    CROSSING = 4  # tracks it near the locus
    SAFE_STOP = 5  # brakes, then no torque
    FAULT = 6  # no torque


LIMP = (Phase.IDLE, Phase.FAULT, Phase.SAFE_STOP)  # where the law gives no torque
REST_ZONE, REST_WIDTH = 0.05, 0.05  # |s| of the estimator's hold while holding a point: the direct model serves nearer
MIN_HOLD_S = REST_ZONE + REST_WIDTH  # |s| nearer than which no point is held
FIRST_PERIOD = 1e-3  # s taken for the first sample
START_MARGIN = 2e-3  # s by which a trajectory's start may have passed when it begins
WATCH_DECAY = 0.25  # a torque that swings between its limits is watched too
MOVING = (Phase.APPROACH, Phase.TRACK, Phase.CROSSING)


@dataclass(frozen=True)
class Settings:
    """Gains and limits of the loop; values stand in ``config/crossing.yaml``.

    Attributes:
        law: enforcement of the criterion.
        natural_frequency: of the tracking error, rad/s; K_p is its square.
        damping_ratio: K_d = 2 damping_ratio natural_frequency.
        integral_frequency: K_i = integral_frequency natural_frequency^2, 1/s; 0 is off.
        filter_bandwidth: of the joint filter, rad/s.
        zone, zone_width: |s| of the law's transition and its width.
        hold_zone, hold_width: |s| of the estimator's, ``estimator.estimate_platform``.
        return_time: over which the direct model takes over after a crossing, s.
        friction_compensation: fraction of the modelled joint friction that is fed forward.
        max_tracking_error: platform error that ends a motion in a safe stop, m.
        max_start_distance: between the robot and a trajectory's start, m.
        max_residual: of the criterion at a crossing of an accepted trajectory, N.
        watch_ratio, watch_torque, watch_s, watch_time: torque above ratio x planned peak and above
            watch_torque (N m) within |s| < watch_s for this long ends a motion in a safe stop: a robot
            that bounced asks for it.
        brake_gain: of the safe stop, N m s/rad.
        brake_time: after which the safe stop's torque is gone, s.
    """

    law: Law
    natural_frequency: float
    damping_ratio: float
    integral_frequency: float
    filter_bandwidth: float
    zone: float
    zone_width: float
    hold_zone: float
    hold_width: float
    return_time: float
    friction_compensation: float
    max_tracking_error: float
    max_start_distance: float
    max_residual: float
    watch_ratio: float
    watch_torque: float
    watch_s: float
    watch_time: float
    brake_gain: float
    brake_time: float


class _Gains(NamedTuple):
    """What the compiled tick takes of the settings."""

    K_p: float
    K_d: float
    K_i: float
    bandwidth: float
    zone: float
    zone_width: float
    return_time: float
    friction_compensation: float
    max_torque: float


class Tick(NamedTuple):
    """Everything about one sample; arrays are (2,)."""

    time: float  # of the state, s
    reference_time: float  # since the trajectory's start, s
    phase: Phase
    tau: Array  # N m
    x_ref: Array
    x_ref_dot: Array
    x_ref_ddot: Array
    x_hat: Array
    x_hat_dot: Array
    error: Array  # m
    error_dot: Array  # m/s
    u: Array  # m/s^2
    force: Array  # J_inv^T tau, N
    residual: float  # N
    s: float
    sigma_min: float
    weight: float
    assembly_mode: int


_TAU, _X_REF, _X_HAT, _ERROR, _U, _FORCE, _SCALARS, _S_REF, _FINITE, _PEAK, _DISTANCE, _SIZE = (
    0, 2, 8, 12, 16, 18, 20, 24, 26, 27, 28, 29,
)  # fmt: skip


@njit
def _tick(
    model: Model, gains: _Gains, memory: JointMemory, integral: Array,
    knots: Array, origins: Array, coefficients: Array, plan_times: Array, plan_multipliers: Array,
    reference_time: float, dt: float, q_meas: Array, time_outside: float, assembly_mode: float, law: int,
    zone: float, width: float, out: Array,
) -> None:  # fmt: skip
    point = evaluate(knots, origins, coefficients, reference_time)
    reference = state_of_platform(model, point[0], point[1])
    s_ref = singularity(model, reference.A_r)
    if s_ref * assembly_mode < 0.0:
        assembly_mode = -assembly_mode  # the reference has crossed: the direct model's branch changes with it
    filter_joints(memory, q_meas, reference.q_a, reference.q_a_dot, dt, gains.bandwidth)
    estimate = estimate_platform(
        model, memory, reference, s_ref, zone, width,
        time_outside, gains.return_time, assembly_mode,
    )  # fmt: skip
    error = point[0] - estimate.x
    error_dot = point[1] - estimate.x_dot
    if abs(s_ref) > zone + width:
        integral += dt * error
    u = point[2] + gains.K_d * error_dot + gains.K_p * error + gains.K_i * integral
    kin = state_of_platform(model, estimate.x, estimate.x_dot)
    lambda_ref = np.array(
        [
            np.interp(reference_time, plan_times, plan_multipliers[:, 0]),
            np.interp(reference_time, plan_times, plan_multipliers[:, 1]),
        ]
    )
    enforced = enforce(model, kin, u, lambda_ref, law, gains.zone, gains.zone_width)
    tau = enforced.tau + gains.friction_compensation * friction(model, reference.q_a_dot)
    for i in range(2):
        out[_TAU + i] = min(max(tau[i], -gains.max_torque), gains.max_torque) if np.isfinite(tau[i]) else np.nan
        for row in range(3):
            out[_X_REF + 2 * row + i] = point[row, i]
        out[_X_HAT + i] = estimate.x[i]
        out[_X_HAT + 2 + i] = estimate.x_dot[i]
        out[_ERROR + i] = error[i]
        out[_ERROR + 2 + i] = error_dot[i]
        out[_U + i] = u[i]
    for i in range(2):
        out[_FORCE + i] = kin.J_inv[0, i] * out[_TAU] + kin.J_inv[1, i] * out[_TAU + 1]
    out[_SCALARS] = enforced.residual
    out[_SCALARS + 1] = enforced.s
    out[_SCALARS + 2] = enforced.sigma_min
    out[_SCALARS + 3] = enforced.weight
    out[_S_REF] = s_ref
    out[_S_REF + 1] = assembly_mode
    out[_FINITE] = 1.0 if np.isfinite(out[:_S_REF]).all() else 0.0
    out[_PEAK] = max(abs(out[_TAU]), abs(out[_TAU + 1]))
    out[_DISTANCE] = np.hypot(error[0], error[1])


@njit
def _coast(
    model: Model, memory: JointMemory, q_meas: Array, dt: float, bandwidth: float, assembly_mode: float,
    gain: float, limit: float, out: Array,
) -> None:  # fmt: skip
    """A tick without a law: damping torque of the joints alone, the platform by the plain direct model."""
    filter_joints(memory, q_meas, memory.q_ref, np.zeros(2), dt, bandwidth)
    estimate = direct_estimate(model, memory, assembly_mode)
    kin = kinematics(model, memory.q, estimate.x, estimate.x_dot)
    out[:] = 0.0
    for i in range(2):
        out[_TAU + i] = min(max(-gain * memory.q_dot[i], -limit), limit)
        out[_X_REF + i] = estimate.x[i]
        out[_X_HAT + i] = estimate.x[i]
        out[_X_HAT + 2 + i] = estimate.x_dot[i]
    for i in range(2):
        out[_FORCE + i] = kin.J_inv[0, i] * out[_TAU] + kin.J_inv[1, i] * out[_TAU + 1]
    s = singularity(model, kin.A_r)
    out[_SCALARS + 1] = s
    out[_SCALARS + 2] = abs(singular_values(kin.A_r).sigma2) / np.sqrt(model.l2[0] * model.l2[1])
    out[_S_REF] = s
    out[_S_REF + 1] = assembly_mode
    out[_FINITE] = 1.0 if np.isfinite(out[:_S_REF]).all() else 0.0


class ControlLoop:
    """The Cartesian computed-torque loop of one robot.

    Args:
        robot: the controller's model of it.
        settings: gains and limits.
        assembly_mode: sign of s where the robot stands at the first sample.
        enabled: whether the first sample is held; otherwise the loop idles until ``enable``.

    Raises:
        ParameterError: assembly_mode is neither +1 nor -1.
    """

    def __init__(
        self, robot: RobotParameters, settings: Settings, assembly_mode: int, *, enabled: bool = True
    ) -> None:
        if assembly_mode not in (-1, 1):
            raise ParameterError(f"assembly_mode = {assembly_mode}; it must be +1 or -1")
        self.robot = robot
        self.model = make_model(robot)
        self.phase = Phase.HOLD if enabled else Phase.IDLE
        self.reason = ""
        self.refusal = ""
        self.mode_known = True
        self.certificate: Certificate | None = None
        self.saturated_ticks = 0
        self.completed = 0
        self.tick: Tick | None = None
        self._mode = float(assembly_mode)
        self._out = np.zeros(_SIZE)
        self._integral = np.zeros(2)
        self._memory = JointMemory(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2))
        self._time = math.nan
        self._start = 0.0
        self._pending: tuple[Trajectory, Certificate, float | None] | None = None
        self._watch = 0.0
        self._outside = math.inf
        self._stop_time = 0.0
        self._stop_wanted = False
        self.configure(settings)

    def configure(self, settings: Settings) -> None:
        """Take gains and limits, also while running.

        Raises:
            ParameterError: the law's transition would reach the locus itself.
        """
        if settings.zone < 0.5 * settings.zone_width:
            raise ParameterError(
                f"zone = {settings.zone} with zone_width = {settings.zone_width}: the transition would reach the locus;"
                f" zone must be >= {0.5 * settings.zone_width}"
            )
        self.settings = settings
        self._law = int(settings.law)
        K_p = settings.natural_frequency**2
        self._gains = _Gains(
            K_p, 2.0 * settings.damping_ratio * settings.natural_frequency, settings.integral_frequency * K_p,
            settings.filter_bandwidth, settings.zone, settings.zone_width, settings.return_time,
            settings.friction_compensation, self.robot.max_torque,
        )  # fmt: skip

    def check(self, trajectory: Trajectory) -> Certificate:
        """What ``accept`` checks of a trajectory by itself; may run beside the loop, in another thread.

        Raises:
            TrajectoryError: it breaks the criterion, the workspace or a limit, or does not rest at its
                ends clear of the locus; names the value and the limit.
        """
        check_rest(trajectory)
        certificate = certify(self.robot, trajectory, max_residual=self.settings.max_residual)
        least = self.settings.hold_zone + self.settings.hold_width
        for name, row in (("starts", 0), ("ends", -1)):
            s = abs(float(certificate.profile.s[row]))
            if s < least:
                raise TrajectoryError(f"the trajectory {name} at |s| = {s:.3f} of the Type 2 locus; the limit is {least:.3g}")
        return certificate

    def accept(self, trajectory: Trajectory, start: float | None = None) -> Certificate:
        """Check a trajectory and track it from its start time on.

        Args:
            start: in the time of the samples, s; the next sample when None.

        Raises:
            TrajectoryError: as ``check``, or it does not start at the robot, or in the past, or the
                loop is not holding.
        """
        certificate = self.check(trajectory)
        self.schedule(trajectory, certificate, start)
        return certificate

    def schedule(self, trajectory: Trajectory, certificate: Certificate, start: float | None = None) -> None:
        """Track a checked trajectory from its start time on; see ``accept``.

        What can only be seen when it begins (where the robot stands at the first sample, a start that
        has passed) is refused then, in ``refusal``.
        """
        if self.phase != Phase.HOLD:
            raise TrajectoryError(f"a trajectory is taken in phase HOLD only; the controller is in {self.phase.name}")
        if not math.isnan(self._time):
            self._check_start(trajectory, start, self._time)
        self.refusal = ""
        self._pending = (trajectory, certificate, start)

    def _check_start(self, trajectory: Trajectory, start: float | None, time: float) -> None:
        first, held = trajectory.at(0.0).x, self.trajectory.at(0.0).x
        distance = float(np.hypot(*(first - held)))
        if not distance <= self.settings.max_start_distance:
            raise TrajectoryError(
                f"the trajectory starts in ({first[0]:.4f}, {first[1]:.4f}) m, {distance:.4f} m from the robot;"
                f" the limit is {self.settings.max_start_distance} m"
            )
        if start is not None and time - start > START_MARGIN:
            raise TrajectoryError(f"the trajectory starts at {start:.6f} s; the last state is of {time:.6f} s")

    def enable(self) -> None:
        """Leave IDLE and hold the present point.

        Raises:
            StateError: the robot stands too near to the locus to be held.
        """
        if self.phase != Phase.IDLE:
            return
        if self.tick is not None:
            if not abs(self.tick.s) >= MIN_HOLD_S:
                raise StateError(f"the robot stands at |s| = {abs(self.tick.s):.3f} of the locus; holding needs {MIN_HOLD_S}")
            self._hold_at(self.tick.x_hat)
        self.phase, self.reason = Phase.HOLD, ""

    def disable(self) -> None:
        """No torque from the next sample on, whatever goes on."""
        if self.phase not in (Phase.FAULT, Phase.SAFE_STOP):
            self._go_limp(Phase.IDLE, "disabled on request")

    def stop(self, reason: str = "stop requested") -> None:
        """A safe stop: at once away from the locus; a crossing that has begun is finished first.

        Holding goes on; a trajectory that waits for its start is dropped.
        """
        self._pending = None
        if self.phase == Phase.CROSSING:
            self._stop_wanted, self.reason = True, reason
        elif self.phase in MOVING:
            self._go_limp(Phase.SAFE_STOP, reason)

    def fault(self, reason: str) -> None:
        """No torque, latched until ``reset``."""
        self._go_limp(Phase.FAULT, reason)

    def set_assembly_mode(self, assembly_mode: int) -> None:
        """Tell on which side of the locus the robot stands; only without torque.

        Raises:
            StateError: the loop is holding or moving.
        """
        if self.phase not in LIMP:
            raise StateError(f"the assembly mode can be told in IDLE, SAFE_STOP or FAULT; the phase is {self.phase.name}")
        self._mode, self.mode_known = float(assembly_mode), True

    def reset(self) -> None:
        """From SAFE_STOP or FAULT to IDLE.

        Raises:
            StateError: the robot was near the locus without control, so that its assembly mode is not
                known; ``set_assembly_mode`` tells it.
        """
        if self.phase in (Phase.SAFE_STOP, Phase.FAULT):
            if not self.mode_known:
                raise StateError(
                    f"the robot was within |s| < {self.settings.hold_zone} of the locus without control:"
                    " set assembly_mode to the side where it stands, then reset"
                )
            self.phase, self.reason = Phase.IDLE, ""

    def _go_limp(self, phase: Phase, reason: str) -> None:
        """Leave the reference: from now on the joints alone are watched, and damped in SAFE_STOP."""
        if self.phase == Phase.CROSSING:
            self.mode_known = False
        self.phase, self.reason, self._pending, self._stop_wanted = phase, reason, None, False
        self._stop_time = self._time
        self._memory.q_ref[:] = self._memory.q
        self._memory.q_ref_dot[:] = 0.0

    def _hold_at(self, x: Array) -> None:
        self._set_trajectory(hold(x, 1.0), np.array([0.0, 1.0]), np.zeros((2, 2)))
        kin = state_of_platform(self.model, np.ascontiguousarray(x), np.zeros(2))
        self._memory.q_ref[:] = kin.q_a
        self._memory.q_ref_dot[:] = 0.0
        self._integral[:] = 0.0
        self._outside = math.inf

    def _set_trajectory(self, trajectory: Trajectory, times: Array, multipliers: Array) -> None:
        self.trajectory = trajectory
        self._reference = (trajectory.knots, trajectory.origins, trajectory.coefficients)
        self._plan = (np.ascontiguousarray(times), np.ascontiguousarray(multipliers))

    def _first(self, q_a: Array) -> None:
        x = direct_model(self.model, q_a, int(self._mode))
        kin = state_of_platform(self.model, x, np.zeros(2))
        if not np.hypot(*wrapped(kin.q_a - q_a)) < 1e-6:
            raise StateError(
                f"active joints ({q_a[0]:.4f}, {q_a[1]:.4f}) rad with assembly mode {int(self._mode):+d} are not in"
                f" working mode {self.robot.working_mode}"
            )
        s = abs(float(singularity(self.model, kin.A_r)))
        if self.phase == Phase.HOLD and s < MIN_HOLD_S:
            raise StateError(f"the robot stands at |s| = {s:.3f} of the locus; holding needs {MIN_HOLD_S}")
        self._memory.q[:] = q_a
        self._memory.q_dot[:] = 0.0
        self._hold_at(x)

    def step(self, time: float, q_a: Array) -> Array:
        """Torque (2,), N m, that answers the active joints q_a (2,), rad, sampled at ``time``, s.

        Raises:
            StateError: a number is not finite, time does not advance, or (first sample) the joints
                belong to another working mode or stand on the locus. Nothing is changed then.
            GeometryError: first sample: the distal links cannot meet.
        """
        q_a = np.array(q_a, dtype=np.float64)
        if q_a.shape != (2,) or not math.isfinite(time + q_a[0] + q_a[1]):
            raise StateError(f"state at {time} s: active joints {q_a} are not two finite numbers")
        if math.isnan(self._time):
            self._first(q_a)
            dt = FIRST_PERIOD
        else:
            dt = time - self._time
            if not dt > 0.0:
                raise StateError(f"state at {time:.6f} s is not after the last one at {self._time:.6f} s")
        self._time = time
        if self._pending is not None and (self._pending[2] is None or time >= self._pending[2]):
            self._begin(time, *self._pending)
        reference_time = 0.0
        if self.phase in MOVING:
            reference_time = time - self._start
            if reference_time >= self.trajectory.duration:
                reference_time = self._end()
        if self.phase not in LIMP:
            self._servo(reference_time, dt, q_a)
        if self.phase in LIMP:
            self._coast(dt, q_a)
        values = self._out.copy()
        self._remember(reference_time, values)
        return values[_TAU : _TAU + 2]

    def _begin(self, time: float, trajectory: Trajectory, certificate: Certificate, start: float | None) -> None:
        self._pending = None
        try:
            self._check_start(trajectory, start, time)
        except TrajectoryError as error:
            self.refusal = str(error)
            return
        self.certificate = certificate
        self._start = time if start is None else start
        self._set_trajectory(trajectory, certificate.profile.time, certificate.profile.multipliers)
        self._integral[:] = 0.0
        self._watch = 0.0
        self._stop_wanted = False
        self.saturated_ticks = 0
        self.phase = Phase.TRACK if len(certificate.crossing_times) else Phase.APPROACH

    def _end(self) -> float:
        """The trajectory is over: hold its end, or stop where that was asked for during the crossing."""
        self.completed += 1
        self.phase = Phase.HOLD
        self._hold_at(self.trajectory.at(self.trajectory.duration).x)
        if self._stop_wanted:
            self._go_limp(Phase.SAFE_STOP, self.reason)
        return 0.0

    def _servo(self, reference_time: float, dt: float, q_a: Array) -> None:
        """One tick of the law, and whether it may go on."""
        settings, out = self.settings, self._out
        crossing = self.phase is Phase.TRACK or self.phase is Phase.CROSSING
        zone, width = (settings.hold_zone, settings.hold_width) if crossing else (REST_ZONE, REST_WIDTH)
        if settings.law is Law.CLASSIC:
            zone = 0.0
        _tick(
            self.model, self._gains, self._memory, self._integral, *self._reference, *self._plan,
            reference_time, dt, q_a, self._outside, self._mode, self._law, zone, width, out,
        )  # fmt: skip
        self._mode = float(out[_S_REF + 1])
        s_ref = abs(float(out[_S_REF]))
        self._outside = self._outside + dt if s_ref > zone else 0.0
        if crossing:
            near = s_ref < settings.hold_zone + settings.hold_width
            self.phase = Phase.CROSSING if near else Phase.TRACK
        self._supervise(dt, s_ref, crossing)

    def _supervise(self, dt: float, s_ref: float, crossing: bool) -> None:
        settings, out = self.settings, self._out
        if out[_FINITE] == 0.0:
            self._go_limp(Phase.SAFE_STOP, "the law gave a number that is not finite")
            return
        peak = float(out[_PEAK])
        saturated = peak >= self.robot.max_torque
        self.saturated_ticks += saturated
        if self._stop_wanted and self.phase != Phase.CROSSING:
            self._go_limp(Phase.SAFE_STOP, self.reason)
            return
        error = float(out[_DISTANCE])
        if error > settings.max_tracking_error:
            self._go_limp(Phase.SAFE_STOP, f"tracking error {error:.4f} m; the limit is {settings.max_tracking_error} m")
            return
        if self.certificate is None or not crossing:
            return
        limit = max(settings.watch_ratio * self.certificate.peak_torque, settings.watch_torque)
        watched = saturated or (s_ref < settings.watch_s and peak > limit)
        self._watch = self._watch + dt if watched else max(self._watch - WATCH_DECAY * dt, 0.0)
        if self._watch > settings.watch_time:
            self._go_limp(
                Phase.SAFE_STOP,
                f"torque {peak:.3f} N m for {1e3 * self._watch:.0f} ms; the limit is"
                f" {min(limit, self.robot.max_torque):.3f} N m for {1e3 * settings.watch_time:.0f} ms",
            )

    def _coast(self, dt: float, q_a: Array) -> None:
        """One tick without the law: damped in SAFE_STOP until its time is over, else without torque."""
        settings, out = self.settings, self._out
        braking = self.phase is Phase.SAFE_STOP and self._time - self._stop_time <= settings.brake_time
        gain = settings.brake_gain if braking else 0.0
        _coast(
            self.model, self._memory, q_a, dt, settings.filter_bandwidth, self._mode, gain, self.robot.max_torque, out
        )
        self._memory.q_ref[:] = self._memory.q
        if not abs(out[_S_REF]) >= settings.hold_zone:
            self.mode_known = False

    def _remember(self, reference_time: float, out: Array) -> None:
        def pair(offset: int) -> Array:
            return out[offset : offset + 2]

        self.tick = Tick(
            self._time, reference_time, self.phase, pair(_TAU), pair(_X_REF), pair(_X_REF + 2), pair(_X_REF + 4),
            pair(_X_HAT), pair(_X_HAT + 2), pair(_ERROR), pair(_ERROR + 2), pair(_U), pair(_FORCE),
            float(out[_SCALARS]), float(out[_SCALARS + 1]), float(out[_SCALARS + 2]), float(out[_SCALARS + 3]),
            int(out[_S_REF + 1]),
        )  # fmt: skip


def wrapped(angles: Array) -> Array:
    """Angle differences (2,) in [-pi, pi), rad."""
    return np.array([wrap(float(angle)) for angle in angles])
