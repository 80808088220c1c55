"""The rig in a plain loop: what reaches the controller, what reaches the motors, and
when.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.resources import config_file
from dextar_control.contract.robot import load_robot
from dextar_sim.rig import PLANTS, ControllerInput, Rig

DEXTAR = load_robot(config_file("dextar.yaml"))
START = (0.0, 0.105)
PERIOD = 1.0e-3
EXACT = 1.0e-12
PLANT_NAMES = list(PLANTS)


def wavy(step: int) -> tuple[float, float]:
    return 0.03 * math.sin(0.02 * step), -0.02 * math.cos(0.015 * step)


def drive(
    rig: Rig, steps: int
) -> tuple[list[ControllerInput | None], list[list[float]], list[np.ndarray]]:
    """Samples, applied torques and true positions; a lost sample gets no answer."""
    samples, applied, truth = [], [], []
    for step in range(steps):
        samples.append(rig.read())
        truth.append(rig.truth().x)
        applied.append(rig.write(None if samples[-1] is None else wavy(step)).tolist())
    return samples, applied, truth


def flat(samples: list[ControllerInput | None]) -> list[Any]:
    return [
        sample
        and (
            sample.time,
            *sample.q_a.tolist(),
            sample.pose and (sample.pose.time, *sample.pose.x.tolist()),
        )
        for sample in samples
    ]


def poses(
    samples: list[ControllerInput | None],
) -> list[tuple[float, float, np.ndarray]]:
    """(time of arrival, time of truth, x) of each delivered external measurement."""
    return [
        (sample.time, sample.pose.time, sample.pose.x)
        for sample in samples
        if sample and sample.pose
    ]


@pytest.mark.parametrize("plant", PLANT_NAMES)
def test_a_perfect_rig_is_the_plant_itself(plant: str) -> None:
    rig, bare = Rig(DEXTAR, plant=plant, encoder_resolution=0), PLANTS[plant](DEXTAR)
    rig.reset(START)
    bare.reset(START)
    samples, applied, truth = drive(rig, 100)
    for step, sample in enumerate(samples):
        state = bare.state()
        assert sample is not None
        assert (sample.time, sample.q_a.tolist(), sample.pose) == (
            state.time,
            state.q_a.tolist(),
            None,
        )
        assert truth[step].tolist() == state.x.tolist()
        assert bare.step(wavy(step)).tolist() == applied[step]
    rig.close()
    bare.close()


@pytest.mark.parametrize("plant", PLANT_NAMES)
def test_everything_at_once_repeats_from_its_seed(plant: str) -> None:
    options = dict(
        position_noise=1.0e-5,
        command_delay=2.0e-3,
        sample_loss=0.2,
        jitter=0.9,
        pose_rate=90.0,
        pose_delay=0.02,
        pose_noise=1.0e-4,
        pose_dropout=0.1,
    )
    runs = []
    rig, again, other = (
        Rig(DEXTAR, plant=plant, seed=seed, **options) for seed in (5, 5, 6)
    )
    for each in (rig, rig, again, other):
        each.reset(START)
        samples, applied, truth = drive(each, 200)
        runs.append((flat(samples), applied, [x.tolist() for x in truth]))
    assert runs[0] == runs[1] == runs[2]
    for part, (first, second) in enumerate(zip(runs[0], runs[3], strict=True)):
        assert first != second, part
    for each in (rig, again, other):
        each.close()


def test_one_flaw_does_not_change_the_chances_of_another() -> None:
    """The same samples are lost with and without noise: cases of a campaign differ by
    one thing.
    """
    lost = []
    for noise in (0.0, 1.0e-4):
        rig = Rig(
            DEXTAR, plant="cartesian", sample_loss=0.3, position_noise=noise, seed=2
        )
        rig.reset(START)
        lost.append([sample is None for sample in drive(rig, 200)[0]])
    assert lost[0] == lost[1]


def test_encoders_read_the_nearest_count() -> None:
    rig = Rig(DEXTAR, plant="cartesian", encoder_resolution=1000)
    rig.reset(START, (0.1, -0.1))
    count = 2.0 * math.pi / 1000
    for _ in range(50):
        sample = rig.read()
        assert sample is not None
        np.testing.assert_allclose(
            sample.q_a, count * np.round(rig.truth().q_a / count), atol=EXACT
        )
        rig.write((0.0, 0.0))


@pytest.mark.parametrize("plant", PLANT_NAMES)
def test_a_robot_built_otherwise_starts_where_its_encoders_say(plant: str) -> None:
    built = DEXTAR.replace(
        **{"left.distal_length": 0.0903, "right.proximal_length": 0.0898}
    )
    rig, q_a = Rig(built, plant=plant), (1.9, 1.2)
    rig.reset_joints(q_a, 1)
    sample = rig.read()
    assert sample is not None
    np.testing.assert_allclose(sample.q_a, q_a, atol=math.pi / 2**17 + EXACT)
    assert rig.time == 0.0
    rig.close()


def test_a_command_acts_whole_periods_late() -> None:
    rig = Rig(DEXTAR, plant="cartesian", command_delay=3.0e-3)
    rig.reset(START)
    applied = drive(rig, 20)[1]
    assert applied == [[0.0, 0.0]] * 3 + [list(wavy(step)) for step in range(17)]


def test_without_an_answer_the_last_command_goes_on_until_it_is_too_old() -> None:
    rig = Rig(DEXTAR, plant="cartesian", command_timeout=0.02, command_delay=5.0e-3)
    rig.reset(START)
    rig.write((0.01, -0.01))
    applied = [rig.write(None).tolist() for _ in range(40)]
    assert applied == [[0.0, 0.0]] * 4 + [[0.01, -0.01]] * 21 + [[0.0, 0.0]] * 15
    assert rig.trips == 1
    rig.write((0.02, 0.0))
    assert [rig.write(None).tolist() for _ in range(5)][-1] == [0.02, 0.0]


def test_lost_samples_are_none_and_as_many_as_said() -> None:
    rig = Rig(DEXTAR, plant="cartesian", sample_loss=0.2, seed=1)
    rig.reset(START)
    samples, applied, _ = drive(rig, 2000)
    lost = [step for step, sample in enumerate(samples) if sample is None]
    assert (
        len(lost)
        == rig.samples_lost
        == pytest.approx(400, abs=5.0 * math.sqrt(2000 * 0.2 * 0.8))
    )
    for step in lost:
        assert applied[step] == (applied[step - 1] if step else [0.0, 0.0])


def test_saturated_periods_are_counted_since_the_reset() -> None:
    rig = Rig(DEXTAR, plant="cartesian", max_torque=0.02)
    for _ in range(2):
        rig.reset(START)
        for step in range(10):
            assert rig.write((0.05, -0.01) if step < 4 else (0.01, 0.0)).tolist() == [
                0.02 if step < 4 else 0.01,
                -0.01 if step < 4 else 0.0,
            ]
        assert rig.saturated == 4


def test_a_command_that_is_not_finite_is_refused_and_counted() -> None:
    rig = Rig(DEXTAR, plant="cartesian")
    rig.reset(START)
    rig.write((0.01, 0.0))
    assert rig.write((math.nan, 0.0)).tolist() == [0.01, 0.0]
    assert rig.refused == 1


@pytest.mark.parametrize("plant", PLANT_NAMES)
def test_a_late_command_gives_the_share_of_its_impulse_that_is_left(plant: str) -> None:
    """From rest and without a command before, speed after one period grows with the
    substeps that remain.
    """
    full = Rig(DEXTAR, plant=plant)
    full.reset(START)
    full.write((0.02, 0.01))
    whole = np.hypot(*full.truth().x_dot)
    full.close()
    shares = []
    for seed in range(40):
        rig = Rig(DEXTAR, plant=plant, jitter=1.0, seed=seed)
        rig.reset(START)
        assert rig.write((0.02, 0.01)).tolist() == [0.02, 0.01]
        shares.append(np.hypot(*rig.truth().x_dot) / whole)
        rig.close()
    np.testing.assert_allclose(
        4.0 * np.array(shares), np.round(4.0 * np.array(shares)), atol=0.01
    )
    assert {round(4.0 * share) for share in shares} == {0, 1, 2, 3, 4}
    assert np.mean(shares) == pytest.approx(0.5, abs=0.15)


@pytest.mark.parametrize("plant", PLANT_NAMES)
def test_a_strike_throws_the_end_effector_the_way_it_points(plant: str) -> None:
    rig = Rig(DEXTAR, plant=plant)
    rig.reset(START)
    rig.strike((0.0, -0.02))
    rig.write((0.0, 0.0))
    assert rig.truth().x_dot[1] < -0.05
    before = rig.truth().x_dot
    rig.write((0.0, 0.0))
    assert math.dist(rig.truth().x_dot, before) < 0.02
    rig.close()


@pytest.mark.parametrize("loss", [0.0, 0.5])
def test_an_external_pose_was_true_at_its_time_and_comes_once_after_its_delay(
    loss: float,
) -> None:
    rig = Rig(
        DEXTAR,
        plant="cartesian",
        pose_rate=80.0,
        pose_delay=0.0153,
        sample_loss=loss,
        seed=3,
    )
    rig.reset(START, (0.1, -0.1))
    samples, _, truth = drive(rig, 500)
    delivered = poses(samples)
    stamps = [stamp for _, stamp, _ in delivered]
    assert stamps == sorted(set(stamps))
    for arrival, stamp, x in delivered:
        assert x.tolist() == truth[round(stamp / PERIOD)].tolist()
        late = arrival - stamp - 0.016
        assert abs(late) < EXACT if not loss else late > -EXACT
    if not loss:
        np.testing.assert_allclose(
            stamps, np.ceil(np.arange(len(stamps)) * 12.5 - 1.0e-9) * PERIOD, atol=EXACT
        )
        assert len(stamps) == 39


def test_external_noise_dropout_and_outage_are_as_said() -> None:
    rig = Rig(
        DEXTAR,
        plant="cartesian",
        pose_rate=1000.0,
        pose_noise=1.0e-4,
        pose_dropout=0.25,
        pose_outages=[(1.0, 1.5)],
        seed=4,
    )
    rig.reset(START)
    samples, _, truth = drive(rig, 4000)
    delivered = poses(samples)
    assert not [stamp for _, stamp, _ in delivered if 1.0 <= stamp < 1.5]
    assert len(delivered) == pytest.approx(
        0.75 * 3500, abs=5.0 * math.sqrt(3500 * 0.25 * 0.75)
    )
    errors = np.array([x - truth[round(stamp / PERIOD)] for _, stamp, x in delivered])
    assert errors.std() == pytest.approx(1.0e-4, rel=0.05)
    assert abs(errors.mean()) < 1.0e-5


def test_without_a_rate_there_is_no_external_pose() -> None:
    rig = Rig(DEXTAR, plant="cartesian", pose_delay=0.01, pose_noise=1.0e-3)
    rig.reset(START)
    assert not poses(drive(rig, 100)[0])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            {"plant": "gazebo"},
            "plant = 'gazebo'; it must be one of pybullet, cartesian",
        ),
        ({"sample_loss": 1.5}, r"sample_loss = 1.5; it must lie in \[0, 1\]"),
        ({"jitter": -0.1}, r"jitter = -0.1; it must lie in \[0, 1\]"),
        ({"encoder_resolution": -1}, "encoder resolution = -1; it must be >= 0"),
        ({"position_noise": math.nan}, "encoder position_noise = nan"),
        ({"command_delay": -1.0e-3}, "command delay of -1 periods"),
        ({"command_timeout": 0.0}, "command timeout of 0 ns"),
        ({"max_torque": 0.0}, "drive max_torque = 0.0 N m"),
        ({"substeps": 0}, "substeps = 0; it must be >= 1"),
        ({"pose_rate": 2000.0}, "pose rate = 2000.0 Hz; it must be <= 1000 Hz"),
        ({"pose_delay": -0.1}, "pose delay = -0.1; it must be >= 0"),
        ({"pose_noise": math.inf}, "pose noise = inf"),
        ({"pose_dropout": 2.0}, r"pose dropout = 2.0; it must lie in \[0, 1\]"),
        ({"pose_outages": [(0.2, 0.1)]}, "pose outage from 0.2 to 0.1 s"),
        ({"seed": -1}, "seed = -1; it must be >= 0"),
    ],
)
def test_values_out_of_range_are_refused_by_name(
    options: dict[str, Any], words: str
) -> None:
    with pytest.raises(ParameterError, match=words):
        Rig(DEXTAR, **({"plant": "cartesian"} | options))
