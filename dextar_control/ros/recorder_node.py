"""Records every contract topic to MCAP, with all that is known of the run; says which samples it lost."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import parameter_value_to_python
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from dextar_control.contract.errors import BagError, DextarError, ParameterError
from dextar_control.contract.node import DextarNode, Parameter, StopSignal, run_node
from dextar_control.contract.topics import DIAGNOSTICS, TOPICS
from dextar_control.ros.mcap_writer import COMPRESSIONS, BagWriter, Sample
from dextar_control.ros.parameter_snapshot import ParameterSnapshot
from dextar_control.ros.qos_profiles import describe
from dextar_control.ros.run_record import METADATA_NAME, RunRecord
from dextar_control.ros.taps import ALONGSIDE, PARAMETER_EVENTS, Tap, found_topic, profile_of

EXIT_RECORDING = 1
POLL_PERIOD = 0.02  # s
LAST_WORDS = 0.3  # s given to samples under way when the recording ends
METADATA_PERIOD = 10  # s between two records of what was counted so far: what a killed recorder still says
LEAST_SPLIT = 65536  # bytes
LOW_SPACE = 300.0  # s of recording that still fit the disk, from which on it is said
LABELS = ("name", "notes", "tags")

SPECS = (
    Parameter("output", "path of the new .mcap file; its folder becomes the bag; {stamp} is the UTC time of the start"),
    Parameter("record_from_start", "false waits for ~/start"),
    Parameter("name", "of the run, into the bag", live=True),
    Parameter("notes", "on the run, into the bag", live=True),
    Parameter("tags", "of the run, separated by spaces, into the bag", live=True),
    Parameter("max_bag_size", "bytes of a file from which on the next one begins; 0 does not split", 0),
    Parameter("max_bag_duration", "of a file, after which the next one begins; 0 does not split, s", 0.0),
    Parameter("sync_period", "between two times that the disk is waited for: what a power cut can cost, s", 0.1, 3600.0),
    Parameter("reliable", "ask the publishers to repeat lost samples; false never slows them"),
    Parameter("compression", "of each chunk", choices=tuple(COMPRESSIONS)),
    Parameter("parameters_of", "nodes whose parameters go into the bag, separated by spaces"),
    Parameter("extra_topics", "further topics to record, separated by spaces; their types are found"),
)


class RecorderNode(DextarNode):
    """Polls its subscriptions instead of being called for each sample.

    Six topics at 1 kHz are 6000 callbacks a second: with the single-threaded executor they took
    76-86 % of a core, and the events executor of rclpy 7.1.6 fails on callbacks that also want the
    message info. Taking what each reader holds every 20 ms takes 12 % (5 ms: 14 %, 50 ms: 11 %),
    lost nothing, and the receive times are the middleware's, so that polling does not blur them.
    With the writing (8 us per sample, in the bag writer's thread) the whole recorder took 20-24 %
    of a core and every one of 60 000 samples arrived, reliable or best effort; the reliable reader
    costs the publishing process more.

    The subscriptions stay between two recordings, so that the next one misses nothing at its start.

    Raises:
        BagError: the file cannot be made.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("recorder", SPECS, robot=False, **options)
        if 0 < self.values["max_bag_size"] < LEAST_SPLIT:
            size = self.values["max_bag_size"]
            raise ParameterError(f"parameter 'max_bag_size' = {size}; it must be 0 or >= {LEAST_SPLIT} bytes")
        self._writer: BagWriter | None = None
        self._record = RunRecord({})
        self._made: Counter[Path] = Counter()
        self._target = Path()
        self._seconds = 0
        self._unnumbered: set[str] = set()
        self._known: tuple[Any, ...] = ()
        self._resolved: dict[str, str] = {}
        self._taps: list[Tap] = []
        listeners = {DIAGNOSTICS.name: self._on_diagnostics, PARAMETER_EVENTS.name: self._on_parameter_event}
        for topic in (*TOPICS, *ALONGSIDE):
            tap = Tap(self, topic, profile_of(topic, self.values["reliable"]), listeners.get(topic.name))
            self._taps.append(tap)
            if topic in TOPICS:
                self._resolved[topic.name] = tap.name
        self._wanted = self.values["extra_topics"].split()
        self._snapshots = [ParameterSnapshot(self, name) for name in self.values["parameters_of"].split()]
        self.create_service(Trigger, "~/start", self._on_start)
        self.create_service(Trigger, "~/stop", self._on_stop)
        if self.values["record_from_start"]:
            self._begin()
        self._timer = self.create_timer(1.0, self._on_second, clock=self.steady_clock)

    def on_parameters(self, changes: Mapping[str, Any]) -> None:
        """Name, notes and tags as they are set last."""
        self._record.labels.update({key: value for key, value in changes.items() if key in LABELS})

    def poll(self) -> int:
        """Take what the readers hold, and record it if a recording is on; how many samples."""
        count = 0
        writer = self._writer
        for tap in self._taps:
            message_type, take, name, losses = tap.message_type, tap.take, tap.name, tap.losses
            while (taken := take(message_type, True)) is not None:
                count += 1
                data, info = taken
                number = info["publication_sequence_number"]
                losses.see(number)
                received = info["received_timestamp"] or time.time_ns()
                sample = Sample(received, name, info["source_timestamp"], number or losses.received, data)
                if tap.kept is not None:
                    tap.kept.append(sample)
                if writer is None:
                    continue
                if not writer.has_topic(name):
                    self._describe(writer, tap)
                writer.add(sample)
                if tap.listen is not None:
                    tap.listen(data, received)
        if writer is not None and writer.error is not None and not self.finished:
            self.get_logger().error(str(writer.error))
            self.finish(EXIT_RECORDING)
        return count

    def close(self) -> None:
        """Take the samples under way, say what was lost, finish the file."""
        deadline = time.monotonic() + LAST_WORDS
        while self.poll() and time.monotonic() < deadline:
            time.sleep(POLL_PERIOD)
        self._publish_diagnostics()
        time.sleep(2 * POLL_PERIOD)
        self.poll()
        if self._writer is not None:
            self._end()

    def _begin(self) -> None:
        """Begin a recording; raises BagError."""
        values = self.values
        path = self._new_path()
        writer = BagWriter(
            path, values["compression"], max_size=values["max_bag_size"], max_duration=values["max_bag_duration"],
            sync_period=values["sync_period"], folder=True,
        )  # fmt: skip
        self._record = RunRecord({key: values[key] for key in LABELS})
        for snapshot in self._snapshots:
            snapshot.renew()
        writer.add_metadata(METADATA_NAME, self._texts(writer))
        now = time.time_ns()
        for tap in self._taps:
            tap.losses.restart()
            for sample in tap.kept or ():
                self._describe(writer, tap)
                writer.add(sample._replace(log_time=now))
        self._writer = writer
        self._made[self._target] += 1
        self.get_logger().info(f"recording to {writer.path}")

    def _end(self) -> str:
        """Finish the recording; why the bag is not whole, or ""."""
        writer, self._writer = self._writer, None
        assert writer is not None
        for tap in self._taps:
            if tap.losses.lost:
                self.get_logger().warning(f"{tap.name}: {tap.losses.lost} samples lost, {tap.losses.received} recorded")
        missing = self._missing()
        if missing:
            self.get_logger().warning(f"no parameters of {', '.join(missing)}: they never answered")
        known = writer.error
        try:
            ended = datetime.now(timezone.utc)
            writer.close({METADATA_NAME: self._texts(writer, ended)}, self._record.custom_data(self._parameters_known()))
        except BagError as error:
            if error is not known:
                self.get_logger().error(str(error))
            self.finish(EXIT_RECORDING)
            return str(error)
        return ""

    def _new_path(self) -> Path:
        """Of the next recording: the output, or where that was recorded to already, a folder beside it."""
        stamp = datetime.now(timezone.utc).strftime("%Y%m%dT%H%M%SZ")
        path = Path(self.values["output"].replace("{stamp}", stamp)).expanduser()
        if path.suffix != ".mcap":
            raise BagError(f"cannot record to {path}: the name must end in .mcap")
        self._target = path
        if not self._made[path]:
            return path
        return path.parent / f"{path.stem}-{self._made[path] + 1}" / path.name

    def _on_start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._writer is not None:
            response.message = f"already recording to {self._writer.path}"
            return response
        self.poll()
        try:
            self._begin()
        except BagError as error:
            self.get_logger().error(str(error))
            response.message = str(error)
            return response
        assert self._writer is not None
        response.success, response.message = True, f"recording to {self._writer.path}"
        return response

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        writer = self._writer
        if writer is None:
            response.message = "not recording"
            return response
        self.poll()
        error = self._end()
        received, lost = sum(tap.losses.received for tap in self._taps), self._lost(writer)
        response.success = not error
        response.message = error or f"{received - lost_on_disk(writer)} messages in {writer.path}, {lost} lost"
        self._publish_diagnostics()
        return response

    def _describe(self, writer: BagWriter, tap: Tap) -> None:
        """Add the topic to the bag as its publishers offer it, at its first sample."""
        offered = [info.qos_profile for info in self.get_publishers_info_by_topic(tap.name)]
        writer.add_topic(tap.name, tap.type, [describe(profile) for profile in offered])

    def _on_second(self) -> None:
        self._seconds += 1
        for snapshot in self._snapshots:
            snapshot.ask()
        writer = self._writer
        if writer is not None:
            record = self._record
            known = (self._missing(), dict(record.labels), record.certificate, len(record.changes))
            if known != self._known or self._seconds % METADATA_PERIOD == 0:
                self._known = known
                writer.add_metadata(METADATA_NAME, self._texts(writer))
        for tap in self._taps:
            if not tap.losses.supported and tap.name not in self._unnumbered:
                self._unnumbered.add(tap.name)
                self.get_logger().warning(f"{tap.name}: the middleware numbers no samples; only stamps can tell losses")
        self._find_extra_topics()
        self._publish_diagnostics()

    def _find_extra_topics(self) -> None:
        if not self._wanted:
            return
        types = dict(self.get_topic_names_and_types())
        for name in list(self._wanted):
            resolved = self.resolve_topic_name(name)
            if resolved not in types:
                continue
            self._wanted.remove(name)
            if any(tap.name == resolved for tap in self._taps):
                continue
            offered = [info.qos_profile for info in self.get_publishers_info_by_topic(resolved)]
            try:
                self._taps.append(Tap(self, *found_topic(name, types[resolved][0], offered)))
            except (DextarError, ModuleNotFoundError, AttributeError, ValueError) as error:
                self.get_logger().error(f"cannot record {resolved} of type {types[resolved][0]}: {error}")

    def _on_diagnostics(self, data: bytes, _: int) -> None:
        """The plan's certificate is told there."""
        own = self.get_namespace().rstrip("/")
        for status in deserialize_message(data, DiagnosticArray).status:
            if status.name.rpartition("/")[0] == own:
                for entry in status.values:
                    if entry.key == "certificate":
                        self._record.note_certificate(entry.value)

    def _on_parameter_event(self, data: bytes, received: int) -> None:
        event = deserialize_message(data, ParameterEvent)
        for parameter in event.changed_parameters:
            self._record.note_change(received, event.node, parameter.name, parameter_value_to_python(parameter.value))

    def _publish_diagnostics(self) -> None:
        writer = self._writer
        missing = " ".join(self._missing()) or "none"
        if writer is None:
            values = {"recording": False, "parameters_missing": missing}
            self.publish_diagnostics(DiagnosticStatus.OK, "not recording", values)
            return
        lost = self._lost(writer)
        level, message = DiagnosticStatus.OK, f"recording to {writer.path}"
        free = _free_space(writer.path.parent)
        elapsed = (datetime.now(timezone.utc) - self._record.started).total_seconds()
        lasts = free * elapsed / writer.size if writer.size and elapsed > 0 else float("inf")
        if writer.error is not None:
            level, message = DiagnosticStatus.ERROR, str(writer.error)
        elif lost:
            level, message = DiagnosticStatus.WARN, f"{lost} samples lost"
        elif lasts < LOW_SPACE:
            level, message = DiagnosticStatus.WARN, f"the disk is full in {lasts:.0f} s"
        values = {
            "recording": writer.error is None, "bag": writer.path, "bytes": writer.size, "bytes_on_disk": writer.synced,
            "files": len(writer.paths), "pending": len(writer), "disk_free_bytes": free, "parameters_missing": missing,
        }  # fmt: skip
        for name, counts in self._counts(writer).items():
            values[f"{name} received"] = counts["received"]
            values[f"{name} lost"] = "unknown" if counts["lost"] is None else counts["lost"] + (counts["dropped"] or 0)
        self.publish_diagnostics(level, message, values)

    def _counts(self, writer: BagWriter) -> dict[str, dict[str, int | None]]:
        """Per topic: samples received, lost on the way (None: not numbered), dropped before the disk."""
        return {
            tap.name: {
                "received": tap.losses.received,
                "lost": tap.losses.lost if tap.losses.supported else None,
                "dropped": writer.dropped.get(tap.name, 0),
            }
            for tap in self._taps
        }

    def _lost(self, writer: BagWriter) -> int:
        return sum(tap.losses.lost for tap in self._taps) + lost_on_disk(writer)

    def _missing(self) -> list[str]:
        return [snapshot.target for snapshot in self._snapshots if snapshot.values is None]

    def _parameters_known(self) -> dict[str, dict[str, Any]]:
        own = {self.get_name(): {spec.name: self.values[spec.name] for spec in SPECS}}
        return own | {snapshot.target: snapshot.values for snapshot in self._snapshots if snapshot.values is not None}

    def _texts(self, writer: BagWriter, ended: datetime | None = None) -> dict[str, str]:
        return self._record.texts(self._parameters_known(), self._resolved, self._counts(writer), self._missing(), ended)


def lost_on_disk(writer: BagWriter) -> int:
    """Samples that arrived and could not be written."""
    return sum(writer.dropped.values())


def _free_space(folder: Path) -> float:
    """Bytes that the disk still has; nan when it cannot be asked."""
    try:
        space = os.statvfs(folder)
    except OSError:
        return float("nan")
    return space.f_bavail * space.f_frsize


def _spin(node: RecorderNode, executor: Any, stop: StopSignal) -> None:
    while not stop and not node.finished:
        executor.spin_once(timeout_sec=POLL_PERIOD)
        node.poll()


def main(args: list[str] | None = None) -> int:
    """Record until SIGINT or SIGTERM; 0, or 1 when the bag is not whole, or 2 when it cannot be made."""
    return run_node(RecorderNode, args, _spin)


if __name__ == "__main__":
    raise SystemExit(main())
