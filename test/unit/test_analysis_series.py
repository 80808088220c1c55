"""Messages read as columns are the library's messages."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from synthetic_run import joint_state, message

from dextar_control.bags.series import BLOCK, MOST_LAYOUTS, WAITING, Series

TYPES = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE = "sensor_msgs/msg/JointState"
NAMES = ("q11", "q21")


def filled(messages: list[Any], endings: bytes = b"") -> Series:
    series = Series("/joint_states", messages[0].__msgtype__, by_name)
    for number, content in enumerate(messages):
        series.add(
            number,
            number + 7,
            bytes(TYPES.serialize_cdr(content, content.__msgtype__)) + endings,
        )
    return series


def by_name(content: Any) -> dict[str, str]:
    return {
        name: f"position.{content.name.index(name)}"
        for name in NAMES
        if name in content.name
    }


def expected(messages: list[Any]) -> np.ndarray:
    return np.array(
        [
            [
                dict(zip(m.name, m.position, strict=True)).get(name, np.nan)
                for name in NAMES
            ]
            for m in messages
        ]
    )


def many(count: int) -> list[Any]:
    """Four structures in turn, as when drivers with other names and lengths publish on
    one topic.
    """
    generator = np.random.default_rng(0)
    orders = [["q11", "q21"], ["q21", "q11"], ["q21", "other", "q11"], ["other"]]
    return [
        joint_state(
            3 * 10**9 + number * 10**6,
            names := orders[number % 4],
            generator.normal(size=len(names)),
        )
        for number in range(count)
    ]


@pytest.mark.parametrize("count", [1, 7, BLOCK, 2 * BLOCK + 3])
def test_columns_follow_names_whatever_the_structure(count: int) -> None:
    messages = many(count)
    table = filled(messages).table(NAMES)
    assert np.array_equal(table.values, expected(messages), equal_nan=True)
    assert table.stamps.tolist() == [
        3 * 10**9 + number * 10**6 for number in range(count)
    ]
    assert table.published.tolist() == [number + 7 for number in range(count)]


def test_bytes_after_the_message_do_not_matter() -> None:
    messages = many(40)
    assert np.array_equal(
        filled(messages, b"\0" * 3).table(NAMES).values,
        expected(messages),
        equal_nan=True,
    )


def test_bytes_of_another_byte_order_are_read_by_the_library() -> None:
    messages = many(8)
    series = Series("/joint_states", JOINT_STATE, by_name)
    for number, content in enumerate(messages):
        series.add(
            number,
            number,
            bytes(
                TYPES.serialize_cdr(content, JOINT_STATE, little_endian=number % 2 == 0)
            ),
        )
    assert np.array_equal(
        series.table(NAMES).values, expected(messages), equal_nan=True
    )


def test_numbers_that_are_not_finite_come_through() -> None:
    messages = [
        joint_state(k, ["q11", "q21"], (np.nan, np.inf) if k % 2 else (-0.0, 1.0))
        for k in range(6)
    ]
    values = filled(messages).table(NAMES).values
    assert np.isnan(values[1::2, 0]).all() and np.isinf(values[1::2, 1]).all()
    assert np.signbit(values[::2, 0]).all() and (values[::2, 1] == 1.0).all()


def test_the_first_message_of_a_stamp_counts() -> None:
    messages = [
        joint_state(10, ["q11", "q21"], (1.0, 2.0)),
        joint_state(5, ["q11", "q21"], (3.0, 4.0)),
        joint_state(10, ["q11", "q21"], (5.0, 6.0)),
    ]
    table = filled(messages).table(NAMES)
    assert table.stamps.tolist() == [5, 10]
    assert table.values.tolist() == [[3.0, 4.0], [1.0, 2.0]]


def test_bytes_that_are_no_message_are_counted_and_cost_no_other() -> None:
    series = Series("/joint_states", JOINT_STATE, by_name)
    messages = many(8)
    for number, content in enumerate(messages):
        series.add(
            number,
            number,
            (
                b"\0\1\0\0\xff\xff"
                if number in (0, 5)
                else bytes(TYPES.serialize_cdr(content, JOINT_STATE))
            ),
        )
    kept = [content for number, content in enumerate(messages) if number not in (0, 5)]
    assert np.array_equal(series.table(NAMES).values, expected(kept), equal_nan=True)
    assert (len(series), series.readable, series.unreadable) == (8, 6, 2)
    assert series.why.startswith(
        "6 bytes are no message of type sensor_msgs/msg/JointState: "
    )


def test_an_empty_topic_has_an_empty_table() -> None:
    table = Series("/joint_states", JOINT_STATE, by_name).table(NAMES)
    assert table.values.shape == (0, 2)
    assert len(table.stamps) == 0


def test_slow_topics_give_the_selected_messages_in_order() -> None:
    series = Series("/words", "std_msgs/msg/String", select=list)
    for number in range(2 * WAITING + 1):
        content = message("std_msgs/msg/String", data=str(number))
        series.add(
            number, number, bytes(TYPES.serialize_cdr(content, content.__msgtype__))
        )
    assert [content.data for content in series.messages()] == [
        str(number) for number in range(2 * WAITING + 1)
    ]


def test_a_topic_of_which_hardly_two_messages_are_alike_is_read_by_the_library() -> (
    None
):
    count = 2 * MOST_LAYOUTS
    messages = [
        joint_state(
            number,
            [*("pqrs"[: number % 4]), f"n{number}", "q11", "q21"],
            np.arange(number % 4 + 3.0),
        )
        for number in range(count)
    ]
    series = filled(messages)
    assert np.array_equal(
        series.table(NAMES).values, expected(messages), equal_nan=True
    )
    assert len(series._layouts) == MOST_LAYOUTS
