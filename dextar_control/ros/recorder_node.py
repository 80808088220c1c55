"""Records every contract topic to MCAP, with the parameters of the run; says which samples it lost."""

from __future__ import annotations

import importlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from dextar_control.contract.errors import BagError, DextarError
from dextar_control.contract.node import DextarNode, Parameter, StopSignal, qos, run_node
from dextar_control.contract.topics import TOPICS, Topic
from dextar_control.ros.loss_count import LossCount
from dextar_control.ros.mcap_writer import COMPRESSIONS, BagWriter, Sample
from dextar_control.ros.message_definitions import definition, type_hash
from dextar_control.ros.parameter_snapshot import ParameterSnapshot, parameter_text
from dextar_control.ros.qos_profiles import describe

EXIT_RECORDING = 1
METADATA_NAME = "dextar"
POLL_PERIOD = 0.02  # s
HISTORY = 4000  # samples each reader holds between two polls: 4 s at 1 kHz
LAST_WORDS = 0.3  # s given to samples under way when the recording ends

SPECS = (
    Parameter("output", "path of the new .mcap file"),
    Parameter("reliable", "ask the publishers to repeat lost samples; false never slows them"),
    Parameter("compression", "of each chunk", choices=tuple(COMPRESSIONS)),
    Parameter("parameters_of", "nodes whose parameters go into the bag, separated by spaces"),
    Parameter("extra_topics", "further topics to record, separated by spaces; their types are found"),
)


@dataclass
class _Tap:
    """One recorded topic."""

    name: str
    subscription: Subscription
    type: str
    losses: LossCount
    take: Callable[[Any, bool], Any] = field(init=False)

    def __post_init__(self) -> None:
        self.take = self.subscription.handle.take_message


