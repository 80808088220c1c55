"""A polynomial through a given state at a crossing, whatever its criterion."""

from __future__ import annotations

import numpy as np

from dextar_control.model.robot import AnyRobot
from dextar_control.planning.model import planning_model
from dextar_control.planning.search import coefficients_over
from dextar_control.planning.trajectory import Trajectory


def crossing_polynomial(
    robot: AnyRobot,
    ends: tuple[np.ndarray, np.ndarray],
    x: np.ndarray,
    x_dot: np.ndarray,
    x_ddot: np.ndarray,
    before: float = 0.16,
    after: float = 0.17,
) -> Trajectory:
    """From rest at the first end in ``before``, s, to the state at the crossing, and in
    ``after`` to rest at the other.
    """
    spans = -before, after
    jerk = np.mean(
        [
            6.0 * (end - x - x_dot * span - 0.5 * x_ddot * span**2) / span**3
            for end, span in zip(ends, spans, strict=True)
        ],
        axis=0,
    )
    state, pieces = np.column_stack([x, x_dot, x_ddot, jerk]), []
    for end, span in zip(ends, spans, strict=True):
        rest = np.column_stack([end, np.zeros((len(x), 3))])
        (half,) = planning_model(robot).half(
            state.ravel("F"), rest.ravel("F"), span, 0.0
        )
        pieces.append(coefficients_over(half, span))
    return Trajectory(
        np.array([0.0, before, before + after]),
        np.array([before, before]),
        np.stack(pieces),
    )
