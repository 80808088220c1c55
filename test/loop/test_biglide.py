"""A mechanism with prismatic joints: its equations apart from the package's, and a
crossing in a plain loop.
"""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import biglide as biglide_module
import casadi as ca
import numpy as np
import pytest
from plain_loop import PlantOf, drive, exact_plant, pybullet_plant

from dextar_control.contract.errors import (
    GeometryError,
    ParameterError,
    TrajectoryError,
)
from dextar_control.control.phases import Phase
from dextar_control.control.verdicts import Verdict
from dextar_control.model.model import Model, check_geometry
from dextar_control.model.robot import Robot
from dextar_control.planning.certificate import PLAN_RESIDUAL
from dextar_control.planning.checks import beyond_range
from dextar_control.planning.locus import nearest_point
from dextar_control.planning.planner import (
    Plan,
    plan_approach,
    plan_return_trip_through,
)

LOW, HIGH = [-0.05, -0.1], [0.05, 0.1]  # m, places of the platform
STATES = 100
RELATIVE = 1e-9  # two exact formulations in float64
CRITERION = 1e-8  # N, t_s.w_d at a singular state under any forces
MAX_ERROR, MAX_ERROR_MASSES = (
    0.1e-3,
    1.0e-3,
)  # m, true, throughout: nominal, and with all masses a fifth off


@pytest.fixture(scope="module")
def biglide() -> Any:
    return biglide_module


@pytest.fixture(scope="module")
def uneven(biglide: Any) -> Robot:
    """Unequal legs, friction and gravity."""
    return biglide.ROBOT.replace(
        **{
            "left.bar_mass": 0.17,
            "right.slider_mass": 0.45,
            "left.viscous_friction": 0.8,
            "right.bar_length": 0.21,
            "gravity": [0.7, -9.81],
        }
    )


@pytest.fixture(scope="module")
def trip(biglide: Any) -> Plan:
    return plan_return_trip_through(
        biglide.ROBOT, nearest_point(biglide.ROBOT, np.array([0.0, 0.02])), 1, 0.3, 0.1
    )


def kkt(robot: Robot, x: np.ndarray, x_dot: np.ndarray) -> SimpleNamespace:
    """The robot in (q1, q2, x, y) with its two bars as constraints, by hand: the
    sliders go straight, so the mass is constant.

    ``forward(forces)`` gives the accelerations (4,).
    """
    p, mass = robot.numbers, np.zeros((4, 4))
    weight, friction, jacobian, drift, q, v = (
        np.zeros(4),
        np.zeros(4),
        np.zeros((2, 4)),
        np.zeros(2),
        np.zeros(4),
        np.zeros(4),
    )
    g = np.array(p["gravity"])
    q[2:], v[2:] = x, x_dot
    mass[2:, 2:] += p["point_mass"] * np.eye(2)
    weight[2:] += p["point_mass"] * g
    for leg, name in enumerate(("left", "right")):
        length, bar, slider = (
            p[f"{name}.{key}"] for key in ("bar_length", "bar_mass", "slider_mass")
        )
        d = np.array([np.cos(p[f"{name}.rail_angle"]), np.sin(p[f"{name}.rail_angle"])])
        off = x - np.array(p[f"{name}.rail_origin"])
        q[leg] = off @ d + p["working_mode"][leg] * np.sqrt(
            length**2 - (off @ off - (off @ d) ** 2)
        )
        r = off - q[leg] * d
        v[leg] = (r @ x_dot) / (r @ d)
        ends = np.zeros((4, 4))  # velocities of slider and point
        ends[:2, leg], ends[2:, 2:] = d, np.eye(2)
        rod = bar * np.kron(np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0, np.eye(2))
        mass += ends.T @ rod @ ends
        mass[leg, leg] += slider
        weight += ends.T @ (0.5 * bar * np.concatenate([g, g]))
        weight[leg] += slider * (g @ d)
        friction[leg] = p[f"{name}.viscous_friction"] * v[leg]
        jacobian[leg, leg], jacobian[leg, 2:] = -(r @ d), r
        drift[leg] = (x_dot - d * v[leg]) @ (x_dot - d * v[leg])

    def forward(forces: np.ndarray) -> np.ndarray:
        matrix = np.block([[mass, -jacobian.T], [jacobian, np.zeros((2, 2))]])
        right = np.concatenate(
            [np.append(forces, [0.0, 0.0]) + weight - friction, -drift]
        )
        return np.linalg.solve(matrix, right)[:4]

    return SimpleNamespace(q_a=q[:2], q_a_dot=v[:2], forward=forward)


