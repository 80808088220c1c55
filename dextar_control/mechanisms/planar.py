"""What planar mechanisms share: legs of two links, rods and circles, on symbols."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import casadi as ca

from dextar_control.mechanisms.bodies import GROUND, Link
from dextar_control.mechanisms.mechanism import Constant, Mechanism, Values
from dextar_control.symbols.types import Symbol

Ends = tuple[Symbol, Symbol]

# where the arc cosine of a leg that does not reach is taken: its derivative is finite
MOST_COSINE = 1.0 - 1e-6
LEAST_REACH = 1e-6  # of the proximal length, below which a leg's end has no direction


def leg_parameters(leg: str) -> tuple[Constant, ...]:
    """Return the parameters of a leg of two links, under the leg's name."""
    links = (("proximal", "motor"), ("distal", "elbow"))
    return (
        *(
            parameter
            for link, joint in links
            for parameter in (
                Constant(f"{leg}.{link}_length", "m", f"of the {link} link", above=0.0),
                Constant(f"{leg}.{link}_mass", "kg", f"of the {link} link", 0.0),
                Constant(
                    f"{leg}.{link}_center",
                    "1",
                    f"centre of mass from the {joint}, as a fraction of the length",
                    0.0,
                    1.0,
                ),
                Constant(
                    f"{leg}.{link}_inertia", "kg m^2", "about its centre of mass", 0.0
                ),
            )
        ),
        Constant(
            f"{leg}.rotor_inertia",
            "kg m^2",
            "of the motor, reflected to the joint",
            0.0,
        ),
        Constant(f"{leg}.viscous_friction", "N m s/rad", "of the active joint", 0.0),
        Constant(f"{leg}.coulomb_friction", "N m", "of the active joint", 0.0),
    )


def plane_parameters(legs: int) -> tuple[Constant, ...]:
    """Return the parameters that legs of two links share: gravity, friction, elbow
    sides.
    """
    return (
        Constant("gravity", "m/s^2", "in the robot's plane", size=2),
        Constant(
            "coulomb_speed",
            "rad/s",
            "over which Coulomb friction changes sign",
            above=0.0,
        ),
        Constant(
            "working_mode",
            "1",
            "elbow side of the legs: +1 left of the line from base to tip",
            -1.0,
            1.0,
            size=legs,
        ),
    )


