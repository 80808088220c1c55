"""The command ``dextar replay``."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from dextar_control.cli.arguments import add_bag, add_output, number, whole
from dextar_control.cli.bags import add_robot, exit_code_of, given_robot, shown_progress
from dextar_control.contract.errors import ParameterError

SUMMARY = "animate a recorded run"
DESCRIPTION = (
    "Draws the linkage with the Type 2 locus, the path, the motors' torques and t_s"
    " over time, from the true motion where the bag holds it and else from the"
    " estimate, and writes a GIF, a WebP (the smallest) or an MP4; or shows it in"
    " PyBullet's window. Exit code 0, 1 when the bag is damaged or breaks off and what"
    " is left was drawn, 2 for a bad file."
)
WINDOW_MODULE = "dextar_sim.replay"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own arguments."""
    add_bag(parser)
    add_robot(parser)
    text = ".gif, .webp or .mp4 (default: replay.gif beside the bag)"
    add_output(parser, text, metavar="FILE")
    parser.add_argument(
        "--speed",
        type=number(0.0, 1000.0, above=True),
        default=0.2,
        metavar="X",
        help="times real time (default: %(default)g)",
    )
    parser.add_argument(
        "--fps",
        type=whole(1, 120),
        default=20,
        metavar="N",
        help="frames per second (default: %(default)g)",
    )
    parser.add_argument(
        "--from",
        type=float,
        metavar="S",
        dest="begin",
        help="begin, s since the trajectory's start",
    )
    parser.add_argument(
        "--to",
        type=float,
        metavar="S",
        dest="end",
        help="end, s since the trajectory's start",
    )
    parser.add_argument(
        "--dark", action="store_true", help="light on a dark background"
    )
    parser.add_argument(
        "--window",
        action="store_true",
        help="show it in PyBullet's window instead (needs a display)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    from rich.progress import BarColumn, TimeRemainingColumn

    from dextar_control.analysis.animate import animate, check_output
    from dextar_control.analysis.drawing import SCREEN, Look
    from dextar_control.analysis.load import load_run
    from dextar_control.analysis.motion import frames_of
    from dextar_control.contract.style import DARK
    from dextar_control.contract.terminal import (
        Steps,
        Terminal,
        TextColumn,
        spoken_warnings,
    )

    if arguments.window and not os.environ.get("DISPLAY"):
        raise ParameterError(
            "--window needs a display, and DISPLAY is not set; write a file instead:"
            " --output replay.gif"
        )
    if not arguments.window and arguments.output is not None:
        check_output(arguments.output)
    console = Terminal()
    with spoken_warnings("replay"), shown_progress(f"reading {arguments.bag}") as shown:
        recorded = load_run(
            arguments.bag, arguments.namespace, shown.read, given_robot(arguments)
        )
        motion = frames_of(
            recorded, arguments.speed / arguments.fps, arguments.begin, arguments.end
        )
    if arguments.window:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "motion.npz"
            motion.write(file, arguments.speed)
            ended = subprocess.run(
                [sys.executable, "-m", WINDOW_MODULE, str(file)], check=False
            ).returncode
            return ended or exit_code_of(recorded)
    output = arguments.output or recorded.path.parent / "replay.gif"
    check_output(output, len(motion.time))
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total}"),
        TimeRemainingColumn(),
    )
    with Steps(*columns, console=Terminal(stderr=True)) as progress:
        bar = progress.add_task("frames", total=len(motion.time))
        look = Look(palette=DARK) if arguments.dark else SCREEN
        animate(
            motion,
            output,
            arguments.speed,
            arguments.fps,
            lambda done, total: progress.update(bar, completed=done),
            look,
        )
    console.print(f"{output}", soft_wrap=True)
    return exit_code_of(recorded)
