"""Tours: exactly the crossings asked for, in order, on one side between them, certified
as a whole.
"""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure
from test_planning_locus import sine

from dextar_control.analysis.drawing import SCREEN, draw_places
from dextar_control.analysis.plan_figure import draw_plan
from dextar_control.analysis.plane import Place
from dextar_control.contract.errors import (
    DextarError,
    GeometryError,
    ParameterError,
    TrajectoryError,
)
from dextar_control.contract.robot import RobotParameters
from dextar_control.planning.certificate import PLAN_RESIDUAL, Plan
from dextar_control.planning.locus import MIN_END_S, WORKING_MODES, sample_locus
from dextar_control.planning.tour import plan_tour, spread_points

AT_POINT = 1e-9  # m: the crossing's point is imposed
STANDS = 1e-9  # m/s
LONG_APART = 0.5e-3  # s: over a shorter time rounding tells on a rate
# N m/s: ways through single points, of open duration, take up to 10
STEEPEST = 15.0
MOVES = 0.02  # m/s: slower than this between crossings is a stop


@pytest.fixture(scope="module")
def tour(robot: RobotParameters) -> Plan:
    """Six points spread over the locus, twice."""
    return plan_tour(robot, 6, repeat=2, seed=3)


def test_a_tour_crosses_at_its_points_in_order_and_nowhere_else(
    robot: RobotParameters, tour: Plan
) -> None:
    points = spread_points(robot, 6, 3)
    assert [point.x.tolist() for point in spread_points(robot, -6, 3)] == [
        point.x.tolist() for point in points[::-1]
    ]
    crossings = tour.certificate.crossings
    for row, crossing in enumerate(crossings):
        np.testing.assert_allclose(crossing.x, points[row % 6].x, atol=AT_POINT)
        assert crossing.sign == (-1) ** row
    times = np.arange(0.0, tour.trajectory.duration, 2e-3)
    s = np.array([sine(robot, tour.trajectory.at(time).x) for time in times])
    assert np.count_nonzero(np.diff(np.sign(s))) == len(crossings) == 12
    assert (tour.certificate.residuals <= PLAN_RESIDUAL).all()


def test_a_tour_starts_and_ends_at_rest_in_one_place_away_from_the_locus(
    robot: RobotParameters, tour: Plan
) -> None:
    begin, end = tour.trajectory.at(0.0), tour.trajectory.at(tour.trajectory.duration)
    np.testing.assert_allclose(begin.x, end.x, atol=AT_POINT)
    for point in (begin, end):
        assert np.hypot(*point.x_dot) < STANDS
    assert abs(sine(robot, begin.x)) >= MIN_END_S


def test_a_tour_is_smooth_where_its_pieces_meet(tour: Plan) -> None:
    h = 1e-9
    for knot in tour.trajectory.knots[1:-1]:
        before, after = tour.trajectory.at(knot - h), tour.trajectory.at(knot + h)
        np.testing.assert_allclose(before.x, after.x, atol=1e-8)
        np.testing.assert_allclose(before.x_dot, after.x_dot, atol=1e-6)
        np.testing.assert_allclose(before.x_ddot, after.x_ddot, atol=1e-4)


def test_the_torque_of_a_tour_is_nowhere_steep_and_the_certificate_tells_how_steep(
    robot: RobotParameters,
) -> None:
    seen = plan_tour(robot, 3, start=np.array([-0.025, 0.115]), duration=0.33)
    profile, rate = seen.certificate.profile, seen.certificate.peak_torque_rate
    apart = np.diff(profile.time)[:, None]
    rates = (np.abs(np.diff(profile.torque, axis=0)) / apart)[apart[:, 0] > LONG_APART]
    assert rates.max() < STEEPEST
    assert 0.5 * rates.max() < rate <= 1.1 * rates.max()


def test_crossings_are_joined_without_stopping(tour: Plan) -> None:
    times = tour.certificate.crossing_times
    slowest = []
    for before, after in zip(times[:-1], times[1:], strict=True):
        speeds = [
            np.hypot(*tour.trajectory.at(time).x_dot)
            for time in np.linspace(before, after, 60)
        ]
        slowest.append(min(speeds))
    assert np.count_nonzero(np.array(slowest) > MOVES) >= 9


