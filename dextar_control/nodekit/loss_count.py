"""The sequence numbers that publishers count tell how many samples of a topic were
lost.
"""

from __future__ import annotations

from collections.abc import Callable

UNSUPPORTED = 2**64 - 1


class LossCount:
    """Gaps in the publication sequence numbers of one topic.

    rclpy's MessageInfo carries the number but not the publisher, and each publisher
    counts from 1. So one expected number is kept per publisher: a sample belongs to the
    publisher that expects exactly it; else, with fewer publishers known than matched,
    to a new one; else it is a gap of the publisher that misses fewest. With one
    publisher, as the streams have, this is exact; a publisher's samples from before the
    first one heard are not counted as lost.

    Args:
        count_publishers: how many publishers the topic has now; asked only when no
            number fits.

    Attributes:
        received: samples seen.
        lost: samples missing between them.
        supported: the middleware numbers its samples (rmw_fastrtps_cpp does).
    """

    def __init__(self, count_publishers: Callable[[], int] = lambda: 1) -> None:
        self.received = 0
        self.lost = 0
        self.supported = True
        self._count_publishers = count_publishers
        # The next number of each publisher, of the one heard last first.
        self._expected: list[int] = []

    def restart(self) -> None:
        """Count anew from the next sample on."""
        self.received = self.lost = 0

    def see(self, number: int | None) -> None:
        """Count one sample, and those that are missing before it."""
        self.received += 1
        if not number or number == UNSUPPORTED:
            self.supported = False
            return
        expected = self._expected
        if number in expected:
            expected.remove(number)
        else:
            publishers = self._count_publishers()
            behind = [other for other in expected if other < number]
            if behind and (len(expected) >= publishers or publishers <= 1):
                mine = behind[0] if publishers <= 1 else max(behind)
                expected.remove(mine)
                self.lost += number - mine
        expected.insert(0, number + 1)
