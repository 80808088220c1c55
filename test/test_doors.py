"""The doors between the rooms open one way."""

from __future__ import annotations

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

ALLOWED_OUTSIDE = {
    "dextar_control.symbols": {"numpy", "casadi"},
    "dextar_control.mechanisms": {"numpy", "casadi"},
    "dextar_control.model": {"numpy", "casadi"},
    "dextar_control.estimation": {"numpy", "casadi"},
    "dextar_control.control": {"numpy", "casadi"},
    "dextar_control.planning": {"numpy", "scipy", "casadi"},
    "dextar_control.bags": {"numpy", "mcap", "rosbags", "yaml", "zstandard"},
    "dextar_control.campaign": {"numpy", "matplotlib", "rich", "yaml", "pydantic", "pydantic_core", "dask", "distributed",
                                "pyarrow"},
    "dextar_control.identification": {"numpy", "scipy", "casadi", "rich"},
    "dextar_control.rig_check": {"numpy"},
    "dextar_control.faults": {"numpy", "matplotlib", "rich", "yaml", "pydantic", "pydantic_core", "mcap"},
    "dextar_control.panel": {"numpy", "tornado"},
    "dextar_control.analysis": {"numpy", "scipy", "matplotlib", "mcap", "rosbags", "rich", "yaml", "zstandard", "jinja2",
                                "markupsafe", "pyarrow", "imageio_ffmpeg"},
}
ROS = {"rclpy", "builtin_interfaces", "rcl_interfaces", "sensor_msgs", "trajectory_msgs", "nav_msgs", "geometry_msgs",
       "std_msgs", "std_srvs", "diagnostic_msgs", "lifecycle_msgs", "rosgraph_msgs", "visualization_msgs"}  # fmt: skip


def _rooms(*names: str) -> set[str]:
    return {f"dextar_control.{name}" for name in names}


MATHEMATICS = ("symbols", "mechanisms", "model", "planning", "estimation", "control")
DOORS = {  # each room, and those that it may import beside itself and the contract
    "dextar_control.contract": set(),
    "dextar_control.symbols": set(),
    "dextar_control.mechanisms": _rooms("symbols"),
    "dextar_control.model": _rooms("symbols", "mechanisms"),
    "dextar_control.planning": _rooms("symbols", "mechanisms", "model"),
    "dextar_control.estimation": _rooms("symbols", "mechanisms", "model"),
    "dextar_control.control": _rooms("symbols", "mechanisms", "model", "planning", "estimation"),
    "dextar_control.bags": set(),
    "dextar_control.analysis": _rooms("bags", *MATHEMATICS),
    "dextar_control.identification": _rooms("analysis", *MATHEMATICS),
    "dextar_control.rig_check": _rooms(*MATHEMATICS),
    "dextar_control.campaign": _rooms("analysis", "identification", *MATHEMATICS),
    "dextar_control.faults": _rooms("bags", *MATHEMATICS),
    "dextar_control.security": set(),
    "dextar_control.panel": set(),
    "dextar_control.ros": _rooms("executables", "analysis", "bags", "rig_check", "faults", "panel", *MATHEMATICS),
    "dextar_control.commands": _rooms("bags", "analysis", "campaign", "identification", "ros"),
    "dextar_sim": _rooms("symbols", "mechanisms"),
}
NO_ROS_MODULES = {"dextar_control/contract": {"robot.py", "topics.py", "tables.py", "errors.py", "resources.py",
                                             "parameters.py", "help.py", "words.py", "plain_data.py", "validation.py",
                                             "settings.py", "style.py",
                                             "decoding.py"},
                  "dextar_sim": {"plant.py", "body_plant.py", "cartesian.py", "platform_motion.py", "rig.py", "state.py",
                                 "sensors.py", "geometry.py", "tree.py", "urdf.py", "world.py", "replay.py"}}  # fmt: skip


def _imports(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}: relative import"
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def _modules(room: str) -> list[Path]:
    found = sorted((ROOT / room.replace(".", "/")).rglob("*.py"))
    assert found
    return found


def test_no_circle_of_modules() -> None:
    paths = [*_modules("dextar_control"), *_modules("dextar_sim")]
    names = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in paths}
    TopologicalSorter({name: _imports(path) - {name} for name, path in names.items()}).prepare()  # CycleError names one


@pytest.mark.parametrize("room", DOORS)
def test_a_room_imports_only_through_its_doors(room: str) -> None:
    for path in _modules(room):
        for name in _imports(path):
            if name.split(".")[0] in ("dextar_control", "dextar_sim") and name != "dextar_control":
                doors = {room, "dextar_control.contract", *DOORS[room]}
                assert any(name == door or name.startswith(f"{door}.") for door in doors), f"{path} imports {name}"


def test_every_room_stands_in_the_plan() -> None:
    rooms = {f"dextar_control.{path.parent.name}" for path in (ROOT / "dextar_control").glob("*/__init__.py")}
    assert rooms | {"dextar_sim"} == set(DOORS)


def test_the_controller_never_imports_the_simulator() -> None:
    for path in _modules("dextar_control"):
        assert not any(name.split(".")[0] in ("dextar_sim", "pybullet") for name in _imports(path)), path


@pytest.mark.parametrize("room", ALLOWED_OUTSIDE)
def test_mathematics_campaign_and_analysis_need_neither_ros_nor_simulator(room: str) -> None:
    for path in _modules(room):
        for name in _imports(path):
            top = name.split(".")[0]
            if top not in sys.stdlib_module_names and not top.startswith("dextar"):
                assert top in ALLOWED_OUTSIDE[room], f"{path} imports {name}"


@pytest.mark.parametrize("folder", NO_ROS_MODULES)
def test_data_and_plant_are_free_of_ros(folder: str) -> None:
    for name in NO_ROS_MODULES[folder]:
        assert not {item.split(".")[0] for item in _imports(ROOT / folder / name)} & ROS, name


def test_importing_the_mathematics_loads_neither_ros_nor_simulator() -> None:
    code = (
        "import sys, dextar_control.control.loop, dextar_control.planning.tour;"
        "print('rclpy' in sys.modules or 'pybullet' in sys.modules)"
    )
    answer = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, cwd=ROOT)
    assert answer.stdout.split()[-1] == "False"
