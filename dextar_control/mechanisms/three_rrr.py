"""The planar 3-RRR: three legs of two links carry a platform that moves and turns in
the plane.

Frame: origin in the middle of the three motor axes, which lie on a circle at 90, 210
and 330 degrees. The platform's corners C_i, the tips of the legs, lie on a circle about
its centre (X, Y), at the same angles plus phi. The third coordinate is rho phi: a
length, as the others.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from dextar_control.mechanisms.bodies import Bodies, Link, Pin
from dextar_control.mechanisms.mechanism import Constant, Coordinate, Values
from dextar_control.mechanisms.planar import (
    TwoLinkLegs,
    direction,
    leg_links,
    leg_parameters,
    plane_parameters,
)
from dextar_control.symbols.types import Array, Symbol

LEGS = ("leg1", "leg2", "leg3")
# rad, of motor axes and platform corners
ANGLES = tuple(ca.pi * (0.5 + 2.0 * leg / 3.0) for leg in range(3))


class ThreeRRR(TwoLinkLegs):
    """Three RRR legs on a platform; q_a = (q11, q21, q31), x = (X, Y, rho phi)."""

    name = "three_rrr"
    legs = LEGS
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
        Constant("base_radius", "m", "of the circle of the motor axes", above=0.0),
        Constant(
            "platform_radius", "m", "of the circle of the platform's corners", above=0.0
        ),
        Constant(
            "rotation_radius",
            "m",
            "rho, by which the platform's angle is a length",
            above=0.0,
        ),
        *(number for name in LEGS for number in leg_parameters(name)),
        Constant(
            "platform_mass",
            "kg",
            "of the platform, its centre of mass in its middle",
            above=0.0,
        ),
        Constant("platform_inertia", "kg m^2", "about its middle", above=0.0),
        *plane_parameters(3),
    )

    def base(self, leg: int, p: Values) -> Symbol:
        """Return e_i (2,), m, a motor's axis."""
        return p.base_radius * direction(ANGLES[leg])

    def tip(self, leg: int, x: Symbol | ca.DM, p: Values) -> Symbol:
        """Return C_i (2,), m, a corner of the platform."""
        return x[:2] + p.platform_radius * direction(
            ANGLES[leg] + x[2] / p.rotation_radius
        )

    def platform_lagrangian(self, x: Symbol, x_dot: Symbol, p: Values) -> Symbol:
        """Return the kinetic less potential energy, J, of the platform."""
        turn = x_dot[2] / p.rotation_radius
        kinetic = (
            0.5 * p.platform_mass * ca.sumsqr(x_dot[:2])
            + 0.5 * p.platform_inertia * turn**2
        )
        return kinetic + p.platform_mass * ca.dot(p.gravity, x[:2])

    def direct_geometric_model(
        self, q_a: Symbol, assembly_mode: Symbol, p: Values
    ) -> None:
        """None: there are up to six solutions, of a polynomial of the sixth degree."""

    def linkage(self, q_a: Array, x: Array, p: Values) -> Array:
        """Return (16, 2) points, m, from each corner to its motor and back, along the
        platform's edges to the first corner again.

        Args:
            q_a: active joints, (3,), rad.
            x: platform position, (3,), m.
            p: numbers.
        """
        points = []
        for leg in range(3):
            corner, base = self.tip(leg, ca.DM(x), p), self.base(leg, p)
            elbow = self.elbow(leg, float(q_a[leg]), p)
            points += [corner, elbow, base, elbow, corner]
        return np.array([ca.DM(point).full().ravel() for point in (*points, points[0])])

    def bodies(self, p: Values) -> Bodies:
        """Return the first leg carries the platform by its corner, at q13; the other
        legs are pinned to it.
        """
        legs = [p[name] for name in LEGS]
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

    def tree_joints(self, q_a: Symbol, x: Symbol, p: Values) -> Symbol:
        """Return angles (7,), rad, of q11, q12, q21, q22, q31, q32 and q13."""
        legs = super().tree_joints(q_a, x, p)
        return ca.vertcat(legs, x[2] / p.rotation_radius - legs[0] - legs[1])

    def tree_platform(self, joints: Symbol, p: Values) -> Symbol:
        """Return x (3,), m, by the corner on the first leg, at joints (7,), rad."""
        distal = joints[0] + joints[1]
        corner = self.elbow(0, joints[0], p) + p["leg1"].distal_length * direction(
            distal
        )
        turned = ca.vertcat(0.0, 0.0, p.rotation_radius * (distal + joints[6]))
        return turned + ca.vertcat(corner - self.tip(0, turned, p), 0.0)

    def singularity_scale(self, p: Values) -> Symbol:
        """Return the product of the distal lengths and the lever of a corner over
        rho, m^3.
        """
        first, second, third = (p[name].distal_length for name in LEGS)
        return first * second * third * p.platform_radius / p.rotation_radius

    def singularity_length(self, p: Values) -> Symbol:
        """Return the geometric mean of the distal lengths, m."""
        first, second, third = (p[name].distal_length for name in LEGS)
        return (first * second * third) ** (1.0 / 3.0)
