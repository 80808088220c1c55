"""The report says what the metrics say, with units, offline, and honestly where a bag
lacks something.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import re
import tempfile
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from synthetic_run import CROSSINGS, NEAR_TORQUE, TRUE_OFFSET, robot, write_run

from dextar_control.analysis import Metrics, Run, compute_metrics, load_run
from dextar_control.analysis.curves import around, panels
from dextar_control.analysis.figure import draw_run
from dextar_control.analysis.page import render_report
from dextar_control.analysis.plane import plane_of
from dextar_control.analysis.report import analyze, summary_lines
from dextar_control.analysis.run import TopicCounts
from dextar_control.analysis.web_figures import in_plane
from dextar_control.cli import main as cli
from dextar_control.cli.analyze import folders
from dextar_control.cli.bags import shown_progress
from dextar_control.contract import style

SIZE_OF_A_DEMO, SIZE_OF_ITS_PAGE = (
    500_000,
    100_000,
)  # bytes, with what was recorded and without


class Text(HTMLParser):
    """What a reader reads: text outside scripts, tables as rows of cells."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.rows: list[list[str]] = []
        self._hidden = self._cell = False
        self.feed(page)

    def handle_starttag(self, tag: str, attributes: object) -> None:
        self._hidden = self._hidden or tag in ("script", "style")
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
            self._cell = True

    def handle_endtag(self, tag: str) -> None:
        if tag in ("script", "style"):
            self._hidden = False
        if tag in ("td", "th"):
            self._cell = False

    def handle_data(self, data: str) -> None:
        if not self._hidden:
            self.words.append(data)
            if self._cell:
                self.rows[-1][-1] += data

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@functools.cache
def made(**options: object) -> tuple[Run, Metrics, Text]:
    """A run whose numbers are known, its metrics and its page; each kind is made
    once.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.mcap"
        write_run(file, **options)  # type: ignore[arg-type]
        run = load_run(file)
    metrics = compute_metrics(run)
    return run, metrics, Text(render_report(run, metrics))


def test_the_verdict_stands_at_the_top_with_its_numbers() -> None:
    _, _, page = made()
    assert page.text.index("Success.") < page.text.index("Path, torques")
    assert (
        "Crossed 2 of 2 planned crossings; true error 0.100 mm at most and 0.100 mm at"
        " the end" in page.text
    )


def test_each_crossing_has_its_row_with_the_metrics_numbers() -> None:
    _, metrics, page = made()
    head = next(row for row in page.rows if row[:1] == ["no."])
    rows = [
        dict(zip(head, row, strict=True))
        for row in page.rows
        if row[:1] in (["1"], ["2"]) and len(row) == len(head)
    ]
    assert len(rows) == 2
    for row, crossing, moment in zip(rows, metrics.crossings, CROSSINGS, strict=True):
        assert float(row["planneds"]) == pytest.approx(moment, abs=6e-5)
        assert float(row["trues"]) == pytest.approx(crossing.true_time, abs=6e-5)
        assert float(row["late byms"]) == pytest.approx(
            1e3 * (crossing.true_time - moment), abs=6e-3
        )
        assert (row["outcome"], row["estimator says"], row["verdict is"]) == (
            "crossed",
            "crossed",
            "right",
        )
        assert float(row["smallest σ1"]) == 0.5
        assert float(row["peak torqueN m"]) == crossing.peak_torque
        assert (
            float(row["true error beforemm"])
            == float(row["true error aftermm"])
            == pytest.approx(1e3 * TRUE_OFFSET)
        )


def test_every_column_with_numbers_has_a_unit() -> None:
    _, _, page = made()
    units = re.compile(r"(µs|ms|mm|m/s|N m|N/m|N|Hz|s|1)$")
    counts = {"no.", "count", "messages", "lost", "dropped"}
    tables = [
        row
        for row in page.rows
        if row[:1] in (["no."], ["topic"]) or row[1:2] == ["count"]
    ]
    assert len(tables) == 4
    for head in tables:
        for name in (
            set(head)
            - counts
            - {
                "",
                "locus",
                "to s",
                "outcome",
                "estimator says",
                "verdict is",
                "topic",
                "type",
            }
        ):
            assert units.search(name), name


def test_without_truth_it_says_what_needs_it() -> None:
    _, metrics, page = made(truth=False)
    assert metrics.success is None
    assert "Not decidable." in page.text
    assert "2 planned crossings, 2 crossed by the estimator's own verdict" in page.text
    head = next(row for row in page.rows if row[:1] == ["no."])
    row = dict(
        zip(
            head,
            next(
                row for row in page.rows if row[:1] == ["1"] and len(row) == len(head)
            ),
            strict=True,
        )
    )
    assert row["trues"] == row["outcome"] == row["verdict is"] == "needs truth"
    assert float(row["estimated error aftermm"]) == pytest.approx(
        0.02
    )  # the estimate's own
    assert (
        "the true error needs the true motion, which this bag does not hold"
        in page.text
    )


def test_a_bounce_is_called_one() -> None:
    _, metrics, page = made(bounce=True, says=(1, 1))
    assert metrics.crossings[0].outcome == "bounced"
    assert "Failed." in page.text
    assert "WRONG" in page.text


def test_timing_is_measured_on_the_system_clock_and_misses_are_counted() -> None:
    _, metrics, page = made()
    timing = metrics.timing
    assert timing.state_period.median == pytest.approx(
        6e-6
    )  # six messages a tick, written 1 us apart
    assert timing.round_trip.median == pytest.approx(1e-6)
    assert timing.round_trip.count == metrics.answered
    assert timing.stamp_period == pytest.approx(1e-3)
    assert (timing.missed_runs, timing.longest_miss) == ([3], 3)
    assert timing.lockstep is None
    assert "The bag does not say whether this was real time." in page.text
    assert (
        "States without a command of their stamp: 3 of 1001, in 1 gap, the longest of 3"
        " states" in page.text
    )


def test_losses_phases_parameters_and_versions_are_there() -> None:
    _, metrics, page = made(last_phase=5)
    assert [(span.phase, span.ticks) for span in metrics.phases] == [
        ("TRACK", 1000),
        ("SAFE_STOP", 1),
    ]
    assert next(row for row in page.rows if row[:1] == ["/joint_states"])[2:5] == [
        "1001",
        "2",
        "1",
    ]
    assert "working_mode [1, -1]" in page.text
    assert "recorded with dextar 9.9" in page.text
    assert "the controller ended in SAFE_STOP: no state for 20 ms" in page.text


def test_only_a_topic_with_a_rate_of_its_own_has_a_mean_rate() -> None:
    run, metrics, _ = made()
    burst = TopicCounts("rcl_interfaces/msg/ParameterEvent", 150, 1_000, 50_001_000)
    other = TopicCounts(
        "sensor_msgs/msg/Image", 150, 1_000, 50_001_000
    )  # of another type than the contract's
    topics = {
        "/parameter_events": burst,
        "/left/joint_states": run.topics["/joint_states"],
        "/camera/criterion": other,
    }
    run = dataclasses.replace(run, topics=run.topics | topics)
    rows = {
        row[0]: row[5:]
        for row in Text(render_report(run, metrics)).rows
        if row and row[0].startswith("/")
    }
    assert rows["/joint_states"][0] == rows["/sim/joint_states"][0] == "1000"
    assert float(rows["/joint_states"][1]) == pytest.approx(
        1e6 / 6.0, rel=1e-2
    )  # six messages a tick, written 1 us apart
    assert rows["/left/joint_states"] == rows["/joint_states"]
    assert (
        rows["/parameter_events"]
        == rows["/camera/criterion"]
        == rows["/trajectory"]
        == rows["/diagnostics"]
        == ["", ""]
    )


def test_the_page_of_a_real_run_is_light_and_loads_nothing(
    demo: Path, tmp_path: Path
) -> None:
    analyze(demo / "run.mcap", tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    recorded = re.search(r'id="figures">(.*?)</script>', page, re.DOTALL)
    assert recorded is not None
    assert (
        len(page) < SIZE_OF_A_DEMO and len(page) - len(recorded[1]) < SIZE_OF_ITS_PAGE
    )
    outside = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert (
        re.findall(r"""(?:src|href)\s*=\s*["']?(?!#|data:)([^"'\s>]+)""", outside) == []
    )
    assert "Lockstep: the plant waited for each command" in Text(page).text
    assert "Certificate recorded with the run" in outside


