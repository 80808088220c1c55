"""CDR bytes to messages, by rosbags, for live nodes and analysis alike: one tolerance for all. Needs no ROS."""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from dextar_control.contract.errors import StateError

SLACK = 128  # bytes that rclpy's serialisation may leave behind a message
HEADER = 4  # bytes of CDR's encapsulation


@cache
def types() -> Typestore:
    """The message types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def read_message(raw: bytes, type_name: str) -> Any:
    """A message from CDR bytes in rosbags' classes: the fields of rclpy's, read without holding other threads up.

    Up to SLACK bytes behind it do not matter. In a text that is not UTF-8 the bytes that are none become question marks, so that
    it costs no number beside it.

    Raises:
        StateError: the bytes are no message of that type, or rosbags does not know the type.
    """
    if len(raw) < HEADER or raw[:2] not in (b"\0\0", b"\0\1"):
        raise StateError(f"{len(raw)} bytes are no message of type {type_name}: they do not begin as CDR does")
    content = bytes(raw[HEADER:])
    try:
        definition = types().get_msgdef(type_name)
        decode = definition.deserialize_cdr_le if raw[1] else definition.deserialize_cdr_be
        while True:
            try:
                message, end = decode(content, 0, definition.cls, types())
                break
            except UnicodeDecodeError as error:
                content = _readable(content, error)
    except (SerdeError, struct.error, ValueError, LookupError) as error:
        raise StateError(f"{len(raw)} bytes are no message of type {type_name}: {error}") from error
    if len(content) - end > SLACK:
        raise StateError(
            f"{len(raw)} bytes are no message of type {type_name}: {len(content) - end} bytes are left behind it; the limit is"
            f" {SLACK}"
        )
    return message


def _readable(content: bytes, error: UnicodeDecodeError) -> bytes:
    """The content with a question mark for each byte of a text that is no UTF-8: every other byte stays in its place."""
    text, changed = error.object, error.object
    while True:
        try:
            changed.decode()
            break
        except UnicodeDecodeError as found:
            changed = changed[: found.start] + b"?" * (found.end - found.start) + changed[found.end :]
    for order in "<>":  # CDR stores the length before a text, and a zero behind it
        length = struct.pack(f"{order}I", len(text) + 1)
        if length + text + b"\0" in content:
            return content.replace(length + text + b"\0", length + changed + b"\0")
    raise error