class TwoLinkLegs(Mechanism):
    """A planar mechanism on legs of a motor, a proximal and a distal link each.

    Leg i runs from the motor axis e_i over the elbow P_i = e_i + l1 u_i, u_i =
    (cos q_i, sin q_i), to its tip C_i on the platform, |C_i - P_i| = l2.

    Attributes:
        legs: their names, which stand before the dot of their parameters' names.
    """

    legs: tuple[str, ...]

    @abstractmethod
    def base(self, leg: int, p: Values) -> Symbol:
        """Return e_i (2,), m, a motor's axis."""

    @abstractmethod
    def tip(self, leg: int, x: Symbol, p: Values) -> Symbol:
        """Return C_i (2,), m, a leg's end on the platform at x (n,), m."""

    @abstractmethod
    def platform_lagrangian(self, x: Symbol, x_dot: Symbol, p: Values) -> Symbol:
        """Return the kinetic less potential energy, J, of the platform alone."""

    def elbow(self, leg: int, angle: Symbol | float, p: Values) -> Symbol:
        """Return P_i (2,), m, at a motor's angle, rad."""
        return self.base(leg, p) + p[self.legs[leg]].proximal_length * direction(angle)

    def distal_rods(self, q_a: Symbol, x: Symbol, p: Values) -> list[Symbol]:
        """Return C_i - P_i (2,), m, of each leg."""
        return [
            self.tip(leg, x, p) - self.elbow(leg, q_a[leg], p) for leg in range(self.n)
        ]

    def closures(self, q_a: Symbol, x: Symbol, p: Values) -> Symbol:
        """Return half of |C_i - P_i|^2 - l2^2 (n,), m^2."""
        rods = self.distal_rods(q_a, x, p)
        return ca.vertcat(
            *(
                0.5 * (ca.sumsqr(r) - p[name].distal_length ** 2)
                for r, name in zip(rods, self.legs, strict=True)
            )
        )

    def lagrangian(
        self, q_a: Symbol, x: Symbol, q_a_dot: Symbol, x_dot: Symbol, p: Values
    ) -> Symbol:
        """Return L, J; each distal rod is seen from its two ends, the elbow and the
        tip.
        """
        energy = self.platform_lagrangian(x, x_dot, p)
        for leg, name in enumerate(self.legs):
            link, base = p[name], self.base(leg, p)
            P, C = self.elbow(leg, q_a[leg], p), self.tip(leg, x, p)
            P_dot, C_dot = ca.jtimes(P, q_a, q_a_dot), ca.jtimes(C, x, x_dot)
            energy += 0.5 * link.rotor_inertia * q_a_dot[leg] ** 2
            energy += rod(
                link.proximal_mass,
                link.proximal_center,
                link.proximal_inertia,
                link.proximal_length,
                (base, P),
                (ca.SX.zeros(2), P_dot),
                p.gravity,
            )
            energy += rod(
                link.distal_mass,
                link.distal_center,
                link.distal_inertia,
                link.distal_length,
                (P, C),
                (P_dot, C_dot),
                p.gravity,
            )
        return energy

    def _reaches(
        self, x: Symbol, p: Values
    ) -> list[tuple[Symbol, Symbol, Symbol, Symbol]]:
        """Return (C_i - e_i (2,), l1, l2, m, elbow side) of each leg."""
        return [
            (
                self.tip(leg, x, p) - self.base(leg, p),
                p[name].proximal_length,
                p[name].distal_length,
                p.working_mode[leg],
            )
            for leg, name in enumerate(self.legs)
        ]

    def inverse_geometric_model(self, x: Symbol, p: Values) -> Symbol:
        """Return q_a (n,), rad, in closed form, in [-pi, pi)."""
        return ca.vertcat(*(two_link_angle(*leg) for leg in self._reaches(x, p)))

    def nearest_joints(self, x: Symbol, p: Values) -> tuple[Symbol, Symbol]:
        """Return (q_a (n,), rad, extension (n,), 1), in closed form."""
        angles, extensions = zip(
            *(nearest_two_link_angle(*leg) for leg in self._reaches(x, p)), strict=True
        )
        return ca.vertcat(*angles), ca.vertcat(*extensions)

    def type1_sines(self, q_a: Symbol, x: Symbol, p: Values) -> Symbol:
        """Return sines (n,) of the elbows' angles."""
        sines = []
        for leg, r in enumerate(self.distal_rods(q_a, x, p)):
            u = direction(q_a[leg])
            sines.append((u[0] * r[1] - u[1] * r[0]) / p[self.legs[leg]].distal_length)
        return ca.vertcat(*sines)

    def friction(self, q_a_dot: Symbol, p: Values) -> Symbol:
        """Return friction (n,), N m, of the motors, which opposes q_a_dot
        (n,), rad/s.
        """
        legs = [p[name] for name in self.legs]
        viscous = ca.vertcat(*(leg.viscous_friction for leg in legs))
        coulomb = ca.vertcat(*(leg.coulomb_friction for leg in legs))
        return viscous_and_coulomb(q_a_dot, viscous, coulomb, p.coulomb_speed)

    def tree_joints(self, q_a: Symbol, x: Symbol, p: Values) -> Symbol:
        """Return angles (2n,), rad, of motors and elbows: q11, q12, q21, q22
        and so on.
        """
        angles = []
        for leg, r in enumerate(self.distal_rods(q_a, x, p)):
            angles += [q_a[leg], wrapped(ca.atan2(r[1], r[0]) - q_a[leg])]
        return ca.vertcat(*angles)


def viscous_and_coulomb(
    rates: Symbol, viscous: Symbol, coulomb: Symbol, speed: Symbol
) -> Symbol:
    """Return viscous and smoothed Coulomb friction (m,), N m, that opposes rates (m,),
    rad/s.

    Args:
        rates: of the joints, (m,), rad/s.
        viscous: coefficients (m,), N m s/rad.
        coulomb: torques (m,), N m.
        speed: over which the Coulomb friction changes sign, rad/s.
    """
    return viscous * rates + coulomb * ca.tanh(rates / speed)


def direction(angle: Symbol | float) -> Symbol:
    """Return the unit vector (2,) at an angle, rad."""
    return ca.vertcat(ca.cos(angle), ca.sin(angle))


def rod(
    mass: Symbol,
    center: Symbol | float,
    inertia: Symbol,
    length: Symbol,
    ends: Ends,
    velocities: Ends,
    gravity: Symbol,
) -> Symbol:
    """Return the Lagrangian, J, of a rigid rod seen from its two ends.

    Args:
        mass: kg.
        center: of mass from the first end, as a fraction of the length.
        inertia: about the centre of mass, kg m^2.
        length: between the ends, m; their distance counts as constant in the kinetic
            energy, as the closures keep it.
        ends, velocities: positions, m, and velocities, m/s, (2,) each.
        gravity: (2,) m/s^2.
    """
    (first, second), (v_first, v_second) = ends, velocities
    v_center = (1.0 - center) * v_first + center * v_second
    kinetic = (
        0.5 * mass * ca.sumsqr(v_center)
        + 0.5 * inertia * ca.sumsqr(v_second - v_first) / length**2
    )
    return kinetic + mass * ca.dot(gravity, (1.0 - center) * first + center * second)


