"""The observer: its process, its honesty about its errors, blows, a wrong geometry,
crossed against bounced.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from closed_loop import Blow, Run, drive, s_of, state_of, turn_round
from mechanics import integrate
from oracle import Oracle
from scipy.stats import chi2

from dextar_control import estimation
from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.settings import default_settings
from dextar_control.control.phases import WITHOUT_LAW, Phase
from dextar_control.control.verdicts import Verdict
from dextar_control.estimation.belief import Belief
from dextar_control.estimation.observer import REST_SPEED, Observer
from dextar_control.estimation.observing import ObserverEstimator
from dextar_control.model.model import Model
from dextar_control.planning.locus import Family, LocusPoint, sample_locus
from dextar_control.planning.planner import Plan, robot_at
from dextar_sim.cartesian import CartesianPlant

PERIOD = 1e-3  # s
STEP_ERROR = (
    8e-6,
    4e-4,
)  # m, m/s after 20 ms: the process takes the acceleration in the middle of each 1 ms
CROSSING_SPEED = 0.4  # m/s along the gradient of s
RUNS, SAMPLES = 24, 200
# of the chi-square bounds, on each side: the seeds are fixed, a sound filter fails one
# in thousands
LEVEL = 1e-4
LINEAR = {
    "observer.bias_deviation": 1e-3,
    "observer.disturbance_deviation": 5e-3,
}  # where what the covariance leaves out of the motion is small
RECOVERY = 0.02  # s after a blow
SMALL = 0.1e-3  # m
# m, after a blow on a robot at rest: a wrong geometry would give the same joints
HIDDEN = 0.4e-3
HELD, SETTLED = 20.0, 1.0  # s of holding, and after which it is looked at
NOISE = 2e-5  # rad of the encoder, less than half a fine count
# of the error at rest before: b is all that is learned, and eight parameters are not
# two angles
LEARNED = 0.7


def _observer(
    robot: RobotParameters, x: np.ndarray, x_dot: np.ndarray, **settings: float
) -> Observer:
    """With the default settings but those; its main filter is at a place with a
    velocity.
    """
    observer = ObserverEstimator(
        Model.of(robot), default_settings(**settings), robot.min_type1_distance
    ).observer
    observer.begin(x, REST_SPEED)
    observer.main.x_dot = x_dot
    return observer


def _through(
    robot: RobotParameters,
) -> Iterator[tuple[RobotParameters, LocusPoint, np.ndarray, np.ndarray]]:
    """A place and a velocity 10 ms before each of some locus points of both
    families.
    """
    for point in sample_locus(robot, 16, 5, folded=6):
        x_dot = CROSSING_SPEED * point.gradient / np.hypot(*point.gradient)
        yield robot_at(robot, point), point, point.x - 0.01 * x_dot, x_dot


def test_the_process_is_the_mechanism_through_both_families(
    robot: RobotParameters,
) -> None:
    """Against link bodies and multipliers integrated by scipy; the direct model does
    not exist where links are folded.
    """
    tau, families, crossed = np.array([0.05, -0.03]), set(), 0
    for here, point, x, x_dot in _through(robot):
        plant, model, observer = (
            CartesianPlant(here),
            Model.of(here),
            _observer(here, x, x_dot),
        )
        truth = plant.reset(x, x_dot)
        for _ in range(20):
            observer.predict(observer.main, observer.noise, tau, PERIOD)
        x_true, x_dot_true = integrate(here, truth, 0.02, lambda time: tau)
        np.testing.assert_allclose(
            observer.main.x, x_true, rtol=0.0, atol=STEP_ERROR[0]
        )
        np.testing.assert_allclose(
            observer.main.x_dot, x_dot_true, rtol=0.0, atol=STEP_ERROR[1]
        )
        families.add(point.family)
        crossed += s_of(model, x) * s_of(model, x_true) < 0.0
    assert families == set(Family)
    assert crossed == 16


def test_correcting_on_the_locus_is_regular_and_keeps_the_covariance_positive(
    robot: RobotParameters,
) -> None:
    for here, point, x, x_dot in _through(robot):
        observer = _observer(here, x, x_dot)
        state = observer.main
        state.x = point.x
        before = point.t_s @ state.covariance[0:2, 0:2] @ point.t_s
        observer.correct(
            state,
            observer.noise,
            Model.of(here).inverse_geometric_model(point.x),
            PERIOD,
        )
        assert np.isfinite(state.numbers).all()
        assert np.linalg.eigvalsh(state.covariance).min() > 0.0
        np.testing.assert_allclose(state.x, point.x, atol=1e-12)
        after = point.t_s @ state.covariance[0:2, 0:2] @ point.t_s
        assert after <= before * (1.0 + 1e-9)


def test_the_direct_model_is_called_to_mirror_and_to_begin_again_only() -> None:
    """By the source: compiled code cannot be watched."""
    folder = Path(estimation.__file__).parent
    callers = set()
    for name in ("filters.py", "observer.py", "out_of_sequence.py", "belief.py"):
        for function in ast.walk(
            ast.parse((folder / name).read_text(encoding="utf-8"))
        ):
            if isinstance(function, ast.FunctionDef):
                nodes = list(ast.walk(function))
                names = {node.id for node in nodes if isinstance(node, ast.Name)}
                names |= {
                    node.attr for node in nodes if isinstance(node, ast.Attribute)
                }
                callers |= (
                    {function.name}
                    if names
                    & {"direct_geometric_model", "direct_model", "mirror_image"}
                    else set()
                )
    assert callers == {
        "mirror",
        "begin_again",
        "direct_model",
    }  # the last one is what begin_again and a told side call


def _random_runs(
    robot: RobotParameters, trip: Plan, first: float
) -> tuple[np.ndarray, np.ndarray]:
    """Squared normalised errors (RUNS, SAMPLES) of state and innovation, where the
    truth has the noise that was told.

    The truth moves by the oracle engine's forward dynamics under the plan's torque from
    ``first`` on, so that it passes the locus where the plan does.
    """
    generator, oracle, model = np.random.default_rng(11), Oracle(robot), Model.of(robot)
    profile = trip.certificate.profile
    errors, innovations = np.zeros((RUNS, SAMPLES)), np.zeros((RUNS, SAMPLES))

    def rate(y: np.ndarray, tau: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [
                y[2:],
                oracle.forward(model.inverse_geometric_model(y[:2]), y[:2], y[2:], tau),
            ]
        )

    for run in range(RUNS):
        point = trip.trajectory.at(first)
        observer = _observer(robot, point.x, point.x_dot, **LINEAR)
        state, noise = observer.main, observer.noise
        off = generator.multivariate_normal(np.zeros(8), state.covariance)
        y, b, d = (
            np.concatenate([point.x, point.x_dot]) + off[:4],
            off[4:6].copy(),
            off[6:].copy(),
        )
        for k in range(SAMPLES):
            time = first + (k + 0.5) * PERIOD
            tau = np.array(
                [np.interp(time, profile.time, profile.torque[:, i]) for i in range(2)]
            )
            true = tau + d + generator.normal(0.0, noise.torque, 2)
            k1 = rate(y, true)
            k2 = rate(y + 0.5 * PERIOD * k1, true)
            k3 = rate(y + 0.5 * PERIOD * k2, true)
            y = y + PERIOD / 6.0 * (
                k1 + 2.0 * k2 + 2.0 * k3 + rate(y + PERIOD * k3, true)
            )
            y[2:] += PERIOD * generator.normal(0.0, noise.acceleration, 2)
            speed = np.abs(state_of(model, y[:2], y[2:]).q_a_dot)
            b += np.sqrt(PERIOD * speed) * generator.normal(0.0, noise.bias_walk, 2)
            d += np.sqrt(PERIOD) * generator.normal(0.0, noise.disturbance_walk, 2)
            q_meas = (
                model.inverse_geometric_model(y[:2])
                + b
                + generator.normal(0.0, noise.encoder, 2)
            )
            observer.predict(state, noise, tau, PERIOD)
            innovations[run, k], _ = observer.innovate(state, noise, q_meas)
            error = np.concatenate([y, b, d]) - np.concatenate(
                [state.x, state.x_dot, state.b, state.d]
            )
            errors[run, k] = error @ np.linalg.solve(state.covariance, error)
    return errors, innovations


def _within(total: float, freedom: float) -> bool:
    low, high = chi2.ppf([LEVEL, 1.0 - LEVEL], freedom)
    return bool(low <= total <= high)


@pytest.fixture(scope="module")
def monte(robot: RobotParameters, trip: Plan) -> tuple[np.ndarray, np.ndarray]:
    """From 100 ms before the first crossing to 100 ms after it."""
    return _random_runs(robot, trip, float(trip.certificate.crossing_times[0]) - 0.1)


def test_the_errors_are_as_large_as_the_covariance_says(
    monte: tuple[np.ndarray, np.ndarray],
) -> None:
    """Before the crossing, on it, and after it."""
    errors, _ = monte
    for k in (0, 50, 99, 150, 199):
        assert _within(errors[:, k].sum(), 8 * RUNS), (k, errors[:, k].mean())


def test_the_innovations_are_as_large_as_the_filter_expects(
    monte: tuple[np.ndarray, np.ndarray],
) -> None:
    _, innovations = monte
    assert _within(innovations.sum(), 2 * RUNS * SAMPLES), innovations.mean()


def test_a_wrong_geometry_is_known_better_after_a_stretched_crossing(
    robot: RobotParameters, trip: Plan
) -> None:
    """Each length up to 0.1 mm off: the joints alone cannot tell it at rest, the
    crossing can.
    """
    before, after = [], []
    for seed in range(8):
        off = np.random.default_rng(seed).uniform(-1e-4, 1e-4, 4)
        names = (
            "left.proximal_length",
            "left.distal_length",
            "right.proximal_length",
            "right.distal_length",
        )
        built = robot.replace(
            **{name: 0.09 + shift for name, shift in zip(names, off, strict=True)}
        )
        run = drive(robot, trip, built, plant="cartesian", seed=seed)
        assert run.loop.completed == 1
        before.append(run.estimate_error[50])
        after.append(run.estimate_error[-1])
    assert np.sqrt(np.mean(np.square(after))) < LEARNED * np.sqrt(
        np.mean(np.square(before))
    )


@pytest.mark.parametrize(("resolution", "limit"), [(2**17, 0.1e-3), (2**13, 0.4e-3)])
def test_a_robot_that_is_held_stays_where_it_is(
    robot: RobotParameters, trip: Plan, resolution: int, limit: float
) -> None:
    """A count of the coarse encoder is 0.07 mm of a link's end; what is thought of the
    geometry must not follow the counts.
    """
    run = drive(
        robot,
        trip,
        plant="cartesian",
        until=trip.trajectory.duration + HELD,
        encoder_resolution=resolution,
        position_noise=NOISE,
    )
    held = run.time > trip.trajectory.duration + SETTLED
    assert run.loop.phase is Phase.HOLD
    assert np.ptp(run.x[held], axis=0).max() < limit
    assert run.error[held].max() < limit


@pytest.fixture(scope="module", params=["pybullet", "cartesian"])
def nominal(request: pytest.FixtureRequest, robot: RobotParameters, trip: Plan) -> Run:
    return drive(robot, trip, plant=request.param)


def test_a_crossing_is_known_for_one(nominal: Run) -> None:
    sure = nominal.loop.settings.mode_check.confidence
    assert nominal.loop.phase is Phase.HOLD
    assert [passed.verdict for passed in nominal.loop.passed] == [Verdict.CROSSED] * 2
    assert all(passed.confidence >= sure for passed in nominal.loop.passed)
    assert not ((nominal.mode != nominal.side) & (nominal.confidence >= sure)).any()
    assert nominal.loop.estimator.swaps == 0


@pytest.mark.parametrize("plant", ["pybullet", "cartesian"])
@pytest.mark.parametrize("moment", [-0.006, 0.0, 0.004])
def test_a_robot_that_is_turned_round_is_known_for_one(
    robot: RobotParameters, trip: Plan, plant: str, moment: float
) -> None:
    when = round(1000.0 * (trip.certificate.crossing_times[0] + moment)) / 1000.0
    run = drive(robot, trip, plant=plant, blow=turn_round(robot, trip, when, 0.8))
    assert run.side[-1] == 1.0
    assert run.loop.passed[0].verdict is Verdict.BOUNCED
    assert run.loop.phase in WITHOUT_LAW
    assert run.mode[-1] == 1.0
    assert run.estimate_error[-1] < 1e-3


@pytest.mark.parametrize("coulomb", [0.02, 0.05])
def test_a_friction_that_nobody_modelled_makes_it_unsure_not_wrong(
    robot: RobotParameters, trip: Plan, coulomb: float
) -> None:
    built = robot.replace(
        **{"left.coulomb_friction": coulomb, "right.coulomb_friction": coulomb}
    )
    run = drive(robot, trip, built, plant="cartesian")
    assert Verdict.BOUNCED not in [passed.verdict for passed in run.loop.passed]
    wrong = (run.mode != run.side) & (
        run.confidence >= run.loop.settings.mode_check.confidence
    )
    assert not wrong.any()


def test_the_test_of_two_filters_does_not_care_which_is_which() -> None:
    """The log-odds of the exchanged likelihoods are the negative ones."""
    generator = np.random.default_rng(0)
    one, other = Belief(), Belief()
    for _ in range(30):
        same, image, spread_same, spread_image = generator.exponential(
            [2.0, 30.0, 1.0, 1.0]
        )
        one.weigh(same, spread_same, image, spread_image, 2)
        other.weigh(image, spread_image, same, spread_same, 2)
        assert one.log_odds == pytest.approx(-other.log_odds, abs=1e-12)
    assert one.log_odds > 0.0


def test_a_mirrored_state_has_the_same_joints_and_mirrors_back(
    robot: RobotParameters,
) -> None:
    model = Model.of(robot)
    observer = _observer(robot, np.array([-0.02, 0.11]), np.array([0.3, -0.2]))
    state, image, again = observer.main, observer.main.copy(), observer.main.copy()
    assert observer.mirror(state, image)
    assert observer.mirror(image, again)
    here, there = (state_of(model, found.x, found.x_dot) for found in (state, image))
    assert s_of(model, state.x) * s_of(model, image.x) < 0.0
    np.testing.assert_allclose(there.q_a, here.q_a, atol=1e-12)
    np.testing.assert_allclose(there.q_a_dot, here.q_a_dot, atol=1e-11)
    np.testing.assert_allclose(
        [*again.x, *again.x_dot, *again.b],
        [*state.x, *state.x_dot, *state.b],
        atol=1e-12,
    )
    np.testing.assert_allclose(again.covariance, state.covariance, atol=1e-12)


@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.0, 1.0), (-0.7, 0.7)])
def test_a_blow_away_from_the_locus_is_followed(
    robot: RobotParameters, trip: Plan, direction: tuple[float, float]
) -> None:
    """A blow of 0.06 N s at rest; the loop goes on."""
    run = drive(
        robot,
        trip,
        plant="cartesian",
        blow=Blow(0.1, 0.06 * np.array(direction)),
        until=0.18,
    )
    after = run.time >= 0.1 + RECOVERY
    assert run.error[~after].max() > 10.0 * SMALL
    assert run.estimate_error[after].max() < HIDDEN
    assert not (
        (run.mode != run.side)
        & (run.confidence >= run.loop.settings.mode_check.confidence)
    ).any()