def test_names_from_a_bag_are_text_not_code() -> None:
    run, metrics, _ = made()
    evil = "<script>alert(1)</script>"
    run = dataclasses.replace(
        run,
        record={"name": evil, "notes": evil},
        robot=run.robot.replace(name=evil),
        version=evil,
    )
    page = render_report(run, dataclasses.replace(metrics, robot=evil, law=evil))
    assert "<script>alert" not in page
    assert "alert(1)" in Text(page).text


def test_curves_that_share_an_axis_have_lines_of_their_own() -> None:
    run, metrics, _ = made()
    for panel in panels(run, metrics):
        lines = [style.LINES[curve.kind, curve.part] for curve in panel.curves]
        assert len(set(lines)) == len(lines), panel.key


def test_a_figure_for_a_paper_is_a_column_wide_with_its_fonts_inside(
    tmp_path: Path,
) -> None:
    write_run(tmp_path / "run.mcap")
    analyze(tmp_path / "run.mcap", formats=("pdf", "svg", "png"), width=88.0)
    pdf = (tmp_path / "paper.pdf").read_bytes()
    assert b"/FontFile2" in pdf and b"/Type3" not in pdf
    width = float(re.search(rb"/MediaBox \[ *0 0 ([\d.]+)", pdf)[1])
    assert width * 25.4 / 72.0 == pytest.approx(88.0, abs=0.1)
    svg = (tmp_path / "paper.svg").read_text()
    assert "<text" not in svg and "<path" in svg  # outlines, so that no font is needed
    assert (tmp_path / "paper.png").read_bytes().startswith(b"\x89PNG")


