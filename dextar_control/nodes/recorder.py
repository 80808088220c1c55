"""The recorder writes every contract topic to MCAP, with all that is known of the run,
and says which samples it lost.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from datetime import datetime, timezone
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.executors import Executor
from std_srvs.srv import Trigger

from dextar_control.bags.mcap_file import SerializedMessage
from dextar_control.contract.errors import BagError, DextarError, ParameterError
from dextar_control.contract.node_parameters import PARAMETERS
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.signals import StopSignal
from dextar_control.contract.topics import DIAGNOSTICS, TOPICS
from dextar_control.nodekit.node import DextarNode, run_node
from dextar_control.nodekit.parameter_snapshot import ParameterSnapshot, unanswered
from dextar_control.nodekit.scheduling import stand_back
from dextar_control.nodes.recorded_topics import (
    ALONGSIDE,
    PARAMETER_EVENTS,
    RecordedTopic,
    found_topic,
    profile_of,
)
from dextar_control.nodes.recording import LABELS, BagRecording

EXIT_RECORDING = 1
POLL_PERIOD = 0.02  # s
ASK_PERIOD = 0.05  # s between two asks for the other nodes' parameters
LAST_WORDS = 0.3  # s given to samples under way when the recording ends
LEAST_SPLIT = 65536  # bytes
# Samples that tell of the run, too.
HEARD = {
    DIAGNOSTICS.name: BagRecording.hear_diagnostics,
    PARAMETER_EVENTS.name: BagRecording.hear_parameter_event,
}
# What a topic raises whose type is not installed, or is none.
NO_TOPIC = (DextarError, ModuleNotFoundError, AttributeError, ValueError)


class RecorderNode(DextarNode):
    """Records every topic of the package, and those that are asked for, into an MCAP
    file in the layout of rosbag2.

    It polls its subscriptions every 20 ms instead of being called for each sample: at
    6000 samples a second callbacks took 76-86 % of a core, polling takes 12 %, and
    15-18 % with the writing, which the bag writer's thread does. Receive times are the
    middleware's, so that polling does not blur them.

    A best-effort reader that gets no processor time for about 0.1 s loses samples,
    because the middleware's queue holds 512 of them; a reliable one is given all again,
    as far as the publishers' history reaches (1 s), and when it is stopped altogether
    they do not wait for it.

    The subscriptions stay between two recordings, so that the next one misses nothing
    at its start.

    Raises:
        ParameterError: a parameter is unknown or out of its bounds.
    """

    NAME = "recorder"
    PARAMETERS = PARAMETERS[NAME]
    ROBOT = False

    def __init__(self) -> None:
        super().__init__()
        if 0 < self.values["bag.max_size"] < LEAST_SPLIT:
            size = self.values["bag.max_size"]
            raise ParameterError(
                f"parameter 'bag.max_size' = {size}; it must be 0 or >= {LEAST_SPLIT}"
                " bytes"
            )
        self._recording: BagRecording | None = None
        self._made: Counter[Path] = Counter()
        self._unnumbered: set[str] = set()
        reliable = self.values["topics.reliable"]
        self._topics = [
            RecordedTopic(self, topic, profile_of(topic, reliable))
            for topic in (*TOPICS, *ALONGSIDE)
        ]
        self._wanted = self.values["topics.extra"].split()
        self._snapshots = [
            ParameterSnapshot(self, name)
            for name in self.values["bag.parameters_of"].split()
        ]
        self.create_service(Trigger, "~/start", self._on_start)
        self.create_service(Trigger, "~/stop", self._on_stop)
        self._missing = self._parameters_missing()
        self.create_timer(ASK_PERIOD, self._ask, clock=self.steady_clock)
        self.create_timer(1.0, self._on_second, clock=self.steady_clock)

    def on_parameters(self, changes: Mapping[str, ParameterValue]) -> None:
        """Use name, notes and tags as they are set last."""
        if self._recording is not None:
            self._recording.record.labels.update(
                {
                    key: changes[name]
                    for key in LABELS
                    if (name := f"run.{key}") in changes
                }
            )

    def begin(self) -> None:
        """Begin the first recording, unless ``~/start`` shall.

        It is not begun while the node is made: a signal then ends the process at once,
        and a bag would stay cut off.

        Raises:
            BagError: the file cannot be made.
        """
        if self.values["record_from_start"]:
            self._begin()

    def poll(self) -> int:
        """Take what the readers hold, and record it if a recording is on; return how
        many samples.
        """
        count = 0
        recording = self._recording
        for recorded in self._topics:
            message_type, take = recorded.message_type, recorded.take
            name, losses = recorded.name, recorded.losses
            hear = HEARD.get(recorded.topic.name)
            while (taken := take(message_type, True)) is not None:
                count += 1
                data, info = taken
                number = info["publication_sequence_number"]
                losses.see(number)
                received = info["received_timestamp"] or time.time_ns()
                number = number or losses.received
                sent = info["source_timestamp"]
                sample = SerializedMessage(received, name, sent, number, data)
                if recorded.kept is not None:
                    recorded.kept.append(sample)
                if recording is None:
                    continue
                if not recording.writer.has_topic(name):
                    recording.describe(recorded)
                recording.writer.add(sample)
                if hear is not None:
                    hear(recording, data, received)
        error = recording.writer.error if recording is not None else None
        if error is not None and not self.finished:
            self.get_logger().error(str(error))
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
        if self._recording is not None:
            self._end(self._recording)

    def _begin(self) -> BagRecording:
        """Begin a recording.

        Raises:
            BagError: the file cannot be made.
        """
        stamp = datetime.now(timezone.utc).strftime("%Y%m%dT%H%M%SZ")
        path = target = Path(
            self.values["output"].replace("{stamp}", stamp)
        ).expanduser()
        if target.suffix != ".mcap":
            raise BagError(f"cannot record to {target}: the name must end in .mcap")
        if self._made[target]:
            path = (
                target.parent / f"{target.stem}-{self._made[target] + 1}" / target.name
            )
        self._recording = BagRecording(self, path, self._topics, self._snapshots)
        self._made[target] += 1
        self.get_logger().info(f"recording to {self._recording.writer.path}")
        return self._recording

    def _end(self, recording: BagRecording) -> str:
        """Finish the recording; return why the bag is not whole, or ""."""
        self._recording = None
        for recorded in self._topics:
            if recorded.losses.lost:
                self.get_logger().warning(
                    f"{recorded.name}: {recorded.losses.lost} samples lost,"
                    f" {recorded.losses.received} recorded"
                )
        if missing := unanswered(self._snapshots):
            self.get_logger().warning(
                f"no parameters of {', '.join(missing)}: they never answered"
            )
        if self._wanted:
            self.get_logger().warning(
                f"not recorded: {', '.join(self._wanted)}: nobody published there"
            )
        known = recording.writer.error
        try:
            recording.end()
        except BagError as error:
            if error is not known:
                self.get_logger().error(str(error))
            self.finish(EXIT_RECORDING)
            return str(error)
        return ""

    def _on_start(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        if self._recording is not None:
            stop = f"{self.get_fully_qualified_name()}/stop"
            response.message = (
                f"already recording to {self._recording.writer.path}; call {stop} first"
            )
            return response
        self.poll()
        try:
            response.message = f"recording to {self._begin().writer.path}"
            response.success = True
        except BagError as error:
            self.get_logger().error(str(error))
            response.message = str(error)
        return response

    def _on_stop(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        recording = self._recording
        if recording is None:
            response.message = (
                f"not recording; call {self.get_fully_qualified_name()}/start first"
            )
            return response
        self.poll()
        error = self._end(recording)
        response.success = not error
        response.message = (
            error
            or f"{recording.written} messages in {recording.writer.path},"
            f" {recording.lost} lost"
        )
        self._publish_diagnostics()
        return response

    def _parameters_missing(self) -> str:
        """Return the nodes whose parameters are not known."""
        return " ".join(unanswered(self._snapshots)) or "none"

    def _ask(self) -> None:
        """Ask for the other nodes' parameters; that some are known, or no longer, is
        told at once.
        """
        for snapshot in self._snapshots:
            snapshot.ask()
        if self._parameters_missing() != self._missing:
            self._publish_diagnostics()

    def _on_second(self) -> None:
        if self._recording is not None:
            self._recording.on_second()
        for recorded in self._topics:
            if not recorded.losses.supported and recorded.name not in self._unnumbered:
                self._unnumbered.add(recorded.name)
                self.get_logger().warning(
                    f"{recorded.name}: the middleware numbers no samples; only stamps"
                    " can tell losses"
                )
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
            if any(recorded.name == resolved for recorded in self._topics):
                continue
            offered = [
                info.qos_profile for info in self.get_publishers_info_by_topic(resolved)
            ]
            try:
                self._topics.append(
                    RecordedTopic(self, *found_topic(name, types[resolved][0], offered))
                )
            except NO_TOPIC as error:
                self.get_logger().error(
                    f"cannot record {resolved} of type {types[resolved][0]}: {error}"
                )

    def _publish_diagnostics(self) -> None:
        values: dict[str, object] = {"recording": False}
        level, message = DiagnosticStatus.OK, "not recording"
        if self._recording is not None:
            level, message, values = self._recording.status()
        self._missing = self._parameters_missing()
        self.publish_diagnostics(
            level, message, values | {"parameters_missing": self._missing}
        )


def _spin(node: RecorderNode, executor: Executor, stop: StopSignal) -> None:
    node.begin()
    while not stop and not node.finished:
        executor.spin_once(timeout_sec=POLL_PERIOD)
        node.poll()


def main(args: list[str] | None = None) -> int:
    """Record until a signal asks to end; return 0, or 1 when the bag is not whole, or 2
    when it cannot be made.

    The recorder has time: taking samples as soon as they come would interrupt plant and
    controller, which send them.
    """
    stand_back()
    return run_node(RecorderNode, args, _spin)


if __name__ == "__main__":
    raise SystemExit(main())
