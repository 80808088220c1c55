"""A trajectory sampled over time, with the torques that it needs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dextar_control.model.robot import AnyRobot
from dextar_control.planning.model import StatesModel, states_model
from dextar_control.planning.trajectory import Trajectory
from dextar_control.symbols.types import Array

# |s| below which the multipliers are taken from their neighbourhood: 0/0 on the locus
LIMIT_ZONE = 0.01
# of that zone, where they are taken on either side of a crossing
LIMIT_NODES = np.array([1.0, 2.0 / 3.0, 1.0 / 3.0])
# s; a crossing this near to a knot is at the knot, where it was imposed
AT_KNOT = 1e-12
ON_CROSSING = 1e-9  # s, closer to a crossing than this counts as on it


class Profile(NamedTuple):
    """A trajectory at m times, with nan where a leg does not reach."""

    time: Array  # (m,) s
    x: Array  # (m, n) m
    x_dot: Array  # (m, n) m/s
    q_a: Array  # (m, n) rad
    q_a_dot: Array  # (m, n) rad/s
    # (m,) singularity measure: of the block of A_r that is nearest to its locus
    s: Array
    s_blocks: Array  # (m, k) of each
    residual: Array  # (m,) t_s.w_d of the nearest, N
    criterion: Array  # (m, k) of each
    multipliers: Array  # (m, n) lambda, N/m; its finite limit near the locus
    torque: Array  # (m, n) N m; its finite limit near the locus
    type1: Array  # (m,) distance to Type 1


def sample_times(trajectory: Trajectory, period: float) -> Array:
    """Return times (m,), s, at most ``period`` apart, with every knot among them."""
    count = int(np.ceil(trajectory.duration / period - 1e-9)) + 1
    grid = np.linspace(0.0, trajectory.duration, max(count, 2))
    knots = trajectory.knots
    if len(knots) > len(grid):
        return knots
    merged = np.union1d(grid, knots)
    keep = np.concatenate([[True], np.diff(merged) > 1e-9])
    spaced: Array = merged[keep]
    return spaced


def sample_profile(robot: AnyRobot, trajectory: Trajectory, times: Array) -> Profile:
    """Return the profile of a trajectory at times (m,), s.

    Within LIMIT_ZONE of the locus the multipliers are continued from either side of the
    crossing by a parabola: towards the value they tend to when the criterion holds.
    """
    times, model = np.asarray(times, dtype=np.float64), states_model(robot)
    x, x_dot, x_ddot = trajectory.table(times)
    found = model.instants(x, x_dot, x_ddot)
    multipliers = found.multipliers
    for s, (rows, _) in zip(found.s_blocks.T, model.blocks, strict=True):
        inside = ~(np.abs(s) >= LIMIT_ZONE)
        padded = np.concatenate([[False], inside, [False]]).astype(int)
        edges = np.flatnonzero(np.diff(padded))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            first, last = max(start - 1, 0), min(stop, len(times) - 1)
            if s[first] * s[last] < 0.0:
                near = _continued(
                    model, trajectory, times, s, (first, last), times[start:stop]
                )
                multipliers[start:stop, rows] = near[:, rows]
    internal = (found.B.transpose(0, 2, 1) @ multipliers[:, :, None])[:, :, 0]
    torque = found.joint_torque - internal  # Eq. 4: w_b - B^T lambda, and friction
    return Profile(
        time=times,
        x=x,
        x_dot=x_dot,
        q_a=found.q_a,
        q_a_dot=found.q_a_dot,
        s=found.s[:, 0],
        s_blocks=found.s_blocks,
        residual=found.residual[:, 0],
        criterion=found.criterion,
        multipliers=multipliers,
        torque=torque,
        type1=found.type1[:, 0],
    )


def _continued(
    model: StatesModel,
    trajectory: Trajectory,
    times: Array,
    s: Array,
    around: tuple[int, int],
    inside: Array,
) -> Array:
    """Return the multipliers (k, n) at the times ``inside`` (k,), s, between the two
    rows ``around`` a crossing, continued from its neighbourhood.
    """
    first, last = around
    turn = first + int(np.argmax(s[first:last] * s[first + 1 : last + 1] <= 0.0))
    middle = times[turn] + (times[turn + 1] - times[turn]) * s[turn] / (
        s[turn] - s[turn + 1]
    )
    reach = LIMIT_ZONE * (times[last] - times[first]) / abs(s[last] - s[first])
    ahead, sides = inside - middle, []
    for side in (-1.0, 1.0):
        nodes = side * reach * LIMIT_NODES
        near = model.instants(*trajectory.table(middle + nodes)).multipliers
        parabolas = np.polyfit(nodes, near, 2)
        sides.append(
            np.stack([np.polyval(parabola, ahead) for parabola in parabolas.T], axis=1)
        )
    weight = np.select([ahead < -ON_CROSSING, ahead > ON_CROSSING], [0.0, 1.0], 0.5)
    return np.asarray((1.0 - weight[:, None]) * sides[0] + weight[:, None] * sides[1])


def find_crossings(
    robot: AnyRobot, trajectory: Trajectory, times: Array, s: Array, block: int
) -> list[float]:
    """Return the instants, s, at which a block's s changes sign, by bisection to
    machine precision.

    Args:
        robot: of the trajectory.
        trajectory: in which they are looked for.
        times: of the samples, (m,), s.
        s: of the block at the samples, (m,), 1.
        block: of A_r.
    """
    model = states_model(robot)

    def value(time: float) -> float:
        return float(model.side(trajectory.at(time).x).s_blocks[block])

    clear: NDArray[np.int64] = np.flatnonzero((s != 0.0) & np.isfinite(s))
    found = []
    for before, after in zip(clear[:-1], clear[1:], strict=True):
        if s[before] * s[after] < 0.0:
            low, high = times[before], times[after]
            while (middle := 0.5 * (low + high)) not in (low, high):
                low, high = (
                    (middle, high) if value(middle) * s[before] > 0.0 else (low, middle)
                )
            crossing = low if abs(value(low)) < abs(value(high)) else high
            knot = trajectory.knots[np.argmin(np.abs(trajectory.knots - crossing))]
            found.append(float(knot if abs(knot - crossing) < AT_KNOT else crossing))
    return found
