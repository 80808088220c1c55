"""The ``dextar`` command."""

from __future__ import annotations

import argparse
import io
import os
import sys
from typing import Protocol

from dextar_control.cli import (
    analyze,
    bench,
    calibrate,
    campaign,
    check_rig,
    compare,
    demo,
    export,
    faults,
    identify,
    operate,
    recover,
    replay,
)
from dextar_control.contract.caches import prepare_environment
from dextar_control.contract.signals import run_command
from dextar_control.executables import EXECUTABLES


class CommandModule(Protocol):
    """What a command's module offers."""

    SUMMARY: str
    DESCRIPTION: str

    def add_arguments(self, parser: argparse.ArgumentParser, /) -> None:
        """Add the command's own arguments."""

    def run(self, arguments: argparse.Namespace, /) -> int:
        """Do what was asked; return the exit code."""


COMMANDS: dict[str, CommandModule] = {
    "demo": demo,
    "go": operate.GO,
    "stop": operate.STOP,
    "status": operate.STATUS,
    "enable": operate.ENABLE,
    "reset": operate.RESET,
    "analyze": analyze,
    "compare": compare,
    "replay": replay,
    "export": export,
    "recover": recover,
    "calibrate": calibrate,
    "identify": identify,
    "campaign": campaign,
    "faults": faults,
    "check-rig": check_rig,
    "bench": bench,
}


NODES = ", ".join(EXECUTABLES)


def parser() -> argparse.ArgumentParser:
    """Return the whole command line."""
    whole = argparse.ArgumentParser(
        prog="dextar",
        description=(
            "Drive a five-bar parallel robot through its Type 2 singularities, record"
            " the run and analyse it."
        ),
        epilog=(
            "start with: dextar demo. Each node alone, as ros2 run dextar NODE: dextar"
            f" NODE --help, NODE one of {NODES}"
        ),
    )
    parsers = whole.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, command in COMMANDS.items():
        command.add_arguments(
            parsers.add_parser(
                name, help=command.SUMMARY, description=command.DESCRIPTION
            )
        )
    return whole


def main(argv: list[str] | None = None) -> int:
    """Run the command; return the exit code. What a command starts stays on this
    machine unless the environment opens it.
    """
    arguments = parser().parse_args(argv)
    prepare_environment()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A terminal that knows no × shows a ? for it.
            stream.reconfigure(errors="replace")
    return run_command(
        f"dextar {arguments.command}",
        lambda: COMMANDS[arguments.command].run(arguments),
    )


if __name__ == "__main__":
    sys.exit(main())
