"""A node hands long work to one thread, which tells its progress, and takes the results
in its own thread.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from dextar_control.contract.errors import DextarError

T = TypeVar("T")
Done = Callable[[T | None, DextarError | None], object]


class GivenUp(DextarError):
    """A plan is given up because the node ends or a stop was asked for."""


class JobQueue:
    """Runs jobs one after the other in a thread; ``poll`` hands their results over in
    the caller's thread.

    Attributes:
        fraction, stage: of the job under way, as its ``progress`` told them; stage is
            empty when there is none.
    """

    def __init__(self) -> None:
        self.fraction = 0.0
        self.stage = ""
        self._closing = False
        self._threads = ThreadPoolExecutor(max_workers=1)
        self._jobs: deque[tuple[Callable[[], bool], Callable[[], None]]] = deque()

    def submit(self, work: Callable[[], T], done: Done[T]) -> None:
        """Do ``work``; afterwards ``poll`` calls ``done(result, None)`` or ``done(None,
        error)``.
        """
        future = self._threads.submit(work)
        self._jobs.append((future.done, lambda: _hand_over(future, done)))

    def progress(self, fraction: float, stage: str) -> None:
        """Tell how far the job under way is, which calls this.

        Raises:
            GivenUp: the queue is closed.
        """
        if self._closing:
            raise GivenUp("planning was given up: the node ends")
        self.fraction, self.stage = fraction, stage

    def poll(self) -> None:
        """Hand over the results that are there, in the order in which they were asked
        for.
        """
        while self._jobs and self._jobs[0][0]():
            _, hand_over = self._jobs.popleft()
            self.fraction, self.stage = 0.0, ""
            hand_over()

    def close(self) -> None:
        """Give up the job under way at its next progress, and all that wait."""
        self._closing = True
        self._threads.shutdown(wait=False, cancel_futures=True)


def _hand_over(future: Future[T], done: Done[T]) -> None:
    try:
        result = future.result()
    except DextarError as error:
        done(None, error)
    else:
        done(result, None)
