"""A time for order and age must not step when somebody sets the system clock. No ROS
here.
"""

from __future__ import annotations

import time
from collections.abc import Callable

Clock = Callable[[], int]


class UnsteppedClock:
    """A clock that shows the system clock's time when it was made, and goes on by the
    steady clock, ns.

    A stamp of the middleware by the system clock is brought over to it by how long the
    message has waited.

    Args:
        system: a clock that may step, ns.
        steady: a clock that does not, ns.
    """

    def __init__(
        self, system: Clock = time.time_ns, steady: Clock = time.monotonic_ns
    ) -> None:
        self._system, self._steady = system, steady
        self._ahead = system() - steady()

    def now(self) -> int:
        """Return the time, ns."""
        return self._steady() + self._ahead

    def arrival(self, received: int) -> int:
        """Return when a message arrived, ns, that the middleware received at this time
        of the system clock; now where that is 0, which means unknown.

        A step of the system clock while the message waited makes it older, never
        younger.
        """
        return self.now() - (abs(self._system() - received) if received else 0)
