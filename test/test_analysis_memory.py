"""What a long bag takes of memory: its columns lie in files, so that a run's own memory hardly grows with its length."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import long_run
import pytest
from synthetic_run import write_run

from dextar_control.analysis import compute_metrics, load_run
from dextar_control.analysis.load import MEMORY

SHORT, LONG = 2, 10  # s


def peak(file: Path) -> int:
    """Largest traced size while the run is loaded and measured, bytes; files that are mapped are not in it."""
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


def test_the_columns_lie_in_no_file_that_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_run(tmp_path / "run.mcap")
    (tmp_path / "spool").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "spool"))
    run = load_run(tmp_path / "run.mcap")
    assert not list((tmp_path / "spool").iterdir())
    assert run.states.position[5, 0] == pytest.approx(run.states.position[6, 0], abs=1e-3)
