"""The core's kinematics over many points at once."""

from __future__ import annotations

import numpy as np

from dextar_control.analysis.run import Floats
from dextar_control.contract.robot import RobotParameters
from dextar_control.core.compiled import njit
from dextar_control.core.kinematics import elbows, inverse_geometric_model, singularity
from dextar_control.core.model import Model, make_model


@njit
def _measures(model: Model, x: Floats, q_a: Floats) -> Floats:
    s = np.empty(len(x))
    for k in range(len(x)):
        s[k] = singularity(model, x[k] - elbows(model, q_a[k]))
    return s


@njit
def _joints(model: Model, x: Floats) -> Floats:
    q_a = np.empty((len(x), 2))
    for k in range(len(x)):
        q_a[k] = inverse_geometric_model(model, x[k])
    return q_a


def singularity_measure(robot: RobotParameters, x: Floats, q_a: Floats) -> Floats:
    """s (...,): sine of the angle from the left to the right distal link, of x (..., 2) and q_a (..., 2)."""
    rows = np.ascontiguousarray(x).reshape(-1, 2), np.ascontiguousarray(q_a).reshape(-1, 2)
    return _measures(make_model(robot), *rows).reshape(x.shape[:-1])


def active_joints(robot: RobotParameters, x: Floats) -> Floats:
    """Active joints (..., 2), rad, of x (..., 2), m, in the robot's working mode; nan out of reach."""
    return _joints(make_model(robot), np.ascontiguousarray(x).reshape(-1, 2)).reshape(x.shape)
