"""One direction of a faulty transport, driven by the receiver's clock: which messages
arrive, when, and in which shape.

It knows no ROS: messages are opaque, time is whatever integer nanoseconds its user
counts. From one seed the fate of the n-th message is always the same.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Generic, NamedTuple, TypeVar

from dextar_control.contract.errors import ParameterError

Item = TypeVar("Item")
NANOSECONDS = 1.0e9


class MessageShape(Enum):
    """What is wrong with the messages of a window."""

    OUTAGE = "outage"  # none arrives
    NAN = "nan"  # the first joint's number
    INFINITY = "infinity"  # the second joint's number
    NAMES = "names"  # of joints that the robot does not have
    SIZES = "sizes"  # one number for two names
    STAMP_BACK = "stamp_back"  # by STAMP_SHIFT
    STAMP_FUTURE = "stamp_future"  # by STAMP_SHIFT
    # by STAMP_EARLINESS: hardly after that of the state before
    STAMP_EARLY = "stamp_early"
    STAMP_FROZEN = "stamp_frozen"  # that of the window's first message
    STEP = "step"  # of the first joint's number, by ENCODER_STEP


STAMP_SHIFT = 50_000_000  # ns
STAMP_EARLINESS = 900_000  # ns
ENCODER_STEP = 0.05  # rad
NON_FINITE = (MessageShape.NAN, MessageShape.INFINITY)


@dataclass(frozen=True)
class Transport:
    """Says what a link does to each message, independently of the others.

    Attributes:
        drop: probability that it is lost.
        duplicate: probability that it arrives twice.
        reorder: probability that it is held back by up to ``reorder_time`` while later
            ones overtake it.
        reorder_time: s.
        delay: of each message, s.
        jitter: on top of it, evenly distributed up to this, s; messages keep their
            order.
    """

    drop: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    reorder_time: float = 0.003
    delay: float = 0.0
    jitter: float = 0.0

    def __post_init__(self) -> None:
        for name in ("drop", "duplicate", "reorder"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ParameterError(
                    f"transport {name} = {getattr(self, name)}; it must lie in [0, 1]"
                )
        for name in ("reorder_time", "delay", "jitter"):
            if not 0.0 <= getattr(self, name) <= 10.0:
                raise ParameterError(
                    f"transport {name} = {getattr(self, name)} s; it must lie in"
                    " [0, 10]"
                )


class FaultWindow(NamedTuple):
    """A span of time, ns, half open, in which each message has one shape."""

    begin: int
    end: int
    shape: MessageShape


class Delivery(NamedTuple, Generic[Item]):
    """A message that arrives.

    Attributes:
        item: as it was sent.
        shape: in which it arrives; None is as it was sent.
        began: when the first message of its window was sent, ns.
    """

    item: Item
    shape: MessageShape | None
    began: int


class MessageLink(Generic[Item]):
    """Passes messages in one direction, subject to chance and windows.

    Args:
        transport: what happens to each message.
        seed: of all chance.

    Attributes:
        counts: messages sent, delivered, dropped, duplicated, held_back, lost_in_outage
            and shaped.
    """

    def __init__(self, transport: Transport | None = None, seed: int = 0) -> None:
        self.counts = dict.fromkeys(
            (
                "sent",
                "delivered",
                "dropped",
                "duplicated",
                "held_back",
                "lost_in_outage",
                "shaped",
            ),
            0,
        )
        self._line: list[tuple[int, int, Delivery[Item]]] = []
        self._number = 0
        self._last_due = 0
        self._windows: list[FaultWindow] = []
        self._began: dict[FaultWindow, int] = {}
        self.configure(transport or Transport(), seed)

    def configure(self, transport: Transport, seed: int) -> None:
        """Behave otherwise from the next message on; what is under way arrives as it
        was going to.
        """
        self._transport = transport
        self._random = random.Random(seed)

    def add(self, window: FaultWindow) -> None:
        """Give the messages sent in this window its shape."""
        self._windows.append(window)

    def clear_windows(self) -> None:
        """Forget the windows; what is under way arrives."""
        self._windows.clear()
        self._began.clear()

    def clear(self) -> None:
        """Forget the windows, and what is under way."""
        self.clear_windows()
        self._line.clear()
        self._last_due = 0

    def send(self, time: int, item: Item) -> None:
        """Put in one message at a time, ns."""
        transport, draw, counts = self._transport, self._random.random, self.counts
        lost = draw() < transport.drop
        twice = draw() < transport.duplicate
        held = draw() < transport.reorder
        # always five draws: the fate of the n-th message is its own
        late, back = draw(), draw()
        counts["sent"] += 1
        window = next(
            (window for window in self._windows if window.begin <= time < window.end),
            None,
        )
        if window is not None and window.shape is MessageShape.OUTAGE:
            counts["lost_in_outage"] += 1
            return
        if lost:
            counts["dropped"] += 1
            return
        due = time + round(NANOSECONDS * (transport.delay + transport.jitter * late))
        if held:
            counts["held_back"] += 1
            due += round(NANOSECONDS * transport.reorder_time * back) + 1
        else:
            due = self._last_due = max(due, self._last_due)
        began = self._began.setdefault(window, time) if window else 0
        delivery = Delivery(item, window and window.shape, began)
        counts["shaped"] += window is not None
        counts["duplicated"] += twice
        for _ in range(1 + twice):
            self._number += 1
            heapq.heappush(self._line, (due, self._number, delivery))

    def due(self, time: int) -> Iterator[Delivery[Item]]:
        """Take out what has arrived by a time, ns, in the order of arrival."""
        while self._line and self._line[0][0] <= time:
            self.counts["delivered"] += 1
            yield heapq.heappop(self._line)[2]

    def next_due(self) -> int | None:
        """Return when the next message arrives, ns."""
        return self._line[0][0] if self._line else None
