"""The command ``dextar faults``."""

from __future__ import annotations

import argparse
from pathlib import Path

from dextar_control.cli.arguments import add_output, whole

SUMMARY = (
    "try faults against the nodes while the robot crosses: lost, late and broken"
    " messages, killed processes, full disks"
)
DESCRIPTION = (
    "Starts the real nodes in real processes, does each fault of the file while the"
    " robot crosses its singularities, and judges from the robot's truth what became of"
    " it. Leaves runs/faults-<UTC stamp>/ with faults.md, faults.json, faults.png and"
    " the nodes' logs. Exit code 0 when every outcome was an expected one and nothing"
    " happened that never must, else 1; 2 for a wrong argument, 128 + the signal's"
    " number when one ended it."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own arguments."""
    parser.add_argument(
        "config", type=Path, nargs="?", help="cases (default: config/faults.yaml)"
    )
    parser.add_argument(
        "--cases",
        metavar="A,B",
        default="",
        help="only these cases, or those whose names begin so",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="a small part of them in simulated time, in about a minute",
    )
    parser.add_argument(
        "--count",
        type=whole(1, 100_000),
        metavar="N",
        help="faulted crossings of each case (default: the file's)",
    )
    parser.add_argument(
        "--seed",
        type=int,
        metavar="N",
        help="of all that is random (default: the file's)",
    )
    parser.add_argument(
        "--jobs",
        type=whole(1, 100_000),
        default=2,
        metavar="N",
        help="sets of nodes side by side in simulated time (default: 2)",
    )
    add_output(parser, "where runs go (default: runs)", Path("runs"))


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    from dextar_control.experiments.faults.run import run_faults

    return run_faults(
        config_path=arguments.config,
        names=[name for name in arguments.cases.split(",") if name],
        seed=arguments.seed,
        count=arguments.count,
        quick=arguments.quick,
        jobs=arguments.jobs,
        output=arguments.output,
    )
