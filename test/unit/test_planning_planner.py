"""Plans: the criterion at the crossing, finite torque through it, and refusals with
numbers.
"""

from __future__ import annotations

import itertools
import json
import re
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from crossing_polynomial import crossing_polynomial
from oracle import Oracle
from planner_bench import answer, random_requests

from dextar_control.contract.errors import DextarError, GeometryError, TrajectoryError
from dextar_control.contract.robot import RobotParameters
from dextar_control.planning.candidate import layouts
from dextar_control.planning.certificate import Certificate, measure
from dextar_control.planning.checks import certify
from dextar_control.planning.locus import (
    MIN_END_S,
    WORKING_MODES,
    Family,
    LocusPoint,
    locus_point,
    nearest_point,
    sample_locus,
)
from dextar_control.planning.model import planning_model
from dextar_control.planning.planner import (
    CrossingCriterion,
    Plan,
    plan_approach,
    plan_crossing,
    plan_return_trip,
    plan_return_trip_through,
    plan_through,
    robot_at,
)
from dextar_control.planning.profile import sample_profile
from dextar_control.planning.search import (
    IMPOSSIBLE,
    crossing_problem,
    leg_problem,
    trajectory_of,
)
from dextar_control.planning.trajectory import Trajectory, quintic
from dextar_sim.geometry import bases, elbow, joints_at

PLAN_RESIDUAL = 1e-9  # N
# two exact formulations in float64; 0.1 N m is the size of the planned torques
RELATIVE = 1e-9
LONG_AND_SHORT = {
    f"{side}.{link}_length": length
    for side in ("left", "right")
    for link, length in (("proximal", 0.12), ("distal", 0.06))
}  # m: Type 1 parts y > 0 and y < 0
FAST_PEAK = 0.2  # N m, of a fast trip through any crossable point; the limit is 0.3
CRAMPED_PEAK = (
    0.145  # N m, of a fast trip where Type 1 leaves little room: half of the limit
)
# N, of the second difference over 1e-4 s of 0.1 kg m of moments known to 1e-17 m:
# rounding and truncation
MASS_FORCE = 2e-5
# just before and after the locus: the torque's slope makes 1e-5 of it over 2e-6 of s,
# rounding less
LIMIT_AGREEMENT = 1e-4


def _torque_at(
    robot: RobotParameters, trajectory: Trajectory, crossing: float, s: float
) -> np.ndarray:
    """Eq. 4's torque at the instant nearest to the crossing with the given s, by the
    oracle engine.
    """
    model = planning_model(robot)

    def value(time: float) -> float:
        return model.s(trajectory.at(time).x)

    slope = (value(crossing + 1e-6) - value(crossing - 1e-6)) / 2e-6
    point = trajectory.at(crossing + s / slope)
    return Oracle(robot).inverse(
        model.inverse_geometric_model(point.x), point.x, point.x_dot, point.x_ddot
    )


def test_residual_vanishes_at_each_planned_crossing(
    trip: Plan, slow_trip: Plan
) -> None:
    for plan in (trip, slow_trip):
        assert len(plan.certificate.crossing_times) == 2
        assert (plan.certificate.residuals <= PLAN_RESIDUAL).all()


def test_planned_torque_is_continuous_through_the_locus(
    robot: RobotParameters, trip: Plan
) -> None:
    for crossing in trip.certificate.crossing_times:
        before = _torque_at(robot, trip.trajectory, crossing, -1e-6)
        after = _torque_at(robot, trip.trajectory, crossing, 1e-6)
        np.testing.assert_allclose(
            before, after, atol=LIMIT_AGREEMENT * np.abs(before).max()
        )
        row = np.searchsorted(trip.certificate.profile.time, crossing)
        np.testing.assert_allclose(
            trip.certificate.profile.torque[row],
            after,
            atol=LIMIT_AGREEMENT * np.abs(after).max(),
        )


