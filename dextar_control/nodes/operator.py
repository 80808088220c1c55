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

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rich.progress import BarColumn, TimeElapsedColumn
from std_srvs.srv import SetBool, Trigger

from dextar_control.contract.errors import NodesError, ParameterError
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.signals import EXIT_FAILED, tell
from dextar_control.contract.terminal import Steps, Terminal, TextColumn, plain
from dextar_control.contract.topics import NODES
from dextar_control.nodekit.client import (
    ANSWER,
    SILENCE,
    NodeClient,
    StopRequest,
    client_node,
)
from dextar_control.nodekit.node import prepare_middleware
from dextar_control.nodekit.services import ServiceType
from dextar_control.nodes.next_step import command, next_step, why_not
from dextar_control.nodes.progress import crossing_line, crossings, trip_line, unhealthy

# s for the trajectory server's part of a stop; on a busy machine it is found up to 3 s
# after the controller
SERVER = 5.0
STOPPING = 30.0  # s in which a stop is over
MOVING = ("APPROACH", "TRACK", "CROSSING")
STOPS = "controller/stop", "trajectory_server/stop"
GRAPH = 1.5  # s in which it is known which nodes there are
OK, ERROR = (str(level[0]) for level in (DiagnosticStatus.OK, DiagnosticStatus.ERROR))


