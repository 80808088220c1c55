"""The plan's reference at a time: a piecewise polynomial's segment, and what the robot needs for it."""

from __future__ import annotations

import bisect
from functools import lru_cache

import casadi as ca
import numpy as np

from dextar_control.contract.errors import TrajectoryError
from dextar_control.estimation.records import REFERENCE
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.model.model import Model, equations_of
from dextar_control.planning.trajectory import Trajectory
from dextar_control.symbols.functions import Library, cache_folder, named
from dextar_control.symbols.record import Layout
from dextar_control.symbols.types import Array

ROWS = 10  # most coefficients of a segment


@lru_cache
def references_of(mechanism: Mechanism) -> Library:
    """``refer``: (p, coefficients, time, before, after, share) -> reference, s_blocks."""
    n = mechanism.n
    vector, p = mechanism.symbols()
    coefficients = ca.SX.sym("coefficients", n * ROWS)  # by rising power
    before, after = ca.SX.sym("before", n), ca.SX.sym("after", n)
    time, share = ca.SX.sym("time"), ca.SX.sym("share")
    table = ca.reshape(coefficients, n, ROWS)
    x = table[:, ROWS - 1]
    for power in range(ROWS - 2, -1, -1):
        x = x * time + table[:, power]
    x_dot = ca.jacobian(x, time)
    x_ddot = ca.jacobian(x_dot, time)
    e = equations_of(mechanism).at(vector, mechanism.inverse_geometric_model(x, p), x, x_dot)
    found = {"x": x, "x_dot": x_dot, "x_ddot": x_ddot, "q_a": e.q_a, "q_a_dot": e.q_a_dot,
             "multipliers": before + share * (after - before), "s": e.s}
    arguments = {"p": vector, "coefficients": coefficients, "time": time, "before": before, "after": after, "share": share}
    results = {"reference": Layout("reference", n, REFERENCE).join(found), "s_blocks": e.s_blocks}
    return Library([named("refer", arguments, results)], cache_folder())


class PlannedReference:
    """Of a trajectory and the multipliers that it needs.

    Args:
        model: of the robot, as the controller knows it.

    Attributes:
        now: the reference of the last ``at``.
        s_blocks: (k,) of each block of A_r, there.
    """

    def __init__(self, model: Model) -> None:
        self._n = model.n
        self.now = Layout("reference", model.n, REFERENCE).make()
        self._refer = references_of(model.mechanism).fast("refer", p=model.p, reference=self.now.numbers)
        self.s_blocks: Array = self._refer.results.s_blocks
        self._segment = self._row = -1

    def set(self, trajectory: Trajectory, times: Array, multipliers: Array) -> None:
        """Follow a trajectory.

        Args:
            trajectory: of the platform.
            times: (m,) rising, s.
            multipliers: (m, n) at these times, N/m; between them in proportion.

        Raises:
            TrajectoryError: a segment has more than ROWS coefficients.
        """
        count, rows, _ = trajectory.coefficients.shape
        if rows > ROWS:
            raise TrajectoryError(f"the trajectory's segments have {rows} coefficients; the limit is {ROWS}")
        padded = np.zeros((count, ROWS, self._n))
        padded[:, :rows] = trajectory.coefficients
        self._coefficients = padded.reshape(count, ROWS * self._n)
        self._knots, self._origins = trajectory.knots.tolist(), trajectory.origins.tolist()
        self._times, self._multipliers = times.tolist(), np.ascontiguousarray(multipliers)
        self._segment = self._row = -1

    def at(self, time: float) -> None:
        """Make ``now`` the reference at a time since the trajectory's start, s, held at both ends."""
        given, knots, times = self._refer.arguments, self._knots, self._times
        segment = min(max(bisect.bisect_right(knots, time) - 1, 0), len(self._origins) - 1)
        if segment != self._segment:
            self._segment = segment
            given.coefficients[:] = self._coefficients[segment]
        row = min(max(bisect.bisect_right(times, time) - 1, 0), len(times) - 2)
        if row != self._row:
            self._row = row
            given.before[:], given.after[:] = self._multipliers[row], self._multipliers[row + 1]
        given.time[0] = min(max(time, knots[0]), knots[-1]) - self._origins[segment]
        given.share[0] = min(max((time - times[row]) / (times[row + 1] - times[row]), 0.0), 1.0)
        self._refer.run()
