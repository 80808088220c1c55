"""The layouts for Foxglove and PlotJuggler: whatever they plot exists in the contract,
with that meaning.
"""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import pytest

from dextar_control.contract.resources import config_file
from dextar_control.contract.topics import (
    BASE_FRAME,
    CONTROLLER_STATE,
    CRITERION,
    CRITERION_NAMES,
    MARKERS,
    TOPICS,
    Topic,
)
from dextar_control.security.policy import ENCLAVES

TABLE = {
    topic.name if topic.name.startswith("/") else f"/{topic.name}": topic
    for topic in TOPICS
}
PANELS = {
    "3D",
    "Plot",
    "StateTransitions",
    "DiagnosticSummary",
    "DiagnosticStatusPanel",
}
NODES = {profile.node for enclave in ENCLAVES for profile in enclave.rights}
# A message path as Foxglove documents it: topic, then fields, each perhaps with an
# index and filters.
STEP = re.compile(
    r"\.(?P<field>\w+)(?P<slice>\[(?:\d+|:)\])?(?P<filters>(?:\{\w+==\"[^\"]*\"\})*)"
)
PATH = re.compile(
    r"(?P<topic>(?:/\w+)+)(?P<steps>(?:\.\w+(?:\[(?:\d+|:)\])?(?:\{\w+==\"[^\"]*\"\})*)+)"
)
NUMBER = re.compile(r"-?\d+(\.\d+)?")
NUMERIC = {
    "double",
    "float",
    "octet",
    "boolean",
    *(f"{sign}int{size}" for sign in ("u", "") for size in (8, 16, 32, 64)),
}
ROWS = 4  # points of controller_state: reference, estimate, error, output
PANELS_HEIGHT = 880.0  # px that the panels have in a window of 1000
TOOLBAR, STATE_ROW, STATE_AXIS = (
    30.0,
    64.0,
    30.0,
)  # px, of a panel, and of a StateTransitions panel in particular
RANGES = {
    "s": (-1.0, 1.0),
    "sigma_min": (0.0, 1.0),
    "projection_weight": (0.0, 1.0),
    "mode_confidence": (0.5, 1.0),
}
TF_SETTINGS = {
    "editable",
    "showLabel",
    "labelSize",
    "axisScale",
    "lineWidth",
    "lineColor",
    "enablePreloading",
}


def _class(kind: str) -> Any:
    package, *_, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def _field(kind: str, name: str) -> str:
    fields = _class(kind).get_fields_and_field_types()
    assert name in fields, f"{kind} has no field {name}"
    return str(fields[name])


def _length(topic: Topic, field: str) -> int:
    """How many entries a sequence of a topic has, by the contract."""
    if topic is CRITERION:
        return len(CRITERION_NAMES)
    if topic is CONTROLLER_STATE and field == "points":
        return ROWS
    return len(topic.joints)


def _type_at(path: str) -> str:
    """The type of what a Foxglove path leads to."""
    whole = PATH.fullmatch(path)
    assert whole, path
    topic = TABLE[whole["topic"]]
    kind = topic.type
    for step in STEP.finditer(whole["steps"]):
        kind = _field(kind, step["field"])
        if kind.startswith("sequence<"):
            kind = kind.removeprefix("sequence<").removesuffix(">")
            assert step["slice"], f"{path}: {step['field']} is a sequence"
            if step["slice"] != "[:]":
                assert int(step["slice"][1:-1]) < _length(topic, step["field"]), path
        else:
            assert not step["slice"], path
        for name, value in re.findall(r"\{(\w+)==\"([^\"]*)\"\}", step["filters"]):
            assert _field(kind, name) == "string"
            assert name != "name" or value.removeprefix("/") in NODES, path
    return kind


@pytest.fixture(scope="module")
def foxglove() -> dict[str, Any]:
    layout: dict[str, Any] = json.loads(config_file("foxglove.json").read_text())
    return layout


