"""The faulty link between two network namespaces: what is lost, late or out of order is
what was asked for.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import link_peer
import pytest
from patience import PATIENCE
from scipy.stats import binomtest, kstest

from dextar_control.experiments.faults.frames import (
    FrameSchedule,
    LinkError,
    LinkQuality,
)
from dextar_control.experiments.faults.netns import ADDRESSES, FaultyLink, Side

ROOT = Path(__file__).resolve().parents[2]
PEER = [sys.executable, link_peer.__file__]
UNLIKELY = 1e-6  # of a count or a distribution, when the link is as declared


def _refusal() -> str:
    try:
        with FaultyLink():
            return ""
    except LinkError as error:
        return str(error)


REFUSAL = _refusal()
needs_root = pytest.mark.skipif(bool(REFUSAL), reason=REFUSAL)


def _pass(
    quality: LinkQuality, count: int, period: float = 1e-3, seed: int = 5
) -> tuple[FrameSchedule, list[tuple[int, float]]]:
    """(number, time of leaving) of count frames that enter period apart, in the order
    in which they leave.
    """
    schedule, left = FrameSchedule(quality, seed), []
    for number in range(count):
        while schedule.next_departure() <= number * period:
            due = schedule.next_departure()
            left += [(int(frame), due) for frame in schedule.leave(due)]
        schedule.enter(number * period, str(number).encode())
    while (due := schedule.next_departure()) < math.inf:
        left += [(int(frame), due) for frame in schedule.leave(due)]
    return schedule, left


def test_a_perfect_link_forwards_each_frame_at_once_and_in_order() -> None:
    schedule, left = _pass(LinkQuality(), 100)
    assert left == [(number, number * 1e-3) for number in range(100)]
    assert schedule.statistics.forwarded == schedule.statistics.received == 100


@pytest.mark.parametrize("loss", [0.01, 0.05, 0.2])
def test_the_share_of_lost_frames_is_the_declared_one(loss: float) -> None:
    schedule, left = _pass(LinkQuality(loss=loss), 20_000)
    assert binomtest(schedule.statistics.dropped, 20_000, loss).pvalue > UNLIKELY
    assert (
        len(left)
        == schedule.statistics.forwarded
        == 20_000 - schedule.statistics.dropped
    )


def test_jitter_delays_within_its_bounds_and_keeps_the_order() -> None:
    _, left = _pass(LinkQuality(delay=0.003, jitter=0.004), 5000)
    assert [number for number, _ in left] == list(range(5000))
    delays = [due - number * 1e-3 for number, due in left]
    assert min(delays) >= 0.003 - 1e-12
    assert max(delays) <= 0.007 + 1e-12


def test_jitter_of_frames_too_far_apart_to_wait_for_each_other_is_uniform() -> None:
    _, left = _pass(LinkQuality(delay=0.003, jitter=0.004), 5000, period=0.01)
    assert (
        kstest(
            [due - number * 0.01 for number, due in left], "uniform", (0.003, 0.004)
        ).pvalue
        > UNLIKELY
    )


def test_a_frame_held_back_is_overtaken_by_those_that_come_while_it_is() -> None:
    schedule, left = _pass(LinkQuality(reorder=0.02, hold=0.0035), 10_000)
    order = [number for number, _ in left]
    assert sorted(order) == list(range(10_000))
    overtaken = sum(
        number < before
        for number, before in zip(order, itertools.accumulate(order, max), strict=True)
    )
    assert schedule.statistics.reordered == overtaken
    assert binomtest(overtaken, 10_000, 0.02).pvalue > UNLIKELY


def test_a_duplicate_is_the_same_frame_directly_after_the_first() -> None:
    schedule, left = _pass(LinkQuality(duplicate=0.1), 10_000)
    order = [number for number, _ in left]
    twice = [number for number, after in itertools.pairwise(order) if number == after]
    assert len(twice) == schedule.statistics.duplicated
    assert binomtest(len(twice), 10_000, 0.1).pvalue > UNLIKELY


def test_the_fate_of_a_frame_depends_on_the_seed_and_its_number_alone() -> None:
    quality = LinkQuality(loss=0.1, jitter=0.002, reorder=0.05)
    survivors = [
        {number for number, _ in _pass(quality, 1000, period, seed)[1]}
        for period, seed in ((1e-3, 1), (5e-2, 1), (1e-3, 2))
    ]
    assert survivors[0] == survivors[1]
    assert survivors[0] != survivors[2]


@pytest.mark.parametrize(
    ("quality", "message"),
    [
        ({"loss": 1.5}, r"link quality 'loss' = 1.5; it must lie in \[0, 1\]"),
        ({"delay": -0.001}, r"link quality 'delay' = -0.001; it must lie in \[0, 10\]"),
        (
            {"jitter": math.nan},
            r"link quality 'jitter' = nan; it must lie in \[0, 10\]",
        ),
    ],
)
def test_a_quality_out_of_its_limits_is_refused(
    quality: dict[str, float], message: str
) -> None:
    with pytest.raises(LinkError, match=message):
        FaultyLink(**quality)


def test_without_the_right_to_make_namespaces_one_sentence_says_so() -> None:
    """Root without CAP_SYS_ADMIN is refused as a user is."""
    code = (
        "from dextar_control.experiments.faults.netns import FaultyLink\nwith"
        " FaultyLink(): pass"
    )
    drop = [] if REFUSAL else ["setpriv", "--bounding-set=-sys_admin"]
    done = subprocess.run(
        [*drop, sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT
    )
    assert done.stderr.splitlines()[-1].startswith(
        "dextar_control.experiments.faults.frames.LinkError: network namespaces need"
        " root"
    )


def test_a_missing_tool_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with (
        pytest.raises(
            LinkError, match=r"a faulty link needs ip, unshare, nsenter of iproute2"
        ),
        FaultyLink(),
    ):
        pass


def _start(link: FaultyLink, side: Side, *command: str) -> subprocess.Popen[str]:
    """A process on one side of a link."""
    return subprocess.Popen(
        [*link.inside(side), *PEER, *command],
        env=link.environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def _datagrams(link: FaultyLink, count: int) -> list[tuple[int, int]]:
    """(number, delay in ns) of the datagrams that came through from a to b, in order of
    arrival.
    """
    receiver = _start(link, "b", "receive")
    assert receiver.stdout is not None
    assert receiver.stdout.readline() == "ready\n"
    before = link.statistics()["a_to_b"].received
    assert _start(link, "a", "send", ADDRESSES["b"], str(count)).wait(PATIENCE) == 0
    deadline = time.monotonic() + PATIENCE
    while (now := link.statistics()["a_to_b"]).received < before + count or now.waiting:
        assert time.monotonic() < deadline, now
    return [
        tuple(pair) for pair in json.loads(receiver.communicate(timeout=PATIENCE)[0])
    ]


@needs_root
def test_the_datagrams_lost_between_the_namespaces_are_those_the_seed_says() -> None:
    quality = LinkQuality(loss=0.05, delay=0.003, jitter=0.002)
    with FaultyLink(loss=0.05, delay=0.003, jitter=0.002, seed=11) as link:
        arrived = _datagrams(link, 2000)
        statistics = link.statistics()["a_to_b"]
    survivors = sorted(
        {number for number, _ in _pass(quality, 2000, seed="11 a_to_b")[1]}
    )  # type: ignore[arg-type]
    assert [number for number, _ in arrived] == survivors
    assert (statistics.received, statistics.dropped, statistics.forwarded) == (
        2000,
        2000 - len(survivors),
        len(survivors),
    )
    assert statistics.overrun == statistics.refused == statistics.reordered == 0
    assert min(delay for _, delay in arrived) >= 3_000_000


@needs_root
def test_the_datagrams_overtaken_or_doubled_between_the_namespaces_are_counted() -> (
    None
):
    with FaultyLink(reorder=0.05, duplicate=0.05, seed=12) as link:
        order = [number for number, _ in _datagrams(link, 1000)]
        statistics = link.statistics()["a_to_b"]
    assert set(order) == set(range(1000))
    assert len(order) - 1000 == statistics.duplicated > 0
    overtaken = sum(
        number < before
        for number, before in zip(order, itertools.accumulate(order, max), strict=True)
    )
    assert overtaken == statistics.reordered > 0


@needs_root
def test_nothing_passes_during_an_outage_and_everything_after_it() -> None:
    with FaultyLink() as link:
        link.set_quality(loss=1.0)
        sender = _start(link, "a", "send", ADDRESSES["b"], "20")
        assert sender.wait(PATIENCE) == 0
        assert link.set_quality("a_to_b")["a_to_b"].dropped == 20  # the other way not
        assert [number for number, _ in _datagrams(link, 20)] == list(range(20))


@needs_root
def test_reliable_topics_get_through_a_bad_link_whole() -> None:
    count = 200
    with FaultyLink(
        loss=0.1, delay=0.002, jitter=0.002, reorder=0.05, duplicate=0.05, seed=13
    ) as link:
        listener = _start(link, "b", "subscribe", str(count))
        talker = _start(link, "a", "publish", str(count))
        assert json.loads(listener.communicate(timeout=PATIENCE)[0]) == list(
            range(count)
        )
        assert talker.communicate(timeout=PATIENCE)[0] == "True\n"
        statistics = link.statistics()["a_to_b"]
    assert (
        statistics.received > count
    )  # over the link, not past it through shared memory
    assert statistics.dropped > 0


@needs_root
@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_a_link_leaves_nothing_behind_when_its_owner_is_killed(
    end: signal.Signals,
) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    owner = subprocess.Popen(
        [*PEER, "hold"], stdout=subprocess.PIPE, text=True, cwd=ROOT, env=environment
    )
    assert owner.stdout is not None
    pids = json.loads(owner.stdout.readline())
    assert all(Path(f"/proc/{pid}").exists() for pid in pids)
    os.kill(owner.pid, end)
    owner.wait(timeout=PATIENCE)
    owner.stdout.close()
    deadline = time.monotonic() + PATIENCE
    while any(_runs(pid) for pid in pids):
        assert time.monotonic() < deadline, [pid for pid in pids if _runs(pid)]
        time.sleep(0.05)


def _runs(pid: int) -> bool:
    """Whether a process is there and no zombie that nobody has waited for yet."""
    try:
        return (
            Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
        )
    except (FileNotFoundError, ProcessLookupError):
        return False


@needs_root
def test_an_error_inside_the_context_ends_the_processes_of_the_link() -> None:
    with pytest.raises(RuntimeError, match="on purpose"), FaultyLink() as link:
        pids = link.helper_pids()
        raise RuntimeError("on purpose")
    assert not any(_runs(pid) for pid in pids)
    with pytest.raises(LinkError, match="there is no side 'a' of the link now"):
        link.inside("a")