def test_its_forward_and_inverse_dynamics_are_a_constrained_systems(
    uneven: Robot,
) -> None:
    model, generator = Model.of(uneven), np.random.default_rng(0)
    check_geometry(model, generator.uniform(LOW, HIGH, (20, 2)))
    for _ in range(STATES):
        x, x_dot, tau = (
            generator.uniform(LOW, HIGH),
            generator.normal(0.0, 1.0, 2),
            generator.normal(0.0, 5.0, 2),
        )
        other, place = kkt(uneven, x, x_dot), model.place(x)
        np.testing.assert_allclose(place.q_a, other.q_a, rtol=RELATIVE, atol=1e-15)
        np.testing.assert_allclose(
            model.state(place.q_a, x, x_dot).q_a_dot, other.q_a_dot, rtol=RELATIVE
        )
        expected = other.forward(tau)
        x_ddot = model.platform_dynamics(place.q_a, x, x_dot, tau).x_ddot
        np.testing.assert_allclose(
            x_ddot, expected[2:], rtol=0.0, atol=RELATIVE * np.abs(expected).max()
        )
        if abs(place.s[0]) > 0.05:
            np.testing.assert_allclose(
                model.wrenches(place.q_a, x, x_dot, x_ddot).tau,
                tau,
                rtol=0.0,
                atol=1e-9 * 20.0,
            )


def test_the_criterion_holds_at_singular_states_under_any_forces(uneven: Robot) -> None:
    model, generator = Model.of(uneven), np.random.default_rng(1)
    for _ in range(STATES):
        x, x_dot = (
            nearest_point(uneven, generator.uniform(LOW, HIGH)).x,
            generator.normal(0.0, 1.0, 2),
        )
        x_ddot = kkt(uneven, x, x_dot).forward(generator.normal(0.0, 5.0, 2))[2:]
        assert (
            abs(model.wrenches(model.place(x).q_a, x, x_dot, x_ddot).criterion[0])
            <= CRITERION
        )


def test_the_locus_lies_inside_the_workspace_and_can_be_named_by_a_place_near_it(
    biglide: Any,
) -> None:
    model = Model.of(biglide.ROBOT)
    point = nearest_point(biglide.ROBOT, np.array([0.03, 0.05]))
    assert abs(point.x[0]) < 0.02 and point.type1 > 0.5
    assert abs(model.place(point.x).s[0]) < 1e-12
    along = np.array([-point.gradient[1], point.gradient[0]]) / np.linalg.norm(
        point.gradient
    )
    assert (
        abs(along @ (np.array([0.03, 0.05]) - point.x)) < 1e-4
    )  # straight across from there
    with pytest.raises(
        GeometryError, match="no place of the Type 2 locus was found near"
    ):
        nearest_point(biglide.ROBOT, np.array([1.0, 0.0]))


@pytest.mark.parametrize("plant_of", [exact_plant, pybullet_plant])
def test_it_crosses_there_and_back_in_a_plain_loop(
    biglide: Any, trip: Plan, plant_of: PlantOf
) -> None:
    certificate = trip.certificate
    assert (certificate.residuals <= PLAN_RESIDUAL).all() and len(
        certificate.residuals
    ) == 2
    run = drive(
        biglide.ROBOT,
        trip,
        resolution=biglide.RESOLUTION,
        plant_of=plant_of,
        **biglide.SETTINGS,
    )
    assert run.loop.phase is Phase.HOLD and run.loop.completed == 1, run.loop.reason
    assert run.sides == [-1.0, 1.0, -1.0]
    assert run.error.max() <= MAX_ERROR
    assert run.near_torque <= certificate.peak_torque
    assert [passed.verdict for passed in run.loop.passed] == 2 * [Verdict.CROSSED]


