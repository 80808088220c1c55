"""A bag's messages and metadata, whole, damaged or cut off."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.records import Channel, Metadata, Schema
from rosbags.rosbag2 import Reader

from dextar_control.bags.compression import ZSTD, plain_name, unpack_message
from dextar_control.bags.damage import Hole, hole_in_words, missing_end_in_words
from dextar_control.bags.folder import (
    METADATA_FILE,
    SQLITE_SUFFIX,
    Opened,
    check_one_recording,
    files_of,
    holes_of,
    opened,
)
from dextar_control.bags.scan import (
    MAGIC,
    PER_MESSAGE,
    RECOVERY_NAME,
    Messages,
    Progress,
    Scan,
)
from dextar_control.bags.series import TYPES, Columns, Select, Series
from dextar_control.contract.errors import BagError, bag_errors
from dextar_control.contract.robot import JOINT_NAMES
from dextar_control.contract.topics import JOINT_STATES, TOPICS, Topic
from dextar_control.contract.words import counted

BROKEN_MESSAGE = "its compressed content is damaged"


@dataclass
class Bag:
    """The messages and the metadata of a bag.

    Attributes:
        path: of the file.
        messages: per topic name; where a topic has two types, the second with its type
            behind the name.
        metadata: per record name, the last record's texts.
        holes: what is missing in its middle.
        truncated: the file whose end is missing, where nothing comes after it, or None.
        undescribed: messages per number of a channel that no record describes.
        faults: what else is wrong with it, each in words.
    """

    path: Path
    messages: dict[str, Series] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    holes: list[Hole] = field(default_factory=list)
    truncated: str | None = None
    undescribed: dict[int, int] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)

    @property
    def damage(self) -> str:
        """What the bag lacks, a sentence for each damage; "" where nothing is known to
        be lost.
        """
        recovered, lines = RECOVERY_NAME in self.metadata, list[str]()
        saved = "" if recovered else "; dextar recover saves what can be"
        if self.truncated:
            sqlite = plain_name(self.truncated).endswith(SQLITE_SUFFIX)
            lines.append(
                missing_end_in_words(
                    self.truncated,
                    "message" if sqlite else "chunk",
                    recovered=recovered,
                )
            )
            saved = "" if sqlite else saved
        lines += [*map(hole_in_words, self.holes)]
        lines += [
            f"{self.path}: {counted(count, 'message')} of channel {channel}, which no"
            " record describes, cannot be read"
            for channel, count in self.undescribed.items()
        ]
        return "; ".join([*lines, *self.faults]) + saved * bool(lines)

    def series_of(
        self,
        contract_name: str,
        resolved: Mapping[str, str],
        namespace: str | None = None,
        near: str | None = None,
    ) -> Series:
        """Find the messages of a contract topic, maybe none. What has its name but
        another type is passed over.

        Args:
            contract_name: of the topic.
            resolved: the recorder's own table of names; where that says nothing the end
                of the name decides.
            namespace: of the robot, where the bag holds several.
            near: the namespace of the robot's joint states, which decides between
                several topics.

        Raises:
            BagError: of the joint states: they have another type, or there are several
                robots and none was named.
        """
        topic = next(topic for topic in TOPICS if topic.name == contract_name)
        names = self._names(topic, resolved, namespace)
        named = [
            series
            for name in names
            for series in self.messages.values()
            if series.topic == name
        ]
        found = [series for series in named if series.type == topic.type]
        if len(found) > 1 and topic is JOINT_STATES:
            found = [
                series
                for series in found
                if all(series.knows(f"position.{joint}") for joint in JOINT_NAMES)
            ] or found
        elif len(found) > 1:
            listed = ", ".join(series.topic for series in found)
            found = [
                series for series in found if series.topic == f"{near}/{contract_name}"
            ]
            if not found:
                warnings.warn(
                    f"{contract_name} is there as {listed}, and none is the robot's"
                    " own: not read",
                    stacklevel=5,
                )
        if len(found) > 1:
            listed = ", ".join(series.topic for series in found)
            raise BagError(
                f"{self.path} holds {contract_name} of {len(found)} robots ({listed});"
                " name one's namespace"
            )
        if not found and topic is JOINT_STATES:
            for other in named:
                raise BagError(
                    f"{self.path}: {other.topic} is a {other.type}; a run of this robot"
                    f" has a {topic.type} there"
                )
        return found[0] if found else Series(contract_name, topic.type)

    def _names(
        self, topic: Topic, resolved: Mapping[str, str], namespace: str | None
    ) -> list[str]:
        if topic.name in resolved:
            return [resolved[topic.name]]
        if topic.name.startswith("/") or namespace is not None:
            own = (
                topic.name
                if topic.name.startswith("/")
                else f"/{(namespace or '').strip('/')}/{topic.name}"
            )
            return [own.replace("//", "/")]
        longer = [
            other.name for other in TOPICS if other.name.endswith("/" + topic.name)
        ]
        topics = {series.topic for series in self.messages.values()}
        return sorted(
            {
                name
                for name in topics
                if name.endswith("/" + topic.name)
                and not any(name.endswith("/" + other) for other in longer)
            }
        )


def read_bag(
    path: str | Path,
    columns: Mapping[str, Columns] | None = None,
    select: Mapping[str, Select] | None = None,
    progress: Progress | None = None,
    tell: bool = True,
) -> Bag:
    """Read a bag: a file, MCAP or sqlite3, or a folder in rosbag2's layout, also of a
    split bag. Damaged chunks are passed over.

    Memory does not grow with its length: messages are made into columns in temporary
        files (``Series``), or only counted.

    Args:
        path: of the file or folder.
        columns: per message type, what is kept of each message of a fast topic.
        select: per message type, which messages of a slow topic are kept.
        progress: told the bytes read and those there are; not for what only the library
            reads.
        tell: warn of its damage; otherwise the caller does.

    Raises:
        BagError: no such file, empty, no bag, of several recordings, or without a
            message of a known type.
    """
    path = Path(path)
    with bag_errors(f"read {path}"):
        files, listed = _files(path) if path.is_dir() else ([path], True)
        bag = Bag(files[0])
        with opened(files) as parts:
            _Filling(bag, columns or {}, select or {}).from_files(
                parts, listed, progress
            )
    if not any(len(series) for series in bag.messages.values()):
        raise BagError(
            f"{path} holds no ROS 2 message" + (f": {bag.damage}" if bag.damage else "")
        )
    if tell and bag.damage:
        warnings.warn(bag.damage, stacklevel=2)
    return bag


def _files(folder: Path) -> tuple[list[Path], bool]:
    """Find the files of a bag folder, and whether ``metadata.yaml`` lists them."""
    found = files_of(folder)
    if not found.listed and (folder / METADATA_FILE).is_file():
        raise BagError(
            f"{folder}: {found.fault}; dextar recover saves what is there, or name one"
            " of its files"
        )
    if found.listed and found.fault:
        warnings.warn(
            f"{folder}: {found.fault} beside it: not read; dextar recover puts them"
            " together",
            stacklevel=3,
        )
    return found.listed or found.files, bool(found.listed)


class _Filling:
    """Fills a bag from files; ``columns`` and ``select`` as in ``read_bag``."""

    def __init__(
        self, bag: Bag, columns: Mapping[str, Columns], select: Mapping[str, Select]
    ) -> None:
        self._bag, self._columns, self._select = bag, columns, select
        self._count = 0  # messages read

    def from_files(
        self, parts: list[Opened], listed: bool, progress: Progress | None
    ) -> None:
        """Read files in their order."""
        sizes = [part.content.stat().st_size for part in parts]
        scans: list[Scan] = []
        for index, part in enumerate(parts):
            before = sum(sizes[:index])

            def told(done: int, _: int, before: int = before) -> None:
                if progress is not None:
                    progress(before + done, sum(sizes))

            if part.storage is not MAGIC:
                self._with_library(part)
                continue
            scans.append(Scan(part.file, part.content))
            self._from_file(scans[-1], told)
            if not listed:
                check_one_recording(scans)
        self._bag.holes, truncated = holes_of(scans)
        self._bag.truncated = self._bag.truncated or truncated

    def _from_file(self, scan: Scan, progress: Progress) -> None:
        schemas: dict[int, Schema] = {}
        series: dict[int, Series | None] = {}
        for record in scan.records(progress):
            if isinstance(record, Messages):
                self._take(record, series)
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                if record.id not in series:
                    schema = schemas.get(record.schema_id)
                    known = record.message_encoding == "cdr" and schema is not None
                    series[record.id] = self._series(
                        record.topic, schema.name if known and schema else ""
                    )
            elif isinstance(record, Metadata):
                self._bag.metadata[record.name] = dict(record.metadata)

    def _take(self, batch: Messages, series: Mapping[int, Series | None]) -> None:
        numbers = np.frombuffer(batch.numbers, dtype=np.uint64).reshape(-1, PER_MESSAGE)
        places = self._count + np.arange(len(numbers), dtype=np.int64)
        self._count += len(numbers)
        channels = numbers[:, 0]
        for channel in np.unique(channels).tolist():
            mine = channels == channel
            if channel not in series:
                undescribed = self._bag.undescribed
                undescribed[channel] = undescribed.get(channel, 0) + int(mine.sum())
                continue
            found = series[channel]
            if found is None:
                continue
            messages = numbers[mine][:, 2:]
            if any(
                batch.data[begin : begin + len(ZSTD)] == ZSTD
                for begin in messages[:, 2].tolist()
            ):
                for place, (log_time, publish_time, first, last) in zip(
                    places[mine].tolist(), messages.tolist(), strict=True
                ):
                    self._take_one(
                        found, log_time, publish_time, batch.data[first:last], place
                    )
            else:
                found.extend(batch.data, messages, places[mine])

    @staticmethod
    def _take_one(
        series: Series, log_time: int, publish_time: int, data: bytes, place: int
    ) -> None:
        """Take a message that rosbag2 may have compressed by itself: no CDR message
        begins as a compressed one does.
        """
        content = unpack_message(data) if data.startswith(ZSTD) else data
        if content is None:
            series.lose(log_time, BROKEN_MESSAGE)
        else:
            series.add(log_time, publish_time, content, place)

    def _with_library(self, part: Opened) -> None:
        """Read a sqlite3 file, which has no publish times."""
        before = self._count
        try:
            with Reader(part.content) as reader:
                series = {
                    connection.id: self._series(connection.topic, connection.msgtype)
                    for connection in reader.connections
                }
                for connection, time, data in reader.messages():
                    self._count += 1
                    found = series[connection.id]
                    if found is not None:
                        self._take_one(found, time, time, bytes(data), self._count)
        except (OSError, BagError):
            raise
        # what the library and sqlite3 raise at a damaged file is listed nowhere
        except Exception as error:
            if self._count == before:
                raise BagError(f"{part.file} cannot be read: {error}") from error
            self._bag.truncated = str(part.file)

    def _series(self, topic: str, type_name: str) -> Series | None:
        if type_name not in TYPES.fielddefs:
            return None
        known = self._bag.messages
        name = (
            topic
            if topic not in known or known[topic].type == type_name
            else f"{topic} ({type_name})"
        )
        if name not in known:
            known[name] = Series(
                topic,
                type_name,
                self._columns.get(type_name),
                self._select.get(type_name),
            )
        return known[name]
