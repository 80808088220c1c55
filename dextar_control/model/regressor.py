"""The identification's regressor: how the torques of a motion depend on a mechanism's
masses, inertias, friction and gravity.

The equation is J_inv^T (tau - friction) = force, which is regular on the Type 2 locus;
its slopes by the parameters come from differentiating it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.model.equations import Equations
from dextar_control.model.model import equations_of, equations_on
from dextar_control.symbols.functions import Library, cache_folder, named
from dextar_control.symbols.types import Array, Symbol

AXES = "xyz"
SIZES = {
    "N m": 0.02,
    "N m s/rad": 0.005,
    "N": 0.2,
    "N s/m": 0.05,
    "m/s^2": 1.0,
    "kg": 0.05,
    "kg m^2": 1e-4,
}
"""The size by which a parameter of a unit is counted: what changes the torques
noticeably.
"""


class Unknown(NamedTuple):
    """A parameter, or one number of it, that the torques of a motion depend on.

    Attributes:
        name: of the parameter, with an axis where it has several numbers.
        unit: SI.
        row: in the vector of parameters.
        minimum: bound.
    """

    name: str
    unit: str
    row: int
    minimum: float


@lru_cache
def unknowns_of(mechanism: Mechanism) -> tuple[Unknown, ...]:
    """Return the parameters in which the dynamics are linear and on which no
    geometry depends.
    """
    e = equations_of(mechanism)
    gap, closures = _gap(e), mechanism.closures(e.q_a, e.x, mechanism.named(e.p))
    found, row = [], 0
    for parameter in mechanism.parameters:
        for place in range(parameter.size):
            number, slope = e.p[row], ca.jacobian(gap, e.p[row])
            if (
                slope.nnz()
                and not ca.depends_on(slope, number)
                and not ca.depends_on(closures, number)
            ):
                name = (
                    f"{parameter.name}.{AXES[place]}"
                    if parameter.size > 1
                    else parameter.name
                )
                found.append(
                    Unknown(
                        name,
                        parameter.unit,
                        row,
                        max(parameter.minimum, parameter.above),
                    )
                )
            row += 1
    return tuple(found)


def sizes_of(mechanism: Mechanism, p: Array) -> Array:
    """Return sizes (k,), in the unknowns' units such as kg, by which these are counted:
    masses and inertias by the largest in p (m,), others by ``SIZES``.
    """
    unknowns = unknowns_of(mechanism)
    largest = {
        unit: max(float(p[one.row]) for one in unknowns if one.unit == unit)
        for unit in {one.unit for one in unknowns}
    }
    by_unit = {
        unit: most if unit.startswith("kg") and most else SIZES[unit]
        for unit, most in largest.items()
    }
    return np.array([by_unit[one.unit] for one in unknowns])


def _gap(e: Equations) -> Symbol:
    """Return the force (n,), N, on the platform of motors and friction, less what the
    motion takes.
    """
    return e.J_inv.T @ (e.tau - e.friction) - e.force


@lru_cache
def regressors(mechanism: Mechanism) -> Library:
    """Return the identification's functions, compiled together where that can be done.

    ``motion`` of (p, q_a, x, q_a_dot, q_a_ddot): x_dot, x_ddot, s, and the rates (n,)
    of the joints. ``gap`` of (p, q_a, x, x_dot, x_ddot, tau): J_inv, inertia (M
    J_inv^-1, (n, n)), gap (n,), N, slopes (n, k) of it by the ``unknowns_of``.
    ``planned`` of (p, x, x_dot, x_ddot): torque_slopes (n, k) of the torques, N m, by
    them, and rates (n,) of the joints.
    """
    e = equations_of(mechanism)
    n, rows = mechanism.n, [unknown.row for unknown in unknowns_of(mechanism)]
    q_a_dot, q_a_ddot = ca.SX.sym("q_a_dot", n), ca.SX.sym("q_a_ddot", n)
    x_dot = ca.solve(e.J_inv, q_a_dot)
    moving = e.at(e.p, e.q_a, e.x, x_dot)
    x_ddot = ca.solve(e.J_inv, q_a_ddot - moving.drift)
    gap = _gap(e)
    slopes = ca.jacobian(gap, e.p[rows])
    placed = equations_on(mechanism, e.p, e.x, e.x_dot, e.x_ddot)
    needed = placed.inverse_dynamics + placed.friction
    joints = {"p": e.p, "q_a": e.q_a, "x": e.x}
    return Library(
        [
            named(
                "motion",
                joints | {"q_a_dot": q_a_dot, "q_a_ddot": q_a_ddot},
                {"x_dot": x_dot, "x_ddot": x_ddot, "s": e.s, "rates": q_a_dot},
            ),
            named(
                "gap",
                joints | {"x_dot": e.x_dot, "x_ddot": e.x_ddot, "tau": e.tau},
                {
                    "J_inv": e.J_inv,
                    "inertia": e.M @ ca.solve(e.J_inv, ca.SX.eye(n)),
                    "gap": gap,
                    "slopes": slopes,
                },
            ),
            named(
                "planned",
                {"p": e.p, "x": e.x, "x_dot": e.x_dot, "x_ddot": e.x_ddot},
                {
                    "torque_slopes": ca.jacobian(needed, e.p[rows]),
                    "rates": placed.q_a_dot,
                },
            ),
        ],
        cache_folder(),
        1,
    )
