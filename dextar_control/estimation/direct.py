"""The platform's state by the direct geometric model, with the paper's precautions
(section 4.2).

Away from the locus the direct model gives the platform. Near it that amplifies any
joint error along t_s and, at folded points, does not exist. The precautions:

- the joint angles are filtered about the reference's own motion, which gives a velocity
  usable with a quantised encoder without the lag of a plain filter;
- inside the zone the direct model is not called: the strong directions of J_inv are
  corrected from the joints, the weak one follows the reference;
- after the zone the direct model takes over again over a time, on the assembly mode
  behind the crossing;
- the direct model's root is clamped at zero, its branch is chosen by the assembly mode,
  which changes only where the reference crosses: noise can flip neither.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.settings import Settings
from dextar_control.estimation.estimate import Estimator
from dextar_control.estimation.joint_filter import JOINTS, track_joints
from dextar_control.estimation.records import ESTIMATE, REFERENCE
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.mechanisms.planar import wrapped
from dextar_control.model.model import Model, equations_of, equations_on
from dextar_control.symbols.functions import (
    Fast,
    Library,
    cache_folder,
    in_place,
    named,
)
from dextar_control.symbols.record import Layout, Record
from dextar_control.symbols.singular import singular_vectors
from dextar_control.symbols.smooth import smooth_step
from dextar_control.symbols.types import Array, Symbol

REFINEMENTS = 2  # Newton steps of the strong directions inside the zone


@lru_cache
def direct_of(mechanism: Mechanism) -> Library:
    """Return the functions of the direct estimators: ``follow`` and ``coast``.

    Raises:
        ParameterError: the mechanism has no direct model in closed form.
    """
    n = mechanism.n
    vector, p = mechanism.symbols()
    joints, estimates = Layout("joints", n, JOINTS), Layout("estimate", n, ESTIMATE)
    memory_vector, memory = joints.symbols("memory")
    before_vector, before = estimates.symbols()
    ref_vector, ref = Layout("reference", n, REFERENCE).symbols()
    q_meas = ca.SX.sym("q_meas", n)
    dt, bandwidth, mode, zone, width, outside, returning = (
        ca.SX.sym(name)
        for name in (
            "dt",
            "bandwidth",
            "assembly_mode",
            "zone",
            "width",
            "time_outside",
            "time_return",
        )
    )
    equations = equations_of(mechanism)
    resting = ca.SX.zeros(n)

    def direct(joint: dict[str, Symbol]) -> tuple[Symbol, Symbol]:
        """Return the direct model and its velocity, x_dot = J_inv^-1 q_a_dot."""
        x = mechanism.direct_geometric_model(joint["q"], mode, p)
        if x is None:
            raise ParameterError(
                "estimator plain or dgm needs a direct model in closed form;"
                f" {mechanism.name} has none"
            )
        return x, ca.solve(
            equations.at(vector, joint["q"], x, resting).J_inv, joint["q_dot"]
        )

    def held(joint: dict[str, Symbol]) -> tuple[Symbol, Symbol]:
        """Return the reference, corrected along the strong directions of J_inv so that
        the joints agree there.
        """
        x = ref["x"]
        J = singular_vectors(equations.at(vector, ref["q_a"], x, ref["x_dot"]).J_inv)
        for _ in range(REFINEMENTS):
            missing = wrapped(joint["q"] - mechanism.inverse_geometric_model(x, p))
            x = x + J.v_strong @ ((J.u_strong.T @ missing) / J.sigma_strong)
        e = equations_on(mechanism, vector, x, ref["x_dot"])
        J = singular_vectors(e.J_inv)
        slow = joint["q_dot"] - e.q_a_dot
        return x, ref["x_dot"] + J.v_strong @ ((J.u_strong.T @ slow) / J.sigma_strong)

    def estimate(joint: dict[str, Symbol], x: Symbol, x_dot: Symbol) -> Symbol:
        s = equations.at(vector, joint["q"], x, x_dot).s
        return estimates.join(
            {
                "x": x,
                "x_dot": x_dot,
                "q_a": joint["q"],
                "q_a_dot": joint["q_dot"],
                "assembly_mode": mode,
                "confidence": before["confidence"],
                "s": s,
                "d": resting,
                "b": resting,
                "twist_dot": resting,
                "innovation": resting,
                "innovation_square": ca.SX(0.0),
            }
        )

    followed = track_joints(memory, q_meas, ref["q_a"], ref["q_a_dot"], dt, bandwidth)
    trust = smooth_step(ca.fabs(ref["s"]), zone, zone + width) * smooth_step(
        outside, 0.0, returning
    )
    trust = ca.if_else(zone <= 0.0, 1.0, trust)
    (x_direct, v_direct), (x_held, v_held) = direct(followed), held(followed)

    def blend(one: Symbol, other: Symbol) -> Symbol:
        return ca.if_else(
            trust <= 0.0,
            one,
            ca.if_else(trust >= 1.0, other, one + trust * (other - one)),
        )

    coasting = track_joints(memory, q_meas, memory["q_ref"], resting, dt, bandwidth)
    alone = {**coasting, "q_ref": coasting["q"]}
    known = {"p": vector, "memory": memory_vector, "estimate": before_vector}
    given = {"dt": dt, "bandwidth": bandwidth, "q_meas": q_meas}
    return Library(
        [
            in_place(
                named(
                    "follow",
                    known
                    | given
                    | {
                        "reference": ref_vector,
                        "zone": zone,
                        "width": width,
                        "time_outside": outside,
                        "time_return": returning,
                        "assembly_mode": mode,
                    },
                    {
                        "memory_next": joints.join(followed),
                        "estimate_next": estimate(
                            followed, blend(x_held, x_direct), blend(v_held, v_direct)
                        ),
                    },
                )
            ),
            in_place(
                named(
                    "coast",
                    known | given | {"assembly_mode": mode},
                    {
                        "memory_next": joints.join(alone),
                        "estimate_next": estimate(alone, *direct(alone)),
                    },
                )
            ),
        ],
        cache_folder(),
    )


class DirectEstimator(Estimator):
    """The estimator ``dgm``: the direct geometric model, but within
    ``dgm.hold_below_abs_s`` of the locus the reference.
    """

    held = True

    def __init__(
        self,
        model: Model,
        settings: Settings,
        min_type1: float,
        estimate: Record | None = None,
    ) -> None:
        self._memory = Layout("joints", model.n, JOINTS).make()
        self._outside = np.inf
        super().__init__(model, settings, min_type1, estimate)
        library = direct_of(model.mechanism)
        memory, shown = self._memory.numbers, self.estimate.numbers
        shared = {
            "p": model.p,
            "memory": memory,
            "memory_next": memory,
            "estimate": shown,
            "estimate_next": shown,
        }
        self._follow = library.fast("follow", **shared)
        self._coast = library.fast("coast", **shared)

    def configure(self, settings: Settings) -> None:
        """See ``Estimator``."""
        super().configure(settings)
        self._bandwidth = settings.joint_filter.bandwidth
        self._return_time = settings.dgm.fade_time

    def start(self, x: Array, q_a: Array, assembly_mode: int) -> None:
        """See ``Estimator``: x (n,), m, q_a (n,), rad."""
        self._memory.q, self._memory.q_dot = q_a, 0.0
        self.rebase(q_a)
        self.tell_mode(assembly_mode, q_a)

    def tell_mode(self, assembly_mode: int, q_a: Array) -> None:
        """See ``Estimator``: q_a (n,), rad."""
        self.believe(assembly_mode, 1.0)
        self._known = True

    def rebase(self, q_a: Array) -> None:
        """See ``Estimator``: q_a (n,), rad."""
        self._memory.q_ref, self._memory.q_ref_dot = q_a, 0.0
        self._outside = np.inf

    def release(self, crossing: bool) -> None:
        """See ``Estimator``."""
        super().release(crossing)
        self._memory.q_ref, self._memory.q_ref_dot = self._memory.q, 0.0

    def _take(self, step: Fast, dt: float, q_a: Array) -> None:
        given = step.arguments
        given.q_meas[:], given.dt[0] = q_a, dt
        given.bandwidth[0] = self._bandwidth
        given.assembly_mode[0] = self.estimate.assembly_mode
        step.run()

    def observe(self, dt: float, q_a: Array, tau: Array) -> None:
        """See ``Estimator``: q_a (n,), rad, tau (n,), N m; about the last joints."""
        self._take(self._coast, dt, q_a)

    def track(
        self,
        dt: float,
        q_a: Array,
        tau: Array,
        reference: Record,
        zone: float,
        width: float,
    ) -> None:
        """See ``Estimator``: q_a (n,), rad, tau (n,), N m; about the reference, with
        which the direct model's branch changes.
        """
        s_ref = reference.s
        if s_ref * self.estimate.assembly_mode < 0.0:
            self.believe(-self.estimate.assembly_mode, 0.5)
        given = self._follow.arguments
        given.reference[:] = reference.numbers
        given.zone[0], given.width[0] = zone if self.held else 0.0, width
        given.time_outside[0] = min(self._outside, 1e9)
        given.time_return[0] = self._return_time
        self._take(self._follow, dt, q_a)
        self._outside = self._outside + dt if abs(s_ref) > zone else 0.0


class PlainEstimator(DirectEstimator):
    """The estimator ``plain``: the direct geometric model everywhere."""

    held = False
