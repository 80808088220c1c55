"""A recorded motion in PyBullet's window: the linkage set from frame to frame, nothing
simulated.

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
from typing import Any

import numpy as np
import pybullet as p

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.robot import flatten, from_flat
from dextar_control.contract.signals import run_command
from dextar_control.mechanisms import mechanism_named
from dextar_sim.urdf import bodies_of
from dextar_sim.world import connect, load, release

KEYS = (
    "time",
    "q",
    "x",
    "torque",
    "s",
    "t_s",
    "planned",
    "locus",
    "phase",
    "speed",
    "robot",
)
T_S_LENGTH = 0.015  # m, half of what is drawn of t_s
HEIGHT = 0.03  # m, of what is drawn over the linkage
CAMERA = 0.24  # m over the plane
BLACK, GREY, RED = (0.0, 0.0, 0.0), (0.5, 0.5, 0.5), (0.65, 0.15, 0.05)
MOST_SEGMENTS = 120  # of a drawn line: the window takes its time for each


class Player:
    """Shows frames of a motion.

    Args:
        motion: the arrays named in KEYS: time (n,) s, q (n, 4) rad in the order q11,
            q12, q21, q22, x and t_s (n, 2), torque (n, 2) N m, s (n,), planned (m, 2)
            and locus (k, 2) m, parted by nan, phase (n,), and the robot as JSON.
        window: open PyBullet's window; otherwise nothing is drawn.

    Raises:
        ParameterError: an array is missing, or the window cannot be opened.
    """

    def __init__(self, motion: Any, window: bool) -> None:
        missing = [key for key in KEYS if key not in motion]
        if missing:
            raise ParameterError(f"the motion has no {', '.join(missing)}")
        if window and not os.environ.get("DISPLAY"):
            raise ParameterError(
                "PyBullet's window needs a display, and DISPLAY is not set"
            )
        self.time, self.x, self._q = motion["time"], motion["x"], motion["q"]
        self._torque, self._s, self._t_s, self._phase = (
            motion["torque"],
            motion["s"],
            motion["t_s"],
            motion["phase"],
        )
        self._window = window
        robot = from_flat(json.loads(str(motion["robot"])))
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
            self._line(motion["locus"], GREY, 2.0)
            self._line(motion["planned"], RED, 3.0)

    def show(self, frame: int) -> None:
        """Put the linkage where it was."""
        for joint, angle in zip(self.loop.joints, self._q[frame], strict=True):
            p.resetJointState(
                self.loop.body, joint, float(angle), 0.0, physicsClientId=self.client
            )
        if not self._window:
            return
        x, along = self.x[frame], T_S_LENGTH * self._t_s[frame]
        self._mark = p.addUserDebugLine(
            [*(x - along), HEIGHT],
            [*(x + along), HEIGHT],
            RED,
            5.0,
            replaceItemUniqueId=self._mark,
            physicsClientId=self.client,
        )
        moment, s = (
            round(float(value), 3) + 0.0 for value in (self.time[frame], self._s[frame])
        )  # no -0.000
        text = "  ".join(
            [
                f"{moment:.3f} s",
                str(self._phase[frame]),
                f"s {s:+.3f}",
                *(
                    f"tau{index + 1} {torque:+.3f} N m"
                    for index, torque in enumerate(self._torque[frame])
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

    def play(self, speed: float) -> None:
        """Every frame in its time; ends when the window is closed."""
        begin = time.monotonic()
        for frame in range(len(self.time)):
            if not p.isConnected(self.client):
                return
            self.show(frame)
            if self._window:
                wait = (self.time[frame] - self.time[0]) / speed - (
                    time.monotonic() - begin
                )
                time.sleep(max(wait, 0.0))
        while self._window and p.isConnected(self.client):
            time.sleep(0.1)

    def close(self) -> None:
        """Leave PyBullet."""
        release(self.client, self._window)

    def _line(
        self, points: np.ndarray, color: tuple[float, float, float], width: float
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


def read_motion(file: Path) -> dict[str, Any]:
    """The arrays of a motion file.

    Raises:
        ParameterError: it cannot be read.
    """
    try:
        with np.load(file) as content:
            return {key: content[key] for key in content.files}
    except (OSError, ValueError) as error:
        raise ParameterError(f"cannot read the motion {file}: {error}") from error


def main(argv: list[str] | None = None) -> int:
    """Show a motion file; 0, or 2 when it cannot be shown."""
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
    motion = read_motion(file)
    player = Player(motion, window=window)
    try:
        player.play(float(motion["speed"]))
    except p.error:
        if p.isConnected(player.client):
            raise
    finally:
        player.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
