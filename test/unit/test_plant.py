"""The plant's surface: poses, modes, limits, independence of plants, determinism."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dextar_control.contract.errors import GeometryError, ParameterError, StateError
from dextar_control.contract.resources import config_file
from dextar_control.contract.robot import RobotParameters, load_robot
from dextar_sim import urdf
from dextar_sim.effects import Effects
from dextar_sim.plant import Plant

DEXTAR = load_robot(config_file("dextar.yaml"))
MOCKUP = load_robot(config_file("mockup.yaml"))
EXACT = 1.0e-12
"""Rounding of a few trigonometric functions of lengths near 0.1 m."""
FLOOR_EFFECT = 1.0e-7
"""m; the numerical mass of massless links against one a hundred times smaller, after
0.5 s.
"""


def cross(first: np.ndarray, second: np.ndarray) -> float:
    return float(first[0] * second[1] - first[1] * second[0])


def elbows(robot: RobotParameters, q_a: np.ndarray) -> np.ndarray:
    base = np.array(
        [[-0.5 * robot.base_distance, 0.0], [0.5 * robot.base_distance, 0.0]]
    )
    lengths = np.array([leg.proximal_length for leg in robot.legs])
    return base + lengths[:, None] * np.stack([np.cos(q_a), np.sin(q_a)], axis=1)


@pytest.mark.parametrize("working_mode", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_reset_puts_the_elbows_on_the_sides_of_the_working_mode(
    working_mode: tuple[int, int],
) -> None:
    plant = Plant(DEXTAR.replace(working_mode=working_mode))
    state = plant.reset((0.013, 0.11))
    points = elbows(DEXTAR, state.q_a)
    for leg, mode in enumerate(working_mode):
        base = np.array([(-0.5, 0.5)[leg] * DEXTAR.base_distance, 0.0])
        assert mode * cross(np.array([0.013, 0.11]) - base, points[leg] - base) > 0.0
        assert math.dist(points[leg], (0.013, 0.11)) == pytest.approx(0.09, abs=EXACT)
    assert state.x == pytest.approx((0.013, 0.11), abs=EXACT)
    assert state.loop_gap < EXACT
    plant.close()


@pytest.mark.parametrize("assembly_mode", [1, -1])
def test_reset_joints_takes_the_assembly_mode_as_the_sign_of_s(
    assembly_mode: int,
) -> None:
    plant = Plant(DEXTAR)
    q_a = np.array([1.9, 1.2])
    state = plant.reset_joints(q_a, assembly_mode)
    r_1, r_2 = state.x - elbows(DEXTAR, q_a)
    assert assembly_mode * cross(r_1, r_2) > 0.0
    assert state.q_a == pytest.approx(q_a, abs=EXACT)
    assert state.loop_gap < EXACT
    plant.close()


def test_initial_velocity_is_that_of_both_tips() -> None:
    plant = Plant(DEXTAR)
    state = plant.reset((0.02, 0.105), (0.3, -0.2))
    assert state.x_dot == pytest.approx((0.3, -0.2), abs=EXACT)
    step = 1.0e-6
    ahead = plant.reset((0.02 + 0.3 * step, 0.105 - 0.2 * step)).joints
    behind = plant.reset((0.02 - 0.3 * step, 0.105 + 0.2 * step)).joints
    assert state.joints_dot == pytest.approx(
        (ahead - behind) / (2.0 * step), abs=1.0e-7
    )
    plant.close()


def test_rest_without_torque_stays_at_rest() -> None:
    plant = Plant(DEXTAR)
    plant.reset((0.0, 0.105))
    for _ in range(200):
        plant.step((0.0, 0.0))
    state = plant.state()
    assert state.x == pytest.approx((0.0, 0.105), abs=EXACT)
    assert state.time == 200 * 1.0e-3
    plant.close()


def test_unreachable_point_names_point_distance_and_reach() -> None:
    plant = Plant(DEXTAR)
    with pytest.raises(
        GeometryError, match=r"\(0, 0\.3\) m is 0\.305747 m from the left .* 0\.18 m"
    ):
        plant.reset((0.0, 0.3))
    with pytest.raises(GeometryError, match="left motor axis"):
        plant.reset((-0.059, 0.0))
    with pytest.raises(GeometryError, match="not finite"):
        plant.reset((math.nan, 0.1))
    with pytest.raises(GeometryError, match="elbows are"):
        plant.reset_joints((math.pi, 0.0), 1)
    plant.close()


def test_velocity_at_a_stretched_leg_is_refused() -> None:
    lengths = {
        "base_distance": 0.125,
        "left.proximal_length": 0.125,
        "left.distal_length": 0.125,
    }
    plant = Plant(DEXTAR.replace(**lengths))
    assert plant.reset((0.1875, 0.0)).joints[1] == pytest.approx(0.0, abs=EXACT)
    with pytest.raises(GeometryError, match="left leg"):
        plant.reset((0.1875, 0.0), (0.1, 0.1))
    plant.close()


def test_torque_saturates_and_the_applied_one_is_returned() -> None:
    plant, limited = Plant(DEXTAR), Plant(DEXTAR, max_torque=0.1)
    for each, torque in ((plant, (0.1, -0.1)), (limited, (7.0, -7.0))):
        each.reset((0.0, 0.105))
        assert each.step(torque).tolist() == [0.1, -0.1]
    assert plant.state().joints.tolist() == limited.state().joints.tolist()
    plant.close()
    limited.close()


def test_torque_that_is_not_finite_is_refused() -> None:
    plant = Plant(DEXTAR)
    plant.reset((0.0, 0.105))
    with pytest.raises(StateError, match="nan"):
        plant.step((math.nan, 0.0))
    plant.close()


def drive(plant: Plant, steps: int) -> list[list[float]]:
    plant.reset((0.01, 0.1))
    trace = []
    for step in range(steps):
        plant.step((0.05 * math.sin(0.02 * step), 0.04))
        trace.append([*plant.state().joints, *plant.state().joints_dot])
    return trace


def test_two_plants_in_one_process_do_not_share_anything() -> None:
    alone_dextar, alone_mockup = Plant(DEXTAR), Plant(MOCKUP)
    expected = drive(alone_dextar, 100), drive(alone_mockup, 100)
    alone_dextar.close()
    first, second = Plant(DEXTAR), Plant(MOCKUP)
    first.reset((0.01, 0.1))
    second.reset((0.01, 0.1))
    for step in range(100):
        for plant, trace in ((first, expected[0]), (second, expected[1])):
            plant.step((0.05 * math.sin(0.02 * step), 0.04))
            assert [*plant.state().joints, *plant.state().joints_dot] == trace[step]
    for plant in (alone_mockup, first, second):
        plant.close()


def test_reset_repeats_a_run_bit_for_bit() -> None:
    plant = Plant(DEXTAR)
    first = drive(plant, 300)
    assert drive(plant, 300) == first
    plant.close()


@pytest.mark.parametrize("substeps", [1, 2, 3, 4])
def test_a_period_is_its_substeps_bit_for_bit(substeps: int) -> None:
    """PyBullet divides the period itself where it can; a period of one substep cannot
    be divided.
    """
    whole, parts = (
        Plant(DEXTAR, period=substeps * 2.5e-4, substeps=substeps),
        Plant(DEXTAR, period=2.5e-4, substeps=1),
    )
    for plant in (whole, parts):
        plant.reset((0.01, 0.1), (0.1, -0.2))
    for step in range(200):
        torque = (0.05 * math.sin(0.02 * step), 0.04)
        if step == 50:
            whole.apply_impulse((0.003, -0.002))
            parts.apply_impulse((0.003, -0.002))
        whole.step(torque)
        for _ in range(substeps):
            parts.step(torque)
        assert whole.state().joints.tolist() == parts.state().joints.tolist()
    whole.close()
    parts.close()


def test_a_plant_after_another_one_is_as_new() -> None:
    """Connections are kept: nothing of the mock-up before may show."""
    fresh = Plant(DEXTAR)
    others = [Plant(MOCKUP, period=2.0e-3, substeps=2) for _ in range(3)]
    expected = drive(fresh, 100)
    for other in (fresh, *others):
        drive(other, 20)
        other.close()
        other.close()
    for _ in range(3):
        plant = Plant(DEXTAR)
        assert drive(plant, 100) == expected
        plant.close()


def test_mass_floor_of_massless_links_does_not_show(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ends = []
    for floor in (urdf.MASS_FLOOR, 0.01 * urdf.MASS_FLOOR):
        monkeypatch.setattr(urdf, "MASS_FLOOR", floor)
        plant = Plant(MOCKUP.replace(gravity=(0.0, -1.0)))
        plant.reset((0.02, 0.105), (0.2, -0.1))
        for _ in range(500):
            plant.step((0.1, -0.1))
        ends.append(plant.state().x)
        plant.close()
    assert math.dist(*ends) < FLOOR_EFFECT


def test_friction_too_steep_for_the_substep_is_refused_with_the_remedy() -> None:
    with pytest.raises(
        ParameterError, match="left joint friction .* substeps must be >= "
    ):
        Plant(
            DEXTAR.replace(**{"left.coulomb_friction": 1.0}), effects=Effects("smooth")
        )


@pytest.mark.parametrize(
    ("options", "word"), [({"substeps": 0}, "substeps"), ({"period": 0.0}, "period")]
)
def test_steps_that_are_none_are_refused(options: dict[str, float], word: str) -> None:
    with pytest.raises(ParameterError, match=word):
        Plant(DEXTAR, **options)


def test_window_without_a_display_is_one_clear_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(ParameterError, match="DISPLAY"):
        Plant(DEXTAR, window=True)
