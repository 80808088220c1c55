"""``dextar go``, ``stop``, ``status``, ``enable`` and ``reset`` ask what an operator
asks of a robot whose nodes run.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

from dextar_control.cli.demo import add_point_and_excite


@dataclass
class OperatorCommand:
    """One of several commands of a module, with the names that ``cli`` asks a module
    for.
    """

    SUMMARY: str
    DESCRIPTION: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]


def _robot(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--namespace",
        default="",
        metavar="NS",
        help="of the robot's nodes, where they have one",
    )


def _go_arguments(parser: argparse.ArgumentParser) -> None:
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--tour",
        type=int,
        metavar="N",
        help="cross at N points spread over the locus; 0 is the trip A -> B -> A",
    )
    add_point_and_excite(where)
    parser.add_argument(
        "--duration",
        type=float,
        metavar="S",
        help="of one way, s; 0 leaves it to the planner",
    )
    parser.add_argument(
        "--repeat", type=int, metavar="N", help="return trips, or laps of a tour"
    )
    _robot(parser)


def _enable_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--off",
        action="store_true",
        help="take the torque away instead, whatever goes on",
    )
    _robot(parser)


def _reset_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--plant",
        action="store_true",
        help="also put a simulated robot back to its start, at rest",
    )
    _robot(parser)


def _run(name: str) -> Callable[[argparse.Namespace], int]:
    """Return a function of ``nodes.operator`` that is loaded when it is called."""

    def run(arguments: argparse.Namespace) -> int:
        from dextar_control.nodes import operator

        return int(getattr(operator, name)(arguments))

    return run


GO = OperatorCommand(
    "start a trip or tour of a running robot and follow it to its end",
    "Sets the task of the running trajectory server (what is not given stays as it was"
    " set last), has it planned and started, and follows it. Ctrl-C is a safe stop."
    " Ends with the verdict of each crossing, the largest error and the bag of a"
    " recorder that runs. Exit code 0 when the trip was done and each planned crossing"
    " was crossed, 1 when not, 2 when nothing was started, 130 after Ctrl-C.",
    _go_arguments,
    _run("go"),
)
STOP = OperatorCommand(
    "stop a running robot safely",
    "Asks the controller for a safe stop, and the trajectory server to start nothing"
    " that it still plans; waits until the robot is at rest. A crossing that has begun"
    " is finished first. Exit code 0 when it rests, or holds, 1 when not, 2 when no"
    " controller answers.",
    _robot,
    _run("stop"),
)
STATUS = OperatorCommand(
    "tell how a running robot is and what to do next",
    "Prints what the nodes tell of themselves. Exit code 0 when no node tells of an"
    " error, 1 when one does, 2 when there is no controller.",
    _robot,
    _run("status"),
)
ENABLE = OperatorCommand(
    "give a running robot torque, so that it holds",
    "Asks the controller for torque; it says what is missing. Exit code 0 when that was"
    " done, 2 when it was refused.",
    _enable_arguments,
    _run("enable"),
)
RESET = OperatorCommand(
    "leave a fault or a safe stop of a running robot, without torque",
    "Asks the controller to leave what it has latched; it says what is in the way. Exit"
    " code 0 when that was done, 2 when it was refused.",
    _reset_arguments,
    _run("reset"),
)
