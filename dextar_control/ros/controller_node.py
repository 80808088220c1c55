"""The controller node: one command for each joint state, from the active joints alone."""

from __future__ import annotations

import gc
import math
import sys
import time
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

from dextar_control.contract.cdr import NANOSECONDS, from_time, read_message
from dextar_control.contract.errors import DextarError, ParameterError, StateError, TrajectoryError
from dextar_control.contract.node import DextarNode, Parameter, qos, run_node
from dextar_control.contract.topics import (
    CONTROLLER_STATE,
    CRITERION,
    JOINT_COMMANDS,
    JOINT_STATES,
    MAX_TRAJECTORY_POINTS,
    TRAJECTORY,
)
from dextar_control.core.certificate import Certificate
from dextar_control.core.law import CONFIDENCE, ERROR, FINITE, MODE_HAT, Q_HAT, Q_REF, SCALARS, Law
from dextar_control.core.loop import LIMP, OPEN_BEFORE, ControlLoop, Passed, Phase, Tick, Verdict
from dextar_control.core.settings import Estimation, Settings
from dextar_control.core.trajectory import Trajectory
from dextar_control.core.warmup import warm_up
from dextar_control.ros import messages
from dextar_control.ros.external_pose import ExternalPoseReader
from dextar_control.ros.task import in_words

LAWS = tuple(law.name.lower() for law in Law)
WORDS = {verdict: verdict.name.lower() for verdict in Verdict}
ESTIMATORS = tuple(estimator.name.lower() for estimator in Estimation)

