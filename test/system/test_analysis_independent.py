"""The metrics agree with a second computation that shares no line with the package."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import independent_numbers
import pytest
from synthetic_run import write_run

from dextar_control.analysis import compute_metrics, load_run

# relative: rounding of sums in another order, and of a bisection, is well below
AGREEMENT = 1e-9
OF_THE_RUN = (
    "peak_torque",
    "rms_true_error",
    "max_true_error",
    "final_true_error",
    "peak_torque_near",
)
OF_A_CROSSING = ("planned_time", "true_time")


def compare(bag: Path) -> None:
    independent = independent_numbers.numbers(bag)
    metrics = json.loads(compute_metrics(load_run(bag)).to_json())
    assert metrics["start_stamp"] == independent["start_stamp"]
    assert len(independent["planned_time"]) == 2
    for key in OF_THE_RUN:
        assert metrics[key] == pytest.approx(
            independent[key], rel=AGREEMENT, abs=0.0
        ), key
    for key in OF_A_CROSSING:
        found = [crossing[key] for crossing in metrics["crossings"]]
        assert found == pytest.approx(independent[key], rel=AGREEMENT, abs=0.0), key


def test_the_independent_script_uses_rosbags_and_numpy_alone() -> None:
    tree = ast.parse(Path(independent_numbers.__file__).read_text())
    names = {
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    names |= {
        str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)
    }
    assert {name.partition(".")[0] for name in names} - set(
        sys.stdlib_module_names
    ) == {"numpy", "rosbags"}


def test_crossing_instants_peak_torque_and_errors_of_a_real_run_agree(
    demo: Path,
) -> None:
    compare(demo / "run.mcap")


def test_they_agree_where_the_numbers_are_known(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap")
    compare(tmp_path / "run.mcap")


def test_the_script_runs_by_itself(tmp_path: Path) -> None:
    write_run(tmp_path / "rig.mcap", truth=False)
    command = [sys.executable, independent_numbers.__file__, str(tmp_path / "rig.mcap")]
    answer = json.loads(
        subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout
    )
    metrics = compute_metrics(load_run(tmp_path / "rig.mcap"))
    assert answer["peak_torque"] == pytest.approx(metrics.peak_torque, rel=AGREEMENT)
    assert "rms_true_error" not in answer
