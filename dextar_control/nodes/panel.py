"""The panel is one page in the browser that watches and drives a robot; nothing on the
control path waits for it.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.executors import Executor
from std_srvs.srv import SetBool, Trigger

from dextar_control.contract import style
from dextar_control.contract.errors import DextarError, ParameterError
from dextar_control.contract.node_parameters import PARAMETERS
from dextar_control.contract.parameters import Parameter
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.resources import node_defaults
from dextar_control.contract.signals import StopSignal
from dextar_control.contract.topics import (
    CONTROLLER_STATE,
    CRITERION,
    JOINT_STATES,
    PHASES,
)
from dextar_control.control.supervisor import WATCHES
from dextar_control.nodekit.cdr import NANOSECONDS, from_time
from dextar_control.nodekit.job_queue import GivenUp, JobQueue
from dextar_control.nodekit.node import DextarNode, run_node
from dextar_control.nodekit.scheduling import stand_back
from dextar_control.nodes.newest import NewestSamples
from dextar_control.nodes.panel_operator import SET, PanelOperator, task_of
from dextar_control.nodes.scene import Scene, View
from dextar_control.nodes.task import Task, in_words, place_told, plan_from
from dextar_control.panel.server import PanelServer, Reply
from dextar_control.panel.words import shown_margins, trouble_and_remedy
from dextar_control.planning.locus import LocusPoint, nearest_point
from dextar_control.symbols.types import Array

Told = Callable[[bool, str, Mapping[str, object]], None]
# Of the command ``dextar panel``, for short: what ROS calls them.
OPTIONS = {
    "--host": ("-p", "panel:host:="),
    "--port": ("-p", "panel:port:="),
    "--namespace": ("-r", "__ns:="),
}
UNITS = {watch.name: watch.unit for watch in WATCHES}

STATUS_PERIOD = 0.2  # s
LISTENING = 2.5  # s from the panel's begin within which silence says nothing
DIAGNOSTICS_PERIOD = 1.0  # s
# s by which the controller's last word is behind the last joint state, from which on it
# tells no phase
SILENCE = 0.1
HEARING = 0.1  # s of the executor's longest wait
DIGITS = 6  # of numbers that are shown: 1 µm, 1 µN m
PATH_POINTS = 400  # of a path that is drawn
PLAN_POINTS = 500  # of a plan's torque over time
SHOWN = (  # of the controller's diagnostics
    "lifecycle",
    "phase",
    "reason",
    "enabling",
    "law",
    "estimator",
    "trajectory",
    "waiting_for",
    "crossings",
    "begun",
    "verdicts",
    "confidences",
    "largest_error",
    "reference_time",
    "duration",
    "stopped",
    "mode_known",
    "mode_confidence",
    "distance_to_locus",
    "rate",
    "jitter_us",
    "missed_states",
    "stalls",
    "latency_p99_us",
    "saturated_share",
    "x",
    "y",
    "s",
)


class PanelNode(DextarNode):
    """Serves a page that shows the robot as it moves and, to one driver at a time,
    starts, stops and sets it.

    It asks the nodes what ``dextar go``, ``stop``, ``enable`` and ``reset`` ask, by the
    same code. While nobody looks on it reads no topic but diagnostics. Its readers keep
    one sample and ask for no repetition.
    """

    NAME = "panel"
    PARAMETERS = PARAMETERS[NAME]
    SHORT = (
        ("--host HOST, --port PORT", "short for -p host:=HOST, -p port:=PORT"),
        ("--namespace NS", "short for -r __ns:=NS: the robot of that namespace"),
    )

    def __init__(self) -> None:
        super().__init__()
        self._scene = Scene(self.robot)
        self._newest = NewestSamples(self)
        self.operator = PanelOperator(self.get_namespace())
        self._jobs = JobQueue()
        self._wanted: object | None = None  # the plan that is looked at
        self._reporting: asyncio.Task[None] | None = None
        self._report: Path | None = None
        self._bag = ""
        self._complaint = ""
        self._shown = 0
        self._began = time.monotonic()
        self._loop: asyncio.AbstractEventLoop | None = None
        self.server = PanelServer(self, self.values["host"], self.values["port"])
        if self.server.moved:
            self.get_logger().warning(
                f"port {self.values['port']} is taken, perhaps by another panel"
            )
        self.get_logger().info(f"the panel is at {self.server.address}")

    def setup(self) -> dict[str, object]:
        """Return what a page draws once: robot, locus, and what may be set."""
        low, high = self._scene.workspace
        arcs = [
            {"family": arc.family.name.lower(), "x": _rounded(arc.x[::4])}
            for arc in self._scene.arcs
        ]
        specs = {node: [_spec(node, spec) for spec in PARAMETERS[node]] for node in SET}
        lines = {
            f"{kind}{part}": line._asdict()
            for (kind, part), line in style.LINES.items()
        }
        return {
            "robot": self.robot.name,
            "namespace": self.get_namespace(),
            "low": low,
            "high": high,
            "arcs": arcs,
            "motors": _rounded(self._scene.motors),
            "limit": self.robot.max_torque,
            "specs": specs,
            "lines": lines,
            "phases": PHASES,
            "palettes": {"light": style.LIGHT, "dark": style.DARK},
            "rate": self.values["rate"],
        }

    def watched(self, viewers: int) -> None:
        """Read topics while somebody looks on."""
        if viewers and not self._newest:
            self._newest.open()
        elif not viewers and self._newest:
            self._newest.close()

    def told(self, text: str) -> None:
        """Tell a text in the log and on the pages."""
        self.get_logger().warning(text, throttle_duration_sec=1.0)
        self.operator.note(text)

    def report(self) -> Path | None:
        """Return the report that was made last."""
        return self._report

    def ask(
        self, name: str, asked: Mapping[str, ParameterValue], answer: Reply
    ) -> None:
        """Do what the driver asks for; see ``panel_operator``.

        Args:
            name: of the request.
            asked: what the page sent with it.
            answer: told in the server's thread what became of it.

        Raises:
            KeyError: there is no such request, or a value is missing.
        """
        assert self._loop is not None
        loop, me = self._loop, self.operator

        def told(ok: bool, text: str, more: Mapping[str, object] | None = None) -> None:
            with contextlib.suppress(RuntimeError):  # the panel has ended meanwhile
                loop.call_soon_threadsafe(answer, ok, text, more or {})

        def desk(work: Callable[[], str]) -> None:
            me.do(work, told)

        requests: dict[str, Callable[[], None]] = {
            "stop": lambda: me.stop_now(told),
            "enable": lambda: desk(
                partial(me.ask_controller, SetBool, "enable", data=_flag(asked, "on"))
            ),
            "reset": lambda: desk(partial(me.ask_controller, Trigger, "reset")),
            "activate": lambda: desk(me.activate),
            "go": lambda: me.go(task_of(asked), told),
            "set": lambda: desk(partial(me.put, asked["node"], asked["values"])),
            "record": lambda: desk(
                partial(
                    me.record,
                    _flag(asked, "on"),
                    {f"run.{key}": str(asked[key]) for key in ("name", "notes")},
                )
            ),
            "plan": lambda: self._plan(task_of(asked), told),
            "near": lambda: self._near(asked["point"], told),
            "report": lambda: self._make_report(told),
        }
        if name not in requests:
            raise KeyError(name)
        requests[name]()

    def _plan(self, changes: Mapping[str, ParameterValue], told: Told) -> None:
        """Plan as the trajectory server would, from where the robot stands; a newer
        request ends an older one.
        """
        server = self.operator.values.get("trajectory_server", {})
        values = {**node_defaults("trajectory_server"), **server, **changes}
        wanted = self._wanted = object()
        task, origin = Task.from_values(values), place_told(self.operator.controller)

        def progress(fraction: float, stage: str) -> None:
            if self._wanted is not wanted:
                raise GivenUp("another plan is wanted")
            self._jobs.progress(fraction, stage)

        def work() -> dict[str, object]:
            progress(0.0, "planning")
            plan = task.plan(self.robot, progress)
            if origin is not None:
                plan = plan_from(
                    self.robot, origin, plan, values["task.approach_speed"]
                )
            seen = plan.certificate
            rows = np.unique(
                np.linspace(0, len(seen.profile.time) - 1, PLAN_POINTS).astype(int)
            )
            return {
                "path": _rounded(seen.profile.x[rows]),
                "time": _rounded(seen.profile.time[rows]),
                "torque": _rounded(seen.profile.torque[rows]),
                "limit": self.robot.max_torque,
                "peak": seen.peak_torque,
                "duration": seen.duration,
                "words": in_words(seen),
                "crossings": [
                    {
                        "time": one.time,
                        "x": one.x,
                        "family": one.family,
                        "sign": one.sign,
                    }
                    for one in seen.crossings
                ],
            }

        def done(plan: dict[str, object] | None, error: DextarError | None) -> None:
            if plan is None:
                instead = error.instead if error else {}
                given_up = isinstance(error, GivenUp)
                told(False, str(error), {"instead": instead, "given_up": given_up})
            else:
                told(True, "this can be driven", {"plan": plan})

        self._jobs.submit(work, done)

    def _near(self, point: Sequence[float], told: Told) -> None:
        """Find the point of the locus nearest to a place, (2,), m."""
        x = np.array(point, dtype=float)

        def done(found: LocusPoint | None, error: DextarError | None) -> None:
            told(
                error is None,
                str(error or "the nearest point of the locus"),
                {} if found is None else {"point": _rounded(found.x)},
            )

        self._jobs.submit(lambda: nearest_point(self.robot, x), done)

    def _make_report(self, told: Told) -> None:
        """Have the last recording analysed, in a process of its own."""
        if not self._bag:
            raise DextarError(
                "no recording is known: this panel has not heard of one since it began"
            )
        if self._reporting is not None and not self._reporting.done():
            raise DextarError("the report is being made")
        self._reporting = asyncio.ensure_future(self._analyze(Path(self._bag), told))

    async def _analyze(self, bag: Path, told: Told) -> None:
        module = "dextar_control.cli.main"
        command = ["nice", "-n", "10", sys.executable, "-m", module, "analyze"]
        process = await asyncio.create_subprocess_exec(
            *(*command, str(bag)),
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
        )
        _, errors = await process.communicate()
        said = errors.decode(errors="replace").strip().splitlines()
        page = bag.parent / "report.html"
        # 1: the run is no success, or not whole
        if process.returncode in (0, 1) and page.is_file():
            self._report = page
            told(True, f"{page} is made", {"report": True})
        else:
            ended = f"the analysis of {bag} ended with exit code {process.returncode}"
            told(False, said[-1] if said else ended, {})

    def show(self) -> None:
        """Send the newest sample to all pages."""
        if not self._newest:
            return
        try:
            if (taken := self._newest.take()) is not None:
                self._scene.set_path(*taken)
                self.send_path()
            view = self._newest.view()
            state = None if view is None else self._state(view)
            self._complaint = ""
        except DextarError as error:
            self._complaint = str(error)
            return
        if state is not None:
            self.server.send("state", state)
            self._shown += 1

    def send_path(self) -> None:
        """Send the path that is served to all pages."""
        thin = max(1, len(self._scene.path) // PATH_POINTS)
        self.server.send(
            "path",
            {
                "path": _rounded(self._scene.path[::thin]),
                "crossings": _rounded(self._scene.crossings),
            },
            keep=True,
        )

    def _state(self, view: View) -> dict[str, object]:
        x = self._scene.platform(view)
        t_s, s = self._scene.kernel(view, x)
        seen, scalars = self._newest.seen, view.scalars
        joints, told = seen[JOINT_STATES.name], seen.get(CONTROLLER_STATE.name)
        stamp, points = joints.header.stamp, [] if told is None else told.points
        error: float = np.nan
        if len(points) > 2:
            error = float(np.linalg.norm(points[2].positions))
        torque = dict(zip(joints.name, joints.effort, strict=False))
        behind = 0.0
        if scalars:
            behind = (
                from_time(stamp) - from_time(seen[CRITERION.name].header.stamp)
            ) / NANOSECONDS
        return {
            "time": round(from_time(stamp) / NANOSECONDS, 3),
            "stale": view.stale,
            "phase": self._scene.phase(view) if abs(behind) < SILENCE else "",
            "links": _rounded(self._scene.linkage(view.q_a, x)),
            "x": _rounded(x),
            "reference": _rounded(view.x_ref),
            "t_s": _rounded(t_s),
            "s": _round(s),
            "torque": [_round(torque.get(name, np.nan)) for name in ("q11", "q21")],
            "limit": _round(scalars.get("torque_limit", np.nan)),
            "error": _round(error),
            "residual": _round(scalars.get("residual", np.nan)),
            "confidence": _round(scalars.get("mode_confidence", np.nan)),
            "mode": _round(scalars.get("assembly_mode", np.nan)),
            "verdict": _round(scalars.get("verdict", 0.0)),
        }

    def status(self) -> None:
        """Send what the nodes tell of themselves to all pages."""
        me = self.operator
        told = me.controller if me.fresh("controller") else {}
        plant, recorder = (
            me.status.get(name, {}) if me.fresh(name) else {}
            for name in ("plant", "recorder")
        )
        self._bag = recorder.get("bag", self._bag)
        if not self.server.pages:
            return
        nodes = {
            name: {"message": values["message"], "level": int(values["level"])}
            for name, values in me.status.items()
            if me.fresh(name)
        }
        listening = not nodes and time.monotonic() - self._began < LISTENING
        why, action = trouble_and_remedy(self.get_namespace(), told, nodes, listening)
        lost = sum(
            int(value)
            for key, value in recorder.items()
            if key.endswith(" lost") and value.isdigit()
        )
        self.server.send(
            "status",
            {
                "controller": _known(told, *SHOWN),
                "why": why,
                "action": action,
                "margins": shown_margins(told, UNITS),
                "listening": listening,
                "nodes": nodes,
                "values": me.values,
                "complaint": self._complaint,
                "plant": _known(
                    plant, "mode", "real_time_factor", "late_ticks", "steps"
                ),
                "recorder": {
                    **_known(recorder, "recording", "bag", "bytes", "name"),
                    "lost": lost,
                },
                "bag": self._bag,
                "reported": self._report is not None,
                "progress": me.progress,
                "lines": list(me.lines),
                "planning": self._jobs.stage,
            },
            keep=True,
        )

    def diagnose(self) -> None:
        """Publish diagnostics."""
        address = self.server.address.partition("?")[0]
        self.publish_diagnostics(
            DiagnosticStatus.OK,
            f"at {address}",
            {
                "address": address,
                "viewers": len(self.server.pages),
                "driven": self.server.driver is not None,
                "shown": self._shown,
            },
        )

    async def serve(self, ended: Callable[[], bool]) -> None:
        """Show, tell and answer until it ends."""
        self._loop = asyncio.get_running_loop()
        self.server.begin()
        period = 1.0 / self.values["rate"]
        due = {self.status: 0.0, self.diagnose: 0.0, self.operator.each_second: 0.0}
        periods = {self.status: STATUS_PERIOD}
        following = time.monotonic()
        while not ended():
            now = time.monotonic()
            self._jobs.poll()
            self.show()
            for work, moment in due.items():
                if now >= moment:
                    due[work] = now + periods.get(work, DIAGNOSTICS_PERIOD)
                    work()
            following = max(following + period, now)
            await asyncio.sleep(following - now)

    def close(self) -> None:
        """Let go of the pages; the robot stays to the controller's own rules."""
        self._jobs.close()
        self.operator.leave()
        self.diagnose()

    def destroy_node(self) -> None:
        """Leave the graph, with the operator's client."""
        self.operator.destroy_node()
        super().destroy_node()


