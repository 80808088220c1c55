"""The command ``dextar campaign``."""

from __future__ import annotations

import argparse
from pathlib import Path

from dextar_control.cli.arguments import add_output
from dextar_control.cli.pdf import add_pdf, write_pdf
from dextar_control.contract.errors import lacking

SUMMARY = (
    "run crossing points x directions x cases x laws x estimators x seeds in parallel,"
    " and judge them"
)
DESCRIPTION = (
    "Runs what its folder lacks, so an interrupted campaign goes on with the same"
    " command, and writes rows.parquet, report.html, summary.md, summary.json,"
    " failures.md, figure.png, reliability.png and, of a file with sweeps, frontier.png"
    " there. Exit code 0 when all bars of the file hold, 1 when one is missed, 2 for a"
    " wrong argument, 128 + the signal's number when one ended it."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own arguments."""
    parser.add_argument(
        "config", type=Path, help="campaign file, e.g. config/campaign_small.yaml"
    )
    add_output(parser, "folder (default: runs/<file>-<digest of the campaign>)")
    parser.add_argument(
        "--seed",
        type=int,
        metavar="N",
        help="of the crossing points and of all that is random",
    )
    parser.add_argument(
        "--points",
        type=int,
        metavar="N",
        help="crossing points, the share of folded ones kept",
    )
    parser.add_argument("--cases", metavar="A,B", help="only these cases")
    parser.add_argument(
        "--laws",
        metavar="A,B",
        help="only these laws; with --estimators each law meets each estimator",
    )
    parser.add_argument("--estimators", metavar="A,B", help="only these estimators")
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help="processes on this machine (default: one for each core)",
    )
    parser.add_argument(
        "--scheduler",
        metavar="TCP://HOST:PORT",
        help="use the workers of a running Dask scheduler instead",
    )
    add_pdf(parser, "report.html")
    parser.add_argument(
        "--row",
        metavar="KEY",
        help="run one row again, print it and compare it with the recorded one",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    try:
        from dextar_control.experiments.campaign.command import run_command
    except ImportError as error:
        if str(error.name).startswith("dextar"):
            raise
        raise lacking("a campaign", "campaign", error) from error
    return run_command(arguments, printed=write_pdf)
