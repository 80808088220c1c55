"""A bag's messages and metadata, whole, damaged or cut off."""

from __future__ import annotations

import sqlite3
import struct
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.records import Channel, Metadata, Schema
from rosbags.rosbag2 import Reader, ReaderError

from dextar_control.analysis.series import TYPES, Columns, Select, Series
from dextar_control.bags.folder import (
    METADATA_FILE,
    check_one_recording,
    holes_of,
    in_order,
    one_bag_by_name,
    read_listing,
    split_name,
)
from dextar_control.bags.records import MAGIC, PER_MESSAGE, RECOVERY_NAME, Hole, Messages, Progress, Scan
from dextar_control.contract.errors import BagError
from dextar_control.contract.topics import TOPICS

SQLITE = b"SQLite format 3\0"


@dataclass
class Bag:
    """What a bag holds, in the order of its records.

    Attributes:
        path: of the file.
        messages: per topic name.
        metadata: per record name, the last record's texts.
        holes: what is missing in its middle.
        truncated: the file whose end is missing, where nothing comes after it, or None.
    """

    path: Path
    messages: dict[str, Series] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    holes: list[Hole] = field(default_factory=list)
    truncated: Path | None = None

    @property
    def damage(self) -> str:
        """What is missing, in one sentence; "" where nothing is known to be."""
        parts, recovered = [], RECOVERY_NAME in self.metadata
        for hole in self.holes:
            what = f"{hole.chunks} damaged chunk{'s' * (hole.chunks > 1)}" if hole.chunks else "the missing end"
            parts.append(f"{what} of {hole.path}, {_span(hole)}")
        text = f"no message is left of {'; '.join(parts)}" if parts else ""
        if self.truncated:
            was = "was recovered from a file that breaks off or" if recovered else "breaks off or"
            cut = f"{self.truncated} {was} is damaged: read up to its last complete chunk"
            text = f"{cut}; {text}" if text else cut
        if not text or recovered:
            return text
        return f"{text}; dextar recover saves what can be"

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


def read_bag(
    path: str | Path, columns: Mapping[str, Columns] | None = None, select: Mapping[str, Select] | None = None,
    progress: Progress | None = None,
) -> Bag:  # fmt: skip
    """A bag: a file, MCAP or sqlite3, or a folder in rosbag2's layout, also a split one. Damaged chunks are passed over.

    Memory does not grow with its length: messages are made into columns in temporary files (``Series``), or only counted.

    Args:
        path: of the file or folder.
        columns: per message type, what is kept of each message of a fast topic.
        select: per message type, which messages of a slow topic are kept.
        progress: told the bytes read and those there are; not for what only the library reads.

    Raises:
        BagError: no such file, empty, no bag, of several recordings, or without a message of a known type.
    """
    path = Path(path)
    try:
        files, listed = _files(path) if path.is_dir() else ([path], True)
        bag = Bag(files[0] if files else path)
        fill = _Filling(bag, columns or {}, select or {})
        if files and all(_storage(file) is MAGIC for file in files):
            fill.from_files(files, listed, progress)
        else:
            fill.with_library(path)
    except OSError as error:
        raise BagError(f"cannot read {path}: {error.strerror or error}") from error
    if not any(len(series) for series in bag.messages.values()):
        raise BagError(f"{path} holds no ROS 2 message" + (f": {bag.damage}" if bag.damage else ""))
    if bag.damage:
        warnings.warn(bag.damage, stacklevel=2)
    return bag


def _span(hole: Hole) -> str:
    if hole.first is None or hole.last is None:
        return "before all others" if hole.first is None else "after all others"
    return f"{(hole.last - hole.first) * 1e-9:.3f} s"


