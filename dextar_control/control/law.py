"""Laws: from an error to input torques through a configuration where A_r loses rank.

The Cartesian laws ask for the platform acceleration u = x_ddot_ref + K_d e_dot + K_p e
+ K_i int(e) (section 3) at the estimated state, which takes the wrenches w_b and w_d;
then tau = w_b - B^T lambda (Eq. 1). They differ in lambda, the multipliers with w_d =
A_r^T lambda; A_r = U S V^T:

- ``classic``: lambda = A_r^-T w_d everywhere (Eq. 4). Grows as 1/s under any tracking
  error.
- ``projected``: the paper. Within |s| < band w_u is projected on the image of A_r^T and
  the torque of least norm is taken (Eq. 9, with J_inv of rank n - 1 in the whole band
  as it is on the locus): bounded, but it jumps at the band's edges, where the internal
  force along the distal links is dropped.
- ``consistent``: ours. lambda = sum u_i (v_i.w_d)/sigma_i over the strong directions,
  which follow the feedback everywhere, + u_weak [(1 - phi) u_weak.lambda_ref + phi
  (v_weak.w_d)/sigma_weak], phi rising from 0 to 1 over |s| = zone -+ width/2: along the
  weak direction the multiplier that the trajectory itself needs (finite on the locus
  when the criterion holds) takes over, so that nothing jumps and no internal force is
  lost. Its limit: along t_s there is no feedback inside the zone, where no torque could
  give any. Before that u is changed where a leg comes near to Type 1 faster than it may
  (``within_reach``).
- ``multi_model``: the paper's [10]. Within |s| < band the reduced model tau = w_b of
  w_d = 0, in the joints: q_a_ddot = q_a_ddot_ref + K_d e_q_dot + K_p e_q; Eq. (4)
  outside. Needs trajectories planned for w_d = 0; the models differ at the band's edge
  by what w_d is there, and w_d = 0 depends on how L was written.
- ``joint_space``: the paper's future work, without any platform estimate. Matrices are
  taken on the reference; the joint acceleration a = K_d e_q_dot + K_p e_q is split by
  J_inv = U S V^T: its strong parts are realised everywhere, its part along u_weak fades
  with phi, because no finite platform acceleration gives it on the locus; u =
  x_ddot_ref + sum v_i (u_i.a)/sigma_i + phi v_weak (u_weak.a)/sigma_weak, then
  ``consistent``'s multipliers. What can be shown: with an exact model the error along
  the strong directions obeys e_ddot + K_d e_dot + K_p e = 0 everywhere but for a
  hundredth or so of the feedback (how the matrices change with the error), about a
  point at rest outside the zone all do to first order; inside, the platform's error
  along t_s only coasts, and the law never knows it.

Where A_r has several blocks each has its weak direction and multiplier, its |s| and
phi, or its band; ``multi_model`` takes the reduced model of all of them within the band
of one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import casadi as ca

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.plug_in import chosen, short_name
from dextar_control.estimation.records import ESTIMATE, REFERENCE
from dextar_control.estimation.transmission import LEAST_INERTIA
from dextar_control.mechanisms.mechanism import Mechanism, Values
from dextar_control.mechanisms.planar import wrapped
from dextar_control.model.equations import Equations
from dextar_control.model.model import equations_on
from dextar_control.symbols.functions import named
from dextar_control.symbols.record import Field, Layout
from dextar_control.symbols.singular import nearest, singular_vectors
from dextar_control.symbols.smooth import HUGE, is_finite, over, smooth_step
from dextar_control.symbols.types import Symbol

TWIST_DAMPING = 0.35  # damping ratio that the law adds to a rotor on its transmission
# times the error's natural frequency: pace at which a leg may approach Type 1
REACH = 2.0

GAINS = (
    Field("K_p", "1/s^2", "of the error"),
    Field("K_d", "1/s", "of its rate"),
    Field("K_i", "1/s^3", "of its integral"),
    Field("zone", "1", "|s| in the middle of the transition, or of the band's edge"),
    Field("zone_width", "1", "of the transition, in |s|"),
    Field("friction_compensation", "1", "share of the modelled friction fed forward"),
    Field("disturbance_compensation", "1", "share of d that is compensated"),
)
OUTPUT = (
    Field("tau", "N m", "input torques, limited", "n"),
    Field("error", "m", "x_ref - x_hat", "n"),
    Field("error_dot", "m/s", "its rate", "n"),
    Field("u", "m/s^2", "acceleration that is asked for", "n"),
    Field("force", "N", "J_inv^T tau", "n"),
    Field("residual", "N", "t_s.w_d of u, which the enforcement removes on the locus"),
    Field("s", "1", "singularity measure at the state of the model"),
    Field("sigma_min", "1", "least singular value of A_r over the singularity length"),
    Field("weight", "1", "1 where the weak direction has feedback, 0 where the plan's"),
    Field("limit", "N m", "at which tau is cut"),
    Field("finite", "1", "1 where all of this is finite"),
)


class Asked(NamedTuple):
    """The input of a law at one sample, on symbols.

    Attributes:
        mechanism: whose law it is.
        vector: the mechanism's parameters; p: the same by their dotted names.
        gains, ref, hat: by the names of ``GAINS``, of ``estimation.records.REFERENCE``
            and of ``estimation.records.ESTIMATE``.
        u: (n,) acceleration of the platform, m/s^2: the reference's and the feedback on
            the platform's error.
        a: (n,) feedback on the joints' error, rad/s^2.
    """

    mechanism: Mechanism
    vector: Symbol
    p: Values
    gains: dict[str, Symbol]
    ref: dict[str, Symbol]
    hat: dict[str, Symbol]
    u: Symbol
    a: Symbol

    def here(self, x_ddot: Symbol) -> Equations:
        """Return the equations at the estimated state with an acceleration
        (n,), m/s^2.
        """
        x, x_dot = self.hat["x"], self.hat["x_dot"]
        return equations_on(self.mechanism, self.vector, x, x_dot, x_ddot)

    def planned(self, x_ddot: Symbol | None = None) -> Equations:
        """Return the equations on the reference, with its own acceleration or another
        one (n,), m/s^2.
        """
        x, x_dot = self.ref["x"], self.ref["x_dot"]
        x_ddot = self.ref["x_ddot"] if x_ddot is None else x_ddot
        return equations_on(self.mechanism, self.vector, x, x_dot, x_ddot)


class Answer(NamedTuple):
    """The output of a law.

    Attributes:
        tau: (n,) torques, N m, before friction, disturbances and the limit.
        e: the equations at the state of these torques; its x_ddot is the acceleration
            that is asked for.
        weight: 1 where the weak direction follows the feedback, 0 where it follows the
            plan.
    """

    tau: Symbol
    e: Equations
    weight: Symbol | float = 1.0


Law = Callable[[Asked], Answer]


def classic(asked: Asked) -> Answer:
    """Return the torque of Eq. (4) at the estimated state."""
    e = asked.here(asked.u)
    return Answer(e.inverse_dynamics, e)  # Eq. 4


def projected(asked: Asked) -> Answer:
    """Return the paper's torque: within the band of a block the torque of least norm
    for the projected wrench, else Eq. (4).
    """
    e, band = asked.here(asked.u), asked.gains["zone"]
    J, inside = singular_vectors(e.J_inv), ca.fabs(e.s_blocks) <= band
    image = e.w_d - e.singular.v_weak @ ca.if_else(inside, e.criterion, 0.0)  # Eq. 6
    force = e.J_inv.T @ e.w_b + image
    least = J.u_strong @ ((J.v_strong.T @ force) / J.sigma_strong)  # Eq. 9
    # of other blocks:
    regular = ca.if_else(inside, 0.0, over(J.v_weak.T @ force, J.sigma_weak))
    any_inside = ca.fabs(e.s) <= band
    tau = ca.if_else(any_inside, least + J.u_weak @ regular, e.inverse_dynamics)
    return Answer(tau, e, ca.if_else(any_inside, 0.0, 1.0))


def consistent(asked: Asked) -> Answer:
    """Return the torque with the weak multiplier from feedback and plan, at the
    estimated state; each leg is kept from Type 1.
    """
    x, x_dot = asked.hat["x"], asked.hat["x_dot"]
    u = within_reach(
        asked.mechanism, asked.p, x, x_dot, asked.u, ca.sqrt(asked.gains["K_p"])
    )
    return _with_multipliers(asked, asked.here(u))


def multi_model(asked: Asked) -> Answer:
    """Return the torque of the paper's [10]: the reduced model tau = w_b in the joints
    within the band, else Eq. (4).
    """
    e, planned = asked.here(asked.u), asked.planned()
    q_a_ddot, x_ddot = planned.q_a_ddot + asked.a, asked.ref["x_ddot"]
    reduced = e.M_a @ q_a_ddot + e.M_ax @ x_ddot + e.c_a  # Eq. 10 with w_d = 0
    inside = ca.fabs(e.s) <= asked.gains["zone"]
    return Answer(
        ca.if_else(inside, reduced, e.inverse_dynamics), e, ca.if_else(inside, 0.0, 1.0)
    )


def joint_space(asked: Asked) -> Answer:
    """Return the torque of the joints' feedback as an acceleration of the platform,
    whose weak part fades, with the multipliers of ``consistent``.
    """
    planned = asked.planned()
    J, weight = singular_vectors(planned.J_inv), _feedback_share(asked, planned)
    strong = J.v_strong @ ((J.u_strong.T @ asked.a) / J.sigma_strong)
    feedback = strong + J.v_weak @ (weight * over(J.u_weak.T @ asked.a, J.sigma_weak))
    return _with_multipliers(asked, asked.planned(asked.ref["x_ddot"] + feedback))


def _feedback_share(asked: Asked, e: Equations) -> Symbol:
    """Return phi (k,): 1 outside each block's zone, 0 inside."""
    zone, width = asked.gains["zone"], asked.gains["zone_width"]
    return smooth_step(ca.fabs(e.s_blocks), zone - 0.5 * width, zone + 0.5 * width)


