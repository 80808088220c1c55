"""What calibration and identification take of a bag, or of a control loop without
one.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from dextar_control.analysis.run import Run, Stamps, number_of
from dextar_control.contract.errors import CalibrationError
from dextar_control.contract.robot import RobotParameters
from dextar_control.symbols.types import Array

STALE = 0.02  # s, age of a command or a belief that still counts
FEWEST = 50  # states, of which filters can tell something


class MeasuredMotion(NamedTuple):
    """A motion as its encoders, its controller and perhaps a camera told it.

    Attributes:
        path: of the bag.
        working_mode: of the legs.
        time: (m,) s, rising.
        readings: (m, n) of the encoders on one turn after the other, rad.
        torque: (m, n) commanded at each, until the next, N m; nan where there is none.
        side: (m,) sign of s that the controller believed; 0 where it did not know.
        poses: times (k,), s, and positions (k, n), m, of the end effector; None where
            it was not seen.
        believed: the sides are those of a controller at the time, not what is known of
            the start.
    """

    path: Path
    working_mode: tuple[int, int]
    time: Array
    readings: Array
    torque: Array
    side: Array
    poses: tuple[Array, Array] | None = None
    believed: bool = False


def recorded_of(run: Run, robot: RobotParameters, record: str) -> MeasuredMotion:
    """Take the motion of a bag.

    Args:
        robot: as described, where the bag does not say.
        record: what to record, in words.

    Raises:
        CalibrationError: it has too few states of both joints.
    """
    stamps = run.states.stamps
    known = np.isfinite(run.states.position).all(axis=1)
    if known.sum() < FEWEST:
        raise CalibrationError(
            f"{run.path}: {int(known.sum())} joint states have both angles; {FEWEST}"
            f" are the least; {record}"
        )
    given = np.isfinite(run.commands.effort).all(axis=1)
    torque = _held(run.commands.stamps[given], run.commands.effort[given], stamps)
    believed = len(run.criterion.stamps) > 0
    if believed:
        side = np.nan_to_num(
            _held(run.criterion.stamps, run.criterion.assembly_mode[:, None], stamps)[
                :, 0
            ]
        )
    else:
        told = number_of(run.parameters.get("controller", {}).get("assembly_mode"))
        side = np.full(len(stamps), 1.0 if np.isnan(told) else told)
    return MeasuredMotion(
        run.path,
        (run.robot or robot).working_mode,
        ((stamps - stamps[0]) * 1e-9)[known],
        np.unwrap(run.states.position[known], axis=0),
        torque[known],
        side[known],
        (
            None
            if run.poses is None
            else ((run.poses.stamps - stamps[0]) * 1e-9, run.poses.x)
        ),
        believed,
    )


def _held(stamps: Stamps, values: Array, at: Stamps) -> Array:
    """Hold values (k, c) at stamps (k,), ns, until the next one, and read them at other
    stamps (m,), ns; nan where older than STALE.
    """
    if not len(stamps):
        return np.full((len(at), values.shape[1]), np.nan)
    rows = np.searchsorted(stamps, at, side="right") - 1
    found: Array = values[np.maximum(rows, 0)].astype(np.float64)
    found[(rows < 0) | (at - stamps[np.maximum(rows, 0)] > STALE * 1e9)] = np.nan
    return found
