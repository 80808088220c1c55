"""The bag of a real run in lockstep: complete by its own numbers, whole in every
reader, telling of the run.
"""

from __future__ import annotations

import json
import math
import sys
from collections import defaultdict
from pathlib import Path

import foxglove
import pytest
import yaml
from bag_messages import TYPES, difference
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader

from dextar_control.contract.resources import ROBOT_FILE, config_file
from dextar_control.contract.robot import RobotParameters, load_robot
from dextar_control.planning.planner import Plan

ROOT = Path(__file__).resolve().parents[2]
STREAMS = (
    "/joint_states",
    "/joint_commands",
    "/controller_state",
    "/criterion",
    "/sim/end_effector",
    "/sim/joint_states",
)


@pytest.fixture(scope="module")
def record(demo: Path) -> dict[str, str]:
    """The bag's metadata record of the run."""
    with (demo / "run.mcap").open("rb") as stream:
        return [
            entry.metadata
            for entry in make_reader(stream).iter_metadata()
            if entry.name == "dextar"
        ][-1]


def test_in_lockstep_not_one_sample_is_lost(demo: Path, record: dict[str, str]) -> None:
    """By the publishers' own numbers in the file, and by what the recorder says of
    itself.
    """
    numbers: dict[str, list[int]] = defaultdict(list)
    with (demo / "run.mcap").open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            numbers[channel.topic].append(message.sequence)
    for topic in STREAMS:
        assert len(numbers[topic]) > 1000
        assert numbers[topic] == list(
            range(numbers[topic][0], numbers[topic][0] + len(numbers[topic]))
        ), topic
    counts = json.loads(record["topics"])
    for topic, seen in numbers.items():
        assert counts[topic] == {"received": len(seen), "lost": 0, "dropped": 0}, topic


def test_the_runs_folder_is_a_bag_for_rosbags(demo: Path) -> None:
    info = yaml.safe_load((demo / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert info["custom_data"] == {
        "name": "first light",
        "tags": "demo lockstep",
        "law": "consistent",
        "estimator": "observer",
        "dextar": info["custom_data"]["dextar"],
    }
    with Reader(demo) as reader:
        counts: dict[str, int] = defaultdict(int)
        for connection, _, raw in reader.messages():
            TYPES.deserialize_cdr(raw, connection.msgtype)
            counts[connection.topic] += 1
        assert {
            connection.topic: connection.msgcount for connection in reader.connections
        } == counts
        assert all(
            connection.ext.offered_qos_profiles for connection in reader.connections
        )
        assert all(connection.msgdef.data for connection in reader.connections)
    assert counts["/external_pose"] > 10


def test_three_readers_decode_every_message_alike(demo: Path) -> None:
    """Rosbags, mcap-ros2-support and Foxglove's: numbers to the bit, texts to the
    letter.
    """
    file = demo / "run.mcap"
    expected = {}
    with Reader(file) as reader:
        for connection, time, raw in reader.messages():
            expected[connection.topic, time, bytes(raw)] = TYPES.deserialize_cdr(
                raw, connection.msgtype
            )
    by_key = {}
    with file.open("rb") as stream:
        for _, channel, message, decoded in make_reader(
            stream, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            mine = expected[channel.topic, message.log_time, message.data]
            by_key[channel.topic, message.log_time, message.sequence] = mine
            assert repr_of(decoded) == repr_of(mine)
    assert len(by_key) >= len(expected) > 6000
    read = 0
    for line in foxglove.read(file):
        mine = by_key[line["topic"], int(line["log"]), line["sequence"]]
        assert difference(mine, line["message"], line["topic"]) == ""
        read += 1
    assert read == len(by_key)


def repr_of(message: object) -> str:
    """Every number of a message in the order of its fields."""
    if hasattr(message, "__slots__") and not isinstance(message, (str, bytes)):
        names = [
            name.lstrip("_")
            for name in message.__slots__
            if name not in ("__msgtype__",)
        ]
        return f"({','.join(repr_of(getattr(message, name)) for name in names)})"
    msgtype = getattr(message, "__msgtype__", None)
    if msgtype is not None:
        return f"({','.join(repr_of(getattr(message, name)) for name, _ in TYPES.fielddefs[msgtype][1])})"
    if hasattr(message, "tolist"):
        message = message.tolist()
    if isinstance(message, (list, tuple)):
        return f"[{','.join(map(repr_of, message))}]"
    if isinstance(message, (bytes, bytearray)):
        return repr_of(list(message))
    return (
        "nan" if isinstance(message, float) and math.isnan(message) else repr(message)
    )


def test_the_bag_tells_what_was_run(
    record: dict[str, str], robot: RobotParameters, trip: Plan, tmp_path: Path
) -> None:
    assert (record["name"], record["tags"], record["law"], record["estimator"]) == (
        "first light",
        "demo lockstep",
        "consistent",
        "observer",
    )
    assert record["started"] < record["ended"]
    (tmp_path / "robot.yaml").write_text(record["robot_description"])
    assert (
        load_robot(tmp_path / "robot.yaml")
        == load_robot(config_file(ROBOT_FILE))
        == robot
    )
    certificate = json.loads(record["certificate"])
    planned = trip.certificate
    assert len(certificate["crossings"]) == len(planned.crossings) == 2
    for told, crossing in zip(certificate["crossings"], planned.crossings, strict=True):
        assert told["x"] == pytest.approx(crossing.x, abs=1e-9)
        assert told["sign"] == crossing.sign
    versions = json.loads(record["versions"])
    assert versions["python"] == ".".join(map(str, sys.version_info[:3]))
    assert versions["rmw"] == "rmw_fastrtps_cpp"
    assert {
        "dextar",
        "ros_distro",
        "numpy",
        "scipy",
        "casadi",
        "rclpy",
        "mcap",
        "machine",
    } <= set(versions)
    assert json.loads(record["parameters_missing"]) == []
    for node in ("plant", "controller", "trajectory_server", "recorder"):
        assert yaml.safe_load(record[f"parameters.{node}"])