def _with_multipliers(asked: Asked, e: Equations) -> Answer:
    """Return the torque at ``e`` with the weak multiplier from feedback and plan."""
    v, phi = e.singular, _feedback_share(asked, e)
    strong = v.u_strong @ ((v.v_strong.T @ e.w_d) / v.sigma_strong)
    planned = v.u_weak.T @ asked.ref["multipliers"]
    weak = (1.0 - phi) * planned + phi * over(e.criterion, v.sigma_weak)
    return Answer(e.w_b - e.B.T @ (strong + v.u_weak @ weak), e, ca.mmin(phi))  # Eq. 1


LAWS: dict[str, Law] = {
    law.__name__: law
    for law in (classic, projected, consistent, multi_model, joint_space)
}
"""The laws of this package by their names."""


def within_reach(
    mechanism: Mechanism,
    p: Values,
    x: Symbol,
    x_dot: Symbol,
    u: Symbol,
    frequency: Symbol,
) -> Symbol:
    """Return u (n,), m/s^2, changed as little as keeps each leg from Type 1: a control
    barrier function.

    c, the squared sine of a leg's angle, has to obey c_ddot + 2 w c_dot + w^2 c >= 0. A
    leg of two links of 90 mm at a sine of 0.12 is a third of a millimetre from the end
    of its reach, which the feedback on the platform's error cannot keep.

    Args:
        mechanism: whose legs they are.
        p: symbols.
        x, x_dot: of the platform, (n,), m, m/s.
        u: acceleration that is asked for, (n,), m/s^2.
        frequency: natural frequency of the error, rad/s.
    """
    clear = mechanism.type1_sines(mechanism.inverse_geometric_model(x, p), x, p) ** 2
    slopes, w = ca.jacobian(clear, x), REACH * frequency
    rate = slopes @ x_dot
    # the least values of slopes @ u
    least = -(ca.jtimes(rate, x, x_dot) + 2.0 * w * rate + w**2 * clear)
    for leg in range(slopes.shape[0]):
        slope = slopes[leg, :]
        lacks = least[leg] - slope @ u
        u = u + ca.if_else(lacks > 0.0, lacks / ca.sumsqr(slope), 0.0) * slope.T
    return u


