"""Eqs. (1)-(14) of the paper from a mechanism's closures and Lagrangian, for any number
n of degrees of freedom.

Each equation stands once, on the line that carries its number, in the paper's symbols;
these lines are what runs. Three departures from the print, each with its reason:

- Eq. (10) has cross terms: w_b depends on x_ddot as well, and w_d on q_a_ddot, by M_ax.
  They vanish only for links whose mass is lumped at their ends; without them the
  criterion is false at true singular states.
- In Eq. (14) h carries M_a B^-1 b; as printed it misses M_a, and its terms have
  different units.
- The pseudo-inverse of Eqs. (9), (13), (14) is not taken: on the locus it gives the
  torque of least norm, which is not the limit of Eq. (4) along a trajectory that meets
  the criterion, so that the torque would step. M and h are kept as J_inv^T times the
  paper's, regular everywhere, and what gives the torque near the locus is the law.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import casadi as ca
import numpy as np

from dextar_control.contract.errors import ParameterError
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.symbols.singular import (
    SingularVectors,
    blocks,
    nearest,
    singular_vectors,
)
from dextar_control.symbols.types import Symbol

TRIES = 5  # sets of numbers at which a matrix that loses rank loses it everywhere


@dataclass(frozen=True)
class Equations:
    """One state of a mechanism on symbols: what is given, and what follows.

    Units are those of the symbol table in the documentation.

    Attributes:
        p: parameters, as one vector (m,).
        q_a, x, x_dot: joints and platform (closed), and its velocity, (n,).
        x_ddot: acceleration of the platform (n,).
        tau: input torques (n,).
        A_r, B: (n, n), closure Jacobians.
        J_inv: (n, n), -B^-1 A_r.
        q_a_dot, q_a_ddot: of the joints (n,), from the platform's.
        b: (n,), velocity terms of the closures' second derivative.
        drift: (n,), -B^-1 b.
        w_b, w_d: (n,), wrenches on joints and platform.
        force: (n,), J_inv^T w_b + w_d, which J_inv^T tau has to equal.
        M_a, M_ax, M_x, c_a, c_x: terms of the wrenches.
        M, h: (n, n), (n,): J_inv^T tau = M x_ddot + h; regular on the Type 2 locus.
        multipliers: (n,), lambda; grows as 1/s unless the criterion holds.
        inverse_dynamics: (n,), tau of x_ddot off the locus.
        friction: (n,), of the active joints.
        forward_dynamics: (n,), x_ddot of tau; regular on the locus.
        s_blocks: (k,), determinants of A_r's blocks, dimensionless: how far each of k
            motions is from being uncontrollable.
        s: that of ``s_blocks`` which is least in size.
        singular: singular vectors of A_r; t_s (n, k) are the weak right ones.
        criterion: (k,), t_s . w_d.
        type1: least distance of a leg to Type 1.
    """

    p: Symbol
    q_a: Symbol
    x: Symbol
    x_dot: Symbol
    x_ddot: Symbol
    tau: Symbol
    A_r: Symbol
    B: Symbol
    J_inv: Symbol
    q_a_dot: Symbol
    q_a_ddot: Symbol
    b: Symbol
    drift: Symbol
    w_b: Symbol
    w_d: Symbol
    force: Symbol
    M_a: Symbol
    M_ax: Symbol
    M_x: Symbol
    c_a: Symbol
    c_x: Symbol
    M: Symbol
    h: Symbol
    multipliers: Symbol
    inverse_dynamics: Symbol
    friction: Symbol
    forward_dynamics: Symbol
    s_blocks: Symbol
    s: Symbol
    singular: SingularVectors
    criterion: Symbol
    type1: Symbol

    def at(
        self,
        p: Symbol,
        q_a: Symbol,
        x: Symbol,
        x_dot: Symbol,
        x_ddot: Symbol | float = 0.0,
        tau: Symbol | float = 0.0,
    ) -> Equations:
        """Return the equations of another state: of other symbols or expressions."""
        names = [field.name for field in fields(self) if field.name != "singular"]
        given = [self.p, self.q_a, self.x, self.x_dot, self.x_ddot, self.tau]
        values = ca.Function(
            "at", given, [*(getattr(self, name) for name in names), *self.singular]
        )(p, q_a, x, x_dot, x_ddot, tau)
        return Equations(
            **dict(zip(names, values, strict=False)),
            singular=SingularVectors(*values[len(names) :]),
        )


def equations(mechanism: Mechanism) -> Equations:
    """Return the equations of a mechanism.

    Raises:
        ParameterError: its closures and coordinates do not match in number, or B or A_r
            is singular everywhere.
    """
    n = mechanism.n
    vector, p = mechanism.symbols()
    q_a, x, x_dot, x_ddot, tau = (
        ca.SX.sym(name, n) for name in ("q_a", "x", "x_dot", "x_ddot", "tau")
    )
    # velocity and acceleration of the joints, not yet bound to the platform's:
    v, a = ca.SX.sym("q_a_dot", n), ca.SX.sym("q_a_ddot", n)

    closures = mechanism.closures(q_a, x, p)
    if len(mechanism.coordinates) != n or closures.shape != (n, 1):
        raise ParameterError(
            f"mechanism {mechanism.name} has {n} active joints,"
            f" {len(mechanism.coordinates)} coordinates and {closures.shape[0]}"
            " closures; the three numbers must be equal"
        )
    A_r, B = ca.jacobian(closures, x), ca.jacobian(closures, q_a)  # Eq. 2
    uncoupled = "the closures do not depend on all active joints, each in its own way"
    for name, matrix, why in (
        ("B", B, uncoupled),
        ("A_r", A_r, "a closure has no coordinate of its own"),
    ):
        values = ca.Function(name, [vector, q_a, x], [matrix])
        if ca.sprank(matrix) < n or _loses_rank(values):
            raise ParameterError(
                f"{name} of mechanism {mechanism.name} is singular everywhere: {why}"
            )
    J_inv = -ca.solve(B, A_r)  # Eq. 8
    q_a_dot = J_inv @ x_dot  # Eq. 2

    def along(expression: Symbol) -> Symbol:
        """Return the rate of an expression that depends on positions."""
        return ca.jtimes(expression, ca.vertcat(q_a, x), ca.vertcat(v, x_dot))

    b = along(along(closures))  # Eq. 11
    L = mechanism.lagrangian(q_a, x, v, x_dot, p)
    rates, opposing = mechanism.passive_friction(q_a, x, v, x_dot, p)

    def euler_lagrange(position: Symbol, velocity: Symbol) -> Symbol:
        """Return d/dt of dL/dvelocity, less dL/dposition, and the friction of joints
        without a motor, by its virtual power.
        """
        momentum = ca.gradient(L, velocity)
        rate = along(momentum) + ca.jtimes(
            momentum, ca.vertcat(v, x_dot), ca.vertcat(a, x_ddot)
        )
        friction = ca.jacobian(rates, velocity).T @ opposing
        return rate - ca.gradient(L, position) + friction

    w_b, w_d = euler_lagrange(q_a, v), euler_lagrange(x, x_dot)  # Eq. 3
    M_a, M_x = ca.jacobian(w_b, a), ca.jacobian(w_d, x_ddot)  # Eq. 10
    M_ax = ca.jacobian(w_b, x_ddot)  # Eq. 10, cross terms
    at_rest = ca.vertcat(a, x_ddot), ca.SX.zeros(2 * n)
    c_a, c_x = ca.substitute(w_b, *at_rest), ca.substitute(w_d, *at_rest)  # Eq. 10

    b, w_b, w_d, c_a, c_x = ca.substitute([b, w_b, w_d, c_a, c_x], [v], [q_a_dot])
    drift = -ca.solve(B, b)  # Eq. 12
    q_a_ddot = J_inv @ x_ddot + drift  # Eq. 12
    w_b, w_d = ca.substitute([w_b, w_d], [a], [q_a_ddot])  # Eq. 10
    force = J_inv.T @ w_b + w_d  # Eqs. 7, 8; with Eq. 10's wrenches Eq. 13 inverts it
    # with the cross terms of Eq. 10, and M_a on B^-1 b:
    M = J_inv.T @ M_a @ J_inv + J_inv.T @ M_ax + M_ax.T @ J_inv + M_x  # Eq. 14
    h = J_inv.T @ (M_a @ drift + c_a) + M_ax.T @ drift + c_x  # Eq. 14
    multipliers = ca.solve(A_r.T, w_d)  # Eq. 1
    inverse_dynamics = w_b - B.T @ multipliers  # Eq. 4
    singular = singular_vectors(A_r)
    t_s = singular.v_weak  # Eq. 5: spans the kernel of A_r, on the locus
    criterion = t_s.T @ w_d  # Eq. 5
    s_blocks = ca.vertcat(
        *(ca.det(A_r[rows, columns]) for rows, columns in blocks(A_r))
    ) / mechanism.singularity_scale(p)

    friction = mechanism.friction(q_a_dot, p)
    forward_dynamics = ca.solve(M, J_inv.T @ (tau - friction) - h)
    return Equations(
        vector,
        q_a,
        x,
        x_dot,
        x_ddot,
        tau,
        A_r,
        B,
        J_inv,
        q_a_dot,
        q_a_ddot,
        b,
        drift,
        w_b,
        w_d,
        force,
        M_a,
        M_ax,
        M_x,
        c_a,
        c_x,
        M,
        h,
        multipliers,
        inverse_dynamics,
        friction,
        forward_dynamics,
        s_blocks,
        nearest(s_blocks, s_blocks),
        singular,
        criterion,
        ca.mmin(ca.fabs(mechanism.type1_sines(q_a, x, p))),
    )


def _loses_rank(matrix: ca.Function) -> bool:
    """Return whether a square matrix has less than full rank at each of some random
    arguments; not where it has entries that are no number.
    """
    generator = np.random.default_rng(0)
    for _ in range(TRIES):
        sizes = [matrix.size1_in(i) for i in range(matrix.n_in())]
        arguments = [generator.uniform(0.5, 1.5, size) for size in sizes]
        found = np.array(matrix(*arguments))
        if not np.isfinite(found).all() or np.linalg.matrix_rank(found) == len(found):
            return False
    return True
