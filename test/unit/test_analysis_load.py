"""Loading a bag: contents, cut-off files, foreign files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from damaged import with_damaged_chunks
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import (
    CompressionFormat,
    CompressionMode,
    Reader,
    StoragePlugin,
    Writer,
)
from synthetic_run import (
    MISSED,
    START,
    TICKS,
    TRUE_OFFSET,
    TYPES,
    effort_at,
    joint_state,
    joints_of,
    path,
    robot,
    write_run,
)

from dextar_control.analysis.compute import compute_metrics
from dextar_control.analysis.load import load_run
from dextar_control.analysis.run import Run
from dextar_control.bags.recover import recover
from dextar_control.bags.writer import BagWriter, SerializedMessage
from dextar_control.cli import main as cli
from dextar_control.contract.errors import BagError


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("run") / "run.mcap"
    write_run(file)
    return file


def test_every_stream_comes_back_by_name_and_stamp(bag: Path) -> None:
    run = load_run(bag)
    assert run.states.stamps[0] == START
    assert len(run.states.stamps) == TICKS
    assert tuple(run.states.position[100]) == joints_of(path(0.1)[0] + TRUE_OFFSET)
    assert len(run.commands.stamps) == TICKS - len(MISSED)
    assert tuple(run.commands.effort[0]) == effort_at(0)
    assert np.isnan(run.commands.position).all()
    assert run.control.time[250] == 0.25
    assert tuple(run.control.reference[250]) == (0.0, path(0.25)[0])
    assert tuple(run.control.output[250]) == (0.0, path(0.25)[2])
    assert tuple(run.control.wrench[250]) == (0.0, 1.0)
    assert run.criterion.assembly_mode[0] == 1.0
    assert run.truth is not None
    assert run.truth.x.shape == (TICKS, 2)
    assert run.trajectory is not None
    assert run.trajectory.x_ddot[10, 1] == path(0.01)[2]
    assert run.diagnostics["plant"]["late_commands"] == "7"
    assert run.robot == robot()
    assert not run.truncated


def test_a_rigs_bag_has_no_truth(tmp_path: Path) -> None:
    write_run(tmp_path / "rig.mcap", truth=False)
    assert load_run(tmp_path / "rig.mcap").truth is None


@pytest.mark.parametrize("share", [0.55, 0.9, 0.999])
def test_a_cut_off_file_loads_up_to_its_last_complete_chunk(
    bag: Path, tmp_path: Path, share: float
) -> None:
    cut = tmp_path / "cut.mcap"
    content = bag.read_bytes()
    cut.write_bytes(content[: int(share * len(content))])
    with pytest.warns(UserWarning, match="last complete chunk"):
        run = load_run(cut)
    assert run.truncated
    assert 0 < len(run.states.stamps) <= TICKS
    assert run.robot == robot()


def test_a_file_without_end_record_keeps_every_sample(
    bag: Path, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(bag.read_bytes()[:-20])
    with pytest.warns(UserWarning, match="last complete chunk"):
        assert len(load_run(cut).states.stamps) == TICKS


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "is empty"),
        (b"PK\x03\x04 something else entirely", "not an MCAP file"),
        (b"\x89MCAP0\r\n", "no ROS 2 message"),
    ],
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_unusable_file_is_named_in_one_sentence(
    tmp_path: Path, content: bytes, sentence: str
) -> None:
    file = tmp_path / "strange.mcap"
    file.write_bytes(content)
    with pytest.raises(BagError, match=sentence) as caught:
        load_run(file)
    assert str(file) in str(caught.value)


def as_ros2_bag_record(
    source: Path,
    target: Path,
    storage: StoragePlugin,
    prefixes: tuple[str, ...] = ("",),
    mode: CompressionMode = CompressionMode.NONE,
) -> None:
    """The run as another recorder has it: rosbags' writer, no metadata of ours, in each
    namespace once.
    """
    writer = Writer(target, version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with Reader(source) as reader, writer:
        for prefix in prefixes:
            taken = {
                connection.topic: writer.add_connection(
                    f"{prefix}{connection.topic}", connection.msgtype, typestore=TYPES
                )
                for connection in reader.connections
            }
            for connection, time, raw in reader.messages():
                writer.write(taken[connection.topic], time, raw)


RECORDED = {
    "mcap": (StoragePlugin.MCAP, CompressionMode.NONE),
    "sqlite3": (StoragePlugin.SQLITE3, CompressionMode.NONE),
    "sqlite3, each message compressed": (
        StoragePlugin.SQLITE3,
        CompressionMode.MESSAGE,
    ),
    "sqlite3, file compressed": (StoragePlugin.SQLITE3, CompressionMode.FILE),
}


@pytest.mark.parametrize("kind", RECORDED)
def test_a_bag_of_ros2_bag_record_loads_as_well(
    bag: Path, tmp_path: Path, kind: str
) -> None:
    storage, mode = RECORDED[kind]
    as_ros2_bag_record(bag, tmp_path / "theirs", storage, mode=mode)
    ours, theirs = load_run(bag), load_run(tmp_path / "theirs")
    assert_same_run(theirs, ours)
    assert (theirs.parameters, theirs.robot, theirs.losses, theirs.version) == (
        {},
        None,
        {},
        "",
    )
    assert theirs.diagnostics["plant"]["late_commands"] == "7"
    if kind == "sqlite3":
        assert_same_run(load_run(next((tmp_path / "theirs").glob("*.db3"))), ours)


@pytest.mark.parametrize(
    "options", [{"use_chunking": False}, {"compression": CompressionType.LZ4}], ids=str
)
def test_files_of_rosbag2s_other_presets_load_and_are_recovered(
    bag: Path, tmp_path: Path, options: dict
) -> None:
    with bag.open("rb") as source, (tmp_path / "run.mcap").open("wb") as target:
        writer = McapWriter(target, **options)
        writer.start("ros2", "libmcap")
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.id not in channels:
                schema_id = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
                channels[channel.id] = writer.register_channel(
                    channel.topic, "cdr", schema_id
                )
            writer.add_message(
                channels[channel.id],
                message.log_time,
                message.data,
                message.publish_time,
            )
        writer.finish()
    assert_same_run(load_run(tmp_path / "run.mcap"), load_run(bag))
    (tmp_path / "run.mcap").write_bytes((tmp_path / "run.mcap").read_bytes()[:-8])
    assert_same_run(load_run(recover(tmp_path / "run.mcap").folder), load_run(bag))


def assert_same_run(mine: Run, other: Run) -> None:
    for part, names in (
        ("states", ("stamps", "position", "velocity", "effort")),
        ("commands", ("stamps", "effort")),
        (
            "control",
            ("stamps", "time", "reference", "estimate", "error", "output", "wrench"),
        ),
        ("criterion", ("stamps", "residual", "s", "phase", "verdict")),
        ("truth", ("stamps", "x", "x_dot", "q_a")),
        ("trajectory", ("time", "x", "x_dot", "x_ddot")),
    ):
        for name in names:
            np.testing.assert_array_equal(
                getattr(getattr(mine, part), name), getattr(getattr(other, part), name)
            )


def test_analysis_of_another_recorders_bag_says_what_it_does_not_know(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    as_ros2_bag_record(bag, tmp_path / "theirs", StoragePlugin.SQLITE3)
    assert cli.main(["analyze", str(tmp_path / "theirs")]) in (0, 1)
    printed = capsys.readouterr().out
    assert "law unknown, estimator unknown" in printed
    assert "not counted" in printed


def test_another_recorders_bag_is_analysed_whole_where_its_robot_is_given(
    bag: Path, tmp_path: Path
) -> None:
    """Crossings, instants and peaks are those of our own bag."""
    as_ros2_bag_record(bag, tmp_path / "theirs", StoragePlugin.MCAP)
    bare = load_run(tmp_path / "theirs")
    own = load_run(bag)
    assert bare.robot is None
    assert compute_metrics(bare).crossings == []
    given = load_run(tmp_path / "theirs", robot=own.robot)
    ours, theirs = compute_metrics(own), compute_metrics(given)
    assert theirs.crossings == ours.crossings != []
    assert (theirs.planned_peak_torque, theirs.peak_torque_near) == (
        ours.planned_peak_torque,
        ours.peak_torque_near,
    )
    robot = replace(own.robot, name="another")
    with pytest.warns(UserWarning, match="says which robot it is of"):
        assert load_run(bag, robot=robot).robot == own.robot


@pytest.mark.parametrize("named", [True, False])
def test_a_split_bag_loads_as_one(bag: Path, tmp_path: Path, named: bool) -> None:
    writer = BagWriter(tmp_path / "run.mcap", max_duration=0.5, folder=named)
    writer.add_metadata("dextar", {"version": "9.9"})
    with Reader(bag) as reader:
        first = reader.start_time
        for connection, time, raw in reader.messages():
            if not writer.has_topic(connection.topic):
                writer.add_topic(connection.topic, connection.msgtype, [])
            later = first + 1000 * (
                time - first
            )  # 1 us between two samples becomes 1 ms
            writer.add(SerializedMessage(later, connection.topic, time, 1, bytes(raw)))
    writer.close()
    assert len(writer.paths) > 10  # two digits: sorted by number, not by letter
    run = load_run(tmp_path)
    assert_same_run(run, load_run(bag))
    assert run.version == "9.9"


def test_of_two_robots_in_one_bag_one_has_to_be_named(
    bag: Path, tmp_path: Path
) -> None:
    as_ros2_bag_record(
        bag, tmp_path / "both", StoragePlugin.MCAP, prefixes=("/left", "/right")
    )
    with pytest.raises(
        BagError,
        match=(
            r"holds joint_states of 2 robots \(/left/joint_states,"
            r" /right/joint_states\)"
        ),
    ):
        load_run(tmp_path / "both")
    assert_same_run(load_run(tmp_path / "both", namespace="/right"), load_run(bag))
    with pytest.raises(BagError, match="holds no message of joint_states"):
        load_run(tmp_path / "both", namespace="middle")


def one_message(file: Path, topic: str, message: object) -> Path:
    kind = message.__msgtype__  # type: ignore[attr-defined]
    writer = BagWriter(file)
    writer.add_topic(topic, kind, [])
    writer.add(
        SerializedMessage(1, topic, 1, 1, bytes(TYPES.serialize_cdr(message, kind)))
    )
    writer.close()
    return file


def test_a_bag_of_something_else_is_told_by_what_it_holds(tmp_path: Path) -> None:
    other = joint_state(1, ["shoulder", "elbow"], (1.0, 2.0))
    with pytest.raises(
        BagError, match=r"arm.mcap: joint_states never holds the joints q11, q21"
    ):
        load_run(one_message(tmp_path / "arm.mcap", "/joint_states", other))
    text = TYPES.types["std_msgs/msg/String"](data="hello")
    with pytest.raises(
        BagError,
        match=(
            r"/joint_states is a std_msgs/msg/String; .* has a"
            r" sensor_msgs/msg/JointState there"
        ),
    ):
        load_run(one_message(tmp_path / "text.mcap", "/joint_states", text))
    with pytest.raises(
        BagError, match="holds no message of joint_states: not a run of this robot"
    ):
        load_run(one_message(tmp_path / "chatter.mcap", "/chatter", text))


def test_an_unusable_folder_is_named_in_one_sentence(bag: Path, tmp_path: Path) -> None:
    def folder(name: str, *files: str, listing: str = "") -> Path:
        made = tmp_path / name
        made.mkdir()
        for file in files:
            (made / file).write_bytes(bag.read_bytes())
        if listing:
            (made / "metadata.yaml").write_text(listing)
        return made

    lists = "rosbag2_bagfile_information: {{relative_file_paths: [{}]}}"
    for place, words in (
        (folder("void"), "void holds no .mcap or .db3 file"),
        (
            folder("several", "monday.mcap", "tuesday.mcap"),
            "several holds 2 files of different bags; name one of them",
        ),
        (
            folder("odd", "run.mcap", listing="[1, 2]"),
            "metadata.yaml is none of rosbag2; dextar recover saves what is there",
        ),
        (
            folder("torn", "run.mcap", listing="a: [b"),
            "metadata.yaml is none of rosbag2; dextar recover saves what is there",
        ),
        (
            folder("short", "run.mcap", listing=lists.format("run_0.mcap")),
            "lists run_0.mcap, which is not there",
        ),
    ):
        with pytest.raises(BagError, match=words):
            load_run(place)
    (tmp_path / "broken.db3").write_bytes(b"SQLite format 3\0" + bytes(500))
    with pytest.raises(BagError, match="broken.db3 cannot be read"):
        load_run(tmp_path / "broken.db3")
    assert_same_run(
        load_run(
            folder("named", "run.mcap", "noise.mcap", listing=lists.format("run.mcap"))
        ),
        load_run(bag),
    )


def test_a_damaged_chunk_costs_its_own_messages_and_is_told(
    bag: Path, tmp_path: Path
) -> None:
    damaged = with_damaged_chunks(bag, tmp_path / "damaged.mcap", 1)
    with pytest.warns(
        UserWarning,
        match=(
            "no message is left of 1 damaged chunk of .*damaged.mcap, for 0.00. s;"
            " dextar recover"
        ),
    ):
        run = load_run(damaged)
    assert not run.truncated
    assert [hole.chunks for hole in run.holes] == [1]
    assert 0 < len(run.states.stamps) < TICKS
    assert run.states.stamps[-1] == START + (TICKS - 1) * 1_000_000


def two_recordings(folder: Path, started: tuple[str, str] | None, apart: float) -> Path:
    """``run_0.mcap`` and ``run_1.mcap`` of two recordings that begin ``apart`` s from
    each other.
    """
    for number in range(2):
        writer = BagWriter(folder / f"run_{number}.mcap")
        if started is not None:
            writer.add_metadata("dextar", {"started": started[number]})
        writer.add_topic("/joint_states", "sensor_msgs/msg/JointState", [])
        for tick in range(50):
            log_time = START + round(number * apart * 1e9) + tick * 100_000_000
            stamp = START + (50 * number + tick) * 1_000_000
            data = bytes(
                TYPES.serialize_cdr(
                    joint_state(stamp, ["q11", "q21"], (1.0, 2.0)),
                    "sensor_msgs/msg/JointState",
                )
            )
            writer.add(
                SerializedMessage(log_time, "/joint_states", log_time, tick, data)
            )
        writer.close()
    return folder


@pytest.mark.parametrize(
    ("started", "apart", "why"),
    [
        (("monday", "tuesday"), 3600.0, "one began at monday, the other at tuesday"),
        (None, 2.0, "ends 2.900 s after"),
    ],
)
def test_two_recordings_named_like_one_split_bag_are_told_apart(
    tmp_path: Path, started: tuple[str, str] | None, apart: float, why: str
) -> None:
    two_recordings(tmp_path / "both", started, apart)
    for read in (load_run, recover):
        with pytest.raises(
            BagError,
            match=rf"run_0.mcap and .*run_1.mcap are of different recordings: .*{why}",
        ):
            read(tmp_path / "both")


def test_files_of_one_recording_are_read_as_one(tmp_path: Path) -> None:
    two_recordings(tmp_path / "one", ("monday", "monday"), 5.0)
    assert len(load_run(tmp_path / "one").states.stamps) == 100
    assert recover(tmp_path / "one").counts == {"/joint_states": 100}


def test_a_split_bag_whose_first_file_breaks_off_has_a_hole(tmp_path: Path) -> None:
    folder = two_recordings(tmp_path / "one", ("monday", "monday"), 5.0)
    first = folder / "run_0.mcap"
    first.write_bytes(first.read_bytes()[:-20])
    with pytest.warns(
        UserWarning, match="the missing end of .*run_0.mcap, for 0.100 s"
    ):
        run = load_run(folder)
    assert not run.truncated
    (hole,) = run.holes
    assert (hole.file, hole.chunks, hole.begin, hole.end) == (
        "run_0.mcap",
        0,
        START + 49_000_000,
        START + 50_000_000,
    )


def test_a_file_that_the_listing_misses_is_told(tmp_path: Path) -> None:
    folder = two_recordings(tmp_path / "one", ("monday", "monday"), 5.0)
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information: {relative_file_paths: [run_0.mcap]}"
    )
    with pytest.warns(
        UserWarning, match="does not list run_1.mcap beside it: not read"
    ):
        assert len(load_run(folder).states.stamps) == 50


def test_progress_is_told_in_bytes_over_all_files(tmp_path: Path) -> None:
    folder = two_recordings(tmp_path / "one", ("monday", "monday"), 5.0)
    size = sum(file.stat().st_size for file in folder.glob("*.mcap"))
    told: list[tuple[int, int]] = []
    load_run(folder, progress=lambda done, total: told.append((done, total)))
    assert told == sorted(told)
    assert {total for _, total in told} == {size}
    assert told[0][0] < told[-1][0] == size


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="No such file"):
        load_run(tmp_path / "none.mcap")
