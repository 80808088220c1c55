"""The five-bar as URDF text: two open 2R legs on a fixed base; the loop is closed by a constraint.

The end effector's mass sits half on each distal tip, which is the same body once the tips
coincide. Rotor inertia joins the proximal link, which only turns about its motor.
"""

from __future__ import annotations

from dextar_control.contract.robot import SIM_JOINT_NAMES, LegParameters, RobotParameters
from dextar_sim.geometry import bases

MASS_FLOOR = 1.0e-7
"""kg on a link described as massless: the solver needs a body, and this one weighs nothing beside 0.1 kg."""

_THICKNESS = 0.008


def distal_body(leg: LegParameters, end_effector_mass: float) -> tuple[float, float, float]:
    """Mass (kg), centre from the elbow (m) and inertia about it (kg m^2) of link and its half of the end effector."""
    tip_mass = 0.5 * end_effector_mass
    mass = leg.distal_mass + tip_mass
    if mass < MASS_FLOOR:
        return MASS_FLOOR, leg.distal_center * leg.distal_length, leg.distal_inertia
    link_center = leg.distal_center * leg.distal_length
    center = (leg.distal_mass * link_center + tip_mass * leg.distal_length) / mass
    inertia = (
        leg.distal_inertia
        + leg.distal_mass * (link_center - center) ** 2
        + tip_mass * (leg.distal_length - center) ** 2
    )
    return mass, center, inertia


def five_bar(robot: RobotParameters, *, visual: bool = False) -> str:
    """URDF of both legs; joints carry the contract's names.

    Args:
        robot: the description.
        visual: draw the links.
    """
    parts = ['<robot name="five_bar">', _link("base", 0.0, 0.0, 0.0)]
    for index, (leg, base) in enumerate(zip(robot.legs, bases(robot), strict=True)):
        active, passive = SIM_JOINT_NAMES[2 * index : 2 * index + 2]
        shift = 0.5 * _THICKNESS * (2 * index - 1) if visual else 0.0
        parts.append(
            _link(f"{active}_link", max(leg.proximal_mass, MASS_FLOOR), leg.proximal_center * leg.proximal_length,
                  leg.proximal_inertia + leg.rotor_inertia, leg.proximal_length if visual else 0.0, shift)
        )  # fmt: skip
        parts.append(
            _link(f"{passive}_link", *distal_body(leg, robot.end_effector_mass),
                  leg.distal_length if visual else 0.0, shift + 2.0 * _THICKNESS)
        )  # fmt: skip
        parts.append(_joint(active, "base", f"{active}_link", base))
        parts.append(_joint(passive, f"{active}_link", f"{passive}_link", (leg.proximal_length, 0.0)))
    return "\n".join([*parts, "</robot>"])


def _link(name: str, mass: float, center: float, inertia: float, drawn: float = 0.0, height: float = 0.0) -> str:
    picture = (
        f'<visual><origin xyz="{0.5 * drawn!r} 0 {height!r}"/>'
        f'<geometry><box size="{drawn!r} {_THICKNESS} {_THICKNESS}"/></geometry></visual>'
        if drawn
        else ""
    )
    return (
        f'<link name="{name}"><inertial><origin xyz="{center!r} 0 0"/><mass value="{mass!r}"/>'
        f'<inertia ixx="{inertia!r}" ixy="0" ixz="0" iyy="{inertia!r}" iyz="0" izz="{inertia!r}"/></inertial>'
        f"{picture}</link>"
    )


def _joint(name: str, parent: str, child: str, origin: tuple[float, float]) -> str:
    return (
        f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{origin[0]!r} {origin[1]!r} 0"/><axis xyz="0 0 1"/><dynamics damping="0" friction="0"/></joint>'
    )
