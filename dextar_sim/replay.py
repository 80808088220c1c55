"""Show a recorded motion in PyBullet's window: the linkage is set from frame to frame,
nothing is simulated.

Started as ``python -m dextar_sim.replay MOTION.npz``; ``dextar replay --window`` makes
the file.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pybullet as p
from numpy.typing import NDArray

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.robot import flatten, from_flat
from dextar_control.contract.signals import run_command
from dextar_control.mechanisms import mechanism_named
from dextar_control.symbols.types import Array
from dextar_sim.urdf import bodies_of
from dextar_sim.world import connect, load, release

T_S_LENGTH = 0.015  # m, half of what is drawn of t_s
HEIGHT = 0.03  # m, of what is drawn over the linkage
CAMERA = 0.24  # m over the plane
BLACK, GREY, RED = (0.0, 0.0, 0.0), (0.5, 0.5, 0.5), (0.65, 0.15, 0.05)
MOST_SEGMENTS = 120  # of a drawn line: the window takes its time for each


class ReplayMotion(NamedTuple):
    """A recorded motion, frame by frame.

    Attributes:
        time: of each frame, (n,), s.
        q: joints q11, q12, q21, q22, (n, 4), rad.
        x: end effector, (n, 2), m.
        torque: of the motors, (n, 2), N m.
        s: singularity measure, (n,).
        t_s: direction in which the end effector cannot be held, (n, 2).
        planned: planned path, (m, 2), m; nan parts its pieces.
        locus: Type 2 locus, (k, 2), m; nan parts its pieces.
        phase: of the controller, (n,).
        speed: how many times as fast as real time it is shown.
        robot: the description as JSON.
    """

    time: Array
    q: Array
    x: Array
    torque: Array
    s: Array
    t_s: Array
    planned: Array
    locus: Array
    phase: NDArray[np.str_]
    speed: float
    robot: str


class Player:
    """Shows the frames of a motion.

    Args:
        motion: to be shown.
        window: open PyBullet's window; otherwise nothing is drawn.

    Raises:
        ParameterError: the window cannot be opened.
    """

    def __init__(self, motion: ReplayMotion, window: bool) -> None:
        if window and not os.environ.get("DISPLAY"):
            raise ParameterError(
                "PyBullet's window needs a display, and DISPLAY is not set"
            )
        self._motion, self._window = motion, window
        robot = from_flat(json.loads(motion.robot))
        self.client = connect(window)
        self.loop = load(
            self.client,
            bodies_of(mechanism_named("five_bar"), flatten(robot)),
            1e-3,
            window,
        )
        self._mark, self._words = -1, -1
        self.show(0)
        if window:
            p.resetDebugVisualizerCamera(
                CAMERA, 0.0, -89.9, [0.0, 0.04, 0.0], physicsClientId=self.client
            )
            self._line(motion.locus, GREY, 2.0)
            self._line(motion.planned, RED, 3.0)

    def show(self, frame: int) -> None:
        """Put the linkage where it was in a frame."""
        motion = self._motion
        for joint, angle in zip(self.loop.joints, motion.q[frame], strict=True):
            p.resetJointState(
                self.loop.body, joint, float(angle), 0.0, physicsClientId=self.client
            )
        if not self._window:
            return
        x, along = motion.x[frame], T_S_LENGTH * motion.t_s[frame]
        self._mark = p.addUserDebugLine(
            [*(x - along), HEIGHT],
            [*(x + along), HEIGHT],
            RED,
            5.0,
            replaceItemUniqueId=self._mark,
            physicsClientId=self.client,
        )
        # no -0.000
        moment, s = (
            round(float(value), 3) + 0.0
            for value in (motion.time[frame], motion.s[frame])
        )
        text = "  ".join(
            [
                f"{moment:.3f} s",
                str(motion.phase[frame]),
                f"s {s:+.3f}",
                *(
                    f"tau{index + 1} {torque:+.3f} N m"
                    for index, torque in enumerate(motion.torque[frame])
                    if math.isfinite(torque)
                ),
            ]
        )
        self._words = p.addUserDebugText(
            text,
            [-0.12, -0.05, HEIGHT],
            BLACK,
            1.2,
            replaceItemUniqueId=self._words,
            physicsClientId=self.client,
        )

    def play(self) -> None:
        """Show every frame at its time, until the window is closed."""
        begin, times = time.monotonic(), self._motion.time
        for frame in range(len(times)):
            if not p.isConnected(self.client):
                return
            self.show(frame)
            if self._window:
                due = begin + (times[frame] - times[0]) / self._motion.speed
                time.sleep(max(due - time.monotonic(), 0.0))
        while self._window and p.isConnected(self.client):
            time.sleep(0.1)

    def close(self) -> None:
        """Leave PyBullet."""
        release(self.client, self._window)

    def _line(
        self, points: Array, color: tuple[float, float, float], width: float
    ) -> None:
        kept = points[:: max(len(points) // MOST_SEGMENTS, 1)]
        for first, second in zip(kept[:-1], kept[1:], strict=True):
            if (
                np.isfinite([first, second]).all()
                and np.hypot(*(second - first)) < HEIGHT
            ):
                p.addUserDebugLine(
                    [*first, HEIGHT],
                    [*second, HEIGHT],
                    color,
                    width,
                    physicsClientId=self.client,
                )


def read_motion(file: Path) -> ReplayMotion:
    """Read the motion from a file.

    Raises:
        ParameterError: the file cannot be read, or lacks an array.
    """
    try:
        with np.load(file) as content:
            missing = [name for name in ReplayMotion._fields if name not in content]
            if missing:
                raise ParameterError(f"the motion {file} has no {', '.join(missing)}")
            found = ReplayMotion(*(content[name] for name in ReplayMotion._fields))
    except (OSError, ValueError) as error:
        raise ParameterError(f"cannot read the motion {file}: {error}") from error
    return found._replace(speed=float(found.speed), robot=str(found.robot))


def main(argv: list[str] | None = None) -> int:
    """Show a motion file; return 0, or 2 when it cannot be shown."""
    parser = argparse.ArgumentParser(
        prog="dextar_sim.replay", description="Show a motion file in PyBullet's window."
    )
    parser.add_argument("motion", type=Path, help="an .npz file made by dextar replay")
    parser.add_argument(
        "--direct",
        action="store_true",
        help="without a window: set every frame and end",
    )
    arguments = parser.parse_args(argv)
    return run_command(
        "dextar replay", lambda: _show(arguments.motion, window=not arguments.direct)
    )


def _show(file: Path, *, window: bool) -> int:
    player = Player(read_motion(file), window=window)
    try:
        player.play()
    except p.error:
        if p.isConnected(player.client):
            raise
    finally:
        player.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
