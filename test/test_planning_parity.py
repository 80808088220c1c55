"""The mathematics on symbols gives the numbers of the compiled core: to be deleted together with it."""

from __future__ import annotations

import numpy as np
import pytest

from dextar_control.contract.robot import RobotParameters
from dextar_control.core import certificate as old_certificate
from dextar_control.core import crossing as old_crossing
from dextar_control.core import dynamics as old_dynamics
from dextar_control.core import kinematics as old_kinematics
from dextar_control.core import locus as old_locus
from dextar_control.core import planner as old_planner
from dextar_control.core import search as old_search
from dextar_control.core.model import make_model
from dextar_control.mechanisms.mechanism import Array
from dextar_control.model.model import Model
from dextar_control.planning.certificate import Plan, measure
from dextar_control.planning.locus import WORKING_MODES, locus_point, nearest_point, sample_locus
from dextar_control.planning.model import planning_model
from dextar_control.planning.profile import sample_profile
from dextar_control.planning.search import Criterion, crossing_problem

RELATIVE = 1e-11  # of each quantity's size over its states: rounding of two formulations, amplified by 1/s <= 20
EQUAL = 1e-9  # of a trip's profile and certificate
STATES = 1000


def _same(new: Array, old: Array, relative: float = RELATIVE) -> None:
    new, old = np.asarray(new, dtype=np.float64), np.asarray(old, dtype=np.float64)
    np.testing.assert_allclose(new, old.reshape(new.shape), rtol=relative, atol=relative * np.abs(old).max())


@pytest.mark.parametrize("mode", WORKING_MODES)
@pytest.mark.parametrize("description", ["robot", "uneven"])
def test_kinematics_and_dynamics_at_random_states(
    description: str, mode: tuple[int, int], request: pytest.FixtureRequest
) -> None:
    robot: RobotParameters = request.getfixturevalue(description).replace(
        working_mode=mode, **{"left.viscous_friction": 0.01, "right.coulomb_friction": 0.02}
    )
    model, old, generator, count = Model.of(robot), make_model(robot), np.random.default_rng(5), 0
    while count < STATES // len(WORKING_MODES):
        x, x_dot, x_ddot = generator.uniform(-0.15, 0.15, 2), generator.normal(0.0, 0.5, 2), generator.normal(0.0, 10.0, 2)
        kin = old_kinematics.state_of_platform(old, x, x_dot)
        s = old_kinematics.singularity(old, kin.A_r)
        if not (old_kinematics.type1_distance(old, kin) > 0.1 and abs(s) > 0.05):
            continue
        count += 1
        q_a = model.inverse_geometric_model(x)
        state, place = model.state(q_a, x, x_dot), planning_model(robot).place(x)
        vectors = old_kinematics.singular_values(kin.A_r)
        for new, expected in (
            (q_a, kin.q_a), (state.A_r, kin.A_r), (np.diag(state.B), kin.B), (state.J_inv, kin.J_inv), (state.b, kin.b),
            (state.q_a_dot, kin.q_a_dot), (state.drift, kin.g), (state.s, s), (state.t_s, vectors.v2), (place.s, s),
            (state.type1, old_kinematics.type1_distance(old, kin)), (place.t_s, vectors.v2),
        ):  # fmt: skip
            _same(new, expected)
        _same(place.gradient, old_locus.singularity_gradient(old, x), 1e-4)  # the core's own differences
        wrenches, dynamics = model.wrenches(q_a, x, x_dot, x_ddot), model.platform_dynamics(q_a, x, x_dot, x_dot)
        mass, bias = old_dynamics.platform_dynamics(old, kin)
        w_b, w_d = old_dynamics.wrenches(old, kin, x_ddot)
        for new, expected in (
            (wrenches.w_b, w_b), (wrenches.w_d, w_d), (wrenches.q_a_ddot, old_dynamics.joint_acceleration(kin, x_ddot)),
            (wrenches.multipliers, old_dynamics.multipliers(kin, w_d)),
            (wrenches.friction, old_dynamics.friction(old, kin.q_a_dot)),
            (wrenches.tau, old_dynamics.inverse_dynamics(old, kin, x_ddot)), (dynamics.M, mass), (dynamics.h, bias),
            (dynamics.x_ddot, old_dynamics.forward_dynamics(old, kin, x_dot)),
        ):  # fmt: skip
            _same(new, expected)


def test_a_trips_profile_and_certificate(robot: RobotParameters, trip: Plan) -> None:
    trajectory, model = trip.trajectory, make_model(robot)
    new, old = measure(robot, trajectory), old_certificate.measure(model, trajectory)
    profile = sample_profile(robot, trajectory, old.profile.time)
    for name, expected in old.profile._asdict().items():
        _same(getattr(profile, name), expected, EQUAL)
    for name in ("crossing_times", "crossing_points", "crossing_signs", "crossing_speeds", "multipliers"):
        _same(getattr(new, name), getattr(old, name), EQUAL)
    for name in ("peak_torque", "peak_torque_near", "peak_joint_speed", "peak_platform_speed", "least_type1", "least_s"):
        assert getattr(new, name) == pytest.approx(getattr(old, name), rel=EQUAL)
    for here, there in zip(new.crossings, old.crossings, strict=True):
        assert (here.family, here.sign) == (there.family, there.sign)
        np.testing.assert_allclose(here.torque, there.torque, atol=EQUAL)
        assert here.near_time == pytest.approx(there.near_time, abs=1e-9)


def test_the_locus(robot: RobotParameters) -> None:
    for new, old in zip(sample_locus(robot, 40, 3, folded=10), old_locus.sample_locus(robot, 40, 3, folded=10), strict=True):
        assert (new.working_mode, new.family.name, new.branch) == (old.working_mode, old.family.name, old.branch)
        np.testing.assert_allclose(new.x, old.x, atol=1e-12)
        np.testing.assert_allclose(new.t_s, old.t_s, atol=1e-9)
        assert new.type1 == pytest.approx(old.type1, rel=1e-9)
    x = np.array([0.0, 0.0842])
    np.testing.assert_allclose(locus_point(robot, x).x, old_locus.locus_point(robot, x).x, atol=1e-9)


@pytest.mark.parametrize("criterion", Criterion)
def test_a_candidates_cost_and_gradient(uneven: RobotParameters, criterion: Criterion) -> None:
    point, generator = nearest_point(uneven, np.array([0.0, 0.09])), np.random.default_rng(1)
    names = ("start", "goal", "place", "split", "velocity", "strong", "jerk", "first_bends", "second_bends")
    problem = crossing_problem(uneven, point, 1.0, 0.4, criterion, names)
    old_point = old_locus.nearest_point(uneven, np.array([0.0, 0.09]))
    old = old_search.crossing_problem(uneven, old_point, 1.0, 0.4, old_planner.Criterion[criterion.name], range(20))
    guesses = old_search.guesses_through(old, old_point)
    for guess in guesses:
        z = guess + 0.02 * generator.normal(size=20)
        new = problem.variables.make(
            start=z[:2], goal=z[2:4], place=z[4], split=z[5], velocity=z[6:8], strong=z[8], jerk=z[9:11],
            first_bends=z[12:16].reshape(2, 2).T, second_bends=z[16:20].reshape(2, 2).T,
        )  # fmt: skip
        cost, gradient = problem.costs(new)
        expected, differences = old_crossing.cost_and_gradient(old.model, old.task, z, np.delete(np.arange(20), 11))
        assert cost == pytest.approx(expected, rel=1e-9)
        np.testing.assert_allclose(gradient, differences, rtol=1e-4, atol=1e-6 * np.abs(differences).max())
