"""Bags with damage in their middle: what is left is read, what is missing is told, and
nothing is made up for it.
"""

from __future__ import annotations

import json
import random
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from damaged import chunks, with_damaged_chunks
from mcap.opcode import Opcode
from synthetic_run import TICKS, write_run

from dextar_control.analysis import Metrics, Run, compute_metrics, load_run
from dextar_control.analysis.tracking import plan_of
from dextar_control.analysis.verdict import judge
from dextar_control.bags import mcap_file
from dextar_control.bags.damage import Hole
from dextar_control.bags.recover import recover
from dextar_control.cli import main as cli
from dextar_control.planning.checks import clear_times

CHUNK = 60_000  # bytes: about thirty ticks
TRIALS = 30  # of damage at random
pytestmark = [
    pytest.mark.usefixtures("patient"),
    pytest.mark.filterwarnings("ignore::UserWarning"),
]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("run") / "run.mcap"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mcap_file, "CHUNK_SIZE", CHUNK)
        write_run(file)
    assert len(chunks(file)) > 20
    return file


@pytest.fixture(scope="module")
def intact(bag: Path) -> tuple[Run, Metrics]:
    run = load_run(bag)
    return run, compute_metrics(run)


def missing_stamps(intact: Run, run: Run) -> np.ndarray:
    """Of the ticks of which some message is not there."""
    lost = [
        np.setdiff1d(whole.stamps, left.stamps)
        for whole, left in (
            (intact.states, run.states),
            (intact.commands, run.commands),
            (intact.control, run.control),
            (intact.criterion, run.criterion),
            (intact.truth, run.truth),
        )
    ]
    return np.unique(np.concatenate(lost))


@pytest.mark.parametrize("share", [0.1, 0.24, 0.5, 0.76, 0.9])
def test_no_crossing_in_a_hole_is_judged_and_the_others_keep_their_numbers(
    bag: Path, intact: tuple[Run, Metrics], tmp_path: Path, share: float
) -> None:
    whole, expected = intact
    number = min(
        round(share * len(chunks(bag))), len(chunks(bag)) - 5
    )  # not at the end
    run = load_run(with_damaged_chunks(bag, tmp_path / "run.mcap", number, number + 1))
    metrics = compute_metrics(run)
    missing = missing_stamps(whole, run)
    assert len(missing) > 10
    (hole,) = metrics.holes
    assert (hole.file, hole.chunks, run.truncated) == ("run.mcap", 2, False)
    assert (
        hole.begin < missing[0] < hole.begin + 3_000_000
        and hole.end - 3_000_000 < missing[-1] < hole.end
    )
    plan, start = plan_of(whole), expected.start_stamp
    for index, (crossing, before) in enumerate(
        zip(metrics.crossings, expected.crossings, strict=True)
    ):
        first, last = (start + 1e9 * time for time in clear_times(plan, index))
        if ((missing > first) & (missing < last)).any():
            assert (crossing.outcome, crossing.crossed, crossing.true_time) == (
                "not recorded",
                None,
                None,
            )
            assert np.isnan(
                [
                    crossing.speed,
                    crossing.residual,
                    crossing.peak_torque,
                    crossing.error_before,
                ]
            ).all()
        else:
            assert (crossing.outcome, crossing.true_time) == (
                "crossed",
                before.true_time,
            )
            assert (crossing.speed, crossing.peak_torque) == (
                before.speed,
                before.peak_torque,
            )
    assert metrics.success is None
    assert any(
        "no message is left of 2 damaged chunks of run.mcap" in reason
        for reason in metrics.reasons
    )


def test_a_trajectory_whose_end_lies_in_a_hole_did_not_end_early(
    intact: tuple[Run, Metrics],
) -> None:
    _, expected = intact
    early = replace(expected, tracked_until=0.9, final_true_error=1.0)

    def judged(begin: float, end: float | None) -> tuple[bool | None, int]:
        stamps = [
            None if time is None else expected.start_stamp + round(1e9 * time)
            for time in (begin, end)
        ]
        holed = replace(early, holes=[Hole("run.mcap", 1, 0, 1, *stamps)])
        success, reasons = judge(holed, has_truth=True)
        return success, len(reasons)

    assert judged(0.9, 1.5) == judged(0.9, None) == (None, 1)
    # the hole came later: it ended early, and far from the plan
    assert judged(1.2, 1.5) == (False, 2)


def test_a_hole_is_neither_a_long_period_nor_states_without_a_command(
    bag: Path, intact: tuple[Run, Metrics], tmp_path: Path
) -> None:
    _, expected = intact
    metrics = compute_metrics(
        load_run(with_damaged_chunks(bag, tmp_path / "run.mcap", 5, 20))
    )
    assert metrics.timing.missed_runs == expected.timing.missed_runs
    assert metrics.timing.state_period.maximum <= expected.timing.state_period.maximum
    assert (
        metrics.timing.command_period.maximum <= expected.timing.command_period.maximum
    )
    assert metrics.missed == expected.missed


def test_topics_described_in_a_damaged_chunk_are_described_at_the_end_too(
    bag: Path, tmp_path: Path
) -> None:
    run = load_run(with_damaged_chunks(bag, tmp_path / "run.mcap", 0, 1))
    assert 0.9 * TICKS < len(run.states.stamps) < TICKS
    assert run.trajectory is None
    assert run.holes[0].begin is None and run.holes[0].end in run.states.stamps[:2]


