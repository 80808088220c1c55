"""A mechanism with a robot's numbers: kinematics and dynamics as fast functions."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import TypeVar

import casadi as ca
import numpy as np

from dextar_control.contract.errors import GeometryError, ParameterError
from dextar_control.contract.robot import RobotParameters, flatten
from dextar_control.mechanisms import five_bar_of
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.model.equations import Equations, equations
from dextar_control.model.robot import AnyRobot
from dextar_control.model.solved import closed_near, mirror_image
from dextar_control.symbols.functions import (
    Library,
    NumericFunction,
    cache_folder,
    named,
)
from dextar_control.symbols.singular import blocks
from dextar_control.symbols.types import Array, Symbol

AnyModel = TypeVar("AnyModel", bound="Model")

SOLVED = 1e-12  # m^2, of a closure that counts as closed
CLOSED = 1e-9  # of the closures' size, beyond which a model does not satisfy them
CLEAR = 0.1  # |s| from which the direct geometric model is checked
RETURNED = 1e-6  # of a place's distance, to which it has to give that place


class Model:
    """The functions of a mechanism for one robot; not for two threads at once.

    Args:
        mechanism: the equations.
        values: by the dotted names of the mechanism's parameters.

    Attributes:
        p: the parameters as one vector (m,).
        n: degrees of freedom.
        blocks: of A_r; their rows are those of the multipliers.
        place: x -> q_a, A_r, s, s_blocks, type1, t_s, gradient (of s, 1/m); nan out of
            reach.
        state: (q_a, x, x_dot) -> A_r, B, J_inv, q_a_dot, b, drift, s, type1, t_s:
            kinematics of a closed configuration.
        wrenches: (q_a, x, x_dot, x_ddot) -> q_a_ddot, w_b, w_d, multipliers, tau,
            friction, criterion, t_s.
        platform_dynamics: (q_a, x, x_dot, tau) -> M, h, x_ddot; regular on the Type 2
            locus.

    Raises:
        ParameterError: a parameter is missing or out of its bounds.
    """

    def __init__(self, mechanism: Mechanism, values: Mapping[str, object]) -> None:
        self.mechanism, self.n = mechanism, mechanism.n
        self.p = mechanism.values(values)
        self.library = library_of(mechanism)
        self.blocks = blocks(equations_of(mechanism).A_r)
        self._inverse = self.library.fast("inverse_geometric_model")
        self.place, self.state, self.wrenches, self.platform_dynamics = (
            self._bound(self.library.fast(name))
            for name in ("place", "state", "wrenches", "platform_dynamics")
        )

    @classmethod
    def of(cls: type[AnyModel], robot: AnyRobot) -> AnyModel:
        """Return the model of a robot's description."""
        if isinstance(robot, RobotParameters):
            flat = flatten(robot)
            return cls(five_bar_of(flat), flat)
        return cls(robot.mechanism, robot.numbers)

    def _bound(self, function: NumericFunction) -> NumericFunction:
        """Return a function whose first argument is ``p``, of the others alone."""
        return lambda *arguments: function(self.p, *arguments)

    def inverse_geometric_model(self, x: Array) -> Array:
        """Return q_a (n,), rad or m, of a platform position x (n,), m.

        Raises:
            GeometryError: a leg does not reach it.
        """
        (q_a,) = self._inverse(self.p, x)
        if not np.isfinite(q_a).all():
            p = self.mechanism.named(self.p)
            raise GeometryError(self.mechanism.unreached(np.asarray(x), q_a, p))
        return q_a

    def type1_distance(self, x: Array) -> float:
        """Return the least sine of a leg's angle at a platform position x (n,), m: zero
        at a Type 1 singularity; nan out of reach.
        """
        return float(self.place(x).type1[0])

    def direct_geometric_model(
        self, q_a: Array, assembly_mode: float | Array, near: Array
    ) -> Array:
        """Return the platform position x (n,), m, with sign(s) = assembly_mode, clamped
        on the locus; nan where the loops do not close.

        Args:
            q_a: active joints, (n,), rad or m.
            assembly_mode: of all blocks, or (k,).
            near: (n,), m, where the search begins that a mechanism without a closed
                form needs.
        """
        if "direct_geometric_model" in self.library.symbolic:
            direct = self.library.fast("direct_geometric_model")
            return direct(self.p, q_a, assembly_mode).x
        solve = self.library.fast("closed_near")
        found = solve(self.p, q_a, near)
        if found.s[0] * assembly_mode < 0.0:
            found = solve(self.p, q_a, found.image)
        good = found.gap[0] < SOLVED and found.s[0] * assembly_mode > 0.0
        return found.x if good else np.full(self.n, np.nan)

    def close(
        self, q_a: Array, assembly_mode: float, near: Array | None = None
    ) -> Array:
        """Return the platform position x (n,), m, with sign(s) = assembly_mode.

        Args:
            q_a: active joints, (n,), rad or m.
            assembly_mode: of all blocks.
            near: (n,), m, where the search begins that a mechanism without a closed
                form needs; the origin when None.

        Raises:
            GeometryError: the loops do not close there.
        """
        problem = self.mechanism.why_open(np.asarray(q_a), self.mechanism.named(self.p))
        x = self.direct_geometric_model(
            q_a, assembly_mode, np.zeros(self.n) if near is None else near
        )
        if problem or not np.isfinite(x).all():
            raise GeometryError(
                problem
                or f"the loops of {self.mechanism.name} do not close at joints"
                f" {np.round(q_a, 6)}"
            )
        return x