def test_a_violated_criterion_makes_the_torque_grow_as_one_over_s(
    robot: RobotParameters, trip: Plan
) -> None:
    crossing = float(trip.certificate.crossing_times[0])
    point = trip.trajectory.at(crossing)
    along = planning_model(robot).place(point.x).t_s
    task = trip.trajectory.at(0.0).x, trip.trajectory.at(0.6).x
    wrong = crossing_polynomial(
        robot, task, point.x, point.x_dot, point.x_ddot + 1.0 * along
    )
    peaks = [
        np.abs(_torque_at(robot, wrong, 0.16, s)).max() for s in (1e-3, 1e-4, 1e-5)
    ]
    assert 5.0 < peaks[1] / peaks[0] < 20.0
    assert 9.0 < peaks[2] / peaks[1] < 11.0


def test_planned_torque_is_the_oracles_away_from_the_locus(
    robot: RobotParameters, trip: Plan
) -> None:
    oracle, profile = Oracle(robot), trip.certificate.profile
    for row in np.flatnonzero(np.abs(profile.s) > 0.15)[::40]:
        point = trip.trajectory.at(float(profile.time[row]))
        expected = oracle.inverse(profile.q_a[row], point.x, point.x_dot, point.x_ddot)
        np.testing.assert_allclose(
            profile.torque[row], expected, rtol=RELATIVE, atol=RELATIVE * 0.1
        )


def test_the_trip_rests_at_its_ends_and_crosses_once_each_way(
    robot: RobotParameters, trip: Plan
) -> None:
    signs = trip.certificate.crossing_signs
    assert signs.tolist() == [-1.0, 1.0]
    for time in (0.0, 0.1, 0.6, trip.trajectory.duration):
        np.testing.assert_allclose(trip.trajectory.at(time).x_dot, 0.0, atol=1e-9)
    certify(robot, trip.trajectory, max_residual=PLAN_RESIDUAL, crossings=2)


def test_derivatives_agree_with_finite_differences(trip: Plan) -> None:
    h = 1e-5
    for time in np.linspace(0.01, trip.trajectory.duration - 0.01, 50):
        before, now, after = (
            trip.trajectory.at(time + shift) for shift in (-h, 0.0, h)
        )
        np.testing.assert_allclose(now.x_dot, (after.x - before.x) / (2 * h), atol=1e-6)
        np.testing.assert_allclose(
            now.x_ddot, (after.x_dot - before.x_dot) / (2 * h), atol=1e-4
        )


def test_uniform_time_scaling_keeps_the_criterion(
    robot: RobotParameters, trip: Plan
) -> None:
    stretched = measure(robot, trip.trajectory.scaled(3.0))
    assert len(stretched.crossing_times) == 2
    assert (stretched.residuals <= PLAN_RESIDUAL).all()
    assert stretched.peak_torque == pytest.approx(
        trip.certificate.peak_torque / 9.0, rel=1e-3
    )


def test_samples_give_the_trajectory_back_with_its_criterion(
    robot: RobotParameters, trip: Plan
) -> None:
    knots = [*trip.certificate.crossing_times, trip.trajectory.duration]
    times = np.union1d(np.arange(0.0, trip.trajectory.duration, 2e-3), knots)
    again = quintic(times, *trip.trajectory.table(times))
    for time in np.linspace(0.0, trip.trajectory.duration, 501):
        np.testing.assert_allclose(
            again.at(time).x, trip.trajectory.at(time).x, atol=1e-9
        )
        np.testing.assert_allclose(
            again.at(time).x_ddot, trip.trajectory.at(time).x_ddot, atol=2e-2
        )
    assert (
        np.abs(sample_profile(robot, again, trip.certificate.crossing_times).residual)
        <= PLAN_RESIDUAL
    ).all()


def test_gravity_in_the_plane_is_planned_both_ways(robot: RobotParameters) -> None:
    plan = plan_return_trip(
        robot.replace(gravity=(0.0, -1.0)), [-0.025, 0.115], [0.01, 0.06], 0.33, 0.1
    )
    assert (plan.certificate.residuals <= PLAN_RESIDUAL).all()


def test_an_approach_stays_on_its_side(robot: RobotParameters) -> None:
    line = plan_approach(robot, [0.02, 0.12], [-0.025, 0.115], 0.1)
    profile = measure(robot, line).profile
    assert (profile.s > 0.0).all()
    with pytest.raises(TrajectoryError, match="approach keeps 0.2"):
        plan_approach(robot, [0.01, 0.06], [-0.025, 0.115], 0.1)


