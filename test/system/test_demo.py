"""The real nodes in real processes over DDS, in lockstep: nothing here depends on
wall-clock speed.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.typesys import Stores, get_typestore

from dextar_control.analysis.load import load_run
from dextar_control.contract.topics import CLOCK, EXTERNAL_POSE, TOPICS

FOLDED = (
    (0.09**2 - 0.059**2) ** 0.5 - 0.09
)  # m, y on the axis where both elbows meet above and the distal links hang down
ROOT = Path(__file__).resolve().parents[2]


def dextar(*arguments: str) -> subprocess.CompletedProcess[str]:
    """The command as a user runs it."""
    return subprocess.run(
        [sys.executable, "-m", "dextar_control.cli.main", *arguments],
        capture_output=True,
        text=True,
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        timeout=300,
    )


def test_the_lockstep_demo_is_a_success_within_its_bars(demo: Path) -> None:
    metrics = json.loads((demo / "metrics.json").read_text())
    assert metrics["success"] is True
    assert metrics["max_true_error"] <= 0.3e-3
    assert metrics["final_true_error"] <= 0.1e-3
    assert metrics["torque_ratio"] <= 1.3
    assert metrics["torque_ratio_near"] <= 1.0
    assert metrics["missed"] == 0
    assert (demo / "figure.png").stat().st_size > 20_000


def test_the_lockstep_bag_holds_every_sample(demo: Path) -> None:
    run = load_run(demo / "run.mcap")
    stamps = run.states.stamps
    period = yaml.safe_load((ROOT / "config/crossing.yaml").read_text())["/**"][
        "ros__parameters"
    ]["task"]["sample_period"]
    assert stamps[0] == 0
    np.testing.assert_array_equal(np.diff(stamps), round(period * 1e9))
    assert set(stamps[:-1]) <= set(run.commands.stamps)


def test_rosbags_reads_every_contract_topic(demo: Path) -> None:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    present = [
        topic
        for topic in TOPICS
        if not topic.optional or topic in (CLOCK, EXTERNAL_POSE)
    ]
    wanted = {
        topic.name if topic.name.startswith("/") else f"/{topic.name}": topic.type
        for topic in present
    }
    typestore = get_typestore(Stores.ROS2_JAZZY)
    with (demo / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        seen = {}
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            if channel.topic not in seen:
                seen[channel.topic] = schema.name
                again = typestore.deserialize_cdr(message.data, schema.name)
                assert type(decoded).__name__ == schema.name.rpartition("/")[2]
                assert again is not None
    assert {name: seen.get(name) for name in wanted} == wanted


def test_analyze_gives_the_same_metrics_from_the_bag_alone(
    demo: Path, tmp_path: Path
) -> None:
    bag = tmp_path / "moved.mcap"
    bag.write_bytes((demo / "run.mcap").read_bytes())
    answer = dextar("analyze", str(bag), "--output", str(tmp_path))
    assert answer.returncode == 0, answer.stdout + answer.stderr
    again, first = (
        json.loads((folder / "metrics.json").read_text()) for folder in (tmp_path, demo)
    )
    assert again.pop("bag") != first.pop("bag")
    assert again == first


def test_two_lockstep_runs_give_bit_identical_states(
    demo: Path, tmp_path: Path
) -> None:
    answer = dextar("demo", "--lockstep", "--output", str(tmp_path))
    assert answer.returncode == 0, answer.stdout + answer.stderr
    first, second = (
        load_run(demo / "run.mcap"),
        load_run(tmp_path / "latest" / "run.mcap"),
    )
    length = min(len(first.states.stamps), len(second.states.stamps))
    assert length > 1000
    for name in ("position", "velocity", "effort"):
        np.testing.assert_array_equal(
            getattr(first.states, name)[:length], getattr(second.states, name)[:length]
        )
    np.testing.assert_array_equal(first.truth.x[:length], second.truth.x[:length])


def test_the_classic_law_on_the_direct_model_fails_and_says_why(tmp_path: Path) -> None:
    answer = dextar(
        "demo",
        "--lockstep",
        "--law",
        "classic",
        "--estimator",
        "plain",
        "--output",
        str(tmp_path),
    )
    assert answer.returncode == 1, answer.stdout + answer.stderr
    metrics = json.loads((tmp_path / "latest" / "metrics.json").read_text())
    assert metrics["success"] is False
    assert metrics["saturated"] > 0
    assert any("saturat" in reason for reason in metrics["reasons"])
    assert (tmp_path / "latest" / "figure.png").exists()


def test_a_trip_through_a_folded_point_begins_where_the_planner_lets_it_and_is_drawn(
    tmp_path: Path,
) -> None:
    answer = dextar(
        "demo",
        "--lockstep",
        "--point",
        "0.0",
        str(FOLDED),
        "--duration",
        "0.4",
        "--output",
        str(tmp_path),
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr
    metrics = json.loads((tmp_path / "latest" / "metrics.json").read_text())
    assert metrics["success"] is True
    for crossing in metrics["crossings"]:
        np.testing.assert_allclose(crossing["point"], [0.0, FOLDED], atol=1e-6)
        assert (crossing["verdict"], crossing["verdict_correct"]) == ("crossed", True)
    assert (tmp_path / "latest" / "plan.png").read_bytes().startswith(b"\x89PNG")


def test_a_tour_crosses_everywhere_and_the_estimator_knows_it(tmp_path: Path) -> None:
    answer = dextar("demo", "--lockstep", "--tour", "4", "--output", str(tmp_path))
    assert answer.returncode == 0, answer.stdout + answer.stderr
    metrics = json.loads((tmp_path / "latest" / "metrics.json").read_text())
    assert [(c["crossed"], c["verdict"]) for c in metrics["crossings"]] == [
        (True, "crossed")
    ] * 4
    assert len({tuple(c["point"]) for c in metrics["crossings"]}) == 4
    assert "4 crossed, 0 bounced, 0 undecided; agrees" in " ".join(
        answer.stdout.split()
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--point", "0.0", "0.05"), "off the Type 2 locus"),
        (
            ("--tour", "2", "-p", "trajectory_server.task.point:=[0.0, 0.08]"),
            "are given; one may be",
        ),
        (("--tour", "2", "--point", "0.0", "0.08"), "not allowed with argument"),
        (
            ("-p", "controller.law:=["),
            "-p controller.law:=[, line 1: while parsing a flow node",
        ),
        (
            ("--params", "/dev/zero"),
            (
                "parameter file /dev/zero is a pipe or a device; each node reads it, so"
                " it must be a file"
            ),
        ),
    ],
)
def test_a_demo_that_cannot_be_planned_says_so(
    arguments: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    answer = dextar("demo", "--lockstep", *arguments, "--output", str(tmp_path))
    assert answer.returncode == 2, answer.stdout + answer.stderr
    assert message in " ".join((answer.stdout + answer.stderr).split())
    assert "Traceback" not in answer.stderr