PARAMETERS = (
    Parameter("law", "multipliers near the locus", choices=LAWS),
    Parameter("estimator", "of the platform state and the assembly mode", choices=ESTIMATORS),
    Parameter("enabled", "hold the first state; false idles until ~/enable"),
    Parameter("lockstep", "states arrive reliably and at any pace"),
    Parameter("assembly_mode", "sign of s where the robot stands; live without torque", -1, 1, live=True),
    Parameter("task.sample_period", "of the control loop, s", 1e-4, 0.1),
    Parameter("state_timeout", "longest gap between two states, by their stamps, s", 1e-3, 10.0, live=True),
    Parameter("natural_frequency", "of the platform error, rad/s", 1.0, 500.0, live=True),
    Parameter("damping_ratio", "of the platform error", 0.1, 5.0, live=True),
    Parameter("integral_frequency", "of the integral term, 1/s; 0 is off", 0.0, 50.0, live=True),
    Parameter("zone", "|s| in the middle of the law's transition", 0.0, 0.9, live=True),
    Parameter("zone_width", "of the law's transition in |s|", 0.0, 0.9, live=True),
    Parameter("band", "|s| of the band of the laws projected and multi_model", 0.0, 0.9, live=True),
    Parameter("hold_zone", "|s| below which dgm does not call the direct model", 0.0, 0.9, live=True),
    Parameter("hold_width", "of the zone around it that still counts as a crossing, in |s|", 0.0, 0.9, live=True),
    Parameter("filter_bandwidth", "of the joint filter of dgm and plain, rad/s", 10.0, 2000.0, live=True),
    Parameter("return_time", "over which dgm takes the direct model again after a crossing, s", 0.0, 1.0, live=True),
    Parameter("encoder_deviation", "of a joint sample, as the observer is told, rad", 1e-7, 0.1, live=True),
    Parameter("bias_deviation", "of the joint angles that a wrong geometry explains, rad", 1e-9, 0.1, live=True),
    Parameter("bias_walk", "of their random walk, rad/sqrt(s)", 0.0, 0.1, live=True),
    Parameter("torque_deviation", "of a sample's torque, N m", 1e-6, 10.0, live=True),
    Parameter("acceleration_deviation", "of a sample's platform acceleration, m/s^2", 0.0, 1e3, live=True),
    Parameter("shock_gate", "innovation of the joints that only a blow explains, deviations", 1.0, 1e6, live=True),
    Parameter("shock_speed", "by which a blow may change the platform's speed, m/s", 0.0, 100.0, live=True),
    Parameter("passage_armed", "|s| within which the assembly mode counts as unknown", 0.0, 0.9, live=True),
    Parameter("passage_begin", "|s| at which the test of crossed against bounced begins", 0.0, 0.9, live=True),
    Parameter("passage_log_odds", "that decide the test", 0.1, 20.0, live=True),
    Parameter("passage_encoder_deviation", "of a joint sample, as the test is told, rad", 1e-7, 0.1, live=True),
    Parameter("passage_torque_deviation", "of a sample's torque, as the test is told, N m", 1e-6, 10.0, live=True),
    Parameter("passage_acceleration_deviation", "of a sample's platform acceleration, as the test is told, m/s^2", 0.0, 1e3,
              live=True),
    Parameter("pose_deviation", "of an external position, m", 1e-6, 0.1, live=True),
    Parameter("pose_gate", "distance beyond which an external position is refused, deviations", 1.0, 1e3, live=True),
    Parameter("pose_timeout", "without an external position, after which its absence is told, s", 1e-3, 10.0, live=True),
    Parameter("friction_compensation", "fraction of the modelled friction fed forward", 0.0, 1.5, live=True),
    Parameter("max_tracking_error", "ends a motion in a safe stop, m", 1e-4, 0.2, live=True),
    Parameter("max_start_distance", "between the robot and a trajectory's start, m", 1e-5, 0.05, live=True),
    Parameter("max_residual", "of the criterion at an accepted crossing, N", 1e-12, 10.0, live=True),
    Parameter("verdict_s", "|s| of the reference outside which the believed assembly mode is compared", 0.0, 0.9, live=True),
    Parameter("verdict_confidence", "in the assembly mode from which on it counts", 0.6, 0.99999999, live=True),
    Parameter("watch_ratio", "torque over planned peak that a crossing trajectory is held below", 1.0, 1e6, live=True),
    Parameter("watch_torque", "that it is always allowed, N m", 0.0, 100.0, live=True),
    Parameter("watch_time", "at a torque limit that ends a motion in a safe stop, s", 0.0, 10.0, live=True),
    Parameter("brake_gain", "of the safe stop, N m s/rad", 0.0, 10.0, live=True),
    Parameter("brake_time", "after which the safe stop's torque is gone, s", 0.0, 10.0, live=True),
    Parameter("brake_constant", "of the safe stop on a known side: the velocity's time constant, s", 0.005, 1.0, live=True),
    Parameter("coast_s", "|s| within which the safe stop coasts", 0.02, 0.9, live=True),
    Parameter("stop_s", "|s| clear of which the safe stop comes to rest", 0.02, 0.9, live=True),
    Parameter("coast_time", "of the safe stop's coasting, after which it gives no torque any more, s", 0.0, 10.0, live=True),
    Parameter("rest_time", "for which the joints rest until the safe stop is over, s", 0.01, 10.0, live=True),
    Parameter("speed_margin", "times the robot's speed limits beyond which a motion is stopped", 1.0, 10.0, live=True),
    Parameter("speed_time", "beyond them, which ends a motion in a safe stop, s", 0.0, 10.0, live=True),
    Parameter("joint_margin", "by which a joint may leave its range, rad", 0.0, 1.0, live=True),
    Parameter("max_joint_jump", "of a joint beside where the last estimate expected it, rad", 1e-4, 3.2, live=True),
    Parameter("max_joint_misfit", "of a joint beside that of the estimated platform, rad", 1e-4, 3.2, live=True),
    Parameter("misfit_time", "of that misfit, which ends a motion in a safe stop, s", 0.0, 10.0, live=True),
    Parameter("locus_s", "|s| nearer than which the robot may come in phase CROSSING only", 0.0, 0.9, live=True),
    Parameter("max_torque_rate", "of a torque, in the robot's max_torque per second", 1.0, 1e6, live=True),
    Parameter("torque_rate_time", "of that rate, which ends a motion in a safe stop, s", 0.0, 10.0, live=True),
)  # fmt: skip

