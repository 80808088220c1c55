"""The equations from closures and Lagrangian: against independent engines, against the
paper's print, and at the locus.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import oracle
import oracle_three_rrr
import pytest
import yaml
from scipy.optimize import brentq

from dextar_control.contract.resources import config_file
from dextar_control.contract.robot import RobotParameters, flatten, load_robot
from dextar_control.mechanisms import mechanism_named
from dextar_control.model.equations import equations
from dextar_control.model.model import Model, check_geometry, equations_of
from dextar_control.symbols.types import Array

# two exact formulations in float64; the oracles solve systems of 4 to 15 unknowns
RELATIVE = 1e-9
RESIDUAL = 1e-8  # N, at an exactly singular state
PLACES = {
    "five_bar": ([-0.1, -0.16], [0.1, 0.16]),
    "three_rrr": ([-0.04, -0.04, -0.08], [0.04, 0.04, 0.08]),
}


def three_rrr_values(**changes: Any) -> dict[str, Any]:
    """The numbers of ``config/three_rrr.yaml`` by dotted names, with changes."""
    nested = yaml.safe_load(config_file("three_rrr.yaml").read_text(encoding="utf-8"))[
        "/**"
    ]["ros__parameters"]["robot"]
    flat: dict[str, Any] = {}
    for key, value in nested.items():
        flat |= (
            {f"{key}.{inner}": number for inner, number in value.items()}
            if isinstance(value, dict)
            else {key: value}
        )
    return flat | changes


UNEVEN = {
    "leg1.proximal_length": 0.115,
    "leg2.distal_length": 0.125,
    "leg3.distal_mass": 0.11,
    "leg1.proximal_center": 0.4,
    "leg2.distal_center": 0.45,
    "gravity": [0.7, -9.81],
}


@pytest.fixture(params=["dextar", "uneven five-bar", "3-RRR", "uneven 3-RRR"])
def case(
    request: pytest.FixtureRequest, robot: RobotParameters, uneven: RobotParameters
) -> tuple[Model, Any]:
    """A robot's model and the engine that knows nothing of it."""
    if "RRR" in request.param:
        values = three_rrr_values(**(UNEVEN if "uneven" in request.param else {}))
        return Model(mechanism_named("three_rrr"), values), oracle_three_rrr.Oracle(
            values
        )
    description = uneven if "uneven" in request.param else robot
    return Model(mechanism_named("five_bar"), flatten(description)), oracle.Oracle(
        description
    )


def states(
    model: Model, count: int, seed: int, least_s: float
) -> list[tuple[Array, Array, Array, Array]]:
    """Random (q_a, x, x_dot, x_ddot) with |s| > least_s and clear of Type 1."""
    generator, found = np.random.default_rng(seed), []
    low, high = PLACES[model.mechanism.name]
    igm = model.library.fast("inverse_geometric_model")
    while len(found) < count:
        x = generator.uniform(low, high)
        (q_a,) = igm(model.p, x)
        state = model.state(q_a, x, np.zeros(model.n))
        if np.isfinite(q_a).all() and state.type1 > 0.2 and abs(state.s) > least_s:
            found.append(
                (
                    q_a,
                    x,
                    generator.normal(0, 0.5, model.n),
                    generator.normal(0, 10.0, model.n),
                )
            )
    return found


def singular_states(model: Model, count: int, seed: int) -> list[tuple[Array, Array]]:
    """(q_a, x) on the Type 2 locus: between two places on either side of it."""
    generator, found = np.random.default_rng(seed), []
    low, high = PLACES[model.mechanism.name]
    igm = model.library.fast("inverse_geometric_model")

    def s(place: Array) -> float:
        (q_a,) = igm(model.p, place)
        return float(model.state(q_a, place, np.zeros(model.n)).s[0])

    while len(found) < count:
        first, second = generator.uniform(low, high), generator.uniform(low, high)
        along = first + np.linspace(0.0, 1.0, 30)[:, None] * (second - first)
        values = np.array([s(place) for place in along])
        turns = np.flatnonzero(values[1:] * values[:-1] < 0.0)
        if not np.isfinite(values).all() or not len(turns):
            continue
        begin, end = along[turns[0]], along[turns[0] + 1]
        if not np.isfinite([s(place) for place in np.linspace(begin, end, 50)]).all():
            continue
        share = brentq(
            lambda t, a=begin, b=end: s(a + t * (b - a)),
            0.0,
            1.0,
            xtol=1e-16,
            rtol=1e-15,
        )
        x = begin + share * (end - begin)
        (q_a,) = igm(model.p, x)
        if model.state(q_a, x, np.zeros(model.n)).type1 > 0.2:
            found.append((q_a, x))
    return found


