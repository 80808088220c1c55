"""The interface package says what the contract says; it is built, and a goal, its
feedback, its cancel go over the wire.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from patience import PATIENCE
from rig import NODES, start, stop
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dextar_control.contract.topics import (
    CONTROLLER_STATE,
    CRITERION_NAMES,
    INTERFACES,
    PHASES,
    WITHOUT_INTERFACES,
)
from dextar_control.control.verdicts import Verdict
from dextar_control.executables import go_server
from dextar_control.nodekit.layouts import template
from dextar_control.nodes.readable import fill

ROOT = Path(__file__).resolve().parents[2]
TOOLS = ROOT / "test" / "tools"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6  # action_msgs/msg/GoalStatus
PARTS = {"": [""], "2": ["_q11", "_q21"]}


def read(name: str) -> Any:
    """A message's class, as rosbags makes it of the definition."""
    types = get_typestore(Stores.ROS2_JAZZY)
    path = ROOT / "interfaces" / "msg" / f"{name}.msg"
    types.register(
        get_types_from_msg(path.read_text(encoding="utf-8"), f"{INTERFACES}/msg/{name}")
    )
    return types.types[f"{INTERFACES}/msg/{name}"]


def fields(name: str) -> list[tuple[str, str]]:
    """Each number's type and name, in order, what has no number left out."""
    text = (ROOT / "interfaces" / "msg" / f"{name}.msg").read_text(encoding="utf-8")
    words = [line.partition("#")[0].split() for line in text.splitlines()]
    return [
        (word[0], word[1])
        for word in words
        if len(word) == 2 and "/" not in word[0] and "=" not in word[1]
    ]


def test_the_criterions_fields_are_the_contracts_in_its_order() -> None:
    told = [
        f"{name}{part}"
        for kind, name in fields("Criterion")
        for part in PARTS["2" if kind.endswith("[2]") else ""]
    ]
    assert told == list(CRITERION_NAMES)
    numbers = {
        name: value for name, value in vars(read("Criterion")).items() if name.isupper()
    }
    assert numbers == {name.upper(): number for number, name in enumerate(PHASES)} | {
        verdict.name: verdict.value for verdict in Verdict
    }


def test_the_states_fields_are_as_many_as_its_template_has_numbers() -> None:
    assert {kind for kind, _ in fields("ControllerState")} == {"float64[2]"}
    names = [
        name
        for name in read("ControllerState").__dataclass_fields__
        if not name.startswith("__")
    ]
    assert names == [
        "header",
        "reference_time",
        *(name for _, name in fields("ControllerState")),
    ]
    template(CONTROLLER_STATE).pack(0, [0.0] * 2 * len(fields("ControllerState")))


def test_the_action_is_one() -> None:
    parser = pytest.importorskip("rosidl_adapter.parser")
    path = ROOT / "interfaces" / "action" / "Go.action"
    action = parser.parse_action_string(
        INTERFACES, "Go", path.read_text(encoding="utf-8")
    )
    parts = [
        [field.name for field in part.fields]
        for part in (action.goal, action.result, action.feedback)
    ]
    assert parts == [
        ["task", "crossings", "point", "duration", "repeat"],
        ["done", "verdicts", "confidences", "largest_error", "bag", "message"],
        ["phase", "crossing", "crossings", "s", "confidence", "progress"],
    ]


