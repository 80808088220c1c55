"""The plant node over real DDS: the node in its own process, a small commander here.

Nothing depends on how fast the machine is: waits end on what arrives, and PATIENCE only
ends a test that is lost anyway.
"""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from patience import PATIENCE
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from dextar_control.contract.resources import (
    NODES_FILE,
    ROBOT_FILE,
    config_file,
    node_defaults,
)
from dextar_control.contract.robot import load_robot
from dextar_control.contract.topics import (
    DIAGNOSTICS,
    EXTERNAL_POSE,
    JOINT_COMMANDS,
    JOINT_STATES,
    SIM_END_EFFECTOR,
    SIM_JOINT_STATES,
)
from dextar_control.nodekit.cdr import from_time, to_time
from dextar_control.nodekit.node import make_executor, qos
from dextar_sim.disturbances import Disturbances
from dextar_sim.node import PlantNode
from dextar_sim.plant import Plant

PERIOD = 1_000_000
START = (0.0, 0.105)
PUSH, NONE = [1.0e-4, -1.0e-4], [0.0, 0.0]  # N m
EXACT = 1.0e-12
"""A float through CDR is itself; the pose is a few roundings away."""


def wavy(stamp: int) -> list[float]:
    """A torque that depends on the stamp alone, N m."""
    return [0.03 * math.sin(20.0e-9 * stamp), -0.02 * math.cos(15.0e-9 * stamp)]


class Commander:
    """Answers each joint state by ``answer(state) -> JointState | None`` and keeps all
    it received.
    """

    def __init__(self, parameters: dict[str, str]) -> None:
        self.node = rclpy.create_node("commander")
        self.executor = make_executor()
        self.states: list[JointState] = []
        self.platform: list[Odometry] = []
        self.joints: list[JointState] = []
        self.poses: list[PoseStamped] = []
        self.newest_at_pose: list[int] = []
        self.health: dict[str, str] = {}
        self.clients: dict[str, Any] = {}
        self.answer: Callable[[JointState], JointState | None] = lambda state: None
        self.commands = self.node.create_publisher(
            JointState, JOINT_COMMANDS.name, qos(JOINT_COMMANDS)
        )
        for topic, kind, take in (
            (SIM_END_EFFECTOR, Odometry, self.platform.append),
            (SIM_JOINT_STATES, JointState, self.joints.append),
            (EXTERNAL_POSE, PoseStamped, self._on_pose),
            (DIAGNOSTICS, DiagnosticArray, self._on_health),
        ):
            self.node.create_subscription(kind, topic.name, take, qos(topic))
        self.node.create_subscription(
            JointState, JOINT_STATES.name, self._on_state, qos(JOINT_STATES)
        )
        self.executor.add_node(self.node)
        parameters = {"simulation.real_time_factor": "0.0", **parameters}
        flags = [
            flag
            for name, value in parameters.items()
            for flag in ("-p", f"{name}:={value}")
        ]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "dextar_sim.node", "--ros-args", *flags],
            env=os.environ,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    def _on_state(self, state: JointState) -> None:
        if not self.states or state.header.stamp != self.states[-1].header.stamp:
            self.states.append(state)
        command = self.answer(state)
        if command is not None:
            self.commands.publish(command)

    def _on_pose(self, pose: PoseStamped) -> None:
        self.poses.append(pose)
        self.newest_at_pose.append(
            from_time(self.states[-1].header.stamp) if self.states else -1
        )

    def _on_health(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if status.name == "/plant":
                self.health = {"message": status.message} | {
                    item.key: item.value for item in status.values
                }

    def until(self, condition: Callable[[], Any]) -> None:
        limit = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < limit, "nothing more arrived"
            assert self.process.poll() is None, "the plant ended"
            self.executor.spin_once(timeout_sec=0.05)

    def until_effort(self, effort: list[float]) -> None:
        """Wait until this is the torque that acts, N m."""
        self.until(lambda: self.states and list(self.states[-1].effort) == effort)

    def linger(self, duration: float) -> None:
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.01)

    def leave_one_out(self) -> list[int]:
        """Answer each state but, when it comes first, the one after ten periods; the
        stamps of those that come, ns.
        """
        asked: list[int] = []

        def answer(state: JointState) -> JointState | None:
            asked.append(from_time(state.header.stamp))
            first = asked[-1] == 10 * PERIOD and asked.count(asked[-1]) == 1
            return None if first else wavy_answer(state)

        self.answer = answer
        return asked

    def call(self, name: str, kind: Any, **fields: Any) -> Any:
        if (
            name not in self.clients
        ):  # a new client may not yet be known to the server whose answer it waits for
            self.clients[name] = self.node.create_client(kind, f"/plant/{name}")
        client = self.clients[name]
        self.until(client.service_is_ready)
        future = client.call_async(kind.Request(**fields))
        self.until(future.done)
        return future.result()

    def close(self) -> tuple[int, str]:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        _, text = self.process.communicate(timeout=PATIENCE)
        self.executor.remove_node(self.node)
        self.executor.shutdown()
        self.node.destroy_node()
        return self.process.returncode, text


