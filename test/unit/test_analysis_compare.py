"""Runs side by side: the same quantities with their differences."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from synthetic_run import CROSSINGS, TRUE_OFFSET, path, write_run

from dextar_control.analysis import Metrics, Run, compute_metrics, load_run
from dextar_control.analysis.compare import (
    COMPARED,
    OF_THE_MACHINE,
    Comparison,
    by_matter,
    compare_runs,
    overlaid,
    render_comparison,
)
from dextar_control.cli import main as cli

ESTIMATED_ERROR = 0.02  # mm
FARTHER = 3.0e-4  # m, added to the true y of the second run


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Run:
    file = tmp_path_factory.mktemp("good") / "run.mcap"
    write_run(file)
    return load_run(file)


@pytest.fixture(scope="module")
def comparison(good: Run) -> Comparison:
    truth = good.truth
    assert truth is not None
    worse = dataclasses.replace(
        good, truth=dataclasses.replace(truth, x=truth.x + [0.0, FARTHER])
    )
    rig = dataclasses.replace(good, truth=None)
    runs = [good, worse, rig]
    return compare_runs(
        runs, [compute_metrics(run) for run in runs], ["good", "worse", "rig"]
    )


def line(comparison: Comparison, name: str) -> dict[str, object]:
    entries = json.loads(comparison.to_json())["quantities"]
    return next(entry for entry in entries if entry["name"] == name)


def test_a_difference_is_the_later_run_less_the_first(comparison: Comparison) -> None:
    entry = line(comparison, "true error, largest")
    assert entry["unit"] == "mm"
    assert entry["values"][:2] == pytest.approx(
        [1e3 * TRUE_OFFSET, 1e3 * (TRUE_OFFSET + FARTHER)], rel=1e-9
    )
    assert entry["differences"][0] == pytest.approx(1e3 * FARTHER, rel=1e-9)


def test_what_needs_truth_is_null_and_marked(comparison: Comparison) -> None:
    entry = line(comparison, "true error, RMS")
    assert entry["values"][2] is None
    assert entry["differences"][1] is None
    assert entry["truth"] is True
    row = next(
        row
        for row in comparison.to_markdown().splitlines()
        if row.startswith("| true error, RMS")
    )
    assert row.split("|")[-3].strip() == "needs truth"
    assert any(
        remark.startswith("rig: no true motion") for remark in comparison.remarks
    )


def test_every_quantity_of_equal_runs_differs_by_nothing(good: Run) -> None:
    metrics = compute_metrics(good)
    same = compare_runs([good, good], [metrics, metrics])
    for entry in [
        *same.lines,
        *same.machine,
        *(one for lines in same.crossings for one in lines),
    ]:
        assert entry.values[0] == entry.values[1]
        assert entry.differences in ([0.0], [None])
    assert len(set(same.names)) == 2
    assert same.remarks == []
    assert len(same.lines) == len(COMPARED)
    assert len(same.machine) == len(OF_THE_MACHINE)


def test_crossings_are_compared_one_by_one(comparison: Comparison) -> None:
    assert len(comparison.crossings) == 2
    outcome = comparison.crossings[0][0]
    assert outcome.values == ["crossed", "crossed", None]


def test_curves_over_each_other_are_the_true_ones_where_every_run_has_them(
    comparison: Comparison,
) -> None:
    both = compare_runs(
        comparison.runs[:2], comparison.metrics[:2], comparison.names[:2]
    )
    panels = overlaid(both)
    assert [panel.key for panel in panels] == [
        "torque0",
        "torque1",
        "error",
        "residual",
        "s",
    ]
    error = panels[2]
    assert (error.label, panels[4].label) == (
        "true error (mm)",
        "true s, 0 on the locus (1)",
    )
    assert [curve.name for curve in error.curves] == ["good", "worse"]
    assert np.nanmax(error.curves[1].values) == pytest.approx(
        1e3 * (TRUE_OFFSET + FARTHER), rel=1e-9
    )


def test_beside_a_run_without_truth_the_estimated_curves_of_all_are_drawn(
    comparison: Comparison,
) -> None:
    error, s = (panel for panel in overlaid(comparison) if panel.key in ("error", "s"))
    assert (error.label, s.label) == (
        "estimated error (mm)",
        "estimated s, 0 on the locus (1)",
    )
    assert [curve.name for curve in error.curves] == ["good", "worse", "rig"]
    for curve in error.curves:
        assert np.nanmax(curve.values) == pytest.approx(ESTIMATED_ERROR, rel=1e-9)
    assert any(
        "drawn as estimated for all runs" in remark for remark in comparison.remarks
    )


def test_true_and_estimated_speed_are_different_lines(comparison: Comparison) -> None:
    lines = {entry.metric.name: entry for entry in comparison.crossings[0]}
    assert lines["true speed"].values[:2] == pytest.approx(
        [abs(path(CROSSINGS[0])[1])] * 2, rel=1e-2
    )
    assert (
        lines["true speed"].values[2] is None
        and lines["true speed"].differences[1] is None
    )
    assert lines["estimated speed"].values == pytest.approx(
        [abs(path(CROSSINGS[0])[1])] * 3, rel=1e-2
    )
    assert "speed" not in lines


def test_other_plans_and_robots_are_remarked(good: Run) -> None:
    metrics = compute_metrics(good)
    shorter = dataclasses.replace(metrics, crossings=metrics.crossings[:1])
    other = dataclasses.replace(good, robot=good.robot.replace(end_effector_mass=0.06))  # type: ignore[union-attr]
    found = compare_runs([good, other], [metrics, shorter])
    assert "The runs have different robots." in found.remarks
    assert any("the first 1 one by one" in remark for remark in found.remarks)
    assert len(found.crossings) == 1


def test_what_differs_is_listed_and_names_the_runs(good: Run) -> None:
    metrics = compute_metrics(good)
    own = {
        **good.parameters["controller"],
        "near_locus.fade_abs_s": 0.25,
        "robot.left.distal_mass": 0.1,
    }
    other = dataclasses.replace(good, parameters={"controller": own})
    found = compare_runs(
        [good, other],
        [metrics, dataclasses.replace(metrics, reasons=["too far"], success=False)],
    )
    assert [one.name for one in found.differences] == [
        "controller.near_locus.fade_abs_s",
        "robot.left.distal_mass",
        "bag",
    ]
    assert found.differences[0].values == ["–", "0.25"]
    assert found.names == [
        "consistent / observer, near_locus.fade_abs_s –",
        "consistent / observer, near_locus.fade_abs_s 0.25",
    ]
    page = render_comparison(found)
    assert (
        page.index("too far")
        < page.index("What differs")
        < page.index("robot.left.distal_mass")
        < page.index("matters")
    )
    assert "| controller.near_locus.fade_abs_s | – | 0.25 |" in found.to_markdown()


def test_what_differs_most_stands_first_and_what_is_of_the_machine_apart(
    comparison: Comparison,
) -> None:
    matter, alike = by_matter(comparison.lines)
    finite = [line.matter for line in matter if math.isfinite(line.matter)]
    assert finite == sorted(finite, reverse=True)
    assert "peak torque" in {line.metric.name for line in alike}
    machine = {line.metric.name for line in comparison.machine}
    assert "round trip, median" in machine
    assert len(matter) + len(alike) == len(comparison.lines)


def test_the_command_writes_page_text_and_numbers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b"):
        write_run(tmp_path / f"{name}.mcap")
    assert (
        cli.main(
            [
                "compare",
                str(tmp_path / "a.mcap"),
                str(tmp_path / "b.mcap"),
                "--output",
                str(tmp_path / "out"),
            ]
        )
        == 0
    )
    page = (tmp_path / "out" / "comparison.html").read_text(encoding="utf-8")
    assert "Crossing by crossing" in page
    assert capsys.readouterr().out.startswith(
        f"bag: {tmp_path.name}/a.mcap | {tmp_path.name}/b.mcap\n"
    )
    _, text = (tmp_path / "out" / "comparison.md").read_text().split("## Side by side")
    rows = [row for row in text.splitlines() if row.startswith("|")]
    assert len({row.replace("\\|", "").count("|") for row in rows}) == 1
    numbers = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert all(
        math.isfinite(value)
        for entry in numbers["quantities"]
        for value in entry["differences"]
        if value is not None
    )


def test_one_bag_is_no_comparison(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_run(tmp_path / "a.mcap")
    assert cli.main(["compare", str(tmp_path / "a.mcap")]) == 2
    assert (
        capsys.readouterr().err
        == "dextar compare: 1 run; a comparison needs at least two\n"
    )


def test_metrics_are_what_is_compared(good: Run) -> None:
    metrics: Metrics = compute_metrics(good)
    for compared in (*COMPARED, *OF_THE_MACHINE):
        value = compared.of(metrics)
        assert isinstance(value, (int, float, str)) or value is None, compared.metric
