"""One row of a campaign: what is perturbed reaches the robot, and what is counted is
the true robot against its plan.
"""

from __future__ import annotations

import inspect
import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from closed_loop import running

from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.control.phases import Phase
from dextar_control.experiments.campaign.design import CrossingPoint, Trial
from dextar_control.experiments.campaign.ranges import PERTURBATIONS
from dextar_control.experiments.campaign.trial import (
    RIG_OPTIONS,
    built_robot,
    controller_model,
    run_trial,
    sample_points,
)
from dextar_control.planning.planner import Plan
from dextar_sim.effects import Effects
from dextar_sim.rig import Rig

# m; the plan moves on by five times as much in a lost millisecond, the robot strays by
# less than half of it
LOST_ERROR = 0.1e-3
TORQUE_BOUND = 3.0  # of the planned peak, after a bounce


@pytest.fixture(scope="module")
def place(robot: RobotParameters) -> CrossingPoint:
    return sample_points(robot, 4, 0, 0)[0]


def run(
    robot: RobotParameters,
    place: CrossingPoint,
    direction: int = 1,
    seed: int = 1,
    law: str = "consistent",
    estimator: str = "observer",
    **perturbation: float,
) -> dict[str, Any]:
    trial = Trial(
        index=0,
        point=place.point,
        working_mode=place.working_mode,
        family=place.family,
        direction=direction,
        case="tried",
        perturbation=perturbation,
        law=law,
        estimator=estimator,
        plant="cartesian",
        seed=seed,
        duration=0.33,
        dwell=0.2,
        repeat=1,
        settings={},
    )
    return run_trial(robot, trial, Rig)


def test_each_perturbation_of_the_rig_reaches_it() -> None:
    options = (
        {*inspect.signature(Rig).parameters} | {field.name for field in fields(Effects)}
    ) & set(PERTURBATIONS)
    assert options == {*RIG_OPTIONS, "encoder_resolution", "cogging_periods"}


def test_a_sample_that_is_lost_is_no_error_of_the_robot(
    robot: RobotParameters, place: CrossingPoint
) -> None:
    row = run(robot, place, sample_loss=0.2)
    assert row["success"], row["reason"]
    assert row["max_error"] < LOST_ERROR


def test_a_robot_off_its_plan_where_that_nearly_stretches_a_leg_goes_on(
    robot: RobotParameters,
) -> None:
    """A third of a millimetre beside this plan a leg is at its end."""
    row = run(
        robot, CrossingPoint((0.08713179, 0.04542322), (1, 1), "folded"), payload=0.3
    )
    assert row["phase"] == "HOLD" and row["crossed"] == 2, row["reason"]


def test_a_run_that_bounces_is_no_crossing_and_is_called_so(
    robot: RobotParameters, place: CrossingPoint
) -> None:
    row = run(robot, place, bounce=1.0)
    assert row["crossed"] == 0
    assert (
        row["recognised"] and row["missed_bounces"] == 0
    )  # called crossed is only who has coasted across without the law
    assert row["torque_after_bounce"] <= TORQUE_BOUND
    assert row["safe_after"]
    assert 0.0 < row["release_delay"] <= row.get("recognition_delay", 1.0)


@pytest.mark.parametrize("coulomb", [0.0, 0.02])
def test_no_robot_that_bounced_is_held_or_called_crossed_whatever_its_friction(
    robot: RobotParameters, coulomb: float
) -> None:
    """At points where it was held on the wrong side, called crossed or left undecided
    while the test knew of no friction.
    """
    points = [
        point
        for point in sample_points(robot, 16, 0, 97)
        if point.family == "stretched"
    ]
    rows = [
        run(robot, point, (-1) ** index, index, bounce=1.0, coulomb=coulomb)
        for index, point in enumerate(points)
    ]
    bounced = [row for row in rows if row["recognised"] is not None]
    assert len(bounced) >= 6
    assert not any(row["missed_bounces"] for row in rows)
    assert all(row["phase"] == "SAFE_STOP" for row in bounced)
    assert sum(row["recognised"] for row in bounced) >= 4


@pytest.mark.parametrize("push", [-0.5, 0.5])
def test_a_robot_that_recovers_from_a_push_goes_on(
    robot: RobotParameters, trip: Plan, push: float
) -> None:
    """0.5 N for 20 ms along t_s just before the locus: the torque is at its limit for
    longer than 20 ms.
    """
    loop, crossing = (
        ControlLoop(robot, default_settings(), 1),
        float(trip.certificate.crossing_times[0]),
    )
    rig = Rig(robot, plant="cartesian")
    rig.reset_joints(loop.model.inverse_geometric_model(trip.trajectory.at(0.0).x), 1)
    loop.schedule(trip.trajectory, trip.certificate)
    along = loop.model.place(trip.trajectory.at(crossing).x).t_s
    for sample, _ in running(loop, rig, until=trip.trajectory.duration + 0.2):
        if crossing - 0.022 <= sample.time < crossing - 0.002:
            rig.strike(push * rig.period * along)
    assert (loop.phase, loop.completed) == (Phase.HOLD, 1), loop.reason
    assert (
        np.hypot(*(rig.truth().x - trip.trajectory.at(trip.trajectory.duration).x))
        < 1e-3
    )


