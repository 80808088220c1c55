"""colcon builds the sources as they are into what `ros2 run` and `ros2 launch` look
for.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LEFT_OUT = shutil.ignore_patterns(
    ".*", "build", "install", "log", "runs", "test", "__pycache__", "*.egg-info"
)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    pytest.importorskip(
        "colcon_ros", reason="colcon is not installed: make test installs it"
    )
    folder = tmp_path_factory.mktemp("workspace")
    shutil.copytree(ROOT, folder / "src" / "dextar", ignore=LEFT_OUT)
    environment = {**os.environ, "COLCON_LOG_LEVEL": "error"}
    environment.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    # colcon's set-up scripts and setuptools' first lines break on an interpreter path
    # with a space.
    (folder / ".python").symlink_to(sys.prefix)
    colcon = [str(folder / ".python" / "bin" / "python"), "-m", "colcon"]
    listed = subprocess.run(
        [*colcon, "list"],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert listed.stdout.split("\t")[::2] == ["dextar", "(ros.ament_python)\n"]
    built = subprocess.run(
        [*colcon, "build", "--event-handlers", "console_direct+"],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    return folder


@pytest.mark.parametrize(
    "name", ["dextar", "plant", "controller", "trajectory_server", "recorder"]
)
def test_executable_lies_where_ros2_run_looks(workspace, name):
    assert os.access(
        workspace / "install" / "dextar" / "lib" / "dextar" / name, os.X_OK
    )


def test_share_folder_and_index_marker_are_complete(workspace):
    share = workspace / "install" / "dextar" / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / "dextar").is_file()
    assert (share / "dextar" / "package.xml").is_file()
    for kind in ("config", "launch"):
        installed = {
            path.name for path in (share / "dextar" / kind).iterdir() if path.is_file()
        }
        assert installed == {
            path.name for path in (ROOT / kind).iterdir() if path.is_file()
        }


def test_sourced_installation_runs_and_finds_its_own_config(workspace):
    script = (
        "set -e; . install/setup.bash; install/dextar/lib/dextar/dextar --help; python"
        ' -c "from dextar_control.contract.resources import share_folder;'
        ' print(share_folder())"'
    )
    environment = {
        **os.environ,
        "PATH": f"{workspace / '.python' / 'bin'}{os.pathsep}{os.environ['PATH']}",
    }
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=workspace,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "usage" in done.stdout.lower()
    assert (
        Path(done.stdout.split("\n")[-2])
        == workspace / "install" / "dextar" / "share" / "dextar"
    )
