"""Time for order and age: it does not step when somebody sets the system clock. No ROS
here.
"""

from __future__ import annotations

import time
from collections.abc import Callable

Clock = Callable[[], int]


class UnsteppedClock:
    """The system clock's time when this was made, going on by the steady clock, ns.

    What the middleware stamps by the system clock, and is read soon after, comes over
    to it by how long it has waited.

    Args:
        system: ns; may step.
        steady: ns; does not.
    """

    def __init__(
        self, system: Clock = time.time_ns, steady: Clock = time.monotonic_ns
    ) -> None:
        self._system, self._steady = system, steady
        self._ahead = system() - steady()

    def now(self) -> int:
        """Now, ns."""
        return self._steady() + self._ahead

    def arrival(self, received: int) -> int:
        """When something arrived that the middleware received at this time of the
        system clock; now where that is 0, unknown.

        A step of the system clock while it waited makes it older, never younger.
        """
        return self.now() - (abs(self._system() - received) if received else 0)
