"""A run as frames: where the linkage was, with which torques, at evenly spaced
times.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dextar_control.analysis.plane import chain, locus_of, t_s_at
from dextar_control.analysis.run import Floats, Run, Stamps, rows_between, seconds
from dextar_control.analysis.timing import phase_name
from dextar_control.analysis.tracking import singularity_measure, tracked
from dextar_control.contract.errors import BagError, ParameterError
from dextar_control.contract.robot import JOINT_NAMES, RobotParameters, flatten

MARGIN = 0.1  # s shown before and after the trajectory


class RunFrames(NamedTuple):
    """A run at evenly spaced times, to be shown as a motion.

    Attributes:
        robot: as the controller had it.
        true: the positions are the true ones; otherwise the estimate with the measured
            joints.
        time: (n,) s since the trajectory's start (since the first state where nothing
            was tracked).
        x, q_a: (n, 2) end effector, m, and active joints, rad.
        torque: (n, 2) last command, N m; nan before the first.
        s: (n,) singularity measure at x and q_a.
        t_s: (n, 2) unit weak direction there: t_s on the locus.
        phase: (n,) of the controller, by name.
        planned: (m, 2) the served path, m.
        course_time, course: (k,), (k, 2) every command between the first frame and the
            last, s, N m: frames pass over peaks.
    """

    robot: RobotParameters
    true: bool
    time: Floats
    x: Floats
    q_a: Floats
    torque: Floats
    s: Floats
    t_s: Floats
    phase: list[str]
    planned: Floats
    course_time: Floats
    course: Floats

    def chain(self, frame: int) -> Floats:
        """Return motor, elbow, end effector, elbow and motor of a frame, (5, 2), m."""
        return chain(self.robot, self.x[frame], self.q_a[frame])

    def write(self, file: Path, speed: float) -> None:
        """Write what PyBullet's window needs into one .npz file."""
        links = np.array([self.chain(frame) for frame in range(len(self.time))])
        distal = np.stack(
            [np.arctan2(*(self.x - links[:, row]).T[::-1]) for row in (1, 3)], axis=1
        )
        q = np.stack(
            [
                self.q_a[:, 0],
                distal[:, 0] - self.q_a[:, 0],
                self.q_a[:, 1],
                distal[:, 1] - self.q_a[:, 1],
            ],
            axis=1,
        )
        arcs = [arc for _, arc in locus_of(self.robot)]
        np.savez_compressed(
            file,
            time=self.time,
            q=q,
            x=self.x,
            torque=self.torque,
            s=self.s,
            t_s=self.t_s,
            planned=self.planned,
            locus=(
                np.concatenate([np.vstack([arc, [[np.nan, np.nan]]]) for arc in arcs])
                if arcs
                else np.zeros((0, 2))
            ),
            phase=np.array(self.phase),
            speed=speed,
            robot=json.dumps(flatten(self.robot)),
        )


def frames_of(
    run: Run, period: float, begin: float | None = None, end: float | None = None
) -> RunFrames:
    """Sample a run every ``period`` s of its own time.

    Args:
        run: with a robot.
        period: between frames, s of the run.
        begin, end: s since the trajectory's start; the trajectory with a little before
            and after by default.

    Raises:
        BagError: the bag holds no robot description or no position.
        ParameterError: there is nothing between begin and end.
    """
    if run.robot is None:
        raise BagError(
            f"{run.path} holds no robot description: there is no linkage to draw;"
            " --robot FILE gives it"
        )
    stamps, x, q_a = _positions(run)
    if len(stamps) == 0:
        raise BagError(
            f"{run.path} holds no position of the end effector: neither the truth nor"
            " the controller's estimate"
        )
    track = tracked(run)
    zero = track.start if track else int(stamps[0])
    clock = seconds(stamps - zero)
    first, last = (
        (track.time[0] - MARGIN, track.time[-1] + MARGIN)
        if track
        else (clock[0], clock[-1])
    )
    first = max(first if begin is None else begin, float(clock[0]))
    if end is None and begin is not None and begin >= last:
        last = float(clock[-1])
    last = min(last if end is None else end, float(clock[-1]))
    if not first < last:
        raise ParameterError(
            f"from {begin if begin is not None else first:g} s to"
            f" {end if end is not None else last:g} s: the bag has nothing there; its"
            f" motion is from {clock[0]:.3f} to {clock[-1]:.3f} s"
        )
    times = np.arange(first, last + 1e-9, period)
    rows = _last(clock, times)
    commands = seconds(run.commands.stamps - zero)
    told = _last(commands, times)
    torque = np.full((len(times), len(JOINT_NAMES)), np.nan)
    torque[told >= 0] = run.commands.effort[told[told >= 0]]
    seen = _last(seconds(run.criterion.stamps - zero), times)
    names = [
        phase_name(int(run.criterion.phase[row])) if row >= 0 else "" for row in seen
    ]
    robot, shown = run.robot, rows_between(commands, times[0], times[-1] + 1e-9)
    return RunFrames(
        robot=robot,
        true=run.truth is not None,
        time=times,
        x=x[rows],
        q_a=q_a[rows],
        torque=torque,
        s=singularity_measure(robot, x[rows], q_a[rows]),
        t_s=np.array([t_s_at(robot, point) for point in x[rows]]),
        phase=names,
        planned=run.trajectory.x if run.trajectory is not None else np.zeros((0, 2)),
        course_time=commands[shown],
        course=run.commands.effort[shown],
    )


def _positions(run: Run) -> tuple[Stamps, Floats, Floats]:
    """Return (stamps, end effector, active joints): the true ones, or else the estimate
    with the measured joints.
    """
    if run.truth is not None:
        return run.truth.stamps, run.truth.x, run.truth.q_a
    known = np.isfinite(run.control.estimate).all(axis=1)
    stamps, rows, joints = np.intersect1d(
        run.control.stamps[known],
        run.states.stamps,
        assume_unique=True,
        return_indices=True,
    )
    offset = run.robot.encoder_offset if run.robot else 0.0
    return (
        np.asarray(stamps, dtype=np.int64),
        run.control.estimate[known][rows],
        run.states.position[joints] - offset,
    )


def _last(clock: Floats, times: Floats) -> Stamps:
    """Find the row of the last value at each time; -1 before the first."""
    return np.searchsorted(clock, times + 1e-9, side="right").astype(np.int64) - 1
