"""The estimator ``external``: late positions, wrong ones, none; and what they tell of
crossed against bounced.
"""

from __future__ import annotations

import numpy as np
import pytest
from closed_loop import Run, drive, s_of, turn_round

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.settings import Settings, default_settings
from dextar_control.control.phases import WITHOUT_LAW, Phase
from dextar_control.control.verdicts import Verdict
from dextar_control.estimation.estimate import ExternalPosition
from dextar_control.estimation.estimator import make_estimator
from dextar_control.estimation.external import ExternalEstimator
from dextar_control.estimation.out_of_sequence import LENGTH, PositionOutcome
from dextar_control.estimation.records import REFERENCE
from dextar_control.model.model import Model
from dextar_control.planning.planner import Plan
from dextar_control.symbols.record import Layout

EXACT = 1e-9  # m, rad, and their rates: the same arithmetic in another order of arrival
PERIOD = 1e-3  # s
CAMERA = {"pose_rate": 100.0, "pose_delay": 0.02, "pose_noise": 2e-4}
NOMINAL_ERROR = 0.2e-3  # m, true: the camera's own standard deviation
BETTER = 0.9  # of the observer's error, which learns much of a wrong geometry by itself
SIGHTS = 0.03 + 1e-6  # s: the delay and one period of the camera
# s: the delay, two positions, and the way out of the zone where nothing can be told
RECOGNITION = 0.05
NO_REFERENCE = Layout("reference", 2, REFERENCE).make()


@pytest.fixture(scope="module")
def settings() -> Settings:
    return default_settings(estimator="external")


@pytest.fixture(scope="module")
def recorded(robot: RobotParameters, trip: Plan) -> Run:
    """The first crossing with 2^13 encoders: the noise of the joints matters."""
    return drive(robot, trip, plant="cartesian", until=0.5, encoder_resolution=2**13)


def _replayed(
    robot: RobotParameters,
    settings: Settings,
    run: Run,
    samples: int,
    delay: int,
    last: int,
) -> ExternalEstimator:
    """The recorded joints and torques with a position of each tenth sample up to
    ``last``, ``delay`` samples late.
    """
    estimator = ExternalEstimator(Model.of(robot), settings, robot.min_type1_distance)
    estimator.start(run.x_ref[0], run.q_a[0], 1)
    noise = np.random.default_rng(3).normal(0.0, 3e-4, run.x.shape)
    tau = np.zeros(2)
    for row in range(samples):
        seen = row - delay
        if 0 <= seen <= last and seen % 10 == 0:
            estimator.take_pose(
                ExternalPosition(run.time[seen], run.x[seen] + noise[seen]),
                run.time[row],
            )
        estimator.track(PERIOD, run.q_a[row], tau, NO_REFERENCE, 0.0, 0.0)
        tau = run.tau[row]
    return estimator


@pytest.mark.parametrize("delay", [1, 20, 100])
def test_a_late_position_gives_what_one_in_time_gives(
    robot: RobotParameters, settings: Settings, recorded: Run, delay: int
) -> None:
    """Forty positions, three of them behind the crossing; compared as of when the last
    of the late ones is there.
    """
    last = 390
    assert recorded.side[0] != recorded.side[last - 20]
    late = _replayed(robot, settings, recorded, last + delay + 1, delay, last)
    in_time = _replayed(robot, settings, recorded, last + delay + 1, 0, last)
    assert late.outcomes == in_time.outcomes == {PositionOutcome.TAKEN: 40}
    np.testing.assert_allclose(
        late.estimate.numbers, in_time.estimate.numbers, rtol=0.0, atol=EXACT
    )
    np.testing.assert_allclose(
        late.observer.main.numbers, in_time.observer.main.numbers, rtol=0.0, atol=EXACT
    )


