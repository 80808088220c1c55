"""``dextar check-rig``: watches a driver over DDS, commands it a little when that is
allowed, and reports.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from rclpy.duration import Duration, Infinite
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import (
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rich.progress import BarColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from dextar_control.check_rig.check import (
    report,
    torque_obstacle,
    torque_tests,
    watch_lines,
)
from dextar_control.check_rig.limits import MIN_SAMPLES, Limits
from dextar_control.check_rig.report import LINES, CheckLine, Result, failed, has_failed
from dextar_control.check_rig.samples import Endpoint, Graph, JointSample
from dextar_control.check_rig.torque import TorqueTests
from dextar_control.check_rig.trial import NO_TORQUE, Torque
from dextar_control.contract.caches import check_file
from dextar_control.contract.clocks import UnsteppedClock
from dextar_control.contract.errors import ParameterError
from dextar_control.contract.resources import ROBOT_FILE, config_file, node_defaults
from dextar_control.contract.robot import JOINT_NAMES, RobotParameters, load_robot
from dextar_control.contract.signals import StopSignal
from dextar_control.contract.terminal import Steps, Terminal, TextColumn, title
from dextar_control.contract.topics import EFFORT_COMMANDS, JOINT_COMMANDS, JOINT_STATES
from dextar_control.nodekit.cdr import from_time, to_time
from dextar_control.nodekit.client import client_node
from dextar_control.nodekit.domain import discovery
from dextar_control.nodekit.node import qos

DISCOVERY = 3.0  # s until whoever is there has been found
# s after the first state: readers and writers find each other, and queues run empty
SETTLE = 0.5
POLL = 0.0005  # s between two looks for a state
GRAPH_PERIOD = 0.1  # s between two looks for another commander
LAST_ZEROS = 0.2  # s of zero torque at the end
LAST_WORD = 1.0  # s until the last zero must be acknowledged
DEPTH = 4000  # states held between two looks


class RigClient(Node):
    """Reads a driver's states without an executor, and commands it once ``open`` was
    called.

    Args:
        namespace: of the rig's topics.
        states, commands: topic names; empty is the contract's.
        arrays: whether commands are effort arrays.
    """

    def __init__(
        self, namespace: str, states: str, commands: str, *, arrays: bool
    ) -> None:
        super().__init__(
            "check_rig",
            namespace=namespace,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._topic = EFFORT_COMMANDS if arrays else JOINT_COMMANDS
        self._kind = Float64MultiArray if arrays else JointState
        profile = qos(JOINT_STATES, reliable=False, depth=DEPTH)
        self._states = self.create_subscription(
            JointState, states or JOINT_STATES.name, lambda _: None, profile
        )
        self._commands_name = self.resolve_topic_name(commands or self._topic.name)
        self._commands: Publisher | None = None
        self._stamp = 0
        self._unstepped = UnsteppedClock()

    def now(self) -> int:
        """Return the system clock's time when this began, gone on by the steady clock,
        ns: torque must not last because a clock was set.
        """
        return self._unstepped.now()

    def take(self) -> Iterator[JointSample]:
        """Give the states that have arrived."""
        while (
            taken := self._states.handle.take_message(JointState, False)
        ) is not None:
            message, info = taken
            self._stamp = from_time(message.header.stamp)
            yield JointSample(
                self._unstepped.arrival(info["received_timestamp"]),
                self._stamp,
                tuple(message.name),
                tuple(message.position),
                tuple(message.velocity),
                tuple(message.effort),
            )

    def graph(self) -> Graph:
        """Return who stands at the two topics, without this node."""
        states = self._states.topic_name
        reader, writer = qos(JOINT_STATES, reliable=False), qos(self._topic)
        for profile in (reader, writer):  # unset counts as 0 in a comparison
            profile.deadline = profile.liveliness_lease_duration = Infinite
        drivers = self._ends(
            self.get_publishers_info_by_topic(states),
            lambda theirs: qos_check_compatible(theirs, reader),
        )
        readers = self._ends(
            self.get_subscriptions_info_by_topic(self._commands_name),
            lambda theirs: qos_check_compatible(writer, theirs),
        )
        commanders = self._ends(
            self.get_publishers_info_by_topic(self._commands_name), None
        )
        return Graph(
            states,
            self._commands_name,
            JOINT_STATES.type,
            self._topic.type,
            drivers,
            readers,
            commanders,
        )

    def _ends(
        self,
        infos: Sequence[TopicEndpointInfo],
        check: Callable[[QoSProfile], tuple[QoSCompatibility, str]] | None,
    ) -> tuple[Endpoint, ...]:
        found = []
        own = f"{self.get_namespace().rstrip('/')}/{self.get_name()}"
        for info in infos:
            name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            if name != own:
                reliable = info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
                mismatch = ""
                if check:
                    fits, why = check(info.qos_profile)
                    mismatch = why if fits == QoSCompatibility.ERROR else ""
                found.append(Endpoint(name, info.topic_type, reliable, mismatch))
        return tuple(found)

    def hint(self) -> str:
        """Return where to look when nobody publishes states."""
        names = [
            name
            for name, types in self.get_topic_names_and_types()
            if JOINT_STATES.type in types
        ]
        others = (
            ", ".join(name for name in names if self.count_publishers(name)) or "none"
        )
        return (
            f"Nobody publishes {self._states.topic_name} ({discovery()}). Other topics"
            f" of that type: {others}; --states and --namespace choose another."
        )

    def open(self) -> None:
        """Offer commands: from now on this node counts as the commander."""
        self._commands = self.create_publisher(
            self._kind, self._commands_name, qos(self._topic)
        )

    @property
    def offers(self) -> bool:
        """Whether this node counts as the commander."""
        return self._commands is not None

    @property
    def others(self) -> int:
        """How many publishers of commands there are beside this node."""
        return self.count_publishers(self._commands_name) - self.offers

    @property
    def drivers(self) -> int:
        """How many publishers of states there are."""
        return int(self.count_publishers(self._states.topic_name))

    @property
    def heard(self) -> bool:
        """Whether somebody receives our commands."""
        return (
            self._commands is not None and self._commands.get_subscription_count() > 0
        )

    def command(self, torque: Torque) -> None:
        """Command torques, N m, in answer to the newest state."""
        assert self._commands is not None
        if self._kind is Float64MultiArray:
            self._commands.publish(Float64MultiArray(data=list(torque)))
            return
        message = JointState(name=list(JOINT_NAMES), effort=list(torque))
        message.header.stamp = to_time(self._stamp)
        self._commands.publish(message)

    def release(self) -> None:
        """Command zero torque in answer to the coming states, or without any."""
        if self._commands is None:
            return
        self.command(NO_TORQUE)
        end = time.monotonic() + LAST_ZEROS
        while time.monotonic() < end:
            for _ in self.take():
                self.command(NO_TORQUE)
            time.sleep(POLL)
        self.command(NO_TORQUE)
        self._commands.wait_for_all_acked(Duration(seconds=LAST_WORD))
        self.destroy_publisher(self._commands)
        self._commands = None

    def destroy_node(self) -> None:
        """Leave the graph; whatever happened, zero torque is the last command."""
        self.release()
        Node.destroy_node(self)


def limits_of(arguments: argparse.Namespace, robot: RobotParameters) -> Limits:
    """Return the limits of parsed arguments; what is not given follows from the nodes'
    own parameters.
    """
    plant, controller = node_defaults("plant"), node_defaults("controller")

    def given(value: float | None, default: float) -> float:
        return default if value is None else value

    rate = given(arguments.rate, 1.0 / plant["task.sample_period"])
    return Limits(
        rate=rate,
        watchdog=given(arguments.watchdog, plant["drive.command_timeout"]),
        max_torque=robot.max_torque,
        max_gap=given(arguments.max_gap, controller["joint_states.timeout"]),
        jitter=given(arguments.jitter, 1.0 / rate if rate else 0.0),
        rate_tolerance=arguments.rate_tolerance,
        max_age=arguments.max_age,
        watchdog_margin=arguments.watchdog_margin,
        torque=arguments.torque,
        pulse=given(
            arguments.pulse, max(Limits.pulse, MIN_SAMPLES / rate if rate else 0.0)
        ),
        max_move=arguments.max_move,
        max_speed=arguments.max_speed,
    )


def run_check(arguments: argparse.Namespace) -> int:
    """Check the rig of parsed arguments (see ``dextar check-rig --help``); return 0
    where all passed, 1 where something failed.
    """
    robot = load_robot(arguments.robot or config_file(ROBOT_FILE))
    limits = limits_of(arguments, robot)
    if not 100 <= arguments.duration * limits.rate < math.inf:
        raise ParameterError(
            f"duration = {arguments.duration} s at {limits.rate:g} Hz; it must be >="
            f" {100 / limits.rate:g} s"
        )
    if not 0.0 <= arguments.wait < math.inf:
        raise ParameterError(f"wait = {arguments.wait} s; it must be >= 0 and finite")
    if arguments.json is not None:
        check_file(arguments.json, "--json")
    console = Terminal()
    arrays = arguments.command_interface == "effort_array"
    names = arguments.namespace, arguments.states, arguments.commands
    with client_node(lambda _: RigClient(*names, arrays=arrays)) as (node, stop):
        graph, samples = _look(console, node, stop, arguments.wait, arguments.duration)
        lines = watch_lines(graph, samples, robot, limits, arguments.duration)
        hint = "" if graph.drivers else node.hint()
        torque: TorqueTests | str = torque_obstacle(lines) or _permission(
            console, stop, limits, arguments
        )
        if not torque:
            torque = torque_tests(lines, limits)
            second = _torque(console, node, stop, torque)
            if second is not None:
                lines = [second if line.name == second.name else line for line in lines]
    lines = report(lines, samples, torque)
    console.print(table(lines, graph))
    _note(console, lines)
    if hint:
        console.print(hint)
    if arguments.json is not None:
        _write(arguments.json, lines, graph, limits)
    return 1 if has_failed(lines) else 0


def _look(
    console: Terminal, node: RigClient, stop: StopSignal, wait: float, duration: float
) -> tuple[Graph, list[JointSample]]:
    """Return the graph, and the states of a quiet watch, which begins with the first of
    them or when none has come in time.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    samples: list[JointSample] = []
    with Steps(*columns, console=console, transient=True) as progress:
        bar = progress.add_task(
            f"looking for {node.graph().states}", total=wait + SETTLE + duration
        )
        begun = begin = time.monotonic()
        while time.monotonic() - begin < wait and not any(True for _ in node.take()):
            stop.check()
            time.sleep(20 * POLL)
            progress.update(bar, completed=time.monotonic() - begin)
        progress.update(bar, completed=wait, description="watching")
        for span, keep in ((SETTLE, False), (duration, True)):
            begin, done = time.monotonic(), progress.tasks[0].completed
            while (elapsed := time.monotonic() - begin) < span:
                stop.check()
                taken = list(node.take())
                if keep:
                    samples += taken
                progress.update(bar, completed=done + elapsed)
                time.sleep(20 * POLL)
        return _settled(node, begun + DISCOVERY, stop), samples


