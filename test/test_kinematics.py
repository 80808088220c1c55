"""Inverse and direct models in every working and assembly mode, and on the locus."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dextar_control.contract.errors import GeometryError
from dextar_control.contract.resources import ROBOT_FILE, config_file
from dextar_control.contract.robot import RobotParameters, load_robot
from dextar_control.core.kinematics import (
    direct_geometric_model,
    direct_model,
    inverse_model,
    kinematics,
    singular_vectors,
    singularity,
    state_of_platform,
    type1_distance,
)
from dextar_control.core.model import make_model

ROBOT = load_robot(config_file(ROBOT_FILE))
MODES = [(left, right) for left in (-1, 1) for right in (-1, 1)]
CLOSURE = 1e-12  # m
POSITION = 1e-9  # m, well away from the locus

coordinate = st.floats(-0.17, 0.17)
angle = st.floats(-math.pi, math.pi)


@pytest.mark.parametrize("working_mode", MODES)
@given(x=coordinate, y=coordinate)
@settings(max_examples=60, deadline=None)
def test_direct_undoes_inverse_in_every_mode(working_mode: tuple[int, int], x: float, y: float) -> None:
    robot = ROBOT.replace(working_mode=working_mode, **{"left.distal_length": 0.095, "right.proximal_length": 0.087})
    model = make_model(robot)
    point = np.array([x, y])
    kin = state_of_platform(model, point, np.zeros(2))
    assume(np.isfinite(kin.q_a).all() and type1_distance(model, kin) > 0.01)
    s = singularity(model, kin.A_r)
    for i, base in enumerate(model.base):
        elbow = base + model.l1[i] * np.array([np.cos(kin.q_a[i]), np.sin(kin.q_a[i])])
        assert abs(np.hypot(*(point - elbow)) - model.l2[i]) < CLOSURE
        line, arm = point - base, elbow - base
        assert np.sign(line[0] * arm[1] - line[1] * arm[0]) == working_mode[i]
    assume(abs(s) > 0.1)
    np.testing.assert_allclose(direct_model(model, kin.q_a, int(np.sign(s))), point, atol=POSITION)
    other = direct_model(model, kin.q_a, -int(np.sign(s)))
    assert singularity(model, kinematics(model, kin.q_a, other, np.zeros(2)).A_r) == pytest.approx(-s, abs=1e-9)


@given(q1=angle, q2=angle, mode=st.sampled_from([-1.0, 1.0]))
@settings(max_examples=200, deadline=None)
def test_the_clamped_direct_model_is_always_real(q1: float, q2: float, mode: float) -> None:
    x = direct_geometric_model(make_model(ROBOT), np.array([q1, q2]), mode)
    assert np.isfinite(x).all()


def test_noise_on_the_locus_neither_leaves_the_reals_nor_flips_the_branch() -> None:
    """A stretched posture exactly on the locus, joints disturbed by an encoder count of 2^13."""
    model = make_model(ROBOT)
    right = math.pi - math.acos((ROBOT.base_distance - 0.18) / 0.18)
    q_a = np.array([math.pi - right, right])
    on_locus = direct_geometric_model(model, q_a, 1.0)
    generator = np.random.default_rng(0)
    for mode in (1.0, -1.0):
        for _ in range(200):
            noisy = q_a + generator.uniform(-1, 1, 2) * math.pi / 2**13
            x = direct_geometric_model(model, noisy, mode)
            assert np.hypot(*(x - on_locus)) < 0.01
            assert mode * singularity(model, kinematics(model, noisy, x, np.zeros(2)).A_r) > -1e-12


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4))
@settings(max_examples=200, deadline=None)
def test_singular_vectors_rebuild_any_matrix(entries: list[float]) -> None:
    A = np.array(entries).reshape(2, 2)
    assume(np.abs(A).max() > 1e-3)
    ours = singular_vectors(A, np.array([1.0, 0.3]))
    rebuilt = ours.sigma1 * np.outer(ours.u1, ours.v1) + ours.sigma2 * np.outer(ours.u2, ours.v2)
    np.testing.assert_allclose(rebuilt, A, atol=1e-12)
    np.testing.assert_allclose([ours.sigma1, abs(ours.sigma2)], np.linalg.svd(A, compute_uv=False), atol=1e-12)
    assert ours.v2 @ np.array([1.0, 0.3]) >= 0.0


def test_what_cannot_be_is_refused_with_the_distance(robot: RobotParameters) -> None:
    model = make_model(robot)
    with pytest.raises(GeometryError, match="0.2026 m from the left motor axis; the leg reaches 0.0000 to 0.1800 m"):
        inverse_model(model, np.array([0.13, 0.073]))
    with pytest.raises(GeometryError, match="the elbows are 0.298000 m apart; the distal links close 0.000000 to 0.180000"):
        direct_model(model, np.array([math.pi, 0.0]), 1)
