"""The ``dextar`` command."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from dextar_control.contract.errors import DextarError, ParameterError

EXIT_FAILED = 1
EXIT_USAGE = 2
LAWS = ("consistent", "projected", "classic", "multi_model", "joint_space")
ESTIMATORS = ("observer", "dgm", "plain", "external")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="dextar",
        description="Drive a five-bar parallel robot through its Type 2 singularities, record the run and analyse it.",
        epilog="start with: dextar demo",
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = commands.add_parser(
        "demo",
        help="run A -> B -> A through the singularity in simulation, record and draw it",
        description="Starts plant, controller, trajectory server and recorder as separate ROS 2 processes, runs the"
        " return trip and leaves runs/<UTC stamp>/ with plan.png, run.mcap, metrics.json, figure.png and the nodes' logs."
        " Exit code 0 when the run was a success, 1 when it was not, 2 for a wrong argument.",
    )
    demo.add_argument(
        "--law", default="consistent", choices=LAWS,
        help="control law near the locus; classic is the plain inverse model, which fails with the estimator plain"
        " (default: %(default)s)",
    )  # fmt: skip
    demo.add_argument("--estimator", choices=ESTIMATORS, help="of the platform state (default: config/crossing.yaml)")
    where = demo.add_mutually_exclusive_group()
    where.add_argument("--tour", type=int, metavar="N", help="cross at N points spread over the locus, one after the other")
    where.add_argument("--point", type=float, nargs=2, metavar=("X", "Y"), help="return trip through this point of the locus, m")
    demo.add_argument("--lockstep", action="store_true", help="each simulated step waits for its command: deterministic")
    demo.add_argument("--duration", type=float, metavar="S", help="of one way, s (default: config/crossing.yaml)")
    demo.add_argument("--repeat", type=int, metavar="N", help="return trips, or laps of a tour (default: config/crossing.yaml)")
    demo.add_argument("--robot", type=Path, metavar="FILE", help="robot description (default: config/dextar.yaml)")
    demo.add_argument("--params", type=Path, metavar="FILE", help="node parameters (default: config/crossing.yaml)")
    demo.add_argument(
        "-p", "--set", action="append", default=[], metavar="NODE.NAME:=VALUE", dest="overrides",
        help="set one node parameter, e.g. -p plant.command_delay:=0.003 (repeatable)",
    )  # fmt: skip
    demo.add_argument("--output", type=Path, default=Path("runs"), metavar="DIR", help="where runs go (default: runs)")
    demo.add_argument("--window", action="store_true", help="show the simulator's window (needs a display)")

    analyze = commands.add_parser(
        "analyze",
        help="metrics and figure from a recorded run",
        description="Reads run.mcap and writes metrics.json and figure.png beside it (or into --output)."
        " Exit code 0 when the run was a success or has no truth to judge by, 1 when it was not, 2 for a bad file.",
    )
    analyze.add_argument("bag", type=Path, help="an .mcap file, or the run's folder")
    analyze.add_argument("--output", type=Path, metavar="DIR", help="where metrics and figure go (default: beside the bag)")

    campaign = commands.add_parser(
        "campaign",
        help="run crossing points x directions x cases x laws x estimators x seeds in parallel, and judge them",
        description="Runs what its folder lacks, so an interrupted campaign goes on with the same command, and writes"
        " rows.parquet, summary.md, summary.json, failures.md and figure.png there. Exit code 0 when all bars of the"
        " file hold, 1 when one is missed, 2 for a wrong argument, 130 when interrupted.",
    )
    campaign.add_argument("config", type=Path, help="campaign file, e.g. config/campaign_small.yaml")
    campaign.add_argument("--output", type=Path, metavar="DIR", help="folder (default: runs/<file>-<digest of the campaign>)")
    campaign.add_argument("--seed", type=int, metavar="N", help="of the crossing points and of all that is random")
    campaign.add_argument("--points", type=int, metavar="N", help="crossing points, the share of folded ones kept")
    campaign.add_argument("--cases", metavar="A,B", help="only these cases")
    campaign.add_argument("--laws", metavar="A,B", help="only these laws; with --estimators each law meets each estimator")
    campaign.add_argument("--estimators", metavar="A,B", help="only these estimators")
    campaign.add_argument("--workers", type=int, metavar="N", help="processes on this machine (default: one for each core)")
    campaign.add_argument("--scheduler", metavar="TCP://HOST:PORT", help="use the workers of a running Dask scheduler instead")
    campaign.add_argument("--row", metavar="KEY", help="run one row again, print it and compare it with the recorded one")

    bench = commands.add_parser(
        "bench",
        help="cost of a tick, of a DDS round trip and of a plant step, beside a baseline of the same minute",
        description="Measures on this machine, now; every figure stands beside something bare run in the same minute.",
    )
    bench.add_argument("--seconds", type=float, default=5.0, metavar="S", help="of each DDS measurement (default: %(default)s)")
    return parser


def main(argv: list[str] | None = None) -> int:
    """Console entry; the exit code."""
    arguments = _parser().parse_args(argv)
    try:
        if arguments.command == "demo":
            from dextar_control.ros.demo import run_demo

            return run_demo(arguments)
        if arguments.command == "analyze":
            from dextar_control.analysis.report import analyze, summary_table

            metrics = analyze(arguments.bag, arguments.output)
            _print(summary_table(metrics))
            return EXIT_FAILED if metrics.success is False else 0
        if arguments.command == "campaign":
            return _campaign(arguments)
        from dextar_control.ros.bench import run_bench

        return run_bench(arguments.seconds)
    except DextarError as error:
        print(f"dextar {arguments.command}: {error}", file=sys.stderr)
        return EXIT_USAGE
    except KeyboardInterrupt:
        print(f"dextar {arguments.command}: interrupted", file=sys.stderr)
        return 130


def _campaign(arguments: argparse.Namespace) -> int:
    try:
        from dextar_control.campaign.command import run_command
    except ImportError as error:
        if str(error.name).startswith("dextar"):
            raise
        raise ParameterError(f"a campaign needs the packages named in setup.py, installed by pip: {error}") from error
    return run_command(arguments)


def _print(renderable: object) -> None:
    from rich.console import Console

    Console().print(renderable)


if __name__ == "__main__":
    sys.exit(main())
