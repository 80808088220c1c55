"""The command ``dextar export``."""

from __future__ import annotations

import argparse

from dextar_control.cli.arguments import add_bag, add_output
from dextar_control.cli.bags import add_robot, exit_code_of, given_robot, shown_progress

SUMMARY = "a recorded run as a table for pandas or MATLAB"
DESCRIPTION = (
    "Writes run.parquet, run.csv or run.mat: one row for each state, everything else"
    " joined to it by its stamp, with units (in Parquet's column metadata, in CSV's"
    " column names, in MATLAB's struct units). Only Parquet needs pyarrow. Exit code 0,"
    " 1 when the bag is damaged or breaks off and what is left was written, 2 for a bad"
    " file."
)
FORMATS = ("parquet", "csv", "mat")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own arguments."""
    add_bag(parser)
    add_robot(parser)
    add_output(parser, "folder (default: export beside the bag)")
    parser.add_argument(
        "--format",
        action="append",
        metavar="NAME",
        dest="formats",
        choices=FORMATS,
        help="parquet, csv or mat (repeatable; default: parquet and csv)",
    )
    parser.add_argument(
        "--topics", action="store_true", help="also each topic in a table of its own"
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    from dextar_control.analysis.load import load_run
    from dextar_control.analysis.table import check_formats, export
    from dextar_control.contract.terminal import Terminal, spoken_warnings

    console, formats = Terminal(), arguments.formats or ["parquet", "csv"]
    check_formats(formats)
    with spoken_warnings("export"), shown_progress(f"reading {arguments.bag}") as shown:
        recorded = load_run(
            arguments.bag, arguments.namespace, shown.read, given_robot(arguments)
        )
        folder = arguments.output or recorded.path.parent / "export"
        files = export(recorded, folder, formats, arguments.topics, shown.stage)
    console.print(f"{folder}: {' '.join(file.name for file in files)}", soft_wrap=True)
    return exit_code_of(recorded)
