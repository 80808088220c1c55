"""The controller node answers each joint state with one command, from the active joints
alone.
"""

from __future__ import annotations

import gc
import math
import sys
import time
from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from rclpy.executors import Executor
from rclpy.parameter import Parameter as RosParameter
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from dextar_control.contract.errors import DextarError, ParameterError, StateError
from dextar_control.contract.node_parameters import PARAMETERS
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.settings import SETTING_NAMES, Settings
from dextar_control.contract.signals import StopSignal
from dextar_control.contract.topics import JOINT_STATES, TRAJECTORY
from dextar_control.control.loop import ControlLoop
from dextar_control.control.phases import MOVING, WITHOUT_LAW, Phase, Tick
from dextar_control.control.stream import StateStream
from dextar_control.control.verdicts import OPEN_BEFORE, Passed, Verdict
from dextar_control.nodekit.cdr import NANOSECONDS, from_time
from dextar_control.nodekit.layouts import template
from dextar_control.nodekit.lifecycle import ManagedNode
from dextar_control.nodekit.node import qos, run_node
from dextar_control.nodekit.scheduling import ask_kernel, precise_timers
from dextar_control.nodes import messages
from dextar_control.nodes.controller_report import loop_values, waiting_for
from dextar_control.nodes.external_pose import ExternalPoseReader
from dextar_control.nodes.next_step import next_step
from dextar_control.nodes.outputs import Outputs
from dextar_control.nodes.progress import crossing_line, trip_line
from dextar_control.nodes.reference import ReferenceReader
from dextar_control.nodes.statistics import Statistics
from dextar_control.planning.certificate import Certificate
from dextar_control.symbols.types import Array

# s until the thread that checks a trajectory lets the control thread go on.
SWITCH_INTERVAL = 2e-4
WATCH_PERIOD = 0.01  # s
MOST_AT_ONCE = 10  # states that are answered before what else is due
# of the period after an answer, in which nothing else is begun: who reads the answer is
# often woken on this core and needs it
GIVE_WAY = 0.2
# requests: 200 a second are plenty for an operator; the longest, all parameters at
# once, costs about 1 ms
SERVED_PER_WATCH = 2
DIAGNOSTICS_PERIOD = 0.2  # s
TELL_PERIOD = 1.0  # s between two lines about the external pose
R = TypeVar("R", SetBool.Response, Trigger.Response)
LATCHED = (Phase.SAFE_STOP, Phase.FAULT)  # left by ~/reset only


