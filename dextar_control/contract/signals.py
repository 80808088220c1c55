"""Signals ask a process to end, and every program of the package takes them alike. No
ROS here.

A node takes them as a flag (``StopSignal``) and ends in order with code 0. A command is
interrupted by the first one (``interruptible``), tidies up, and ends with 128 + the
signal's number. While modules load nothing is held yet: ``loading`` ends the process at
once.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import weakref
from collections.abc import Callable, Iterator
from types import FrameType
from typing import TextIO

from dextar_control.contract.errors import DextarError

EXIT_FAILED = 1  # what was asked for was done and is no success
EXIT_USAGE = 2  # a user's mistake
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Ctrl-C, a supervisor's request, a terminal that closes, Ctrl-backslash."""
RAISE_AGAIN = 0.5  # s after which an interrupt that was swallowed is raised again
START_GRACE = 3.0  # s from a signal during a node's start to its end

Handler = Callable[[int, FrameType | None], object] | int | signal.Handlers | None


class Interrupted(KeyboardInterrupt):
    """A signal asked a command to end.

    Args:
        number: of the signal.
    """

    def __init__(self, number: int = signal.SIGINT) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


def exit_code(interrupt: BaseException) -> int:
    """Return the exit code of a command that a signal ended: 128 + its number, 130
    after Ctrl-C.
    """
    return killed(int(getattr(interrupt, "number", signal.SIGINT)))


def caused_by_interrupt(error: BaseException) -> KeyboardInterrupt | None:
    """Return the interrupt that an error is or came of; None without one. Compilers and
    child processes turn an interrupt into errors of their own.
    """
    seen: BaseException | None = error
    while seen is not None and not isinstance(seen, KeyboardInterrupt):
        seen = seen.__cause__ or seen.__context__
    return seen


def install(handler: Handler, always: tuple[int, ...] = ()) -> dict[int, Handler]:
    """Handle every ending signal; return the handlers from before.

    A signal that the parent had ignored (``nohup``, a script's background job) stays
    ignored. Outside of the main thread, where Python allows no handlers, nothing
    changes.

    Args:
        handler: of Python's kind.
        always: signals that are handled although they were ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    found: dict[int, Handler] = {number: signal.getsignal(number) for number in ENDING}
    before = {
        number: old
        for number, old in found.items()
        if old is not signal.SIG_IGN or number in always
    }
    for number in before:
        signal.signal(number, handler)
    return before


def restore(before: dict[int, Handler]) -> None:
    """Undo ``install``."""
    for number, handler in before.items():
        if handler is not None:  # one that Python did not set
            signal.signal(number, handler)


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Let ending signals raise ``Interrupted``; a further one is passed over while the
    first is still being dealt with.

    It is being dealt with as long as something holds the exception: a name, or an
    ``except`` or ``finally`` block that it runs through. An exception that nothing
    holds any more while the block goes on was swallowed by foreign code, such as a
    compiler's callback, and is raised again.
    """
    last: weakref.ref[Interrupted] | None = None
    left = threading.Event()

    def insist(number: int) -> None:
        while not left.wait(RAISE_AGAIN):
            if last is None or last() is None:
                os.kill(os.getpid(), number)

    def interrupt(number: int, _: object) -> None:
        nonlocal last
        if last is not None and last() is not None:
            return
        _hush_callbacks()
        if last is None:
            threading.Thread(target=insist, args=(number,), daemon=True).start()
        interrupted = Interrupted(number)
        last = weakref.ref(interrupted)
        try:
            raise interrupted
        finally:
            del interrupted  # its own traceback would hold it

    before = install(interrupt)
    try:
        yield
    finally:
        left.set()
        restore(before)


def killed(number: int) -> int:
    """Return the exit code of a process that this signal ended."""
    return 128 + number


@contextlib.contextmanager
def loading(code: Callable[[int], int] = killed) -> Iterator[None]:
    """Let ending signals end the process at once, without a word, while modules are
    being loaded.

    Args:
        code: gives the exit code that belongs to a signal's number.
    """
    before = install(lambda number, _: os._exit(code(number)))
    try:
        yield
    finally:
        restore(before)


def run_command(name: str, work: Callable[[], int]) -> int:
    """Run a command; return its own exit code, 2 for a user's mistake, or 128 + the
    number of a signal that ended it.

    Args:
        name: as it was called, for the one line that says why it ended.
        work: the command.
    """
    with interruptible():
        try:
            code = work()
            sys.stdout.flush()
            return code
        except BaseException as error:
            if (interrupt := caused_by_interrupt(error)) is not None:
                tell(f"{name}: interrupted", sys.stderr)
                return exit_code(interrupt)
            if isinstance(error, BrokenPipeError):  # who reads has enough
                with contextlib.suppress(OSError):
                    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                return EXIT_USAGE
            # A user's mistake, or a disk that fills up under the output.
            if isinstance(error, (DextarError, OSError)):
                from dextar_control.contract.terminal import plain

                tell(plain(f"{name}: {error}"), sys.stderr)
                return EXIT_USAGE
            raise


class StopSignal:
    """The ending signals as an event: a node finishes what it holds before it ends,
    however many of them come.

    A node that is still being made holds nothing yet, and the first signal interrupts
    it. A compiler's callback may swallow or print that interrupt: it is not printed,
    and where the node goes on nevertheless the process ends after ``START_GRACE``.
    SIGINT and SIGTERM are how launchers end their nodes: these are handled even where
    the parent ignores them.

    Attributes:
        starting: the node is still being made.
        number: of the first signal; 0 before.
    """

    def __init__(self) -> None:
        self._event = threading.Event()
        self.starting = True
        self.number = 0
        self._before = install(self._on_signal, (signal.SIGINT, signal.SIGTERM))

    def _on_signal(self, number: int, _: object) -> None:
        if self._event.is_set():
            return
        self.number = number
        self._event.set()
        if self.starting:
            _hush_callbacks()
            timer = threading.Timer(START_GRACE, self._give_up)
            timer.daemon = True
            timer.start()
            raise Interrupted(number)

    def _give_up(self) -> None:
        if self.starting:
            os._exit(0)

    def check(self) -> None:
        """Raise ``Interrupted`` once a signal came."""
        if self:
            raise Interrupted(self.number)

    def restore(self) -> None:
        """Leave the signals as they were found."""
        restore(self._before)

    def __bool__(self) -> bool:
        return self._event.is_set()


def _hush_callbacks() -> None:
    """Print no traceback of an interrupt that is raised in a callback of compiled code,
    which it cannot leave.
    """
    sys.unraisablehook = lambda _: None


def tell(text: str, stream: TextIO) -> None:
    """Write a line where somebody may no longer read: a closed pipe or terminal does
    not end what still has to be done.
    """
    try:
        print(text, file=stream, flush=True)
    except OSError:
        # What is still buffered would fail again at the process's end.
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
