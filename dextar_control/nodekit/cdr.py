"""Messages of fixed layout as CDR bytes: at 1 kHz only the numbers in them change."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import TypeVar

from builtin_interfaces.msg import Duration, Time
from rclpy.serialization import serialize_message

from dextar_control.contract.decoding import places_of, types
from dextar_control.contract.decoding import read_message as read_message

NANOSECONDS = 1_000_000_000
T = TypeVar("T")


def to_time(stamp: int) -> Time:
    """Return integer nanoseconds as a ROS stamp."""
    return Time(sec=stamp // NANOSECONDS, nanosec=stamp % NANOSECONDS)


def to_duration(nanoseconds: int) -> Duration:
    """Return integer nanoseconds as a ROS duration."""
    return Duration(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS)


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
        clocks = [places[f"{path}.sec"][0] for path in (stamp, duration) if path]
        floats = [places[path][0] for path in values] or [
            offset for offset, kind in places.values() if kind == "<f8"
        ]
        # What varies is packed from seconds and nanoseconds of stamp and duration, then
        # the values; each letter of a code takes one of these numbers, from this on.
        moving = sorted(
            [
                *((offset, "iI", 2 * row) for row, offset in enumerate(clocks)),
                *((offset, "d", 4 + row) for row, offset in enumerate(floats)),
            ]
        )
        edge, form = 0, "<"
        order: list[int] = []  # -1, -2, ... are the parts between, which stay
        self._still: list[tuple[int, int]] = []
        for offset, code, first in (*moving, (len(raw), "", 0)):
            if offset > edge:
                self._still.append((edge, offset))
                order.append(-len(self._still))
                form += f"{offset - edge}s"
            order += range(first, first + len(code))
            form += code
            edge = offset + 8
        self._whole, self._length = struct.Struct(form), len(raw)
        self._arranged = _chosen(order)
        self._fixed = self._parts(raw)
        self._packed = self._fixed[::-1]  # so that -1 is the first of them
        self._fixed_of = _chosen([order.index(-1 - k) for k in range(len(self._still))])
        self._stamp_of = _chosen([order.index(0), order.index(1)])
        self._values_of = _chosen([order.index(4 + k) for k in range(len(floats))])

    def _parts(self, raw: bytes) -> tuple[bytes, ...]:
        """Return the bytes that stay."""
        return tuple(raw[start:stop] for start, stop in self._still)

    def pack(self, stamp: int, values: Sequence[float], duration: int = 0) -> bytes:
        """Return the message's CDR bytes.

        Args:
            stamp: ns.
            values: those that vary, in their order.
            duration: ns.
        """
        numbers = (
            *divmod(stamp, NANOSECONDS),
            *divmod(duration, NANOSECONDS),
            *values,
            *self._packed,
        )
        return self._whole.pack(*self._arranged(numbers))

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
            self._fixed = self._parts(raw)
