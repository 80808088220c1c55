"""Real-time pace on made-up clocks: what is late is made up for gently, what is
hopeless is dropped and counted.
"""

from __future__ import annotations

import random
from typing import Any

import pytest

from dextar_sim import node
from dextar_sim.pace import MOST_BEHIND, PATIENT, SHORTEST, Schedule, keeping_pace

PERIOD = 1_000_000
CLOSEST = round(SHORTEST * PERIOD)


def started(period: int = PERIOD) -> Schedule:
    schedule = Schedule(period)
    schedule.start(0, 0)
    return schedule


def run(schedule: Schedule, delays: list[int], *, awaited: bool = False) -> list[int]:
    """When each sample came, so long after its deadline, ns."""
    times = []
    for delay in delays:
        times.append(schedule.deadline(awaited) + delay)
        schedule.met(times[-1], awaited)
    return times


def test_samples_on_time_lie_a_period_apart() -> None:
    schedule = started()
    assert run(schedule, [0] * 5) == [PERIOD * index for index in range(5)]
    assert (schedule.overruns, schedule.longest, schedule.behind, schedule.slip) == (
        0,
        0,
        0,
        0,
    )


def test_a_late_sample_is_made_up_for_and_none_comes_closer_than_the_shortest_period() -> (
    None
):
    """3.4 periods late; each of the next gains a quarter of a period: after 14 the
    schedule is back.
    """
    schedule = started()
    late = round(3.4 * PERIOD)
    times = run(schedule, [0, late] + [0] * 20)
    gaps = [after - before for before, after in zip(times, times[1:], strict=False)]
    assert gaps[1:14] == [CLOSEST] * 13
    assert min(gaps) == CLOSEST
    assert times[15:] == [PERIOD * index for index in range(15, 22)]
    assert (schedule.overruns, schedule.longest, schedule.behind, schedule.slip) == (
        1,
        late,
        0,
        0,
    )


def test_a_sample_without_its_command_is_given_nearly_a_whole_period() -> None:
    schedule = started()
    times = run(schedule, [0, round(0.3 * PERIOD), *[0] * 10], awaited=True)
    gaps = [after - before for before, after in zip(times, times[1:], strict=False)]
    assert gaps[1:7] == [round(PATIENT * PERIOD)] * 6
    assert times[-1] == 11 * PERIOD


def test_what_is_behind_is_told_while_it_is_made_up_for() -> None:
    schedule = started()
    run(schedule, [0, 2 * PERIOD])
    behind = []
    for _ in range(10):
        behind.append(schedule.behind)
        run(schedule, [0])
    assert behind == [
        max(0, 2 * PERIOD - (PERIOD - CLOSEST) * index) for index in range(10)
    ]
    assert schedule.overruns == 1