def test_without_the_package_its_server_says_what_to_do(
    capsys: pytest.CaptureFixture[str],
) -> None:
    if importlib.util.find_spec(INTERFACES) is not None:
        pytest.skip("the package is installed")
    assert go_server() == 2
    assert capsys.readouterr().err == f"error: {WITHOUT_INTERFACES}\n"
    controller = start(
        "dextar_control.nodes.controller", "-p", "publish.readable:=true"
    )
    output = controller.communicate(timeout=PATIENCE)[0]
    assert controller.returncode == 2, output
    assert f"publish.readable = true: {WITHOUT_INTERFACES}, or leave it false" in output


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a shell that has sourced both packages, built by colcon as the
    documentation says.
    """
    prefix = next(
        (
            path
            for path in os.environ.get("AMENT_PREFIX_PATH", sys.prefix).split(
                os.pathsep
            )
            if Path(path, "share", "rosidl_default_generators").is_dir()
        ),
        "",
    )
    if not (prefix and shutil.which("cmake") and shutil.which("c++")):
        pytest.skip(
            "no generators, which make test brings, or no cmake and g++, which apt has"
        )
    pytest.importorskip(
        "colcon_ros", reason="colcon is not installed: make test installs it"
    )
    folder = tmp_path_factory.mktemp("workspace")
    shutil.copytree(ROOT / "interfaces", folder / "interfaces")
    (folder / ".python").symlink_to(
        sys.prefix
    )  # colcon's set-up scripts break on an interpreter path with a space
    python = folder / ".python" / "bin" / "python"
    environment = {
        **os.environ,
        "COLCON_LOG_LEVEL": "error",
        "PATH": f"{python.parent}{os.pathsep}{os.environ['PATH']}",
    }
    environment.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    environment.setdefault("CMAKE_PREFIX_PATH", environment["AMENT_PREFIX_PATH"])
    command = [
        python,
        "-m",
        "colcon",
        "build",
        "--cmake-args",
        f"-DPython3_EXECUTABLE={python}",
        f"-DCMAKE_PROJECT_INCLUDE={folder}/interfaces/on_wheels.cmake",
    ]
    made = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True
    )
    assert made.returncode == 0, made.stdout + made.stderr
    sourced = subprocess.run(
        ["bash", "-c", ". install/setup.bash && env -0"],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return dict(
        entry.partition("=")[::2] for entry in sourced.stdout.split("\0") if entry
    )


@pytest.fixture(scope="module")
def go(
    built: dict[str, str], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[list[dict[str, Any]]]:
    """What goals to a running robot came to, and a readable message of each kind."""
    bag = tmp_path_factory.mktemp("run") / "run.mcap"
    nodes = NODES | {"go_server": ("dextar_control.nodes.go_server", ())}
    own = {"controller": ("publish.readable:=true",), "recorder": (f"output:={bag}",)}
    goals: list[dict[str, Any]] = [
        {},
        {"task": 7},
        {"task": 2},
        {"task": 3, "point": [0.0, 0.05]},
        {"task": 1, "duration": 30.0, "cancel_in": "TRACK"},
        {},
    ]
    processes = []
    with pytest.MonkeyPatch.context() as patch:
        for name, value in built.items():
            patch.setenv(name, value)
        patch.setenv(
            "PYTHONPATH",
            os.pathsep.join([str(ROOT), str(TOOLS), built.get("PYTHONPATH", "")]),
        )
        try:
            for name, (module, values) in nodes.items():
                options = [
                    part
                    for value in (*values, *own.get(name, ()))
                    for part in ("-p", value)
                ]
                processes.append(start(module, "-r", "__ns:=/left", *options))
            deadline = time.monotonic() + PATIENCE
            while (
                not bag.exists()
            ):  # a recorder that begins later is none of the first goal's
                assert time.monotonic() < deadline and all(
                    process.poll() is None for process in processes
                )
                time.sleep(0.1)
            asked = subprocess.run(
                [sys.executable, TOOLS / "action_client.py"],
                input="".join(f"{json.dumps(goal)}\n" for goal in goals),
                capture_output=True,
                text=True,
                timeout=8 * PATIENCE,
            )
        finally:
            ends = [stop(process) for process in reversed(processes)]
    for code, output in ends:
        assert code == 0, output
        assert "Traceback" not in output, output
    assert asked.returncode == 0, asked.stderr + "".join(output for _, output in ends)
    yield [json.loads(line) for line in asked.stdout.splitlines()]


def test_a_goal_is_followed_to_its_end(go: list[dict[str, Any]]) -> None:
    told = go[0]
    assert (told["status"], told["done"], told["verdicts"]) == (
        SUCCEEDED,
        True,
        ["crossed"] * 2,
    ), told["message"]
    assert all(0.9 < confidence <= 1.0 for confidence in told["confidences"])
    assert 0.0 < told["largest_error"] < 1e-3
    assert told["bag"].endswith("run.mcap")
    assert "done: crossed 2 of 2 planned" in told["message"]
    assert {"TRACK", "HOLD"} <= set(told["phases"])
    phase, crossing, crossings, s, confidence, progress = told["last"]
    assert (phase, crossing, crossings, progress) == ("HOLD", 2, 2, 1.0)
    assert abs(s) > 0.3 and confidence > 0.9


def test_a_goal_that_cannot_be_is_aborted_with_what_to_do(
    go: list[dict[str, Any]],
) -> None:
    unknown, empty, off, last = go[1], go[2], go[3], go[5]
    assert {told["status"] for told in (unknown, empty, off, last)} == {ABORTED}
    assert (
        "task = 7; it must be 0 (as set), 1 (trip), 2 (tour) or 3 (point)"
        in unknown["message"]
    )
    assert "crossings = 0 for a tour; it must be 1 to 1000" in empty["message"]
    assert "off the Type 2 locus" in off["message"]
    assert "phase SAFE_STOP" in last["message"]
    assert last["message"].endswith(
        "type dextar reset --namespace /left, then dextar enable --namespace /left"
    )


def test_a_cancel_is_a_safe_stop(go: list[dict[str, Any]]) -> None:
    told = go[4]
    assert (told["status"], told["done"]) == (CANCELED, False), told
    assert "not done: crossed 0 of 2 planned" in told["message"]
    assert "SAFE_STOP (stop requested; at rest" in told["message"]
    assert told["last"][0] == "SAFE_STOP"


def test_the_readable_messages_say_where_the_robot_is(go: list[dict[str, Any]]) -> None:
    state, criterion = go[6:]
    assert state["reference_position"] == pytest.approx(
        state["estimated_position"], abs=0.05
    )
    assert state["estimated_position"][1] > 0.05
    assert criterion["phase"] == list(PHASES).index("safe_stop")
    assert (
        criterion["assembly_mode"] == 1
        and criterion["s"] > 0.2
        and 0.5 <= criterion["mode_confidence"] <= 1.0
    )


def test_numbers_go_into_the_fields_in_their_order() -> None:
    class Message:
        @staticmethod
        def get_fields_and_field_types() -> dict[str, str]:
            return {
                "header": "std_msgs/Header",
                "a": "double",
                "phase": "uint8",
                "b": "double[2]",
            }

    message = Message()
    fill(message, [1.5, 4.0, 2.0, 3.0])
    assert vars(message) == {"a": 1.5, "phase": 4, "b": [2.0, 3.0]}
