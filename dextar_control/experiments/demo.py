"""The demo: four nodes and the panel as separate processes, one return trip, its bag
analysed.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import gc
import importlib
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rich.progress import BarColumn, TimeElapsedColumn
from std_srvs.srv import SetBool

from dextar_control.contract import signals
from dextar_control.contract.errors import (
    BagError,
    DextarError,
    GeometryError,
    ParameterError,
)
from dextar_control.contract.former_names import present_names, renamed_in_words
from dextar_control.contract.node_parameters import PARAMETERS
from dextar_control.contract.resources import NODES_FILE, ROBOT_FILE, config_file
from dextar_control.contract.robot import PREFIX, RobotParameters, load_robot
from dextar_control.contract.terminal import (
    Steps,
    Terminal,
    TextColumn,
    say,
    spoken_warnings,
)
from dextar_control.contract.topics import DIAGNOSTICS
from dextar_control.contract.yaml_text import assignment, load_parameters, parse_value
from dextar_control.control.prepare import prepare
from dextar_control.executables import EXECUTABLES
from dextar_control.experiments.launch_arguments import PACE
from dextar_control.experiments.start_check import check_start
from dextar_control.model.model import Model
from dextar_control.nodekit.domain import choose_domain
from dextar_control.nodekit.node import check_value, qos
from dextar_control.nodes.progress import crossings, unhealthy
from dextar_control.nodes.task import Task
from dextar_control.symbols.types import Array

NODES = "recorder", "plant", "controller", "trajectory_server", "panel"
PANEL = "panel"  # a display is nobody's need: where it ends the demo goes on
CAMERA = {
    "external_pose.rate": 100.0,
    "external_pose.delay": 0.02,
    "external_pose.noise": 0.0002,
}  # of the plant, where the estimator wants one: Hz, s, m
PR_SET_PDEATHSIG = 1  # of Linux' prctl
STARTING = "starting the nodes"
START_TIMEOUT = 120.0  # s, on a busy machine
RUN_TIMEOUT = 20.0  # s beyond 20 times the trip's duration
STOP_TIMEOUT = 15.0  # s until a node that does not end is killed
LOADING_NICE = 10
SAME_PLACE = 1e-9  # m
LINGER = 0.2  # s of holding after the trip


class DemoError(DextarError):
    """The demo's processes did not do what was asked; the message says which and
    why.
    """


class _Monitor(Node):
    """Reads every node's diagnostics and lets the plant run."""

    def __init__(self) -> None:
        super().__init__("demo", enable_rosout=False, start_parameter_services=False)
        self.status: dict[str, dict[str, str]] = {}
        self.create_subscription(
            DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, qos(DIAGNOSTICS)
        )
        self._pause = self.create_client(SetBool, "plant/pause")

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name = status.name.rpartition("/")[2]
            self.status[name] = {item.key: item.value for item in status.values} | {
                "message": status.message
            }

    def get(self, node: str, key: str) -> str:
        """A node's last diagnostics value, empty when unknown."""
        return self.status.get(node, {}).get(key, "")

    @property
    def controller(self) -> dict[str, str]:
        """What the controller told last."""
        return self.status.get("controller", {})

    @property
    def plant_waits(self) -> bool:
        """Whether the plant is there, to be resumed."""
        return bool(self._pause.service_is_ready())

    def resume(self) -> None:
        """Let the simulated time run."""
        future = self._pause.call_async(SetBool.Request(data=False))
        rclpy.spin_until_future_complete(self, future, timeout_sec=10.0)
        if future.result() is None or not future.result().success:
            raise DemoError("the plant did not resume")


def _be_node(name: str, arguments: list[str], log: Path) -> None:
    """What a node's own process does; the kernel sends it SIGTERM when the demo dies,
    however it dies.
    """
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    os.setsid()
    for stream in (1, 2):
        os.dup2(os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644), stream)
    signals.install(signal.SIG_DFL)
    sys.argv = [name, "--ros-args", *arguments]
    sys.exit(EXECUTABLES[name]())