def _files(folder: Path) -> tuple[list[Path], bool]:
    """(the files of a bag folder in order, whether ``metadata.yaml`` lists them); none where only the library reads them."""
    if not (folder / METADATA_FILE).is_file():
        files = in_order([*folder.glob("*.mcap"), *folder.glob("*.db3")])
        if not files or not one_bag_by_name(files):
            raise BagError(f"folder {folder} has no {METADATA_FILE} and holds {len(files)} .mcap files; one is needed")
        return files, False
    document = read_listing(folder)
    files = [folder / name for name in document["relative_file_paths"]]
    for file in files:
        if not file.is_file():
            raise BagError(f"{folder / METADATA_FILE} lists {file.name}, which is not there; dextar recover saves the rest")
    names = {split_name(file)[0] for file in files}
    more = sorted(file.name for file in folder.glob("*.mcap") if file not in files and split_name(file)[0] in names)
    if more:
        text = f"{folder / METADATA_FILE} does not list {', '.join(more)} beside it: not read; dextar recover puts them together"
        warnings.warn(text, stacklevel=3)
    return ([] if document.get("compression_mode") else files), True


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


class _Filling:
    """Fills a bag; ``columns`` and ``select`` as in ``read_bag``."""

    def __init__(self, bag: Bag, columns: Mapping[str, Columns], select: Mapping[str, Select]) -> None:
        self._bag, self._columns, self._select = bag, columns, select

    def from_files(self, files: list[Path], listed: bool, progress: Progress | None) -> None:
        """From MCAP files in order."""
        scans = [Scan(file) for file in files]
        sizes = [file.stat().st_size for file in files]
        for index, scan in enumerate(scans):
            before = sum(sizes[:index])

            def told(done: int, _: int, before: int = before) -> None:
                if progress is not None:
                    progress(before + done, sum(sizes))

            self._from_file(scan, told)
            if not listed:
                check_one_recording(scans[: index + 1])
        self._bag.holes, self._bag.truncated = holes_of(scans)

    def _from_file(self, scan: Scan, progress: Progress) -> None:
        schemas: dict[int, Schema] = {}
        series: dict[int, Series | None] = {}
        for record in scan.records(progress):
            if isinstance(record, Messages):
                self._take(scan.path, record, series)
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                if record.id not in series:
                    schema = schemas.get(record.schema_id)
                    known = record.message_encoding == "cdr" and schema is not None
                    series[record.id] = self._series(record.topic, schema.name if known and schema else "")
            elif isinstance(record, Metadata):
                self._bag.metadata[record.name] = dict(record.metadata)

    def _take(self, path: Path, batch: Messages, series: Mapping[int, Series | None]) -> None:
        numbers = np.frombuffer(batch.numbers, dtype=np.uint64).reshape(-1, PER_MESSAGE)
        channels = numbers[:, 0]
        for channel in np.unique(channels).tolist():
            if channel not in series:
                raise BagError(f"{path} is damaged: a message is of channel {channel}, which no record describes")
            found = series[channel]
            if found is not None:
                try:
                    found.extend(batch.data, numbers[channels == channel][:, 2:])
                except BagError as error:
                    raise BagError(f"{path}: {error}") from error

    def with_library(self, path: Path) -> None:
        """What is not plain MCAP: sqlite3, and what rosbag2 compressed itself. It has no publish times."""
        try:
            with Reader(path) as reader:
                series = {connection.id: self._series(connection.topic, connection.msgtype) for connection in reader.connections}
                for connection, time, data in reader.messages():
                    found = series[connection.id]
                    if found is not None:
                        found.add(time, time, bytes(data))
        except (ReaderError, sqlite3.Error, AssertionError, ValueError, LookupError, struct.error) as error:
            raise BagError(f"{path} cannot be read: {error}") from error

    def _series(self, topic: str, type_name: str) -> Series | None:
        if type_name not in TYPES.fielddefs:
            return None
        found = self._bag.messages.get(topic)
        if found is None:
            found = Series(topic, type_name, self._columns.get(type_name), self._select.get(type_name))
            self._bag.messages[topic] = found
        if found.type != type_name:
            raise BagError(f"{self._bag.path}: {topic} is a {found.type} and a {type_name}")
        return found
