"""One topic's messages as columns, so that a long recording is read without holding its messages.

A kilohertz topic repeats one structure: the same names, the same array lengths. Its layout is found once, by having the
library serialize a message whose numbers are marks, and whole blocks of messages are then read by numpy at the marks'
places. A message of another structure gets a layout of its own; one whose bytes are not reproduced by the library is read
by it alone.
"""

from __future__ import annotations

import dataclasses
import struct
from array import array
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from dextar_control.analysis.run import Floats, Stamps
from dextar_control.contract.errors import BagError

LATEST = 2**63 - 1  # ns since the epoch
BLOCK = 4096  # messages made into columns at a time
FIRST_MARK = 0x5A5A0001  # of the integers
MARK = 7.25e211  # of the floats, times 1 + their number
TYPES = get_typestore(Stores.ROS2_JAZZY)
COLUMNAR = {"sensor_msgs/msg/JointState", "trajectory_msgs/msg/JointTrajectory", "nav_msgs/msg/Odometry",
            "geometry_msgs/msg/PoseStamped"}  # fmt: skip
SECONDS, NANOSECONDS = "header.stamp.sec", "header.stamp.nanosec"


class Table(NamedTuple):
    """A topic's columns by rising stamp, the first message of each stamp."""

    stamps: Stamps  # (n,) ns
    published: Stamps  # (n,) ns of the publisher's system clock
    logged: Stamps  # (n,) ns of the recorder's system clock
    values: Floats  # (n, k); nan where a message has no such number


class Series:
    """One topic's messages in the order of the bag.

    Args:
        topic: its name.
        type_name: ``package/msg/Type``, known to the typestore.
    """

    def __init__(self, topic: str, type_name: str) -> None:
        self.topic, self.type = topic, type_name
        self._logged, self._published = array("q"), array("q")
        self._raw: list[bytes] = []
        self._blocks: list[_Block] = []
        self._layouts: list[_Layout] = []

    def __len__(self) -> int:
        return len(self._logged)

    def add(self, log_time: int, publish_time: int, data: bytes) -> None:
        """Take one serialized message.

        Raises:
            BagError: a block holds bytes that are no message of the type, or a time is none.
        """
        if max(log_time, publish_time) > LATEST:
            raise BagError(f"a message on {self.topic} has the time {max(log_time, publish_time)} ns: the file is damaged")
        self._logged.append(log_time)
        self._published.append(publish_time)
        self._raw.append(data)
        if len(self._raw) >= BLOCK and self.type in COLUMNAR:
            self._compact()

    @property
    def logged(self) -> Stamps:
        """(n,) ns of the recorder's clock, in the order of the bag."""
        return np.array(self._logged, dtype=np.int64)

    def messages(self) -> Iterator[Any]:
        """Every message of a slow topic, as the library's classes."""
        if self._blocks:
            raise TypeError(f"{self.topic}: its messages have been made into columns")
        return (self._message(data) for data in self._raw)

    def stamps(self) -> Stamps:
        """(n,) ns of the messages' headers, in the order of the bag.

        Raises:
            BagError: some bytes are no message of the type.
        """
        self._compact()
        stamps = np.zeros(len(self), dtype=np.int64)
        for block in self._blocks:
            seconds, rest = block.column(SECONDS), block.column(NANOSECONDS)
            stamps[block.rows] = np.asarray(seconds, dtype=np.int64) * 1_000_000_000 + np.asarray(rest, dtype=np.int64)
        return stamps

    def table(self, width: int, paths: Callable[[Any], Sequence[str]]) -> Table:
        """Numbers by their paths, such as ``position.0``.

        Args:
            width: of the table.
            paths: the columns' paths in messages of one structure, from one of them; "" for none.

        Raises:
            BagError: some bytes are no message of the type.
        """
        stamps = self.stamps()
        values = np.full((len(self), width), np.nan)
        for block in self._blocks:
            for column, path in enumerate(paths(block.sample)):
                values[block.rows, column] = block.column(path)
        unique, rows = np.unique(stamps, return_index=True)
        published = np.array(self._published, dtype=np.int64)
        return Table(unique, published[rows], self.logged[rows], values[rows])

    def _message(self, data: bytes) -> Any:
        try:
            return TYPES.deserialize_cdr(data, self.type)
        except (SerdeError, ValueError, IndexError, struct.error) as error:
            raise BagError(f"a message on {self.topic} is not a {self.type}: {error}") from error

    def _compact(self) -> None:
        first = len(self) - len(self._raw)
        left = np.arange(len(self._raw))
        for layout in self._layouts:
            left = self._take(layout, left, first)
        odd: list[int] = []
        while len(left):
            data = self._raw[left[0]]
            found = _Layout.of(self._message(data), data, self.type)
            if found is None:
                odd.append(int(left[0]))
                left = left[1:]
                continue
            self._layouts.append(found)
            left = self._take(found, left, first)
        for row in odd:
            message = self._message(self._raw[row])
            numbers = {path: np.array([number]) for path, number in _numbers(message)}
            self._blocks.append(_Block(message, np.array([first + row]), dict(numbers)))
        self._raw = []

    def _take(self, layout: _Layout, left: Stamps, first: int) -> Stamps:
        """Read the messages of a layout among those left; the others."""
        fitting = np.array([row for row in left if len(self._raw[row]) == len(layout.template)], dtype=np.int64)
        if len(fitting) == 0:
            return left
        joined = b"".join([self._raw[row] for row in fitting])
        table = np.frombuffer(joined, dtype=np.uint8).reshape(len(fitting), -1)
        same = (table[:, layout.fixed] == layout.template[layout.fixed]).all(axis=1)
        if not same.any():
            return left
        self._blocks.append(_Block(layout.sample, first + fitting[same], layout.columns(table[same])))
        return np.setdiff1d(left, fitting[same], assume_unique=True)


