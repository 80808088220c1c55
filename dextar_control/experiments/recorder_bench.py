"""Measure whether the recorder keeps up beside the running stack: ``python -m
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
from typing import NamedTuple

from mcap.reader import make_reader
from rich.progress import BarColumn, TimeRemainingColumn
from rich.table import Column, Table
from std_srvs.srv import Trigger

from dextar_control.contract.errors import NodesError
from dextar_control.contract.signals import EXIT_FAILED, run_command
from dextar_control.contract.terminal import Steps, Terminal, TextColumn
from dextar_control.contract.yaml_text import assignment
from dextar_control.experiments.processes import (
    Processes,
    node_arguments,
    processor_time,
)
from dextar_control.nodekit.client import NodeClient, monitoring
from dextar_control.nodekit.domain import choose_domain

CAMERA_RATE = 1000.0  # Hz
TOUR_PERIOD = 30  # s between two tours
STARTING = 120.0  # s until the nodes have to be there


class TopicCount(NamedTuple):
    """The messages of one topic of a bag."""

    topic: str
    messages: int
    missing: int  # numbers that its publisher gave and that are not in the bag
    dropped: int  # as the recorder counted itself: lost on the way or before the disk


def topic_counts(bag: Path) -> list[TopicCount]:
    """Count, for each topic with one publisher, the numbers missing between the first
    and the last one in the bag.
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
    # by several publishers, each with its own numbers
    shared = ("/diagnostics", "/rosout", "/parameter_events")
    return [
        TopicCount(
            topic,
            len(seen),
            0 if topic in shared else max(seen) - min(seen) + 1 - len(set(seen)),
            (counts[topic]["lost"] or 0) + counts[topic]["dropped"],
        )
        for topic, seen in sorted(numbers.items())
    ]


def run(seconds: int, output: Path, reliable: bool) -> int:
    """Measure and print; return 0 when nothing is missing."""
    console = Terminal()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    choose_domain()
    settings: dict[str, dict[str, object]] = {
        "recorder": {
            "output": output / "run.mcap",
            "topics.reliable": reliable,
            "bag.compression": "zstd",
        },
        "plant": {"external_pose.rate": CAMERA_RATE},
        "controller": {},
        "trajectory_server": {"autostart": True, "task.repeat": 10},
    }
    asked = refused = 0
    with Processes(output) as processes, monitoring("recorder_bench") as monitor:
        for name, values in settings.items():
            given = [assignment(*item) for item in values.items()]
            processes.start(name, node_arguments(name, given))
        with console.working("starting the nodes"):
            _wait_for_all(monitor, processes, output)
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
                    asked += 1
                    refused += not _tour_starts(monitor)
                monitor.wait(begin + second + 1.0 - time.monotonic())
                processes.check()
                progress.advance(bar)
        elapsed = time.monotonic() - begin
        load = {
            name: (processor_time(processes.pid(name)) - before[name]) / elapsed
            for name in settings
        }
        memory = {name: _memory(processes.pid(name)) for name in settings}
    found = topic_counts(output / "run.mcap")
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
    console.print(f"tours asked for: {1 + asked}; refused or not answered: {refused}")
    console.print(
        f"load average {os.getloadavg()[1]:.1f} on {os.cpu_count()} cores; bag {output}"
    )
    return EXIT_FAILED if any(row.missing or row.dropped for row in found) else 0


def _tour_starts(monitor: NodeClient) -> bool:
    """Ask the trajectory server for another tour; tell whether it is granted."""
    try:
        return monitor.call(Trigger, "trajectory_server/start").success
    except NodesError:
        return False


def _wait_for_all(monitor: NodeClient, processes: Processes, output: Path) -> None:
    def accepted() -> bool:
        processes.check()
        return monitor.get("controller", "trajectory") == "accepted"

    if not monitor.until(accepted, STARTING):
        raise NodesError(
            f"no trajectory was accepted within {STARTING:.0f} s: see the logs in"
            f" {output}"
        )


def _memory(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024.0  # MB, at most so far


def main(argv: list[str] | None = None) -> int:
    """Run the bench as a console command."""
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

    def work() -> int:
        output = arguments.output or Path(tempfile.mkdtemp(prefix="recorder-"))
        output.mkdir(parents=True, exist_ok=True)
        return run(arguments.seconds, output, arguments.reliable)

    return run_command("recorder_bench", work)


if __name__ == "__main__":
    sys.exit(main())
