"""Trajectories of the end effector: piecewise polynomials, and the form in which they
travel.

A planned trajectory is exact between its knots. On the ``trajectory`` topic it travels
as samples (position, velocity, acceleration); quintic Hermite interpolation gives it
back, and because each crossing instant is itself a sample, the criterion holds there to
machine precision.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import NamedTuple

import numpy as np

from dextar_control.contract.errors import TrajectoryError
from dextar_control.symbols.types import Array

# instants that a table computes at once, in less than a control period
AT_ONCE = 512


def in_words(x: Array) -> str:
    """Return a platform position (n,), m, as messages write it."""
    return f"({', '.join(f'{value:.4f}' for value in x)}) m"


def lengths_along(places: Array) -> Array:
    """Return the length (m,), m, of a way up to each of its places (m, n), m."""
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


class Point(NamedTuple):
    """One instant of a trajectory."""

    x: Array  # (n,) m
    x_dot: Array  # (n,) m/s
    x_ddot: Array  # (n,) m/s^2


class Trajectory:
    """A piecewise polynomial of the end effector over [0, duration], immutable.

    Args:
        knots: rising times of the segment ends, (m + 1,), s, from 0.
        origins: times at which each segment's polynomial argument is zero, (m,), s.
        coefficients: by rising power, (m, k, n), m over powers of s.
    """

    def __init__(self, knots: Array, origins: Array, coefficients: Array) -> None:
        self.knots = np.ascontiguousarray(knots, dtype=np.float64)
        self.origins = np.ascontiguousarray(origins, dtype=np.float64)
        self.coefficients = np.ascontiguousarray(coefficients, dtype=np.float64)
        _, rows, n = self.coefficients.shape
        self._begins, self._origins = self.knots[:-1].tolist(), self.origins.tolist()
        self._powers = np.arange(rows, dtype=np.float64)
        self._n, self._end = n, float(self.knots[-1])
        first, second = np.zeros((2, *self.coefficients.shape))
        first[:, :-1] = self.coefficients[:, 1:] * self._powers[1:, None]
        second[:, :-1] = first[:, 1:] * self._powers[1:, None]
        # (m, k, 3n): x, x_dot and x_ddot at once
        self._rows = np.concatenate([self.coefficients, first, second], axis=2)

    @property
    def duration(self) -> float:
        """The time from start to end, s."""
        return self._end

    def at(self, time: float) -> Point:
        """Return the instant at a time, s, held at both ends."""
        held = min(max(float(time), 0.0), self._end)
        row = max(bisect_right(self._begins, held) - 1, 0)
        found = (held - self._origins[row]) ** self._powers @ self._rows[row]
        n = self._n
        return Point(found[:n], found[n : 2 * n], found[2 * n :])

    def table(self, times: Array) -> tuple[Array, Array, Array]:
        """Return (x, m, x_dot, m/s, x_ddot, m/s^2), (k, n) each, at times (k,), s, held
        at both ends.
        """
        held = np.clip(np.asarray(times, dtype=np.float64), 0.0, self.duration)
        found = np.empty((len(held), 3 * self._n))
        for begin in range(0, len(held), AT_ONCE):
            part = slice(begin, begin + AT_ONCE)
            rows = np.maximum(
                np.searchsorted(self.knots[:-1], held[part], side="right") - 1, 0
            )
            powers = (held[part] - self.origins[rows])[:, None] ** self._powers
            found[part] = (powers[:, None, :] @ self._rows[rows])[:, 0]
        x, x_dot, x_ddot = np.split(found, 3, axis=1)
        return x, x_dot, x_ddot

    def scaled(self, factor: float) -> Trajectory:
        """Return the same path in ``factor`` times the time; without gravity it keeps
        the criterion.
        """
        powers = factor ** -np.arange(self.coefficients.shape[1])
        return Trajectory(
            self.knots * factor,
            self.origins * factor,
            self.coefficients * powers[None, :, None],
        )

    def reversed(self) -> Trajectory:
        """Return the time reversal; it keeps the criterion where w_d is quadratic in
        the velocity.
        """
        signs = (-1.0) ** np.arange(self.coefficients.shape[1])
        turned = (self.coefficients * signs[None, :, None])[::-1]
        return Trajectory(
            self.duration - self.knots[::-1], self.duration - self.origins[::-1], turned
        )


def hold(x: Array, duration: float) -> Trajectory:
    """Return the trajectory at rest at x (n,), m, for a duration, s."""
    return Trajectory(np.array([0.0, duration]), np.zeros(1), np.array([[x]]))


def join(parts: list[Trajectory]) -> Trajectory:
    """Return trajectories one after the other, each starting where the one
    before ends.
    """
    width = max(part.coefficients.shape[1] for part in parts)
    knots, origins, coefficients = [np.zeros(1)], [], []
    start = 0.0
    for part in parts:
        knots.append(part.knots[1:] + start)
        origins.append(part.origins + start)
        missing = width - part.coefficients.shape[1]
        coefficients.append(np.pad(part.coefficients, ((0, 0), (0, missing), (0, 0))))
        start += part.duration
    return Trajectory(
        np.concatenate(knots), np.concatenate(origins), np.concatenate(coefficients)
    )


def quintic(times: Array, x: Array, x_dot: Array, x_ddot: Array) -> Trajectory:
    """Return the trajectory through samples by quintic Hermite interpolation.

    Args:
        times: rising from 0, (m,), s.
        x, x_dot, x_ddot: (m, n), m, m/s, m/s^2.

    Raises:
        TrajectoryError: there are fewer than two samples, the times do not rise from
            zero, or a number is not finite.
    """
    times, x, x_dot, x_ddot = (
        np.asarray(part, dtype=np.float64) for part in (times, x, x_dot, x_ddot)
    )
    if len(times) < 2:
        raise TrajectoryError(
            f"the trajectory has {len(times)} points; at least 2 are needed"
        )
    for name, part in (
        ("times", times),
        ("positions", x),
        ("velocities", x_dot),
        ("accelerations", x_ddot),
    ):
        if not np.isfinite(part).all():
            row = int(np.argmax(~np.isfinite(part.reshape(len(times), -1)).all(axis=1)))
            raise TrajectoryError(
                f"trajectory {name} at point {row} are not finite: {part[row]}"
            )
    steps = np.diff(times)
    if times[0] != 0.0 or (steps <= 0.0).any():
        row = int(np.argmax(steps <= 0.0)) + 1 if times[0] == 0.0 else 0
        raise TrajectoryError(
            f"time_from_start at point {row} is {times[row]:.6f} s; times must rise"
            " from 0"
        )
    h = steps[:, None]
    dx = x[1:] - x[:-1] - h * x_dot[:-1] - 0.5 * h**2 * x_ddot[:-1]
    dv = (x_dot[1:] - x_dot[:-1] - h * x_ddot[:-1]) * h
    da = (x_ddot[1:] - x_ddot[:-1]) * h**2
    powers = [
        x[:-1],
        x_dot[:-1],
        0.5 * x_ddot[:-1],
        (10.0 * dx - 4.0 * dv + 0.5 * da) / h**3,
        (-15.0 * dx + 7.0 * dv - da) / h**4,
        (6.0 * dx - 3.0 * dv + 0.5 * da) / h**5,
    ]
    return Trajectory(times, times[:-1], np.stack(powers, axis=1))
