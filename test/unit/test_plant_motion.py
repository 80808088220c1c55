"""The PyBullet plant against the tests' own mechanics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mechanics import absolute, energy, equations, integrate
from scipy.integrate import trapezoid

from dextar_control.contract.resources import config_file
from dextar_control.contract.robot import RobotParameters, load_robot
from dextar_sim.plant import Plant
from dextar_sim.state import PlantState

LOOP_GAP = 2.0e-6
"""m; what the loop constraint may leave open at 1 ms and 4 substeps."""
FREE_MOTION_ERROR = 0.02e-3
"""m after 0.4 s; first-order integration at 0.25 ms."""
ENERGY_DRIFT = 2.0e-3
"""Share of the kinetic energy over 3 s."""
FAST_SUBSTEPS = 20
"""Where weight drives the joints to 26 rad/s, others reaching 11: the drift of the
first-order integrator grows with speed and halves with the substep, from 6e-3 at 4
substeps over 3e-3 at 8 to 1.6e-3 at 16.
"""
FREE_TIME = 0.4
IMPULSE_ERROR = 1.0e-4
"""Relative; motion during the 0.1 ms of the blow."""
HOLD_ERROR = 1.0e-5
"""m after 0.1 s; finite differences leave 1e-9 N m, and the pose is unstable."""
FRICTION_ERROR = 5.0e-3
"""Relative; trapezoidal power over 1 ms against 0.25 ms substeps."""
DRIVEN_STEPS = 300

DEXTAR = load_robot(config_file("dextar.yaml"))
MOCKUP = load_robot(config_file("mockup.yaml"))
TILTED = DEXTAR.replace(gravity=(0.6, -0.8))
UNEQUAL = DEXTAR.replace(
    **{
        "left.proximal_length": 0.1,
        "right.proximal_length": 0.085,
        "left.distal_length": 0.11,
        "right.distal_length": 0.095,
        "left.proximal_center": 0.4,
        "right.distal_center": 0.62,
        "right.distal_mass": 0.12,
        "left.rotor_inertia": 3.0e-4,
    }
)
ROBOTS = {"dextar": DEXTAR, "tilted": TILTED, "unequal": UNEQUAL, "mockup": MOCKUP}
START = (0.02, 0.105)
START_VELOCITY = (-0.2, 0.1)
FAST_VELOCITY = (0.3, -0.2)
ENERGY_VELOCITY = (0.2, -0.15)


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest) -> RobotParameters:
    return ROBOTS[request.param]


def run_free(
    robot: RobotParameters,
    velocity: tuple[float, float],
    duration: float,
    substeps: int = 4,
) -> list[PlantState]:
    plant = Plant(robot, substeps=substeps)
    states = [plant.reset(START, velocity)]
    for _ in range(round(duration / plant.period)):
        plant.step((0.0, 0.0))
        states.append(plant.state())
    plant.close()
    return states


def test_free_motion_follows_the_exact_model(robot: RobotParameters) -> None:
    states = run_free(robot, START_VELOCITY, FREE_TIME)
    x, _ = integrate(robot, states[0], FREE_TIME)
    assert math.dist(states[-1].x, x) < FREE_MOTION_ERROR


def test_loop_stays_closed_in_free_motion(robot: RobotParameters) -> None:
    assert (
        max(state.loop_gap for state in run_free(robot, FAST_VELOCITY, 1.0)) < LOOP_GAP
    )


def test_energy_is_kept_over_three_seconds(robot: RobotParameters) -> None:
    states = run_free(
        robot, ENERGY_VELOCITY, 3.0, FAST_SUBSTEPS if robot is TILTED else 4
    )
    energies = [energy(robot, state) for state in states]
    weightless = robot.replace(gravity=(0.0, 0.0))
    kinetic = max(energy(weightless, state) for state in states)
    assert max(abs(value - energies[0]) for value in energies) < ENERGY_DRIFT * kinetic


def test_driven_motion_follows_the_exact_model_and_stays_closed(
    robot: RobotParameters,
) -> None:
    """Torques held over each period; to the exact model that is the same torque half a
    period later.
    """
    plant = Plant(robot)
    start = plant.reset((0.0, 0.105))

    def torque(time: float) -> tuple[float, float]:
        return 0.05 * math.sin(20.0 * time), -0.035 * math.cos(15.0 * time)

    gap = 0.0
    for step in range(DRIVEN_STEPS):
        plant.step(torque(step * plant.period))
        gap = max(gap, plant.state().loop_gap)
    x, _ = integrate(
        robot,
        start,
        DRIVEN_STEPS * plant.period,
        lambda time: torque(time - 0.5 * plant.period),
    )
    assert gap < LOOP_GAP
    assert math.dist(plant.state().x, x) < FREE_MOTION_ERROR
    plant.close()


def test_free_motion_error_halves_with_the_substep() -> None:
    exact, errors = None, []
    for substeps in (2, 4, 8):
        plant = Plant(DEXTAR, substeps=substeps)
        start = plant.reset(START, FAST_VELOCITY)
        if exact is None:
            exact, _ = integrate(DEXTAR, start, FREE_TIME)
        for _ in range(round(FREE_TIME / plant.period)):
            plant.step((0.0, 0.0))
        errors.append(math.dist(plant.state().x, exact))
        plant.close()
    assert errors[1] < 0.6 * errors[0]
    assert errors[2] < 0.6 * errors[1]


def test_impulse_at_rest_gives_the_velocity_of_the_exact_model() -> None:
    """M v + C^T impulses of the loop = impulse on the end effector, C v = 0."""
    impulse = np.array([0.01, -0.02])
    plant = Plant(DEXTAR, period=1.0e-4, substeps=1)
    start = plant.reset(START)
    plant.apply_impulse(impulse)
    plant.step((0.0, 0.0))
    state = plant.state()
    plant.close()
    system, blow = (
        equations(DEXTAR, absolute(start.joints), np.zeros(6))[0],
        np.zeros(10),
    )
    blow[4:6] = impulse
    exact = np.linalg.solve(system, blow)[:6]
    assert math.dist(state.x_dot, exact[4:]) < IMPULSE_ERROR * np.hypot(*exact[4:])
    assert math.dist(
        absolute(state.joints_dot), exact[:4]
    ) < IMPULSE_ERROR * np.linalg.norm(exact[:4])


def test_holding_torque_against_gravity_keeps_the_pose() -> None:
    """Torque by virtual work: the potential's slope along each motor angle, by finite
    differences.
    """
    robot = DEXTAR.replace(gravity=(0.0, -9.81))
    plant = Plant(robot)
    start = plant.reset(START)
    step, torque = 1.0e-5, []
    for joint in (0, 1):
        potentials = []
        for sign in (1.0, -1.0):
            q_a = start.q_a.copy()
            q_a[joint] += sign * step
            potentials.append(energy(robot, plant.reset_joints(q_a, 1)))
        torque.append((potentials[0] - potentials[1]) / (2.0 * step))
    plant.reset(START)
    for _ in range(100):
        plant.step(torque)
    assert max(np.abs(torque)) > 0.01
    assert math.dist(plant.state().x, START) < HOLD_ERROR
    plant.close()


def test_friction_takes_the_energy_its_law_says() -> None:
    """Loss = integral of q_dot (viscous q_dot + coulomb tanh(q_dot / coulomb_speed))
    over both motors.
    """
    robot = DEXTAR.replace(
        **{"left.viscous_friction": 1.0e-3, "right.coulomb_friction": 5.0e-3}
    )
    states = run_free(robot, FAST_VELOCITY, 0.2)
    rates = np.array([state.q_a_dot for state in states])
    power = 1.0e-3 * rates[:, 0] ** 2 + 5.0e-3 * rates[:, 1] * np.tanh(
        rates[:, 1] / robot.coulomb_speed
    )
    lost = energy(robot, states[0]) - energy(robot, states[-1])
    assert lost > 0.1 * energy(robot, states[0])
    assert lost == pytest.approx(float(trapezoid(power, dx=1.0e-3)), rel=FRICTION_ERROR)
