"""A whole bag from one that is damaged or breaks off: every intact message, an index, rosbag2's metadata. Needs no ROS."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from dextar_control.bags.folder import (
    METADATA_FILE,
    check_one_recording,
    in_order,
    one_bag_by_name,
    read_listing,
    split_name,
)
from dextar_control.bags.records import MAGIC, PER_MESSAGE, RECOVERY_NAME, Messages, Progress, Scan
from dextar_control.contract.errors import BagError
from dextar_control.ros.bag_metadata import RECORD_NAME, FileSummary, TopicDescription, write_metadata_file
from dextar_control.ros.mcap_file import McapFile, Sample

SUFFIX = "-recovered"


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
    metadata: str = ""


def recover(path: Path, progress: Callable[[Path], Progress] | None = None) -> Recovery:
    """Rebuild a cut-off bag into a new folder beside it, which is named after it.

    Args:
        path: of an ``.mcap`` file or of a bag's folder.
        progress: called with each file, gives what to call while it is read.

    Raises:
        BagError: it is whole, was recovered before, is no ROS 2 recording or holds nothing, or cannot be written.
    """
    files, fault = _files(path)
    whole_path = path.resolve()
    folder = whole_path.with_name(whole_path.name.removesuffix(".mcap") + SUFFIX)
    if folder.exists():
        raise BagError(f"{path} was recovered before: {folder} is there")
    scans = [Scan(file) for file in files]
    counts = [_count(scan, progress(scan.path) if progress else None) for scan in scans]
    if path.is_dir():
        if fault:
            check_one_recording(scans)
        else:
            fault = _wrong_counts(path, files, counts)
    if all(scan.whole and not scan.damaged for scan in scans) and not fault:
        raise BagError(f"{path} is whole: there is nothing to recover")
    working = folder.with_name(f".{folder.name}.{os.getpid()}")
    try:
        working.mkdir()
        result = _rebuild(scans, working, folder, progress)
        result.metadata = fault
        working.rename(folder)
    except OSError as error:
        raise BagError(f"cannot recover {path} into {folder}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(working, ignore_errors=True)
    return result


def _files(path: Path) -> tuple[list[Path], str]:
    """(the bag's files in order, what is wrong with the list of them)."""
    try:
        files, fault = _files_of_folder(path) if path.is_dir() else ([path], "")
        for file in files:
            _check(file)
        return files, fault
    except OSError as error:
        raise BagError(f"cannot read {path}: {error.strerror or error}") from error


def _files_of_folder(folder: Path) -> tuple[list[Path], str]:
    files = in_order([*folder.glob("*.mcap")])
    if not files:
        raise BagError(f"folder {folder} holds no .mcap file")
    fault, listed = f"there was no {METADATA_FILE}", list[str]()
    if (folder / METADATA_FILE).is_file():
        try:
            document = read_listing(folder)
            fault, listed = "", document["relative_file_paths"]
        except BagError:
            fault = f"{METADATA_FILE} could not be read"
        else:
            if document.get("compression_mode"):
                raise BagError(f"{folder} was compressed by rosbag2 itself ({document['compression_mode']}): dextar recover"
                               " reads only MCAP's own compression")  # fmt: skip
    names = {split_name(Path(name))[0] for name in listed}
    own = [file for file in files if split_name(file)[0] in names] or files
    missing = [name for name in listed if not (folder / name).is_file()]
    more = [file.name for file in own if file.name not in listed]
    if listed and missing:
        fault = f"{METADATA_FILE} lists {', '.join(missing)}, which {'is' if len(missing) == 1 else 'are'} not there"
    elif listed and more:
        fault = f"{METADATA_FILE} does not list {', '.join(more)}"
    elif not listed and not fault:
        fault = f"{METADATA_FILE} lists no file"
    if not one_bag_by_name(own):
        raise BagError(f"folder {folder} holds {len(own)} .mcap files of different bags; name one of them")
    return own, fault


def _wrong_counts(folder: Path, files: Sequence[Path], counts: Sequence[int]) -> str:
    """What ``metadata.yaml`` says wrongly of its files; "" where it is right or does not say."""
    document = read_listing(folder)
    told = {"the bag": (document.get("message_count"), sum(counts))}
    entries = document.get("files")
    for entry in entries if isinstance(entries, list) else []:
        for file, count in zip(files, counts, strict=True):
            if isinstance(entry, dict) and entry.get("path") == file.name:
                told[file.name] = entry.get("message_count"), count
    for name, (said, count) in told.items():
        if said is not None and said != count:
            return f"{METADATA_FILE} says that {name} has {said} messages; there are {count}"
    return ""


def _count(scan: Scan, progress: Progress | None) -> int:
    """Messages of a file."""
    return sum(len(record.numbers) for record in scan.records(progress) if isinstance(record, Messages)) // PER_MESSAGE


def _check(file: Path) -> None:
    with file.open("rb") as stream:
        start = stream.read(len(MAGIC))
        if not start:
            raise BagError(f"{file} is empty")
        if start != MAGIC:
            raise BagError(f"{file} is not an MCAP file")


def _rebuild(scans: list[Scan], working: Path, folder: Path, progress: Callable[[Path], Progress] | None) -> Recovery:
    result = Recovery(folder)
    summaries: list[FileSummary] = []
    topics: dict[str, TopicDescription] = {}
    for scan in scans:
        target = McapFile(working / scan.path.name, library="dextar recover")
        try:
            _copy(scan, target, topics, progress(scan.path) if progress else None)
            lost = 0 if scan.whole else scan.path.stat().st_size - scan.end
            target.add_metadata(RECOVERY_NAME, {"source": scan.path.name, "read_bytes": str(scan.end), "lost_bytes": str(lost),
                                                "damaged_chunks": str(scan.damaged), **scan.told()})  # fmt: skip
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


def _copy(scan: Scan, target: McapFile, topics: dict[str, TopicDescription], progress: Progress | None) -> None:
    schemas: dict[int, Schema] = {}
    channels: dict[int, str] = {}
    for record in scan.records(progress):
        if isinstance(record, Messages):
            numbers = iter(record.numbers)
            for channel, sequence, log_time, publish_time, begin, end in zip(*[numbers] * PER_MESSAGE, strict=True):
                if channel not in channels:
                    raise BagError(f"{scan.path} is damaged: a message is of channel {channel}, which no record describes")
                target.write([Sample(log_time, channels[channel], publish_time, sequence, record.data[begin:end])])
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
