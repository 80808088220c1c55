"""What a bag holds beside what is needed costs nothing; what is needed and cannot be
read is counted and told.
"""

from __future__ import annotations

import bz2
import gzip
import json
import lzma
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from synthetic_run import START, TICKS, TYPES, joint_state, message

from dextar_control.analysis import Metrics, compute_metrics, load_run
from dextar_control.bags.folder import in_order
from dextar_control.bags.recover import recover
from dextar_control.bags.scan import RECOVERY_NAME
from dextar_control.cli import main as cli
from dextar_control.contract import decoding
from dextar_control.contract.errors import BagError, StateError

pytestmark = pytest.mark.usefixtures("patient")

Message = tuple[
    str, str, str, int, int, bytes
]  # topic, type, encoding, log time, publish time, data
JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/MultiDOFJointTrajectory"
ROLLED_OVER = 2**64 - 1_000_000_000  # ns: a second before the epoch, without its sign
LATIN_1 = "Temperatur 41 °C".encode("latin-1")


@pytest.fixture(scope="module")
def expected(good: Path) -> Metrics:
    return compute_metrics(load_run(good))


def messages_of(file: Path) -> list[Message]:
    """In the order of the file."""
    with file.open("rb") as stream:
        return [
            (
                channel.topic,
                schema.name,
                channel.message_encoding,
                one.log_time,
                one.publish_time,
                one.data,
            )
            for schema, channel, one in make_reader(stream).iter_messages(
                log_time_order=False
            )
        ]


def write(
    target: Path,
    messages: Any,
    profile: str = "ros2",
    metadata: dict[str, dict[str, str]] | None = None,
) -> Path:
    target.parent.mkdir(parents=True, exist_ok=True)
    with target.open("wb") as stream:
        writer = Writer(stream, chunk_size=40_000)
        writer.start(profile=profile, library="test")
        channels: dict[tuple[str, str, str], int] = {}
        for name, record in (metadata or {}).items():
            writer.add_metadata(name, record)
        for topic, kind, encoding, log_time, publish_time, data in messages:
            if (topic, kind, encoding) not in channels:
                schema = writer.register_schema(
                    kind, "ros2msg" if encoding == "cdr" else "jsonschema", b""
                )
                channels[topic, kind, encoding] = writer.register_channel(
                    topic, encoding, schema
                )
            writer.add_message(
                channels[topic, kind, encoding], log_time, data, publish_time
            )
        writer.finish()
    return target


def record_of(file: Path) -> dict[str, dict[str, str]]:
    with file.open("rb") as stream:
        return {one.name: one.metadata for one in make_reader(stream).iter_metadata()}


def serialized(content: Any) -> bytes:
    return bytes(TYPES.serialize_cdr(content, content.__msgtype__))


def with_text(content: Any, text: bytes) -> bytes:
    """A message in which the text XXX... of that length is other bytes."""
    raw = serialized(content)
    assert raw.count(b"X" * len(text)) == 1
    return raw.replace(b"X" * len(text), text)


def diagnostics() -> bytes:
    entry = message(
        "diagnostic_msgs/msg/KeyValue", key="state", value="X" * len(LATIN_1)
    )
    status = message(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=0,
        name="motor",
        message="",
        hardware_id="",
        values=[entry],
    )
    header = joint_state(START, []).header
    return with_text(
        message("diagnostic_msgs/msg/DiagnosticArray", header=header, status=[status]),
        LATIN_1,
    )


def log() -> bytes:
    time = joint_state(START, []).header.stamp
    fields = {
        "stamp": time,
        "level": 20,
        "name": "a",
        "msg": "b",
        "file": "",
        "function": "",
        "line": 1,
    }
    return serialized(message("rcl_interfaces/msg/Log", **fields))


def path() -> bytes:
    return serialized(
        message("nav_msgs/msg/Path", header=joint_state(START, []).header, poses=[])
    )


def nowhere() -> bytes:
    return serialized(
        message(
            TRAJECTORY, header=joint_state(START, []).header, joint_names=[], points=[]
        )
    )


