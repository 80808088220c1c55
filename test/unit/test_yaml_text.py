"""Files as ROS 2 reads them, and what is refused in one sentence."""

from __future__ import annotations

import math
import os
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from dextar_control.bags.folder import METADATA_FILE, METADATA_ROOT, read_listing
from dextar_control.bags.run_record import robot_file
from dextar_control.cli import main as cli
from dextar_control.contract import yaml_text
from dextar_control.contract.errors import BagError, ParameterError
from dextar_control.contract.resources import ROBOT_FILE, config_file, node_defaults
from dextar_control.contract.robot import load_robot
from dextar_control.contract.yaml_text import (
    assignment,
    dump_document,
    load_document,
    load_parameters,
    read_text,
)
from dextar_control.experiments.campaign.config import load_config
from dextar_control.experiments.faults.cases import load_cases
from dextar_control.nodekit.node import run_node


def test_a_path_that_is_not_utf_8_is_refused() -> None:
    with pytest.raises(
        ParameterError, match="it is not UTF-8, and a ROS 2 parameter must be"
    ):
        assignment("output", Path(os.fsdecode(b"caf\xe9.mcap")))


@pytest.mark.parametrize("name", ["1e3", "0x10", "yes", "5", "d'où", "a #b"])
def test_a_recorded_robot_keeps_its_name(tmp_path: Path, name: str) -> None:
    values = node_defaults("controller", config_file(ROBOT_FILE)) | {"robot.name": name}
    file = tmp_path / "robot.yaml"
    file.write_text(robot_file({"controller": values}), encoding="utf-8")
    assert load_robot(file).name == name
    assert "distal_mass: 0.1" in dump_document({"distal_mass": 0.1})


GOOD = config_file(ROBOT_FILE).read_bytes()
ODD_FILES = {  # content, what is said of it as a robot file
    "latin1": (
        b"# M\xe4rz\n" + GOOD,
        (
            "line 1 is not UTF-8 (byte 0xe4); if it is Latin-1, convert it: iconv -f"
            " ISO-8859-1"
        ),
    ),
    "utf16": (
        GOOD.decode().encode("utf-16"),
        "it is UTF-16, not UTF-8; convert it: iconv -f UTF-16",
    ),
    "utf16be": ("\ufeff".encode("utf-16-be"), "it is UTF-16"),
    "nul": (GOOD + b"\0", f"line {GOOD.count(bytes([10])) + 1} holds a NUL byte"),
    "null": (b"/**:\n  ros__parameters:\n    robot:\n", "line 3: 'robot' has no value"),
    "list": (
        b"/**:\n  ros__parameters:\n    robot: [1, 2]\n",
        "'robot' is [1, 2]; a description such as config/dextar.yaml",
    ),
    "word": (b"/**: {ros__parameters: {robot: hello}}\n", "'robot' is 'hello'"),
    "empty": (b"", "no entry '/**: ros__parameters: robot:'"),
    "scalar": (b"hello\n", "line 1: 'hello' stands where a node's name is wanted"),
    "top": (b"- 1\n", "line 1: a list stands where a node's name is wanted"),
    "no section": (
        b"ros__parameters: {a: 1}\n",
        "'ros__parameters' stands under no node's name",
    ),
    "no parameters": (
        b"/**:\n  ros__parameters:\n",
        "line 2: nothing stands where a mapping of parameters",
    ),
    "one underscore": (
        b"/**:\n  ros_parameters:\n    robot:\n      left: {axis: [0.0, 0.0]}\n",
        "line 2: 'ros_parameters' stands where 'ros__parameters', with two underscores",
    ),
    "tab": (
        b"/**:\n\tros__parameters: {a: 1}\n",
        "line 2: while scanning for the next token",
    ),
    "alias": (
        b"/**: {ros__parameters: {a: &x 1, b: *x}}\n",
        "line 1: ROS 2 knows no aliases (*x)",
    ),
    "mixed": (
        GOOD.replace(b"[1, -1]", b"[1, -1.0]"),
        "a list holds whole numbers and numbers with a point",
    ),
    "nested": (
        b"/**: {ros__parameters: {robot: {gravity: [[0.0]]}}}\n",
        "a list of lists or mappings is no value",
    ),
    "infinite": (
        b"/**: {ros__parameters: {robot: {name: x, working_mode: [.inf, 1.0]}}}\n",
        "robot parameters 'base_dist",
    ),
    "control": (b'/**: {ros__parameters: {a: "\x1b"}}\n', "unacceptable character"),
    "deep": (b"/**: {ros__parameters: " + b"{a: " * 3000, "it is nested too deeply"),
    "huge": (b"#" * 4_000_001, "it is larger than 4 MB"),
}


@pytest.mark.parametrize("name", ODD_FILES)
def test_a_file_that_is_no_robot_is_told_in_one_sentence(
    tmp_path: Path, name: str
) -> None:
    file = tmp_path / "robot.yaml"
    content, said = ODD_FILES[name]
    file.write_bytes(content)
    with pytest.raises(ParameterError) as caught:
        load_robot(file)
    assert (
        said in str(caught.value)
        and str(file) in str(caught.value)
        and "\n" not in str(caught.value)
    )


