"""The planar five-bar: two legs of two links that meet in the end effector.

Frame: that of the motor axes e_i; where only their distance is given, its origin is
midway, x towards the right one.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from dextar_control.mechanisms.bodies import Bodies, Pin
from dextar_control.mechanisms.five_bar_locus import LEAST_CHORD, SIDES, FiveBarLocus
from dextar_control.mechanisms.mechanism import Constant, Coordinate, Values
from dextar_control.mechanisms.planar import (
    circles,
    direction,
    leg_links,
    leg_parameters,
    plane_parameters,
    viscous_and_coulomb,
)
from dextar_control.symbols.types import Array, Symbol

PASSIVE = ("passive_viscous_friction", "N m s/rad"), ("passive_coulomb_friction", "N m")


class FiveBar(FiveBarLocus):
    """Two 2R legs closed at the end effector; q_a = (q11, q21), x = (x, y)."""

    name = "five_bar"
    joints = (Coordinate("q11", "rad"), Coordinate("q21", "rad"))
    coordinates = (Coordinate("x", "m"), Coordinate("y", "m"))
    parameters = (
        *(Constant(f"{side}.axis", "m", "of the motor", size=2) for side in SIDES),
        *(number for side in SIDES for number in leg_parameters(side)),
        Constant("end_effector_mass", "kg", "point mass at the end effector", 0.0),
        *plane_parameters(2),
    )

    def platform_lagrangian(self, x: Symbol, x_dot: Symbol, p: Values) -> Symbol:
        """Return the kinetic less potential energy, J, of the point mass."""
        m = p.end_effector_mass
        return 0.5 * m * ca.sumsqr(x_dot) + m * ca.dot(p.gravity, x)

    def unreached(self, x: Array, q_a: Array, p: Values) -> str:
        """Return the sentence with the distance of the first leg that does not reach.

        Args:
            x: platform position, (2,), m.
            q_a: active joints, (2,), rad, nan where there is none.
            p: numbers.
        """
        leg = int(np.argmin(np.isfinite(q_a)))
        link, base = p[SIDES[leg]], np.array(self.base(leg, p)).ravel()
        l1, l2 = float(link.proximal_length[0]), float(link.distal_length[0])
        return (
            f"point ({x[0]:.4f}, {x[1]:.4f}) m is {np.hypot(*(x - base)):.4f} m from"
            f" the {SIDES[leg]} motor axis; the leg reaches {abs(l1 - l2):.4f} to"
            f" {l1 + l2:.4f} m"
        )

    def direct_geometric_model(
        self, q_a: Symbol, assembly_mode: Symbol, p: Values
    ) -> Symbol:
        """Return x (2,), m, where the distal links' circles about the elbows meet.

        It is never on the line of the elbows itself, where the velocity would be 0/0.
        Elbows that coincide define no point: nan.
        """
        left, right = (self.elbow(leg, q_a[leg], p) for leg in range(2))
        return circles(
            left,
            p["left"].distal_length,
            right,
            p["right"].distal_length,
            assembly_mode,
            LEAST_CHORD,
        )

    def mirror_image(self, q_a: Symbol, x: Symbol, p: Values) -> Symbol:
        """Return x (2,), m, mirrored on the line of the elbows."""
        first, second = self.distal_rods(q_a, x, p)
        side = first[0] * second[1] - first[1] * second[0]  # of the sign of s
        return self.direct_geometric_model(q_a, ca.if_else(side > 0.0, -1.0, 1.0), p)

    def why_open(self, q_a: Array, p: Values) -> str:
        """Return the sentence with the distance of the elbows at joints q_a (2,), rad,
        where the distal links do not span it, else "".
        """
        left, right = (
            np.array(self.elbow(leg, float(q_a[leg]), p)).ravel() for leg in range(2)
        )
        distance = float(np.hypot(*(right - left)))
        first, second = (float(p[side].distal_length[0]) for side in SIDES)
        low, high = abs(first - second), first + second
        if low <= distance <= high and distance != 0.0:
            return ""
        return (
            f"the elbows are {distance:.6f} m apart; the distal links close {low:.6f}"
            f" to {high:.6f} m"
        )

    def folded(self, q_a: Symbol, x: Symbol, p: Values) -> Symbol:
        """Return the dot product, m^2, of the distal rods: where they point the same
        way, the image is a whole turn of them away.
        """
        return ca.dot(*self.distal_rods(q_a, x, p))

    def singularity_of_joints(self, q_a: Symbol, p: Values) -> Symbol:
        """Return the sine of the angle between the distal links, which follows from the
        distance of the elbows.
        """
        l2, r2 = p["left"].distal_length, p["right"].distal_length
        between = ca.sumsqr(self.elbow(1, q_a[1], p) - self.elbow(0, q_a[0], p))
        cosine = 0.5 * (l2**2 + r2**2 - between) / (l2 * r2)
        square = 1.0 - cosine**2
        closes = square > 0.0
        return ca.if_else(closes, ca.sqrt(ca.if_else(closes, square, 1.0)), 0.0)

    def linkage(self, q_a: Array, x: Array, p: Values) -> Array:
        """Return (5, 2) motor, elbow, end effector, elbow, motor, m, to draw.

        Args:
            q_a: active joints, (2,), rad.
            x: end effector, (2,), m.
            p: numbers.
        """
        (left, first), (right, second) = (
            (self.base(leg, p), self.elbow(leg, float(q_a[leg]), p)) for leg in range(2)
        )
        points: Array = np.array(ca.horzcat(left, first, ca.DM(x), second, right)).T
        return points

    def bodies(self, p: Values) -> Bodies:
        """Return both legs, half of the end effector's mass on each tip: pinned
        together they are one body.
        """
        legs = [p[side] for side in SIDES]
        bases = [self.base(leg, p) for leg in range(2)]
        links = leg_links(bases, legs, 0.5 * p.end_effector_mass)
        left, right = (ca.vertcat(link.distal_length, 0.0) for link in legs)
        return Bodies(
            tuple(links), (Pin((1, 3), (left, right)),), p.gravity, p.coulomb_speed
        )

    def tree_platform(self, joints: Symbol, p: Values) -> Symbol:
        """Return x (2,), m, in the middle of the tips at joints (4,), rad."""
        left, right = (
            self.elbow(leg, joints[2 * leg], p)
            + p[side].distal_length * direction(joints[2 * leg] + joints[2 * leg + 1])
            for leg, side in enumerate(SIDES)
        )
        return 0.5 * (left + right)

    def singularity_scale(self, p: Values) -> Symbol:
        """Return the product of the distal lengths, m^2: s is the sine of the angle
        between the distal links.
        """
        return p["left"].distal_length * p["right"].distal_length

    def singularity_length(self, p: Values) -> Symbol:
        """Return the geometric mean of the distal lengths, m."""
        return ca.sqrt(p["left"].distal_length * p["right"].distal_length)


class DetailedFiveBar(FiveBar):
    """The same with friction of elbows and pin and elastic transmissions, which cost
    each tick some time.
    """

    detail = (
        *(
            Constant(f"{side}.{name}", unit, "of the elbow", 0.0)
            for side in SIDES
            for name, unit in PASSIVE
        ),
        Constant("pin_viscous_friction", "N m s/rad", "between the distal links", 0.0),
        Constant("pin_coulomb_friction", "N m", "between the distal links", 0.0),
        *(
            Constant(
                f"{side}.transmission_stiffness",
                "N m/rad",
                "behind the rotor; 0 is rigid",
                0.0,
            )
            for side in SIDES
        ),
        *(
            Constant(f"{side}.transmission_damping", "N m s/rad", "beside it", 0.0)
            for side in SIDES
        ),
    )
    parameters = (*FiveBar.parameters, *detail)

    def transmission(self, p: Values) -> tuple[Symbol, Symbol, Symbol]:
        """Return (rotor inertia, kg m^2, stiffness, N m/rad, damping, N m s/rad), (2,)
        each, of the motors.
        """
        legs = [p[side] for side in SIDES]
        return (
            ca.vertcat(*(leg.rotor_inertia for leg in legs)),
            ca.vertcat(*(leg.transmission_stiffness for leg in legs)),
            ca.vertcat(*(leg.transmission_damping for leg in legs)),
        )

    def passive_friction(
        self, q_a: Symbol, x: Symbol, q_a_dot: Symbol, x_dot: Symbol, p: Values
    ) -> tuple[Symbol, Symbol]:
        """Return (rates (3,), rad/s, friction (3,), N m) of the left elbow, the right
        one and the pin.
        """
        turning = []
        for leg, side in enumerate(SIDES):
            P = self.elbow(leg, q_a[leg], p)
            r, r_dot = x - P, x_dot - ca.jtimes(P, q_a, q_a_dot)
            turning.append(
                (r[0] * r_dot[1] - r[1] * r_dot[0]) / p[side].distal_length ** 2
            )
        left, right = turning
        rates = ca.vertcat(left - q_a_dot[0], right - q_a_dot[1], right - left)
        viscous = ca.vertcat(
            *(p[side].passive_viscous_friction for side in SIDES),
            p.pin_viscous_friction,
        )
        coulomb = ca.vertcat(
            *(p[side].passive_coulomb_friction for side in SIDES),
            p.pin_coulomb_friction,
        )
        return rates, viscous_and_coulomb(rates, viscous, coulomb, p.coulomb_speed)
