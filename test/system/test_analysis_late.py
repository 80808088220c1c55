"""A run that failed because commands came too late says so; no other does."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from synthetic_run import PERIOD, START, _diagnostics, write_run
from test_analysis_clock import in_time
from test_analysis_passed_over import messages_of, record_of, serialized, write

from dextar_control.analysis import Metrics, compute_metrics, load_run
from dextar_control.analysis.report import summary_lines
from dextar_control.cli import main as cli

ROUND_TRIP = 10_000_000  # ns


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that ends in a safe stop."""
    file = tmp_path_factory.mktemp("stopped") / "run.mcap"
    write_run(file, last_phase=5)
    return file


def busy(
    source: Path,
    target: Path,
    mode: str = "realtime",
    late: int = 640,
    trip: int = ROUND_TRIP,
) -> Path:
    """The run with the plant's counts, and each command published so long after its
    state.
    """
    counts = {
        "late_commands": "500",
        "late_ticks": str(late),
        "steps": "1000",
        "mode": mode,
    }
    messages = []
    for _, (topic, kind, encoding, time, _, data) in in_time(messages_of(source)):
        if topic == "/diagnostics" and b"/plant" in data:
            data = serialized(_diagnostics("plant", "running", counts))
        messages.append(
            (
                topic,
                kind,
                encoding,
                time,
                time + trip * (topic == "/joint_commands"),
                data,
            )
        )
    record = record_of(source)
    record["dextar"]["parameters.plant"] = yaml.safe_dump({"mode": mode})
    return write(target, messages, metadata=record)


def blamed(metrics: Metrics) -> list[str]:
    return [reason for reason in metrics.reasons if "too late" in reason]


def test_a_starved_run_says_that_commands_came_too_late_and_what_to_do(
    stopped: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["analyze", str(busy(stopped, tmp_path / "run.mcap"))]) == 1
    found = json.loads((tmp_path / "metrics.json").read_text())
    assert found["success"] is False
    first, *others = found["reasons"]
    assert "commands came too late: 100% of the steps had none in time" in first
    assert "it took 10.0 ms (median), 10.0 ms at worst, and a step is 1.0 ms" in first
    assert "machine was too busy" in first and "without --real-time" in first
    assert any(
        "SAFE_STOP" in reason for reason in others
    )  # what it ended with is still said
    assert found["late_share"] == 1.0
    said = capsys.readouterr().out
    assert "commands came too late" in said and "640 of 1000 (64%)" in said
    assert "commands came too late: 100%" in (tmp_path / "report.html").read_text()


def test_the_plants_own_count_suffices(stopped: Path, tmp_path: Path) -> None:
    metrics = compute_metrics(
        load_run(busy(stopped, tmp_path / "run.mcap", trip=300_000))
    )
    assert metrics.late_share == 0.64
    assert len(blamed(metrics)) == 1 and "64% of the steps" in blamed(metrics)[0]
    assert (
        dict(summary_lines(metrics))["steps without it in time"]
        == "640 of 1000 (64%); 500 commands came later"
    )


@pytest.mark.parametrize("kind", ["lockstep", "few late", "success"])
def test_lateness_is_not_blamed_where_it_was_not_the_cause(
    kind: str, stopped: Path, tmp_path: Path
) -> None:
    source, options = stopped, dict[str, Any]()
    if kind == "lockstep":
        options = {"mode": "lockstep"}
    elif kind == "few late":
        options = {"late": 100, "trip": 300_000}
    else:
        source = tmp_path / "good.mcap"
        write_run(source)
    metrics = compute_metrics(load_run(busy(source, tmp_path / "run.mcap", **options)))
    assert metrics.success is (kind == "success")
    assert blamed(metrics) == []
    assert math.isnan(metrics.timing.late_share) == (kind == "lockstep")


def test_a_run_whose_clock_is_unknown_is_not_called_late_by_its_times(
    stopped: Path, tmp_path: Path
) -> None:
    bag = write(
        tmp_path / "run.mcap",
        [
            (topic, kind, encoding, time, START + 3 * (time - START), data)
            for topic, kind, encoding, time, _, data in (
                one for _, one in in_time(messages_of(stopped))
            )
        ],
        metadata=record_of(stopped),
    )
    metrics = compute_metrics(load_run(bag))
    assert (
        metrics.timing.lockstep is None
        and math.isnan(metrics.late_share)
        and PERIOD == 1_000_000
    )
    assert blamed(metrics) == []