@pytest.mark.parametrize("name", ["latin1", "no parameters", "tab", "mixed"])
def test_a_node_refuses_such_a_file_in_the_same_sentence(
    tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "robot.yaml"
    content, said = ODD_FILES[name]
    file.write_bytes(content)
    assert run_node(lambda: None, ["--ros-args", "--params-file", str(file)]) == 2
    written = capfd.readouterr().err
    assert said in written and str(file) in written and written.count("\n") == 1


def test_an_infinite_working_mode_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        robot_file(
            {
                "a": (
                    node_defaults("a", config_file(ROBOT_FILE))
                    | {"robot.working_mode": [math.inf, 1.0]}
                )
            }
        )
    )
    with pytest.raises(
        ParameterError,
        match=r"robot.working_mode = \[inf, 1.0\]; it must be two numbers",
    ):
        load_robot(file)


@pytest.mark.parametrize(
    "read",
    [load_robot, load_config, load_cases, lambda path: node_defaults("plant", path)],
)
def test_what_is_no_text_file_is_told_in_one_sentence(
    tmp_path: Path, read: Any
) -> None:
    loop, latin = tmp_path / "loop", tmp_path / "latin1"
    loop.symlink_to(loop)
    latin.write_bytes(b"seed: 1\nrobot: caf\xe9\n")
    for path, said in (
        (tmp_path, "it is a folder, not a file"),
        (loop, "Too many levels of symbolic links"),
        (tmp_path / "none", "No such file"),
        (Path("/dev/zero"), "it is larger than 4 MB"),
        (latin, "line 2 is not UTF-8"),
    ):
        with pytest.raises(ParameterError) as caught:
            read(path)
        assert said in str(caught.value) and "\n" not in str(caught.value)


def test_no_parameter_of_a_file_stands_twice(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    robot: {left: {distal_mass: 1.0, distal_mass:"
        " 2.0}}\n"
    )
    with pytest.raises(
        ParameterError, match="line 3: the key 'distal_mass' stands there twice"
    ):
        load_parameters(file)


def test_a_document_has_rcls_numbers_and_no_key_twice(tmp_path: Path) -> None:
    file = tmp_path / "campaign.yaml"
    file.write_text(
        "\ufeffa: 1e-1\r\nb: 1:30\r\nc: null\r\nd: nan\r\ne: .inf\r\nf: [1, x,"
        " [2]]\r\ng: {<<: &m {h: 1}, i: 2}\r\nj: *m\r\n"
    )
    assert load_document(file, "x") == {
        "a": 0.1,
        "b": "1:30",
        "c": None,
        "d": "nan",
        "e": math.inf,
        "f": [1, "x", [2]],
        "g": {"h": 1, "i": 2},
        "j": {"h": 1},
    }
    file.write_text("seed: 1\nseed: 2\n")
    with pytest.raises(
        ParameterError, match="line 2: the key 'seed' stands there twice"
    ):
        load_document(file, "x")
    file.write_text("a: &a [*a]\n")
    with pytest.raises(ParameterError, match="an alias stands within what it names"):
        load_document(file, "x")
    levels = "".join(f"a{n + 1}: &a{n + 1} [*a{n}, *a{n}]\n" for n in range(40))
    file.write_text(f"a0: &a0 1\n{levels}")
    assert (
        len(load_document(file, "x")) == 41
    )  # 2 to the 40 if each alias were read anew


def test_a_listing_that_is_nested_too_deeply_is_no_listing(tmp_path: Path) -> None:
    (tmp_path / METADATA_FILE).write_text(f"{METADATA_ROOT}: {'[' * 5000}")
    with pytest.raises(BagError, match="metadata.yaml is none of rosbag2"):
        read_listing(tmp_path)


@pytest.mark.parametrize("seconds", ["nan", "0", "-1", "inf", "x"])
def test_a_bench_of_no_length_is_refused(
    seconds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        cli.main(["bench", f"--seconds={seconds}"])
    assert caught.value.code == 2 and "argument --seconds:" in capsys.readouterr().err


def test_a_file_without_a_byte_order_mark_is_what_it_was(tmp_path: Path) -> None:
    file = tmp_path / "x"
    file.write_bytes("\ufeffgrün\n".encode())
    assert read_text(file, "file") == "grün\n"


def test_a_pipe_without_a_writer_is_told_and_one_with_a_writer_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(yaml_text, "WRITER_PATIENCE", 0.05)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(
        ParameterError,
        match=(
            "parameter file .*pipe: it is a pipe, and nobody wrote into it within"
            " 0.05 s"
        ),
    ):
        load_parameters(pipe)
    reading, writing = os.pipe()

    def write() -> None:
        time.sleep(0.3)  # longer than the patience with a pipe that has no writer
        os.write(writing, b"/**:\n  ros__parameters:\n    a: 1e-1\n")
        os.close(writing)

    writer = threading.Thread(target=write)
    writer.start()
    assert load_parameters(f"/dev/fd/{reading}") == {"/**": {"a": 0.1}}
    writer.join()
    os.close(reading)
