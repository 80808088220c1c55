"""The command ``dextar analyze``."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path

from dextar_control.cli import EXIT_FAILED, EXIT_USAGE
from dextar_control.cli.arguments import add_bag, add_output, number
from dextar_control.cli.bags import add_robot, exit_code_of, given_robot, shown_progress
from dextar_control.cli.pdf import add_pdf, write_pdf
from dextar_control.contract.errors import DextarError

SUMMARY = "metrics, figures and a report from recorded runs"
DESCRIPTION = (
    "Reads each bag and writes metrics.json, figure.png and report.html, one page that"
    " opens offline, beside it (or into --output). Exit code 0 when every run was a"
    " success or has no truth to judge by, 1 when one was not or its bag is damaged or"
    " breaks off, 2 for a bad file; the others are analysed all the same."
)
FORMATS = ("png", "svg", "pdf")
WIDTHS = (40.0, 400.0)  # mm


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own arguments."""
    add_bag(parser, several="")
    add_robot(parser)
    add_output(
        parser,
        "where the results go (default: beside the bag); several bags that would share"
        " a folder get one each in it",
    )
    parser.add_argument(
        "--format",
        action="append",
        default=[],
        metavar="NAME",
        dest="formats",
        choices=FORMATS,
        help=(
            "also write paper.NAME, a figure for a paper with its fonts embedded: png,"
            " svg or pdf (repeatable)"
        ),
    )
    add_pdf(parser, "report.html")
    parser.add_argument(
        "--width",
        type=number(*WIDTHS, "mm"),
        default=88.0,
        metavar="MM",
        help="of that figure, mm (default: %(default)g)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    from dextar_control.analysis.report import analyze, summary_table
    from dextar_control.contract.terminal import Terminal, say, spoken_warnings

    console, code, robot = Terminal(), 0, given_robot(arguments)
    for bag, folder in zip(
        arguments.bag, folders(arguments.bag, arguments.output), strict=True
    ):
        try:
            with spoken_warnings("analyze"), shown_progress() as shown:

                def show(
                    stage: str,
                    bag: Path = bag,
                    tell: Callable[[str], None] = shown.stage,
                ) -> None:
                    tell(f"{bag}: {stage}")

                metrics = analyze(
                    bag,
                    folder,
                    arguments.formats,
                    arguments.width,
                    show,
                    arguments.namespace,
                    shown.read,
                    robot,
                )
                place = folder or Path(metrics.bag).parent
                if arguments.pdf:
                    show("printing report.html")
                    write_pdf(place / "report.html")
        except DextarError as error:
            say(f"dextar analyze: {error}")
            code = EXIT_USAGE
            continue
        if len(arguments.bag) > 1:
            console.print(f"{bag}", soft_wrap=True)
        console.print(summary_table(metrics))
        names = [
            "metrics.json",
            "figure.png",
            "report.html",
            *["report.pdf"] * arguments.pdf,
        ]
        names += [f"paper.{name}" for name in dict.fromkeys(arguments.formats)]
        console.print(f"{place}: {' '.join(names)}", soft_wrap=True)
        code = code or (
            EXIT_FAILED if metrics.success is False else exit_code_of(metrics)
        )
    return code


def folders(bags: list[Path], output: Path | None) -> list[Path | None]:
    """Return where each bag's results go; None is beside it.

    Bags that would share a folder get one each in it, by their own names, whatever
    links lead to them. A bag that is named twice has one folder.
    """
    real = [Path(os.path.realpath(bag)) for bag in bags]
    shared = [
        output if output is not None else bag if bag.is_dir() else bag.parent
        for bag in bags
    ]
    places = [Path(os.path.realpath(folder)) for folder in shared]
    found: list[Path | None] = []
    taken: dict[Path, Path] = {}  # bag per folder
    for bag, folder, place in zip(real, shared, places, strict=True):
        if (
            len(
                {
                    other
                    for other, theirs in zip(real, places, strict=True)
                    if theirs == place
                }
            )
            == 1
        ):
            found.append(output)
            continue
        name = bag.name if bag.is_dir() else f"{bag.parent.name}-{bag.stem}"
        number = 1
        while (
            taken.setdefault(
                own := folder / (name if number == 1 else f"{name}-{number}"), bag
            )
            != bag
        ):
            number += 1
        found.append(own)
    return found
