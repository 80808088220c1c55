"""The model's kinematics over many points at once."""

from __future__ import annotations

import numpy as np

from dextar_control.analysis.run import Floats
from dextar_control.contract.robot import RobotParameters
from dextar_control.planning.model import states_model


def singularity_measure(robot: RobotParameters, x: Floats, q_a: Floats) -> Floats:
    """s (...,): sine of the angle from the left to the right distal link, of x (..., 2) and q_a (..., 2)."""
    model = states_model(robot)
    found = model.library.batch("state")(model.p, q_a.reshape(-1, 2), x.reshape(-1, 2), np.zeros(2))
    s: Floats = found.s.reshape(x.shape[:-1])
    return s


def active_joints(robot: RobotParameters, x: Floats) -> Floats:
    """Active joints (..., 2), rad, of x (..., 2), m, in the robot's working mode; nan out of reach."""
    q_a: Floats = states_model(robot).sides(x.reshape(-1, 2)).q_a.reshape(x.shape)
    return q_a
