"""A panel asks the nodes what an operator asks, each kind of request in a thread of its
own.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from dextar_control.contract.errors import DextarError, NodesError, ParameterError
from dextar_control.contract.node_parameters import PARAMETERS
from dextar_control.contract.parameters import check_value
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.resources import node_defaults
from dextar_control.contract.signals import Interrupted
from dextar_control.nodekit.client import TICK
from dextar_control.nodekit.parameter_snapshot import ParameterSnapshot
from dextar_control.nodes.operator import (
    MOVING,
    OperatorClient,
    TripFollower,
    task_values,
)

SET = ("controller", "trajectory_server", "recorder")
"""The nodes whose parameters a panel sets."""
# Parameters that the controller takes only where it is built anew.
REBUILT = ("law", "estimator")
KINDS = ("trip", "point", "tour")  # of a task
# s without a word of a node, after which its parameters are asked for again.
SILENT = 3.0
LINES = 40  # that are kept of what was said
EVENTS_DEPTH = 100

Job = Callable[[], str]
Answer = Callable[[bool, str], None]


class PanelOperator(OperatorClient):
    """The operator's client for several threads that wait; whoever made it spins it.

    Args:
        namespace: of the robot's nodes.

    Attributes:
        values: of the parameters of each node of ``SET``; empty where they are not
            known.
        lines: what was said last, each with its number, the oldest first.
        progress: of the trip that this panel has started: what is under way, and how
            much of it is done; None without one.
    """

    def __init__(self, namespace: str) -> None:
        super().__init__(namespace)
        self._news = threading.Condition()
        self._leaving = False
        self._snapshots = {name: ParameterSnapshot(self, name) for name in SET}
        self._threads = {
            name: ThreadPoolExecutor(1, name)
            for name in ("stop", "drop", "trip", "desk")
        }
        self.lines: deque[tuple[int, str]] = deque(maxlen=LINES)
        self.progress: tuple[str, float] | None = None
        self.create_subscription(
            ParameterEvent,
            "/parameter_events",
            self._on_parameters,
            QoSProfile(depth=EVENTS_DEPTH),
        )

    def hear(self, *names: str) -> None:
        """Do nothing: this client hears all the time."""

    def turn(self) -> None:
        """Wait for news, which whoever spins this node tells by ``notify``."""
        with self._news:
            self._news.wait(TICK)
        if self._leaving:
            raise Interrupted

    def notify(self) -> None:
        """Tell the waiting threads that something may have come."""
        with self._news:
            self._news.notify_all()

    def note(self, text: str) -> None:
        """Show a line on all pages."""
        self.lines.append((self.lines[-1][0] + 1 if self.lines else 1, text))

    def _on_parameters(self, event: ParameterEvent) -> None:
        space, _, name = event.node.rpartition("/")
        snapshot = self._snapshots.get(name)
        if (
            snapshot is not None
            and snapshot.values is not None
            and space == self.get_namespace().rstrip("/")
        ):
            changed = {
                entry.name: parameter_value_to_python(entry.value)
                for entry in event.changed_parameters
            }
            snapshot.values = snapshot.values | changed

    def each_second(self) -> None:
        """Ask for parameters that are not known; forget those of a node
        that has gone.
        """
        for name, snapshot in self._snapshots.items():
            if not self.fresh(name):
                snapshot.renew()
            else:
                snapshot.ask()

    def fresh(self, name: str) -> bool:
        """Return whether a node has told of itself lately."""
        return self.heard_since(name, time.monotonic() - SILENT)

    @property
    def values(self) -> dict[str, dict[str, ParameterValue]]:
        """The parameters of each node, as far as its table names them."""
        return {
            name: {
                spec.name: known[spec.name]
                for spec in PARAMETERS[name]
                if spec.name in known
            }
            for name, snapshot in self._snapshots.items()
            if (known := snapshot.values) is not None
        }

    def stop_now(self, answer: Answer) -> None:
        """Begin a safe stop, whatever else is under way; ``answer`` is called when the
        controller has answered.
        """

        def work() -> str:
            self.stop_controller()
            return "a stop was asked for"

        def drop() -> str:
            self.stop_server()
            return ""

        self._do("stop", work, answer)
        self._do("drop", drop, lambda *_: None)

    def go(self, values: Mapping[str, ParameterValue], answer: Answer) -> None:
        """Start a trip; ``answer`` is called when it has ended.

        Args:
            values: parameters of the trajectory server.
            answer: told whether it was done, and why not.

        Raises:
            NodesError: one is under way.
        """
        if self.progress is not None:
            raise NodesError(
                "a trip of this panel is under way: wait until it ends, or stop it"
            )
        self.progress = "planning", 0.0

        def show(text: str, share: float) -> None:
            self.progress = text, share

        def work() -> str:
            try:
                TripFollower(self, show, self.note).run(values)
            finally:
                self.progress = None
            return ""  # all is said

        self._do("trip", work, answer)

    def do(self, work: Job, answer: Answer) -> None:
        """Do what is asked of the robot at rest, one request after the other;
        ``answer`` is told its text, or why it was not done.
        """
        self._do("desk", work, answer)

    def put(self, node: str, values: Mapping[str, ParameterValue]) -> str:
        """Set live parameters of a node; the controller is built anew, without torque,
        for law and estimator. Return what they are now, in words.

        Args:
            node: its name.
            values: by name.

        Raises:
            ParameterError: there is no such parameter, or its value cannot be.
            NodesError: the node does not answer, or the controller moves the robot.
        """
        checked = _checked(node, values)
        anew = {name: checked.pop(name) for name in REBUILT if name in checked}
        if checked:
            self.set_parameters_of(node, checked)
        if anew:
            self._rebuild(anew)
        return "; ".join(
            f"'{name}' is {value}" for name, value in (checked | anew).items()
        )

    def activate(self) -> str:
        """Have a controller that was let go answer states again."""
        if self.controller.get("lifecycle") == "unconfigured":
            self._change("configure")
        self._change("activate")
        return "the controller is active"

    def record(self, on: bool, labels: Mapping[str, str]) -> str:
        """Begin a recording with this name and these notes, or end the one
        that is on; return what became of it, in words.
        """
        self.find("recorder")
        self.alone("recorder")
        self.set_parameters_of("recorder", labels)
        if (self.get("recorder", "recording") == "True") == on:
            return "name and notes are set"
        told = self.call(Trigger, f"recorder/{'start' if on else 'stop'}")
        if not told.success:
            raise NodesError(told.message)
        return told.message

    def _rebuild(self, values: Mapping[str, ParameterValue]) -> None:
        """Build the controller anew with another law or estimator: it lets go of the
        robot first, and asks for torque as at its start.
        """
        self.find("controller")
        self.alone("controller")
        if (phase := self.controller.get("phase", "")) in MOVING:
            what = ", ".join(values)
            raise NodesError(
                f"the controller is in phase {phase}; {what} can be changed once it"
                " holds or has stopped"
            )
        if self.controller["lifecycle"] == "active":
            self._change("deactivate")
        self._change("cleanup")
        try:
            self.set_parameters_of("controller", values)
        finally:
            self._change("configure")
            self._change("activate")

    def _change(self, label: str) -> None:
        answer = self.call(
            ChangeState, "controller/change_state", transition=Transition(label=label)
        )
        if not answer.success:
            raise NodesError(f"the controller does not {label}; its log says why")

    def _do(self, thread: str, work: Job, answer: Answer) -> None:
        """Work in a thread; two panels of one name would ask the same robot, so that is
        refused.
        """

        def run() -> None:
            try:
                if thread not in ("stop", "drop"):
                    self.alone("panel")
                text = work()
            except DextarError as error:
                answer(False, str(error))
            except Interrupted:
                answer(False, "the panel ends")
            except Exception as error:
                answer(False, f"that failed: {error!r}")
            else:
                answer(True, text)

        self._threads[thread].submit(run)

    def leave(self) -> None:
        """End the threads; the robot stays to the controller's own rules."""
        self._leaving = True
        for pool in self._threads.values():
            pool.shutdown(wait=True, cancel_futures=True)


