"""A whole bag from one that is damaged or breaks off: every intact message, an index,
rosbag2's metadata. Needs no ROS.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import yaml
from mcap.records import Attachment, Channel, Metadata, Schema

from dextar_control.bags.compression import ZSTD, plain_name, unpack_message
from dextar_control.bags.damage import Hole
from dextar_control.bags.folder import (
    METADATA_FILE,
    BagFiles,
    check_one_recording,
    files_of,
    opened,
    read_listing,
)
from dextar_control.bags.mcap_file import McapFile, SerializedMessage
from dextar_control.bags.metadata import (
    RECORD_NAME,
    FileSummary,
    Qos,
    TopicDescription,
    write_metadata_file,
)
from dextar_control.bags.scan import (
    MAGIC,
    PER_MESSAGE,
    RECOVERY_NAME,
    Messages,
    Progress,
    Scan,
)
from dextar_control.contract.errors import BagError, bag_errors

SUFFIX = "-recovered"
# Of a QoS profile in rosbag2's order: a type, or the words for the numbers of rmw that
# stand there before version 9.
QOS_KEYS: dict[str, type | list[str]] = {
    "history": "system_default keep_last keep_all unknown".split(),
    "depth": int,
    "reliability": "system_default reliable best_effort unknown best_available".split(),
    "durability": (
        "system_default transient_local volatile unknown best_available".split()
    ),
    "deadline": dict,
    "lifespan": dict,
    "liveliness": (
        "system_default automatic manual_by_node manual_by_topic unknown"
        " best_available".split()
    ),
    "liveliness_lease_duration": dict,
    "avoid_ros_namespace_conventions": bool,
}


@dataclass
class Recovery:
    """What was saved of a bag.

    Attributes:
        folder: the new bag.
        counts: messages per topic.
        first, last: log times of what was saved, ns since the epoch.
        lost_bytes: at the end of the file that breaks off.
        holes: what was missing already, each damaged chunk among it.
        metadata: what was wrong with ``metadata.yaml``.
        left_out: messages that were not copied, per channel and reason.
        unpacked: messages that the recorder had compressed one by one.
    """

    folder: Path
    counts: dict[str, int] = field(default_factory=dict)
    first: int = 0
    last: int = 0
    lost_bytes: int = 0
    holes: list[Hole] = field(default_factory=list)
    metadata: str = ""
    left_out: dict[tuple[str, str], int] = field(default_factory=dict)
    unpacked: int = 0

    def leave_out(self, channel: str, why: str, count: int = 0) -> None:
        """Note messages that are not copied."""
        self.left_out[channel, why] = self.left_out.get((channel, why), 0) + count


class _Content(NamedTuple):
    """How many messages a file holds.

    Attributes:
        messages: all of them.
        copied: those that can be copied: of a ROS 2 topic, and intact where they are
            compressed one by one.
        damaged: those of a channel that nothing describes, and damaged ones where they
            are compressed one by one.
    """

    messages: int
    copied: int
    damaged: int


def recover(path: Path, progress: Callable[[Path], Progress] | None = None) -> Recovery:
    """Rebuild a cut-off bag into a new folder beside it, which is named after it.

    Args:
        path: of an ``.mcap`` file or of a bag's folder.
        progress: called with each file, gives what to call while it is read.

    Raises:
        BagError: it is whole, was recovered before, holds nothing of ROS 2, or cannot
            be read or written.
    """
    # also of links in a circle, which are told when they are opened
    whole_path = Path(os.path.realpath(path))
    folder = whole_path.with_name(
        plain_name(whole_path.name).removesuffix(".mcap") + SUFFIX
    )
    if folder.exists():
        raise BagError(f"{path} was recovered before: {folder} is there")
    with bag_errors(f"read {path}"):
        files, _, fault = files_of(path) if path.is_dir() else BagFiles([path], [], "")
        with opened(files) as parts:
            for part in parts:
                if part.storage != MAGIC:
                    raise BagError(
                        f"{part.file} is not an MCAP file but a sqlite3 bag: dextar"
                        " recover takes MCAP alone"
                    )
            scans = [Scan(part.file, part.content) for part in parts]
            return _recover(path, scans, fault, folder, progress)


def _recover(
    path: Path,
    scans: list[Scan],
    fault: str,
    folder: Path,
    progress: Callable[[Path], Progress] | None,
) -> Recovery:
    contents = [
        _look(scan, progress(scan.path) if progress else None) for scan in scans
    ]
    if path.is_dir():
        if fault:
            check_one_recording(scans)
        else:
            fault = _wrong_counts(
                path,
                [scan.path for scan in scans],
                [content.messages for content in contents],
            )
    whole = all(scan.whole and not scan.damaged for scan in scans) and not any(
        content.damaged for content in contents
    )
    if whole and not fault:
        if not any(content.copied for content in contents):
            raise BagError(
                f"{path} holds no message of a ROS 2 topic: nothing can be recovered"
            )
        raise BagError(f"{path} is whole: there is nothing to recover")
    working = folder.with_name(f".{folder.name}.{os.getpid()}")
    try:
        with bag_errors(f"recover {path} into {folder}"):
            working.mkdir()
            result = _rebuild(scans, working, folder, progress)
            result.metadata = fault
            working.rename(folder)
    finally:
        shutil.rmtree(working, ignore_errors=True)
    return result


def _wrong_counts(folder: Path, files: Sequence[Path], counts: Sequence[int]) -> str:
    """Say what ``metadata.yaml`` counts wrongly; "" where it is right or does not
    count.
    """
    document = read_listing(folder).document
    told = {"the bag": (document.get("message_count"), sum(counts))}
    entries = document.get("files")
    for entry in entries if isinstance(entries, list) else []:
        for file, count in zip(files, counts, strict=True):
            if isinstance(entry, dict) and plain_name(
                str(entry.get("path"))
            ) == plain_name(file.name):
                told[file.name] = entry.get("message_count"), count
    for name, (said, count) in told.items():
        if said is not None and said != count:
            return (
                f"{METADATA_FILE} says that {name} has {said} messages; there are"
                f" {count}"
            )
    return ""


def _look(scan: Scan, progress: Progress | None) -> _Content:
    ours: dict[int, bool] = {}
    schemas: set[int] = set()
    messages = copied = damaged = 0
    for record in scan.records(progress):
        if isinstance(record, Schema):
            schemas.add(record.id)
        elif isinstance(record, Channel):
            ours[record.id] = (
                record.message_encoding == "cdr" and record.schema_id in schemas
            )
        elif isinstance(record, Messages):
            for channel, _, _, _, data, _ in _unpacked(record):
                known = ours.get(channel)
                messages += 1
                copied += known is True and data is not None
                damaged += known is None or (known and data is None)
    return _Content(messages, copied, damaged)


def _unpacked(
    batch: Messages,
) -> Iterator[tuple[int, int, int, int, bytes | None, bool]]:
    """Yield channel, sequence, log and publish time (ns) and content of each message,
    and whether it was compressed by itself; None for content that is damaged.
    """
    numbers = iter(batch.numbers)
    for channel, sequence, log_time, publish_time, begin, end in zip(
        *[numbers] * PER_MESSAGE, strict=True
    ):
        data = batch.data[begin:end]
        packed = data.startswith(ZSTD)
        content = unpack_message(data) if packed else data
        yield channel, sequence, log_time, publish_time, content, packed


def _rebuild(
    scans: list[Scan],
    working: Path,
    folder: Path,
    progress: Callable[[Path], Progress] | None,
) -> Recovery:
    result = Recovery(folder)
    summaries: list[FileSummary] = []
    topics: dict[str, TopicDescription] = {}
    for scan in scans:
        target = McapFile(
            working / plain_name(scan.path.name), library="dextar recover"
        )
        try:
            _copy(
                scan, target, topics, result, progress(scan.path) if progress else None
            )
            lost = 0 if scan.whole else scan.size - scan.end
            target.add_metadata(
                RECOVERY_NAME,
                {
                    "source": scan.path.name,
                    "read_bytes": str(scan.end),
                    "lost_bytes": str(lost),
                    "damaged_chunks": str(scan.damaged),
                    **scan.recovery_details(),
                },
            )
            target.finish({"recovered_from": scan.path.name})
        finally:
            target.stream.close()
        summary = target.summary()
        summaries.append(summary)
        result.lost_bytes += lost
        result.holes += scan.holes
        for name, count in summary.counts.items():
            result.counts[name] = result.counts.get(name, 0) + count
    filled = [summary for summary in summaries if any(summary.counts.values())]
    if not filled:
        left = "; ".join(f"messages of {name}: {why}" for name, why in result.left_out)
        what = f"message of a ROS 2 topic ({left})" if left else "complete message"
        raise BagError(f"{scans[0].path} holds no {what}: nothing can be recovered")
    result.first, result.last = (
        min(summary.first for summary in filled),
        max(summary.last for summary in filled),
    )
    write_metadata_file(
        working,
        summaries,
        topics.values(),
        {"recovered_from": scans[0].path.parent.name},
    )
    return result


def _copy(
    scan: Scan,
    target: McapFile,
    topics: dict[str, TopicDescription],
    result: Recovery,
    progress: Progress | None,
) -> None:
    schemas: dict[int, Schema] = {}
    channels: dict[int, str] = {}
    others: dict[int, tuple[str, str]] = {}
    for record in scan.records(progress):
        if isinstance(record, Messages):
            for channel, sequence, log_time, publish_time, data, packed in _unpacked(
                record
            ):
                if channel not in channels:
                    unknown = (
                        f"channel {channel}, which no record describes",
                        "nothing says what they are",
                    )
                    result.leave_out(*others.get(channel, unknown), 1)
                    continue
                topic = channels[channel]
                if data is None:
                    result.leave_out(topic, "their compressed content is damaged", 1)
                    continue
                result.unpacked += packed
                message = SerializedMessage(
                    log_time, topic, publish_time, sequence, data
                )
                target.write([message])
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel) and record.id not in channels:
            schema = schemas.get(record.schema_id)
            if schema is None or record.message_encoding != "cdr":
                why = (
                    f"its messages are '{record.message_encoding}'"
                    if schema
                    else "it has no schema"
                )
                others[record.id] = record.topic, f"it is no ROS 2 topic, {why}"
                result.leave_out(*others[record.id])
                continue
            found = _topic(record, schema)
            before = topics.setdefault(found.name, found).type
            if before != found.type:
                why = f"it is a {before} before, and a {found.type} here"
                others[record.id] = found.name, why
                continue
            channels[record.id] = found.name
            target.register(found)
        elif isinstance(record, Metadata) and record.name != RECORD_NAME:
            target.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            target.attach(record)


def _topic(channel: Channel, schema: Schema) -> TopicDescription:
    details: Mapping[str, str] = channel.metadata
    return TopicDescription(
        channel.topic,
        schema.name,
        _profiles(details.get("offered_qos_profiles", "")),
        schema.data.decode("utf-8", errors="replace"),
        details.get("topic_type_hash", ""),
        schema.encoding,
    )


def _profiles(text: str) -> list[Qos]:
    """Read the offered QoS profiles that version 9 of rosbag2's metadata can hold, with
    words for what earlier versions wrote as numbers.
    """
    try:
        listed = yaml.safe_load(text)
    # what PyYAML raises at content that is no YAML
    except (yaml.YAMLError, ValueError, AttributeError, RecursionError):
        return []
    return [
        found
        for profile in (listed if isinstance(listed, list) else [])
        if (found := _profile(profile)) is not None
    ]


def _profile(profile: object) -> Qos | None:
    if not isinstance(profile, dict):
        return None
    found: dict[str, object] = {}
    for key, kind in QOS_KEYS.items():
        value = profile.get(key)
        if isinstance(kind, list):
            value = (
                kind[value] if type(value) is int and 0 <= value < len(kind) else value
            )
            good = isinstance(value, str)
        elif kind is dict:
            good = isinstance(value, dict) and all(
                type(value.get(part)) is int for part in ("sec", "nsec")
            )
        else:
            good = type(value) is kind
        if not good:
            return None
        found[key] = value
    return found
