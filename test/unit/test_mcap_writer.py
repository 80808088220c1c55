"""The bag's layout as other tools read it, and what happens when the disk does not take
it.
"""

from __future__ import annotations

import os
import random
import resource
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from patience import PATIENCE
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import Reader, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from synthetic_run import TYPES, joint_state, write_run

from dextar_control.bags import mcap_file
from dextar_control.bags import writer as writing
from dextar_control.bags.mcap_file import McapFile
from dextar_control.bags.message_definitions import SEPARATOR, definition, type_hash
from dextar_control.bags.reader import read_bag
from dextar_control.bags.writer import BagWriter, SerializedMessage
from dextar_control.contract.errors import BagError
from dextar_control.contract.topics import TOPICS
from dextar_control.nodekit.loss_count import UNSUPPORTED, LossCount
from dextar_control.nodekit.qos_profiles import describe

JOINT_STATE = "sensor_msgs/msg/JointState"


@pytest.mark.parametrize("type_name", sorted({topic.type for topic in TOPICS}))
def test_definition_and_hash_are_those_of_an_independent_type_store(
    type_name: str,
) -> None:
    known = get_typestore(Stores.ROS2_JAZZY)
    assert type_hash(type_name) == known.hash_rihs01(type_name)
    fresh = get_typestore(Stores.EMPTY)
    fresh.register(get_types_from_msg(definition(type_name), type_name))
    assert fresh.hash_rihs01(type_name) == known.hash_rihs01(type_name)


def test_each_dependency_stands_once_depth_first() -> None:
    parts = definition("nav_msgs/msg/Odometry").split(f"\n{SEPARATOR}\nMSG: ")
    assert [part.splitlines()[0] for part in parts[1:]] == [
        "std_msgs/Header",
        "builtin_interfaces/Time",
        "geometry_msgs/PoseWithCovariance",
        "geometry_msgs/Pose",
        "geometry_msgs/Point",
        "geometry_msgs/Quaternion",
        "geometry_msgs/TwistWithCovariance",
        "geometry_msgs/Twist",
        "geometry_msgs/Vector3",
    ]


def test_an_unknown_type_is_named() -> None:
    with pytest.raises(BagError, match="nowhere_msgs/msg/Nothing"):
        definition("nowhere_msgs/msg/Nothing")


@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_two_independent_readers_agree_with_what_was_written(
    tmp_path: Path, compression: str
) -> None:
    file = tmp_path / "a.mcap"
    writer = BagWriter(file, compression)
    writer.add_topic("/joints", JOINT_STATE, [{"history": "keep_last", "depth": 3}])
    sent = [
        joint_state(1000 + k, ["q11", "q21"], (k, 2.0), (0.5, -k), (1e-3, k))
        for k in range(50)
    ]
    for k, message in enumerate(sent):
        data = bytes(TYPES.serialize_cdr(message, JOINT_STATE))
        writer.add(SerializedMessage(5000 - k, "/joints", 4000 + k, 2**32 + k, data))
    writer.close({"note": {"key": "value"}})

    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        decoded = [
            (m.sequence, m.publish_time, tuple(r.position))
            for _, _, m, r in reader.iter_decoded_messages()
        ]
        channel = next(iter(reader.get_summary().channels.values()))
        records = {record.name: record.metadata for record in reader.iter_metadata()}
    assert sorted(decoded) == [(k, 4000 + k, (k, 2.0)) for k in range(50)]
    assert [k for k, _, _ in decoded] == list(range(49, -1, -1))
    assert yaml.safe_load(channel.metadata["offered_qos_profiles"]) == [
        {"history": "keep_last", "depth": 3}
    ]
    assert channel.metadata["topic_type_hash"] == type_hash(JOINT_STATE)
    assert records["note"] == {"key": "value"}
    info = yaml.safe_load(records["rosbag2"]["serialized_metadata"])
    assert info["version"] == 9
    assert info["message_count"] == 50
    assert info["topics_with_message_count"][0]["topic_metadata"]["type"] == JOINT_STATE
    assert info["duration"] == {"nanoseconds": 49}


def test_a_whole_run_reads_with_rosbags(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap")
    with AnyReader([tmp_path / "run.mcap"]) as reader:
        counts = {
            connection.topic: connection.msgcount for connection in reader.connections
        }
        first = next(reader.messages())
        reader.deserialize(first[2], first[0].msgtype)
    assert counts["/joint_states"] == 1001
    assert counts["/joint_commands"] == 998


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    file = tmp_path / "kept.mcap"
    file.write_text("precious")
    with pytest.raises(BagError, match="kept.mcap: it exists already"):
        BagWriter(file)
    assert file.read_text() == "precious"


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BagError, match="Not a directory"):
        BagWriter(tmp_path / "file" / "run.mcap")


