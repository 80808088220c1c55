"""The records of an MCAP file one after the other: past damaged chunks, up to where the
file breaks off.
"""

from __future__ import annotations

import contextlib
import json
import struct
from array import array
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Footer, Header, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
from zstandard import ZstdError

from dextar_control.bags.damage import Hole

MAGIC = b"\x89MCAP0\r\n"
LATEST = 2**63 - 1  # ns since the epoch: what is beyond is no time
RECOVERY_NAME = "dextar_recovery"  # of the metadata record that tells of a recovery
PER_MESSAGE = 6  # numbers
BATCH = 1 << 20  # bytes of messages outside chunks that are gathered
BUFFER = 1 << 20  # bytes
TOLD = 1 << 18  # bytes from one word of progress to the next
_RECORD = struct.Struct("<BQ")  # opcode, length
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
Record = Header | Schema | Channel | Metadata | Attachment | Footer
_READ: Mapping[int, Callable[[ReadDataStream], Record]] = {
    Opcode.HEADER: Header.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.FOOTER: Footer.read,
}
# What the libraries raise at content that is damaged; lz4 raises RuntimeError.
_DAMAGED = (
    EndOfFile,
    McapError,
    struct.error,
    ZstdError,
    ValueError,
    OverflowError,
    MemoryError,
    RuntimeError,
)

Progress = Callable[[int, int], None]  # bytes read, bytes in all


class Messages(NamedTuple):
    """Serialized messages in the order of the file.

    Attributes:
        data: what holds them.
        numbers: PER_MESSAGE for each: channel, sequence, log time and publish time in
            ns, begin and end of its content in data.
    """

    data: bytes
    numbers: array[int]


@dataclass
class Scan:
    """A file that is read from its beginning, and what that found of it.

    Attributes:
        path: of the file.
        whole: its end was reached.
        end: bytes up to the end of the last record that could be read.
        size: bytes of the content.
        holes: in the order of the file.
        damaged: chunks whose content does not agree with their check sum, or is none.
        first, last: least and greatest log time of its messages, ns; None before there
            was one. What is no time does not count.
        started: when its recording began, as the recorder says; "" where it does not.
        inherited: holes of the file that it was recovered from.
        cut: it was recovered from a file whose end was missing.
        content: where its content lies, where the file itself is compressed.
    """

    path: Path
    content: Path | None = None
    whole: bool = False
    end: int = 0
    size: int = 0
    holes: list[Hole] = field(default_factory=list)
    first: int | None = None
    last: int | None = None
    started: str = ""
    inherited: list[Hole] = field(default_factory=list)
    cut: bool = False
    _opened: bool = False  # a hole without messages after it
    _count: int = 0  # messages

    @property
    def damaged(self) -> int:
        """How many chunks were left out."""
        return sum(hole.chunks for hole in self.holes)

    def records(self, progress: Progress | None = None) -> Iterator[Record | Messages]:
        """Yield every record that can be read, from the beginning; those of intact
        chunks as schemas, channels and ``Messages``.

        Raises:
            OSError: the file cannot be read.
        """
        self.whole, self.end, self.started = False, 0, ""
        self.first = self.last = None
        self.holes, self.inherited, self.cut = [], [], False
        self._opened, self._count = False, 0
        source = self.content or self.path
        self.size = size = source.stat().st_size
        loose: list[bytes] = []
        gathered = 0
        with source.open("rb", buffering=BUFFER) as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                return
            for opcode, content in self._frames(stream, size, progress):
                if opcode == Opcode.MESSAGE:
                    if len(content) >= _MESSAGE.size:
                        loose.append(content)
                        gathered += len(content)
                    if gathered < BATCH:
                        continue
                if loose:
                    yield self._counted(_joined(loose))
                    loose, gathered = [], 0
                if opcode == Opcode.CHUNK:
                    yield from self._chunk(stream, content)
                elif opcode == Opcode.STATISTICS:
                    self._compare(content)
                elif opcode in _READ:
                    try:
                        record = _READ[opcode](ReadDataStream(BytesIO(content)))
                    except _DAMAGED:
                        continue
                    if (
                        isinstance(record, Metadata)
                        and record.name == "dextar"
                        and not self.started
                    ):
                        self.started = str(record.metadata.get("started", ""))
                    if isinstance(record, Metadata) and record.name == RECOVERY_NAME:
                        self._inherit(record.metadata)
                    yield record
            if loose:
                yield self._counted(_joined(loose))
        if progress is not None:
            progress(size, size)

    def _frames(
        self, stream: IO[bytes], size: int, progress: Progress | None
    ) -> Iterator[tuple[int, bytes]]:
        """Yield (opcode, content) of each record up to the footer, but not of those
        that only an index needs.
        """
        told = 0
        while True:
            self.end = stream.tell()
            if progress is not None and self.end >= told:
                progress(self.end, size)
                told = self.end + TOLD
            head = stream.read(_RECORD.size)
            if len(head) < _RECORD.size:
                return
            opcode, length = _RECORD.unpack(head)
            if opcode == 0 or length > size - stream.tell():
                return
            if opcode not in _READ and opcode not in (
                Opcode.CHUNK,
                Opcode.MESSAGE,
                Opcode.STATISTICS,
            ):
                stream.seek(length, 1)
                continue
            yield opcode, stream.read(length)
            if opcode == Opcode.FOOTER:
                self.whole = stream.read(len(MAGIC)) == MAGIC
                self.end = stream.tell()
                return

    def _chunk(self, stream: IO[bytes], content: bytes) -> Iterator[Record | Messages]:
        try:
            records, messages = _break_up(content)
        except _DAMAGED:
            if not self.holes:
                yield from _described_at_the_end(stream)
            self._miss(1)
            return
        yield from records
        if messages.numbers:
            yield self._counted(messages)

    def _compare(self, statistics: bytes) -> None:
        """Compare the number of messages with the file's own count: a chunk may be
        missing that was not even seen as one, somewhere in the file.
        """
        if (
            not self.holes
            and len(statistics) >= 8
            and int.from_bytes(statistics[:8], "little") > self._count
        ):
            self.holes.append(Hole(str(self.path), 1, self.first, self.last))

    def recovery_details(self) -> dict[str, str]:
        """Return what is missing here, for the record ``RECOVERY_NAME`` of a file that
        is recovered from this one.
        """
        holes = [
            (hole.chunks, hole.first, hole.last)
            for hole in (*self.inherited, *self.holes)
        ]
        return {
            "holes": json.dumps(holes),
            "cut": json.dumps(self.cut or not self.whole),
        }

    def _inherit(self, metadata: Mapping[str, str]) -> None:
        try:
            told = json.loads(metadata.get("holes", "[]"))
            holes = [
                Hole(str(self.path), int(chunks), first, last)
                for chunks, first, last in told
            ]
            cut = bool(json.loads(metadata.get("cut", "false")))
        except (ValueError, TypeError, RecursionError):  # not ours
            return
        self.inherited, self.cut = holes, cut

    def _miss(self, chunks: int) -> None:
        if self._opened:
            self.holes[-1].chunks += chunks
        else:
            self.holes.append(Hole(str(self.path), chunks, self.last))
            self._opened = True

    def _counted(self, messages: Messages) -> Messages:
        times = messages.numbers[2::PER_MESSAGE]
        self._count += len(times)
        known = (
            times
            if max(times) <= LATEST
            else [time for time in times if time <= LATEST]
        )
        if len(known) == 0:
            return messages
        first, last = min(known), max(known)
        if self._opened:
            self.holes[-1].last = first
            self._opened = False
        self.first = first if self.first is None else min(first, self.first)
        self.last = last if self.last is None else max(last, self.last)
        return messages


