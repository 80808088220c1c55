"""rosbags turns CDR bytes into messages and tells where numbers lie in them, for live
nodes and bags alike. Needs no ROS.
"""

from __future__ import annotations

import dataclasses
import struct
from functools import cache

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from dextar_control.contract.errors import StateError

SLACK = 128  # bytes that rclpy's serialisation may leave behind a message
HEADER = 4  # bytes of CDR's encapsulation
FIRST_MARK = 0x5A5A0001  # of the integers
MARK = 7.25e211  # of the floats, times 1 + their number


@cache
def types() -> Typestore:
    """Return the message types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def read_message(raw: bytes, type_name: str) -> object:
    """Return the message that CDR bytes hold, in rosbags' classes, which have the
    fields of rclpy's; no other thread waits meanwhile.

    Up to SLACK bytes may follow the message. Bytes of a text that are no UTF-8 become
    question marks, so that the numbers beside it can still be read.

    Raises:
        StateError: the bytes are no message of that type, or rosbags does not know the
            type.
    """
    if len(raw) < HEADER or raw[:2] not in (b"\0\0", b"\0\1"):
        raise StateError(
            f"{len(raw)} bytes are no message of type {type_name}: they do not begin as"
            " CDR does"
        )
    content = bytes(raw[HEADER:])
    try:
        definition = types().get_msgdef(type_name)
        decode = (
            definition.deserialize_cdr_le if raw[1] else definition.deserialize_cdr_be
        )
        while True:
            try:
                message, end = decode(content, 0, definition.cls, types())
                break
            except UnicodeDecodeError as error:
                content = _readable(content, error)
    except (SerdeError, struct.error, ValueError, LookupError) as error:
        raise StateError(
            f"{len(raw)} bytes are no message of type {type_name}: {error}"
        ) from error
    if len(content) - end > SLACK:
        raise StateError(
            f"{len(raw)} bytes are no message of type {type_name}: {len(content) - end}"
            f" bytes are left behind it; the limit is {SLACK}"
        )
    return message


def _readable(content: bytes, error: UnicodeDecodeError) -> bytes:
    """Return the content with a question mark for each byte of a text that is no UTF-8;
    every other byte stays in its place.
    """
    text, changed = error.object, error.object
    while True:
        try:
            changed.decode()
            break
        except UnicodeDecodeError as found:
            changed = (
                changed[: found.start]
                + b"?" * (found.end - found.start)
                + changed[found.end :]
            )
    for order in "<>":  # CDR stores the length before a text, and a zero behind it
        length = struct.pack(f"{order}I", len(text) + 1)
        if length + text + b"\0" in content:
            return content.replace(length + text + b"\0", length + changed + b"\0")
    raise error


def places_of(message: object, type_name: str) -> dict[str, tuple[int, str]]:
    """Return where the floats and times of a message lie in the bytes that rosbags
    writes of it; they are found by marks, not assumed.

    Args:
        message: of rosbags' classes, with texts and lengths that stay.
        type_name: ``package/msg/Type``.

    Returns:
        Per path, such as ``points.0.positions.1``, the first byte and the kind:
        ``<f8``, ``<i4`` or ``<u4``; nothing where the message's own content looks like
        a mark.
    """
    marks: list[tuple[str, bytes, str]] = []
    marked = bytes(types().serialize_cdr(_mark(message, "", marks), type_name))
    if any(marked.count(mark) != 1 for _, mark, _ in marks):
        return {}
    return {path: (marked.index(mark), kind) for path, mark, kind in marks}


def _mark(message: object, path: str, marks: list[tuple[str, bytes, str]]) -> object:
    """Return a copy of the message with a mark for each of its numbers."""

    def number(here: str) -> float:
        value = MARK * (1.0 + len(marks))
        marks.append((here, struct.pack("<d", value), "<f8"))
        return value

    def whole(here: str, kind: str) -> int:
        value = FIRST_MARK + len(marks)
        marks.append((here, struct.pack("<I", value), kind))
        return value

    changed: dict[str, object] = {}
    assert dataclasses.is_dataclass(message) and not isinstance(message, type)
    for field in dataclasses.fields(message):
        name, value = field.name, getattr(message, field.name)
        here = f"{path}{name}"
        if isinstance(value, np.ndarray) and value.dtype == np.float64:
            changed[name] = np.array(
                [number(f"{here}.{index}") for index in range(len(value))],
                dtype=np.float64,
            )
        elif name in ("sec", "nanosec"):
            changed[name] = whole(here, "<i4" if name == "sec" else "<u4")
        elif isinstance(value, float):
            changed[name] = number(here)
        elif dataclasses.is_dataclass(value):
            changed[name] = _mark(value, f"{here}.", marks)
        elif isinstance(value, list) and value and dataclasses.is_dataclass(value[0]):
            changed[name] = [
                _mark(inner, f"{here}.{index}.", marks)
                for index, inner in enumerate(value)
            ]
        else:
            changed[name] = value
    return dataclasses.replace(message, **changed)