def test_inverse_and_forward_dynamics_agree_with_another_engine(
    case: tuple[Model, Any],
) -> None:
    model, engine = case
    for q_a, x, x_dot, x_ddot in states(model, 100, 1, 0.15):
        expected = engine.inverse(q_a, x, x_dot, x_ddot)
        tau = model.wrenches(q_a, x, x_dot, x_ddot).tau
        np.testing.assert_allclose(
            tau, expected, rtol=RELATIVE, atol=RELATIVE * np.abs(expected).max()
        )
        acceleration = engine.forward(q_a, x, x_dot, tau)
        ours = model.platform_dynamics(q_a, x, x_dot, tau).x_ddot
        np.testing.assert_allclose(
            ours,
            acceleration,
            rtol=RELATIVE,
            atol=RELATIVE * np.abs(acceleration).max(),
        )


def test_any_torque_meets_the_criterion_at_a_singular_state(
    case: tuple[Model, Any],
) -> None:
    model, engine = case
    generator = np.random.default_rng(2)
    for q_a, x in singular_states(model, 100, 3):
        x_dot, tau = (
            generator.normal(0, 0.3, model.n),
            generator.uniform(-0.3, 0.3, model.n),
        )
        acceleration = engine.forward(q_a, x, x_dot, tau)
        assert abs(model.wrenches(q_a, x, x_dot, acceleration).criterion) <= RESIDUAL
        np.testing.assert_allclose(
            model.platform_dynamics(q_a, x, x_dot, tau).x_ddot,
            acceleration,
            rtol=1e-7,
            atol=1e-7 * np.abs(acceleration).max(),
        )


def _replaced(
    model: Model, name: str, change: Callable[[Any], ca.SX]
) -> Callable[..., Array]:
    """A function of (q_a, x, x_dot, x_ddot) for another statement of an equation."""
    e = equations(model.mechanism)
    function = ca.Function(name, [e.p, e.q_a, e.x, e.x_dot, e.x_ddot], [change(e)])
    return lambda *state: np.array(function(model.p, *state)).ravel()


def test_the_papers_eq_10_without_cross_terms_is_false_at_singular_states(
    robot: RobotParameters,
) -> None:
    model, engine = (
        Model(mechanism_named("five_bar"), flatten(robot)),
        oracle.Oracle(robot),
    )
    printed = _replaced(
        model, "printed", lambda e: ca.dot(e.singular.v_weak, e.M_x @ e.x_ddot + e.c_x)
    )
    worst = 0.0
    for q_a, x in singular_states(model, 20, 5):
        x_dot = np.array([0.5, -0.4])
        acceleration = engine.forward(q_a, x, x_dot, np.array([0.2, -0.1]))
        assert abs(model.wrenches(q_a, x, x_dot, acceleration).criterion) <= RESIDUAL
        worst = max(worst, abs(printed(q_a, x, x_dot, acceleration)[0]))
    assert worst > 0.1


def test_the_papers_eq_14_without_the_mass_on_the_drift_gives_another_torque(
    robot: RobotParameters,
) -> None:
    model, engine = (
        Model(mechanism_named("five_bar"), flatten(robot)),
        oracle.Oracle(robot),
    )

    def torque(h: Callable[[Any], ca.SX]) -> Callable[..., Array]:
        return _replaced(
            model, "torque", lambda e: ca.solve(e.J_inv.T, e.M @ e.x_ddot + h(e))
        )

    ours = torque(lambda e: e.h)
    printed = torque(
        lambda e: e.J_inv.T @ (e.c_a + e.drift) + e.M_ax.T @ e.drift + e.c_x
    )
    worst = 0.0
    for state in states(model, 20, 6, 0.15):
        expected = engine.inverse(*state)
        np.testing.assert_allclose(
            ours(*state),
            expected,
            rtol=RELATIVE,
            atol=RELATIVE * np.abs(expected).max(),
        )
        worst = max(worst, np.abs(printed(*state) - expected).max())
    assert worst > 1.0


