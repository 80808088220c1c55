"""The healthy time of a stream of states, and the regularity of its arrival."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dextar_control.contract.errors import StateError
from dextar_control.control.stream import MIXED, StateStream
from dextar_control.control.timing import Window

MS = 1_000_000  # ns
LIMIT = 0.02  # s


def _healthy(stamps: list[int], arrivals: list[float] | None = None) -> StateStream:
    stream = StateStream()
    for index, stamp in enumerate(stamps):
        stream.take(stamp * MS, LIMIT, None if arrivals is None else arrivals[index])
    return stream


@pytest.mark.parametrize(
    ("stamps", "healthy", "trouble"),
    [
        ([], 0.0, ""),
        ([5], 0.0, ""),
        (list(range(0, 301, 20)), 0.3, ""),  # gaps of exactly the limit
        ([0, 1, 2, 23, 24], 0.001, "no state for 21.0 ms; the limit is 20.0 ms"),
        ([0, 1, 2, 2, 3], 0.001, "a state of 2000000 ns after one of 2000000 ns"),
        ([5, 6, 7, 3, 4, 5], 0.002, "a state of 3000000 ns after one of 7000000 ns"),
    ],
)
def test_healthy_time_counts_from_the_last_trouble_by_the_stamps(
    stamps: list[int], healthy: float, trouble: str
) -> None:
    stream = _healthy(stamps)
    assert stream.healthy_for(LIMIT) == pytest.approx(healthy, abs=1e-12)
    assert stream.trouble == trouble


def test_a_refused_state_begins_the_count_anew_with_the_next_one() -> None:
    stream = _healthy([0, 1, 2])
    stream.spoil("not finite")
    assert stream.healthy_for(LIMIT) == 0.0
    stream.take(90 * MS, LIMIT)  # a gap to a state before the trouble is no second one
    stream.take(91 * MS, LIMIT)
    assert stream.healthy_for(LIMIT) == pytest.approx(0.001, abs=1e-12)
    with pytest.raises(
        StateError,
        match=r"healthy states for 0.00 s; 0.5 s are needed \(last: not finite\)",
    ):
        stream.check(0.5, LIMIT)


def test_a_burst_counts_as_long_as_it_lasted() -> None:
    stream = _healthy(list(range(600)), [1.0 + 1e-6 * k for k in range(600)])
    assert stream.healthy_for(LIMIT, 1.001) == pytest.approx(599e-6, abs=1e-12)


def test_late_arrivals_are_trouble_where_the_stamps_are_regular() -> None:
    stream = _healthy([0, 1, 2, 3], [0.0, 0.001, 0.032, 0.033])
    assert stream.trouble == "no state for 31.0 ms; the limit is 20.0 ms"
    assert stream.healthy_for(LIMIT, 0.034) == pytest.approx(0.001, abs=1e-12)


def test_a_stale_stream_is_not_healthy_and_says_how_stale() -> None:
    stream = _healthy([0, 1, 2], [0.0, 0.001, 0.002])
    assert stream.healthy_for(LIMIT, 0.0225) == 0.0
    with pytest.raises(StateError, match=r"no state for 98 ms; the limit is 20.0 ms"):
        stream.check(0.0, LIMIT, 0.1)
    stream.check(0.0, LIMIT, 0.01)


def test_nothing_is_asked_of_a_stream_whose_healthy_time_is_zero() -> None:
    StateStream().check(0.0, LIMIT)
    StateStream().check(0.0, LIMIT, 5.0)
    with pytest.raises(
        StateError, match=r"healthy states for 0.00 s; 0.5 s are needed$"
    ):
        StateStream().check(0.5, LIMIT)


def test_a_window_forgets_and_tells_what_numpy_tells_of_the_rest() -> None:
    window = Window(50)
    assert math.isnan(window.regularity().rate)
    intervals = np.random.default_rng(3).uniform(0.5e-3, 1.5e-3, 130)
    for interval in intervals:
        window.add(float(interval))
    kept = intervals[-50:]
    found = window.regularity()
    assert found.rate == pytest.approx(1.0 / kept.mean(), rel=1e-12)
    assert found.jitter == pytest.approx(kept.std(), rel=1e-9)
    assert (found.p99, found.longest) == (
        pytest.approx(np.percentile(kept, 99)),
        kept.max(),
    )
    window.clear()
    assert math.isnan(window.percentiles(50.0)[0])


def test_a_second_publisher_is_told_by_a_number_that_does_not_rise() -> None:
    stream = StateStream()
    for number in (7, 8, 12, 13):  # some were lost
        stream.hear(number, 1.0)
    stream.hear(None, 1.0)
    stream.hear(0, 1.0)
    stream.hear(2**64 - 1, 1.0)
    assert not stream.mixed(1.0)
    stream.hear(1, 2.0)
    assert stream.mixed(2.0)
    assert stream.mixed(2.0 + MIXED)
    assert not stream.mixed(2.1 + MIXED)
