"""The command ``dextar compare``."""

from __future__ import annotations

import argparse
from pathlib import Path

from dextar_control.cli.arguments import add_bag, add_output
from dextar_control.cli.bags import add_robot, exit_code_of, given_robot, shown_progress

SUMMARY = "recorded runs side by side, with their differences"
DESCRIPTION = (
    "Puts two or more runs side by side, law against law or rig against simulation:"
    " first what differs, then by how much it matters, in comparison.html (curves over"
    " each other), comparison.md and comparison.json. Differences are to the first bag."
    " Exit code 0, 1 when a bag is damaged or breaks off and what is left was compared,"
    " 2 for a bad file."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own arguments."""
    add_bag(parser, several="; two or more")
    add_robot(parser)
    add_output(parser, "folder (default: %(default)s)", Path("comparison"))


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    from dextar_control.analysis.compare import (
        compare_bags,
        summary_table,
        write_comparison,
    )
    from dextar_control.contract.terminal import Terminal, spoken_warnings

    console = Terminal()
    with spoken_warnings("compare"), shown_progress() as shown:
        comparison = compare_bags(
            arguments.bag,
            shown.stage,
            arguments.namespace,
            shown.read,
            given_robot(arguments),
        )
        shown.stage(f"writing to {arguments.output}")
        write_comparison(comparison, arguments.output)
    for one in comparison.shown_differences:
        console.print(f"{one.name}: {' | '.join(one.values)}", soft_wrap=True)
    console.print(summary_table(comparison, console.width))
    for remark in comparison.remarks:
        console.print(remark)
    console.print(
        f"{arguments.output}: comparison.html comparison.md comparison.json",
        soft_wrap=True,
    )
    return exit_code_of(*comparison.runs)
