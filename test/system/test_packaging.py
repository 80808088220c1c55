"""The package's metadata agree with each other and with what is installed."""

import ast
import importlib
import importlib.metadata
import importlib.util
import py_compile
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

import dextar_control
from dextar_control import executables

ROOT = Path(__file__).resolve().parents[2]
MANIFEST = ElementTree.parse(ROOT / "package.xml").getroot()
EXECUTABLES = {
    "dextar",
    "plant",
    "controller",
    "trajectory_server",
    "recorder",
    "markers",
    "go_server",
    "panel",
    "warmup",
}
CONFIGS = sorted((ROOT / "config").glob("*.yaml"))
PARAMETER_FILES = [
    path
    for path in CONFIGS
    if not path.name.startswith(("campaign", "faults", "frontier", "rig"))
]
LAUNCH_FILES = sorted((ROOT / "launch").glob("*.launch.py"))


def test_package_xml_is_a_valid_ament_python_manifest():
    assert MANIFEST.get("format") == "3"
    assert MANIFEST.findtext("name") == "dextar"
    assert MANIFEST.findtext("export/build_type") == "ament_python"
    assert MANIFEST.findtext("license") == "Apache-2.0"
    catkin = pytest.importorskip("catkin_pkg.package")
    warnings: list[str] = []
    package = catkin.parse_package(str(ROOT / "package.xml"), warnings=warnings)
    assert not warnings
    package.validate()


