"""The control loop: estimate, law, limits and phases in one ``step(time, q_a) -> torque``.

It knows no ROS and no simulator; a rig, a node or a plain ``for`` calls it alike.
"""

from __future__ import annotations

import bisect
import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from dextar_control.contract.errors import ParameterError, StateError, TrajectoryError
from dextar_control.contract.robot import RobotParameters
from dextar_control.core.certificate import Certificate, certify, check_rest
from dextar_control.core.compiled import njit
from dextar_control.core.dgm import wrap
from dextar_control.core.estimator import Pose, make_estimator
from dextar_control.core.kinematics import direct_model, singularity, state_of_platform, type1_distance
from dextar_control.core.law import (
    CONFIDENCE,
    ERROR,
    FINITE,
    FORCE,
    LAMBDA_REF,
    MODE_HAT,
    OUTPUT,
    Q_REF,
    REFERENCE,
    S_REF,
    SCALARS,
    TAU,
    X_HAT,
    X_REF,
    Gains,
    Law,
    U,
    brake,
    control,
)
from dextar_control.core.model import Array, make_model, pack, unpack
from dextar_control.core.settings import Settings
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
OPEN_BEFORE = 0.02  # s before a planned crossing from which on it counts as begun
TYPE1_END = 0.1  # distance to Type 1 at which a robot without control is followed no further
WATCH_DECAY = 0.25  # a torque that swings between its limits is watched too
UNKNOWN_SIDE = "the estimator cannot tell on which side of the locus the robot stands:"
MOVING = (Phase.APPROACH, Phase.TRACK, Phase.CROSSING)


class Verdict(IntEnum):
    """What became of a planned crossing, as the estimator sees it."""

    UNDECIDED = 0
    CROSSED = 1
    BOUNCED = 2


class Passed(NamedTuple):
    """One planned crossing and what the estimator made of it."""

    planned_time: float  # since the trajectory's start, s
    verdict: Verdict
    confidence: float  # in the assembly mode that the verdict rests on, 0.5 to 1
    time: float  # of the verdict, since the trajectory's start, s; nan while undecided


class Tick:
    """Everything about one sample; arrays are (2,), copies of their own.

    Attributes:
        time: of the state, s.
        reference_time: since the trajectory's start, s.
        phase: of the loop.
    """

    __slots__ = ("_estimate", "_output", "_reference", "phase", "reference_time", "time")

    def __init__(
        self, time: float, reference_time: float, phase: Phase, reference: Array, estimate: Array, output: Array
    ) -> None:
        self.time, self.reference_time, self.phase = time, reference_time, phase
        self._reference, self._estimate, self._output = reference, estimate, output

    tau = property(lambda self: self._output[TAU : TAU + 2], doc="N m.")
    x_ref = property(lambda self: self._reference[X_REF : X_REF + 2], doc="m.")
    x_ref_dot = property(lambda self: self._reference[X_REF + 2 : X_REF + 4], doc="m/s.")
    x_ref_ddot = property(lambda self: self._reference[X_REF + 4 : X_REF + 6], doc="m/s^2.")
    x_hat = property(lambda self: self._estimate[X_HAT : X_HAT + 2], doc="m.")
    x_hat_dot = property(lambda self: self._estimate[X_HAT + 2 : X_HAT + 4], doc="m/s.")
    error = property(lambda self: self._output[ERROR : ERROR + 2], doc="x_ref - x_hat, m.")
    error_dot = property(lambda self: self._output[ERROR + 2 : ERROR + 4], doc="m/s.")
    u = property(lambda self: self._output[U : U + 2], doc="Auxiliary acceleration, m/s^2.")
    force = property(lambda self: self._output[FORCE : FORCE + 2], doc="J_inv^T tau, N.")
    residual = property(lambda self: float(self._output[SCALARS]), doc="t_s.w_d that u asks for, N.")
    s = property(lambda self: float(self._output[SCALARS + 1]), doc="Singularity measure at the model's state.")
    sigma_min = property(lambda self: float(self._output[SCALARS + 2]), doc="Of A_r over the distal length.")
    weight = property(lambda self: float(self._output[SCALARS + 3]), doc="Of the feedback along the weak direction.")
    assembly_mode = property(lambda self: int(self._estimate[MODE_HAT]), doc="Believed sign of s.")
    confidence = property(lambda self: float(self._estimate[CONFIDENCE]), doc="In the assembly mode, 0.5 to 1.")
    rows = property(
        lambda self: (self._reference, self._estimate, self._output), doc="Reference, estimate, output; see ``law``."
    )


