"""Who hears of the nodes: what this package starts stays on this machine unless one setting opens it."""

from __future__ import annotations

import ast
import os
import re
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest

from dextar_control.cli import main

ROOT = Path(__file__).resolve().parents[1]
VARIABLE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
# A node that somebody else starts keeps what that one has set.
STARTED_BY_OTHERS = {"dextar_control/contract/node.py", "dextar_control/ros/echo.py"}


def _calls(path: Path) -> list[str]:
    return [ast.unparse(node) for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]


def test_every_command_that_makes_ros_entities_keeps_them_on_this_machine_by_default() -> None:
    found = set()
    for path in sorted((ROOT / "dextar_control").rglob("*.py")):
        name, calls = path.relative_to(ROOT).as_posix(), _calls(path)
        if any(call.startswith("rclpy.init(") for call in calls) and name not in STARTED_BY_OTHERS:
            found.add(name)
            assert any(re.fullmatch(rf"os\.environ\.setdefault\('{VARIABLE}', 'LOCALHOST'\)", call) for call in calls), name
    assert {"dextar_control/ros/demo.py", "dextar_control/ros/bench.py"} <= found


def test_the_launch_file_keeps_its_nodes_on_this_machine_by_default_and_one_argument_opens_them() -> None:
    calls = _calls(ROOT / "launch" / "crossing.launch.py")
    argument = next(call for call in calls if call.startswith("DeclareLaunchArgument('discovery_range'"))
    assert "EnvironmentVariable(DISCOVERY, default_value='LOCALHOST')" in argument
    assert "SetEnvironmentVariable(DISCOVERY, LaunchConfiguration('discovery_range'))" in calls
    assert f'DISCOVERY = "{VARIABLE}"' in (ROOT / "launch" / "crossing.launch.py").read_text(encoding="utf-8")


@pytest.mark.parametrize(("given", "range_"), [(None, "LOCALHOST"), ("SUBNET", "SUBNET")])
def test_the_demos_nodes_stay_on_this_machine_unless_the_variable_opens_them(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, given: str | None, range_: str
) -> None:
    """What the first node would be started with."""

    class StartedError(Exception):
        """Instead of a node."""

    def start(command: list[str], **options: Any) -> None:
        raise StartedError(options.get("env", os.environ)[VARIABLE])

    monkeypatch.setenv(VARIABLE, given or "")
    if given is None:
        monkeypatch.delenv(VARIABLE)
    monkeypatch.setattr(subprocess, "Popen", start)
    monkeypatch.setattr(signal, "signal", lambda number, handler: None)  # the demo's handlers are not the tests'
    with pytest.raises(StartedError, match=f"^{range_}$"):
        main(["demo", "--lockstep", "--output", str(tmp_path)])
