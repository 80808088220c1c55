"""``dextar bench``."""

from __future__ import annotations

import argparse

SUMMARY = "cost of a tick, of a DDS round trip and of a plant step, beside a baseline of the same minute"
DESCRIPTION = "Measures on this machine, now; every figure stands beside something bare run in the same minute."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    parser.add_argument("--seconds", type=float, default=5.0, metavar="S", help="of each DDS measurement (default: %(default)s)")


def run(arguments: argparse.Namespace) -> int:
    """The exit code."""
    from dextar_control.ros.bench import run_bench

    return run_bench(arguments.seconds)