def command(
    state: JointState, torque: list[float], names: tuple[str, ...] = ("q11", "q21")
) -> JointState:
    message = JointState(name=list(names), effort=[float(value) for value in torque])
    message.header.stamp = state.header.stamp
    return message


def stamps(states: list[Any]) -> list[int]:
    return [from_time(state.header.stamp) for state in states]


def by_stamp(messages: list[Any]) -> dict[int, Any]:
    return dict(zip(stamps(messages), messages, strict=True))


def push(state: JointState) -> JointState:
    return command(state, PUSH)


def wavy_answer(state: JointState) -> JointState:
    return command(state, wavy(from_time(state.header.stamp)))


@pytest.fixture(scope="module", autouse=True)
def ros() -> Iterator[None]:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    yield
    rclpy.try_shutdown()


@pytest.fixture
def start() -> Iterator[Callable[..., Commander]]:
    started: list[Commander] = []

    def make(**parameters: str) -> Commander:
        started.append(
            Commander(
                {key.replace("__", "."): value for key, value in parameters.items()}
            )
        )
        return started[-1]

    yield make
    for commander in started:
        if commander.process.poll() is None:
            commander.close()


def lockstep_run(
    start: Callable[..., Commander], count: int, **parameters: str
) -> Commander:
    commander = start(mode="lockstep", **parameters)
    commander.answer = wavy_answer
    commander.until(lambda: len(commander.states) >= count)
    return commander


def test_lockstep_runs_are_bit_identical_and_answer_every_state(
    start: Callable[..., Commander],
) -> None:
    """Message for message; the bytes between the fields are alignment, which CDR leaves
    undefined.
    """
    runs = []
    for _ in range(2):
        commander = lockstep_run(
            start, 400, encoder__noise="1.0e-4", drive__command_delay="0.003"
        )
        runs.append(commander.states[:400])
        assert stamps(commander.states[:400]) == [
            PERIOD * index for index in range(400)
        ]
        assert commander.close()[0] == 0
    assert runs[0] == runs[1]


def test_lockstep_applies_each_answer_over_the_period_it_answers(
    start: Callable[..., Commander],
) -> None:
    """The same run on a plant of this process; the effort of state k + 1 is the answer
    to state k.
    """
    commander = start(
        mode="lockstep", encoder__resolution="0", task__start=str(list(START))
    )
    commander.answer = lambda state: (
        wavy_answer(state) if commander.joints and commander.platform else None
    )
    last = PERIOD * 199
    commander.until(
        lambda: all(
            last in stamps(kind) for kind in (commander.states, commander.joints)
        )
    )
    commander.until(lambda: last in stamps(commander.platform))
    joints, platforms = by_stamp(commander.joints), by_stamp(commander.platform)
    plant = Plant(load_robot(config_file("dextar.yaml")))
    plant.reset(START)
    applied = NONE
    for index in range(200):
        state, truth = plant.state(), joints[PERIOD * index]
        assert list(commander.states[index].position) == state.q_a.tolist()
        assert list(commander.states[index].effort) == applied
        assert list(truth.name) == ["q11", "q12", "q21", "q22"]
        assert list(truth.position) == state.joints.tolist()
        assert list(truth.velocity) == state.joints_dot.tolist()
        assert list(truth.effort) == [applied[0], 0.0, applied[1], 0.0]
        platform = platforms[PERIOD * index]
        pose, twist = platform.pose.pose.position, platform.twist.twist.linear
        assert [pose.x, pose.y, twist.x, twist.y] == [
            *state.x.tolist(),
            *state.x_dot.tolist(),
        ]
        applied = wavy(PERIOD * index)
        plant.step(applied)
    plant.close()


