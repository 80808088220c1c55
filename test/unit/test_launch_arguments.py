"""The launch file's arguments: what they mean and how each that cannot be used is
refused, without an installed launch.
"""

from __future__ import annotations

import importlib.util
import re
import sys
import types
from pathlib import Path
from typing import Any

import pytest

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.resources import NODES_FILE, ROBOT_FILE, config_file
from dextar_control.experiments.launch_arguments import (
    ARGUMENTS,
    changes,
    check_nodes,
    misspelt,
    read,
)

LAUNCH_FILE = Path(__file__).resolve().parents[2] / "launch" / "crossing.launch.py"
PLAIN = {name: argument.default for name, argument in ARGUMENTS.items()} | {
    "robot_file": str(config_file(ROBOT_FILE)),
    "params_file": str(config_file(NODES_FILE)),
    "discovery_range": "LOCALHOST",
}


def test_without_arguments_the_parameter_files_decide() -> None:
    values = read(PLAIN)
    assert [
        values[name] for name in ("law", "estimator", "tour", "duration", "output")
    ] == [""] * 5
    assert (values["plant"], values["real_time"], values["namespace"]) == (
        True,
        False,
        "/",
    )


@pytest.mark.parametrize("word", ["true", "True", "TRUE", "1", "yes", "On", " true "])
@pytest.mark.parametrize(
    ("other", "value"),
    [("false", True), ("False", False), ("0", False), ("no", False), ("OFF", False)],
)
def test_a_switch_takes_every_common_word(word: str, other: str, value: bool) -> None:
    assert read(PLAIN | {"real_time": word})["real_time"] is True
    if not value:
        assert read(PLAIN | {"record": other})["record"] is False


def test_values_have_the_type_of_the_parameter_they_become() -> None:
    values = read(
        PLAIN | {"tour": "6", "duration": "2", "law": "Classic", "output": "a #1.mcap"}
    )
    assert [values[name] for name in ("tour", "duration", "law", "output")] == [
        6,
        2.0,
        "classic",
        "a #1.mcap",
    ]
    assert [type(values[name]) for name in ("tour", "duration")] == [int, float]
    assert read(PLAIN | {"duration": "5e-1"})["duration"] == 0.5


