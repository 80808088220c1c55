"""Who hears of the nodes: what this package starts stays on this machine unless one
setting opens it.
"""

from __future__ import annotations

import ast
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from dextar_control.cli.main import COMMANDS, main
from dextar_control.experiments import demo

ROOT = Path(__file__).resolve().parents[2]
VARIABLE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def _calls(path: Path) -> list[str]:
    return [
        ast.unparse(node)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
    ]


@pytest.mark.parametrize(
    ("given", "range_"), [(None, "LOCALHOST"), ("SUBNET", "SUBNET")]
)
@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_stays_on_this_machine_unless_the_variable_opens_it(
    monkeypatch: pytest.MonkeyPatch, name: str, given: str | None, range_: str
) -> None:
    """By what the command finds in its environment, from which its processes
    inherit.
    """
    found = []
    monkeypatch.setenv(VARIABLE, given or "")
    if given is None:
        monkeypatch.delenv(VARIABLE)
    monkeypatch.setattr(COMMANDS[name], "add_arguments", lambda parser: None)
    monkeypatch.setattr(
        COMMANDS[name], "run", lambda arguments: found.append(os.environ[VARIABLE]) or 0
    )
    assert main([name]) == 0
    assert found == [range_]


def test_the_launch_file_keeps_its_nodes_on_this_machine_by_default_and_one_argument_opens_them() -> (
    None
):
    calls = _calls(ROOT / "launch" / "crossing.launch.py")
    argument = next(
        call
        for call in calls
        if call.startswith("DeclareLaunchArgument('discovery_range'")
    )
    assert "EnvironmentVariable(DISCOVERY, default_value='LOCALHOST')" in argument
    assert (
        "SetEnvironmentVariable(DISCOVERY, LaunchConfiguration('discovery_range'))"
        in calls
    )
    assert f'DISCOVERY = "{VARIABLE}"' in (
        ROOT / "launch" / "crossing.launch.py"
    ).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("given", "range_"), [(None, "LOCALHOST"), ("SUBNET", "SUBNET")]
)
def test_the_demos_nodes_stay_on_this_machine_unless_the_variable_opens_them(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, given: str | None, range_: str
) -> None:
    """What the first node would be started with."""

    class StartedError(Exception):
        """Instead of a node."""

    def start(*_: Any) -> None:
        raise StartedError(os.environ[VARIABLE])  # which a fork inherits

    monkeypatch.setenv(VARIABLE, given or "")
    if given is None:
        monkeypatch.delenv(VARIABLE)
    monkeypatch.setattr(demo.Processes, "start", start)
    monkeypatch.setattr(
        signal, "signal", lambda number, handler: None
    )  # the demo's handlers are not the tests'
    with pytest.raises(StartedError, match=f"^{range_}$"):
        main(["demo", "--lockstep", "--output", str(tmp_path)])