def _settled(node: RigClient, earliest: float, stop: StopSignal | None = None) -> Graph:
    """Return the graph once everybody has a name: a node's endpoints are often found
    before it.
    """
    latest = max(earliest, time.monotonic()) + DISCOVERY
    while True:
        now, graph = time.monotonic(), node.graph()
        unknown = any(
            "UNKNOWN" in end.node
            for end in (*graph.drivers, *graph.readers, *graph.commanders)
        )
        if now >= latest or (now >= earliest and not unknown):
            return graph
        if stop is not None:
            stop.check()
        time.sleep(20 * POLL)


def _permission(
    console: Terminal, stop: StopSignal, limits: Limits, arguments: argparse.Namespace
) -> str:
    """Ask on a terminal whether the robot may be moved; return why not, empty when it
    may.
    """
    if arguments.no_torque:
        return "not asked for (--no-torque)"
    if arguments.yes:
        return ""
    if not sys.stdin.isatty():
        return "no permission to move the robot: neither a terminal to ask on nor --yes"
    seconds = TorqueTests(limits, has_effort=True).expected_duration
    console.print("\nThe robot will move.", style="bold", end=" ")
    console.print(
        f"For about {seconds:.1f} s each motor in turn gets {limits.torque:+g} and"
        f" {-limits.torque:+g} N m, then commands stop, then NaN is sent. The tests end"
        f" at once, without torque, when a joint moves more than {limits.max_move:g}"
        f" rad from where a test began or turns faster than {limits.max_speed:g}"
        " rad/s.\nClear the robot's space, rest a hand on the emergency stop. Without"
        " permission these lines are skipped."
    )
    stop.starting = True  # a signal must interrupt the question
    try:
        answer = console.input("Type yes to go on: ", markup=False)
    except EOFError:
        answer = ""
    finally:
        stop.starting = False
    return "" if answer.strip().lower() == "yes" else "no permission to move the robot"


