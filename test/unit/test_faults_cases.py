"""The file of cases, the choice among them, and the table that comes of it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from PIL import Image

from dextar_control.cli import main as cli
from dextar_control.contract.errors import ParameterError
from dextar_control.contract.resources import config_file
from dextar_control.contract.validation import validate
from dextar_control.experiments.faults.cases import FaultConfig, load_cases
from dextar_control.experiments.faults.figure import draw
from dextar_control.experiments.faults.judgement import Check, Outcome
from dextar_control.experiments.faults.link import MessageShape
from dextar_control.experiments.faults.run import select, session_plans
from dextar_control.experiments.faults.table import Summary

ROOT = Path(__file__).resolve().parents[2]
FILE = config_file("faults.yaml")
NODES = {"controller", "plant", "trajectory_server", "recorder"}


def test_the_shipped_file_tries_at_least_a_thousand_crossings_and_every_kind_of_fault() -> (
    None
):
    cases = load_cases(FILE).cases.values()
    assert sum(case.crossings for case in cases) >= 1000
    mild = [case for case in cases if case.transport]
    transports = [
        (way, key, value)
        for case in mild
        for way in case.ways
        for key, value in case.transport.items()
    ]
    for way in ("states", "commands"):
        for share in (0.01, 0.05, 0.2):
            assert (way, "drop", share) in transports
        for kind in ("duplicate", "reorder", "delay", "jitter"):
            assert any(item[:2] == (way, kind) for item in transports)
        outages = [
            case.window.lasting
            for case in cases
            if case.window and case.window.shape == "outage" and way in case.ways
        ]
        assert {0.005, 0.1} <= set(outages)
    delays = [value for _, key, value in transports if key == "delay"]
    assert min(delays) == 0.001 and max(delays) == 0.01
    assert {case.window.shape for case in cases if case.window} == {
        shape.value for shape in MessageShape
    }
    assert {(case.kill.node, case.kill.signal) for case in cases if case.kill} == {
        (node, number) for node in NODES for number in ("SIGKILL", "SIGTERM")
    }
    assert {case.kind for case in cases} >= {
        "commander",
        "flood",
        "parameters",
        "disk",
        "network",
    }
    network = {key for case in cases if case.network for key in case.network}
    assert network >= {"loss", "delay", "reorder"}
    assert all(Outcome.MISSED.value not in case.expect for case in cases)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"on": ["states"]}, "unknown key 'on'"),
        ({"kill": {"node": "plant", "signal": "SIGHUP"}}, "'SIGHUP' is not valid"),
        (
            {"window": {"shape": "nan", "lasting": 0.01}},
            "it has transport and window; it must have exactly one",
        ),
        ({"transport": None}, "it has no fault"),
        (
            {"transport": {"drop": 1.5}},
            r"transport drop = 1.5; it must lie in \[0, 1\]",
        ),
        ({"expect": ["survived"]}, "unknown outcome 'survived'"),
        ({"transport": None, "commander": True}, "commander needs the clock realtime"),
    ],
)
def test_a_wrong_case_is_refused_with_its_name_and_the_reason(
    change: dict[str, Any], message: str
) -> None:
    case = {
        "title": "t",
        "transport": {"drop": 0.1},
        "crossings": 1,
        "expect": ["crossed"],
    } | change
    case = {key: value for key, value in case.items() if value is not None}
    with pytest.raises(ParameterError, match=message) as caught:
        validate(
            FaultConfig,
            {"trip": {"duration": 0.33, "dwell": 0.06}, "cases": {"mine": case}},
            "file",
        )
    assert "cases.mine" in str(caught.value)


def test_cases_are_chosen_by_name_or_beginning_and_shared_among_the_sets_of_nodes() -> (
    None
):
    config = load_cases(FILE)
    assert list(select(config, ["states_nan"], 3, quick=False).items()) == [
        ("states_nan", 3)
    ]
    assert set(select(config, ["network"], None, quick=False)) == {
        name for name in config.cases if name.startswith("network")
    }
    quick = select(config, [], None, quick=True)
    assert all(config.cases[name].clock == "lockstep" for name in quick), (
        "a quick run must not depend on the machine's noise"
    )
    everything = select(config, [], None, quick=False)
    groups = session_plans(config, everything, 2)
    assert [[plan.kind for plan in group] for group in groups] == [
        ["lockstep", "lockstep"],
        ["realtime"],
        ["network"],
    ]
    assert {
        name: count
        for group in groups
        for plan in group
        for name, count in plan.cases.items()
    } == everything
    with pytest.raises(
        ParameterError, match="unknown case 'nothing'; known are: states_lost_1"
    ):
        select(config, ["nothing"], None, quick=False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--cases", "nothing"), "unknown case 'nothing'"),
        (("missing.yaml",), "No such file"),
        (("--count", "0"), "1 to 100000"),
    ],
)
def test_the_command_refuses_a_wrong_argument_with_one_line(
    arguments: tuple[str, ...],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    try:
        code = cli.main(["faults", *arguments, "--output", str(tmp_path)])
    except SystemExit as end:  # argparse's
        code = end.code
    assert code == 2
    assert message in capsys.readouterr().err


def record(case: str, outcome: Outcome, **changes: Any) -> dict[str, Any]:
    fields = {
        "where": "before",
        "offset": -0.05,
        "reason": "",
        "true_error": 1e-4,
        "reported": ["plant.late_ticks"],
    }
    return (
        {
            "event": "record",
            "case": case,
            "outcome": outcome.value,
            "expected": True,
            "recovered": True,
        }
        | fields
        | changes
    )


def filled() -> Summary:
    summary = Summary.of(
        load_cases(FILE), ["states_lost_20", "controller_sigkill", "service_flood"]
    )
    summary.take(record("states_lost_20", Outcome.CROSSED))
    summary.take(
        record("states_lost_20", Outcome.CROSSED, where="after", true_error=3e-4)
    )
    summary.take(
        record(
            "controller_sigkill",
            Outcome.NO_TORQUE,
            curve=[[-0.01, 0.05], [0.0, 0.05], [0.03, 0.0], [0.12, 0.0]],
        )
    )
    summary.take(record("service_flood", Outcome.DISTURBED))
    summary.take(
        {
            "event": "checks",
            "case": "",
            "looked": {Check.TORQUE_LIMIT.value: 12},
            "violations": [],
        }
    )
    return summary


def test_the_table_counts_each_case_and_not_what_the_machine_disturbed(
    tmp_path: Path,
) -> None:
    summary = filled()
    assert summary.good and summary.count == 3
    lines = summary.markdown().splitlines()
    wanted = (
        "| states: 20 % lost | before 1, after 1 | crossed | crossed 2 | 0.3 |"
        " plant.late_ticks 2 | 2 |"
    )
    assert wanted in lines
    assert "| torque beyond the limit | 12 | 0 |" in lines
    assert all(line.count("|") in (0, 4, 8) for line in lines)
    data = json.loads(json.dumps(summary.to_dict()))
    assert data["cases"]["controller_sigkill"]["outcomes"] == {"no torque": 1}
    summary.cases["states_lost_20"].title = r"$\frac{"  # no formula
    draw(summary, 0.02).savefig(tmp_path / "figure.png", dpi=60)
    with Image.open(tmp_path / "figure.png") as image:
        low, high = image.convert("L").getextrema()
        assert low < 64 and high == 255  # ink on paper


@pytest.mark.parametrize(
    "event",
    [
        record("states_lost_20", Outcome.FAULT, expected=False, reason="no state"),
        record("states_lost_20", Outcome.CROSSED, recovered=False),
        {
            "event": "checks",
            "case": "",
            "looked": {},
            "violations": [[Check.BAG.value, "run.mcap"]],
        },
        {"event": "failed", "case": "service_flood", "text": "the plant ended"},
    ],
)
def test_a_run_is_not_good_with_one_bad_event(event: dict[str, Any]) -> None:
    summary = filled()
    summary.take(event)
    assert not summary.good
    assert len(summary.troubles()) == 1
    assert summary.troubles()[0] in summary.markdown()


def test_every_way_of_reporting_in_the_file_is_one_that_is_understood() -> None:
    ways = {
        way
        for case in yaml.safe_load(FILE.read_text())["cases"].values()
        for way in case.get("reported", [])
    }
    nodes = "|".join(NODES)
    assert all(
        re.fullmatch(rf"({nodes})\.\w+(~.+)?|(exit|silent)\.({nodes})|answer~.+", way)
        for way in ways
    )
