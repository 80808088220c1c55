"""The whole closed loop in a plain ``for``: planner, estimator, law against the
PyBullet plant.
"""

from __future__ import annotations

import math

import closed_loop
import numpy as np
import pytest
from closed_loop import Bare, Run, advance, running, s_of

from dextar_control.contract.errors import ParameterError, StateError, TrajectoryError
from dextar_control.contract.resources import config_file
from dextar_control.contract.robot import RobotParameters, load_robot
from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.control.phases import Phase
from dextar_control.control.verdicts import Verdict
from dextar_control.model.model import Model
from dextar_control.planning.planner import (
    MIN_END_S,
    Plan,
    plan_approach,
    plan_return_trip,
)
from dextar_control.planning.trajectory import Trajectory
from dextar_sim.plant import Plant

RESOLUTION = 2**17
MAX_ERROR = 0.3e-3  # m, true, throughout
MAX_END_ERROR = 0.1e-3  # m, true, at the end
TORQUE_RATIO = 1.3  # of the planned peak
TORQUE_RATIO_NEAR = 1.0  # of the planned peak, within |s| < 0.1
NEAR = 0.1
REST_SPEED = 0.1  # rad/s: the joints of a robot that was braked
AFTER = 0.2  # s of holding after the trip


def drive(
    robot: RobotParameters,
    plan: Plan,
    law: str = "consistent",
    resolution: int = RESOLUTION,
    **settings: object,
) -> Run:
    """A trip behind encoders."""
    settings["law"] = law
    return closed_loop.drive(
        robot, plan, settings=settings, encoder_resolution=resolution
    )


@pytest.fixture(scope="module")
def fast_run(robot: RobotParameters, trip: Plan) -> Run:
    return drive(robot, trip)


def test_the_fast_trip_meets_its_bars(
    robot: RobotParameters, trip: Plan, fast_run: Run
) -> None:
    peak = np.abs(fast_run.tau).max(axis=1)
    assert fast_run.loop.phase == Phase.HOLD
    assert fast_run.loop.completed == 1
    assert fast_run.error.max() <= MAX_ERROR
    assert fast_run.error[-1] <= MAX_END_ERROR
    assert peak.max() <= TORQUE_RATIO * trip.certificate.peak_torque
    assert (
        peak[np.abs(fast_run.s) < NEAR].max()
        <= TORQUE_RATIO_NEAR * trip.certificate.peak_torque
    )
    assert fast_run.loop.saturated_ticks == 0


def test_the_true_robot_changes_sides_twice(
    robot: RobotParameters, fast_run: Run
) -> None:
    signs = np.sign([s_of(Model.of(robot), x) for x in fast_run.x])
    assert signs[0] == signs[-1] == 1.0
    assert np.count_nonzero(np.diff(signs)) == 2


def test_the_slow_trip_meets_the_same_error_bars(
    robot: RobotParameters, slow_trip: Plan
) -> None:
    run = drive(robot, slow_trip)
    assert run.loop.phase == Phase.HOLD
    assert run.error.max() <= MAX_ERROR
    assert run.error[-1] <= MAX_END_ERROR


def test_the_enforcement_makes_no_torque_step(trip: Plan, fast_run: Run) -> None:
    steps = np.abs(np.diff(fast_run.tau, axis=0)).max(axis=1)
    engaged = np.abs(fast_run.s[1:]) < 0.2
    planned = np.abs(np.diff(trip.certificate.profile.torque, axis=0)).max()
    assert steps[engaged].max() < planned + 0.05 * trip.certificate.peak_torque


def test_the_papers_projection_steps_where_ours_does_not(
    robot: RobotParameters, trip: Plan, fast_run: Run
) -> None:
    paper = drive(robot, trip, "projected", **{"near_locus.replace_below_abs_s": 0.2})

    def step(run: Run) -> float:
        near = (np.abs(run.s[1:]) < 0.25) & (np.abs(run.s[1:]) > 0.15)
        return float(np.abs(np.diff(run.tau, axis=0)).max(axis=1)[near].max())

    assert step(paper) > 3.0 * step(fast_run)