def test_uneven_links_are_planned_or_refused_in_words(robot: RobotParameters) -> None:
    generator, uneven = np.random.default_rng(1), robot.replace(**LONG_AND_SHORT)
    for _ in range(12):
        start, goal = generator.uniform([-0.06, 0.06], [0.06, 0.16], (2, 2))
        try:
            plan = plan_crossing(uneven, start, goal, 0.4)
        except DextarError:
            continue
        assert (plan.certificate.residuals <= PLAN_RESIDUAL).all()


@pytest.fixture(scope="module")
def points(robot: RobotParameters) -> list[LocusPoint]:
    """Twelve points of the locus, both families, all working modes."""
    return sample_locus(robot, 12, seed=7, folded=5)


def _wrench(
    robot: RobotParameters, trajectory: Trajectory, time: float, h: float = 1e-4
) -> np.ndarray:
    """w_d by differences: the rate of sum m_Px P_dot + M_x x_dot of uniform rods, from
    the simulator's geometry.
    """

    def moment(instant: float) -> np.ndarray:
        x = trajectory.at(instant).x
        joints = joints_at(robot, x)
        total = robot.end_effector_mass * x
        for leg, base, q in zip(
            robot.legs, bases(robot), (joints[0], joints[2]), strict=True
        ):
            total = total + leg.distal_mass * (
                np.array(elbow(leg, q, base)) / 6.0 + x / 3.0
            )
        return total

    def second(step: float) -> np.ndarray:
        return (
            moment(time + step) - 2.0 * moment(time) + moment(time - step)
        ) / step**2

    return (4.0 * second(h) - second(2.0 * h)) / 3.0


@pytest.mark.parametrize("duration", [0.33, 2.0, None])
def test_any_point_of_the_locus_is_crossed_both_ways(
    robot: RobotParameters, points: list[LocusPoint], duration: float | None
) -> None:
    assert {point.family for point in points} == set(Family)
    assert {point.working_mode for point in points} == set(WORKING_MODES)
    for point, sign in zip(points, itertools.cycle((1, -1)), strict=False):
        plan = plan_return_trip_through(
            robot_at(robot, point), point, sign, duration, 0.1
        )
        crossings = plan.certificate.crossings
        assert [crossing.sign for crossing in crossings] == [sign, -sign]
        assert {crossing.family for crossing in crossings} == {
            point.family.name.lower()
        }
        np.testing.assert_allclose(
            [crossing.x for crossing in crossings], [point.x, point.x], atol=1e-12
        )
        assert (plan.certificate.residuals <= PLAN_RESIDUAL).all()
        assert plan.certificate.least_s >= MIN_END_S
        assert plan.certificate.peak_torque <= FAST_PEAK


def test_a_fast_way_through_a_cramped_place_takes_little_torque(
    robot: RobotParameters,
) -> None:
    """Late torque leaves an error in proportion: far from the easy places the search
    must not end in a bad way.
    """
    cramped = locus_point(
        robot.replace(working_mode=(1, 1)), np.array([-0.08467, -0.09848])
    )
    assert (
        plan_through(robot_at(robot, cramped), cramped, 1, 0.33).certificate.peak_torque
        <= CRAMPED_PEAK
    )


def test_torque_is_continuous_through_every_kind_of_crossing(
    robot: RobotParameters, points: list[LocusPoint]
) -> None:
    for point in points:
        at = robot_at(robot, point)
        plan = plan_through(at, point, 1, 0.33)
        crossing = plan.certificate.crossings[0]
        before, after = (
            _torque_at(at, plan.trajectory, crossing.time, s) for s in (-1e-6, 1e-6)
        )
        scale = LIMIT_AGREEMENT * max(np.abs(after).max(), 0.05)
        np.testing.assert_allclose(before, after, atol=scale)
        np.testing.assert_allclose(crossing.torque, after, atol=scale)


def test_zero_wrench_plans_have_no_wrench_at_the_crossing_and_others_none_along_t_s(
    robot: RobotParameters, points: list[LocusPoint]
) -> None:
    for point in points[::3]:
        at = robot_at(robot, point)
        for wanted in CrossingCriterion:
            plan = plan_through(at, point, 1, 0.4, criterion=wanted)
            w_d = _wrench(at, plan.trajectory, plan.certificate.crossings[0].time)
            scale = MASS_FORCE + 2e-3 * np.abs(_wrench(at, plan.trajectory, 0.1)).max()
            assert abs(w_d @ point.t_s) < scale
            if wanted is CrossingCriterion.ZERO_WRENCH:
                assert np.abs(w_d).max() < scale


