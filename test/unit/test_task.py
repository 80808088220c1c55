"""What the trajectory server is asked to plan: taken, refused in one sentence,
planned.
"""

from __future__ import annotations

import numpy as np
import pytest

from dextar_control.contract.errors import DextarError, ParameterError, TrajectoryError
from dextar_control.contract.resources import node_defaults
from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.topics import MAX_TRAJECTORY_POINTS
from dextar_control.nodes.task import MOST_LINES, Task, in_words, plan_from
from dextar_control.nodes.trajectory_server import COARSEST, served_times
from dextar_control.planning.checks import certify
from dextar_control.planning.planner import PLAN_RESIDUAL, CrossingCriterion, Plan
from dextar_control.planning.trajectory import join

STRETCHED = (
    0.09**2 - (0.09 - 0.059) ** 2
) ** 0.5  # m, y of the stretched posture on the axis x = 0


def _values(**changes: object) -> dict[str, object]:
    asked = {f"task.{name}": value for name, value in changes.items()}
    return node_defaults("trajectory_server") | asked


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"tour": 3, "point": [0.0, 0.08]},
            r"task.point = \[0.0, 0.08\] and task.tour = 3 are given; one may be",
        ),
        (
            {"tour": 3, "tour_points": [0.0, 0.08]},
            r"task.tour = 3 and task.tour_points = \[0.0, 0.08\] are given; one may be",
        ),
        (
            {"tour": 3, "excite": 10.0},
            r"task.tour = 3 and task.excite = 10.0 are given; one may be",
        ),
        ({"direction": 1}, "task.direction = 1 is given without a point; it must be 0"),
        (
            {"tour_points": [0.0, 0.08, 0.1]},
            "task.tour_points has 3 numbers; it must be pairs of x and y",
        ),
        ({"duration": 0.01}, "task.duration = 0.01 s; it must be 0 or >= 0.02"),
    ],
)
def test_contradictions_are_refused_in_one_sentence(
    changes: dict[str, object], message: str
) -> None:
    with pytest.raises(ParameterError, match=message):
        Task.from_values(_values(**changes))


def test_without_a_wish_it_is_the_trip_of_the_configuration(
    robot: RobotParameters, trip: Plan
) -> None:
    plan = Task.from_values(_values()).plan(robot)
    assert plan.certificate.duration == pytest.approx(trip.certificate.duration)
    np.testing.assert_allclose(
        plan.certificate.crossing_points, trip.certificate.crossing_points
    )


@pytest.mark.parametrize("direction", [0, -1, 1])
def test_a_trip_through_a_point_crosses_there_and_leads_away_from_a_unless_told(
    robot: RobotParameters, direction: int
) -> None:
    plan = Task.from_values(_values(point=[0.0, STRETCHED], direction=direction)).plan(
        robot
    )
    np.testing.assert_allclose(
        plan.certificate.crossing_points, [[0.0, STRETCHED]] * 2, atol=1e-9
    )
    assert plan.certificate.crossing_signs[0] == (direction or -1)  # A lies at s > 0


def test_an_exciting_motion_begins_and_ends_in_a_and_crosses_nothing(
    robot: RobotParameters,
) -> None:
    values = _values(excite=3.0)
    plan = Task.from_values(values).plan(robot)
    for time in (0.0, plan.certificate.duration):
        np.testing.assert_allclose(
            plan.trajectory.at(time).x, values["task.start"], atol=1e-12
        )
    assert not plan.certificate.crossings


def test_a_tour_of_given_points_begins_in_a(robot: RobotParameters) -> None:
    values = _values(
        tour_points=[0.0, STRETCHED, 0.0, STRETCHED],
        duration=0.0,
        criterion="zero_wrench",
    )
    task = Task.from_values(values)
    assert (task.duration, task.criterion) == (None, CrossingCriterion.ZERO_WRENCH)
    plan = Task.from_values(values | {"task.criterion": "reciprocal"}).plan(robot)
    np.testing.assert_allclose(plan.trajectory.at(0.0).x, values["task.start"])
    assert len(plan.certificate.crossings) == 2


def test_a_robot_on_the_other_side_of_the_locus_is_told_what_to_do_and_that_works(
    robot: RobotParameters,
) -> None:
    across = _values()["task.goal"]
    trip = Task.from_values(_values()).plan(robot)
    with pytest.raises(
        TrajectoryError,
        match=r"no way around was found: let the trip begin where the robot stands",
    ):
        plan_from(robot, np.array(across), trip, speed=0.2)
    home = Task.from_values(_values(start=across, goal=_values()["task.start"])).plan(
        robot
    )
    assert plan_from(
        robot, np.array(across), home, speed=0.2
    ).certificate.crossing_signs.tolist() == [1, -1]


def test_progress_may_end_a_plan(robot: RobotParameters) -> None:
    class Enough(DextarError):
        pass

    def progress(fraction: float, stage: str) -> None:
        raise Enough(stage)

    with pytest.raises(Enough):
        Task.from_values(_values(tour=2, dwell=0.123)).plan(robot, progress)


def test_a_long_trajectory_is_served_with_fewer_points_and_keeps_the_criterion(
    robot: RobotParameters, trip: Plan
) -> None:
    laps = 60
    long = join([trip.trajectory] * laps)
    certificate = certify(robot, long, max_residual=PLAN_RESIDUAL)
    times = served_times(long, certificate, 1e-3)
    assert long.duration > 1e-3 * MAX_TRAJECTORY_POINTS
    assert len(times) <= MAX_TRAJECTORY_POINTS
    assert set(certificate.crossing_times) <= set(times)
    assert np.diff(times).max() < COARSEST
    assert len(in_words(certificate).split("; ")) == MOST_LINES + 1
    assert f"and {2 * laps + 1 - MOST_LINES} more" in in_words(certificate)


def test_what_is_too_long_is_refused_with_the_number(
    robot: RobotParameters, slow_trip: Plan
) -> None:
    long = join([slow_trip.trajectory] * 70)
    certificate = slow_trip.certificate._replace(crossing_times=np.zeros(0))
    with pytest.raises(
        DextarError,
        match=f"the limit is {MAX_TRAJECTORY_POINTS} points: repeat it less often",
    ):
        served_times(long, certificate, 1e-3)