def _torque(
    console: Terminal, node: RigClient, stop: StopSignal, tests: TorqueTests
) -> CheckLine | None:
    """Run the tests with torque; return the line that another commander or another
    driver earns, or None.
    """
    if (rival := _rival(node, tests)) is not None:
        return rival
    node.open()
    deadline = time.monotonic() + DISCOVERY
    while not node.heard and time.monotonic() < deadline:
        stop.check()
        time.sleep(20 * POLL)
    if not node.heard:
        tests.stop("nobody received the commands")
        return None
    # Both ends must have matched, and the states that waited are old.
    settle = time.monotonic() + SETTLE
    while time.monotonic() < settle:
        for _ in node.take():
            node.command(NO_TORQUE)
        stop.check()
        time.sleep(POLL)
    with console.working("torque") as working:
        looked = time.monotonic()
        while not tests.finished:
            stop.check()
            now = time.monotonic()
            if now - looked > GRAPH_PERIOD:
                looked = now
                working.now(f"torque: {tests.stage}")
                if (rival := _rival(node, tests)) is not None:
                    return rival
            _answer(node, tests)
    node.release()
    return None


def _answer(node: RigClient, tests: TorqueTests) -> None:
    """Let the tests see what arrived, and command what they want."""
    torque = None
    for sample in node.take():
        torque = tests.update(node.now(), sample)
        if torque is not None:
            node.command(torque)
    if torque is None:
        torque = tests.update(node.now(), None)
        if torque is not None:
            node.command(torque)
        time.sleep(POLL)