def _joined(loose: list[bytes]) -> Messages:
    numbers, place = array("Q"), 0
    for content in loose:
        numbers.extend(_MESSAGE.unpack_from(content))
        numbers.extend((place + _MESSAGE.size, place + len(content)))
        place += len(content)
    return Messages(b"".join(loose), numbers)


def _break_up(content: bytes) -> tuple[list[Record], Messages]:
    """Break a chunk up into schemas, channels and messages; mcap's own way takes ten
    times as long.
    """
    stream, length = get_chunk_data_stream(
        Chunk.read(ReadDataStream(BytesIO(content))), validate_crc=True
    )
    data = stream.read(length)
    records: list[Record] = []
    numbers = array("Q")
    place = 0
    while place < length:
        opcode, size = _RECORD.unpack_from(data, place)
        begin = place + _RECORD.size
        place = begin + size
        if place > length or (opcode == Opcode.MESSAGE and size < _MESSAGE.size):
            raise EndOfFile
        if opcode == Opcode.MESSAGE:
            numbers.extend(_MESSAGE.unpack_from(data, begin))
            numbers.extend((begin + _MESSAGE.size, place))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            # a record whose text is damaged describes nothing
            with contextlib.suppress(UnicodeDecodeError):
                records.append(
                    _READ[opcode](ReadDataStream(BytesIO(data[begin:place])))
                )
    return records, Messages(data, numbers)


def _described_at_the_end(stream: IO[bytes]) -> Iterator[Record]:
    """Yield the schemas and channels that a file repeats before its end, for those that
    stood in a damaged chunk.
    """
    place, summary = stream.tell(), None
    stream.seek(0)
    with contextlib.suppress(*_DAMAGED, OSError, StopIteration):
        summary = SeekingReader(stream).get_summary()
    stream.seek(place)
    if summary is not None:
        yield from summary.schemas.values()
        yield from summary.channels.values()