def _known(values: Mapping[str, str], *names: str) -> dict[str, str]:
    return {name: values[name] for name in names if name in values}


def _round(value: float) -> float:
    return round(float(value), DIGITS) + 0.0  # no minus nothing


def _rounded(values: Array) -> list[object]:
    rounded: list[object] = np.round(values, DIGITS).tolist()
    return rounded


def _spec(node: str, spec: Parameter) -> dict[str, object]:
    """Return a parameter as a page sets it."""
    default = node_defaults(node)[spec.name]
    return {**spec.__dict__, "default": default}


def _flag(asked: Mapping[str, ParameterValue], name: str) -> bool:
    value = asked[name]
    if not isinstance(value, bool):
        raise ParameterError(f"'{name}' = {value!r}; it must be true or false")
    return value


def spin(node: PanelNode, executor: Executor, stop: StopSignal) -> None:
    """Run the server in this thread and ROS in another, until a signal."""
    executor.add_node(node.operator)
    ended = threading.Event()

    def hear() -> None:
        while not ended.is_set():
            executor.spin_once(timeout_sec=HEARING)
            node.operator.notify()

    async def serve() -> None:
        try:
            await node.serve(lambda: bool(stop) or node.finished)
        finally:
            node.server.close()

    hearing = threading.Thread(target=hear, name="ros")
    hearing.start()
    try:
        asyncio.run(serve())
    finally:
        node.operator.leave()
        ended.set()
        hearing.join()
        executor.remove_node(node.operator)


def ros_arguments(words: list[str]) -> list[str]:
    """Return ``--host H``, ``--port N`` and ``--namespace NS`` as ROS arguments;
    everything else stays as it is.
    """
    own: list[str] = []
    rest = list(words)
    while len(rest) > 1 and rest[0] in OPTIONS:
        flag, rule = OPTIONS[rest.pop(0)]
        own += [flag, rule + rest.pop(0)]
    return ["--ros-args", *own, "--", *rest] if own else rest


def main(args: list[str] | None = None) -> int:
    """Run the panel, at a priority that does not interrupt what moves the robot; return
    the exit code.
    """
    stand_back()
    return run_node(
        PanelNode, ros_arguments(sys.argv[1:] if args is None else args), spin
    )


if __name__ == "__main__":
    sys.exit(main())
