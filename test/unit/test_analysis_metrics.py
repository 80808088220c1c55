"""Metrics, verdict and figure of a run whose numbers are known."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text
from rich.console import Console
from synthetic_run import (
    BASE_TORQUE,
    CONFIDENCE,
    CROSSINGS,
    DECIDED,
    FAR_TORQUE,
    LOCUS,
    MISSED,
    NEAR_TORQUE,
    START,
    TICKS,
    TRUE_OFFSET,
    path,
    robot,
    write_run,
)

from dextar_control.analysis.compute import compute_metrics
from dextar_control.analysis.figure import draw_run
from dextar_control.analysis.load import load_run
from dextar_control.analysis.report import analyze, summary_table
from dextar_control.analysis.run import Phase, Run
from dextar_control.analysis.tracking import plan_of, singularity_measure
from dextar_control.control.verdicts import Verdict
from dextar_control.planning.checks import SIDE, clear_times
from dextar_control.planning.model import states_model

INSTANT = 2.0e-6  # s: interpolation of a smooth s between ticks of 1 ms
ROUNDING = 1.0e-12
TICK = 1.0e-3  # s


def _run(folder: Path, **options: object) -> Run:
    write_run(folder / "run.mcap", **options)  # type: ignore[arg-type]
    return load_run(folder / "run.mcap")


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return _run(tmp_path_factory.mktemp("good"))


def test_s_is_zero_in_the_stretched_posture_and_positive_above_it() -> None:
    x = np.array([[0.0, LOCUS], [0.0, 0.105], [0.0, 0.06]])
    s = singularity_measure(robot(), x, states_model(robot()).sides(x).q_a)
    assert abs(s[0]) < ROUNDING
    assert abs(s[1]) > 0.1
    assert np.sign(s[1]) == -np.sign(s[2])


def test_crossings_are_found_where_geometry_puts_them(good: Run) -> None:
    metrics = compute_metrics(good)
    assert [c.planned_time for c in metrics.crossings] == pytest.approx(
        CROSSINGS, abs=INSTANT
    )
    assert metrics.crossings[0].planned_stamp == pytest.approx(
        START + CROSSINGS[0] * 1e9, abs=1e9 * INSTANT
    )
    late = TRUE_OFFSET / abs(path(CROSSINGS[0])[1])
    assert metrics.crossings[0].true_time == pytest.approx(
        CROSSINGS[0] + late, abs=2e-5
    )
    assert [c.crossed for c in metrics.crossings] == [True, True]
    assert [c.estimated_mode for c in metrics.crossings] == [-1, 1]
    assert metrics.crossings[0].speed == pytest.approx(
        abs(path(CROSSINGS[0])[1]), rel=1e-2
    )
    assert metrics.crossings[0].residual == 0.25


def test_errors_torques_and_counts_are_the_recorded_ones(good: Run) -> None:
    metrics = compute_metrics(good)
    assert metrics.max_true_error == pytest.approx(TRUE_OFFSET, abs=ROUNDING)
    assert metrics.rms_true_error == pytest.approx(TRUE_OFFSET, abs=ROUNDING)
    assert metrics.final_true_error == pytest.approx(TRUE_OFFSET, abs=ROUNDING)
    assert metrics.max_estimated_error == pytest.approx(2e-5, abs=ROUNDING)
    assert metrics.peak_torque == FAR_TORQUE
    assert metrics.peak_torque_near == NEAR_TORQUE
    assert metrics.crossings[0].peak_torque == NEAR_TORQUE
    assert metrics.crossings[1].peak_torque == BASE_TORQUE
    assert metrics.crossings[0].torque_step == pytest.approx(
        NEAR_TORQUE - BASE_TORQUE, abs=ROUNDING
    )
    assert metrics.torque_ratio == pytest.approx(
        FAR_TORQUE / metrics.planned_peak_torque
    )
    assert (metrics.states, metrics.missed) == (TICKS, len(MISSED))
    assert metrics.loop_rate == pytest.approx(
        1e9 / 6000
    )  # six messages a tick, written 1 us apart
    assert metrics.late_commands == 7
    assert metrics.lost == {"/joint_states": 3}
    assert metrics.success is True
    assert metrics.reasons == []


def test_a_bounce_is_no_crossing_whatever_the_estimate_says(tmp_path: Path) -> None:
    metrics = compute_metrics(_run(tmp_path, bounce=True))
    assert metrics.success is False
    assert metrics.crossings[0].crossed is False
    assert metrics.crossings[0].estimated_mode == -1
    assert any("crossing 1" in reason for reason in metrics.reasons)


def _table(run: Run) -> str:
    console = Console(width=120, record=True, file=open("/dev/null", "w"))
    console.print(summary_table(compute_metrics(run)))
    return console.export_text()


def test_the_estimators_verdicts_are_read_and_compared_with_the_truth(
    good: Run,
) -> None:
    metrics = compute_metrics(good)
    assert [c.verdict for c in metrics.crossings] == ["crossed", "crossed"]
    assert [c.verdict_time for c in metrics.crossings] == pytest.approx(
        [c + DECIDED for c in CROSSINGS], abs=TICK
    )
    assert [c.verdict_confidence for c in metrics.crossings] == [CONFIDENCE] * 2
    assert [c.verdict_correct for c in metrics.crossings] == [True, True]
    assert "2 crossed, 0 bounced, 0 undecided; agrees with the truth" in _table(good)
    assert "estimator observer" in _table(good)


def test_a_wrong_verdict_is_a_reason(tmp_path: Path) -> None:
    run = _run(tmp_path, says=(1, 2))
    metrics = compute_metrics(run)
    assert metrics.crossings[1].verdict_correct is False
    assert metrics.success is False
    assert metrics.reasons == [
        f"the estimator says of crossing 2: bounced (confidence {CONFIDENCE:.4f}, at"
        f" {metrics.crossings[1].verdict_time:.4f} s), and the true robot was on the"
        " other side"
    ]
    assert "1 crossed, 1 bounced, 0 undecided; WRONG at crossing 2" in _table(run)


def test_a_bounce_called_one_is_a_right_verdict_of_a_failed_run(tmp_path: Path) -> None:
    run = _run(tmp_path, bounce=True, says=(2, 1))
    metrics = compute_metrics(run)
    assert [c.verdict_correct for c in metrics.crossings] == [True, True]
    assert metrics.success is False
    draw_run(run, metrics).canvas.draw()


def test_the_last_verdict_on_a_crossing_counts(good: Run) -> None:
    verdict, confidence = (
        good.criterion.verdict.copy(),
        good.criterion.mode_confidence.copy(),
    )
    second = round(1e3 * (CROSSINGS[1] + DECIDED)) + 30
    verdict[second:], confidence[second:] = 2.0, 0.9995
    criterion = dataclasses.replace(
        good.criterion, verdict=verdict, mode_confidence=confidence
    )
    metrics = compute_metrics(dataclasses.replace(good, criterion=criterion))
    assert [c.verdict for c in metrics.crossings] == ["crossed", "bounced"]
    assert metrics.crossings[1].verdict_time == pytest.approx(
        1e-3 * second, abs=ROUNDING
    )
    assert metrics.crossings[1].verdict_confidence == 0.9995


def test_undecided_is_neither_right_nor_wrong(tmp_path: Path) -> None:
    run = _run(tmp_path, says=(0, 0))
    metrics = compute_metrics(run)
    assert [c.verdict for c in metrics.crossings] == ["undecided", "undecided"]
    assert [c.verdict_correct for c in metrics.crossings] == [None, None]
    assert metrics.success is True
    assert "0 crossed, 0 bounced, 2 undecided" in _table(run)


def test_a_crossing_planned_after_a_stop_was_not_begun(good: Run) -> None:
    """Of a bag that breaks off there nobody knows."""
    criterion = good.criterion
    after = criterion.stamps - criterion.stamps[0] > 1e9 * np.mean(CROSSINGS)
    stopped = dataclasses.replace(
        criterion,
        phase=np.where(after, Phase.SAFE_STOP, criterion.phase),
        verdict=np.where(after, Verdict.CROSSED, criterion.verdict),
    )
    run = dataclasses.replace(good, criterion=stopped)
    metrics = compute_metrics(run)
    assert [c.verdict for c in metrics.crossings] == ["crossed", "not begun"]
    assert metrics.crossings[1].verdict_correct is None
    assert "0 undecided, 1 not begun; agrees" in _table(run)
    draw_run(run, metrics).canvas.draw()
    broken = compute_metrics(dataclasses.replace(run, truncated=True))
    assert broken.crossings[1].verdict == "undecided"


def test_a_bag_without_verdicts_is_still_read(tmp_path: Path) -> None:
    run = _run(tmp_path, says=None)
    metrics = compute_metrics(run)
    assert metrics.success is True
    assert [c.verdict for c in metrics.crossings] == [None, None]
    assert "nothing recorded" in _table(run)
    json.loads(metrics.to_json())
    draw_run(run, metrics).canvas.draw()


def test_the_sides_are_read_where_the_plan_is_clear_of_the_locus(good: Run) -> None:
    plan = plan_of(good)
    assert plan is not None
    for index in range(2):
        before, after = clear_times(plan, index)
        for moment in (before, after):
            row = int(np.searchsorted(plan.profile.time, moment))
            assert abs(plan.profile.s[row]) >= SIDE
        assert before < plan.crossing_times[index] < after
        between = (plan.profile.time > before) & (plan.profile.time < after)
        assert np.all(np.abs(plan.profile.s[between]) < SIDE)


def test_a_crossing_that_comes_late_counts_and_is_timed(good: Run) -> None:
    """A slow robot may be tens of milliseconds behind at the locus, and cross all the
    same.
    """
    assert good.truth is not None
    late = 15
    x, q_a = np.roll(good.truth.x, late, axis=0), np.roll(good.truth.q_a, late, axis=0)
    x[:late], q_a[:late] = good.truth.x[0], good.truth.q_a[0]
    metrics = compute_metrics(
        dataclasses.replace(good, truth=dataclasses.replace(good.truth, x=x, q_a=q_a))
    )
    assert [c.crossed for c in metrics.crossings] == [True, True]
    shift = late * TICK
    first = metrics.crossings[0]
    assert first.true_time == pytest.approx(
        CROSSINGS[0] + shift + TRUE_OFFSET / abs(path(CROSSINGS[0])[1]), abs=2e-5
    )


def test_without_truth_there_is_no_verdict(tmp_path: Path) -> None:
    metrics = compute_metrics(_run(tmp_path, truth=False))
    assert metrics.success is None
    assert metrics.crossings[0].crossed is None
    assert [c.verdict_correct for c in metrics.crossings] == [None, None]
    assert "no true motion" in metrics.reasons[0]
    assert json.loads(metrics.to_json())["max_true_error"] is None


def test_a_saturated_command_is_a_failure_with_its_count(good: Run) -> None:
    effort = good.commands.effort.copy()
    effort[20, 1] = -robot().max_torque
    metrics = compute_metrics(
        dataclasses.replace(
            good, commands=dataclasses.replace(good.commands, effort=effort)
        )
    )
    assert metrics.saturated == 1
    assert metrics.success is False
    assert metrics.reasons == ["saturated commands: 1; the limit is 0"]


@pytest.mark.parametrize(
    ("offset", "words"), [(6.0e-3, "largest true error"), (2.0e-3, "at the end")]
)
def test_an_error_over_its_limit_names_both_numbers(
    good: Run, offset: float, words: str
) -> None:
    assert good.truth is not None
    x = good.truth.x.copy()
    x[-1, 0] += offset
    metrics = compute_metrics(
        dataclasses.replace(good, truth=dataclasses.replace(good.truth, x=x))
    )
    assert metrics.success is False
    assert any(
        words in reason and "the limit is" in reason for reason in metrics.reasons
    )


def test_a_safe_stop_reports_the_controllers_reason(tmp_path: Path) -> None:
    metrics = compute_metrics(_run(tmp_path, last_phase=5))
    assert metrics.phase == "SAFE_STOP"
    assert metrics.reason == "no state for 20 ms"
    assert metrics.success is False


def test_a_run_without_tracking_is_a_failure_and_draws(tmp_path: Path) -> None:
    run = _run(tmp_path, phase=2)
    metrics = compute_metrics(run)
    assert metrics.success is False
    assert metrics.reasons == ["no trajectory was tracked"]
    draw_run(run, metrics).canvas.draw()


def test_a_run_that_flew_away_keeps_sensible_axes(good: Run) -> None:
    assert good.truth is not None
    x = good.truth.x + np.array([3.0, -2.0])
    run = dataclasses.replace(good, truth=dataclasses.replace(good.truth, x=x))
    metrics = compute_metrics(run)
    figure = draw_run(run, metrics)
    assert abs(figure.axes[0].get_xlim()[1]) < 0.5
    assert figure.axes[2].get_ylim()[1] < 20.0
    words = " ".join(text.get_text() for text in figure.findobj(Text))
    assert metrics.reasons[0] in words or "the limit" in words


def test_analysis_leaves_strict_json_a_picture_and_a_table(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap")
    metrics = analyze(tmp_path / "run.mcap", tmp_path / "out")

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    content = json.loads(
        (tmp_path / "out" / "metrics.json").read_text(), parse_constant=refuse
    )
    assert content["success"] is True
    assert (tmp_path / "out" / "figure.png").read_bytes().startswith(b"\x89PNG")
    console = Console(width=100, record=True, file=open("/dev/null", "w"))
    console.print(summary_table(metrics))
    text = console.export_text()
    assert "2 of 2 planned" in text
    assert "success" in text
