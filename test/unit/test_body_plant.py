"""Bodies that a mechanism describes, in PyBullet, beside its own Lagrangian and forward
dynamics.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from plain_loop import PERIOD

from dextar_control.contract.errors import GeometryError, ParameterError
from dextar_control.contract.resources import config_file
from dextar_control.contract.robot import flatten, load_robot
from dextar_control.mechanisms.five_bar import FiveBar
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.mechanisms.three_rrr import ThreeRRR
from dextar_control.model.exact_plant import ExactPlant
from dextar_control.model.model import Model
from dextar_control.model.robot import Robot, load_any_robot
from dextar_sim.body_plant import BodyPlant
from dextar_sim.plant import Plant
from dextar_sim.tree import frames, gaps, placed

BOX = [-0.12, -0.12, -0.1], [0.12, 0.12, 0.1]  # m, of the platform
LEAST_SINE = 0.2  # of a leg's elbow: near Type 1 the joints run away
STATES = 30
EXACT = 1e-12  # relative: the same mechanics, added up in another order
FINE, COARSE = 64, 16  # substeps of a period
DYNAMICS = 1e-3
"""Of the change of velocity over 1 ms at FINE substeps: PyBullet is of the first order
(3e-4 the worst of 100 states).
"""
# of the kinetic energy over 1 s of free motion at 4 substeps; of the first order too
ENERGY_DRIFT = 2e-3
LOOP_GAP = 2e-6  # m, of each pin at 4 substeps, as for the five-bar
IMPULSE_ERROR = 1e-3  # relative; motion during the 0.1 ms of the blow

DEXTAR = load_robot(config_file("dextar.yaml"))
THREE_RRR = load_any_robot(config_file("three_rrr.yaml"))
UNEVEN = THREE_RRR.replace(
    **{
        "leg1.distal_mass": 0.12,
        "leg2.proximal_center": 0.4,
        "leg3.distal_center": 0.6,
        "leg3.proximal_length": 0.13,
        "leg1.coulomb_friction": 5e-3,
        "leg3.viscous_friction": 1e-3,
        "gravity": [0.7, -2.0],
    }
)
NUMBERS = {
    FiveBar(): flatten(
        DEXTAR.replace(
            **{
                "left.distal_mass": 0.12,
                "right.proximal_length": 0.1,
                "right.distal_center": 0.6,
                "left.coulomb_friction": 5e-3,
                "right.viscous_friction": 1e-3,
                "gravity": (0.7, -2.0),
            }
        )
    ),
    ThreeRRR(): UNEVEN.numbers,
}


def states(robot: Robot, count: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """x, x_dot and torques (n,) of places that it reaches."""
    random, model, found = np.random.default_rng(1), Model.of(robot), []
    while len(found) < count:
        x = random.uniform(*BOX)
        place = model.place(x)
        if np.isfinite(place.q_a).all() and place.type1.min() > LEAST_SINE:
            found.append((x, random.normal(0.0, 0.2, 3), random.normal(0.0, 0.2, 3)))
    return found


def lagrangian(mechanism: Mechanism, p: Any) -> ca.Function:
    """Of q_a, x, q_a_dot, x_dot."""
    terms = [ca.SX.sym(name, mechanism.n) for name in ("q_a", "x", "q_a_dot", "x_dot")]
    return ca.Function("lagrangian", terms, [mechanism.lagrangian(*terms, p)])


@pytest.mark.parametrize("mechanism", NUMBERS, ids=lambda mechanism: mechanism.name)
def test_the_bodies_are_those_of_the_lagrangian(mechanism: Mechanism) -> None:
    """Closed, with the same x, kinetic less potential energy and friction, at random
    places.
    """
    values = mechanism.values(NUMBERS[mechanism])
    p, n = mechanism.named(ca.DM(values)), mechanism.n
    bodies = mechanism.bodies(p)
    assert bodies is not None
    x, x_dot = ca.SX.sym("x", n), ca.SX.sym("x_dot", n)
    q_a = mechanism.inverse_geometric_model(x, p)
    q_a_dot = ca.jtimes(q_a, x, x_dot)
    joints = mechanism.tree_joints(q_a, x, p)
    energy = ca.SX(0.0)
    for link, frame in zip(bodies.links, frames(bodies, joints), strict=True):
        center = placed(frame, link.center)
        energy += 0.5 * link.mass * ca.sumsqr(
            ca.jtimes(center, x, x_dot)
        ) + link.mass * ca.dot(bodies.gravity, center)
        energy += 0.5 * link.inertia * ca.jtimes(frame[1], x, x_dot) ** 2
    motors = [
        link
        for link in bodies.links
        if link.joint in [joint.name for joint in mechanism.joints]
    ]
    losses = [
        link.viscous * rate + link.coulomb * ca.tanh(rate / bodies.coulomb_speed)
        for link, rate in zip(motors, ca.vertsplit(q_a_dot), strict=True)
    ]
    compared = ca.Function(
        "compared",
        [x, x_dot],
        [
            ca.vertcat(energy, mechanism.tree_platform(joints, p), *losses),
            ca.vertcat(
                lagrangian(mechanism, p)(q_a, x, q_a_dot, x_dot),
                x,
                mechanism.friction(q_a_dot, p),
            ),
            gaps(bodies, joints),
        ],
    )
    random, tried = np.random.default_rng(2), 0
    while tried < STATES:
        place = (
            random.uniform(*BOX)[:n]
            if n == 3
            else random.uniform([-0.05, 0.06], [0.05, 0.14])
        )
        found, expected, gap = (
            np.array(part).ravel()
            for part in compared(place, random.normal(0.0, 0.3, n))
        )
        if not np.isfinite(expected).all():
            continue
        tried += 1
        np.testing.assert_allclose(found, expected, rtol=100.0 * EXACT, atol=EXACT)
        np.testing.assert_allclose(gap, 0.0, rtol=0.0, atol=EXACT)


def test_the_forward_dynamics_of_the_bodies_are_the_models() -> None:
    """Velocity after 1 ms from random states under random torques, with friction and
    weight, against Runge and Kutta's steps.
    """
    errors: dict[int, list[float]] = {FINE: [], COARSE: []}
    for substeps, found in errors.items():
        plant = BodyPlant(
            UNEVEN.mechanism, UNEVEN.numbers, period=PERIOD, substeps=substeps
        )
        for x, x_dot, tau in states(UNEVEN, STATES):
            start = plant.reset(x, x_dot)
            np.testing.assert_allclose(
                np.concatenate([start.x, start.x_dot]),
                np.concatenate([x, x_dot]),
                rtol=0.0,
                atol=1e-11,
            )
            plant.step(tau)
            exact = ExactPlant(UNEVEN, PERIOD)
            exact.reset(x, x_dot)
            exact.step(tau)
            expected = exact.state().x_dot
            off = np.linalg.norm(plant.state().x_dot - expected)
            found.append(float(off / np.linalg.norm(expected - x_dot)))
        plant.close()
    assert max(errors[FINE]) < DYNAMICS
    assert np.median(errors[FINE]) < 0.4 * np.median(errors[COARSE])


def test_free_motion_keeps_its_energy_and_the_loops_closed() -> None:
    mechanism = THREE_RRR.mechanism
    energy = lagrangian(
        mechanism, mechanism.named(ca.DM(mechanism.values(THREE_RRR.numbers)))
    )  # kinetic: there is no weight
    plant = BodyPlant(mechanism, THREE_RRR.numbers, period=PERIOD)
    state, energies, gap = plant.reset((0.0, 0.0, 0.0), (0.2, -0.15, 0.2)), [], 0.0
    for _ in range(1000):
        energies.append(float(energy(state.q_a, state.x, state.q_a_dot, state.x_dot)))
        gap = max(gap, state.loop_gap)
        plant.step((0.0, 0.0, 0.0))
        state = plant.state()
    plant.close()
    assert np.ptp(energies) < ENERGY_DRIFT * energies[0]
    assert gap < LOOP_GAP


def test_a_blow_on_the_moving_platform_gives_the_velocity_of_the_model() -> None:
    x, x_dot = np.array([0.02, 0.01, -0.01]), np.array([0.3, -0.2, 0.2])
    tau, blow = np.array([0.1, -0.1, 0.05]), np.array([0.01, -0.02, 0.015])
    plant, after = (
        BodyPlant(UNEVEN.mechanism, UNEVEN.numbers, period=1e-4, substeps=1),
        [],
    )
    for struck in (True, False):
        plant.reset(x, x_dot)
        if struck:
            plant.apply_impulse(blow)
        plant.step(tau)
        after.append(plant.state().x_dot)
    plant.close()
    model = Model.of(UNEVEN)
    exact = np.linalg.solve(
        model.platform_dynamics(model.place(x).q_a, x, x_dot, tau).M, blow
    )
    np.testing.assert_allclose(
        after[0] - after[1], exact, rtol=0.0, atol=IMPULSE_ERROR * np.linalg.norm(exact)
    )


def test_the_five_bars_geometry_and_its_mechanisms_agree() -> None:
    own, described = Plant(DEXTAR), BodyPlant(FiveBar(), flatten(DEXTAR))
    for x, x_dot in (((0.013, 0.11), (0.2, -0.1)), ((-0.03, 0.1), (0.0, 0.3))):
        one, other = own.reset(x, x_dot), described.reset(x, x_dot)
        np.testing.assert_allclose(one.numbers, other.numbers, rtol=0.0, atol=1e-12)
    own.close()
    described.close()


def test_what_cannot_be_built_or_reached_is_named() -> None:
    class Bodiless(ThreeRRR):
        name = "bodiless"

        def bodies(self, p: Any) -> None:  # type: ignore[override]
            """None."""

    with pytest.raises(
        ParameterError,
        match="mechanism bodiless does not say of which bodies it is made",
    ):
        BodyPlant(Bodiless(), THREE_RRR.numbers)
    with pytest.raises(
        ParameterError, match="q21 joint friction of .* substeps must be >= "
    ):
        BodyPlant(
            THREE_RRR.mechanism, THREE_RRR.numbers | {"leg2.coulomb_friction": 1.0}
        )
    plant = BodyPlant(THREE_RRR.mechanism, THREE_RRR.numbers)
    with pytest.raises(GeometryError, match="is out of reach: q"):
        plant.reset((0.5, 0.0, 0.0))
    plant.close()
