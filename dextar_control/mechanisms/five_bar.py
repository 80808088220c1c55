"""The planar five-bar: two legs of a motor, a proximal link, a passive elbow and a
distal link that meet in the end effector.

Frame: that of the motor axes e_i; where only their distance is given, its origin is
midway, x towards the right one. Leg i runs from the motor axis e_i over the elbow P_i =
e_i + l1 u_i, u_i = (cos q_i, sin q_i), to the end effector x, |x - P_i| = l2.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from dextar_control.mechanisms.bodies import Bodies, Pin
from dextar_control.mechanisms.five_bar_locus import LEAST_CHORD, SIDES, FiveBarLocus
from dextar_control.mechanisms.mechanism import Coordinate, Parameter
from dextar_control.mechanisms.planar import (
    circles,
    direction,
    friction,
    leg_joints,
    leg_links,
    leg_parameters,
    nearest_two_link_angle,
    rod,
    rubbing,
    two_link_angle,
)
from dextar_control.symbols.types import Array, Symbol

PASSIVE = ("passive_viscous_friction", "N m s/rad"), ("passive_coulomb_friction", "N m")


class FiveBar(FiveBarLocus):
    """Two 2R legs closed at the end effector; q_a = (q11, q21), x = (x, y)."""

    name = "five_bar"
    joints = (Coordinate("q11", "rad"), Coordinate("q21", "rad"))
    coordinates = (Coordinate("x", "m"), Coordinate("y", "m"))
    parameters = (
        *(Parameter(f"{side}.axis", "m", "of the motor", size=2) for side in SIDES),
        *(number for side in SIDES for number in leg_parameters(side)),
        Parameter("end_effector_mass", "kg", "point mass at the end effector", 0.0),
        Parameter("gravity", "m/s^2", "in the robot's plane", size=2),
        Parameter(
            "coulomb_speed",
            "rad/s",
            "over which Coulomb friction changes sign",
            above=0.0,
        ),
        Parameter(
            "working_mode",
            "1",
            "elbow side of the legs: +1 left of the line base -> end effector",
            -1.0,
            1.0,
            size=2,
        ),
    )

    def elbow(self, leg: int, angle: Symbol | float, p: Any) -> Symbol:
        """P_i (2,), m, at a motor's angle."""
        return self.base(leg, p) + getattr(p, SIDES[leg]).proximal_length * direction(
            angle
        )

    def closures(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """Half of |x - P_i|^2 - l2^2, m^2."""
        rods = [x - self.elbow(leg, q_a[leg], p) for leg in range(2)]
        lengths = [getattr(p, side).distal_length for side in SIDES]
        return ca.vertcat(
            *(0.5 * (ca.sumsqr(r) - l2**2) for r, l2 in zip(rods, lengths, strict=True))
        )

    def lagrangian(
        self, q_a: Symbol, x: Symbol, q_a_dot: Symbol, x_dot: Symbol, p: Any
    ) -> Symbol:
        """Each distal rod is seen from its two ends, the elbow and the end effector."""
        energy = 0.5 * p.end_effector_mass * ca.sumsqr(
            x_dot
        ) + p.end_effector_mass * ca.dot(p.gravity, x)
        for leg, side in enumerate(SIDES):
            link, base = getattr(p, side), self.base(leg, p)
            P = self.elbow(leg, q_a[leg], p)
            P_dot = ca.jtimes(P, q_a, q_a_dot)
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
                (P, x),
                (P_dot, x_dot),
                p.gravity,
            )
        return energy

    def inverse_geometric_model(self, x: Symbol, p: Any) -> Symbol:
        """In closed form, in [-pi, pi)."""
        return ca.vertcat(
            *(
                two_link_angle(
                    x - self.base(leg, p),
                    getattr(p, side).proximal_length,
                    getattr(p, side).distal_length,
                    p.working_mode[leg],
                )
                for leg, side in enumerate(SIDES)
            )
        )

    def nearest_joints(self, x: Symbol, p: Any) -> tuple[Symbol, Symbol]:
        """In closed form."""
        found = [
            nearest_two_link_angle(
                x - self.base(leg, p),
                getattr(p, side).proximal_length,
                getattr(p, side).distal_length,
                p.working_mode[leg],
            )
            for leg, side in enumerate(SIDES)
        ]
        return ca.vertcat(*(q for q, _ in found)), ca.vertcat(
            *(extension for _, extension in found)
        )

    def unreached(self, x: Array, q_a: Array, p: Any) -> str:
        """The distance of the first leg that does not reach, and its limits."""
        leg = int(np.argmin(np.isfinite(q_a)))
        link, distance = (
            getattr(p, SIDES[leg]),
            float(np.hypot(*(x - np.array(self.base(leg, p)).ravel()))),
        )
        l1, l2 = float(link.proximal_length[0]), float(link.distal_length[0])
        return (
            f"point ({x[0]:.4f}, {x[1]:.4f}) m is {distance:.4f} m from the"
            f" {SIDES[leg]} motor axis; the leg reaches {abs(l1 - l2):.4f} to"
            f" {l1 + l2:.4f} m"
        )

    def direct_geometric_model(
        self, q_a: Symbol, assembly_mode: Symbol, p: Any
    ) -> Symbol:
        """The distal links' circles about the elbows, never on the line of the elbows
        itself, where the velocity would be 0/0.

        Elbows that coincide define no point: nan.
        """
        left, right = (self.elbow(leg, q_a[leg], p) for leg in range(2))
        return circles(
            left,
            p.left.distal_length,
            right,
            p.right.distal_length,
            assembly_mode,
            LEAST_CHORD,
        )

    def mirror_image(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """Mirrored on the line of the elbows."""
        first, second = (x - self.elbow(leg, q_a[leg], p) for leg in range(2))
        side = first[0] * second[1] - first[1] * second[0]  # of the sign of s
        return self.direct_geometric_model(q_a, ca.if_else(side > 0.0, -1.0, 1.0), p)

    def why_open(self, q_a: Array, p: Any) -> str:
        """By the distance of the elbows."""
        left, right = (
            np.array(self.elbow(leg, float(q_a[leg]), p)).ravel() for leg in range(2)
        )
        distance = float(np.hypot(*(right - left)))
        lengths = float(p.left.distal_length[0]), float(p.right.distal_length[0])
        low, high = abs(lengths[0] - lengths[1]), sum(lengths)
        if low <= distance <= high and distance != 0.0:
            return ""
        return (
            f"the elbows are {distance:.6f} m apart; the distal links close {low:.6f}"
            f" to {high:.6f} m"
        )

    def folded(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """Of the distal links: the image is a whole turn of them away where they point
        the same way.
        """
        return ca.dot(x - self.elbow(0, q_a[0], p), x - self.elbow(1, q_a[1], p))

    def singularity_of_joints(self, q_a: Symbol, p: Any) -> Symbol:
        """Sine of the angle between the distal links, which follows from the distance
        of the elbows.
        """
        l2, r2 = p.left.distal_length, p.right.distal_length
        between = ca.sumsqr(self.elbow(1, q_a[1], p) - self.elbow(0, q_a[0], p))
        cosine = 0.5 * (l2**2 + r2**2 - between) / (l2 * r2)
        square = 1.0 - cosine**2
        closes = square > 0.0
        return ca.if_else(closes, ca.sqrt(ca.if_else(closes, square, 1.0)), 0.0)

    def linkage(self, q_a: Array, x: Array, p: Any) -> Array:
        """(5, 2) motor, elbow, end effector, elbow, motor, m, to draw; ``p`` has
        numbers.
        """
        (left, first), (right, second) = (
            (self.base(leg, p), self.elbow(leg, float(q_a[leg]), p)) for leg in range(2)
        )
        return np.array(ca.horzcat(left, first, ca.DM(x), second, right)).T

    def bodies(self, p: Any) -> Bodies:
        """Both legs, half of the end effector's mass on each tip: pinned together they
        are one body.
        """
        links = leg_links(
            [self.base(leg, p) for leg in range(2)],
            [p.left, p.right],
            0.5 * p.end_effector_mass,
        )
        left, right = (
            ca.vertcat(link.distal_length, 0.0) for link in (p.left, p.right)
        )
        return Bodies(
            tuple(links), (Pin((1, 3), (left, right)),), p.gravity, p.coulomb_speed
        )

    def tree_joints(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """q11, q12, q21, q22."""
        return ca.vertcat(
            *leg_joints(q_a, [x - self.elbow(leg, q_a[leg], p) for leg in range(2)])
        )

    def tree_platform(self, joints: Symbol, p: Any) -> Symbol:
        """In the middle of the tips."""
        left, right = (
            self.elbow(leg, joints[2 * leg], p)
            + getattr(p, side).distal_length
            * direction(joints[2 * leg] + joints[2 * leg + 1])
            for leg, side in enumerate(SIDES)
        )
        return 0.5 * (left + right)

    def singularity_scale(self, p: Any) -> Symbol:
        """s is then the sine of the angle between the distal links."""
        return p.left.distal_length * p.right.distal_length

    def singularity_length(self, p: Any) -> Symbol:
        """Geometric mean of the distal lengths, m."""
        return ca.sqrt(p.left.distal_length * p.right.distal_length)

    def type1_sines(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """Sines of the elbows' angles."""
        sines = []
        for leg, side in enumerate(SIDES):
            link, u = getattr(p, side), direction(q_a[leg])
            r = x - self.elbow(leg, q_a[leg], p)
            sines.append((u[0] * r[1] - u[1] * r[0]) / link.distal_length)
        return ca.vertcat(*sines)

    def friction(self, q_a_dot: Symbol, p: Any) -> Symbol:
        """Of the motors."""
        return friction(q_a_dot, [getattr(p, side) for side in SIDES], p.coulomb_speed)


class DetailedFiveBar(FiveBar):
    """The same with friction of elbows and pin and elastic transmissions, which cost
    each tick some time.
    """

    detail = (
        *(
            Parameter(f"{side}.{name}", unit, "of the elbow", 0.0)
            for side in SIDES
            for name, unit in PASSIVE
        ),
        Parameter("pin_viscous_friction", "N m s/rad", "between the distal links", 0.0),
        Parameter("pin_coulomb_friction", "N m", "between the distal links", 0.0),
        *(
            Parameter(
                f"{side}.transmission_stiffness",
                "N m/rad",
                "behind the rotor; 0 is rigid",
                0.0,
            )
            for side in SIDES
        ),
        *(
            Parameter(f"{side}.transmission_damping", "N m s/rad", "beside it", 0.0)
            for side in SIDES
        ),
    )
    parameters = (*FiveBar.parameters, *detail)

    def transmission(self, p: Any) -> tuple[Symbol, Symbol, Symbol]:
        """Of the motors."""
        legs = [getattr(p, side) for side in SIDES]
        inertia, stiffness, damping = (
            [getattr(leg, name) for leg in legs]
            for name in (
                "rotor_inertia",
                "transmission_stiffness",
                "transmission_damping",
            )
        )
        return ca.vertcat(*inertia), ca.vertcat(*stiffness), ca.vertcat(*damping)

    def passive_friction(
        self, q_a: Symbol, x: Symbol, q_a_dot: Symbol, x_dot: Symbol, p: Any
    ) -> tuple[Symbol, Symbol]:
        """Of the left elbow, the right one and the pin."""
        turning = []
        for leg, side in enumerate(SIDES):
            P = self.elbow(leg, q_a[leg], p)
            r, r_dot = x - P, x_dot - ca.jtimes(P, q_a, q_a_dot)
            turning.append(
                (r[0] * r_dot[1] - r[1] * r_dot[0])
                / getattr(p, side).distal_length ** 2
            )
        left, right = turning
        rates = ca.vertcat(left - q_a_dot[0], right - q_a_dot[1], right - left)
        viscous = ca.vertcat(
            p.left.passive_viscous_friction,
            p.right.passive_viscous_friction,
            p.pin_viscous_friction,
        )
        coulomb = ca.vertcat(
            p.left.passive_coulomb_friction,
            p.right.passive_coulomb_friction,
            p.pin_coulomb_friction,
        )
        return rates, rubbing(rates, viscous, coulomb, p.coulomb_speed)