def task_of(asked: Mapping[str, ParameterValue]) -> dict[str, ParameterValue]:
    """Return the trajectory server's parameters of a task that a page asks for.

    Args:
        asked: ``kind`` of KINDS; ``start`` and ``goal``, or ``point``, or ``count`` of
            a tour; ``duration``, ``repeat``.

    Raises:
        ParameterError: one is missing or is no number.
    """
    kind = asked["kind"]
    if kind not in KINDS:
        raise ParameterError(f"task {kind!r}; it must be one of {', '.join(KINDS)}")
    chosen = dict(
        tour=asked["count"] if kind == "tour" else 0,
        point=asked["point"] if kind == "point" else None,
        excite=None,
        duration=asked.get("duration"),
        repeat=asked.get("repeat"),
    )
    values = task_values(chosen) | {"task.start": asked["start"]}
    if kind == "trip":
        values["task.goal"] = asked["goal"]
    return _checked("trajectory_server", values)


def _checked(
    node: str, values: Mapping[str, ParameterValue]
) -> dict[str, ParameterValue]:
    """Return a node's parameters in the types of their defaults.

    Raises:
        ParameterError: there is no such parameter, or its value cannot be.
    """
    checked, defaults = {}, node_defaults(node)
    specs = {spec.name: spec for spec in PARAMETERS[node]} if node in SET else {}
    for name, value in values.items():
        if name not in specs:
            raise ParameterError(f"there is no parameter '{name}' of {node}")
        checked[name] = check_value(specs[name], value, defaults[name])
    return checked
