"""Caches and logs are a convenience: where they cannot be written, another place does,
or none.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from patience import PATIENCE

from dextar_control.contract import caches
from dextar_control.contract.caches import cache_folder, prepare_environment
from dextar_control.planning.planner import Plan
from dextar_control.symbols.functions import compiler

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler here")
ROOT = Path(__file__).resolve().parents[2]
DOUBLE = """
import resource, signal, sys, tempfile
tempfile.tempdir = sys.argv[1]
import casadi as ca
from dextar_control.symbols.functions import Library, cache_folder, named
if "full" in sys.argv:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (64, 64))
x = ca.SX.sym("x")
library = Library([named("twice", {"x": x}, {"y": 2.0 * x})], cache_folder())
print(library.fast("twice")(3.0).y[0], library.compiled)
"""


@pytest.fixture
def installation(tmp_path: Path) -> Path:
    """The package in a folder where nothing can be written beside the sources, whoever
    runs the tests.
    """
    for room in ("dextar_control/contract", "dextar_control/symbols"):
        shutil.copytree(
            ROOT / room,
            tmp_path / "site" / room,
            ignore=shutil.ignore_patterns("__pycache__"),
        )
    (tmp_path / "site" / "dextar_control" / "__init__.py").touch()
    (tmp_path / "blocked").touch()
    (tmp_path / "temp").mkdir()
    (tmp_path / "double.py").write_text(DOUBLE)
    return tmp_path


def double(
    installation: Path,
    temporary: str,
    *arguments: str,
    cache: str = "blocked",
    compiled: bool = True,
) -> str:
    """The error output of a process that compiles a function, or interprets it."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(installation / "site"),
        "PYTHONDONTWRITEBYTECODE": "1",
        "HOME": str(installation / "blocked"),
        "XDG_CACHE_HOME": str(installation / cache),
    }
    answer = subprocess.run(
        [
            sys.executable,
            str(installation / "double.py"),
            str(installation / temporary),
            *arguments,
        ],
        env=environment,
        cwd=installation,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (answer.returncode, answer.stdout) == (0, f"6.0 {compiled}\n"), answer.stderr
    return answer.stderr


def test_without_any_place_the_equations_are_interpreted_and_one_line_says_so(
    installation: Path,
) -> None:
    said = double(installation, "blocked", compiled=False)
    assert (
        said.count("\n") == 1 and "interpreted" in said and "set XDG_CACHE_HOME" in said
    )


@needs_compiler
def test_a_private_folder_for_temporary_files_takes_the_cache(
    installation: Path,
) -> None:
    assert not double(installation, "temp")
    private = installation / "temp" / f"dextar-{os.getuid()}"
    assert private.stat().st_mode & 0o777 == 0o700
    assert len(list(private.rglob("model-*.so"))) == 1


@needs_compiler
def test_a_full_disk_or_a_broken_cache_ends_nothing(installation: Path) -> None:
    folder = installation / "cache" / "dextar"
    said = double(installation, "blocked", "full", cache="cache", compiled=False)
    assert "File too large" in said and said.count("\n") == 1
    assert not list(folder.rglob("*.so"))
    assert not double(installation, "blocked", cache="cache")
    (library,) = folder.rglob("model-*.so")
    library.write_bytes(library.read_bytes()[:-20])
    assert not double(installation, "blocked", cache="cache")
    (again,) = folder.rglob("model-*.so")
    before = again.read_bytes()
    assert not double(installation, "blocked", cache="cache")
    assert again.read_bytes() == before


def test_a_folder_that_others_may_write_is_not_used(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "blocked").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "blocked"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    private = tmp_path / f"dextar-{os.getuid()}"
    private.mkdir()
    private.chmod(0o777)
    assert cache_folder("plans") is None
    private.rmdir()
    private.symlink_to(tmp_path)
    assert cache_folder("plans") is None
    private.unlink()
    assert cache_folder("plans") == private / "plans"
    assert cache_folder("plans", tmp_path / "wanted") == tmp_path / "wanted"


def test_a_user_without_a_home_has_a_cache(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def nobody(_: type[Path]) -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", classmethod(nobody))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert cache_folder("plans") == tmp_path / f"dextar-{os.getuid()}" / "plans"


VARIABLES = (
    "MPLCONFIGDIR",
    "ROS_LOG_DIR",
    "ROS_HOME",
    "XDG_CONFIG_HOME",
    "XDG_CACHE_HOME",
)


@pytest.mark.parametrize("usable", [True, False])
def test_settings_and_logs_find_a_folder_where_the_home_cannot_be_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, usable: bool
) -> None:
    for name in VARIABLES:
        monkeypatch.setenv(name, "")
    home = tmp_path / "home"
    if usable:
        home.mkdir()
    else:
        home.touch()
    (tmp_path / "temp").mkdir()
    monkeypatch.setattr(caches, "home", lambda: home)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temp"))
    prepare_environment()
    private = tmp_path / "temp" / f"dextar-{os.getuid()}"
    wanted = (
        ("", "") if usable else (str(private / "matplotlib"), str(private / "ros-logs"))
    )
    assert (os.environ["MPLCONFIGDIR"], os.environ["ROS_LOG_DIR"]) == wanted
    assert not usable or not list(home.iterdir())


def test_help_loads_neither_mathematics_nor_ros() -> None:
    code = """
import sys
from dextar_control.cli import main as cli
for words in ([], *([name] for name in cli.COMMANDS)):
    try: cli.main([*words, "--help"])
    except SystemExit as end: assert end.code == 0
loaded = {name.split(".")[0] for name in sys.modules}
print(
    loaded & {"casadi", "numpy", "rclpy", "matplotlib"},
    [name for name in sys.modules if name.startswith("dextar_control.model")],
)
"""
    answer = subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert answer.stdout.splitlines()[-1] == "set() []"


@needs_compiler
def test_two_processes_that_start_at_once_share_one_library(tmp_path: Path) -> None:
    code = (
        "import numpy as np; from dextar_control.contract.resources import"
        " config_file;from dextar_control.contract.robot import flatten, load_robot;"
        " from dextar_control.mechanisms import mechanism_named;from"
        " dextar_control.model.model import Model;m ="
        " Model(mechanism_named('five_bar'),"
        " flatten(load_robot(config_file('dextar.yaml'))));assert m.library.compiled; x"
        " = np.array([0.0, 0.115]); print(m.state(m.inverse_geometric_model(x), x,"
        " np.zeros(2)).s)"
    )
    environment = os.environ | {
        "XDG_CACHE_HOME": str(tmp_path),
        "PYTHONPATH": str(ROOT),
    }
    started = [
        subprocess.Popen(
            [sys.executable, "-W", "error", "-c", code],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(3)
    ]
    answers = {
        process.communicate(timeout=PATIENCE)[0].split("\n")[0] for process in started
    }
    assert all(process.returncode == 0 for process in started) and len(answers) == 1
    assert (
        len(list(tmp_path.rglob("*.so"))) == 1
        and len(list(tmp_path.rglob(".model-*"))) == 0
    )


def test_it_plans_the_same_without_a_compiler(trip: Plan, tmp_path: Path) -> None:
    program = """
from dextar_control.contract.resources import ROBOT_FILE, config_file
from dextar_control.contract.robot import load_robot
from dextar_control.planning.planner import plan_return_trip
plan = plan_return_trip(load_robot(config_file(ROBOT_FILE)), [-0.025, 0.115], [0.01, 0.06], 0.33, 0.2)
print(plan.certificate.peak_torque, plan.certificate.crossing_times[0])
"""
    found = subprocess.run(
        [sys.executable, "-c", program],
        check=True,
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=dict(os.environ) | {"DEXTAR_CC": "", "XDG_CACHE_HOME": str(tmp_path)},
    )
    peak, crossing = (float(number) for number in found.stdout.split())
    assert peak == pytest.approx(
        trip.certificate.peak_torque, rel=1e-4
    )  # where a descent ends that rounding may bend
    assert crossing - 0.2 == pytest.approx(
        trip.certificate.crossing_times[0] - 0.2, abs=1e-3
    )
    assert found.stderr.count("are interpreted") == len(found.stderr.splitlines()) == 1
    assert not list(tmp_path.rglob("*.so"))
