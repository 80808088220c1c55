"""Plans: the criterion at the crossing, finite torque through it, and refusals with numbers."""

from __future__ import annotations

import numpy as np
import pytest
from oracle import Oracle

from dextar_control.contract.errors import DextarError, GeometryError, TrajectoryError
from dextar_control.contract.robot import RobotParameters
from dextar_control.core.certificate import certify, measure
from dextar_control.core.dynamics import criterion
from dextar_control.core.kinematics import singular_values, singularity, state_of_platform
from dextar_control.core.model import make_model
from dextar_control.core.planner import Plan, crossing_polynomial, plan_approach, plan_crossing, plan_return_trip
from dextar_control.core.trajectory import Trajectory, quintic

PLAN_RESIDUAL = 1e-9  # N
RELATIVE = 1e-9  # two exact formulations in float64; 0.1 N m is the size of the planned torques
LIMIT_AGREEMENT = 1e-4  # just before and after the locus: the torque's slope makes 1e-5 of it over 2e-6 of s, rounding less


def _torque_at(robot: RobotParameters, trajectory: Trajectory, crossing: float, s: float) -> np.ndarray:
    """Eq. 4's torque at the instant nearest to the crossing with the given s, by the oracle engine."""
    model = make_model(robot)

    def value(time: float) -> float:
        point = trajectory.at(time)
        return float(singularity(model, state_of_platform(model, point.x, point.x_dot).A_r))

    slope = (value(crossing + 1e-6) - value(crossing - 1e-6)) / 2e-6
    point = trajectory.at(crossing + s / slope)
    kin = state_of_platform(model, point.x, point.x_dot)
    return Oracle(robot).inverse(kin.q_a, point.x, point.x_dot, point.x_ddot)


def test_residual_vanishes_at_each_planned_crossing(trip: Plan, slow_trip: Plan) -> None:
    for plan in (trip, slow_trip):
        assert len(plan.certificate.crossing_times) == 2
        assert (plan.certificate.residuals <= PLAN_RESIDUAL).all()


def test_planned_torque_is_continuous_through_the_locus(robot: RobotParameters, trip: Plan) -> None:
    for crossing in trip.certificate.crossing_times:
        before = _torque_at(robot, trip.trajectory, crossing, -1e-6)
        after = _torque_at(robot, trip.trajectory, crossing, 1e-6)
        np.testing.assert_allclose(before, after, atol=LIMIT_AGREEMENT * np.abs(before).max())
        row = np.searchsorted(trip.certificate.profile.time, crossing)
        np.testing.assert_allclose(
            trip.certificate.profile.torque[row], after, atol=LIMIT_AGREEMENT * np.abs(after).max()
        )


def test_a_violated_criterion_makes_the_torque_grow_as_one_over_s(robot: RobotParameters, trip: Plan) -> None:
    model = make_model(robot)
    crossing = float(trip.certificate.crossing_times[0])
    point = trip.trajectory.at(crossing)
    along = singular_values(state_of_platform(model, point.x, point.x_dot).A_r).v2
    task = trip.trajectory.at(0.0).x, trip.trajectory.at(0.6).x
    wrong = crossing_polynomial(task[0], task[1], point.x, point.x_dot, point.x_ddot + 1.0 * along, 0.16, 0.17)
    peaks = [np.abs(_torque_at(robot, wrong, 0.16, s)).max() for s in (1e-3, 1e-4, 1e-5)]
    assert 5.0 < peaks[1] / peaks[0] < 20.0
    assert 9.0 < peaks[2] / peaks[1] < 11.0


def test_planned_torque_is_the_oracles_away_from_the_locus(robot: RobotParameters, trip: Plan) -> None:
    oracle, profile = Oracle(robot), trip.certificate.profile
    for row in np.flatnonzero(np.abs(profile.s) > 0.15)[::40]:
        point = trip.trajectory.at(float(profile.time[row]))
        expected = oracle.inverse(profile.q_a[row], point.x, point.x_dot, point.x_ddot)
        np.testing.assert_allclose(profile.torque[row], expected, rtol=RELATIVE, atol=RELATIVE * 0.1)


def test_the_trip_rests_at_its_ends_and_crosses_once_each_way(robot: RobotParameters, trip: Plan) -> None:
    signs = trip.certificate.crossing_signs
    assert signs.tolist() == [-1.0, 1.0]
    for time in (0.0, 0.1, 0.6, trip.trajectory.duration):
        np.testing.assert_allclose(trip.trajectory.at(time).x_dot, 0.0, atol=1e-9)
    certify(robot, trip.trajectory, max_residual=PLAN_RESIDUAL, crossings=2)


def test_derivatives_agree_with_finite_differences(trip: Plan) -> None:
    h = 1e-5
    for time in np.linspace(0.01, trip.trajectory.duration - 0.01, 50):
        before, now, after = (trip.trajectory.at(time + shift) for shift in (-h, 0.0, h))
        np.testing.assert_allclose(now.x_dot, (after.x - before.x) / (2 * h), atol=1e-6)
        np.testing.assert_allclose(now.x_ddot, (after.x_dot - before.x_dot) / (2 * h), atol=1e-4)


