"""A bag's messages and metadata, whole or cut off."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Metadata, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader, get_chunk_data_stream
from zstandard import ZstdError

from dextar_control.analysis.series import TYPES, Series
from dextar_control.contract.errors import BagError
from dextar_control.contract.topics import TOPICS

MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")  # opcode, length
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CUT = (EndOfFile, McapError, struct.error, ZstdError, ValueError, MemoryError)


@dataclass
class Bag:
    """What a bag holds, in the order of its records.

    Attributes:
        path: of the file.
        messages: per topic name.
        metadata: per record name, the last record's texts.
        truncated: the file ends before its end record; every complete chunk was read.
    """

    path: Path
    messages: dict[str, Series] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    truncated: bool = False

    def of(self, contract_name: str, resolved: dict[str, str]) -> Series:
        """Messages of a contract topic, by the recorder's own table or else by the end of the name; maybe none."""
        topic = next(topic for topic in TOPICS if topic.name == contract_name)
        name = resolved.get(contract_name) or self._find(contract_name)
        found = self.messages.get(name)
        if found is not None and found.type != topic.type:
            raise BagError(f"{self.path}: {name} is a {found.type}; a run of this robot has a {topic.type} there")
        return Series(contract_name, topic.type) if found is None else found

    def _find(self, contract_name: str) -> str:
        plain = contract_name.lstrip("/")
        longer = [topic.name for topic in TOPICS if topic.name.endswith("/" + plain)]
        for name in self.messages:
            if name.endswith("/" + plain) and not any(name.endswith("/" + other) for other in longer):
                return name
        return ""


def read_bag(path: str | Path) -> Bag:
    """Every message of a bag (a ``.mcap`` file, or a folder that holds one).

    Raises:
        BagError: no such file, empty, not MCAP, or no message of this package's topics.
    """
    path = Path(path)
    if path.is_dir():
        files = sorted(path.glob("*.mcap"))
        if len(files) != 1:
            raise BagError(f"folder {path} holds {len(files)} .mcap files; one is needed")
        path = files[0]
    try:
        with path.open("rb") as stream:
            magic = stream.read(MAGIC_SIZE)
            if not magic:
                raise BagError(f"{path} is empty")
            if magic != MAGIC:
                raise BagError(f"{path} is not an MCAP file")
            stream.seek(0)
            return _collect(path, StreamReader(stream, emit_chunks=True))
    except OSError as error:
        raise BagError(f"cannot read {path}: {error.strerror or error}") from error


def _collect(path: Path, reader: StreamReader) -> Bag:
    bag = Bag(path)
    schemas: dict[int, Schema] = {}
    series: dict[int, Series | None] = {}
    for record in _records(reader, bag):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            if record.id not in series:
                series[record.id] = _series(bag, record, schemas.get(record.schema_id))
        elif isinstance(record, Metadata):
            bag.metadata[record.name] = dict(record.metadata)
        elif isinstance(record, Message):
            found = series[record.channel_id]
            if found is not None:
                try:
                    found.add(record.log_time, record.publish_time, record.data)
                except BagError as error:
                    raise BagError(f"{path}: {error}") from error
    if bag.truncated:
        warnings.warn(f"{path} ends before its end record: read up to its last complete chunk", stacklevel=3)
    if not any(len(series) for series in bag.messages.values()):
        raise BagError(f"{path} holds no ROS 2 message" + (" before it breaks off" if bag.truncated else ""))
    return bag


def _series(bag: Bag, channel: Channel, schema: Schema | None) -> Series | None:
    if channel.message_encoding != "cdr" or schema is None or schema.name not in TYPES.fielddefs:
        return None
    return bag.messages.setdefault(channel.topic, Series(channel.topic, schema.name))


def _records(reader: StreamReader, bag: Bag) -> Iterator[Any]:
    records = reader.records
    while True:
        try:
            record = next(records)
            inside = _break_up(record) if isinstance(record, Chunk) else (record,)
        except StopIteration:
            return
        except _CUT:
            bag.truncated = True
            return
        yield from inside


def _break_up(chunk: Chunk) -> list[Any]:
    """The records of a chunk; the library's own way takes seven times as long for messages."""
    stream, length = get_chunk_data_stream(chunk)
    data = stream.read(length)
    records: list[Any] = []
    place = 0
    while place < length:
        opcode, size = _RECORD.unpack_from(data, place)
        begin = place + _RECORD.size
        place = begin + size
        if place > length:
            raise EndOfFile
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, begin)
            records.append(Message(channel, log_time, data[begin + _MESSAGE.size : place], publish_time, sequence))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            kind = Schema if opcode == Opcode.SCHEMA else Channel
            records.append(kind.read(ReadDataStream(BytesIO(data[begin:place]))))
    return records