def loaded_rod(
    mass: Symbol, center: Symbol, inertia: Symbol, length: Symbol, load: Symbol | float
) -> tuple[Symbol, Symbol, Symbol]:
    """Return a rod with a point mass at its end, as one body.

    Args:
        mass: of the rod alone, kg.
        center: of its mass, m from its begin.
        inertia: about that, kg m^2.
        length: m.
        load: the point mass, kg.

    Returns:
        (mass, kg, centre (2,), m, inertia about it, kg m^2).
    """
    total = mass + load
    both = ca.if_else(
        total > 0.0,
        (mass * center + load * length) / ca.if_else(total > 0.0, total, 1.0),
        center,
    )
    return (
        total,
        ca.vertcat(both, 0.0),
        inertia + mass * (center - both) ** 2 + load * (length - both) ** 2,
    )


def leg_links(
    bases: Sequence[Symbol], legs: Sequence[Values], load: Symbol | float
) -> list[Link]:
    """Return links on the joints q11, q12, q21, q22 and so on.

    Args:
        bases: of the motors, (2,) each, m.
        legs: the parameters of each leg.
        load: a point mass at the end of each, kg.
    """
    links = []
    for i, (base, leg) in enumerate(zip(bases, legs, strict=True)):
        l1, l2 = leg.proximal_length, leg.distal_length
        links.append(
            Link(
                f"q{i + 1}1",
                GROUND,
                base,
                leg.proximal_mass,
                ca.vertcat(leg.proximal_center * l1, 0.0),
                leg.proximal_inertia + leg.rotor_inertia,
                viscous=leg.viscous_friction,
                coulomb=leg.coulomb_friction,
            )
        )
        distal = loaded_rod(
            leg.distal_mass, leg.distal_center * l2, leg.distal_inertia, l2, load
        )
        links.append(Link(f"q{i + 1}2", 2 * i, ca.vertcat(l1, 0.0), *distal))
    return links


def two_link_angle(
    reach: Symbol, l1: Symbol, l2: Symbol, working_mode: Symbol
) -> Symbol:
    """Return the angle of a leg's first link, rad, in [-pi, pi); nan where it does not
    reach.

    Args:
        reach: from the base to the tip, (2,), m.
        l1, l2: lengths of the first and the second link, m.
        working_mode: +1 where the elbow is left of the line from base to tip, -1 where
            it is right.
    """
    square = ca.sumsqr(reach)
    cosine = (square + l1**2 - l2**2) / (2.0 * l1 * ca.sqrt(square))
    return wrapped(ca.atan2(reach[1], reach[0]) + working_mode * ca.acos(cosine))


def nearest_two_link_angle(
    reach: Symbol, l1: Symbol, l2: Symbol, working_mode: Symbol
) -> tuple[Symbol, Symbol]:
    """Return (``two_link_angle``, rad, extension, 1), finite everywhere as their
    derivatives.

    The extension is minus the cosine of the angle between the links: it is -1 where
    they are folded, 1 where they are stretched, and beyond that out of reach.
    """
    square = ca.fmax(ca.sumsqr(reach), (LEAST_REACH * l1) ** 2)
    cosine = (square + l1**2 - l2**2) / (2.0 * l1 * ca.sqrt(square))
    clamped = ca.fmin(ca.fmax(cosine, -MOST_COSINE), MOST_COSINE)
    angle = ca.atan2(reach[1], reach[0]) + working_mode * ca.acos(clamped)
    return wrapped(angle), (square - l1**2 - l2**2) / (2.0 * l1 * l2)


def wrapped(angle: Symbol) -> Symbol:
    """Return an angle in [-pi, pi), rad."""
    return angle - 2.0 * ca.pi * ca.floor((angle + ca.pi) / (2.0 * ca.pi))


def circles(
    first: Symbol,
    first_radius: Symbol,
    second: Symbol,
    second_radius: Symbol,
    side: Symbol,
    least: float = 0.0,
) -> Symbol:
    """Return the point (2,), m, where two circles meet, on the line of their centres
    where they do not touch.

    Args:
        first, second: centres (2,), m.
        first_radius, second_radius: m.
        side: +1 for the point left of the line of the centres, -1 for that right of it.
        least: least square of half the common chord, m^2; above zero the point has a
            derivative everywhere.
    """
    along, distance = _chord(first, first_radius, second, second_radius)
    d, height = second - first, ca.sqrt(ca.fmax(first_radius**2 - along**2, least))
    return first + (along * d + side * height * ca.vertcat(-d[1], d[0])) / distance


def overlap(
    first: Symbol, first_radius: Symbol, second: Symbol, second_radius: Symbol
) -> Symbol:
    """Return the square of half of two circles' common chord, m^2; below zero where
    they do not touch.
    """
    return first_radius**2 - _chord(first, first_radius, second, second_radius)[0] ** 2


def _chord(
    first: Symbol, first_radius: Symbol, second: Symbol, second_radius: Symbol
) -> tuple[Symbol, Symbol]:
    """Return (from the first centre to the common chord, between the centres), m."""
    distance = ca.sqrt(ca.sumsqr(second - first))
    return 0.5 * (distance + (first_radius**2 - second_radius**2) / distance), distance