def test_the_classic_law_asks_for_too_much_near_the_locus(
    robot: RobotParameters, trip: Plan, fast_run: Run
) -> None:
    run = drive(
        robot, trip, "classic", resolution=2**15, **{"observer.scatter_gain": 0.0}
    )  # an estimate with the noise of its encoders
    peak = np.abs(run.tau).max(axis=1)
    limit = default_settings().torque_limit.peak_ratio * trip.certificate.peak_torque
    assert run.loop.saturated_ticks > fast_run.loop.saturated_ticks == 0
    assert abs(run.s[int(np.argmax(peak >= limit))]) < 0.1


def test_the_classic_law_with_the_plain_direct_model_saturates_at_each_crossing(
    robot: RobotParameters, trip: Plan
) -> None:
    run = drive(robot, trip, "classic", estimator="plain")
    limit = default_settings().torque_limit.peak_ratio * trip.certificate.peak_torque
    at_limit = (
        np.flatnonzero((np.abs(run.tau).max(axis=1) >= limit) & (np.abs(run.s) < 0.1))
        * 1e-3
    )
    for crossing in trip.certificate.crossing_times:
        assert np.abs(at_limit - crossing).min() < 0.02


def test_the_direct_model_alone_amplifies_what_the_hold_does_not(
    robot: RobotParameters, trip: Plan
) -> None:
    held = drive(robot, trip, resolution=2**13, estimator="dgm")
    bare = drive(robot, trip, resolution=2**13, estimator="plain")

    def step(run: Run) -> float:
        return float(
            np.abs(np.diff(run.tau, axis=0)).max(axis=1)[np.abs(run.s[1:]) < NEAR].max()
        )

    assert held.loop.phase == Phase.HOLD
    assert held.error.max() < 1e-3
    assert step(bare) > 20.0 * step(held)


@pytest.mark.parametrize("estimator", ["observer", "dgm"])
@pytest.mark.parametrize("seed", range(3))
def test_a_robot_built_a_tenth_of_a_millimetre_off_still_crosses_with(
    robot: RobotParameters, trip: Plan, seed: int, estimator: str
) -> None:
    """The plant's lengths and base differ from the model's by up to 0.1 mm; it starts
    where the encoders say.
    """
    generator = np.random.default_rng(seed)
    lengths = {
        f"{side}.{link}_length": 0.09 + generator.uniform(-1e-4, 1e-4)
        for side in ("left", "right")
        for link in ("proximal", "distal")
    }
    built = robot.replace(
        base_distance=robot.base_distance + generator.uniform(-1e-4, 1e-4), **lengths
    )
    plant, loop, worst = (
        Plant(built),
        ControlLoop(robot, default_settings(estimator=estimator), 1),
        0.0,
    )
    plant.reset_joints(loop.model.inverse_geometric_model(trip.trajectory.at(0.0).x), 1)
    loop.accept(trip.trajectory)
    for _ in running(loop, Bare(plant), count=1460):
        error = float(np.hypot(*(loop.tick.x_ref - plant.state().x)))
        worst = max(worst, error)
    plant.close()
    assert loop.completed == 1
    assert worst < 5e-3
    assert error < 1e-3


def test_phases_follow_the_crossings(fast_run: Run) -> None:
    seen = [
        phase
        for index, phase in enumerate(fast_run.phases)
        if index == 0 or phase != fast_run.phases[index - 1]
    ]
    assert seen == [
        Phase.TRACK,
        Phase.CROSSING,
        Phase.TRACK,
        Phase.CROSSING,
        Phase.TRACK,
        Phase.HOLD,
    ]
    assert [passed.verdict for passed in fast_run.loop.passed] == [Verdict.CROSSED] * 2


@pytest.mark.parametrize("law", ["projected", "multi_model", "joint_space"])
def test_each_law_crosses_with_the_exact_model(
    robot: RobotParameters, trip: Plan, law: str
) -> None:
    run = drive(robot, trip, law)
    assert run.loop.completed == 1
    assert run.error.max() < MAX_ERROR


def test_an_unknown_law_or_estimator_is_refused_with_the_known_ones() -> None:
    with pytest.raises(
        ParameterError,
        match="law = 'magic'; it must be one of classic, projected, consistent",
    ):
        default_settings(law="magic")
    with pytest.raises(
        ParameterError,
        match="estimator = 'eyes'; it must be one of plain, dgm, observer, external",
    ):
        default_settings(estimator="eyes")


