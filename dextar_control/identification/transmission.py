"""The stiffness of the transmissions, where encoders at the motors and external poses
show the links lag behind.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dextar_control.contract.robot import RobotParameters
from dextar_control.identification.motion import SmoothMotion
from dextar_control.model.model import Model
from dextar_control.symbols.types import Array

SURE = 5.0  # standard deviations of a compliance from zero, from which on it is told
FEWEST = 200  # poses
OUTLIER = 4.0  # standard deviations


class Stiffness(NamedTuple):
    """Stiffness of a transmission, N m/rad, and its standard deviation."""

    value: float
    deviation: float


def stiffnesses_of(
    robot: RobotParameters, motions: Sequence[SmoothMotion]
) -> list[Stiffness | None]:
    """Find the stiffness of each joint's transmission; None where it is not told.

    A link lags behind its motor by what the transmission passes on over its stiffness;
    an offset and a term once a turn allow for a geometry that is not quite the
    described one.
    """
    model, gaps, passed, angles = Model.of(robot), [], [], []
    rotors = np.array([leg.rotor_inertia for leg in robot.legs])
    for motion in motions:
        if motion.recorded.poses is None or not len(motion.time):
            continue
        times, x = motion.recorded.poses
        after = np.clip(np.searchsorted(motion.time, times), 1, len(motion.time) - 1)
        good = motion.time[after] - motion.time[after - 1] <= 2.0 * float(
            np.median(np.diff(motion.time))
        )
        good &= (times >= motion.time[0]) & (times <= motion.time[-1])

        def at(
            values: Array, own: Array = times[good], time: Array = motion.time
        ) -> Array:
            return np.column_stack(
                [np.interp(own, time, column) for column in values.T]
            )

        q_a = at(motion.q_a)
        links = np.array([model.place(place).q_a for place in x[good]]).reshape(-1, 2)
        gaps.append((links - q_a + np.pi) % (2.0 * np.pi) - np.pi)
        passed.append(at(motion.smooth_tau - rotors * motion.q_a_ddot))
        angles.append(q_a)
    if sum(map(len, gaps)) < FEWEST:
        return [None, None]
    every = (np.concatenate(parts) for parts in (gaps, passed, angles))
    return [
        _stiffness(*(column for column in columns))
        for columns in zip(*(part.T for part in every), strict=True)
    ]


def _stiffness(gap: Array, passed: Array, angle: Array) -> Stiffness | None:
    shapes = np.column_stack([-passed, np.ones(len(gap)), np.cos(angle), np.sin(angle)])
    used = np.isfinite(gap)
    for _ in range(4):
        found = np.linalg.lstsq(shapes[used], gap[used], rcond=None)[0]
        rest = gap - shapes @ found
        spread = float(rest[used].std())
        used = np.abs(np.nan_to_num(rest, nan=np.inf)) <= OUTLIER * spread
    compliance = float(found[0])
    deviation = spread * float(
        np.sqrt(np.linalg.inv(shapes[used].T @ shapes[used])[0, 0])
    )
    return (
        Stiffness(1.0 / compliance, deviation / compliance**2)
        if compliance > SURE * deviation
        else None
    )
