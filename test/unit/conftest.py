"""Tests of this folder start no Python process and no ROS."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Refuse what belongs in another folder. The compiler of the equations may run."""
    if HERE not in item.path.parents:
        return (yield)
    start = subprocess.Popen.__init__

    def popen(self: Any, command: Any, *others: Any, **options: Any) -> None:
        assert sys.executable not in command, "test/system has what starts processes"
        start(self, command, *others, **options)

    def init(*_: Any, **__: Any) -> None:
        raise AssertionError("test/nodes has what needs a ROS context")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subprocess.Popen, "__init__", popen)
        if context := sys.modules.get("rclpy.context"):
            patch.setattr(context.Context, "init", init)
        return (yield)