def test_package_xml_setup_py_and_the_installation_agree_on_the_version():
    version = MANIFEST.findtext("version")
    built = subprocess.run(
        [sys.executable, "setup.py", "--version"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()[-1]
    assert built == version
    assert importlib.metadata.version("dextar") == version


def test_everything_that_describes_the_package_says_the_same():
    asked = ["--name", "--version", "--description", "--license", "--maintainer"]
    told = subprocess.run(
        [sys.executable, "setup.py", "-q", *asked],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    tags = "name", "version", "description", "license", "maintainer"
    assert told[-len(asked) :] == [MANIFEST.findtext(tag) for tag in tags]
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    described = {
        "title": "name",
        "version": "version",
        "abstract": "description",
        "license": "license",
    }
    assert {key: cited[key] for key in described} == {
        key: MANIFEST.findtext(tag) for key, tag in described.items()
    }
    assert cited["authors"] == [{"name": MANIFEST.findtext("maintainer")}]
    changes = (ROOT / "CHANGELOG.rst").read_text(encoding="utf-8").splitlines()
    assert "Changelog for package dextar" in changes and "Forthcoming" in changes
    beside = ElementTree.parse(ROOT / "interfaces" / "package.xml").getroot()
    assert all(
        beside.findtext(tag) == MANIFEST.findtext(tag)
        for tag in ("version", "license", "maintainer")
    )


ROSDEP = {  # the rosdep key that brings a requirement of setup.py
    "numpy": "python3-numpy",
    "scipy": "python3-scipy",
    "tornado": "python3-tornado",
    "casadi": "casadi-pip",
    "matplotlib": "python3-matplotlib",
    "jinja2": "python3-jinja2",
    "pyyaml": "python3-yaml",
    "rich": "python3-rich",
    "mcap": "mcap-ros2-support",  # requires mcap, which requires zstandard
    "zstandard": "mcap-ros2-support",
    "rosbags": "python3-rosbags-pip",
    "pydantic": "python3-pydantic",
    "pybullet": "python3-pybullet-pip",
    "pybullet-arm64": "python3-pybullet-pip",  # the same module
}
OF_CAMPAIGNS = {
    "distributed",
    "pyarrow",
}  # the extra campaign; rosdep has no keys for them
ROSDEP_TEST = {
    "pytest": "python3-pytest",
    "hypothesis": "python3-hypothesis",
    "mcap-ros2-support": "mcap-ros2-support",
    "colcon-common-extensions": "python3-colcon-common-extensions",
    "colcon-ros": "python3-colcon-common-extensions",
}


def of_package_xml(tag: str) -> set[str]:
    """Keys of package.xml that are not packages of ROS 2's own distribution."""
    names = {element.text or "" for element in MANIFEST.findall(tag)}
    return {
        name
        for name in names
        if name.startswith("python3-") or name in ("mcap-ros2-support", "casadi-pip")
    }


def of_setup_py() -> tuple[set[str], ...]:
    """Names of what setup.py requires, and of what its tests and campaigns do."""
    call = next(
        node
        for node in ast.walk(ast.parse((ROOT / "setup.py").read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "setup"
    )
    given = {word.arg: word.value for word in call.keywords}
    required, extras = (
        ast.literal_eval(given["install_requires"]),
        ast.literal_eval(given["extras_require"]),
    )
    return tuple(
        {re.split(r"[<>=;\[ ]", text)[0] for text in texts}
        for texts in (required, extras["test"], extras["campaign"])
    )


def test_package_xml_and_setup_py_name_the_same_requirements():
    required, tested, campaigning = of_setup_py()
    assert (
        required == set(ROSDEP)
        and tested == set(ROSDEP_TEST)
        and campaigning == OF_CAMPAIGNS
    )
    assert of_package_xml("exec_depend") == set(ROSDEP.values())
    assert of_package_xml("test_depend") == set(ROSDEP_TEST.values()) - of_package_xml(
        "exec_depend"
    )
    remark = " ".join((ROOT / "package.xml").read_text(encoding="utf-8").split())
    assert f"pip install {' '.join(sorted(OF_CAMPAIGNS))}" in remark


def test_package_xml_names_every_ros_package_that_is_imported():
    declared = {element.text for element in MANIFEST.findall("exec_depend")}
    ros = {
        "rclpy",
        "launch",
        "launch_ros",
        "ament_index_python",
        "builtin_interfaces",
        "rcl_interfaces",
        "std_srvs",
    }
    found = set()
    for path in [*ROOT.glob("dextar_*/**/*.py"), *LAUNCH_FILES]:
        for line in path.read_text(encoding="utf-8").splitlines():
            words = line.split()
            if words[:1] in (["import"], ["from"]):
                top = words[1].partition(".")[0]
                if top in ros or top.endswith("_msgs"):
                    found.add(top)
    assert found <= declared, found - declared


def scripts(*command: str) -> set[str]:
    """Executables that setup.py names to who calls it so."""
    code = (
        "import runpy, setuptools, sys; setuptools.setup = lambda **k:"
        " print(*k['entry_points']['console_scripts'], sep='\\n'); sys.argv ="
        f" {['setup.py', *command]}; runpy.run_path('setup.py')"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    points = [
        importlib.metadata.EntryPoint(*line.split(" = "), "console_scripts")
        for line in answer.stdout.splitlines()
    ]
    assert all(
        callable(getattr(importlib.import_module(point.module), point.attr))
        for point in points
    )
    return {point.name for point in points}


@pytest.mark.parametrize("command", ["install", "develop"])
def test_colcon_gets_an_executable_for_each_node_and_the_command(command):
    assert scripts("egg_info", command) == EXECUTABLES


@pytest.mark.parametrize("command", ["bdist_wheel", "editable_wheel", "dist_info"])
def test_pip_puts_nothing_but_the_command_on_the_path(command):
    assert scripts(command) == {"dextar"}


@pytest.mark.parametrize("name", sorted(EXECUTABLES - {"dextar"}))
def test_the_command_runs_each_node(name, monkeypatch):
    ran = []
    monkeypatch.setitem(
        executables.EXECUTABLES, name, lambda: ran.append(sys.argv) or 0
    )
    monkeypatch.setattr(sys, "argv", ["dextar", name, "--ros-args", "-r", "a:=b"])
    assert executables.dextar() == 0
    assert ran == [[f"dextar {name}", "--ros-args", "-r", "a:=b"]]


def test_the_package_offers_a_few_names_and_loads_them_when_they_are_used():
    code = (
        "import sys, dextar_control as d; print('numpy' in sys.modules);"
        " print(*(getattr(d, name).__name__ for name in d.__all__))"
    )
    said = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    assert said == ["False", " ".join(dextar_control.__all__)]
    assert set(dextar_control.__all__) <= set(dir(dextar_control))
    assert (ROOT / "dextar_control" / "py.typed").exists() and (
        ROOT / "dextar_sim" / "py.typed"
    ).exists()


@pytest.mark.parametrize("path", PARAMETER_FILES, ids=lambda path: path.name)
def test_config_file_is_a_ros_parameter_file(path):
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert all(set(section) == {"ros__parameters"} for section in document.values())


def test_config_launch_files_and_index_marker_are_installed(tmp_path):
    command = [
        sys.executable,
        "setup.py",
        "-q",
        "install_data",
        "--install-dir",
        str(tmp_path),
    ]
    subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
    installed = {
        str(path.relative_to(tmp_path))
        for path in tmp_path.rglob("*")
        if path.is_file()
    }
    wanted = {
        f"share/dextar/{path.relative_to(ROOT)}"
        for path in (ROOT / "config").rglob("*")
        if path.is_file()
    }
    wanted |= {f"share/dextar/launch/{path.name}" for path in LAUNCH_FILES}
    wanted |= {
        f"share/dextar/examples/{path.name}"
        for path in (ROOT / "examples").glob("*.py")
    }
    wanted |= {
        "share/dextar/package.xml",
        "share/ament_index/resource_index/packages/dextar",
    }
    assert installed == wanted


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_launch_file_compiles_and_loads_where_launch_is_there(path, tmp_path):
    py_compile.compile(str(path), cfile=str(tmp_path / "launch.pyc"), doraise=True)
    if importlib.util.find_spec("launch_ros") is None:
        return
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    assert (
        PythonLaunchDescriptionSource(
            str(path)
        ).try_get_launch_description_without_context()
        is not None
    )


def test_launch_file_starts_every_node():
    files = [
        *LAUNCH_FILES,
        ROOT / "dextar_control" / "experiments" / "launch_arguments.py",
    ]
    text = "".join(path.read_text(encoding="utf-8") for path in files)
    for name in EXECUTABLES - {"dextar"}:
        assert f'"{name}"' in text
