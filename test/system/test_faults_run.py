"""Faults against the real nodes, in simulated time; and that each check on them fails
where a node is bad.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml

from dextar_control.contract.resources import config_file
from dextar_control.contract.validation import validate
from dextar_control.experiments.faults import run
from dextar_control.experiments.faults.cases import FaultConfig
from dextar_control.experiments.faults.judgement import Check
from dextar_control.experiments.faults.stack import SessionRequest

ROOT = Path(__file__).resolve().parents[2]
CASES = yaml.safe_load(config_file("faults.yaml").read_text(encoding="utf-8"))
PATIENCE = 400.0  # s until a session counts as hanging: nothing is timed


def session(
    folder: Path, cases: dict[str, int], **changes: Any
) -> tuple[int, list[dict[str, Any]]]:
    """Exit code and events of one session in simulated time, in a domain of its own."""
    request = SessionRequest(
        str(folder),
        "lockstep",
        cases,
        CASES,
        seed=5,
        injector=True,
        record=False,
        **changes,
    )
    environment = {
        **os.environ,
        "ROS_DOMAIN_ID": str(101 + os.getpid() % 100),
        "PYTHONPATH": str(ROOT / "test" / "tools"),
    }
    answer = subprocess.run(
        [sys.executable, "-m", "dextar_control.experiments.faults.session"],
        input=json.dumps(asdict(request)) + "\n",
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=environment,
        timeout=PATIENCE,
        check=False,
    )
    assert answer.stdout, answer.stderr
    return answer.returncode, [json.loads(line) for line in answer.stdout.splitlines()]


def violations(events: list[dict[str, Any]]) -> list[tuple[str, str]]:
    return [
        (check, text)
        for event in events
        if event["event"] == "checks"
        for check, text in event["violations"]
    ]


def test_faults_tried_by_the_command_have_their_expected_outcomes_and_are_reported(
    tmp_path: Path,
) -> None:
    """The command as a user runs it: mild faults are crossed, hard ones end without
    torque, everything is in the files.
    """
    answer = subprocess.run(
        [
            sys.executable,
            "-m",
            "dextar_control.cli.main",
            "faults",
            "--quick",
            "--jobs",
            "1",
            "--output",
            str(tmp_path),
            "--cases",
            "states_lost_20,commands_gone_250ms,states_nan,stamps_back,parameters",
        ],
        capture_output=True,
        text=True,
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        timeout=PATIENCE,
        check=False,
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr
    folder = next(tmp_path.iterdir())
    data = json.loads((folder / "faults.json").read_text())
    outcomes = {name: set(case["outcomes"]) for name, case in data["cases"].items()}
    assert outcomes["states_lost_20"] == {"crossed"}
    assert outcomes["parameters"] == {"refused, crossed"}
    assert outcomes["states_nan"] == outcomes["stamps_back"] == {"fault"}
    assert outcomes["commands_gone_250ms"] <= {"safe stop", "fault"}
    assert all(case["reported"] for case in data["cases"].values())
    looked = {name: check["looked"] for name, check in data["never"].items()}
    assert all(looked[check.value] > 0 for check in Check if check is not Check.BAG)
    assert not any(check["violations"] for check in data["never"].values())
    assert (
        data["crossings"] == sum(case["count"] for case in data["cases"].values()) >= 8
    )
    assert (folder / "faults.png").stat().st_size > 10_000
    assert "| states: NaN |" in (folder / "faults.md").read_text()


def test_a_drive_without_its_timeout_and_a_controller_that_answers_bad_states_in_silence_are_caught(
    tmp_path: Path,
) -> None:
    """Three checks that must be able to fail, against bad nodes in real processes."""
    _, events = session(
        tmp_path,
        {"commands_gone_250ms": 1, "states_nan": 1},
        plant=["drive.command_timeout:=10.0"],
        modules={"controller": "bad_controller"},
    )
    seen = violations(events)
    death, limit = Check.TORQUE_AFTER_DEATH.value, Check.TORQUE_LIMIT.value
    assert any(
        check == death and "after the last command" in text for check, text in seen
    ), events
    assert any(
        check == Check.NOT_FINITE.value and "answer the bad state" in text
        for check, text in seen
    ), events
    assert any(
        check == Check.UNREPORTED.value and "controller.reason~finite" in text
        for check, text in seen
    ), events
    assert not any(check == limit for check, _ in seen)
    records = [
        event
        for event in events
        if event["event"] == "record" and event["case"] == "states_nan"
    ]
    assert [record["expected"] for record in records] == [False]


def test_a_session_that_is_being_started_while_the_run_is_stopped_is_ended_too(
    tmp_path: Path, monkeypatch: Any
) -> None:
    """The signal comes between the start of the process and the moment it is known."""
    config = validate(FaultConfig, CASES, "cases")
    worker = run.SessionRunner(
        run.SessionPlan("lockstep", {"states_nan": 1}),
        tmp_path,
        config,
        1,
        queue.Queue(),
        "lockstep-1",
    )
    started: list[subprocess.Popen[str]] = []

    def popen(command: list[str], **options: Any) -> subprocess.Popen[str]:
        started.append(
            real([sys.executable, "-c", "import time; time.sleep(600)"], **options)
        )
        worker.stop()
        return started[-1]

    real = subprocess.Popen
    monkeypatch.setattr(run.subprocess, "Popen", popen)
    worker.start()
    worker.join(PATIENCE)
    assert not worker.is_alive()
    assert [process.poll() for process in started] == [-signal.SIGTERM]


def test_a_session_ends_its_nodes_however_often_it_is_told_to(tmp_path: Path) -> None:
    request = SessionRequest(
        str(tmp_path),
        "lockstep",
        {"states_nan": 1},
        CASES,
        seed=5,
        injector=True,
        record=False,
    )
    process = subprocess.Popen(
        [sys.executable, "-m", "dextar_control.experiments.faults.session"],
        cwd=ROOT,
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "ROS_DOMAIN_ID": str(101 + os.getpid() % 100)},
    )
    assert process.stdin is not None
    process.stdin.write(json.dumps(asdict(request)) + "\n")
    process.stdin.flush()
    nodes: set[int] = set()
    while len(nodes) < 3:  # plant, controller, trajectory server
        assert process.poll() is None
        nodes |= {
            child
            for child in map(int, children(process.pid))
            if "--ros-args" in command_line(child)
        }
        time.sleep(0.02)
    while process.poll() is None:
        process.send_signal(signal.SIGTERM)
        time.sleep(0.02)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 128 + signal.SIGTERM, errors
    assert "Traceback" not in errors
    assert not any(command_line(node) for node in nodes)


def children(pid: int) -> list[str]:
    try:
        return [
            child
            for task in Path(f"/proc/{pid}/task").iterdir()
            for child in (task / "children").read_text().split()
        ]
    except OSError:
        return []


def command_line(pid: int) -> str:
    """Empty for a process that is gone."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")
    except OSError:
        return ""
