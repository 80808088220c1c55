"""The command ``dextar bench``."""

from __future__ import annotations

import argparse

from dextar_control.cli.arguments import number

SUMMARY = (
    "cost of a tick, of a DDS round trip and of a plant step, beside a baseline of the"
    " same minute"
)
DESCRIPTION = (
    "Measures on this machine, now; every figure stands beside something bare run in"
    " the same minute."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own arguments."""
    parser.add_argument(
        "--demos",
        type=int,
        metavar="N",
        help=(
            "run N demos instead: how many succeed, how long each takes, and whether"
            " their joint states are alike; what stands behind -- goes to dextar demo"
        ),
    )
    parser.add_argument(
        "--busy",
        type=int,
        default=0,
        metavar="N",
        help="processes that keep cores busy beside them",
    )
    parser.add_argument(
        "demo", nargs="*", metavar="ARGUMENT", help="of dextar demo, behind --"
    )
    parser.add_argument(
        "--seconds",
        type=number(0.1, 3600.0, "s"),
        default=5.0,
        metavar="S",
        help="of each DDS measurement (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    if arguments.demos is not None:
        from dextar_control.experiments.bench_stack import bench_demos

        return bench_demos(arguments.demos, arguments.busy, arguments.demo)
    from dextar_control.experiments.bench import run_bench

    return run_bench(arguments.seconds)