def test_command_delay_is_whole_periods(start: Callable[..., Commander]) -> None:
    commander = lockstep_run(start, 50, drive__command_delay="0.004")
    for index, state in enumerate(commander.states[:50]):
        assert list(state.effort) == (
            wavy(PERIOD * (index - 5)) if index >= 5 else NONE
        )


def test_external_pose_was_true_at_its_stamp_and_comes_after_its_delay(
    start: Callable[..., Commander],
) -> None:
    commander = start(
        mode="lockstep", external_pose__rate="80.0", external_pose__delay="0.0153"
    )
    commander.answer = lambda state: wavy_answer(state) if commander.platform else None
    commander.until(
        lambda: len(commander.poses) >= 10 and len(commander.platform) >= 200
    )
    due = [PERIOD * math.ceil(12.5 * index) for index in range(30)]
    first = due.index(
        stamps(commander.poses)[0]
    )  # a reader that matches late misses what came before
    assert stamps(commander.poses[:10]) == due[first : first + 10]
    platforms = by_stamp(commander.platform)
    for pose, newest in zip(
        commander.poses[:10], commander.newest_at_pose, strict=False
    ):
        stamp = from_time(pose.header.stamp)
        assert pose.header.frame_id == "base"
        assert pose.pose.position == platforms[stamp].pose.pose.position
        assert pose.pose.orientation.w == 1.0
        assert newest >= stamp + 15 * PERIOD


def test_external_noise_repeats_and_a_repeated_state_brings_no_second_pose(
    start: Callable[..., Commander],
) -> None:
    runs = []
    for _ in range(2):
        commander = start(
            mode="lockstep",
            external_pose__rate="100.0",
            external_pose__noise="1.0e-3",
            seed="7",
        )
        asked = commander.leave_one_out()
        commander.until(lambda commander=commander: len(commander.poses) >= 20)
        assert asked.count(10 * PERIOD) == 2
        times = stamps(commander.poses[:20])
        assert times == [times[0] + 10 * PERIOD * index for index in range(20)]
        runs.append(
            {
                stamp: (pose.pose.position.x, pose.pose.position.y)
                for stamp, pose in by_stamp(commander.poses).items()
            }
        )
        commander.close()
    common = runs[0].keys() & runs[1].keys()
    assert len(common) >= 10
    assert all(runs[0][stamp] == runs[1][stamp] for stamp in common)


def test_without_a_rate_nobody_publishes_an_external_pose(
    start: Callable[..., Commander],
) -> None:
    commander = start(mode="lockstep", external_pose__noise="1.0e-3")
    commander.answer = wavy_answer
    commander.until(lambda: len(commander.states) >= 50)
    assert commander.node.count_publishers(EXTERNAL_POSE.name) == 0
    assert commander.poses == []


def test_external_rate_above_that_of_the_samples_is_refused(
    start: Callable[..., Commander],
) -> None:
    commander = start(mode="lockstep", external_pose__rate="2000.0")
    assert commander.process.wait(PATIENCE) == 2
    code, text = commander.close()
    assert (code, text.splitlines()[-1]) == (
        2,
        "error: pose rate = 2000.0 Hz; it must be <= 1000 Hz, that of the samples",
    )


