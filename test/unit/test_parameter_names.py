"""Each parameter has one name in a group, and the names of the release before still
lead to it: in files, at a start, in campaigns and in bags, but not beside the new ones.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from synthetic_run import write_run

from dextar_control.analysis.differences import nodes_of
from dextar_control.analysis.load import load_run
from dextar_control.analysis.page import _changes
from dextar_control.bags.mcap_file import COMPRESSIONS
from dextar_control.contract.errors import ParameterError
from dextar_control.contract.former_names import (
    former_names,
    present_arguments,
    present_names,
    renamed_in_words,
)
from dextar_control.contract.help import node_help
from dextar_control.contract.node_parameters import PARAMETERS, parameters_of_node
from dextar_control.contract.parameters import Parameter, nearest_in_words
from dextar_control.contract.resources import (
    ROBOT_FILE,
    config_file,
    node_defaults,
)
from dextar_control.contract.settings import GROUPS, SETTING_NAMES, default_settings
from dextar_control.contract.yaml_text import dump_document
from dextar_control.experiments.campaign.config import load_config
from dextar_control.experiments.launch_arguments import changes, check_nodes, read
from dextar_control.experiments.start_check import check_start
from dextar_control.nodes.controller import ControllerNode
from dextar_control.planning.search import LOCUS_TIMES, CrossingCriterion

PLAIN = {
    "law",
    "estimator",
    "autostart",
    "enabled",
    "lockstep",
    "assembly_mode",
    "thread_priority",
    "cpu_affinity",
    "lock_memory",
    "mode",
    "command_interface",
    "seed",
    "window",
    "drawing",
    "output",
    "record_from_start",
}
"""What a user sets first, beside the few parameters of markers and panel."""
ROBOT = config_file(ROBOT_FILE)


def before(node: str, **changed: Any) -> dict[str, Any]:
    """All parameters of a node under the names of the release before."""
    defaults = node_defaults(node)
    values = {spec.formerly or spec.name: defaults[spec.name] for spec in specs(node)}
    assert changed.keys() <= values.keys()
    return values | changed


def specs(node: str) -> tuple[Parameter, ...]:
    return PARAMETERS[node]


def file_of(folder: Path, **nodes: dict[str, Any]) -> Path:
    """A parameter file of nodes."""
    path = folder / "params.yaml"
    sections = {f"/**/{node}": {"ros__parameters": own} for node, own in nodes.items()}
    path.write_text(dump_document(sections), encoding="utf-8")
    return path


@pytest.fixture
def spoken() -> Iterator[list[warnings.WarningMessage]]:
    """The warnings of a test."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield caught


@pytest.mark.parametrize("node", PARAMETERS)
def test_former_and_present_names_are_in_one_to_one_correspondence(node: str) -> None:
    names = [spec.name for spec in specs(node)]
    former = [spec.formerly for spec in specs(node) if spec.formerly]
    assert len({*names, *former}) == len(names) + len(former)
    assert sorted(former_names(specs(node)).values()) == sorted(
        spec.name for spec in specs(node) if spec.formerly
    )
    shared = set(node_defaults(node)) - set(names)  # of other nodes, under /**
    assert shared.isdisjoint(former)


@pytest.mark.parametrize("node", PARAMETERS)
def test_each_parameter_has_a_group_or_is_one_of_few_plain_names(node: str) -> None:
    groups = [spec.group for spec in specs(node)]
    assert groups == sorted(groups, key=groups.index), "a group stands in two places"
    plain = {spec.name for spec in specs(node) if not spec.group}
    assert plain <= PLAIN or len(specs(node)) < 5
    assert not plain & {*groups}, "a YAML file could not hold both"


@pytest.mark.parametrize("node", PARAMETERS)
def test_a_name_tells_seconds_and_limits_of_s_apart(node: str) -> None:
    for spec in specs(node):
        own = spec.name.rpartition(".")[2]
        assert own.endswith("abs_s") or "|s|" not in spec.description, spec.name
        assert not own.endswith("_s") or own.endswith("abs_s"), spec.name
        if own.endswith(("time", "timeout", "period")):
            assert spec.unit == "s", spec.name


def test_the_settings_are_grouped_as_the_parameters_are() -> None:
    named = {spec.name: spec for spec in specs("controller")}
    assert {*SETTING_NAMES} <= {*named}
    assert {named[name].group for name in SETTING_NAMES} == {"", *GROUPS}


def test_choices_and_limits_in_the_table_are_those_of_the_rooms_that_use_them() -> None:
    served = {spec.name: spec for spec in specs("trajectory_server")}
    kept = {spec.name: spec for spec in specs("recorder")}
    names = {criterion.name.lower() for criterion in CrossingCriterion}
    assert {*served["task.criterion"].choices} == names
    time = served["task.locus_time"]
    assert time.bounds == LOCUS_TIMES
    assert {*kept["bag.compression"].choices} == {*COMPRESSIONS}


