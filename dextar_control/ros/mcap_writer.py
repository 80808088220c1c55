"""A bag in rosbag2's MCAP layout, written by its own thread.

Readers of either world take it: profile ``ros2``, ``ros2msg`` schemas, the QoS and type hash of
each channel, and rosbag2's own metadata record (BagMetadata version 9) at the end.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, NamedTuple, cast

import yaml
from mcap.writer import CompressionType, Writer

from dextar_control.contract.errors import BagError
from dextar_control.ros.message_definitions import definition, type_hash

CHUNK_SIZE = 512 * 1024
DRAIN_PERIOD = 0.1
FLUSH_PERIODS = 10  # a killed recorder loses at most this many drain periods
MAX_PENDING = 300_000
COMPRESSIONS = {"zstd": CompressionType.ZSTD, "none": CompressionType.NONE}

Qos = dict[str, object]


class Sample(NamedTuple):
    """One message on its way to the bag; times in ns since the epoch."""

    log_time: int
    topic: str
    publish_time: int
    sequence: int
    data: bytes


@dataclass
class _Channel:
    topic: str
    type: str
    qos: list[Qos]
    id: int
    count: int = 0


class _File:
    """An unbuffered stream that knows where its last whole write ended; mcap's Writer writes whole records."""

    def __init__(self, path: Path) -> None:
        self._file = open(path, "xb", buffering=0)  # noqa: SIM115
        self.tell, self.flush = self._file.tell, self._file.flush
        self.complete = 0

    @property
    def closed(self) -> bool:
        return self._file.closed

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        done = 0
        while done < len(view):
            done += self._file.write(view[done:]) or 0
        self.complete += done
        return done

    def cut(self) -> None:
        """Drop what came after the last whole write."""
        self._file.truncate(self.complete)

    def sync(self) -> None:
        os.fsync(self._file.fileno())

    def close(self) -> None:
        self._file.close()


