"""Decide what a bad link does to the frames of one direction: which are lost, and when
the others leave.
"""

from __future__ import annotations

import heapq
import math
import random
from dataclasses import asdict, dataclass, fields

from dextar_control.contract.errors import DextarError


class LinkError(DextarError):
    """A faulty link was asked for that cannot be, or this machine cannot make one."""


@dataclass(frozen=True)
class LinkQuality:
    """One direction of a link.

    Attributes:
        loss: probability that a frame is lost.
        delay: of every frame, s.
        jitter: largest further delay, uniformly distributed, s; it keeps the order.
        reorder: probability that a frame is held back, so that later ones overtake it.
        hold: by which such a frame is later than it would be, s.
        duplicate: probability that a frame arrives twice.

    Raises:
        LinkError: a probability outside [0, 1], a time outside [0, 10] s.
    """

    loss: float = 0.0
    delay: float = 0.0
    jitter: float = 0.0
    reorder: float = 0.0
    hold: float = 0.003
    duplicate: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            limit = LONGEST if field.name in TIMES else 1.0
            if not (math.isfinite(value) and 0.0 <= value <= limit):
                raise LinkError(
                    f"link quality '{field.name}' = {value}; it must lie in [0,"
                    f" {limit:g}]"
                )


DIRECTIONS = "a_to_b", "b_to_a"
TIMES = ("delay", "jitter", "hold")
LONGEST = 10.0  # s


@dataclass
class LinkStatistics:
    """Counts what became of the frames of one direction.

    Attributes:
        received: frames that entered the link.
        dropped: of these, lost on purpose.
        duplicated: of these, sent twice.
        forwarded: frames that left the link, second copies included.
        reordered: of these, overtaken by a later one.
        refused: that the interface at the far end did not take.
        overrun: that this machine lost before the relay saw them; 0 unless it was too
            slow.
        waiting: still under way, second copies included.
    """

    received: int = 0
    dropped: int = 0
    duplicated: int = 0
    forwarded: int = 0
    reordered: int = 0
    refused: int = 0
    overrun: int = 0
    waiting: int = 0

    def to_dict(self) -> dict[str, int]:
        """Return the counts by name."""
        return asdict(self)


class FrameSchedule:
    """Queues the frames of one direction; the n-th frame's fate depends on the seed and
    n alone, not on the clock.

    Args:
        quality: of the link; may be replaced at any time.
        seed: of the pseudo-random numbers.
    """

    def __init__(self, quality: LinkQuality, seed: int | str = 0) -> None:
        self.quality = quality
        self.statistics = LinkStatistics()
        self._random = random.Random(seed)
        self._queue: list[
            tuple[float, int, int, bytes]
        ] = []  # departure (s), order of entry, number of the frame, frame
        self._entries = 0
        self._last = -math.inf
        self._newest = -1

    def enter(self, now: float, frame: bytes) -> None:
        """Take in a frame at the time now, s."""
        quality, number = self.quality, self.statistics.received
        lost, late, held, twice = (self._random.random() for _ in range(4))
        self.statistics.received += 1
        if lost < quality.loss:
            self.statistics.dropped += 1
            return
        departure = now + quality.delay + late * quality.jitter
        if held < quality.reorder:
            departure += quality.hold
        else:
            departure = self._last = max(departure, self._last)
        copies = 1
        if twice < quality.duplicate:
            self.statistics.duplicated += 1
            copies = 2
        for _ in range(copies):
            heapq.heappush(self._queue, (departure, self._entries, number, frame))
            self._entries += 1
            self.statistics.waiting += 1

    def next_departure(self) -> float:
        """Return when the next frame leaves, s; infinite while none waits."""
        return self._queue[0][0] if self._queue else math.inf

    def leave(self, now: float) -> list[bytes]:
        """Take out the frames whose time has come at the time now, s, in the order in
        which they leave.
        """
        frames = []
        while self._queue and self._queue[0][0] <= now:
            _, _, number, frame = heapq.heappop(self._queue)
            frames.append(frame)
            self.statistics.forwarded += 1
            self.statistics.waiting -= 1
            self.statistics.reordered += number < self._newest
            self._newest = max(self._newest, number)
        return frames
