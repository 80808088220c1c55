"""The functions that planning takes of a mechanism, compiled together, and a robot's with its numbers."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import casadi as ca

from dextar_control.contract.robot import RobotParameters
from dextar_control.mechanisms.five_bar import FiveBar
from dextar_control.model.model import Model, equations_of
from dextar_control.planning.candidate import candidates, costs, layouts
from dextar_control.symbols.functions import Library, cache_folder, named
from dextar_control.symbols.types import Array

KEPT = 64  # robots whose models a thread keeps
_building, _of_thread = threading.Lock(), threading.local()


class PlanningModel(Model):
    """A robot's model with the functions of planning; not for two threads at once.

    Attributes:
        sides: of places x (m, n) -> q_a, s, type1 (m, 1); nan out of reach.
        side: the same of one x.
        instants: of (x, x_dot, x_ddot), (m, n) each -> q_a, q_a_dot, s, type1, residual, multipliers, joint_torque
            (w_b and friction), B.
        locus: of (family, branch, tracing angles (m, 1)) -> x, type1_sines, closing.
        half, crossing, leg, crossing_cost, leg_cost: see ``candidate``.
        layouts: of the records that the last four take.
        numbers: the parameters by their dotted names.
        length: by which distances are measured, m.
        workspace: corners (n,) of a box that holds every place it reaches.
    """

    mechanism: FiveBar

    def __init__(self, mechanism: FiveBar, values: Mapping[str, Any]) -> None:
        super().__init__(mechanism, values)
        library, self.numbers = planning_library(mechanism), mechanism.named(self.p)
        self.sides, self.instants, self.locus = (
            self._with_numbers(library.batch(name)) for name in ("sides", "instants", "locus")
        )
        self.half = library.fast("half")
        self.side, self.crossing, self.leg, self.crossing_cost, self.leg_cost = (
            self._with_numbers(library.fast(name)) for name in ("sides", "crossing", "leg", "crossing_cost", "leg_cost")
        )
        self.layouts = layouts(self.n)
        self.length: float = mechanism.length(self.numbers)
        self.workspace: tuple[Array, Array] = mechanism.workspace(self.numbers)

    def _with_numbers(self, function: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *arguments: function(self.p, *arguments)

    def s(self, x: Array) -> float:
        """Of a platform position (n,) in the working mode; nan out of reach."""
        return float(self.side(x).s[0])


def planning_model(robot: RobotParameters) -> PlanningModel:
    """A robot's; one for each thread, since its functions have places of their own."""
    if not hasattr(_of_thread, "model"):
        _of_thread.model = lru_cache(KEPT)(PlanningModel.of)
    model: PlanningModel = _of_thread.model(robot)
    return model


def planning_library(mechanism: FiveBar) -> Library:
    """The functions of planning for a mechanism, compiled where that can be done, once."""
    with _building:
        return _library(mechanism)


@lru_cache
def _library(mechanism: FiveBar) -> Library:
    e = equations_of(mechanism)
    numbers, x = {"p": e.p}, {"x": e.x}
    at = e.at(e.p, mechanism.inverse_geometric_model(e.x, mechanism.named(e.p)), e.x, e.x_dot, e.x_ddot)
    side = {"q_a": at.q_a, "s": at.s, "type1": at.type1}
    family, branch, angle = (ca.SX.sym(name) for name in ("family", "branch", "angle"))
    q_locus, x_locus, closing = mechanism.type2_locus(family, branch, angle, mechanism.named(e.p))
    made = candidates(mechanism, e)
    return Library([
        named("sides", numbers | x, side),
        named("instants", numbers | x | {"x_dot": e.x_dot, "x_ddot": e.x_ddot}, side | {
            "q_a_dot": at.q_a_dot, "residual": at.criterion, "multipliers": at.multipliers,
            "joint_torque": at.w_b + at.friction, "B": at.B,
        }),
        named("locus", numbers | {"family": family, "branch": branch, "angle": angle}, {
            "x": x_locus, "type1_sines": mechanism.type1_sines(q_locus, x_locus, mechanism.named(e.p)), "closing": closing,
        }),
        *made, *costs(mechanism, e, made),
    ], cache_folder(), 1)
