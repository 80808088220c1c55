"""The commands that read bags share an argument, the display of progress, and the exit
code of a damaged bag.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from dextar_control.cli import EXIT_FAILED
from dextar_control.cli.arguments import add_bag, add_output
from dextar_control.cli.pdf import add_pdf, write_pdf

if TYPE_CHECKING:
    from dextar_control.analysis.metrics import Metrics
    from dextar_control.analysis.run import Run
    from dextar_control.contract.robot import RobotParameters
    from dextar_control.identification.quantities import Quantity


class Shown(NamedTuple):
    """The display of what is under way, on the error output where that is a terminal.

    Attributes:
        stage: tells what is done now.
        read: tells the bytes read and those there are.
    """

    stage: Callable[[str], None]
    read: Callable[[int, int], None]


class Found(NamedTuple):
    """What a command found that fits a robot's numbers to bags.

    Attributes:
        sentence: the result in words.
        quantities: the numbers.
        lines: that stand below them.
        files: that were written.
    """

    sentence: str
    quantities: Sequence[Quantity]
    lines: Sequence[str]
    files: Sequence[str]


def add_fit(parser: argparse.ArgumentParser, page: str) -> None:
    """Add the arguments of a command that fits a robot's numbers and writes a page."""
    add_bag(parser, several="; several are taken together")
    parser.add_argument(
        "--check",
        type=Path,
        action="append",
        default=[],
        metavar="BAG",
        help="a bag that is not used, to see how the numbers explain it (repeatable)",
    )
    add_robot(parser)
    add_pdf(parser, page)
    add_output(parser, "where the results go (default: beside the first bag)")


def run_fit(
    arguments: argparse.Namespace,
    name: str,
    find: Callable[[Sequence[Run], Sequence[Run], Path, Callable[[str], None]], Found],
) -> int:
    """Read the bags, fit, write and tell; return the exit code.

    Args:
        arguments: of the command line.
        name: of the command.
        find: of (bags that serve, bags that check, folder for the results, to tell what
            is done) what is found.
    """
    from dextar_control.analysis.load import load_run
    from dextar_control.contract.errors import CalibrationError, ParameterError
    from dextar_control.contract.terminal import Terminal, say, spoken_warnings
    from dextar_control.identification.report import summary

    console, robot = Terminal(), given_robot(arguments)
    with spoken_warnings(name), shown_progress() as shown:
        runs, bags = [], (*arguments.bag, *arguments.check)
        files = [
            min(bag.glob("*.mcap"), default=bag).resolve() for bag in bags
        ]  # a folder and the file in it are one
        if twice := [bag for row, bag in enumerate(bags) if files[row] in files[:row]]:
            raise ParameterError(
                f"{twice[0]} is given twice; each bag may serve once, and --check takes"
                " one that does not"
            )
        for bag in bags:
            shown.stage(f"reading {bag}")
            runs.append(load_run(bag, arguments.namespace, shown.read, robot))
        folder = arguments.output or runs[0].path.parent
        try:
            found = find(
                runs[: len(arguments.bag)],
                runs[len(arguments.bag) :],
                folder,
                shown.stage,
            )
            pages = [folder / name for name in found.files if name.endswith(".html")]
            printed = [write_pdf(page).name for page in pages] if arguments.pdf else []
        except CalibrationError as error:
            say(f"dextar {name}: {error}")
            return EXIT_FAILED
    console.print(summary(found.sentence, found.quantities))
    for line in found.lines:
        console.print(line, soft_wrap=True)
    console.print(f"{folder}: {' '.join((*found.files, *printed))}", soft_wrap=True)
    return exit_code_of(*runs)


def add_robot(parser: argparse.ArgumentParser) -> None:
    """Add the robot's namespace and description, which another recorder's bag does not
    tell.
    """
    parser.add_argument(
        "--robot",
        metavar="FILE",
        help="robot description of a bag of another recorder, e.g. config/dextar.yaml",
    )
    parser.add_argument(
        "--namespace",
        metavar="NAME",
        help="of the robot, where a bag of another recorder holds several, e.g. /left",
    )


def given_robot(arguments: argparse.Namespace) -> RobotParameters | None:
    """Return the robot of ``--robot``; None without it.

    Raises:
        ParameterError: the file cannot be read or is none of a robot.
    """
    from dextar_control.contract.robot import load_robot

    return None if arguments.robot is None else load_robot(arguments.robot)


def exit_code_of(*runs: Run | Metrics) -> int:
    """Return 0 where the bags are whole, 1 where one is damaged or breaks off."""
    return (
        EXIT_FAILED
        if any(run.truncated or run.holes or run.unreadable for run in runs)
        else 0
    )


@contextlib.contextmanager
def shown_progress(first: str = "") -> Iterator[Shown]:
    """Show a line with what is done, and a bar where the bytes of a bag are counted,
    until the context ends.
    """
    from rich.progress import (
        BarColumn,
        SpinnerColumn,
        TaskProgressColumn,
        TimeRemainingColumn,
    )

    from dextar_control.contract.terminal import Steps, Terminal, TextColumn

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    with Steps(*columns, console=Terminal(stderr=True), transient=True) as bars:
        task = bars.add_task(first, total=None)

        def stage(text: str) -> None:
            nonlocal task
            bars.remove_task(task)
            task = bars.add_task(text, total=None)

        yield Shown(
            stage, lambda done, total: bars.update(task, completed=done, total=total)
        )
