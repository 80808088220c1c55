"""The extended Kalman filter over the Cartesian dynamics, on symbols: it is regular on
the Type 2 locus and needs no direct model.

State (x, x_dot, b, d). Process: x_ddot by the forward dynamics under the commanded
torque and d, which is regular on the locus; near it the input torques do not act along
t_s, so the filter coasts there. Measurement: q_a = inverse geometric model(x) + b,
regular as well; on the locus it has no component along t_s. Where the transmission is
compliant its twist is added, which follows from the torque
(``estimation.transmission``). b (n,) is the error of the joints by a wrong geometry:
without it a tenth of a millimetre is taken for motion along t_s, amplified by 1/s. d
(n,) are torques on the joints that are not modelled: friction, tilt, a payload, wrong
masses.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import casadi as ca

from dextar_control.estimation.records import ESTIMATE
from dextar_control.estimation.transmission import LEAST_STIFFNESS, transmission_over
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.mechanisms.planar import wrapped
from dextar_control.model.equations import Equations
from dextar_control.model.model import equations_of, equations_on
from dextar_control.model.solved import mirror_image
from dextar_control.symbols.functions import Library, cache_folder, in_place, named
from dextar_control.symbols.record import Field, Layout
from dextar_control.symbols.singular import blocks
from dextar_control.symbols.smooth import is_finite, smooth_step
from dextar_control.symbols.types import Symbol

TURN = 0.05  # rad/s of a joint over which its friction changes sign
# m/s, standard deviation added to x_dot of a state that may be on the wrong side
UNSURE_SPEED = 0.5
# standard deviation added to its b, opposed by x in the joints, over that of the start
UNSURE_BIAS = 2.0
KEPT = 0.05, 0.3  # |s| over which the samples begin to correct d
CLEAR = 0.2, 0.4  # |s| over which the scatter of the samples begins to count
# times the known variance of a sample, at which a jump of the innovation is bounded
JUMP = 4.0
# times the twist by the torque of the process noise, that counts as noise of a sample
TWISTED = 3.0
# s over which the scatter of the samples is averaged, where it rises and where it falls
SCATTER = 0.02, 0.3
BLIND = 0.02  # s before a position in which a blow near the locus may be unseen

FILTER = (
    Field("x", "m", "mean of the platform", "n"),
    Field("x_dot", "m/s", "mean of its velocity", "n"),
    Field("b", "rad", "mean error of the joints by a wrong geometry", "n"),
    Field("d", "N m", "mean of the torques on the joints that are not modelled", "n"),
    Field("x_ddot", "m/s^2", "acceleration of the last prediction", "n"),
    Field("innovation", "rad", "of the last sample", "n"),
    Field("innovation_square", "1", "of the last sample, normalised by its covariance"),
    Field("scatter", "rad^2", "half the mean squared step of the innovation", "n"),
    Field("twist", "rad", "of the transmissions: motors less joints", "n"),
    Field("twist_dot", "rad/s", "its rate", "n"),
    Field("covariance", "SI", "of (x, x_dot, b, d)", "4n", "4n"),
)
NOISE = (
    Field("encoder", "rad", "least standard deviation of a sample"),
    Field("scatter_gain", "1", "of the samples' scatter in their variance"),
    Field("bias", "rad", "of b at the start"),
    Field("bias_walk", "rad/sqrt(rad)", "of b's random walk as the joints move"),
    Field("torque", "N m", "of a sample's torque: friction and motors"),
    Field("acceleration", "m/s^2", "of a sample's acceleration: masses"),
    Field("disturbance", "N m", "of d at the start"),
    Field("disturbance_walk", "N m/sqrt(s)", "of d's random walk"),
    Field("disturbance_turn", "N m", "of d's change as the joint turns round"),
    Field("shock_gate", "1", "squared normalised innovation that only a blow explains"),
    Field("shock_speed", "m/s", "of x_dot after a blow"),
)
TOLD = (  # of one block of A_r
    Field("s", "1", "its singularity measure"),
    Field("s_variance", "1", "of s, by the covariance"),
    Field("type1", "1", "least distance of a leg to Type 1"),
    Field("folded", "1", "positive where the mirror image is far even near the locus"),
    Field("square", "1", "normalised, of the innovation of ``same``; nan without one"),
    Field("spread", "1", "ln det of that innovation's covariance"),
)


class _Filters:
    """The filter's steps for one mechanism."""

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism, self.n = mechanism, mechanism.n
        self.filter, self.noise, self.estimate, self.told = (
            Layout(name, self.n, fields)
            for name, fields in (
                ("filter", FILTER),
                ("noise", NOISE),
                ("estimate", ESTIMATE),
                ("told", TOLD),
            )
        )
        self._equations = equations_of(mechanism)
        self.blocks = blocks(self._equations.J_inv)  # of joints and coordinates
        self.vector, self.p = mechanism.symbols()

    def at(self, x: Symbol, x_dot: Symbol, tau: Symbol | float = 0.0) -> Equations:
        """Return the equations at a state of the platform, (n,), m, m/s."""
        return equations_on(self.mechanism, self.vector, x, x_dot, 0.0, tau)

    def begin(
        self, noise: dict[str, Symbol], x: Symbol, speed: Symbol
    ) -> dict[str, Symbol]:
        """Return the state of a robot at x (n,), m, known from its joints, so that the
        errors of x and b oppose each other there.
        """
        J = ca.inv(self.at(x, ca.SX.zeros(self.n)).J_inv)
        one, zero = ca.SX.eye(self.n), ca.SX.zeros(self.n, self.n)
        bias, encoder = noise["bias"] ** 2, noise["encoder"] ** 2
        covariance = ca.vertcat(
            ca.horzcat((bias + encoder) * J @ J.T, zero, -bias * J, zero),
            ca.horzcat(zero, speed**2 * one, zero, zero),
            ca.horzcat(-bias * J.T, zero, bias * one, zero),
            ca.horzcat(zero, zero, zero, noise["disturbance"] ** 2 * one),
        )
        rest = {
            field.name: ca.SX.zeros(1 if field.rows == 1 else self.n)
            for field in FILTER
        }
        return rest | {"x": x, "covariance": covariance}

    def predict(
        self,
        noise: dict[str, Symbol],
        state: dict[str, Symbol],
        tau: Symbol,
        dt: Symbol,
        *,
        test: bool = False,
    ) -> dict[str, Symbol]:
        """Return the state after dt, s, under tau (n,), N m: x_ddot by the forward
        dynamics in the middle of the step, and the covariance with it.

        b depends on the configuration, so that its random walk is one of the joints'
        motion: with a walk in time a robot at rest, whose joints cannot tell x from b,
        would drift away. The covariance takes x_ddot as independent of the state but d,
        which over a sample it nearly is. d moves rotors and links as one, so that its
        changes do not excite the twist. The torque's noise acts through M^-1 J_inv^T:
        not along t_s on the locus. In a test d may change sign with the joint's
        velocity, as friction does.
        """
        n, x, x_dot = self.n, state["x"], state["x_dot"]
        e = self.at(
            x + 0.5 * dt * x_dot, x_dot + 0.5 * dt * state["x_ddot"], tau + state["d"]
        )
        G = ca.solve(e.M, e.J_inv.T)  # x_ddot per torque
        x_ddot = e.forward_dynamics
        twist, twist_dot = state["twist"], state["twist_dot"]
        if transmission := transmission_over(self.mechanism.transmission(self.p), dt):
            held_back, rotors = transmission.held_back(twist, twist_dot, tau)
            links = e.M - e.J_inv.T @ ca.diag(rotors) @ e.J_inv
            acting = tau - e.friction - held_back + rotors * e.drift
            x_ddot = ca.solve(links, e.J_inv.T @ acting - e.h)
            twist, twist_dot = transmission.after(
                twist, twist_dot, tau, e.J_inv @ x_ddot + e.drift
            )
            x_ddot += G @ state["d"]
        F = ca.SX.eye(4 * n)
        F[:n, n : 2 * n] = dt * ca.SX.eye(n)
        F[:n, 3 * n :], F[n : 2 * n, 3 * n :] = 0.5 * dt**2 * G, dt * G
        P = F @ state["covariance"] @ F.T
        by_torque = (dt * noise["torque"]) ** 2 * G @ G.T
        P[n : 2 * n, n : 2 * n] += by_torque + (
            dt * noise["acceleration"]
        ) ** 2 * ca.SX.eye(n)
        moved = dt * ca.fabs(e.q_a_dot) * noise["bias_walk"] ** 2
        P[2 * n : 3 * n, 2 * n : 3 * n] += ca.diag(moved)
        walk = dt * noise["disturbance_walk"] ** 2 * ca.SX.ones(n)
        if test:
            turned = ca.fabs(
                ca.tanh(e.J_inv @ (x_dot + dt * x_ddot) / TURN)
                - ca.tanh(e.J_inv @ x_dot / TURN)
            )
            walk += 2.0 * turned * noise["disturbance_turn"] ** 2
        P[3 * n :, 3 * n :] += ca.diag(walk)
        return state | {
            "x": x + dt * (x_dot + 0.5 * dt * x_ddot),
            "x_dot": x_dot + dt * x_ddot,
            "x_ddot": x_ddot,
            "twist": twist,
            "twist_dot": twist_dot,
            "covariance": _symmetric(P),
        }

    def shocked(
        self,
        noise: dict[str, Symbol],
        state: dict[str, Symbol],
        dt: Symbol,
        struck: Symbol,
    ) -> dict[str, Symbol]:
        """Return the state with the covariance of a blow in the last dt, s, where
        ``struck`` is 1: shock_speed in x_dot, and what that makes of x.
        """
        n = self.n
        reach = ca.vertcat(dt * ca.SX.eye(n), ca.SX.eye(n), ca.SX.zeros(2 * n, n))
        added = struck * noise["shock_speed"] ** 2 * reach @ reach.T
        return state | {"covariance": state["covariance"] + added}

    def innovation(
        self, state: dict[str, Symbol], q_meas: Symbol
    ) -> tuple[Symbol, Symbol]:
        """Return (innovation (n,), rad, of the active joints on any turn, their
        Jacobian H (n, 4n)).
        """
        e = self.at(state["x"], ca.SX.zeros(self.n))
        none = ca.SX(self.n, self.n)
        H = ca.horzcat(e.J_inv, none, ca.SX.eye(self.n), none)
        return wrapped(q_meas - e.q_a - state["b"] - state["twist"]), H

    def update(
        self,
        state: dict[str, Symbol],
        innovation: Symbol,
        H: Symbol,
        variance: Symbol,
        parts: Sequence[Sequence[int]],
        taken: Symbol | float = 1.0,
    ) -> tuple[dict[str, Symbol], Symbol, Symbol]:
        """Return the Kalman update of a state.

        Args:
            state: before.
            innovation: (m,).
            H: Jacobian of the measurement, (m, 4n).
            variance: of the measurement, (m,) or one for all.
            parts: rows of the innovation that are judged together.
            taken: share of the gain with which d is corrected; what is not taken of d
                stays in the covariance (Schmidt's filter).

        Returns:
            (the state after, the normalised square of each part, ln det of its
            covariance).
        """
        n, P = self.n, state["covariance"]
        PH, S = _gain_parts(P, H, variance)
        K = PH @ ca.inv(S)
        step, less = K @ innovation, K @ PH.T
        less[3 * n :, 3 * n :] *= taken * (2.0 - taken)
        changed = {
            "x": state["x"] + step[:n],
            "x_dot": state["x_dot"] + step[n : 2 * n],
            "b": state["b"] + step[2 * n : 3 * n],
            "d": state["d"] + taken * step[3 * n :],
            "covariance": _symmetric(P - less),
        }
        squares = [
            ca.dot(innovation[rows], ca.solve(S[rows, rows], innovation[rows]))
            for rows in parts
        ]
        spreads = [ca.log(ca.det(S[rows, rows])) for rows in parts]
        return state | changed, ca.vertcat(*squares), ca.vertcat(*spreads)

    def correct(
        self,
        noise: dict[str, Symbol],
        state: dict[str, Symbol],
        q_meas: Symbol,
        dt: Symbol,
    ) -> tuple[dict[str, Symbol], Symbol]:
        """Return (the state corrected with the active joints (n,), rad, 1 where the
        robot was struck in the last dt, s).

        The variance of the samples grows with the jumps of the innovation from one to
        the next, as wrong stamps and a coarse encoder make them, and a soft
        transmission that this filter and the law excite. Slow changes, as by a wrong
        acceleration, do not count.

        Near the locus d is not corrected: for a force along t_s it would be a torque
        that grows as 1/s and changes its sign behind the locus.
        """
        innovation, H = self.innovation(state, q_meas)
        least = self.least_variance(noise)
        variance = least + noise["scatter_gain"] * state["scatter"]
        _, S = _gain_parts(state["covariance"], H, least + state["scatter"])
        square = ca.dot(innovation, ca.solve(S, innovation))
        struck = ca.if_else(square > noise["shock_gate"], 1.0, 0.0)
        near = ca.fabs(self.at(state["x"], ca.SX.zeros(self.n)).s)
        counts = smooth_step(near, *CLEAR) * (1.0 - struck)
        scatter = state["scatter"]
        most = JUMP * (noise["encoder"] ** 2 + scatter)
        more = ca.fmin(0.5 * (innovation - state["innovation"]) ** 2, most) - scatter
        rise, fall = (ca.fmin(dt / time, 1.0) for time in SCATTER)
        memory = {
            "innovation": (1.0 - struck) * innovation,
            "scatter": scatter + counts * ca.if_else(more > 0.0, rise, fall) * more,
        }
        taken, parts = smooth_step(near, *KEPT), [range(self.n)]
        struck_state = self.shocked(noise, state, dt, struck)
        moved, square, _ = self.update(
            struck_state, innovation, H, variance, parts, taken
        )
        return moved | memory | {"innovation_square": square}, struck

    def innovate(
        self, noise: dict[str, Symbol], state: dict[str, Symbol], q_meas: Symbol
    ) -> tuple[dict[str, Symbol], Symbol, Symbol]:
        """Return the ``update`` with the active joints (n,), rad, with a part for
        each block.
        """
        innovation, H = self.innovation(state, q_meas)
        parts = [rows for rows, _ in self.blocks]
        return self.update(state, innovation, H, self.least_variance(noise), parts)

    def least_variance(self, noise: dict[str, Symbol]) -> Symbol:
        """Return the variance (n,), rad^2, of the samples by the encoder and by a twist
        under unknown torques.
        """
        softness: Symbol | float = 0.0
        if numbers := self.mechanism.transmission(self.p):
            _, stiffness, _ = numbers
            softness = (stiffness > 0.0) / ca.fmax(stiffness, LEAST_STIFFNESS)
        return noise["encoder"] ** 2 + (TWISTED * noise["torque"] * softness) ** 2

    def position(
        self, state: dict[str, Symbol], x_meas: Symbol
    ) -> tuple[Symbol, Symbol]:
        """Return (innovation (n,), m, of an external position, its Jacobian H
        (n, 4n)).
        """
        H = ca.horzcat(ca.SX.eye(self.n), ca.SX(self.n, 3 * self.n))
        return x_meas - state["x"], H

    def unseen_blow(
        self, noise: dict[str, Symbol], state: dict[str, Symbol]
    ) -> dict[str, Symbol]:
        """Return the state with the covariance of an unseen blow along t_s at any time
        in the last BLIND, which may have been taken for b.
        """
        n = self.n
        t_s = self.at(state["x"], ca.SX.zeros(n)).singular.v_weak
        variance = noise["shock_speed"] ** 2 * t_s @ t_s.T
        added = ca.SX(4 * n, 4 * n)
        added[:n, :n] = variance * BLIND**2 / 3.0
        added[:n, n : 2 * n] = added[n : 2 * n, :n] = variance * BLIND / 2.0
        added[n : 2 * n, n : 2 * n] = variance
        added[2 * n : 3 * n, 2 * n : 3 * n] = noise["bias"] ** 2 * ca.SX.eye(n)
        return state | {"covariance": state["covariance"] + added}

    def unsure(
        self, noise: dict[str, Symbol], state: dict[str, Symbol]
    ) -> dict[str, Symbol]:
        """Return the state with which a test begins: had the filter been on the wrong
        side, x_dot, b and d would be wrong, in accord with the joints.

        The same covariance is added to the state and to its image, so that neither has
        an advantage.
        """
        n, one, P = self.n, ca.SX.eye(self.n), ca.SX(state["covariance"])
        P[3 * n :, :] = P[:, 3 * n :] = 0.0
        P[3 * n :, 3 * n :] = noise["disturbance"] ** 2 * one
        P[n : 2 * n, n : 2 * n] += UNSURE_SPEED**2 * one
        P[2 * n : 3 * n, 2 * n : 3 * n] += noise["bias"] ** 2 * one
        J = ca.inv(self.at(state["x"], ca.SX.zeros(n)).J_inv)
        apart = ca.vertcat(J, ca.SX.zeros(n, n), -one, ca.SX.zeros(n, n))
        P += (UNSURE_BIAS * noise["bias"]) ** 2 * apart @ apart.T
        return state | {"d": ca.SX.zeros(n), "covariance": P}

    def mirror(
        self, state: dict[str, Symbol], columns: Sequence[int]
    ) -> tuple[dict[str, Symbol], Symbol, Symbol]:
        """Return the mirror image of a state: the same joints and velocities in a
        block's other assembly mode, with the covariance.

        Returns:
            (the image, the parameters of its working mode, which may be another one,
            its distance to Type 1, 0 where there is no image).
        """
        n, mechanism = self.n, self.mechanism
        e = self.at(state["x"], state["x_dot"])
        other = ca.SX(state["x"])
        turned = mirror_image(self.mechanism, e.q_a, state["x"], self.p)
        other[columns] = turned[columns]
        J = ca.inv(self._equations.at(self.vector, e.q_a, other, ca.SX.zeros(n)).J_inv)
        T = ca.SX.eye(4 * n)
        T[:n, :n] = T[n : 2 * n, n : 2 * n] = J @ e.J_inv
        sines, sines_here = (
            mechanism.type1_sines(e.q_a, place, self.p) for place in (other, state["x"])
        )
        p, rows = ca.SX(self.vector), mechanism.rows().get("working_mode")
        if rows is not None:
            p[rows] *= ca.if_else(sines * sines_here < 0.0, -1.0, 1.0)
        q_a = mechanism.inverse_geometric_model(other, mechanism.named(p))
        off = ca.norm_1(q_a - e.q_a)
        image = state | {
            "x": other,
            "x_dot": J @ e.q_a_dot,
            "x_ddot": ca.SX.zeros(n),
            "covariance": _symmetric(T @ state["covariance"] @ T.T),
        }
        return image, p, ca.if_else(off < 1e-6, ca.mmin(ca.fabs(sines)), 0.0)

    def look(
        self, state: dict[str, Symbol], estimate: dict[str, Symbol], *sample: Symbol
    ) -> dict[str, Symbol]:
        """Return the records of TOLD, one for each block, and the estimate, whose
        assembly mode stays.

        Args:
            state: of the main filter.
            estimate: before.
            sample: (normalised square of the innovation, ln det of its covariance) of
                each block, (k,) each; none without a sample.
        """
        n, x = self.n, ca.SX.sym("x", self.n)
        slopes = ca.jacobian(self.at(x, ca.SX.zeros(n)).s_blocks, x)
        slopes = ca.substitute(slopes, x, state["x"])
        e, k = self.at(state["x"], state["x_dot"]), len(self.blocks)
        folded = self.mechanism.folded(e.q_a, state["x"], self.p) * ca.SX.ones(k)
        square, spread = sample or (ca.SX.nan(k), ca.SX.nan(k))
        told = [
            self.told.join(
                {
                    "s": e.s_blocks[block],
                    "s_variance": slope @ state["covariance"][:n, :n] @ slope.T,
                    "type1": e.type1,
                    "folded": folded[block],
                    "square": square[block],
                    "spread": spread[block],
                }
            )
            for block, slope in enumerate(ca.vertsplit(slopes))
        ]
        own = {field.name for field in ESTIMATE} & state.keys()
        now = {name: state[name] for name in own} | {
            "q_a": e.q_a + state["b"] + state["twist"],
            "q_a_dot": e.q_a_dot,
            "s": e.s,
        }
        return {
            "told": ca.vertcat(*told),
            "estimate_next": self.estimate.join(estimate | now),
        }


