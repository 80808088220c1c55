"""A run as an animation: linkage, locus, path, torques and t_s, to a GIF or an MP4."""

from __future__ import annotations

import contextlib
import math
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dextar_control.analysis.motion import Motion
from dextar_control.analysis.plane import locus_of
from dextar_control.analysis.thin import thin, thin_path
from dextar_control.contract.errors import BagError, ParameterError
from dextar_control.contract.signals import caused_by_interrupt

MOST_FRAMES = {".gif": 1500, ".mp4": 20_000}  # a GIF's frames are held in memory until it is written
SIZE = (10.0, 5.0)  # inches
RESOLUTION = 96  # dots per inch: 960 x 480 pixels
T_S_LENGTH = 0.012  # m, half of what is drawn of t_s
ARC_RADIUS = 0.014  # m, of the arcs that show the torques
ARC_TURN = 1.5 * math.pi  # rad, of such an arc at the torque limit of the axis
BLACK, GREY, LIGHT, ACCENT = "#000000", "#767676", "#c4c4c4", "#a3260f"
MARGIN = 0.02  # m
TRACE: Any = {"color": BLACK, "linewidth": 1.0}
LINKAGE: Any = {"color": GREY, "linewidth": 4.0, "marker": "o", "markersize": 6, "solid_capstyle": "round", "alpha": 0.8}
T_S: Any = {"color": ACCENT, "linewidth": 3.0}


def animate(
    motion: Motion, file: Path, speed: float, frames_per_second: int, progress: Callable[[int, int], None]
) -> None:
    """Write the animation.

    Args:
        motion: its frames lie speed / frames_per_second s apart.
        file: ``.gif`` or ``.mp4``; one that is there is replaced once the new one is whole.
        speed: s of the run in a second of the animation; printed.
        frames_per_second: of the animation.
        progress: told (frames done, frames in all).

    Raises:
        ParameterError: another kind of file, too many frames, or an MP4 without ffmpeg.
        BagError: the file cannot be written.
    """
    check_output(file, len(motion.time))
    if file.suffix.lower() == ".gif":
        writer: Any = PillowWriter(fps=frames_per_second)
    else:
        matplotlib.rcParams["animation.ffmpeg_path"] = find_ffmpeg()
        writer = FFMpegWriter(fps=frames_per_second, codec="libx264", extra_args=["-pix_fmt", "yuv420p"])
    scene = _Scene(motion, speed)
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
        raise BagError(f"cannot write {file}: {Path(error.cmd[0]).name} ended with code {error.returncode}") from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()


def check_output(file: Path, frames: int = 0) -> None:
    """Refuse what cannot be written, before anything is done for it.

    Raises:
        ParameterError: as ``animate``.
    """
    most = MOST_FRAMES.get(file.suffix.lower())
    if most is None or file.is_dir():
        raise ParameterError(f"--output {file}: it must be a file whose name ends in {' or '.join(MOST_FRAMES)}")
    if frames > most:
        raise ParameterError(
            f"{frames} frames; a {file.suffix} may have {most}: raise --speed, lower --fps, or name a part with --from and --to"
        )
    if file.suffix.lower() == ".mp4":
        find_ffmpeg()


