"""The command ``dextar check-rig``."""

from __future__ import annotations

import argparse
from pathlib import Path

SUMMARY = (
    "does a rig's driver keep the contract? watches its topics, and with permission"
    " moves it a little"
)
DESCRIPTION = (
    "Watches the driver of a real-time rig: topics, types, QoS, names, sizes, numbers,"
    " rate, stamps, geometry. Then, after a yes on the terminal or with --yes, sends"
    " small torques, stops sending, and sends NaN, and watches what the robot does;"
    " zero torque comes last, whatever happens. A real rig's own limits and emergency"
    " stop must work before. Exit code 0 when nothing failed (lines may be skipped, or"
    " noted: the controller does without), 1 when a line failed, 2 for a wrong"
    " argument."
)

# Name, default, unit and help of an option that takes a number.
Number = tuple[str, float | None, str, str]
EXPECTED: tuple[Number, ...] = (
    ("--rate", None, "HZ", "of the states (default: one per task.sample_period)"),
    ("--rate-tolerance", 0.05, "X", "relative (default: %(default)s)"),
    ("--jitter", None, "S", "99th percentile off the period (default: one period)"),
    (
        "--max-gap",
        None,
        "S",
        "between two states (default: controller.joint_states.timeout)",
    ),
    ("--max-age", 0.05, "S", "of a stamp at arrival (default: %(default)s)"),
    (
        "--watchdog",
        None,
        "S",
        "declared time-out of the drive (default: plant.drive.command_timeout)",
    ),
    (
        "--watchdog-margin",
        0.01,
        "S",
        "for the way there and back, beyond two periods (default: %(default)s)",
    ),
)
TRIED: tuple[Number, ...] = (
    ("--duration", 5.0, "S", "of the watch (default: %(default)s)"),
    ("--wait", 5.0, "S", "for the first state (default: %(default)s)"),
    (
        "--torque",
        0.005,
        "NM",
        "of the tests; above friction and the effort's noise (default: %(default)s)",
    ),
    ("--pulse", None, "S", "time at one torque (default: 0.1, or 20 states)"),
    (
        "--max-move",
        0.1,
        "RAD",
        "of a joint, that ends the tests (default: %(default)s)",
    ),
    (
        "--max-speed",
        1.0,
        "RAD/S",
        "of a joint, that ends the tests (default: %(default)s)",
    ),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own arguments."""
    where = parser.add_argument_group("where")
    where.add_argument(
        "--namespace", default="", metavar="NS", help="of the rig's topics"
    )
    where.add_argument(
        "--states",
        default="",
        metavar="TOPIC",
        help="joint states (default: joint_states)",
    )
    where.add_argument(
        "--commands",
        default="",
        metavar="TOPIC",
        help="commands (default: joint_commands, or effort_commands with effort_array)",
    )
    where.add_argument(
        "--command-interface",
        choices=("joint_state", "effort_array"),
        default="joint_state",
        help="type of the commands (default: %(default)s)",
    )
    where.add_argument(
        "--robot",
        type=Path,
        metavar="FILE",
        help="robot description (default: config/dextar.yaml)",
    )
    what = parser.add_argument_group("what is expected")
    how = parser.add_argument_group("how")
    for group, numbers in ((what, EXPECTED), (how, TRIED)):
        for name, default, unit, text in numbers:
            group.add_argument(
                name, type=float, default=default, metavar=unit, help=text
            )
    how.add_argument(
        "--yes", action="store_true", help="the robot may move: do not ask"
    )
    how.add_argument("--no-torque", action="store_true", help="only watch")
    how.add_argument(
        "--json", type=Path, metavar="FILE", help="write the report there, too"
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    from dextar_control.check_rig.client import run_check

    return run_check(arguments)
