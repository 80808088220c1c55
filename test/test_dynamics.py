"""The model against pinocchio, finite differences and the physics of the locus."""

from __future__ import annotations

import numpy as np
import pytest
from oracle import Oracle

from dextar_control.contract.resources import config_file
from dextar_control.contract.robot import RobotParameters, load_robot
from dextar_control.core.dynamics import (
    criterion,
    criterion_acceleration,
    forward_dynamics,
    inverse_dynamics,
    inverse_dynamics_minimum_norm,
    joint_acceleration,
    wrenches,
)
from dextar_control.core.kinematics import (
    inverse_geometric_model,
    kinematics,
    singular_values,
    singularity,
    state_of_platform,
    type1_distance,
)
from dextar_control.core.model import make_model

RELATIVE = 1e-9  # two exact formulations in float64; the oracle solves a 4 x 4 or 6 x 6 system
RESIDUAL = 1e-8  # N, at an exactly singular state


def _states(robot: RobotParameters, count: int, seed: int, least_s: float) -> list[tuple[np.ndarray, ...]]:
    """Random (x, x_dot, x_ddot) over the workspace with |s| > least_s and clear of Type 1."""
    generator, model, found = np.random.default_rng(seed), make_model(robot), []
    while len(found) < count:
        x = generator.uniform([-0.1, -0.16], [0.1, 0.16])
        kin = state_of_platform(model, x, np.zeros(2))
        if np.isfinite(kin.q_a).all() and type1_distance(model, kin) > 0.2 and abs(singularity(model, kin.A_r)) > least_s:
            found.append((x, generator.normal(0, 0.5, 2), generator.normal(0, 10.0, 2)))
    return found


def _circles(center: np.ndarray, radius: float, other: np.ndarray, other_radius: float, sign: float) -> np.ndarray | None:
    """An intersection of two circles."""
    d = np.hypot(*(other - center))
    along = (d**2 + radius**2 - other_radius**2) / (2 * d)
    if d == 0 or abs(along) >= radius:
        return None
    e = (other - center) / d
    return center + along * e + sign * np.sqrt(radius**2 - along**2) * np.array([-e[1], e[0]])


