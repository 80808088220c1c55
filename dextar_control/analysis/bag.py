"""A bag's messages and metadata, whole or cut off."""

from __future__ import annotations

import struct
import warnings
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.exceptions import EndOfFile, McapError
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from zstandard import ZstdError

from dextar_control.contract.errors import BagError
from dextar_control.contract.topics import TOPICS

MAGIC = b"\x89MCAP0\r\n"
_CUT = (EndOfFile, McapError, struct.error, ZstdError, ValueError, MemoryError)


@dataclass
class Bag:
    """What a bag holds, in the order of its records.

    Attributes:
        path: of the file.
        messages: per topic name, (publish time in ns, message) in rosbags' classes.
        metadata: per record name, the last record's texts.
        truncated: the file ends before its end record; every complete chunk was read.
    """

    path: Path
    messages: dict[str, list[tuple[int, Any]]] = field(default_factory=lambda: defaultdict(list))
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    truncated: bool = False

    def of(self, contract_name: str, resolved: dict[str, str]) -> list[Any]:
        """Messages of a contract topic, by the recorder's own table or else by the end of the name."""
        return [message for _, message in self.timed(contract_name, resolved)]

    def timed(self, contract_name: str, resolved: dict[str, str]) -> list[tuple[int, Any]]:
        """The same with their publish times, ns of the system clock."""
        return self.messages.get(resolved.get(contract_name) or self._find(contract_name), [])

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
            return _collect(path, StreamReader(stream))
    except OSError as error:
        raise BagError(f"cannot read {path}: {error.strerror or error}") from error


def _collect(path: Path, reader: StreamReader) -> Bag:
    bag = Bag(path)
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    types = get_typestore(Stores.ROS2_JAZZY)
    for record in _records(reader, bag):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Metadata):
            bag.metadata[record.name] = dict(record.metadata)
        elif isinstance(record, Message):
            channel = channels[record.channel_id]
            schema = schemas.get(channel.schema_id)
            if channel.message_encoding != "cdr" or schema is None or schema.name not in types.fielddefs:
                continue
            try:
                message = types.deserialize_cdr(record.data, schema.name)
            except (SerdeError, ValueError, struct.error) as error:
                raise BagError(f"{path}: a message on {channel.topic} is not a {schema.name}: {error}") from error
            bag.messages[channel.topic].append((record.publish_time, message))
    if bag.truncated:
        warnings.warn(f"{path} ends before its end record: read up to its last complete chunk", stacklevel=3)
    if not bag.messages:
        raise BagError(f"{path} holds no ROS 2 message" + (" before it breaks off" if bag.truncated else ""))
    return bag


def _records(reader: StreamReader, bag: Bag) -> Iterator[Any]:
    records = reader.records
    while True:
        try:
            record = next(records)
        except StopIteration:
            return
        except _CUT:
            bag.truncated = True
            return
        yield record
