"""The reference of a planned trajectory at a time."""

from __future__ import annotations

import bisect
import math
from functools import lru_cache

import casadi as ca
import numpy as np

from dextar_control.contract.errors import TrajectoryError
from dextar_control.estimation.records import REFERENCE
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.model.model import Model, equations_on
from dextar_control.planning.trajectory import Trajectory
from dextar_control.symbols.functions import Library, cache_folder, named
from dextar_control.symbols.record import Field, Layout, Record
from dextar_control.symbols.types import Array

ROWS = 10  # most coefficients of a segment
SEGMENT = (
    Field("coefficients", "m/s^k", "by rising power", "n", ROWS),
    Field("origin", "s", "of its time"),
    Field("first", "s", "begin of the trajectory, before which it is held"),
    Field("last", "s", "end of the trajectory, after which it is held"),
)
PAIR = (
    Field("begin", "s", "time of the multipliers before"),
    Field("end", "s", "time of the multipliers after"),
    Field("before", "N/m", "multipliers", "n"),
    Field("after", "N/m", "multipliers; between the two they are interpolated", "n"),
)


@lru_cache
def references_of(mechanism: Mechanism) -> Library:
    """Return the function ``refer``: (p, segment, pair, time) -> reference,
    s_blocks.
    """
    n = mechanism.n
    vector, _ = mechanism.symbols()
    (segment_vector, segment), (pair_vector, pair) = (
        Layout(name, n, fields).symbols()
        for name, fields in (("segment", SEGMENT), ("pair", PAIR))
    )
    time, since, table = ca.SX.sym("time"), ca.SX.sym("since"), segment["coefficients"]
    x = table[:, ROWS - 1]
    for power in range(ROWS - 2, -1, -1):
        x = x * since + table[:, power]
    x_dot = ca.jacobian(x, since)
    x_ddot = ca.jacobian(x_dot, since)
    held = ca.fmin(ca.fmax(time, segment["first"]), segment["last"]) - segment["origin"]
    x, x_dot, x_ddot = ca.substitute([x, x_dot, x_ddot], [since], [held])
    e = equations_on(mechanism, vector, x, x_dot)
    share = (time - pair["begin"]) / (pair["end"] - pair["begin"])
    share = ca.fmin(ca.fmax(share, 0.0), 1.0)
    found = {
        "x": x,
        "x_dot": x_dot,
        "x_ddot": x_ddot,
        "q_a": e.q_a,
        "q_a_dot": e.q_a_dot,
        "multipliers": pair["before"] + share * (pair["after"] - pair["before"]),
        "s": e.s,
    }
    arguments = {
        "p": vector,
        "segment": segment_vector,
        "pair": pair_vector,
        "time": time,
    }
    results = {
        "reference": Layout("reference", n, REFERENCE).join(found),
        "s_blocks": e.s_blocks,
    }
    return Library([named("refer", arguments, results)], cache_folder())


class PlannedReference:
    """The reference of a trajectory with the multipliers that it needs.

    Args:
        model: of the robot, as the controller knows it.
        now: the record to write; one of its own when None.

    Attributes:
        now: the reference of the last ``at``.
        s_blocks: of each block of A_r there, (k,).
    """

    def __init__(self, model: Model, now: Record | None = None) -> None:
        n = model.n
        self.now = now or Layout("reference", n, REFERENCE).make()
        self._layouts = Layout("segment", n, SEGMENT), Layout("pair", n, PAIR)
        self._refer = references_of(model.mechanism).fast(
            "refer", p=model.p, reference=self.now.numbers
        )
        self.s_blocks: Array = self._refer.results.s_blocks

    def set(self, trajectory: Trajectory, times: Array, multipliers: Array) -> None:
        """Follow a trajectory.

        Args:
            trajectory: of the platform.
            times: rising, (m,), s.
            multipliers: at these times, (m, n), N/m; interpolated between them.

        Raises:
            TrajectoryError: a segment has more than ROWS coefficients.
        """
        rows = trajectory.coefficients.shape[1]
        if rows > ROWS:
            raise TrajectoryError(
                f"the trajectory's segments have {rows} coefficients; the limit is"
                f" {ROWS}"
            )
        count, n = len(trajectory.origins), len(self.now.x)
        padded = np.zeros((count, ROWS, n))
        padded[:, :rows] = trajectory.coefficients
        (segment, pair), knots = self._layouts, trajectory.knots
        self._segments = segment.rows(
            coefficients=padded.reshape(count, -1),
            origin=trajectory.origins,
            first=knots[0],
            last=knots[-1],
        )
        self._pairs = pair.rows(
            begin=times[:-1],
            end=times[1:],
            before=multipliers[:-1],
            after=multipliers[1:],
        )
        self._begins, self._times = knots[:-1].tolist(), times[:-1].tolist()
        self._row, self._from, self._until = -1, math.nan, math.nan

    def at(self, time: float) -> float:
        """Write into ``now`` the reference at a time since the trajectory's start, s,
        held at both ends; its s.
        """
        given = self._refer.arguments
        if not self._from <= time < self._until:
            segment = max(bisect.bisect_right(self._begins, time) - 1, 0)
            given.segment[:] = self._segments[segment]
            ends = [-math.inf, *self._begins[1:], math.inf]
            self._from, self._until = ends[segment : segment + 2]
        row = max(bisect.bisect_right(self._times, time) - 1, 0)
        if row != self._row:
            self._row = row
            given.pair[:] = self._pairs[row]
        given.time[0] = time
        self._refer.run()
        s: float = self.now.s
        return s
