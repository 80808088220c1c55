"""Each law's equation, evaluated apart: pinocchio, numpy's singular values and
pseudo-inverse, the forward dynamics.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from closed_loop import state_of
from oracle import Oracle

from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.settings import LAWS
from dextar_control.control.law import GAINS as GAIN_FIELDS
from dextar_control.control.law import OUTPUT, law_of
from dextar_control.estimation.records import ESTIMATE, REFERENCE
from dextar_control.model.model import Model
from dextar_control.planning.planner import Plan, plan_return_trip
from dextar_control.planning.search import CrossingCriterion
from dextar_control.symbols.functions import Fast
from dextar_control.symbols.record import Layout, Record

GAINS = Layout("gains", 2, GAIN_FIELDS).make(
    K_p=1600.0, K_d=80.0, K_i=0.0, zone=0.2, zone_width=0.3, friction_compensation=1.0
)
REFERENCES, ESTIMATES, OUTPUTS = (
    Layout(name, 2, fields)
    for name, fields in (
        ("reference", REFERENCE),
        ("estimate", ESTIMATE),
        ("output", OUTPUT),
    )
)
NO_LIMIT = 1e9  # N m
RELATIVE = 1e-9  # two exact formulations in float64
# of the peak torque, between the locus and 1e-6 s beside it, and of the profile's
# interpolation
LIMIT_AGREEMENT = 1e-4
POSITION, VELOCITY = 1e-3, 20e-3  # m, m/s: errors of a tick
# N m over |s|: measured 1.1 for a continuous law with these errors, 400 and more for
# one that steps
SLOPE = 2.0
U1_MOVING, U1_RESTING = 0.03, 0.005  # of the feedback: measured 0.014 and 0.002
EPSILON = 1e-4  # of the errors, where a first-order statement is tested


def smooth_step(value: float, low: float, high: float) -> float:
    z = min(max((value - low) / (high - low), 0.0), 1.0)
    return z**3 * (10.0 - 15.0 * z + 6.0 * z * z)


class Bench:
    """A law's tick at a moment of a plan, with an error."""

    def __init__(self, robot: RobotParameters, plan: Plan) -> None:
        self.robot, self.plan = robot, plan
        self.model = Model.of(robot)
        self.oracle = Oracle(robot)
        self.crossing = float(plan.certificate.crossing_times[0])
        self._laws = {law: Fast(law_of(self.model.mechanism, law)) for law in LAWS}

    def reference(self, time: float) -> Record:
        point, profile = self.plan.trajectory.at(time), self.plan.certificate.profile
        kin = state_of(self.model, point.x, point.x_dot)
        multipliers = [
            np.interp(time, profile.time, profile.multipliers[:, i]) for i in range(2)
        ]
        return REFERENCES.make(
            x=point.x,
            x_dot=point.x_dot,
            x_ddot=point.x_ddot,
            q_a=kin.q_a,
            q_a_dot=kin.q_a_dot,
            multipliers=multipliers,
            s=kin.s[0],
        )

    def estimate(self, x: np.ndarray, x_dot: np.ndarray) -> Record:
        kin = state_of(self.model, x, x_dot)
        return ESTIMATES.make(
            x=x,
            x_dot=x_dot,
            q_a=kin.q_a,
            q_a_dot=kin.q_a_dot,
            assembly_mode=1.0,
            confidence=1.0,
        )

    def tick(
        self,
        law: str,
        reference: Record,
        estimate: Record,
        gains: Record = GAINS,
        limit: float = NO_LIMIT,
    ) -> Record:
        found = self._laws[law](
            self.model.p,
            gains.numbers,
            reference.numbers,
            estimate.numbers,
            np.zeros(2),
            limit,
            1e-3,
        )
        return OUTPUTS.of(found.output)

    def tau(self, law: str, reference: Record, estimate: Record) -> np.ndarray:
        return self.tick(law, reference, estimate).tau

    def asked(self, reference: Record, estimate: Record) -> np.ndarray:
        """u: section 3."""
        error, error_dot = reference.x - estimate.x, reference.x_dot - estimate.x_dot
        return reference.x_ddot + GAINS.K_d * error_dot + GAINS.K_p * error

    def wrenches(self, kin: SimpleNamespace, x_ddot: np.ndarray) -> SimpleNamespace:
        return self.model.wrenches(kin.q_a, kin.x, kin.x_dot, x_ddot)

    def samples(
        self, count: int, least: float, most: float
    ) -> Iterator[tuple[Record, Record, SimpleNamespace]]:
        """Reference, estimate a millimetre off, and the state of the estimate with
        least < |s| < most on the way out.
        """
        generator, found = np.random.default_rng(0), 0
        while found < count:
            reference = self.reference(
                generator.uniform(self.crossing - 0.12, self.crossing + 0.12)
            )
            x = reference.x + generator.normal(0.0, POSITION, 2)
            estimate = self.estimate(
                x, reference.x_dot + generator.normal(0.0, VELOCITY, 2)
            )
            kin = state_of(self.model, x, estimate.x_dot)
            if least < abs(kin.s[0]) < most:
                found += 1
                yield reference, estimate, kin


