"""What only a process of its own shows: how it ends, and what it has loaded."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from patience import PATIENCE

ROOT = Path(__file__).resolve().parents[2]
LOADED = """
import sys
import dextar_control.analysis.report, dextar_control.bags.recover
import dextar_control.control.loop, dextar_control.planning.tour
ros = {"rclpy", "rosidl_runtime_py"}
print(sorted((ros | {"pybullet"}) & set(sys.modules)))
import dextar_sim.rig
print(sorted(ros & set(sys.modules)))
"""


def test_a_command_that_fails_ends_with_two_and_no_traceback(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_text("no bag")
    answer = subprocess.run(
        [sys.executable, "-m", "dextar_control.cli.main", "analyze", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert answer.returncode == 2, answer.stderr
    assert "run.mcap" in answer.stderr and "Traceback" not in answer.stderr


def test_neither_mathematics_nor_analysis_nor_the_simulated_rig_loads_ros() -> None:
    """Not through a library either; of the first two nothing loads the simulator."""
    answer = subprocess.run(
        [sys.executable, "-c", LOADED],
        check=True,
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert answer.stdout.split() == ["[]", "[]"]


SWALLOWED = """
import sys, time
from dextar_control.contract.signals import StopSignal
stop, word = StopSignal(), "ready\\n"
while True:
    try:
        told, word = word, ""
        print(told, end="", flush=True)
        time.sleep(0.01)
    except KeyboardInterrupt:
        pass
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_node_that_is_being_made_ends_although_the_compiler_swallows_the_interrupt(
    number: int,
) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", SWALLOWED],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    output, _ = process.communicate(timeout=PATIENCE)
    assert (process.returncode, output) == (0, "")
