"""What the commands that read bags share: an argument, what is under way, and the exit code of a damaged bag."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from dextar_control.commands import EXIT_FAILED

if TYPE_CHECKING:
    from dextar_control.analysis.metrics import Metrics
    from dextar_control.analysis.run import Run
    from dextar_control.contract.robot import RobotParameters


class Shown(NamedTuple):
    """What is under way, on the error output where that is a terminal.

    Attributes:
        stage: tell what is done now.
        read: tell the bytes read and those there are.
    """

    stage: Callable[[str], None]
    read: Callable[[int, int], None]


def add_robot(parser: argparse.ArgumentParser) -> None:
    """What another recorder's bag does not say: the robot's namespace and its description."""
    parser.add_argument("--robot", metavar="FILE", help="robot description of a bag of another recorder, e.g. config/dextar.yaml")
    parser.add_argument(
        "--namespace", metavar="NAME", help="of the robot, where a bag of another recorder holds several, e.g. /left"
    )


def given_robot(arguments: argparse.Namespace) -> RobotParameters | None:
    """The robot of ``--robot``.

    Raises:
        ParameterError: the file cannot be read or is none of a robot.
    """
    from dextar_control.contract.robot import load_robot

    return None if arguments.robot is None else load_robot(arguments.robot)


def exit_code_of(*runs: Run | Metrics) -> int:
    """0 where the bags are whole, 1 where one is damaged or breaks off."""
    return EXIT_FAILED if any(run.truncated or run.holes or run.unreadable for run in runs) else 0


@contextlib.contextmanager
def shown_progress(first: str = "") -> Iterator[Shown]:
    """A line with what is done, and a bar where the bytes of a bag are counted; gone at the end."""
    from rich.progress import BarColumn, SpinnerColumn, TaskProgressColumn, TimeRemainingColumn

    from dextar_control.contract.terminal import Steps, Terminal, TextColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(),
               TimeRemainingColumn())  # fmt: skip
    with Steps(*columns, console=Terminal(stderr=True), transient=True) as bars:
        task = bars.add_task(first, total=None)

        def stage(text: str) -> None:
            nonlocal task
            bars.remove_task(task)
            task = bars.add_task(text, total=None)

        yield Shown(stage, lambda done, total: bars.update(task, completed=done, total=total))