@njit
def _reference_at(
    packed: Array, knots: Array, origins: Array, coefficients: Array, plan_times: Array, plan_multipliers: Array,
    time: float, row: Array,
) -> None:  # fmt: skip
    """The reference's row (``law.X_REF`` and following) at a time since the trajectory's start."""
    model = unpack(packed)
    point = evaluate(knots, origins, coefficients, time)
    kin = state_of_platform(model, point[0], point[1])
    for k in range(3):
        row[X_REF + 2 * k : X_REF + 2 * k + 2] = point[k]
    row[Q_REF : Q_REF + 2] = kin.q_a
    row[Q_REF + 2 : Q_REF + 4] = kin.q_a_dot
    row[S_REF] = singularity(model, kin.A_r)
    for i in range(2):
        row[LAMBDA_REF + i] = np.interp(time, plan_times, plan_multipliers[:, i])


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
        self.certificate: Certificate | None = None
        self.passed: list[Passed] = []
        self.saturated_ticks = 0
        self.completed = 0
        self.tick: Tick | None = None
        self.estimator = make_estimator(robot, settings)
        self._assembly_mode = assembly_mode
        self._packed = pack(self.model)
        self._ref = np.zeros(REFERENCE)
        self._out = np.zeros(OUTPUT)
        self._tau = np.zeros(2)
        self._integral = np.zeros(2)
        self._time = math.nan
        self._start = 0.0
        self._pending: tuple[Trajectory, Certificate, float | None] | None = None
        self._watch = 0.0
        self._crossing_limit = robot.max_torque
        self._open = -1
        self._crossing_times: list[float] = []
        self._crossing_signs: list[float] = []
        self._q_a = np.zeros(2)
        self._stop_time = 0.0
        self._stop_wanted = False
        self.configure(settings)

    def configure(self, settings: Settings) -> None:
        """Take gains and limits, also while running; the estimator's kind stays.

        Raises:
            ParameterError: the law's transition would reach the locus itself, or the zones of the test of
                crossed against bounced are not in order.
        """
        if settings.zone < 0.5 * settings.zone_width:
            raise ParameterError(
                f"zone = {settings.zone} with zone_width = {settings.zone_width}: the transition would reach the locus;"
                f" zone must be >= {0.5 * settings.zone_width}"
            )
        if not settings.passage_armed < settings.passage_begin:
            raise ParameterError(
                f"passage_armed = {settings.passage_armed} with passage_begin = {settings.passage_begin}; it must be smaller"
            )
        self.settings = settings
        self._law = int(settings.law)
        K_p = settings.natural_frequency**2
        self._gains = Gains(
            K_p, 2.0 * settings.damping_ratio * settings.natural_frequency, settings.integral_frequency * K_p,
            settings.band if settings.law in (Law.PROJECTED, Law.MULTI_MODEL) else settings.zone, settings.zone_width,
            settings.friction_compensation,
        )  # fmt: skip
        self.estimator.configure(settings)

    @property
    def mode_known(self) -> bool:
        """Whether the side of the locus on which the robot stands is known well enough to begin a motion."""
        return self.estimator.mode_known

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
            StateError: the robot stands too near to the locus to be held, or on a side that is not known.
        """
        if self.phase != Phase.IDLE:
            return
        if self.tick is not None:
            if not self.mode_known:
                raise StateError(f"{UNKNOWN_SIDE} set assembly_mode to the side where it stands, then enable")
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
        self._assembly_mode = assembly_mode
        self._open = -1
        if not math.isnan(self._time):
            self.estimator.tell_mode(assembly_mode, self._q_a)

    def reset(self) -> None:
        """From SAFE_STOP or FAULT to IDLE.

        Raises:
            StateError: the robot was near the locus without control, so that its assembly mode is not
                known; ``set_assembly_mode`` tells it.
        """
        if self.phase in (Phase.SAFE_STOP, Phase.FAULT):
            if not self.mode_known:
                raise StateError(f"{UNKNOWN_SIDE} set assembly_mode to the side where it stands, then reset")
            self.phase, self.reason, self._open = Phase.IDLE, "", -1

    def _go_limp(self, phase: Phase, reason: str) -> None:
        """Leave the reference: from now on the robot is only watched, and damped in SAFE_STOP."""
        current = self._current_crossing()
        if self.phase in MOVING:
            self._open = current
        elif self.phase not in LIMP:
            self._open = -1
        self.estimator.release(self.phase == Phase.CROSSING)
        self.phase, self.reason, self._pending, self._stop_wanted = phase, reason, None, False
        self._stop_time = self._time

    def _hold_at(self, x: Array) -> None:
        self._set_trajectory(hold(x, 1.0), np.array([0.0, 1.0]), np.zeros((2, 2)))
        self.estimator.rebase(state_of_platform(self.model, np.ascontiguousarray(x), np.zeros(2)).q_a)
        self._integral[:] = 0.0

    def _set_trajectory(self, trajectory: Trajectory, times: Array, multipliers: Array) -> None:
        self.trajectory = trajectory
        self._duration = trajectory.duration
        self._reference = (trajectory.knots, trajectory.origins, trajectory.coefficients)
        self._plan = (np.ascontiguousarray(times), np.ascontiguousarray(multipliers))

    def _first(self, q_a: Array) -> None:
        x = direct_model(self.model, q_a, self._assembly_mode)
        kin = state_of_platform(self.model, x, np.zeros(2))
        if not np.hypot(*wrapped(kin.q_a - q_a)) < 1e-6:
            raise StateError(
                f"active joints ({q_a[0]:.4f}, {q_a[1]:.4f}) rad with assembly mode {self._assembly_mode:+d} are not in"
                f" working mode {self.robot.working_mode}"
            )
        s = abs(float(singularity(self.model, kin.A_r)))
        if self.phase == Phase.HOLD and s < MIN_HOLD_S:
            raise StateError(f"the robot stands at |s| = {s:.3f} of the locus; holding needs {MIN_HOLD_S}")
        self.estimator.start(x, q_a, self._assembly_mode)
        self._hold_at(x)

    def step(self, time: float, q_a: Array, pose: Pose | None = None) -> Array:
        """Torque (2,), N m, that answers the active joints q_a (2,), rad, sampled at ``time``, s.

        Args:
            pose: an external measurement that has arrived since the last sample; for the estimator ``external``.

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
        self._time, self._q_a = time, q_a
        if self._pending is not None and (self._pending[2] is None or time >= self._pending[2]):
            self._begin(time, *self._pending)
        reference_time = 0.0
        if self.phase in MOVING:
            reference_time = time - self._start
            if reference_time >= self._duration:
                reference_time = self._end()
        if pose is not None:
            self.estimator.take_pose(pose, time)
        if self.phase in LIMP:
            self.estimator.coast(dt, q_a, self._tau)
            self._compare_afterwards()
            self._limp()
        else:
            self._servo(reference_time, dt, q_a)
        self._tau = self._out[TAU : TAU + 2].copy()
        self.tick = Tick(time, reference_time, self.phase, self._ref.copy(), self.estimator.row.copy(), self._out.copy())
        return self._tau

    def _begin(self, time: float, trajectory: Trajectory, certificate: Certificate, start: float | None) -> None:
        self._pending = None
        try:
            self._check_start(trajectory, start, time)
        except TrajectoryError as error:
            self.refusal = str(error)
            return
        self.certificate = certificate
        self.passed = [Passed(float(time), Verdict.UNDECIDED, 0.5, math.nan) for time in certificate.crossing_times]
        self._crossing_limit = self._limit_crossing(certificate)
        self._crossing_times = certificate.crossing_times.tolist()
        self._crossing_signs = certificate.crossing_signs.tolist()
        self._start = time if start is None else start
        self._set_trajectory(trajectory, certificate.profile.time, certificate.profile.multipliers)
        self._integral[:] = 0.0
        self._watch = 0.0
        self._stop_wanted = False
        self.saturated_ticks = 0
        self.phase = Phase.TRACK if len(certificate.crossing_times) else Phase.APPROACH

    def _limit_crossing(self, certificate: Certificate) -> float:
        """Torque limit of a crossing trajectory, N m: what bounds a robot that bounced and is not yet known to have."""
        watched = max(self.settings.watch_ratio * certificate.peak_torque, self.settings.watch_torque)
        return min(self.robot.max_torque, watched)

    def _end(self) -> float:
        """The trajectory is over: hold its end, or stop where that was asked for during the crossing."""
        self.completed += 1
        self.phase = Phase.HOLD
        self._hold_at(self.trajectory.at(self._duration).x)
        if self._stop_wanted:
            self._go_limp(Phase.SAFE_STOP, self.reason)
        return 0.0

    def _servo(self, reference_time: float, dt: float, q_a: Array) -> None:
        """One tick of the law, and whether it may go on."""
        settings, ref, out = self.settings, self._ref, self._out
        crossing = self.phase is Phase.TRACK or self.phase is Phase.CROSSING
        zone, width = (settings.hold_zone, settings.hold_width) if crossing else (REST_ZONE, REST_WIDTH)
        _reference_at(self._packed, *self._reference, *self._plan, reference_time, ref)
        self.estimator.track(dt, q_a, self._tau, ref, zone, width)
        s_ref = float(ref[S_REF])
        limit = self.robot.max_torque
        if crossing:
            near = abs(s_ref) < settings.hold_zone + settings.hold_width
            self.phase = Phase.CROSSING if near else Phase.TRACK
            limit = self._crossing_limit
        control(self._packed, self._gains, self._law, ref, self.estimator.row, self._integral, limit, dt, out)
        self._supervise(dt, s_ref, crossing, limit)
        if self.phase in LIMP:
            self._limp()

    def _supervise(self, dt: float, s_ref: float, crossing: bool, limit: float) -> None:
        settings, out = self.settings, self._out.tolist()
        if out[FINITE] == 0.0:
            self._go_limp(Phase.SAFE_STOP, "the law gave a number that is not finite")
            return
        peak = max(abs(out[TAU]), abs(out[TAU + 1]))
        saturated = peak >= limit
        self.saturated_ticks += saturated
        if self._stop_wanted and self.phase != Phase.CROSSING:
            self._go_limp(Phase.SAFE_STOP, self.reason)
            return
        self._compare_sides(s_ref)
        if self.phase in LIMP:
            return
        error = math.hypot(out[ERROR], out[ERROR + 1])
        if error > settings.max_tracking_error:
            self._go_limp(Phase.SAFE_STOP, f"tracking error {error:.4f} m; the limit is {settings.max_tracking_error} m")
            return
        if not crossing:
            return
        self._watch = self._watch + dt if saturated else max(self._watch - WATCH_DECAY * dt, 0.0)
        if self._watch > settings.watch_time:
            self._go_limp(
                Phase.SAFE_STOP,
                f"torque {peak:.3f} N m for {1e3 * self._watch:.0f} ms; the limit is"
                f" {limit:.3f} N m for {1e3 * settings.watch_time:.0f} ms",
            )

    def _compare_sides(self, s_ref: float) -> None:
        """The believed assembly mode against the reference's, away from the locus: a verdict for each crossing."""
        if abs(s_ref) < self.settings.verdict_s or not self._sure_of_side():
            return
        row = self.estimator.row
        current = self._current_crossing()
        if row[MODE_HAT] * s_ref < 0.0:
            self._judge(current, Verdict.BOUNCED)
            self._go_limp(
                Phase.SAFE_STOP,
                f"bounced: the robot is at s = {self.estimator.s:+.2f}, the reference at {s_ref:+.2f}"
                f" (confidence {row[CONFIDENCE]:.3f})",
            )
        elif current >= 0 and self.phase in MOVING and s_ref * self._crossing_signs[current] > 0.0:
            self._judge(current, Verdict.CROSSED)

    def _compare_afterwards(self) -> None:
        """The side on which a robot ends that was let go during a crossing: it may change as it coasts.

        While it brakes, and until it comes near Type 1: behind that lies another working mode, which the model does not follow.
        """
        if self._time - self._stop_time > self.settings.brake_time:
            self._open = -1
        if self._open < 0 or not self._sure_of_side():
            return
        row = self.estimator.row
        kin = state_of_platform(self.model, row[X_HAT : X_HAT + 2], row[X_HAT + 2 : X_HAT + 4])
        if not type1_distance(self.model, kin) >= TYPE1_END:
            self._open = -1
            return
        same = self.estimator.row[MODE_HAT] * self._crossing_signs[self._open] > 0.0
        verdict = Verdict.CROSSED if same else Verdict.BOUNCED
        if self.passed[self._open].verdict is verdict:
            return
        self._judge(self._open, verdict)
        if not same and "bounced" not in self.reason:
            self.reason = f"bounced (s = {self.estimator.s:+.2f}, confidence {self.estimator.row[CONFIDENCE]:.3f}); {self.reason}"

    def _sure_of_side(self) -> bool:
        """Whether the estimator has an opinion about the assembly mode that counts."""
        return bool(self.estimator.row[CONFIDENCE] >= self.settings.verdict_confidence)

    def _current_crossing(self) -> int:
        """Index of the last planned crossing that has begun; -1 before the first and without a trajectory."""
        return bisect.bisect_right(self._crossing_times, self._time - self._start + OPEN_BEFORE) - 1

    def _judge(self, index: int, verdict: Verdict) -> None:
        if index >= 0 and self.passed[index].verdict is not verdict:
            time, confidence = self._time - self._start, float(self.estimator.row[CONFIDENCE])
            self.passed[index] = self.passed[index]._replace(verdict=verdict, confidence=confidence, time=time)

    def _limp(self) -> None:
        """One tick without the law: damped in SAFE_STOP until its time is over, else without torque."""
        settings, row, out = self.settings, self.estimator.row, self._out
        braking = self.phase is Phase.SAFE_STOP and self._time - self._stop_time <= settings.brake_time
        brake(self._packed, row, settings.brake_gain if braking else 0.0, self._crossing_limit, out)
        if out[FINITE] == 0.0:
            out[:FINITE] = 0.0
        self._ref[:] = 0.0
        self._ref[X_REF : X_REF + 2] = row[X_HAT : X_HAT + 2]
        self._ref[S_REF] = self.estimator.s


def wrapped(angles: Array) -> Array:
    """Angle differences (2,) in [-pi, pi), rad."""
    return np.array([wrap(float(angle)) for angle in angles])