def test_a_position_between_two_samples_is_taken_between_them(
    robot: RobotParameters, settings: Settings, recorded: Run
) -> None:
    """Against the filter's own steps, called by hand in the order in which things were
    true.
    """
    ours = _replayed(robot, settings, recorded, 300, 0, -1)
    hand = _replayed(robot, settings, recorded, 300, 0, -1)
    observer, state, noise = hand.observer, hand.observer.main, hand.observer.noise
    early, tau, tau_next = 0.4 * PERIOD, recorded.tau[299], recorded.tau[300]
    seen = recorded.x[299] + np.array([2e-4, -3e-4])
    ours.track(PERIOD, recorded.q_a[300], tau, NO_REFERENCE, 0.0, 0.0)
    ours.take_pose(
        ExternalPosition(recorded.time[299] + early, seen), recorded.time[301]
    )
    ours.track(PERIOD, recorded.q_a[301], tau_next, NO_REFERENCE, 0.0, 0.0)
    observer.predict(state, noise, tau, early)
    observer.correct_position(state, seen, settings.external.position_deviation)
    observer.predict(state, noise, tau, PERIOD - early)
    observer.correct(state, noise, recorded.q_a[300], PERIOD - early)
    observer.predict(state, noise, tau_next, PERIOD)
    observer.correct(state, noise, recorded.q_a[301], PERIOD)
    np.testing.assert_allclose(ours.observer.main.x, state.x, rtol=0.0, atol=EXACT)
    np.testing.assert_allclose(
        ours.observer.main.numbers, state.numbers, rtol=0.0, atol=EXACT
    )


@pytest.mark.parametrize("plant", ["pybullet", "cartesian"])
def test_it_crosses_and_knows_it_sooner_than_the_joints_tell(
    robot: RobotParameters, trip: Plan, plant: str
) -> None:
    run = drive(robot, trip, plant=plant, settings={"estimator": "external"}, **CAMERA)
    blind = drive(robot, trip, plant=plant)
    assert run.loop.phase is Phase.HOLD
    assert [passed.verdict for passed in run.loop.passed] == [Verdict.CROSSED] * 2
    assert run.error.max() < NOMINAL_ERROR
    assert all(
        ours.time < joints.time
        for ours, joints in zip(run.loop.passed, blind.loop.passed, strict=True)
    )
    assert run.notes == [""]


@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_geometry_is_made_up_for(
    robot: RobotParameters, trip: Plan, seed: int
) -> None:
    """Lengths up to 0.2 mm off: through both crossings, and held for a second, it is
    nearer to the truth than the joints.
    """
    off = np.random.default_rng(seed).uniform(-2e-4, 2e-4, 4)
    names = (
        "left.proximal_length",
        "left.distal_length",
        "right.proximal_length",
        "right.distal_length",
    )
    built = robot.replace(
        **{name: 0.09 + shift for name, shift in zip(names, off, strict=True)}
    )
    end = trip.trajectory.duration + 1.0
    seen = drive(
        robot,
        trip,
        built,
        plant="cartesian",
        seed=seed,
        until=end,
        settings={"estimator": "external"},
        **CAMERA,
    )
    blind = drive(robot, trip, built, plant="cartesian", seed=seed, until=end)
    assert seen.loop.completed == 1
    assert seen.error.max() < BETTER * blind.error.max()
    assert seen.estimate_error.max() < BETTER * blind.estimate_error.max()
    assert seen.estimate_error[-1] < BETTER * blind.estimate_error[-1]


@pytest.mark.parametrize("plant", ["pybullet", "cartesian"])
@pytest.mark.parametrize(
    ("moment", "restitution"), [(-0.01, 0.7), (-0.006, 0.9), (0.0, 0.7), (0.006, 1.0)]
)
def test_a_bounce_is_seen_and_ends_safely(
    robot: RobotParameters, trip: Plan, plant: str, moment: float, restitution: float
) -> None:
    when = round(1000.0 * (trip.certificate.crossing_times[0] + moment)) / 1000.0
    blow = turn_round(robot, trip, when, restitution)
    run = drive(
        robot,
        trip,
        plant=plant,
        blow=blow,
        settings={"estimator": "external"},
        **CAMERA,
    )
    assert run.side[-1] == 1.0
    assert run.loop.passed[0].verdict is Verdict.BOUNCED
    assert run.loop.phase in WITHOUT_LAW
    wrong = (run.mode != run.side) & (run.time > when + RECOGNITION)
    assert not wrong.any()
    sure_and_wrong = (run.mode != run.side) & (
        run.confidence >= run.loop.settings.mode_check.confidence
    )
    assert np.count_nonzero(sure_and_wrong & (run.time > when + SIGHTS)) == 0
    assert run.estimate_error[-1] < NOMINAL_ERROR


