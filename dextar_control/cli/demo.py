"""The command ``dextar demo``."""

from __future__ import annotations

import argparse
from pathlib import Path

from dextar_control.cli.arguments import add_output
from dextar_control.contract.plug_in import one_of
from dextar_control.contract.settings import ESTIMATORS, LAWS

SUMMARY = "run A -> B -> A through the singularity in simulation, record and draw it"
DESCRIPTION = (
    "Starts plant, controller, trajectory server and recorder as separate ROS 2"
    " processes, runs the return trip and leaves runs/<UTC stamp>/ with plan.png,"
    " run.mcap, metrics.json, figure.png, report.html and the nodes' logs. Exit code 0"
    " when the run was a success, 1 when it was not, 2 for a wrong argument."
)
EXCITE = 20.0  # s


def add_point_and_excite(group: argparse._MutuallyExclusiveGroup) -> None:
    """Add ``--point`` and ``--excite`` to the arguments that say where to."""

    def seconds(text: str) -> float:
        if not float(text) > 0.0:
            raise argparse.ArgumentTypeError(
                f"{text} s; it must be > 0 (without --excite it is a trip)"
            )
        return float(text)

    group.add_argument(
        "--point",
        type=float,
        nargs=2,
        metavar=("X", "Y"),
        help="return trip through this point of the locus, m",
    )
    group.add_argument(
        "--excite",
        type=seconds,
        nargs="?",
        const=EXCITE,
        metavar="S",
        help=(
            "a motion that tells masses and friction to dextar identify, about S long,"
            f" s (default: {EXCITE:g})"
        ),
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own arguments."""
    parser.add_argument(
        "--law",
        metavar="NAME",
        help=(
            f"control law near the locus, {one_of(LAWS)}; classic is the plain inverse"
            " model, which fails with the estimator plain (default:"
            " config/crossing.yaml)"
        ),
    )
    parser.add_argument(
        "--estimator",
        metavar="NAME",
        help=(
            f"of the platform state, {one_of(ESTIMATORS)} (default:"
            " config/crossing.yaml)"
        ),
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--tour",
        type=int,
        metavar="N",
        help=(
            "cross at N points spread over the locus, one after the other;"
            " -N the other way round"
        ),
    )
    add_point_and_excite(where)
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument(
        "--real-time",
        action="store_true",
        help=(
            "as a rig: the plant runs on whether or not a command came (default: each"
            " simulated step waits for its command, so that a busy machine is slower"
            " and never wrong)"
        ),
    )
    pace.add_argument(
        "--real-time-factor",
        type=float,
        metavar="F",
        dest="pace",
        help=(
            "pace of steps that wait, simulated over real time; 0 is as fast as"
            " possible (default: config/crossing.yaml, 1)"
        ),
    )
    pace.add_argument(
        "--lockstep",
        action="store_const",
        const=0.0,
        dest="pace",
        help="short for --real-time-factor 0",
    )
    parser.add_argument(
        "--duration",
        type=float,
        metavar="S",
        help="of one way, s (default: config/crossing.yaml)",
    )
    parser.add_argument(
        "--repeat",
        type=int,
        metavar="N",
        help="return trips, or laps of a tour (default: config/crossing.yaml)",
    )
    parser.add_argument(
        "--robot",
        type=Path,
        metavar="FILE",
        help="robot description (default: config/dextar.yaml)",
    )
    parser.add_argument(
        "--plant-robot",
        type=Path,
        metavar="FILE",
        help=(
            "description of the simulated robot, where that is another one than the"
            " nodes know"
        ),
    )
    parser.add_argument(
        "--params",
        type=Path,
        metavar="FILE",
        help="node parameters (default: config/crossing.yaml)",
    )
    parser.add_argument(
        "-p",
        "--set",
        action="append",
        default=[],
        metavar="NODE.NAME:=VALUE",
        dest="overrides",
        help=(
            "set one node parameter, e.g. -p plant.drive.command_delay:=0.003"
            " (repeatable)"
        ),
    )
    add_output(parser, "where runs go (default: runs)", Path("runs"))
    parser.add_argument(
        "--window",
        action="store_true",
        help="show the simulator's window (needs a display)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    from dextar_control.experiments.demo import run_demo

    return run_demo(arguments)
