"""Geometric models without a closed form, solved."""

from __future__ import annotations

import casadi as ca

from dextar_control.mechanisms.mechanism import Mechanism, Values
from dextar_control.symbols.singular import singular_vectors
from dextar_control.symbols.types import Symbol

NEWTON_STEPS = 6  # from a guess of the second order: each doubles the digits


def mirror_image(mechanism: Mechanism, q_a: Symbol, x: Symbol, p: Values) -> Symbol:
    """Return the platform position (n,), m, with -sign(s) that has the same joints as
    x; near the locus it is near x.

    Where the mechanism knows no closed form it is found by Newton's method, from where
    the quadratic terms of the closures put it along the weak direction.

    Args:
        mechanism: the equations.
        q_a: active joints, (n,), rad or m.
        x: platform position, (n,), m.
        p: symbols or numbers.
    """
    known = mechanism.mirror_image(q_a, x, p)
    if known is not None:
        return known
    place = ca.SX.sym("place", mechanism.n)
    closures = mechanism.closures(q_a, place, p)
    A_r = ca.jacobian(closures, place)
    weak = singular_vectors(ca.substitute(A_r, place, x))
    along = ca.sum2(weak.v_weak)  # blocks do not see each other's
    turned = ca.jtimes(A_r @ along, place, along)
    curvature = weak.u_weak.T @ ca.substitute(turned, place, x)
    guess = x - weak.v_weak @ (2.0 * weak.sigma_weak / curvature)
    return closed_near(mechanism, q_a, guess, p)


def closed_near(mechanism: Mechanism, q_a: Symbol, guess: Symbol, p: Values) -> Symbol:
    """Return the platform position (n,), m, that closes the loops, by Newton's method.

    Args:
        mechanism: the equations.
        q_a: active joints, (n,), rad or m.
        guess: near the position, (n,), m.
        p: symbols or numbers.
    """
    place = ca.SX.sym("place", mechanism.n)
    closures = mechanism.closures(q_a, place, p)
    A_r, found = ca.jacobian(closures, place), guess
    for _ in range(NEWTON_STEPS):
        gap, slope = ca.substitute([closures, A_r], [place], [found])
        found = found - ca.solve(slope, gap)
    return found