SERVED_BEFORE = 1.0  # s, by which a latched trajectory may be older than the node; allows for two machines' clocks
SWITCH_INTERVAL = 2e-4  # s until the thread that checks a trajectory lets the control thread go on
STALLED = 0.5  # s on the steady clock without a state before a fault is latched
WATCH_PERIOD = 0.01  # s
DIAGNOSTICS_PERIOD = 0.2  # s
TELL_PERIOD = 1.0  # s between two lines about the external pose


class ControllerNode(DextarNode):
    """Answers each joint state with a torque (``core.loop``) and tells what it did.

    A gap of more than ``state_timeout`` between the stamps of two states is a fault (no torque until
    ``~/reset`` and ``~/enable``); while no state comes nothing is commanded at all, and the drive's own
    time-out takes the torque away.
    """

    def __init__(self) -> None:
        super().__init__("controller", PARAMETERS, robot=True)
        if self.values["assembly_mode"] == 0:
            raise ParameterError("parameter 'assembly_mode' = 0; it must be +1 or -1")
        self._period = self.values["task.sample_period"]
        warm_up()
        self._loop = ControlLoop(
            self.robot, Settings.from_values(self.values), self.values["assembly_mode"], enabled=self.values["enabled"]
        )
        self._states_in = messages.joint_states_template()
        self._commands_out = messages.joint_commands_template()
        self._state_out = messages.controller_state_template()
        self._criterion_out = messages.criterion_template()
        self._counts = {"states": 0, "missed_states": 0, "refused_states": 0, "repeated_states": 0, "stalls": 0}
        self._stamp = -1
        self._arrival = math.nan
        self._stalled = False
        self._last_command = b""
        self._tick_times: deque[float] = deque(maxlen=500)
        self._trajectory_note = "none"
        self._refusal = ""
        self._checker = ThreadPoolExecutor(max_workers=1)
        self._checking: Future[tuple[Trajectory, Certificate, float | None] | None] | None = None
        self._said: tuple[Phase, str] = (self._loop.phase, "")
        self._passed: list[Passed] = self._loop.passed
        self._begun = -1
        self._pose_note = ""
        self._pose_told = -math.inf
        reliable = self.values["lockstep"]
        self._command_publisher = self.create_publisher(JointState, JOINT_COMMANDS.name, qos(JOINT_COMMANDS))
        self._state_publisher = self.create_publisher(JointTrajectory, CONTROLLER_STATE.name, qos(CONTROLLER_STATE))
        self._criterion_publisher = self.create_publisher(JointState, CRITERION.name, qos(CRITERION))
        self.create_subscription(
            JointState, JOINT_STATES.name, self._on_state, qos(JOINT_STATES, reliable=reliable), raw=True
        )
        self._trajectories = self.create_polled_subscription(MultiDOFJointTrajectory, TRAJECTORY.name, qos(TRAJECTORY))
        external = self._loop.settings.estimator is Estimation.EXTERNAL
        self._poses = ExternalPoseReader(self) if external else None
        self._started = time.time_ns()
        self.create_service(SetBool, "~/enable", self._on_enable)
        self.create_service(Trigger, "~/stop", self._on_stop)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_timer(WATCH_PERIOD, self._watch, clock=self.steady_clock)
        self.create_timer(DIAGNOSTICS_PERIOD, self._diagnose, clock=self.steady_clock)
        sys.setswitchinterval(SWITCH_INTERVAL)
        gc.collect()
        gc.freeze()
        self.get_logger().info(
            f"law {self.values['law']}, estimator {self.values['estimator']},"
            f" waiting for {self.resolve_topic_name(JOINT_STATES.name)}"
        )

    def on_parameters(self, changes: Mapping[str, Any]) -> None:
        """Take live gains, limits or, without torque, the assembly mode."""
        if changes.get("assembly_mode") == 0:
            raise ParameterError("parameter 'assembly_mode' = 0; it must be +1 or -1")
        if not changes.keys().isdisjoint(Settings.__dataclass_fields__):
            self._loop.configure(Settings.from_values(self.values))
        if "assembly_mode" in changes:
            self._loop.set_assembly_mode(changes["assembly_mode"])

    def _on_state(self, raw: bytes) -> None:
        begin = time.perf_counter()
        known = self._states_in.unpack(raw)
        try:
            if known is not None:
                stamp, values = known
                q_a = np.array(values[0:2])
            else:
                message = deserialize_message(raw, JointState)
                q_a = messages.active_joints(message)
                stamp = from_time(message.header.stamp)
                if list(message.name) == ["q11", "q21"]:
                    self._states_in.learn(raw)
            if stamp == self._stamp and self._last_command:
                self._counts["repeated_states"] += 1
                self._command_publisher.publish(self._last_command)
                return
            self._check_gap(stamp)
            pose = None if self._poses is None else self._poses.take()
            tau = self._loop.step(stamp / NANOSECONDS, q_a, pose)
        except DextarError as error:
            self._refuse(error)
            return
        self._stamp = stamp
        self._arrival = begin
        self._stalled = False
        self._counts["states"] += 1
        self._answer(stamp, tau)
        self._tick_times.append(time.perf_counter() - begin)
        if self._loop.refusal != self._refusal:
            self._refusal = self._loop.refusal
            self._note_refusal(self._refusal)

    def _answer(self, stamp: int, tau: np.ndarray) -> None:
        tick = self._loop.tick
        assert tick is not None
        self._last_command = self._commands_out.pack(stamp, tau.tolist())
        self._command_publisher.publish(self._last_command)
        reference, estimate, output = tick.rows
        values = [*reference[:Q_REF].tolist(), *estimate[:Q_HAT].tolist(), *output[ERROR:SCALARS].tolist()]
        self._state_publisher.publish(self._state_out.pack(stamp, values, round(tick.reference_time * NANOSECONDS)))
        mode, confidence = estimate[MODE_HAT : CONFIDENCE + 1].tolist()
        criterion = [*output[SCALARS:FINITE].tolist(), mode, float(tick.phase), confidence, self._verdict(tick)]
        self._criterion_publisher.publish(self._criterion_out.pack(stamp, criterion))
        if (self._loop.phase, self._loop.reason) != self._said:
            self._say(answered=True)

    def _verdict(self, tick: Tick) -> float:
        """Of the planned crossing that has begun last; once the controller let go that one stays."""
        passed = self._loop.passed
        if passed is not self._passed:
            self._passed, self._begun = passed, -1
        begun = tick.reference_time + OPEN_BEFORE
        while self._begun + 1 < len(passed) and passed[self._begun + 1].planned_time <= begun:
            self._begun += 1
        return float(passed[self._begun].verdict) if self._begun >= 0 else 0.0

    def _check_gap(self, stamp: int) -> None:
        if self._stamp < 0:
            return
        gap = (stamp - self._stamp) / NANOSECONDS
        self._counts["missed_states"] += max(round(gap / self._period) - 1, 0)
        if gap > self.values["state_timeout"] and self._loop.phase not in (Phase.IDLE, Phase.FAULT):
            self._loop.fault(f"no state for {1e3 * gap:.1f} ms; the limit is {1e3 * self.values['state_timeout']:.1f} ms")

    def _refuse(self, error: DextarError) -> None:
        """No torque for a state that cannot be used; a broken first state or a bad number is a fault."""
        self._counts["refused_states"] += 1
        if self._loop.phase not in (Phase.IDLE, Phase.FAULT) and isinstance(error, StateError):
            self._loop.fault(str(error))
        else:
            self.get_logger().error(str(error), throttle_duration_sec=1.0)
        if (self._loop.phase, self._loop.reason) != self._said:
            self._say()

    def _say(self, *, answered: bool = False) -> None:
        """Tell a change of phase; one that no state has answered yet takes the torque away at once."""
        self._said = (self._loop.phase, self._loop.reason)
        if not answered and self._loop.phase in LIMP:
            self._release()
        if self._loop.phase in (Phase.FAULT, Phase.SAFE_STOP):
            self.get_logger().error(f"{self._loop.phase.name}: {self._loop.reason}")
        else:
            self.get_logger().info(f"phase {self._loop.phase.name}")
        self._diagnose()

    def _release(self) -> None:
        """No torque, in answer to the last state once more."""
        if self._stamp >= 0:
            self._last_command = self._commands_out.pack(self._stamp, (0.0, 0.0))
            self._command_publisher.publish(self._last_command)

    def _watch(self) -> None:
        """New trajectories, states on the steady clock, and who else commands the robot."""
        self._take_trajectory()
        self._tell_pose()
        if self._loop.phase in (Phase.IDLE, Phase.FAULT):
            return
        others = self.count_publishers(self._command_publisher.topic_name) - 1
        if others > 0:
            self._loop.fault(f"{others + 1} publishers on {self._command_publisher.topic_name}; the limit is 1")
        age = time.perf_counter() - self._arrival
        if not math.isnan(age) and not self.values["lockstep"]:
            if age > self.values["state_timeout"] and not self._stalled:
                self._stalled = True
                self._counts["stalls"] += 1
                self._release()
                limit = 1e3 * self.values["state_timeout"]
                self.get_logger().warning(f"no state for {1e3 * age:.0f} ms (limit {limit:.0f} ms): no torque")
            if age > STALLED:
                self._loop.fault(f"no state for {1e3 * age:.0f} ms; the limit is {1e3 * STALLED:.0f} ms")
        if (self._loop.phase, self._loop.reason) != self._said:
            self._say()

    def _tell_pose(self) -> None:
        """A complaint about the external pose when it changes, the last one and not more than one each TELL_PERIOD."""
        if self._poses is None:
            return
        note, now = self._pose_complaint(), time.monotonic()
        if note == self._pose_note or now - self._pose_told < TELL_PERIOD:
            return
        self._pose_note, self._pose_told = note, now
        if note:
            self.get_logger().warning(f"external pose: {note}")
        else:
            self.get_logger().info("external pose: accepted")
        self._diagnose()

    def _pose_complaint(self) -> str:
        return "" if self._poses is None else self._poses.note or self._loop.estimator.note

    def _take_trajectory(self) -> None:
        """The newest trajectory, unless it was served before this node began: a restart moves nothing.

        It is read and checked in another thread (a long one takes tenths of a second), and begins with
        the sample after that.
        """
        newest = None
        while (taken := self._trajectories.handle.take_message(MultiDOFJointTrajectory, True)) is not None:
            newest = taken
        if newest is not None:
            raw, info = newest
            age = (self._started - info["source_timestamp"]) / NANOSECONDS
            if self._checking is not None:
                self._checking.cancel()
            self._trajectory_note = "checking"
            self._checking = self._checker.submit(self._check_trajectory, bytes(raw), age)
        if self._checking is None or not self._checking.done():
            return
        checking, self._checking = self._checking, None
        try:
            checked = checking.result()
            if checked is None:
                self._trajectory_note = "stop"
                self._loop.stop("stopped by the trajectory server")
            else:
                trajectory, certificate, start = checked
                self._loop.schedule(trajectory, certificate, start)
                self._trajectory_note = "accepted"
                self.get_logger().info(f"trajectory accepted: {in_words(certificate)}")
        except DextarError as error:
            self._note_refusal(str(error))
        self._diagnose()

    def _check_trajectory(self, raw: bytes, age: float) -> tuple[Trajectory, Certificate, float | None] | None:
        """(trajectory, certificate, start) of a message's bytes; None for a stop."""
        message = read_message(raw, TRAJECTORY.type)
        if age > SERVED_BEFORE:
            raise TrajectoryError(f"it was served {age:.1f} s before this controller began; serve it again")
        if len(message.points) == 0:
            return None
        if len(message.points) > MAX_TRAJECTORY_POINTS:
            raise TrajectoryError(f"the trajectory has {len(message.points)} points; the limit is {MAX_TRAJECTORY_POINTS}")
        stamp = from_time(message.header.stamp)
        trajectory = messages.to_trajectory(message)
        return trajectory, self._loop.check(trajectory), stamp / NANOSECONDS if stamp else None

    def _note_refusal(self, reason: str) -> None:
        if reason:
            self._trajectory_note = f"refused: {reason}"
            self.get_logger().error(f"trajectory refused: {reason}")
            self._diagnose()

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            if request.data:
                self._loop.enable()
            else:
                self._loop.disable()
            response.success = (self._loop.phase not in LIMP) if request.data else self._loop.phase in LIMP
            response.message = f"phase {self._loop.phase.name} {self._loop.reason}".strip()
        except StateError as error:
            response.success, response.message = False, str(error)
        self._say()
        return response

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._loop.stop()
        response.success, response.message = True, f"phase {self._loop.phase.name}"
        if (self._loop.phase, self._loop.reason) != self._said:
            self._say()
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            self._loop.reset()
            response.success = self._loop.phase == Phase.IDLE
            response.message = f"phase {self._loop.phase.name} {self._loop.reason}".strip()
        except StateError as error:
            response.success, response.message = False, str(error)
        self._say()
        return response

    def _diagnose(self) -> None:
        loop, tick = self._loop, self._loop.tick
        bad = loop.phase in (Phase.FAULT, Phase.SAFE_STOP)
        times = np.array(self._tick_times) if self._tick_times else np.array([math.nan])
        x, y = tick.x_hat.tolist() if tick is not None else (math.nan, math.nan)
        values = {
            "phase": loop.phase.name, "reason": loop.reason, "law": self.values["law"],
            "estimator": self.values["estimator"], "trajectory": self._trajectory_note,
            "x": x, "y": y, "s": tick.s if tick else math.nan,
            "assembly_mode": tick.assembly_mode if tick else self.values["assembly_mode"],
            "mode_confidence": tick.confidence if tick else math.nan, "mode_known": loop.mode_known,
            **self._verdicts(), "completed": loop.completed, "reference_time": tick.reference_time if tick else 0.0,
            "duration": loop.certificate.duration if loop.certificate else 0.0,
            **self._counts, "saturated_ticks": loop.saturated_ticks,
            "callback_p50_us": round(1e6 * float(np.percentile(times, 50)), 1),
            "callback_p99_us": round(1e6 * float(np.percentile(times, 99)), 1),
        }  # fmt: skip
        if self._poses is not None:
            values |= {"poses": self._poses.received, "refused_poses": self._poses.refused, "pose_note": self._pose_complaint()}
        level = DiagnosticStatus.ERROR if bad else DiagnosticStatus.WARN if self._pose_complaint() else DiagnosticStatus.OK
        self.publish_diagnostics(level, loop.reason if bad else loop.phase.name, values)

    def _verdicts(self) -> dict[str, object]:
        """How many crossings are planned, have begun, and were called crossed or bounced; each one's verdict."""
        words = [WORDS[passed.verdict] for passed in self._loop.passed]
        return {
            "crossings": len(words), "begun": self._begun + 1, "crossed": words.count("crossed"),
            "bounced": words.count("bounced"), "verdicts": " ".join(words),
        }  # fmt: skip

    def close(self) -> None:
        """A last word, and zero torque in answer to the last state."""
        self._checker.shutdown(wait=False, cancel_futures=True)
        self._release()
        self._diagnose()


def main(args: list[str] | None = None) -> int:
    """Console entry."""
    return run_node(ControllerNode, args)


if __name__ == "__main__":
    sys.exit(main())
