"""Does the recorder keep up beside the running stack? ``python -m
dextar_control.experiments.recorder_bench 600``.

Runs plant (with a camera at the loop's rate), controller, trajectory server and
recorder in real time as processes of their own, has a tour of ten return trips served
every half minute, and counts afterwards from the bag alone, by the numbers that the
publishers gave their samples, what is missing.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import rclpy
from mcap.reader import make_reader
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rich.progress import BarColumn, TimeRemainingColumn
from rich.table import Column, Table
from std_srvs.srv import Trigger

from dextar_control.contract.errors import DextarError
from dextar_control.contract.resources import NODES_FILE, ROBOT_FILE, config_file
from dextar_control.contract.signals import EXIT_FAILED, run_command
from dextar_control.contract.terminal import Steps, Terminal, TextColumn
from dextar_control.contract.yaml_text import assignment
from dextar_control.experiments.processes import NodesError, Processes, processor_time
from dextar_control.nodekit.domain import choose_domain

CAMERA_RATE = 1000.0  # Hz
TOUR_PERIOD = 30  # s between two tours
ANSWER = 5.0  # s
STARTING = 120.0  # s until the nodes have to be there


class Stream(NamedTuple):
    """One topic of a bag."""

    topic: str
    messages: int
    missing: int  # numbers that its publisher gave and that are not in the bag
    dropped: int  # as the recorder counted itself: lost on the way or before the disk


def streams(bag: Path) -> list[Stream]:
    """Per topic with one publisher, the numbers missing between the first and the last
    one in the bag.
    """
    numbers: dict[str, list[int]] = {}
    counts: dict[str, dict[str, int]] = {}
    with bag.open("rb") as stream:
        reader = make_reader(stream)
        for record in reader.iter_metadata():
            if record.name == "dextar":
                counts = json.loads(record.metadata["topics"])
        for _, channel, message in reader.iter_messages(log_time_order=False):
            numbers.setdefault(channel.topic, []).append(message.sequence)
    shared = (
        "/diagnostics",
        "/rosout",
        "/parameter_events",
    )  # by several publishers, each with its own numbers
    return [
        Stream(
            topic,
            len(seen),
            0 if topic in shared else max(seen) - min(seen) + 1 - len(set(seen)),
            (counts[topic]["lost"] or 0) + counts[topic]["dropped"],
        )
        for topic, seen in sorted(numbers.items())
    ]


def run(seconds: int, output: Path, reliable: bool) -> int:
    """Measure and print; 0 when nothing is missing."""
    console = Terminal()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    choose_domain()
    settings: dict[str, dict[str, Any]] = {
        "recorder": {
            "output": output / "run.mcap",
            "topics.reliable": reliable,
            "bag.compression": "zstd",
        },
        "plant": {"external_pose.rate": CAMERA_RATE},
        "controller": {},
        "trajectory_server": {"autostart": True, "task.repeat": 10},
    }
    files = [
        "--params-file",
        str(config_file(ROBOT_FILE)),
        "--params-file",
        str(config_file(NODES_FILE)),
    ]
    processes = Processes(
        output,
        {
            name: [
                *files,
                *(
                    part
                    for item in values.items()
                    for part in ("-p", f"{name}:{assignment(*item)}")
                ),
            ]
            for name, values in settings.items()
        },
    )
    operator = _Operator()
    try:
        for name in settings:
            processes.start(name)
        with console.working("starting the nodes"):
            _wait_for_all(output, processes)
        before = {name: processor_time(processes.pid(name)) for name in settings}
        begin = time.monotonic()
        with Steps(
            TextColumn("{task.description}"),
            BarColumn(),
            TimeRemainingColumn(),
            console=console,
        ) as progress:
            bar = progress.add_task("recording", total=seconds)
            for second in range(seconds):
                if second % TOUR_PERIOD == TOUR_PERIOD - 1:
                    operator.start_tour()
                time.sleep(max(0.0, begin + second + 1.0 - time.monotonic()))
                processes.check()
                progress.advance(bar)
        elapsed = time.monotonic() - begin
        load = {
            name: (processor_time(processes.pid(name)) - before[name]) / elapsed
            for name in settings
        }
        memory = {name: _memory(processes.pid(name)) for name in settings}
    finally:
        operator.close()
        processes.stop_all()
    found = streams(output / "run.mcap")
    columns = (
        Column("topic", overflow="fold"),
        "messages",
        "missing",
        "told by the recorder",
    )
    table = Table(*columns, title=f"{elapsed:.0f} s in real time")
    for row in found:
        table.add_row(row.topic, str(row.messages), str(row.missing), str(row.dropped))
    console.print(table)
    console.print(
        "; ".join(
            f"{name} {load[name]:.2f} cores, {memory[name]:.0f} MB" for name in load
        )
    )
    console.print(
        f"tours asked for: {1 + operator.asked}; refused or not answered:"
        f" {operator.refused}"
    )
    console.print(
        f"load average {os.getloadavg()[1]:.1f} on {os.cpu_count()} cores; bag {output}"
    )
    return EXIT_FAILED if any(row.missing or row.dropped for row in found) else 0


class _Operator:
    """Asks the trajectory server for another tour."""

    def __init__(self) -> None:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node(
            "recorder_bench", enable_rosout=False, start_parameter_services=False
        )
        self._client = self._node.create_client(Trigger, "trajectory_server/start")
        self.asked = self.refused = 0

    def start_tour(self) -> None:
        """Ask, and count what is not granted."""
        self.asked += 1
        future = self._client.call_async(Trigger.Request())
        rclpy.spin_until_future_complete(self._node, future, timeout_sec=ANSWER)
        answer = future.result() if future.done() else None
        self.refused += answer is None or not answer.success

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()
        rclpy.try_shutdown()


def _wait_for_all(output: Path, processes: Processes) -> None:
    deadline = time.monotonic() + STARTING
    while "accepted" not in processes.log_path("controller").read_text(
        errors="replace"
    ):
        processes.check()
        if time.monotonic() > deadline:
            raise NodesError(
                f"no trajectory was accepted within {STARTING:.0f} s: see the logs in"
                f" {output}"
            )
        time.sleep(0.2)


def _memory(pid: int) -> float:
    """Largest resident size, MB."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024.0


def main(argv: list[str] | None = None) -> int:
    """Console entry."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seconds", type=int, nargs="?", default=600)
    parser.add_argument(
        "--output",
        type=Path,
        help="new folder of bag and logs (default: a temporary one)",
    )
    parser.add_argument(
        "--reliable",
        action="store_true",
        help="ask the publishers to repeat what was lost",
    )
    arguments = parser.parse_args(argv)
    if arguments.output is None:
        arguments.output = Path(tempfile.mkdtemp(prefix="recorder-"))

    def work() -> int:
        try:
            arguments.output.mkdir(parents=True, exist_ok=True)
            return run(arguments.seconds, arguments.output, arguments.reliable)
        except (DextarError, OSError) as error:
            print(f"error: {error}", file=sys.stderr)
            return EXIT_FAILED

    return run_command("recorder_bench", work)


if __name__ == "__main__":
    sys.exit(main())
