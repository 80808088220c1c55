"""The command ``dextar calibrate``."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dextar_control.cli.bags import Found, add_fit, run_fit

if TYPE_CHECKING:
    from dextar_control.analysis.run import Run

SUMMARY = (
    "the robot's own lengths, motor axes and encoder offsets from recorded crossings"
)
DESCRIPTION = (
    "Reads bags of one robot and finds its geometry. At each crossing the distal links"
    " are aligned, so that the encoders alone tell how far apart the elbows are; with"
    " external_pose in the bags every length, axis and offset is found, without it all"
    " up to scale, place and turn, which are kept, and said. Writes calibrated.yaml, a"
    " robot file for every node (dextar demo --robot, robot_file:= of the launch"
    " files), and calibration.html beside the first bag or into --output. A tour for"
    " it: dextar demo --lockstep --tour 12. Exit code 0; 1 when the bags do not tell"
    " enough or contradict each other or the description (nothing is written then, and"
    " what to record is said) or one is damaged; 2 for a bad file."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own arguments."""
    add_fit(parser, "calibration.html")
    parser.add_argument(
        "--no-pose",
        action="store_true",
        help="leave external poses out, by the encoders alone",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    from dextar_control.identification.calibration import calibrate, predict
    from dextar_control.identification.report import (
        PAGE_FILE,
        ROBOT_FILE,
        fit_in_words,
        prediction_in_words,
        write_calibration,
    )

    def find(
        used: Sequence[Run],
        unused: Sequence[Run],
        folder: Path,
        stage: Callable[[str], None],
    ) -> Found:
        found = calibrate(used, poses=not arguments.no_pose, progress=stage)
        predictions = [predict(found, other) for other in unused]
        write_calibration(found, predictions, folder)
        return Found(
            fit_in_words(found),
            found.quantities,
            [*found.kept, *map(prediction_in_words, predictions)],
            (ROBOT_FILE, PAGE_FILE),
        )

    return run_fit(arguments, "calibrate", find)
