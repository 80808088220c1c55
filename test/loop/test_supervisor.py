"""Each watch trips on what it is there for, that one and no other; none trips in runs
that end well.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from closed_loop import AFTER, running

from dextar_control.contract.controller_parameters import CONTROLLER
from dextar_control.contract.errors import (
    GeometryError,
    ParameterError,
    StateError,
    TrajectoryError,
)
from dextar_control.contract.resources import node_defaults
from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.control.phases import WITHOUT_LAW, Phase
from dextar_control.control.supervisor import WATCHES
from dextar_control.planning.checks import certify
from dextar_control.planning.planner import (
    PLAN_RESIDUAL,
    Plan,
    plan_approach,
    plan_return_trip,
)
from dextar_sim.rig import ControllerInput, Rig

Seen = Callable[[ControlLoop, float, np.ndarray], np.ndarray]
# of its limit that no watch passes in a run that ends well, those with a time aside
SHARE = 0.7
SLIP = 0.05  # rad


def drive(
    robot: RobotParameters,
    plan: Plan | None,
    *,
    known: RobotParameters | None = None,
    start: Any = None,
    side: int = 1,
    seen: Seen = lambda loop, time, q_a: q_a,
    push: Callable[[float], Any] | None = None,
    swapped: bool = False,
    offset: Any = (0.0, 0.0),
    until: float = 5.0,
    settings: dict[str, Any] | None = None,
    **rig_options: Any,
) -> tuple[ControlLoop, float, dict[str, float]]:
    """A trip, or a hold, until it ends or is ended: the loop, the time, and the largest
    value over limit of each watch.

    Args:
        known: the robot as the controller knows it.
        start: where it holds without a plan, m.
        side: true sign of s.
        seen: the joints as the controller sees them, of the loop, the time and the true
            ones.
        push: force on the end effector at a time, N.
        swapped: the motors' cables are.
        offset: of the true joints over those of the start, rad.
    """
    rig = Rig(robot, plant="cartesian", **rig_options)
    loop = ControlLoop(known or robot, default_settings(**(settings or {})), 1)
    shares: dict[str, float] = {}

    def as_seen(sample: ControllerInput) -> ControllerInput:
        return sample._replace(q_a=seen(loop, sample.time, sample.q_a))

    try:
        begin = plan.trajectory.at(0.0).x if plan is not None else np.array(start)
        rig.reset_joints(loop.model.inverse_geometric_model(begin) + offset, side)
        if plan is not None:
            loop.schedule(plan.trajectory, plan.certificate)
            until = plan.trajectory.duration + AFTER
        if swapped:
            write = rig.write
            rig.write = lambda tau: write(None if tau is None else tau[::-1])  # type: ignore[method-assign]
        for sample, tau in running(loop, rig, until=until, seen=as_seen):
            if push is not None:
                rig.strike(rig.period * np.asarray(push(sample.time)))
            if loop.phase in WITHOUT_LAW:
                rig.write(tau)
                break
            for name, (value, limit) in loop.watches.items():
                if limit > 0.0:
                    share = limit / value if name == "locus" else value / limit
                    shares[name] = max(shares.get(name, 0.0), share)
    finally:
        rig.close()
    return loop, rig.time, shares


def test_every_watch_has_its_parameters_and_reasons() -> None:
    declared = {parameter.name: parameter for parameter in CONTROLLER}
    defaults = node_defaults("controller")
    for watch in WATCHES:
        assert watch.value and watch.reason
        for name in [
            *re.findall(r"\b(?!robot)\w+\.\w+", watch.limit),
            *([watch.time] if watch.time else []),
        ]:
            assert name in defaults, f"{watch.name}: {name}"
            assert (
                declared[name].description
                and declared[name].live
                and declared[name].bounds
            )
    named = {
        name for watch in WATCHES for name in (watch.limit.split()[-1], watch.time)
    }
    assert named >= {
        "watch.max_joint_jump",
        "watch.max_joint_misfit",
        "watch.joint_misfit_time",
        "watch.speed_margin",
        "watch.joint_margin",
        "torque_limit.time",
    }


@pytest.mark.parametrize(
    ("case", "built", "rig"),
    [
        ("nominal", {}, {}),
        (
            "another start of the noise",
            {},
            {"encoder_resolution": 65536, "position_noise": 2e-5, "seed": 3},
        ),
        (
            "masses",
            {
                "left.distal_mass": 0.064,
                "right.proximal_inertia": 1.2e-4,
                "end_effector_mass": 0.06,
            },
            {},
        ),
        (
            "geometry 0.2 mm",
            {"left.proximal_length": 0.0902, "right.distal_length": 0.0898},
            {},
        ),
        (
            "friction",
            {"left.coulomb_friction": 0.05, "right.coulomb_friction": 0.05},
            {},
        ),
        ("delay", {}, {"command_delay": 3e-3}),
        ("lost", {}, {"sample_loss": 0.2}),
        ("jitter", {}, {"jitter": 0.9, "sample_loss": 0.01, "command_delay": 2e-3}),
    ],
)
@pytest.mark.parametrize("estimator", ["observer", "dgm"])
def test_none_trips_in_a_run_that_ends_well(
    robot: RobotParameters,
    trip: Plan,
    slow_trip: Plan,
    case: str,
    built: dict,
    rig: dict,
    estimator: str,
) -> None:
    for plan in (trip, slow_trip) if case == "nominal" else (trip,):
        loop, _, shares = drive(
            robot.replace(**built),
            plan,
            known=robot,
            settings={"estimator": estimator},
            **rig,
        )
        assert (loop.phase, loop.tripped, loop.completed) == (
            Phase.HOLD,
            "",
            1,
        ), loop.reason
        timed = {watch.name for watch in WATCHES if watch.time}
        assert not {
            name: share
            for name, share in shares.items()
            if share > SHARE and name not in timed
        }


def test_an_estimate_out_of_the_workspace(robot: RobotParameters, trip: Plan) -> None:
    def seen(loop: ControlLoop, time: float, q_a: np.ndarray) -> np.ndarray:
        if time >= 0.1:
            loop.estimator.observer.main.x = [0.0, 0.175]  # out of the legs' reach
        return q_a

    loop, _, _ = drive(robot, trip, seen=seen)
    assert loop.tripped == "finite"
    assert loop.reason.startswith(
        "the estimate or the law gave a number that is not finite"
    )


def test_a_robot_that_is_pulled_to_the_end_of_a_legs_reach(
    robot: RobotParameters,
) -> None:
    pull = np.array(
        [22.0, 21.0]
    )  # N: where the leg is stretched nothing of the motor acts along it
    loop, _, _ = drive(
        robot,
        None,
        start=[0.0698, 0.1251],
        push=lambda time: pull * (0.1 < time < 0.15),
        until=0.5,
    )
    assert loop.tripped == "finite", loop.reason
    assert re.search(
        r"a leg was 0\.0[0-4]\d from Type 1, where its reach ends \(a plan keeps"
        r" 0\.05\)",
        loop.reason,
    ), loop.reason


def test_a_blow_that_the_gains_do_not_hold(robot: RobotParameters) -> None:
    loop, _, _ = drive(
        robot,
        None,
        start=[-0.025, 0.115],
        push=lambda time: [0.0, 250.0 if 0.0995 < time < 0.1005 else 0.0],
        settings={"feedback.natural_frequency": 15.0},
    )
    assert loop.tripped == "tracking_error", loop.reason
    assert "tracking error 0.02" in loop.reason and "the limit is 0.02 m" in loop.reason


@pytest.mark.parametrize(
    ("change", "name", "sentence"),
    [
        (
            {"max_joint_speed": 0.4},
            "joint_speed",
            "rad/s for [56] ms; the limit is 0.5 rad/s for 5 ms",
        ),
        (
            {"max_platform_speed": 0.1},
            "platform_speed",
            "m/s for [56] ms; the limit is 0.125 m/s for 5 ms",
        ),
    ],
)
def test_a_robot_faster_than_it_may_be(
    robot: RobotParameters, trip: Plan, change: dict, name: str, sentence: str
) -> None:
    loop, time, _ = drive(robot, trip, known=robot.replace(**change))
    assert loop.tripped == name, loop.reason
    assert re.search(sentence, loop.reason)


def test_a_joint_out_of_its_range(robot: RobotParameters, trip: Plan) -> None:
    first = trip.certificate.profile.q_a[0]
    limits = {"left.min_angle": first[0] - 0.02, "left.max_angle": first[0] + 0.02}
    loop, _, _ = drive(robot, trip, known=robot.replace(**limits))
    assert loop.tripped == "joint_range", loop.reason
    low, high = limits.values()
    assert re.search(
        rf"the left joint is 0.05\d rad outside its range of {low:.4g} to"
        rf" {high:.4g} rad",
        loop.reason,
    )


@pytest.mark.parametrize("estimator", ["observer", "dgm", "plain", "external"])
@pytest.mark.parametrize("slip", [SLIP, -SLIP])
@pytest.mark.parametrize("when", [0.1, 0.28, 0.34, 0.36, 0.45, 0.9])
def test_an_encoder_that_slips_is_seen_at_once(
    robot: RobotParameters, trip: Plan, estimator: str, slip: float, when: float
) -> None:
    def seen(loop: ControlLoop, now: float, q_a: np.ndarray) -> np.ndarray:
        return q_a + (np.array([slip, 0.0]) if now >= when else 0.0)

    loop, time, _ = drive(robot, trip, seen=seen, settings={"estimator": estimator})
    assert loop.tripped == "joint_jump", loop.reason
    assert time == pytest.approx(when, abs=2.5e-3)


@pytest.mark.parametrize("offset", [(-SLIP, 0.0), (0.0, SLIP)])
def test_an_estimate_that_has_lost_the_robot(
    robot: RobotParameters, offset: tuple[float, float]
) -> None:
    """The encoders are off from the start: at rest nothing shows it, near the locus the
    joints fit no estimate.

    Where it crosses decides which watch is the first to see it: an observer that takes
        it for scatter comes to the locus sooner.
    """
    settings = {
        "watch.max_tracking_error": 0.1,
        "torque_limit.peak_ratio": 1e3,
        "observer.scatter_gain": 0.0,
    }
    trip = plan_return_trip(
        robot,
        [-0.025, 0.115],
        [0.01, 0.06],
        2.0,
        0.2,
        point=np.array([-0.0623, 0.05102]),
    )
    loop, _, _ = drive(
        robot,
        trip,
        offset=offset,
        seen=lambda loop, time, q_a: q_a - np.array(offset),
        settings=settings,
    )
    assert loop.tripped == "estimator", loop.reason
    assert "the limit is 0.04 rad for 10 ms" in loop.reason


@pytest.mark.parametrize(
    "offset",
    [
        (SLIP, 0.0),
        (-SLIP, 0.0),
        (0.0, SLIP),
        (0.0, -SLIP),
        (SLIP, -SLIP),
        (-SLIP, SLIP),
    ],
)
@pytest.mark.parametrize("estimator", ["observer", "dgm"])
def test_encoders_that_are_off_from_the_start_end_the_motion(
    robot: RobotParameters, slow_trip: Plan, offset: tuple[float, float], estimator: str
) -> None:
    """By 50 mrad with the direct model; of one encoder the observer, which allows for a
    wrong geometry, takes twice that.
    """
    off = np.array(offset) * (2.0 if estimator == "observer" and 0.0 in offset else 1.0)
    loop, _, _ = drive(
        robot,
        slow_trip,
        offset=off,
        seen=lambda loop, time, q_a: q_a - off,
        settings={"estimator": estimator},
    )
    assert loop.phase is Phase.SAFE_STOP and loop.tripped


def test_a_robot_that_is_on_the_other_side_than_told(
    robot: RobotParameters, trip: Plan, slow_trip: Plan
) -> None:
    for plan in (trip, slow_trip):
        loop, _, _ = drive(robot, plan, side=-1)
        assert loop.phase is Phase.SAFE_STOP and loop.tripped


def test_joints_or_cables_in_the_wrong_order(
    robot: RobotParameters, trip: Plan
) -> None:
    with pytest.raises(StateError, match="are not in working mode"):
        drive(robot, trip, seen=lambda loop, time, q_a: q_a[::-1])
    loop, time, _ = drive(robot, trip, swapped=True)
    assert loop.tripped in ("saturation", "tracking_error")  # whichever is sooner
    assert time < trip.certificate.crossing_times[0]


@pytest.mark.parametrize("where", [[-0.012, 0.1], [-0.025, 0.115]])
def test_a_robot_that_is_pushed_towards_the_locus(
    robot: RobotParameters, where: list[float]
) -> None:
    """By a hand of 1.5 N against soft gains, while it holds."""
    loop, _, _ = drive(
        robot,
        None,
        start=where,
        push=lambda time: [0.0, -1.5] if time > 0.1 else [0.0, 0.0],
        settings={"feedback.natural_frequency": 8.0, "watch.max_tracking_error": 0.1},
    )
    assert loop.tripped == "locus", loop.reason
    assert (
        "the robot is at |s| = 0.1" in loop.reason
        and "without a planned crossing; the limit is 0.15" in loop.reason
    )


def test_a_robot_that_is_blocked_asks_for_torque_until_it_is_stopped(
    robot: RobotParameters, trip: Plan
) -> None:
    """What blocks it is taken for a torque that the model lacks, which the limit leaves
    beside 2.9 times the plan's.
    """
    stuck = ControlLoop(robot, default_settings(), 1).model.inverse_geometric_model(
        trip.trajectory.at(0.0).x
    )
    loop, _, shares = drive(robot, trip, seen=lambda loop, time, q_a: stuck)
    assert loop.tripped == "saturation", loop.reason
    assert re.search(
        r"torque 0.300 N m for 6[01] ms; the limit is 0.300 N m for 60 ms", loop.reason
    )


def test_a_loop_that_swings(robot: RobotParameters, trip: Plan) -> None:
    """Gains far too high for encoders that noisy."""
    settings = {
        "estimator": "plain",
        "feedback.natural_frequency": 200.0,
        "joint_filter.bandwidth": 1500.0,
    }
    loop, _, _ = drive(
        robot, None, start=[-0.025, 0.115], position_noise=1e-4, settings=settings
    )
    assert loop.tripped == "torque_rate", loop.reason
    assert "the limit is 120 N m/s for 20 ms" in loop.reason


def test_a_plan_out_of_a_joint_s_range_is_refused_with_the_joint_and_the_range(
    robot: RobotParameters, trip: Plan
) -> None:
    """Here, by the planner and by the approach: a range that ends 0.1 rad before the
    trip's largest angle.
    """
    most = float(trip.certificate.profile.q_a[:, 1].max())
    narrow = robot.replace(
        **{"right.max_angle": most - 0.1, "right.min_angle": most - 3.0}
    )
    words = (
        rf"the right joint's angle is {most:.4g} rad, 0.1 rad outside its range; the"
        rf" limits are .* and {most - 0.1:.4g} rad"
    )
    with pytest.raises(TrajectoryError, match=words):
        certify(narrow, trip.trajectory, max_residual=PLAN_RESIDUAL)
    with pytest.raises(TrajectoryError, match=words):
        ControlLoop(narrow, default_settings(), 1).check(trip.trajectory)
    start, goal = (
        trip.trajectory.at(0.0).x,
        trip.trajectory.at(0.5 * trip.trajectory.duration).x,
    )
    with pytest.raises((TrajectoryError, GeometryError), match="the right joint"):
        plan_return_trip(narrow, start, goal, 0.33, 0.2)
    wide = robot.replace(
        **{"right.max_angle": most + 0.01, "right.min_angle": most - 3.0}
    )
    assert certify(
        wide, trip.trajectory, max_residual=PLAN_RESIDUAL
    ).crossing_times.tolist() == pytest.approx(trip.certificate.crossing_times.tolist())


def test_a_joint_s_range_is_one_on_a_circle(robot: RobotParameters, trip: Plan) -> None:
    """The same range a turn farther, and the whole turn of the shipped robots, refuse
    nothing.
    """
    q_a = trip.certificate.profile.q_a
    for turn in (-2.0 * np.pi, 0.0, 2.0 * np.pi):
        limits = {
            "left.min_angle": q_a[:, 0].min() - 0.01 + turn,
            "left.max_angle": q_a[:, 0].max() + 0.01 + turn,
        }
        certify(robot.replace(**limits), trip.trajectory, max_residual=PLAN_RESIDUAL)
    with pytest.raises(
        ParameterError,
        match=r"robot.left.min_angle = 1.0 with max_angle = 0.5; it must be smaller",
    ):
        robot.replace(**{"left.min_angle": 1.0, "left.max_angle": 0.5})


def test_an_approach_goes_round_what_a_joint_cannot_reach(
    robot: RobotParameters,
) -> None:
    start, goal = np.array([-0.025, 0.115]), np.array([0.03, 0.125])
    line = plan_approach(robot, start, goal, 0.2)
    profile = certify(robot, line, max_residual=PLAN_RESIDUAL).profile
    least = profile.q_a[:, 0].min() - 0.002
    with pytest.raises(GeometryError, match=r"goal .* takes the left joint to"):
        plan_approach(
            robot.replace(
                **{"left.min_angle": profile.q_a[-1, 0] + 0.01, "left.max_angle": 3.0}
            ),
            start,
            goal,
            0.2,
        )
    plan_approach(
        robot.replace(**{"left.min_angle": least, "left.max_angle": 3.0}),
        start,
        goal,
        0.2,
    )