def test_the_papers_least_norm_torque_of_eq_9_is_not_the_limit_on_the_locus(
    robot: RobotParameters,
) -> None:
    """Along a motion whose w_d stays in the image of A_r^T, Eq. (4) has a limit; the
    pseudo-inverse drops its weak part.
    """
    model = Model(mechanism_named("five_bar"), flatten(robot))
    e = equations_of(model.mechanism)
    function = ca.Function(
        "weak", [e.p, e.q_a, e.x], [e.A_r, e.B, e.J_inv, e.singular.u_weak]
    )
    for q_a, x in singular_states(model, 10, 7):
        A_r, B, J_inv, u_weak = (np.array(part) for part in function(model.p, q_a, x))
        multipliers = (
            A_r @ np.array([[0.5], [0.2]]) + 3.0 * u_weak
        )  # of a consistent motion with w_b = 0: w_d = A_r^T lambda
        limit = -B.T @ multipliers
        least_norm = np.linalg.pinv(J_inv.T, rcond=1e-9) @ (J_inv.T @ limit)  # Eq. 9
        np.testing.assert_allclose(
            J_inv.T @ least_norm, A_r.T @ multipliers, atol=1e-12
        )  # both give the same wrench ...
        assert (
            np.abs(least_norm - limit).max() > 1e-3
        )  # ... and differ by the internal force along the distal links


def test_eq_8_eq_14_and_eq_4_are_one_statement(case: tuple[Model, Any]) -> None:
    model, _ = case
    e = equations_of(model.mechanism)
    function = ca.Function(
        "both",
        [e.p, e.q_a, e.x, e.x_dot, e.x_ddot],
        [
            e.force,
            e.M @ e.x_ddot + e.h,
            e.J_inv.T @ e.inverse_dynamics,
            e.A_r @ e.x_ddot + e.B @ e.q_a_ddot + e.b,
            e.A_r @ e.x_dot + e.B @ e.q_a_dot,
            e.A_r.T @ e.multipliers - e.w_d,
        ],
    )
    for state in states(model, 50, 8, 0.1):
        force, mass_form, of_torque, eq_11, eq_2, eq_1 = (
            np.array(value).ravel() for value in function(model.p, *state)
        )
        scale = np.abs(force).max()
        np.testing.assert_allclose(mass_form, force, atol=1e-12 * scale)
        np.testing.assert_allclose(of_torque, force, atol=1e-10 * scale)
        np.testing.assert_allclose(eq_11, 0.0, atol=1e-12)
        np.testing.assert_allclose(eq_2, 0.0, atol=1e-14)
        np.testing.assert_allclose(eq_1, 0.0, atol=1e-10 * scale)


def test_joint_rates_agree_with_finite_differences(case: tuple[Model, Any]) -> None:
    model, _ = case
    igm, step = model.library.fast("inverse_geometric_model"), 1e-4
    for _, x, x_dot, x_ddot in states(model, 30, 9, 0.1):
        x_dot, x_ddot = 0.1 * x_dot, 0.1 * x_ddot
        times = step * np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
        q = np.unwrap(
            np.array(
                [igm(model.p, x + x_dot * t + 0.5 * x_ddot * t**2)[0] for t in times]
            ),
            axis=0,
        )
        found = model.wrenches(q[2], x, x_dot, x_ddot)
        velocity = (q[0] - 8 * q[1] + 8 * q[3] - q[4]) / (12 * step)
        acceleration = (-q[0] + 16 * q[1] - 30 * q[2] + 16 * q[3] - q[4]) / (
            12 * step**2
        )
        np.testing.assert_allclose(
            model.state(q[2], x, x_dot).q_a_dot, velocity, rtol=1e-7, atol=1e-7
        )
        np.testing.assert_allclose(found.q_a_ddot, acceleration, rtol=1e-4, atol=1e-4)


def test_singular_vectors_rebuild_the_matrix_and_turn_with_it_through_the_locus(
    case: tuple[Model, Any],
) -> None:
    model, _ = case
    e = equations_of(model.mechanism)
    v = e.singular
    function = ca.Function(
        "svd",
        [e.p, e.q_a, e.x],
        [
            e.A_r,
            v.u_strong,
            v.sigma_strong,
            v.v_strong,
            v.u_weak,
            v.sigma_weak,
            v.v_weak,
        ],
    )
    for q_a, x, _, _ in states(model, 50, 10, 0.0):
        A_r, U, strong, V, u, weak, t = (
            np.array(part) for part in function(model.p, q_a, x)
        )
        np.testing.assert_allclose(
            U @ np.diag(strong.ravel()) @ V.T + weak * u @ t.T, A_r, atol=1e-15
        )
        ours = np.sort([*strong.ravel(), abs(weak.item())])[::-1]
        np.testing.assert_allclose(ours, np.linalg.svd(A_r)[1], rtol=1e-9, atol=1e-15)
        assert np.sign(weak.item()) == np.sign(np.linalg.det(A_r))
    for q_a, x in singular_states(model, 20, 11):
        before, after = (
            np.array(function(model.p, q_a, x + shift)[6]).ravel()
            for shift in (-1e-7, 1e-7)
        )
        np.testing.assert_allclose(before, after, atol=1e-3)
        A_r, t_s = (
            np.array(function(model.p, q_a, x)[0]),
            np.array(function(model.p, q_a, x)[6]),
        )
        np.testing.assert_allclose(A_r @ t_s, 0.0, atol=1e-14)