def test_several_bags_get_a_report_each_and_a_bad_one_stops_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_run(tmp_path / name / "run.mcap")
    (tmp_path / "none.mcap").write_bytes(b"")
    bags = [
        str(tmp_path / "a" / "run.mcap"),
        str(tmp_path / "none.mcap"),
        str(tmp_path / "b" / "run.mcap"),
    ]
    assert cli.main(["analyze", *bags, "--output", str(tmp_path / "out")]) == 2
    assert [line for line in capsys.readouterr().err.splitlines() if line] == [
        f"dextar analyze: {bags[1]} is empty"
    ]
    found = sorted(
        str(file.relative_to(tmp_path / "out"))
        for file in (tmp_path / "out").rglob("report.html")
    )
    assert found == ["a-run/report.html", "b-run/report.html"]
    assert (
        json.loads((tmp_path / "out" / "a-run" / "metrics.json").read_text())["success"]
        is True
    )


def test_nothing_is_under_way_on_an_error_output_that_is_no_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with shown_progress("reading") as shown:
        shown.read(1, 2)
        shown.stage("drawing")
    assert capsys.readouterr() == ("", "")


def test_folders_do_not_depend_on_the_links_that_lead_to_the_bags(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a", "b", "c"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.mcap").touch()
    (tmp_path / "latest").symlink_to("b")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "a").mkdir()
    monkeypatch.chdir(tmp_path)

    def made(*bags: str, output: str | None = None) -> list[str | None]:
        found = folders([Path(bag) for bag in bags], Path(output) if output else None)
        return [None if folder is None else str(folder) for folder in found]

    assert made("a", "b", "c") == [None] * 3
    assert made("a", "latest", output="out") == ["out/a", "out/b"]
    assert made("a/run.mcap", "latest/run.mcap", output="out") == [
        "out/a-run",
        "out/b-run",
    ]
    assert made("latest", "b", output="out") == ["out", "out"]  # one bag by two names
    assert made("latest", "b") == [None, None]
    assert made("a", "other/a", output="out") == ["out/a", "out/a-2"]
    assert made("a", "other/a", "a", output="out") == ["out/a", "out/a-2", "out/a"]
    assert made("a/run.mcap", "a", "c") == ["a/a-run", "a/a", None]
    monkeypatch.chdir(tmp_path / "a")
    assert made("run.mcap", "../latest", output="out") == ["out/a-run", "out/b"]
    assert made(".", "../latest", output="out") == ["out/a", "out/b"]


def test_the_robot_is_printed_once() -> None:
    run, metrics, _ = made()
    own = {key: value for key, value in run.parameters["controller"].items()}
    run = dataclasses.replace(
        run, parameters={"controller": own, "plant": {**own, "mode": "lockstep"}}
    )
    assert Text(render_report(run, metrics)).text.count("left.proximal_length") == 1
    assert robot().left.proximal_length == run.robot.left.proximal_length


def test_a_curve_that_leaves_its_axis_is_told() -> None:
    _, metrics, page = made(bounce=True, says=(1, 1))
    assert (
        "curves that leave the axis: true from 0.1 to"
        f" {1e3 * metrics.max_true_error:.3g}" in page.text
    )


