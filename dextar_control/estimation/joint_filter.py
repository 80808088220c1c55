"""Velocities of the joints from their angles, by a tracker about a
reference's motion.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.mechanisms.planar import wrapped
from dextar_control.symbols.functions import Library, cache_folder, in_place, named
from dextar_control.symbols.record import Field, Layout
from dextar_control.symbols.types import Array, Symbol

JOINTS = (
    Field("q", "rad", "filtered angles", "n"),
    Field("q_dot", "rad/s", "filtered velocities", "n"),
    Field("q_ref", "rad", "reference at the last sample", "n"),
    Field("q_ref_dot", "rad/s", "its velocity", "n"),
)


def track_joints(
    memory: dict[str, Symbol],
    q_meas: Symbol,
    q_ref: Symbol,
    q_ref_dot: Symbol,
    dt: Symbol,
    bandwidth: Symbol,
) -> dict[str, Symbol]:
    """Return one step of a critically damped second-order tracker of q_meas - q_ref.

    Args:
        memory: of the filter.
        q_meas: measured joints, (n,), rad, on any turn.
        q_ref, q_ref_dot: of the reference now, (n,), rad, rad/s.
        dt: since the last sample, s.
        bandwidth: rad/s.
    """
    decay = ca.exp(-bandwidth * dt)
    error_dot = memory["q_dot"] - memory["q_ref_dot"]
    predicted = memory["q"] + wrapped(q_ref - memory["q_ref"]) + dt * error_dot
    innovation = wrapped(q_meas - predicted)
    return {
        "q": predicted + (1.0 - decay * decay) * innovation,
        "q_dot": q_ref_dot + error_dot + (1.0 - decay) ** 2 / dt * innovation,
        "q_ref": q_ref,
        "q_ref_dot": q_ref_dot,
    }


@lru_cache
def joint_filter_of(mechanism: Mechanism) -> Library:
    """Return the function ``joints``: one sample about the joints' last position, at
    rest.
    """
    n = mechanism.n
    layout = Layout("joints", n, JOINTS)
    vector, memory = layout.symbols("memory")
    q_meas, dt = ca.SX.sym("q_meas", n), ca.SX.sym("dt")
    bandwidth = ca.SX.sym("bandwidth")
    coasting = track_joints(
        memory, q_meas, memory["q_ref"], ca.SX.zeros(n), dt, bandwidth
    )
    arguments = {"memory": vector, "dt": dt, "bandwidth": bandwidth, "q_meas": q_meas}
    return Library(
        [in_place(named("joints", arguments, {"memory_next": layout.join(coasting)}))],
        cache_folder(),
    )


class JointFilter:
    """The filter of the joints where there is no reference."""

    def __init__(self, mechanism: Mechanism) -> None:
        self.memory = Layout("joints", mechanism.n, JOINTS).make()
        self._step = joint_filter_of(mechanism).fast(
            "joints", memory=self.memory.numbers, memory_next=self.memory.numbers
        )

    def set(self, q: Array, q_dot: Array | float) -> None:
        """Set the joints (n,), rad, and their velocities (n,), rad/s."""
        self.memory.q, self.memory.q_dot = q, q_dot

    def take(self, q_meas: Array, dt: float, bandwidth: float) -> None:
        """Take a sample (n,), rad, dt, s, after the last; begin anew where the memory
        is not finite.
        """
        memory, given = self.memory, self._step.arguments
        if not np.isfinite(memory.q + memory.q_dot).all():
            self.set(q_meas, 0.0)
        given.q_meas[:] = q_meas
        given.dt[0], given.bandwidth[0] = dt, bandwidth
        self._step.run()