def _leaves(node: Any, height: float = 1.0) -> Iterator[tuple[str, float]]:
    """Each panel with its share of the height."""
    if isinstance(node, str):
        yield node, height
        return
    assert set(node) == {"direction", "first", "second", "splitPercentage"}
    assert node["direction"] in ("row", "column")
    assert 0 < node["splitPercentage"] < 100
    share = node["splitPercentage"] / 100 if node["direction"] == "column" else 1.0
    rest = 1.0 - share if node["direction"] == "column" else 1.0
    yield from _leaves(node["first"], share * height)
    yield from _leaves(node["second"], rest * height)


def test_each_foxglove_panel_has_its_place_and_its_settings(
    foxglove: dict[str, Any],
) -> None:
    assert set(foxglove) == {
        "configById",
        "globalVariables",
        "userNodes",
        "playbackConfig",
        "layout",
    }
    leaves = [leaf for leaf, _ in _leaves(foxglove["layout"])]
    assert sorted(leaves) == sorted(foxglove["configById"])
    assert {leaf.partition("!")[0] for leaf in leaves} == PANELS


def test_every_path_that_foxglove_plots_leads_to_a_number_of_the_contract(
    foxglove: dict[str, Any],
) -> None:
    for name, panel in foxglove["configById"].items():
        for path in panel.get("paths", ()):
            if NUMBER.fullmatch(path["value"]):  # a line across the plot
                continue
            kind = _type_at(path["value"])
            assert kind in NUMERIC or (
                name.startswith("StateTransitions!") and kind == "string"
            ), path
            if path["value"].startswith("/criterion"):
                assert (
                    path["label"]
                    == CRITERION_NAMES[int(path["value"].rpartition("[")[2][:-1])]
                )


def test_foxglove_orders_by_what_any_bag_has_a_clock_for(
    foxglove: dict[str, Any],
) -> None:
    """Stamps of a lockstep run begin at 0: by them, its curves lie decades before the
    bag and every plot is empty.
    """
    methods = {
        path["timestampMethod"]
        for panel in foxglove["configById"].values()
        for path in panel.get("paths", ())
    }
    assert methods == {"receiveTime"}


def test_foxglove_shows_each_state_without_scrolling_and_no_legend_over_a_curve(
    foxglove: dict[str, Any],
) -> None:
    height = {
        leaf: share * PANELS_HEIGHT - TOOLBAR
        for leaf, share in _leaves(foxglove["layout"])
    }
    for name, panel in foxglove["configById"].items():
        if name.startswith("StateTransitions!"):
            assert height[name] >= STATE_ROW * len(panel["paths"]) + STATE_AXIS
            labels = [path["label"] for path in panel["paths"]]
            assert len(set(labels)) == len(labels)
        if name.startswith("Plot!"):
            assert panel["legendDisplay"] == "left"


def test_a_bounded_value_never_runs_along_the_edge_of_its_plot(
    foxglove: dict[str, Any], plotjuggler: ElementTree.Element
) -> None:
    plots = [
        (
            {path["label"] for path in panel["paths"]},
            panel["minYValue"],
            panel["maxYValue"],
        )
        for panel in foxglove["configById"].values()
        if "minYValue" in panel
    ]
    for plot in plotjuggler.iter("plot"):
        limit = plot.find("limitY")
        if limit is not None and limit.attrib:
            names = {
                curve.attrib["name"].split("/")[-2] for curve in plot.iter("curve")
            }
            plots.append(
                (names, float(limit.attrib["min"]), float(limit.attrib["max"]))
            )
    bounded = [
        (name, low, high)
        for names, low, high in plots
        for name in names
        if name in RANGES
    ]
    assert {name for name, _, _ in bounded} == set(RANGES)
    for name, low, high in bounded:
        assert low < RANGES[name][0] and RANGES[name][1] < high, name


