"""The functions that planning takes of a mechanism, compiled together, and a robot's
with its numbers.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from functools import lru_cache
from typing import TypeVar

import casadi as ca

from dextar_control.mechanisms.five_bar_locus import FiveBarLocus
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.model.model import Model, equations_of, equations_on
from dextar_control.model.robot import AnyRobot
from dextar_control.planning.candidate import candidates, costs, layouts
from dextar_control.symbols.functions import Library, cache_folder, named
from dextar_control.symbols.singular import nearest
from dextar_control.symbols.types import Array

KEPT = 64  # robots whose models a thread keeps
_building, _of_thread = threading.Lock(), threading.local()
AnyStates = TypeVar("AnyStates", bound="StatesModel")


class StatesModel(Model):
    """A robot's model with functions of many states, for certificates and pictures; not
    for two threads at once.

    Attributes:
        sides: of places x (m, n) -> q_a, s, s_blocks, type1 (m, 1 or k); nan out of
            reach.
        side: the same of one x.
        instants: of (x, x_dot, x_ddot), (m, n) each -> q_a, q_a_dot, s, s_blocks,
            type1, residual, multipliers, joint_torque (w_b and friction), B, criterion.
        numbers: the parameters by their dotted names.
    """

    def __init__(self, mechanism: Mechanism, values: Mapping[str, object]) -> None:
        super().__init__(mechanism, values)
        library, self.numbers = states_library(mechanism), mechanism.named(self.p)
        self.sides, self.instants = (
            self._bound(library.batch(name)) for name in ("sides", "instants")
        )
        self.side = self._bound(library.fast("sides"))

    def s(self, x: Array) -> float:
        """Return s of a platform position x (n,), m, in the working mode; nan out of
        reach.
        """
        return float(self.side(x).s[0])


class PlanningModel(StatesModel):
    """A ``StatesModel`` with the locus and the functions of the search.

    Attributes:
        locus: of (family, branch, tracing angles (m, 1)) -> x, type1_sines, closing;
            where it is traced in closed form.
        half, crossing, leg, crossing_cost, leg_cost: see ``candidate``.
        layouts: of the records that the last four take.
        length: by which distances are measured, m.
        workspace: corners (n,), m, of a box that holds every place a five-bar reaches.
    """

    def __init__(self, mechanism: Mechanism, values: Mapping[str, object]) -> None:
        super().__init__(mechanism, values)
        library = planning_library(mechanism)
        self.half = library.fast("half")
        if "locus" in library.symbolic:
            self.locus = self._bound(library.batch("locus"))
        self.crossing, self.leg, self.crossing_cost, self.leg_cost = (
            self._bound(library.fast(name))
            for name in ("crossing", "leg", "crossing_cost", "leg_cost")
        )
        self.layouts = layouts(self.n)
        self.length: float = mechanism.length(self.numbers)
        if isinstance(mechanism, FiveBarLocus):
            self.workspace: tuple[Array, Array] = mechanism.workspace(self.numbers)


def states_model(robot: AnyRobot) -> StatesModel:
    """Return the ``StatesModel`` of a robot, one for each thread."""
    return _own(StatesModel, robot)


def planning_model(robot: AnyRobot) -> PlanningModel:
    """Return the ``PlanningModel`` of a robot, one for each thread."""
    return _own(PlanningModel, robot)


def _own(kind: type[AnyStates], robot: AnyRobot) -> AnyStates:
    if not hasattr(_of_thread, kind.__name__):
        setattr(_of_thread, kind.__name__, lru_cache(KEPT)(kind.of))
    model: AnyStates = getattr(_of_thread, kind.__name__)(robot)
    return model


def states_library(mechanism: Mechanism) -> Library:
    """Return the functions of ``StatesModel``, made once, compiled where that can be
    done.
    """
    with _building:
        return _states_library(mechanism)


def planning_library(mechanism: Mechanism) -> Library:
    """Return the other functions of ``PlanningModel``, likewise."""
    with _building:
        return _planning_library(mechanism)


@lru_cache
def _states_library(mechanism: Mechanism) -> Library:
    e = equations_of(mechanism)
    at = equations_on(mechanism, e.p, e.x, e.x_dot, e.x_ddot)
    place = {"p": e.p, "x": e.x}
    side = {"q_a": at.q_a, "s": at.s, "s_blocks": at.s_blocks, "type1": at.type1}
    return Library(
        [
            named("sides", place, side),
            named(
                "instants",
                place | {"x_dot": e.x_dot, "x_ddot": e.x_ddot},
                side
                | {
                    "q_a_dot": at.q_a_dot,
                    "residual": nearest(at.s_blocks, at.criterion),
                    "criterion": at.criterion,
                    "multipliers": at.multipliers,
                    "joint_torque": at.w_b + at.friction,
                    "B": at.B,
                },
            ),
        ],
        cache_folder(),
    )


@lru_cache
def _planning_library(mechanism: Mechanism) -> Library:
    e = equations_of(mechanism)
    family, branch, angle = (ca.SX.sym(name) for name in ("family", "branch", "angle"))
    made = candidates(mechanism, e)
    functions = [*made, *costs(mechanism, e, made)]
    traced = mechanism.type2_locus(family, branch, angle, mechanism.named(e.p))
    if traced is not None:
        q_a, x, closing = traced
        functions.insert(
            0,
            named(
                "locus",
                {"p": e.p, "family": family, "branch": branch, "angle": angle},
                {
                    "x": x,
                    "type1_sines": mechanism.type1_sines(q_a, x, mechanism.named(e.p)),
                    "closing": closing,
                },
            ),
        )
    return Library(functions, cache_folder(), 1)
