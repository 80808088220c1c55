"""What /diagnostics says about the arrival of states, from arrivals made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from dextar_control.nodes.statistics import LATELY, Statistics

PERIOD = 1e-3  # s


def _arrivals(intervals: np.ndarray) -> Statistics:
    statistics = Statistics()
    for now in np.concatenate([[0.0], np.cumsum(intervals)]):
        statistics.arrived(0, float(now))
    return statistics


@pytest.mark.parametrize(
    ("intervals", "words"),
    [
        (np.full(500, PERIOD), []),
        (np.full(500, 1.04 * PERIOD), []),
        (np.full(500, 1.1 * PERIOD), ["states come at 909.1 Hz; 1000 Hz are expected"]),
        (
            np.tile([0.3 * PERIOD, 1.7 * PERIOD], 250),
            ["the states' period varies by 0.70 ms; the limit is 0.50 ms"],
        ),
        (np.full(50, 2.0 * PERIOD), []),  # too few to say
    ],
)
def test_a_rate_or_a_jitter_that_is_off_is_told_with_the_limit(
    intervals: np.ndarray, words: list[str]
) -> None:
    assert _arrivals(intervals).warnings(PERIOD) == words


def test_rate_and_jitter_are_those_of_the_last_second() -> None:
    intervals = np.random.default_rng(5).uniform(0.5, 1.5, 1500) * PERIOD
    told = _arrivals(intervals).report(0)
    kept = intervals[-1000:]
    assert told["rate"] == pytest.approx(1.0 / kept.mean(), abs=0.01)
    assert told["jitter_us"] == pytest.approx(1e6 * kept.std(), abs=0.1)
    assert told["interval_p99_us"] == pytest.approx(
        1e6 * np.percentile(kept, 99), abs=0.1
    )
    assert "latency_p50_us" not in told  # stamps of another clock


def test_missed_states_are_a_warning_for_a_while() -> None:
    statistics = Statistics()
    statistics.counts["missed_states"] += 3
    for _ in range(LATELY):
        assert statistics.missed_lately() == ["3 states were missed lately"]
        statistics.report(0)
    assert statistics.missed_lately() == []


def test_the_saturated_share_is_of_the_ticks_since_the_last_report_also_over_a_new_trajectory() -> (
    None
):
    statistics = Statistics()
    for saturated, ticks, share in (
        (10, 100, 0.1),
        (60, 100, 0.5),
        (5, 50, 0.1),
        (5, 20, 0.0),
    ):
        statistics.counts["states"] += ticks
        assert statistics.report(saturated)["saturated_share"] == pytest.approx(share)


def test_stamps_off_the_period_are_counted_and_told_and_gaps_of_whole_periods_are_not() -> (
    None
):
    statistics = Statistics()
    for gap in (1.0e-3, 3.0e-3, 1.1e-3, 0.1e-3, 1.5e-3, 1.0e-3):
        statistics.spaced(gap, 1e-3)
    assert (
        statistics.counts["missed_states"],
        statistics.counts["irregular_stamps"],
    ) == (3, 2)
    assert statistics.missed_lately() == [
        "3 states were missed lately",
        "2 stamps were off the period lately",
    ]


def _answers(
    ages: np.ndarray, intervals: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> Statistics:
    """States of these ages, s, when they were answered, so far apart, s."""
    statistics, now = Statistics(), 0.0
    monkeypatch.setattr("dextar_control.nodes.statistics.time.time_ns", lambda: 10**18)
    for age, interval in zip(ages, intervals, strict=True):
        now += float(interval)
        statistics.arrived(10**18 - round(1e9 * age), now)
    return statistics


EVEN = np.full(300, PERIOD)


@pytest.mark.parametrize(
    ("ages", "intervals", "words"),
    [
        (np.full(300, 0.3e-3), EVEN, ""),
        (np.full(300, 40e-3), EVEN, ""),  # another machine's clock, ahead by that
        (np.full(300, -40e-3), EVEN, ""),  # or behind
        (np.full(300, 1e9), EVEN, ""),  # or one of its own
        (np.tile([0.3e-3] * 19 + [2e-3], 15), EVEN, ""),  # one in twenty
        (
            np.tile([0.5e-3, 10.5e-3], 150),
            EVEN,
            "100 of the last 200 answers (50%) were late by more than",
        ),
        (
            np.r_[np.full(250, 0.5e-3), [15.5e-3], np.full(49, 0.5e-3)],
            EVEN,
            "1 of the last 200 answers (0%) were late by more",
        ),
        (
            np.full(300, 1e9),
            np.tile([PERIOD] * 4 + [3.5 * PERIOD], 60),
            "40 of the last 200 states (20%) were late by more",
        ),
        (np.r_[np.full(100, 50e-3), np.full(200, 0.5e-3)], EVEN, ""),  # long over
    ],
)
def test_lateness_is_told_with_its_share_and_only_where_it_was(
    ages: np.ndarray, intervals: np.ndarray, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = _answers(ages, intervals, monkeypatch).lateness(PERIOD)
    assert told.startswith(f"commands came too late: {words}") if words else told == ""


def test_a_rig_whose_stamps_fall_behind_the_clock_is_answered_in_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a slow simulation: what counts is when a state was sent, where the middleware
    tells.
    """
    monkeypatch.setattr("dextar_control.nodes.statistics.time.time_ns", lambda: 10**18)
    statistics = Statistics()
    for k in range(200):
        statistics.arrived(10**18 - 2_000_000 * k, PERIOD * k, 10**18 - 300_000)
    assert statistics.lateness(PERIOD) == ""
