"""What the README says is what the package does."""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dextar_control.cli import check_rig
from dextar_control.cli.main import COMMANDS
from dextar_control.contract import tables

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("table", [tables.topic_table, tables.service_table])
def test_the_tables_are_the_contract(table: Callable[[], list[str]]) -> None:
    lines = table()
    begin = README.splitlines().index(lines[0])
    assert README.splitlines()[begin : begin + len(lines) + 1] == [*lines, ""]


def test_the_phases_are_numbered_as_in_the_contract() -> None:
    assert f"{tables.phase_line()}." in README


def test_the_python_example_runs_and_crosses() -> None:
    code = next(
        block
        for block in re.findall(r"```python\n(.*?)```", README, re.DOTALL)
        if "ControlLoop(" in block
    )
    answer = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert answer.returncode == 0, answer.stderr
    assert (
        float(re.search(r"HOLD, largest true error ([0-9.]+) mm", answer.stdout)[1])
        < 0.3
    )


@pytest.mark.parametrize(
    "target", sorted(set(re.findall(r"^make (\w+)", README, re.MULTILINE)))
)
def test_every_make_command_is_a_target(target: str) -> None:
    assert re.search(
        rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )


def test_no_figure_is_missing() -> None:
    assert not re.search(
        r"@[A-Z]+@|TODO|TBD|^[A-Z_]{5,}$|\(table of", README, re.MULTILINE
    )


def test_ci_calls_the_readmes_own_commands() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "make test" in script
    assert "make demo" in script
    assert "pip install" not in script


def test_every_option_of_check_rig_in_the_readme_exists() -> None:
    used = [
        line.partition("#")[0].split()
        for line in README.splitlines()
        if line.startswith(".venv/bin/dextar check-rig")
    ]
    assert len(used) >= 3
    parser = argparse.ArgumentParser()
    check_rig.add_arguments(parser)
    for words in used:
        parser.parse_args(words[2:])


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_helps(command: str) -> None:
    answer = subprocess.run(
        [sys.executable, "-m", "dextar_control.cli.main", command, "--help"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert answer.returncode == 0
    assert "usage: dextar" in answer.stdout