class _Processes:
    """The nodes' processes, their logs, and their end.

    They are forked: what all of them need is loaded once. So no thread may run here
        yet, and no ROS.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._fork = multiprocessing.get_context("fork")
        self._processes: dict[str, Any] = {}

    def start(self, name: str, arguments: list[str]) -> None:
        process = self._fork.Process(
            target=_be_node,
            args=(name, arguments, self._folder / f"{name}.log"),
            name=name,
        )
        process.start()
        self._processes[name] = process

    def check(self) -> None:
        for name, process in self._processes.items():
            code = process.exitcode
            if code is not None and name != PANEL:
                raise DemoError(self.describe_end(name, code))

    def describe_end(self, name: str, code: int) -> str:
        """How a node ended, in words."""
        if code < 0:
            return f"{name} was killed by {signal.Signals(-code).name}"
        return f"{name} ended with exit code {code}: {self.last_words(name)}"

    def last_words(self, name: str) -> str:
        lines = (
            (self._folder / f"{name}.log")
            .read_text(encoding="utf-8", errors="replace")
            .strip()
            .splitlines()
        )
        telling = [line for line in lines if "error" in line.lower()]
        return (telling or lines or ["nothing"])[-1]

    def interrupt(self, name: str) -> None:
        """Ask one node to end, without waiting for it."""
        process = self._processes.get(name)
        if process is not None and process.exitcode is None:
            os.kill(process.pid, signal.SIGINT)

    def stop(self, name: str) -> dict[str, int]:
        """End one node with SIGINT; SIGKILL when it does not. Its exit code, if it
        runs.
        """
        self.interrupt(name)
        process = self._processes.pop(name, None)
        if process is None:
            return {}
        process.join(STOP_TIMEOUT)
        if process.exitcode is None:
            process.kill()
            process.join()
        return {name: process.exitcode}

    def stop_loop(self) -> dict[str, int]:
        """Controller first, recorder last: it keeps what the others say at their
        end.
        """
        self.stop(PANEL)
        return {
            **self.stop("controller"),
            **self.stop("plant"),
            **self.stop("recorder"),
        }

    def stop_all(self) -> dict[str, int]:
        """Commander before all others; it may still draw when they have ended."""
        return {**self.stop("trajectory_server"), **self.stop_loop()}


def run_demo(arguments: argparse.Namespace) -> int:
    """Run the demo of parsed arguments (see ``dextar demo --help``); the exit code."""
    console = Terminal()
    files = _parameter_files(arguments)
    robot = load_robot(files["controller"][0])
    values = _node_values(arguments)
    changes = {node: _changes(node, own) for node, own in values.items()}
    settings = {
        node: check_start(node, own, *files[node]) for node, own in changes.items()
    }
    start, stands = (
        settings["trajectory_server"]["task.start"],
        settings["plant"]["task.start"],
    )
    if arguments.point is not None:
        start = stands = _stand_at_start(
            console, robot, Task.from_values(settings["trajectory_server"]), values
        )
    if "task.start" not in changes["plant"]:
        other = {
            name.removeprefix(PREFIX): value
            for name, value in changes["plant"].items()
            if name.startswith(PREFIX)
        }
        place = _place_as_read(
            robot, load_robot(files["plant"][0]).replace(**other), start
        )
        if np.hypot(*(place - stands)) > SAME_PLACE:
            values["plant"].append(assignment("task.start", place.tolist()))
    folder = _make_folder(arguments.output)
    values["recorder"].append(assignment("output", folder / "run.mcap"))
    values["trajectory_server"].append(assignment("drawing", folder / "plan.png"))
    ros_arguments = _node_arguments(values, files)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain = choose_domain()
    waiting = (
        "as fast as possible"
        if arguments.pace == 0.0
        else "each step waits for its command"
    )
    mode = "real time" if arguments.real_time else waiting
    chosen = "".join(
        f"{name} {getattr(arguments, name)}, "
        for name in ("law", "estimator")
        if getattr(arguments, name)
    )
    said = f"{chosen}{mode}, ROS_DOMAIN_ID={domain}, into {folder}"
    console.print(said, soft_wrap=True)
    prepare(Model.of(robot).mechanism)
    gc.freeze()
    troubles: list[str] = []
    processes = _Processes(folder)
    with contextlib.ExitStack() as stack:
        stack.callback(processes.stop_all)
        for name in NODES:
            processes.start(name, ros_arguments[name])
        with _monitor() as monitor:
            _wait_until_ready(console, monitor, processes)
            _link_latest(folder)
            if (
                not arguments.real_time
            ):  # there what else is done could make commands late
                threading.Thread(target=_load_analysis, daemon=True).start()
            try:
                monitor.resume()
                _follow(console, monitor, processes)
            except DemoError as error:
                troubles.append(str(error))
            for name in ("trajectory_server", PANEL):
                processes.interrupt(name)
            ended = processes.stop_loop()
        from dextar_control.analysis.report import analyze, brief_table

        try:
            with spoken_warnings("demo"):
                metrics = analyze(
                    folder / "run.mcap",
                    judged=lambda metrics: console.print(brief_table(metrics)),
                )
        except BagError as error:
            raise BagError("; ".join([*troubles, str(error)])) from error
        ended |= processes.stop("trajectory_server")
    troubles += [
        processes.describe_end(name, code) for name, code in ended.items() if code
    ]
    for line in dict.fromkeys(troubles):
        console.print(line, style="bold")
    console.print(
        f"{folder}: plan.png run.mcap metrics.json figure.png report.html",
        soft_wrap=True,
    )
    return 0 if metrics.success and not troubles else 1


def _load_analysis() -> None:
    """Load what judges and draws the run while the robot moves, behind everything else
    that wants the processor.
    """
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), LOADING_NICE)
    for module in ("report", "figure", "page"):
        importlib.import_module(f"dextar_control.analysis.{module}")


def _node_values(arguments: argparse.Namespace) -> dict[str, list[str]]:
    """NAME:=VALUE of each node."""
    given: dict[str, dict[str, Any]] = {name: {} for name in NODES}
    given["plant"] |= {
        "mode": "realtime" if arguments.real_time else "lockstep",
        "simulation.start_paused": True,
    }
    given["plant"] |= (
        {}
        if arguments.pace is None
        else {"simulation.real_time_factor": check_value(PACE, arguments.pace, 0.0)}
    )
    given["plant"] |= {"window": True} if arguments.window else {}
    given["controller"] |= {"lockstep": not arguments.real_time}
    given["trajectory_server"] |= {"autostart": True}
    for name in ("law", "estimator"):
        if getattr(arguments, name) is not None:
            given["controller"][name] = getattr(arguments, name)
    if arguments.estimator == "external":
        given["plant"] |= CAMERA
    if arguments.law == "multi_model":
        given["trajectory_server"]["task.criterion"] = "zero_wrench"
    for name in ("duration", "repeat", "tour", "excite", "point"):
        if getattr(arguments, name) is not None:
            given["trajectory_server"][f"task.{name}"] = getattr(arguments, name)
    values = {
        node: [assignment(*item) for item in own.items()] for node, own in given.items()
    }
    typed: dict[str, dict[str, str]] = {name: {} for name in NODES}
    for override in arguments.overrides:
        node, dot, rest = override.partition(".")
        if not dot or node not in NODES or ":=" not in rest:
            raise ParameterError(
                f"-p {override}: expected NODE.NAME:=VALUE with NODE one of"
                f" {', '.join(NODES)}"
            )
        name, _, value = rest.partition(":=")
        parse_value(value, f"-p {override}")
        typed[node][name] = value
    renamed: dict[str, str] = {}
    for node, own in typed.items():
        present, found = present_names(PARAMETERS[node], own)
        values[node] += [f"{name}:={value}" for name, value in present.items()]
        renamed |= found
    if renamed:
        say(f"dextar demo: {renamed_in_words(renamed)}")
    return values


def _changes(node: str, texts: Sequence[str]) -> dict[str, Any]:
    """The values in NAME:=VALUE of one node."""
    parts = [text.partition(":=") for text in texts]
    return {
        name: parse_value(value, f"-p {node}.{name}:={value}")
        for name, _, value in parts
    }


def _stand_at_start(
    console: Terminal, robot: RobotParameters, task: Task, values: dict[str, list[str]]
) -> list[float]:
    """Plan the trip through the point, so that the robot can be put where it begins, m,
    and on that side of the locus.

    The trajectory server makes the same plan again.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Steps(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("planning", total=1.0)
        plan = task.plan(
            robot,
            lambda fraction, stage: progress.update(
                bar, completed=fraction, description=stage
            ),
        )
    start = plan.trajectory.at(0.0).x.tolist()
    for name in ("plant", "trajectory_server"):
        values[name].append(assignment("task.start", start))
    direction = round(plan.certificate.crossing_signs[0])
    values["trajectory_server"].append(assignment("task.direction", direction))
    values["controller"].append(assignment("assembly_mode", -direction))
    return start


def _place_as_read(
    robot: RobotParameters, true: RobotParameters, start: Sequence[float]
) -> Array:
    """(2,) m, where a simulated robot stands whose encoders read what the described
    one's do where the trip starts.
    """
    x, model = np.array(start), Model.of(robot)
    q_a = (
        model.inverse_geometric_model(x)
        + np.array(robot.encoder_offset)
        - np.array(true.encoder_offset)
    )
    try:
        return Model.of(true).close(q_a, float(np.sign(model.place(x).s[0])))
    except GeometryError as error:
        raise ParameterError(
            "the simulated robot cannot stand where its encoders read the trip's"
            f" start: {error}"
        ) from error


def _parameter_files(arguments: argparse.Namespace) -> dict[str, tuple[Path, Path]]:
    """The files of the robot and of the nodes' parameters, which each node reads for
    itself.
    """
    robot, nodes = (
        arguments.robot or config_file(ROBOT_FILE),
        arguments.params or config_file(NODES_FILE),
    )
    true = arguments.plant_robot or robot
    for path, what in (
        (robot, "robot file"),
        (true, "robot file"),
        (nodes, "parameter file"),
    ):
        if path.exists() and not path.is_dir() and not path.is_file():
            raise ParameterError(
                f"{what} {path} is a pipe or a device; each node reads it, so it must"
                " be a file"
            )
        load_parameters(path, what=what)
    return {name: (true if name == "plant" else robot, nodes) for name in NODES}


def _node_arguments(
    values: dict[str, list[str]], files: dict[str, tuple[Path, Path]]
) -> dict[str, list[str]]:
    """The ROS arguments of each node."""
    # with the node's name: a plain -p counts as /**, which a file's section for the
    # node overrides
    return {
        name: [
            *(part for path in files[name] for part in ("--params-file", str(path))),
            *(part for value in values[name] for part in ("-p", f"{name}:{value}")),
        ]
        for name in NODES
    }


def _make_folder(output: Path) -> Path:
    stamp = datetime.now(timezone.utc).strftime("%Y%m%dT%H%M%SZ")
    folder = output / stamp
    try:
        number = 1
        while folder.exists():
            number += 1
            folder = output / f"{stamp}-{number}"
        folder.mkdir(parents=True)
    except OSError as error:
        raise BagError(
            f"run folder {folder} cannot be made: {error.strerror}; name another with"
            " --output"
        ) from error
    return folder


def _link_latest(folder: Path) -> None:
    """``latest`` beside the run's folder leads to it, once the run has begun."""
    latest = folder.parent / "latest"
    try:
        if latest.is_symlink():
            latest.unlink()
        if not latest.exists():
            latest.symlink_to(folder.name)
    except OSError as error:
        raise BagError(
            f"link {latest} cannot be made: {error.strerror}; name another folder with"
            " --output"
        ) from error


@contextlib.contextmanager
def _monitor() -> Iterator[_Monitor]:
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    monitor = _Monitor()
    try:
        yield monitor
    finally:
        monitor.destroy_node()
        rclpy.try_shutdown()


def _wait_until_ready(
    console: Terminal, monitor: _Monitor, processes: _Processes
) -> None:
    """Recorder recording with everybody's parameters, trajectory accepted, plant
    paused.
    """
    deadline, told = time.monotonic() + START_TIMEOUT, False
    with console.working(STARTING) as working:
        while True:
            rclpy.spin_once(monitor, timeout_sec=0.1)
            processes.check()
            note, address = (
                monitor.get("controller", "trajectory"),
                monitor.get(PANEL, "address"),
            )
            planning = monitor.get("trajectory_server", "planning")
            working.now(f"planning: {planning}" if planning else STARTING)
            if refusal := monitor.get("trajectory_server", "error"):
                raise DemoError(f"the trajectory server: {refusal}")
            if note.startswith("refused"):
                raise DemoError(f"the controller {note}")
            if address and not told:
                told = True
                console.print(
                    f"while it runs, watch and drive it at {address}", soft_wrap=True
                )
            recording = monitor.get("recorder", "parameters_missing") == "none"
            active = monitor.get("controller", "lifecycle") == "active"
            if recording and active and note == "accepted" and monitor.plant_waits:
                return
            if time.monotonic() > deadline:
                known = ", ".join(sorted(monitor.status)) or "none"
                raise DemoError(
                    f"the nodes were not ready within {START_TIMEOUT:.0f} s; heard of:"
                    f" {known}"
                )


def _follow(console: Terminal, monitor: _Monitor, processes: _Processes) -> None:
    """Progress until the trip is done or the controller gave up."""
    deadline = time.monotonic() + RUN_TIMEOUT
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    with Steps(*columns, console=console) as progress:
        task = progress.add_task("waiting", total=1.0)
        known_duration = 0.0
        while True:
            rclpy.spin_once(monitor, timeout_sec=0.1)
            processes.check()
            duration = float(monitor.get("controller", "duration") or 0.0)
            if duration > known_duration:
                known_duration = duration
                deadline = time.monotonic() + RUN_TIMEOUT + 20.0 * duration
            told, phase = monitor.controller, monitor.get("controller", "phase")
            note = monitor.get("controller", "trajectory")
            if note.startswith("refused"):
                raise DemoError(f"the controller {note}")
            if waits := unhealthy(told):
                progress.update(task, description=f"waiting{waits}")
            if duration > 0.0:
                elapsed = float(monitor.get("controller", "reference_time") or 0.0)
                progress.update(
                    task,
                    description=f"{phase:<9} {crossings(told)}",
                    completed=min(elapsed / duration, 1.0),
                )
            if monitor.get("controller", "completed") not in ("", "0"):
                progress.update(
                    task, description=f"done      {crossings(told)}", completed=1.0
                )
                break
            if phase in ("SAFE_STOP", "FAULT"):
                progress.update(task, description=f"{phase} {crossings(told)}")
                break
            if time.monotonic() > deadline:
                raise DemoError(
                    "the trip did not end in time; the controller is in phase"
                    f" {phase}{unhealthy(told)}"
                )
    end = time.monotonic() + (
        1.5 if monitor.get("controller", "phase") == "SAFE_STOP" else LINGER
    )
    while time.monotonic() < end:
        rclpy.spin_once(monitor, timeout_sec=0.05)
