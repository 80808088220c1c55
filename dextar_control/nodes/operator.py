"""An operator's client starts a trip of a robot whose nodes run and follows it, stops,
enables and resets the robot, and tells its state.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Protocol

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from rich.progress import BarColumn, TimeElapsedColumn
from std_srvs.srv import SetBool, Trigger

from dextar_control.contract.errors import DextarError, ParameterError
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.signals import EXIT_FAILED, tell
from dextar_control.contract.terminal import Steps, Terminal, TextColumn, plain
from dextar_control.contract.topics import DIAGNOSTICS, NODES
from dextar_control.nodekit.client import client_node
from dextar_control.nodekit.domain import discovery
from dextar_control.nodekit.node import prepare_middleware, qos
from dextar_control.nodes.next_step import next_step, why_not
from dextar_control.nodes.progress import crossing_line, crossings, trip_line, unhealthy

DISCOVERY = 5.0  # s in which a node that runs is heard of
ANSWER = 10.0  # s in which a service answers that does not plan
# s without a word of a node that speaks each second, after which it counts as gone
SILENCE = 10.0
# s for the trajectory server's part of a stop; on a busy machine it is found up to 3 s
# after the controller
SERVER = 5.0
STOPPING = 30.0  # s in which a stop is over
TICK = 0.05  # s
MOVING = ("APPROACH", "TRACK", "CROSSING")
STOPS = "controller/stop", "trajectory_server/stop"
GRAPH = 1.5  # s in which it is known which nodes there are
OK, ERROR = (str(level[0]) for level in (DiagnosticStatus.OK, DiagnosticStatus.ERROR))


class Unreached(DextarError):
    """Nobody is there to ask, or none answers; the message says what to do."""


class StopRequest(Protocol):
    """True from when on what is under way is to end."""

    def __bool__(self) -> bool: ...

    def check(self) -> None:
        """Raise ``Interrupted`` where it is to end."""


class OperatorClient(Node):
    """Hears what the nodes of one robot tell of themselves, and calls their services.

    Args:
        namespace: of the robot's nodes.
        stop: what asks for an end, as the signals to a command's process; None asks
            for none.
        name: of the node.

    Attributes:
        status: of each node, by its name in the namespace: what it told last, with
            ``message`` and ``level``.
    """

    def __init__(
        self, namespace: str, stop: StopRequest | None = None, name: str = "operator"
    ) -> None:
        super().__init__(
            name,
            namespace=namespace,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self.stop = stop
        self.status: dict[str, dict[str, str]] = {}
        self._heard: dict[str, float] = {}
        self._clients_of: dict[str, Client] = {}
        self.create_subscription(
            DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, qos(DIAGNOSTICS)
        )
        # Known before they are needed: a stop waits for no discovery.
        for service in STOPS:
            self._client(Trigger, service)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            space, _, name = status.name.rpartition("/")
            if space == self.get_namespace().rstrip("/"):
                told = {"message": status.message, "level": str(status.level[0])}
                self._heard[name] = time.monotonic()
                self.status[name] = {
                    item.key: item.value for item in status.values
                } | told

    def full(self, name: str) -> str:
        """Return a node's or service's name with the namespace."""
        return f"{self.get_namespace().rstrip('/')}/{name}"

    @property
    def controller(self) -> dict[str, str]:
        """What the controller told last."""
        return self.status.get("controller", {})

    def turn(self) -> None:
        """Hear for a moment."""
        rclpy.spin_once(self, timeout_sec=TICK)

    def until(
        self, condition: Callable[[], object], seconds: float, *, through: bool = False
    ) -> bool:
        """Hear until something holds; return False where it does not in time.

        Args:
            condition: true once it holds.
            seconds: at most.
            through: whether to go on after a signal.

        Raises:
            Interrupted: a signal came.
        """
        deadline = time.monotonic() + seconds
        while not condition():
            if self.stop and not through:
                self.stop.check()
            if time.monotonic() > deadline:
                return False
            self.turn()
        return True

    def find(self, *names: str) -> None:
        """Wait until these nodes are heard of.

        Raises:
            Unreached: one is not there; says what else is and what to do.
        """
        for name in names:
            heard = partial(self.status.__contains__, name)
            if not self.until(heard, DISCOVERY) and not (
                self.count_nodes(name) and self.until(heard, SILENCE)
            ):
                raise Unreached(self._missing(name))

    def hear(self, *names: str) -> None:
        """Wait until those of these nodes that are known to be there have told of
        themselves.
        """
        self.until(
            lambda: all(
                name in self.status or not self.count_nodes(name) for name in names
            ),
            DISCOVERY,
            through=True,
        )

    def _missing(self, name: str) -> str:
        nodes = self.get_node_names_and_namespaces()
        others = sorted(
            {
                space
                for node, space in nodes
                if node == name and space != self.get_namespace()
            }
        )
        if others:
            return (
                f"{self.full(name)} does not run, but there is one in"
                f" {', '.join(others)}: choose by --namespace"
            )
        where = discovery()
        if name in [node for node, _ in nodes]:
            return (
                f"no word of {self.full(name)} for {SILENCE:.0f} s, though it is there"
                f" ({where}): see its log"
            )
        return (
            f"no word of {self.full(name)} within {DISCOVERY:g} s ({where}): start the"
            " nodes (ros2 launch dextar crossing.launch.py, or each alone), or set"
            " ROS_DOMAIN_ID to theirs; dextar demo starts its own and tells its domain"
            " first"
        )

    def count_nodes(self, name: str) -> int:
        """Return how many nodes have this name in the namespace."""
        return self.get_node_names_and_namespaces().count((name, self.get_namespace()))

    def alone(self, *names: str) -> None:
        """Check that each of these nodes is there once.

        Raises:
            Unreached: a request would reach two.
        """
        for name in names:
            if (count := self.count_nodes(name)) > 1:
                raise Unreached(
                    f"{count} nodes are called {self.full(name)}: end one or give its"
                    " robot a namespace (one that was killed counts for up to 20 s)"
                )

    def _client(self, kind: type[object], name: str) -> Client:
        if name not in self._clients_of:
            self._clients_of[name] = self.create_client(kind, name)
        return self._clients_of[name]

    def ask(
        self, kind: type[object], name: str, request: object, *, through: bool = False
    ) -> Future:
        """Return the answer of a service, as a future.

        Args:
            kind: the service's type.
            name: of the service, relative to the namespace.
            request: of that type.
            through: whether to go on after a signal.

        Raises:
            Unreached: nobody offers it.
        """
        client = self._client(kind, name)
        if not self.until(client.service_is_ready, DISCOVERY, through=through):
            raise Unreached(self._missing(name.partition("/")[0]))
        return client.call_async(request)

    def call(
        self, kind: type[object], name: str, request: object, *, through: bool = False
    ) -> object:
        """Return the answer of a service; the arguments are those of ``ask``.

        Raises:
            Unreached: none comes.
        """
        future = self.ask(kind, name, request, through=through)
        there = self._client(kind, name).service_is_ready
        over = self.until(lambda: future.done() or not there(), ANSWER, through=through)
        if not future.done():
            why = "and it has ended" if over else f"within {ANSWER:.0f} s"
            raise Unreached(
                f"no answer of {self.full(name)} {why}; see that its node runs, then"
                " try again"
            )
        return future.result()

    def set_parameters_of(
        self, node: str, values: Mapping[str, ParameterValue]
    ) -> None:
        """Set parameters of a node, all or none.

        Raises:
            ParameterError: they are refused.
        """
        parameters = [
            Parameter(name, kind_of(value), value).to_parameter_msg()
            for name, value in values.items()
        ]
        request = SetParametersAtomically.Request(parameters=parameters)
        answer: SetParametersAtomically.Response = self.call(
            SetParametersAtomically, f"{node}/set_parameters_atomically", request
        )
        if not answer.result.successful:
            raise ParameterError(answer.result.reason)

    def prepare(self, values: Mapping[str, ParameterValue]) -> None:
        """Check that a trip can begin, and set the task; what is not given stays as it
        was set last.

        Raises:
            DextarError: a node is missing or there twice, the controller would take no
                trip, or the task is refused.
        """
        self.find("controller", "trajectory_server")
        self.alone("controller", "trajectory_server")
        if reason := why_not(self.full("controller"), self.controller):
            raise Unreached(reason)
        if values:
            self.set_parameters_of("trajectory_server", values)

    def heard_since(self, name: str, moment: float) -> bool:
        """Return whether a node has told of itself since a moment of the monotonic
        clock, s.
        """
        return self._heard.get(name, -SILENCE) > moment

    def silence(self, name: str) -> str:
        """Return that a node has fallen silent; empty when it has not."""
        age = time.monotonic() - self._heard[name]
        return (
            f"no word of {self.full(name)} for {age:.0f} s; see that it runs, and where"
            " the robot is"
            if age > SILENCE
            else ""
        )

    def stop_robot(self) -> None:
        """Ask for a safe stop, and that nothing that is still planned begins.

        Raises:
            Unreached: no controller answers.
        """
        try:
            self.stop_controller()
        finally:
            self.stop_server()

    def stop_controller(self) -> None:
        """Ask for a safe stop alone.

        Raises:
            Unreached: no controller answers.
        """
        self.call(Trigger, STOPS[0], Trigger.Request(), through=True)

    def stop_server(self) -> None:
        """Ask that nothing that is still planned begins."""
        server = self._client(Trigger, STOPS[1])
        # A robot may do without one.
        if self.until(server.service_is_ready, SERVER, through=True):
            self.until(server.call_async(Trigger.Request()).done, SERVER, through=True)

    def at_rest(self) -> bool:
        """Return whether a stop is over: the robot holds, or has no torque."""
        phase = self.controller.get("phase", "")
        return (
            self.controller.get("stopped") == "True"
            if phase == "SAFE_STOP"
            else phase not in MOVING
        )

    def wait_for_rest(self) -> bool:
        """Return whether the controller tells, after this call, that a stop is over."""
        since = time.monotonic()
        return self.until(
            lambda: self.heard_since("controller", since) and self.at_rest(),
            STOPPING,
            through=True,
        )

    def bag(self) -> str:
        """Return the file that a recorder of the robot writes; empty without one."""
        self.hear("recorder")
        recorder = self.status.get("recorder", {})
        return recorder.get("bag", "") if recorder.get("recording") == "True" else ""

    def reset_plant(self) -> None:
        """Put a simulated robot back to its start, at rest, and wait until the
        controller tells of itself again.

        Raises:
            Unreached: there is none, or it refuses.
        """
        self.find("controller", "plant")
        answer: Trigger.Response = self.call(Trigger, "plant/reset", Trigger.Request())
        if not answer.success:
            raise Unreached(answer.message)
        since = time.monotonic()
        self.until(lambda: self.heard_since("controller", since), SILENCE)

    def ask_controller(self, kind: type[object], name: str, request: object) -> str:
        """Have the controller do something at once; return its state afterwards, in
        words.

        Args:
            kind: the service's type.
            name: of the controller's service.
            request: of that type.

        Raises:
            Unreached: it refuses, or no one controller answers.
        """
        self.find("controller")
        self.alone("controller")
        answer: Trigger.Response = self.call(kind, f"controller/{name}", request)
        if not answer.success:
            raise Unreached(answer.message)
        since = time.monotonic()
        self.until(lambda: self.heard_since("controller", since), SILENCE)
        return self.state()

    def trip(
        self,
        values: Mapping[str, ParameterValue],
        show: Callable[[str, float], None],
        say: Callable[[str], object],
    ) -> bool:
        """Set the task, have it planned and started, and follow it; return whether it
        was done and each planned crossing crossed.

        Args:
            values: parameters of the trajectory server; what is not given stays as it
                was set last.
            show, say: as ``TripFollower`` takes them.

        Raises:
            Unreached: nothing is started; says why and what to do.
            ParameterError: the task is refused.
        """
        self.prepare(values)
        trip = TripFollower(self, show, say)
        trip.start()
        trip.follow()
        return trip.end()

    def state(self) -> str:
        """Return phase and reason, and what to do next, as the controller told them
        last.
        """
        told = self.controller
        phase, lifecycle, reason = (
            told.get(key, "") for key in ("phase", "lifecycle", "reason")
        )
        text = f"{phase or lifecycle}{f' ({reason})' if reason else ''}"
        step = next_step(
            self.full("controller"), lifecycle, phase, told.get("enabling", "")
        )
        return f"{text}: {step}" if step else text


def kind_of(value: ParameterValue) -> Parameter.Type:
    """Return a parameter's type; an empty list is one of floats."""
    if isinstance(value, list):
        return Parameter.Type.DOUBLE_ARRAY
    found: Parameter.Type = Parameter.Type.from_parameter_value(value)
    return found


