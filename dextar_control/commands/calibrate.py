"""``dextar calibrate``."""

from __future__ import annotations

import argparse
from pathlib import Path

from dextar_control.commands import EXIT_FAILED
from dextar_control.commands.bags import add_robot, exit_code_of, given_robot, shown_progress

SUMMARY = "the robot's own lengths, motor axes and encoder offsets from recorded crossings"
DESCRIPTION = (
    "Reads bags of one robot and finds its geometry. At each crossing the distal links are aligned, so that the encoders alone"
    " tell how far apart the elbows are; with external_pose in the bags every length, axis and offset is found, without it"
    " all up to scale, place and turn, which are kept, and said. Writes calibrated.yaml, a robot file for every node (dextar demo"
    " --robot, robot_file:= of the launch files), and calibration.html beside the first bag or into --output. A tour for it:"
    " dextar demo --lockstep --tour 12. Exit code 0; 1 when the bags do not tell enough or contradict each other or the"
    " description (nothing is written then, and what to record is said) or one is damaged; 2 for a bad file."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    parser.add_argument("bag", type=Path, nargs="+", help="an .mcap file, or the run's folder; several are taken together")
    parser.add_argument("--check", type=Path, action="append", default=[], metavar="BAG",
                        help="a bag that is not used, to see how the numbers explain it (repeatable)")  # fmt: skip
    parser.add_argument("--no-pose", action="store_true", help="leave external poses out, by the encoders alone")
    add_robot(parser)
    parser.add_argument("--output", type=Path, metavar="DIR", help="where the results go (default: beside the first bag)")


def run(arguments: argparse.Namespace) -> int:
    """The exit code."""
    from dextar_control.analysis.load import load_run
    from dextar_control.contract.errors import CalibrationError
    from dextar_control.contract.terminal import Terminal, say, spoken_warnings
    from dextar_control.identification.calibration import calibrate, predict
    from dextar_control.identification.report import PAGE_FILE, ROBOT_FILE, predicted, sentence, summary, write_calibration

    console, robot = Terminal(), given_robot(arguments)
    with spoken_warnings("calibrate"), shown_progress() as shown:
        runs = []
        for bag in (*arguments.bag, *arguments.check):
            shown.stage(f"reading {bag}")
            runs.append(load_run(bag, arguments.namespace, shown.read, robot))
        twice = [run.path for row, run in enumerate(runs) if run.path.resolve() in [one.path.resolve() for one in runs[:row]]]
        if twice:
            say(f"dextar calibrate: {twice[0]} is given twice; each bag may serve once, and --check takes one that does not")
            return EXIT_FAILED
        used, unused = runs[: len(arguments.bag)], runs[len(arguments.bag) :]
        folder = arguments.output or used[0].path.parent
        try:
            found = calibrate(used, poses=not arguments.no_pose, progress=shown.stage)
            predictions = [predict(found, other) for other in unused]
            shown.stage(f"writing to {folder}")
            write_calibration(found, predictions, folder)
        except CalibrationError as error:
            say(f"dextar calibrate: {error}")
            return EXIT_FAILED
    console.print(summary(sentence(found), found.quantities))
    for line in (*found.kept, *map(predicted, predictions)):
        console.print(line, soft_wrap=True)
    console.print(f"{folder}: {ROBOT_FILE} {PAGE_FILE}", soft_wrap=True)
    return exit_code_of(*runs)