def test_an_approach_has_its_own_phase(robot: RobotParameters) -> None:
    start, goal = np.array([0.01, 0.12]), np.array([0.0, 0.115])
    line = plan_approach(robot, start, goal, 0.2)
    loop = ControlLoop(robot, default_settings(), 1)
    loop.accept(line)
    loop.step(0.0, loop.model.inverse_geometric_model(start))
    assert loop.phase == Phase.APPROACH


def _holding(robot: RobotParameters, trip: Plan) -> tuple[ControlLoop, np.ndarray]:
    loop = ControlLoop(robot, default_settings(), 1)
    q_a = loop.model.inverse_geometric_model(trip.trajectory.at(0.0).x)
    loop.step(0.0, q_a)
    return loop, q_a


def test_bad_states_are_refused_and_change_nothing(
    robot: RobotParameters, trip: Plan
) -> None:
    loop, q_a = _holding(robot, trip)
    with pytest.raises(StateError, match="not two finite numbers"):
        loop.step(0.001, np.array([np.nan, 1.0]))
    with pytest.raises(StateError, match="not after the last one"):
        loop.step(0.0, q_a)
    assert np.abs(loop.step(0.001, q_a)).max() < 1e-6


def test_a_trajectory_elsewhere_or_while_moving_is_refused(
    robot: RobotParameters, trip: Plan
) -> None:
    loop, q_a = _holding(robot, trip)
    elsewhere = plan_approach(robot, [0.0, 0.12], [-0.025, 0.115], 0.1)
    with pytest.raises(
        TrajectoryError, match=r"m from the robot; the limit is 0.001 m"
    ):
        loop.accept(elsewhere)
    loop.accept(trip.trajectory)
    loop.step(0.001, q_a)
    with pytest.raises(
        TrajectoryError, match="in phase HOLD only; the controller is in TRACK"
    ):
        loop.accept(trip.trajectory)


def test_a_fault_and_a_disabled_loop_give_no_torque_until_reset(
    robot: RobotParameters, trip: Plan
) -> None:
    loop, q_a = _holding(robot, trip)
    loop.fault("tried")
    assert (loop.step(0.001, q_a + 1e-3) == 0.0).all()
    loop.enable()
    assert loop.phase == Phase.FAULT
    loop.reset()
    assert (loop.step(0.002, q_a + 1e-3) == 0.0).all()
    loop.enable()
    loop.step(0.003, q_a)
    assert loop.phase == Phase.HOLD


def test_a_stop_brakes_away_from_the_locus_and_finishes_a_crossing(
    robot: RobotParameters, trip: Plan
) -> None:
    for when, expected in (
        (0.25, Phase.SAFE_STOP),
        (float(trip.certificate.crossing_times[0]), Phase.CROSSING),
    ):
        plant = Plant(robot)
        plant.reset(trip.trajectory.at(0.0).x)
        loop = ControlLoop(robot, default_settings(), 1)
        loop.accept(trip.trajectory)
        for tick, (_, tau) in enumerate(running(loop, Bare(plant), count=3000)):
            if tick == round(when * 1000):
                loop.stop()
                assert loop.phase == expected
            assert np.abs(tau).max() <= robot.max_torque
        assert loop.phase == Phase.SAFE_STOP
        assert (tau == 0.0).all()
        assert np.abs(plant.state().q_a_dot).max() < 0.1
        plant.close()


def _drive_until(
    robot: RobotParameters, trip: Plan, time: float, estimator: str = "observer"
) -> tuple[Plant, ControlLoop]:
    plant, loop = (
        Plant(robot),
        ControlLoop(robot, default_settings(estimator=estimator), 1),
    )
    plant.reset(trip.trajectory.at(0.0).x)
    loop.accept(trip.trajectory)
    advance(loop, Bare(plant), until=time)
    return plant, loop


def _put(plant: Plant, loop: ControlLoop, x: np.ndarray) -> None:
    """The robot is taken to x, and rests there for 0.1 s."""
    plant.reset(x)
    for _ in range(100):
        loop.step(loop.tick.time + 1e-3, plant.state().q_a)


def _beyond(trip: Plan, s: float) -> np.ndarray:
    """A point of the trip behind its first crossing, at that |s| or a little more,
    m.
    """
    profile, crossing = trip.certificate.profile, trip.certificate.crossing_times[0]
    return profile.x[np.argmax((profile.time > crossing) & (np.abs(profile.s) >= s))]