@pytest.mark.parametrize(
    ("moment", "restitution"), [(-0.008, 0.5), (0.0, 0.0), (0.004, 0.5)]
)
def test_a_blow_that_neither_the_believed_motion_nor_its_image_explains_is_found(
    robot: RobotParameters, trip: Plan, moment: float, restitution: float
) -> None:
    """Near the locus the joints show little of it."""
    when = round(1000.0 * (trip.certificate.crossing_times[0] + moment)) / 1000.0
    blow = turn_round(robot, trip, when, restitution)
    seen = drive(
        robot,
        trip,
        plant="cartesian",
        blow=blow,
        until=0.45,
        settings={"estimator": "external"},
        **CAMERA,
    )
    blind = drive(robot, trip, plant="cartesian", blow=blow, until=0.45)
    later = seen.time > when + RECOGNITION
    assert seen.loop.estimator.outcomes[PositionOutcome.STRUCK] >= 1
    assert seen.estimate_error[later].max() < BETTER * blind.estimate_error[later].max()


def test_when_the_positions_stop_the_joints_serve_and_it_says_so(
    robot: RobotParameters, trip: Plan
) -> None:
    run = drive(
        robot,
        trip,
        plant="cartesian",
        settings={"estimator": "external"},
        pose_outages=[(0.25, 0.55)],
        **CAMERA,
    )
    assert run.loop.phase is Phase.HOLD
    assert run.error.max() < NOMINAL_ERROR
    assert run.loop.estimator.outages == 1
    assert (
        run.notes[1]
        == "no external position for 0.101 s (limit 0.1 s): the encoders serve alone"
    )
    assert run.notes[2].startswith("external positions are back after 0.3")
    assert run.notes[3] == run.notes[-1] == ""


def test_no_camera_at_all_is_the_observer(robot: RobotParameters, trip: Plan) -> None:
    run = drive(robot, trip, plant="cartesian", settings={"estimator": "external"})
    blind = drive(robot, trip, plant="cartesian")
    np.testing.assert_array_equal(run.x_hat, blind.x_hat)
    np.testing.assert_array_equal(run.confidence, blind.confidence)
    assert run.loop.estimator.outages == 1


def test_a_bumped_camera_is_refused_however_often_it_repeats_itself(
    robot: RobotParameters, trip: Plan
) -> None:
    run = drive(
        robot,
        trip,
        plant="cartesian",
        settings={"estimator": "external"},
        camera_off=0.01,
        **CAMERA,
    )
    assert run.loop.phase is Phase.HOLD
    assert run.error.max() < NOMINAL_ERROR
    outcomes = run.loop.estimator.outcomes
    assert outcomes[PositionOutcome.TAKEN] == outcomes[PositionOutcome.SWAPPED] == 0
    assert outcomes[PositionOutcome.JUMP] > 100
    assert "mm from the estimate" in run.notes[1]
    assert "the limit is 6" in run.notes[1]


class Standing:
    """A robot at rest, looked at."""

    def __init__(
        self, robot: RobotParameters, settings: Settings, mode: int = 1
    ) -> None:
        self.x = np.array([-0.025, 0.115])
        self.model = Model.of(robot)
        self.q_a = self.model.inverse_geometric_model(self.x)
        self.estimator = ExternalEstimator(
            Model.of(robot), settings, robot.min_type1_distance
        )
        self.estimator.start(self.model.close(self.q_a, mode), self.q_a, mode)
        self.time = 100.0
        self.wait(50)

    def wait(self, samples: int) -> None:
        for _ in range(samples):
            self.time += PERIOD
            self.estimator.coast(PERIOD, self.q_a, np.zeros(2))

    def look(self, age: float, x: np.ndarray | None = None) -> str:
        self.time += PERIOD
        self.estimator.take_pose(
            ExternalPosition(self.time - age, self.x if x is None else x), self.time
        )
        self.estimator.coast(PERIOD, self.q_a, np.zeros(2))
        return self.estimator.note


