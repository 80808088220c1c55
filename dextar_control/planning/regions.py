"""Regions that one working mode joins without a singularity, on a grid, and ways in
and between them.

The Type 2 locus and a margin about Type 1 cut the workspace of a working mode into
regions of one sign of s. A way within a region is regular motion; a way from one to
another crosses the locus, once when it changes sides once.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dextar_control.contract.robot import RobotParameters
from dextar_control.planning.checks import beyond_range
from dextar_control.planning.model import planning_model
from dextar_control.symbols.types import Array

SPACING = 3e-3  # m, of the grid
MARGIN = 1.2  # times the robot's least distance to Type 1 that a way keeps
COSTLY_TYPE1 = 0.1  # distance to Type 1 at which a way costs twice its length
COSTLY_S = 0.15  # |s| within which it costs up to S_COST times its length more
S_COST = 3.0
ENTRY = 4  # cells within which a place finds its cell
EVERYWHERE = np.ones((3, 3), dtype=int)


class Regions(NamedTuple):
    """The grid of one working mode."""

    origin: Array  # (2,) m, of cell (0, 0)
    shape: tuple[int, int]
    s: Array  # (nx, ny)
    # (nx, ny) number of the region from 1; 0 where a cell is too near to Type 1, out of
    # a joint's range or unreachable
    region: NDArray[np.int64]
    edges: tuple[NDArray[np.int64], NDArray[np.int64], Array]  # from, to, cost


@lru_cache(maxsize=32)
def make_regions(robot: RobotParameters) -> Regions:
    """Return the regions of the robot's working mode."""
    from scipy.ndimage import label  # here: it takes longer to load than all else

    low, high = planning_model(robot).workspace
    extent = np.maximum(high - low, SPACING)
    nx, ny = (np.ceil(extent / SPACING).astype(int) + 1).tolist()
    grid = np.indices((nx, ny)).reshape(2, -1).T
    found = planning_model(robot).sides(low + SPACING * grid)
    beyond = beyond_range(robot, found.q_a).max(axis=1)
    s, type1, beyond = (
        values.reshape(nx, ny) for values in (found.s, found.type1, beyond)
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        clear = (type1 >= MARGIN * robot.min_type1_distance) & (beyond <= 0.0)
        first, count = label(clear & (s > 0.0), EVERYWHERE)
        second, _ = label(clear & (s <= 0.0), EVERYWHERE)
        price = (
            1.0 + (COSTLY_TYPE1 / type1) ** 2 + S_COST * np.exp(-((s / COSTLY_S) ** 2))
        )
    region = first.astype(np.int64) + np.where(second > 0, second + count, 0)
    numbers = np.arange(nx * ny).reshape(nx, ny)
    edges = []
    for di, dj in ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1)):
        a = (slice(0, nx - di), slice(max(0, -dj), ny - max(0, dj)))
        b = (slice(di, nx), slice(max(0, dj), ny + min(0, dj)))
        both = clear[a] & clear[b]
        edges.append(
            (
                numbers[a][both],
                numbers[b][both],
                SPACING * np.hypot(di, dj) * 0.5 * (price[a] + price[b])[both],
            )
        )
    begin, end, cost = (np.concatenate(part) for part in zip(*edges, strict=True))
    return Regions(
        low,
        (nx, ny),
        s,
        region,
        (np.append(begin, end), np.append(end, begin), np.append(cost, cost)),
    )


def cell_of(regions: Regions, x: Array, sign: float) -> int | None:
    """Return the nearest cell to x (2,), m, on the side ``sign`` of the locus, within
    ENTRY cells; None when there is none.
    """
    middle = np.round((x - regions.origin) / SPACING).astype(int)
    low, high = (
        np.maximum(middle - ENTRY, 0),
        np.minimum(middle + ENTRY + 1, regions.shape),
    )
    if (low >= high).any():
        return None
    i, j = np.mgrid[low[0] : high[0], low[1] : high[1]]
    usable = (regions.region[i, j] > 0) & ((regions.s[i, j] > 0.0) == (sign > 0.0))
    if not usable.any():
        return None
    gaps = np.hypot(
        regions.origin[0] + SPACING * i - x[0], regions.origin[1] + SPACING * j - x[1]
    )
    row = np.unravel_index(int(np.argmin(np.where(usable, gaps, np.inf))), gaps.shape)
    return int(np.ravel_multi_index((i[row], j[row]), regions.shape))


def region_of(regions: Regions, x: Array, sign: float) -> int:
    """Return the number of the region at x (2,), m, on the side ``sign`` of the locus;
    0 when there is none.
    """
    cell = cell_of(regions, x, sign)
    return 0 if cell is None else int(regions.region.flat[cell])


def find_way(
    regions: Regions,
    start: Array,
    start_sign: float,
    goal: Array,
    goal_sign: float,
    least_s: float = 0.0,
) -> tuple[Array, int] | None:
    """Return the way (n, 2), m, from start to goal that changes sides once, or never
    when both are on one side.

    Args:
        least_s: |s| kept where both ends lie on one side.

    Returns:
        The way and the index of its first place after the change of sides (0 when it
        makes none), or None.
    """
    from scipy.sparse import csr_matrix  # here: it takes longer to load than all else
    from scipy.sparse.csgraph import dijkstra

    begin, end = cell_of(regions, start, start_sign), cell_of(regions, goal, goal_sign)
    if begin is None or end is None:
        return None
    a, b, cost = regions.edges
    s = regions.s.ravel()
    across = (s[a] > 0.0) != (s[b] > 0.0)
    allowed = ~across
    if start_sign * goal_sign < 0.0:
        allowed |= across & ((s[a] > 0.0) == (start_sign > 0.0))
    elif least_s > 0.0:
        ends = np.isin(a, (begin, end)) | np.isin(b, (begin, end))
        allowed &= ends | ((np.abs(s[a]) >= least_s) & (np.abs(s[b]) >= least_s))
    size = s.size
    graph = csr_matrix((cost[allowed], (a[allowed], b[allowed])), shape=(size, size))
    distances, before = dijkstra(graph, indices=begin, return_predecessors=True)
    if not np.isfinite(distances[end]):
        return None
    cells = [end]
    while cells[-1] != begin:
        cells.append(int(before[cells[-1]]))
    cells.reverse()
    inner = regions.origin + SPACING * np.stack(
        np.unravel_index(np.array(cells[1:-1], dtype=int), regions.shape), axis=1
    )
    sides = s[cells] > 0.0
    return np.vstack([start, inner, goal]), (
        int(np.argmax(sides != sides[0])) if start_sign * goal_sign < 0.0 else 0
    )
