"""One bag under way holds the samples and a record of the run; the diagnostics tell of
it.
"""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import parameter_value_to_python
from rclpy.serialization import deserialize_message
from rclpy.utilities import get_rmw_implementation_identifier

from dextar_control.bags.run_record import METADATA_NAME, RunRecord
from dextar_control.bags.writer import BagWriter
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.topics import TOPICS
from dextar_control.nodekit.node import DextarNode
from dextar_control.nodekit.parameter_snapshot import ParameterSnapshot, unanswered
from dextar_control.nodekit.qos_profiles import describe
from dextar_control.nodes.recorded_topics import RecordedTopic

# s between two records of what was counted so far: what a killed recorder still says
METADATA_PERIOD = 10
LOW_SPACE = 300.0  # s of recording that still fit the disk, from which on it is said
LABELS = ("name", "notes", "tags")


class BagRecording:
    """A bag, its record of the run and its counts.

    Args:
        node: the recorder.
        path: of the new ``.mcap`` file.
        topics: that are recorded; more may be added while it runs.
        snapshots: of the other nodes' parameters; asked for anew.

    Attributes:
        writer: of the bag.
        record: of the run.

    Raises:
        BagError: the bag cannot be made.
    """

    def __init__(
        self,
        node: DextarNode,
        path: Path,
        topics: Sequence[RecordedTopic],
        snapshots: Sequence[ParameterSnapshot],
    ) -> None:
        values = node.values
        self.writer = BagWriter(
            path,
            values["bag.compression"],
            max_size=values["bag.max_size"],
            max_duration=values["bag.max_duration"],
            sync_period=values["bag.sync_period"],
            folder=True,
        )
        self.record = RunRecord(
            {key: values[f"run.{key}"] for key in LABELS},
            get_rmw_implementation_identifier(),
        )
        self._node, self._topics, self._snapshots = node, topics, snapshots
        self._known: tuple[object, ...] = ()
        self._seconds = 0
        for snapshot in snapshots:
            snapshot.renew()
        self.writer.add_metadata(METADATA_NAME, self._texts())
        self._begun = time.monotonic()
        now = time.time_ns()
        for recorded in topics:
            recorded.losses.restart()
            for sample in recorded.kept or ():
                self.describe(recorded)
                self.writer.add(sample._replace(log_time=now))

    def describe(self, recorded: RecordedTopic) -> None:
        """Add a topic to the bag as its publishers offer it, at its first sample."""
        offered = [
            info.qos_profile
            for info in self._node.get_publishers_info_by_topic(recorded.name)
        ]
        profiles = [describe(profile) for profile in offered]
        self.writer.add_topic(
            recorded.name, recorded.type, profiles, standing=recorded.kept is not None
        )

    def hear_diagnostics(self, data: bytes, _: int) -> None:
        """Keep the plan's certificate, which diagnostics tell."""
        own = self._node.get_namespace().rstrip("/")
        for status in deserialize_message(data, DiagnosticArray).status:
            if status.name.rpartition("/")[0] == own:
                for entry in status.values:
                    if entry.key == "certificate":
                        self.record.note_certificate(entry.value)

    def hear_parameter_event(self, data: bytes, received: int) -> None:
        """Keep a change of a node's parameters.

        Args:
            data: the event as CDR bytes.
            received: ns.
        """
        event = deserialize_message(data, ParameterEvent)
        for parameter in event.changed_parameters:
            self.record.note_change(
                received,
                event.node,
                parameter.name,
                parameter_value_to_python(parameter.value),
            )

    def on_second(self) -> None:
        """Write what has become known of the run, and now and then what was counted."""
        self._seconds += 1
        record = self.record
        known = (
            unanswered(self._snapshots),
            dict(record.labels),
            record.certificate,
            len(record.changes),
        )
        if known != self._known or self._seconds % METADATA_PERIOD == 0:
            self._known = known
            self.writer.add_metadata(METADATA_NAME, self._texts())

    def end(self) -> None:
        """Finish the bag.

        Raises:
            BagError: it is not whole or ended early.
        """
        ended = datetime.now(timezone.utc)
        self.writer.close(
            {METADATA_NAME: self._texts(ended)},
            self.record.custom_data(self._parameters()),
        )

    def status(self) -> tuple[bytes, str, dict[str, object]]:
        """Return level, message and values for ``/diagnostics``."""
        writer = self.writer
        level, message = DiagnosticStatus.OK, f"recording to {writer.path}"
        free = _free_space(writer.path.parent)
        elapsed = time.monotonic() - self._begun
        lasts = free * elapsed / writer.size if writer.size else math.inf
        if writer.error is not None:
            level, message = DiagnosticStatus.ERROR, str(writer.error)
        elif self.lost:
            level, message = DiagnosticStatus.WARN, f"{self.lost} samples lost"
        elif lasts < LOW_SPACE:
            level, message = DiagnosticStatus.WARN, f"the disk is full in {lasts:.0f} s"
        values: dict[str, object] = {
            "recording": writer.error is None,
            "bag": writer.path,
            "bytes": writer.size,
            "bytes_on_disk": writer.synced,
            "files": len(writer.paths),
            "pending": len(writer),
            "disk_free_bytes": free,
        }
        for name, counts in self._counts().items():
            values[f"{name} received"] = counts["received"]
            values[f"{name} lost"] = (
                "unknown"
                if counts["lost"] is None
                else counts["lost"] + (counts["dropped"] or 0)
            )
        return level, message, values

    @property
    def lost(self) -> int:
        """How many samples of all topics are not in the bag."""
        return sum(recorded.losses.lost for recorded in self._topics) + sum(
            self.writer.dropped.values()
        )

    @property
    def written(self) -> int:
        """How many samples are, or will be, in the bag."""
        return sum(recorded.losses.received for recorded in self._topics) - sum(
            self.writer.dropped.values()
        )

    def _counts(self) -> dict[str, dict[str, int | None]]:
        """Return, per topic, samples received, lost on the way (None: not numbered) and
        dropped before the disk.
        """
        return {
            recorded.name: {
                "received": recorded.losses.received,
                "lost": recorded.losses.lost if recorded.losses.supported else None,
                "dropped": self.writer.dropped.get(recorded.name, 0),
            }
            for recorded in self._topics
        }

    def _parameters(self) -> Mapping[str, dict[str, ParameterValue]]:
        node = self._node
        others = {
            snapshot.target: snapshot.values
            for snapshot in self._snapshots
            if snapshot.values is not None
        }
        return {node.get_name(): dict(node.values), **others}

    def _texts(self, ended: datetime | None = None) -> dict[str, str]:
        resolved = {
            recorded.topic.name: recorded.name
            for recorded in self._topics
            if recorded.topic in TOPICS
        }
        return self.record.texts(
            self._parameters(),
            resolved,
            self._counts(),
            unanswered(self._snapshots),
            ended,
        )


def _free_space(folder: Path) -> float:
    """Return the bytes that the disk still has; nan when it cannot be asked."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return math.nan
