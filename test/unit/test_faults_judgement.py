"""Each check of what must never happen passes what is right and fails what is wrong."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from dextar_control.contract.robot import RobotParameters
from dextar_control.experiments.faults import bag_check, judgement
from dextar_control.experiments.faults.judgement import Evidence, NodeReports
from dextar_control.model.model import Model
from dextar_sim import geometry

MS = 1_000_000
STATES = 400
LIMIT = 0.3


def evidence(
    torque: np.ndarray, commanded: np.ndarray, command_torque: np.ndarray | None = None
) -> Evidence:
    """States of 1 to STATES ms, and commands for those in ``commanded`` (ms)."""
    commands = (
        np.full((len(commanded), 2), 0.1) if command_torque is None else command_torque
    )
    return Evidence(
        np.arange(1, STATES + 1) * MS,
        np.zeros((STATES, 4)),
        torque,
        commanded * MS,
        commands,
        MS,
    )


def torque_until(last: int) -> np.ndarray:
    """0.1 N m in the states up to ``last`` ms, then none."""
    values = np.zeros((STATES, 2))
    values[:last] = 0.1
    return values


def test_torque_within_100_ms_of_the_last_command_is_allowed_and_one_period_more_is_not() -> (
    None
):
    """The last command is of 100 ms: the period that begins 100 ms later, and ends in
    the state of 201 ms, must be free.
    """
    commanded = np.arange(1, 101)
    looked, lines = judgement.torque_after_death(evidence(torque_until(200), commanded))
    assert (looked, lines) == (STATES - 200, [])
    _, lines = judgement.torque_after_death(evidence(torque_until(201), commanded))
    assert lines == ["0.1 N m at 201000000 ns, 0.100 s after the last command"]


def test_commands_that_are_not_finite_keep_nobody_alive() -> None:
    commanded = np.arange(1, STATES + 1)
    torque = np.full((STATES, 2), 0.1)
    torque[100:, 0] = np.nan
    _, lines = judgement.torque_after_death(
        evidence(torque_until(STATES), commanded, torque)
    )
    assert len(lines) == 1
    assert judgement.torque_after_death(evidence(torque_until(STATES), commanded)) == (
        0,
        [],
    )


def test_torque_without_any_command_is_one_after_death() -> None:
    _, lines = judgement.torque_after_death(
        evidence(torque_until(3), np.array([], dtype=np.int64))
    )
    assert lines == ["0.1 N m at 1000000 ns, without any command"]


@pytest.mark.parametrize("wrong", [0.301, -0.301, np.nan, np.inf])
def test_torque_beyond_the_limit_or_no_number_is_told(wrong: float) -> None:
    torque = np.full((STATES, 2), LIMIT)
    assert judgement.torque_beyond(evidence(torque, np.arange(1, 9)), LIMIT) == (
        STATES,
        [],
    )
    torque[7, 1] = wrong
    _, lines = judgement.torque_beyond(evidence(torque, np.arange(1, 9)), LIMIT)
    assert len(lines) == 1 and "at 8000000 ns; the limit is 0.3 N m" in lines[0]


def test_a_command_that_is_no_number_too_large_or_answers_a_bad_state_is_told() -> None:
    stamps, torque = np.arange(5) * MS, np.zeros((5, 2))
    torque[0] = 0.3
    assert judgement.not_finite(stamps, torque, [2 * MS], LIMIT) == (5, [])
    torque[1, 0], torque[2, 1], torque[3, 0] = np.nan, 0.1, 0.4
    _, lines = judgement.not_finite(stamps, torque, [2 * MS], LIMIT)
    assert lines == [
        "[nan, 0.0] N m at 1000000 ns",
        "[0.4, 0.0] N m at 3000000 ns",
        "[0.0, 0.1] N m answer the bad state of 2000000 ns",
    ]


def test_side_and_place_of_the_true_joints_are_those_of_the_geometry(
    robot: RobotParameters,
) -> None:
    """Joints from the simulator's inverse geometry of points on both sides; the side
    from the controller's model.
    """
    model = Model.of(robot)
    for x in ([-0.025, 0.115], [0.01, 0.06], [0.0, 0.1]):
        joints = np.array([geometry.joints_at(robot, x)])
        np.testing.assert_allclose(
            judgement.true_position(robot, joints)[0], x, atol=1e-12
        )
        np.testing.assert_allclose(
            joints[0, [0, 2]], model.inverse_geometric_model(np.array(x)), atol=1e-9
        )
    sides = [
        judgement.true_side(np.array([geometry.joints_at(robot, x)]))[0]
        for x in ([-0.025, 0.115], [0.01, 0.06])
    ]
    assert sides == [
        1.0,
        -1.0,
    ]  # the trip between these two is planned from s > 0 to s < 0


def test_a_silent_publisher_is_seen_by_its_largest_gap() -> None:
    times = np.arange(100) * MS
    assert not judgement.paused(times, 0.02)
    assert judgement.paused(np.delete(times, range(40, 61)), 0.02)


def seen(**changes: object) -> NodeReports:
    status = {
        "controller": {"missed_states": "3", "reason": ""},
        "plant": {"late_ticks": "7"},
    }
    fields: dict[str, object] = {
        "before": status,
        "after": status,
        "texts": {},
        "exits": {},
        "logs": {},
        "answers": [],
    }
    return NodeReports(**(fields | changes))  # type: ignore[arg-type]


WAYS = [
    "controller.missed_states",
    "controller.reason~no state",
    "exit.plant",
    "silent.plant",
    "log.recorder~full",
    "answer~refused",
]


def test_a_fault_of_which_nobody_speaks_is_not_reported() -> None:
    assert seen().reports(WAYS) == []
    assert (
        seen(
            exits={"plant": 0},
            logs={"recorder": "fine"},
            answers=["taken"],
            silent={"controller"},
        ).reports(WAYS)
        == []
    )


@pytest.mark.parametrize(
    ("changes", "way"),
    [
        ({"after": {"controller": {"missed_states": "4"}}}, WAYS[0]),
        ({"texts": {"controller.reason": ["", "no state for 31 ms"]}}, WAYS[1]),
        ({"exits": {"plant": -9}}, WAYS[2]),
        ({"silent": {"plant"}}, WAYS[3]),
        ({"logs": {"recorder": "disk full"}}, WAYS[4]),
        ({"answers": ["refused: too large"]}, WAYS[5]),
    ],
)
def test_each_way_of_reporting_is_recognised(
    changes: dict[str, object], way: str
) -> None:
    assert seen(**changes).reports(WAYS) == [way]


def whole_bag(chunks: int) -> bytes:
    """An MCAP file of so many chunks."""
    file = io.BytesIO()
    writer = Writer(file, chunk_size=1_000_000, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library="test")
    schema = writer.register_schema("std_msgs/msg/Int64", "ros2msg", b"int64 data")
    channel = writer.register_channel("/number", "cdr", schema)
    for chunk in range(chunks):
        for number in range(30 * chunk + 1, 30 * chunk + 31):
            writer.add_message(
                channel, number, number.to_bytes(64, "little"), number, number
            )
        writer.flush()
    writer.finish()
    return file.getvalue()


def test_a_bag_cut_off_anywhere_is_readable_up_to_its_last_complete_chunk(
    tmp_path: Path,
) -> None:
    raw = whole_bag(4)
    path = tmp_path / "cut.mcap"
    for length in [*range(100, len(raw), 97), len(raw)]:
        path.write_bytes(raw[:length])
        assert bag_check.unreadable(path) == []
        assert bag_check.finished(path) == (length == len(raw))


def test_a_bag_with_a_broken_chunk_in_front_is_not_readable(tmp_path: Path) -> None:
    """The lengths of the records still fit, so that the chunks behind count as
    complete.
    """
    raw = bytearray(whole_bag(3))
    path = tmp_path / "broken.mcap"
    place = raw.index(b"zstd") + 30
    raw[place : place + 20] = bytes(20)
    path.write_bytes(raw)
    assert len(bag_check.unreadable(path)) == 1


def test_a_file_that_is_none_or_no_bag_is_not_readable(tmp_path: Path) -> None:
    other = tmp_path / "other.mcap"
    other.write_bytes(b"something else")
    assert "does not begin as an MCAP file" in bag_check.unreadable(other)[0]
    assert "No such file" in bag_check.unreadable(tmp_path / "none.mcap")[0]
