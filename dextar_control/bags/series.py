"""One topic's messages as columns in a temporary file, so that a long recording is read
without holding it in memory.

A kilohertz topic repeats one structure: the same names, the same array lengths. Its
layout is found once, by having the library serialize a message whose numbers are marks,
and whole blocks of messages are then read by numpy at the marks' places. A message of
another structure gets a layout of its own; one whose bytes are not reproduced by the
library is read by it alone; one that cannot be decoded is counted and passed over. Only
the columns that are asked for are kept.
"""

from __future__ import annotations

import dataclasses
import mmap
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import IO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dextar_control.bags.scan import LATEST
from dextar_control.contract.decoding import places_of, read_message, types
from dextar_control.contract.errors import BagError, StateError

BLOCK = 4096  # messages at a time, where they come one by one or are sorted
MOST_LAYOUTS = 64  # of a topic; what fits none of them is read by the library alone
WAITING = 16  # messages of a slow topic that wait for being selected from
TYPES = types()
SECONDS, NANOSECONDS = "header.stamp.sec", "header.stamp.nanosec"
_STAMP_NAMES = _SECONDS, _NANOSECONDS = "(s)", "(ns)"  # which no column has
# the first words of a row; numbers follow
_STAMP, _PUBLISHED, _LOGGED, _ORDER, _TIMES = range(5)

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
Unsigned = NDArray[np.uint64]
Columns = Callable[[object], Mapping[str, str]]
Select = Callable[[Iterable[object]], list[object]]
# (stamps, places in the bag) to stamps of a clock that does not step
Steady = Callable[[Stamps, Stamps], Stamps]


class Table(NamedTuple):
    """A topic's columns by rising stamp, with the first message of each stamp. They lie
    in a file that is mapped into memory.
    """

    stamps: Stamps  # (n,) ns
    published: Stamps  # (n,) ns of the publisher's system clock
    logged: Stamps  # (n,) ns of the recorder's system clock
    values: Floats  # (n, k); nan where a message has no such number


class RecordedColumns(NamedTuple):
    """A topic's columns in the order of the bag; as in ``Table``, with the place (n,)
    of each message among all of the bag.
    """

    stamps: Stamps
    logged: Stamps
    places: Stamps
    values: Floats


