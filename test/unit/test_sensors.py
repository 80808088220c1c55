"""Encoder, transport delay and drive-side watchdog."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dextar_control.contract.errors import ParameterError
from dextar_sim.sensors import (
    CommandDelay,
    CommandHold,
    Encoder,
    PoseSensor,
    TorqueCommand,
)

PERIOD = 1.0e-3
MILLISECOND = 1_000_000
ROUNDING = 1.0e-12
FILTER_ERROR = 0.02
"""Relative; discrete low-pass against the continuous one at 1 kHz."""


def test_exact_encoder_returns_the_position() -> None:
    position, velocity = Encoder(PERIOD).read((0.1234567, -1.0))
    assert position.tolist() == [0.1234567, -1.0]
    assert velocity.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("resolution", [1000, 131072])
def test_quantised_position_is_the_nearest_count(resolution: int) -> None:
    true = np.linspace(-4.0, 4.0, 997)
    encoder = Encoder(PERIOD, resolution=resolution)
    counts = (
        np.array([encoder.read((value, 0.0))[0][0] for value in true])
        * resolution
        / (2.0 * math.pi)
    )
    assert np.abs(counts - np.round(counts)).max() < 1.0e-8
    assert (
        np.abs(counts * 2.0 * math.pi / resolution - true).max()
        <= math.pi / resolution + ROUNDING
    )


def test_velocity_of_constant_motion_settles_at_it() -> None:
    encoder = Encoder(PERIOD, velocity_cutoff=100.0)
    for step in range(100):
        _, velocity = encoder.read((3.0 * PERIOD * step, -step * PERIOD))
    assert velocity == pytest.approx((3.0, -1.0), rel=1.0e-9)


def test_velocity_lags_by_the_cutoff_time_constant() -> None:
    """After 1 / (2 pi cutoff) the answer to a step in velocity is 1 - 1/e."""
    encoder = Encoder(PERIOD, velocity_cutoff=5.0)
    encoder.read((0.0, 0.0))
    steps = round(1.0 / (2.0 * math.pi * 5.0 * PERIOD))
    for step in range(1, steps + 1):
        _, velocity = encoder.read((PERIOD * step, 0.0))
    assert velocity[0] == pytest.approx(1.0 - math.exp(-1.0), rel=FILTER_ERROR)


def test_noise_is_repeated_by_the_seed_and_has_its_deviation() -> None:
    first, second, other = (
        Encoder(PERIOD, position_noise=1.0e-3, seed=seed) for seed in (1, 1, 2)
    )
    samples = np.array([encoder_sample(first) for _ in range(2000)])
    assert samples.tolist() == [encoder_sample(second) for _ in range(2000)]
    assert encoder_sample(other) != samples[0].tolist()
    assert samples.std() == pytest.approx(1.0e-3, rel=0.05)


def encoder_sample(encoder: Encoder) -> list[float]:
    return encoder.read((0.0, 0.0))[0].tolist()


def test_reset_forgets_the_last_sample() -> None:
    encoder = Encoder(PERIOD, velocity_cutoff=100.0)
    encoder.read((0.0, 0.0))
    encoder.read((1.0, 1.0))
    encoder.reset()
    assert encoder.read((-3.0, 0.0))[1].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("periods", [0, 1, 3])
def test_delay_hands_out_after_its_periods(periods: int) -> None:
    delay: CommandDelay[int] = CommandDelay(periods)
    assert [delay.shift(item) for item in range(6)] == [None] * periods + list(
        range(6 - periods)
    )
    delay.reset()
    assert delay.shift(9) == (None if periods else 9)


def hold_with(torque: tuple[float, float]) -> CommandHold:
    hold = CommandHold(20 * MILLISECOND, 0.3)
    assert hold.receive(TorqueCommand(0, torque))
    return hold


def test_nothing_received_is_no_torque() -> None:
    hold = CommandHold(20 * MILLISECOND, 0.3)
    assert hold.torque(0) == (0.0, 0.0)
    assert hold.trips == 0


def test_held_command_lasts_exactly_its_timeout() -> None:
    hold = hold_with((0.1, -0.2))
    assert hold.torque(20 * MILLISECOND) == (0.1, -0.2)
    assert hold.torque(20 * MILLISECOND + 1) == (0.0, 0.0)


def test_one_silence_is_one_trip_and_a_fresh_command_ends_it() -> None:
    hold = hold_with((0.1, 0.1))
    for stamp in range(21, 40):
        assert hold.torque(stamp * MILLISECOND) == (0.0, 0.0)
    assert hold.trips == 1
    hold.receive(TorqueCommand(40 * MILLISECOND, (0.2, 0.0)))
    assert hold.torque(40 * MILLISECOND) == (0.2, 0.0)
    hold.torque(61 * MILLISECOND)
    assert hold.trips == 2


def test_silence_counts_by_the_steady_clock_too_whichever_is_first() -> None:
    """The machine stalls with a command held: simulated time stands still, the drives'
    own clock does not.
    """
    hold = CommandHold(20 * MILLISECOND, 0.3)
    hold.receive(TorqueCommand(0, (0.1, -0.2), arrival=1000 * MILLISECOND))
    assert hold.torque(MILLISECOND, 1020 * MILLISECOND) == (0.1, -0.2)
    assert hold.torque(MILLISECOND, 1020 * MILLISECOND + 1) == (0.0, 0.0)
    assert hold.torque(20 * MILLISECOND + 1, 1001 * MILLISECOND) == (0.0, 0.0)
    assert hold.trips == 1
    hold.receive(TorqueCommand(2 * MILLISECOND, (0.2, 0.0), arrival=3000 * MILLISECOND))
    assert hold.torque(2 * MILLISECOND, 3001 * MILLISECOND) == (0.2, 0.0)


def test_in_lockstep_only_simulated_time_counts() -> None:
    hold = CommandHold(20 * MILLISECOND, 0.3)
    hold.receive(TorqueCommand(0, (0.1, -0.2)))
    assert hold.torque(MILLISECOND, 10**15) == (0.1, -0.2)
    hold.receive(TorqueCommand(0, (0.1, -0.2), arrival=0))
    assert hold.torque(MILLISECOND) == (0.1, -0.2)


def test_answers_to_old_states_trip_the_watchdog_too() -> None:
    hold = CommandHold(20 * MILLISECOND, 0.3)
    hold.receive(TorqueCommand(0, (0.1, 0.1)))
    assert hold.torque(100 * MILLISECOND) == (0.0, 0.0)


def test_position_alone_is_that_of_a_sample() -> None:
    sampled, plain = (
        Encoder(PERIOD, resolution=1000, position_noise=1.0e-3, seed=3)
        for _ in range(2)
    )
    for step in range(20):
        assert (
            plain.position((0.1 * step, -0.3))
            == sampled.read((0.1 * step, -0.3))[0].tolist()
        )


def look(sensor: PoseSensor, samples: range) -> dict[int, int]:
    """Sample of arrival to sample of truth, of a target that moves 1 m in each
    sample.
    """
    seen = {
        sample: sensor.sense(sample, (float(sample), -float(sample)))
        for sample in samples
    }
    for measurement in seen.values():
        assert measurement is None or measurement.x == (
            measurement.sample,
            -measurement.sample,
        )
    return {
        arrival: measurement.sample
        for arrival, measurement in seen.items()
        if measurement
    }


@pytest.mark.parametrize(
    ("rate", "exposures"),
    [
        (1000.0, list(range(12))),
        (500.0, [0, 2, 4, 6, 8, 10]),
        (300.0, [0, 4, 7, 10]),
        (0.0, []),
    ],
)
def test_camera_exposes_at_its_rate_and_answers_after_its_delay(
    rate: float, exposures: list[int]
) -> None:
    """Due at 0, 3.33, 6.67, 10 ms: at the first sample not earlier; 2.2 ms are three
    samples.
    """
    seen = look(PoseSensor(PERIOD, rate=rate, delay=2.2e-3), range(15))
    assert {arrival: truth for arrival, truth in seen.items() if truth < 12} == {
        truth + 3: truth for truth in exposures
    }


def test_camera_without_delay_answers_at_once() -> None:
    assert look(PoseSensor(PERIOD, rate=1000.0), range(100, 103)) == {
        100: 100,
        101: 101,
        102: 102,
    }


def test_camera_forgets_what_is_under_way() -> None:
    sensor = PoseSensor(PERIOD, rate=250.0, delay=3.0e-3)
    assert look(sensor, range(10)) == {3: 0, 7: 4}
    sensor.reset()
    assert look(sensor, range(10, 20)) == {13: 10, 17: 14}


def test_camera_outage_is_counted_from_the_first_sample() -> None:
    sensor = PoseSensor(PERIOD, rate=1000.0, outages=[(2.0e-3, 5.0e-3)])
    assert list(look(sensor, range(40, 48))) == [40, 41, 45, 46, 47]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_command_that_is_not_finite_is_refused_and_the_last_one_stays(
    bad: float,
) -> None:
    hold = hold_with((0.1, -0.1))
    assert not hold.receive(TorqueCommand(MILLISECOND, (bad, 0.0)))
    assert hold.refused == 1
    assert hold.torque(MILLISECOND) == (0.1, -0.1)


def test_command_saturates_and_is_counted() -> None:
    hold = hold_with((5.0, -0.1))
    assert hold.torque(0) == (0.3, -0.1)
    assert hold.saturated == 1


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: Encoder(0.0), "period"),
        (lambda: Encoder(PERIOD, resolution=-1), "resolution"),
        (lambda: Encoder(PERIOD, position_noise=math.nan), "position_noise"),
        (lambda: PoseSensor(0.0, rate=1.0), "period"),
        (lambda: PoseSensor(PERIOD, rate=-1.0), "rate"),
        (lambda: PoseSensor(PERIOD, rate=1001.0), "<= 1000 Hz"),
        (lambda: PoseSensor(PERIOD, delay=math.nan), "delay"),
        (lambda: PoseSensor(PERIOD, noise=-1.0), "noise"),
        (lambda: PoseSensor(PERIOD, dropout=1.1), "dropout"),
        (lambda: CommandDelay(-1), "delay"),
        (lambda: CommandHold(0, 0.3), "timeout"),
        (lambda: CommandHold(1, 0.0), "max_torque"),
    ],
)
def test_values_out_of_range_are_refused_by_name(make, word: str) -> None:
    with pytest.raises(ParameterError, match=word):
        make()
