"""Equations of the motor side of a joint over one substep: drive, rotor and
transmission, on symbols.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from dextar_control.symbols.record import Field, Layout
from dextar_control.symbols.types import Symbol

DRIVE = Layout(
    "drive_numbers",
    2,
    (
        Field("inertia", "kg m^2", "of a rotor behind a compliant transmission", 2),
        Field("stiffness", "N m/rad", "of the transmission; 0 is rigid", 2),
        Field("damping", "N m s/rad", "beside it", 2),
        Field("backlash", "rad", "from one end to the other"),
        Field("cogging", "N m", "amplitude"),
        Field("cogging_periods", "1", "in one revolution"),
        Field("drive_lag", "s", "time constant of a torque; 0 is none"),
        Field("torque_step", "N m", "of commands; 0 is none"),
    ),
)
MEMORY = Layout(
    "drive_memory",
    2,
    (
        Field("torque", "N m", "of the motors at the end of a substep", 2),
        Field("rotor", "rad", "angles, half a substep ahead", 2),
        Field("rotor_dot", "rad/s", "their rates", 2),
    ),
)


def drive_step(
    command: Symbol,
    q: Symbol,
    q_dot: Symbol,
    memory: Mapping[str, Symbol],
    p: Mapping[str, Symbol],
    h: Symbol,
) -> tuple[Symbol, dict[str, Symbol]]:
    """Return the torque at the joints over one substep, (2,), N m, and the drives'
    memory after it.

    A lag is followed exactly; its mean over the substep acts. Where the transmission is
    rigid the rotor is the joint, whose inertia the links have.

    Args:
        command: (2,) to the drives, N m.
        q, q_dot: (2,) of the joints, rad, half a substep ahead, and rad/s.
        memory: of ``MEMORY``.
        p: of ``DRIVE``.
        h: substep, s.
    """
    step, lag = p["torque_step"], p["drive_lag"]
    wanted = ca.if_else(
        step > 0.0,
        step * ca.floor(command / ca.if_else(step > 0.0, step, 1.0) + 0.5),
        command,
    )
    slowness = ca.if_else(lag > 0.0, lag, 1.0)
    decay = ca.if_else(lag > 0.0, ca.exp(-h / slowness), 0.0)
    missing = memory["torque"] - wanted
    torque = wanted + missing * ca.if_else(lag > 0.0, slowness / h * (1.0 - decay), 0.0)
    compliant = p["stiffness"] > 0.0
    rotor, rotor_dot = (
        ca.if_else(compliant, of, at)
        for of, at in ((memory["rotor"], q), (memory["rotor_dot"], q_dot))
    )
    torque -= p["cogging"] * ca.sin(p["cogging_periods"] * rotor)
    passed = _passed(rotor - q, rotor_dot - q_dot, p)
    speed = rotor_dot + h * (torque - passed) / p["inertia"]
    after = {
        "torque": wanted + missing * decay,
        "rotor": ca.if_else(compliant, rotor + h * speed, q),
        "rotor_dot": ca.if_else(compliant, speed, q_dot),
    }
    return ca.if_else(compliant, passed, torque), after


def _passed(twist: Symbol, twist_dot: Symbol, p: Mapping[str, Symbol]) -> Symbol:
    """Return the torque that a transmission passes on, N m: spring and damper, which
    teeth with backlash only push with, and only in touch.
    """
    half = 0.5 * p["backlash"]
    stretch = twist - ca.fmin(ca.fmax(twist, -half), half)
    torque = p["stiffness"] * stretch + p["damping"] * twist_dot
    pushed = ca.if_else(
        stretch > 0.0,
        ca.fmax(torque, 0.0),
        ca.if_else(stretch < 0.0, ca.fmin(torque, 0.0), 0.0),
    )
    return ca.if_else(half > 0.0, pushed, torque)
