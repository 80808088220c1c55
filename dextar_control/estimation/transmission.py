"""A compliant transmission between rotor and joint over one sample, on symbols: what it
holds back of the torque, and its twist.

The encoder is at the motor: it reads the joint's angle and the twist. The rotor's
balance J (q_a_ddot + twist_ddot) = tau - k twist - c twist_dot, of which the rigid
model has all but J twist_ddot, is solved in closed form for a torque and a joint
acceleration that hold over the sample. Rigid (k = 0) holds nothing back and does not
twist.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from dextar_control.symbols.types import Symbol

DAMPING = (
    0.03,
    0.9,
    # least and largest damping ratio of rotor and transmission: none rings for ever,
    # and
    # all swing
)
LEAST_INERTIA, LEAST_STIFFNESS = (
    1e-7,
    1.0,
)  # kg m^2 of a rotor, N m/rad of a transmission that is not rigid


class Transmission(NamedTuple):
    """What one sample makes of the twists (n,), linear in them, in their rates and in
    the drive (torque / inertia - q_a_ddot).
    """

    inertia: Symbol  # kg m^2, of the rotors
    twist: tuple[
        Symbol, Symbol, Symbol
    ]  # next twist per twist, rate and drive; nothing drives a rigid one
    rate: tuple[Symbol, Symbol, Symbol]  # next rate per the same
    dt: Symbol

    def held_back(
        self, twist: Symbol, twist_dot: Symbol, tau: Symbol
    ) -> tuple[Symbol, Symbol]:
        """Torque (n,), N m, that turns the rotors away from joints at rest, and what
        each rad/s^2 of a joint takes off it.
        """
        per_twist, per_rate, per_drive = self.rate
        at_rest = (
            self.inertia * (per_twist * twist + (per_rate - 1.0) * twist_dot)
            + per_drive * tau
        )
        return at_rest / self.dt, self.inertia * per_drive / self.dt

    def after(
        self, twist: Symbol, twist_dot: Symbol, tau: Symbol, q_a_ddot: Symbol
    ) -> tuple[Symbol, Symbol]:
        """(twist, its rate) at the end of the sample, (n,) each."""
        drive = tau / ca.fmax(self.inertia, LEAST_INERTIA) - q_a_ddot
        first, second = (
            a * twist + b * twist_dot + c * drive for a, b, c in (self.twist, self.rate)
        )
        return first, second


def transmission_over(
    numbers: tuple[Symbol, Symbol, Symbol] | None, dt: Symbol
) -> Transmission | None:
    """Of a mechanism's ``transmission`` over a sample of dt, s; None where it has
    none.
    """
    if numbers is None:
        return None
    inertia, stiffness, damping = numbers
    moved = ca.fmax(inertia, LEAST_INERTIA)
    square = ca.fmax(stiffness, LEAST_STIFFNESS) / moved
    natural = ca.sqrt(square)
    decay = ca.fmin(
        ca.fmax(0.5 * damping / moved, DAMPING[0] * natural), DAMPING[1] * natural
    )
    swing = ca.sqrt(square - decay**2)
    left = ca.exp(-decay * dt)
    C, S = left * ca.cos(swing * dt), left * ca.sin(swing * dt) / swing
    soft, same = stiffness > 0.0, C + decay * S
    return Transmission(
        inertia,
        (same, S, soft * (1.0 - same) / square),
        (-square * S, C - decay * S, soft * S),
        dt,
    )