def test_a_curve_that_covers_another_is_wider_and_below_it(
    foxglove: dict[str, Any],
) -> None:
    """Foxglove draws the first path on top."""
    for name, thin in (("Plot!position", "estimate"), ("Plot!torque", "applied")):
        paths = foxglove["configById"][name]["paths"]
        for upper, lower in zip(paths[::2], paths[1::2], strict=True):
            assert upper["label"].endswith(thin)
            assert upper["label"].split()[0] == lower["label"].split()[0]
            assert upper["lineSize"] < lower["lineSize"]


def test_no_axes_and_no_name_of_a_frame_stand_before_the_robot(
    foxglove: dict[str, Any],
) -> None:
    """Foxglove draws a metre of axes and a label into each frame, a frame without a
    transform too.
    """
    panel = foxglove["configById"]["3D!linkage"]
    assert panel["transforms"][f"frame:{BASE_FRAME}"] == {"visible": False}
    assert set(panel["scene"]["transforms"]) <= TF_SETTINGS
    assert panel["followTf"] == BASE_FRAME == panel["layers"]["grid"]["frameId"]


def test_the_3d_and_diagnostics_panels_show_our_topics_in_our_frame(
    foxglove: dict[str, Any],
) -> None:
    panels = foxglove["configById"]
    assert [f"/{MARKERS.name}"] == [
        topic
        for topic, shown in panels["3D!linkage"]["topics"].items()
        if shown["visible"]
    ]
    for name, panel in panels.items():
        if name.startswith("Diagnostic"):
            assert (
                TABLE[panel["topicToRender"]].type
                == "diagnostic_msgs/msg/DiagnosticArray"
            )


@pytest.fixture(scope="module")
def plotjuggler() -> ElementTree.Element:
    return ElementTree.parse(config_file("plotjuggler.xml")).getroot()


def _curves(root: ElementTree.Element) -> Iterator[str]:
    for plot in root.iter("plot"):
        for curve in plot.iter("curve"):
            if plot.get("mode") == "XYPlot":
                yield from (curve.attrib["curve_x"], curve.attrib["curve_y"])
            else:
                yield curve.attrib["name"]


def test_plotjugglers_splitters_count_what_they_hold(
    plotjuggler: ElementTree.Element,
) -> None:
    assert plotjuggler.tag == "root"
    tabs = plotjuggler.findall("tabbed_widget[@parent='main_window']/Tab")
    assert len(tabs) == len({tab.attrib["tab_name"] for tab in tabs}) > 1
    for tab in tabs:
        assert len(tab.findall("Container")) == int(tab.attrib["containers"]) == 1
    for splitter in plotjuggler.iter("DockSplitter"):
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert len(list(splitter)) == len(sizes) == int(splitter.attrib["count"])
        assert sum(sizes) == pytest.approx(1.0, abs=1e-5)  # written with six decimals


def test_every_curve_of_plotjuggler_is_a_number_of_the_contract(
    plotjuggler: ElementTree.Element,
) -> None:
    """Names as PlotJuggler gives them: joint states by joint, diagnostics by hardware
    and node, the rest by field.
    """
    curves = list(_curves(plotjuggler))
    assert curves
    for curve in curves:
        name = max((name for name in TABLE if curve.startswith(f"{name}/")), key=len)
        topic, rest = TABLE[name], curve.removeprefix(f"{name}/")
        if topic.type == "sensor_msgs/msg/JointState":
            joint, field = rest.split("/")
            assert joint in (CRITERION_NAMES if topic is CRITERION else topic.joints), (
                curve
            )
            assert _field(topic.type, field) == "sequence<double>"
        elif topic.type == "diagnostic_msgs/msg/DiagnosticArray":
            hardware, node, field = re.fullmatch(r"(\w+)/(/\w+)/(\w+)", rest).groups()  # type: ignore[union-attr]
            assert (hardware, field) == ("dextar", "level")
            assert node.removeprefix("/") in NODES
        else:
            assert _type_at(f"{name}.{rest.replace('/', '.')}") in NUMERIC, curve