@pytest.mark.parametrize(("index", "direction"), [(6, -1), (7, 1)])
def test_a_bounced_robot_that_coasts_through_type_1_is_not_called_crossed(
    robot: RobotParameters, index: int, direction: int
) -> None:
    """Beyond Type 1 lies another working mode: what the model says of the side there is
    worth nothing.
    """
    row = run(
        robot,
        sample_points(robot, 10, 3, 3)[index],
        direction,
        7 + index,
        bounce=1.0,
        encoder_resolution=131072.0,
    )
    assert row["recognised"]
    assert row["missed_bounces"] == 0 and row["called_crossed"] == 0


def test_a_row_repeats_bit_for_bit(
    robot: RobotParameters, place: CrossingPoint
) -> None:
    perturbation = {
        "masses": 0.1,
        "geometry": 1e-4,
        "jitter": 0.9,
        "sample_loss": 0.05,
        "command_delay": 2e-3,
    }
    first, again = (run(robot, place, **perturbation) for _ in range(2))
    times = ("wall_time", "cpu_time", "planning_time")
    assert {name: value for name, value in first.items() if name not in times} == {
        name: value for name, value in again.items() if name not in times
    }


def test_the_true_robot_has_what_the_controller_knows_a_share_of(
    robot: RobotParameters,
) -> None:
    perturbation = {
        "belt": 200.0,
        "belt_damping": 0.1,
        "passive": 2e-3,
        "passive_modelled": 0.5,
        "coulomb": 0.04,
        "coulomb_modelled": 0.75,
        "tilt": 0.1,
        "geometry_signs": 2e-4,
    }
    true = built_robot(
        robot, perturbation, np.random.default_rng(0), np.random.default_rng(1)
    )
    leg, model = true.left, controller_model(robot, perturbation)
    assert (
        leg.transmission_stiffness,
        leg.passive_coulomb_friction,
        true.pin_coulomb_friction,
    ) == (200.0, 2e-3, 2e-3)
    assert leg.transmission_damping == pytest.approx(
        0.2 * math.sqrt(200.0 * leg.rotor_inertia)
    )
    assert np.hypot(*true.gravity) == pytest.approx(9.81 * math.sin(0.1))
    off = [leg.proximal_length - 0.09 for leg in true.legs] + [
        leg.distal_length - 0.09 for leg in true.legs
    ]
    off += (
        np.subtract([leg.axis for leg in true.legs], [leg.axis for leg in robot.legs])
        .ravel()
        .tolist()
    )
    assert (
        np.abs(off) == pytest.approx(np.full(8, 2e-4), abs=1e-15)
        and 0 < np.sum(np.array(off) > 0.0) < 8
    )
    assert model == robot.replace(
        **{
            "pin_coulomb_friction": 1e-3,
            **{
                f"{side}.{key}": value
                for side in robot.sides
                for key, value in (
                    ("passive_coulomb_friction", 1e-3),
                    ("coulomb_friction", 0.03),
                )
            },
        }
    )
    assert (
        controller_model(
            robot, perturbation | {"belt_modelled": 1.0}
        ).right.transmission_stiffness
        == 200.0
    )


@pytest.mark.parametrize(
    "perturbation",
    [
        {"belt": 1000.0},
        {"coulomb": 0.02},
        {"passive": 1e-3},
        {"stamp_error": 1e-5},
        {"payload": 0.02, "payload_time": 0.6},
        {"push": 0.1},
        {"push": 0.1, "push_across": 1.0},
        {"cogging": 2e-3, "cogging_periods": 30.0},
        {"link_encoder": 1.0, "belt": 500.0},
        {"coulomb": 0.02, "coulomb_speed": 0.05},
    ],
)
def test_a_little_of_each_changes_a_trip_and_is_crossed(
    robot: RobotParameters, place: CrossingPoint, perturbation: dict[str, float]
) -> None:
    plain, row = run(robot, place), run(robot, place, **perturbation)
    assert row["success"], row["reason"]
    assert row["max_error"] != plain["max_error"]
    assert (
        row["held_wrong"],
        row["wrong_side_time"],
        row["stopped_after_crossing"],
    ) == (False, 0.0, False)


def test_a_blow_is_a_force_for_a_while_that_turns_the_robot_round(
    robot: RobotParameters,
) -> None:
    place = sample_points(robot, 8, 0, 0)[5]
    row = run(robot, place, bounce=1.0, blow=10.0, blow_duration=0.012)
    assert row["crossed"] < 2
    assert row["recognised"] is not None


def test_a_row_runs_with_a_law_and_an_estimator_of_ones_own(
    robot: RobotParameters, place: CrossingPoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[2] / "examples"))
    own = "own_estimator:Luenberger"
    row = run(robot, place, law="own_law:damped", estimator=own)
    assert row["success"], row["reason"]
