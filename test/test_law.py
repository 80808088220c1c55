"""Each law's equation, evaluated apart: pinocchio, numpy's singular values and pseudo-inverse, the forward dynamics."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from oracle import Oracle

from dextar_control.contract.robot import RobotParameters
from dextar_control.core.dynamics import joint_acceleration, wrenches
from dextar_control.core.kinematics import Kinematics, singular_values, singular_vectors, singularity, state_of_platform
from dextar_control.core.law import (
    ESTIMATE,
    LAMBDA_REF,
    OUTPUT,
    Q_HAT,
    Q_REF,
    S_REF,
    SCALARS,
    TAU,
    X_HAT,
    X_REF,
    Gains,
    Law,
    control,
    smooth_step,
)
from dextar_control.core.model import make_model, pack
from dextar_control.core.planner import Plan, plan_return_trip
from dextar_control.core.search import Criterion

GAINS = Gains(K_p=1600.0, K_d=80.0, K_i=0.0, zone=0.2, zone_width=0.3, friction_compensation=1.0)
NO_LIMIT = 1e9  # N m
RELATIVE = 1e-9  # two exact formulations in float64
LIMIT_AGREEMENT = 1e-4  # of the peak torque, between the locus and 1e-6 s beside it, and of the profile's interpolation
POSITION, VELOCITY = 1e-3, 20e-3  # m, m/s: errors of a tick
SLOPE = 2.0  # N m over |s|: measured 1.1 for a continuous law with these errors, 400 and more for one that steps
U1_MOVING, U1_RESTING = 0.03, 0.005  # of the feedback: measured 0.014 and 0.002
EPSILON = 1e-4  # of the errors, where a first-order statement is tested


class Bench:
    """A law's tick at a moment of a plan, with an error."""

    def __init__(self, robot: RobotParameters, plan: Plan) -> None:
        self.robot, self.plan = robot, plan
        self.model = make_model(robot)
        self.packed = pack(self.model)
        self.oracle = Oracle(robot)
        self.crossing = float(plan.certificate.crossing_times[0])

    def reference(self, time: float) -> np.ndarray:
        point, profile = self.plan.trajectory.at(time), self.plan.certificate.profile
        kin = state_of_platform(self.model, point.x, point.x_dot)
        multipliers = [np.interp(time, profile.time, profile.multipliers[:, i]) for i in range(2)]
        s = singularity(self.model, kin.A_r)
        return np.concatenate([point.x, point.x_dot, point.x_ddot, kin.q_a, kin.q_a_dot, [s], multipliers])

    def estimate(self, x: np.ndarray, x_dot: np.ndarray) -> np.ndarray:
        kin = state_of_platform(self.model, x, x_dot)
        row = np.concatenate([x, x_dot, kin.q_a, kin.q_a_dot, [1.0, 1.0]])
        assert len(row) == ESTIMATE
        return row

    def tick(self, law: Law, reference: np.ndarray, estimate: np.ndarray, gains: Gains = GAINS, limit: float = NO_LIMIT):
        out = np.zeros(OUTPUT)
        control(self.packed, gains, int(law), reference, estimate, np.zeros(2), limit, 1e-3, out)
        return out

    def tau(self, law: Law, reference: np.ndarray, estimate: np.ndarray) -> np.ndarray:
        return self.tick(law, reference, estimate)[TAU : TAU + 2]

    def asked(self, reference: np.ndarray, estimate: np.ndarray) -> np.ndarray:
        """u: section 3."""
        error = reference[X_REF : X_REF + 4] - estimate[X_HAT : X_HAT + 4]
        return reference[X_REF + 4 : X_REF + 6] + GAINS.K_d * error[2:] + GAINS.K_p * error[:2]

    def samples(self, count: int, least: float, most: float) -> Iterator[tuple[np.ndarray, np.ndarray, Kinematics]]:
        """Reference, estimate a millimetre off, and the state of the estimate with least < |s| < most on the way out."""
        generator, found = np.random.default_rng(0), 0
        while found < count:
            reference = self.reference(generator.uniform(self.crossing - 0.12, self.crossing + 0.12))
            x = reference[X_REF : X_REF + 2] + generator.normal(0.0, POSITION, 2)
            estimate = self.estimate(x, reference[X_REF + 2 : X_REF + 4] + generator.normal(0.0, VELOCITY, 2))
            kin = state_of_platform(self.model, x, estimate[X_HAT + 2 : X_HAT + 4])
            if least < abs(singularity(self.model, kin.A_r)) < most:
                found += 1
                yield reference, estimate, kin


