"""A whole bag from one that breaks off: every intact message, an index, rosbag2's metadata. Needs no ROS."""

from __future__ import annotations

import os
import re
import shutil
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Attachment, Channel, Chunk, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from zstandard import ZstdError

from dextar_control.contract.errors import BagError
from dextar_control.ros.bag_metadata import METADATA_FILE, RECORD_NAME, FileSummary, TopicDescription, write_metadata_file
from dextar_control.ros.mcap_file import McapFile, Sample

MAGIC = b"\x89MCAP0\r\n"
RECOVERY_NAME = "dextar_recovery"  # of the metadata record that tells of it
SUFFIX = "-recovered"
_SPLIT = re.compile(r"_\d+$")  # the number of a split bag's file
_BROKEN = (EndOfFile, McapError, struct.error, ValueError, OverflowError, MemoryError)
_DAMAGED = (ZstdError, RuntimeError, *_BROKEN)  # lz4 raises RuntimeError

Progress = Callable[[int, int], None]  # bytes done, bytes in all


@dataclass
class Recovery:
    """What was saved.

    Attributes:
        folder: the new bag.
        counts: messages per topic.
        first, last: log times of what was saved, ns since the epoch.
        lost_bytes: at the end of the file that breaks off.
        damaged: chunks whose content does not agree with its check sum.
    """

    folder: Path
    counts: dict[str, int] = field(default_factory=dict)
    first: int = 0
    last: int = 0
    lost_bytes: int = 0
    damaged: int = 0


@dataclass
class _Scan:
    """One file as it is read from its beginning."""

    path: Path
    whole: bool = False
    damaged: int = 0
    end: int = 0  # of the last record that could be read

    def records(self, progress: Progress | None = None) -> Iterator[Any]:
        """Every record that can be read, those of intact chunks one by one."""
        size = self.path.stat().st_size
        self.whole, self.damaged = False, 0
        with self.path.open("rb") as stream:
            records = StreamReader(stream, emit_chunks=True).records
            while True:
                try:
                    record = next(records)
                except StopIteration:
                    self.whole = True
                    return
                except _BROKEN:
                    return
                self.end = stream.tell()
                if progress is not None:
                    progress(self.end, size)
                if not isinstance(record, Chunk):
                    yield record
                    continue
                try:
                    inside = breakup_chunk(record, validate_crc=True)
                except _DAMAGED:
                    self.damaged += 1
                    continue
                yield from inside


