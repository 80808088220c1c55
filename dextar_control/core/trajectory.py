"""Trajectories of the end effector: piecewise polynomials, and the form in which they travel.

A planned trajectory is exact between its knots. On the ``trajectory`` topic it travels as samples
(position, velocity, acceleration); quintic Hermite interpolation gives it back, and because each
crossing instant is itself a sample, the criterion holds there to machine precision.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dextar_control.contract.errors import TrajectoryError
from dextar_control.core.compiled import njit
from dextar_control.core.model import Array


class Point(NamedTuple):
    """One instant of a trajectory."""

    x: Array  # (2,) m
    x_dot: Array  # (2,) m/s
    x_ddot: Array  # (2,) m/s^2


@njit
def evaluate_segment(coefficients: Array, time: float) -> Array:
    """Rows x, x_dot, x_ddot, shape (3, 2), of one segment, coefficients (n, 2) by rising power."""
    value = np.zeros((3, 2))
    for power in range(coefficients.shape[0] - 1, -1, -1):
        for axis in range(2):
            value[2, axis] = value[2, axis] * time + 2.0 * value[1, axis]
            value[1, axis] = value[1, axis] * time + value[0, axis]
            value[0, axis] = value[0, axis] * time + coefficients[power, axis]
    return value


@njit
def evaluate(knots: Array, origins: Array, coefficients: Array, time: float) -> Array:
    """Rows x, x_dot, x_ddot, shape (3, 2), at a time held within the trajectory."""
    index = np.searchsorted(knots, time, side="right") - 1
    index = min(max(index, 0), coefficients.shape[0] - 1)
    return evaluate_segment(coefficients[index], min(max(time, knots[0]), knots[-1]) - origins[index])


class Trajectory:
    """A piecewise polynomial of the end effector over [0, duration].

    Args:
        knots: (m + 1,) rising times of the segment ends, s, from 0.
        origins: (m,) the time at which each segment's polynomial argument is zero, s.
        coefficients: (m, n, 2) by rising power.
    """

    def __init__(self, knots: Array, origins: Array, coefficients: Array) -> None:
        self.knots = np.ascontiguousarray(knots, dtype=np.float64)
        self.origins = np.ascontiguousarray(origins, dtype=np.float64)
        self.coefficients = np.ascontiguousarray(coefficients, dtype=np.float64)

    @property
    def duration(self) -> float:
        """s."""
        return float(self.knots[-1])

    def at(self, time: float) -> Point:
        """The instant at a time, held at both ends."""
        return Point(*evaluate(self.knots, self.origins, self.coefficients, float(time)))

    def table(self, times: Array) -> tuple[Array, Array, Array]:
        """(x, x_dot, x_ddot), each (k, 2), at times (k,)."""
        values = np.array([evaluate(self.knots, self.origins, self.coefficients, float(time)) for time in times])
        return values[:, 0], values[:, 1], values[:, 2]

    def scaled(self, factor: float) -> Trajectory:
        """The same path, ``factor`` times as long; keeps the criterion without gravity."""
        powers = factor ** -np.arange(self.coefficients.shape[1])
        return Trajectory(self.knots * factor, self.origins * factor, self.coefficients * powers[None, :, None])

    def reversed(self) -> Trajectory:
        """The time reversal; keeps the criterion, since w_d is quadratic in velocity."""
        signs = (-1.0) ** np.arange(self.coefficients.shape[1])
        duration = self.duration
        return Trajectory(
            duration - self.knots[::-1],
            duration - self.origins[::-1],
            (self.coefficients * signs[None, :, None])[::-1],
        )


def hold(x: Array, duration: float) -> Trajectory:
    """At rest at x (2,) for a duration, s."""
    return Trajectory(np.array([0.0, duration]), np.zeros(1), np.array([[x]]))


def join(parts: list[Trajectory]) -> Trajectory:
    """Trajectories one after the other, each starting where the one before ends."""
    width = max(part.coefficients.shape[1] for part in parts)
    knots, origins, coefficients = [np.zeros(1)], [], []
    start = 0.0
    for part in parts:
        knots.append(part.knots[1:] + start)
        origins.append(part.origins + start)
        padding = ((0, 0), (0, width - part.coefficients.shape[1]), (0, 0))
        coefficients.append(np.pad(part.coefficients, padding))
        start += part.duration
    return Trajectory(np.concatenate(knots), np.concatenate(origins), np.concatenate(coefficients))


def quintic(times: Array, x: Array, x_dot: Array, x_ddot: Array) -> Trajectory:
    """Quintic Hermite interpolation of samples.

    Args:
        times: (m,) rising from 0, s.
        x, x_dot, x_ddot: (m, 2), m, m/s, m/s^2.

    Raises:
        TrajectoryError: fewer than two samples, times not rising from zero, a number not finite.
    """
    times, x, x_dot, x_ddot = (np.asarray(part, dtype=np.float64) for part in (times, x, x_dot, x_ddot))
    if len(times) < 2:
        raise TrajectoryError(f"the trajectory has {len(times)} points; at least 2 are needed")
    for name, part in (("times", times), ("positions", x), ("velocities", x_dot), ("accelerations", x_ddot)):
        if not np.isfinite(part).all():
            row = int(np.argmax(~np.isfinite(part.reshape(len(times), -1)).all(axis=1)))
            raise TrajectoryError(f"trajectory {name} at point {row} are not finite: {part[row]}")
    steps = np.diff(times)
    if times[0] != 0.0 or (steps <= 0.0).any():
        row = int(np.argmax(steps <= 0.0)) + 1 if times[0] == 0.0 else 0
        raise TrajectoryError(f"time_from_start at point {row} is {times[row]:.6f} s; times must rise from 0")
    h = steps[:, None]
    dx = x[1:] - x[:-1] - h * x_dot[:-1] - 0.5 * h**2 * x_ddot[:-1]
    dv = (x_dot[1:] - x_dot[:-1] - h * x_ddot[:-1]) * h
    da = (x_ddot[1:] - x_ddot[:-1]) * h**2
    coefficients = np.stack(
        [
            x[:-1],
            x_dot[:-1],
            0.5 * x_ddot[:-1],
            (10.0 * dx - 4.0 * dv + 0.5 * da) / h**3,
            (-15.0 * dx + 7.0 * dv - da) / h**4,
            (6.0 * dx - 3.0 * dv + 0.5 * da) / h**5,
        ],
        axis=1,
    )
    return Trajectory(times, times[:-1], coefficients)