@pytest.mark.parametrize("share", [0.8, 1.2])
def test_it_crosses_with_other_masses_than_it_knows(
    biglide: Any, trip: Plan, share: float
) -> None:
    masses = {
        key: share * value
        for key, value in biglide.ROBOT.numbers.items()
        if key.endswith("_mass")
    }
    run = drive(
        biglide.ROBOT,
        trip,
        biglide.ROBOT.replace(**masses),
        biglide.RESOLUTION,
        **biglide.SETTINGS,
    )
    assert run.loop.phase is Phase.HOLD and run.sides == [
        -1.0,
        1.0,
        -1.0,
    ], run.loop.reason
    assert run.error.max() <= MAX_ERROR_MASSES
    assert run.near_torque <= trip.certificate.peak_torque


def test_a_number_of_its_own_that_is_missing_or_out_of_bounds_is_named(
    biglide: Any,
) -> None:
    with pytest.raises(
        ParameterError,
        match="robot parameter 'max_torque' of the mechanism biglide is missing",
    ):
        Robot.of(biglide.ROBOT.mechanism, biglide.ROBOT.numbers)
    with pytest.raises(
        ParameterError, match=r"robot\.left\.bar_length = -0\.1; it must be > 0 m"
    ):
        biglide.ROBOT.replace(**{"left.bar_length": -0.1})
    with pytest.raises(
        ParameterError,
        match=r"joint_min = 0\.4 with joint_max = 0\.4 of q2; it must be smaller",
    ):
        biglide.ROBOT.replace(joint_min=[-0.4, 0.4])


@pytest.mark.parametrize(
    ("method", "said"),
    [
        (
            "inverse_geometric_model",
            "the inverse geometric model of wrong leaves its closures open by",
        ),
        (
            "direct_geometric_model",
            (
                r"the direct geometric model of wrong gives .* for the joints and the"
                r" side \(s = -0\.428\)"
            ),
        ),
        (
            "lagrangian",
            (
                "the inertia of wrong at .* is not positive: its Lagrangian has to be"
                " kinetic less potential energy"
            ),
        ),
        (
            "closures",
            (
                "B of mechanism wrong is singular everywhere: the closures do not"
                " depend on all active joints"
            ),
        ),
    ],
)
def test_a_plan_of_a_mechanism_that_contradicts_itself_is_refused(
    biglide: Any, method: str, said: str
) -> None:
    right = getattr(biglide.Biglide(), method)
    instead = {
        "inverse_geometric_model": lambda self, x, p: right(x, p) + 1e-4,
        "direct_geometric_model": lambda self, q_a, side, p: right(q_a, -side, p),
        "lagrangian": lambda self, *state: -right(*state),
        "closures": lambda self, *state: ca.vertcat(right(*state)[0], right(*state)[0]),
    }
    wrong = type(
        "Wrong", (biglide.Biglide,), {"name": "wrong", method: instead[method]}
    )
    with pytest.raises(ParameterError, match=said):
        robot = dataclasses.replace(biglide.ROBOT, mechanism=wrong())
        plan_approach(robot, np.array([-0.045, -0.03]), np.array([-0.045, 0.0]), 0.3)


def test_a_way_of_free_duration_keeps_a_speed_limit_and_ends_clear_of_the_locus(
    biglide: Any,
) -> None:
    place = nearest_point(biglide.ROBOT, np.array([0.0, 0.0]))
    for limit in (1.0, 0.5, 0.3):
        certificate = plan_return_trip_through(
            biglide.ROBOT.replace(max_joint_speed=limit), place, 1, None, 0.1
        ).certificate
        assert (
            certificate.peak_joint_speed <= limit
            and abs(certificate.profile.s[0]) >= 0.4
        )
    with pytest.raises(
        TrajectoryError,
        match=r"the way ends at \|s\| = .* of the Type 2 locus; a rest needs 0\.4",
    ):
        plan_return_trip_through(
            biglide.ROBOT.replace(max_torque=0.02), place, 1, None, 0.1
        )


def test_a_slider_has_no_turns(biglide: Any) -> None:
    far = biglide.ROBOT.replace(
        joint_min=[-0.4 + 2.0 * np.pi] * 2, joint_max=[0.4 + 2.0 * np.pi] * 2
    )
    assert (beyond_range(far, np.zeros(2)) > 5.0).all()
    with pytest.raises(
        ParameterError,
        match="unknown robot parameter 'joint_mn' of the mechanism biglide",
    ):
        Robot.of(far.mechanism, {**far.numbers, "joint_mn": [0.0, 0.0]})
