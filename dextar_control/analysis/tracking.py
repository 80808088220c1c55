"""The part of a run in which a trajectory was tracked, and the plan it followed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from dextar_control.analysis.run import Floats, Phase, Run, Stamps, seconds
from dextar_control.contract.robot import RobotParameters
from dextar_control.planning.certificate import Certificate, measure
from dextar_control.planning.model import states_model
from dextar_control.planning.trajectory import quintic


@dataclass(frozen=True)
class Tracked:
    """The ticks of the last trajectory that was tracked, on one clock.

    Attributes:
        start: ns of its time zero.
        stamps, time: (n,) of the ticks, ns and s.
        estimated_error: (n,) reference against estimate, m.
        true_time, true_s, true_error: (k,) where truth is known, also after the last
            tick: s, 1, m; the error is nan where nothing was tracked.
        torque_time, torque: (c,), (c, 2) commanded, s, N m.
        torque_s: (c,) s at the commands: true where known, else estimated.
    """

    start: int
    stamps: Stamps
    time: Floats
    estimated_error: Floats
    true_time: Floats
    true_s: Floats
    true_error: Floats
    torque_time: Floats
    torque: Floats
    torque_s: Floats


def singularity_measure(robot: RobotParameters, x: Floats, q_a: Floats) -> Floats:
    """Compute s, the sine of the angle from the left to the right distal link.

    Args:
        robot: as described.
        x: (m, n) end effector, m.
        q_a: (m, n) active joints, rad.

    Returns:
        (m,) 1.
    """
    model = states_model(robot)
    s: Floats = model.library.batch("state")(model.p, q_a, x, np.zeros(model.n)).s[:, 0]
    return s


Result = TypeVar("Result")


def once(function: Callable[[Run], Result]) -> Callable[[Run], Result]:
    """Remember what a function computes of a run: metrics, figures and report all start
    from it.
    """
    known: WeakKeyDictionary[Run, Result] = WeakKeyDictionary()

    @wraps(function)
    def remembered(run: Run) -> Result:
        if run not in known:
            known[run] = function(run)
        return known[run]

    return remembered


@once
def plan_of(run: Run) -> Certificate | None:
    """Compute the served trajectory's crossings and torques anew, from the run's robot;
    None where one of the two is not in the bag.
    """
    if run.robot is None or run.trajectory is None:
        return None
    served = run.trajectory
    return measure(
        run.robot, quintic(served.time, served.x, served.x_dot, served.x_ddot)
    )


@once
def tracked(run: Run) -> Tracked | None:
    """Find the last trajectory that was tracked, among those with crossings where there
    are any; None when none was.
    """
    criterion, control = run.criterion, run.control
    crossing = np.isin(criterion.phase, (Phase.TRACK, Phase.CROSSING))
    busy = criterion.stamps[
        crossing if crossing.any() else criterion.phase == Phase.APPROACH
    ]
    stamps, rows, _ = np.intersect1d(
        control.stamps, busy, assume_unique=True, return_indices=True
    )
    known = np.isfinite(control.time[rows])
    stamps, rows = stamps[known], rows[known]
    if len(stamps) == 0:
        return None
    starts = stamps - np.round(control.time[rows] * 1e9).astype(np.int64)
    last = np.abs(starts - starts[-1]) < 1_000_000
    stamps, rows, start = stamps[last], rows[last], int(np.median(starts[last]))
    empty = np.zeros(0)
    true_time, true_s, true_error = empty, empty, empty
    if run.truth is not None:
        inside = run.truth.stamps >= stamps[0]
        true_time = seconds(run.truth.stamps - start)[inside]
        if run.robot is not None:
            true_s = singularity_measure(run.robot, run.truth.x, run.truth.q_a)[inside]
        _, ticks, truths = np.intersect1d(
            stamps, run.truth.stamps, assume_unique=True, return_indices=True
        )
        true_error = np.full(len(run.truth.stamps), np.nan)
        true_error[truths] = np.hypot(
            *(run.control.reference[rows[ticks]] - run.truth.x[truths]).T
        )
        true_error = true_error[inside]
    inside = (run.commands.stamps >= stamps[0]) & (run.commands.stamps <= stamps[-1])
    torque_stamps = run.commands.stamps[inside]
    torque_time = seconds(torque_stamps - start)
    s_time, s = (
        (true_time, true_s)
        if len(true_s)
        else (seconds(criterion.stamps - start), criterion.s)
    )
    torque_s = (
        np.interp(torque_time, s_time, s)
        if len(s)
        else np.full(len(torque_time), np.nan)
    )
    return Tracked(
        start,
        stamps,
        seconds(stamps - start),
        np.hypot(*control.error[rows].T),
        true_time,
        true_s,
        true_error,
        torque_time,
        run.commands.effort[inside],
        torque_s,
    )