def test_joints_in_another_order_are_mapped_by_name(
    start: Callable[..., Commander],
) -> None:
    commander = start(mode="lockstep")
    commander.answer = lambda state: command(state, [0.01, 0.02], ("q21", "q11"))
    commander.until(lambda: len(commander.states) >= 5)
    assert list(commander.states[4].effort) == [0.02, 0.01]


def test_unusable_commands_are_refused_counted_and_without_torque(
    start: Callable[..., Commander],
) -> None:
    """Each state is first answered four times wrongly; only the right answer moves the
    plant.
    """
    commander = start(mode="lockstep")

    def answer(state: JointState) -> JointState:
        early = command(state, [0.1, 0.1])
        early.header.stamp = to_time(from_time(state.header.stamp) + PERIOD)
        for bad in (
            command(state, [math.nan, 0.1]),
            command(state, [0.1, 0.1], ("q11", "q12")),
            command(state, [0.1]),
            early,
        ):
            commander.commands.publish(bad)
        return command(state, NONE)

    commander.answer = answer
    commander.until(lambda: len(commander.states) >= 100)
    assert all(list(state.effort) == NONE for state in commander.states)
    assert commander.states[99].position == commander.states[0].position
    commander.until(lambda: int(commander.health.get("commands_refused", 0)) >= 4 * 99)
    assert "refused" in commander.health["message"]
    code, text = commander.close()
    assert code == 0
    assert 1 <= text.count(JOINT_COMMANDS.name) <= 100


def test_unanswered_state_is_repeated_and_counted(
    start: Callable[..., Commander],
) -> None:
    commander = start(mode="lockstep")
    asked = commander.leave_one_out()
    commander.until(lambda: len(commander.states) >= 20)
    assert asked.count(10 * PERIOD) == 2
    commander.until(lambda: int(commander.health.get("repeated_states", 0)) >= 1)


def acknowledgement(state: JointState) -> JointState:
    message = JointState()
    message.header.stamp = state.header.stamp
    return message


def test_lockstep_acknowledged_without_a_command_the_drives_hold_the_last_one_until_their_timeout(
    start: Callable[..., Commander],
) -> None:
    """Commands for the states before the tenth only: the torque goes on for the
    time-out's 5 ms and is gone then.
    """
    commander = start(mode="lockstep", drive__command_timeout="0.005")

    def answer(state: JointState) -> JointState:
        return (
            command(state, [0.01, -0.02])
            if from_time(state.header.stamp) < 10 * PERIOD
            else acknowledgement(state)
        )

    commander.answer = answer
    commander.until(lambda: len(commander.states) >= 40)
    efforts = [list(state.effort) for state in commander.states[:40]]
    assert efforts == [NONE] + 15 * [[0.01, -0.02]] + 24 * [NONE]
    assert stamps(commander.states[:40]) == [PERIOD * index for index in range(40)]
    commander.until(lambda: commander.health.get("watchdog_trips") == "1")
    assert int(commander.health["acknowledgements"]) >= 30
    assert int(commander.health["late_ticks"]) >= 30
    assert commander.health["commands_refused"] == "0"


