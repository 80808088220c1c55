"""Damage done to MCAP files where a test wants it."""

from __future__ import annotations

import struct
from pathlib import Path

from mcap.opcode import Opcode


def frames(content: bytes) -> list[tuple[int, int, int]]:
    """(opcode, begin, end) of each record's content."""
    found, place = [], 8
    while place + 9 <= len(content):
        opcode, length = struct.unpack_from("<BQ", content, place)
        found.append((opcode, place + 9, place + 9 + length))
        place += 9 + length
    return found


def chunks(file: Path) -> list[tuple[int, int]]:
    """(begin, end) of each chunk's content."""
    return [
        (begin, end)
        for opcode, begin, end in frames(file.read_bytes())
        if opcode == Opcode.CHUNK
    ]


def with_damaged_chunks(source: Path, target: Path, *numbers: int) -> Path:
    """A copy in which a byte in the middle of each of these chunks is another."""
    content, places = bytearray(source.read_bytes()), chunks(source)
    for number in numbers:
        begin, end = places[number]
        content[(begin + end) // 2] ^= 0xFF
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(content)
    return target
