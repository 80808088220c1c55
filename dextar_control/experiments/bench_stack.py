"""What the running nodes cost, and whether the demo is right on a busy machine:
``dextar bench --nodes``, ``--demos``.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.signals import SignalHandlerOptions
from tornado.websocket import websocket_connect

from dextar_control.contract.errors import DextarError
from dextar_control.contract.topics import DIAGNOSTICS, JOINT_STATES
from dextar_control.experiments.processes import processor_time
from dextar_control.nodekit.node import qos

MODULES = {
    "plant": "dextar_sim.node",
    "controller": "dextar_control.nodes.controller",
    "recorder": "dextar_control.nodes.recorder",
}
START_TIMEOUT = 60.0  # s until the nodes run
SETTLING = 2.0  # s of running before their processor time counts
STOPS = 20  # that a page asks for
BUSY = "while True: pass"
VERDICT = "verdict"
SPENT_TIMEOUT = 600.0  # s for one demo


@contextlib.contextmanager
def _processes(
    commands: dict[str, list[str]],
) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Processes by name, ended with SIGINT and then with SIGKILL."""
    started: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for name, command in commands.items():
            started[name] = subprocess.Popen(
                [sys.executable, *command],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
        yield started
    finally:
        for process in started.values():
            process.send_signal(signal.SIGINT)
        for process in started.values():
            try:
                process.wait(timeout=10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def bench_nodes(seconds: float) -> dict[str, float]:
    """Processor time of plant, controller and recorder in real time, cores: s for each
    second of 1 kHz states, while holding.
    """
    looks: list[tuple[int, dict[str, float]]] = []
    with tempfile.TemporaryDirectory() as folder:
        given = {
            "plant": ["plant:mode:=realtime"],
            "controller": ["controller:joint_states.healthy_time:=0.1"],
            "recorder": [
                f"recorder:output:={folder}/run/run.mcap",
                "recorder:bag.parameters_of:=''",
            ],
        }
        commands = {
            name: [
                "-m",
                module,
                "--ros-args",
                *(part for value in given[name] for part in ("-p", value)),
            ]
            for name, module in MODULES.items()
        }
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        try:
            node = rclpy.create_node(
                "bench", start_parameter_services=False, enable_rosout=False
            )
            phase = ""
            with _processes(commands) as running:

                def look(message: DiagnosticArray) -> None:
                    nonlocal phase
                    values = {
                        entry.key: entry.value for entry in message.status[0].values
                    }
                    if message.status[0].name == "/controller":
                        phase = values["phase"]
                    elif message.status[0].name == "/plant" and phase == "HOLD":
                        looks.append(
                            (
                                int(values["steps"]),
                                {
                                    name: processor_time(one.pid)
                                    for name, one in running.items()
                                },
                            )
                        )

                node.create_subscription(
                    DiagnosticArray, DIAGNOSTICS.name, look, qos(DIAGNOSTICS)
                )
                deadline = time.monotonic() + START_TIMEOUT + seconds
                while len(looks) < 2 or looks[-1][0] - looks[0][0] < 1000.0 * (
                    seconds + SETTLING
                ):
                    rclpy.spin_once(node, timeout_sec=0.2)
                    ended = [
                        name for name, one in running.items() if one.poll() is not None
                    ]
                    if ended or time.monotonic() > deadline:
                        raise DextarError(
                            f"the {', '.join(ended) or 'nodes'} did not run as expected"
                        )
            node.destroy_node()
        finally:
            rclpy.try_shutdown()
    begin = next(look for look in looks if look[0] - looks[0][0] >= 1000.0 * SETTLING)
    end = looks[-1]
    return {
        name: (end[1][name] - begin[1][name]) / (1.0e-3 * (end[0] - begin[0]))
        for name in MODULES
    }


class PanelCost(NamedTuple):
    """What the panel costs in real time at 1 kHz."""

    unwatched: float  # cores of the panel
    watched: float  # the same while a page looks on
    late_unwatched: float  # share of the plant's steps without their command in time
    late_watched: float
    pictures: float  # that the page gets in a second
    stops: list[float]  # s from asking for a stop to the controller's answer


def bench_panel(seconds: float, viewers: int = 1) -> PanelCost:
    """Measure it on a plant and a controller that holds, which a stop lets hold on:
    each for so long without and with pages.
    """
    given = {
        "plant": ["plant:mode:=realtime"],
        "controller": ["controller:joint_states.healthy_time:=0.1"],
        "panel": ["panel:port:=0"],
    }
    modules = MODULES | {"panel": "dextar_control.nodes.panel"}
    commands = {
        name: [
            "-m",
            modules[name],
            "--ros-args",
            *(part for value in own for part in ("-p", value)),
        ]
        for name, own in given.items()
    }
    told: dict[str, dict[str, str]] = {}
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node(
            "bench", start_parameter_services=False, enable_rosout=False
        )

        def hear(message: DiagnosticArray) -> None:
            for status in message.status:
                told[status.name.strip("/")] = {
                    entry.key: entry.value for entry in status.values
                }

        def spin(until: float, done: Callable[[], bool]) -> None:
            while time.monotonic() < until and not done():
                rclpy.spin_once(node, timeout_sec=0.1)

        node.create_subscription(
            DiagnosticArray, DIAGNOSTICS.name, hear, qos(DIAGNOSTICS)
        )
        with _processes(commands) as running:

            def look(name: str) -> tuple[float, float, float]:
                return (
                    processor_time(running[name].pid),
                    float(told["plant"]["steps"]),
                    float(told["plant"]["late_ticks"]),
                )

            def over(
                begin: tuple[float, float, float], end: tuple[float, float, float]
            ) -> tuple[float, float]:
                steps = end[1] - begin[1]
                return (end[0] - begin[0]) / (1.0e-3 * steps), (
                    end[2] - begin[2]
                ) / steps

            def holds() -> bool:
                return told.get("controller", {}).get("phase") == "HOLD" and {
                    "panel",
                    "plant",
                } <= set(told)

            spin(time.monotonic() + START_TIMEOUT, holds)
            if not holds():
                raise DextarError(
                    "plant, controller and panel did not come to hold within"
                    f" {START_TIMEOUT:.0f} s"
                )
            spin(time.monotonic() + SETTLING, lambda: False)
            looks = [look("panel")]
            spin(time.monotonic() + seconds, lambda: False)
            looks.append(look("panel"))
            with ThreadPoolExecutor(viewers) as pool:
                pages = [
                    pool.submit(
                        watch_panel,
                        told["panel"]["address"],
                        seconds + SETTLING,
                        STOPS * (number == 0),
                    )
                    for number in range(viewers)
                ]
                spin(time.monotonic() + SETTLING, lambda: False)
                looks.append(look("panel"))
                spin(
                    time.monotonic() + START_TIMEOUT + seconds,
                    lambda: all(page.done() for page in pages),
                )
                looks.append(look("panel"))
                pictures, stops = pages[0].result()
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    (unwatched, late_unwatched), (watched, late_watched) = (
        over(*looks[:2]),
        over(*looks[2:]),
    )
    return PanelCost(unwatched, watched, late_unwatched, late_watched, pictures, stops)


def watch_panel(address: str, seconds: float, stops: int) -> tuple[float, list[float]]:
    """Look on as a page does, and ask for stops evenly: pictures in a second, and s
    from asking to the controller's answer.
    """

    async def run() -> tuple[float, list[float]]:
        stream = await websocket_connect(f"{address.replace('http', 'ws')}stream")
        begin = time.monotonic()
        pictures, asked = 0, 0.0
        taken: list[float] = []
        while (now := time.monotonic()) < begin + seconds:
            if (
                len(taken) < stops
                and not asked
                and now - begin > seconds * (len(taken) + 1) / (stops + 2)
            ):
                asked = time.monotonic()
                await stream.write_message(json.dumps({"ask": "stop", "number": 1}))
            text = await stream.read_message()
            if text is None:
                raise DextarError(f"the panel at {address} closed the stream")
            kind = json.loads(text)["kind"]
            pictures += kind == "state"
            if kind == "answer":
                taken.append(time.monotonic() - asked)
                asked = 0.0
        stream.close()
        return pictures / (time.monotonic() - begin), taken

    return asyncio.run(run())


def fingerprint(folder: Path) -> str:
    """Of the joint states in a demo's bag up to the end of its trip, all bytes in
    order; when it stops after that is chance.
    """
    from mcap.reader import make_reader

    found, name = hashlib.sha256(), f"/{JOINT_STATES.name}"
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    end = (metrics["start_stamp"] or 0) + 1.0e9 * (metrics["tracked_until"] or 0.0)
    with (folder / "run.mcap").open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(
            topics=[name], log_time_order=False
        ):
            seconds, nanoseconds = struct.unpack_from("<iI", message.data, 4)
            if 1_000_000_000 * seconds + nanoseconds <= end:
                found.update(message.data)
    return found.hexdigest()[:16]


def bench_demos(count: int, busy: int, arguments: list[str]) -> int:
    """Demos one after the other beside busy processes, a line for each; the exit code.

    Args:
        count: of demos.
        busy: of processes that do nothing but work, at the priority of any.
        arguments: of ``dextar demo``.
    """
    successes, kinds = 0, set()
    spinners = {f"busy {number}": ["-c", BUSY] for number in range(busy)}
    with tempfile.TemporaryDirectory() as folder, _processes(spinners):
        for number in range(1, count + 1):
            output = Path(folder) / str(number)
            begin, verdict, told = time.monotonic(), float("nan"), ""
            with subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    "dextar_control.cli.main",
                    "demo",
                    "--output",
                    str(output),
                    *arguments,
                ],
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                text=True,
            ) as demo:
                assert demo.stdout is not None
                for line in demo.stdout:
                    if VERDICT in line:
                        verdict, told = (
                            time.monotonic() - begin,
                            line.strip(" │\n").removeprefix(VERDICT).strip(" │"),
                        )
                code = demo.wait(timeout=SPENT_TIMEOUT)
            states = fingerprint(output / "latest")
            kinds.add(states)
            successes += code == 0
            print(
                f"{number}: exit code {code}, verdict after {verdict:.1f} s, end after"
                f" {time.monotonic() - begin:.1f} s, joint states {states}: {told}",
                flush=True,
            )
    print(
        f"{successes} of {count} demos beside {busy} busy processes on {os.cpu_count()}"
        f" cores were successes; {len(kinds)} different sequences of joint states"
    )
    return 0 if successes == count else 1


def bench_imports() -> dict[str, float]:
    """Wall time of a new process, best of three, s: ``dextar --help``, the mathematics,
    a bare ``import numpy`` beside.
    """
    commands = {
        "dextar --help": ["-m", "dextar_control.cli.main", "--help"],
        "import of the mathematics": [
            "-c",
            "import dextar_control.control.loop, dextar_control.planning.planner",
        ],
        "import numpy": ["-c", "import numpy"],
    }
    times = {}
    for name, command in commands.items():
        best = float("inf")
        for _ in range(3):
            begin = time.monotonic()
            subprocess.run(
                [sys.executable, *command],
                check=True,
                stdout=subprocess.DEVNULL,
                stdin=subprocess.DEVNULL,
            )
            best = min(best, time.monotonic() - begin)
        times[name] = best
    return times