def test_a_tour_that_rests_between_its_crossings_crosses_the_same(
    robot: RobotParameters,
) -> None:
    points = spread_points(robot, 3, 1)
    resting = plan_tour(robot, points, flow=False)
    assert len(resting.certificate.crossings) == 3
    assert resting.certificate.least_s >= MIN_END_S


@pytest.mark.parametrize("mode", WORKING_MODES)
def test_every_working_mode_has_tours(
    robot: RobotParameters, mode: tuple[int, int]
) -> None:
    plan = plan_tour(robot.replace(working_mode=mode), 4, seed=1)
    assert len(plan.certificate.crossings) == 4


def test_a_tour_goes_from_a_given_start_in_the_given_directions(
    robot: RobotParameters,
) -> None:
    points = [(np.array([0.0, 0.0842]), 1), np.array([0.04, 0.0723])]
    plan = plan_tour(robot, points, start=np.array([0.01, 0.06]))
    assert [crossing.sign for crossing in plan.certificate.crossings] == [1, -1]
    np.testing.assert_allclose(plan.trajectory.at(0.0).x, [0.01, 0.06])
    np.testing.assert_allclose(
        plan.trajectory.at(plan.trajectory.duration).x, [0.01, 0.06]
    )


def test_tours_that_cannot_be_are_refused(robot: RobotParameters) -> None:
    high, right = np.array([0.0, 0.0842]), np.array([0.04, 0.0723])
    refusals: list[tuple[type[DextarError], str, object]] = [
        (ParameterError, "no points", []),
        (ParameterError, "tour = 0 points", 0),
        (
            TrajectoryError,
            "point 2 of the tour asks for direction .1, .* must alternate",
            [(high, 1), (right, 1)],
        ),
        (TrajectoryError, "direction = 3 at point 1", [(high, 3)]),
        (GeometryError, "off the Type 2 locus", [np.array([0.0, 0.11])]),
        (
            GeometryError,
            "belongs to working mode",
            sample_locus(robot, 1, working_modes=((1, 1),)),
        ),
    ]
    for kind, message, points in refusals:
        with pytest.raises(kind, match=message):
            plan_tour(robot, points)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="repeat = 0"):
        plan_tour(robot, 2, repeat=0)
    with pytest.raises(TrajectoryError, match="must start on the other side"):
        plan_tour(robot, [(high, 1)], start=np.array([-0.025, 0.115]))


def test_progress_runs_from_nothing_to_all(robot: RobotParameters) -> None:
    seen: list[tuple[float, str]] = []
    plan_tour(
        robot, 2, seed=1, progress=lambda fraction, text: seen.append((fraction, text))
    )
    fractions = [fraction for fraction, _ in seen]
    assert fractions == sorted(fractions)
    assert fractions[0] == 0.0
    assert fractions[-1] == 1.0
    assert all(text for _, text in seen)


def test_crossings_near_each_other_share_a_label() -> None:
    axes, nothing = Figure().add_subplot(), np.full((2, 2), np.nan)
    places = [
        Place([number], np.array([x, 0.1]), nothing, "")
        for number, x in ((1, 0.0), (2, 0.06), (3, 0.001))
    ]
    draw_places(axes, places, [], SCREEN)
    assert [text.get_text() for text in axes.texts] == ["1, 3", "2"]


def test_the_figure_shows_both_families_and_numbers_the_crossings(
    robot: RobotParameters, tour: Plan
) -> None:
    figure = draw_plan(robot.replace(name=r"$\frac{"), tour)  # a name is no formula
    figure.canvas.draw()
    path = figure.axes[0]
    names = path.get_legend_handles_labels()[1]
    assert {
        "Type 2 locus, stretched",
        "Type 2 locus, folded",
        "path",
        "$t_{s}$ at a crossing",
    } <= set(names)
    assert [text.get_text() for text in path.texts if text.get_text()] == [
        *(f"{n}, {n + 6}" for n in range(1, 7)),
        "start",
    ]
