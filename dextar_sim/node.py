"""The plant node: like a rig it takes motor commands and publishes joint states.

One sample is a state k at stamp k, published; the command that answers it; and the
physics from k to k+1 under it. In lockstep the command is waited for. In real time the
state goes out at its deadline on the steady clock, and a command that is not there in
time is replaced by the held one.

Whoever stands between rig and commander in lockstep can say that a state gets no
command: a JointState with its stamp and without joints is a bare acknowledgement. The
drives then go on under the command they hold, whose age counts, so that their time-out
acts in simulated time. A command that answers an earlier state is taken as in real time
(the newest stamp wins) and does not let time go on.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.executors import Executor
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from dextar_control.contract.errors import ParameterError, StateError
from dextar_control.contract.node_parameters import PARAMETERS
from dextar_control.contract.signals import StopSignal
from dextar_control.contract.topics import (
    CLOCK,
    EFFORT_COMMANDS,
    EXTERNAL_POSE,
    JOINT_COMMANDS,
    JOINT_STATES,
    ROBOT_DESCRIPTION,
    SIM_END_EFFECTOR,
    SIM_JOINT_STATES,
)
from dextar_control.nodekit.cdr import NANOSECONDS
from dextar_control.nodekit.node import DextarNode, qos, run_node
from dextar_control.nodekit.scheduling import ask_kernel, precise_timers
from dextar_control.symbols.types import Array
from dextar_sim.commanders import SPEAKING, CommanderArbiter
from dextar_sim.messages import CommandReader, StateWriter, read_efforts
from dextar_sim.pace import SERVED_EACH, Schedule, keeping_pace
from dextar_sim.sensors import (
    Acknowledgement,
    CommandDelay,
    CommandHold,
    Encoder,
    PoseSensor,
    StampError,
    TorqueCommand,
)

REPEAT_AFTER = 0.5  # s without an answer after which lockstep publishes a state again


COMMANDER_PERIOD = 0.1  # s between two looks at who publishes commands
IDLE_WAIT = 0.05  # s for which a paused plant waits for a service call at a time
# s by which a sample may be out before its deadline: no sleep is as short.
EARLY = 2.0e-5
SERVED_AT_ONCE = 4  # timers and services, where the loop does not sleep


class Reported(NamedTuple):
    """The counters at a report, from which the next report counts."""

    ran: int  # ns, steady, without the pauses
    steps: int
    late: int
    refused: int


class PlantNode(DextarNode):
    """Simulates a five-bar with the topics of a real one, and publishes the truth under
    ``sim/``.

    Attributes:
        lockstep: each step waits for its command.
        paced: samples are due at the steady clock's times; always without lockstep.
        answered: the command for the published state is here.

    Raises:
        ParameterError: a parameter is out of its range, or a window is wanted without a
            display.
        GeometryError: the start lies outside the workspace.
    """

    NAME = "plant"
    PARAMETERS = PARAMETERS[NAME]

    def __init__(self, *, cli_args: list[str] | None = None) -> None:
        # imported here, since --help needs no physics
        from dextar_sim.disturbances import Disturbances
        from dextar_sim.effects import Effects
        from dextar_sim.plant import Plant, urdf_of

        super().__init__(cli_args=cli_args)
        values = self.values
        period = values["task.sample_period"]
        self.period_ns: int = round(period * NANOSECONDS)
        self.lockstep = values["mode"] == "lockstep"
        pace = values["simulation.real_time_factor"] if self.lockstep else 1.0
        self.paced = pace > 0.0
        self._arrays = values["command_interface"] == "effort_array"
        if self._arrays and self.lockstep:
            raise ParameterError(
                "parameter 'command_interface' = 'effort_array'; in mode lockstep it"
                " must be joint_state: an array does not say which state it answers"
            )
        max_torque = values["drive.max_torque"] or self.robot.max_torque
        effects = Effects(
            friction=values["mechanics.friction"],
            encoder_at=values["encoder.side"],
            backlash=values["mechanics.backlash"],
            cogging=values["drive.cogging"],
            cogging_periods=values["drive.cogging_periods"],
            drive_lag=values["drive.lag"],
            torque_step=values["drive.torque_step"],
        )
        self.plant = Plant(
            self.robot,
            period=period,
            substeps=values["simulation.substeps"],
            window=values["window"],
            max_torque=max_torque,
            effects=effects,
        )
        self.plant.reset(values["task.start"])
        self._encoder = Encoder(
            period,
            resolution=values["encoder.resolution"],
            seed=values["seed"],
            velocity_cutoff=values["encoder.velocity_cutoff"],
            position_noise=values["encoder.noise"],
            offset=self.robot.encoder_offset,
            homing_error=values["encoder.homing_error"],
            eccentricity=values["encoder.eccentricity"],
        )
        self._stamp_error = StampError(
            values["encoder.stamp_error"], period, values["seed"]
        )
        self._disturbances = Disturbances(
            payload=values["payload.mass"],
            payload_time=values["payload.time"],
            push=values["push.force"],
            push_time=values["push.time"],
            push_duration=values["push.duration"],
        )
        self._camera = PoseSensor(
            period,
            rate=values["external_pose.rate"],
            delay=values["external_pose.delay"],
            noise=values["external_pose.noise"],
            seed=values["seed"],
        )
        self._delay: CommandDelay[TorqueCommand] = CommandDelay(
            round(values["drive.command_delay"] / period)
        )
        self._command_timeout = round(values["drive.command_timeout"] * NANOSECONDS)
        self._hold = CommandHold(self._command_timeout, max_torque)
        self.schedule = Schedule(
            round(self.period_ns / pace) if self.paced else self.period_ns
        )
        self._writer, self._reader = StateWriter(), CommandReader()
        self._index = -1
        self._since = 0
        self._first_stamp = 0
        self._told = 0
        self._published = -1
        self._oldest = 0
        self._newest: TorqueCommand | None = None
        self._sample: list[tuple[Publisher, bytes]] | None = None
        self._sent: list[tuple[Publisher, bytes]] = []
        self._pose: bytes | None = None
        self._sent_at = self._published_at = 0.0
        self.answered = False
        self._commanded = False
        self._budget: int | None = 0 if values["simulation.start_paused"] else None
        self.counts = dict.fromkeys(
            (
                "commands_received",
                "commands_refused",
                "late_ticks",
                "late_commands",
                "repeated_states",
                "acknowledgements",
            ),
            0,
        )
        self._max_loop_gap = 0.0
        self._reported = Reported(0, 0, 0, 0)
        self._warned_at = -1.0
        self._states = self.create_publisher(
            JointState, JOINT_STATES.name, qos(JOINT_STATES)
        )
        self._true_platform = self.create_publisher(
            Odometry, SIM_END_EFFECTOR.name, qos(SIM_END_EFFECTOR)
        )
        self._true_joints = self.create_publisher(
            JointState, SIM_JOINT_STATES.name, qos(SIM_JOINT_STATES)
        )
        self._poses = (
            self.create_publisher(PoseStamped, EXTERNAL_POSE.name, qos(EXTERNAL_POSE))
            if values["external_pose.rate"]
            else None
        )
        self._description = self.create_publisher(
            String, ROBOT_DESCRIPTION.name, qos(ROBOT_DESCRIPTION)
        )
        self._description.publish(String(data=urdf_of(self.robot)))
        rate = values["simulation.clock_rate"] if self.lockstep else 0.0
        self._time = (
            self.create_publisher(Clock, CLOCK.name, qos(CLOCK)) if rate else None
        )
        self._told_each = max(1, round(1.0 / (rate * period))) if rate else 0
        topic, kind = (
            (EFFORT_COMMANDS, Float64MultiArray)
            if self._arrays
            else (JOINT_COMMANDS, JointState)
        )
        self._command_name = topic.name
        profile = qos(topic, reliable=self.lockstep)
        self._commands = self.create_polled_subscription(
            kind, topic.name, profile, raw=True
        )
        self._command_type = kind
        self._arbiter = CommanderArbiter(
            lambda: int(self.count_publishers(self._commands.topic_name)),
            lossless=self.lockstep,
        )
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, "~/step", self._on_step)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_timer(1.0, self.report, clock=self.steady_clock)
        self.create_timer(
            COMMANDER_PERIOD, self._count_commanders, clock=self.steady_clock
        )
        # A process's first log line costs tens of ms: not in the middle of a run.
        told = (
            "as fast as possible"
            if not self.paced
            else f"at {pace:g} x real time"
            if self.lockstep
            else ""
        )
        self.get_logger().info(
            ", ".join(
                filter(
                    None,
                    (self.robot.name, values["mode"], told, f"{1.0 / period:g} Hz"),
                )
            )
        )

    @property
    def paused(self) -> bool:
        """Whether no sample is due, neither running nor stepping."""
        return self._budget == 0

    @property
    def sample_ready(self) -> bool:
        """Whether the next state is computed and not yet published."""
        return self._sample is not None

    @property
    def awaited(self) -> bool:
        """Whether somebody commands, and has not answered the published state yet."""
        newest = self._newest
        return (
            not self.answered
            and newest is not None
            and self._published - newest.stamp <= self._command_timeout
        )

    def begin(self) -> None:
        """Prepare the first state: its stamp is 0 in lockstep, the system clock's time
        in real time.
        """
        if self._index < 0:
            self._first_stamp = 0 if self.lockstep else time.time_ns()
            self._index = 0
            self._prepare(np.zeros(2))

    def advance(self) -> None:
        """Simulate one period under the command that the drives hold, and prepare the
        state after it.
        """
        if not self._commanded and self._newest is not None:
            self.counts["late_ticks"] += 1
        delayed = self._delay.shift(self._newest)
        if delayed is not None:
            later = self._delay.periods * self.period_ns
            arrival = None if delayed.arrival is None else delayed.arrival + later
            self._hold.receive(
                delayed._replace(stamp=delayed.stamp + later, arrival=arrival)
            )
        self._disturbances.before(
            (self._index - self._since) * self.plant.period, self.plant
        )
        applied = self.plant.step(self._hold.torque(self._stamp(), self._ran()))
        self._index += 1
        self._prepare(applied)

    def _ran(self) -> int | None:
        """Return the drives' steady clock, ns, which a pause stops; None in lockstep,
        where simulated time alone counts.
        """
        return None if self.lockstep else self.schedule.ran(time.monotonic_ns())

    def _stamp(self) -> int:
        return self._first_stamp + self._index * self.period_ns

    def _prepare(self, applied: Array) -> None:
        state = self.plant.state()
        self._told = stamp = max(
            self._stamp() + round(NANOSECONDS * self._stamp_error.next()), 0
        )
        self._max_loop_gap = max(self._max_loop_gap, state.loop_gap)
        q_a, q_a_dot = self._encoder.read(self.plant.encoder_angles())
        self._sample = [
            (self._states, self._writer.measured(stamp, q_a, q_a_dot, applied))
        ]
        if self._poses is not None:
            seen = self._camera.sense(self._index, state.x.tolist())
            self._pose = seen and self._writer.external_pose(
                self._first_stamp + seen.sample * self.period_ns, seen.x
            )
        if self.values["publish.truth"]:
            self._sample.append(
                (self._true_platform, self._writer.true_end_effector(stamp, state))
            )
            self._sample.append(
                (self._true_joints, self._writer.true_joints(stamp, state, applied))
            )

    def publish(self) -> None:
        """Send the prepared state on all topics in one burst, and before it the
        external pose that arrives then.
        """
        if self._sample is None:
            return
        self._sent, self._sample = self._sample, None
        self._published = self._told
        self.answered = self._commanded = False
        self._sent_at = self._published_at = time.monotonic()
        if self._poses is not None and self._pose is not None:
            self._poses.publish(self._pose)
        for publisher, raw in self._sent:
            publisher.publish(raw)
        if self._time is not None and self._index % self._told_each == 0:
            self._time.publish(self._writer.clock(self._stamp()))
        if self._budget:
            self._budget -= 1

    def repeat_unanswered(self) -> None:
        """Publish the last state again when its answer has been missing for too
        long.
        """
        if time.monotonic() - self._sent_at < REPEAT_AFTER:
            return
        if self.counts["commands_received"]:
            self.counts["repeated_states"] += 1
        self._sent_at = time.monotonic()
        for publisher, raw in self._sent:
            publisher.publish(raw)

    def listen(self) -> None:
        """Take the commands that have come; this costs about 1 us when there is
        none.
        """
        take = self._commands.handle.take_message
        while (taken := take(self._command_type, True)) is not None:
            self._on_command(*taken)

    def wait(self, seconds: float) -> None:
        """Sleep until a command comes, at most for so long, s."""
        self.wait_for(self._commands, seconds)

    def _on_command(self, raw: bytes, info: Mapping[str, int]) -> None:
        try:
            if not self._arbiter.take(
                info.get("publication_sequence_number"),
                self._index,
                time.monotonic_ns(),
            ):
                self._let_go()
                raise StateError(f"{self._complaint()}: no torque")
            command = self._read_command(raw)
        except StateError as error:
            self.counts["commands_refused"] += 1
            if time.monotonic() - self._warned_at >= 1.0:
                self._warned_at = time.monotonic()
                self.get_logger().warning(str(error))
            return
        answers = command.stamp == self._published
        if isinstance(command, Acknowledgement):
            self.counts["acknowledgements"] += 1
            self.answered = self.answered or answers
            return
        self.counts["commands_received"] += 1
        if not answers or self.sample_ready:
            self.counts["late_commands"] += 1
        if command.stamp < self._oldest or (
            self.lockstep and answers and self.answered
        ):
            return
        if self._newest is None or command.stamp >= self._newest.stamp:
            self._newest = command._replace(arrival=self._ran())
        self.answered = self.answered or answers
        self._commanded = self._commanded or answers

    def _read_command(self, raw: bytes) -> TorqueCommand | Acknowledgement:
        """Return a command, or in lockstep an acknowledgement, whose stamp is that of a
        published state.

        In real time a stamp of the sender's own clock counts as an answer to the state
        last published, as does an array, which has none: neither can be told from a
        late one.
        """
        command: TorqueCommand | Acknowledgement
        if self._arrays:
            command = TorqueCommand(max(self._published, 0), read_efforts(raw))
        else:
            command = self._reader.read(raw, lockstep=self.lockstep)
        if command.stamp <= self._published:
            return command
        now = (
            self._published if self.lockstep or self._published < 0 else time.time_ns()
        )
        if command.stamp > now:
            clock = "" if self.lockstep else f" and the system clock at {now} ns"
            raise StateError(
                f"{self._command_name}: stamp {command.stamp} ns answers no state yet"
                f" published; the last one is {self._published} ns{clock}"
            )
        return command._replace(stamp=self._published)

    def _count_commanders(self) -> None:
        now = time.monotonic_ns()
        self._arbiter.count_publishers(now)
        if not self._arbiter.accepts(now):
            self._let_go()

    def _let_go(self) -> None:
        self._newest = None
        self._delay.reset()
        self._hold.reset()

    def _complaint(self) -> str:
        """Say what is wrong with the publishers of commands."""
        count, name = self._arbiter.count, self._command_name
        if count <= 1:
            return f"a message on {name} is numbered as another publisher's"
        if self._arbiter.several:
            return (
                f"{count} publishers on {name}, more than one speaks; the limit is 1:"
                " end all but one"
            )
        return (
            f"{count} publishers on {name}; one must have spoken alone for"
            f" {1.0e-9 * SPEAKING:g} s"
        )

    def _on_pause(
        self, request: SetBool.Request, response: SetBool.Response
    ) -> SetBool.Response:
        self._budget = 0 if request.data else None
        response.success = True
        response.message = "paused" if request.data else "running"
        return response

    def _on_step(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        if self._budget is None:
            pause = f"{self.get_fully_qualified_name()}/pause"
            response.success = False
            response.message = f"not paused; call {pause} with data true first"
            return response
        count = self.values["simulation.step_count"]
        self._budget += count
        response.success, response.message = True, f"stepping {count} samples"
        return response

    def _on_reset(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Put the robot at its start at rest as the next sample, without torque;
        commands for earlier states no longer count.
        """
        self._disturbances.reset(self.plant)
        self.plant.reset(self.values["task.start"])
        for part in (self._encoder, self._camera, self._delay, self._hold):
            part.reset()
        self._newest = None
        if self._index >= 0:
            self._index += self._sample is None
            self._since = self._index
            self._prepare(np.zeros(2))
            self._oldest = self._told
            if self.paused:
                self.publish()
        response.success, response.message = True, "at the start, at rest"
        return response

    def report(self) -> None:
        """Publish the counters since the start on ``/diagnostics``, with the real-time
        factor and the judgement since the last report.
        """
        before, counts = self._reported, self.counts
        steps = max(self._index, 0)
        late = counts["late_ticks"]
        refused = counts["commands_refused"]
        self._reported = after = Reported(
            self.schedule.ran(time.monotonic_ns()), steps, late, refused
        )
        factor = (
            (steps - before.steps) * self.period_ns / max(after.ran - before.ran, 1)
            if after.ran > before.ran
            else 0.0
        )
        commanders = self._arbiter.count
        taken = self._arbiter.accepts(time.monotonic_ns())
        message = self._trouble(before, after)
        level = DiagnosticStatus.WARN if message else DiagnosticStatus.OK
        self.publish_diagnostics(
            level,
            message or ("paused" if self.paused else "running"),
            {
                "mode": self.values["mode"],
                "steps": steps,
                **self.counts,
                "command_publishers": commanders,
                "commands_taken": taken,
                "overruns": self.schedule.overruns,
                "longest_overrun": 1.0e-9 * self.schedule.longest,
                "behind": 1.0e-9 * self.schedule.behind,
                "slip": 1.0e-9 * self.schedule.slip,
                "real_time_factor": round(factor, 4),
                "max_loop_gap": self._max_loop_gap,
                "saturated_ticks": self._hold.saturated,
                "watchdog_trips": self._hold.trips,
            },
        )

    def _trouble(self, before: Reported, after: Reported) -> str:
        """Say the worst that is wrong since the report before; empty when nothing
        is.
        """
        commanders = self._arbiter.count
        if rivals := self.too_many_publishers(self._states.topic_name):
            return f"{rivals}: another rig or plant"
        if commanders > 1:
            words = f"{commanders} publishers on {self._command_name}"
            return (
                f"{words}, one speaks"
                if self._arbiter.accepts(time.monotonic_ns())
                else f"{words}; no torque"
            )
        if after.refused > before.refused:
            return f"commands on {self._command_name} were refused"
        if self.lockstep:  # at the pace of the answers
            waits = time.monotonic() - self._published_at
            told = (
                self.counts["commands_received"] > 0
                and not self.paused
                and not self.answered
                and waits > REPEAT_AFTER
            )
            words = (
                f"for {waits:.1f} s no command has answered the state of"
                f" {self._published} ns: simulated time waits"
            )
            return words if told else ""
        ran = after.ran - before.ran
        return "; ".join(
            keeping_pace(
                after.steps - before.steps,
                after.late - before.late,
                ran,
                self.period_ns,
            )
        )

    def close(self) -> None:
        """Report for the last time, log the pace that was kept, and leave PyBullet."""
        self.report()
        ran = 1.0e-9 * self.schedule.ran(time.monotonic_ns())
        simulated = 1.0e-9 * self.period_ns * max(self._index, 0)
        if simulated and ran:
            self.get_logger().info(
                f"simulated {simulated:.3f} s in {ran:.3f} s: {simulated / ran:.2f} x"
                " real time"
            )
        self.plant.close()