@pytest.mark.parametrize("node", PARAMETERS)
def test_a_whole_file_of_the_release_before_gives_what_it_gave(
    node: str, tmp_path: Path
) -> None:
    path = file_of(tmp_path, **{node: before(node)})
    assert check_start(node, {}, ROBOT, path) == check_start(node, {}, ROBOT)


def test_former_names_are_told_in_one_sentence_with_the_present_ones() -> None:
    given = {"coast_s": 0.12, "law": "dgm", "brake_gain": 0.1}
    values, renamed = present_names(specs("controller"), given)
    assert values == {
        "safe_stop.coast_below_abs_s": 0.12,
        "law": "dgm",
        "safe_stop.brake_gain": 0.1,
    }
    assert renamed_in_words(renamed) == (
        "parameters have been renamed: brake_gain is now safe_stop.brake_gain, coast_s"
        " is now safe_stop.coast_below_abs_s; the next release takes the present names"
        " only"
    )
    assert present_names(specs("controller"), values) == (values, {})


BOTH = (
    "parameter 'payload' is now called 'payload.mass', and both names are given; give"
    " 'payload.mass' alone"
)


def test_both_names_of_a_parameter_in_one_place_are_refused(tmp_path: Path) -> None:
    both = {"payload": 0.1, "payload.mass": 0.2}
    with pytest.raises(ParameterError, match=BOTH):
        check_start("plant", both, ROBOT)
    path = file_of(tmp_path, plant=both)
    for refused in (
        lambda: check_start("plant", {}, ROBOT, path),
        lambda: present_arguments("plant", ["--params-file", str(path)], folder),
    ):
        with pytest.raises(ParameterError, match=f"parameter file {path}: {BOTH}"):
            refused()
    words = ["--ros-args", "-p", "plant:payload:=0.1", "-p", "payload.mass:=0.2"]
    with pytest.raises(ParameterError, match=BOTH):
        present_arguments("plant", words, folder)


def folder() -> Path:
    """Stands where no file needs a copy."""
    raise AssertionError


def test_what_stands_later_overrides_what_stands_earlier_under_whichever_name(
    tmp_path: Path,
) -> None:
    old = file_of(tmp_path, plant={"payload": 0.1, "payload_time": 2.0})
    (tmp_path / "new").mkdir()
    new = file_of(tmp_path / "new", plant={"payload": {"mass": 0.3}})
    for files, mass in (((old, new), 0.3), ((new, old), 0.1)):
        values = check_start("plant", {}, ROBOT, *files)
        assert (values["payload.mass"], values["payload.time"]) == (mass, 2.0)
    assert check_start("plant", {"payload.mass": 0.5}, old)["payload.mass"] == 0.5


def test_a_command_line_is_given_present_names_for_its_own_node_only(
    tmp_path: Path,
) -> None:
    path = file_of(
        tmp_path,
        plant={"payload": 0.1, "push": [1.0, 0.0]},
        recorder={"notes": "1e3", "tags": "on", "extra_topics": ""},
    )
    words = ["--ros-args", "--params-file", str(path), "-p", "recorder:name:='a: b'"]
    words += ["--param", "sync_period:=2.0", "-r", "a:=b", "-p", "plant:payload:=1.0"]
    (tmp_path / "copy").mkdir()
    present, renamed = present_arguments("recorder", words, lambda: tmp_path / "copy")
    assert present[3:] == [
        "-p",
        "recorder:run.name:='a: b'",
        "--param",
        "bag.sync_period:=2.0",
        *words[7:],
    ]
    copy = Path(present[2])
    values = node_defaults("recorder", copy)
    assert values == {"run.notes": "1e3", "run.tags": "on", "topics.extra": ""}
    assert node_defaults("plant", copy) == {"payload": 0.1, "push": [1.0, 0.0]}
    assert {*renamed} == {"notes", "tags", "extra_topics", "name", "sync_period"}
    assert present_arguments("panel", words, folder) == (words, {})
    twice = ["--ros-args", "-p", "notes:=a", "-p", "notes:=b"]
    present, _ = present_arguments("recorder", twice, folder)
    assert present == ["--ros-args", "-p", "run.notes:=a", "-p", "run.notes:=b"]


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("safe_stop.brake_gian", "safe_stop.brake_gain"),
        ("brake_gian", "safe_stop.brake_gain"),
        ("coast_z", "safe_stop.coast_below_abs_s"),
        ("stop.brake_gain", "safe_stop.brake_gain"),
        ("estimater", "estimator"),
    ],
)
def test_a_misspelt_name_is_refused_with_the_nearest(given: str, meant: str) -> None:
    with pytest.raises(
        ParameterError,
        match=f"unknown parameter '{given}' for node controller; did you mean"
        f" '{meant}'?",
    ):
        check_start("controller", {given: 0.1}, ROBOT)
    assert nearest_in_words("qqqq", specs("controller")) == ""