@dataclasses.dataclass(frozen=True)
class _Block:
    """Messages of one structure: a sample, their places in the series, their numbers; one number where all are the same."""

    sample: Any
    rows: Stamps
    numbers: dict[str, Any]

    def column(self, path: str) -> Any:
        return self.numbers.get(path, np.nan)


class _Layout(NamedTuple):
    """Where the numbers lie in the bytes of messages of one structure."""

    sample: Any
    template: Any  # (length,) bytes of the sample
    fixed: Any  # (length,) bytes that all such messages share
    places: dict[str, tuple[int, str]]  # per path: offset and numpy type

    @staticmethod
    def of(message: Any, data: bytes, type_name: str) -> _Layout | None:
        """The layout of a message, or None when the library writes other bytes for it."""
        plain = bytes(TYPES.serialize_cdr(message, type_name))
        if data[: len(plain)] != plain:
            return None
        marks: list[tuple[str, bytes, str]] = []
        marked = bytes(TYPES.serialize_cdr(_mark(message, "", marks), type_name))
        fixed = np.ones(len(data), dtype=bool)
        fixed[len(plain) :] = False
        places: dict[str, tuple[int, str]] = {}
        for path, mark, kind in marks:
            if marked.count(mark) != 1:
                return None
            offset = marked.index(mark)
            places[path] = offset, kind
            fixed[offset : offset + len(mark)] = False
        return _Layout(message, np.frombuffer(data, dtype=np.uint8), fixed, places)

    def columns(self, table: Any) -> dict[str, Any]:
        """The numbers of messages, rows of (n, length) bytes."""
        found: dict[str, Any] = {}
        for path, (offset, kind) in self.places.items():
            column = np.ascontiguousarray(table[:, offset : offset + int(kind[-1])]).view(kind)[:, 0]
            found[path] = column[0] if (column == column[0]).all() else column
        return found


def _numbers(message: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """(path, number) of every float and time in a message."""
    for field in dataclasses.fields(message):
        value, here = getattr(message, field.name), f"{path}{field.name}"
        if isinstance(value, np.ndarray) and value.dtype == np.float64:
            yield from ((f"{here}.{index}", number) for index, number in enumerate(value))
        elif isinstance(value, float) or field.name in ("sec", "nanosec"):
            yield here, value
        elif dataclasses.is_dataclass(value):
            yield from _numbers(value, f"{here}.")
        elif isinstance(value, list) and value and dataclasses.is_dataclass(value[0]):
            for index, inner in enumerate(value):
                yield from _numbers(inner, f"{here}.{index}.")


def _mark(message: Any, path: str, marks: list[tuple[str, bytes, str]]) -> Any:
    """A copy of the message with a mark for each of its numbers."""

    def number(here: str) -> float:
        value = MARK * (1.0 + len(marks))
        marks.append((here, struct.pack("<d", value), "<f8"))
        return value

    def whole(here: str, kind: str) -> int:
        value = FIRST_MARK + len(marks)
        marks.append((here, struct.pack("<I", value), kind))
        return value

    changed: dict[str, Any] = {}
    for field in dataclasses.fields(message):
        name, value = field.name, getattr(message, field.name)
        here = f"{path}{name}"
        if isinstance(value, np.ndarray) and value.dtype == np.float64:
            changed[name] = np.array([number(f"{here}.{index}") for index in range(len(value))], dtype=np.float64)
        elif name in ("sec", "nanosec"):
            changed[name] = whole(here, "<i4" if name == "sec" else "<u4")
        elif isinstance(value, float):
            changed[name] = number(here)
        elif dataclasses.is_dataclass(value):
            changed[name] = _mark(value, f"{here}.", marks)
        elif isinstance(value, list) and value and dataclasses.is_dataclass(value[0]):
            changed[name] = [_mark(inner, f"{here}.{index}.", marks) for index, inner in enumerate(value)]
        else:
            changed[name] = value
    return type(message)(**{name: value for name, value in changed.items() if name != "__msgtype__"})