def twist_damping(inertia: Symbol, stiffness: Symbol, dt: Symbol) -> Symbol:
    """Return the damping (n,), N m s/rad, that the motors add to the twist: 0 where
    rigid, and less where it swings too fast for the control period.

    The feedback acts on the links through the motors and would excite a transmission
    that damps itself too little.

    Args:
        inertia: of the rotors, (n,), kg m^2.
        stiffness: of the transmissions, (n,), N m/rad.
        dt: control period, s.
    """
    # squared product of natural frequency and period
    pace = stiffness * dt**2 / ca.fmax(inertia, LEAST_INERTIA)
    return 2.0 * TWIST_DAMPING * ca.sqrt(inertia * stiffness) / (1.0 + pace**2)


def law_of(mechanism: Mechanism, name: str) -> ca.Function:
    """Return the function of one tick of a law: (p, gains, reference, estimate,
    integral, limit, dt) -> output, integral_next.

    Args:
        mechanism: whose law it is.
        name: of ``LAWS``, or ``module:function`` of one's own.

    Raises:
        ParameterError: there is no such law, or its equations cannot be built.
    """
    n, law = mechanism.n, chosen("law", name, LAWS)
    vector, p = mechanism.symbols()
    (gains_vector, gains), (ref_vector, ref), (hat_vector, hat) = (
        Layout(layout, n, fields).symbols()
        for layout, fields in (
            ("gains", GAINS),
            ("reference", REFERENCE),
            ("estimate", ESTIMATE),
        )
    )
    integral, limit, dt = ca.SX.sym("integral", n), ca.SX.sym("limit"), ca.SX.sym("dt")
    error, error_dot = ref["x"] - hat["x"], ref["x_dot"] - hat["x_dot"]
    away = ca.fabs(ref["s"]) > gains["zone"] + gains["zone_width"]
    grown = ca.if_else(away, integral + dt * error, integral)
    u = (
        ref["x_ddot"]
        + gains["K_d"] * error_dot
        + gains["K_p"] * error
        + gains["K_i"] * grown
    )
    a = gains["K_p"] * wrapped(ref["q_a"] - hat["q_a"]) + gains["K_d"] * (
        ref["q_a_dot"] - hat["q_a_dot"]
    )
    asked = Asked(mechanism, vector, p, gains, ref, hat, u, a)
    tau, e, weight = _answer(name, law, asked)
    tau = tau + gains["friction_compensation"] * mechanism.friction(ref["q_a_dot"], p)
    tau = tau - gains["disturbance_compensation"] * hat["d"]
    if transmission := mechanism.transmission(p):
        inertia, stiffness, _ = transmission
        tau = tau - twist_damping(inertia, stiffness, dt) * hat["twist_dot"]
    size = ca.fabs(tau)
    tau = ca.if_else(
        size < HUGE, ca.if_else(size <= limit, tau, limit * ca.sign(tau)), ca.SX.nan(n)
    )
    found = {
        "tau": tau,
        "error": error,
        "error_dot": error_dot,
        "u": e.x_ddot,
        "force": e.J_inv.T @ tau,
        "residual": nearest(e.s_blocks, e.criterion),
        "s": e.s,
        "sigma_min": (
            ca.mmin(ca.fabs(e.singular.sigma_weak)) / mechanism.singularity_length(p)
        ),
        "weight": weight,
        "limit": limit,
    }
    found["finite"] = is_finite(ca.vertcat(*found.values()))
    arguments = {
        "p": vector,
        "gains": gains_vector,
        "reference": ref_vector,
        "estimate": hat_vector,
        "integral": integral,
        "limit": limit,
        "dt": dt,
    }
    results = {
        "output": Layout("output", n, OUTPUT).join(found),
        "integral_next": grown,
    }
    return named(f"law_{short_name(name)}", arguments, results)


def _answer(name: str, law: Law, asked: Asked) -> Answer:
    """Return the answer of a law, which may be one's own.

    Raises:
        ParameterError: the law fails, or its answer has wrong shapes or types.
    """
    if name in LAWS:
        return law(asked)
    try:
        answer = law(asked)
        if not isinstance(answer, Answer):
            raise TypeError(f"it returns {answer!r}; an Answer(tau, e) is wanted")
        tau, e, weight = answer
        tau, weight = ca.SX(tau), ca.SX(weight)
    except Exception as error:
        raise ParameterError(
            f"law {name!r} fails as its equations are built:"
            f" {type(error).__name__}: {error}"
        ) from error
    n = asked.mechanism.n
    if tau.shape != (n, 1) or weight.shape != (1, 1) or not isinstance(e, Equations):
        raise ParameterError(
            f"law {name!r} answers tau of shape {tau.shape}, e of type"
            f" {type(e).__name__} and a weight of shape {weight.shape}; they must be of"
            f" shape ({n}, 1), Equations and of shape (1, 1)"
        )
    return Answer(tau, e, weight)
