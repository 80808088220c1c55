"""A compliant transmission that the robot's file has: the observer's twist against the
plant's, and trips with it.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.settings import default_settings
from dextar_control.estimation.observing import ObserverEstimator
from dextar_control.estimation.transmission import transmission_over
from dextar_control.experiments.campaign.design import CrossingPoint, Trial
from dextar_control.experiments.campaign.trial import run_trial, sample_points
from dextar_control.model.model import Model
from dextar_sim.cartesian import CartesianPlant
from dextar_sim.rig import Rig

INERTIA, STIFFNESS, DAMPING = 2e-4, 80.0, 0.02  # kg m^2, N m/rad, N m s/rad
PERIOD = 1e-3  # s
SUBSTEPS = 64  # of the plant, whose springs swing too fast by a fraction (w h)^2 / 24
AT = np.array([-0.025, 0.115])
TORQUES = 0.05, 3.0  # N m, and periods that the first holds
HELD = (
    (1, 0.02),
    (4, 0.005),
    # steps in a period over which an acceleration is held, and error of the largest
    # twist
    # then
)
# m; without the file's stiffness a belt of 50 N m/rad leaves 0.3 mm and false bounces
SMALL = 0.15e-3


def soft(
    robot: RobotParameters, stiffness: float, damping: float = DAMPING
) -> RobotParameters:
    return robot.replace(
        **{
            f"{side}.transmission_{name}": value
            for side in robot.sides
            for name, value in (("stiffness", stiffness), ("damping", damping))
        }
    )


def over(stiffness: float, *state: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(twist and rate after a sample, torque held back from joints at rest, what an
    acceleration takes off it).
    """
    numbers = ca.SX(INERTIA), ca.SX(stiffness), ca.SX(DAMPING)
    twist, rate, tau, q_a_ddot = (ca.SX(value) for value in state)
    transmission = transmission_over(numbers, ca.SX(PERIOD))
    assert transmission is not None
    after, (held_back, rotors) = (
        transmission.after(twist, rate, tau, q_a_ddot),
        transmission.held_back(twist, rate, tau),
    )
    return tuple(
        np.array(ca.DM(ca.vertcat(*values))).ravel()
        for values in (after, [held_back], [rotors])
    )  # type: ignore[return-value]


def test_a_twist_swings_as_its_equation_says_and_the_rotor_keeps_its_momentum() -> None:
    state, tau, q_a_ddot = np.array([1e-3, -0.4]), 0.07, 30.0
    found, held_back, rotors = over(STIFFNESS, *state, tau, q_a_ddot)
    matrix = np.zeros((3, 3))  # of (twist, rate, drive)
    matrix[0, 1], matrix[1] = 1.0, (-STIFFNESS / INERTIA, -DAMPING / INERTIA, 1.0)
    expected = (expm(matrix * PERIOD) @ [*state, tau / INERTIA - q_a_ddot])[:2]
    assert found == pytest.approx(expected, rel=1e-9)
    assert held_back - rotors * q_a_ddot == pytest.approx(
        INERTIA * (expected[1] - state[1]) / PERIOD, rel=1e-9
    )


def test_a_rigid_transmission_holds_nothing_back() -> None:
    for result in over(0.0, 0.0, 0.0, 0.07, 30.0):
        assert not result.any()


@pytest.mark.parametrize(("steps", "bound"), HELD)
def test_the_observer_predicts_the_twist_of_the_plant(
    robot: RobotParameters, steps: int, bound: float
) -> None:
    robot = soft(robot, STIFFNESS)
    plant = CartesianPlant(robot, substeps=SUBSTEPS)
    estimator = ObserverEstimator(
        Model.of(robot), default_settings(), robot.min_type1_distance
    )
    plant.reset(AT)
    observer = estimator.observer
    observer.begin(AT, 1e-3)
    largest = off = 0.0
    for k in range(40):
        tau = TORQUES[0] * np.array([np.cos(k // TORQUES[1]), -np.sin(k // TORQUES[1])])
        plant.step(tau)
        for _ in range(steps):
            observer.predict(observer.main, observer.noise, tau, PERIOD / steps)
        twist = np.array(plant.encoder_angles()) - plant.state().q_a
        largest = max(largest, *abs(twist))
        off = max(off, *abs(observer.main.twist - twist))
    assert largest > 5e-4
    assert off < bound * largest


@pytest.fixture(scope="module")
def place(robot: RobotParameters) -> CrossingPoint:
    return sample_points(robot, 4, 0, 0)[0]


def run(
    robot: RobotParameters, place: CrossingPoint, **perturbation: float
) -> dict[str, Any]:
    trial = Trial(
        index=0,
        point=place.point,
        working_mode=place.working_mode,
        family=place.family,
        direction=1,
        case="tried",
        perturbation={"encoder_resolution": 131072, **perturbation},
        law="consistent",
        estimator="observer",
        plant="cartesian",
        seed=1,
        duration=0.33,
        dwell=0.2,
        repeat=1,
        settings={},
    )
    return run_trial(robot, trial, Rig)


@pytest.mark.parametrize("belt", [30.0, 500.0])
def test_a_belt_of_the_robot_file_is_crossed_with_as_if_there_was_none(
    robot: RobotParameters, place: CrossingPoint, belt: float
) -> None:
    row = run(robot, place, belt=belt, belt_modelled=1.0)
    assert row["success"] and row["crossed"] == 2, row["reason"]
    assert row["max_error"] < SMALL


def test_a_bounce_behind_a_belt_of_the_robot_file_is_called_so(
    robot: RobotParameters, place: CrossingPoint
) -> None:
    row = run(robot, place, belt=50.0, belt_modelled=1.0, bounce=1.0)
    assert row["recognised"] and row["missed_bounces"] == 0 and not row["held_wrong"]


def test_backlash_is_not_called_a_bounce_and_a_bounce_with_backlash_is(
    robot: RobotParameters, place: CrossingPoint
) -> None:
    """The samples of a test count as the less the worse they fitted the model
    before.
    """
    row = run(robot, place, backlash=2e-3)
    assert row["success"] and row["crossed"] == 2, row["reason"]
    row = run(robot, place, backlash=2e-3, bounce=1.0)
    assert row["recognised"] and row["missed_bounces"] == 0 and not row["held_wrong"]