@pytest.mark.parametrize("how", ["fault", "disable"])
def test_after_a_fault_on_the_far_side_the_estimate_is_still_the_robot(
    robot: RobotParameters, trip: Plan, how: str
) -> None:
    plant, loop = _drive_until(robot, trip, 0.65)
    loop.fault("tried") if how == "fault" else loop.disable()
    advance(loop, Bare(plant), count=50)
    assert loop.tick.assembly_mode == -1
    np.testing.assert_allclose(loop.tick.x_hat, plant.state().x, atol=1e-4)
    loop.reset()
    loop.enable()
    tau = advance(loop, Bare(plant), count=200)
    assert loop.phase == Phase.HOLD
    assert np.abs(tau).max() < 0.02
    np.testing.assert_allclose(loop.tick.x_ref, plant.state().x, atol=5e-4)
    plant.close()


def test_a_fault_on_the_locus_asks_for_the_assembly_mode(
    robot: RobotParameters, trip: Plan
) -> None:
    """What it advises can be followed, step by step, by a robot that rests where it is
    put.
    """
    plant, loop = _drive_until(robot, trip, float(trip.certificate.crossing_times[0]))
    loop.fault("tried")
    with pytest.raises(
        StateError,
        match=r"move it by hand to \|s\| >= 0.20, set assembly_mode .*, then reset",
    ):
        loop.reset()
    with pytest.raises(
        StateError, match=r"move it by hand to \|s\| >= 0.20, then set assembly_mode"
    ):
        loop.set_assembly_mode(-1)
    _put(plant, loop, _beyond(trip, 0.21))
    with pytest.raises(
        StateError,
        match=(
            "cannot tell on which side .* set assembly_mode to the side .*, then reset"
        ),
    ):
        loop.reset()
    loop.set_assembly_mode(-1)
    loop.reset()
    loop.enable()
    state = plant.state()
    loop.step(loop.tick.time + 1e-3, state.q_a)
    assert loop.phase is Phase.HOLD and loop.mode_known
    plant.close()


@pytest.mark.parametrize("impulse", [0.04, 0.06, 0.08, 0.12])
def test_an_impulse_against_the_motion_is_judged_as_it_was(
    robot: RobotParameters, trip: Plan, impulse: float
) -> None:
    """Struck 12 ms before the crossing the robot crosses late, or turns back; the
    joints alone look alike.
    """
    plant, loop = _drive_until(
        robot, trip, float(trip.certificate.crossing_times[0]) - 0.012
    )
    velocity = plant.state().x_dot
    plant.apply_impulse(-impulse * velocity / np.hypot(*velocity))
    taus, judged, lacking = [], 0.0, 0.0
    for _, tau in running(loop, Bare(plant), count=2500):
        taus.append(tau)
        lacking = max(lacking, loop.lacking)
        if loop.passed[0].verdict is not Verdict.UNDECIDED and judged == 0.0:
            judged = s_of(loop.model, plant.state().x)
    wrong = Verdict.BOUNCED if judged < 0.0 else Verdict.CROSSED
    assert loop.passed[0].verdict is not wrong
    assert (
        loop.passed[0].verdict is not Verdict.UNDECIDED or loop.phase == Phase.SAFE_STOP
    )
    assert (
        np.abs(taus).max()
        <= default_settings().torque_limit.peak_ratio * trip.certificate.peak_torque
        + lacking
        + 1e-12
    )
    assert lacking < 0.01
    if loop.passed[0].verdict is Verdict.BOUNCED:
        assert loop.phase == Phase.SAFE_STOP
        assert "bounced" in loop.reason
        assert (taus[-1] == 0.0).all()
        assert np.abs(plant.state().q_a_dot).max() < 0.5
    plant.close()


def test_a_held_robot_that_is_pushed_away_is_stopped(
    robot: RobotParameters, trip: Plan
) -> None:
    loop, q_a = _holding(robot, trip)
    for tick in range(1, 400):
        tau = loop.step(1e-3 * tick, q_a + np.array([0.0, 1e-3 * tick]))
        if loop.phase == Phase.SAFE_STOP:
            break
    assert "torque 0.300 N m for" in loop.reason
    assert np.abs(tau).max() <= robot.max_torque


