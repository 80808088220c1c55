"""The planar 3-RRR: three legs of a motor, a proximal and a distal link carry a
platform that moves and turns in the plane.

Frame: origin in the middle of the three motor axes, which lie on a circle at 90, 210
and 330 degrees. The platform's corners C_i lie on a circle about its centre (X, Y), at
the same angles plus phi. Leg i runs from the motor axis e_i over the elbow P_i = e_i +
l1 (cos q_i, sin q_i) to C_i, |C_i - P_i| = l2. The third coordinate is rho phi: a
length, as the others.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from dextar_control.mechanisms.bodies import Bodies, Link, Pin
from dextar_control.mechanisms.mechanism import Coordinate, Mechanism, Parameter
from dextar_control.mechanisms.planar import (
    direction,
    friction,
    leg_joints,
    leg_links,
    leg_parameters,
    nearest_two_link_angle,
    rod,
    two_link_angle,
)
from dextar_control.symbols.types import Array, Symbol

LEGS = ("leg1", "leg2", "leg3")
ANGLES = tuple(
    ca.pi * (0.5 + 2.0 * leg / 3.0) for leg in range(3)
)  # rad, of motor axes and platform corners


class ThreeRRR(Mechanism):
    """Three RRR legs on a platform; q_a = (q11, q21, q31), x = (X, Y, rho phi)."""

    name = "three_rrr"
    joints = (
        Coordinate("q11", "rad"),
        Coordinate("q21", "rad"),
        Coordinate("q31", "rad"),
    )
    coordinates = (
        Coordinate("x", "m"),
        Coordinate("y", "m"),
        Coordinate("rho_phi", "m"),
    )
    parameters = (
        Parameter("base_radius", "m", "of the circle of the motor axes", above=0.0),
        Parameter(
            "platform_radius", "m", "of the circle of the platform's corners", above=0.0
        ),
        Parameter(
            "rotation_radius",
            "m",
            "rho, by which the platform's angle is a length",
            above=0.0,
        ),
        *(number for name in LEGS for number in leg_parameters(name)),
        Parameter(
            "platform_mass",
            "kg",
            "of the platform, its centre of mass in its middle",
            above=0.0,
        ),
        Parameter("platform_inertia", "kg m^2", "about its middle", above=0.0),
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
            "elbow side of the legs: +1 left of the line base -> corner",
            -1.0,
            1.0,
            size=3,
        ),
    )

    def base(self, leg: int, p: Any) -> Symbol:
        """e_i (2,), m."""
        return p.base_radius * direction(ANGLES[leg])

    def elbow(self, leg: int, angle: Symbol | float, p: Any) -> Symbol:
        """P_i (2,), m, at a motor's angle."""
        return self.base(leg, p) + getattr(p, LEGS[leg]).proximal_length * direction(
            angle
        )

    def corner(self, leg: int, x: Symbol | ca.DM, p: Any) -> Symbol:
        """C_i (2,), m."""
        return x[:2] + p.platform_radius * direction(
            ANGLES[leg] + x[2] / p.rotation_radius
        )

    def closures(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """Half of |C_i - P_i|^2 - l2^2, m^2."""
        rods = [
            self.corner(leg, x, p) - self.elbow(leg, q_a[leg], p) for leg in range(3)
        ]
        return ca.vertcat(
            *(
                0.5 * (ca.sumsqr(r) - getattr(p, name).distal_length ** 2)
                for r, name in zip(rods, LEGS, strict=True)
            )
        )

    def lagrangian(
        self, q_a: Symbol, x: Symbol, q_a_dot: Symbol, x_dot: Symbol, p: Any
    ) -> Symbol:
        """Each distal rod is seen from its two ends, the elbow and the platform's
        corner.
        """
        turn = x_dot[2] / p.rotation_radius
        energy = (
            0.5 * p.platform_mass * ca.sumsqr(x_dot[:2])
            + 0.5 * p.platform_inertia * turn**2
        )
        energy += p.platform_mass * ca.dot(p.gravity, x[:2])
        for leg, name in enumerate(LEGS):
            link, P, C = (
                getattr(p, name),
                self.elbow(leg, q_a[leg], p),
                self.corner(leg, x, p),
            )
            P_dot, C_dot = ca.jtimes(P, q_a, q_a_dot), ca.jtimes(C, x, x_dot)
            energy += 0.5 * link.rotor_inertia * q_a_dot[leg] ** 2
            energy += rod(
                link.proximal_mass,
                link.proximal_center,
                link.proximal_inertia,
                link.proximal_length,
                (self.base(leg, p), P),
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

    def inverse_geometric_model(self, x: Symbol, p: Any) -> Symbol:
        """In closed form, in [-pi, pi)."""
        legs = [getattr(p, name) for name in LEGS]
        return ca.vertcat(
            *(
                two_link_angle(
                    self.corner(leg, x, p) - self.base(leg, p),
                    link.proximal_length,
                    link.distal_length,
                    p.working_mode[leg],
                )
                for leg, link in enumerate(legs)
            )
        )

    def nearest_joints(self, x: Symbol, p: Any) -> tuple[Symbol, Symbol]:
        """In closed form."""
        found = []
        for leg, name in enumerate(LEGS):
            link, reach = getattr(p, name), self.corner(leg, x, p) - self.base(leg, p)
            found.append(
                nearest_two_link_angle(
                    reach, link.proximal_length, link.distal_length, p.working_mode[leg]
                )
            )
        return ca.vertcat(*(q for q, _ in found)), ca.vertcat(
            *(extension for _, extension in found)
        )

    def direct_geometric_model(
        self, q_a: Symbol, assembly_mode: Symbol, p: Any
    ) -> None:
        """None: up to six solutions, of a polynomial of the sixth degree."""

    def linkage(self, q_a: Array, x: Array, p: Any) -> Array:
        """(16, 2) from each corner to its motor and back, along the platform's edges to
        the first again.
        """
        legs = [
            (
                self.corner(leg, ca.DM(x), p),
                self.elbow(leg, float(q_a[leg]), p),
                self.base(leg, p),
            )
            for leg in range(3)
        ]
        ways = [
            point
            for corner, elbow, base in legs
            for point in (corner, elbow, base, elbow, corner)
        ]
        return np.array([ca.DM(point).full().ravel() for point in (*ways, legs[0][0])])

    def bodies(self, p: Any) -> Bodies:
        """The first leg carries the platform by its corner, at q13; the other legs are
        pinned to it.
        """
        legs = [getattr(p, name) for name in LEGS]
        links = leg_links([self.base(leg, p) for leg in range(3)], legs, 0.0)
        tips = [ca.vertcat(leg.distal_length, 0.0) for leg in legs]
        corners = [p.platform_radius * direction(angle) for angle in ANGLES]
        platform = Link(
            "q13", 1, tips[0], p.platform_mass, -corners[0], p.platform_inertia
        )
        pins = tuple(
            Pin((6, 2 * leg + 1), (corners[leg] - corners[0], tips[leg]))
            for leg in (1, 2)
        )
        return Bodies((*links, platform), pins, p.gravity, p.coulomb_speed)

    def tree_joints(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """q11, q12, q21, q22, q31, q32, q13."""
        legs = leg_joints(
            q_a,
            [self.corner(leg, x, p) - self.elbow(leg, q_a[leg], p) for leg in range(3)],
        )
        return ca.vertcat(*legs, x[2] / p.rotation_radius - legs[0] - legs[1])

    def tree_platform(self, joints: Symbol, p: Any) -> Symbol:
        """The corner on the first leg, and from there."""
        distal = joints[0] + joints[1]
        corner = self.elbow(0, joints[0], p) + p.leg1.distal_length * direction(distal)
        turned = ca.vertcat(0.0, 0.0, p.rotation_radius * (distal + joints[6]))
        return turned + ca.vertcat(corner - self.corner(0, turned, p), 0.0)

    def singularity_scale(self, p: Any) -> Symbol:
        """The distal lengths, and the lever of a corner over rho."""
        return (
            p.leg1.distal_length
            * p.leg2.distal_length
            * p.leg3.distal_length
            * p.platform_radius
            / p.rotation_radius
        )

    def singularity_length(self, p: Any) -> Symbol:
        """Geometric mean of the distal lengths, m."""
        return (p.leg1.distal_length * p.leg2.distal_length * p.leg3.distal_length) ** (
            1.0 / 3.0
        )

    def type1_sines(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """Sines of the elbows' angles."""
        sines = []
        for leg, name in enumerate(LEGS):
            u, r = (
                direction(q_a[leg]),
                self.corner(leg, x, p) - self.elbow(leg, q_a[leg], p),
            )
            sines.append((u[0] * r[1] - u[1] * r[0]) / getattr(p, name).distal_length)
        return ca.vertcat(*sines)

    def friction(self, q_a_dot: Symbol, p: Any) -> Symbol:
        """Of the motors."""
        return friction(q_a_dot, [getattr(p, name) for name in LEGS], p.coulomb_speed)
