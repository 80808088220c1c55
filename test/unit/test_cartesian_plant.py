"""The plant in platform coordinates against three others: pinocchio, the tests' own
mechanics, PyBullet.
"""

from __future__ import annotations

import inspect
import math

import numpy as np
import pytest
from mechanics import absolute, energy, equations, integrate

from dextar_control.contract.errors import GeometryError, ParameterError, StateError
from dextar_control.contract.resources import config_file
from dextar_control.contract.robot import RobotParameters, load_robot
from dextar_sim.cartesian import CartesianPlant
from dextar_sim.effects import FRICTIONS, Effects
from dextar_sim.plant import Plant
from dextar_sim.state import PlantState

FORMULATIONS = 1.0e-10
"""Relative; two exact formulations in float64, 4e-14 measured."""
EXACT_MOTION = 1.0e-9
"""m after 0.4 s; the oracle's own tolerance is 1e-10."""
ENERGY_DRIFT = 5.0e-8
"""Share of the kinetic energy over 1 s, 4e-9 measured under weight; PyBullet's bar is
2e-3 over 3 s.
"""
PYBULLET_ERROR = 0.05e-3
"""m after 0.4 s at up to 10 rad/s: PyBullet's first-order substeps of 0.25 ms, 0.036 mm
measured.
"""
FOURTH_ORDER = 12.0
"""Halving the substep divides the error by 16; higher orders take some of it."""
IMPULSE_ERROR = 1.0e-4
"""Relative; motion during the 0.1 ms of the blow."""
SIZE_STEP = 1.0e-7
"""s; for a difference quotient of angles at about 10 rad/s."""
EXACT = 1.0e-12
WORKING_MODES = [(1, 1), (1, -1), (-1, 1), (-1, -1)]

DEXTAR = load_robot(config_file("dextar.yaml"))
MOCKUP = load_robot(config_file("mockup.yaml"))
THROUGH = [((-0.025, 0.115), (0.1, -0.3)), ((0.0, 0.1), (0.05, -0.4))]
"""Start and velocity of motions that pass the Type 2 locus within 0.1 s."""


def wavy(step: int) -> tuple[float, float]:
    return 0.02 * math.sin(0.02 * step), -0.03 * math.cos(0.015 * step)


def assembly(state: PlantState) -> float:
    """Sine of the angle from the left distal link to the right one."""
    theta = absolute(state.joints)
    return math.sin(theta[3] - theta[1])


def run(plant: Plant | CartesianPlant, steps: int, driven: bool) -> list[PlantState]:
    states = [plant.state()]
    for step in range(steps):
        plant.step(wavy(step) if driven else (0.0, 0.0))
        states.append(plant.state())
    return states


@pytest.mark.parametrize("working_mode", WORKING_MODES)
def test_acceleration_is_that_of_an_independent_engine(
    uneven: RobotParameters, working_mode: tuple[int, int]
) -> None:
    """At random states in both assembly modes, the Type 2 locus among them."""
    Oracle = pytest.importorskip("oracle").Oracle
    robot = uneven.replace(working_mode=working_mode, max_torque=1.0)
    oracle, plant, random = (
        Oracle(robot),
        CartesianPlant(robot),
        np.random.default_rng(4),
    )
    compared, near = 0, 0
    while compared < 300:
        x, x_dot, tau = (
            random.uniform((-0.08, -0.13), (0.08, 0.13)),
            random.uniform(-1.0, 1.0, 2),
            random.uniform(-0.5, 0.5, 2),
        )
        try:
            state = plant.reset(x, x_dot)
        except GeometryError:
            continue
        if min(abs(math.sin(state.joints[1])), abs(math.sin(state.joints[3]))) < 0.1:
            continue
        expected = oracle.forward(state.q_a, x, x_dot, tau)
        np.testing.assert_allclose(
            plant.acceleration(tau),
            expected,
            rtol=FORMULATIONS,
            atol=FORMULATIONS * np.abs(expected).max(),
        )
        compared += 1
        near += abs(assembly(state)) < 0.15
    assert near > 5


