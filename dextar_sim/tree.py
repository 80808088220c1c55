"""Where the bodies of a mechanism are at given joint positions: on symbols, and as
functions that a plant calls.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import casadi as ca

from dextar_control.mechanisms.bodies import GROUND, Bodies
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.symbols.functions import named
from dextar_control.symbols.types import Symbol
from dextar_sim.state import state_layout

Frame = tuple[Symbol, Symbol]  # origin (2,), m, and angle, rad


def placed(frame: Frame, place: Symbol) -> Symbol:
    """Return a place, (2,), m, of a frame in the frame of the ground."""
    origin, angle = frame
    cosine, sine = ca.cos(angle), ca.sin(angle)
    return origin + ca.vertcat(
        cosine * place[0] - sine * place[1], sine * place[0] + cosine * place[1]
    )


def frames(bodies: Bodies, joints: Symbol) -> list[Frame]:
    """List the frame of each link at positions, (m,), of all joints, rad or m."""
    found: list[Frame] = []
    for link, joint in zip(bodies.links, ca.vertsplit(joints), strict=True):
        parent = (
            found[link.parent]
            if link.parent != GROUND
            else (ca.SX.zeros(2), ca.SX(0.0))
        )
        origin, angle = placed(parent, link.place), parent[1] + link.angle
        found.append(
            (placed((origin, angle), ca.vertcat(joint, 0.0)), angle)
            if link.prismatic
            else (origin, angle + joint)
        )
    return found


def gaps(bodies: Bodies, joints: Symbol) -> Symbol:
    """Return the distances, (2, pins), m, from one place of each pin to the other."""
    at = frames(bodies, joints)
    return ca.horzcat(
        *(
            placed(at[one], here) - placed(at[other], there)
            for (one, other), (here, there) in bodies.pins
        )
    )


@lru_cache
def functions_of(mechanism: Mechanism) -> Mapping[str, ca.Function]:
    """Return the functions that a plant asks of a mechanism that has bodies,
    interpreted.

    closed: x, x_dot -> q_a, joints, joints_dot. truth: joints as held, joints_dot, lead
    (s) by which held is ahead, time -> state, a record of ``state_layout``. push:
    joints, force on the platform -> forces at all joints.
    """
    vector, p = mechanism.symbols()
    bodies = mechanism.bodies(p)
    assert bodies is not None
    names, n = [link.joint for link in bodies.links], mechanism.n
    x, x_dot, force = (ca.SX.sym(name, n) for name in ("x", "x_dot", "force"))
    held = ca.SX.sym("held", len(names))
    joints_dot = ca.SX.sym("joints_dot", len(names))
    lead = ca.SX.sym("lead")
    q_a = mechanism.inverse_geometric_model(x, p)
    closed = mechanism.tree_joints(q_a, x, p)
    joints = held - lead * joints_dot
    motors = [names.index(joint.name) for joint in mechanism.joints]
    platform = mechanism.tree_platform(joints, p)
    time, m = ca.SX.sym("time"), len(names)
    state = state_layout(n, m).join(
        {
            "time": time,
            "q_a": joints[motors],
            "q_a_dot": joints_dot[motors],
            "joints": joints,
            "joints_dot": joints_dot,
            "x": platform,
            "x_dot": ca.jtimes(platform, held, joints_dot),
            "loop_gap": ca.sqrt(ca.mmax(ca.sum1(gaps(bodies, joints) ** 2))),
        }
    )
    pushed = ca.jtimes(mechanism.tree_platform(held, p), held, force, True)
    results: dict[str, tuple[dict[str, Symbol], dict[str, Symbol]]] = {
        "closed": (
            {"x": x, "x_dot": x_dot},
            {"q_a": q_a, "joints": closed, "joints_dot": ca.jtimes(closed, x, x_dot)},
        ),
        "truth": (
            {"held": held, "joints_dot": joints_dot, "lead": lead, "time": time},
            {"state": state},
        ),
        "push": ({"joints": held, "force": force}, {"forces": pushed}),
    }
    return {
        name: named(name, {"p": vector, **given}, found)
        for name, (given, found) in results.items()
    }
