"""Who speaks on a topic, told by message numbers alone: every interleaving of a
speaker, a ghost and a second speaker.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from itertools import product

import pytest

from dextar_sim.commanders import SLACK, SPEAKING, UNNUMBERED, CommanderArbiter

MILLISECOND = 1_000_000
WINDOW = SPEAKING // MILLISECOND


class Voice:
    """A publisher: each message has the next number, also those that are lost."""

    def __init__(self, number: int = 0) -> None:
        self.number = number

    def lose(self, count: int = 1) -> None:
        self.number += count


class Topic:
    """A topic with a graph, a clock and states that go on together."""

    def __init__(self, graph: int = 1, *, lossless: bool = False) -> None:
        self.graph, self.now, self.states = graph, 0, 0
        self.speakers = CommanderArbiter(lambda: self.graph, lossless=lossless)

    def wait(self, milliseconds: int, *, states: bool = True) -> None:
        self.now += milliseconds * MILLISECOND
        self.states += milliseconds * states

    def say(self, voice: Voice) -> bool:
        voice.number += 1
        return self.speakers.take(voice.number, self.states, self.now)

    def appear(self, count: int) -> None:
        self.graph = count
        self.speakers.count_publishers(self.now)

    def talk(self, voice: Voice, milliseconds: int) -> list[bool]:
        """A message for each state."""
        taken = []
        for _ in range(milliseconds):
            self.wait(1)
            taken.append(self.say(voice))
        return taken

    @property
    def clear(self) -> bool:
        return self.speakers.accepts(self.now)


def test_one_publisher_is_taken_from_its_first_message_on() -> None:
    topic, voice = Topic(), Voice()
    assert topic.say(voice)
    assert all(topic.talk(voice, 500))
    topic.wait(10_000)
    assert topic.say(voice)
    assert all(topic.say(voice) for _ in range(50))


def test_gaps_are_no_second_speaker() -> None:
    chance = random.Random(1)
    for graph in (1, 2):
        topic, voice = Topic(graph), Voice()
        topic.talk(voice, 300)
        for _ in range(2000):
            topic.wait(1)
            if chance.random() < 0.3:
                voice.lose()
            else:
                assert topic.say(voice)


def test_a_long_outage_of_one_publisher_costs_nothing() -> None:
    topic, voice = Topic(), Voice()
    topic.talk(voice, 10)
    topic.wait(50, states=False)
    voice.lose(1000)
    assert topic.say(voice)


def test_a_second_publisher_in_the_graph_ends_it_at_once_and_its_silence_is_waited_for() -> (
    None
):
    topic, voice = Topic(), Voice()
    topic.talk(voice, 1000)
    topic.appear(2)
    assert not topic.clear
    taken = topic.talk(voice, 400)
    assert taken == [False] * (WINDOW - 1) + [True] * (400 - WINDOW + 1)
    assert topic.clear and topic.speakers.count == 2
    topic.appear(3)
    assert not topic.clear
    assert topic.talk(voice, 400).count(True) == 400 - WINDOW + 1
    topic.appear(2)
    assert all(topic.talk(voice, 10))


def test_the_successor_of_a_killed_speaker_is_taken_while_the_graph_still_has_the_dead_one() -> (
    None
):
    topic, killed, successor = Topic(), Voice(), Voice()
    topic.talk(killed, 5000)
    topic.wait(700)
    topic.appear(2)
    taken = topic.talk(successor, 1000)
    assert taken == [False] * WINDOW + [True] * (1000 - WINDOW)
    topic.appear(1)
    assert all(topic.talk(successor, 100))


def test_the_successor_of_a_speaker_that_left_is_taken_at_once() -> None:
    topic, left, successor = Topic(), Voice(), Voice()
    topic.talk(left, 5000)
    topic.wait(300)
    assert all(topic.talk(successor, 100))


def test_a_successor_that_follows_at_once_loses_one_message_where_the_graph_has_one() -> (
    None
):
    topic, left, successor = Topic(), Voice(), Voice()
    topic.talk(left, 5000)
    assert topic.talk(successor, 100) == [False] + [True] * 99


def test_a_starting_second_speaker_is_told_by_its_first_message_before_anybody_looks_at_the_graph() -> (
    None
):
    topic, first, second = Topic(), Voice(), Voice()
    topic.talk(first, 1000)
    topic.graph = 2
    topic.wait(1)
    assert not topic.say(second)
    assert not topic.clear
    assert not any(
        topic.talk(first, 5000)
    )  # both were heard: silence is no proof any more
    assert topic.speakers.several
    topic.appear(1)
    assert topic.clear and all(topic.talk(first, 10))
    topic.appear(2)  # one that is silent
    assert topic.talk(first, 400).count(True) == 400 - WINDOW + 1


def test_a_slow_second_speaker_does_not_switch_the_torque_on_and_off() -> None:
    topic, first, second = Topic(), Voice(), Voice()
    topic.talk(first, 1000)
    topic.appear(2)
    taken = topic.talk(first, 500)
    assert taken[-1]
    for _ in range(5):
        assert not topic.say(second)
        assert not any(topic.talk(first, 1000))


NUMBERS: dict[str, Callable[[int], int]] = {
    "just started": lambda number: 0,
    "as many": lambda number: number,
    "one behind": lambda number: number - 1,
    "a few ahead": lambda number: number + 3,
    "at the slack": lambda number: number + SLACK,
    "far ahead": lambda number: number + 5000,
}
SLIPS = ("as many", "one behind", "a few ahead", "at the slack")
"""Where a second one has said about as much as the first although nobody heard it."""


@pytest.mark.parametrize("start", NUMBERS)
@pytest.mark.parametrize("seen", [False, True], ids=["unseen", "seen"])
@pytest.mark.parametrize("lossless", [False, True], ids=["lossy", "lossless"])
def test_every_interleaving_of_two_speakers_ends_when_the_first_one_is_heard_again(
    start: str, seen: bool, lossless: bool
) -> None:
    """Eight messages of either in any order, a state for each: what the second one says
    is taken only before the first one's next word, and not at all where its numbers are
    not those that the first one might give next.
    """
    for pattern in product((True, False), repeat=8):
        topic, first = Topic(lossless=lossless), Voice()
        topic.talk(first, 300)
        if seen:
            topic.appear(2)
            topic.talk(first, WINDOW + 1)
        topic.graph = 2
        assert topic.clear
        second = Voice(NUMBERS[start](first.number))
        heard_second = told = False
        slipped = 0
        for is_first in pattern:
            topic.wait(1)
            taken = topic.say(first if is_first else second)
            told = (
                told
                or (is_first and heard_second)
                or (not is_first and start not in SLIPS)
            )
            heard_second = heard_second or not is_first
            assert not (taken and told), (pattern, start)
            slipped += taken and not is_first
        if start not in SLIPS:
            assert slipped == 0
        if told:
            assert not topic.clear


@pytest.mark.parametrize("lossless", [False, True])
def test_two_that_speak_from_the_beginning_are_never_taken(lossless: bool) -> None:
    for seed in range(50):
        chance = random.Random(seed)
        topic = Topic(2, lossless=lossless)
        voices = [Voice(chance.randrange(3)), Voice(chance.randrange(3))]
        for _ in range(1000):
            topic.wait(1)
            assert not any(topic.say(voice) for voice in chance.sample(voices, 2))


def test_with_one_in_the_graph_that_lags_only_one_of_two_is_ever_taken() -> None:
    """The graph may come late: of a pair that answers each state, no message that steps
    back is taken.
    """
    topic, first, second = Topic(), Voice(), Voice()
    topic.talk(first, 1000)
    for _ in range(50):
        topic.wait(1)
        topic.say(first)
        assert not topic.say(second)


def test_numbers_that_jump_ahead_beside_a_silent_one_are_waited_for_again() -> None:
    topic, voice = Topic(2), Voice()
    topic.talk(voice, 300)
    assert topic.clear
    voice.lose(SLACK + 1)
    taken = topic.talk(voice, 400)
    assert taken == [False] * WINDOW + [True] * (400 - WINDOW)


def test_a_burst_after_a_stall_is_one_speaker() -> None:
    topic, voice = Topic(2), Voice()
    topic.talk(voice, 300)
    topic.wait(60)
    voice.lose(5)
    assert all(topic.say(voice) for _ in range(55))


def test_silence_beside_a_silent_one_is_waited_for_again() -> None:
    topic, voice = Topic(2), Voice()
    topic.talk(voice, 300)
    topic.wait(WINDOW + 1)
    assert not topic.clear
    assert topic.talk(voice, 400).count(True) == 400 - WINDOW


def test_lossless_numbers_follow_one_by_one_at_any_pace() -> None:
    topic, voice = Topic(2, lossless=True), Voice()
    for _ in range(2):
        topic.wait(500, states=False)
        topic.say(voice)
    assert topic.clear
    topic.wait(60_000, states=False)
    assert topic.say(voice)
    voice.lose()
    topic.wait(1)
    assert not topic.say(voice)


@pytest.mark.parametrize("number", [None, *UNNUMBERED])
def test_without_numbers_the_graph_alone_counts(number: int | None) -> None:
    topic = Topic()
    assert topic.speakers.take(number, 0, 0)
    topic.appear(2)
    topic.wait(1000)
    assert not topic.speakers.take(number, 1000, topic.now)
    assert not topic.clear