def test_a_crossing_moves_in_the_direction_asked_for(
    robot: RobotParameters, points: list[LocusPoint]
) -> None:
    for point in points[::4]:
        across = point.gradient / np.hypot(*point.gradient)
        wanted = across + 0.4 * np.array([-across[1], across[0]])
        for way in (wanted, -wanted):
            crossing = plan_through(
                robot_at(robot, point), point, way, 0.4
            ).certificate.crossings[0]
            cosine = (
                np.array(crossing.x_dot)
                @ way
                / np.hypot(*way)
                / np.hypot(*crossing.x_dot)
            )
            assert cosine == pytest.approx(1.0, abs=1e-9)


def test_a_given_start_and_goal_meet_a_given_point(robot: RobotParameters) -> None:
    plan = plan_crossing(
        robot, [-0.025, 0.115], [0.01, 0.06], 0.5, point=np.array([0.01, 0.0838])
    )
    np.testing.assert_allclose(
        plan.certificate.crossings[0].x, [0.01, 0.0838], atol=1e-3
    )
    np.testing.assert_allclose(plan.trajectory.at(0.0).x, [-0.025, 0.115])
    np.testing.assert_allclose(plan.trajectory.at(0.5).x, [0.01, 0.06])


def test_an_open_duration_is_chosen_by_the_torque(robot: RobotParameters) -> None:
    certificate = plan_crossing(robot, [-0.025, 0.115], [0.01, 0.06]).certificate
    assert certificate.peak_torque == pytest.approx(0.3 * robot.max_torque, rel=0.05)


def test_random_requests_on_two_sides_are_planned(robot: RobotParameters) -> None:
    answers = [answer(request) for request in random_requests(robot, 12, seed=11)]
    assert [item.refusal for item in answers if item.refusal] == []


def test_the_searchs_gradient_is_that_of_its_cost_and_both_are_finite_everywhere(
    uneven: RobotParameters, points: list[LocusPoint]
) -> None:
    """Candidates that lead out of the workspace, through Type 1 and where the locus
    does not close included.
    """
    generator, outside = np.random.default_rng(3), 0
    for point in points:
        at = robot_at(uneven, point)
        names = [field.name for field in layouts(2).crossing.fields]
        problem = crossing_problem(
            at, point, 1.0, 0.4, CrossingCriterion.RECIPROCAL, names
        )
        left, reached = generator.normal(0.0, 0.1, (2, 2, 4))
        leg = leg_problem(at, left, reached, 1.0, 0.4)
        for asked, spread in itertools.product((problem, leg), (0.1, 0.5, 3.0)):
            z = asked.variables.make()
            z.numbers[:] = spread * generator.normal(size=asked.variables.size)
            cost, gradient = asked.costs(z)
            assert np.isfinite(cost)
            assert cost != IMPOSSIBLE
            assert np.isfinite(gradient).all()
            outside += not np.isfinite(
                measure(at, trajectory_of(asked, z)).profile.q_a
            ).all()
            direction = generator.normal(size=len(gradient))

            def along(step: float, asked=asked, z=z, direction=direction) -> float:
                moved = z.copy()
                moved.numbers += step * direction
                return asked.costs(moved)[0]

            slope, steps = float(gradient @ direction), (1e-7, 1e-8, 1e-9)
            differences = [
                (along(step) - along(-step)) / (2.0 * step) for step in steps
            ]
            gap = np.abs(np.array(differences) - slope).min()
            assert gap <= 1e-4 * max(abs(slope), np.abs(gradient).max()), (
                f"{asked.leg} {spread}"
            )
    assert outside > 20


