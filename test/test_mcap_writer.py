"""The bag's layout as other tools read it, and what happens when the disk does not take it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from synthetic_run import TYPES, joint_state, write_run

from dextar_control.analysis.bag import read_bag
from dextar_control.contract.errors import BagError
from dextar_control.contract.topics import TOPICS
from dextar_control.ros.loss_count import UNSUPPORTED, LossCount
from dextar_control.ros.mcap_writer import BagWriter, Sample
from dextar_control.ros.message_definitions import SEPARATOR, definition, type_hash

JOINT_STATE = "sensor_msgs/msg/JointState"


@pytest.mark.parametrize("type_name", sorted({topic.type for topic in TOPICS}))
def test_definition_and_hash_are_those_of_an_independent_type_store(type_name: str) -> None:
    known = get_typestore(Stores.ROS2_JAZZY)
    assert type_hash(type_name) == known.hash_rihs01(type_name)
    fresh = get_typestore(Stores.EMPTY)
    fresh.register(get_types_from_msg(definition(type_name), type_name))
    assert fresh.hash_rihs01(type_name) == known.hash_rihs01(type_name)


def test_each_dependency_stands_once_depth_first() -> None:
    parts = definition("nav_msgs/msg/Odometry").split(f"\n{SEPARATOR}\nMSG: ")
    assert [part.splitlines()[0] for part in parts[1:]] == [
        "std_msgs/Header", "builtin_interfaces/Time", "geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose",
        "geometry_msgs/Point", "geometry_msgs/Quaternion", "geometry_msgs/TwistWithCovariance", "geometry_msgs/Twist",
        "geometry_msgs/Vector3",
    ]  # fmt: skip


def test_an_unknown_type_is_named() -> None:
    with pytest.raises(BagError, match="nowhere_msgs/msg/Nothing"):
        definition("nowhere_msgs/msg/Nothing")


@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_two_independent_readers_agree_with_what_was_written(tmp_path: Path, compression: str) -> None:
    file = tmp_path / "a.mcap"
    writer = BagWriter(file, compression)
    writer.add_topic("/joints", JOINT_STATE, [{"history": "keep_last", "depth": 3}])
    sent = [joint_state(1000 + k, ["q11", "q21"], (k, 2.0), (0.5, -k), (1e-3, k)) for k in range(50)]
    for k, message in enumerate(sent):
        data = bytes(TYPES.serialize_cdr(message, JOINT_STATE))
        writer.add(Sample(5000 - k, "/joints", 4000 + k, 2**32 + k, data))
    writer.close({"note": {"key": "value"}})

    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        decoded = [(m.sequence, m.publish_time, tuple(r.position)) for _, _, m, r in reader.iter_decoded_messages()]
        channel = next(iter(reader.get_summary().channels.values()))
        records = {record.name: record.metadata for record in reader.iter_metadata()}
    assert sorted(decoded) == [(k, 4000 + k, (k, 2.0)) for k in range(50)]
    assert [k for k, _, _ in decoded] == list(range(49, -1, -1))
    assert yaml.safe_load(channel.metadata["offered_qos_profiles"]) == [{"history": "keep_last", "depth": 3}]
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
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
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
    with pytest.raises(BagError, match="Not a directory|File exists|exists already"):
        BagWriter(tmp_path / "file" / "run.mcap")


def test_a_full_disk_is_named_and_what_was_written_can_be_read(tmp_path: Path) -> None:
    file = tmp_path / "full.mcap"
    code = f"""
import resource, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
from synthetic_run import write_run
from dextar_control.contract.errors import BagError
import dextar_control.ros.mcap_writer as w
w.CHUNK_SIZE = 20_000
w.COMPRESSIONS = dict.fromkeys(w.COMPRESSIONS, w.CompressionType.NONE)
resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, 600_000))
try:
    write_run(Path({str(file)!r}))
except BagError as error:
    print(error)
    sys.exit(7)
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert result.returncode == 7, result.stderr
    assert str(file) in result.stdout
    assert "File too large" in result.stdout
    assert "Traceback" not in result.stderr
    with pytest.warns(UserWarning, match="last complete chunk"):
        bag = read_bag(file)
    assert bag.truncated
    assert 0 < len(bag.messages["/joint_states"]) < 1001
    assert "parameters.controller" in bag.metadata["dextar"]


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
