"""Truncated, empty, foreign and mixed-up bags: one clear message, a non-zero exit,
never a traceback.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer
from recorded_run import rewrite
from synthetic_run import START, TICKS, message

from dextar_control.analysis import load_run
from dextar_control.cli import main as cli

pytestmark = pytest.mark.usefixtures("patient")

HOUR = 3600  # s
TRUTH = ("/sim/end_effector", "/sim/joint_states")


def later(content: Any, seconds: int) -> Any:
    moved = copy.deepcopy(content)
    object.__setattr__(moved.header.stamp, "sec", moved.header.stamp.sec + seconds)
    return moved


def moving(
    *topics: str, seconds: int = HOUR
) -> Callable[[str, Any], list[tuple[str, Any]]]:
    return lambda topic, content: [
        (topic, later(content, seconds) if topic in topics else content)
    ]


def renamed(topic: str, content: Any) -> list[tuple[str, Any]]:
    changed = copy.deepcopy(content)
    if topic == "/joint_states":
        object.__setattr__(changed, "name", ["shoulder", "elbow"])
    return [(topic, changed)]


def words_alone(topic: str, content: Any) -> list[tuple[str, Any]]:
    return (
        [("/chatter", message("std_msgs/msg/String", data="hello"))]
        if topic == "/joint_states"
        else []
    )


def swapped(topic: str, content: Any) -> list[tuple[str, Any]]:
    names = {"/joint_states": "/sim/end_effector", "/sim/end_effector": "/joint_states"}
    return [(names.get(topic, topic), content)]


def empty(good: Path, folder: Path) -> Path:
    (folder / "x.mcap").write_bytes(b"")
    return folder / "x.mcap"


def cut_early(good: Path, folder: Path) -> Path:
    (folder / "x.mcap").write_bytes(good.read_bytes()[:60])
    return folder / "x.mcap"


def archive(good: Path, folder: Path) -> Path:
    (folder / "x.mcap").write_bytes(b"PK\x03\x04" + bytes(500))
    return folder / "x.mcap"


def no_bag_in_a_folder(good: Path, folder: Path) -> Path:
    return folder


def others_topics(good: Path, folder: Path) -> Path:
    return rewrite(good, folder / "x.mcap", words_alone, keep_metadata=False)


def others_joints(good: Path, folder: Path) -> Path:
    return rewrite(good, folder / "x.mcap", renamed)


def others_types(good: Path, folder: Path) -> Path:
    return rewrite(good, folder / "x.mcap", swapped)


def two_runs(good: Path, folder: Path) -> Path:
    return rewrite(
        [good, good], folder / "x.mcap", lambda topic, content: [(topic, content)]
    )


def others_commands(good: Path, folder: Path) -> Path:
    return rewrite(good, folder / "x.mcap", moving("/joint_commands"))


def others_controller(good: Path, folder: Path) -> Path:
    return rewrite(good, folder / "x.mcap", moving("/controller_state", "/criterion"))


def others_truth(good: Path, folder: Path) -> Path:
    return rewrite(good, folder / "x.mcap", moving(*TRUTH))


def half_anothers_truth(good: Path, folder: Path) -> Path:
    return rewrite(good, folder / "x.mcap", moving(TRUTH[0]))


def broken_bytes(good: Path, folder: Path) -> Path:
    content = bytearray(good.read_bytes())
    for place in range(2000, len(content) - 2000, 97):
        content[place] ^= 0xFF
    (folder / "x.mcap").write_bytes(content)
    return folder / "x.mcap"


BAD = {
    empty: "is empty",
    cut_early: "holds no ROS 2 message",
    archive: "is not an MCAP file",
    no_bag_in_a_folder: "",
    others_topics: "holds no message of joint_states",
    others_joints: "never holds the joints q11, q21",
    others_types: "is a nav_msgs/msg/Odometry",
    two_runs: "fall back by 1.000 s after 1001 of 2002 messages: two runs in one bag",
    others_commands: "none of the 998 stamps of joint_commands",
    others_controller: "none of the 1001 stamps of controller_state",
    others_truth: "none of the 1001 stamps of sim/end_effector",
    half_anothers_truth: "have none in common",
    broken_bytes: "",
}


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("make", BAD, ids=lambda make: make.__name__)
def test_every_command_refuses_it_in_one_line(
    make: Callable[[Path, Path], Path],
    good: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "bag").mkdir()
    bad = str(make(good, tmp_path / "bag"))
    output = ["--output", str(tmp_path / "out")]
    for command in (
        ["analyze", bad, *output],
        ["compare", bad, bad, *output],
        ["replay", bad],
        ["export", bad, *output],
    ):
        assert cli.main(command) == 2
        (error,) = capsys.readouterr().err.splitlines()
        assert error.startswith(f"dextar {command[0]}: ")
        assert BAD[make] in error
        assert str(tmp_path / "bag") in error
    assert not (tmp_path / "out").exists()


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_truncated_bag_is_analysed_and_says_so(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "cut.mcap"
    content = good.read_bytes()
    file.write_bytes(content[: int(0.6 * len(content))])
    assert cli.main(["analyze", str(file)]) == 1
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert "breaks off or is damaged" in capsys.readouterr().err
    assert metrics["truncated"] is True
    assert metrics["success"] is None  # the run may have gone on as well as it began
    assert (
        len(metrics["reasons"]) == 1
        and "the bag breaks off at" in metrics["reasons"][0]
    )
    assert {crossing["outcome"] for crossing in metrics["crossings"]} <= {
        "crossed",
        "not recorded",
    }
    assert (
        "The bag breaks off or is damaged: read up to its last complete chunk."
        in (tmp_path / "report.html").read_text()
    )


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(
    ("words", "left"),
    [
        (("export", "CUT", "--format", "csv"), "run.csv"),
        (("compare", "GOOD", "CUT"), "comparison.json"),
        (("replay", "CUT", "--speed", "1", "--fps", "5"), "replay.gif"),
    ],
)
def test_the_other_commands_write_what_is_left_of_a_truncated_bag_and_end_alike(
    words: tuple[str, ...],
    left: str,
    good: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    content = good.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: int(0.6 * len(content))])
    places = {"CUT": str(tmp_path / "cut.mcap"), "GOOD": str(good)}
    output = tmp_path / "out" / ("replay.gif" if words[0] == "replay" else "")
    output.parent.mkdir(exist_ok=True)
    assert (
        cli.main([*(places.get(word, word) for word in words), "--output", str(output)])
        == 1
    )
    assert "breaks off or is damaged" in capsys.readouterr().err
    assert (tmp_path / "out" / left).stat().st_size > 0


def test_one_wrong_stamp_is_no_second_run(good: Path, tmp_path: Path) -> None:
    def once(topic: str, content: Any) -> list[tuple[str, Any]]:
        wrong = topic == "/joint_states" and content.header.stamp.nanosec == 500_000_000
        return [(topic, later(content, HOUR) if wrong else content)]

    run = load_run(rewrite(good, tmp_path / "x.mcap", once))
    assert len(run.states.stamps) == TICKS
    assert run.states.stamps[-1] == START + HOUR * 10**9 + 500_000_000


def test_a_bag_of_two_robots_is_analysed_by_namespace(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def twice(topic: str, content: Any) -> list[tuple[str, Any]]:
        return (
            [(f"/{robot}{topic}", content) for robot in ("left", "right")]
            if topic != "/diagnostics"
            else []
        )

    bag = str(rewrite(good, tmp_path / "two.mcap", twice, keep_metadata=False))
    assert cli.main(["analyze", bag, "--output", str(tmp_path / "out")]) == 2
    assert (
        "of 2 robots (/left/joint_states, /right/joint_states)"
        in capsys.readouterr().err
    )
    code = cli.main(
        ["analyze", bag, "--output", str(tmp_path / "out"), "--namespace", "left"]
    )
    assert code in (0, 1)
    assert (
        json.loads((tmp_path / "out" / "metrics.json").read_text())["states"] == TICKS
    )


def test_a_time_that_is_none_is_damage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "run.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", b"")
        writer.add_message(
            writer.register_channel("/joint_states", "cdr", schema),
            2**63,
            b"\0\1\0\0",
            0,
        )
        writer.finish()
    assert cli.main(["analyze", str(file)]) == 2
    assert (
        "has the time 9223372036854775808 ns: the file is damaged"
        in capsys.readouterr().err
    )
