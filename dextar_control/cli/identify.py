"""The command ``dextar identify``."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dextar_control.cli.bags import Found, add_fit, run_fit

if TYPE_CHECKING:
    from dextar_control.analysis.run import Run

SUMMARY = "the robot's own masses, friction and tilt from recorded torques"
DESCRIPTION = (
    "Reads bags of one robot and finds the combinations of masses and inertias that its"
    " torques see, the friction of motors, elbows and pin, gravity (the tilt) and, with"
    " external_pose beside encoders at the motors, the transmissions' stiffness; what"
    " they do not tell is kept, and said. Writes identified.yaml, a robot file for"
    " every node (dextar demo --robot, robot_file:= of the launch files), and"
    " identification.html beside the first bag or into --output. A motion for it:"
    " dextar demo --lockstep --excite. Exit code 0; 1 when the bags do not tell enough"
    " or contradict each other or the description (nothing is written then, and what to"
    " record is said) or one is damaged; 2 for a bad file."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own arguments."""
    add_fit(parser, "identification.html")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    from dextar_control.identification.identification import identify, predict_torques
    from dextar_control.identification.report import (
        IDENTIFICATION_FILE,
        IDENTIFIED_FILE,
        torque_fit_in_words,
        torque_prediction_in_words,
        write_identification,
    )

    def find(
        used: Sequence[Run],
        unused: Sequence[Run],
        folder: Path,
        stage: Callable[[str], None],
    ) -> Found:
        found = identify(used, progress=stage)
        predictions = [predict_torques(found, other) for other in unused]
        write_identification(found, predictions, folder)
        lines = [
            *found.told,
            *found.kept,
            *map(torque_prediction_in_words, predictions),
        ]
        return Found(
            torque_fit_in_words(found),
            found.quantities,
            lines,
            (IDENTIFIED_FILE, IDENTIFICATION_FILE),
        )

    return run_fit(arguments, "identify", find)
