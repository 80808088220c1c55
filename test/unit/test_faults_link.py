"""The faulty link by itself: what arrives, when, how often and in which shape."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dextar_control.contract.errors import ParameterError
from dextar_control.experiments.faults.link import (
    Delivery,
    FaultWindow,
    MessageLink,
    MessageShape,
    Transport,
)

MS = 1_000_000
COUNT = 2000


def run(
    transport: Transport, windows: tuple[FaultWindow, ...] = (), seed: int = 3
) -> list[tuple[int, Delivery[int]]]:
    """(time of arrival, delivery) of COUNT messages, one each millisecond, looked for
    at each millisecond.
    """
    link: MessageLink[int] = MessageLink(transport, seed)
    for window in windows:
        link.add(window)
    arrived = []
    for tick in range(COUNT + 50):
        if tick < COUNT:
            link.send(tick * MS, tick)
        arrived += [(tick, delivery) for delivery in link.due(tick * MS)]
    return arrived


def test_a_whole_link_hands_on_everything_at_once_and_in_order() -> None:
    assert run(Transport()) == [
        (tick, Delivery(tick, None, 0)) for tick in range(COUNT)
    ]


@pytest.mark.parametrize("drop", [0.01, 0.05, 0.2])
def test_the_share_that_is_lost_is_the_one_asked_for(drop: float) -> None:
    """Within five standard deviations of the binomial distribution; the same ones each
    time.
    """
    arrived = run(Transport(drop=drop))
    lost = COUNT - len(arrived)
    assert abs(lost - drop * COUNT) < 5.0 * math.sqrt(drop * (1.0 - drop) * COUNT)
    assert run(Transport(drop=drop)) == arrived
    assert run(Transport(drop=drop), seed=4) != arrived


def test_a_delay_is_kept_to_the_nanosecond() -> None:
    link: MessageLink[str] = MessageLink(Transport(delay=0.003))
    link.send(7, "a")
    assert list(link.due(3 * MS + 6)) == []
    assert link.next_due() == 3 * MS + 7
    assert [delivery.item for delivery in link.due(3 * MS + 7)] == ["a"]


def test_jitter_delays_within_its_bound_and_keeps_the_order() -> None:
    arrived = run(Transport(jitter=0.004))
    items = [delivery.item for _, delivery in arrived]
    assert items == list(range(COUNT))
    lateness = {tick - delivery.item for tick, delivery in arrived}
    assert lateness <= {0, 1, 2, 3, 4}
    assert len(lateness) >= 3


def test_a_message_held_back_is_overtaken_within_its_time() -> None:
    arrived = run(Transport(reorder=0.1, reorder_time=0.003))
    items = [delivery.item for _, delivery in arrived]
    assert sorted(items) == list(range(COUNT))
    overtaken = [
        item
        for place, item in enumerate(items)
        if any(later < item for later in items[place + 1 : place + 5])
    ]
    assert overtaken
    assert max(tick - delivery.item for tick, delivery in arrived) <= 4


def test_a_duplicate_arrives_right_behind_its_original() -> None:
    items = [delivery.item for _, delivery in run(Transport(duplicate=0.3))]
    twice = [item for item in set(items) if items.count(item) == 2]
    assert len(items) - len(set(items)) == len(twice) > 0
    assert all(items[items.index(item) + 1] == item for item in twice)


def test_a_window_gives_its_shape_to_what_is_sent_in_it_and_an_outage_lets_nothing_through() -> (
    None
):
    windows = (
        FaultWindow(10 * MS, 15 * MS, MessageShape.OUTAGE),
        FaultWindow(20 * MS - 7, 22 * MS, MessageShape.NAN),
    )
    arrived = [delivery for _, delivery in run(Transport(), windows)]
    assert [delivery.item for delivery in arrived][:12] == [*range(10), 15, 16]
    shaped = [
        (delivery.item, delivery.shape, delivery.began)
        for delivery in arrived
        if delivery.shape is not None
    ]
    assert shaped == [(20, MessageShape.NAN, 20 * MS), (21, MessageShape.NAN, 20 * MS)]


@given(
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.floats(0.0, 0.01),
    st.floats(0.0, 0.01),
    st.integers(0, 99),
)
def test_nothing_gets_lost_that_is_not_counted(
    drop: float,
    duplicate: float,
    reorder: float,
    delay: float,
    jitter: float,
    seed: int,
) -> None:
    link: MessageLink[int] = MessageLink(
        Transport(drop, duplicate, reorder, 0.003, delay, jitter), seed
    )
    link.add(FaultWindow(20 * MS, 30 * MS, MessageShape.OUTAGE))
    for tick in range(100):
        link.send(tick * MS, tick)
    arrived = list(link.due(10**12))
    counts = link.counts
    assert counts["sent"] == 100
    assert counts["lost_in_outage"] == 10
    assert (
        len(arrived)
        == counts["delivered"]
        == 90 - counts["dropped"] + counts["duplicated"]
    )


def test_a_probability_or_a_time_out_of_range_is_refused_with_the_number() -> None:
    with pytest.raises(ParameterError, match=r"drop = 1.5; it must lie in \[0, 1\]"):
        Transport(drop=1.5)
    with pytest.raises(ParameterError, match=r"delay = -0.1 s"):
        Transport(delay=-0.1)
