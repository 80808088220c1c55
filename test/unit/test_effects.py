"""What makes a simulated rig unlike its drawing, each against a closed form or an
energy.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from mechanics import energy

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.resources import config_file
from dextar_control.contract.robot import RobotParameters, load_robot
from dextar_sim.cartesian import CartesianPlant
from dextar_sim.disturbances import Disturbances
from dextar_sim.effects import Effects
from dextar_sim.plant import Plant
from dextar_sim.rig import PLANTS, Rig
from dextar_sim.sensors import Encoder
from dextar_sim.state import PlantState

DEXTAR = load_robot(config_file("dextar.yaml"))
AT = (-0.025, 0.115)
KINDS = [Plant, CartesianPlant]
Kind = type[Plant] | type[CartesianPlant]

both_plants = pytest.mark.parametrize("kind", KINDS)


def with_legs(robot: RobotParameters = DEXTAR, **numbers: float) -> RobotParameters:
    return robot.replace(
        **{
            f"{side}.{key}": value
            for side in robot.sides
            for key, value in numbers.items()
        }
    )


def run(
    plant: Plant | CartesianPlant, steps: int, torque: tuple[float, float] = (0.0, 0.0)
) -> list[PlantState]:
    states = [plant.state()]
    for _ in range(steps):
        plant.step(torque)
        states.append(plant.state())
    return states


def joint_inertia(robot: RobotParameters) -> np.ndarray:
    """(2, 2) that the motors see at AT, kg m^2, from kinetic energies of motions."""
    plant = CartesianPlant(robot)
    states = [plant.reset(AT, x_dot) for x_dot in ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0))]
    kinetic = [energy(robot, state) for state in states]
    coupling = kinetic[2] - kinetic[0] - kinetic[1]
    platform = np.array([[2.0 * kinetic[0], coupling], [coupling, 2.0 * kinetic[1]]])
    to_platform = np.linalg.inv(np.array([state.q_a_dot for state in states[:2]]).T)
    return np.asarray(to_platform.T @ platform @ to_platform)


@both_plants
def test_a_belt_resonates_where_rotors_and_links_say(kind: Kind) -> None:
    """Frequencies of a spring between each rotor and the links' joint inertia: k (1 /
    J_rotor + M^-1), undamped.
    """
    stiffness = 500.0
    plant = kind(with_legs(transmission_stiffness=stiffness), period=0.5e-3)
    mobility = np.eye(2) / DEXTAR.left.rotor_inertia + np.linalg.inv(
        joint_inertia(with_legs(rotor_inertia=0.0))
    )
    expected = np.sqrt(stiffness * np.linalg.eigvalsh(mobility)) / (2.0 * math.pi)
    plant.reset(AT)
    for _ in range(2):
        plant.step((0.02, 0.004))
    twists = []
    for _ in range(4000):
        plant.step((0.0, 0.0))
        twists.append(np.subtract(plant.encoder_angles(), plant.state().q_a))
        if len(twists) % 500 == 0:
            plant.step((0.0, 0.0))
    plant.close()
    series = np.array(twists[:500])  # 0.25 s: the robot has hardly moved
    spectrum = np.abs(np.fft.rfft(series.sum(axis=1) * np.hanning(500), 8192)) + np.abs(
        np.fft.rfft((series[:, 0] - series[:, 1]) * np.hanning(500), 8192)
    )
    frequencies = np.fft.rfftfreq(8192, 0.5e-3)
    peaks = [
        f
        for f, a, b, c in zip(
            frequencies[1:], spectrum[1:], spectrum, spectrum[2:], strict=False
        )
        if a > b and a > c and a > 0.1 * spectrum.max()
    ]
    assert np.ptp(expected) > 10.0
    for frequency in expected:
        assert min(abs(peak - frequency) for peak in peaks) < 0.02 * frequency
    assert np.abs(twists[-500:]).max() == pytest.approx(
        np.abs(series).max(), rel=0.25
    )  # nothing damps it, nothing feeds it


@both_plants
def test_a_damped_belt_comes_to_rest_under_a_torque_bent_by_it_over_its_stiffness(
    kind: Kind,
) -> None:
    """On joints that stick the motors wind the belts up; the encoder is at the motor or
    at the link.
    """
    robot = with_legs(
        transmission_stiffness=100.0, transmission_damping=0.01, coulomb_friction=0.2
    )
    for at, seen in (("motor", 1.0), ("link", 0.0)):
        plant = kind(robot, effects=Effects(encoder_at=at))
        plant.reset(AT)
        state = run(plant, 300, (0.05, -0.03))[-1]
        np.testing.assert_allclose(
            np.subtract(plant.encoder_angles(), state.q_a),
            seen * np.array([5e-4, -3e-4]),
            atol=1e-6,
        )
        plant.close()


@both_plants
def test_friction_holds_a_joint_below_its_torque_and_lets_go_above(kind: Kind) -> None:
    """A torque that rises slowly to 0.98 and stays for 2 s, then 1.02 of Coulomb's;
    smoothed friction creeps all the while.
    """
    moved = {}
    for friction in ("stick", "smooth"):
        plant = kind(with_legs(coulomb_friction=0.05), effects=Effects(friction))
        start = plant.reset(AT).q_a
        for step in range(500):
            plant.step((0.049 * step / 500, -0.049 * step / 500))
        first = run(plant, 500, (0.049, -0.049))[-1]
        last = run(plant, 1500, (0.049, -0.049))[-1]
        moved[friction] = (
            np.abs(first.q_a - start).max(),
            np.abs(last.q_a - first.q_a).max(),
        )
        if friction == "stick":
            assert np.abs(last.q_a_dot).max() < 1e-12
            freed = run(plant, 100, (0.051, -0.051))[-1]
            assert np.abs(freed.q_a - last.q_a).max() > 1e-3
        plant.close()
    assert moved["stick"][0] < 5e-5  # rad, the bristle's bending
    assert moved["stick"][1] < 1e-12
    assert moved["smooth"][1] > 0.01


@both_plants
def test_elbows_and_pin_take_the_energy_that_their_friction_says(kind: Kind) -> None:
    """Loss = integral of Coulomb's torque times the rates' sizes and of the viscous
    one, at q12, q22 and between the links.
    """
    robot = with_legs(
        passive_coulomb_friction=8e-3, passive_viscous_friction=4e-4
    ).replace(pin_coulomb_friction=9e-3, pin_viscous_friction=6e-4)
    plant = kind(robot, period=0.25e-3, substeps=1)
    plant.reset((0.02, 0.105), (0.5, -0.4))
    states = run(plant, 300)
    plant.close()
    rates = np.array([state.joints_dot for state in states])
    pin = rates[:, 2] + rates[:, 3] - rates[:, 0] - rates[:, 1]
    places = ((rates[:, 1], 8e-3, 4e-4), (rates[:, 3], 8e-3, 4e-4), (pin, 9e-3, 6e-4))
    power = sum(
        coulomb * np.abs(rate) + viscous * rate**2 for rate, coulomb, viscous in places
    )
    lost = energy(robot, states[0]) - energy(robot, states[-1])
    assert lost > 0.1 * energy(robot, states[0])
    assert lost == pytest.approx(
        0.25e-3 * float((power[1:] + power[:-1]).sum()) / 2.0, rel=0.01
    )


@both_plants
def test_elbows_that_rub_enough_hold_a_tilted_robot(kind: Kind) -> None:
    tilted = DEXTAR.replace(gravity=(0.0, -9.81 * math.sin(math.radians(2.0))))
    falls = {}
    for friction in (0.0, 0.1):
        plant = kind(with_legs(tilted, passive_coulomb_friction=friction))
        plant.reset(AT)
        states = run(plant, 400)
        falls[friction] = (
            math.dist(states[-1].x, states[0].x),
            float(np.abs(states[-1].x_dot).max()),
        )
        plant.close()
    assert falls[0.0][0] > 1e-3
    assert falls[0.1][0] < 5e-5 and falls[0.1][1] < 1e-6


@both_plants
def test_a_lag_answers_a_step_by_its_exponential(kind: Kind) -> None:
    plant = kind(DEXTAR, effects=Effects(drive_lag=5e-3))
    plant.reset(AT)
    for step in range(1, 20):
        assert plant.step((0.05, -0.02)) == pytest.approx(
            np.array([0.05, -0.02]) * (1.0 - math.exp(-0.2 * step)), rel=1e-9
        )
    plant.close()


def test_a_torque_comes_in_steps() -> None:
    plant = CartesianPlant(DEXTAR, effects=Effects(torque_step=1e-3))
    plant.reset(AT)
    assert plant.step((0.0514, -0.0196)).tolist() == pytest.approx(
        [0.051, -0.020], abs=1e-15
    )


@both_plants
@pytest.mark.parametrize("belt", [0.0, 1000.0])
def test_cogging_keeps_the_energy_of_its_potential(kind: Kind, belt: float) -> None:
    """-A sin(N angle) is the slope of -A/N cos(N angle); the belt's own energy is small
    beside it.
    """
    amplitude, periods = 0.02, 24
    robot = with_legs(transmission_stiffness=belt)
    plant = kind(robot, effects=Effects(cogging=amplitude, cogging_periods=periods))
    plant.reset(AT, (0.1, -0.1))
    totals, kinetic = [], []
    for state in run(plant, 200):
        kinetic.append(energy(robot, state))
        totals.append(
            kinetic[-1] - amplitude / periods * float(np.cos(periods * state.q_a).sum())
        )
    plant.close()
    assert np.ptp(kinetic) > 5e-4
    assert np.ptp(totals) < (0.02 if belt == 0.0 else 0.1) * np.ptp(kinetic)


@both_plants
def test_backlash_leaves_a_motor_half_of_it_to_each_side(kind: Kind) -> None:
    """Links that stick; the motors push to and fro: between both ends lie the backlash
    and the teeth's bending.
    """
    plant = kind(with_legs(coulomb_friction=0.2), effects=Effects(backlash=2e-3))
    plant.reset(AT)
    rests = []
    for torque in (0.05, -0.05, 0.05):
        state = run(plant, 1500, (torque, -torque))[-1]
        rests.append(plant.encoder_angles()[0] - state.q_a[0])
    plant.close()
    assert rests == pytest.approx(
        [1.05e-3, -1.05e-3, 1.05e-3], abs=1e-6
    )  # 0.05 N m over 1000 N m/rad


def test_an_eccentric_encoder_is_off_by_one_wave_a_turn() -> None:
    turn = np.linspace(0.0, 2.0 * math.pi, 256, endpoint=False)
    encoder = Encoder(
        1e-3, eccentricity=2e-3, homing_error=5e-3, offset=(0.1, -0.2), seed=3
    )
    off = np.array([encoder.position([angle, angle]) for angle in turn]) - turn[:, None]
    waves = np.fft.rfft(off, axis=0) / len(turn)
    assert np.abs(
        np.abs(waves[0]) - np.abs(np.array([0.1, -0.2]))
    ).tolist() == pytest.approx([5e-3, 5e-3], abs=1e-12)
    assert np.abs(2.0 * waves[1]).tolist() == pytest.approx([2e-3, 2e-3], abs=1e-12)
    assert np.abs(waves[2:]).max() < 1e-12
    again = Encoder(
        1e-3, eccentricity=2e-3, homing_error=5e-3, offset=(0.1, -0.2), seed=3
    )
    assert again.position([0.3, 0.4]) == encoder.position([0.3, 0.4])


@pytest.mark.parametrize("plant", list(PLANTS))
def test_wrong_stamps_leave_the_physics_as_it_was(plant: str) -> None:
    told, truths = [], []
    for error in (0.0, 2e-4):
        rig = Rig(DEXTAR, plant=plant, stamp_error=error, jitter=0.5, seed=5)
        rig.reset(AT)
        times = []
        for step in range(200):
            sample = rig.read()
            times.append(sample.time)
            rig.write((0.02 * math.sin(0.03 * step), 0.01))
        told.append(np.array(times))
        truths.append(rig.truth().numbers.copy())
        rig.close()
    assert truths[0].tolist() == truths[1].tolist()
    off = told[1] - told[0]
    assert np.abs(off).max() <= 2e-4 and np.std(off) == pytest.approx(
        2e-4 / math.sqrt(3.0), rel=0.15
    )
    assert np.diff(told[1]).min() > 0.0


@both_plants
@pytest.mark.parametrize("rough", [False, True])
def test_a_load_taken_up_moves_on_as_a_heavier_robot(kind: Kind, rough: bool) -> None:
    robot = DEXTAR.replace(pin_viscous_friction=1e-5) if rough else DEXTAR
    plant, heavy = kind(robot), kind(robot.replace(end_effector_mass=0.1))
    plant.reset(AT, (0.1, -0.2))
    run(plant, 20, (0.03, -0.02))
    before = plant.state()
    plant.take_up(0.05)
    heavy.reset(before.x, before.x_dot)
    for first, second in zip(
        run(plant, 50, (0.03, -0.02)), run(heavy, 50, (0.03, -0.02)), strict=True
    ):
        assert first.x == pytest.approx(second.x, abs=1e-7)
        assert first.x_dot == pytest.approx(second.x_dot, abs=1e-5)
    plant.close()
    heavy.close()


@both_plants
def test_a_push_does_the_work_of_its_force(kind: Kind) -> None:
    """From rest; kinetic energy afterwards = force times way, which a blow at the begin
    of each ms leads by a quarter of one.
    """
    force = np.array([0.3, -0.4])
    plant, pushed = (
        kind(DEXTAR),
        Disturbances(push=force.tolist(), push_time=0.01, push_duration=0.02),
    )
    states = [plant.reset(AT)]
    for step in range(32):
        pushed.before(1e-3 * step, plant)
        plant.step((0.0, 0.0))
        states.append(plant.state())
    plant.close()
    assert states[10].x.tolist() == pytest.approx(states[0].x.tolist(), abs=1e-12)
    assert energy(DEXTAR, states[30]) == pytest.approx(
        float(force @ (states[30].x - states[0].x)), rel=0.05
    )
    assert energy(DEXTAR, states[-1]) == pytest.approx(
        energy(DEXTAR, states[30]), rel=1e-3
    )


@pytest.mark.parametrize("plant", list(PLANTS))
def test_a_reset_takes_the_load_off_again(plant: str) -> None:
    rig = Rig(DEXTAR, plant=plant, payload=0.05, payload_time=5e-3)
    ends = []
    for _ in range(2):
        rig.reset(AT)
        for _ in range(20):
            rig.write((0.03, 0.0))
        ends.append(rig.truth().x.tolist())
        assert rig.plant.robot.end_effector_mass == pytest.approx(0.1)
    rig.close()
    assert ends[0] == pytest.approx(ends[1], abs=1e-12)


@pytest.mark.parametrize(
    "change, effects, said",
    [
        (
            {"transmission_stiffness": 2e4},
            {},
            "left transmission of 20000 N m/rad .* substeps must be >= ",
        ),
        (
            {"transmission_stiffness": 100.0, "rotor_inertia": 0.0},
            {},
            "rotor_inertia = 0 with a compliant transmission",
        ),
        (
            {
                "transmission_stiffness": 100.0,
                "proximal_mass": 0.0,
                "proximal_inertia": 0.0,
            },
            {},
            "a massless proximal link behind",
        ),
        (
            {"passive_coulomb_friction": 1e-3, "distal_inertia": 0.0},
            {},
            "at the left elbow acts on links without inertia",
        ),
        (
            {"passive_viscous_friction": 1e-3, "distal_inertia": 0.0},
            {},
            "at the left elbow acts on links without inertia",
        ),
        (
            {},
            {"friction": "sticky"},
            "friction = 'sticky'; it must be one of stick, smooth",
        ),
        ({}, {"backlash": -1e-3}, "backlash = -0.001; it must be >= 0"),
        ({}, {"stamp_error": 6e-4}, "stamp_error = 0.0006 s; it must lie in"),
        ({}, {"gluey": 1.0}, "unknown option 'gluey' of a rig"),
    ],
)
def test_what_cannot_be_followed_is_refused(
    change: dict[str, float], effects: dict[str, float], said: str
) -> None:
    with pytest.raises(ParameterError, match=said):
        Rig(with_legs(**change), plant="cartesian", **effects)