def singular_states(robot: RobotParameters, family: str, count: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Exactly singular (q_a, x): distal links in line, stretched or folded back on each other."""
    generator, found = np.random.default_rng(seed), []
    bases = np.array([[-0.5 * robot.base_distance, 0.0], [0.5 * robot.base_distance, 0.0]])
    left, right = robot.legs
    while len(found) < count:
        q1 = generator.uniform(-np.pi, np.pi)
        elbow = bases[0] + left.proximal_length * np.array([np.cos(q1), np.sin(q1)])
        sign = 1.0 if family == "stretched" else -1.0
        reach = left.distal_length + sign * right.distal_length
        if family == "folded" and abs(reach) < 1e-12:
            q1_elbow = _circles(bases[0], left.proximal_length, bases[1], right.proximal_length, generator.choice([-1, 1]))
            assert q1_elbow is not None
            elbow, other = q1_elbow, q1_elbow
            angle = generator.uniform(-np.pi, np.pi)
            x = elbow + left.distal_length * np.array([np.cos(angle), np.sin(angle)])
            q1 = np.arctan2(*(elbow - bases[0])[::-1])
        else:
            other_or_none = _circles(elbow, abs(reach), bases[1], right.proximal_length, generator.choice([-1, 1]))
            if other_or_none is None:
                continue
            other = other_or_none
            x = elbow + left.distal_length * (other - elbow) / reach
        q_a = np.array([q1, np.arctan2(*(other - bases[1])[::-1])])
        kin = kinematics(make_model(robot), q_a, x, np.zeros(2))
        if type1_distance(make_model(robot), kin) > 0.2:
            found.append((q_a, x))
    return found


@pytest.mark.parametrize("name", ["robot", "uneven"])
def test_inverse_and_forward_dynamics_agree_with_pinocchio(name: str, request: pytest.FixtureRequest) -> None:
    description = request.getfixturevalue(name)
    oracle, model = Oracle(description), make_model(description)
    for x, x_dot, x_ddot in _states(description, 200, 1, 0.15):
        kin = state_of_platform(model, x, x_dot)
        expected = oracle.inverse(kin.q_a, x, x_dot, x_ddot)
        tau = inverse_dynamics(model, kin, x_ddot)
        np.testing.assert_allclose(tau, expected, rtol=RELATIVE, atol=RELATIVE * np.abs(expected).max())
        minimum_norm = inverse_dynamics_minimum_norm(model, kin, x_ddot)
        np.testing.assert_allclose(minimum_norm, expected, rtol=RELATIVE, atol=RELATIVE * np.abs(expected).max())
        acceleration = oracle.forward(kin.q_a, x, x_dot, tau)
        np.testing.assert_allclose(
            forward_dynamics(model, kin, tau), acceleration, rtol=RELATIVE, atol=RELATIVE * np.abs(acceleration).max()
        )


@pytest.mark.parametrize("family", ["stretched", "folded"])
@pytest.mark.parametrize("name", ["robot", "uneven"])
def test_any_torque_meets_the_criterion_at_a_singular_state(
    name: str, family: str, request: pytest.FixtureRequest
) -> None:
    description = request.getfixturevalue(name)
    oracle, model = Oracle(description), make_model(description)
    generator = np.random.default_rng(2)
    for q_a, x in singular_states(description, family, 100, 3):
        x_dot, tau = generator.normal(0, 0.3, 2), generator.uniform(-0.3, 0.3, 2)
        kin = kinematics(model, q_a, x, x_dot)
        assert abs(singularity(model, kin.A_r)) < 1e-12
        acceleration = oracle.forward(q_a, x, x_dot, tau)
        assert abs(criterion(model, kin, acceleration)) <= RESIDUAL
        np.testing.assert_allclose(forward_dynamics(model, kin, tau), acceleration, rtol=1e-7, atol=1e-7)


def test_without_cross_terms_the_criterion_would_be_false(robot: RobotParameters) -> None:
    oracle, model = Oracle(robot), make_model(robot)
    truncated = model._replace(m_Px=np.zeros(2))
    worst = 0.0
    for q_a, x in singular_states(robot, "stretched", 20, 5):
        x_dot = np.array([0.5, -0.4])
        kin = kinematics(model, q_a, x, x_dot)
        worst = max(worst, abs(criterion(truncated, kin, oracle.forward(q_a, x, x_dot, np.array([0.2, -0.1])))))
    assert worst > 0.1


def test_the_criterions_acceleration_always_exists(uneven: RobotParameters) -> None:
    model = make_model(uneven)
    for family in ("stretched", "folded"):
        for q_a, x in singular_states(uneven, family, 30, 6):
            kin = kinematics(model, q_a, x, np.array([0.4, 0.7]))
            assert abs(criterion(model, kin, criterion_acceleration(model, kin, 3.0))) < 1e-12


def test_kinematics_agree_with_finite_differences(uneven: RobotParameters) -> None:
    model, step = make_model(uneven), 1e-4
    for x, x_dot, x_ddot in _states(uneven, 50, 7, 0.05):
        x_dot, x_ddot = 0.3 * x_dot, 0.3 * x_ddot

        def joints(time: float, x: np.ndarray = x, v: np.ndarray = x_dot, a: np.ndarray = x_ddot) -> np.ndarray:
            return inverse_geometric_model(model, x + v * time + 0.5 * a * time**2)

        kin = state_of_platform(model, x, x_dot)
        times = step * np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
        q = np.unwrap(np.array([joints(time) for time in times]), axis=0)
        velocity = (q[0] - 8 * q[1] + 8 * q[3] - q[4]) / (12 * step)
        acceleration = (-q[0] + 16 * q[1] - 30 * q[2] + 16 * q[3] - q[4]) / (12 * step**2)
        np.testing.assert_allclose(kin.q_a_dot, velocity, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(joint_acceleration(kin, x_ddot), acceleration, rtol=1e-4, atol=1e-4)


def test_singular_vectors_are_numpys_up_to_signs(robot: RobotParameters) -> None:
    model = make_model(robot)
    for x, _, _ in _states(robot, 50, 8, 0.0):
        A_r = state_of_platform(model, x, np.zeros(2)).A_r
        ours = singular_values(A_r)
        _, sigma, _ = np.linalg.svd(A_r)
        np.testing.assert_allclose([ours.sigma1, abs(ours.sigma2)], sigma, rtol=1e-12, atol=1e-15)
        rebuilt = ours.sigma1 * np.outer(ours.u1, ours.v1) + ours.sigma2 * np.outer(ours.u2, ours.v2)
        np.testing.assert_allclose(rebuilt, A_r, atol=1e-16)


def test_friction_and_gravity_enter_with_their_sign(robot: RobotParameters) -> None:
    held = robot.replace(gravity=(0.0, -9.81))
    model = make_model(held)
    kin = state_of_platform(model, np.array([0.0, 0.115]), np.zeros(2))
    np.testing.assert_allclose(
        inverse_dynamics(model, kin, np.zeros(2)),
        Oracle(held).inverse(kin.q_a, kin.x, np.zeros(2), np.zeros(2)),
        rtol=RELATIVE,
    )
    rough = robot.replace(**{"left.viscous_friction": 0.01, "left.coulomb_friction": 0.05})
    moving = state_of_platform(make_model(robot), np.array([0.01, 0.12]), np.array([0.2, 0.1]))
    extra = inverse_dynamics(make_model(rough), moving, np.zeros(2)) - inverse_dynamics(make_model(robot), moving, np.zeros(2))
    rate = moving.q_a_dot[0]
    np.testing.assert_allclose(extra, [0.01 * rate + 0.05 * np.tanh(rate / robot.coulomb_speed), 0.0], atol=1e-12)


def test_the_mock_ups_wrenches_are_the_published_lumped_ones() -> None:
    robot = load_robot(config_file("mockup.yaml"))
    model = make_model(robot)
    x_ddot = np.array([3.0, -2.0])
    kin = state_of_platform(model, np.array([0.01, 0.12]), np.array([0.2, 0.1]))
    w_b, w_d = wrenches(model, kin, x_ddot)
    np.testing.assert_allclose(w_b, 0.002 * joint_acceleration(kin, x_ddot), rtol=1e-12)
    np.testing.assert_allclose(w_d, 0.5 * x_ddot, rtol=1e-12)
