"""Clocks that step back while a run is recorded: one run, in the order of record; two
runs are still told apart.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from synthetic_run import PERIOD, START, TICKS, TYPES, joint_state
from test_analysis_passed_over import (
    JOINT_STATE,
    Message,
    messages_of,
    record_of,
    serialized,
    write,
)

from dextar_control.analysis import compute_metrics, load_run
from dextar_control.cli import main as cli
from dextar_control.contract.errors import BagError

STAMPED = (
    "/joint_states",
    "/joint_commands",
    "/controller_state",
    "/criterion",
    "/sim/end_effector",
    "/sim/joint_states",
)


def in_time(messages: list[Message]) -> Iterator[tuple[int, Message]]:
    """(tick, message) with the recorder's times a tick of a millisecond apart, as in
    real time.
    """
    tick = -1
    for number, (topic, kind, encoding, _, _, data) in enumerate(messages):
        tick += topic == "/joint_states"
        time = START + max(tick, 0) * PERIOD + number % 7 * 1000
        yield max(tick, 0), (topic, kind, encoding, time, time, data)


def shifted(data: bytes, kind: str, by: int) -> bytes:
    content = TYPES.deserialize_cdr(data, kind)
    stamp = content.header.stamp.sec * 10**9 + content.header.stamp.nanosec + by
    object.__setattr__(
        content.header,
        "stamp",
        dataclasses.replace(
            content.header.stamp, sec=stamp // 10**9, nanosec=stamp % 10**9
        ),
    )
    return serialized(content)


def stepped(
    good: Path, target: Path, stamps: Callable[[int], int], times: Callable[[int], int]
) -> Path:
    """The run with what these functions of the tick add to its stamps and to the
    recorder's times.
    """
    messages = []
    for tick, (topic, kind, encoding, time, _, data) in in_time(messages_of(good)):
        by = stamps(tick)
        moved = shifted(data, kind, by) if by and topic in STAMPED else data
        messages.append(
            (topic, kind, encoding, time + times(tick), time + times(tick), moved)
        )
    return write(target, messages, metadata=record_of(good))


def back(seconds: float, at: int = 400) -> Callable[[int], int]:
    return lambda tick: -round(seconds * 1e9) * (tick >= at)


def still(_: int) -> int:
    return 0


def test_a_system_clock_set_back_costs_neither_rate_nor_round_trip(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The rig's own clock goes on, as that of a plant that counts its steps."""
    bag = stepped(good, tmp_path / "run.mcap", still, back(60.0))
    assert cli.main(["analyze", str(bag)]) in (0, 1)
    printed = capsys.readouterr()
    assert "the system clock stepped back once, by 59.99" in printed.err
    assert "stepped back once" in " ".join(printed.out.split())
    found = json.loads((tmp_path / "metrics.json").read_text())
    assert found["mean_rate"] == pytest.approx(1000.0, rel=1e-3) and found[
        "loop_rate"
    ] == pytest.approx(1000.0, rel=1e-2)
    assert found["timing"]["round_trip"]["maximum"] < 0.001
    assert (
        found["clock_steps"] == pytest.approx([60.0], abs=0.01)
        and found["stamp_steps"] == []
    )
    assert (
        "The system clock stepped back once" in (tmp_path / "report.html").read_text()
    )
    plain = compute_metrics(
        load_run(stepped(good, tmp_path / "plain.mcap", still, still))
    )
    assert [one["true_time"] for one in found["crossings"]] == [
        one.true_time for one in plain.crossings
    ]


@pytest.mark.parametrize(
    "times", ["with", "without"], ids=lambda word: f"{word} the recorder's clock"
)
@pytest.mark.parametrize("seconds", [0.02, 0.4, 2.0, 60.0])
def test_stamps_that_step_back_lose_no_state(
    seconds: float, times: str, good: Path, tmp_path: Path
) -> None:
    bag = stepped(
        good,
        tmp_path / "run.mcap",
        back(seconds),
        back(seconds) if times == "with" else still,
    )
    with pytest.warns(
        UserWarning,
        match=f"the clock of the stamps stepped back once, by {seconds - 0.001:.3f} s",
    ):
        run = load_run(bag)
    plain = load_run(good)
    assert (
        np.abs(run.states.stamps - plain.states.stamps).max() <= 20_000
    )  # the recorder's jitter at the step
    for part in ("states", "commands", "control", "criterion", "truth"):
        mine, theirs = getattr(run, part), getattr(plain, part)
        assert np.isin(mine.stamps, run.states.stamps).all(), part
        assert len(mine.stamps) == len(theirs.stamps), part
    np.testing.assert_array_equal(run.states.position, plain.states.position)
    np.testing.assert_array_equal(run.truth.x, plain.truth.x)
    metrics = compute_metrics(run)
    assert (metrics.states, metrics.missed) == (TICKS, 3)
    assert [crossing.outcome for crossing in metrics.crossings] == [
        "crossed",
        "crossed",
    ]
    assert metrics.stamp_steps == pytest.approx([seconds - 0.001])