def recover(path: Path, progress: Callable[[Path], Progress] | None = None) -> Recovery:
    """Rebuild a cut-off bag into a new folder beside it, which is named after it.

    Args:
        path: of an ``.mcap`` file or of a bag's folder.
        progress: called with each file, gives what to call while it is read.

    Raises:
        BagError: it is whole, was recovered before, is no ROS 2 recording or holds nothing, or cannot be written.
    """
    files = _files(path)
    whole_path = path.resolve()
    folder = whole_path.with_name(whole_path.name.removesuffix(".mcap") + SUFFIX)
    if folder.exists():
        raise BagError(f"{path} was recovered before: {folder} is there")
    scans = [_Scan(file) for file in files]
    for scan in scans:
        for _ in scan.records(progress(scan.path) if progress else None):
            pass
    listed = not path.is_dir() or (path / METADATA_FILE).is_file()
    if all(scan.whole and not scan.damaged for scan in scans) and listed:
        raise BagError(f"{path} is whole: there is nothing to recover")
    working = folder.with_name(f".{folder.name}.{os.getpid()}")
    try:
        working.mkdir()
        result = _rebuild(scans, working, folder, progress)
        working.rename(folder)
    except OSError as error:
        raise BagError(f"cannot recover {path} into {folder}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(working, ignore_errors=True)
    return result


def _files(path: Path) -> list[Path]:
    try:
        if not path.is_dir():
            _check(path)
            return [path]
        files = sorted(path.glob("*.mcap"), key=lambda file: (len(file.name), file.name))
        if not files:
            raise BagError(f"folder {path} holds no .mcap file")
        if len(files) > 1 and len({_SPLIT.sub("", file.stem) for file in files}) > 1:
            raise BagError(f"folder {path} holds {len(files)} .mcap files of different bags; name one of them")
        for file in files:
            _check(file)
        return files
    except OSError as error:
        raise BagError(f"cannot read {path}: {error.strerror or error}") from error


def _check(file: Path) -> None:
    with file.open("rb") as stream:
        start = stream.read(len(MAGIC))
        if not start:
            raise BagError(f"{file} is empty")
        if start != MAGIC:
            raise BagError(f"{file} is not an MCAP file")


def _rebuild(scans: list[_Scan], working: Path, folder: Path, progress: Callable[[Path], Progress] | None) -> Recovery:
    result = Recovery(folder)
    summaries: list[FileSummary] = []
    topics: dict[str, TopicDescription] = {}
    for scan in scans:
        target = McapFile(working / scan.path.name, library="dextar recover")
        try:
            _copy(scan, target, topics, progress(scan.path) if progress else None)
            lost = 0 if scan.whole else scan.path.stat().st_size - scan.end
            target.add_metadata(RECOVERY_NAME, {"source": scan.path.name, "read_bytes": str(scan.end), "lost_bytes": str(lost),
                                                "damaged_chunks": str(scan.damaged)})  # fmt: skip
            target.finish({"recovered_from": scan.path.name})
        finally:
            target.stream.close()
        summary = target.summary()
        summaries.append(summary)
        result.lost_bytes += lost
        result.damaged += scan.damaged
        for name, count in summary.counts.items():
            result.counts[name] = result.counts.get(name, 0) + count
    filled = [summary for summary in summaries if sum(summary.counts.values())]
    if not filled:
        raise BagError(f"{scans[0].path} holds no complete message: nothing can be recovered")
    result.first, result.last = min(summary.first for summary in filled), max(summary.last for summary in filled)
    write_metadata_file(working, summaries, topics.values(), {"recovered_from": scans[0].path.parent.name})
    return result


def _copy(scan: _Scan, target: McapFile, topics: dict[str, TopicDescription], progress: Progress | None) -> None:
    schemas: dict[int, Schema] = {}
    channels: dict[int, str] = {}
    for record in scan.records(progress):
        if isinstance(record, Message):
            if record.channel_id not in channels:
                raise BagError(f"{scan.path} is damaged: a message is of channel {record.channel_id}, which no record describes")
            name = channels[record.channel_id]
            target.write([Sample(record.log_time, name, record.publish_time, record.sequence, record.data)])
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel) and record.id not in channels:
            topic = _topic(scan.path, record, schemas.get(record.schema_id))
            if topics.setdefault(topic.name, topic).type != topic.type:
                raise BagError(f"{scan.path}: {topic.name} is a {topics[topic.name].type} and a {topic.type}")
            channels[record.id] = topic.name
            target.register(topic)
        elif isinstance(record, Metadata) and record.name != RECORD_NAME:
            target.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            target.attach(record)
        elif isinstance(record, Header) and record.profile != "ros2":
            raise BagError(f"{scan.path} is no ROS 2 recording: its profile is '{record.profile}'")


def _topic(path: Path, channel: Channel, schema: Schema | None) -> TopicDescription:
    if schema is None or channel.message_encoding != "cdr":
        raise BagError(f"{path}: {channel.topic} is no ROS 2 topic: its messages are '{channel.message_encoding}'")
    details: Mapping[str, str] = channel.metadata
    try:
        qos = yaml.safe_load(details.get("offered_qos_profiles", "")) or []
    except yaml.YAMLError:
        qos = []
    text = schema.data.decode("utf-8", errors="replace")
    return TopicDescription(channel.topic, schema.name, qos, text, details.get("topic_type_hash", ""), schema.encoding)
