"""A mechanism with its numbers: one state's kinematics and dynamics as fast functions."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from dextar_control.contract.errors import GeometryError, ParameterError
from dextar_control.contract.robot import RobotParameters, flatten
from dextar_control.mechanisms import mechanism_named
from dextar_control.mechanisms.mechanism import Array, Mechanism
from dextar_control.model.equations import Equations, equations
from dextar_control.model.functions import Fast, Library, cache_folder, named

AnyModel = TypeVar("AnyModel", bound="Model")

CLOSED = 1e-9  # of the closures' own size, beyond which a geometric model does not satisfy them


class Model:
    """Functions of a mechanism for one robot; not for two threads at once.

    Args:
        mechanism: the equations.
        values: by the dotted names of the mechanism's parameters.

    Attributes:
        p: the parameters as one vector.
        n: degrees of freedom.
        state: (q_a, x, x_dot) -> A_r, B, J_inv, q_a_dot, b, drift, s, type1, t_s: kinematics of a closed configuration.
        wrenches: (q_a, x, x_dot, x_ddot) -> q_a_ddot, w_b, w_d, multipliers, tau, friction, criterion, t_s.
        platform_dynamics: (q_a, x, x_dot, tau) -> M, h, x_ddot; regular on the Type 2 locus.

    Raises:
        ParameterError: a parameter is missing or out of its bounds.
    """

    def __init__(self, mechanism: Mechanism, values: Mapping[str, Any]) -> None:
        self.mechanism, self.n = mechanism, mechanism.n
        self.p = mechanism.values(values)
        self.library = library_of(mechanism)
        self._inverse = self.library.fast("inverse_geometric_model")
        self.state, self.wrenches, self.platform_dynamics = (
            self._bound(name) for name in ("state", "wrenches", "platform_dynamics")
        )

    @classmethod
    def of(cls: type[AnyModel], robot: RobotParameters) -> AnyModel:
        """That of a robot's description."""
        return cls(mechanism_named("five_bar"), flatten(robot))

    def _bound(self, name: str) -> Any:
        fast: Fast = self.library.fast(name)
        return lambda *arguments: fast(self.p, *arguments)

    def inverse_geometric_model(self, x: Array) -> Array:
        """q_a (n,) of a platform position x (n,).

        Raises:
            GeometryError: a leg does not reach it.
        """
        (q_a,) = self._inverse(self.p, x)
        if not np.isfinite(q_a).all():
            raise GeometryError(self.mechanism.unreached(np.asarray(x), q_a, self.mechanism.named(self.p)))
        return np.asarray(q_a)


@lru_cache
def equations_of(mechanism: Mechanism) -> Equations:
    """The equations of a mechanism, once."""
    return equations(mechanism)


@lru_cache
def library_of(mechanism: Mechanism) -> Library:
    """The functions of a mechanism, compiled where that can be done, once.

    Raises:
        ParameterError: the mechanism contradicts itself.
    """
    e = equations_of(mechanism)
    vector, p = mechanism.symbols()
    x = ca.SX.sym("x", mechanism.n)
    closed = {"p": e.p, "q_a": e.q_a, "x": e.x, "x_dot": e.x_dot}
    functions = [
        named("inverse_geometric_model", {"p": vector, "x": x}, {"q_a": mechanism.inverse_geometric_model(x, p)}),
        named("state", closed, {
            "A_r": e.A_r, "B": e.B, "J_inv": e.J_inv, "q_a_dot": e.q_a_dot, "b": e.b, "drift": e.drift, "s": e.s,
            "type1": e.type1, "t_s": e.singular.v_weak,
        }),
        named("wrenches", closed | {"x_ddot": e.x_ddot}, {
            "q_a_ddot": e.q_a_ddot, "w_b": e.w_b, "w_d": e.w_d, "multipliers": e.multipliers,
            "tau": e.inverse_dynamics + e.friction, "friction": e.friction, "criterion": e.criterion, "t_s": e.singular.v_weak,
        }),
        named("platform_dynamics", closed | {"tau": e.tau}, {"M": e.M, "h": e.h, "x_ddot": e.forward_dynamics}),
    ]  # fmt: skip
    q_a, mode = ca.SX.sym("q_a", mechanism.n), ca.SX.sym("assembly_mode")
    direct = mechanism.direct_geometric_model(q_a, mode, p)
    if direct is not None:
        functions.append(named("direct_geometric_model", {"p": vector, "q_a": q_a, "assembly_mode": mode}, {"x": direct}))
    return Library(functions, cache_folder())


def check_geometry(model: Model, places: Array) -> None:
    """The geometric models satisfy the closures.

    Args:
        model: of the robot.
        places: (m, n) platform positions that it reaches.

    Raises:
        ParameterError: they do not, or there is no such place.
    """
    mechanism = model.mechanism
    vector, p = mechanism.symbols()
    q_a, x = ca.SX.sym("q_a", model.n), ca.SX.sym("x", model.n)
    closures = ca.Function("closures", [vector, q_a, x], [mechanism.closures(q_a, x, p)])
    size = float(np.abs(np.array(closures(model.p, np.zeros(model.n), places[0]))).max())
    for place in places:
        gap = float(np.abs(np.array(closures(model.p, model.inverse_geometric_model(place), place))).max())
        if not gap <= CLOSED * max(size, 1e-12):
            raise ParameterError(
                f"the inverse geometric model of {mechanism.name} leaves its closures open by {gap:.3g} at x ="
                f" {np.round(place, 6).tolist()}; it must satisfy them"
            )
