"""A bag written by its own thread: queue, synchronisation with the disk, splitting,
``metadata.yaml``.
"""

from __future__ import annotations

import bisect
import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from dextar_control.bags import mcap_file
from dextar_control.bags.mcap_file import McapFile, SerializedMessage
from dextar_control.bags.message_definitions import definition, type_hash
from dextar_control.bags.metadata import (
    METADATA_FILE,
    FileSummary,
    Qos,
    TopicDescription,
    write_metadata_file,
)
from dextar_control.contract.errors import BagError

DRAIN_PERIOD = 0.1  # s
SYNC_PERIOD = 1.0  # s
MAX_PENDING = 300_000  # samples that may wait for the disk ...
MAX_PENDING_BYTES = 256 * 1024 * 1024  # ... and their bytes
SLICE = 200  # samples between two looks at a file's size


class BagWriter:
    """Takes messages from one thread and writes them to a bag from another.

    Args:
        path: of the new ``.mcap`` file; its folder is made. A bag that is split has
            ``_0``, ``_1``, ... before the suffix.
        compression: ``zstd`` or ``none``, per chunk.
        max_size: bytes of a file from which on the next begins; 0 does not split.
        max_duration: s of a file after which the next begins; 0 does not split.
        sync_period: s between two times that the disk is waited for: what a power cut
            can cost.
        folder: the file's folder is the bag: ``metadata.yaml`` goes beside it at the
            end.

    Attributes:
        path: of the file under way.
        paths: of all files of the bag.
        error: why the writing ended early, or None.
        dropped: samples per topic that found the queue full or the writing ended.

    Raises:
        BagError: the file or the folder's ``metadata.yaml`` exists, or it cannot be
            made.
    """

    def __init__(
        self,
        path: Path,
        compression: str = "zstd",
        *,
        max_size: int = 0,
        max_duration: float = 0.0,
        sync_period: float = SYNC_PERIOD,
        folder: bool = False,
    ) -> None:
        self.error: BagError | None = None
        self.dropped: dict[str, int] = {}
        self.paths: list[Path] = []
        self._target = path
        self._compression = compression
        self._max_size, self._max_duration = max_size, round(max_duration * 1e9)
        self._sync_period = sync_period
        self._folder = folder
        self._pending: deque[SerializedMessage | Callable[[], None]] = deque()
        self._bytes_in = self._bytes_out = 0
        self._stop = threading.Event()
        self._topics: dict[str, TopicDescription] = {}
        # last sample of what is said once
        self._standing: dict[str, SerializedMessage | None] = {}
        self._metadata: dict[str, dict[str, str]] = {}
        self._custom: dict[str, str] = {}
        self._done: list[FileSummary] = []
        self._earlier = 0  # bytes of the files before the one under way
        self._closed = False
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if folder and (path.parent / METADATA_FILE).exists():
                raise BagError(
                    f"cannot record to {path}: {path.parent} holds another bag's"
                    f" {METADATA_FILE}; name another folder"
                )
            self._file = self._open()
        except FileExistsError as error:
            if not path.parent.is_dir():
                raise BagError(
                    f"cannot record to {path}: Not a directory: {path.parent}; name"
                    " another output"
                ) from error
            raise BagError(
                f"cannot record to {path}: it exists already; name another output or"
                " remove it"
            ) from error
        except OSError as error:
            raise BagError(
                f"cannot record to {path}: {error.strerror or error}"
            ) from error
        self._thread = threading.Thread(
            target=self._run, name="bag writer", daemon=True
        )
        self._thread.start()

    def __len__(self) -> int:
        """Samples waiting to be written."""
        return len(self._pending)

    @property
    def path(self) -> Path:
        """The file that is being written."""
        return self.paths[-1]

    @property
    def size(self) -> int:
        """Bytes written, of all files."""
        return self._earlier + self._file.stream.complete

    @property
    def synced(self) -> int:
        """Bytes of all files that the disk is known to have."""
        return self._earlier + self._file.stream.synced

    def has_topic(self, topic: str) -> bool:
        """Tell whether the topic was added."""
        return topic in self._topics

    def add_topic(
        self, topic: str, type_name: str, qos: Sequence[Qos], *, standing: bool = False
    ) -> None:
        """Describe a topic, before its first message.

        Args:
            topic: its name.
            type_name: of its messages.
            qos: as each publisher offers it.
            standing: its last sample holds until the next one comes: each file of a
                split bag begins with it, logged at the time of the split.

        Raises:
            BagError: no definition of the type is installed.
        """
        description = TopicDescription(
            topic, type_name, list(qos), definition(type_name), type_hash(type_name)
        )
        self._topics[topic] = description
        if standing:
            self._standing[topic] = None
        self._pending.append(lambda: self._file.register(description))

    def add(self, sample: SerializedMessage) -> None:
        """Queue a message; a full queue drops and counts it."""
        waiting = self._bytes_in - self._bytes_out
        if (
            len(self._pending) >= MAX_PENDING
            or waiting > MAX_PENDING_BYTES
            or self.error is not None
        ):
            self._drop(sample)
            return
        self._bytes_in += len(sample.data)
        self._pending.append(sample)

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Queue a metadata record. A later one of the same name replaces it for the
        reader; each file has the last.
        """
        copy = dict(data)

        def write() -> None:
            self._metadata[name] = copy
            self._file.add_metadata(name, copy)

        self._pending.append(write)

    def close(
        self,
        metadata: Mapping[str, Mapping[str, str]] | None = None,
        custom: Mapping[str, str] | None = None,
    ) -> None:
        """Write what waits, the metadata records, index and end; then wait for the
        disk.

        Args:
            metadata: last records, per name.
            custom: goes to ``custom_data`` of rosbag2's metadata.

        Raises:
            BagError: the recording ended early, or the bag is not whole; what was
                written can be read.
        """
        if not self._closed:
            self._closed = True
            self._stop.set()
            self._thread.join()
            self._custom = dict(custom or {})
            try:
                if not self._file.stream.closed and (
                    self.error is None or self._file.stream.full is not None
                ):
                    for name, data in (metadata or {}).items():
                        self._file.add_metadata(name, data)
                    self._finish()
            except OSError as error:
                self._fail(error)
            finally:
                self._file.stream.close()
            self._write_metadata_file()
        if self.error is not None:
            raise self.error

    def _open(self) -> McapFile:
        splits = self._max_size or self._max_duration
        target = self._target
        path = (
            target.with_name(f"{target.stem}_{len(self.paths)}{target.suffix}")
            if splits
            else target
        )
        chunk = min(mcap_file.CHUNK_SIZE, self._max_size // 4 or mcap_file.CHUNK_SIZE)
        file = McapFile(path, self._compression, chunk)
        self.paths.append(path)
        return file

    def _run(self) -> None:
        synced = time.monotonic()
        try:
            while self.error is None:
                stopping = self._stop.wait(DRAIN_PERIOD)
                self._drain()
                if stopping or time.monotonic() - synced >= self._sync_period:
                    self._file.sync()
                    synced = time.monotonic()
                full = self._file.stream.full
                if full is not None:
                    self._end(f"{full.strerror}; the bag is whole up to there")
                if stopping:
                    return
        except OSError as error:
            self._fail(error)
        except Exception as error:  # a bug must end the recording aloud, not silently
            self._end(repr(error))

    def _drain(self) -> None:
        """Write all that waits; between two other records messages go by log time."""
        batch: list[SerializedMessage] = []
        for _ in range(len(self._pending)):
            item = self._pending.popleft()
            if isinstance(item, SerializedMessage):
                batch.append(item)
            else:
                self._write(batch)
                batch = []
                item()
        self._write(batch)

    def _write(self, batch: list[SerializedMessage]) -> None:
        batch.sort(key=_log_time)
        start = 0
        try:
            while start < len(batch):
                if self._is_due(batch[start].log_time):
                    self._split(batch[start].log_time)
                end = self._slice_end(batch, start)
                part = batch[start:end]
                self._file.write(part)
                self._standing.update(
                    {
                        sample.topic: sample
                        for sample in part
                        if sample.topic in self._standing
                    }
                )
                self._bytes_out += sum(len(sample.data) for sample in part)
                start = end
        finally:
            for sample in batch[start:]:  # none, unless the disk failed
                self._drop(sample)

    def _is_due(self, log_time: int) -> bool:
        file = self._file
        if not file.first:
            return False
        if self._max_size and file.stream.complete >= self._max_size:
            return True
        return bool(self._max_duration) and log_time - file.first >= self._max_duration

    def _slice_end(self, batch: list[SerializedMessage], start: int) -> int:
        end = min(start + SLICE, len(batch)) if self._max_size else len(batch)
        if self._max_duration:
            limit = (self._file.first or batch[start].log_time) + self._max_duration
            end = min(
                end, max(start + 1, bisect.bisect_left(batch, limit, key=_log_time))
            )
        return end

    def _split(self, log_time: int) -> None:
        self._finish()
        earlier = self._earlier + self._file.stream.complete
        self._file = self._open()
        self._earlier = earlier
        for description in list(self._topics.values()):
            self._file.register(description)
        for name, data in self._metadata.items():
            self._file.add_metadata(name, data)
        self._file.write(
            [
                sample._replace(log_time=log_time)
                for sample in self._standing.values()
                if sample is not None
            ]
        )

    def _finish(self) -> None:
        self._file.finish(self._custom)
        self._done.append(self._file.summary())

    def _write_metadata_file(self) -> None:
        if not self._folder or len(self._done) < len(self.paths):
            return
        try:
            write_metadata_file(
                self.path.parent, self._done, self._topics.values(), self._custom
            )
        except OSError as error:
            if self.error is None:
                self.error = BagError(
                    f"{self.path} is whole, but {METADATA_FILE} beside it:"
                    f" {error.strerror or error}"
                )

    def _fail(self, error: OSError) -> None:
        stream = self._file.stream
        why = error.strerror or str(error)
        if stream.closed:  # it ended well, and the next one could not be made
            self._end(f"{why}; the bag is whole up to there")
            return
        if isinstance(error, FileNotFoundError):
            self._end(why)
            return
        self._end(
            f"{why}; it can be read up to its last complete chunk ({stream.complete}"
            " bytes)"
        )
        with contextlib.suppress(OSError):
            stream.cut()

    def _end(self, why: str) -> None:
        self.error = BagError(f"recording to {self.path} stopped: {why}")
        for item in list(self._pending):
            if isinstance(item, SerializedMessage):
                self._drop(item)
        self._pending.clear()

    def _drop(self, sample: SerializedMessage) -> None:
        self.dropped[sample.topic] = self.dropped.get(sample.topic, 0) + 1


def _log_time(sample: SerializedMessage) -> int:
    return sample.log_time
