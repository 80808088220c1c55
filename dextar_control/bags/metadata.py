"""rosbag2's BagMetadata, version 9: in ``metadata.yaml`` and in each file's own
record.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import yaml

from dextar_control.bags.folder import METADATA_FILE as METADATA_FILE
from dextar_control.bags.folder import METADATA_ROOT

RECORD_NAME = "rosbag2"
_NEVER = 2**63 - 1  # rosbag2's starting time of a bag without messages, ns

Qos = Mapping[str, object]


class TopicDescription(NamedTuple):
    """What a bag says of one topic."""

    name: str
    type: str
    qos: Sequence[Qos]  # as its publishers offered it
    definition: str
    digest: str  # REP-2016 hash of the type
    encoding: str = "ros2msg"  # of the definition


class FileSummary(NamedTuple):
    """What a bag says of one of its files; times in ns since the epoch, of
    reception.
    """

    name: str
    first: int
    last: int
    counts: dict[str, int]  # messages per topic


def bag_metadata(
    files: Sequence[FileSummary],
    topics: Iterable[TopicDescription],
    custom: Mapping[str, str] | None = None,
) -> str:
    """Return the BagMetadata as YAML, with its keys in rosbag2's order."""
    return _dump(_document(files, topics, custom or {}))


def qos_text(profiles: Sequence[Qos]) -> str:
    """Return a list of profiles as a channel's ``offered_qos_profiles``."""
    return _dump([dict(profile) for profile in profiles]).strip()


def write_metadata_file(
    folder: Path,
    files: Sequence[FileSummary],
    topics: Iterable[TopicDescription],
    custom: Mapping[str, str] | None = None,
) -> None:
    """Write ``metadata.yaml``, whole or not at all, and never over another.

    Raises:
        OSError: it exists already, or cannot be written.
    """
    temporary = folder / f".{METADATA_FILE}.{os.getpid()}"
    try:
        with temporary.open("w", encoding="utf-8") as stream:
            stream.write(_dump({METADATA_ROOT: _document(files, topics, custom or {})}))
            stream.flush()
            os.fsync(stream.fileno())
        os.link(temporary, folder / METADATA_FILE)
    finally:
        temporary.unlink(missing_ok=True)


def _document(
    files: Sequence[FileSummary],
    topics: Iterable[TopicDescription],
    custom: Mapping[str, str],
) -> dict[str, object]:
    total: dict[str, int] = {}
    for file in files:
        for name, count in file.counts.items():
            total[name] = total.get(name, 0) + count
    filled = [file for file in files if sum(file.counts.values())]
    first = min((file.first for file in filled), default=0)
    last = max((file.last for file in filled), default=0)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        **_span(first, last, sum(total.values())),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [dict(profile) for profile in topic.qos],
                    "type_description_hash": topic.digest,
                },
                "message_count": total.get(topic.name, 0),
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [{"path": file.name, **_file_span(file)} for file in files],
        "custom_data": dict(custom),
        "ros_distro": os.environ.get("ROS_DISTRO", "jazzy"),
    }


def _span(first: int, last: int, count: int) -> dict[str, object]:
    return {
        "duration": {"nanoseconds": last - first if count else 0},
        "starting_time": {"nanoseconds_since_epoch": first if count else _NEVER},
        "message_count": count,
    }


def _file_span(file: FileSummary) -> dict[str, object]:
    span = _span(file.first, file.last, sum(file.counts.values()))
    return {key: span[key] for key in ("starting_time", "duration", "message_count")}


def _dump(document: object) -> str:
    """Return YAML without anchors, which rosbag2 does not read: no part stands in it
    twice.
    """
    parts = json.loads(json.dumps(document))
    return str(yaml.safe_dump(parts, sort_keys=False, allow_unicode=True))