def test_a_start_that_has_passed_moves_nothing(
    robot: RobotParameters, trip: Plan
) -> None:
    loop = ControlLoop(robot, default_settings(), 1)
    loop.accept(trip.trajectory, start=-0.2)
    tau = loop.step(0.0, loop.model.inverse_geometric_model(trip.trajectory.at(0.0).x))
    assert loop.phase == Phase.HOLD
    assert "starts at -0.200000 s" in loop.refusal
    assert np.abs(tau).max() < 1e-6


def test_a_stop_asked_for_while_crossing_does_not_outlive_its_trip(
    robot: RobotParameters, trip: Plan
) -> None:
    plant, loop = _drive_until(robot, trip, float(trip.certificate.crossing_times[0]))
    loop.stop("first trip")
    loop.fault("tried")
    _put(plant, loop, trip.trajectory.at(0.0).x)
    loop.set_assembly_mode(1)  # nobody saw how the robot came here
    loop.reset()
    loop.enable()
    now, fresh = loop.tick.time, plant.state()
    loop.step(now + 1e-3, fresh.q_a)
    loop.accept(trip.trajectory)
    loop.step(now + 2e-3, fresh.q_a)
    assert loop.phase == Phase.TRACK
    plant.close()


def test_an_end_near_the_locus_is_refused(robot: RobotParameters, trip: Plan) -> None:
    loop, _ = _holding(robot, trip)
    start = trip.trajectory.at(0.0).x
    near = np.array([-0.005, 0.095])
    law = np.array([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
    coefficients = np.outer(law / 0.5 ** np.arange(8), near - start)
    coefficients[0] += start
    with pytest.raises(
        TrajectoryError,
        match=(
            r"the trajectory ends at \|s\| = 0\.\d+ of the Type 2 .*; the limit is 0.4:"
            r" serve"
        ),
    ):
        loop.accept(Trajectory(np.array([0.0, 0.5]), np.zeros(1), coefficients[None]))


def test_the_planners_ends_are_the_estimators(robot: RobotParameters) -> None:
    settings = default_settings()
    assert settings.dgm.hold_below_abs_s + settings.dgm.fade_width_abs_s <= MIN_END_S


def test_a_transition_that_reaches_the_locus_is_refused(robot: RobotParameters) -> None:
    with pytest.raises(ParameterError, match="near_locus.fade_abs_s must be >= 0.15"):
        ControlLoop(
            robot,
            default_settings(
                **{"near_locus.fade_abs_s": 0.1, "near_locus.fade_width_abs_s": 0.3}
            ),
            1,
        )


def test_the_mock_up_crosses_too() -> None:
    mockup = load_robot(config_file("mockup.yaml"))
    plan = plan_return_trip(
        mockup, np.array([-0.025, 0.115]), np.array([0.01, 0.06]), 0.33, 0.1
    )
    run = drive(mockup, plan)
    assert run.loop.completed == 1
    assert run.error.max() <= MAX_ERROR


def test_lost_samples_do_not_end_the_trip(robot: RobotParameters, trip: Plan) -> None:
    run = closed_loop.drive(robot, trip, sample_loss=0.2, seed=4)
    assert len(run.time) < 850.0 * run.time[-1]
    assert run.loop.phase == Phase.HOLD
    assert run.error.max() < 1e-3


def test_another_working_mode_is_refused(robot: RobotParameters, trip: Plan) -> None:
    other = Model.of(robot.replace(working_mode=(1, 1)))
    grid = [
        np.array([x, y]) for x in (-0.05, 0.0, 0.05) for y in (-0.1, -0.05, 0.05, 0.1)
    ]
    q_a = other.inverse_geometric_model(next(x for x in grid if s_of(other, x) > 0.1))
    loop = ControlLoop(robot, default_settings(), 1)
    with pytest.raises(StateError, match="not in working mode"):
        loop.step(0.0, q_a)
    with pytest.raises(ParameterError, match="assembly_mode = 0"):
        ControlLoop(robot, default_settings(), 0)


@pytest.mark.parametrize("estimator", ["observer", "dgm"])
def test_a_robot_let_go_on_the_locus_is_held_only_on_a_side_that_was_told(
    robot: RobotParameters, trip: Plan, estimator: str
) -> None:
    plant, loop = _drive_until(
        robot, trip, float(trip.certificate.crossing_times[0]), estimator
    )
    loop.disable()
    _put(plant, loop, _beyond(trip, 0.26))
    assert not loop.mode_known
    with pytest.raises(
        StateError, match="cannot tell on which side .* set assembly_mode"
    ):
        loop.enable()
    loop.set_assembly_mode(-1)
    assert loop.passed[0].verdict is Verdict.UNDECIDED, (
        "what somebody tells is no verdict of the estimator"
    )
    loop.step(loop.tick.time + 1e-3, plant.state().q_a)
    assert loop.passed[0].verdict is Verdict.UNDECIDED
    loop.enable()
    assert loop.phase is Phase.HOLD
    plant.close()


def test_a_robot_whose_estimate_leaves_the_workspace_is_braked_and_of_no_known_side(
    robot: RobotParameters, trip: Plan
) -> None:
    plant = Plant(robot)
    plant.reset(trip.trajectory.at(0.0).x)
    loop = ControlLoop(robot, default_settings(), 1)
    state = plant.state()
    loop.step(state.time, state.q_a)
    plant.apply_impulse([0.05, 0.08])
    plant.step([0.0, 0.0])
    loop.estimator.observer.main.x = [0.0, 0.175]  # out of the legs' reach
    for _, tau in running(loop, Bare(plant), count=500):
        assert np.isfinite(tau).all()
        assert loop.phase is Phase.SAFE_STOP and not loop.mode_known
    assert np.abs(plant.state().q_a_dot).max() < REST_SPEED
    plant.close()


def test_no_motion_begins_while_the_side_is_not_known(
    robot: RobotParameters, trip: Plan
) -> None:
    """Asked for then, and lost between asking and the start."""
    loop, q_a = _holding(robot, trip)
    certificate = loop.check(trip.trajectory)
    loop.schedule(trip.trajectory, certificate, start=0.05)
    loop.step(0.001, q_a)
    loop.estimator.estimate.confidence = 0.5
    with pytest.raises(
        TrajectoryError,
        match="cannot tell on which side .* disable, set assembly_mode .*, enable",
    ):
        loop.accept(trip.trajectory)
    loop.step(0.051, q_a)
    assert loop.phase is Phase.HOLD and "cannot tell on which side" in loop.refusal
    loop.disable()
    loop.step(0.052, q_a)
    loop.set_assembly_mode(1)
    loop.enable()
    loop.step(0.053, q_a)
    loop.accept(trip.trajectory)
    loop.step(0.054, q_a)
    assert loop.phase is Phase.TRACK


def test_a_moving_robot_is_not_enabled(robot: RobotParameters, trip: Plan) -> None:
    plant = Plant(robot)
    plant.reset(trip.trajectory.at(0.0).x)
    loop = ControlLoop(robot, default_settings(), 1, enabled=False)
    plant.apply_impulse([0.02, 0.04])
    advance(loop, Bare(plant), count=30)
    with pytest.raises(
        StateError,
        match=(
            r"a joint moves at .* rad/s; the limit is 0.5 rad/s: bring it to rest, then"
            r" enable"
        ),
    ):
        loop.enable()
    plant.close()


def test_a_robot_with_encoder_offsets_and_turned_axes_moves_as_one_without(
    robot: RobotParameters,
) -> None:
    """The base turned by an angle: the joints are the same but for it, in a platform
    frame turned alike.
    """
    angle, offset = 0.3, np.array([0.02, -0.03])
    turn = np.array(
        [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    )
    axes = {
        f"{side}.axis": tuple(turn @ leg.axis)
        for side, leg in zip(robot.sides, robot.legs, strict=True)
    }
    offsets = {
        f"{side}.encoder_offset": value
        for side, value in zip(robot.sides, offset, strict=True)
    }
    turned = robot.replace(**axes, **offsets)
    loops = [ControlLoop(each, default_settings(), 1) for each in (robot, turned)]
    x = np.array([-0.025, 0.115])
    q_a = loops[0].model.place(x).q_a
    for step in range(20):
        moved = q_a + 1e-4 * step
        first = loops[0].step(1e-3 * step, moved)
        second = loops[1].step(1e-3 * step, moved + angle + offset)
        np.testing.assert_allclose(second, first, atol=1e-9)
        np.testing.assert_allclose(
            loops[1].tick.x_hat, turn @ loops[0].tick.x_hat, atol=1e-10
        )