class RecorderNode(DextarNode):
    """Polls its subscriptions instead of being called for each sample.

    Six topics at 1 kHz are 6000 callbacks a second: with the single-threaded executor they took
    76-86 % of a core, and the events executor of rclpy 7.1.6 fails on callbacks that also want the
    message info. Taking what each reader holds every 20 ms takes 12 % (5 ms: 14 %, 50 ms: 11 %),
    lost nothing, and the receive times are the middleware's, so that polling does not blur them.
    With the writing (8 us per sample, in the bag writer's thread) the whole recorder took 20-24 %
    of a core and every one of 60 000 samples arrived, reliable or best effort; the reliable reader
    costs the publishing process more.

    Raises:
        BagError: the file cannot be made.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("recorder", SPECS, robot=False, **options)
        self._started = datetime.now(timezone.utc)
        self._taps: list[_Tap] = []
        self._unnumbered: set[str] = set()
        self._unanswered = -1
        for topic in TOPICS:
            self._tap(topic.name, topic.type, self._profile(topic))
        self._writer = BagWriter(Path(self.values["output"]).expanduser(), self.values["compression"])
        self._wanted = self.values["extra_topics"].split()
        self._snapshots = [ParameterSnapshot(self, name) for name in self.values["parameters_of"].split()]
        self._writer.add_metadata(METADATA_NAME, self._run_metadata())
        self._timer = self.create_timer(1.0, self._on_second, clock=self.steady_clock)
        self.get_logger().info(f"recording to {self._writer.path}")

    def poll(self) -> int:
        """Take what the readers hold; how many samples."""
        count = 0
        for tap in self._taps:
            message_type, take, name, see = tap.subscription.msg_type, tap.take, tap.name, tap.losses.see
            while (taken := take(message_type, True)) is not None:
                data, info = taken
                if not self._writer.has_topic(name):
                    self._describe(tap)
                number = info["publication_sequence_number"]
                see(number)
                received = info["received_timestamp"] or time.time_ns()
                self._writer.add(Sample(received, name, info["source_timestamp"], number or tap.losses.received, data))
                count += 1
        if self._writer.error is not None and not self.finished:
            self.get_logger().error(str(self._writer.error))
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
        for tap in self._taps:
            if tap.losses.lost:
                self.get_logger().warning(f"{tap.name}: {tap.losses.lost} samples lost, {tap.losses.received} recorded")
        missing = [snapshot.target for snapshot in self._snapshots if snapshot.values is None]
        if missing:
            self.get_logger().warning(f"no parameters of {', '.join(missing)}: they never answered")
        try:
            self._writer.close({METADATA_NAME: self._run_metadata(ended=datetime.now(timezone.utc))})
        except BagError as error:
            if not self.finished:
                self.get_logger().error(str(error))
            self.finish(EXIT_RECORDING)

    def _profile(self, topic: Topic) -> QoSProfile:
        reliable = self.values["reliable"] or topic.latched or topic.rate < 100.0
        return qos(topic, reliable=reliable, depth=topic.depth if topic.latched else HISTORY)

    def _tap(self, name: str, type_name: str, profile: QoSProfile) -> None:
        definition(type_name), type_hash(type_name)
        package, _, short = type_name.split("/")
        message_type = getattr(importlib.import_module(f"{package}.msg"), short)
        subscription = self.create_polled_subscription(message_type, name, profile, raw=True)
        resolved = subscription.topic_name
        losses = LossCount(lambda: self.count_publishers(resolved))
        self._taps.append(_Tap(resolved, subscription, type_name, losses))

    def _describe(self, tap: _Tap) -> None:
        """Add the topic to the bag as its publishers offer it, at its first sample."""
        offered = [info.qos_profile for info in self.get_publishers_info_by_topic(tap.name)]
        self._writer.add_topic(tap.name, tap.type, [describe(profile) for profile in offered])

    def _on_second(self) -> None:
        unanswered = [snapshot for snapshot in self._snapshots if snapshot.values is None]
        for snapshot in unanswered:
            snapshot.ask()
        if len(unanswered) != self._unanswered:
            self._unanswered = len(unanswered)
            self._writer.add_metadata(METADATA_NAME, self._run_metadata())
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
            offered = [info.qos_profile for info in self.get_publishers_info_by_topic(resolved)]
            reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered)
            latched = all(profile.durability.name == "TRANSIENT_LOCAL" for profile in offered)
            found = Topic(name, types[resolved][0], "", 1, latched and bool(offered), 0.0, "")
            try:
                self._tap(name, found.type, qos(found, reliable=reliable, depth=HISTORY))
            except (DextarError, ModuleNotFoundError, AttributeError, ValueError) as error:
                self.get_logger().error(f"cannot record {resolved} of type {found.type}: {error}")

    def _publish_diagnostics(self) -> None:
        lost = sum(tap.losses.lost for tap in self._taps) + sum(self._writer.dropped.values())
        level, message = DiagnosticStatus.OK, f"recording to {self._writer.path}"
        if self._writer.error is not None:
            level, message = DiagnosticStatus.ERROR, str(self._writer.error)
        elif lost:
            level, message = DiagnosticStatus.WARN, f"{lost} samples lost"
        missing = [snapshot.target for snapshot in self._snapshots if snapshot.values is None]
        values: dict[str, Any] = {"pending": len(self._writer), "parameters_missing": " ".join(missing) or "none"}
        for name, counts in self._counts().items():
            values[f"{name} received"] = counts["received"]
            values[f"{name} lost"] = "unknown" if counts["lost"] is None else counts["lost"] + (counts["dropped"] or 0)
        self.publish_diagnostics(level, message, values)

    def _counts(self) -> dict[str, dict[str, int | None]]:
        """Per topic: samples received, lost on the way (None: not numbered), dropped before the disk."""
        return {
            tap.name: {
                "received": tap.losses.received,
                "lost": tap.losses.lost if tap.losses.supported else None,
                "dropped": self._writer.dropped.get(tap.name, 0),
            }
            for tap in self._taps
        }

    def _run_metadata(self, ended: datetime | None = None) -> dict[str, str]:
        missing = [snapshot.target for snapshot in self._snapshots if snapshot.values is None]
        own = {spec.name: self.values[spec.name] for spec in SPECS}
        record = {
            "version": _version(),
            "started": self._started.isoformat(),
            "ended": ended.isoformat() if ended else "",
            "contract": json.dumps({topic.name: tap.name for topic, tap in zip(TOPICS, self._taps, strict=False)}),
            "topics": json.dumps(self._counts()),
            "parameters_missing": json.dumps(missing),
            f"parameters.{self.get_name()}": parameter_text(own),
        }
        for snapshot in self._snapshots:
            if snapshot.values is not None:
                record[f"parameters.{snapshot.target}"] = snapshot.text()
        return record


def _version() -> str:
    try:
        return metadata.version("dextar")
    except metadata.PackageNotFoundError:
        manifest = Path(__file__).resolve().parents[2] / "package.xml"
        text = manifest.read_text(encoding="utf-8") if manifest.is_file() else ""
        return text.partition("<version>")[2].partition("</version>")[0] or "unknown"


def _spin(node: RecorderNode, executor: Any, stop: StopSignal) -> None:
    while not stop and not node.finished:
        executor.spin_once(timeout_sec=POLL_PERIOD)
        node.poll()


def main(args: list[str] | None = None) -> int:
    """Record until SIGINT or SIGTERM; 0, or 1 when the bag is not whole, or 2 when it cannot be made."""
    return run_node(RecorderNode, args, _spin)


if __name__ == "__main__":
    raise SystemExit(main())