@lru_cache
def equations_of(mechanism: Mechanism) -> Equations:
    """Return the equations of a mechanism, made once."""
    return equations(mechanism)


def equations_on(
    mechanism: Mechanism,
    p: Symbol,
    x: Symbol,
    x_dot: Symbol,
    x_ddot: Symbol | float = 0.0,
    tau: Symbol | float = 0.0,
) -> Equations:
    """Return the equations at a state of the platform, with the joints that it has in
    the working mode of ``p``.

    Args:
        mechanism: the equations.
        p: parameters, as one vector (m,).
        x, x_dot, x_ddot: of the platform, (n,), m, m/s, m/s^2.
        tau: input torques, (n,), N m.
    """
    q_a = mechanism.inverse_geometric_model(x, mechanism.named(p))
    return equations_of(mechanism).at(p, q_a, x, x_dot, x_ddot, tau)


@lru_cache
def library_of(mechanism: Mechanism) -> Library:
    """Return the functions of a mechanism, made once and compiled where that can be
    done.

    Raises:
        ParameterError: the mechanism contradicts itself.
    """
    e = equations_of(mechanism)
    vector, p = mechanism.symbols()
    x = ca.SX.sym("x", mechanism.n)
    at = equations_on(mechanism, vector, x, ca.SX.zeros(mechanism.n))
    closed = {"p": e.p, "q_a": e.q_a, "x": e.x, "x_dot": e.x_dot}
    functions = [
        named(
            "inverse_geometric_model",
            {"p": vector, "x": x},
            {"q_a": mechanism.inverse_geometric_model(x, p)},
        ),
        named(
            "state",
            closed,
            {
                "A_r": e.A_r,
                "B": e.B,
                "J_inv": e.J_inv,
                "q_a_dot": e.q_a_dot,
                "b": e.b,
                "drift": e.drift,
                "s": e.s,
                "type1": e.type1,
                "t_s": e.singular.v_weak,
            },
        ),
        named(
            "place",
            {"p": vector, "x": x},
            {
                "q_a": at.q_a,
                "A_r": at.A_r,
                "s": at.s,
                "s_blocks": at.s_blocks,
                "type1": at.type1,
                "t_s": at.singular.v_weak,
                "gradient": ca.gradient(at.s, x),
            },
        ),
        named(
            "wrenches",
            closed | {"x_ddot": e.x_ddot},
            {
                "q_a_ddot": e.q_a_ddot,
                "w_b": e.w_b,
                "w_d": e.w_d,
                "multipliers": e.multipliers,
                "tau": e.inverse_dynamics + e.friction,
                "friction": e.friction,
                "criterion": e.criterion,
                "t_s": e.singular.v_weak,
            },
        ),
        named(
            "platform_dynamics",
            closed | {"tau": e.tau},
            {"M": e.M, "h": e.h, "x_ddot": e.forward_dynamics},
        ),
    ]
    q_a = ca.SX.sym("q_a", mechanism.n)
    mode = ca.SX.sym("assembly_mode", e.s_blocks.numel())
    direct = mechanism.direct_geometric_model(q_a, mode, p)
    if direct is None:
        functions.append(_closed_near(mechanism, e))
    else:
        functions.append(
            named(
                "direct_geometric_model",
                {"p": vector, "q_a": q_a, "assembly_mode": mode},
                {"x": direct},
            )
        )
    return Library(functions, cache_folder())