def find_ffmpeg() -> str:
    """The machine's ffmpeg, or the one of the package imageio-ffmpeg.

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
            "an MP4 needs ffmpeg: install it (apt install ffmpeg, or pip install imageio-ffmpeg), or write a .gif"
        ) from error


class _Scene:
    """The figure; ``show`` moves what moves.

    What stands still is drawn once and lies under the rest as an image: a frame then takes a tenth of the time.
    """

    def __init__(self, motion: Motion, speed: float) -> None:
        self._motion = motion
        still = Figure(figsize=SIZE, dpi=RESOLUTION, layout="constrained")
        canvas = FigureCanvasAgg(still)
        grid = still.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
        plane = still.add_subplot(grid[:, 0])
        torque = still.add_subplot(grid[0, 1])
        measure = still.add_subplot(grid[1, 1], sharex=torque)
        finite = np.abs(motion.course[np.isfinite(motion.course)])
        self._limit = 1.15 * max(float(finite.max()) if finite.size else 0.0, 1e-3)
        self._draw_plane(plane)
        self._draw_time(torque, measure)
        still.suptitle(" ", fontsize=10)
        canvas.draw()
        self.figure = Figure(figsize=SIZE, dpi=RESOLUTION)
        FigureCanvasAgg(self.figure)
        self.figure.figimage(np.array(canvas.buffer_rgba()), origin="upper", zorder=-1)
        moving = [self._over(axes) for axes in (plane, torque, measure)]
        (self._trace,) = moving[0].plot([], [], **TRACE)
        (self._linkage,) = moving[0].plot([], [], **LINKAGE)
        (self._t_s,) = moving[0].plot([], [], **T_S)
        self._arcs = [moving[0].plot([], [], color=BLACK, linewidth=2.5)[0] for _ in range(2)]
        self._heads = [moving[0].plot([], [], color=BLACK, marker="o", markersize=5, linestyle="none")[0] for _ in range(2)]
        self._cursors = [axes.axvline(motion.time[0], color=ACCENT, linewidth=1.5) for axes in moving[1:]]
        self._title = self.figure.text(0.5, 0.965, "", ha="center", fontsize=10, family="monospace")
        self._words = f"{'true motion' if motion.true else 'estimated motion'}, {speed:g} × real time"

    def _over(self, axes: Any) -> Any:
        """Empty axes in the place of others."""
        over = self.figure.add_axes(axes.get_position())
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
        along = T_S_LENGTH * motion.t_s[frame]
        self._t_s.set_data(*np.stack([x - along, x + along]).T)
        self._t_s.set_alpha(max(0.15, 1.0 - abs(float(motion.s[frame]))) ** 2)
        for arc, base, torque in zip(self._arcs, links[[0, 4]], motion.torque[frame], strict=True):
            turn = ARC_TURN * (torque / self._limit if math.isfinite(torque) else 0.0)
            angles = 0.5 * math.pi + np.linspace(0.0, turn, 40)
            arc.set_data(*(base + ARC_RADIUS * np.stack([np.cos(angles), np.sin(angles)], axis=1)).T)
            head = base + ARC_RADIUS * np.array([math.cos(angles[-1]), math.sin(angles[-1])])
            self._heads[self._arcs.index(arc)].set_data(*head[:, None])
        for cursor in self._cursors:
            cursor.set_xdata([motion.time[frame]] * 2)
        time, s = (round(float(value), 3) + 0.0 for value in (motion.time[frame], motion.s[frame]))  # no -0.000
        self._title.set_text(f"{time:8.3f} s   {motion.phase[frame]:<9}   s {s:+.3f}   {self._words}")

    def _draw_plane(self, axes: Any) -> None:
        motion = self._motion
        named = set()
        for family, arc in locus_of(motion.robot):
            axes.plot(*arc.T, color=GREY, linestyle="--" if family == "stretched" else ":", linewidth=1.2,
                      label=None if family in named else f"locus, {family}")  # fmt: skip
            named.add(family)
        if len(motion.planned):
            axes.plot(*motion.planned[thin_path(motion.planned)].T, color=ACCENT, linewidth=4.0, alpha=0.25, label="planned path")
        axes.plot([], [], label="path so far", **TRACE)
        axes.plot([], [], label="weak direction ($t_s$ on the locus)", **T_S)
        axes.plot([], [], color=BLACK, linewidth=2.5, marker="o", markersize=5, label="torque at each motor")
        reach = np.concatenate([motion.planned, motion.x, *[motion.chain(row) for row in _some(len(motion.time))]])
        reach = reach[np.isfinite(reach).all(axis=1) & (np.abs(reach) < 1.0).all(axis=1)]
        low, high = reach.min(axis=0) - MARGIN, reach.max(axis=0) + MARGIN
        axes.set_aspect("equal")
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_xlabel("x (m)")
        axes.set_ylabel("y (m)")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, fontsize=7, frameon=False)

    def _draw_time(self, torque: Any, measure: Any) -> None:
        motion = self._motion
        for part, style in enumerate(("-", "--")):
            rows = thin(motion.course_time, motion.course[:, part])
            torque.plot(motion.course_time[rows], motion.course[rows, part], BLACK, linestyle=style, linewidth=1.0,
                        label=f"τ{part + 1}")  # fmt: skip
        rows = thin(motion.time, motion.s)
        measure.plot(motion.time[rows], motion.s[rows], BLACK, linewidth=1.0)
        measure.axhline(0.0, color=GREY, linewidth=0.8, linestyle="--")
        torque.set_ylim(-self._limit, self._limit)
        measure.set_ylim(-1.05, 1.05)
        torque.set_xlim(motion.time[0], motion.time[-1] if len(motion.time) > 1 else motion.time[0] + 1e-3)
        torque.set_ylabel("torque (N m)")
        measure.set_ylabel("s (1), 0 on the locus")
        measure.set_xlabel("time since the trajectory's start (s)")
        torque.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=7, ncols=2, frameon=False, borderaxespad=0.0)
        torque.tick_params(labelbottom=False)
        for axes in (torque, measure):
            axes.grid(color="#e6e6e6", linewidth=0.5)


def _some(count: int) -> range:
    return range(0, count, max(count // 20, 1))