class Series:
    """The messages of one topic, in the order of the bag.

    Args:
        topic: its name.
        type_name: ``package/msg/Type``, known to the typestore.
        columns: of a fast topic with headers: by name the paths, such as
            ``position.0``, of the numbers to be kept, from a message; the names stay
            the same where messages differ in structure.
        select: of a slow topic: those of some messages, newest first, that have to be
            kept, in the same order.

    With neither the messages are counted only.

    Attributes:
        first, last: log times of the first message and of the last one, ns.
        fallen: by how much the log times fell back between them, ns.
        unreadable: messages that cannot be decoded; ``why`` says what is wrong with the
            first of them.
        untimed: messages with a log or publish time beyond LATEST or none, ``odd_time``
            the first of these, ns. The other time stands for it, or that of the message
            before.
        places: of a slow topic's messages, among all of the bag.
    """

    def __init__(
        self,
        topic: str,
        type_name: str,
        columns: Columns | None = None,
        select: Select | None = None,
    ) -> None:
        self.topic, self.type = topic, type_name
        self.first = self.last = self.fallen = 0
        self.unreadable, self.why = 0, ""
        self.untimed = self.odd_time = 0
        self.places: list[int] = []
        self._columns, self._select = columns, select
        self._count = self._rows = 0
        self._waiting: list[tuple[int, int, int, bytes]] = []
        self._selected: list[object] = []
        self._layouts: list[_Layout] = []
        self._names: list[str] = []
        self._spool: IO[bytes] | None = None
        self._segments: list[list[int]] = []  # [words of a row, rows] in the spool
        self._rising, self._latest = True, -LATEST

    def __len__(self) -> int:
        return self._count

    def add(
        self, log_time: int, publish_time: int, data: bytes, place: int | None = None
    ) -> None:
        """Take one serialized message; raises as ``extend`` does."""
        place = self._count if place is None else place
        ((log_time, publish_time),) = self._see(
            np.array([[log_time, publish_time]], dtype=np.uint64)
        ).tolist()
        if self._columns is None and self._select is None:
            return
        if self._select is not None:
            self.places.append(place)
        self._waiting.append((log_time, publish_time, place, data))
        if len(self._waiting) >= (WAITING if self._select else BLOCK):
            self._settle()

    def extend(self, data: bytes, messages: Unsigned, places: Stamps) -> None:
        """Take serialized messages.

        Args:
            data: what holds them.
            messages: (m, 4) log time, publish time in ns, begin and end of each in
                ``data``.
            places: (m,) of each among all messages of the bag.

        Raises:
            BagError: the temporary file cannot be written.
        """
        if self._columns is None and self._select is not None:
            for place, (log_time, publish_time, begin, end) in zip(
                places.tolist(), messages.tolist(), strict=True
            ):
                self.add(log_time, publish_time, data[begin:end], place)
            return
        times = self._see(messages[:, :2])
        if self._columns is not None:
            self._settle()
            self._append(
                data, np.column_stack([times, messages[:, 2:].astype(np.int64), places])
            )

    def lose(self, log_time: int, why: str) -> None:
        """Count a message whose content cannot even be taken."""
        self._see(np.array([[log_time, log_time]], dtype=np.uint64))
        self._refuse(why)

    def messages(self) -> list[object]:
        """Return the selected messages of a slow topic in the order of the bag, as the
        library's classes.
        """
        self._settle()
        return self._selected[::-1]

    def recorded(self, names: Sequence[str]) -> RecordedColumns:
        """Return the columns of these names in the order of the bag; before
        ``table``.
        """
        words = self._words(names)
        return RecordedColumns(
            words[_STAMP],
            words[_LOGGED],
            words[_ORDER],
            words[_TIMES:].view(np.float64).T,
        )

    @property
    def rising(self) -> bool:
        """Whether each stamp is later than the one before."""
        self._settle()
        return self._rising

    @property
    def readable(self) -> int:
        """How many messages of a fast topic could be decoded."""
        self._settle()
        return self._rows

    def knows(self, name: str) -> bool:
        """Whether some message has a column of this name."""
        self._settle()
        return name in self._names

    def table(self, names: Sequence[str], steady: Steady | None = None) -> Table:
        """Return the columns of these names, nan where no message has them. It is
        called once, for it gives the temporary file back.

        Args:
            names: of the columns.
            steady: what makes the stamps go on where the clock that they are from
                stepped.

        Raises:
            BagError: the temporary file cannot be written.
        """
        words, rising = self._words(names), self._rising
        if steady is not None:
            words[_STAMP] = steady(words[_STAMP], words[_ORDER])
            rising = bool((np.diff(words[_STAMP]) > 0).all())
        if not rising:
            order = np.unique(words[_STAMP], return_index=True)[1]
            unsorted, words = words, self._mapped(len(words), len(order))
            for row, place in zip(unsorted, words, strict=True):
                np.take(row, order, out=place)
        if self._spool is not None:
            self._spool.close()
        return Table(
            words[_STAMP],
            words[_PUBLISHED],
            words[_LOGGED],
            words[_TIMES:].view(np.float64).T,
        )

    def _words(self, names: Sequence[str]) -> Stamps:
        """Write times and columns of these names in the order of the bag into a mapped
        file, a row for each.
        """
        self._settle()
        words = self._mapped(_TIMES + len(names), self._rows)
        for start, rows in self._blocks():
            place = slice(start, start + len(rows))
            words[:_TIMES, place] = rows[:, :_TIMES].T
            known = dict(zip(self._names, range(_TIMES, rows.shape[1]), strict=False))
            numbers = rows.view(np.float64)
            for row, name in enumerate(names, start=_TIMES):
                words.view(np.float64)[row, place] = (
                    numbers[:, known[name]] if name in known else np.nan
                )
        return words

    def _see(self, raw: Unsigned) -> Stamps:
        """Count messages and return their log and publish times (m, 2), ns; where one
        of the two is no time, another stands for it.
        """
        wrong = (raw > LATEST) | ((raw == 0) & (raw[:, ::-1] > 0))
        times: Stamps = raw.astype(np.int64)
        if wrong.any():
            beyond = raw[raw > LATEST]
            if len(beyond):
                self.odd_time = self.odd_time or int(beyond[0])
                self.untimed += int((raw > LATEST).any(axis=1).sum())
            for row in np.flatnonzero(wrong.any(axis=1)).tolist():
                before = int(times[row - 1, 0]) if row else self.last
                good = times[row, ~wrong[row]]
                times[row, wrong[row]] = good[0] if len(good) else before
        if self._count == 0:
            self.first = self.last = int(times[0, 0])
        logged = np.concatenate([[self.last], times[:, 0]])
        falls = np.diff(logged)
        self.fallen -= int(falls[falls < 0].sum())
        self.last = int(times[-1, 0])
        self._count += len(times)
        return times

    def _refuse(self, why: str) -> None:
        self.unreadable += 1
        self.why = self.why or why

    def _settle(self) -> None:
        """Make columns of the messages that wait, or select from them."""
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return
        if self._select is not None:
            newest = (
                message
                for *_, data in reversed(waiting)
                if (message := self._message(data)) is not None
            )
            self._selected = self._select(chain(newest, self._selected))
            return
        ends = np.cumsum([len(data) for *_, data in waiting])
        begins = np.concatenate([[0], ends[:-1]])
        numbers = np.array([line[:3] for line in waiting], dtype=np.int64)
        joined = b"".join([data for *_, data in waiting])
        self._append(
            joined, np.column_stack([numbers[:, :2], begins, ends, numbers[:, 2]])
        )

    def _message(self, data: bytes) -> object | None:
        try:
            message: object = read_message(data, self.type)
            return message
        except StateError as error:
            self._refuse(str(error))
            return None

    def _append(self, data: bytes, messages: Stamps) -> None:
        begins, sizes = messages[:, 2], messages[:, 3] - messages[:, 2]
        found: list[_Read] = []
        refused: list[int] = []
        left = np.arange(len(messages))
        for known in self._layouts:
            left = known.take(data, begins, sizes, left, found)
        while len(left):
            raw = data[begins[left[0]] : messages[left[0], 3]]
            message = self._message(raw)
            if message is None:
                refused.append(int(left[0]))
                left = left[1:]
                continue
            paths = self._columns(message) if self._columns is not None else {}
            room = len(self._layouts) < MOST_LAYOUTS
            layout = _Layout.of(message, raw, self.type, paths) if room else None
            if layout is not None:
                self._layouts.append(layout)
                left = layout.take(data, begins, sizes, left, found)
                continue
            # its bytes are not the library's, or hardly two messages are alike
            own = dict(_numbers(message))
            stamp = int(own[SECONDS]) * 1_000_000_000 + int(own[NANOSECONDS])
            numbers = {name: own[path] for name, path in paths.items() if path in own}
            found.append(_Read(left[:1], stamp, numbers))
            left = left[1:]
        names = dict.fromkeys(name for read in found for name in read.numbers)
        self._names += [name for name in names if name not in self._names]
        rows = np.full((len(messages), _TIMES + len(self._names)), np.nan)
        times = rows.view(np.int64)
        times[:, [_LOGGED, _PUBLISHED, _ORDER]] = messages[:, [0, 1, 4]]
        places = dict(zip(self._names, range(_TIMES, rows.shape[1]), strict=True))
        for read in found:
            times[read.rows, _STAMP] = read.stamps
            for name, values in read.numbers.items():
                rows[read.rows, places[name]] = values
        if refused:
            rows = np.delete(rows, refused, axis=0)
            if len(rows) == 0:
                return
        stamps = rows.view(np.int64)[:, _STAMP]
        self._rising = (
            self._rising
            and self._latest < stamps[0]
            and bool((stamps[1:] > stamps[:-1]).all())
        )
        self._latest = int(stamps[-1])
        self._write(rows)

    def _write(self, rows: Floats) -> None:
        try:
            if self._spool is None:
                self._spool = tempfile.TemporaryFile(prefix="dextar-")
            self._spool.write(rows.data)
        except OSError as error:
            raise self._no_room(error) from error
        self._rows += len(rows)
        if self._segments and self._segments[-1][0] == rows.shape[1]:
            self._segments[-1][1] += len(rows)
        else:
            self._segments.append([rows.shape[1], len(rows)])

    def _blocks(self) -> Iterator[tuple[int, Stamps]]:
        """Yield (number of the first row, rows (m, words)) of what was written, in
        blocks.
        """
        if self._spool is None:
            return
        self._spool.seek(0)
        start = 0
        for words, count in self._segments:
            for done in range(0, count, BLOCK):
                rows = min(BLOCK, count - done)
                block = self._spool.read(8 * words * rows)
                yield start, np.frombuffer(block, np.int64).reshape(rows, words)
                start += rows

    def _mapped(self, rows: int, columns: int) -> Stamps:
        """Make zeros (rows, columns), int64, that lie in a file without a name and go
        with the last array on them.
        """
        size = 8 * rows * columns
        if size == 0:
            return np.zeros((rows, columns), dtype=np.int64)
        try:
            with tempfile.TemporaryFile(prefix="dextar-") as file:
                # a full disk is found here, and not by a signal later
                os.posix_fallocate(file.fileno(), 0, size)
                words = np.frombuffer(mmap.mmap(file.fileno(), size), np.int64)
                return words.reshape(rows, columns)
        except OSError as error:
            raise self._no_room(error) from error

    def _no_room(self, error: OSError) -> BagError:
        why = error.strerror or error
        return BagError(
            f"cannot keep the columns of {self.topic} in {tempfile.gettempdir()} (set"
            f" TMPDIR to name another): {why}"
        )


