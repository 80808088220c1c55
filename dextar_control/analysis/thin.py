"""Fewer points for a picture, with its extremes: what a report of a long run can
hold.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dextar_control.analysis.run import Floats, rows_between

POINTS = 4000  # of a curve, outside the windows kept whole
WHOLE = 8000  # points of a curve that may lie in such windows
WINDOW = 0.06  # s on either side of an instant that is kept whole where there is room
BLOCK = 1 << 16  # rows looked at together
STEP = 2.0e-4  # m between the points of a drawn path, at least

Rows = NDArray[np.int64]


def thin(
    time: Floats, values: Floats, instants: Sequence[float] = (), points: int = POINTS
) -> Rows:
    """Choose the rows of a curve that show it: the least and the greatest value of each
    bin, and all rows near some instants.

    Args:
        time: (n,) rising, s.
        values: (n,); nan rows are kept where they part the curve.
        instants: s, about which every row is kept as long as there are not too many.
        points: about how many rows may come from the bins.

    Returns:
        Rising rows; all of them when n is at most ``points``.
    """
    count = len(time)
    if count <= points:
        return np.arange(count)
    edges = np.linspace(0, count, max(points // 2, 1) + 1).astype(np.int64)
    bins = max(BLOCK * (len(edges) - 1) // count, 1)
    rows = [np.array([0, count - 1])]
    for first in range(0, len(edges) - 1, bins):
        rows += _extremes(values, edges[first : first + bins + 1])
    window = min(
        WINDOW, WHOLE * float(np.median(np.diff(time))) / max(2 * len(instants), 1)
    )
    for instant in instants:
        near = rows_between(time, instant - window, instant + window)
        rows.append(np.arange(near.start, near.stop))
    return np.unique(np.concatenate(rows)).astype(np.int64)


def _extremes(values: Floats, edges: Rows) -> list[Rows]:
    """Find the rows of the least and greatest value, and of the first nan, of each bin
    from one edge to the next.
    """
    begins, sizes = edges[:-1], np.diff(edges)
    width = int(sizes.max())
    padded = np.minimum(begins[:, None] + np.arange(width), len(values) - 1)
    inside = np.arange(width) < sizes[:, None]
    block = values[padded]
    holes = np.isnan(block)
    low = np.where(inside & ~holes, block, np.inf).argmin(axis=1)
    high = np.where(inside & ~holes, block, -np.inf).argmax(axis=1)
    hole = np.where((inside & holes).any(axis=1), (inside & holes).argmax(axis=1), low)
    return [begins + low, begins + high, begins + hole]


def thin_path(x: Floats, points: int = 2 * POINTS) -> Rows:
    """Choose the rows of a path x (n, 2), m, after each of which it has gone on by a
    step that suits its length.
    """
    if len(x) < 3:
        return np.arange(len(x))
    gone = np.concatenate(
        [[0.0], np.cumsum(np.nan_to_num(np.hypot(*np.diff(x, axis=0).T)))]
    )
    step = max(STEP, float(gone[-1]) / points)
    kept = np.flatnonzero(np.diff(np.floor(gone / step), prepend=-1.0) > 0)
    return np.unique(np.append(kept, len(x) - 1)).astype(np.int64)
