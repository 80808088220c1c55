"""The model's kinematics over many points at once."""

from __future__ import annotations

import numpy as np

from dextar_control.analysis.run import Floats
from dextar_control.contract.robot import RobotParameters
from dextar_control.planning.model import states_model


def singularity_measure(robot: RobotParameters, x: Floats, q_a: Floats) -> Floats:
    """Compute s, the sine of the angle from the left to the right distal link.

    Args:
        robot: as described.
        x: (..., n) end effector, m.
        q_a: (..., n) active joints, rad.

    Returns:
        (...,) 1.
    """
    model = states_model(robot)
    found = model.library.batch("state")(
        model.p, q_a.reshape(-1, model.n), x.reshape(-1, model.n), np.zeros(model.n)
    )
    s: Floats = found.s.reshape(x.shape[:-1])
    return s


def active_joints(robot: RobotParameters, x: Floats) -> Floats:
    """Compute the active joints (..., n), rad, of an end effector x (..., n), m, in the
    robot's working mode; nan out of reach.
    """
    q_a: Floats = (
        states_model(robot).sides(x.reshape(-1, x.shape[-1])).q_a.reshape(x.shape)
    )
    return q_a
