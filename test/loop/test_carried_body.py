"""The mechanism of ``carried_body.py``: a locus where two motions are
uncontrollable at once, and crossings of it.

What the body does is compared with its own equations of motion in the plane, bound to
the end effectors by hand.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import carried_body
import casadi as ca
import numpy as np
import pytest
from crossing_polynomial import crossing_polynomial
from plain_loop import Run, drive, heavier
from scipy.optimize import newton

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.control.phases import Phase
from dextar_control.control.verdicts import Verdict
from dextar_control.model.model import Model, equations_of
from dextar_control.model.robot import Robot
from dextar_control.planning.certificate import PLAN_RESIDUAL, Plan
from dextar_control.planning.checks import certify
from dextar_control.planning.planner import plan_return_trip_through
from dextar_control.planning.profile import find_crossings
from dextar_control.planning.trajectory import Trajectory, hold, join

PLACES = (
    ([0.02, 0.083], [-0.03, 0.08]),
    ([-0.04, 0.074], [-0.02, 0.08]),
    ([0.05, 0.066], [0.01, 0.083]),
)  # m
RELATIVE = 1e-9  # two exact formulations in float64
CRITERION = 1e-8  # N, t_s.w_d at a singular state under any torques
MAX_ERROR, MAX_ERROR_MASSES = (
    0.1e-3,
    1.0e-3,
)  # m, true, throughout: nominal, and with all masses a fifth off
LIMIT = 5e-3  # N/m, of the multipliers a microsecond beside their limit
BOTH = [(-1.0, 1.0, -1.0), (-1.0, 1.0, -1.0)]  # sides of the two blocks, in turn


@pytest.fixture(scope="module")
def carried() -> Any:
    return carried_body


@pytest.fixture(scope="module")
def robot(carried: Any) -> Robot:
    robot: Robot = carried.ROBOT
    return robot


@pytest.fixture(scope="module")
def trips(carried: Any) -> list[Plan]:
    return [
        plan_return_trip_through(
            carried.ROBOT, carried.place_of_both(*near), 1, None, 0.1
        )
        for near in PLACES
    ]


def sides(run: Run) -> list[tuple[float, ...]]:
    return [tuple(run.sides_of(block)) for block in range(2)]


def by_hand(
    carried: Any, x: np.ndarray, x_dot: np.ndarray, tau: np.ndarray
) -> np.ndarray:
    """x_ddot (4,) of the two five-bars' own equations and the body's (center, angle),
    bound by pin and slot.
    """
    p, arm = carried.ROBOT.numbers, Model.of(carried.DEXTAR)
    c, s = np.cos(p["second_angle"]), np.sin(p["second_angle"])
    turn = np.array([[c, -s], [s, c]])
    d, d_dot = (
        np.array(p["second_origin"]) + turn @ x[2:] - x[:2],
        turn @ x_dot[2:] - x_dot[:2],
    )
    u = d / np.linalg.norm(d)
    n = np.array([-u[1], u[0]])
    rate = n @ d_dot / np.linalg.norm(d)
    mass, right = np.zeros((7, 7)), np.zeros(7)  # x, center, angle
    mass[4:, 4:] = np.diag([p["body_mass"], p["body_mass"], p["body_inertia"]])
    for half in (slice(0, 2), slice(2, 4)):
        place = arm.place(x[half])
        found = arm.platform_dynamics(place.q_a, x[half], x_dot[half], tau[half])
        mass[half, half] = found.M
        right[half] = found.M @ found.x_ddot
    bound, drift = np.zeros((3, 7)), np.zeros(3)
    bound[:2, :2], bound[:2, 4:6], bound[:2, 6] = (
        -np.eye(2),
        np.eye(2),
        -p["body_center"] * n,
    )  # the pin
    drift[:2] = p["body_center"] * rate**2 * u
    bound[2, :2], bound[2, 2:4], bound[2, 6] = (
        -n,
        n @ turn,
        -u @ d,
    )  # the slot: no distance across the body
    drift[2] = -2.0 * rate * (u @ d_dot)
    matrix = np.block([[mass, -bound.T], [bound, np.zeros((3, 3))]])
    return np.linalg.solve(matrix, np.concatenate([right, -drift]))[:4]


def states(carried: Any, count: int, seed: int) -> list[tuple[np.ndarray, ...]]:
    """(x, x_dot, tau) away from the locus."""
    generator = np.random.default_rng(seed)
    low, high = [-0.05, 0.05, -0.05, 0.05], [0.05, 0.13, 0.05, 0.13]
    return [
        (
            generator.uniform(low, high),
            generator.normal(0.0, 0.5, 4),
            generator.normal(0.0, 0.2, 4),
        )
        for _ in range(count)
    ]


def test_its_forward_dynamics_are_those_of_a_body_bound_to_two_five_bars(
    carried: Any, robot: Robot
) -> None:
    model = Model.of(robot)
    for x, x_dot, tau in states(carried, 100, 0):
        expected = by_hand(carried, x, x_dot, tau)
        found = model.platform_dynamics(model.place(x).q_a, x, x_dot, tau).x_ddot
        np.testing.assert_allclose(
            found, expected, rtol=0.0, atol=RELATIVE * np.abs(expected).max()
        )
        if np.abs(model.place(x).s_blocks).min() > 0.05:
            np.testing.assert_allclose(
                model.wrenches(model.place(x).q_a, x, x_dot, found).tau,
                tau,
                rtol=0.0,
                atol=RELATIVE,
            )


def test_on_both_loci_two_motions_are_lost_and_any_torque_meets_both_criteria(
    carried: Any, robot: Robot
) -> None:
    model = Model.of(robot)
    for near in PLACES:
        place = carried.place_of_both(*near)
        found = model.place(place.x)
        assert np.abs(found.s_blocks).max() < 1e-12
        singular = np.linalg.svd(found.A_r, compute_uv=False)
        assert (singular[2:] < 1e-12).all() and (singular[:2] > 1e-2).all()
        np.testing.assert_allclose(found.A_r @ found.t_s, 0.0, atol=1e-12)
        np.testing.assert_allclose(found.t_s.T @ found.t_s, np.eye(2), atol=1e-12)
        for _, x_dot, tau in states(carried, 30, 1):
            x_ddot = by_hand(carried, place.x, x_dot, tau)
            assert (
                np.abs(
                    model.wrenches(found.q_a, place.x, x_dot, x_ddot).criterion
                ).max()
                <= CRITERION
            )


def test_the_body_couples_the_criteria(carried: Any, robot: Robot) -> None:
    """An acceleration of the one five-bar alone, along its t_s, breaks the other's
    criterion.
    """
    model, place = Model.of(robot), carried.place_of_both(*PLACES[0])
    q_a, t_s = model.place(place.x).q_a, model.place(place.x).t_s
    rest, pushed = (
        model.wrenches(q_a, place.x, np.zeros(4), way).criterion
        for way in (np.zeros(4), t_s[:, 0])
    )
    own, other = pushed - rest
    assert abs(other) > 0.1 * abs(own)


def test_singular_vectors_of_its_blocks_rebuild_the_matrix(
    carried: Any, robot: Robot
) -> None:
    e, model = equations_of(robot.mechanism), Model.of(robot)
    function = ca.Function(
        "vectors", [e.p, e.q_a, e.x], [e.A_r, e.s_blocks, *map(ca.densify, e.singular)]
    )
    for x, _, _ in states(carried, 20, 2):
        A_r, s, u, sigma, v, u_weak, sigma_weak, v_weak = (
            np.array(part) for part in function(model.p, model.place(x).q_a, x)
        )
        np.testing.assert_allclose(
            u * sigma.T @ v.T + u_weak * sigma_weak.T @ v_weak.T, A_r, atol=1e-14
        )
        every = np.column_stack([v, v_weak])
        np.testing.assert_allclose(every.T @ every, np.eye(4), atol=1e-12)
        np.testing.assert_array_equal(np.sign(s), np.sign(sigma_weak))


@pytest.mark.parametrize("broken", [(), (0,), (1,), (0, 1)])
def test_the_torque_stays_finite_where_both_criteria_hold_and_grows_as_1_over_s_where_one_does_not(
    robot: Robot, trips: list[Plan], broken: tuple[int, ...]
) -> None:
    model, plan = Model.of(robot), trips[0]
    (time, _), limit = (
        plan.certificate.crossing_times[:2],
        plan.certificate.multipliers[0],
    )
    t_s = model.place(plan.trajectory.at(time).x).t_s
    for side in (-1.0, 1.0):
        off = []  # from the limit, N/m, of each block
        for ahead in (1e-4, 1e-5, 1e-6):  # s
            x, x_dot, x_ddot = plan.trajectory.at(time + side * ahead)
            asked = x_ddot + t_s[:, list(broken)].sum(axis=1)  # 1 m/s^2 more
            found = model.wrenches(model.place(x).q_a, x, x_dot, asked).multipliers
            off.append(np.abs((found - limit).reshape(2, 2)).max(axis=1))
        for far, near in pairwise(off):  # the body hands it on to the other block
            assert (
                (near < 0.2 * far + LIMIT).all()
                if not broken
                else ((near > 9.0 * far) & (near < 11.0 * far)).all()
            )
        assert (off[-1] < LIMIT).all() if not broken else (off[-1] > 1e3).all()


@pytest.mark.parametrize("row", range(len(PLACES)))
@pytest.mark.parametrize("share", [1.0, 0.8, 1.2])
def test_it_crosses_both_loci_at_once_there_and_back(
    robot: Robot, trips: list[Plan], row: int, share: float
) -> None:
    plan = trips[row]
    certificate = plan.certificate
    assert certificate.crossing_times[0] == certificate.crossing_times[
        1
    ] and certificate.crossing_blocks.tolist() == [0, 1, 0, 1]
    assert certificate.residuals.max() <= PLAN_RESIDUAL
    run = drive(robot, plan, heavier(robot, share))
    assert run.loop.phase is Phase.HOLD and run.loop.completed == 1, run.loop.reason
    assert sides(run) == BOTH
    assert run.error.max() <= (MAX_ERROR if share == 1.0 else MAX_ERROR_MASSES)
    assert (
        run.near_torque <= (1.0 if share == 1.0 else 1.2) * certificate.peak_torque
    )  # masses that far off ask for as much
    verdicts = [passed.verdict for passed in run.loop.passed]
    assert (
        verdicts.count(Verdict.CROSSED) >= (4 if share == 1.0 else 3)
        and Verdict.BOUNCED not in verdicts
    )


def test_the_plain_law_takes_more_than_twice_the_planned_torque_where_the_consistent_one_stays_below_it(
    robot: Robot, trips: list[Plan]
) -> None:
    assert (
        drive(
            robot, trips[0], law="classic", **{"observer.scatter_gain": 0.0}
        ).near_torque
        > 2.0 * trips[0].certificate.peak_torque
    )


@pytest.mark.parametrize("row", range(len(PLACES)))
@pytest.mark.parametrize("share", [1.0, 0.8, 1.2])
@pytest.mark.parametrize("blocks", [(0,), (1,), (0, 1)])
def test_a_block_that_bounces_is_told_from_one_that_crosses(
    robot: Robot, trips: list[Plan], row: int, share: float, blocks: tuple[int, ...]
) -> None:
    moment = float(trips[row].certificate.crossing_times[0])
    run = drive(
        robot, trips[row], heavier(robot, share), turned=moment, turned_blocks=blocks
    )
    assert run.loop.phase is Phase.SAFE_STOP
    verdicts = [passed.verdict for passed in run.loop.passed[:2]]
    assert Verdict.BOUNCED in verdicts or share != 1.0
    for block, verdict in enumerate(verdicts):
        assert verdict in (
            Verdict.UNDECIDED,
            Verdict.BOUNCED if block in blocks else Verdict.CROSSED,
        )


def apart(robot: Robot, plan: Plan, gap: float) -> Trajectory:
    """One way of a plan, its second block ``gap`` later: each criterion is imposed
    where its own block is singular.
    """
    model, trip, time = (
        Model.of(robot),
        plan.trajectory,
        float(plan.certificate.crossing_times[0]),
    )
    begin, end = trip.knots[1], trip.knots[3]
    now, later = trip.at(time), trip.at(time - gap)
    x, x_dot, x_ddot = (
        np.append(one[:2], other[2:]) for one, other in zip(now, later, strict=True)
    )
    q_a, t_s = model.place(x).q_a, model.place(x).t_s

    def way(bend: float) -> Trajectory:
        asked = x_ddot + bend * t_s[:, 1]
        lacks = [
            model.wrenches(q_a, x, x_dot, tried).criterion[0]
            for tried in (asked, asked + t_s[:, 0])
        ]
        asked = asked - lacks[0] / (lacks[1] - lacks[0]) * t_s[:, 0]
        return crossing_polynomial(
            robot,
            (trip.at(begin).x, trip.at(end).x),
            x,
            x_dot,
            asked,
            time - begin,
            end - time,
        )

    def lack(bend: float) -> float:
        tried = way(bend)
        times = np.linspace(time - begin - 0.02, time - begin + 0.02, 41)
        s = np.array(
            [model.place(place).s_blocks[1] for place in tried.table(times)[0]]
        )
        (crossing,) = find_crossings(robot, tried, times, s, 1)
        point = tried.at(crossing)
        return float(model.wrenches(model.place(point.x).q_a, *point).criterion[1])

    return way(newton(lack, 0.0, x1=1.0, tol=1e-12))


@pytest.mark.parametrize("row", range(len(PLACES)))
@pytest.mark.parametrize("gap", [0.001, 0.003, 0.008])
@pytest.mark.parametrize("share", [1.0, 0.8, 1.2])
def test_it_crosses_the_two_loci_one_shortly_after_the_other(
    robot: Robot, trips: list[Plan], row: int, gap: float, share: float
) -> None:
    out = apart(robot, trips[row], gap)
    rests = [hold(out.at(moment).x, 0.1) for moment in (0.0, out.duration)]
    trip = join([rests[0], out, rests[1], out.reversed(), rests[0]])
    certificate = certify(robot, trip, max_residual=PLAN_RESIDUAL)
    assert certificate.crossing_blocks.tolist() == [0, 1, 1, 0]
    np.testing.assert_allclose(np.diff(certificate.crossing_times)[::2], gap, rtol=0.3)
    run = drive(robot, Plan(trip, certificate), heavier(robot, share))
    assert run.loop.phase is Phase.HOLD and sides(run) == BOTH, run.loop.reason
    assert run.error.max() <= (MAX_ERROR if share == 1.0 else MAX_ERROR_MASSES)
    assert (
        run.near_torque <= (1.0 if share == 1.0 else 1.2) * certificate.peak_torque
    )  # masses that far off ask for as much
    verdicts = [passed.verdict for passed in run.loop.passed]
    assert (
        verdicts.count(Verdict.CROSSED) >= (4 if share == 1.0 else 3)
        and Verdict.BOUNCED not in verdicts
    )


def test_an_external_position_is_not_taken_for_it(robot: Robot) -> None:
    with pytest.raises(
        ParameterError,
        match=(
            "estimator external needs an A_r of one block; that of carried_body has 2"
        ),
    ):
        ControlLoop(robot, default_settings(estimator="external"), 1)