@pytest.mark.parametrize("robot", [DEXTAR, MOCKUP], ids=lambda robot: robot.name)
@pytest.mark.parametrize(("x", "x_dot"), THROUGH)
def test_free_motion_through_the_locus_is_exact(
    robot: RobotParameters, x: tuple[float, float], x_dot: tuple[float, float]
) -> None:
    plant = CartesianPlant(robot)
    plant.reset(x, x_dot)
    states = run(plant, 200, driven=False)
    assert assembly(states[0]) * assembly(states[-1]) < 0.0
    exact, velocity = integrate(robot, states[0], 0.2)
    assert math.dist(states[-1].x, exact) < EXACT_MOTION
    assert math.dist(states[-1].x_dot, velocity) < 100.0 * EXACT_MOTION


@pytest.mark.parametrize("driven", [False, True])
@pytest.mark.parametrize(("x", "x_dot"), THROUGH)
def test_both_plants_move_alike_through_the_locus(
    x: tuple[float, float], x_dot: tuple[float, float], driven: bool
) -> None:
    runs = []
    for plant in (Plant(DEXTAR), CartesianPlant(DEXTAR)):
        plant.reset(x, x_dot)
        runs.append(run(plant, 400, driven))
        plant.close()
    assert min(map(assembly, runs[0])) < -0.1 < 0.1 < max(map(assembly, runs[0]))
    assert (
        max(math.dist(first.x, second.x) for first, second in zip(*runs, strict=True))
        < PYBULLET_ERROR
    )


@pytest.mark.parametrize("friction", FRICTIONS)
def test_both_plants_lose_alike_to_friction_and_late_torque(friction: str) -> None:
    """A torque that comes two substeps of four late, on joints that rub."""
    robot = DEXTAR.replace(
        **{"left.viscous_friction": 1.0e-3, "right.coulomb_friction": 5.0e-3}
    )
    ends = []
    for plant in (
        Plant(robot, effects=Effects(friction)),
        CartesianPlant(robot, effects=Effects(friction)),
    ):
        plant.reset((0.02, 0.105), (0.2, -0.15))
        for step in range(200):
            plant.step(wavy(step), wavy(step - 1), 2)
        ends.append(plant.state().x)
        plant.close()
    assert math.dist(*ends) < PYBULLET_ERROR


@pytest.mark.parametrize("kind", [Plant, CartesianPlant])
@pytest.mark.parametrize("friction", [0.0, 2.0e-3])
def test_late_torque_is_two_torques_in_turn(
    kind: type[Plant] | type[CartesianPlant], friction: float
) -> None:
    robot = DEXTAR.replace(**{"left.coulomb_friction": friction})
    whole, halves = (
        kind(robot, period=1.0e-3, substeps=4),
        kind(robot, period=0.5e-3, substeps=2),
    )
    for plant in (whole, halves):
        plant.reset((0.0, 0.1), (0.05, -0.4))
    for step in range(50):
        assert whole.step(wavy(step), wavy(step - 1), 2).tolist() == list(wavy(step))
        halves.step(wavy(step - 1))
        halves.step(wavy(step))
        assert whole.state().joints.tolist() == halves.state().joints.tolist()
    whole.close()
    halves.close()


@pytest.mark.parametrize("gravity", [(0.0, 0.0), (0.6, -0.8)])
def test_energy_is_kept(gravity: tuple[float, float]) -> None:
    robot = DEXTAR.replace(gravity=gravity)
    plant = CartesianPlant(robot)
    plant.reset((0.02, 0.105), (0.2, -0.15))
    states = run(plant, 1000, driven=False)
    energies = [energy(robot, state) for state in states]
    kinetic = max(energy(robot.replace(gravity=(0.0, 0.0)), state) for state in states)
    assert max(abs(value - energies[0]) for value in energies) < ENERGY_DRIFT * kinetic