@pytest.mark.parametrize("awaited", [False, True])
def test_a_wake_up_that_always_comes_late_does_not_keep_the_schedule_behind(
    awaited: bool,
) -> None:
    schedule = started()
    times = run(schedule, [0, 5 * PERIOD, *[PERIOD // 5] * 200], awaited=awaited)
    assert times[-1] == 201 * PERIOD + PERIOD // 5


def test_small_lateness_moves_nothing() -> None:
    schedule = started()
    times = run(schedule, [PERIOD // 5] * 100)
    assert times[-1] == 99 * PERIOD + PERIOD // 5
    assert schedule.overruns == 0


def test_a_noisy_machine_does_not_slip() -> None:
    """Delays of up to 0.15 periods, and each hundredth sample up to 15 periods late."""
    chance = random.Random(3)
    delays = [
        (
            chance.randrange(0, 3 * PERIOD // 20)
            if index % 100
            else chance.randrange(15 * PERIOD)
        )
        for index in range(20_000)
    ]
    schedule = started()
    times = run(schedule, delays)
    assert (
        min(after - before for before, after in zip(times, times[1:], strict=False))
        >= PERIOD // 2
    )
    assert max(time - PERIOD * index for index, time in enumerate(times)) <= MOST_BEHIND
    assert schedule.slip == 0
    run(schedule, [0] * 200)
    assert schedule.deadline(False) == PERIOD * 20_200


def test_a_stalled_machine_loses_its_time_once() -> None:
    schedule = started()
    stall = MOST_BEHIND + PERIOD
    times = run(schedule, [0, stall, 0, 0])
    assert times[1:] == [PERIOD + stall, 2 * PERIOD + stall, 3 * PERIOD + stall]
    assert (schedule.overruns, schedule.longest, schedule.behind, schedule.slip) == (
        1,
        stall,
        0,
        stall,
    )


def test_lateness_that_adds_up_beyond_the_bound_is_dropped_too() -> None:
    schedule = started()
    run(schedule, [PERIOD] * 500)
    assert schedule.slip > MOST_BEHIND
    assert schedule.behind <= MOST_BEHIND


def test_a_slow_rig_may_be_a_period_late() -> None:
    schedule = started(100 * PERIOD)
    times = run(schedule, [0, 70 * PERIOD, 0, 0, 0])
    assert schedule.slip == 0
    assert times[-1] == 4 * 100 * PERIOD


def test_a_pause_is_neither_late_nor_run() -> None:
    schedule = started()
    run(schedule, [0, 3 * PERIOD])
    schedule.stop(10 * PERIOD)
    assert (schedule.ran(500 * PERIOD), schedule.behind, schedule.running) == (
        10 * PERIOD,
        0,
        False,
    )
    schedule.stop(600 * PERIOD)
    schedule.start(1000 * PERIOD, PERIOD)
    assert run(schedule, [0, 0]) == [1001 * PERIOD, 1002 * PERIOD]
    assert schedule.ran(1002 * PERIOD) == 12 * PERIOD
    assert (schedule.overruns, schedule.slip) == (1, 0)


class MadeUp:
    """A clock, an executor whose waits let it go on, and a rig that keeps when it
    published.
    """

    lockstep = finished = paused = False
    paced = True
    answered = sample_ready = False
    awaited = property(lambda self: not self.answered)
    period_ns = PERIOD

    def __init__(self) -> None:
        self.now = 0
        self.schedule = Schedule(PERIOD)
        self.published: list[int] = []
        self.stalls: dict[int, int] = {}
        self.answers = True
        self.takes = PERIOD // 10  # from a state to its command
        self.waited = 0

    def monotonic_ns(self) -> int:
        return self.now

    def spin_once(self, timeout_sec: float) -> None:
        self.now += min(1 + int(1.0e9 * timeout_sec), PERIOD // 10)

    def listen(self) -> None:
        self.answered = (
            self.answers
            and bool(self.published)
            and self.now >= self.published[-1] + self.takes
        )

    def wait(self, seconds: float) -> None:
        self.waited += 1
        self.spin_once(seconds)

    def begin(self) -> None:
        self.sample_ready = True

    def advance(self) -> None:
        self.now += PERIOD // 10
        self.sample_ready = True

    def publish(self) -> None:
        self.sample_ready = self.answered = False
        self.published.append(self.now)
        self.now += PERIOD // 50 + self.stalls.get(len(self.published), 0)

    def repeat_unanswered(self) -> None:
        raise AssertionError("not in real time")


@pytest.mark.parametrize(
    ("answers", "closest"), [(True, CLOSEST), (False, round(PATIENT * PERIOD))]
)
@pytest.mark.parametrize("stall", [0, 4 * PERIOD, MOST_BEHIND - PERIOD])
def test_the_rigs_clock_keeps_up_with_the_steady_one(
    monkeypatch: Any, stall: int, answers: bool, closest: int
) -> None:
    rig = MadeUp()
    rig.answers = answers
    monkeypatch.setattr(node, "time", rig)
    rig.stalls = {100: stall}
    rig.begin()
    for _ in range(1400):
        node.cycle(rig, rig)
    assert rig.published[-1] - rig.published[0] == pytest.approx(
        1399 * PERIOD, abs=PERIOD // 100
    )
    gaps = [
        after - before
        for before, after in zip(rig.published, rig.published[1:], strict=False)
    ]
    assert min(gaps) >= closest - PERIOD // 1000
    assert rig.schedule.overruns == bool(stall)


@pytest.mark.parametrize(
    ("factor", "takes", "rate"),
    [(1.0, 0.3, 1.0), (0.5, 0.3, 2.0), (1.0, 3.0, 3.1), (0.0, 0.3, 0.42)],
)
def test_in_lockstep_each_step_waits_for_its_command_and_the_clock_sets_the_pace(
    monkeypatch: Any, factor: float, takes: float, rate: float
) -> None:
    """Slower than the clock where the answers are slow; then nothing is left out, and
    nothing is overtaken.
    """
    rig = MadeUp()
    monkeypatch.setattr(node, "time", rig)
    rig.lockstep, rig.paced, rig.takes = True, factor > 0.0, round(takes * PERIOD)
    rig.schedule = Schedule(round(PERIOD / factor) if factor else PERIOD)
    answered = []
    monkeypatch.setattr(
        rig,
        "advance",
        lambda advance=rig.advance: (answered.append(rig.answered), advance()),
    )
    monkeypatch.setattr(rig, "repeat_unanswered", lambda: None)
    rig.begin()
    while len(rig.published) < 300:
        node.cycle(rig, rig)
    assert answered == [True] * 299
    gaps = [
        after - before
        for before, after in zip(rig.published, rig.published[1:], strict=False)
    ]
    assert sum(gaps) / len(gaps) == pytest.approx(rate * PERIOD, rel=0.05)
    assert min(gaps) >= rig.takes


SECOND = 1_000_000_000


@pytest.mark.parametrize(
    ("steps", "late", "ran", "words"),
    [
        (1000, 0, SECOND, []),
        (960, 90, SECOND, []),
        (
            560,
            0,
            SECOND,
            ["real-time factor 0.56 over the last 1.0 s; the limit is 0.95"],
        ),
        (
            560,
            358,
            SECOND,
            [
                "real-time factor 0.56 over",
                "64 % of the steps without their command in time; the limit is 10 %",
            ],
        ),
        (1000, 640, SECOND, ["64 % of the steps without their command in time"]),
        (0, 0, SECOND, ["real-time factor 0.00"]),
        (1, 1, 400_000_000, []),  # it hardly ran
        (0, 0, 0, []),
    ],
)
def test_a_plant_that_falls_behind_says_so_with_the_numbers(
    steps: int, late: int, ran: int, words: list[str]
) -> None:
    told = keeping_pace(steps, late, ran, PERIOD)
    assert len(told) == len(words)
    assert all(text.startswith(word) for text, word in zip(told, words, strict=True))
