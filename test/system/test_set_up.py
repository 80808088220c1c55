"""set_up.sh where it cannot go on: one sentence that says what to do, and the next call
goes on from there.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DEAD = "http://user:secret@127.0.0.1:9"  # nobody listens


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """What set_up.sh looks at, in a folder whose name has a space."""
    folder = tmp_path / "a b"
    folder.mkdir()
    for name in ("set_up.sh", "setup.py", "setup.cfg", "package.xml", "pyproject.toml"):
        shutil.copy(ROOT / name, folder)
    return folder


def script(path: Path, text: str) -> str:
    path.write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
    path.chmod(0o755)
    return str(path)


def set_up(folder: Path, **changes: str) -> str:
    """What it says of a failure, without a sourced Jazzy and an index."""
    names = (
        "ROS_DISTRO",
        "AMENT_PREFIX_PATH",
        "PIP_FIND_LINKS",
        "HTTPS_PROXY",
        "https_proxy",
        "NO_PROXY",
        "no_proxy",
    )
    environment = {
        name: value for name, value in os.environ.items() if name not in names
    }
    environment |= {"PYTHON": sys.executable, "PIP_CONFIG_FILE": os.devnull, **changes}
    done = subprocess.run(
        ["bash", str(folder / "set_up.sh")],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1, (
        done.stderr
    )
    return done.stdout + done.stderr


def test_an_interpreter_that_will_not_do_is_named(
    checkout: Path, tmp_path: Path
) -> None:
    assert "there is no 'python9.9'. Install Python 3.10 to 3.13, or name it" in set_up(
        checkout, PYTHON="python9.9"
    )
    old = script(tmp_path / "old", "echo 3.9")
    assert f"'{old}' is Python 3.9; this package runs on 3.10 to 3.13" in set_up(
        checkout, PYTHON=old
    )
    broken = script(tmp_path / "broken", "exit 3")
    assert f"'{broken}' does not start" in set_up(checkout, PYTHON=broken)


def test_a_linked_environment_is_not_touched(checkout: Path, tmp_path: Path) -> None:
    (checkout / ".venv").symlink_to(tmp_path)
    assert (
        f".venv' is a link to '{tmp_path}', and what is there is not touched. Remove"
        " the link." in set_up(checkout)
    )


def test_a_full_disk_and_a_dead_network_are_told_and_the_environment_is_kept(
    checkout: Path, tmp_path: Path
) -> None:
    script(tmp_path / "uv", 'echo "error: $UV_SAYS" >&2\nexit 2')
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    told = set_up(
        checkout,
        PATH=path,
        UV_SAYS="failed to write: No space left on device (os error 28)",
    )
    assert told.startswith("making .venv with Python")
    assert (
        "the disk is full, or a quota or limit (ulimit -f) is reached: " in told
        and "a b/.venv' takes 1.5 GB" in told
    )
    told = set_up(
        checkout,
        PATH=path,
        UV_SAYS="error sending request for url",
        HTTPS_PROXY=DEAD,
        PIP_RETRIES="1",
        PIP_INDEX_URL="https://index.invalid/simple",
    )
    assert told.startswith("installing ")  # goes on where the first stopped
    assert (
        "cannot be reached through the proxy http://127.0.0.1:9. Check the network"
        in told
    )
