"""Decide whose commands are taken where several publishers offer some, by the
middleware's message numbers. No ROS here.
"""

from __future__ import annotations

from collections.abc import Callable

# ns for which one publisher alone must have spoken until the others count as silent.
SPEAKING = 200_000_000
# Numbers by which a message may be ahead of the states published since the one before
# it.
SLACK = 8
UNNUMBERED = (0, 2**64 - 1)  # what a middleware gives that does not count messages


class CommanderArbiter:
    """Decides whether the commands that come are those of one publisher.

    The middleware's graph keeps a publisher that was killed for its lease (Fast DDS: up
    to 20 s), and messages carry no name of their publisher, but each publisher numbers
    its own from 1. While the graph shows one publisher its messages are taken. With
    more none is, until the numbers of what is heard have risen as one publisher's do
    for ``SPEAKING``: each after the one before it and not farther ahead than a number
    for each state published since, and ``SLACK`` (where nothing is lost: the very next
    one). Gaps are no second speaker.

    A number that steps back within ``SPEAKING`` of the last message is another
    publisher's: it is not taken, and with more than one in the graph nothing is any
    more until the graph shows one. A number that steps back after a longer silence is
    that of a commander started again, and begins a new count.

    What can slip through: the message of a second speaker whose number lies among the
    few that the first one might give next, that is, who has spoken as often as the
    first one although nothing was heard of it for ``SPEAKING``. It can be taken until
    the first one is heard again, in general one period later, whose number then steps
    back or repeats. The first message of a commander that has just been started is
    numbered 1 and cannot.

    Args:
        publishers: counts the topic's publishers in the graph.
        lossless: messages are neither lost nor counted twice, and may come at any pace.

    Attributes:
        count: publishers at the last look.
        several: two were heard, and the graph has not shown one alone since.
    """

    def __init__(
        self, publishers: Callable[[], int], *, lossless: bool = False
    ) -> None:
        self._publishers = publishers
        self._lossless = lossless
        self.count = 0
        self.several = False
        self._number: int | None = None
        self._states = 0
        self._heard = 0
        self._since = 0

    def count_publishers(self, now: int) -> None:
        """Count the publishers at a steady time, ns; one more than before has to stay
        silent for ``SPEAKING`` first.
        """
        before, self.count = self.count, self._publishers()
        if self.count <= 1:
            self.several = False
        elif self.count > before:
            self._since = now

    def accepts(self, now: int) -> bool:
        """Tell whether commands are taken at a steady time, ns: there is one publisher,
        or the others are silent.
        """
        if self.count <= 1:
            return True
        alone = (
            self._number is not None
            and not self.several
            and now - self._since >= SPEAKING
        )
        return alone and (self._lossless or now - self._heard <= SPEAKING)

    def take(self, number: int | None, states: int, now: int) -> bool:
        """Tell whether a message may be taken, and count it.

        Args:
            number: that its publisher gave it; None or one of ``UNNUMBERED`` where
                there is none: the graph alone counts.
            states: published so far.
            now: steady time, ns.
        """
        if number is None or number in UNNUMBERED:
            return self.count <= 1
        last, most = self._number, states - self._states + SLACK
        silent = now - self._heard > SPEAKING
        self._number, self._states, self._heard = number, states, now
        if last is None:
            self._since = now
            self.count_publishers(now)
            return self.count <= 1
        rise = number - last
        if rise == 1 or (not self._lossless and 0 < rise <= most):
            if silent and not self._lossless:
                self._since = now
            return self.accepts(now)
        self._since = now
        self.count_publishers(now)
        if self.count <= 1:
            return rise > 0 or silent
        self.several |= rise <= 0 and not silent
        return False