def test_launch_arguments_override_a_file_of_the_release_before(tmp_path: Path) -> None:
    own = before("trajectory_server", duration=0.5, tour=4)
    path = file_of(tmp_path, trajectory_server=own, plant={"real_time_factor": 2.0})
    typed = dict.fromkeys(
        ("law", "estimator", "tour", "excite", "output", "discovery_range"), ""
    )
    switches = dict.fromkeys(
        ("real_time", "window", "record", "markers", "panel", "enclaves"), "false"
    )
    switches |= dict.fromkeys(("autostart", "activate", "plant"), "true")
    values = read(
        {
            **typed,
            **switches,
            "namespace": "/left",
            "duration": "2",
            "real_time_factor": "0.5",
            "robot_file": str(ROBOT),
            "params_file": str(path),
        }
    )
    check_nodes(values)
    told = changes(values)
    assert told["trajectory_server"] == {"autostart": True, "task.duration": 2.0}
    for node, name, value in (
        ("trajectory_server", "task.duration", 2.0),
        ("trajectory_server", "task.tour", 4),
        ("plant", "simulation.real_time_factor", 0.5),
    ):
        assert check_start(node, told[node], ROBOT, path)[name] == value


def test_settings_in_python_take_former_names_with_a_warning(
    spoken: list[warnings.WarningMessage],
) -> None:
    settings = default_settings(law="classic", coast_s=0.12)
    assert settings.safe_stop.coast_below_abs_s == 0.12
    assert [one.category for one in spoken] == [DeprecationWarning]
    with pytest.raises(ParameterError, match="both names are given"):
        default_settings(coast_s=0.1, **{"safe_stop.coast_below_abs_s": 0.1})
    with pytest.raises(ParameterError, match="did you mean 'watch.speed_time'?"):
        default_settings(**{"watch.speed_tiem": 0.1})


def test_a_campaign_of_the_release_before_is_taken_with_one_warning(
    tmp_path: Path, spoken: list[warnings.WarningMessage]
) -> None:
    document = yaml.safe_load(config_file("campaign_small.yaml").read_text())
    document["settings"] = {"zone": 0.25, "watch.speed_time": 0.01}
    document["cases"]["masses"]["settings"] = {"coast_s": 0.12, "zone": 0.3}
    path = tmp_path / "campaign.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    config = load_config(path)
    assert config.settings == {"near_locus.fade_abs_s": 0.25, "watch.speed_time": 0.01}
    assert config.cases["masses"].settings == {
        "safe_stop.coast_below_abs_s": 0.12,
        "near_locus.fade_abs_s": 0.3,
    }
    (told,) = (str(one.message) for one in spoken)
    assert "zone is now near_locus.fade_abs_s" in told and str(path) in told
    assert told.count("zone is now") == 1 and "coast_s is now" in told
    document["settings"] = {"zone": 0.25, "near_locus.fade_abs_s": 0.25}
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    with pytest.raises(ParameterError, match="both names are given") as refused:
        load_config(path)
    assert str(path) in str(refused.value)


def test_a_bag_of_the_release_before_is_shown_under_the_present_names(
    tmp_path: Path,
) -> None:
    recorded = {node: before(node) for node in ("plant", "trajectory_server")}
    recorded["controller"] = before("controller", watch_ratio=3.5, zone=0.25)
    change = {
        "time": 0,
        "node": "/controller",
        "name": "brake_gain",
        "value": 0.5,
    }
    write_run(tmp_path / "run.mcap", parameters=recorded, changes=[change])
    run = load_run(tmp_path / "run.mcap")
    for node, values in recorded.items():
        own = {name for name in run.parameters[node] if not name.startswith("robot.")}
        assert own == {spec.name for spec in parameters_of_node(f"/{node}")}, node
        assert len(own) == len(values)
    shown = {node.name: node for node in nodes_of(run)}
    assert [name for name, *_ in shown["controller"].changed] == [
        "near_locus.fade_abs_s",
        "torque_limit.peak_ratio",
    ]
    assert not shown["plant"].changed and not shown["trajectory_server"].changed
    (line,) = _changes(run)
    assert line.startswith("/controller.safe_stop.brake_gain was set to 0.5 at")


def test_help_has_a_heading_for_each_group() -> None:
    lines = node_help(ControllerNode).splitlines()
    for group in {spec.group for spec in specs("controller")} - {""}:
        begin = lines.index(f"parameters {group}.*:") + 1
        part = lines[begin : (lines + [""]).index("", begin)]
        named = [line.split()[0] for line in part if line.startswith("  " + group)]
        assert named == [
            spec.name for spec in specs("controller") if spec.group == group
        ]