def test_a_full_disk_is_named_and_what_was_written_can_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "full.mcap"
    monkeypatch.setattr(mcap_file, "CHUNK_SIZE", 20_000)
    plain = dict.fromkeys(mcap_file.COMPRESSIONS, mcap_file.CompressionType.NONE)
    monkeypatch.setattr(mcap_file, "COMPRESSIONS", plain)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, hard))
    try:
        with pytest.raises(BagError, match=f"{file}.*File too large"):
            write_run(file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    with pytest.warns(UserWarning, match="last complete chunk"):
        bag = read_bag(file)
    assert bag.truncated
    assert 0 < len(bag.messages["/joint_states"]) < 1001
    assert "parameters.controller" in bag.metadata["dextar"]


def write_numbers(
    writer: BagWriter, count: int, step: int = 1_000_000, size: int = 0
) -> list[int]:
    """Record strings "0", "1", ... one step (ns) apart, padded with bytes that do not
    compress; their log times.
    """
    rng = random.Random(1)
    writer.add_metadata("note", {"key": "value"})
    writer.add_topic("/numbers", "std_msgs/msg/String", [])
    times = [10**18 + step * number for number in range(count)]
    for number, moment in enumerate(times):
        text = f"{number} {rng.randbytes(size).hex()}"
        message = TYPES.types["std_msgs/msg/String"](data=text)
        writer.add(
            SerializedMessage(
                moment,
                "/numbers",
                moment - 5,
                number,
                bytes(TYPES.serialize_cdr(message, "std_msgs/msg/String")),
            )
        )
    return times


def numbers_in(path: Path) -> list[int]:
    """What rosbags reads back."""
    with Reader(path) as reader:
        taken = [
            TYPES.deserialize_cdr(raw, connection.msgtype).data
            for connection, _, raw in reader.messages()
        ]
    return [int(text.split()[0]) for text in taken]


def test_the_folder_is_a_bag_with_the_metadata_that_rosbags_would_write(
    tmp_path: Path,
) -> None:
    qos = Qos(
        QosHistory.KEEP_LAST,
        7,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        QosTime(1, 2),
        QosTime(3, 4),
        QosLiveliness.AUTOMATIC,
        QosTime(5, 6),
        False,
    )
    described = dump_qos_v9([qos])
    writer = BagWriter(tmp_path / "run" / "run.mcap", folder=True)
    writer.add_topic("/joints", JOINT_STATE, described)
    message = bytes(TYPES.serialize_cdr(joint_state(1, ["q11"], (1.0,)), JOINT_STATE))
    writer.add(SerializedMessage(100, "/joints", 90, 1, message))
    writer.add(SerializedMessage(175, "/joints", 95, 2, message))
    writer.close(custom={"name": "Lauf ü: 1"})
    with RosbagsWriter(
        tmp_path / "theirs", version=9, storage_plugin=StoragePlugin.MCAP
    ) as theirs:
        theirs.set_custom_data("name", "Lauf ü: 1")
        connection = theirs.add_connection(
            "/joints", JOINT_STATE, typestore=TYPES, offered_qos_profiles=[qos]
        )
        theirs.write(connection, 100, message)
        theirs.write(connection, 175, message)
    mine, other = (
        yaml.safe_load((tmp_path / name / "metadata.yaml").read_text())
        for name in ("run", "theirs")
    )
    info, expected = (
        mine["rosbag2_bagfile_information"],
        other["rosbag2_bagfile_information"],
    )
    for document in (info, expected):
        del (
            document["relative_file_paths"],
            document["ros_distro"],
            document["files"][0]["path"],
        )
    assert info == expected
    with Reader(tmp_path / "run") as reader:
        assert (reader.start_time, reader.duration, reader.message_count) == (
            100,
            76,
            2,
        )
        assert reader.connections[0].ext.offered_qos_profiles == [qos]
        assert reader.storage.metadata.custom == {"name": "Lauf ü: 1"}
        assert len(list(reader.messages())) == 2


@pytest.mark.parametrize(
    "kind", [HistoryPolicy, ReliabilityPolicy, DurabilityPolicy, LivelinessPolicy]
)
def test_every_policy_has_the_word_that_rosbag2_reads(kind: type) -> None:
    for policy in kind:
        if policy.name in ("UNKNOWN", "BEST_AVAILABLE", "SYSTEM_DEFAULT"):
            continue
        profile = QoSProfile(depth=1)
        setattr(
            profile,
            kind.__name__.removesuffix("Policy").removeprefix("QoS").lower(),
            policy,
        )
        read = parse_qos([describe(profile)])[0]
        names = [entry.name for entry in read if hasattr(entry, "name")]
        assert policy.name in names
        assert "UNKNOWN" not in names


def test_a_bag_without_messages_begins_never_as_rosbag2_has_it(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "run.mcap", folder=True)
    writer.close()
    info = yaml.safe_load((tmp_path / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert info["starting_time"]["nanoseconds_since_epoch"] == 2**63 - 1
    assert (info["duration"]["nanoseconds"], info["message_count"]) == (0, 0)


@pytest.mark.parametrize(
    ("limits", "most"), [({"max_size": 100_000}, 100_000), ({"max_duration": 0.25}, 0)]
)
def test_a_split_bag_is_one_bag_and_each_file_stands_alone(
    tmp_path: Path, limits: dict, most: int
) -> None:
    writer = BagWriter(tmp_path / "run.mcap", "none", folder=True, **limits)
    times = write_numbers(writer, 1000, size=300)
    writer.close({"note": {"key": "last"}})
    assert len(writer.paths) >= 4
    assert [path.name for path in writer.paths] == [
        f"run_{k}.mcap" for k in range(len(writer.paths))
    ]
    info = yaml.safe_load((tmp_path / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert info["relative_file_paths"] == [path.name for path in writer.paths]
    assert numbers_in(tmp_path) == list(range(1000))
    next_number = 0
    for path, listed in zip(writer.paths, info["files"], strict=True):
        inside = numbers_in(path)
        assert inside == list(range(next_number, next_number + len(inside)))
        next_number += len(inside)
        first, last = times[inside[0]], times[inside[-1]]
        assert listed == {
            "path": path.name,
            "starting_time": {"nanoseconds_since_epoch": first},
            "duration": {"nanoseconds": last - first},
            "message_count": len(inside),
        }
        assert (
            not most or path.stat().st_size < 2.0 * most
        )  # a chunk more, and the index
        assert most or last - first < 250_000_000
        with path.open("rb") as stream:
            notes = [
                record.metadata["key"]
                for record in make_reader(stream).iter_metadata()
                if record.name == "note"
            ]
        assert notes[-1] == ("last" if path == writer.paths[-1] else "value")
    assert next_number == 1000


def test_what_a_failed_write_took_with_it_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk fails at the third of ten batches: what was taken from the queue and
    what waited is dropped, and said.
    """
    writer = BagWriter(tmp_path / "run.mcap", "none")
    writer.add_topic("/numbers", "std_msgs/msg/String", [])
    write, written = McapFile.write, []

    def fail(self: McapFile, batch: list[SerializedMessage]) -> None:
        if len(written) >= 20:
            raise OSError(5, "Input/output error")
        write(self, batch)
        written.extend(batch)

    monkeypatch.setattr(McapFile, "write", fail)
    for number in range(100):
        writer.add(SerializedMessage(number, "/numbers", number, number, b"x"))
        if number % 10 == 9:
            deadline = time.monotonic() + PATIENCE
            while len(writer) and writer.error is None:
                assert time.monotonic() < deadline
                time.sleep(0.01)
    with pytest.raises(BagError, match="Input/output error"):
        writer.close()
    assert len(written) + writer.dropped["/numbers"] == 100
    assert writer.dropped["/numbers"] >= 80


def test_each_file_of_a_split_bag_begins_with_what_holds(tmp_path: Path) -> None:
    """Said once, before and during the second file: the first file has the first of
    them, the second both.
    """
    writer = BagWriter(tmp_path / "run.mcap", "none", max_duration=1.0)
    for topic, standing in (("/plan", True), ("/silent", True), ("/steps", False)):
        writer.add_topic(topic, "std_msgs/msg/String", [], standing=standing)
    second = 1_000_000_000
    samples = [
        (0.1, "/plan", b"A"),
        (0.1, "/steps", b"1"),
        (1.2, "/steps", b"2"),
        (1.5, "/plan", b"B"),
        (2.3, "/steps", b"3"),
    ]
    for number, (when, topic, data) in enumerate(samples):
        writer.add(
            SerializedMessage(
                round(when * second), topic, round(when * second), number, data
            )
        )
    writer.close()
    found = []
    for path in writer.paths:
        with path.open("rb") as stream:
            found.append(
                [
                    (
                        channel.topic,
                        message.log_time / second,
                        message.publish_time / second,
                        message.data,
                    )
                    for _, channel, message in make_reader(stream).iter_messages()
                ]
            )
    assert found == [
        [("/plan", 0.1, 0.1, b"A"), ("/steps", 0.1, 0.1, b"1")],
        [
            ("/plan", 1.2, 0.1, b"A"),
            ("/steps", 1.2, 1.2, b"2"),
            ("/plan", 1.5, 1.5, b"B"),
        ],
        [("/plan", 2.3, 1.5, b"B"), ("/steps", 2.3, 2.3, b"3")],
    ]


def test_what_was_handed_over_a_sync_period_ago_survives_a_power_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cut is simulated: of the file, only what the disk had confirmed is left."""
    confirmed = 0
    sync = os.fsync

    def remember(handle: int) -> None:
        nonlocal confirmed
        size = os.fstat(handle).st_size
        sync(handle)
        if os.readlink(f"/proc/self/fd/{handle}") == str(file):
            confirmed = size

    file = tmp_path / "run.mcap"
    monkeypatch.setattr(os, "fsync", remember)
    writer = BagWriter(file, sync_period=0.1)
    write_numbers(writer, 500, size=100)

    def until(condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, "the disk was never waited for"
            time.sleep(0.01)

    until(lambda: confirmed > 0 and not len(writer))
    for _ in range(
        2
    ):  # the second confirmation from here on was asked for after all was taken
        reached = confirmed
        writer.add_metadata("beat", {})
        until(lambda reached=reached: confirmed > reached)
    left = tmp_path / "left.mcap"
    left.write_bytes(file.read_bytes()[:confirmed])
    writer.close()
    with pytest.warns(UserWarning, match="last complete chunk"):
        assert len(read_bag(left).messages["/numbers"]) == 500


def test_a_folder_that_is_another_bag_is_refused(tmp_path: Path) -> None:
    BagWriter(tmp_path / "first.mcap", folder=True).close()
    before = (tmp_path / "metadata.yaml").read_text()
    with pytest.raises(
        BagError,
        match=r"second.mcap: .* holds another bag's metadata.yaml; name another folder",
    ):
        BagWriter(tmp_path / "second.mcap", folder=True)
    assert (tmp_path / "metadata.yaml").read_text() == before
    assert not (tmp_path / "second.mcap").exists()


def test_a_metadata_file_that_appeared_meanwhile_is_not_overwritten(
    tmp_path: Path,
) -> None:
    writer = BagWriter(tmp_path / "run.mcap", folder=True)
    write_numbers(writer, 10)
    (tmp_path / "metadata.yaml").write_text("precious")
    with pytest.raises(
        BagError, match="run.mcap is whole, but metadata.yaml beside it: File exists"
    ):
        writer.close()
    assert (tmp_path / "metadata.yaml").read_text() == "precious"
    assert numbers_in(tmp_path / "run.mcap") == list(range(10))


def test_a_full_queue_drops_and_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writing, "MAX_PENDING_BYTES", 20_000)
    monkeypatch.setattr(
        writing, "DRAIN_PERIOD", 3600.0
    )  # the first drain is that of close
    writer = BagWriter(tmp_path / "run.mcap")
    write_numbers(writer, 100, size=500)
    writer.close()
    assert 0 < writer.dropped["/numbers"] < 100
    assert len(numbers_in(tmp_path / "run.mcap")) == 100 - writer.dropped["/numbers"]


def test_a_gap_in_the_numbers_is_a_loss() -> None:
    count = LossCount()
    for number in (5, 6, 9, 10, 12):
        count.see(number)
    assert (count.received, count.lost) == (5, 3)


def test_a_publisher_that_starts_anew_loses_nothing() -> None:
    count = LossCount()
    for number in (100, 101, 1, 2, 4):
        count.see(number)
    assert count.lost == 1


def test_interleaved_publishers_are_told_apart() -> None:
    count = LossCount(lambda: 3)
    for number in (7, 100, 8, 1, 2, 101, 9, 103, 3, 11):
        count.see(number)
    assert count.lost == 2


def test_a_middleware_without_numbers_is_admitted() -> None:
    count = LossCount()
    count.see(UNSUPPORTED)
    count.see(None)
    assert not count.supported
    assert (count.received, count.lost) == (2, 0)