@pytest.fixture(scope="module")
def bench(robot: RobotParameters, trip: Plan) -> Bench:
    return Bench(robot, trip)


@pytest.fixture(scope="module")
def zero_wrench(robot: RobotParameters) -> Bench:
    start, goal = np.array([-0.025, 0.115]), np.array([0.01, 0.06])
    return Bench(
        robot,
        plan_return_trip(
            robot, start, goal, 0.33, 0.2, criterion=CrossingCriterion.ZERO_WRENCH
        ),
    )


def _close(ours: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(
        ours, expected, rtol=RELATIVE, atol=RELATIVE * np.abs(expected).max()
    )


def test_classic_is_inverse_dynamics_of_what_is_asked(bench: Bench) -> None:
    """Eq. 4, near the locus too: there the same torque is large."""
    for reference, estimate, kin in bench.samples(60, 0.01, 1.0):
        expected = bench.oracle.inverse(
            kin.q_a, kin.x, kin.x_dot, bench.asked(reference, estimate)
        )
        _close(bench.tau("classic", reference, estimate), expected)


@pytest.mark.parametrize("law", ["projected", "consistent", "multi_model"])
def test_outside_their_zones_the_laws_are_the_classic_one(
    bench: Bench, law: str
) -> None:
    outside = GAINS.zone + (0.5 * GAINS.zone_width if law == "consistent" else 0.0)
    for reference, estimate, _ in bench.samples(40, outside, 1.0):
        _close(
            bench.tau(law, reference, estimate),
            bench.tau("classic", reference, estimate),
        )


def test_projected_is_the_least_torque_of_the_projected_wrench(bench: Bench) -> None:
    """Eq. 9 by numpy; J_inv counts as of rank one in the whole band, as it is on the
    locus.
    """
    for reference, estimate, kin in bench.samples(60, 0.0, GAINS.zone):
        found = bench.wrenches(kin, bench.asked(reference, estimate))
        w_b, w_d = found.w_b, found.w_d
        Vt = np.linalg.svd(kin.A_r)[2]
        image = np.outer(Vt[0], Vt[0])
        J = np.linalg.svd(kin.J_inv, compute_uv=False)
        cut = np.sqrt(J[1] / J[0]) if J[1] > 0.0 else 0.5
        expected = np.linalg.pinv(kin.J_inv.T, rcond=cut) @ (
            kin.J_inv.T @ w_b + image @ w_d
        )
        _close(bench.tau("projected", reference, estimate), expected)


def test_projected_drops_the_internal_force_at_the_bands_edge(bench: Bench) -> None:
    """Without any error: what steps is the plan's own torque."""
    times = bench.crossing + np.linspace(-0.05, 0.0, 2001)
    rows = [bench.reference(time) for time in times]
    edge = int(np.argmax([abs(row.s) < GAINS.zone for row in rows]))
    inside, outside = (
        bench.tau("projected", rows[k], bench.estimate(rows[k].x, rows[k].x_dot))
        for k in (edge, edge - 1)
    )
    step = inside - outside
    weak = np.linalg.svd(state_of(bench.model, rows[edge].x, rows[edge].x_dot).J_inv)[
        0
    ][:, 1]
    assert np.abs(step).max() > 0.05 * bench.plan.certificate.peak_torque
    assert abs(weak @ step) > 0.9 * np.hypot(*step)


def test_consistent_is_its_equation_by_numpys_singular_values(bench: Bench) -> None:
    for reference, estimate, kin in bench.samples(60, 0.0, 1.0):
        found = bench.wrenches(kin, bench.asked(reference, estimate))
        w_b, w_d = found.w_b, found.w_d
        U, sigma, Vt = np.linalg.svd(kin.A_r)
        s = abs(np.linalg.det(kin.A_r)) / np.prod(
            [leg.distal_length for leg in bench.robot.legs]
        )
        phi = smooth_step(
            s, GAINS.zone - 0.5 * GAINS.zone_width, GAINS.zone + 0.5 * GAINS.zone_width
        )
        weak = (1.0 - phi) * (U[:, 1] @ reference.multipliers) + phi * (
            Vt[1] @ w_d
        ) / sigma[1]
        multipliers = U[:, 0] * (Vt[0] @ w_d) / sigma[0] + U[:, 1] * weak
        out = bench.tick("consistent", reference, estimate)
        np.testing.assert_allclose(
            out.tau, w_b - kin.B.T @ multipliers, rtol=1e-8, atol=1e-9
        )
        assert out.weight == pytest.approx(phi, abs=1e-9)


@pytest.mark.parametrize("law", ["consistent", "joint_space"])
def test_without_an_error_the_torque_is_the_plans_up_to_its_limit_on_the_locus(
    bench: Bench, law: str
) -> None:
    """By the oracle beside the locus, and on it by what is found a microsecond before
    and after.
    """
    peak = bench.plan.certificate.peak_torque
    for time in bench.crossing + np.array(
        [-0.1, -0.03, -0.01, -1e-3, -1e-6, 0.0, 1e-6, 1e-3, 0.01, 0.1]
    ):
        row = bench.reference(time)
        near = time if abs(row.s) > 1e-6 else bench.crossing + 1e-6
        exact = bench.reference(near)
        expected = bench.oracle.inverse(exact.q_a, exact.x, exact.x_dot, exact.x_ddot)
        tau = bench.tau(law, row, bench.estimate(row.x, row.x_dot))
        np.testing.assert_allclose(
            tau, expected, rtol=0.0, atol=10.0 * LIMIT_AGREEMENT * peak
        )


@pytest.mark.parametrize("law", ["consistent", "joint_space"])
def test_with_an_error_nothing_jumps_in_the_zone_or_on_the_locus(
    bench: Bench, law: str
) -> None:
    """The same error carried along the plan in steps of 20 microseconds; the classic
    law fails this.
    """

    def steepest(which: str) -> float:
        times = bench.crossing + np.linspace(-0.06, 0.06, 6001)
        rows = [bench.reference(time) for time in times]
        off, off_dot = POSITION * np.array([0.6, -0.8]), VELOCITY * np.array([0.8, 0.6])
        taus = np.array(
            [
                bench.tau(which, row, bench.estimate(row.x + off, row.x_dot + off_dot))
                for row in rows
            ]
        )
        steps = np.abs(np.diff(taus, axis=0)).max(axis=1)
        return float((steps / np.abs(np.diff([row.s for row in rows]))).max())

    assert steepest(law) < SLOPE
    assert steepest("classic") > 10.0 * SLOPE
    assert steepest("projected") > 10.0 * SLOPE


def test_multi_model_is_the_joints_computed_torque_inside_its_band(
    zero_wrench: Bench,
) -> None:
    """tau = w_b with q_a_ddot = q_a_ddot_ref + K_d e_dot + K_p e: Eq. 10 with its cross
    terms.
    """
    bench = zero_wrench
    for reference, estimate, kin in bench.samples(40, 0.0, GAINS.zone):
        planned = bench.wrenches(
            state_of(bench.model, reference.x, reference.x_dot), reference.x_ddot
        )
        feedback = GAINS.K_d * (reference.q_a_dot - estimate.q_a_dot) + GAINS.K_p * (
            reference.q_a - estimate.q_a
        )
        q_a_ddot = planned.q_a_ddot + feedback
        normals = np.column_stack([-np.sin(kin.q_a), np.cos(kin.q_a)])
        legs = bench.robot.legs
        m_Px = [
            leg.distal_mass * leg.distal_center * (1 - leg.distal_center)
            - leg.distal_inertia / leg.distal_length**2
            for leg in legs
        ]
        m_PP = [
            leg.distal_mass * (1 - leg.distal_center) ** 2
            + leg.distal_inertia / leg.distal_length**2
            for leg in legs
        ]
        M_a = [
            leg.proximal_inertia
            + leg.proximal_mass * (leg.proximal_center * leg.proximal_length) ** 2
            + leg.rotor_inertia
            + m * leg.proximal_length**2
            for leg, m in zip(legs, m_PP, strict=True)
        ]
        coupling = (np.array(m_Px) * [leg.proximal_length for leg in legs])[
            :, None
        ] * normals
        _close(
            bench.tau("multi_model", reference, estimate),
            M_a * q_a_ddot + coupling @ reference.x_ddot,
        )


def test_multi_model_needs_plans_with_no_wrench_on_the_platform(
    bench: Bench, zero_wrench: Bench
) -> None:
    """On the locus its torque moves the platform as planned with such a plan, and not
    with one that only meets Eq. 5.
    """

    def miss(here: Bench) -> float:
        row = here.reference(here.crossing)
        tau = here.tau("multi_model", row, here.estimate(row.x, row.x_dot))
        moved = here.oracle.forward(row.q_a, row.x, row.x_dot, tau)
        return float(np.hypot(*(moved - row.x_ddot)))

    row = zero_wrench.reference(zero_wrench.crossing)
    w_d = zero_wrench.wrenches(
        state_of(zero_wrench.model, row.x, row.x_dot), row.x_ddot
    ).w_d
    assert np.abs(w_d).max() < 1e-8
    assert miss(zero_wrench) < 1e-5
    assert miss(bench) > 0.1


def test_joint_space_does_not_look_at_the_platforms_estimate(bench: Bench) -> None:
    for reference, estimate, _ in bench.samples(20, 0.0, 1.0):
        blind = estimate.copy()
        blind.x, blind.x_dot = [0.03, 0.09], [1.0, -1.0]
        np.testing.assert_array_equal(
            bench.tau("joint_space", reference, blind),
            bench.tau("joint_space", reference, estimate),
        )


def _left_over(bench: Bench, reference: Record, seed: int) -> np.ndarray:
    """Rms over random errors of e_ddot + K_d e_dot + K_p e along u1 and u2, and of the
    feedback along them, per unit of error.

    The torque of ``joint_space`` acts on the oracle engine at the true state; finite
    differences of size EPSILON.
    """
    generator, rows = np.random.default_rng(seed), []
    planned = state_of(bench.model, reference.x, reference.x_dot)
    strong, weak = np.linalg.svd(planned.J_inv)[0].T
    planned_ddot = bench.wrenches(planned, reference.x_ddot).q_a_ddot
    for _ in range(20):
        x = reference.x + EPSILON * generator.normal(0.0, POSITION, 2)
        x_dot = reference.x_dot + EPSILON * generator.normal(0.0, VELOCITY, 2)
        true = state_of(bench.model, x, x_dot)
        tau = bench.tau("joint_space", reference, bench.estimate(x, x_dot))
        q_a_ddot = bench.wrenches(
            true, bench.oracle.forward(true.q_a, x, x_dot, tau)
        ).q_a_ddot
        feedback = GAINS.K_d * (planned.q_a_dot - true.q_a_dot) + GAINS.K_p * (
            planned.q_a - true.q_a
        )
        left = planned_ddot - q_a_ddot + feedback
        rows.append([strong @ left, weak @ left, strong @ feedback, weak @ feedback])
    return np.sqrt(np.mean(np.square(rows), axis=0)) / EPSILON


def _at_rest(reference: Record) -> Record:
    held = reference.copy()
    held.x_dot, held.x_ddot, held.q_a_dot, held.multipliers = 0.0, 0.0, 0.0, 0.0
    return held


PLACES = (
    -0.1,
    -0.03,
    -0.01,
    -0.003,
    0.0,
    0.003,
    0.01,
    0.03,
)  # s from the crossing: both sides of the zone and the locus


@pytest.mark.parametrize("place", PLACES)
def test_joint_space_gives_the_strong_direction_its_linear_error_equation(
    bench: Bench, place: float
) -> None:
    """All but a hundredth of the feedback, also on the locus: the rest is how the
    matrices change with the error.
    """
    reference = bench.reference(bench.crossing + place)
    left, _, feedback, _ = _left_over(bench, reference, 1)
    assert left < U1_MOVING * feedback
    left, _, feedback, _ = _left_over(bench, _at_rest(reference), 2)
    assert left < U1_RESTING * feedback


def test_joint_space_gives_both_directions_theirs_at_rest_outside_the_zone(
    bench: Bench,
) -> None:
    reference = _at_rest(bench.reference(bench.crossing - 0.1))
    assert abs(reference.s) > GAINS.zone + 0.5 * GAINS.zone_width
    left_1, left_2, feedback_1, feedback_2 = _left_over(bench, reference, 3)
    assert left_1 < 1e-3 * feedback_1
    assert left_2 < 1e-3 * feedback_2


def test_joint_space_has_no_feedback_along_the_weak_direction_inside_the_zone(
    bench: Bench,
) -> None:
    """All of what u2 asks for is left over there."""
    reference = _at_rest(bench.reference(bench.crossing - 0.003))
    assert abs(reference.s) < GAINS.zone - 0.5 * GAINS.zone_width
    _, left, _, feedback = _left_over(bench, reference, 4)
    assert left == pytest.approx(feedback, rel=0.05)


@pytest.mark.parametrize("law", LAWS)
def test_every_law_compensates_the_reference_s_friction_and_keeps_the_limit(
    robot: RobotParameters, trip: Plan, law: str
) -> None:
    rough = robot.replace(
        **{"left.coulomb_friction": 0.05, "right.viscous_friction": 0.01}
    )
    smooth_bench, rough_bench = Bench(robot, trip), Bench(rough, trip)
    for reference, estimate, _ in smooth_bench.samples(10, 0.05, 1.0):
        extra = rough_bench.tau(law, reference, estimate) - smooth_bench.tau(
            law, reference, estimate
        )
        rate = reference.q_a_dot
        np.testing.assert_allclose(
            extra,
            [0.05 * np.tanh(rate[0] / robot.coulomb_speed), 0.01 * rate[1]],
            atol=1e-9,
        )
        held = smooth_bench.tick(law, reference, estimate, limit=0.02).tau
        np.testing.assert_array_equal(
            held, np.clip(smooth_bench.tau(law, reference, estimate), -0.02, 0.02)
        )