class ControllerNode(ManagedNode):
    """Answers each joint state with a torque and tells what it did.

    It is a managed node: ``configure`` builds everything from the parameters,
    ``activate`` begins to answer states. Torque needs healthy states
    (``joint_states.healthy_time``) and nobody else who commands; ``enabled`` asks for
    it once, by itself. A gap of more than ``joint_states.timeout`` between the stamps
    of two states is a fault (no torque until ``~/reset`` and ``~/enable``); while no
    state comes nothing is commanded at all, and the drive's own time-out takes the
    torque away.
    """

    NAME = "controller"
    PARAMETERS = PARAMETERS[NAME]

    def __init__(self) -> None:
        super().__init__()
        _check_mode(self.values)
        self._loop: ControlLoop | None = None
        self._active = False
        self._closers: list[Callable[[], object]] = []
        self._statistics = Statistics()
        self._stream = StateStream()
        self._automatic = False
        self._enabling = "off"
        self._side_unknown = False
        self._latched: tuple[str, int] = ("", 0)
        self._other_commanders = self._second_publishers = ""
        self._stamp = -1
        self._published = 0
        self._stalled = False
        self._refusal = ""
        self._logged_phase: tuple[Phase, str] = (Phase.IDLE, "")
        self._passed: list[Passed] = []
        self._begun = -1
        self._logged_crossings: list[Passed] = []
        self._verdicts: list[Verdict] = []
        self._completed = 0
        self._tracked: Certificate | None = None
        # Motions that have begun: the phases in five diagnostics a second miss one
        # that ends sooner.
        self._motions = 0
        self._largest_error = 0.0
        self._pose_note = ""
        self._pose_told = -math.inf
        self._states: Subscription | None = None
        self._state_topic = self.resolve_topic_name(JOINT_STATES.name)
        self.create_service(SetBool, "~/enable", self._on_enable)
        self.create_service(Trigger, "~/stop", self._on_stop)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self._watched = self._diagnosed = 0.0
        self._situation: tuple[bytes, str, dict[str, object]] | None = None
        sys.setswitchinterval(SWITCH_INTERVAL)
        if self.values["autostart"]:
            if not (
                self.change_state(Transition.TRANSITION_CONFIGURE)
                and self.change_state(Transition.TRANSITION_ACTIVATE)
            ):
                raise self.transition_error or ParameterError(
                    "the controller could not be activated"
                )
        gc.collect()
        gc.freeze()

    def configure(self) -> None:
        """Build the loop, which checks the parameters, then publishers and
        subscriptions.
        """
        values = self.values
        loop = self._make_loop()
        self._period = values["task.sample_period"]
        self._lockstep = values["lockstep"]
        self._states_in = template(JOINT_STATES)
        self._outputs = Outputs(
            self,
            array=values["publish.effort_array"],
            readable=values["publish.readable"],
        )
        self._closers.append(self._outputs.close)
        self._reference = ReferenceReader(self)
        self._closers.append(self._reference.close)
        self._poses = ExternalPoseReader(self) if loop.estimator.takes_poses else None
        if self._poses is not None:
            self._closers.append(self._poses.close)
        profile = qos(JOINT_STATES, reliable=self._lockstep)
        self._states = self.create_polled_subscription(
            JointState, JOINT_STATES.name, profile, raw=True
        )
        self._closers.append(self._close_states)
        # After a fault somebody has to ask.
        self._automatic = values["enabled"] and not self._latched[0]
        self._enabling = "waiting" if self._automatic else "off"
        self._loop = loop
        self.get_logger().info(f"law {values['law']}, estimator {values['estimator']}")

    def activate(self) -> None:
        """Begin to answer states, with a loop that knows none; a fault that was latched
        before still is.

        Raises:
            StateError: the controller was deactivated where it did not know the robot's
                assembly mode.
        """
        if self._side_unknown:
            raise StateError(
                "the robot was let go near the locus: set assembly_mode to the side"
                " where it stands, then activate"
            )
        self._loop = self._make_loop()
        self._reference.restart()
        self._stream = StateStream()
        self._statistics.restart()
        self._outputs.forget()
        self._stamp, self._stalled, self._refusal = -1, False, ""
        self._passed, self._begun = self._loop.passed, -1
        if self._latched[0]:
            self._loop.fault(self._latched[0])
        elif self._automatic and self.values["joint_states.healthy_time"] == 0.0:
            self._enable_itself()
        self._logged_phase = (self._loop.phase, self._loop.reason)
        self._active = True
        self.get_logger().info(f"waiting for {self._state_topic}")

    def deactivate(self) -> None:
        """Take the torque away at once, and keep the believed assembly mode in the
        parameter ``assembly_mode``.
        """
        self._active = False
        if self._loop is None:
            return
        self._outputs.release()
        self._reference.drop()
        self._enabling = "off"
        self._automatic = False
        loop, tick = self._loop, self._loop.tick
        loop.disable()
        if tick is not None and loop.mode_known:
            self.set_parameters(
                [RosParameter("assembly_mode", value=tick.assembly_mode)]
            )
        self._side_unknown = tick is not None and not loop.mode_known

    def cleanup(self) -> None:
        """Drop the loop and everything on the network but services and diagnostics; a
        latched fault still is.
        """
        self._loop, self._other_commanders, self._second_publishers = None, "", ""
        while self._closers:
            self._closers.pop()()

    def _close_states(self) -> None:
        assert self._states is not None
        self.destroy_subscription(self._states)
        self._states = None

    def on_transition(self) -> None:
        """Publish diagnostics at once."""
        self._diagnose()

    def _make_loop(self) -> ControlLoop:
        _check_mode(self.values)
        return ControlLoop(
            self.robot,
            Settings.from_values(self.values),
            self.values["assembly_mode"],
            enabled=False,
        )

    def on_parameters(self, changes: Mapping[str, ParameterValue]) -> None:
        """Use live gains and limits and, without torque, the assembly mode; what is not
        live waits for ``configure``.
        """
        if "assembly_mode" in changes:
            _check_mode(changes)
        if self._loop is not None and not changes.keys().isdisjoint(SETTING_NAMES):
            before = self._loop.settings
            self._loop.configure(Settings.from_values(self.values))
            try:
                self._tell_mode(changes)
            except StateError:  # all of the changes are refused together
                self._loop.configure(before)
                raise
        else:
            self._tell_mode(changes)

    def _tell_mode(self, changes: Mapping[str, ParameterValue]) -> None:
        if "assembly_mode" in changes:
            if self._loop is not None:
                self._loop.set_assembly_mode(changes["assembly_mode"])
            self._side_unknown = False

    def _now(self) -> float | None:
        """Return the steady clock's time, s; None in lockstep, where states may come at
        any pace.
        """
        return None if self._lockstep else time.perf_counter()

    def turn(self, executor: Executor) -> None:
        """Answer the states that have come or come soon, then do one part of what is
        due besides.

        No executor serves the states: its callbacks, and timers that fire when the next
        state comes, would make its answer late.
        """
        left = max(0.0, self._watched + WATCH_PERIOD - time.perf_counter())
        answered = False
        if self._states is None:
            executor.spin_once(timeout_sec=left)
        else:
            answered = self._answer_within(self._states, left)
        now = time.perf_counter()
        diagnosing = now - self._diagnosed >= DIAGNOSTICS_PERIOD
        watching = now - self._watched >= WATCH_PERIOD
        if not (self._situation is not None or diagnosing or watching):
            return
        if answered and not self._lockstep and self._states is not None:
            self._answer_within(self._states, GIVE_WAY * self._period)
        if self._situation is not None:
            self.publish_diagnostics(*self._situation)
            self._situation = None
            executor.spin_once(timeout_sec=0.0)
        elif diagnosing:
            self._diagnosed = now
            self._situation = self._situation_now()
        elif watching:
            self._watched = now
            self._watch()

    def _answer_within(self, states: Subscription, seconds: float) -> bool:
        """Answer the states that have come, or come within this time, s; whether there
        was one.
        """
        self.wait_for(states, seconds)
        take = states.handle.take_message
        for taken_before in range(MOST_AT_ONCE):
            if (taken := take(JointState, True)) is None:
                return taken_before > 0
            self._receive(*taken)
        return True

    def _receive(self, raw: bytes, info: Mapping[str, int]) -> None:
        """Take a state with what the middleware tells of it: its publisher's number,
        and when it was sent.
        """
        self._stream.hear(info.get("publication_sequence_number"), time.perf_counter())
        self._published = info.get("source_timestamp", 0)
        self._on_state(raw)

    def _on_state(self, raw: bytes) -> None:
        loop = self._loop
        if loop is None or not self._active:
            return
        begin = time.perf_counter()
        try:
            stamp, q_a = self._read_state(raw)
            if stamp == self._stamp and self._outputs.can_repeat:
                self._repeat(stamp)
                return
            limit = self.values["joint_states.timeout"]
            arrival = None if self._lockstep else begin
            gap = (stamp - self._stamp) / NANOSECONDS if self._stamp >= 0 else 0.0
            if gap > limit and loop.phase not in (Phase.IDLE, Phase.FAULT):
                loop.fault(
                    f"no state for {1e3 * gap:.1f} ms; the limit is"
                    f" {1e3 * limit:.1f} ms"
                )
            self._stream.take(stamp, limit, arrival)
            if (
                self._automatic
                and self._stream.healthy_for(limit, arrival)
                >= self.values["joint_states.healthy_time"]
            ):
                self._enable_itself()
            pose = None if self._poses is None else self._poses.take()
            tau = loop.step(stamp / NANOSECONDS, q_a, pose)
        except DextarError as error:
            self._refuse(loop, error)
            return
        self._outputs.command(stamp, tau.tolist())
        assert loop.tick is not None
        self._note_error(loop)
        self._outputs.tell(stamp, loop.tick, self._verdict(loop, loop.tick))
        if self._stamp >= 0:
            self._statistics.spaced(gap, self._period)
        self._stamp = stamp
        self._stalled = False
        if (loop.phase, loop.reason) != self._logged_phase:
            self._log_phase(answered=True)
        self._statistics.arrived(stamp, begin, self._published)
        self._statistics.worked(time.perf_counter() - begin)
        if loop.refusal != self._refusal:
            self._refusal = loop.refusal
            if self._refusal:
                self._reference.refuse(self._refusal)
                self._diagnose()

    def _read_state(self, raw: bytes) -> tuple[int, Array]:
        """Return stamp, ns, and active joints, (2,), rad, of a joint state."""
        known = self._states_in.unpack(raw)
        if known is not None:
            return known[0], np.array(known[1][0:2])
        message = deserialize_message(raw, JointState)
        q_a = messages.active_joints(message)
        if list(message.name) == ["q11", "q21"]:
            self._states_in.learn(raw)
        return from_time(message.header.stamp), q_a

    def _repeat(self, stamp: int) -> None:
        """Answer a state that came before; in lockstep a rig asks so for an answer that
        it did not get.
        """
        self._statistics.counts["repeated_states"] += 1
        if not self._lockstep:
            self._stream.spoil(f"the state of {stamp} ns was repeated")
        self._outputs.repeat()

    def _verdict(self, loop: ControlLoop, tick: Tick) -> float:
        """Return the verdict on the planned crossing that began last, which stays when
        the controller has let go.
        """
        passed = loop.passed
        if passed is not self._passed:
            self._passed, self._begun = passed, -1
        begun = tick.reference_time + OPEN_BEFORE
        while (
            self._begun + 1 < len(passed)
            and passed[self._begun + 1].planned_time <= begun
        ):
            self._begun += 1
        return float(passed[self._begun].verdict) if self._begun >= 0 else 0.0

    def _note_error(self, loop: ControlLoop) -> None:
        """Keep the largest distance between reference and estimate while a trajectory
        is tracked.
        """
        if loop.phase in MOVING:
            if loop.certificate is not self._tracked:
                self._tracked, self._largest_error = loop.certificate, 0.0
                self._motions += 1
            self._largest_error = max(self._largest_error, loop.supervisor.error)

    def _refuse(self, loop: ControlLoop, error: DextarError) -> None:
        """Command no torque for a state that cannot be used; a broken first state or a
        bad number is a fault.
        """
        self._statistics.counts["refused_states"] += 1
        self._look_at_publishers()
        reason = "; ".join(filter(None, (str(error), self._second_publishers)))
        self._stream.spoil(reason)
        if loop.phase not in (Phase.IDLE, Phase.FAULT) and isinstance(
            error, StateError
        ):
            loop.fault(reason)
        else:
            self.get_logger().error(reason, throttle_duration_sec=1.0)
        self._log_phase()

    def _log_phase(self, *, answered: bool = False) -> None:
        """Tell a change of phase, if there is one; one that no state has answered yet
        takes the torque away at once.
        """
        loop = self._loop
        if loop is None or (loop.phase, loop.reason) == self._logged_phase:
            return
        if loop.phase in LATCHED and self._logged_phase[0] is not loop.phase:
            late = second = ""
            # Late commands may be why a watch tripped: they are told before it.
            if loop.phase is Phase.SAFE_STOP and loop.tripped and not self._lockstep:
                late = self._statistics.lateness(self._period)
            # So may be a second rig, which is told after it.
            if self._states_are_mixed and self._second_publishers not in loop.reason:
                second = self._second_publishers
            loop.reason = "; ".join(filter(None, (late, loop.reason, second)))
        before, self._logged_phase = self._logged_phase, (loop.phase, loop.reason)
        if not answered and loop.phase in WITHOUT_LAW:
            self._outputs.release()
        if loop.phase in LATCHED:
            since = self._latched[1]
            if before[0] is not loop.phase:
                since = self.unstepped_clock.now()
            self._latched = loop.reason, since
            self._reference.drop()
            self.get_logger().error(
                f"{loop.phase.name}: {loop.reason}; {self._next_step()}"
            )
        else:
            self._latched = ("", 0)
            self.get_logger().info(f"phase {loop.phase.name}")
        self._diagnose()

    def _watch(self) -> None:
        """Serve some requests, and look for new trajectories, a stalled stream and
        other commanders, every WATCH_PERIOD.
        """
        self.polled_services.poll(SERVED_PER_WATCH)
        loop = self._loop
        if loop is None:
            return
        self._other_commanders = self._outputs.others()
        self._outputs.look()
        self._look_at_publishers()
        if not self._active:
            return
        now = self._stamp / NANOSECONDS if self._stamp >= 0 else math.nan
        keep = self._automatic and loop.phase is Phase.IDLE
        if self._reference.poll(
            loop, self.values, now if self._lockstep else time.perf_counter(), now, keep
        ):
            self._diagnose()
        self._tell_pose()
        if loop.phase in (Phase.IDLE, Phase.FAULT):
            return
        if conflict := self._conflict:
            loop.fault(conflict)
        self._watch_stall(loop)
        self._log_phase()

    def _look_at_publishers(self) -> None:
        self._second_publishers = self.too_many_publishers(self._state_topic)

    @property
    def _states_are_mixed(self) -> bool:
        """Whether a second publisher of joint states sent one lately; a silent one does
        no harm.
        """
        return bool(self._second_publishers) and self._stream.mixed(time.perf_counter())

    @property
    def _conflict(self) -> str:
        """Who else commands, or sends states; empty where nobody does."""
        mixed = self._second_publishers if self._states_are_mixed else ""
        return self._other_commanders or mixed

    def _next_step(self) -> str:
        """Return what to call for a robot that is held."""
        phase = self._loop.phase.name if self._loop is not None else ""
        return next_step(
            self.get_fully_qualified_name(), self.lifecycle, phase, self._enabling
        )

    def _watch_stall(self, loop: ControlLoop) -> None:
        """Take the torque away when no state comes by the steady clock, and after a
        while begin a fault.
        """
        age = time.perf_counter() - self._statistics.arrival
        if math.isnan(age) or self._lockstep:
            return
        names = "joint_states.timeout", "joint_states.stall_timeout"
        limit, fatal = (self.values[name] for name in names)
        if age > limit and not self._stalled:
            self._stalled = True
            self._statistics.counts["stalls"] += 1
            self._outputs.release()
            self.get_logger().warning(
                f"no state for {1e3 * age:.0f} ms (limit {1e3 * limit:.0f} ms): no"
                " torque"
            )
        if age > fatal:
            loop.fault(
                f"no state for {1e3 * age:.0f} ms; the limit is {1e3 * fatal:.0f} ms"
            )

    def _tell_pose(self) -> None:
        """Log a complaint about the external pose when it changes, at most one each
        TELL_PERIOD.
        """
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
        if self._loop is None or self._poses is None:
            return ""
        return self._poses.note or self._loop.estimator.note

    def _check_ready(self) -> None:
        """Raise StateError where torque may not be asked for: somebody else commands,
        or the states are not healthy.
        """
        if not self._active:
            raise StateError(f"the controller is {self.lifecycle}; {self._next_step()}")
        if conflict := self._conflict:
            raise StateError(conflict)
        self._stream.check(
            self.values["joint_states.healthy_time"],
            self.values["joint_states.timeout"],
            self._now(),
        )

    def _enable_itself(self) -> None:
        """Enable once, when the states have become healthy; the trajectory that was
        kept begins with this state.
        """
        assert self._loop is not None
        self._automatic = False
        try:
            self._look_at_publishers()
            if conflict := self._conflict:
                raise StateError(conflict)
            self._enable(self._loop)
        except StateError as error:
            self._enabling = f"refused: {error}"
            self.get_logger().error(f"not enabled: {error}; then {self._next_step()}")
            if self._reference.waiting is not None:
                self._reference.refuse(f"the controller was not enabled: {error}")
            self._diagnose()
        else:
            self._enabling = "done"

    def _enable(self, loop: ControlLoop) -> None:
        """Begin to hold, or begin the trajectory that was kept for this."""
        loop.enable()
        self._automatic = False
        self._reference.begin(loop)

    def _on_enable(
        self, request: SetBool.Request, response: SetBool.Response
    ) -> SetBool.Response:
        loop = self._loop
        try:
            if request.data:
                self._check_ready()
                assert loop is not None
                self._enable(loop)
                self._enabling = "done"
            else:
                self._automatic, self._enabling = False, "off"
                if loop is not None:
                    self._reference.drop()
                    loop.disable()
        except StateError as error:
            return self._answer(response, False, str(error))
        wanted = loop is None or (loop.phase in WITHOUT_LAW) != request.data
        return self._answer(response, wanted)

    def _on_stop(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        if self._loop is not None:
            self._reference.drop()
            self._loop.stop()
        return self._answer(response, True)

    def _on_reset(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Clear what was latched before this call, and only while its cause is gone."""
        loop = self._loop
        try:
            if loop is not None and loop.phase in LATCHED:
                if self.polled_services.received < self._latched[1]:
                    raise StateError(
                        f"{loop.phase.name} was latched after this call: {loop.reason};"
                        " call again to clear it"
                    )
                self._check_ready()
                loop.reset()
        except StateError as error:
            return self._answer(response, False, str(error))
        if (
            loop is not None
            and self._active
            and loop.phase not in (Phase.IDLE, *LATCHED)
        ):
            return self._answer(
                response, False, f"phase {loop.phase.name}: there is nothing to reset"
            )
        return self._answer(response, loop is not None and loop.phase is Phase.IDLE)

    def _answer(self, response: R, success: bool, message: str = "") -> R:
        """Return a service's response, once the change of phase is told."""
        loop, state = self._loop, self.lifecycle
        if loop is not None and self._active:
            self._log_phase()
            state = f"phase {loop.phase.name} {loop.reason}".strip()
        if not success and (step := self._next_step()):
            state = f"{state}; {step}"
        response.success, response.message = success, message or state
        return response

    def _diagnose(self) -> None:
        """Publish diagnostics at once."""
        self._situation = None
        self.publish_diagnostics(*self._situation_now())

    def _situation_now(self) -> tuple[bytes, str, dict[str, object]]:
        """Return level, message and values for ``/diagnostics``."""
        values: dict[str, object] = {"lifecycle": self.lifecycle}
        values |= {name: self.values[name] for name in ("law", "estimator")}
        loop = self._loop
        if loop is None:
            values |= {"phase": "", "reason": ""}
            return DiagnosticStatus.OK, self.lifecycle, values
        self._tell_crossings(loop)
        limit = self.values["joint_states.timeout"]
        values |= {
            "phase": loop.phase.name if self._active else "",
            "reason": loop.reason,
            "enabling": self._enabling,
            "healthy": round(self._stream.healthy_for(limit, self._now()), 3),
            "last_trouble": self._stream.trouble,
            "trajectory": self._reference.note,
            "trajectories": self._reference.arrived,
            "motions": self._motions,
            "waiting_for": waiting_for(self._reference),
            **loop_values(loop, self._begun + 1, self._largest_error),
            "other_commanders": self._other_commanders,
            "state_publishers": self._second_publishers,
            "next_step": self._next_step(),
            "requests": self.polled_services.served,
        }
        if self._poses is not None:
            values |= {
                "poses": self._poses.received,
                "refused_poses": self._poses.refused,
                "pose_note": self._pose_complaint(),
            }
        warnings = self._warnings(limit)
        values |= self._statistics.report(loop.saturated_ticks)
        if self._active and loop.phase in LATCHED:
            return DiagnosticStatus.ERROR, loop.reason, values
        if warnings:
            return DiagnosticStatus.WARN, "; ".join(warnings), values
        return (
            DiagnosticStatus.OK,
            loop.phase.name if self._active else self.lifecycle,
            values,
        )

    def _tell_crossings(self, loop: ControlLoop) -> None:
        """Log each verdict on a planned crossing once, and how a trajectory ended."""
        passed, log = loop.passed, self.get_logger().info
        if passed is not self._logged_crossings:
            self._logged_crossings = passed
            self._verdicts = [Verdict.UNDECIDED] * len(passed)
        for index, crossing in enumerate(passed):
            if crossing.verdict is not self._verdicts[index]:
                self._verdicts[index] = crossing.verdict
                confidence = f"{crossing.confidence:.3f}"
                verdict = crossing.verdict.name
                log(crossing_line(index, len(passed), verdict, confidence))
        if loop.completed != self._completed:
            self._completed = loop.completed
            if loop.completed:
                crossed = self._verdicts.count(Verdict.CROSSED)
                log(f"done: {trip_line(crossed, len(passed), self._largest_error)}")

    def _warnings(self, limit: float) -> list[str]:
        """Return what an operator should look at."""
        second = self._second_publishers
        if second and not self._states_are_mixed:
            second = f"{second}; one speaks"
        told = [
            self._other_commanders,
            second,
            # The newest trajectory counts, whoever serves it.
            self.too_many_publishers(self.resolve_topic_name(TRAJECTORY.name)),
            self._pose_complaint(),
        ]
        if self._active and not self._lockstep:
            age = time.perf_counter() - self._statistics.arrival
            told += (
                [f"no state for {age:.1f} s"]
                if age > limit
                else self._statistics.warnings(self._period)
            )
        elif self._active:
            told += self._statistics.missed_lately()
        if self._enabling.startswith("refused"):
            told.append(f"enabling was {self._enabling}")
        return [text for text in told if text]

    def close(self) -> None:
        """Publish diagnostics, and zero torque in answer to the last state."""
        if self._loop is not None:
            self._reference.drop()
            if self._active:
                self._outputs.release()
        self._diagnose()


def _check_mode(values: Mapping[str, ParameterValue]) -> None:
    if values["assembly_mode"] == 0:
        raise ParameterError("parameter 'assembly_mode' = 0; it must be +1 or -1")


def spin(node: ControllerNode, executor: Executor, stop: StopSignal) -> None:
    """Turn the node until a signal."""
    precise_timers()
    ask_kernel(node.values, node.get_logger().warning)
    while not stop and not node.finished:
        node.turn(executor)


def main(args: list[str] | None = None) -> int:
    """Run the controller; return the exit code."""
    return run_node(ControllerNode, args, spin)


if __name__ == "__main__":
    sys.exit(main())
