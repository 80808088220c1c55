"""What a long bag takes of memory: its columns lie in files, so that a run's own memory
hardly grows with its length.
"""

from __future__ import annotations

import copy
import subprocess
import sys
import tracemalloc
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import independent_numbers
import long_run
import pytest
from recorded_run import rewrite
from synthetic_run import START, write_run

from dextar_control.analysis import compute_metrics, load_run
from dextar_control.analysis.load import MEMORY

SHORT, LONG = 2, 10  # s
IDLE = 300_000_000  # ns


def peak(file: Path) -> int:
    """Largest traced size while the run is loaded and measured, bytes; files that are
    mapped are not in it.
    """
    tracemalloc.start()
    try:
        run = load_run(file)
        compute_metrics(run)
        assert run.truth is not None
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_a_longer_bag_takes_less_than_the_bound_more(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap")
    files = {seconds: tmp_path / f"{seconds}.mcap" for seconds in (SHORT, LONG)}
    for seconds, file in files.items():
        long_run.main(tmp_path / "run.mcap", file, seconds)
    compute_metrics(load_run(files[SHORT]))  # compiles
    growth = (peak(files[LONG]) - peak(files[SHORT])) / (LONG - SHORT)
    print(f"{growth:.0f} bytes for each recorded second")
    assert growth < MEMORY


def test_the_columns_lie_in_no_file_that_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_run(tmp_path / "run.mcap")
    (tmp_path / "spool").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "spool"))
    run = load_run(tmp_path / "run.mcap")
    assert not list((tmp_path / "spool").iterdir())
    assert run.states.position[5, 0] == pytest.approx(
        run.states.position[6, 0], abs=1e-3
    )


def with_rest_before(topic: str, message: Any) -> Iterable[tuple[str, Any]]:
    """Also as it would have been told before the trajectory began, at rest."""
    if topic in long_run.STAMPED:
        begun = (
            message.header.stamp.sec - START // 10**9
        ) * 10**9 + message.header.stamp.nanosec
        if begun < IDLE:
            early = copy.deepcopy(message)
            stamp = START + begun - IDLE
            early.header.stamp.__dict__.update(
                sec=stamp // 10**9, nanosec=stamp % 10**9
            )
            if topic == "/criterion":
                early.position[list(early.name).index("phase")] = 1.0
            if topic == "/controller_state":
                early.points[0].time_from_start.__dict__.update(sec=0, nanosec=0)
            yield topic, early
    yield topic, message


def test_a_long_bag_crosses_as_often_as_its_copies_do_together(tmp_path: Path) -> None:
    write_run(tmp_path / "plain.mcap")
    rewrite(tmp_path / "plain.mcap", tmp_path / "run.mcap", with_rest_before)
    long_run.main(tmp_path / "run.mcap", tmp_path / "long.mcap", 3.0)
    metrics = compute_metrics(load_run(tmp_path / "long.mcap"))
    assert [crossing.crossed for crossing in metrics.crossings] == [True] * 6


@pytest.mark.parametrize("script", [long_run, independent_numbers])
def test_a_script_for_measurements_says_what_it_wants(
    script: Any, tmp_path: Path
) -> None:
    def asked(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, script.__file__, *words]
        return subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=False
        )

    others = ["long.mcap", "20"] if script is long_run else []
    assert asked("--help").returncode == 0
    for answer, said in (
        (asked(), "required"),
        (asked("none.mcap", *others), "none.mcap is no file"),
    ):
        assert (
            answer.returncode,
            said in answer.stderr,
            "Traceback" in answer.stderr,
        ) == (2, True, False)