def test_geometric_models_satisfy_the_closures(case: tuple[Model, Any]) -> None:
    model, _ = case
    found = states(model, 200, 12, 0.05)
    check_geometry(model, np.array([x for _, x, _, _ in found]))
    if model.mechanism.name != "five_bar":
        return
    direct = model.library.fast("direct_geometric_model")
    for q_a, x, _, _ in found:
        sign = np.sign(model.state(q_a, x, np.zeros(2)).s[0])
        np.testing.assert_allclose(direct(model.p, q_a, sign)[0], x, atol=1e-14)


def test_friction_opposes_the_joints(robot: RobotParameters) -> None:
    rough = Model(
        mechanism_named("five_bar"),
        flatten(robot) | {"left.viscous_friction": 0.01, "left.coulomb_friction": 0.05},
    )
    (q_a, x, x_dot, x_ddot), *_ = states(rough, 1, 13, 0.2)
    rate = rough.state(q_a, x, x_dot).q_a_dot[0]
    found = rough.wrenches(q_a, x, x_dot, x_ddot)
    np.testing.assert_allclose(
        found.friction,
        [0.01 * rate + 0.05 * np.tanh(rate / robot.coulomb_speed), 0.0],
        atol=1e-15,
    )
    smooth = Model(mechanism_named("five_bar"), flatten(robot)).wrenches(
        q_a, x, x_dot, x_ddot
    )
    np.testing.assert_allclose(found.tau - smooth.tau, found.friction, atol=1e-14)


def test_friction_of_elbows_and_pin_takes_what_power_they_turn_against(
    robot: RobotParameters,
) -> None:
    torques = {
        "left.passive_coulomb_friction": 0.01,
        "right.passive_viscous_friction": 2e-3,
        "pin_coulomb_friction": 0.02,
    }
    rough, smooth = Model.of(robot.replace(**torques)), Model.of(robot)

    def joints(x: Array) -> Array:
        q_a = smooth.inverse_geometric_model(x)
        return np.array(
            smooth.mechanism.tree_joints(
                ca.DM(q_a), ca.DM(x), smooth.mechanism.named(ca.DM(smooth.p))
            )
        ).ravel()

    for q_a, x, x_dot, x_ddot in states(rough, 20, 15, 0.2):
        rates = (joints(x + 1e-6 * x_dot) - joints(x - 1e-6 * x_dot)) / 2e-6
        pin, speed = rates[2] + rates[3] - rates[0] - rates[1], robot.coulomb_speed
        lost = (
            0.01 * rates[1] * np.tanh(rates[1] / speed)
            + 2e-3 * rates[3] ** 2
            + 0.02 * pin * np.tanh(pin / speed)
        )
        found, free = (
            rough.wrenches(q_a, x, x_dot, x_ddot),
            smooth.wrenches(q_a, x, x_dot, x_ddot),
        )
        q_a_dot = smooth.state(q_a, x, x_dot).q_a_dot
        assert (found.tau - free.tau) @ q_a_dot == pytest.approx(
            lost, rel=1e-6, abs=1e-9
        )


def test_the_mock_ups_wrenches_are_the_published_lumped_ones() -> None:
    model = Model(
        mechanism_named("five_bar"), flatten(load_robot(config_file("mockup.yaml")))
    )
    x, x_dot, x_ddot = (
        np.array([0.01, 0.12]),
        np.array([0.2, 0.1]),
        np.array([3.0, -2.0]),
    )
    found = model.wrenches(model.inverse_geometric_model(x), x, x_dot, x_ddot)
    np.testing.assert_allclose(found.w_b, 0.002 * found.q_a_ddot, rtol=1e-12)
    np.testing.assert_allclose(found.w_d, 0.5 * x_ddot, rtol=1e-12)