def test_the_torque_of_a_profile_is_the_oracles(uneven: RobotParameters) -> None:
    generator, count = np.random.default_rng(3), 0
    for mode in WORKING_MODES:
        at = uneven.replace(working_mode=mode)
        model, oracle = planning_model(at), Oracle(at)
        x, x_dot = generator.uniform(-0.1, 0.1, (20, 2)), generator.normal(size=(20, 2))
        x_ddot = 10.0 * generator.normal(size=(20, 2))
        found = model.instants(x, x_dot, x_ddot)
        for row in np.flatnonzero(
            np.isfinite(found.q_a).all(axis=1) & (np.abs(found.s[:, 0]) > 0.2)
        ):
            expected = oracle.inverse(found.q_a[row], x[row], x_dot[row], x_ddot[row])
            tau = found.joint_torque[row] - found.B[row].T @ found.multipliers[row]
            np.testing.assert_allclose(
                tau, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max()
            )
            count += 1
    assert count >= 20


def test_the_same_request_is_the_same_plan_in_two_threads_at_once(
    robot: RobotParameters,
) -> None:
    goals = [[0.01, 0.06], [0.0, 0.05], [0.015, 0.055]]
    alone = [plan_crossing(robot, [-0.025, 0.115], goal, 0.4) for goal in goals]
    with ThreadPoolExecutor(2) as pool:
        together = list(
            pool.map(
                lambda goal: plan_crossing(robot, [-0.025, 0.115], goal, 0.4), 2 * goals
            )
        )
    for one, other in zip(2 * alone, together, strict=True):
        np.testing.assert_array_equal(
            one.trajectory.coefficients, other.trajectory.coefficients
        )
        assert one.certificate.to_dict() == other.certificate.to_dict()


def test_another_number_anywhere_is_another_plan(robot: RobotParameters) -> None:
    plans = [
        plan_crossing(robot, [-0.025, 0.115], [0.01, 0.06], 0.4),
        plan_crossing(robot, [-0.025, 0.115], [0.01, 0.06], 0.41),
        plan_crossing(
            robot.replace(end_effector_mass=0.051), [-0.025, 0.115], [0.01, 0.06], 0.4
        ),
        plan_crossing(robot, [-0.025 + 1e-9, 0.115], [0.01, 0.06], 0.4),
    ]
    assert len({plan.trajectory.coefficients.tobytes() for plan in plans}) == 4


def test_unequal_links_under_gravity_are_crossed_in_both_families(
    uneven: RobotParameters,
) -> None:
    strong = uneven.replace(max_torque=1.0)
    for point in sample_locus(strong, 6, seed=2, folded=3):
        plan = plan_return_trip_through(robot_at(strong, point), point, 1, 0.4, 0.1)
        assert [crossing.family for crossing in plan.certificate.crossings] == 2 * [
            point.family.name.lower()
        ]
        assert (plan.certificate.residuals <= PLAN_RESIDUAL).all()


def test_a_certificate_travels_as_text(trip: Plan) -> None:
    certificate = trip.certificate
    read = json.loads(certificate.to_json())
    assert read["peak_torque"] == certificate.peak_torque
    assert [crossing["family"] for crossing in read["crossings"]] == [
        "stretched",
        "stretched",
    ]
    assert read["crossings"][0]["residual"] == certificate.residuals[0]
    assert all(
        f"crossing {row + 1} (stretched" in certificate.lines()[row + 1]
        for row in range(2)
    )
    nothing = json.loads(measure_of_rest(certificate).to_json())
    assert nothing["peak_torque_near"] is None


def measure_of_rest(certificate: Certificate) -> Certificate:
    """A certificate of a motion without a crossing."""
    return certificate._replace(crossings=(), peak_torque_near=float("nan"))


def test_progress_is_told_while_it_searches(
    robot: RobotParameters, points: list[LocusPoint]
) -> None:
    told: list[tuple[float, str]] = []
    plan_through(
        robot_at(robot, points[0]),
        points[0],
        1,
        0.33,
        progress=lambda *word: told.append(word),
    )
    assert told[0][0] == 0.0
    assert told[-1] == (1.0, "certified")


def test_an_approach_goes_round_the_locus_where_a_line_would_meet_it(
    robot: RobotParameters,
) -> None:
    start, goal = np.array([-0.075, 0.02]), np.array([0.0, 0.115])
    line = np.array(
        [start + fraction * (goal - start) for fraction in np.linspace(0.0, 1.0, 200)]
    )
    assert planning_model(robot).sides(line).s.min() < 0.2
    motion = plan_approach(robot, start, goal, 0.2)
    profile = measure(robot, motion).profile
    assert profile.s.min() >= 0.2
    for time, x in ((0.0, start), (motion.duration, goal)):
        np.testing.assert_allclose(motion.at(time).x, x, atol=1e-12)
        np.testing.assert_allclose(motion.at(time).x_dot, 0.0, atol=1e-9)
        np.testing.assert_allclose(motion.at(time).x_ddot, 0.0, atol=1e-6)


