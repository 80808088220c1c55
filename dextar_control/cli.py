"""The ``dextar`` command."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from dextar_control.contract.errors import DextarError

EXIT_FAILED = 1
EXIT_USAGE = 2


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
        " return trip and leaves runs/<UTC stamp>/ with run.mcap, metrics.json, figure.png and the nodes' logs."
        " Exit code 0 when the run was a success, 1 when it was not, 2 for a wrong argument.",
    )
    demo.add_argument(
        "--law", default="consistent", choices=("consistent", "projected", "classic"),
        help="control law near the locus; classic is the plain inverse model, which must fail (default: %(default)s)",
    )  # fmt: skip
    demo.add_argument("--lockstep", action="store_true", help="each simulated step waits for its command: deterministic")
    demo.add_argument("--duration", type=float, metavar="S", help="of one way, s (default: config/crossing.yaml)")
    demo.add_argument("--repeat", type=int, metavar="N", help="return trips (default: config/crossing.yaml)")
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
        from dextar_control.ros.bench import run_bench

        return run_bench(arguments.seconds)
    except DextarError as error:
        print(f"dextar {arguments.command}: {error}", file=sys.stderr)
        return EXIT_USAGE
    except KeyboardInterrupt:
        print(f"dextar {arguments.command}: interrupted", file=sys.stderr)
        return 130


def _print(renderable: object) -> None:
    from rich.console import Console

    Console().print(renderable)


if __name__ == "__main__":
    sys.exit(main())
