"""The control loop: estimate, law, watches and phases in one ``step(time, q_a)``, which
a rig, a node and a plain ``for`` call alike.
"""

from __future__ import annotations

import math

import numpy as np

from dextar_control.contract.errors import ParameterError, StateError, TrajectoryError
from dextar_control.contract.plug_in import short_name
from dextar_control.contract.settings import Settings
from dextar_control.control.law import GAINS, LAWS
from dextar_control.control.phases import MOVING, WITHOUT_LAW, Frame, Phase, Tick
from dextar_control.control.reference import PlannedReference
from dextar_control.control.safe_stop import SafeStop, Stage, Stopped
from dextar_control.control.supervisor import Supervisor, acts_of
from dextar_control.control.verdicts import CrossingJudge, Passed
from dextar_control.estimation.estimate import ExternalPosition
from dextar_control.estimation.estimator import make_estimator
from dextar_control.model.model import Model
from dextar_control.model.robot import AnyRobot
from dextar_control.planning.certificate import Certificate
from dextar_control.planning.checks import certify, check_rest
from dextar_control.planning.trajectory import Trajectory, hold, in_words
from dextar_control.symbols.functions import Fast
from dextar_control.symbols.record import Layout, Record
from dextar_control.symbols.types import Array

# |s| within which, and over which, the direct model is not used while holding a point
REST_ZONE, REST_WIDTH = 0.05, 0.05
HOLD_MARGIN = 0.05  # in |s|, over what holding a point needs
ENABLE_SPEED = 0.5  # rad/s of a joint, at which a robot still counts as at rest
FIRST_PERIOD = 1e-3  # s, period of the first sample
START_MARGIN = 2e-3  # s by which a trajectory's start may have passed when it begins
SAME_JOINTS = 1e-6  # rad, between the joints and those of their platform position
COUNTS = {2: "two", 3: "three"}
UNKNOWN_SIDE = "the estimator cannot tell on which side of the locus the robot stands:"


