"""The doors between the rooms open one way, as the table of docs/rooms.md says."""

from __future__ import annotations

import ast
import sys
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROS = {
    "rclpy",
    "builtin_interfaces",
    "rcl_interfaces",
    "sensor_msgs",
    "trajectory_msgs",
    "nav_msgs",
    "geometry_msgs",
    "std_msgs",
    "std_srvs",
    "diagnostic_msgs",
    "lifecycle_msgs",
    "rosgraph_msgs",
    "visualization_msgs",
}
# modules without ROS in rooms that have it, so that tests and worker processes can load
# them alone
FREE = {
    "dextar_sim": {
        "plant",
        "body_plant",
        "cartesian",
        "platform_motion",
        "rig",
        "state",
        "sensors",
        "geometry",
        "tree",
        "urdf",
        "world",
        "replay",
    },
    "dextar_control.check_rig": {
        "check",
        "limits",
        "report",
        "response",
        "samples",
        "stream",
        "torque",
        "trial",
    },
    "dextar_control.experiments.faults": {
        "bag_check",
        "cases",
        "figure",
        "frames",
        "judgement",
        "link",
        "netns",
        "relay",
        "table",
    },
}


class Room(NamedTuple):
    """A row of the plan."""

    doors: set[str]
    outside: set[str]


def _full(room: str) -> str:
    return room if room == "dextar_sim" else f"dextar_control.{room}"


def _plan() -> dict[str, Room]:
    plan = {}
    for line in (ROOT / "docs" / "rooms.md").read_text(encoding="utf-8").splitlines():
        if line.startswith("| `"):
            name, _, doors, outside = (
                cell.strip() for cell in line.strip("|").split("|")
            )
            libraries = set(filter(None, outside.split(", ")))
            if "ROS" in libraries:
                libraries = libraries - {"ROS"} | ROS
            plan[_full(name.strip("`"))] = Room(
                {_full(door) for door in filter(None, doors.split(", "))}, libraries
            )
    return plan


PLAN = _plan()


def _imports(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}: relative import"
            names |= {
                node.module,
                *(f"{node.module}.{alias.name}" for alias in node.names),
            }
    return names


def _room_of(name: str) -> str | None:
    """The innermost room that a dotted name lies in."""
    return max(
        (room for room in PLAN if name == room or name.startswith(f"{room}.")),
        key=len,
        default=None,
    )


def _name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(
        ".__init__"
    )


MODULES = {
    _name(path): path
    for package in ("dextar_control", "dextar_sim")
    for path in sorted((ROOT / package).rglob("*.py"))
}
OURS = "dextar_control", "dextar_sim"


def test_every_folder_is_a_room_of_the_plan() -> None:
    folders = {_name(path) for path in MODULES.values() if path.name == "__init__.py"}
    assert folders == {"dextar_control", *PLAN}
    assert {name for name in MODULES if _room_of(name) is None} == {
        "dextar_control",
        "dextar_control.executables",
    }


def test_no_circle_of_rooms_and_none_of_modules() -> None:
    TopologicalSorter(
        {room: row.doors for room, row in PLAN.items()}
    ).prepare()  # CycleError names one
    TopologicalSorter(
        {name: _imports(path) - {name} for name, path in MODULES.items()}
    ).prepare()


@pytest.mark.parametrize("room", PLAN)
def test_a_room_imports_only_through_its_doors(room: str) -> None:
    ours = {room, "dextar_control.contract", *PLAN[room].doors}
    for path in (path for name, path in MODULES.items() if _room_of(name) == room):
        for name in _imports(path):
            top = name.split(".")[0]
            if top in OURS and name not in OURS:
                assert (_room_of(name) or ".".join(name.split(".")[:2])) in ours, (
                    f"{path} imports {name}"
                )
            elif top not in sys.stdlib_module_names and top not in OURS:
                assert top in PLAN[room].outside, f"{path} imports {name}"


@pytest.mark.parametrize("room", PLAN)
def test_no_door_leads_nowhere(room: str) -> None:
    used = {
        name
        for module, path in MODULES.items()
        if _room_of(module) == room
        for name in _imports(path)
    }
    used |= {".".join(name.split(".")[:depth]) for name in used for depth in (1, 2, 3)}
    assert (
        PLAN[room].doors | {name for name in PLAN[room].outside if name not in ROS}
        <= used
    )


@pytest.mark.parametrize("room", FREE)
def test_what_needs_no_ros_loads_without_it(room: str) -> None:
    for name in FREE[room]:
        assert (
            not {item.split(".")[0] for item in _imports(MODULES[f"{room}.{name}"])}
            & ROS
        ), name


def test_the_controller_never_imports_the_simulator() -> None:
    for name, path in MODULES.items():
        if name.startswith("dextar_control"):
            assert not any(
                item.split(".")[0] in ("dextar_sim", "pybullet")
                for item in _imports(path)
            ), path