def test_lockstep_takes_a_late_command_as_a_drive_does_and_waits_on(
    start: Callable[..., Commander],
) -> None:
    """State k is answered while k + 2 waits, after the command for k - 1 came once
    more: only the newest acts.
    """
    commander = start(mode="lockstep")

    def answer(state: JointState) -> JointState:
        stamp = from_time(state.header.stamp)
        for late in (stamp - 2 * PERIOD, stamp - 3 * PERIOD):
            if late >= 0:
                commander.commands.publish(
                    command(commander.states[late // PERIOD], wavy(late))
                )
        return acknowledgement(state)

    commander.answer = answer
    commander.until(lambda: len(commander.states) >= 50)
    for index, state in enumerate(commander.states[:50]):
        assert list(state.effort) == (
            wavy(PERIOD * (index - 3)) if index >= 3 else NONE
        )


def test_in_real_time_a_message_without_joints_is_refused(
    start: Callable[..., Commander],
) -> None:
    commander = start(mode="realtime")
    commander.answer = acknowledgement
    commander.until(lambda: int(commander.health.get("commands_refused", 0)) > 0)
    assert commander.health["acknowledgements"] == "0"


def test_start_paused_waits_steps_as_told_and_resumes(
    start: Callable[..., Commander],
) -> None:
    commander = start(
        mode="lockstep", simulation__start_paused="true", simulation__step_count="3"
    )
    commander.answer = wavy_answer
    commander.call("pause", SetBool, data=True)
    assert commander.states == []
    for steps in (3, 6):
        assert commander.call("step", Trigger).success
        commander.until(lambda count=steps: len(commander.states) >= count)
        commander.linger(0.2)
        assert len(commander.states) == steps
    commander.call("pause", SetBool, data=False)
    commander.until(lambda: len(commander.states) >= 50)
    assert not commander.call("step", Trigger).success
    assert stamps(commander.states) == [
        PERIOD * index for index in range(len(commander.states))
    ]


def test_reset_returns_to_the_start_at_rest_with_growing_stamps(
    start: Callable[..., Commander],
) -> None:
    commander = lockstep_run(start, 100, encoder__resolution="0")
    assert commander.call("reset", Trigger).success
    commander.answer = lambda state: command(state, NONE)
    first = list(commander.states[0].position)
    commander.until(
        lambda: any(list(state.position) == first for state in commander.states[50:])
    )
    again = next(
        index
        for index in range(50, len(commander.states))
        if list(commander.states[index].position) == first
    )
    assert list(commander.states[again].velocity) == NONE
    assert list(commander.states[again].effort) == NONE
    times = stamps(commander.states)
    assert times == sorted(set(times))


def test_realtime_without_commander_stays_free_and_counts_exact_periods(
    start: Callable[..., Commander],
) -> None:
    before = time.time_ns()
    commander = start(mode="realtime", encoder__resolution="0")
    commander.until(lambda: len(commander.states) >= 300 and bool(commander.health))
    times = stamps(commander.states)
    assert before <= times[0] <= time.time_ns()
    assert all((time_ - times[0]) % PERIOD == 0 for time_ in times)
    assert all(list(state.effort) == NONE for state in commander.states)
    assert commander.states[-1].position == pytest.approx(
        commander.states[0].position, abs=EXACT
    )
    assert commander.health["late_ticks"] == "0"
    assert commander.close()[0] == 0


def test_realtime_applies_answers_and_falls_silent_with_the_commander(
    start: Callable[..., Commander],
) -> None:
    commander = start(mode="realtime", drive__command_timeout="0.05")
    commander.answer = push
    commander.until_effort(PUSH)
    commander.answer = lambda state: None
    commander.until_effort(NONE)
    commander.until(lambda: int(commander.health.get("watchdog_trips", 0)) >= 1)
    assert int(commander.health["late_ticks"]) >= 1


def test_two_speaking_commanders_get_no_torque_and_are_reported(
    start: Callable[..., Commander],
) -> None:
    """The second one's first number steps back: what it says is never taken, not even
    before the graph is looked at.
    """
    commander = start(mode="realtime", drive__command_delay="0.003")
    commander.answer = push
    commander.until_effort(PUSH)
    second = commander.node.create_publisher(
        JointState, JOINT_COMMANDS.name, qos(JOINT_COMMANDS)
    )

    def both(state: JointState) -> JointState:
        second.publish(command(state, [2.0e-4, 2.0e-4]))
        return command(state, PUSH)

    commander.answer = both
    commander.until(lambda: commander.health.get("command_publishers") == "2")
    assert "2 publishers" in commander.health["message"]
    assert "no torque" in commander.health["message"]
    assert commander.health["commands_taken"] == "False"
    seen = len(commander.states)
    commander.until(lambda: len(commander.states) > seen + 500)
    assert {tuple(state.effort) for state in commander.states[seen:]} == {(0.0, 0.0)}
    assert {tuple(state.effort) for state in commander.states} == {
        (0.0, 0.0),
        (1.0e-4, -1.0e-4),
    }
    commander.until(lambda: int(commander.health["commands_refused"]) > 0)


def test_a_silent_second_commander_is_reported_and_waited_for(
    start: Callable[..., Commander],
) -> None:
    commander = start(mode="realtime")
    commander.answer = push
    commander.until_effort(PUSH)
    second = commander.node.create_publisher(
        JointState, JOINT_COMMANDS.name, qos(JOINT_COMMANDS)
    )
    commander.until(
        lambda: (
            commander.health.get("message")
            == "2 publishers on joint_commands, one speaks"
        )
    )
    assert commander.health["commands_taken"] == "True"
    commander.until_effort(PUSH)
    second.publish(command(commander.states[-1], [2.0e-4, 2.0e-4]))
    commander.until(
        lambda: (
            commander.health["message"] == "2 publishers on joint_commands; no torque"
        )
    )
    seen = len(commander.states)
    commander.until(lambda: len(commander.states) > seen + 500)
    assert {tuple(state.effort) for state in commander.states[seen:]} == {(0.0, 0.0)}
    assert not any(list(state.effort) == [2.0e-4, 2.0e-4] for state in commander.states)
    commander.node.destroy_publisher(second)
    commander.until_effort(PUSH)


KILLED_COMMANDER = """
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
rclpy.init()
node = Node("killed")
commands = node.create_publisher(JointState, "joint_commands", 10)
def answer(state):
    state.effort = [3.0e-4, 3.0e-4]
    state.position = state.velocity = []
    commands.publish(state)
node.create_subscription(JointState, "joint_states", answer, 10)
rclpy.spin(node)
"""


@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
def test_after_sigkill_of_a_commander_its_successor_moves_the_robot_at_once(
    start: Callable[..., Commander], mode: str
) -> None:
    """The middleware keeps the dead publisher in the graph for its lease; the drives
    tell it by its silence.
    """
    commander = start(mode=mode)
    killed = subprocess.Popen([sys.executable, "-c", KILLED_COMMANDER], env=os.environ)
    try:
        commander.until_effort([3.0e-4, 3.0e-4])
    finally:
        killed.kill()
        killed.wait()
    if mode == "realtime":
        commander.until_effort(NONE)
    commander.linger(0.5)
    commander.health = {}
    commander.answer = push
    commander.until_effort(PUSH)
    commander.until(
        lambda: (
            commander.health.get("message")
            == "2 publishers on joint_commands, one speaks"
        )
    )


@pytest.fixture
def plant(
    ros: None,
) -> Iterator[Callable[[str], tuple[PlantNode, list[tuple[bytes, str]]]]]:
    """Makes a plant in this process, which nobody spins, and what its reports say."""
    made: list[PlantNode] = []

    def make(mode: str) -> tuple[PlantNode, list[tuple[bytes, str]]]:
        node = PlantNode(cli_args=["--ros-args", "-p", f"mode:={mode}"])
        told: list[tuple[bytes, str]] = []
        node.publish_diagnostics = lambda level, message, values: told.append(
            (level, message)
        )  # type: ignore[method-assign]
        made.append(node)
        return node, told

    yield make
    for node in made:
        node.close()
        node.destroy_node()


def run_for(node: PlantNode, duration: float, steps: int) -> None:
    """As if it had run for so long, s, and made these steps, all without their
    commands.
    """
    node.schedule.start(time.monotonic_ns() - round(1e9 * duration), 0)
    node._index = max(node._index, 0) + steps
    node.counts["late_ticks"] += steps


def test_a_slow_plant_warns_with_the_numbers_since_the_last_report_and_not_in_lockstep_or_a_pause(
    plant: Any,
) -> None:
    node, told = plant("realtime")
    run_for(node, 2.0, 1000)
    node.report()
    assert told[-1][0] == DiagnosticStatus.WARN
    assert "real-time factor 0.50 over the last 2.0 s; the limit is 0.95" in told[-1][1]
    assert "100 % of the steps without their command in time" in told[-1][1]
    node.schedule.stop(time.monotonic_ns())
    node._budget = 0
    node.report()
    assert told[-1] == (DiagnosticStatus.OK, "paused")
    node._budget = None
    node.schedule.start(time.monotonic_ns() - 10**9, 0)
    node._index += 100_000  # whatever the machine does meanwhile: enough
    node.report()
    assert told[-1] == (DiagnosticStatus.OK, "running")
    waiting, told = plant("lockstep")
    run_for(waiting, 2.0, 10)
    assert told == []
    waiting.report()
    assert (
        DiagnosticStatus.OK in told[-1] or "publishers" in told[-1][1]
    )  # of the first one's states
    waiting.counts["commands_received"] = 1
    waiting._published_at = time.monotonic() - 7.0
    waiting.too_many_publishers = lambda topic: ""  # type: ignore[method-assign]
    waiting.report()
    assert "for 7.0 s no command has answered the state of" in told[-1][1]


def test_a_second_plant_is_seen_by_the_first(plant: Any) -> None:
    node, told = plant("lockstep")
    node.report()
    assert told[-1] == (DiagnosticStatus.OK, "running")
    plant("lockstep")
    deadline = time.monotonic() + PATIENCE
    while (
        "2 publishers on /joint_states; the limit is 1: end all but one (2 x /plant)"
        not in told[-1][1]
    ):
        assert time.monotonic() < deadline, told
        node.report()
        time.sleep(0.02)
    assert told[-1][0] == DiagnosticStatus.WARN


def test_a_step_that_is_refused_says_which_service_pauses(
    start: Callable[..., Commander],
) -> None:
    commander = start(mode="realtime")
    answer = commander.call("step", Trigger)
    assert (answer.success, answer.message) == (
        False,
        "not paused; call /plant/pause with data true first",
    )


def test_a_plant_unlike_its_drawing_does_what_its_parameters_say(
    start: Callable[..., Commander],
) -> None:
    """Belt, offset, a push and a load, as the same plant in a loop; stamps that are
    wrong are answered all the same.
    """
    stiffness = {
        "left.transmission_stiffness": 500.0,
        "right.transmission_stiffness": 500.0,
        "left.encoder_offset": 0.01,
    }
    given = {
        f"robot__{key.replace('.', '__')}": str(value)
        for key, value in stiffness.items()
    }
    commander = lockstep_run(
        start,
        60,
        encoder__stamp_error="2.0e-4",
        encoder__resolution="0",
        push__force="[0.1, 0.2]",
        push__time="0.01",
        push__duration="0.02",
        payload__mass="0.05",
        payload__time="0.04",
        **given,
    )
    commander.until(lambda: len(commander.joints) >= 60)
    times = np.array(stamps(commander.states[:60]))
    off = times - PERIOD * np.arange(60)
    assert np.diff(times).min() > 0 and 100_000 < np.abs(off).max() <= 200_000
    plant = Plant(load_robot(config_file(ROBOT_FILE)).replace(**stiffness))
    happenings = Disturbances(
        push=(0.1, 0.2),
        push_time=0.01,
        push_duration=0.02,
        payload=0.05,
        payload_time=0.04,
    )
    plant.reset(node_defaults("plant", config_file(NODES_FILE))["task.start"])
    for index, (state, joints) in enumerate(
        zip(commander.states[:60], commander.joints[:60], strict=True)
    ):
        if index:
            happenings.before(1e-3 * (index - 1), plant)
            plant.step(state.effort)
        assert joints.header.stamp == state.header.stamp
        assert joints.position.tolist() == pytest.approx(
            plant.state().joints.tolist(), abs=1e-9
        )
        assert state.position.tolist() == pytest.approx(
            np.add(plant.encoder_angles(), [0.01, 0.0]).tolist(), abs=1e-9
        )
    plant.close()
    commander.close()
    assert commander.health.get("repeated_states", "0") == "0"
