"""A mechanism as rigid bodies in the plane, to be built: a tree of links on joints, and the pins that close its loops."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from dextar_control.symbols.types import Symbol

GROUND = -1


class Link(NamedTuple):
    """A rigid body and the joint by which it moves against its parent.

    Its frame lies at the joint's place and, where the joint is at zero, at an angle to the parent's frame. A revolute joint turns
    it about its origin, a prismatic one shifts it along its x axis.

    Attributes:
        joint: its name; a motor where the mechanism has an active joint of that name.
        parent: which of the links before it, or GROUND.
        place: (2,) of the joint in the parent's frame, m.
        mass: kg.
        center: (2,) of mass in its own frame, m.
        inertia: about the centre of mass, kg m^2, with the rotor's of a motor that turns it against the ground.
        angle: to the parent's frame, rad.
        prismatic: whether the joint is.
        viscous: friction of the joint over its speed, N m s/rad (N s/m).
        coulomb: friction of the joint when it moves, N m (N).
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
    """A place (2,), m, of one link's frame that is to be that of another's.

    Attributes:
        links: which two.
        places: in the frame of each.
    """

    links: tuple[int, int]
    places: tuple[Symbol, Symbol]


class Bodies(NamedTuple):
    """All of a mechanism.

    Attributes:
        links: parents before children.
        pins: that close the loops.
        gravity: (2,) m/s^2.
        coulomb_speed: over which Coulomb friction changes sign, rad/s (m/s).
    """

    links: tuple[Link, ...]
    pins: tuple[Pin, ...]
    gravity: Symbol
    coulomb_speed: Symbol | float = 1.0

    def frames(self, joints: Symbol) -> list[tuple[Symbol, Symbol]]:
        """(origin (2,), m, angle, rad) of each link's frame at positions (m,) of all joints, rad or m."""
        found: list[tuple[Symbol, Symbol]] = []
        for link, joint in zip(self.links, ca.vertsplit(joints), strict=True):
            origin, angle = found[link.parent] if link.parent != GROUND else (ca.SX.zeros(2), ca.SX(0.0))
            origin, angle = placed((origin, angle), link.place), angle + link.angle
            found.append((placed((origin, angle), ca.vertcat(joint, 0.0)), angle) if link.prismatic else (origin, angle + joint))
        return found

    def pinned(self, joints: Symbol) -> list[tuple[Symbol, Symbol]]:
        """Both places (2,), m, of each pin."""
        frames = self.frames(joints)
        return [(placed(frames[pin.links[0]], pin.places[0]), placed(frames[pin.links[1]], pin.places[1])) for pin in self.pins]


def placed(frame: tuple[Symbol, Symbol], place: Symbol) -> Symbol:
    """A place (2,), m, of a link's frame in the frame of the ground."""
    origin, angle = frame
    cosine, sine = ca.cos(angle), ca.sin(angle)
    return origin + ca.vertcat(cosine * place[0] - sine * place[1], sine * place[0] + cosine * place[1])
