"""A compliant transmission between rotor and joint over one sample, on symbols: its
twist, and the torque that it keeps from the joint.

The encoder is at the motor: it reads the joint's angle and the twist. The rotor's
balance J (q_a_ddot + twist_ddot) = tau - k twist - c twist_dot, of which the rigid
model has all but J twist_ddot, is solved in closed form for a torque and a joint
acceleration that hold over the sample. A rigid one (k = 0) keeps nothing back and does
not twist.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from dextar_control.symbols.types import Symbol

# least and largest damping ratio of rotor and transmission
DAMPING = 0.03, 0.9
LEAST_INERTIA = 1e-7  # kg m^2 of a rotor
LEAST_STIFFNESS = 1.0  # N m/rad of a transmission that is not rigid


class Transmission(NamedTuple):
    """One step of the twists (n,), linear in them, in their rates and in the drive
    (torque / inertia - q_a_ddot).

    Attributes:
        inertia: of the rotors, (n,), kg m^2.
        twist: next twist per twist, rate and drive, (n,) each.
        rate: next rate per the same.
        dt: of the step, s.
    """

    inertia: Symbol
    twist: tuple[Symbol, Symbol, Symbol]
    rate: tuple[Symbol, Symbol, Symbol]
    dt: Symbol

    def held_back(
        self, twist: Symbol, twist_dot: Symbol, tau: Symbol
    ) -> tuple[Symbol, Symbol]:
        """Return (torque (n,), N m, that accelerates the rotors where the joints do
        not, its decrease (n,), N m s^2/rad, with the joints' acceleration).
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
        """Return (twist, rad, its rate, rad/s) at the end of the sample, (n,) each."""
        drive = tau / ca.fmax(self.inertia, LEAST_INERTIA) - q_a_ddot
        first, second = (
            a * twist + b * twist_dot + c * drive for a, b, c in (self.twist, self.rate)
        )
        return first, second


def transmission_over(
    numbers: tuple[Symbol, Symbol, Symbol] | None, dt: Symbol
) -> Transmission | None:
    """Return the step of a mechanism's ``transmission`` over dt, s; None where it has
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
