"""Messages of fixed layout as CDR bytes: at 1 kHz only the numbers in them change."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import TypeVar

from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message

from dextar_control.contract.decoding import places_of, types
from dextar_control.contract.decoding import read_message as read_message

NANOSECONDS = 1_000_000_000
T = TypeVar("T")


def to_time(stamp: int) -> Time:
    """Return integer nanoseconds as a ROS stamp."""
    return Time(sec=stamp // NANOSECONDS, nanosec=stamp % NANOSECONDS)


def from_time(time: Time) -> int:
    """Return a ROS stamp as integer nanoseconds."""
    return int(time.sec * NANOSECONDS + time.nanosec)


def canonical(message: object) -> bytes:
    """Return a message as CDR bytes of exact length, with zeros where CDR leaves bytes
    undefined.

    rclpy's own serialisation leaves memory from before in the alignment bytes and up to
    some tens of them behind the message: strict readers refuse that, and two runs would
    not give the same bytes.

    Raises:
        StateError: rosbags does not know the message's type.
    """
    return bytes(types().serialize_cdr(*_of_library(message)))


def places_in(message: object) -> dict[str, tuple[int, str]]:
    """Return where floats and times lie in ``canonical``; see ``places_of``."""
    return places_of(*_of_library(message))


def _of_library(message: object) -> tuple[object, str]:
    """Return a message in rosbags' classes, and its type's name."""
    package = type(message).__module__.partition(".")[0]
    name = f"{package}/msg/{type(message).__name__}"
    return read_message(bytes(serialize_message(message)), name), name


def _chosen(places: Sequence[int]) -> Callable[[Sequence[T]], tuple[T, ...]]:
    """Return a function that takes a tuple's elements at these places, as a tuple."""
    if len(places) > 1:
        return itemgetter(*places)
    return lambda found: tuple(found[place] for place in places)


class CdrTemplate:
    """A message of fixed layout, whose stamp and float64 values are packed and
    unpacked.

    Args:
        message: what stays of it, words and numbers; as long as it always is.
        values: paths of the floats that vary, such as ``position.0``; by default all,
            in its order.
        stamp: path of the time that varies.
        duration: path of the duration that varies too; "" none.
    """

    def __init__(
        self,
        message: object,
        values: Sequence[str] = (),
        *,
        stamp: str = "header.stamp",
        duration: str = "",
    ) -> None:
        raw, places = canonical(message), places_in(message)
        self._has_duration = bool(duration)
        self._duration_offset = places[f"{duration}.sec"][0] if duration else 0
        self._stamp_offset = places[f"{stamp}.sec"][0]
        offsets = [places[path][0] for path in values] or [
            offset for offset, kind in places.values() if kind == "<f8"
        ]
        runs: list[list[int]] = []  # [offset, first value, number of values]
        for index, offset in enumerate(offsets):
            if runs and offset == runs[-1][0] + 8 * runs[-1][2]:
                runs[-1][2] += 1
            else:
                runs.append([offset, index, 1])
        self._runs = [
            (offset, first, first + size, struct.Struct(f"<{size}d"))
            for offset, first, size in runs
        ]
        clocks = [
            (self._stamp_offset, 8),
            *([(self._duration_offset, 8)] if duration else []),
        ]
        moving = sorted([*clocks, *((offset, 8 * size) for offset, _, size in runs)])
        edges = [
            0,
            *(edge for offset, size in moving for edge in (offset, offset + size)),
            len(raw),
        ]
        self._still = [
            slice(start, stop)
            for start, stop in zip(edges[::2], edges[1::2], strict=True)
            if stop > start
        ]
        self._fixed = tuple(raw[part] for part in self._still)
        slots = sorted(
            [
                *(
                    (part.start, f"{part.stop - part.start}s", -1)
                    for part in self._still
                ),
                *((at, "iI", -2) for at, _ in clocks),
                *((at, f"{size}d", first) for at, first, size in runs),
            ]
        )
        self._whole = struct.Struct("<" + "".join(code for _, code, _ in slots))
        fixed: list[int] = []
        clock: list[int] = []
        numbers: dict[int, int] = {}
        index = 0
        for offset, code, first in slots:
            size = 1 if first == -1 else 2 if first == -2 else int(code[:-1])
            if first == -1:
                fixed.append(index)
            elif offset == self._stamp_offset:
                clock = [index, index + 1]
            elif first >= 0:
                numbers |= {first + k: index + k for k in range(size)}
            index += size
        self._fixed_of, self._stamp_of = _chosen(fixed), _chosen(clock)
        self._values_of = _chosen([numbers[k] for k in range(len(offsets))])
        self._buffer = bytearray(raw)
        self._length = len(raw)

    def pack(self, stamp: int, values: Sequence[float], duration: int = 0) -> bytes:
        """Return the message's CDR bytes.

        Args:
            stamp: ns.
            values: those that vary, in their order.
            duration: ns.
        """
        buffer = self._buffer
        if self._has_duration:
            struct.pack_into(
                "<iI",
                buffer,
                self._duration_offset,
                duration // NANOSECONDS,
                duration % NANOSECONDS,
            )
        struct.pack_into(
            "<iI", buffer, self._stamp_offset, stamp // NANOSECONDS, stamp % NANOSECONDS
        )
        for offset, first, last, layout in self._runs:
            layout.pack_into(buffer, offset, *values[first:last])
        return bytes(buffer)

    def unpack(self, raw: bytes) -> tuple[int, list[float]] | None:
        """Return (stamp in ns, values), or None when anything but stamp and values
        differs from the template.

        Bytes that CDR leaves undefined (alignment) count as a difference: a reader then
        takes its slow path, checks the message and may call ``learn``.
        """
        if len(raw) != self._length:
            return None
        found = self._whole.unpack(raw)
        if self._fixed_of(found) != self._fixed:
            return None
        seconds, nanoseconds = self._stamp_of(found)
        return seconds * NANOSECONDS + nanoseconds, list(self._values_of(found))

    def learn(self, raw: bytes) -> None:
        """Take over the undefined bytes of a publisher whose message was checked to
        have this layout.
        """
        if len(raw) == self._length:
            self._fixed = tuple(raw[part] for part in self._still)