class OperatorClient(NodeClient):
    """Starts, stops, enables and resets one robot, by its nodes' services.

    Args:
        namespace: of the robot's nodes.
        stop: as ``NodeClient`` takes it.
        name: of the node.
    """

    def __init__(
        self, namespace: str, stop: StopRequest | None = None, name: str = "operator"
    ) -> None:
        super().__init__(name, namespace, stop)
        # Known before they are needed: a stop waits for no discovery.
        for service in STOPS:
            self.client(Trigger, service)

    @property
    def controller(self) -> dict[str, str]:
        """What the controller told last."""
        return self.status.get("controller", {})

    def find(self, *names: str) -> None:
        """Wait until these nodes are heard of.

        Raises:
            NodesError: one is not there; says what else is and what to do.
        """
        for name in names:
            heard = partial(self.status.__contains__, name)
            if not self.until(heard, self.patience[0]) and not (
                self.count_nodes(name) and self.until(heard, SILENCE)
            ):
                raise NodesError(self.missing(name))

    def hear(self, *names: str) -> None:
        """Wait until those of these nodes that are known to be there have told of
        themselves.
        """
        self.until(
            lambda: all(
                name in self.status or not self.count_nodes(name) for name in names
            ),
            self.patience[0],
            through=True,
        )

    def count_nodes(self, name: str) -> int:
        """Return how many nodes have this name in the namespace."""
        return self.get_node_names_and_namespaces().count((name, self.get_namespace()))

    def alone(self, *names: str) -> None:
        """Check that each of these nodes is there once.

        Raises:
            NodesError: a request would reach two.
        """
        for name in names:
            if (count := self.count_nodes(name)) > 1:
                raise NodesError(
                    f"{count} nodes are called {self.full(name)}: end one or give its"
                    " robot a namespace (one that was killed counts for up to 20 s)"
                )

    def set_parameters_of(
        self, node: str, values: Mapping[str, ParameterValue]
    ) -> None:
        """Set parameters of a node, all or none.

        Raises:
            ParameterError: they are refused.
        """
        parameters = [
            Parameter(
                name,
                # an empty list tells no type; all that are set are of floats
                Parameter.Type.DOUBLE_ARRAY if isinstance(value, list) else None,
                value,
            ).to_parameter_msg()
            for name, value in values.items()
        ]
        answer: SetParametersAtomically.Response = self.ask(
            SetParametersAtomically,
            f"{node}/set_parameters_atomically",
            parameters=parameters,
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
            raise NodesError(reason)
        if values:
            self.set_parameters_of("trajectory_server", values)

    def heard_since(self, name: str, moment: float) -> bool:
        """Return whether a node has told of itself since a moment of the monotonic
        clock, s.
        """
        return self.heard.get(name, -SILENCE) > moment

    def silence(self, name: str) -> str:
        """Return that a node has fallen silent; empty when it has not."""
        age = time.monotonic() - self.heard[name]
        return (
            f"no word of {self.full(name)} for {age:.0f} s; see that it runs, and where"
            " the robot is"
            if age > SILENCE
            else ""
        )

    def stop_robot(self) -> None:
        """Ask for a safe stop, and that nothing that is still planned begins.

        Raises:
            NodesError: no controller answers.
        """
        try:
            self.stop_controller()
        finally:
            self.stop_server()

    def stop_controller(self) -> None:
        """Ask for a safe stop alone.

        Raises:
            NodesError: no controller answers.
        """
        self.call(Trigger, STOPS[0], through=True)

    def stop_server(self) -> None:
        """Ask that nothing that is still planned begins."""
        server = self.client(Trigger, STOPS[1])
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

        A controller that can leave what it has latched does so first: after
        the robot's jump it knows its side no longer.

        Raises:
            NodesError: there is none, it refuses, or the controller gives it torque.
        """
        self.find("controller", "plant")
        self.alone("controller", "plant")
        phase = self.controller.get("phase", "")
        if phase == "HOLD" or not self.at_rest():
            off = command(self.full("controller"), "enable")
            raise NodesError(
                f"the controller is in phase {phase} and would take the robot's new"
                f" place for a jump: type {off} --off first"
            )
        self.call(Trigger, "controller/reset")
        answer = self.call(Trigger, "plant/reset")
        if not answer.success:
            raise NodesError(answer.message)
        since = time.monotonic()
        self.until(lambda: self.heard_since("controller", since), SILENCE)

    def ask_controller(self, kind: ServiceType, name: str, **fields: bool) -> str:
        """Have the controller do something at once; return its state afterwards, in
        words.

        Args:
            kind: the service's type.
            name: of the controller's service.
            fields: of the request.

        Raises:
            NodesError: it refuses, or no one controller answers.
        """
        self.find("controller")
        self.alone("controller")
        answer = self.call(kind, f"controller/{name}", **fields)
        if not answer.success:
            raise NodesError(answer.message)
        since = time.monotonic()
        self.until(lambda: self.heard_since("controller", since), SILENCE)
        return self.state()

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
    """Has a trip planned and started, and follows it to its end, by what trajectory
    server and controller tell.

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
        self._before: dict[str, str] = {}  # what the controller told
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

    def run(self, values: Mapping[str, ParameterValue]) -> bool:
        """Set the task, have it planned and started, and follow it; return whether it
        was done and each planned crossing crossed.

        Args:
            values: parameters of the trajectory server; what is not given stays as it
                was set last.

        Raises:
            NodesError: nothing is started; says why and what to do.
            ParameterError: the task is refused.
            Interrupted: a signal came before it began; nothing moves.
        """
        self._me.prepare(values)
        self._before = self._me.controller
        self._start()
        self._follow()
        return self._end()

    def _start(self) -> None:
        """Have the trip planned and served."""
        me = self._me
        answer = me.begin(Trigger, "trajectory_server/start")
        while not answer.done():
            if me.stop:
                me.stop_robot()
                me.wait_for_rest()
                self._say(f"stopped while the trip was planned: {me.state()}")
                me.stop.check()
            if silence := me.silence("trajectory_server"):
                raise NodesError(silence)
            planning = me.status["trajectory_server"].get("planning", "")
            self._show(f"planning: {planning}" if planning else "planning", 0.0)
            me.turn()
        if not answer.result().success:
            raise NodesError(answer.result().message)

    def _follow(self) -> None:
        """Follow the trip until it ends; a signal begins a safe stop."""
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
                raise NodesError(
                    "the trip was served and has not arrived at"
                    f" {me.full('controller')} within {ANSWER:.0f} s"
                )
            self._tell()
            me.turn()
        self._tell()

    @property
    def _arrived(self) -> bool:
        now, before = (
            int(told.get("trajectories") or 0)
            for told in (self._me.controller, self._before)
        )
        return now > before

    def _over(self) -> bool:
        me, told = self._me, self._me.controller
        phase, note = told.get("phase", ""), told.get("trajectory", "")
        self.begun = self.begun or (
            self._arrived and told.get("motions") != self._before["motions"]
        )
        if self._asked:
            return me.heard_since("controller", self._asked) and me.at_rest()
        if told.get("lifecycle") != "active":
            return True
        if not self._arrived:
            return False
        if note.startswith("refused") and not self.begun:
            raise NodesError(f"the controller {note}")
        self.done = told["completed"] != self._before["completed"]
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

    def _end(self) -> bool:
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
    console = Terminal()
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
        good = TripFollower(
            me,
            lambda text, share: bars.update(bar, description=text, completed=share),
            lambda text: console.print(text, soft_wrap=True),
        ).run(task_values(vars(arguments)))
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
    with operator(arguments.namespace) as me:
        say(me.ask_controller(SetBool, "enable", data=not arguments.off))
    return 0


def reset(arguments: argparse.Namespace) -> int:
    """Leave a fault or a safe stop; return the exit code."""
    with operator(arguments.namespace) as me:
        if arguments.plant:
            me.reset_plant()
        say(me.ask_controller(Trigger, "reset"))
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
