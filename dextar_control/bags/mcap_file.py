"""One MCAP file in rosbag2's layout: profile ``ros2``, the definition, QoS and type
hash of each topic, its own summary.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, NamedTuple, cast

from mcap.records import Attachment
from mcap.writer import CompressionType, Writer

from dextar_control.bags.metadata import (
    RECORD_NAME,
    FileSummary,
    TopicDescription,
    bag_metadata,
    qos_text,
)
from dextar_control.bags.scan import LATEST
from dextar_control.bags.stream import RESERVE, BagStream

CHUNK_SIZE = 512 * 1024  # bytes before compression
INDEX_SIZE = 512  # most bytes that a write adds to the index at the end
COMPRESSIONS = {"zstd": CompressionType.ZSTD, "none": CompressionType.NONE}


class SerializedMessage(NamedTuple):
    """A message on its way to the bag; times in ns since the epoch."""

    log_time: int
    topic: str
    publish_time: int
    sequence: int
    data: bytes


class McapFile:
    """Writes one file; not thread-safe.

    Args:
        path: of the new file; its folder exists.
        compression: a key of COMPRESSIONS.
        chunk_size: bytes before compression.

    Attributes:
        stream: how far it is written.
        first, last: log times of what was written, ns; what is no time does not count.
        counts: messages per topic.

    Raises:
        OSError: the file exists or cannot be made.
    """

    def __init__(
        self,
        path: Path,
        compression: str = "zstd",
        chunk_size: int = CHUNK_SIZE,
        library: str = "dextar recorder",
    ) -> None:
        self.path = path
        self.first = self.last = 0
        self.counts: dict[str, int] = {}
        self._topics: dict[str, TopicDescription] = {}
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self.stream = BagStream(path)
        self._writer = Writer(
            cast(IO[bytes], self.stream),
            chunk_size=chunk_size,
            compression=COMPRESSIONS[compression],
        )
        try:
            self._writer.start(profile="ros2", library=library)
            self._describe_itself({})
        except OSError:
            self.stream.close()
            raise

    def register(self, topic: TopicDescription) -> None:
        """Describe a topic before its first message; to do it again does nothing."""
        if topic.name in self._topics:
            return
        if topic.type not in self._schemas:
            self._schemas[topic.type] = self._writer.register_schema(
                topic.type, topic.encoding, topic.definition.encode()
            )
        details = {
            "offered_qos_profiles": qos_text(topic.qos),
            "topic_type_hash": topic.digest,
        }
        self._topics[topic.name] = topic
        self._channels[topic.name] = self._writer.register_channel(
            topic.name, "cdr", self._schemas[topic.type], details
        )
        self.counts.setdefault(topic.name, 0)

    def write(self, batch: Sequence[SerializedMessage]) -> None:
        """Write messages in the order of their log times."""
        if not batch:
            return
        if batch[-1].log_time <= LATEST:
            self.first = min(self.first or batch[0].log_time, batch[0].log_time)
            self.last = max(self.last, batch[-1].log_time)
        add, channels, counts = self._writer.add_message, self._channels, self.counts
        for log_time, topic, publish_time, sequence, data in batch:
            counts[topic] += 1
            add(channels[topic], log_time, data, publish_time, sequence & 0xFFFFFFFF)

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Write a metadata record; readers take the last of a name."""
        self._writer.add_metadata(name, dict(data))

    def attach(self, attachment: Attachment) -> None:
        """Copy an attachment of another file."""
        self._writer.add_attachment(
            attachment.create_time,
            attachment.log_time,
            attachment.name,
            attachment.media_type,
            attachment.data,
        )

    def sync(self) -> None:
        """Close the chunk under way and wait until the disk has it; keep room for what
        the end will need.
        """
        self._writer.flush()  # type: ignore[no-untyped-call]  # mcap does not annotate it
        self.stream.reserve(RESERVE // 2 + INDEX_SIZE * self.stream.writes)
        self.stream.sync()

    def finish(self, custom: Mapping[str, str]) -> None:
        """Write rosbag2's record, the index and the end; wait for the disk."""
        self._describe_itself(custom)
        self._writer.finish()  # type: ignore[no-untyped-call]  # mcap does not annotate it
        self.stream.sync()
        self.stream.close()

    def summary(self) -> FileSummary:
        """Return what ``metadata.yaml`` says of this file."""
        return FileSummary(self.path.name, self.first, self.last, dict(self.counts))

    def _describe_itself(self, custom: Mapping[str, str]) -> None:
        text = bag_metadata([self.summary()], self._topics.values(), custom)
        self._writer.add_metadata(RECORD_NAME, {"serialized_metadata": text})