def test_the_marks_of_crossings_tell_the_verdicts_apart() -> None:
    labels = set()
    for says in ((1, 1), (2, 1), (0, 1)):
        run, metrics, _ = made(says=says)
        plane = plane_of(run, metrics)
        assert len(plane.places) == 1
        labels |= {
            one["name"]
            for one in in_plane([plane])["series"]
            if "estimator" in one["name"]
        }
    assert labels == {
        "crossing, estimator: crossed",
        "crossing, estimator: bounced",
        "crossing, estimator: undecided",
    }
    assert len(set(style.MARKS.values())) == len(style.MARKS)


def test_a_bag_of_joint_states_alone_is_not_called_a_failure() -> None:
    run, _, _ = made()
    parts = {
        name: dataclasses.replace(
            getattr(run, name),
            **{
                field.name: getattr(getattr(run, name), field.name)[:0]
                for field in dataclasses.fields(getattr(run, name))
            },
        )
        for name in ("control", "criterion", "commands")
    }
    bare = dataclasses.replace(
        run,
        **parts,
        truth=None,
        trajectory=None,
        robot=None,
        parameters={},
        record={},
        losses={},
    )
    metrics = compute_metrics(bare)
    assert metrics.success is None
    page = Text(render_report(bare, metrics))
    assert "Not decidable." in page.text
    assert "the bag holds no phase of the controller" in page.text
    words = dict(summary_lines(metrics))
    assert words["peak torque"] == words["estimated error"] == "nothing recorded"
    assert words["crossed"] == "unknown without a plan"


@pytest.mark.parametrize(
    "part", ["control", "criterion", "commands", "truth", "states", "all"]
)
def test_what_is_no_number_is_drawn_as_a_gap(part: str) -> None:
    run, _, _ = made()
    names = (
        ["control", "criterion", "commands", "truth", "states"]
        if part == "all"
        else [part]
    )
    changed = {}
    for name in names:
        own = getattr(run, name)
        floats = {
            field.name: np.full_like(getattr(own, field.name), np.nan)
            for field in dataclasses.fields(own)
            if getattr(getattr(own, field.name), "dtype", None) == np.float64
        }
        changed[name] = dataclasses.replace(own, **floats)
    broken = dataclasses.replace(run, **changed)
    metrics = compute_metrics(broken)
    assert (
        re.search(r"\bnan\b", Text(render_report(broken, metrics)).text, re.IGNORECASE)
        is None
    )
    draw_run(broken, metrics).canvas.draw()


def test_many_crossings_are_drawn_one_by_one_over_their_mean() -> None:
    run, metrics, _ = made(bounce=True, says=(1, 1))
    six = dataclasses.replace(metrics, crossings=metrics.crossings * 3)
    torque, error = around(run, six)
    assert (torque.label, error.label) == ("largest torque (N m)", "true error (mm)")
    middle = len(torque.time) // 2
    assert torque.time[middle] == 0.0 and torque.each[0][middle] == pytest.approx(
        NEAR_TORQUE, rel=0.1
    )
    assert torque.mean[middle] == pytest.approx(
        np.mean([own[middle] for own in torque.each])
    )
    assert around(run, metrics) == []
    page = render_report(run, six)
    assert page.count('data-figure="around0-') == 6 and '"1 bounced"' in page
    draw_run(run, six).canvas.draw()


def test_what_is_not_the_default_stands_first() -> None:
    run, metrics, _ = made()
    own = {
        **run.parameters["controller"],
        "near_locus.fade_abs_s": 0.25,
        "robot.end_effector_mass": 0.06,
    }
    page = Text(
        render_report(dataclasses.replace(run, parameters={"controller": own}), metrics)
    )
    assert ["near_locus.fade_abs_s", "0.25", "0.2"] in page.rows and [
        "end_effector_mass",
        "0.06",
        "0.05",
    ] in page.rows
    assert not any(row[:1] == ["law"] for row in page.rows)


def test_the_plan_is_a_table_beside_its_limits() -> None:
    run, _, page = made()
    row = next(row for row in page.rows if row[:1] == ["peak torque"])
    assert row[2:] == ["-", f"{run.robot.max_torque:g}", "N m"] and float(row[1]) > 0.0


def test_a_recorded_robot_is_not_taken_for_another(
    demo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        cli.main(
            [
                "analyze",
                str(demo / "run.mcap"),
                "--output",
                str(tmp_path),
                "--namespace",
                "/left",
            ]
        )
        == 2
    )
    assert "is of the robot in namespace '/', not '/left'" in capsys.readouterr().err
