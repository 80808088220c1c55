"""What planar mechanisms share: rods, circles and two-link legs, on symbols."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

from dextar_control.mechanisms.bodies import GROUND, Link
from dextar_control.mechanisms.mechanism import Parameter
from dextar_control.symbols.types import Symbol

Ends = tuple[Symbol, Symbol]

MOST_COSINE = (
    1.0 - 1e-6
    # where the arc cosine of a leg that does not reach is taken: its derivative is
    # finite
)
LEAST_REACH = 1e-6  # of the proximal length, below which a leg's end has no direction


def leg_parameters(leg: str) -> tuple[Parameter, ...]:
    """Of a leg with a motor, a proximal and a distal link, under the leg's name."""
    return (
        Parameter(f"{leg}.proximal_length", "m", "of the proximal link", above=0.0),
        Parameter(f"{leg}.proximal_mass", "kg", "of the proximal link", 0.0),
        Parameter(
            f"{leg}.proximal_center",
            "1",
            "centre of mass from the motor, as a fraction of the length",
            0.0,
            1.0,
        ),
        Parameter(f"{leg}.proximal_inertia", "kg m^2", "about its centre of mass", 0.0),
        Parameter(f"{leg}.distal_length", "m", "of the distal link", above=0.0),
        Parameter(f"{leg}.distal_mass", "kg", "of the distal link", 0.0),
        Parameter(
            f"{leg}.distal_center",
            "1",
            "centre of mass from the elbow, as a fraction of the length",
            0.0,
            1.0,
        ),
        Parameter(f"{leg}.distal_inertia", "kg m^2", "about its centre of mass", 0.0),
        Parameter(
            f"{leg}.rotor_inertia",
            "kg m^2",
            "of the motor, reflected to the joint",
            0.0,
        ),
        Parameter(f"{leg}.viscous_friction", "N m s/rad", "of the active joint", 0.0),
        Parameter(f"{leg}.coulomb_friction", "N m", "of the active joint", 0.0),
    )


def friction(q_a_dot: Symbol, legs: Sequence[Any], coulomb_speed: Symbol) -> Symbol:
    """Viscous and smoothed Coulomb friction (n,), N m, of the legs' motors, opposing
    q_a_dot (n,), rad/s.
    """
    viscous = ca.vertcat(*(leg.viscous_friction for leg in legs))
    coulomb = ca.vertcat(*(leg.coulomb_friction for leg in legs))
    return rubbing(q_a_dot, viscous, coulomb, coulomb_speed)


def rubbing(rates: Symbol, viscous: Symbol, coulomb: Symbol, speed: Symbol) -> Symbol:
    """Viscous and smoothed Coulomb friction (m,), N m, that opposes rates (m,),
    rad/s.
    """
    return viscous * rates + coulomb * ca.tanh(rates / speed)


def direction(angle: Symbol | float) -> Symbol:
    """Unit vector (2,) at an angle, rad."""
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
    """Lagrangian, J, of a rigid rod seen from its two ends.

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
    """(mass, kg, centre (2,), m, inertia about it, kg m^2) of a rod, its centre in m,
    with a point mass, kg, at its end.
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
    bases: Sequence[Symbol], legs: Sequence[Any], load: Symbol | float
) -> list[Link]:
    """Links on q11, q12, q21, q22, ... of legs whose motors stand at ``bases``, a point
    mass, kg, at the end of each.
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


def leg_joints(q_a: Symbol, rods: Sequence[Symbol]) -> list[Symbol]:
    """Angles of those joints, rad, where the distal links lie along ``rods`` (2,)."""
    return [
        angle
        for i, rod in enumerate(rods)
        for angle in (q_a[i], wrapped(ca.atan2(rod[1], rod[0]) - q_a[i]))
    ]


def two_link_angle(
    reach: Symbol, l1: Symbol, l2: Symbol, working_mode: Symbol
) -> Symbol:
    """Angle of the first link, in [-pi, pi), of a leg whose two links span ``reach``
    (2,); nan where they cannot.

    Args:
        working_mode: +1 where the elbow is left of the line from base to end, -1 where
            it is right.
    """
    square = ca.sumsqr(reach)
    cosine = (square + l1**2 - l2**2) / (2.0 * l1 * ca.sqrt(square))
    return wrapped(ca.atan2(reach[1], reach[0]) + working_mode * ca.acos(cosine))


def nearest_two_link_angle(
    reach: Symbol, l1: Symbol, l2: Symbol, working_mode: Symbol
) -> tuple[Symbol, Symbol]:
    """(``two_link_angle``, extension): finite everywhere, with its derivatives.

    The extension is minus the cosine of the angle between the links: -1 folded, 1
        stretched, and beyond that out of reach.
    """
    square = ca.fmax(ca.sumsqr(reach), (LEAST_REACH * l1) ** 2)
    cosine = (square + l1**2 - l2**2) / (2.0 * l1 * ca.sqrt(square))
    clamped = ca.fmin(ca.fmax(cosine, -MOST_COSINE), MOST_COSINE)
    angle = ca.atan2(reach[1], reach[0]) + working_mode * ca.acos(clamped)
    return wrapped(angle), (square - l1**2 - l2**2) / (2.0 * l1 * l2)


def wrapped(angle: Symbol) -> Symbol:
    """An angle in [-pi, pi), rad."""
    return angle - 2.0 * ca.pi * ca.floor((angle + ca.pi) / (2.0 * ca.pi))


def circles(
    first: Symbol,
    first_radius: Symbol,
    second: Symbol,
    second_radius: Symbol,
    side: Symbol,
    least: float = 0.0,
) -> Symbol:
    """Where two circles meet (2,): left (+1) or right (-1) of the line of their
    centres, on it where they do not touch.

    Args:
        first, second: centres (2,), m.
        first_radius, second_radius: m.
        side: +1 or -1.
        least: square of their half common chord, m^2, from which on it counts; above
            zero it has a derivative everywhere.
    """
    along, distance = _chord(first, first_radius, second, second_radius)
    d, height = second - first, ca.sqrt(ca.fmax(first_radius**2 - along**2, least))
    return first + (along * d + side * height * ca.vertcat(-d[1], d[0])) / distance


def overlap(
    first: Symbol, first_radius: Symbol, second: Symbol, second_radius: Symbol
) -> Symbol:
    """Square of half the circles' common chord, m^2; below zero where they do not
    touch.
    """
    return first_radius**2 - _chord(first, first_radius, second, second_radius)[0] ** 2


def _chord(
    first: Symbol, first_radius: Symbol, second: Symbol, second_radius: Symbol
) -> tuple[Symbol, Symbol]:
    """(from the first centre to the common chord, between the centres), m."""
    distance = ca.sqrt(ca.sumsqr(second - first))
    return 0.5 * (distance + (first_radius**2 - second_radius**2) / distance), distance
