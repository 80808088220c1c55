"""The ``dextar`` command."""

from __future__ import annotations

import argparse
import sys

from dextar_control.commands import EXIT_USAGE, analyze, bench, campaign, check_rig, compare, demo, export, recover, replay
from dextar_control.contract.errors import DextarError

COMMANDS = {
    "demo": demo,
    "analyze": analyze,
    "compare": compare,
    "replay": replay,
    "export": export,
    "campaign": campaign,
    "check-rig": check_rig,
    "bench": bench,
    "recover": recover,
}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="dextar",
        description="Drive a five-bar parallel robot through its Type 2 singularities, record the run and analyse it.",
        epilog="start with: dextar demo",
    )
    parsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, command in COMMANDS.items():
        command.add_arguments(parsers.add_parser(name, help=command.SUMMARY, description=command.DESCRIPTION))
    return parser


def main(argv: list[str] | None = None) -> int:
    """Console entry; the exit code."""
    arguments = _parser().parse_args(argv)
    try:
        return COMMANDS[arguments.command].run(arguments)
    except DextarError as error:
        print(f"dextar {arguments.command}: {error}", file=sys.stderr)
        return EXIT_USAGE
    except KeyboardInterrupt:
        print(f"dextar {arguments.command}: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