class BagWriter:
    """Takes samples from any thread, writes them from one.

    Args:
        path: of the new ``.mcap`` file; its folder is made.
        compression: ``zstd`` or ``none``, per chunk.

    Attributes:
        error: why the writing ended early, or None.
        dropped: samples per topic that found the queue full.

    Raises:
        BagError: the file exists or cannot be made.
    """

    def __init__(self, path: Path, compression: str = "zstd") -> None:
        self.path = path
        self.error: BagError | None = None
        self.dropped: dict[str, int] = {}
        self._pending: deque[Sample | Callable[[], None]] = deque()
        self._stop = threading.Event()
        self._channels: dict[str, _Channel] = {}
        self._schemas: dict[str, int] = {}
        self._first = 0
        self._last = 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = _File(path)
        except FileExistsError as error:
            raise BagError(f"cannot record to {path}: it exists already; name another output or remove it") from error
        except OSError as error:
            raise BagError(f"cannot record to {path}: {error.strerror or error}") from error
        self._writer = Writer(cast(IO[bytes], self._file), chunk_size=CHUNK_SIZE, compression=COMPRESSIONS[compression])
        try:
            self._writer.start(profile="ros2", library="dextar recorder")
        except OSError as error:
            self._file.close()
            raise BagError(f"cannot record to {path}: {error.strerror or error}") from error
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._thread.start()

    def __len__(self) -> int:
        """Samples waiting to be written."""
        return len(self._pending)

    def has_topic(self, topic: str) -> bool:
        """Whether the topic was added."""
        return topic in self._channels

    def add_topic(self, topic: str, type_name: str, qos: Sequence[Qos]) -> None:
        """Describe a topic; before its first sample.

        Raises:
            BagError: no definition of the type is installed.
        """
        text, digest = definition(type_name), type_hash(type_name)
        self._channels[topic] = _Channel(topic, type_name, list(qos), 0)
        self._pending.append(lambda: self._register(topic, text, digest))

    def add(self, sample: Sample) -> None:
        """Queue one sample; a full queue drops and counts it."""
        if len(self._pending) >= MAX_PENDING or self.error is not None:
            self.dropped[sample.topic] = self.dropped.get(sample.topic, 0) + 1
            return
        self._pending.append(sample)

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Queue a metadata record; a later one of the same name replaces it for the reader."""
        copy = dict(data)
        self._pending.append(lambda: self._writer.add_metadata(name, copy))

    def close(self, metadata: Mapping[str, Mapping[str, str]] | None = None) -> None:
        """Write what waits, the metadata records, index and end; then wait for the disk.

        Raises:
            BagError: the bag is not whole; it can be read up to its last complete chunk.
        """
        if not self._file.closed:
            self._stop.set()
            self._thread.join()
            try:
                if self.error is None:
                    self._finish(metadata or {})
            except OSError as error:
                self._fail(error)
            finally:
                self._file.close()
        if self.error is not None:
            raise self.error

    def _run(self) -> None:
        periods = 0
        try:
            while True:
                stopping = self._stop.wait(DRAIN_PERIOD)
                self._drain()
                periods += 1
                if periods >= FLUSH_PERIODS or stopping:
                    self._writer.flush()
                    periods = 0
                if stopping:
                    return
        except OSError as error:
            self._fail(error)
        except Exception as error:  # a bug here must end the recording aloud, not silently
            self.error = BagError(f"recording to {self.path} stopped: {error!r}")

    def _drain(self) -> None:
        """Write all that waits, samples by log time between two other records."""
        batch: list[Sample] = []
        for _ in range(len(self._pending)):
            item = self._pending.popleft()
            if isinstance(item, Sample):
                batch.append(item)
            else:
                self._write(batch)
                batch = []
                item()
        self._write(batch)

    def _write(self, batch: list[Sample]) -> None:
        if not batch:
            return
        batch.sort(key=_log_time)
        self._first = min(self._first or batch[0].log_time, batch[0].log_time)
        self._last = max(self._last, batch[-1].log_time)
        add, channels = self._writer.add_message, self._channels
        for log_time, topic, publish_time, sequence, data in batch:
            channel = channels[topic]
            channel.count += 1
            add(channel.id, log_time, data, publish_time, sequence & 0xFFFFFFFF)

    def _register(self, topic: str, text: str, digest: str) -> None:
        channel = self._channels[topic]
        if channel.type not in self._schemas:
            self._schemas[channel.type] = self._writer.register_schema(channel.type, "ros2msg", text.encode())
        profiles = yaml.safe_dump(channel.qos, sort_keys=False).strip()
        details = {"offered_qos_profiles": profiles, "topic_type_hash": digest}
        channel.id = self._writer.register_channel(topic, "cdr", self._schemas[channel.type], details)

    def _finish(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        for name, data in metadata.items():
            self._writer.add_metadata(name, dict(data))
        self._writer.add_metadata("rosbag2", {"serialized_metadata": self._bag_metadata()})
        self._writer.finish()
        self._file.sync()

    def _fail(self, error: OSError) -> None:
        self.error = BagError(
            f"recording to {self.path} stopped: {error.strerror or error}; "
            f"it can be read up to its last complete chunk ({self._file.complete} bytes)"
        )
        try:
            self._file.cut()
        except OSError:
            pass

    def _bag_metadata(self) -> str:
        """rosbag2's BagMetadata, version 9, as YAML."""
        count = sum(channel.count for channel in self._channels.values())
        span = {
            "starting_time": {"nanoseconds_since_epoch": self._first},
            "duration": {"nanoseconds": self._last - self._first},
            "message_count": count,
        }
        topics = [
            {
                "topic_metadata": {
                    "name": channel.topic,
                    "type": channel.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": channel.qos,
                    "type_description_hash": type_hash(channel.type),
                },
                "message_count": channel.count,
            }
            for channel in self._channels.values()
        ]
        document = {
            "version": 9,
            "storage_identifier": "mcap",
            "relative_file_paths": [self.path.name],
            **span,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "files": [{"path": self.path.name, **span}],
            "custom_data": {},
            "ros_distro": os.environ.get("ROS_DISTRO", "jazzy"),
        }
        return yaml.dump(document, Dumper=_PlainDumper, sort_keys=False)


class _PlainDumper(yaml.SafeDumper):
    """YAML without anchors, which rosbag2 does not read."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def _log_time(sample: Sample) -> int:
    return sample.log_time
