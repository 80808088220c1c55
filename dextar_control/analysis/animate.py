"""A run as an animation: linkage, locus, path, torques and t_s, to a GIF, a WebP or an
MP4.
"""

from __future__ import annotations

import contextlib
import io
import math
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL.Image import Dither, Image

from dextar_control.analysis.curves import Curve, Panel
from dextar_control.analysis.drawing import (
    SCREEN,
    Look,
    draw_line,
    draw_locus,
    draw_panel,
    finish_plane,
)
from dextar_control.analysis.motion import RunFrames
from dextar_control.analysis.plane import corners, locus_of
from dextar_control.analysis.run import Floats
from dextar_control.contract import style
from dextar_control.contract.errors import BagError, ParameterError
from dextar_control.contract.signals import caused_by_interrupt
from dextar_control.contract.style import LINES, Line

# the frames of the first two are held in memory until they are written
MOST_FRAMES = {".gif": 1500, ".webp": 1500, ".mp4": 20_000}
SIZE = (10.0, 5.0)  # inches
COLOURS = 64  # of a GIF: lines and letters with their smoothed edges
RESOLUTION = 96  # dots per inch: 960 x 480 pixels
T_S_HALF = 0.016  # m, of what is drawn of t_s
ARC_RADIUS = 0.014  # m, of the arcs that show the torques
ARC_TURN = 2.0 * math.pi  # rad, of such an arc at the torque axis' end
TRACE, LINKS, T_S = Line("accent", (), 2.0), Line("mid", (), 5.0), Line("bad", (), 4.0)
RING, ARC, CURSOR = Line("line", (), 3.0), Line("ink", (), 3.0), Line("bad", (), 2.0)
PHASES = {
    "TRACK": "on its way",
    "CROSSING": "crossing the locus",
    "SAFE_STOP": "safe stop",
    "FAULT": "fault",
    "HOLD": "at rest",
    "IDLE": "idle",
    "APPROACH": "to its start",
}