def _rival(node: RigClient, tests: TorqueTests) -> CheckLine | None:
    """Stop the tests where there is another commander, or under torque another driver;
    return the line that it earns.
    """
    if not node.others and not (node.offers and node.drivers > 1):
        return None
    commanded = bool(node.others)
    if node.offers:
        node.command(NO_TORQUE)
    tests.stop(
        f"another {'commander' if commanded else 'publisher of joint states'} came"
    )
    graph = _settled(node, 0.0)
    ends = graph.commanders if commanded else graph.drivers
    names = ", ".join(sorted(end.node for end in ends)) or "unknown"
    if commanded:
        text = f"{node.others} other while torque was to be sent ({names})"
        return failed("only commander", text, "0")
    text = f"{node.drivers} publishers of states while torque was sent ({names})"
    return failed("topics", text, "1 publisher")


STYLES = {
    Result.PASS: "green",
    Result.FAIL: "bold red",
    Result.SKIP: "yellow",
    Result.NOTE: "cyan",
}


def table(lines: Sequence[CheckLine], graph: Graph) -> Table:
    """Return the report as a table for a person."""
    grid = Table(title=title(f"{graph.states}, {graph.commands}"), show_lines=False)
    for name in ("line", "", "measured", "limit"):
        grid.add_column(name, overflow="fold")
    for line in lines:
        grid.add_row(
            line.name,
            Text(line.result.value, STYLES[line.result]),
            line.measured,
            line.limit,
        )
    return grid


def _note(console: Terminal, lines: Sequence[CheckLine]) -> None:
    counts = {result: sum(line.result is result for line in lines) for result in Result}
    notes = (
        f", {counts[Result.NOTE]} noted: not needed by the controller"
        if counts[Result.NOTE]
        else ""
    )
    console.print(
        f"{counts[Result.PASS]} passed, {counts[Result.FAIL]} failed,"
        f" {counts[Result.SKIP]} skipped{notes}"
    )
    for line in lines:
        if line.result is Result.FAIL:
            text = (
                f"FAIL {line.name} ({LINES[line.name]}): {line.measured}; limit"
                f" {line.limit}"
            )
            console.print(text)


def _write(
    path: Path, lines: Sequence[CheckLine], graph: Graph, limits: Limits
) -> None:
    document = {
        "passed": not has_failed(lines),
        "states": graph.states,
        "commands": graph.commands,
        "limits": vars(limits),
        "lines": [
            {
                "name": line.name,
                "requirement": LINES[line.name],
                "result": line.result.value,
                "measured": line.measured,
                "limit": line.limit,
                "numbers": line.numbers,
            }
            for line in lines
        ],
    }
    try:
        path.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise ParameterError(
            f"report {path} cannot be written: {error.strerror}"
        ) from error