class _Read(NamedTuple):
    """What was read of some messages.

    Attributes:
        rows: (k,) of these messages among those that were looked at.
        stamps: (k,) or of all, ns.
        numbers: per column, (k,) or of all.
    """

    rows: Stamps
    stamps: Stamps | int
    numbers: Mapping[str, Floats | float]


class _Layout(NamedTuple):
    """Where the wanted numbers lie in the bytes of messages of one structure.

    Attributes:
        size: bytes of such a message.
        fixed, template: (f,) places of the bytes that all such messages share, and
            these bytes.
        numbers: a message as a record of its wanted numbers.
    """

    size: int
    fixed: NDArray[np.intp]
    template: NDArray[np.uint8]
    numbers: np.dtype[np.void]

    @staticmethod
    def of(
        message: object, data: bytes, type_name: str, paths: Mapping[str, str]
    ) -> _Layout | None:
        """The layout of a message, or None when the library writes other bytes for
        it.
        """
        plain = bytes(TYPES.serialize_cdr(message, type_name))
        if data[: len(plain)] != plain:
            return None
        places = places_of(message, type_name)
        if not places:
            return None
        moving = np.zeros(len(data), dtype=bool)
        moving[len(plain) :] = True
        for offset, kind in places.values():
            moving[offset : offset + np.dtype(kind).itemsize] = True
        wanted = {_SECONDS: SECONDS, _NANOSECONDS: NANOSECONDS, **paths}
        wanted = {name: path for name, path in wanted.items() if path in places}
        numbers = np.dtype(
            {
                "names": list(wanted),
                "offsets": [places[path][0] for path in wanted.values()],
                "formats": [places[path][1] for path in wanted.values()],
                "itemsize": len(data),
            }
        )
        fixed = np.flatnonzero(~moving)
        return _Layout(
            len(data), fixed, np.frombuffer(data, dtype=np.uint8)[fixed], numbers
        )

    def take(
        self,
        data: bytes,
        begins: Stamps,
        sizes: Stamps,
        left: Stamps,
        found: list[_Read],
    ) -> Stamps:
        """Read the messages of this layout among those left, return the others."""
        fitting = left[sizes[left] == self.size]
        if len(fitting) == 0:
            return left
        places = len(data) - self.size + 1
        every_place = np.ndarray((places,), f"V{self.size}", data, strides=(1,))
        messages = every_place[begins[fitting]]
        same = (
            messages.view(np.uint8).reshape(len(fitting), -1)[:, self.fixed]
            == self.template
        ).all(axis=1)
        if not same.any():
            return left
        taken = messages.view(self.numbers)
        left = left[sizes[left] != self.size]
        if not same.all():
            left = np.union1d(fitting[~same], left)
            taken, fitting = taken[same], fitting[same]
        stamps = taken[_SECONDS].astype(np.int64) * 1_000_000_000 + taken[_NANOSECONDS]
        names = [name for name in self.numbers.names or () if name not in _STAMP_NAMES]
        found.append(_Read(fitting, stamps, {name: taken[name] for name in names}))
        return left


def _numbers(message: object, path: str = "") -> Iterator[tuple[str, float]]:
    """Yield (path, number) of every float and time in a message."""
    for name, value in vars(message).items():
        here = f"{path}{name}"
        if isinstance(value, np.ndarray) and value.dtype == np.float64:
            yield from (
                (f"{here}.{index}", number) for index, number in enumerate(value)
            )
        elif isinstance(value, float) or name in ("sec", "nanosec"):
            yield here, value
        elif dataclasses.is_dataclass(value):
            yield from _numbers(value, f"{here}.")
        elif isinstance(value, list) and value and dataclasses.is_dataclass(value[0]):
            for index, inner in enumerate(value):
                yield from _numbers(inner, f"{here}.{index}.")
