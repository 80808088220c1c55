"""A mechanism's bodies as URDF text: a tree of links on a fixed base, without the pins
that close its loops.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca

from dextar_control.contract.errors import ParameterError
from dextar_control.mechanisms.bodies import GROUND, Bodies
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.symbols.types import Symbol

# kg on a link described as massless: the solver needs a body, and this one weighs
# nothing beside 0.1 kg.
MASS_FLOOR = 1.0e-7

_THICKNESS = 0.008

Point = tuple[float, float]


def bodies_of(mechanism: Mechanism, values: Mapping[str, object]) -> Bodies:
    """Return a mechanism's bodies with the numbers of its parameters, given under their
    dotted names.

    Raises:
        ParameterError: a parameter is missing or out of its bounds, or the mechanism
            has no bodies.
    """
    bodies = mechanism.bodies(mechanism.named(ca.DM(mechanism.values(values))))
    if bodies is None:
        raise ParameterError(
            f"mechanism {mechanism.name} does not say of which bodies it is made"
        )
    return bodies


def point(place: Symbol) -> Point:
    """Return the two numbers of a place, m."""
    x, y = ca.DM(place).full().ravel().tolist()
    return x, y


def urdf(name: str, bodies: Bodies, *, visual: bool = False) -> str:
    """Write the URDF of the tree; joints carry their names, links the same with
    ``_link`` behind.

    Args:
        name: of the robot.
        bodies: with numbers.
        visual: draw the links.
    """
    parts = [f'<robot name="{name}">', _link("base", 0.0, (0.0, 0.0), 0.0)]
    names = [f"{link.joint}_link" for link in bodies.links]
    pictures = _pictures(bodies) if visual else [""] * len(names)
    for index, link in enumerate(bodies.links):
        mass, center = max(float(link.mass), MASS_FLOOR), point(link.center)
        parts.append(
            _link(names[index], mass, center, float(link.inertia), pictures[index])
        )
        parent = "base" if link.parent == GROUND else names[link.parent]
        parts.append(
            _joint(
                link.joint,
                parent,
                names[index],
                point(link.place),
                float(link.angle),
                link.prismatic,
            )
        )
    return "\n".join([*parts, "</robot>"])


def _pictures(bodies: Bodies) -> list[str]:
    """Draw for each link a box from its joint to each place where another is joined;
    the links of a leg lie above each other.
    """
    joined = [(link.parent, link.place) for link in bodies.links]
    joined += [
        each for pin in bodies.pins for each in zip(pin.links, pin.places, strict=True)
    ]
    roots = [index for index, link in enumerate(bodies.links) if link.parent == GROUND]
    heights: list[float] = []
    for index, link in enumerate(bodies.links):
        if link.parent == GROUND:
            heights.append(_THICKNESS * (roots.index(index) - 0.5 * (len(roots) - 1)))
        else:
            heights.append(heights[link.parent] + 2.0 * _THICKNESS)
    return [
        "".join(_box(point(place), height) for at, place in joined if at == index)
        for index, height in enumerate(heights)
    ]


def _box(end: Point, height: float) -> str:
    """Draw a box from the link's origin to a place of it."""
    return (
        f'<visual><origin xyz="{0.5 * end[0]!r} {0.5 * end[1]!r} {height!r}" rpy="0 0'
        f' {math.atan2(end[1], end[0])!r}"/><geometry><box size="{math.hypot(*end)!r}'
        f' {_THICKNESS} {_THICKNESS}"/></geometry></visual>'
    )


def _link(
    name: str, mass: float, center: Point, inertia: float, picture: str = ""
) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="{center[0]!r} {center[1]!r}'
        f' 0"/><mass value="{mass!r}"/><inertia ixx="{inertia!r}" ixy="0" ixz="0"'
        f' iyy="{inertia!r}" iyz="0" izz="{inertia!r}"/></inertial>{picture}</link>'
    )


def _joint(
    name: str, parent: str, child: str, origin: Point, angle: float, prismatic: bool
) -> str:
    kind, axis = ("prismatic", "1 0 0") if prismatic else ("continuous", "0 0 1")
    # crossed: none
    limit = '<limit lower="1" upper="-1" effort="0" velocity="0"/>' if prismatic else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child'
        f' link="{child}"/><origin xyz="{origin[0]!r} {origin[1]!r} 0" rpy="0 0'
        f' {angle!r}"/><axis xyz="{axis}"/>{limit}<dynamics damping="0"'
        ' friction="0"/></joint>'
    )
