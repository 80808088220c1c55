"""Tables hold the recorded numbers, joined by stamp, with their units."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
from scipy.io import loadmat
from synthetic_run import (
    CROSSINGS,
    DECIDED,
    MISSED,
    START,
    TICKS,
    TRUE_OFFSET,
    effort_at,
    joints_of,
    path,
    write_run,
)

from dextar_control.analysis import load_run
from dextar_control.analysis.table import export
from dextar_control.cli import main as cli

WORDS = ("phase", "verdict")
UNITS = {"ns", "s", "m", "m/s", "m/s^2", "rad", "rad/s", "N m", "N", "1"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("export")
    write_run(place / "run.mcap")
    formats = [
        word for name in ("parquet", "csv", "mat") for word in ("--format", name)
    ]
    assert cli.main(["export", str(place / "run.mcap"), "--topics", *formats]) == 0
    return place / "export"


def test_each_state_has_a_row_with_everything_of_its_stamp(folder: Path) -> None:
    table = pyarrow.parquet.read_table(folder / "run.parquet")
    assert table.num_rows == TICKS
    columns = {name: table.column(name).to_pylist() for name in table.column_names}
    for tick in (0, 100, 359, 1000):
        y = path(tick * 1e-3)[0]
        assert columns["stamp"][tick] == START + tick * 1_000_000
        assert columns["time"][tick] == pytest.approx(tick * 1e-3, abs=1e-12)
        assert (
            columns["q11_position"][tick],
            columns["q21_position"][tick],
        ) == joints_of(y + TRUE_OFFSET)
        assert (
            columns["command_q11_effort"][tick],
            columns["command_q21_effort"][tick],
        ) == effort_at(tick)
        assert columns["reference_y"][tick] == y
        assert columns["true_y"][tick] == y + TRUE_OFFSET
        assert columns["phase"][tick] == "TRACK"
        decided = any(
            crossing + DECIDED <= tick * 1e-3 < crossing + 0.4 for crossing in CROSSINGS
        )
        assert columns["verdict"][tick] == ("crossed" if decided else "undecided")


def test_what_was_not_recorded_is_null_not_a_number(folder: Path) -> None:
    table = pyarrow.parquet.read_table(folder / "run.parquet")
    nulls = [
        row
        for row, value in enumerate(table.column("command_q11_effort").to_pylist())
        if value is None
    ]
    assert nulls == list(MISSED)
    assert [table.column("command_published").to_pylist()[row] for row in MISSED] == [
        None
    ] * 3


def test_every_column_has_a_unit_and_a_meaning(folder: Path) -> None:
    schema = pyarrow.parquet.read_schema(folder / "run.parquet")
    for field in schema:
        assert field.metadata[b"meaning"]
        assert field.name in WORDS or field.metadata[b"unit"].decode() in UNITS, (
            field.name
        )
    assert json.loads(schema.metadata[b"robot"])["base_distance"] == 0.118
    assert (
        json.loads(schema.metadata[b"parameters"])["controller"]["law"] == "consistent"
    )


def test_words_are_categories_whose_meaning_stands_with_the_column(
    folder: Path,
) -> None:
    frame = pyarrow.parquet.read_table(folder / "run.parquet")
    for name, words in (
        ("verdict", ("undecided", "crossed", "bounced")),
        ("phase", ("TRACK", "SAFE_STOP")),
    ):
        assert pa.types.is_dictionary(frame.schema.field(name).type)
        assert all(
            word in frame.schema.field(name).metadata[b"meaning"].decode()
            for word in words
        )


def test_a_verdict_that_was_not_recorded_is_null(tmp_path: Path) -> None:
    write_run(tmp_path / "old.mcap", says=None)
    export(load_run(tmp_path / "old.mcap"), tmp_path, ["parquet"])
    assert set(
        pyarrow.parquet.read_table(tmp_path / "run.parquet")
        .column("verdict")
        .to_pylist()
    ) == {None}


def test_csv_holds_the_same_numbers_under_names_with_units(folder: Path) -> None:
    table, parquet = (
        pyarrow.csv.read_csv(folder / "run.csv"),
        pyarrow.parquet.read_table(folder / "run.parquet"),
    )
    assert "true_x [m]" in table.column_names and "phase" in table.column_names
    for name, column in zip(parquet.column_names, table.columns, strict=True):
        if name in WORDS:
            assert column.to_pylist() == parquet.column(name).to_pylist()
        else:
            ours = parquet.column(name).to_numpy(zero_copy_only=False).astype(float)
            theirs = column.to_numpy(zero_copy_only=False).astype(float)
            assert np.array_equal(ours, theirs, equal_nan=True), name
    assert json.loads((folder / "columns.json").read_text())["run"][
        "command_q11_effort"
    ] == {"unit": "N m", "meaning": "commanded torque"}


def test_matlab_gets_a_struct_of_columns(folder: Path) -> None:
    content = loadmat(folder / "run.mat", squeeze_me=True, struct_as_record=False)
    parquet = pyarrow.parquet.read_table(folder / "run.parquet")
    run = content["run"]
    assert np.array_equal(run.true_y, parquet.column("true_y").to_numpy())
    assert run.stamp.dtype == np.int64 and run.stamp[5] == START + 5_000_000
    assert np.flatnonzero(np.isnan(run.command_q11_effort)).tolist() == list(MISSED)
    assert run.phase[0] == "TRACK"
    assert (run.verdict[0], run.verdict[-1]) == ("undecided", "crossed")
    assert content["units"].true_y == "m"


def test_each_topic_has_its_own_rows(folder: Path) -> None:
    counts = {
        "states": TICKS,
        "commands": TICKS - len(MISSED),
        "controller_state": TICKS,
        "criterion": TICKS,
        "truth": TICKS,
        "trajectory": TICKS,
    }
    for name, count in counts.items():
        assert (
            pyarrow.parquet.read_table(folder / f"{name}.parquet").num_rows == count
        ), name


def test_a_rigs_bag_has_no_true_column(tmp_path: Path) -> None:
    write_run(tmp_path / "rig.mcap", truth=False)
    export(load_run(tmp_path / "rig.mcap"), tmp_path, ["parquet"], topics=True)
    assert not [
        name
        for name in pyarrow.parquet.read_table(tmp_path / "run.parquet").column_names
        if name.startswith("true")
    ]
    assert (tmp_path / "states.parquet").exists() and not (
        tmp_path / "truth.parquet"
    ).exists()


def test_a_folder_that_cannot_be_written_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_run(tmp_path / "run.mcap")
    (tmp_path / "taken").write_text("")
    assert (
        cli.main(
            ["export", str(tmp_path / "run.mcap"), "--output", str(tmp_path / "taken")]
        )
        == 2
    )
    error = capsys.readouterr().err
    assert error.startswith("dextar export: cannot write to") and error.count("\n") == 1


def test_only_parquet_needs_pyarrow(
    tmp_path: Path,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)  # its import fails
    write_run(tmp_path / "run.mcap")
    export = ["export", str(tmp_path / "run.mcap")]
    kinds = [["--format", kind] for kind in ("csv", "mat", "parquet")]
    assert [cli.main(export + kind) for kind in (*kinds, [])] == [0, 0, 2, 2]
    refused = capsys.readouterr().err.splitlines()
    assert len(refused) == 2
    for line in refused:
        assert line.startswith(
            "dextar export: --format parquet (--format csv does not) needs the package"
            " pyarrow"
        )
    assert (tmp_path / "export" / "run.csv").read_bytes() == (
        folder / "run.csv"
    ).read_bytes()


def test_csv_writes_what_python_reads_back_to_the_last_bit(folder: Path) -> None:
    with (folder / "run.csv").open(newline="") as stream:
        lines = list(csv.reader(stream))
    column = lines[0].index("q11_position [rad]")
    run = load_run(folder.parent / "run.mcap")
    assert [float(line[column]) for line in lines[1:]] == run.states.position[
        :, 0
    ].tolist()
    assert [
        row
        for row, line in enumerate(lines[1:])
        if line[lines[0].index("command_q11_effort [N m]")] == ""
    ] == list(MISSED)