def task_values(asked: Mapping[str, ParameterValue]) -> dict[str, ParameterValue]:
    """Return the trajectory server's parameters that were asked for; one kind of task
    switches the others off.

    Args:
        asked: tour, point, excite, duration and repeat; None where it was not.
    """
    values: dict[str, ParameterValue] = {}
    if any(asked[name] is not None for name in ("tour", "point", "excite")):
        values = {
            "task.tour": asked["tour"] or 0,
            "task.point": asked["point"] or [],
            "task.excite": asked["excite"] or 0.0,
            "task.tour_points": [],
            "task.direction": 0,
        }
    return values | {
        f"task.{name}": asked[name]
        for name in ("duration", "repeat")
        if asked[name] is not None
    }


@contextmanager
def operator(namespace: str) -> Iterator[OperatorClient]:
    """Return a client whose signals are a flag, for as long as the context lasts.

    Raises:
        ParameterError: the namespace is none.
    """
    prepare_middleware()
    with client_node(lambda stop: OperatorClient(namespace, stop)) as (me, _):
        yield me


class TripFollower:
    """Starts a trip and follows it to its end, by what trajectory server and controller
    tell.

    Args:
        me: the client.
        show: takes what is under way, and how much of it is done, 0 to 1.
        say: takes a line on what has been decided.

    Attributes:
        begun: it is, or was, tracked.
        done: it was tracked to its end.
        trouble: why it is not known how it went on; empty when it is.
        bag: file of a recorder that ran at its end; empty without one.
    """

    def __init__(
        self,
        me: OperatorClient,
        show: Callable[[str, float], None],
        say: Callable[[str], object],
    ) -> None:
        self._me, self._show, self._say = me, show, say
        self._before = int(me.controller["trajectories"] or 0)
        self._completed = me.controller["completed"]
        self._motions = me.controller["motions"]
        self._told: dict[int, str] = {}
        self._asked = 0.0  # when a stop was, s
        self.begun = self.done = False
        self.trouble = self.bag = ""

    @property
    def verdicts(self) -> list[tuple[str, str]]:
        """The verdict on each planned crossing and the confidence in it; empty before
        the trip began.
        """
        told = self._me.controller if self.begun else {}
        return list(
            zip(
                told.get("verdicts", "").split(),
                told.get("confidences", "").split(),
                strict=True,
            )
        )

    def start(self) -> None:
        """Have the trip planned and served.

        Raises:
            Unreached: that is refused, or nobody answers.
            Interrupted: a signal came first; nothing moves.
        """
        me = self._me
        answer = me.ask(Trigger, "trajectory_server/start", Trigger.Request())
        while not answer.done():
            if me.stop:
                me.stop_robot()
                me.wait_for_rest()
                self._say(f"stopped while the trip was planned: {me.state()}")
                me.stop.check()
            if silence := me.silence("trajectory_server"):
                raise Unreached(silence)
            planning = me.status["trajectory_server"].get("planning", "")
            self._show(f"planning: {planning}" if planning else "planning", 0.0)
            me.turn()
        if not answer.result().success:
            raise Unreached(answer.result().message)

    def follow(self) -> None:
        """Follow the trip until it ends; a signal begins a safe stop.

        Raises:
            Unreached: the controller does not take it.
        """
        me, served = self._me, time.monotonic()
        while not self._over():
            if me.stop and not self._asked:
                me.stop_robot()
                self._asked = time.monotonic()
            if self._asked and time.monotonic() - self._asked > STOPPING:
                self.trouble = (
                    f"a stop was asked for and is not over after {STOPPING:.0f} s"
                )
                break
            if silence := me.silence("controller"):
                self.trouble = silence
                break
            if not self._arrived and time.monotonic() - served > ANSWER:
                raise Unreached(
                    "the trip was served and has not arrived at"
                    f" {me.full('controller')} within {ANSWER:.0f} s"
                )
            self._tell()
            me.turn()
        self._tell()

    @property
    def _arrived(self) -> bool:
        return int(self._me.controller.get("trajectories") or 0) > self._before

    def _over(self) -> bool:
        me, told = self._me, self._me.controller
        phase, note = told.get("phase", ""), told.get("trajectory", "")
        self.begun = self.begun or (
            self._arrived and told.get("motions") != self._motions
        )
        if self._asked:
            return me.heard_since("controller", self._asked) and me.at_rest()
        if told.get("lifecycle") != "active":
            return True
        if not self._arrived:
            return False
        if note.startswith("refused") and not self.begun:
            raise Unreached(f"the controller {note}")
        self.done = told["completed"] != self._completed
        self.begun = self.begun or self.done or phase in MOVING
        if phase in MOVING or note == "checking":
            return False
        waits = told["waiting_for"] or (
            phase == "IDLE" and told["enabling"] == "waiting"
        )
        return me.at_rest() and (self.begun or not waits)

    def _tell(self) -> None:
        told = self._me.controller
        if not self.begun:
            self._show(f"waiting{unhealthy(told)}", 0.0)
            return
        verdicts = self.verdicts
        for index, (verdict, confidence) in enumerate(verdicts):
            if verdict not in ("undecided", self._told.get(index)):
                self._told[index] = verdict
                self._say(crossing_line(index, len(verdicts), verdict, confidence))
        duration = float(told.get("duration") or 0.0)
        share = 1.0 if self.done else 0.0
        if duration and not self.done:
            share = min(float(told.get("reference_time") or 0.0) / duration, 1.0)
        self._show(
            f"{'done' if self.done else told.get('phase', ''):<9} {crossings(told)}",
            share,
        )

    def end(self) -> bool:
        """Say how it ended; return whether it was done and every planned crossing
        crossed.
        """
        me, told = self._me, self._me.controller
        verdicts = self.verdicts
        crossed = [verdict for verdict, _ in verdicts].count("crossed")
        for index in range(min(int(told.get("begun") or 0), len(verdicts))):
            if index not in self._told:
                self._say(crossing_line(index, len(verdicts), *verdicts[index]))
        if self.begun:
            self._say(
                f"{'done' if self.done else 'not done'}:"
                f" {trip_line(crossed, len(verdicts), float(told['largest_error']))}"
            )
        elif not self.trouble:
            self._say("not done: the trip was dropped before it began")
        self.bag = me.bag()
        if self.bag:
            self._say(f"recorded in {self.bag}")
        good = self.done and told["phase"] == "HOLD" and crossed == len(verdicts)
        if self.trouble or not good:
            self._say("; ".join(text for text in (self.trouble, me.state()) if text))
        return good and not self.trouble


