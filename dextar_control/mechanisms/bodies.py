"""What a mechanism is built of, in the plane: a tree of links on joints, and the pins
that close its loops.
"""

from __future__ import annotations

from typing import NamedTuple

from dextar_control.symbols.types import Symbol

GROUND = -1


class Link(NamedTuple):
    """A rigid body and the joint by which it moves against its parent.

    Its frame lies at the joint's place. A revolute joint turns it there, a prismatic
    one shifts it along its x axis.

    Attributes:
        joint: its name; a motor where the mechanism has an active joint of that name.
        parent: which of the links before it, or GROUND.
        place: (2,) of the joint in the parent's frame, m.
        mass: kg.
        center: (2,) of mass in its own frame, m.
        inertia: about the centre of mass, kg m^2, with the rotor's of a motor that
            turns it against the ground.
        angle: of its frame to the parent's where the joint is at zero, rad.
        prismatic: whether the joint is.
        viscous, coulomb: friction of the joint, N m s/rad (N s/m) and N m (N).
    """

    joint: str
    parent: int
    place: Symbol
    mass: Symbol
    center: Symbol
    inertia: Symbol
    angle: Symbol | float = 0.0
    prismatic: bool = False
    viscous: Symbol | float = 0.0
    coulomb: Symbol | float = 0.0


class Pin(NamedTuple):
    """A place (2,), m, in the frame of each of two links: it is to be the same."""

    links: tuple[int, int]
    places: tuple[Symbol, Symbol]


class Bodies(NamedTuple):
    """All of a mechanism: links, parents before children; pins; gravity (2,), m/s^2;
    speed over which Coulomb friction turns.
    """

    links: tuple[Link, ...]
    pins: tuple[Pin, ...]
    gravity: Symbol
    coulomb_speed: Symbol | float = 1.0