def test_error_is_of_fourth_order() -> None:
    errors, exact = [], None
    for substeps in (1, 2, 4):
        plant = CartesianPlant(DEXTAR, period=8.0e-3, substeps=substeps)
        start = plant.reset((0.0, 0.1), (0.1, -0.8))
        exact = integrate(DEXTAR, start, 0.16)[0] if exact is None else exact
        errors.append(math.dist(run(plant, 20, driven=False)[-1].x, exact))
    assert errors[1] < errors[0] / FOURTH_ORDER
    assert errors[2] < errors[1] / FOURTH_ORDER


def test_impulse_gives_the_velocity_of_the_exact_model() -> None:
    """M v + C^T impulses of the loop = impulse on the end effector, C v = 0."""
    impulse = np.array([0.01, -0.02])
    plant = CartesianPlant(DEXTAR, period=1.0e-4, substeps=1)
    start = plant.reset((0.02, 0.105))
    plant.apply_impulse(impulse)
    plant.step((0.0, 0.0))
    system, blow = (
        equations(DEXTAR, absolute(start.joints), np.zeros(6))[0],
        np.zeros(10),
    )
    blow[4:6] = impulse
    exact = np.linalg.solve(system, blow)[:6]
    state = plant.state()
    assert math.dist(state.x_dot, exact[4:]) < IMPULSE_ERROR * np.hypot(*exact[4:])
    assert math.dist(
        absolute(state.joints_dot), exact[:4]
    ) < IMPULSE_ERROR * np.linalg.norm(exact[:4])
    plant.step((0.0, 0.0))
    assert math.dist(plant.state().x_dot, state.x_dot) < IMPULSE_ERROR * np.hypot(
        *exact[4:]
    )


@pytest.mark.parametrize("working_mode", WORKING_MODES)
def test_joints_close_the_loop_in_the_working_mode_and_never_jump(
    working_mode: tuple[int, int],
) -> None:
    """Both tips from the reported angles are the reported x, and angles and rates
    belong together.
    """
    robot = DEXTAR.replace(working_mode=working_mode)
    plant = CartesianPlant(robot)
    start = plant.reset((0.01, 0.1), (0.05, -0.2))
    for before, after in zip(
        (states := run(plant, 300, driven=False)), states[1:], strict=False
    ):
        theta = absolute(after.joints)
        for leg, base in enumerate((-0.059, 0.059)):
            tip = (
                base + 0.09 * sum(math.cos(theta[2 * leg + link]) for link in (0, 1)),
                0.09 * sum(math.sin(theta[2 * leg + link]) for link in (0, 1)),
            )
            assert math.dist(tip, after.x) < EXACT
            assert (
                math.sin(after.joints[2 * leg + 1])
                * math.sin(start.joints[2 * leg + 1])
                > 0.0
            )
        mean_rate = 0.5 * (before.joints_dot + after.joints_dot)
        np.testing.assert_allclose(
            after.joints - before.joints, 1.0e-3 * mean_rate, atol=1.0e-5
        )


def test_joints_go_on_counting_past_half_a_turn() -> None:
    """Both plants' motors turn on past pi, where the inverse geometry alone would start
    anew.
    """
    robot = DEXTAR.replace(working_mode=(1, 1))
    ends = []
    for plant in (Plant(robot), CartesianPlant(robot)):
        plant.reset((-0.09, 0.09), (-0.2, -0.4))
        states = run(plant, 120, driven=False)
        assert max(state.joints[0] for state in states) > math.pi + 0.1
        ends.append(states[-1].joints)
        plant.close()
    np.testing.assert_allclose(ends[0], ends[1], atol=1.0e-3)


@pytest.mark.parametrize("assembly_mode", [1, -1])
def test_reset_joints_is_the_state_of_the_other_plant(assembly_mode: int) -> None:
    states = []
    for plant in (Plant(DEXTAR), CartesianPlant(DEXTAR)):
        states.append(
            plant.reset_joints((1.9, 1.2), assembly_mode, (0.2, -0.1)).numbers
        )
        plant.close()
    np.testing.assert_allclose(*states, atol=EXACT)


