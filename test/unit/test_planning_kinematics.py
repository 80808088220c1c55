"""Inverse and direct models in every working and assembly mode, and on the locus."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dextar_control.contract.errors import GeometryError
from dextar_control.contract.resources import ROBOT_FILE, config_file
from dextar_control.contract.robot import RobotParameters, load_robot
from dextar_control.mechanisms import mechanism_named
from dextar_control.model.model import Model
from dextar_control.symbols.singular import blocks, singular_vectors

ROBOT = load_robot(config_file(ROBOT_FILE))
MODES = [(left, right) for left in (-1, 1) for right in (-1, 1)]
CLOSURE = 1e-12  # m
POSITION = 1e-9  # m, well away from the locus
NOWHERE = np.zeros(2)

coordinate = st.floats(-0.17, 0.17)
angle = st.floats(-math.pi, math.pi)


def s_of(model: Model, q_a: np.ndarray, x: np.ndarray) -> float:
    """s of a closed configuration."""
    return float(model.state(q_a, x, np.zeros(2)).s[0])


@pytest.mark.parametrize("working_mode", MODES)
@given(x=coordinate, y=coordinate)
@settings(max_examples=60, deadline=None)
def test_direct_undoes_inverse_in_every_mode(
    working_mode: tuple[int, int], x: float, y: float
) -> None:
    robot = ROBOT.replace(
        working_mode=working_mode,
        **{"left.distal_length": 0.095, "right.proximal_length": 0.087},
    )
    model, point = Model.of(robot), np.array([x, y])
    place = model.place(point)
    assume(np.isfinite(place.q_a).all() and place.type1[0] > 0.01)
    q_a, s = place.q_a, float(place.s[0])
    for i, leg in enumerate(robot.legs):
        base = np.array([(i - 0.5) * robot.base_distance, 0.0])
        elbow = base + leg.proximal_length * np.array([np.cos(q_a[i]), np.sin(q_a[i])])
        assert abs(np.hypot(*(point - elbow)) - leg.distal_length) < CLOSURE
        line, arm = point - base, elbow - base
        assert np.sign(line[0] * arm[1] - line[1] * arm[0]) == working_mode[i]
    sines = np.array(
        model.mechanism.type1_sines(q_a, point, model.mechanism.named(model.p))
    ).ravel()
    assert tuple(model.mechanism.modes(sines)) == working_mode
    assume(abs(s) > 0.1)
    np.testing.assert_allclose(model.close(q_a, int(np.sign(s))), point, atol=POSITION)
    assert s_of(model, q_a, model.close(q_a, -int(np.sign(s)))) == pytest.approx(
        -s, abs=1e-9
    )


@given(x=st.floats(-0.5, 0.5), y=st.floats(-0.5, 0.5))
@settings(max_examples=200, deadline=None)
def test_the_nearest_joints_are_the_inverse_models_where_a_leg_reaches_and_finite_elsewhere(
    x: float, y: float
) -> None:
    mechanism, point = mechanism_named("five_bar"), ca.SX.sym("x", 2)
    model = Model.of(ROBOT)
    q_a, extension = mechanism.nearest_joints(point, mechanism.named(ca.SX(model.p)))
    found = ca.Function("nearest", [point], [q_a, extension, ca.jacobian(q_a, point)])(
        np.array([x, y])
    )
    nearest, reach, slopes = (np.array(part) for part in found)
    assert np.isfinite(nearest).all()
    assert np.isfinite(slopes).all()
    expected = model.place(np.array([x, y])).q_a
    assume((np.abs(np.abs(reach) - 1.0) > 1e-6).all())
    np.testing.assert_array_equal(np.isfinite(expected), np.abs(reach).ravel() < 1.0)
    good = np.isfinite(expected) & (np.abs(reach).ravel() < 0.999)
    np.testing.assert_allclose(nearest.ravel()[good], expected[good], atol=1e-12)


@given(q1=angle, q2=angle, mode=st.sampled_from([-1.0, 1.0]))
@settings(max_examples=200, deadline=None)
def test_the_clamped_direct_model_is_always_real(
    q1: float, q2: float, mode: float
) -> None:
    x = Model.of(ROBOT).direct_geometric_model(np.array([q1, q2]), mode, NOWHERE)
    assert np.isfinite(x).all()


def test_noise_on_the_locus_neither_leaves_the_reals_nor_flips_the_branch() -> None:
    """A stretched posture exactly on the locus, joints disturbed by an encoder count of
    2^13.
    """
    model = Model.of(ROBOT)
    right = math.pi - math.acos((ROBOT.base_distance - 0.18) / 0.18)
    q_a = np.array([math.pi - right, right])
    on_locus = model.direct_geometric_model(q_a, 1.0, NOWHERE)
    generator = np.random.default_rng(0)
    for mode in (1.0, -1.0):
        for _ in range(200):
            noisy = q_a + generator.uniform(-1, 1, 2) * math.pi / 2**13
            x = model.direct_geometric_model(noisy, mode, NOWHERE)
            assert np.hypot(*(x - on_locus)) < 0.01
            assert mode * s_of(model, noisy, x) > -1e-12


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4))
@settings(max_examples=200, deadline=None)
def test_singular_vectors_rebuild_any_matrix(entries: list[float]) -> None:
    A = np.array(entries).reshape(2, 2)
    assume(np.abs(A).max() > 1e-3)
    symbol = ca.SX.sym("A", 2, 2)
    found = ca.Function("vectors", [symbol], [*singular_vectors(symbol)])(A)
    u1, sigma1, v1, u2, sigma2, v2 = (np.array(part).ravel() for part in found)
    np.testing.assert_allclose(
        sigma1 * np.outer(u1, v1) + sigma2 * np.outer(u2, v2), A, atol=1e-12
    )
    np.testing.assert_allclose(
        [sigma1[0], abs(sigma2[0])], np.linalg.svd(A, compute_uv=False), atol=1e-12
    )
    assert (
        v2 @ np.array([-A[0, 1], A[0, 0]]) >= -1e-15
    )  # t_s turned by +90 degrees from r_1


def test_singular_vectors_of_blocks_of_any_size_rebuild_the_matrix() -> None:
    pattern = np.array([[1, 1, 1, 0], [0, 0, 0, 1], [1, 1, 1, 0], [1, 0, 1, 0]])
    A = pattern * np.random.default_rng(0).normal(size=(4, 4))
    symbol = ca.SX.sym("A", ca.sparsify(ca.DM(pattern)).sparsity())
    assert blocks(symbol) == [([0, 2, 3], [0, 1, 2]), ([1], [3])]
    found = ca.Function(
        "vectors", [symbol], [ca.densify(part) for part in singular_vectors(symbol)]
    )(A)
    u, sigma, v, u_weak, sigma_weak, v_weak = (np.array(part) for part in found)
    np.testing.assert_allclose(
        u * sigma.T @ v.T + u_weak * sigma_weak.T @ v_weak.T, A, atol=1e-12
    )
    np.testing.assert_allclose(
        sorted(np.abs([*sigma.ravel(), *sigma_weak.ravel()])),
        sorted(np.linalg.svd(A, compute_uv=False)),
        atol=1e-12,
    )


def test_what_cannot_be_is_refused_with_the_distance(robot: RobotParameters) -> None:
    model = Model.of(robot)
    with pytest.raises(
        GeometryError,
        match="0.2026 m from the left motor axis; the leg reaches 0.0000 to 0.1800 m",
    ):
        model.inverse_geometric_model(np.array([0.13, 0.073]))
    with pytest.raises(
        GeometryError,
        match=(
            "the elbows are 0.298000 m apart; the distal links close 0.000000 to"
            " 0.180000"
        ),
    ):
        model.close(np.array([math.pi, 0.0]), 1)
