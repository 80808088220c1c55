"""Small functions on symbols, finite with their derivatives on both sides."""

from __future__ import annotations

import casadi as ca

from dextar_control.symbols.types import Symbol

HUGE = 1e300


def smooth_step(value: Symbol, low: Symbol | float, high: Symbol | float) -> Symbol:
    """Return 0 below low, 1 above high, and a quintic between whose first two
    derivatives vanish at both ends; a step where high <= low.
    """
    width = high - low
    z = ca.fmin(ca.fmax((value - low) / ca.if_else(width > 0.0, width, 1.0), 0.0), 1.0)
    return ca.if_else(
        width > 0.0,
        z * z * z * (10.0 + z * (6.0 * z - 15.0)),
        ca.if_else(value >= high, 1.0, 0.0),
    )


def is_finite(values: Symbol) -> Symbol:
    """Return 1 where all values are finite numbers, 0 otherwise."""
    return ca.if_else(ca.sum1(ca.fabs(ca.vec(values))) < HUGE, 1.0, 0.0)


def over(numerator: Symbol, denominator: Symbol) -> Symbol:
    """Return the quotient, and 0 where the denominator is 0."""
    nonzero = ca.fabs(denominator) > 0.0
    return ca.if_else(nonzero, numerator / ca.if_else(nonzero, denominator, 1.0), 0.0)