def _closed_near(mechanism: Mechanism, e: Equations) -> ca.Function:
    """Return the function that finds the platform of given joints, by Newton's method
    from a place near it, and its mirror image.
    """
    vector, p = mechanism.symbols()
    q_a, near = ca.SX.sym("q_a", mechanism.n), ca.SX.sym("near", mechanism.n)
    x = closed_near(mechanism, q_a, near, p)
    s = e.at(vector, q_a, x, ca.SX.zeros(mechanism.n)).s
    return named(
        "closed_near",
        {"p": vector, "q_a": q_a, "near": near},
        {
            "x": x,
            "gap": ca.norm_inf(mechanism.closures(q_a, x, p)),
            "s": s,
            "image": mirror_image(mechanism, q_a, x, p),
        },
    )


def check_geometry(model: Model, places: Array) -> None:
    """Check that the geometric models satisfy the closures, the direct one on its side
    of the locus, and that M is positive definite.

    Args:
        model: of the robot.
        places: platform positions that it reaches, (m, n), m.

    Raises:
        ParameterError: the mechanism contradicts itself at one of the places.
    """
    mechanism = model.mechanism
    vector, p = mechanism.symbols()
    q_a, x = ca.SX.sym("q_a", model.n), ca.SX.sym("x", model.n)
    closures = ca.Function(
        "closures", [vector, q_a, x], [mechanism.closures(q_a, x, p)]
    )

    def gap_at(joints: Array, place: Array) -> float:
        return float(np.abs(np.array(closures(model.p, joints, place))).max())

    rest = np.zeros(model.n)
    size = gap_at(rest, places[0])
    for place in places:
        joints, s = model.inverse_geometric_model(place), model.place(place).s.item()
        gap, at = gap_at(joints, place), np.round(place, 6).tolist()
        if not gap <= CLOSED * max(size, 1e-12):
            raise ParameterError(
                f"the inverse geometric model of {mechanism.name} leaves its closures"
                f" open by {gap:.3g} at x = {at}; it must satisfy them"
            )
        if abs(s) > CLEAR and "direct_geometric_model" in model.library.symbolic:
            found = model.direct_geometric_model(joints, np.sign(s), place)
            allowed = RETURNED * max(float(np.linalg.norm(place)), 1e-3)
            if not np.linalg.norm(found - place) <= allowed:
                raise ParameterError(
                    f"the direct geometric model of {mechanism.name} gives"
                    f" {np.round(found, 6).tolist()} for the joints and the side (s ="
                    f" {s:+.3f}) of x = {at}"
                )
        inertia = model.platform_dynamics(joints, place, rest, rest).M
        if not np.linalg.eigvalsh(inertia).min() > 0.0:
            raise ParameterError(
                f"the inertia of {mechanism.name} at x = {at} is not positive: its"
                " Lagrangian has to be kinetic less potential energy"
            )
