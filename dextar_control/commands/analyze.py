"""``dextar analyze``."""

from __future__ import annotations

import argparse
from pathlib import Path

from dextar_control.commands import EXIT_FAILED

SUMMARY = "metrics and figure from a recorded run"
DESCRIPTION = (
    "Reads run.mcap and writes metrics.json and figure.png beside it (or into --output). Exit code 0 when the run was a"
    " success or has no truth to judge by, 1 when it was not, 2 for a bad file."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    parser.add_argument("bag", type=Path, help="an .mcap file, or the run's folder")
    parser.add_argument("--output", type=Path, metavar="DIR", help="where metrics and figure go (default: beside the bag)")


def run(arguments: argparse.Namespace) -> int:
    """The exit code."""
    from rich.console import Console

    from dextar_control.analysis.report import analyze, summary_table

    metrics = analyze(arguments.bag, arguments.output)
    Console().print(summary_table(metrics))
    return EXIT_FAILED if metrics.success is False else 0
