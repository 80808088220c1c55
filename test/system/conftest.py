"""One DDS domain for each test process, and one recorded demo for all of them."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dextar_control.nodekit.domain import own_domain

os.environ["ROS_DOMAIN_ID"] = str(own_domain())
ROOT = Path(__file__).resolve().parents[2]
SETTINGS = (
    "plant.external_pose.rate:=100.0",
    "recorder.run.name:=first light",
    "recorder.run.tags:=demo lockstep",
)


@pytest.fixture(scope="session")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that one ``dextar demo --lockstep`` left, with a camera and a name;
    only read. Test processes beside each other share it: the first one makes it.
    """
    base = tmp_path_factory.getbasetemp()
    runs = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "demo"
    with Path(f"{runs}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not runs.exists():
            answer = subprocess.run(
                [
                    *(sys.executable, "-m", "dextar_control.cli.main", "demo"),
                    *("--lockstep", "--output", str(runs)),
                    *(part for setting in SETTINGS for part in ("-p", setting)),
                ],
                capture_output=True,
                text=True,
                cwd=ROOT,
                stdin=subprocess.DEVNULL,
                timeout=300,
            )
            assert answer.returncode == 0, answer.stdout + answer.stderr
    return (runs / "latest").resolve()