BESIDE: dict[str, Message] = {
    "Latin-1 in another node's diagnostics": (
        "/diagnostics",
        "diagnostic_msgs/msg/DiagnosticArray",
        "cdr",
        START,
        START,
        diagnostics(),
    ),
    "a log message whose time rolled over": (
        "/rosout",
        "rcl_interfaces/msg/Log",
        "cdr",
        ROLLED_OVER,
        ROLLED_OVER,
        log(),
    ),
    "bytes that are no message": (
        "/rosout",
        "rcl_interfaces/msg/Log",
        "cdr",
        START,
        START,
        b"\xff\xff",
    ),
    "another robot's trajectory": (
        "/planner_server/trajectory",
        "nav_msgs/msg/Path",
        "cdr",
        START,
        START,
        path(),
    ),
    "another robot's trajectory of the same type": (
        "/planner_server/trajectory",
        TRAJECTORY,
        "cdr",
        START,
        START,
        nowhere(),
    ),
    "a topic with two types": (
        "/criterion",
        "nav_msgs/msg/Path",
        "cdr",
        START,
        START,
        path(),
    ),
    "another arm's joints": (
        "/arm/joint_states",
        JOINT_STATE,
        "cdr",
        START,
        START,
        serialized(joint_state(START, ["shoulder"], (1.0,))),
    ),
    "a type that nobody knows": (
        "/battery",
        "acme_msgs/msg/Battery",
        "cdr",
        START,
        START,
        b"\0\1\0\0\1",
    ),
    "a channel of another encoding": (
        "/panel/state",
        "panel.State",
        "json",
        START,
        START,
        b'{"a": 1}',
    ),
}


@pytest.mark.parametrize(
    "ours", [True, False], ids=["our recorder", "another recorder"]
)
@pytest.mark.parametrize("kind", BESIDE)
def test_what_is_not_needed_costs_nothing_and_what_is_called_whole_can_be_analysed(
    kind: str, ours: bool, good: Path, tmp_path: Path
) -> None:
    messages = messages_of(good)
    bag = write(
        tmp_path / "run.mcap",
        [*messages[:300], BESIDE[kind], *messages[300:]],
        metadata=record_of(good) if ours else {},
    )
    run, expected = load_run(bag), load_run(good)
    for part in ("states", "commands", "control", "criterion", "truth", "trajectory"):
        for name, values in vars(getattr(run, part)).items():
            if name not in ("published", "logged"):
                np.testing.assert_array_equal(
                    values, getattr(getattr(expected, part), name)
                )
    assert (
        run.unreadable == {}
        and run.holes == []
        and ours is (run.robot == expected.robot)
    )
    with pytest.raises(BagError, match="is whole: there is nothing to recover"):
        recover(bag)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("profile", ["", "x-other"])