def go(arguments: argparse.Namespace) -> int:
    """Start a trip and follow it; return the exit code."""
    values, console = task_values(vars(arguments)), Terminal()
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    with (
        operator(arguments.namespace) as me,
        Steps(*columns, console=console, transient=True) as bars,
    ):
        bar = bars.add_task("planning", total=1.0)
        good = me.trip(
            values,
            lambda text, share: bars.update(bar, description=text, completed=share),
            lambda text: console.print(text, soft_wrap=True),
        )
        if me.stop:
            me.stop.check()
    return 0 if good else EXIT_FAILED


def stop(arguments: argparse.Namespace) -> int:
    """Stop safely; return the exit code."""
    with operator(arguments.namespace) as me:
        me.stop_robot()
        rests = me.wait_for_rest()
        late = f"the stop is asked for and not over after {STOPPING:.0f} s: "
        say(f"{'' if rests else late}{me.state()}")
    return 0 if rests else EXIT_FAILED


def enable(arguments: argparse.Namespace) -> int:
    """Switch the torque on or off; return the exit code."""
    return _ask_controller(
        arguments, SetBool, "enable", SetBool.Request(data=not arguments.off)
    )


def reset(arguments: argparse.Namespace) -> int:
    """Leave a fault or a safe stop; return the exit code."""
    if arguments.plant:
        with operator(arguments.namespace) as me:
            me.reset_plant()
    return _ask_controller(arguments, Trigger, "reset", Trigger.Request())