def test_a_chunk_that_is_not_seen_as_one_is_missed_by_the_files_own_count(
    bag: Path, tmp_path: Path
) -> None:
    content = bytearray(bag.read_bytes())
    opcode = chunks(bag)[10][0] - 9
    assert content[opcode] == Opcode.CHUNK
    content[opcode] = Opcode.MESSAGE_INDEX
    (tmp_path / "run.mcap").write_bytes(content)
    metrics = compute_metrics(load_run(tmp_path / "run.mcap"))
    assert len(metrics.holes) == 1
    assert metrics.success is None and {
        crossing.outcome for crossing in metrics.crossings
    } == {"not recorded"}


def test_a_damaged_last_chunk_is_a_missing_end(bag: Path, tmp_path: Path) -> None:
    run = load_run(
        with_damaged_chunks(bag, tmp_path / "run.mcap", len(chunks(bag)) - 1)
    )
    assert run.truncated
    assert [(hole.chunks, hole.end) for hole in run.holes] == [(1, None)]


def test_the_command_says_what_is_missing_and_where(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hurt = with_damaged_chunks(bag, tmp_path / "run.mcap", 10, 20)
    assert cli.main(["analyze", str(hurt)]) == 1
    printed = capsys.readouterr()
    (line,) = printed.err.splitlines()
    assert (
        len(
            re.findall(
                rf"no message is left of 1 damaged chunk of {hurt}, for 0.00\d s;", line
            )
        )
        == 2
    )
    assert "breaks off" not in line + printed.out
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert [hole["chunks"] for hole in metrics["holes"]] == [1, 1]
    assert metrics["truncated"] is False and metrics["success"] is None
    assert (
        "No message is left of 1 damaged chunk of run.mcap"
        in (tmp_path / "report.html").read_text()
    )


def test_of_a_cut_bag_the_end_and_its_losses_are_not_known(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "run.mcap"
    cut.write_bytes(bag.read_bytes()[: chunks(bag)[20][1]])
    assert cli.main(["analyze", str(cut)]) == 1
    words = " ".join(re.sub(r"[^\w/:.;,]+", " ", capsys.readouterr().out).split())
    assert (
        "/joint_states: 3 by the last count; the end is missing, and what was lost"
        " there is unknown" in words
    )
    assert "3, end unknown" in (tmp_path / "report.html").read_text()


def test_a_bag_cut_before_its_first_chunk_is_one_line(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "run.mcap"
    cut.write_bytes(bag.read_bytes()[: chunks(bag)[0][1] - 10])
    assert cli.main(["analyze", str(cut)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"dextar analyze: {cut} holds no ROS 2 message: ")
    assert "breaks off" in line


@pytest.mark.parametrize("command", ["export", "recover"])
def test_whatever_is_damaged_there_is_one_message_and_no_traceback(
    command: str, bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    random_source, whole = random.Random(3), bag.read_bytes()
    for trial in range(TRIALS):
        content = bytearray(whole)
        if trial % 2:
            del content[random_source.randrange(len(content)) :]
        for _ in range(random_source.choice((0, 1, 3, 100)) if content else 0):
            content[random_source.randrange(len(content))] = random_source.randrange(
                256
            )
        hurt = tmp_path / f"{trial}.mcap"
        hurt.write_bytes(content)
        options = (
            ["--output", str(tmp_path / "out"), "--format", "csv"]
            if command == "export"
            else []
        )
        code = cli.main([command, str(hurt), *options])
        lines = capsys.readouterr().err.splitlines()
        assert code in ((0, 1, 2) if command == "export" else (0, 2)), (
            trial
        )  # 1: written, but not all is there
        assert len(lines) == 1 if code else len(lines) <= 1, (trial, lines)
        assert all(line.startswith(f"dextar {command}: ") for line in lines)


def test_a_recovered_bag_still_says_what_is_missing(bag: Path, tmp_path: Path) -> None:
    """Recovered once, and once more after another damage: holes and end are the damaged
    bag's, and nothing there is judged.
    """
    middle = chunks(bag)
    damaged = with_damaged_chunks(bag, tmp_path / "run.mcap", len(middle) // 2)
    with pytest.warns(UserWarning, match="damaged"):
        run = load_run(damaged)
    folder = recover(damaged).folder
    with pytest.warns(UserWarning, match="damaged"):
        again = load_run(folder)
    spans = [(hole.chunks, hole.first, hole.last) for hole in run.holes]
    assert [(hole.chunks, hole.first, hole.last) for hole in again.holes] == spans != []
    assert not again.truncated
    before, after = compute_metrics(run), compute_metrics(again)
    assert [crossing.outcome for crossing in before.crossings] == [
        crossing.outcome for crossing in after.crossings
    ]
    assert (after.success, after.missed, after.loop_rate) == (
        before.success,
        before.missed,
        before.loop_rate,
    )

    cut = tmp_path / "cut.mcap"
    content = (folder / "run.mcap").read_bytes()
    cut.write_bytes(content[: len(content) * 9 // 10])
    with pytest.warns(UserWarning, match="damaged"):
        assert load_run(cut).truncated
    with pytest.warns(UserWarning, match="was recovered from a file that breaks off"):
        twice = load_run(recover(cut).folder)
    assert twice.truncated