@pytest.mark.parametrize(
    ("age", "x", "fate", "text"),
    [
        (
            -0.002,
            None,
            PositionOutcome.FUTURE,
            (
                "external position of 100.053000 s is 2.000 ms ahead of the state at"
                " 100.051000 s"
            ),
        ),
        (0.01, [np.nan, 0.1], PositionOutcome.NOT_FINITE, "is not finite"),
        (np.inf, None, PositionOutcome.NOT_FINITE, "is not finite"),
        (0.01, [0.02, 0.11], PositionOutcome.JUMP, "mm from the estimate, "),
    ],
)
def test_a_position_that_cannot_be_is_refused_with_its_numbers(
    robot: RobotParameters,
    settings: Settings,
    age: float,
    x: list[float] | None,
    fate: PositionOutcome,
    text: str,
) -> None:
    standing = Standing(robot, settings)
    before = standing.estimator.estimate.numbers.copy()
    assert text in standing.look(age, None if x is None else np.array(x))
    assert standing.estimator.outcomes == {fate: 1}
    np.testing.assert_allclose(standing.estimator.estimate.numbers, before, atol=1e-9)
    assert standing.look(0.001) == ""
    assert standing.estimator.outcomes[PositionOutcome.TAKEN] == 1


def test_a_position_out_of_order_is_refused(
    robot: RobotParameters, settings: Settings
) -> None:
    standing = Standing(robot, settings)
    assert standing.look(0.010) == ""
    assert (
        standing.look(0.012)
        == "external position of 100.040000 s is not after the last one, of"
        " 100.041000 s"
    )
    assert standing.look(0.012) == ""
    assert standing.estimator.outcomes == {
        PositionOutcome.TAKEN: 2,
        PositionOutcome.OUT_OF_ORDER: 1,
    }


def test_a_position_older_than_what_is_kept_is_refused(
    robot: RobotParameters, settings: Settings
) -> None:
    standing = Standing(robot, settings)
    standing.wait(LENGTH)
    assert "is 170.0 ms old; the last 159.0 ms are kept" in standing.look(0.17)
    assert standing.estimator.outcomes == {PositionOutcome.TOO_OLD: 1}
    assert standing.look(0.15) == "external positions are back after 0.210 s"
    assert standing.estimator.outcomes[PositionOutcome.TAKEN] == 1


def test_a_position_from_before_the_first_sample_is_passed_over_in_silence(
    robot: RobotParameters, settings: Settings
) -> None:
    standing = Standing(robot, settings)
    assert standing.look(0.08) == ""
    assert standing.estimator.outcomes == {PositionOutcome.EARLY: 1}


def test_the_same_complaint_is_made_once_in_a_row(
    robot: RobotParameters, settings: Settings
) -> None:
    standing = Standing(robot, settings)
    first = standing.look(0.01, standing.x + 0.02)
    assert standing.look(0.01, standing.x + 0.03) == first
    assert standing.look(0.01) == ""
    assert standing.look(0.01, standing.x + 0.03) not in ("", first)


def test_an_assembly_mode_told_wrong_is_put_right(
    robot: RobotParameters, settings: Settings
) -> None:
    standing = Standing(robot, settings, mode=-1)
    assert standing.estimator.estimate.assembly_mode == -1.0
    standing.look(0.02)
    assert not standing.estimator.mode_known
    note = standing.look(0.012)
    assert "fits the mirror image of the estimate" in note
    assert note.endswith("the assembly mode is +1")
    assert standing.estimator.estimate.assembly_mode == 1.0
    assert standing.estimator.estimate.confidence >= settings.mode_check.confidence
    assert standing.estimator.swaps == 1
    np.testing.assert_allclose(standing.estimator.estimate.x, standing.x, atol=1e-5)


def test_one_blunder_at_the_mirror_image_moves_nothing(
    robot: RobotParameters, settings: Settings
) -> None:
    standing = Standing(robot, settings)
    image = standing.model.close(standing.q_a, -1)
    assert s_of(standing.model, image) < 0.0
    for _ in range(5):
        standing.look(0.0)
    standing.look(0.0, image)
    assert standing.estimator.outcomes == {
        PositionOutcome.TAKEN: 5,
        PositionOutcome.AGAINST: 1,
    }
    assert standing.estimator.estimate.assembly_mode == 1.0
    standing.look(0.0)
    assert standing.estimator.mode_known


@pytest.mark.parametrize("name", ["position_deviation", "position_gate", "timeout"])
def test_settings_that_cannot_be_are_refused(robot: RobotParameters, name: str) -> None:
    with pytest.raises(
        ParameterError, match=rf"external\.{name} = 0.0; it must be > 0"
    ):
        make_estimator(
            Model.of(robot),
            default_settings(estimator="external", **{f"external.{name}": 0.0}),
            robot.min_type1_distance,
        )
