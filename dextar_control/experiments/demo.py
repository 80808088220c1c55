"""The demo starts four nodes and the panel, has one return trip made, and analyses its
bag.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import importlib
import os
import signal
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.progress import BarColumn, TimeElapsedColumn
from std_srvs.srv import SetBool

from dextar_control.contract.errors import (
    BagError,
    GeometryError,
    NodesError,
    ParameterError,
)
from dextar_control.contract.former_names import present_names, renamed_in_words
from dextar_control.contract.node_parameters import PARAMETERS
from dextar_control.contract.parameters import check_value
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.plug_in import chosen, is_own
from dextar_control.contract.resources import NODES_FILE, ROBOT_FILE, config_file
from dextar_control.contract.robot import PREFIX, RobotParameters, load_robot
from dextar_control.contract.settings import Settings
from dextar_control.contract.terminal import (
    Steps,
    Terminal,
    TextColumn,
    say,
    spoken_warnings,
)
from dextar_control.contract.yaml_text import assignment, load_parameters, parse_value
from dextar_control.control.law import LAWS, law_of
from dextar_control.control.prepare import prepare
from dextar_control.estimation.estimator import ESTIMATORS, make_estimator
from dextar_control.experiments.launch_arguments import PACE
from dextar_control.experiments.processes import Processes, node_arguments
from dextar_control.experiments.run_folder import make_run_folder
from dextar_control.experiments.start_check import check_start, renamed_in_files
from dextar_control.model.model import Model
from dextar_control.nodekit.client import NodeClient, monitoring
from dextar_control.nodekit.domain import choose_domain
from dextar_control.nodes.progress import crossings, unhealthy
from dextar_control.nodes.task import Task
from dextar_control.symbols.types import Array

NODES = "recorder", "plant", "controller", "trajectory_server", "panel"
OWN = "law", "estimator"  # which may be the user's code
PANEL = "panel"  # a display is nobody's need: where it ends the demo goes on
# of the plant, where the estimator wants one: Hz, s, m
CAMERA = {
    "external_pose.rate": 100.0,
    "external_pose.delay": 0.02,
    "external_pose.noise": 0.0002,
}
STARTING = "starting the nodes"
START_TIMEOUT = 120.0  # s, on a busy machine
RUN_TIMEOUT = 20.0  # s beyond 20 times the trip's duration
LOADING_NICE = 10
SAME_PLACE = 1e-9  # m
LINGER = 0.2  # s of holding after the trip
SAFE_STOP_LINGER = 1.5  # s in which a safe stop is over


def run_demo(arguments: argparse.Namespace) -> int:
    """Run the demo of parsed arguments (see ``dextar demo --help``); return the exit
    code.
    """
    console = Terminal()
    files = _parameter_files(arguments)
    robot = load_robot(files["controller"][0])
    values, renamed = _node_values(arguments)
    changes = {node: _changes(node, own) for node, own in values.items()}
    settings = {
        node: check_start(node, own, *files[node]) for node, own in changes.items()
    }
    for node in NODES:
        renamed |= renamed_in_files(node, *files[node])
    if renamed:
        say(f"dextar demo: {renamed_in_words(renamed)}")
    task = Task.from_values(settings["trajectory_server"])
    task.check(robot)
    _check_own(robot, settings["controller"])
    start, stands = np.array(task.start), np.array(settings["plant"]["task.start"])
    if arguments.point is not None:
        start = stands = _stand_at_start(console, robot, task, values)
    if "task.start" not in changes["plant"]:
        other = {
            name.removeprefix(PREFIX): value
            for name, value in changes["plant"].items()
            if name.startswith(PREFIX)
        }
        true = load_robot(files["plant"][0]).replace(**other)
        place = _place_as_read(robot, true, start)
        if np.hypot(*(place - stands)) > SAME_PLACE:
            values["plant"].append(assignment("task.start", place.tolist()))
    prepare(Model.of(robot).mechanism)
    folder = make_run_folder(arguments.output)
    values["recorder"].append(assignment("output", folder / "run.mcap"))
    values["trajectory_server"].append(assignment("drawing", folder / "plan.png"))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain = choose_domain()
    waiting = (
        "as fast as possible"
        if arguments.pace == 0.0
        else "each step waits for its command"
    )
    mode = "real time" if arguments.real_time else waiting
    picked = ", ".join(f"{name} {settings['controller'][name]}" for name in OWN)
    said = f"{picked}, {mode}, ROS_DOMAIN_ID={domain}, into {folder}"
    console.print(said, soft_wrap=True)
    gc.freeze()
    troubles: list[str] = []
    with Processes(folder, forked=True) as processes:
        for name in NODES:
            processes.start(name, node_arguments(name, values[name], files[name]))
        processes.may_end(PANEL)
        with monitoring("demo") as monitor:
            _wait_until_ready(console, monitor, processes)
            _link_latest(folder)
            if not arguments.real_time:  # where it could make commands late
                threading.Thread(target=_load_analysis, daemon=True).start()
            try:
                resumed = monitor.call(SetBool, "plant/pause", data=False)
                if not resumed.success:
                    raise NodesError(f"the plant did not resume: {resumed.message}")
                _follow(console, monitor, processes)
            except NodesError as error:
                troubles.append(str(error))
            for name in ("trajectory_server", PANEL):  # they may draw while others end
                processes.send(name, signal.SIGINT)
            processes.stop(PANEL)
            ended = processes.stop("controller", "plant", "recorder")
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


def _node_values(
    arguments: argparse.Namespace,
) -> tuple[dict[str, list[str]], dict[str, str]]:
    """List NAME:=VALUE of each node, under present names, and the former names that
    were typed with the present ones.
    """
    given: dict[str, dict[str, object]] = {name: {} for name in NODES}
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
    for name in OWN:
        if getattr(arguments, name) is not None:
            given["controller"][name] = getattr(arguments, name)
    if arguments.law:
        chosen("law", arguments.law, LAWS)
    if arguments.estimator:
        estimator = chosen("estimator", arguments.estimator, ESTIMATORS)
        given["plant"] |= CAMERA if getattr(estimator, "takes_poses", False) else {}
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
    return values, renamed


def _check_own(robot: RobotParameters, values: Mapping[str, ParameterValue]) -> None:
    """Build a law or an estimator of the user's own, as the controller does at its
    start.

    Args:
        robot: that the controller knows.
        values: of the controller's parameters.

    Raises:
        ParameterError: it cannot be built.
    """
    settings, model = Settings.from_values(values), Model.of(robot)
    if is_own(settings.law):
        law_of(model.mechanism, settings.law)
    if is_own(settings.estimator):
        make_estimator(model, settings, robot.min_type1_distance)


def _changes(node: str, texts: Sequence[str]) -> dict[str, object]:
    parts = [text.partition(":=") for text in texts]
    return {
        name: parse_value(value, f"-p {node}.{name}:={value}")
        for name, _, value in parts
    }


def _stand_at_start(
    console: Terminal, robot: RobotParameters, task: Task, values: dict[str, list[str]]
) -> Array:
    """Plan the trip through the point, and put the robot where it begins, (2,), m, and
    on that side of the locus.

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
    start = plan.trajectory.at(0.0).x
    for name in ("plant", "trajectory_server"):
        values[name].append(assignment("task.start", start.tolist()))
    direction = round(plan.certificate.crossing_signs[0])
    values["trajectory_server"].append(assignment("task.direction", direction))
    values["controller"].append(assignment("assembly_mode", -direction))
    return start


