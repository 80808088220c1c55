"""Measure what a tick, a round trip and a plant step cost, each beside something bare
in the same minute.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.utilities import try_shutdown
from rich.table import Table
from sensor_msgs.msg import JointState

from dextar_control.contract.errors import DextarError, NodesError
from dextar_control.contract.resources import ROBOT_FILE, config_file, node_defaults
from dextar_control.contract.robot import load_robot
from dextar_control.contract.settings import default_settings
from dextar_control.contract.terminal import Terminal
from dextar_control.contract.topics import JOINT_COMMANDS, JOINT_STATES
from dextar_control.control.loop import ControlLoop
from dextar_control.control.phases import Phase
from dextar_control.experiments.bench_stack import (
    bench_imports,
    bench_nodes,
    bench_panel,
)
from dextar_control.experiments.echo import STAMP
from dextar_control.experiments.processes import Processes, node_arguments
from dextar_control.model.model import Model
from dextar_control.nodekit.client import start_ros
from dextar_control.nodekit.domain import own_domain
from dextar_control.nodekit.layouts import template
from dextar_control.nodekit.node import make_executor, qos
from dextar_control.planning.planner import plan_return_trip

TURNS = 2  # the echo and the controller take turns
START_TIMEOUT = 60.0  # s until the process under test answers
RATE = 1000.0  # states a second
WARM_UP = 200  # answers that do not count


def bench_tick() -> dict[str, tuple[float, float]]:
    """Return (p50, p99) of one control tick along the trip, and of one numpy pinv of 2
    x 2, microseconds.
    """
    robot = load_robot(config_file(ROBOT_FILE))
    task = node_defaults("trajectory_server")
    plan = plan_return_trip(
        robot,
        np.array(task["task.start"]),
        np.array(task["task.goal"]),
        task["task.duration"],
        0.05,
    )
    matrix = np.array([[0.09, 0.01], [0.02, 0.08]])
    tick, bare = [], []
    for _ in range(3):
        loop = ControlLoop(
            robot, default_settings(), int(node_defaults("controller")["assembly_mode"])
        )
        loop.accept(plan.trajectory)
        for k in range(int(plan.trajectory.duration * RATE)):
            q_a = loop.model.inverse_geometric_model(plan.trajectory.at(k / RATE).x)
            begin = time.perf_counter()
            loop.step(k / RATE, q_a)
            middle = time.perf_counter()
            np.linalg.pinv(matrix)
            tick.append(middle - begin)
            bare.append(time.perf_counter() - middle)
        if loop.phase is not Phase.TRACK:
            raise DextarError(
                f"the trip was not tracked to its end: {loop.phase.name} {loop.reason}"
            )
    return {"tick": _percentiles(tick), "pinv": _percentiles(bare)}


def _percentiles(seconds: list[float]) -> tuple[float, float]:
    return float(1e6 * np.percentile(seconds, 50)), float(
        1e6 * np.percentile(seconds, 99)
    )


class _Pinger(Node):
    """Publishes states at 1 kHz and times the commands that answer them."""

    def __init__(self) -> None:
        super().__init__("bench_plant")
        self.round_trips: list[float] = []
        self._sent: dict[bytes, float] = {}
        robot = load_robot(config_file(ROBOT_FILE))
        start = np.array(node_defaults("plant")["task.start"])
        self._values = [
            *Model.of(robot).inverse_geometric_model(start).tolist(),
            0.0,
            0.0,
            0.0,
            0.0,
        ]
        self._template = template(JOINT_STATES)
        self._publisher = self.create_publisher(
            JointState, JOINT_STATES.name, qos(JOINT_STATES)
        )
        self.create_subscription(
            JointState,
            JOINT_COMMANDS.name,
            self._on_command,
            qos(JOINT_COMMANDS, reliable=False),
            raw=True,
        )

    def _on_command(self, raw: bytes) -> None:
        now = time.perf_counter()
        sent = self._sent.pop(bytes(raw[STAMP]), None)
        if sent is not None:
            self.round_trips.append(now - sent)

    def restart(self) -> None:
        """Forget what was measured; answers still to come no longer count."""
        self.round_trips.clear()
        self._sent.clear()

    def send(self) -> None:
        """Publish one state, stamped now."""
        raw = self._template.pack(time.time_ns(), self._values)
        self._sent[raw[STAMP]] = time.perf_counter()
        self._publisher.publish(raw)


def _round_trips(module: str, seconds: float) -> tuple[list[float], int]:
    """Return the round trips against one process, s, and how many states were not
    answered within their period.
    """
    pinger, executor = _Pinger(), make_executor()
    executor.add_node(pinger)
    sent = 0
    with contextlib.ExitStack() as stack:
        stack.callback(executor.shutdown)
        stack.callback(pinger.destroy_node)
        stack.callback(executor.remove_node, pinger)
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        processes = Processes(folder, modules={"controller": module})
        stack.enter_context(processes)
        values = "joint_states.timeout:=10.0", "joint_states.healthy_time:=0.0"
        processes.start("controller", node_arguments("controller", values))
        deadline = time.monotonic() + START_TIMEOUT
        while len(pinger.round_trips) < WARM_UP:
            processes.check()
            if time.monotonic() > deadline:
                raise NodesError(
                    f"{module} did not answer within {START_TIMEOUT:.0f} s"
                )
            _tick(pinger, executor, time.monotonic() + 1.0 / RATE)
        pinger.restart()
        end = time.monotonic() + seconds
        following = time.monotonic()
        while time.monotonic() < end:
            following = max(following + 1.0 / RATE, time.monotonic())
            _tick(pinger, executor, following)
            sent += 1
        return list(pinger.round_trips), sent - sum(
            trip < 1.0 / RATE for trip in pinger.round_trips
        )


def _tick(pinger: _Pinger, executor: Executor, deadline: float) -> None:
    pinger.send()
    while (left := deadline - time.monotonic()) > 0.0:
        executor.spin_once(timeout_sec=left)


def bench_round_trip(seconds: float) -> dict[str, tuple[float, float, int]]:
    """Return (p50, p99), microseconds, and the unanswered states, of the bare echo and
    of the controller.
    """
    modules = {
        "echo": "dextar_control.experiments.echo",
        "controller": "dextar_control.nodes.controller",
    }
    trips: dict[str, list[float]] = {name: [] for name in modules}
    missed = dict.fromkeys(modules, 0)
    start_ros()
    try:
        for _ in range(TURNS):
            for name, module in modules.items():
                times, late = _round_trips(module, seconds / TURNS)
                trips[name] += times
                missed[name] += late
    finally:
        try_shutdown()
    return {name: (*_percentiles(times), missed[name]) for name, times in trips.items()}


def run_bench(seconds: float) -> int:
    """Measure and print; return the exit code."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ["ROS_DOMAIN_ID"] = str(own_domain())
    console = Terminal()
    table = Table(
        "what",
        "p50 us",
        "p99 us",
        "beside",
        "p50 us",
        "p99 us",
        "ratio p50",
        title="cost on this machine, now",
    )

    def row(
        what: str, ours: tuple[float, ...], bare_name: str, bare: tuple[float, ...]
    ) -> None:
        table.add_row(
            what,
            f"{ours[0]:.1f}",
            f"{ours[1]:.1f}",
            bare_name,
            f"{bare[0]:.1f}",
            f"{bare[1]:.1f}",
            f"{ours[0] / bare[0]:.2f}",
        )

    with console.working("one control tick"):
        tick = bench_tick()
        row(
            f"control tick, {node_defaults('controller')['estimator']}",
            tick["tick"],
            "numpy pinv 2 x 2",
            tick["pinv"],
        )
    with console.working("round trip over DDS"):
        trips = bench_round_trip(seconds)
        row("state -> command", trips["controller"], "bare echo", trips["echo"])
    with console.working("processor time of the nodes"):
        cores = bench_nodes(seconds)
    with console.working("the panel"):
        panel = bench_panel(seconds)
    with console.working("imports"):
        imports = bench_imports()
    with console.working("plant step"):
        answer = subprocess.run(
            [sys.executable, "-m", "dextar_sim.bench"],
            check=True,
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
        )
        plant = json.loads(answer.stdout.splitlines()[-1])
        pairs = {name: (value["p50"], value["p99"]) for name, value in plant.items()}
        row("plant step and state", pairs["step"], "raw PyBullet steps", pairs["raw"])
    console.print(table)
    console.print(
        f"states unanswered within their period: controller {trips['controller'][2]},"
        f" echo {trips['echo'][2]} of about {seconds * RATE:.0f} each"
    )
    told = ", ".join(f"{name} {share:.3f}" for name, share in cores.items())
    console.print(
        f"cores at 1 kHz in real time: {told}, together {sum(cores.values()):.3f}"
    )
    console.print(
        f"panel: {panel.watched:.3f} cores while a page looks on, {panel.unwatched:.3f}"
        f" else, {panel.pictures:.1f} pictures/s; a stop is answered after"
        f" {1e3 * float(np.median(panel.stops)):.1f} ms, {1e3 * max(panel.stops):.1f}"
        f" ms at most of {len(panel.stops)}; steps without their command"
        f" {panel.late_watched:.1%}, {panel.late_unwatched:.1%} without a page"
    )
    console.print(", ".join(f"{name} {time:.2f} s" for name, time in imports.items()))
    return 0