@pytest.fixture(scope="module")
def bench(robot: RobotParameters, trip: Plan) -> Bench:
    return Bench(robot, trip)


@pytest.fixture(scope="module")
def zero_wrench(robot: RobotParameters) -> Bench:
    start, goal = np.array([-0.025, 0.115]), np.array([0.01, 0.06])
    return Bench(robot, plan_return_trip(robot, start, goal, 0.33, 0.2, criterion=Criterion.ZERO_WRENCH))


def _close(ours: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(ours, expected, rtol=RELATIVE, atol=RELATIVE * np.abs(expected).max())


def test_classic_is_inverse_dynamics_of_what_is_asked(bench: Bench) -> None:
    """Eq. 4, near the locus too: there the same torque is large."""
    for reference, estimate, kin in bench.samples(60, 0.01, 1.0):
        expected = bench.oracle.inverse(kin.q_a, kin.x, kin.x_dot, bench.asked(reference, estimate))
        _close(bench.tau(Law.CLASSIC, reference, estimate), expected)


@pytest.mark.parametrize("law", [Law.PROJECTED, Law.CONSISTENT, Law.MULTI_MODEL])
def test_outside_their_zones_the_laws_are_the_classic_one(bench: Bench, law: Law) -> None:
    outside = GAINS.zone + (0.5 * GAINS.zone_width if law is Law.CONSISTENT else 0.0)
    for reference, estimate, _ in bench.samples(40, outside, 1.0):
        _close(bench.tau(law, reference, estimate), bench.tau(Law.CLASSIC, reference, estimate))


def test_projected_is_the_least_torque_of_the_projected_wrench(bench: Bench) -> None:
    """Eq. 9 by numpy; J_inv counts as of rank one in the whole band, as it is on the locus."""
    for reference, estimate, kin in bench.samples(60, 0.0, GAINS.zone):
        w_b, w_d = wrenches(bench.model, kin, bench.asked(reference, estimate))
        Vt = np.linalg.svd(kin.A_r)[2]
        image = np.outer(Vt[0], Vt[0])
        J = np.linalg.svd(kin.J_inv, compute_uv=False)
        cut = np.sqrt(J[1] / J[0]) if J[1] > 0.0 else 0.5
        expected = np.linalg.pinv(kin.J_inv.T, rcond=cut) @ (kin.J_inv.T @ w_b + image @ w_d)
        _close(bench.tau(Law.PROJECTED, reference, estimate), expected)


def test_projected_drops_the_internal_force_at_the_bands_edge(bench: Bench) -> None:
    """Without any error: what steps is the plan's own torque."""
    times = bench.crossing + np.linspace(-0.05, 0.0, 2001)
    rows = [bench.reference(time) for time in times]
    edge = int(np.argmax([abs(row[S_REF]) < GAINS.zone for row in rows]))
    inside, outside = (bench.tau(Law.PROJECTED, rows[k], bench.estimate(rows[k][0:2], rows[k][2:4])) for k in (edge, edge - 1))
    step = inside - outside
    J = singular_vectors(state_of_platform(bench.model, rows[edge][0:2], rows[edge][2:4]).J_inv, np.array([1.0, 0.0]))
    assert np.abs(step).max() > 0.05 * bench.plan.certificate.peak_torque
    assert abs(J.u2 @ step) > 0.9 * np.hypot(*step)


def test_consistent_is_its_equation_by_numpys_singular_values(bench: Bench) -> None:
    for reference, estimate, kin in bench.samples(60, 0.0, 1.0):
        w_b, w_d = wrenches(bench.model, kin, bench.asked(reference, estimate))
        U, sigma, Vt = np.linalg.svd(kin.A_r)
        s = abs(np.linalg.det(kin.A_r)) / np.prod([leg.distal_length for leg in bench.robot.legs])
        phi = smooth_step(s, GAINS.zone - 0.5 * GAINS.zone_width, GAINS.zone + 0.5 * GAINS.zone_width)
        weak = (1.0 - phi) * (U[:, 1] @ reference[LAMBDA_REF:]) + phi * (Vt[1] @ w_d) / sigma[1]
        multipliers = U[:, 0] * (Vt[0] @ w_d) / sigma[0] + U[:, 1] * weak
        out = bench.tick(Law.CONSISTENT, reference, estimate)
        np.testing.assert_allclose(out[TAU : TAU + 2], w_b - kin.B * multipliers, rtol=1e-8, atol=1e-9)
        assert out[SCALARS + 3] == pytest.approx(phi, abs=1e-9)


@pytest.mark.parametrize("law", [Law.CONSISTENT, Law.JOINT_SPACE])
def test_without_an_error_the_torque_is_the_plans_up_to_its_limit_on_the_locus(bench: Bench, law: Law) -> None:
    """By the oracle beside the locus, and on it by what is found a microsecond before and after."""
    peak = bench.plan.certificate.peak_torque
    for time in bench.crossing + np.array([-0.1, -0.03, -0.01, -1e-3, -1e-6, 0.0, 1e-6, 1e-3, 0.01, 0.1]):
        row = bench.reference(time)
        near = time if abs(row[S_REF]) > 1e-6 else bench.crossing + 1e-6
        exact = bench.reference(near)
        expected = bench.oracle.inverse(exact[Q_REF : Q_REF + 2], exact[0:2], exact[2:4], exact[4:6])
        tau = bench.tau(law, row, bench.estimate(row[0:2], row[2:4]))
        np.testing.assert_allclose(tau, expected, rtol=0.0, atol=10.0 * LIMIT_AGREEMENT * peak)


@pytest.mark.parametrize("law", [Law.CONSISTENT, Law.JOINT_SPACE])
def test_with_an_error_nothing_jumps_in_the_zone_or_on_the_locus(bench: Bench, law: Law) -> None:
    """The same error carried along the plan in steps of 20 microseconds; the classic law fails this."""

    def steepest(which: Law) -> float:
        times = bench.crossing + np.linspace(-0.06, 0.06, 6001)
        rows = np.array([bench.reference(time) for time in times])
        off, off_dot = POSITION * np.array([0.6, -0.8]), VELOCITY * np.array([0.8, 0.6])
        taus = np.array([bench.tau(which, row, bench.estimate(row[0:2] + off, row[2:4] + off_dot)) for row in rows])
        steps = np.abs(np.diff(taus, axis=0)).max(axis=1)
        return float((steps / np.abs(np.diff(rows[:, S_REF]))).max())

    assert steepest(law) < SLOPE
    assert steepest(Law.CLASSIC) > 10.0 * SLOPE
    assert steepest(Law.PROJECTED) > 10.0 * SLOPE


def test_multi_model_is_the_joints_computed_torque_inside_its_band(zero_wrench: Bench) -> None:
    """tau = w_b with q_a_ddot = q_a_ddot_ref + K_d e_dot + K_p e: Eq. 10 with its cross terms."""
    bench = zero_wrench
    for reference, estimate, kin in bench.samples(40, 0.0, GAINS.zone):
        planned = state_of_platform(bench.model, reference[0:2], reference[2:4])
        error = reference[Q_REF : Q_REF + 4] - estimate[Q_HAT : Q_HAT + 4]
        q_a_ddot = joint_acceleration(planned, reference[4:6]) + GAINS.K_d * error[2:] + GAINS.K_p * error[:2]
        normals = np.column_stack([-np.sin(kin.q_a), np.cos(kin.q_a)])
        coupling = (bench.model.m_Px * bench.model.l1)[:, None] * normals
        _close(bench.tau(Law.MULTI_MODEL, reference, estimate), bench.model.M_a * q_a_ddot + coupling @ reference[4:6])


def test_multi_model_needs_plans_with_no_wrench_on_the_platform(bench: Bench, zero_wrench: Bench) -> None:
    """On the locus its torque moves the platform as planned with such a plan, and not with one that only meets Eq. 5."""

    def miss(here: Bench) -> float:
        row = here.reference(here.crossing)
        tau = here.tau(Law.MULTI_MODEL, row, here.estimate(row[0:2], row[2:4]))
        moved = here.oracle.forward(row[Q_REF : Q_REF + 2], row[0:2], row[2:4], tau)
        return float(np.hypot(*(moved - row[4:6])))

    row = zero_wrench.reference(zero_wrench.crossing)
    _, w_d = wrenches(zero_wrench.model, state_of_platform(zero_wrench.model, row[0:2], row[2:4]), row[4:6])
    assert np.abs(w_d).max() < 1e-8
    assert miss(zero_wrench) < 1e-5
    assert miss(bench) > 0.1


def test_joint_space_does_not_look_at_the_platforms_estimate(bench: Bench) -> None:
    for reference, estimate, _ in bench.samples(20, 0.0, 1.0):
        blind = estimate.copy()
        blind[X_HAT : X_HAT + 4] = [0.03, 0.09, 1.0, -1.0]
        np.testing.assert_array_equal(
            bench.tau(Law.JOINT_SPACE, reference, blind), bench.tau(Law.JOINT_SPACE, reference, estimate)
        )


def _left_over(bench: Bench, reference: np.ndarray, seed: int) -> np.ndarray:
    """Rms over random errors of e_ddot + K_d e_dot + K_p e along u1 and u2, and of the feedback along them, per unit of error.

    The torque of ``joint_space`` acts on the oracle engine at the true state; finite differences of size EPSILON.
    """
    generator, rows = np.random.default_rng(seed), []
    planned = state_of_platform(bench.model, reference[0:2], reference[2:4])
    J = singular_vectors(planned.J_inv, singular_values(planned.A_r).v2)
    for _ in range(20):
        x = reference[0:2] + EPSILON * generator.normal(0.0, POSITION, 2)
        x_dot = reference[2:4] + EPSILON * generator.normal(0.0, VELOCITY, 2)
        true = state_of_platform(bench.model, x, x_dot)
        tau = bench.tau(Law.JOINT_SPACE, reference, bench.estimate(x, x_dot))
        q_a_ddot = joint_acceleration(true, bench.oracle.forward(true.q_a, x, x_dot, tau))
        feedback = GAINS.K_d * (planned.q_a_dot - true.q_a_dot) + GAINS.K_p * (planned.q_a - true.q_a)
        left = joint_acceleration(planned, reference[4:6]) - q_a_ddot + feedback
        rows.append([J.u1 @ left, J.u2 @ left, J.u1 @ feedback, J.u2 @ feedback])
    return np.sqrt(np.mean(np.square(rows), axis=0)) / EPSILON


def _at_rest(reference: np.ndarray) -> np.ndarray:
    held = reference.copy()
    held[2:6], held[Q_REF + 2 : Q_REF + 4], held[LAMBDA_REF:] = 0.0, 0.0, 0.0
    return held


PLACES = (-0.1, -0.03, -0.01, -0.003, 0.0, 0.003, 0.01, 0.03)  # s from the crossing: both sides of the zone and the locus


@pytest.mark.parametrize("place", PLACES)
def test_joint_space_gives_the_strong_direction_its_linear_error_equation(bench: Bench, place: float) -> None:
    """All but a hundredth of the feedback, also on the locus: the rest is how the matrices change with the error."""
    reference = bench.reference(bench.crossing + place)
    left, _, feedback, _ = _left_over(bench, reference, 1)
    assert left < U1_MOVING * feedback
    left, _, feedback, _ = _left_over(bench, _at_rest(reference), 2)
    assert left < U1_RESTING * feedback


def test_joint_space_gives_both_directions_theirs_at_rest_outside_the_zone(bench: Bench) -> None:
    reference = _at_rest(bench.reference(bench.crossing - 0.1))
    assert abs(reference[S_REF]) > GAINS.zone + 0.5 * GAINS.zone_width
    left_1, left_2, feedback_1, feedback_2 = _left_over(bench, reference, 3)
    assert left_1 < 1e-3 * feedback_1
    assert left_2 < 1e-3 * feedback_2


def test_joint_space_has_no_feedback_along_the_weak_direction_inside_the_zone(bench: Bench) -> None:
    """All of what u2 asks for is left over there."""
    reference = _at_rest(bench.reference(bench.crossing - 0.003))
    assert abs(reference[S_REF]) < GAINS.zone - 0.5 * GAINS.zone_width
    _, left, _, feedback = _left_over(bench, reference, 4)
    assert left == pytest.approx(feedback, rel=0.05)


@pytest.mark.parametrize("law", list(Law))
def test_every_law_compensates_the_reference_s_friction_and_keeps_the_limit(robot: RobotParameters, trip: Plan, law: Law) -> None:
    rough = robot.replace(**{"left.coulomb_friction": 0.05, "right.viscous_friction": 0.01})
    smooth_bench, rough_bench = Bench(robot, trip), Bench(rough, trip)
    for reference, estimate, _ in smooth_bench.samples(10, 0.05, 1.0):
        extra = rough_bench.tau(law, reference, estimate) - smooth_bench.tau(law, reference, estimate)
        rate = reference[Q_REF + 2 : Q_REF + 4]
        np.testing.assert_allclose(extra, [0.05 * np.tanh(rate[0] / robot.coulomb_speed), 0.01 * rate[1]], atol=1e-9)
        held = smooth_bench.tick(law, reference, estimate, limit=0.02)[TAU : TAU + 2]
        np.testing.assert_array_equal(held, np.clip(smooth_bench.tau(law, reference, estimate), -0.02, 0.02))
