"""Mechanics written down for the tests: link bodies, a point mass, Lagrange
multipliers.

Coordinates: absolute angles of the four links and the end effector as a particle of its
own, tied to both tips by four constraints; integrated by scipy. Nothing of it is shared
with the plants: one has relative angles, half the end effector on each tip and
PyBullet, the other the end effector's position alone.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp

from dextar_control.contract.robot import RobotParameters
from dextar_sim.state import PlantState

ORACLE_TOLERANCE = 1.0e-10


def links(robot: RobotParameters) -> list[tuple[float, float, float, float]]:
    """Mass (kg), centre (m), inertia about it (kg m^2) with the rotor, length (m): left
    two, right two.
    """
    bodies = []
    for leg in robot.legs:
        bodies.append(
            (
                leg.proximal_mass,
                leg.proximal_center * leg.proximal_length,
                leg.proximal_inertia + leg.rotor_inertia,
                leg.proximal_length,
            )
        )
        bodies.append(
            (
                leg.distal_mass,
                leg.distal_center * leg.distal_length,
                leg.distal_inertia,
                leg.distal_length,
            )
        )
    return bodies


def absolute(joints: np.ndarray) -> np.ndarray:
    """Relative joint values q11, q12, q21, q22 to link values from the x axis, shape
    (4,).
    """
    return np.array(
        [joints[0], joints[0] + joints[1], joints[2], joints[2] + joints[3]]
    )


def point_jacobian(
    theta: np.ndarray, leg: int, arm_1: float, arm_2: float
) -> np.ndarray:
    """Velocity of elbow-arm plus distal-arm per coordinate rate, shape (2, 6)."""
    jacobian = np.zeros((2, 6))
    for index, arm in ((2 * leg, arm_1), (2 * leg + 1, arm_2)):
        jacobian[:, index] = arm * np.array(
            [-math.sin(theta[index]), math.cos(theta[index])]
        )
    return jacobian


def energy(robot: RobotParameters, state: PlantState) -> float:
    """Kinetic and potential energy, J, link by link."""
    bodies, theta, theta_dot = (
        links(robot),
        absolute(state.joints),
        absolute(state.joints_dot),
    )
    gravity = np.array(robot.gravity)
    total = 0.5 * robot.end_effector_mass * state.x_dot @ state.x_dot
    total -= robot.end_effector_mass * gravity @ state.x
    for index, (mass, center, inertia, _) in enumerate(bodies):
        leg, distal = divmod(index, 2)
        arms = (bodies[2 * leg][3], center) if distal else (center, 0.0)
        velocity = point_jacobian(theta, leg, *arms)[:, :4] @ theta_dot
        angles = theta[2 * leg : 2 * leg + 2]
        place = np.array(
            [
                arms[0] * math.cos(angles[0]) + arms[1] * math.cos(angles[1]),
                arms[0] * math.sin(angles[0]) + arms[1] * math.sin(angles[1]),
            ]
        )
        total += (
            0.5 * mass * velocity @ velocity
            + 0.5 * inertia * theta_dot[index] ** 2
            - mass * gravity @ place
        )
    return float(total)


def equations(
    robot: RobotParameters, theta: np.ndarray, speed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """[[M, C^T], [C, 0]], shape (10, 10), of the six coordinates and four multipliers,
    and its right side.
    """
    bodies, gravity = links(robot), np.array(robot.gravity)
    system, right = np.zeros((10, 10)), np.zeros(10)

    def towards(leg: int, arms: tuple[float, float]) -> np.ndarray:
        return sum(
            arm
            * speed[link] ** 2
            * np.array([math.cos(theta[link]), math.sin(theta[link])])
            for link, arm in zip((2 * leg, 2 * leg + 1), arms, strict=True)
        )

    for index, (mass, center, inertia, _) in enumerate(bodies):
        leg, distal = divmod(index, 2)
        arms = (bodies[2 * leg][3], center) if distal else (center, 0.0)
        jacobian = point_jacobian(theta, leg, *arms)
        system[:6, :6] += mass * jacobian.T @ jacobian
        system[index, index] += inertia
        right[:6] += jacobian.T @ (mass * (gravity + towards(leg, arms)))
    system[4:6, 4:6] += robot.end_effector_mass * np.eye(2)
    right[4:6] += robot.end_effector_mass * gravity
    for leg in (0, 1):
        lengths = bodies[2 * leg][3], bodies[2 * leg + 1][3]
        constraint = point_jacobian(theta, leg, *lengths)
        constraint[:, 4:] = -np.eye(2)
        rows = slice(6 + 2 * leg, 8 + 2 * leg)
        system[rows, :6], system[:6, rows] = constraint, constraint.T
        right[rows] = towards(leg, lengths)
    return system, right


def integrate(
    robot: RobotParameters,
    state: PlantState,
    duration: float,
    torque=lambda time: (0.0, 0.0),
):
    """End effector position (m) and velocity (m/s) after the duration, from the exact
    model.
    """

    def rate(time: float, coordinates: np.ndarray) -> np.ndarray:
        speed = coordinates[6:]
        system, right = equations(robot, coordinates[:4], speed)
        right[[0, 2]] += torque(time)
        return np.concatenate([speed, np.linalg.solve(system, right)[:6]])

    start = np.concatenate(
        [absolute(state.joints), state.x, absolute(state.joints_dot), state.x_dot]
    )
    end = solve_ivp(
        rate,
        (0.0, duration),
        start,
        method="DOP853",
        rtol=ORACLE_TOLERANCE,
        atol=ORACLE_TOLERANCE,
    )
    return end.y[4:6, -1], end.y[10:12, -1]
