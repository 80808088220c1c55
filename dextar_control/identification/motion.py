"""A recorded motion as joints, platform and torques at the same instants, smooth and
often enough, where it tells something.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d
from scipy.signal import butter, sosfiltfilt

from dextar_control.contract.robot import RobotParameters, flatten
from dextar_control.identification.recorded import MeasuredMotion
from dextar_control.mechanisms import DETAILED_FIVE_BAR
from dextar_control.model.model import library_of
from dextar_control.model.regressor import regressors
from dextar_control.symbols.types import Array

CUTOFF = 80.0  # Hz, of the filter that smooths the readings forwards and backwards
ORDER = 4  # of that filter
# Hz, of the filter over both sides of the equation: up to there torques are compared
PARALLEL = 20.0
SPREAD = 0.05  # s before and after an instant that the second filter mixes into it
EDGE = 0.06  # s at either end of a stretch in which the filters settle
WINDOW = 0.02  # s between the instants of the equation that count
BLOCK = 0.25  # s within which unexplained torques may have one cause
# |s| above which the encoders tell where the platform is, and how it is accelerated
LEAST_S = 0.2
LEAST_RATE = 0.1  # rad/s of each joint, below which friction has no sure sign
GAP = 3.5  # periods without a state that end a stretch
SHORTEST = 0.3  # s of a stretch
NOTHING = {"time": np.zeros(0)} | dict.fromkeys(
    "q_a q_a_ddot x x_dot x_ddot tau smooth_tau tau_dot".split(), np.zeros((0, 2))
)
"""A stretch without an instant."""
EXCITE = "record dextar demo --lockstep --excite (on a rig dextar go --excite 20)"


@dataclass(frozen=True)
class SmoothMotion:
    """The stretches of a motion in which the encoders tell it, on even grids, smooth.

    Attributes:
        recorded: where they come from.
        time: (m,) s, of each instant.
        stretches: slices of the m instants.
        parallel: coefficients of the filter that goes over both sides of the equation,
            stretch by stretch.
        tells: of the m those rows that count then: far enough apart, clear of both
            ends, the joints turning.
        q_a, q_a_ddot, x, x_dot, x_ddot, tau, smooth_tau, tau_dot: (m, n); tau as
            commanded.
        jitter: (n,) standard deviation of the joints' accelerations by their readings'
            noise, rad/s^2.
        spans: (n,) of the readings, rad.
        rates: (k, n) of the joints at the k instants that tell something, rad/s.
    """

    recorded: MeasuredMotion
    time: Array
    stretches: tuple[slice[int, int, None], ...]
    parallel: Array
    tells: NDArray[np.int64]
    q_a: Array
    q_a_ddot: Array
    x: Array
    x_dot: Array
    x_ddot: Array
    tau: Array
    smooth_tau: Array
    tau_dot: Array
    jitter: Array
    spans: Array
    rates: Array

    def filtered(self, values: Array) -> Array:
        """Filter values (m, ...) of the instants, units alike, and choose those that
        tell something.
        """
        found = np.empty_like(values)
        for part in self.stretches:
            found[part] = sosfiltfilt(self.parallel, values[part], axis=0)
        return found[self.tells]


def motion_of(robot: RobotParameters, recorded: MeasuredMotion) -> SmoothMotion:
    """Find the stretches of a recorded motion that tell something; maybe none."""
    p = DETAILED_FIVE_BAR.values(
        flatten(robot) | {"working_mode": recorded.working_mode}
    )
    library, made = library_of(DETAILED_FIVE_BAR), regressors(DETAILED_FIVE_BAR)
    direct, moving = (
        partial(one, p)
        for one in (library.batch("direct_geometric_model"), made.batch("motion"))
    )
    period = float(np.median(np.diff(recorded.time)))
    smooth, parallel = (
        butter(ORDER, min(cutoff, 0.4 / period), fs=1.0 / period, output="sos")
        for cutoff in (CUTOFF, PARALLEL)
    )
    usable = np.isfinite(recorded.torque).all(axis=1) & (recorded.side != 0.0)
    breaks = (
        (np.diff(recorded.time) > GAP * period)
        | np.diff(usable)
        | (np.diff(recorded.side) != 0.0)
    )
    edge, step, least = (
        round(EDGE / period),
        max(round(WINDOW / period), 1),
        round(SHORTEST / period),
    )
    parts: list[dict[str, Array]] = [NOTHING]
    stretches: list[slice[int, int, None]] = []
    end = 0
    tells, rates = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 2))]
    for rows in np.split(np.arange(len(recorded.time)), np.flatnonzero(breaks) + 1):
        if not usable[rows[0]] or np.ptp(recorded.time[rows]) < SHORTEST:
            continue
        part = _even(robot, recorded, rows, period, smooth)
        part["x"] = direct(part["q_a"], float(recorded.side[rows[0]])).x
        found = moving(part["q_a"], part["x"], part.pop("q_a_dot"), part["q_a_ddot"])
        part |= {"x_dot": found.x_dot, "x_ddot": found.x_ddot}
        clear = (np.abs(found.s[:, 0]) >= LEAST_S) & np.isfinite(found.x_ddot).all(
            axis=1
        )
        slow = (
            minimum_filter1d(
                np.abs(found.rates).min(axis=1), 2 * round(SPREAD / period) + 1
            )
            < LEAST_RATE
        )
        for own in np.split(np.arange(len(clear)), np.flatnonzero(np.diff(clear)) + 1):
            if not clear[own[0]] or len(own) < least:
                continue
            parts.append({name: values[own] for name, values in part.items()})
            stretches.append(slice(end, end + len(own)))
            inner = np.arange(edge, len(own) - edge, step)
            inner = inner[~slow[own[inner]]]
            tells.append(end + inner)
            rates.append(found.rates[own[inner]])
            end += len(own)
    joined = {name: np.concatenate([one[name] for one in parts]) for name in NOTHING}
    return SmoothMotion(
        recorded=recorded,
        stretches=tuple(stretches),
        parallel=parallel,
        tells=np.concatenate(tells),
        jitter=_jitter(recorded, period, smooth, parallel),
        spans=np.ptp(recorded.readings, axis=0),
        rates=np.concatenate(rates),
        **joined,
    )


def _even(
    robot: RobotParameters,
    recorded: MeasuredMotion,
    rows: NDArray[np.int64],
    period: float,
    smooth: Array,
) -> dict[str, Array]:
    """Put one stretch without a gap on an even grid."""
    time = recorded.time[rows]
    grid = time[0] + period * np.arange(int(np.ptp(time) / period + 1e-6) + 1)
    readings = np.column_stack(
        [np.interp(grid, time, column) for column in recorded.readings[rows].T]
    )
    held = np.clip(
        np.searchsorted(time, grid + 1e-6 * period, side="right") - 1, 0, len(rows) - 1
    )
    torque = recorded.torque[rows][held]
    # a command acts for a whole period: this is the mean about its beginning
    torque = 0.5 * (torque + np.vstack([torque[:1], torque[:-1]]))
    q_a = sosfiltfilt(smooth, readings - np.array(robot.encoder_offset), axis=0)
    q_a_dot = np.gradient(q_a, period, axis=0)
    smooth_tau = sosfiltfilt(smooth, torque, axis=0)
    return {
        "time": grid,
        "q_a": q_a,
        "q_a_dot": q_a_dot,
        "q_a_ddot": np.gradient(q_a_dot, period, axis=0),
        "tau": torque,
        "smooth_tau": smooth_tau,
        "tau_dot": np.gradient(smooth_tau, period, axis=0),
    }


def _jitter(
    recorded: MeasuredMotion, period: float, smooth: Array, parallel: Array
) -> Array:
    """Estimate the errors (n,) of the joints' accelerations, rad/s^2, by what the
    filter takes off the readings.
    """
    noise = (recorded.readings - sosfiltfilt(smooth, recorded.readings, axis=0)).std(
        axis=0
    )
    impulse = np.zeros(int(1.0 / period))
    impulse[len(impulse) // 2] = 1.0
    passed = np.gradient(
        np.gradient(sosfiltfilt(parallel, sosfiltfilt(smooth, impulse)), period), period
    )
    return np.asarray(noise * np.linalg.norm(passed))