@pytest.mark.parametrize(
    ("name", "text", "limit"),
    [
        ("real_time", "maybe", "true or false"),
        ("real_time_factor", "slow", "a number"),
        ("real_time_factor", "-1", ">= 0"),
        ("record", "", "true or false"),
        ("law", "clasic", "consistent"),
        ("estimator", "kalman", "observer"),
        (
            "discovery_range",
            "everywhere",
            "one of LOCALHOST, SUBNET, OFF, SYSTEM_DEFAULT",
        ),
        ("tour", "abc", "a number"),
        ("tour", "2.5", "an integer"),
        ("tour", "-1001", ">= -1000"),
        ("tour", "5000", "<= 1000"),
        ("duration", "fast", "a number"),
        ("duration", "nan", "finite"),
        ("duration", "-1", ">= 0"),
        ("duration", "0.001", "0.02"),
        ("output", "run.db3", "a name that ends in .mcap"),
        ("namespace", "/a b", "a ROS namespace such as /left"),
        ("namespace", "1st", "a ROS namespace such as /left"),
        ("params_file", "/no/such/file.yaml", "No such file or directory"),
        ("robot_file", "/no/such/file.yaml", "No such file or directory"),
        ("params_file", "/", "it is a folder, not a file"),
        ("params_file", "/dev/zero", "it is larger than 4 MB"),
        ("params_file", "~no_such_user/params.yaml", "a file that can be found"),
        ("params_file", "x" * 5000, "File name too long"),
        ("params_file", "", "it is a folder, not a file"),
    ],
)
def test_what_cannot_be_used_is_refused_with_argument_value_and_limit(
    name: str, text: str, limit: str
) -> None:
    with pytest.raises(ParameterError) as refused:
        read(PLAIN | {name: text})
    said = str(refused.value)
    assert said.startswith("launch argument ")
    assert name in said
    assert limit in said
    assert not text or text in said
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"robot: [1, 2\n", "a parameter file that nodes take"),
        (b"# caf\xe9\na: {}\n", "line 1 is not UTF-8"),
        (b"", "with sections"),
        (b"- a\n", "a list stands where a node's name is wanted"),
    ],
    ids=["broken", "Latin-1", "empty", "a list"],
)
def test_a_parameter_file_that_no_node_can_read_is_refused_before_they_start(
    tmp_path: Path, content: bytes, words: str
) -> None:
    file = tmp_path / "params.yaml"
    file.write_bytes(content)
    with pytest.raises(
        ParameterError,
        match=f"launch argument 'params_file' = '{file}'; it must be .*{words}",
    ) as refused:
        read(PLAIN | {"params_file": str(file)})
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "    law: consistent",
            "    lwa: consistent",
            "controller: unknown parameter 'lwa' for node controller",
        ),
        (
            "      substeps: 4",
            "      substepz: 4",
            "plant: unknown parameter 'simulation.substepz' for node plant",
        ),
        (
            "      repeat: 1",
            "      repeat: 0",
            "trajectory_server: parameter 'task.repeat' = 0; it must be >= 1",
        ),
        (
            "    law: consistent",
            "    law: clasic",
            "controller: parameter 'law' = 'clasic'; it must be one of",
        ),
    ],
)
def test_what_a_node_would_refuse_of_its_parameter_file_is_refused_before_it_starts(
    old: str, new: str, words: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    text = Path(PLAIN["params_file"]).read_text(encoding="utf-8")
    assert text.count(old) == 1
    file = tmp_path / "params.yaml"
    file.write_text(text.replace(old, new), encoding="utf-8")
    check = loaded(monkeypatch, tmp_path).check
    for namespace in ("/", "/left"):
        with pytest.raises(ParameterError) as refused:
            check(context_of(params_file=str(file), namespace=namespace))
        assert words in str(refused.value) and str(file) in str(refused.value)
        assert len(str(refused.value).splitlines()) == 1


def test_only_nodes_that_are_started_are_asked_and_arguments_win_over_files(
    tmp_path: Path,
) -> None:
    file = tmp_path / "params.yaml"
    file.write_text(
        "/**/plant: {ros__parameters: {substepz: 4}}\n/**/controller: {ros__parameters:"
        " {law: clasic}}\n"
    )
    check_nodes(
        read(PLAIN | {"params_file": str(file), "plant": "false", "law": "classic"})
    )
    with pytest.raises(ParameterError, match="plant: unknown parameter 'substepz'"):
        check_nodes(read(PLAIN | {"params_file": str(file), "law": "classic"}))


def test_a_name_that_looks_like_an_argument_is_told() -> None:
    assert misspelt(["tuor", "tour", "zzz"]) == [
        "launch argument 'tuor' is unknown and has no effect; did you mean 'tour'?"
    ]


class Recorded:
    """Stands for any action, substitution or event of launch: it keeps what it was made
    of.
    """

    def __init__(self, *given: Any, **named: Any) -> None:
        self.given, self.named = given, named

    def perform(self, context: Any) -> str:
        return context.launch_configurations[self.given[0]]


def loaded(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """The launch file as a module, whose imports of launch are recorded only."""
    kinds: dict[str, type] = {}
    names = {
        "launch": ("LaunchContext", "LaunchDescription"),
        "launch.events": (),
        "launch_ros": (),
        "launch.actions": (
            "DeclareLaunchArgument",
            "ExecuteProcess",
            "LogInfo",
            "OpaqueFunction",
            "RegisterEventHandler",
            "SetEnvironmentVariable",
            "Shutdown",
        ),
        "launch.event_handlers": ("OnProcessExit",),
        "launch.events.process": ("ProcessExited",),
        "launch.substitutions": ("EnvironmentVariable", "LaunchConfiguration"),
        "launch_ros.actions": ("Node",),
        "launch_ros.parameter_descriptions": ("ParameterValue",),
    }
    for module, classes in names.items():
        stub = types.ModuleType(module)
        for name in classes:
            kinds[name] = type(name, (Recorded,), {})
            setattr(stub, name, kinds[name])
        monkeypatch.setitem(sys.modules, module, stub)
    index = types.ModuleType("ament_index_python.packages")
    setattr(index, "get_package_prefix", lambda _: str(tmp_path))
    setattr(
        index,
        "get_package_share_directory",
        lambda _: str(Path(PLAIN["params_file"]).parents[1]),
    )
    monkeypatch.setitem(sys.modules, "ament_index_python.packages", index)
    spec = importlib.util.spec_from_file_location("crossing_launch", LAUNCH_FILE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def context_of(**given: str) -> Any:
    return types.SimpleNamespace(launch_configurations=PLAIN | given)


def test_the_arguments_are_checked_before_anything_is_compiled(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    module = loaded(monkeypatch, tmp_path)
    entities = module.generate_launch_description().given[0]
    kinds = [type(entity).__name__ for entity in entities]
    assert kinds.count("DeclareLaunchArgument") == len(ARGUMENTS)
    assert {entity.given[0] for entity in entities[: len(ARGUMENTS)]} == set(ARGUMENTS)
    assert kinds[len(ARGUMENTS)] == "OpaqueFunction"
    assert "ExecuteProcess" not in kinds[: len(ARGUMENTS)]
    check = entities[len(ARGUMENTS)].named["function"]
    with pytest.raises(
        ParameterError, match="launch argument 'tour' = 'abc'; it must be a number"
    ):
        check(context_of(tour="abc"))
    context = context_of(discovery_range="subnet", tuor="3")
    assert [entity.named["msg"] for entity in check(context)] == misspelt(["tuor"])
    assert context.launch_configurations["discovery_range"] == "SUBNET"


def test_the_identification_is_launched_as_a_crossing_is_with_an_exciting_motion() -> (
    None
):
    text = (LAUNCH_FILE.parent / "identify.launch.py").read_text(encoding="utf-8")
    assert LAUNCH_FILE.name in text
    (told,) = re.findall(r'EXCITE = "(\d+)"', text)
    assert changes(read(PLAIN | {"excite": told}))["trajectory_server"] == {
        "autostart": True,
        "task.excite": float(told),
    }


def test_only_what_was_given_overrides_the_parameter_files(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    module = loaded(monkeypatch, tmp_path)
    nodes = {
        node.named["name"]: node.named["parameters"][2]
        for node in module.nodes(context_of())
    }
    assert nodes == {
        "plant": {"mode": "lockstep", "window": False},
        "controller": {"lockstep": True, "autostart": True},
        "trajectory_server": {"autostart": True},
        "recorder": {},
    }
    paced = module.nodes(context_of(real_time="yes", real_time_factor="0.5"))
    nodes = {node.named["name"]: node.named["parameters"][2] for node in paced}
    assert nodes["plant"] == {
        "mode": "realtime",
        "window": False,
        "simulation.real_time_factor": 0.5,
    }
    assert nodes["controller"] == {"lockstep": False, "autostart": True}
    given = {
        "markers": "1",
        "plant": "No",
        "tour": "6",
        "law": "multi_model",
        "duration": "2",
        "output": "a: b #1.mcap",
        "estimator": "plain",
    }
    nodes = {
        node.named["name"]: node.named["parameters"][2]
        for node in module.nodes(context_of(**given))
    }
    assert set(nodes) == {"controller", "trajectory_server", "recorder", "markers"}
    assert nodes["controller"] == {
        "lockstep": False,
        "autostart": True,
        "law": "multi_model",
        "estimator": "plain",
    }  # a rig's
    assert nodes["trajectory_server"] == {
        "autostart": True,
        "task.tour": 6,
        "task.duration": 2.0,
        "task.criterion": "zero_wrench",
    }
    output = nodes["recorder"]["output"]
    assert (output.given, output.named) == (("a: b #1.mcap",), {"value_type": str})


def test_each_argument_is_described_by_a_sentence() -> None:
    assert [
        name
        for name, each in ARGUMENTS.items()
        if not (each.told[0].isupper() and each.told.endswith("."))
    ] == []