def test_uniform_time_scaling_keeps_the_criterion(robot: RobotParameters, trip: Plan) -> None:
    stretched = measure(make_model(robot), trip.trajectory.scaled(3.0))
    assert len(stretched.crossing_times) == 2
    assert (stretched.residuals <= PLAN_RESIDUAL).all()
    assert stretched.peak_torque == pytest.approx(trip.certificate.peak_torque / 9.0, rel=1e-3)


def test_samples_give_the_trajectory_back_with_its_criterion(robot: RobotParameters, trip: Plan) -> None:
    knots = [*trip.certificate.crossing_times, trip.trajectory.duration]
    times = np.union1d(np.arange(0.0, trip.trajectory.duration, 2e-3), knots)
    again = quintic(times, *trip.trajectory.table(times))
    for time in np.linspace(0.0, trip.trajectory.duration, 501):
        np.testing.assert_allclose(again.at(time).x, trip.trajectory.at(time).x, atol=1e-9)
        np.testing.assert_allclose(again.at(time).x_ddot, trip.trajectory.at(time).x_ddot, atol=2e-2)
    model = make_model(robot)
    for time in trip.certificate.crossing_times:
        point = again.at(time)
        assert abs(criterion(model, state_of_platform(model, point.x, point.x_dot), point.x_ddot)) <= PLAN_RESIDUAL


def test_gravity_in_the_plane_is_planned_both_ways(robot: RobotParameters) -> None:
    plan = plan_return_trip(robot.replace(gravity=(0.0, -1.0)), [-0.025, 0.115], [0.01, 0.06], 0.33, 0.1)
    assert (plan.certificate.residuals <= PLAN_RESIDUAL).all()


def test_an_approach_stays_on_its_side(robot: RobotParameters) -> None:
    line = plan_approach(robot, [0.02, 0.12], [-0.025, 0.115], 0.1)
    profile = measure(make_model(robot), line).profile
    assert (profile.s > 0.0).all()
    with pytest.raises(TrajectoryError, match="approach keeps 0.2"):
        plan_approach(robot, [0.01, 0.06], [-0.025, 0.115], 0.1)


def test_uneven_links_are_planned_or_refused_in_words(robot: RobotParameters) -> None:
    lengths = {f"{side}.{link}_length": 0.12 if link == "proximal" else 0.06 for side in ("left", "right")
               for link in ("proximal", "distal")}  # fmt: skip
    generator, uneven = np.random.default_rng(1), robot.replace(**lengths)
    for _ in range(12):
        start, goal = generator.uniform([-0.06, 0.06], [0.06, 0.16], (2, 2))
        try:
            plan = plan_crossing(uneven, start, goal, 0.4)
        except DextarError:
            continue
        assert (plan.certificate.residuals <= PLAN_RESIDUAL).all()


@pytest.mark.parametrize(
    ("start", "goal", "duration", "message"),
    [
        ([0.0, 0.3], [0.01, 0.06], 0.33, r"start: point \(0.0000, 0.3000\) m is 0.3057 m from the left motor axis; the leg"),
        ([-0.025, 0.115], [0.0, 0.12], 0.33, "same side of the Type 2 locus"),
        ([-0.025, 0.115], [0.0, 0.0845], 0.33, "too near to the Type 2 locus"),
        ([-0.025, 0.115], [0.01, 0.06], 0.1, r"peak torque is .* N m; the limit is 0.3 N m"),
        ([-0.025, 0.115], [0.01, 0.06], -1.0, "duration = -1.0 s; it must be > 0"),
    ],
)
def test_refusals_name_the_value_and_the_limit(
    robot: RobotParameters, start: list[float], goal: list[float], duration: float, message: str
) -> None:
    with pytest.raises(DextarError, match=message):
        plan_crossing(robot, np.array(start), np.array(goal), duration)


def test_a_point_near_type_1_is_refused(robot: RobotParameters) -> None:
    with pytest.raises(GeometryError, match="from Type 1; the limit is 0.05"):
        plan_crossing(robot, np.array([0.0, 0.17]), np.array([0.01, 0.06]), 0.33)


def test_certify_refuses_what_breaks_the_criterion(robot: RobotParameters, trip: Plan) -> None:
    point = trip.trajectory.at(float(trip.certificate.crossing_times[0]))
    ends = trip.trajectory.at(0.0).x, trip.trajectory.at(0.6).x
    wrong = crossing_polynomial(*ends, point.x, point.x_dot, point.x_ddot + np.array([0.0, 3.0]), 0.16, 0.17)
    with pytest.raises(TrajectoryError, match=r"residual \|t_s.w_d\| at crossing 1 is .* N; the limit is 0.01 N"):
        certify(robot, wrong, max_residual=0.01)


def test_samples_that_cannot_be_a_trajectory_are_refused() -> None:
    x = np.zeros((3, 2))
    with pytest.raises(TrajectoryError, match="time_from_start at point 2"):
        quintic(np.array([0.0, 0.1, 0.1]), x, x, x)
    with pytest.raises(TrajectoryError, match="positions at point 1 are not finite"):
        quintic(np.array([0.0, 0.1, 0.2]), np.array([[0, 0], [np.nan, 0], [0, 0]]), x, x)
