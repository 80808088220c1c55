"""Friction that sticks, on symbols: each place that rubs is an elastic bristle that
slips at Coulomb's torque.

The bristle is as stiff as the substep bears, so that an explicit step is sound whatever
the torque. At rest it bends by Coulomb's torque over that stiffness (some 1e-5 rad) and
holds for good; a law over the speed alone lets the joint creep. A velocity-level
solver, which needs no bristle, would have to know mass matrix and closures: this needs
a rate and a bound of the inertia, and serves every plant and every joint.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from dextar_control.symbols.types import Symbol

# Of a place: N m s/rad, N m, both of the bristle in N m/rad and N m s/rad (0: it is
# smooth), rad/s of the smooth law.
ELEMENTS = "viscous", "coulomb", "stiffness", "damping", "speed"
QUICKNESS = 0.7
# Frequency of a bristle with the least inertia that moves there, times the substep, and
# its damping ratio.
#
# A step that is explicit in the damping is sound while (frequency x substep)^2 + 4
# damping ratio x frequency x substep < 4. Each body's inertia counts for two bristles
# at most, so that both terms double: 0.98 + 2.8.
DAMPING_RATIO = 0.5


def bristle_of(inertia: float, h: float) -> tuple[float, float]:
    """Return stiffness, N m/rad, and damping, N m s/rad, of the bristle on an inertia,
    kg m^2, for substeps of ``h``, s.
    """
    stiffness = inertia * (QUICKNESS / h) ** 2
    return stiffness, 2.0 * DAMPING_RATIO * stiffness * h / QUICKNESS


def friction_torque(
    rate: Symbol, bristle: Symbol, p: Mapping[str, Symbol], h: Symbol
) -> tuple[Symbol, Symbol]:
    """Return torques, (k,), N m, that oppose rates, (k,), rad/s, over a substep, and
    the bristles' bending, (k,), rad, at half of it.

    Args:
        bristle: bending half a substep before.
        p: of ``ELEMENTS``, (k,) each.
        h: substep, s.
    """
    sticks = p["stiffness"] > 0.0
    stiffness = ca.if_else(sticks, p["stiffness"], 1.0)
    most = p["coulomb"] / stiffness
    bent = ca.if_else(sticks, ca.fmin(ca.fmax(bristle + h * rate, -most), most), 0.0)
    held = p["stiffness"] * bent + p["damping"] * rate
    stuck = ca.fmin(ca.fmax(held, -p["coulomb"]), p["coulomb"])
    smooth = p["coulomb"] * ca.tanh(rate / p["speed"])
    return p["viscous"] * rate + ca.if_else(sticks, stuck, smooth), bent
