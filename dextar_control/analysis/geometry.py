"""What the figure and the metrics need of the robot's shape, from positions alone."""

from __future__ import annotations

import numpy as np

from dextar_control.analysis.run import Floats
from dextar_control.contract.robot import RobotParameters


def elbows(robot: RobotParameters, q_a: Floats) -> Floats:
    """Elbow positions (..., 2 legs, 2 coordinates), m, of active joints (..., 2), rad."""
    half = 0.5 * robot.base_distance
    lengths = np.array([leg.proximal_length for leg in robot.legs])
    x = np.array([-half, half]) + lengths * np.cos(q_a)
    return np.stack([x, lengths * np.sin(q_a)], axis=-1)


def singularity_measure(robot: RobotParameters, x: Floats, q_a: Floats) -> Floats:
    """s (...,): sine of the angle from the left to the right distal link, of x (..., 2) and q_a (..., 2)."""
    r = x[..., None, :] - elbows(robot, q_a)
    area = robot.left.distal_length * robot.right.distal_length
    return (r[..., 0, 0] * r[..., 1, 1] - r[..., 0, 1] * r[..., 1, 0]) / area


def active_joints(robot: RobotParameters, x: Floats) -> Floats:
    """Active joints (..., 2), rad, of x (..., 2), m, in the robot's working mode; nan out of reach."""
    angles = []
    for side, leg, axis in zip(robot.working_mode, robot.legs, (-0.5, 0.5), strict=True):
        dx, dy = x[..., 0] - axis * robot.base_distance, x[..., 1]
        distance = np.hypot(dx, dy)
        with np.errstate(invalid="ignore", divide="ignore"):
            cosine = (distance**2 + leg.proximal_length**2 - leg.distal_length**2) / (
                2.0 * leg.proximal_length * distance
            )
            angles.append(np.arctan2(dy, dx) + side * np.arccos(cosine))
    return np.stack(angles, axis=-1)