class ControlLoop:
    """The Cartesian computed-torque loop of one robot.

    Args:
        robot: the controller's model of it.
        settings: gains and limits.
        assembly_mode: sign of s where the robot stands at the first sample, the same of
            all blocks of A_r.
        enabled: whether the first sample is held; otherwise the loop idles until
            ``enable``.
        near: about where the robot stands at the first sample, (n,), m, for a mechanism
            without a direct geometric model in closed form; the origin when None.

    Attributes:
        phase: of the loop.
        reason: a sentence about why the law stopped acting; empty while it acts.
        tripped: name of the watch that stopped it; empty for none.
        refusal: a sentence about why the last trajectory was refused when it began.
        certificate: of the trajectory that was tracked last; None before the first.
        saturated_ticks: samples of the last trajectory with a torque at its limit.
        completed: number of trajectories that were tracked to their end.
        tick: the last sample; None before the first.
        lacking: largest torque at a joint that is not modelled, N m, up to
            ``torque_limit.min_torque``, when a crossing trajectory's torque was last
            at its limit with the side known; it is added to the limit.

    Raises:
        ParameterError: assembly_mode is neither +1 nor -1.
    """

    def __init__(
        self,
        robot: AnyRobot,
        settings: Settings,
        assembly_mode: int,
        *,
        enabled: bool = True,
        near: Array | None = None,
    ) -> None:
        if assembly_mode not in (-1, 1):
            raise ParameterError(
                f"assembly_mode = {assembly_mode}; it must be +1 or -1"
            )
        self.robot = robot
        self.model = Model.of(robot)
        n = self.model.n
        self.phase = Phase.HOLD if enabled else Phase.IDLE
        self.reason = ""
        self.tripped = ""
        self.refusal = ""
        self.certificate: Certificate | None = None
        self.saturated_ticks = 0
        self.completed = 0
        self.tick: Tick | None = None
        self._frame = Frame(n)
        frame = self._frame
        self._reference, self._estimate = frame.reference, frame.estimate
        self._output = frame.output
        self.estimator = make_estimator(
            self.model, settings, robot.min_type1_distance, self._estimate
        )
        self.supervisor = Supervisor(robot, self.model)
        self._assembly_mode, self._near = assembly_mode, near
        self._judge = CrossingJudge(self.model)
        self._stop = SafeStop(self.model)
        self._planned = PlannedReference(self.model, self._reference)
        self._gains: Record = Layout("gains", n, GAINS).make()
        self._offset = (
            np.array(robot.encoder_offset) if any(robot.encoder_offset) else None
        )
        self._answer: Array = self._output.tau
        self._integral, self._q_a = np.zeros(n), np.zeros(n)
        self._given = {
            "dt": np.zeros(1),
            "limit": np.zeros(1),
            "crossing": np.zeros(1),
            "q_meas": self._q_a,
        }
        self._acts: dict[str, Fast] = {}
        self._time = math.nan
        self._start = 0.0
        self._pending: tuple[Trajectory, Certificate, float | None] | None = None
        self._crossing_limit = robot.max_torque
        self.lacking = 0.0
        self._stop_wanted = False
        self.configure(settings)

    def configure(self, settings: Settings) -> None:
        """Take gains and limits, also while running; the estimator stays the same.

        Raises:
            ParameterError: the law's transition would reach the locus itself, the zones
                of the test of crossed against bounced are not in order, or there is no
                such law.
        """
        near, test, dgm = settings.near_locus, settings.crossing_test, settings.dgm
        if near.fade_abs_s < 0.5 * near.fade_width_abs_s:
            raise ParameterError(
                f"near_locus.fade_abs_s = {near.fade_abs_s} with"
                f" near_locus.fade_width_abs_s = {near.fade_width_abs_s}: the"
                " transition would reach the locus; near_locus.fade_abs_s must be >="
                f" {0.5 * near.fade_width_abs_s}"
            )
        if not test.unknown_below_abs_s < test.begin_below_abs_s:
            raise ParameterError(
                f"crossing_test.unknown_below_abs_s = {test.unknown_below_abs_s} with"
                f" crossing_test.begin_below_abs_s = {test.begin_below_abs_s}; it must"
                " be smaller"
            )
        self.settings = settings
        self._held = dgm.hold_below_abs_s, dgm.fade_width_abs_s
        if settings.law not in self._acts:
            # the laws of this package are compiled together, one's own by itself
            laws = tuple(LAWS) if settings.law in LAWS else (settings.law,)
            library = acts_of(self.model.mechanism, laws)
            self._acts[settings.law] = library.fast(
                f"act_{short_name(settings.law)}",
                p=self.model.p,
                gains=self._gains.numbers,
                reference=self._reference.numbers,
                estimate=self._estimate.numbers,
                output=self._output.numbers,
                integral=self._integral,
                integral_next=self._integral,
                **self._given,
                **self.supervisor.places,
            )
        self._act = self._acts[settings.law]
        self._places = self._act.views()
        feedback, K_p = settings.feedback, settings.feedback.natural_frequency**2
        banded = settings.law in ("projected", "multi_model")
        gains = self._gains.layout.make(
            K_p=K_p,
            K_d=2.0 * feedback.damping_ratio * feedback.natural_frequency,
            K_i=feedback.integral_frequency * K_p,
            zone=near.replace_below_abs_s if banded else near.fade_abs_s,
            zone_width=near.fade_width_abs_s,
            friction_compensation=settings.compensation.friction,
            disturbance_compensation=settings.compensation.disturbance,
        )
        self._gains.take(gains)
        self.estimator.configure(settings)
        self.supervisor.configure(settings)
        self._judge.configure(settings)
        self._stop.configure(settings)

    @property
    def passed(self) -> list[Passed]:
        """The planned crossings of the last trajectory with their verdicts."""
        return self._judge.passed

    @property
    def watches(self) -> dict[str, tuple[float, float]]:
        """(value, limit) of each watch of ``supervisor.WATCHES`` at the last sample at
        which a law acted.
        """
        return self.supervisor.watches

    @property
    def stopped(self) -> Stopped | None:
        """The end of the last safe stop; None before the first and while one lasts."""
        return self._stop.ended

    @property
    def torque_limit(self) -> float:
        """The torque limit of the trajectory that was tracked last, N m, which a safe
        stop keeps.
        """
        return self._crossing_limit

    @property
    def hold_s(self) -> float:
        """Least |s| at which a point is held: clear of where the side is not known and
        of the watch "locus".
        """
        rest, unknown_s = REST_ZONE + REST_WIDTH, self.estimator.unknown_s
        return max(rest, unknown_s, self.settings.watch.min_abs_s) + HOLD_MARGIN

    @property
    def mode_known(self) -> bool:
        """Whether the side of the locus on which the robot stands is known well enough
        to begin a motion.
        """
        return self.estimator.mode_known

    def check(self, trajectory: Trajectory) -> Certificate:
        """Check a trajectory by itself, as ``accept`` does; also in another thread than
        the loop.

        Raises:
            TrajectoryError: it breaks the criterion, the workspace or a limit, or does
                not rest at its ends clear of the locus; names the value and the limit.
        """
        check_rest(trajectory)
        residual = self.settings.trajectory.max_residual
        certificate = certify(self.robot, trajectory, max_residual=residual)
        least = self.settings.dgm.hold_below_abs_s + self.settings.dgm.fade_width_abs_s
        for name, row in (("starts", 0), ("ends", -1)):
            s = abs(float(certificate.profile.s[row]))
            if s < least:
                raise TrajectoryError(
                    f"the trajectory {name} at |s| = {s:.3f} of the Type 2 locus; the"
                    f" limit is {least:.3g}: serve one that starts and ends farther"
                    " from it (task.start, task.goal)"
                )
        return certificate

    def accept(self, trajectory: Trajectory, start: float | None = None) -> Certificate:
        """Check a trajectory and track it from its start time on.

        Args:
            start: in the time of the samples, s; the next sample when None.

        Raises:
            TrajectoryError: as ``check``, or it does not start at the robot, or in the
                past, or the loop is not holding.
        """
        certificate = self.check(trajectory)
        self.schedule(trajectory, certificate, start)
        return certificate

    def schedule(
        self,
        trajectory: Trajectory,
        certificate: Certificate,
        start: float | None = None,
    ) -> None:
        """Track a checked trajectory from its start time on; see ``accept``.

        A trajectory that turns out wrong only when it begins (it starts elsewhere than
        the robot, or too late) is refused then, in ``refusal``.
        """
        if self.phase != Phase.HOLD:
            raise TrajectoryError(
                "a trajectory is taken in phase HOLD only; the controller is in"
                f" {self.phase.name}"
            )
        if not math.isnan(self._time):
            self._check_start(trajectory, start, self._time)
        self.refusal = ""
        self._pending = (trajectory, certificate, start)

    def _check_start(
        self, trajectory: Trajectory, start: float | None, time: float
    ) -> None:
        if not self.mode_known:
            raise TrajectoryError(
                f"{UNKNOWN_SIDE} disable, set assembly_mode to the side where it"
                " stands, enable"
            )
        first, held = trajectory.at(0.0).x, self.trajectory.at(0.0).x
        distance = float(np.linalg.norm(first - held))
        limit = self.settings.trajectory.max_start_distance
        if not distance <= limit:
            raise TrajectoryError(
                f"the trajectory starts in {in_words(first)}, {distance:.4f} m from the"
                f" robot; the limit is {limit} m: serve one that starts where the robot"
                " stands"
            )
        if start is not None and time - start > START_MARGIN:
            raise TrajectoryError(
                f"the trajectory starts at {start:.6f} s; the last state is of"
                f" {time:.6f} s: serve it with a later start, or with 0"
            )

    def enable(self) -> None:
        """Leave IDLE and hold the present point.

        Raises:
            StateError: the robot stands too near to the locus to be held, or on a side
                that is not known, or it moves; says what to do.
        """
        if self.phase != Phase.IDLE:
            return
        if self.tick is not None:
            self._need_side("enable")
            s, speed = self._standing()
            if not s >= self.hold_s:
                raise StateError(
                    f"the robot stands at |s| = {s:.3f} of the locus: move it by hand"
                    f" to |s| >= {self.hold_s:.2f}, then enable"
                )
            if not speed <= ENABLE_SPEED:
                raise StateError(
                    f"a joint moves at {speed:.2f} rad/s; the limit is {ENABLE_SPEED}"
                    " rad/s: bring it to rest, then enable"
                )
            self._hold_at(self.tick.x_hat)
        self.phase, self.reason, self.tripped = Phase.HOLD, "", ""

    def disable(self) -> None:
        """Give no torque from the next sample on; a safe stop stays latched, but brakes
        no longer.
        """
        if self.phase is Phase.SAFE_STOP:
            if self._stop.stage is not Stage.OVER:
                self._stop.abandon()
                self.reason = f"{self.reason}; let go on request"
        elif self.phase is not Phase.FAULT:
            self._end_law(Phase.IDLE, "disabled on request")

    def stop(self, reason: str = "stop requested") -> None:
        """Begin a safe stop as soon as the robot would come to rest clear of the locus:
        mostly at once.

        A robot that would not, while no watch trips (it is crossing, or too fast before
        the locus), finishes its crossing first. A robot that holds a point goes on
        holding; a trajectory that waits for its start is dropped.
        """
        self._pending = None
        if self.phase in MOVING and not self._stop_wanted:
            self._stop_wanted, self.reason = True, reason
            if self.tick is None or self._comes_to_rest():
                self._end_law(Phase.SAFE_STOP, reason)

    def fault(self, reason: str) -> None:
        """Give no torque, latched until ``reset``."""
        self._end_law(Phase.FAULT, reason)

    def set_assembly_mode(self, assembly_mode: int) -> None:
        """Tell on which side of the locus the robot stands, while no law acts.

        Raises:
            StateError: the loop is holding or moving, or the robot stands where the
                estimator would not keep it.
        """
        if self.phase not in WITHOUT_LAW:
            raise StateError(
                "the assembly mode can be told in IDLE, SAFE_STOP or FAULT; the phase"
                f" is {self.phase.name}: disable first"
            )
        if (
            not math.isnan(self._time)
            and not self._standing()[0] >= self.estimator.unknown_s
        ):
            raise StateError(
                f"{self._too_near()} move it by hand to |s| >= {self.hold_s:.2f}, then"
                " set assembly_mode"
            )
        self._assembly_mode = assembly_mode
        self._judge.close()
        if not math.isnan(self._time):
            self.estimator.tell_mode(assembly_mode, self._q_a)

    def reset(self) -> None:
        """Go from SAFE_STOP or FAULT to IDLE.

        Raises:
            StateError: the safe stop is not over, or the robot was near the locus
                without control, so that its assembly mode is not known; says what to
                do.
        """
        if self.phase is Phase.SAFE_STOP and self._stop.stage is not Stage.OVER:
            raise StateError(
                f"the safe stop is not over ({self._stop.stage.name.lower()}): wait"
                " until it is, then reset"
            )
        if self.phase in (Phase.SAFE_STOP, Phase.FAULT):
            self._need_side("reset")
            self.phase, self.reason = Phase.IDLE, ""
            self._judge.close()

    def _standing(self) -> tuple[float, float]:
        """Return (|s| by the joints alone, the larger joint speed, rad/s)."""
        q_a_dot, x = self._estimate.q_a_dot, self._estimate.x
        now = self._stop.braking(self._q_a, q_a_dot, x, 0.0, self.robot.max_torque)
        return now.s, now.speed

    def _too_near(self) -> str:
        return (
            f"the robot stands at |s| = {self._standing()[0]:.3f} of the locus, where"
            " its side cannot be kept:"
        )

    def _need_side(self, then: str) -> None:
        """Check that the side of the locus is known.

        Raises:
            StateError: it is not; says what to do before ``then``.
        """
        if self.mode_known:
            return
        if not self._standing()[0] >= self.hold_s:
            raise StateError(
                f"{self._too_near()} move it by hand to |s| >= {self.hold_s:.2f}, set"
                f" assembly_mode to the side where it stands, then {then}"
            )
        raise StateError(
            f"{UNKNOWN_SIDE} set assembly_mode to the side where it stands, then {then}"
        )

    def _end_law(self, phase: Phase, reason: str, *, trusted: bool = True) -> None:
        """End the law: from now on the robot is only observed, and stopped in
        SAFE_STOP.

        Args:
            phase: of ``WITHOUT_LAW``.
            reason: a sentence.
            trusted: whether the estimate still tells on which side the robot is.
        """
        if self.phase in MOVING:
            self._judge.let_go(self._time)
        elif self.phase not in WITHOUT_LAW:
            self._judge.close()
        self.estimator.release(self.phase == Phase.CROSSING)
        self.supervisor.forget()
        self.phase, self.reason = phase, reason
        self._pending, self._stop_wanted = None, False
        over, limit = phase is not Phase.SAFE_STOP, self._crossing_limit
        self._stop.begin(self._time, limit, trusted=trusted, over=over)

    def _hold_at(self, x: Array) -> None:
        x, times = np.array(x), np.array([0.0, 1.0])
        self._set_trajectory(hold(x, 1.0), times, np.zeros((2, self.model.n)))
        self.estimator.rebase(self.model.inverse_geometric_model(x))
        self._integral[:] = 0.0

    def _set_trajectory(
        self, trajectory: Trajectory, times: Array, multipliers: Array
    ) -> None:
        self.trajectory = trajectory
        self._duration = trajectory.duration
        self._planned.set(trajectory, times, multipliers)

    def _first(self, q_a: Array) -> None:
        x = self.model.close(q_a, self._assembly_mode, self._near)
        implied = self.model.inverse_geometric_model(x)
        off = [abs(math.remainder(angle, 2.0 * math.pi)) for angle in implied - q_a]
        if not max(off) < SAME_JOINTS:
            angles = ", ".join(f"{angle:.4f}" for angle in q_a)
            raise StateError(
                f"active joints ({angles}) rad with assembly mode"
                f" {self._assembly_mode:+d} are not in working mode"
                f" {self.robot.working_mode}: check offset and sign of the encoders,"
                " assembly_mode, working_mode"
            )
        s = abs(float(self.model.state(implied, x, np.zeros(self.model.n)).s[0]))
        if self.phase == Phase.HOLD and s < self.hold_s:
            raise StateError(
                f"the robot stands at |s| = {s:.3f} of the locus; holding needs"
                f" {self.hold_s:.2f}"
            )
        self.estimator.start(x, q_a, self._assembly_mode)
        self._hold_at(x)

    def step(
        self, time: float, q_a: Array, pose: ExternalPosition | None = None
    ) -> Array:
        """Return the torques (n,), N m, that answer a sample of the active joints.

        Args:
            time: of the sample, s.
            q_a: active joints, (n,), rad, as the encoders read them, from which the
                robot's offsets are subtracted here.
            pose: an external measurement that has arrived since the last sample; for
                the estimator ``external``.

        Raises:
            StateError: a number is not finite, time does not advance, or (first sample)
                the joints belong to another working mode or stand on the locus. Nothing
                is changed then.
            GeometryError: first sample: the distal links cannot meet.
        """
        time, q_a = float(time), np.asarray(q_a, dtype=np.float64)
        if q_a.shape != self._q_a.shape or not math.isfinite(time + sum(q_a.tolist())):
            count = COUNTS.get(self.model.n, self.model.n)
            raise StateError(
                f"state at {time} s: active joints {q_a} are not {count} finite numbers"
            )
        if self._offset is not None:
            q_a = q_a - self._offset
        if math.isnan(self._time):
            self._first(q_a)
            dt = FIRST_PERIOD
        else:
            dt = time - self._time
            if not dt > 0.0:
                raise StateError(
                    f"state at {time:.6f} s is not after the last one at"
                    f" {self._time:.6f} s"
                )
        self._time, self._places.q_meas[:] = time, q_a
        if self._pending is not None:
            start = self._pending[2]
            if start is None or time >= start:
                self._begin(time, *self._pending)
        reference_time = 0.0
        if self.phase in MOVING:
            reference_time = time - self._start
            if reference_time >= self._duration:
                reference_time = self._end()
        if pose is not None:
            self.estimator.take_pose(pose, time)
        if self.phase in WITHOUT_LAW:
            self.estimator.coast(dt, self._q_a, self._answer)
            self._judge_coasting()
            self._answer_without_law(dt)
        else:
            self._servo(reference_time, dt)
        self.tick = Tick(time, reference_time, self.phase, self._frame)
        answer: Array = self._answer.copy()
        return answer

    def _begin(
        self,
        time: float,
        trajectory: Trajectory,
        certificate: Certificate,
        start: float | None,
    ) -> None:
        self._pending = None
        try:
            self._check_start(trajectory, start, time)
        except TrajectoryError as error:
            self.refusal = str(error)
            return
        self.certificate = certificate
        crossing = len(certificate.crossing_times) > 0
        self._crossing_limit = self.robot.max_torque
        if crossing:  # which bounds a robot that bounced before the verdict is given
            told = self.settings.torque_limit
            planned = max(told.peak_ratio * certificate.peak_torque, told.min_torque)
            self._crossing_limit = min(self.robot.max_torque, planned)
        self._start = time if start is None else start
        self._judge.begin(certificate, self._start)
        self.supervisor.begin()
        profile = certificate.profile
        self._set_trajectory(trajectory, profile.time, profile.multipliers)
        self._integral[:] = 0.0
        self._stop_wanted = False
        self.saturated_ticks, self.lacking = 0, 0.0
        self.phase = Phase.TRACK if crossing else Phase.APPROACH

    def _end(self) -> float:
        """Hold the end of the trajectory, or stop where that was asked for during the
        crossing.
        """
        self.completed += 1
        self.phase = Phase.HOLD
        self._hold_at(self.trajectory.at(self._duration).x)
        if self._stop_wanted:
            self._end_law(Phase.SAFE_STOP, self.reason)
        return 0.0

    def _servo(self, reference_time: float, dt: float) -> None:
        """Run one tick of the law, and check whether it may go on."""
        given = self._places
        crossing = self.phase is Phase.TRACK or self.phase is Phase.CROSSING
        zone, width = self._held if crossing else (REST_ZONE, REST_WIDTH)
        s_ref = self._planned.at(reference_time)
        self.estimator.track(dt, self._q_a, self._answer, self._reference, zone, width)
        limit = self.robot.max_torque
        if crossing:
            self.phase = Phase.CROSSING if abs(s_ref) < zone + width else Phase.TRACK
            # on the other side d would be another
            if self.supervisor.saturated and self.mode_known:
                largest = float(abs(self._estimate.d).max())
                least = self.settings.torque_limit.min_torque
                self.lacking = min(largest, least)
            limit = min(limit, self._crossing_limit + self.lacking)
        given.dt[0], given.limit[0] = dt, limit
        given.crossing[0] = self.phase is Phase.CROSSING
        self._act.run()
        self._supervise(dt)
        if self.phase in WITHOUT_LAW:
            self._answer_without_law(dt)

    def _supervise(self, dt: float) -> None:
        """End the law where a watch trips or the verdict is that the robot bounced."""
        problem = self.supervisor.check(self._q_a, dt, self.estimator)
        self.saturated_ticks += self.supervisor.saturated
        if self._stop_wanted and not problem and self._comes_to_rest():
            self._end_law(Phase.SAFE_STOP, self.reason)
            return
        side = self._judge.compare(
            self._time,
            self._planned.s_blocks.tolist(),
            self.estimator,
            self.phase in MOVING,
            self.supervisor,
        )
        if side or problem:
            self.tripped = "side" if side else self.supervisor.tripped
            trusted = not self.supervisor.estimate_lost
            self._end_law(Phase.SAFE_STOP, side or problem, trusted=trusted)

    def _comes_to_rest(self) -> bool:
        """Return whether a robot that is braked from now on stops clear of
        the locus.
        """
        mode = self._estimate.assembly_mode if self.mode_known else 0.0
        return self._stop.comes_to_rest(self._estimate, mode, self._crossing_limit)

    def _judge_coasting(self) -> None:
        """Give verdicts on the crossing during which the law stopped acting, for as
        long as braking takes.
        """
        if self._time - self._stop.began > self.settings.safe_stop.brake_time:
            self._judge.close()
        news = self._judge.compare_afterwards(self._time, self.estimator)
        if news and "bounced" not in self.reason:
            self.reason = f"{news}; {self.reason}"

    def _answer_without_law(self, dt: float) -> None:
        """Answer a sample without a law: by the safe stop, or without torque."""
        ended = self._stop.step(
            self._time, dt, self._estimate, self.estimator.mode_known, self._output
        )
        if ended:
            self.reason = f"{self.reason}; {ended}"
        self._reference.numbers[:] = 0.0
        self._reference.x, self._reference.s = self._estimate.x, self._estimate.s