def cycle(node: PlantNode, executor: Executor) -> None:
    """Do one sample: take its command, simulate, and publish the state at its deadline;
    or spend some of the waiting for that command.

    The commands are looked for when they are needed, which spares a waking for each.
    Without lockstep the physics go on when time presses; in lockstep only under the
    command that answers the state, however late the sample becomes.
    """
    schedule = node.schedule
    if not schedule.running:
        schedule.start(time.monotonic_ns(), 0 if node.sample_ready else node.period_ns)
    while not node.sample_ready:
        if node.paused:
            return
        node.listen()
        if (
            node.paced
            and (left := schedule.left_to_work(time.monotonic_ns(), node.awaited)) > 0.0
        ):
            _pass(node, executor, left)
        elif node.answered or not node.lockstep:
            begun = time.monotonic_ns()
            node.advance()
            schedule.worked(time.monotonic_ns() - begun)
        else:
            _await_command(node, executor)
            return
    if node.paced:
        while (
            left := schedule.left(time.monotonic_ns(), node.awaited)
        ) > EARLY and not node.paused:
            executor.spin_once(timeout_sec=left)
    elif schedule.serve(time.monotonic_ns()):
        _serve(executor)
    if node.paused:
        return
    if node.paced:
        schedule.met(time.monotonic_ns(), node.awaited)
    node.publish()


