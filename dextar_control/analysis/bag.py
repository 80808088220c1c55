"""A bag's messages and metadata, whole or cut off."""

from __future__ import annotations

import sqlite3
import struct
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import yaml
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from rosbags.rosbag2 import Reader, ReaderError
from zstandard import ZstdError

from dextar_control.analysis.series import TYPES, Series
from dextar_control.contract.errors import BagError
from dextar_control.contract.topics import TOPICS

METADATA_FILE = "metadata.yaml"
SQLITE = b"SQLite format 3\0"
MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")  # opcode, length
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CUT = (EndOfFile, McapError, struct.error, ZstdError, ValueError, OverflowError, MemoryError)


@dataclass
class Bag:
    """What a bag holds, in the order of its records.

    Attributes:
        path: of the file.
        messages: per topic name.
        metadata: per record name, the last record's texts.
        truncated: the file that breaks off or is damaged, or None; every chunk of it up to there was read.
    """

    path: Path
    messages: dict[str, Series] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    truncated: Path | None = None

    def of(self, contract_name: str, resolved: dict[str, str], namespace: str | None = None) -> Series:
        """Messages of a contract topic, maybe none.

        Args:
            contract_name: of the topic.
            resolved: the recorder's own table of names; where that says nothing the end of the name decides.
            namespace: of the robot, where the bag holds several.

        Raises:
            BagError: it has another type, or there are several robots and none was named.
        """
        topic = next(topic for topic in TOPICS if topic.name == contract_name)
        name = resolved.get(contract_name) or self._find(contract_name, namespace)
        found = self.messages.get(name)
        if found is not None and found.type != topic.type:
            raise BagError(f"{self.path}: {name} is a {found.type}; a run of this robot has a {topic.type} there")
        return Series(contract_name, topic.type) if found is None else found

    def _find(self, contract_name: str, namespace: str | None) -> str:
        if contract_name.startswith("/") or namespace is not None:
            own = contract_name if contract_name.startswith("/") else f"/{(namespace or '').strip('/')}/{contract_name}"
            return own.replace("//", "/")
        longer = [topic.name for topic in TOPICS if topic.name.endswith("/" + contract_name)]
        names = sorted(name for name in self.messages if name.endswith("/" + contract_name)
                       and not any(name.endswith("/" + other) for other in longer))  # fmt: skip
        if len(names) > 1:
            raise BagError(f"{self.path} holds {contract_name} of {len(names)} robots ({', '.join(names)}); name one's namespace")
        return names[0] if names else ""


class _Reader(StreamReader):
    """Without the chunks' indexes, which took a quarter of the time: every message is read anyway."""

    def _read_record(self, opcode: int, length: int) -> Any:
        if opcode == Opcode.MESSAGE_INDEX:
            self._stream.read(length)
            return None
        return super()._read_record(opcode, length)


def read_bag(path: str | Path) -> Bag:
    """Every message of a bag: a file, MCAP or sqlite3, or a folder in rosbag2's layout, also a split one.

    Raises:
        BagError: no such file, empty, no bag, or without a message of a known type.
    """
    path = Path(path)
    try:
        files = _files(path) if path.is_dir() else [path]
        bag = Bag(files[0] if files else path)
        if files and all(_storage(file) is MAGIC for file in files):
            for file in files:
                with file.open("rb") as stream:
                    _collect(bag, file, _Reader(stream, emit_chunks=True))
        else:
            _collect_with_library(bag, path)
    except OSError as error:
        raise BagError(f"cannot read {path}: {error.strerror or error}") from error
    if bag.truncated:
        text = f"{bag.truncated} breaks off or is damaged: read up to its last complete chunk; dextar recover saves what can be"
        warnings.warn(text, stacklevel=2)
    if not any(len(series) for series in bag.messages.values()):
        raise BagError(f"{path} holds no ROS 2 message" + (" before it breaks off" if bag.truncated else ""))
    return bag