def test_a_cut_bag_is_recovered_whatever_its_profile_and_what_is_no_ros_topic_is_left_out_and_told(
    profile: str, good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    messages = messages_of(good)
    beside = [
        BESIDE[kind]
        for kind in (
            "a channel of another encoding",
            "a log message whose time rolled over",
        )
    ]
    bag = write(tmp_path / "run.mcap", [*beside, *messages], profile, record_of(good))
    bag.write_bytes(bag.read_bytes()[:-30])
    assert cli.main(["recover", str(bag)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert (
        "1 message of /panel/state left out: it is no ROS 2 topic, its messages are"
        " 'json'" in said
    )
    copied = messages_of(tmp_path / "run-recovered" / "run.mcap")
    assert sorted(copied) == sorted(
        one for one in [*beside, *messages] if one[2] == "cdr"
    )
    listing = yaml.safe_load(
        (tmp_path / "run-recovered" / "metadata.yaml").read_text()
    )["rosbag2_bagfile_information"]
    begin, length = (
        listing[key][unit]
        for key, unit in (
            ("starting_time", "nanoseconds_since_epoch"),
            ("duration", "nanoseconds"),
        )
    )
    assert (
        START <= begin <= begin + length < START + 10**9
    )  # a time that is none is not the bag's
    with Reader(tmp_path / "run-recovered") as reader:
        assert reader.message_count == len(copied)
    assert len(load_run(tmp_path / "run-recovered").states.stamps) == TICKS


def test_a_bag_without_any_ros_topic_is_neither_whole_nor_recovered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write(tmp_path / "run.mcap", [BESIDE["a channel of another encoding"]] * 3)
    for command, words in (
        ("recover", "holds no message of a ROS 2 topic"),
        ("analyze", "holds no ROS 2 message"),
    ):
        assert cli.main([command, str(bag)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert words in line


def changed(
    messages: list[Any], topic: str, change: Callable[[int, bytes], bytes]
) -> Iterator[Any]:
    number = -1
    for name, *middle, data in messages:
        number += name == topic
        yield (name, *middle, change(number, data) if name == topic else data)


def test_what_is_needed_and_no_message_is_counted_and_told(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    messages = changed(
        messages_of(good),
        "/joint_states",
        lambda number, data: data[:40] if number in (100, 101, 700) else data,
    )
    bag = write(tmp_path / "run.mcap", messages, metadata=record_of(good))
    assert cli.main(["analyze", str(bag)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert f"3 of {TICKS} messages on /joint_states cannot be read" in line
    found = json.loads((tmp_path / "metrics.json").read_text())
    assert found["unreadable"]["/joint_states"]["count"] == 3
    assert found["states"] == TICKS - 3
    assert (
        "3 of 1001 messages on /joint_states cannot be read"
        in (tmp_path / "report.html").read_text()
    )


def test_a_bag_whose_states_are_all_unreadable_says_so(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write(
        tmp_path / "run.mcap",
        changed(messages_of(good), "/joint_states", lambda _, data: data[:40]),
    )
    assert cli.main(["analyze", str(bag)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert (
        "none of 1001 messages on /joint_states can be read: 40 bytes are no message of"
        " type" in line
    )


def test_a_frame_that_is_no_utf_8_costs_no_number(
    good: Path, expected: Metrics, tmp_path: Path
) -> None:
    frame = b"\5\0\0\0base\0"
    messages = changed(
        messages_of(good),
        "/joint_states",
        lambda _, data: data.replace(frame, b"\5\0\0\0b\xe4s\xfc\0"),
    )
    metrics = compute_metrics(
        load_run(write(tmp_path / "run.mcap", messages, metadata=record_of(good)))
    )
    assert (metrics.states, metrics.crossings, metrics.unreadable) == (
        TICKS,
        expected.crossings,
        {},
    )


@pytest.mark.parametrize("both", [True, False], ids=["both times", "the log time"])
def test_states_whose_times_rolled_over_are_kept_by_their_stamps(
    both: bool, good: Path, expected: Metrics, tmp_path: Path
) -> None:
    messages = [
        (
            (
                topic,
                kind,
                encoding,
                ROLLED_OVER,
                ROLLED_OVER if both else published,
                data,
            )
            if topic == "/joint_states" and row % 50 < 6
            else (topic, kind, encoding, logged, published, data)
        )
        for row, (topic, kind, encoding, logged, published, data) in enumerate(
            messages_of(good)
        )
    ]
    odd = sum(one[3] == ROLLED_OVER for one in messages)
    with pytest.warns(
        UserWarning,
        match=(
            rf"/joint_states: the time of {odd} messages is none \({ROLLED_OVER} ns\)"
        ),
    ):
        run = load_run(write(tmp_path / "run.mcap", messages, metadata=record_of(good)))
    metrics = compute_metrics(run)
    assert (metrics.states, metrics.crossings, metrics.clock_steps) == (
        TICKS,
        expected.crossings,
        [],
    )


def test_a_trajectory_without_velocities_is_passed_over(
    good: Path, tmp_path: Path
) -> None:
    def bare(_: int, data: bytes) -> bytes:
        served = TYPES.deserialize_cdr(data, TRAJECTORY)
        served.points[2].velocities.clear()
        return serialized(served)

    bag = write(
        tmp_path / "run.mcap",
        changed(messages_of(good), "/trajectory", bare),
        metadata=record_of(good),
    )
    with pytest.warns(
        UserWarning,
        match="the trajectory cannot be used: point 3 of 1001 has no velocities",
    ):
        assert load_run(bag).trajectory is None


def test_a_metadata_record_that_cannot_be_read_leaves_the_messages(
    good: Path, tmp_path: Path
) -> None:
    for text in ("[1, 2]", '{"joint_states": 5}', "{", "[" * 100_000):
        bag = write(
            tmp_path / "run.mcap",
            messages_of(good),
            metadata={"dextar": {"contract": text}},
        )
        with pytest.warns(
            UserWarning, match="record 'dextar' cannot be read and is passed over"
        ):
            assert len(load_run(bag).states.stamps) == TICKS


def test_records_without_a_bottom_are_read_as_unknown(
    good: Path, tmp_path: Path
) -> None:
    deep = "[" * 100_000
    record = record_of(good)
    record["dextar"] |= {"certificate": deep, "versions": deep}
    bag = write(
        tmp_path / "run.mcap",
        messages_of(good),
        metadata={**record, RECOVERY_NAME: {"holes": deep}},
    )
    assert cli.main(["analyze", str(bag)]) in (0, 1)


NUMBERED = """- {history: 1, depth: 10, reliability: 2, durability: 1, deadline: {sec: 9223372036, nsec: 854775807},
  lifespan: {sec: 1, nsec: 0}, liveliness: 1, liveliness_lease_duration: {sec: 1, nsec: 0},
  avoid_ros_namespace_conventions: false}"""


@pytest.mark.parametrize(
    ("profiles", "kept"),
    [
        *(
            (odd, 0)
            for odd in (
                "",
                "2020-99-99",
                "!!timestamp x",
                "[" * 20_000,
                "hello",
                "{a: 1}",
                "[5]",
                "- {depth: x}",
            )
        ),
        (NUMBERED, 1),
        (NUMBERED.replace("reliability: 2", "reliability: best_effort"), 1),
        (NUMBERED.replace("nsec: 0}, live", "n: 0}, live"), 0),
        (f"{NUMBERED}\n- 5\n{NUMBERED}", 2),
    ],
)
def test_a_recovered_bag_has_the_qos_profiles_that_rosbag2_can_read(
    profiles: str, kept: int, tmp_path: Path
) -> None:
    bag = tmp_path / "run.mcap"
    with bag.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", b"")
        channel = writer.register_channel(
            "/joint_states", "cdr", schema, {"offered_qos_profiles": profiles}
        )
        writer.add_message(
            channel, START, serialized(joint_state(START, ["q11"], (1.0,))), START
        )
        writer.finish()
    with bag.open("r+b") as stream:
        stream.truncate(bag.stat().st_size - 20)
    assert cli.main(["recover", str(bag)]) == 0
    with Reader(tmp_path / "run-recovered") as reader:
        assert len(list(reader.messages())) == 1
    listing = yaml.safe_load(
        (tmp_path / "run-recovered" / "metadata.yaml").read_text()
    )["rosbag2_bagfile_information"]
    offered = listing["topics_with_message_count"][0]["topic_metadata"][
        "offered_qos_profiles"
    ]
    assert [profile["reliability"] for profile in offered] == ["best_effort"] * kept
    assert [profile["durability"] for profile in offered] == ["transient_local"] * kept


# One reader, one tolerance.


@pytest.mark.parametrize("behind", [4, decoding.SLACK])
def test_bytes_left_behind_a_message_are_nothing_to_any_reader(
    behind: int, good: Path, expected: Metrics, tmp_path: Path
) -> None:
    left = [
        (*rest, data + bytes(range(1, behind + 1))) for *rest, data in messages_of(good)
    ]
    metrics = compute_metrics(
        load_run(write(tmp_path / "run.mcap", left, metadata=record_of(good)))
    )
    assert (metrics.crossings, metrics.states, metrics.unreadable) == (
        expected.crossings,
        TICKS,
        {},
    )


def test_the_one_reader_says_what_it_does_not_read() -> None:
    raw = serialized(joint_state(START, ["q11"], (1.0,)))
    assert decoding.read_message(
        raw + bytes(decoding.SLACK), JOINT_STATE
    ).position.tolist() == [1.0]
    for bad, words in (
        (
            raw + bytes(decoding.SLACK + 1),
            "129 bytes are left behind it; the limit is 128",
        ),
        (raw[:30], "30 bytes are no message"),
        (b"", "do not begin as CDR does"),
        (b"\0\3" + raw[2:], "do not begin as CDR does"),
    ):
        with pytest.raises(StateError, match=words):
            decoding.read_message(bad, JOINT_STATE)
    with pytest.raises(StateError, match="no message of type acme/msg/Thing"):
        decoding.read_message(raw, "acme/msg/Thing")


def test_a_text_is_made_readable_in_either_byte_order_and_in_lists() -> None:
    content = joint_state(START, ["XXX", "q21"], (1.0, 2.0))
    for little in (True, False):
        raw = bytes(
            TYPES.serialize_cdr(content, JOINT_STATE, little_endian=little)
        ).replace(b"XXX", b"\xff\xe9a")
        read = decoding.read_message(raw, JOINT_STATE)
        assert read.name == ["??a", "q21"] and read.position.tolist() == [1.0, 2.0]


# Compression that is not MCAP's own, and the names of split files.


def rosbag2(
    source: Path, target: Path, storage: StoragePlugin, mode: CompressionMode
) -> Path:
    writer = BagWriter(target, version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with Reader(source) as reader, writer:
        taken = {
            one.topic: writer.add_connection(one.topic, one.msgtype, typestore=TYPES)
            for one in reader.connections
        }
        for connection, time, raw in reader.messages():
            writer.write(taken[connection.topic], time, raw)
    return target


def compressed_messages(
    good: Path, damage: Callable[[int, bytes], bytes]
) -> Iterator[Any]:
    pack = zstandard.ZstdCompressor()
    packed = [(*rest, pack.compress(data)) for *rest, data in messages_of(good)]
    return changed(packed, "/joint_states", damage)


@pytest.mark.parametrize(
    "damage",
    [lambda data: data[:-9], lambda data: b"\0" + data[1:]],
    ids=["cut", "first byte"],
)
def test_a_damaged_message_of_a_message_compressed_bag_costs_itself_alone(
    damage: Callable[[bytes], bytes], good: Path, tmp_path: Path
) -> None:
    bag = write(
        tmp_path / "run.mcap",
        compressed_messages(good, lambda n, data: damage(data) if n == 100 else data),
    )
    with pytest.warns(
        UserWarning, match="1 of 1001 messages on /joint_states cannot be read"
    ):
        run = load_run(bag)
    assert len(run.states.stamps) == TICKS - 1 and len(run.criterion.stamps) == TICKS


def test_a_message_compressed_bag_is_recovered_plain_without_its_damaged_message(
    good: Path, tmp_path: Path
) -> None:
    bag = write(
        tmp_path / "run.mcap",
        compressed_messages(good, lambda n, data: data[:-9] if n == 100 else data),
    )
    result = recover(bag)
    assert result.counts["/joint_states"] == TICKS - 1
    assert result.left_out == {
        ("/joint_states", "their compressed content is damaged"): 1
    }
    assert set(messages_of(result.folder / "run.mcap")) < set(messages_of(good))


@pytest.mark.parametrize(
    ("storage", "mode"),
    [
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
    ],
)
def test_a_bag_that_rosbag2_compressed_is_read(
    storage: StoragePlugin, mode: CompressionMode, good: Path, tmp_path: Path
) -> None:
    bag = rosbag2(good, tmp_path / "theirs", storage, mode)
    (file,) = (one for one in bag.iterdir() if one.name != "metadata.yaml")
    assert len(load_run(bag).states.stamps) == TICKS
    assert (
        len(load_run(file).states.stamps) == TICKS
    )  # without the listing that says so
    if mode is CompressionMode.FILE:
        plain = file.with_suffix("")
        plain.write_bytes(
            zstandard.ZstdDecompressor().stream_reader(file.read_bytes()).read()
        )
        file.unlink()
        assert (
            len(load_run(bag).states.stamps) == TICKS
        )  # unpacked by hand, still listed as compressed


def test_a_cut_compressed_file_is_read_as_far_as_it_goes(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = rosbag2(
        write(tmp_path / "plain" / "run.mcap", messages_of(good)),
        tmp_path / "theirs",
        StoragePlugin.MCAP,
        CompressionMode.FILE,
    )
    (file,) = bag.glob("*.zstd")
    file.write_bytes(file.read_bytes()[:-2000])
    assert cli.main(["analyze", str(bag), "--output", str(tmp_path / "out")]) in (1, 2)
    (line,) = capsys.readouterr().err.splitlines()
    assert (
        "Traceback" not in line
        and str(file) in line
        and "breaks off or is damaged" in line
    )
    file.write_bytes(file.read_bytes()[:3])
    assert cli.main(["analyze", str(bag), "--output", str(tmp_path / "out")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_file_compressed_in_another_way_is_refused_with_how_to_unpack_it(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = good.read_bytes()
    for pack, kind, command in (
        (gzip.compress, "gzip", "gunzip"),
        (bz2.compress, "bzip2", "bunzip2"),
        (lzma.compress, "xz", "unxz"),
    ):
        file = tmp_path / f"run.{kind}.mcap"
        file.write_bytes(pack(content))
        for name in ("analyze", "recover", "export"):
            assert cli.main([name, str(file)]) == 2
            (line,) = capsys.readouterr().err.splitlines()
            assert f"compressed with {kind}: unpack it ({command} {file.name})" in line
    zst = tmp_path / "run.mcap.zst"
    zst.write_bytes(zstandard.ZstdCompressor().compress(content))
    assert len(load_run(zst).states.stamps) == TICKS


def test_a_damaged_sqlite_bag_is_read_up_to_the_damage_or_refused_in_a_sentence(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = rosbag2(
        good, tmp_path / "theirs", StoragePlugin.SQLITE3, CompressionMode.NONE
    )
    (file,) = bag.glob("*.db3")
    whole = file.read_bytes()
    for keep in (200, 5000, len(whole) // 2, len(whole) - 3 * 4096):
        file.write_bytes(whole[:keep])
        assert cli.main(
            ["export", str(bag), "--output", str(tmp_path / "out"), "--format", "csv"]
        ) in (0, 2)
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("dextar export: ") and str(file) in line


NAMES = {
    "number behind": ["run_0", "run_1", "run_2", "run_10"],
    "number, name, time": [
        f"{number}_rosbag2_2026_01_30-12_0{number}_00" for number in range(3)
    ],
    "number, a name with a number, time": [
        f"{number}_run_1_2026_01_30-12_0{number}_00" for number in range(3)
    ],
    "name with the time of the bag": [
        f"rosbag2_2026_01_30-12_00_00_{number}" for number in range(3)
    ],
    "name, number, time": [
        f"run_{number}_20260130T12000{number}Z" for number in range(3)
    ],
}
OTHERS = {
    "two bags": ["monday", "tuesday"],
    "two bags of a minute": [
        "rosbag2_2026_01_30-12_00_00",
        "rosbag2_2026_01_30-12_00_07",
    ],
    "the first files of two bags": [
        "0_rosbag2_2026_01_30-12_00_00",
        "0_rosbag2_2026_01_30-13_00_00",
    ],
    "files of two bags": [
        "rosbag2_2026_01_30-12_00_00_0",
        "rosbag2_2026_01_30-13_00_00_1",
    ],
}


@pytest.mark.parametrize("kind", [*NAMES, *OTHERS])
@pytest.mark.parametrize("ending", [".mcap", ".mcap.zstd"])
def test_files_of_one_bag_are_known_by_their_names(kind: str, ending: str) -> None:
    files = [Path(f"{name}{ending}") for name in (NAMES | OTHERS)[kind]]
    assert in_order(files[::-1]) == (files if kind in NAMES else None)


@pytest.mark.parametrize("kind", ["number, name, time", "name, number, time"])
def test_a_split_bag_named_with_number_and_time_is_one_bag(
    kind: str, good: Path, tmp_path: Path
) -> None:
    messages = messages_of(good)
    third = len(messages) // 3
    for part, name in enumerate(NAMES[kind]):
        until = (part + 1) * third if part < 2 else None
        write(tmp_path / "bag" / f"{name}.mcap", messages[part * third : until])
    assert len(load_run(tmp_path / "bag").states.stamps) == TICKS
    assert sum(recover(tmp_path / "bag").counts.values()) == len(messages)


def test_a_rolled_over_time_in_one_file_does_not_part_a_split_bag(
    good: Path, tmp_path: Path
) -> None:
    messages = messages_of(good)
    write(
        tmp_path / "bag" / "run_0.mcap",
        [*messages[:900], BESIDE["a log message whose time rolled over"]],
    )
    write(tmp_path / "bag" / "run_1.mcap", messages[900:])
    assert len(load_run(tmp_path / "bag").states.stamps) == TICKS


def test_a_channel_whose_text_is_no_utf_8_costs_its_chunk_nothing(
    good: Path, tmp_path: Path
) -> None:
    messages = messages_of(good)
    odd = ("/motor_XXX", "std_msgs/msg/Empty", "cdr", START, START, b"\0\1\0\0\0")
    file = tmp_path / "run.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE, enable_crcs=False)
        writer.start("ros2", "test")
        channels: dict[str, int] = {}
        for topic, kind, encoding, logged, published, data in [*messages, odd]:
            if topic not in channels:
                channels[topic] = writer.register_channel(
                    topic, encoding, writer.register_schema(kind, "ros2msg", b"")
                )
            writer.add_message(channels[topic], logged, data, published)
        writer.finish()
    file.write_bytes(file.read_bytes().replace(b"/motor_XXX", b"/motor_\xe4\xf6\xfc"))
    with pytest.warns(
        UserWarning,
        match="1 message of channel .*, which no record describes, cannot be read",
    ):
        run = load_run(file)
    assert len(run.states.stamps) == TICKS and run.holes == []
    assert np.isfinite(run.states.position).all()


def test_what_is_no_file_is_one_sentence(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "loop.mcap").symlink_to("loop.mcap")
    os.mkfifo(tmp_path / "pipe.mcap")
    (tmp_path / "head.mcap.zstd").write_bytes(b"\x28\xb5\x2f\xfd")
    for name, words in (
        ("loop.mcap", "Too many levels of symbolic links"),
        ("pipe.mcap", "is a pipe or a device"),
        ("head.mcap.zstd", "breaks off or is damaged before its first bytes"),
    ):
        for command in ("analyze", "recover"):
            assert cli.main([command, str(tmp_path / name)]) == 2
            (line,) = capsys.readouterr().err.splitlines()
            assert words in line and str(tmp_path / name) in line
    bag = rosbag2(
        good, tmp_path / "theirs", StoragePlugin.SQLITE3, CompressionMode.NONE
    )
    (file,) = bag.glob("*.db3")
    assert len(load_run(file.rename(tmp_path / "run.sqlite3")).states.stamps) == TICKS


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_numbers_that_are_no_codes_and_records_of_another_shape_are_not_known(
    good: Path, tmp_path: Path
) -> None:
    def odd(number: int, data: bytes) -> bytes:
        content = TYPES.deserialize_cdr(data, JOINT_STATE)
        row = content.name.index("verdict" if number % 2 else "phase")
        content.position = np.array(content.position)
        content.position[row] = (np.inf, -np.inf, 7.0, 1e300, np.nan)[number % 5]
        return serialized(content)

    record = record_of(good)
    record["dextar"] |= {
        "certificate": json.dumps({"crossings": 5, "peak_torque": 1.0}),
        "versions": "[5]",
        "started": "once",
        "parameter_changes": json.dumps([5, {"time": "x"}]),
    }
    bag = write(
        tmp_path / "run.mcap",
        changed(messages_of(good), "/criterion", odd),
        metadata=record,
    )
    assert cli.main(["analyze", str(bag)]) in (0, 1)
    assert cli.main(["export", str(bag), "--format", "csv"]) == 0
    run = load_run(bag)
    assert set(run.criterion.phase) == {-1, 3} and set(
        run.criterion.verdict[np.isfinite(run.criterion.verdict)]
    ) <= {0.0, 1.0}


def test_of_two_trajectories_neither_of_which_is_the_robots_none_is_taken(
    good: Path, tmp_path: Path
) -> None:
    messages = [
        (f"/{owner}{topic}" if topic == "/trajectory" else topic, *rest)
        for topic, *rest in messages_of(good)
        for owner in (("left", "right") if topic == "/trajectory" else ("",))
    ]
    with pytest.warns(
        UserWarning,
        match=(
            "there as /left/trajectory, /right/trajectory, and none is the robot's own"
        ),
    ):
        run = load_run(write(tmp_path / "run.mcap", messages, metadata=record_of(good)))
    assert run.trajectory is None and len(run.states.stamps) == TICKS