def _ask_controller(
    arguments: argparse.Namespace, kind: type[object], name: str, request: object
) -> int:
    with operator(arguments.namespace) as me:
        say(me.ask_controller(kind, name, request))
    return 0


def status(arguments: argparse.Namespace) -> int:
    """Print the robot's state; return the exit code."""
    with operator(arguments.namespace) as me:
        me.find("controller")
        me.until(lambda: False, GRAPH)
        me.hear(*NODES)
        told, nodes = me.controller, me.status
        say(f"controller: {told['lifecycle']}, {me.state()}")
        say(f"law {told['law']}, estimator {told['estimator']}")
        if told.get("x", "nan") != "nan":
            x, y, s = (float(told[key]) for key in ("x", "y", "s"))
            side = "known" if told["mode_known"] == "True" else "not known"
            say(
                f"robot: x {x:.4f} m, y {y:.4f} m, s {s:+.3f}, side of the locus {side}"
                f" (confidence {float(told['mode_confidence']):.3f})"
            )
        if float(told.get("duration") or 0.0):
            trip = trip_line(
                int(told["crossed"]),
                int(told["crossings"]),
                float(told["largest_error"]),
            )
            say(f"last trip: {', '.join(filter(None, (crossings(told), trip)))}")
        for name, values in nodes.items():
            if name != "controller" or values["level"] != OK:
                text = f"{name}: {values['message']} {values.get('planning', '')}"
                say(text.rstrip())
        wrong = any(values["level"] == ERROR for values in nodes.values())
    return EXIT_FAILED if wrong else 0


def say(text: str) -> None:
    """Print a line on what was found or done."""
    tell(plain(text), sys.stdout)