def _files(folder: Path) -> list[Path]:
    """The files of a bag folder in order; none where only the library reads them, because they are compressed as a whole."""
    listing = folder / METADATA_FILE
    if not listing.is_file():
        files = sorted((*folder.glob("*.mcap"), *folder.glob("*.db3")), key=_number)
        if len({_stem(file) for file in files}) != 1 or (len(files) > 1 and _number(files[0])[0] < 0):
            raise BagError(f"folder {folder} has no {METADATA_FILE} and holds {len(files)} .mcap files; one is needed")
        return files
    try:
        document = yaml.safe_load(listing.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        files = [folder / Path(name).name for name in document["relative_file_paths"]]
        compressed = bool(document.get("compression_mode"))
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, AttributeError) as error:
        raise BagError(f"{listing} is no {METADATA_FILE} of rosbag2; the .mcap file beside it may be given instead") from error
    for file in files:
        if not file.is_file():
            raise BagError(f"{listing} lists {file.name}, which is not there")
    return [] if compressed else files


def _stem(file: Path) -> str:
    return file.stem.rpartition("_")[0] if _number(file)[0] >= 0 else file.stem


def _number(file: Path) -> tuple[int, str]:
    """Of a file of a split bag; -1 without one."""
    last = file.stem.rpartition("_")[2]
    return (int(last) if last.isdigit() and last != file.stem else -1), file.name


def _storage(file: Path) -> bytes:
    """The magic bytes of the file's storage.

    Raises:
        BagError: it is empty or neither MCAP nor sqlite3.
    """
    with file.open("rb") as stream:
        start = stream.read(len(SQLITE))
    if not start:
        raise BagError(f"{file} is empty")
    for magic in (MAGIC, SQLITE):
        if start.startswith(magic):
            return magic
    raise BagError(f"{file} is not an MCAP file, nor a sqlite3 bag")


def _collect(bag: Bag, path: Path, reader: StreamReader) -> None:
    schemas: dict[int, Schema] = {}
    series: dict[int, Series | None] = {}
    for record in _records(reader, bag, path):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            if record.id not in series:
                schema = schemas.get(record.schema_id)
                known = record.message_encoding == "cdr" and schema is not None
                series[record.id] = _series(bag, record.topic, schema.name if known and schema else "")
        elif isinstance(record, Metadata):
            bag.metadata[record.name] = dict(record.metadata)
        elif isinstance(record, Message):
            if record.channel_id not in series:
                raise BagError(f"{path} is damaged: a message is of channel {record.channel_id}, which no record describes")
            found = series[record.channel_id]
            if found is not None:
                try:
                    found.add(record.log_time, record.publish_time, record.data)
                except BagError as error:
                    raise BagError(f"{path}: {error}") from error


def _collect_with_library(bag: Bag, path: Path) -> None:
    """What is not plain MCAP: sqlite3, and what rosbag2 compressed itself. It has no publish times."""
    try:
        with Reader(path) as reader:
            series = {connection.id: _series(bag, connection.topic, connection.msgtype) for connection in reader.connections}
            for connection, time, data in reader.messages():
                found = series[connection.id]
                if found is not None:
                    found.add(time, time, bytes(data))
    except (ReaderError, sqlite3.Error, AssertionError, ValueError) as error:
        raise BagError(f"{path} cannot be read: {error}") from error


def _series(bag: Bag, topic: str, type_name: str) -> Series | None:
    if type_name not in TYPES.fielddefs:
        return None
    found = bag.messages.setdefault(topic, Series(topic, type_name))
    if found.type != type_name:
        raise BagError(f"{bag.path}: {topic} is a {found.type} and a {type_name}")
    return found


def _records(reader: StreamReader, bag: Bag, path: Path) -> Iterator[Any]:
    records = reader.records
    while True:
        try:
            record = next(records)
            inside = _break_up(record) if isinstance(record, Chunk) else (record,)
        except StopIteration:
            return
        except _CUT:
            bag.truncated = path
            return
        yield from inside


def _break_up(chunk: Chunk) -> list[Any]:
    """The records of a chunk; the library's own way takes seven times as long for messages."""
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
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