def test_a_short_duration_is_refused_with_the_one_that_works(
    robot: RobotParameters,
) -> None:
    start, goal = np.array([-0.025, 0.115]), np.array([0.01, 0.06])
    with pytest.raises(
        TrajectoryError,
        match=r"N m; the limit is 0.3 N m .*; the nearest duration that works is",
    ) as refusal:
        plan_crossing(robot, start, goal, 0.12)
    nearest = float(re.findall(r"works is (\d+\.\d+) s", str(refusal.value))[0])
    assert 0.12 < nearest < 0.3
    plan_crossing(robot, start, goal, 1.01 * nearest)
    with pytest.raises(
        TrajectoryError,
        match=r"platform speed .* m/s .*; the nearest duration that works is",
    ):
        plan_crossing(robot.replace(max_platform_speed=0.2), start, goal, 0.33)


def test_a_point_without_room_is_refused_with_one_that_has(
    robot: RobotParameters,
) -> None:
    with pytest.raises(
        GeometryError, match=r"no room for a rest .*; the nearest point that has is \("
    ) as refusal:
        plan_through(robot, np.array([0.0, -0.158]), 1, 0.33)
    x, y = re.findall(r"has is \((-?\d\.\d+), (-?\d\.\d+)\) m", str(refusal.value))[0]
    plan_through(robot, np.array([float(x), float(y)]), 1, 0.33)


def test_what_cannot_be_crossed_is_refused_in_words(
    robot: RobotParameters, points: list[LocusPoint]
) -> None:
    point = points[0]
    at = robot_at(robot, point)
    along = np.array([-point.gradient[1], point.gradient[0]])
    other = robot_at(
        robot, next(item for item in points if item.working_mode != point.working_mode)
    )
    refusals: list[tuple[type[DextarError], str, RobotParameters, object, object]] = [
        (
            TrajectoryError,
            r"runs along the locus .* the sine of its angle .* a crossing needs 0.1",
            at,
            point,
            along,
        ),
        (TrajectoryError, r"direction = 2; it must be \+1 or -1", at, point, 2),
        (
            TrajectoryError,
            r"direction = \[0.0, 0.0\]; it must be a vector",
            at,
            point,
            np.zeros(2),
        ),
        (
            GeometryError,
            r"belongs to working mode .* set robot.working_mode",
            other,
            point,
            1,
        ),
        (
            GeometryError,
            r"off the Type 2 locus: \|s\| = .* the nearest point",
            robot,
            np.array([0.0, 0.11]),
            1,
        ),
    ]
    for kind, message, place, where, direction in refusals:
        with pytest.raises(kind, match=message):
            plan_through(place, where, direction, 0.33)  # type: ignore[arg-type]
    with pytest.raises(GeometryError, match="must be two finite numbers"):
        plan_crossing(robot, [np.nan, 0.1], [0.01, 0.06], 0.33)
    with pytest.raises(TrajectoryError, match="dwell = 0.0 s; it must be > 0"):
        plan_return_trip(robot, [-0.025, 0.115], [0.01, 0.06], 0.33, 0.0)
    with pytest.raises(
        TrajectoryError,
        match=r"Type 1 parts start .* and goal .* in working mode \[1, -1\]",
    ):
        plan_crossing(
            robot.replace(**LONG_AND_SHORT), [-0.043, 0.063], [-0.107, -0.053], 0.5
        )


