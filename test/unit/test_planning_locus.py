"""The Type 2 locus: both families, every working mode, and points off it refused with
the nearest one.
"""

from __future__ import annotations

import numpy as np
import pytest

from dextar_control.contract.errors import GeometryError, ParameterError
from dextar_control.contract.robot import RobotParameters
from dextar_control.planning.locus import (
    MIN_CROSSING_TYPE1,
    WORKING_MODES,
    Family,
    locus_point,
    nearest_point,
    sample_locus,
    trace_locus,
)
from dextar_sim.geometry import bases, elbow, joints_at

# sine of the angle between the distal links: rounding of two square roots well clear of
# Type 1
ALIGNED = 1e-9
STEP = 1e-6  # m, of the finite differences of s
GRADIENT = 1e-3  # 1/m of about 20: the differences' own error
# of the mean: gaps between neighbours, which share a length up to where arcs begin and
# end
EVEN = 0.35


def distal_links(robot: RobotParameters, x: np.ndarray) -> np.ndarray:
    """r_1, r_2 by the simulator's own geometry, rows of (2, 2), m."""
    joints = joints_at(robot, x)
    active = (joints[0], joints[2])
    points = [
        elbow(leg, q, base)
        for leg, q, base in zip(robot.legs, active, bases(robot), strict=True)
    ]
    return x - np.array(points)


def sine(robot: RobotParameters, x: np.ndarray) -> float:
    """Sine of the angle between the distal links."""
    r_1, r_2 = distal_links(robot, x)
    return float((r_1[0] * r_2[1] - r_1[1] * r_2[0]) / np.hypot(*r_1) / np.hypot(*r_2))


@pytest.mark.parametrize("description", ["robot", "uneven"])
def test_sampled_points_have_aligned_distal_links_in_their_family(
    description: str, request: pytest.FixtureRequest
) -> None:
    robot: RobotParameters = request.getfixturevalue(description)
    for point in sample_locus(robot, 60, seed=4, folded=10):
        at = robot.replace(working_mode=point.working_mode)
        r_1, r_2 = distal_links(at, point.x)
        assert abs(sine(at, point.x)) < ALIGNED
        assert (r_1 @ r_2 > 0.0) == (point.family is Family.FOLDED)
        np.testing.assert_allclose(abs(point.t_s @ r_1), 0.0, atol=ALIGNED)
        assert point.type1 >= MIN_CROSSING_TYPE1


def test_the_gradient_of_s_is_that_of_the_simulators_geometry(
    robot: RobotParameters,
) -> None:
    for point in sample_locus(robot, 12, seed=1, folded=4):
        at = robot.replace(working_mode=point.working_mode)
        steps = STEP * np.eye(2)
        expected = [
            (sine(at, point.x + step) - sine(at, point.x - step)) / (2.0 * STEP)
            for step in steps
        ]
        np.testing.assert_allclose(point.gradient, expected, atol=GRADIENT)


def test_t_s_is_tangent_to_the_folded_circle_and_crosses_the_stretched_curve(
    robot: RobotParameters,
) -> None:
    for point in sample_locus(robot, 20, seed=2, folded=8):
        slope = abs(point.gradient @ point.t_s)
        if point.family is Family.FOLDED:
            assert slope < GRADIENT
        else:
            assert slope == pytest.approx(2.0 / robot.left.distal_length, rel=1e-4)


def test_a_sample_has_the_folded_points_and_working_modes_asked_for(
    robot: RobotParameters,
) -> None:
    for seed in range(3):
        points = sample_locus(robot, 40, seed=seed, folded=16)
        assert len(points) == 40
        assert sum(point.family is Family.FOLDED for point in points) >= 16
        assert {point.working_mode for point in points} == set(WORKING_MODES)
    alone = sample_locus(robot, 7, working_modes=((1, -1),))
    assert {point.working_mode for point in alone} == {(1, -1)}


def test_a_sample_is_its_seeds_and_spread_evenly(robot: RobotParameters) -> None:
    first, again, other = (sample_locus(robot, 60, seed=seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(
        [point.x for point in first], [point.x for point in again]
    )
    assert not np.array_equal(
        [point.x for point in first], [point.x for point in other]
    )
    arc = [
        point.x
        for point in first
        if point.working_mode == (1, -1) and point.family is Family.STRETCHED
    ]
    gaps = np.hypot(*np.diff(sorted(arc, key=lambda x: x[0]), axis=0).T)
    assert np.abs(gaps / gaps.mean() - 1.0).max() < EVEN


def test_too_few_points_for_what_is_asked_are_refused(robot: RobotParameters) -> None:
    with pytest.raises(
        ParameterError,
        match="count = 3; 10 folded points and each working mode need at least 1",
    ):
        sample_locus(robot, 3, folded=10)
    with pytest.raises(GeometryError, match="has no folded"):
        long = {f"{side}.proximal_length": 0.05 for side in ("left", "right")}
        sample_locus(robot.replace(**long), 10, folded=1)


def test_a_point_off_the_locus_is_refused_with_s_and_the_nearest_point(
    robot: RobotParameters,
) -> None:
    with pytest.raises(
        GeometryError,
        match=(
            r"off the Type 2 locus: \|s\| = 0\.\d+; the nearest point .* m, 9\.5 mm"
            r" away"
        ),
    ):
        locus_point(robot, np.array([0.0, 0.075]))
    with pytest.raises(GeometryError, match="the leg reaches"):
        locus_point(robot, np.array([0.3, 0.0]))
    point = locus_point(robot, np.array([0.0, 0.0842]))
    assert abs(sine(robot, point.x)) < ALIGNED


def test_the_nearest_point_is_the_nearest_of_the_traced_ones(
    robot: RobotParameters,
) -> None:
    x = np.array([0.03, 0.05])
    traced = np.vstack(
        [
            arc.x
            for arc in trace_locus(
                robot, (robot.working_mode,), robot.min_type1_distance
            )
        ]
    )
    least = np.hypot(*(traced - x).T).min()
    assert np.hypot(*(nearest_point(robot, x).x - x)) <= least