def _gain_parts(P: Symbol, H: Symbol, variance: Symbol) -> tuple[Symbol, Symbol]:
    """Return (P H^T, S = H P H^T + variance), of which the Kalman gain is made."""
    PH = P @ H.T
    return PH, H @ PH + ca.diag(variance * ca.SX.ones(H.shape[0]))


def _symmetric(matrix: Symbol) -> Symbol:
    """Return the symmetric matrix of the lower triangle of one that is so but for
    rounding.
    """
    return ca.tril2symm(ca.tril(matrix))


@lru_cache
def filters_of(mechanism: Mechanism) -> Library:
    """Return the steps of the filter as functions of the records' vectors."""
    f, n = _Filters(mechanism), mechanism.n
    state_vector, state = f.filter.symbols()
    noise_vector, noise = f.noise.symbols()
    tau, q_meas, x_meas = (ca.SX.sym(name, n) for name in ("tau", "q_meas", "x_meas"))
    dt, gap, speed, deviation = (
        ca.SX.sym(name) for name in ("dt", "gap", "speed", "deviation")
    )
    estimate_vector, estimate = f.estimate.symbols()
    p, whole = {"p": f.vector}, {"filter": state_vector}
    told, shown = {"noise": noise_vector}, {"estimate": estimate_vector}

    images = [f.mirror(state, columns) for _, columns in f.blocks]
    corrected, struck = f.correct(noise, state, q_meas, dt)
    innovated, square, spread = f.innovate(noise, state, q_meas)
    followed, square_f, spread_f = f.innovate(
        noise, f.predict(noise, state, tau, dt, test=True), q_meas
    )
    type1_f = f.at(followed["x"], ca.SX.zeros(n)).type1
    moved, square_x, spread_x = f.update(
        state, *f.position(state, x_meas), deviation**2, [range(n)]
    )

    # one sample of the main filter and of the hypothesis "same"
    same_vector, same = f.filter.symbols("same")
    test_vector, test = f.noise.symbols("test_noise")
    main, hit = f.correct(noise, f.predict(noise, state, tau, dt), q_meas, gap)
    same, fit, fit_spread = f.innovate(
        test, f.predict(test, same, tau, dt, test=True), q_meas
    )
    x = ca.SX.sym("x", n)

    def step(
        name: str,
        given: dict[str, Symbol],
        after: dict[str, Symbol],
        **results: Symbol,
    ) -> ca.Function:
        """Return the function that gives the state after a step, and ``results``."""
        return named(name, given, {"filter_next": f.filter.join(after)} | results)

    given, moving = p | told | whole, {"tau": tau, "dt": dt}
    finite = ca.vertcat(main["x"], main["x_dot"], main["b"], main["d"])
    return Library(
        [
            named(
                "begin",
                p | told | {"x": x, "speed": speed},
                {"filter": f.filter.join(f.begin(noise, x, speed))},
            ),
            *(
                step(name, given | moving, f.predict(noise, state, tau, dt, test=test))
                for name, test in (("predict", False), ("predict_test", True))
            ),
            step(
                "correct",
                given | {"q_meas": q_meas, "dt": dt},
                corrected,
                struck=struck,
            ),
            step(
                "innovate",
                given | {"q_meas": q_meas},
                innovated,
                square=square,
                spread=spread,
            ),
            step(
                "correct_position",
                whole | {"x_meas": x_meas, "deviation": deviation},
                moved,
                square=square_x,
                spread=spread_x,
                distance=ca.norm_2(x_meas - state["x"]),
            ),
            step("unseen_blow", given, f.unseen_blow(noise, state)),
            step("unsure", given, f.unsure(noise, state)),
            *(
                named(
                    f"mirror_{block}",
                    p | whole,
                    {"image": f.filter.join(image), "p_image": p_image, "type1": type1},
                )
                for block, (image, p_image, type1) in enumerate(images)
            ),
            in_place(
                step(
                    "follow",
                    given | moving | {"q_meas": q_meas},
                    followed,
                    fit=ca.vertcat(square_f, spread_f),
                    type1=type1_f,
                )
            ),
            in_place(named("look", p | whole | shown, f.look(state, estimate))),
            in_place(
                step(
                    "advance",
                    p
                    | told
                    | {"test_noise": test_vector}
                    | whole
                    | shown
                    | {"same": same_vector, "tau": tau, "dt": dt, "gap": gap}
                    | {"q_meas": q_meas},
                    main,
                    same_next=f.filter.join(same),
                    **f.look(main, estimate, fit, fit_spread),
                    sample=ca.vertcat(is_finite(finite), hit, is_finite(fit)),
                )
            ),
        ],
        cache_folder(),
    )