@pytest.mark.parametrize(
    ("start", "goal", "duration", "message"),
    [
        (
            [0.0, 0.3],
            [0.01, 0.06],
            0.33,
            (
                r"start: point \(0.0000, 0.3000\) m is 0.3057 m from the left motor"
                r" axis; the leg"
            ),
        ),
        ([-0.025, 0.115], [0.0, 0.12], 0.33, "same side of the Type 2 locus"),
        ([-0.025, 0.115], [0.0, 0.0845], 0.33, "too near to the Type 2 locus"),
        (
            [-0.025, 0.115],
            [0.01, 0.06],
            0.1,
            r"peak torque is .* N m; the limit is 0.3 N m",
        ),
        ([-0.025, 0.115], [0.01, 0.06], -1.0, "duration = -1.0 s; it must be > 0"),
    ],
)
def test_refusals_name_the_value_and_the_limit(
    robot: RobotParameters,
    start: list[float],
    goal: list[float],
    duration: float,
    message: str,
) -> None:
    with pytest.raises(DextarError, match=message):
        plan_crossing(robot, np.array(start), np.array(goal), duration)


def test_a_point_near_type_1_is_refused(robot: RobotParameters) -> None:
    with pytest.raises(GeometryError, match="from Type 1; the limit is 0.05"):
        plan_crossing(robot, np.array([0.0, 0.17]), np.array([0.01, 0.06]), 0.33)


def test_certify_refuses_what_breaks_the_criterion(
    robot: RobotParameters, trip: Plan
) -> None:
    point = trip.trajectory.at(float(trip.certificate.crossing_times[0]))
    ends = trip.trajectory.at(0.0).x, trip.trajectory.at(0.6).x
    wrong = crossing_polynomial(
        robot, ends, point.x, point.x_dot, point.x_ddot + np.array([0.0, 3.0])
    )
    with pytest.raises(
        TrajectoryError,
        match=r"residual \|t_s.w_d\| at crossing 1 is .* N; the limit is 0.01 N",
    ):
        certify(robot, wrong, max_residual=0.01)


def test_samples_that_cannot_be_a_trajectory_are_refused() -> None:
    x = np.zeros((3, 2))
    with pytest.raises(TrajectoryError, match="time_from_start at point 2"):
        quintic(np.array([0.0, 0.1, 0.1]), x, x, x)
    with pytest.raises(TrajectoryError, match="positions at point 1 are not finite"):
        quintic(
            np.array([0.0, 0.1, 0.2]), np.array([[0, 0], [np.nan, 0], [0, 0]]), x, x
        )


def test_a_slow_trip_that_may_stay_longer_near_the_locus_takes_less_torque(
    robot: RobotParameters,
) -> None:
    place = sample_locus(robot, 4, 3)[0]
    at = robot_at(robot, place)
    rushed, calm = (
        plan_through(at, place, 1, 2.0, locus_time=locus_time).certificate
        for locus_time in (0.02, 0.8)
    )
    assert calm.peak_torque < 0.7 * rushed.peak_torque
    assert calm.crossings[0].near_time > rushed.crossings[0].near_time
    with pytest.raises(
        TrajectoryError, match=r"locus_time = 0.0 s; it must lie in 0.005 to 5.0 s"
    ):
        plan_through(at, place, 1, 2.0, locus_time=0.0)


def test_friction_that_no_inertia_balances_is_named(robot: RobotParameters) -> None:
    rubbing = robot.replace(
        pin_coulomb_friction=1.0,
        **{f"{side}.passive_coulomb_friction": 1.0 for side in robot.sides},
    )
    with pytest.raises(
        TrajectoryError,
        match=(
            r"friction of joints without a motor, as described, takes \d+\.?\d* N"
            r" along t_s"
        ),
    ):
        plan_return_trip(rubbing, [-0.025, 0.115], [0.01, 0.06], 0.33, 0.2)


def test_a_robot_whose_passive_joints_rub_comes_back_by_a_way_of_its_own(
    robot: RobotParameters,
) -> None:
    rough = robot.replace(
        working_mode=(-1, -1),
        pin_coulomb_friction=0.01,
        **{f"{side}.passive_coulomb_friction": 0.01 for side in ("left", "right")},
    )
    plan = plan_return_trip_through(
        rough, nearest_point(rough, np.array([-0.03235, -0.00801])), 1, 0.33, 0.1
    )
    assert plan.certificate.residuals.max() < 1e-9
    there, back = (
        plan.trajectory.at(plan.certificate.crossing_times[row]) for row in (0, 1)
    )
    assert (
        np.abs(there.x_ddot - back.x_ddot).max() > 0.1
    )  # friction turns round with the motion, and what the criterion asks for