def animate(
    motion: RunFrames,
    file: Path,
    speed: float,
    frames_per_second: int,
    progress: Callable[[int, int], None],
    look: Look = SCREEN,
) -> None:
    """Write a run as an animation.

    Args:
        motion: its frames lie speed / frames_per_second s apart.
        file: ``.gif``, ``.webp`` or ``.mp4``; one that is there is replaced once the
            new one is whole.
        speed: s of the run in a second of the animation; printed.
        frames_per_second: of the animation.
        progress: told (frames done, frames in all).
        look: of the pictures.

    Raises:
        ParameterError: another kind of file, too many frames, or an MP4 without ffmpeg.
        BagError: the file cannot be written.
    """
    check_output(file, len(motion.time))
    if file.suffix.lower() != ".mp4":
        kind = OnePaletteWriter if file.suffix.lower() == ".gif" else PillowWriter
        writer: AbstractMovieWriter = kind(fps=frames_per_second)
    else:
        matplotlib.rcParams["animation.ffmpeg_path"] = find_ffmpeg()
        writer = FFMpegWriter(
            fps=frames_per_second, codec="libx264", extra_args=["-pix_fmt", "yuv420p"]
        )
    with look.settings():
        scene = _Scene(motion, speed, look)
    partial = file.with_name(f".{file.stem}.partial{file.suffix}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with writer.saving(scene.figure, str(partial), RESOLUTION):
            for frame in range(len(motion.time)):
                scene.show(frame)
                writer.grab_frame()
                progress(frame + 1, len(motion.time))
        partial.replace(file)
    except OSError as error:
        raise BagError(f"cannot write {file}: {error.strerror or error}") from error
    except subprocess.CalledProcessError as error:  # ffmpeg's; an interrupt ends it too
        if (interrupt := caused_by_interrupt(error)) is not None:
            raise interrupt from None
        raise BagError(
            f"cannot write {file}: {Path(error.cmd[0]).name} ended with code"
            f" {error.returncode}"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()


class OnePaletteWriter(PillowWriter):
    """Writes a GIF whose frames share one palette, which makes it a fifth as large."""

    _frames: list[Image]

    def finish(self) -> None:
        """Write the frames with the palette of the one in the middle."""
        frames = self._frames
        palette = frames[len(frames) // 2].quantize(COLOURS, dither=Dither.NONE)
        self._frames = [
            frame.quantize(palette=palette, dither=Dither.NONE) for frame in frames
        ]
        super().finish()


def check_output(file: Path, frames: int = 0) -> None:
    """Refuse what cannot be written, before anything is done for it.

    Raises:
        ParameterError: as ``animate``.
    """
    most = MOST_FRAMES.get(file.suffix.lower())
    if most is None or file.is_dir():
        raise ParameterError(
            f"--output {file}: it must be a file whose name ends in"
            f" {', '.join(MOST_FRAMES)}"
        )
    if frames > most:
        raise ParameterError(
            f"{frames} frames; a {file.suffix} may have {most}: raise --speed, lower"
            " --fps, or name a part with --from and --to"
        )
    if file.suffix.lower() == ".mp4":
        find_ffmpeg()


def find_ffmpeg() -> str:
    """Find the machine's ffmpeg, or that of the package imageio-ffmpeg.

    Raises:
        ParameterError: there is neither.
    """
    found = shutil.which("ffmpeg")
    if found:
        return found
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError) as error:
        raise ParameterError(
            "an MP4 needs ffmpeg: install it (apt install ffmpeg, or pip install"
            " imageio-ffmpeg), or write a .gif"
        ) from error


class _Scene:
    """A figure whose moving parts ``show`` moves.

    What stands still is drawn once and lies under the rest as an image: a frame then
    takes a tenth of the time.
    """

    def __init__(self, motion: RunFrames, speed: float, look: Look = SCREEN) -> None:
        self._motion, self._look = motion, look
        still = Figure(figsize=SIZE, dpi=RESOLUTION, layout="constrained")
        grid = still.add_gridspec(2, 2, width_ratios=(1.0, 1.1))
        plane = still.add_subplot(grid[:, 0])
        torque = still.add_subplot(grid[0, 1])
        measure = still.add_subplot(grid[1, 1], sharex=torque)
        finite = np.abs(motion.course[np.isfinite(motion.course)])
        self._limit = 1.15 * max(float(finite.max()) if finite.size else 0.0, 1e-3)
        self._draw_plane(plane)
        self._draw_time(torque, measure)
        still.suptitle(" ", fontsize=11.0)
        self.figure = Figure(figsize=SIZE, dpi=RESOLUTION)
        self.figure.figimage(_pixels(still), origin="upper", zorder=-1)
        moving = [self._over(axes) for axes in (plane, torque, measure)]
        (self._trace,) = moving[0].plot([], [], **look.line(TRACE))
        (self._linkage,) = moving[0].plot(
            [], [], **look.line(LINKS, marker="o", markersize=6, alpha=0.85)
        )
        (self._t_s,) = moving[0].plot([], [], **look.line(T_S))
        self._torques = [
            tuple(
                moving[0].plot([], [], **drawn)[0]
                for drawn in (look.line(ARC), look.line(ARC, marker="o", markersize=6))
            )
            for _ in motion.torque.T
        ]
        self._cursors = [
            axes.axvline(motion.time[0], **look.line(CURSOR)) for axes in moving[1:]
        ]
        self._title = self.figure.text(
            0.012, 0.955, "", fontsize=11.0, weight="bold", parse_math=False
        )
        self._words = (
            f"{'true motion' if motion.true else 'estimated motion'}, {speed:g} × real"
            " time"
        )

    def _over(self, axes: Axes) -> Axes:
        over = self.figure.add_axes(axes.get_position().bounds)
        over.set_axis_off()
        over.set_xlim(axes.get_xlim())
        over.set_ylim(axes.get_ylim())
        return over

    def show(self, frame: int) -> None:
        """Draw one frame."""
        motion = self._motion
        links, x = motion.chain(frame), motion.x[frame]
        self._linkage.set_data(*links.T)
        self._trace.set_data(*motion.x[: frame + 1].T)
        along = T_S_HALF * motion.t_s[frame]
        self._t_s.set_data(*np.stack([x - along, x + along]).T)
        self._t_s.set_alpha(max(0.15, 1.0 - abs(float(motion.s[frame]))) ** 2)
        for (arc, head), base, torque in zip(
            self._torques, links[[0, 4]], motion.torque[frame], strict=True
        ):
            around = _arc(base, torque / self._limit if math.isfinite(torque) else 0.0)
            arc.set_data(*around.T)
            head.set_data(*around[-1:].T)
        for cursor in self._cursors:
            cursor.set_xdata([motion.time[frame]] * 2)
        time, s = (
            round(float(value), 3) + 0.0
            for value in (motion.time[frame], motion.s[frame])
        )  # + 0.0 makes -0.0 a plain zero
        phase = PHASES.get(motion.phase[frame], motion.phase[frame].lower())
        title = (
            f"{time:.3f} s: {phase or 'phase unknown'}, s = {s:+.3f}  ({self._words})"
        )
        self._title.set_text(title.replace("-", "−"))

    def _draw_plane(self, axes: Axes) -> None:
        motion, look, locus = self._motion, self._look, locus_of(self._motion.robot)
        draw_locus(axes, locus, look)
        draw_line(axes, motion.planned, LINES["planned", 0], "planned path", look)
        axes.plot([], [], label="path so far", **look.line(TRACE))
        axes.plot(
            [],
            [],
            label=style.mathtext("weak direction, t_s on the locus"),
            **look.line(T_S),
        )
        axes.plot(
            [],
            [],
            label=f"motor's torque, whole ring {self._limit:.2g} N m",
            **look.line(ARC, marker="o", markersize=6),
        )
        for base in motion.chain(0)[[0, -1]]:
            axes.plot(*_arc(base, 1.0).T, **look.line(RING))
        count = len(motion.time)
        reach = [
            motion.planned,
            motion.x,
            *map(motion.chain, range(0, count, max(count // 20, 1))),
        ]
        low, high = corners(
            [
                part[(np.abs(part) < 1.0).all(axis=1)]
                for part in (*reach, *(arc for _, arc in locus))
            ],
            [],
        )
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        finish_plane(axes)

    def _draw_time(self, torque: Axes, measure: Axes) -> None:
        motion = self._motion
        curves = [
            Curve(f"τ{part + 1}", motion.course_time, values, "commanded", part)
            for part, values in enumerate(motion.course.T)
        ]
        draw_panel(
            torque,
            Panel("torque", style.label("torque"), curves, -self._limit, self._limit),
            [],
            False,
            self._look,
        )
        s = [Curve("s", motion.time, motion.s, "seen")]
        draw_panel(
            measure, Panel("s", style.label("s"), s, -1.05, 1.05), [], True, self._look
        )
        measure.axhline(0.0, **self._look.line(Line("mid", (), 0.9)))
        torque.set_xlim(
            motion.time[0],
            motion.time[-1] if len(motion.time) > 1 else motion.time[0] + 1e-3,
        )
        measure.set_xlabel(style.label("time"))


def _arc(base: Floats, share: float) -> Floats:
    """Return an arc (40, 2), m, around a motor, from the top; ``share`` of the turn
    that a whole ring stands for.
    """
    angles = 0.5 * math.pi + np.linspace(0.0, ARC_TURN * share, 40)
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.asarray(base + ARC_RADIUS * around)


def _pixels(figure: Figure) -> NDArray[np.uint8]:
    stream = io.BytesIO()
    figure.savefig(stream, format="raw")
    size = [round(side * RESOLUTION) for side in SIZE]
    return np.frombuffer(stream.getvalue(), np.uint8).reshape(size[1], size[0], 4)