def _place_as_read(
    robot: RobotParameters, true: RobotParameters, start: Array
) -> Array:
    """Return where a simulated robot stands, (2,), m, whose encoders read what the
    described robot's do at the start of the trip.
    """
    model = Model.of(robot)
    q_a = (
        model.inverse_geometric_model(start)
        + np.array(robot.encoder_offset)
        - np.array(true.encoder_offset)
    )
    try:
        return Model.of(true).close(q_a, float(np.sign(model.place(start).s[0])))
    except GeometryError as error:
        raise ParameterError(
            "the simulated robot cannot stand where its encoders read the trip's"
            f" start: {error}"
        ) from error


def _parameter_files(arguments: argparse.Namespace) -> dict[str, tuple[Path, Path]]:
    """Return the files of the robot and of the nodes' parameters, which each node reads
    for itself.
    """
    robot = arguments.robot or config_file(ROBOT_FILE)
    nodes = arguments.params or config_file(NODES_FILE)
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


def _link_latest(folder: Path) -> None:
    """Let the link ``latest`` beside the run's folder lead to it, once the run has
    begun.
    """
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


def _wait_until_ready(
    console: Terminal, monitor: NodeClient, processes: Processes
) -> None:
    """Wait until the recorder has everybody's parameters, the trajectory is accepted
    and the plant can be resumed.
    """
    deadline, told = time.monotonic() + START_TIMEOUT, False
    pause = monitor.client(SetBool, "plant/pause")
    with console.working(STARTING) as working:
        while True:
            monitor.turn()
            processes.check()
            note = monitor.get("controller", "trajectory")
            address = monitor.get(PANEL, "address")
            planning = monitor.get("trajectory_server", "planning")
            working.now(f"planning: {planning}" if planning else STARTING)
            if refusal := monitor.get("trajectory_server", "error"):
                raise NodesError(f"the trajectory server: {refusal}")
            if note.startswith("refused"):
                raise NodesError(f"the controller {note}")
            if address and not told:
                told = True
                console.print(
                    f"while it runs, watch and drive it at {address}", soft_wrap=True
                )
            recording = monitor.get("recorder", "parameters_missing") == "none"
            active = monitor.get("controller", "lifecycle") == "active"
            waits = pause.service_is_ready()
            if recording and active and note == "accepted" and waits:
                return
            if time.monotonic() > deadline:
                known = ", ".join(sorted(monitor.status)) or "none"
                raise NodesError(
                    f"the nodes were not ready within {START_TIMEOUT:.0f} s; heard of:"
                    f" {known}"
                )


def _follow(console: Terminal, monitor: NodeClient, processes: Processes) -> None:
    """Show the progress until the trip is done or the controller gives up."""
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
            monitor.turn()
            processes.check()
            duration = float(monitor.get("controller", "duration") or 0.0)
            if duration > known_duration:
                known_duration = duration
                deadline = time.monotonic() + RUN_TIMEOUT + 20.0 * duration
            told = monitor.status.get("controller", {})
            phase = told.get("phase", "")
            note = monitor.get("controller", "trajectory")
            if note.startswith("refused"):
                raise NodesError(f"the controller {note}")
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
                raise NodesError(
                    "the trip did not end in time; the controller is in phase"
                    f" {phase}{unhealthy(told)}"
                )
    stops = monitor.get("controller", "phase") == "SAFE_STOP"
    monitor.wait(SAFE_STOP_LINGER if stops else LINGER)
