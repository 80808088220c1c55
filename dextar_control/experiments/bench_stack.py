"""Measure what the running nodes cost, and whether the demo is right on a busy machine
(``dextar bench``, with ``--demos``).
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from tornado.websocket import websocket_connect

from dextar_control.contract.errors import DextarError, NodesError
from dextar_control.contract.topics import JOINT_STATES
from dextar_control.experiments.processes import (
    Processes,
    node_arguments,
    processor_time,
)
from dextar_control.nodekit.client import NodeClient, monitoring

START_TIMEOUT = 60.0  # s until the nodes run
SETTLING = 2.0  # s of running before their processor time counts
STOPS = 20  # that a page asks for
BUSY = "while True: pass"
VERDICT = "verdict"
SPENT_TIMEOUT = 600.0  # s for one demo


class Usage(NamedTuple):
    """What the nodes had used when the plant told of itself."""

    used: dict[str, float]  # s of processor time of each node
    steps: float  # of the plant
    late: float  # of them without their command in time

    def cores(self, name: str, end: Usage) -> float:
        """Return the cores that a node used from here to a later look, at 1 kHz."""
        return (end.used[name] - self.used[name]) / (1.0e-3 * (end.steps - self.steps))

    def late_share(self, end: Usage) -> float:
        """Return the share of late steps from here to a later look."""
        return (end.late - self.late) / (end.steps - self.steps)


@contextlib.contextmanager
def _holding(
    folder: str, **nodes: Sequence[str]
) -> Iterator[tuple[NodeClient, Callable[[], Usage]]]:
    """A context in which plant, controller and further nodes hold the robot in real
    time: their monitor, and what waits until the plant tells of itself and reads what
    they have used.

    Raises:
        NodesError: a node ends, or the robot is not held in time.
    """
    given = {
        "plant": ["mode:=realtime"],
        "controller": ["joint_states.healthy_time:=0.1"],
        **nodes,
    }
    with Processes(Path(folder)) as processes, monitoring("bench") as monitor:

        def holds() -> bool:
            processes.check()
            heard = given.keys() <= monitor.status.keys()
            return heard and monitor.get("controller", "phase") == "HOLD"

        def look() -> Usage:
            before = monitor.get("plant", "steps")
            monitor.until(
                lambda: monitor.get("plant", "steps") != before, START_TIMEOUT
            )
            processes.check()
            used = {name: processor_time(processes.pid(name)) for name in given}
            plant = monitor.status["plant"]
            return Usage(used, float(plant["steps"]), float(plant["late_ticks"]))

        for name, values in given.items():
            processes.start(name, node_arguments(name, values))
        if not monitor.until(holds, START_TIMEOUT):
            raise NodesError(
                f"{', '.join(given)} did not come to hold the robot within"
                f" {START_TIMEOUT:.0f} s; heard of:"
                f" {', '.join(monitor.status) or 'none'}"
            )
        monitor.wait(SETTLING)
        yield monitor, look


def bench_nodes(seconds: float) -> dict[str, float]:
    """Measure the cores that plant, controller and recorder use while holding.

    Args:
        seconds: for which is measured, s.

    Returns:
        Cores of each node: s of processor time for each second of 1 kHz states.
    """
    with tempfile.TemporaryDirectory() as folder:
        recorder = [f"output:={folder}/run/run.mcap", "bag.parameters_of:=''"]
        with _holding(folder, recorder=recorder) as (monitor, look):
            begin = look()
            monitor.wait(seconds)
            end = look()
    return {name: begin.cores(name, end) for name in begin.used}


class PanelCost(NamedTuple):
    """What the panel costs in real time at 1 kHz."""

    unwatched: float  # cores of the panel
    watched: float  # the same while a page looks on
    late_unwatched: float  # share of the plant's steps without their command in time
    late_watched: float
    pictures: float  # that the page gets in a second
    stops: list[float]  # s from asking for a stop to the controller's answer


def bench_panel(seconds: float, viewers: int = 1) -> PanelCost:
    """Measure the panel beside a plant and a controller that holds, which a stop lets
    hold on.

    Args:
        seconds: for which is measured without pages, and with them, s.
        viewers: pages that look on.
    """
    with (
        tempfile.TemporaryDirectory() as folder,
        _holding(folder, panel=["port:=0"]) as (monitor, look),
        ThreadPoolExecutor(viewers) as pool,
    ):
        alone = look()
        monitor.wait(seconds)
        opened = look()
        pages = [
            pool.submit(
                watch_panel,
                monitor.get("panel", "address"),
                seconds + SETTLING,
                STOPS * (number == 0),
            )
            for number in range(viewers)
        ]
        monitor.wait(SETTLING)
        begin = look()
        monitor.until(
            lambda: all(page.done() for page in pages), START_TIMEOUT + seconds
        )
        end = look()
        pictures, stops = pages[0].result()
    return PanelCost(
        alone.cores("panel", opened),
        begin.cores("panel", end),
        alone.late_share(opened),
        begin.late_share(end),
        pictures,
        stops,
    )


def watch_panel(address: str, seconds: float, stops: int) -> tuple[float, list[float]]:
    """Look on as a page does, and ask for stops evenly; return the pictures in a
    second, and s from asking to the controller's answer.
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
    """Return a digest of the joint states in a demo's bag up to the end of its trip,
    all bytes in order; when it stops after that is chance.

    A state that the plant sent again, because its answer was late, counts once.
    """
    from mcap.reader import make_reader

    found, before, name = hashlib.sha256(), b"", f"/{JOINT_STATES.name}"
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    end = (metrics["start_stamp"] or 0) + 1.0e9 * (metrics["tracked_until"] or 0.0)
    with (folder / "run.mcap").open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(
            topics=[name], log_time_order=False
        ):
            seconds, nanoseconds = struct.unpack_from("<iI", message.data, 4)
            if message.data != before and 1_000_000_000 * seconds + nanoseconds <= end:
                found.update(message.data)
            before = message.data
    return found.hexdigest()[:16]


def bench_demos(count: int, busy: int, arguments: list[str]) -> int:
    """Run demos one after the other beside busy processes, and print a line for each;
    return the exit code.

    Args:
        count: of demos.
        busy: of processes that do nothing but work, at the priority of any.
        arguments: of ``dextar demo``.
    """
    successes, kinds = 0, set()
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as spinners:
        for _ in range(busy):
            spinner = subprocess.Popen([sys.executable, "-c", BUSY])
            spinners.callback(spinner.wait)
            spinners.callback(spinner.kill)
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
                        verdict = time.monotonic() - begin
                        told = line.strip(" │\n").removeprefix(VERDICT).strip(" │")
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
    """Return the wall time of a new process, best of three, s: ``dextar --help``, the
    mathematics, and a bare ``import numpy``.
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