def test_a_leg_passes_where_it_is_stretched() -> None:
    """Type 1: the elbow comes out on the other side, as the exact model's and
    PyBullet's do.
    """
    plant, other = CartesianPlant(DEXTAR), Plant(DEXTAR)
    start = plant.reset((0.02, 0.105), (0.2, -0.15))
    other.reset((0.02, 0.105), (0.2, -0.15))
    end, built = (
        run(plant, 800, driven=False)[-1],
        run(other, 800, driven=False)[-1],
    )
    other.close()
    assert any(
        math.sin(start.joints[passive]) * math.sin(end.joints[passive]) < 0.0
        for passive in (1, 3)
    )
    assert math.dist(end.x, integrate(DEXTAR, start, 0.8)[0]) < EXACT_MOTION
    assert math.dist(end.x, built.x) < PYBULLET_ERROR


def test_both_legs_stretched_end_the_run_with_words() -> None:
    plant = CartesianPlant(DEXTAR)
    plant.reset((0.0, 0.1695), (0.0, 0.3))
    with pytest.raises(
        StateError,
        match=r"both legs are stretched or folded: the larger .* needs >= 0.01",
    ):
        run(plant, 500, driven=False)


def test_a_reset_repeats_a_run_bit_for_bit() -> None:
    plant = CartesianPlant(DEXTAR)
    traces = []
    for _ in range(2):
        plant.reset((0.01, 0.1), (0.05, -0.2))
        traces.append([state.joints.tolist() for state in run(plant, 100, driven=True)])
    assert traces[0] == traces[1]


def test_torque_saturates_and_what_is_not_finite_is_refused() -> None:
    plant = CartesianPlant(DEXTAR, max_torque=0.1)
    plant.reset((0.0, 0.105))
    assert plant.step((7.0, -7.0)).tolist() == [0.1, -0.1]
    with pytest.raises(StateError, match="nan"):
        plant.step((math.nan, 0.0))
    with pytest.raises(ParameterError, match="substeps"):
        CartesianPlant(DEXTAR, substeps=0)
    with pytest.raises(ParameterError, match="left joint friction"):
        CartesianPlant(
            DEXTAR.replace(**{"left.coulomb_friction": 1.0}), effects=Effects("smooth")
        )


@pytest.mark.parametrize(
    "name", ["reset", "reset_joints", "step", "apply_impulse", "state", "close"]
)
def test_both_plants_have_the_same_surface(name: str) -> None:
    assert inspect.signature(getattr(Plant, name)) == inspect.signature(
        getattr(CartesianPlant, name)
    )


@pytest.mark.parametrize("plant", [CartesianPlant, Plant])
def test_a_robot_on_another_place_of_the_plane_moves_alike(
    plant: type[Plant] | type[CartesianPlant],
) -> None:
    """Axes, start and weight turned and shifted; near the ends of both legs, where
    their own angles are the coordinates, too.
    """
    angle, shift = 0.4, np.array([0.03, -0.02])
    turn = np.array(
        [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    )
    robot = DEXTAR.replace(gravity=(0.0, -9.81))
    axes = {
        f"{side}.axis": tuple(turn @ leg.axis + shift)
        for side, leg in zip(robot.sides, robot.legs, strict=True)
    }
    moved = robot.replace(gravity=tuple(turn @ robot.gravity), **axes)
    here, there = plant(robot), plant(moved)
    here.reset((0.03, 0.155), (0.0, 0.1))
    there.reset(turn @ (0.03, 0.155) + shift, turn @ (0.0, 0.1))
    for first, second in zip(
        run(here, 150, False), run(there, 150, False), strict=True
    ):
        np.testing.assert_allclose(second.x, turn @ first.x + shift, atol=1e-7)
        np.testing.assert_allclose(
            np.cos(second.q_a - first.q_a - angle), 1.0, atol=1e-9
        )
