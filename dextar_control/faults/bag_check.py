"""Whether a bag can be read up to its last complete chunk, told by two readers that know nothing of each other."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

from mcap.reader import NonSeekingReader

MAGIC = b"\x89MCAP0\r\n"
CHUNK = 0x06
_HEAD = struct.Struct("<BQ")  # opcode, length of the record
_TIMES = struct.Struct("<QQ")  # first and last log time, at the beginning of a chunk


class BagState(NamedTuple):
    """What is left of a bag.

    Attributes:
        chunks: complete ones in the file.
        bytes_behind: of the record that the file ends in; 0 when it ends between two.
        last: log time of the last message in a complete chunk, ns; 0 without any.
        messages: that mcap's reader gave.
        last_read: log time of the last of them, ns.
        finished: the file ends as a whole one does.
    """

    chunks: int
    bytes_behind: int
    last: int
    messages: int
    last_read: int
    finished: bool


def inspect(path: Path) -> BagState:
    """Walk the records by their lengths alone, and read the messages with mcap's NonSeekingReader.

    Raises:
        OSError: the file cannot be opened.
    """
    raw = path.read_bytes()
    place, chunks, last = len(MAGIC), 0, 0
    while place + _HEAD.size <= len(raw):
        opcode, length = _HEAD.unpack_from(raw, place)
        if place + _HEAD.size + length > len(raw):
            break
        if opcode == CHUNK:
            chunks += 1
            last = max(last, _TIMES.unpack_from(raw, place + _HEAD.size)[1])
        place += _HEAD.size + length
        if raw[place:] == MAGIC:
            break
    finished = raw[place:] == MAGIC
    behind = 0 if finished else len(raw) - place
    messages, last_read = 0, 0
    with path.open("rb") as file:
        try:
            for _, _, message in NonSeekingReader(file).iter_messages(log_time_order=False):
                messages += 1
                last_read = max(last_read, message.log_time)
        except Exception:  # cut off, or broken in any way: how far it was read is what counts
            pass
    return BagState(chunks, behind, last, messages, last_read, finished)


def unreadable(path: Path) -> list[str]:
    """One line when the bag does not begin as one or cannot be read up to its last complete chunk."""
    try:
        with path.open("rb") as file:
            begins = file.read(len(MAGIC)) == MAGIC
        state = inspect(path) if begins else None
    except OSError as error:
        return [f"{path.name}: {error.strerror or error}"]
    if state is None:
        return [f"{path.name} does not begin as an MCAP file"]
    if state.last_read < state.last or (state.chunks and not state.messages):
        return [
            f"{path.name}: {state.chunks} complete chunks reach to {state.last} ns; "
            f"{state.messages} messages were read, to {state.last_read} ns"
        ]
    return []