def _pass(node: PlantNode, executor: Executor, left: float) -> None:
    """Spend some of the time until the work begins; a sample that makes lateness up
    waits for its command, to begin with it.
    """
    soonest = node.schedule.left_to_work(time.monotonic_ns(), False)
    if soonest > 0.0:
        executor.spin_once(timeout_sec=soonest)
    else:
        node.wait(left)


def _await_command(node: PlantNode, executor: Executor) -> None:
    """Wait in lockstep for the command of a step."""
    node.wait(SERVED_EACH)
    if node.schedule.serve(time.monotonic_ns()):
        _serve(executor)
    node.listen()
    if not node.answered:
        node.repeat_unanswered()


def _serve(executor: Executor) -> None:
    for _ in range(SERVED_AT_ONCE):
        executor.spin_once(timeout_sec=0.0)


def spin(node: PlantNode, executor: Executor, stop: StopSignal) -> None:
    """Run the node's own loop until a signal comes."""
    precise_timers()
    ask_kernel(node.values, node.get_logger().warning)
    gc.collect()
    gc.freeze()
    while not stop and not node.finished:
        if node.paused:
            node.schedule.stop(time.monotonic_ns())
            executor.spin_once(timeout_sec=IDLE_WAIT)
            node.listen()
        else:
            node.begin()
            cycle(node, executor)


def main(args: list[str] | None = None) -> int:
    """Run the node as a console command; the process's exit code."""
    return run_node(PlantNode, args, spin)


if __name__ == "__main__":
    raise SystemExit(main())