def test_a_bag_of_states_alone_that_steps_twice_is_one_run(tmp_path: Path) -> None:
    """At 100 Hz, as an arm of another make has it, without a controller."""
    messages = []
    for tick in range(900):
        stamp = (
            START + tick * 10_000_000 - 400_000_000 * ((tick >= 300) + (tick >= 600))
        )
        data = serialized(joint_state(stamp, ["q11", "q21"], (0.001 * tick, 1.0)))
        messages.append(
            ("/joint_states", JOINT_STATE, "cdr", stamp + 50, stamp + 50, data)
        )
    with pytest.warns(
        UserWarning,
        match=r"stepped back 2 times, by 0.390 to 0.390 s, the system clock 2 times",
    ):
        run = load_run(write(tmp_path / "run.mcap", messages))
    assert run.states.stamps.tolist() == [
        START + tick * 10_000_000 for tick in range(900)
    ]
    metrics = compute_metrics(run)
    assert (metrics.states, metrics.mean_rate) == (900, pytest.approx(100.0))


def test_single_wrong_stamps_and_messages_that_were_overtaken_are_no_step(
    good: Path, tmp_path: Path
) -> None:
    def odd(tick: int) -> int:
        return {200: -3600 * 10**9, 300: 7_500_000, 301: -1_500_000}.get(tick, 0)

    run = load_run(stepped(good, tmp_path / "run.mcap", odd, still))
    assert (run.stamp_steps, run.clock_steps) == ([], [])
    assert len(run.states.stamps) == TICKS


def two_runs(good: Path, begin: int, later: int) -> list[Message]:
    """The second has the stamps of the first from a tick on, and comes so many ticks
    after the first in the recorder's time.
    """
    first = [one for _, one in in_time(messages_of(good))]
    by = (TICKS + later - 1 - begin) * PERIOD
    second = [
        (topic, kind, encoding, time + by, time + by, data)
        for tick, (topic, kind, encoding, time, _, data) in in_time(messages_of(good))
        if tick >= begin
    ]
    return [*first, *(second if begin else second[1:])]


@pytest.mark.parametrize(
    ("begin", "later", "why"),
    [
        (0, 1, "they begin there as they began before"),
        (500, 1, "the joints jump by"),
        (970, 3000, "no state came for 3.000 s"),
    ],
    ids=["begins anew", "jumps", "after a pause"],
)
def test_two_runs_in_one_bag_are_told_apart(
    begin: int, later: int, why: str, good: Path, tmp_path: Path
) -> None:
    messages = two_runs(good, begin, later)
    if begin == 0:
        messages.insert(
            len(messages) // 2 + 20, messages[0]
        )  # the trajectory, served again
    bag = write(tmp_path / "run.mcap", messages, metadata=record_of(good))
    with pytest.raises(
        BagError,
        match=(
            "after 1001 of .* messages: two runs in one bag, or a plant that was reset"
            f" .{why}"
        ),
    ):
        load_run(bag)


def test_the_states_of_two_publishers_in_turn_are_no_clock_that_steps(
    tmp_path: Path,
) -> None:
    messages = []
    for tick in range(400):
        for ahead in (0, 10**10):
            data = serialized(
                joint_state(START + tick * PERIOD + ahead, ["q11", "q21"], (1.0, 2.0))
            )
            time = START + tick * PERIOD
            messages.append(("/joint_states", JOINT_STATE, "cdr", time, time, data))
    with pytest.raises(
        BagError,
        match="go back and forth, 39. times in 800 messages: two publishers send it",
    ):
        load_run(write(tmp_path / "run.mcap", messages))
