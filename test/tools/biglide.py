"""A biglide (PRRRP) with all that a mechanism may state: rails at any angle, friction,
gravity, a direct geometric model and bodies. ``examples/own_mechanism.py`` is a plain one.

No machine is meant: every number is ours, declared as such.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from dextar_control.mechanisms.bodies import GROUND, Bodies, Link, Pin
from dextar_control.mechanisms.mechanism import Constant, Coordinate, Mechanism
from dextar_control.mechanisms.planar import circles, direction, loaded_rod, rod
from dextar_control.model.robot import Robot
from dextar_control.symbols.types import Symbol

LEGS = ("left", "right")
LEAST = 1e-12  # of a length's square: a root above it has a derivative


class Biglide(Mechanism):
    """Slider i at S_i = o_i + q_i d_i on its rail, its bar from there to the platform
    point x; q_a = (q1, q2), x = (x, y).
    """

    name = "biglide"
    joints = (Coordinate("q1", "m"), Coordinate("q2", "m"))
    coordinates = (Coordinate("x", "m"), Coordinate("y", "m"))
    parameters = (
        *(
            number
            for leg in LEGS
            for number in (
                Constant(f"{leg}.rail_origin", "m", "where q is zero", size=2),
                Constant(f"{leg}.rail_angle", "rad", "of the rail", -np.pi, np.pi),
                Constant(f"{leg}.bar_length", "m", "from slider to point", above=0.0),
                Constant(f"{leg}.bar_mass", "kg", "of a uniform bar", 0.0),
                Constant(
                    f"{leg}.slider_mass", "kg", "with the motor's share", above=0.0
                ),
                Constant(f"{leg}.viscous_friction", "N s/m", "of the slider", 0.0),
            )
        ),
        Constant("point_mass", "kg", "where the bars meet", above=0.0),
        Constant("gravity", "m/s^2", "in the robot's plane", size=2),
        Constant(
            "working_mode",
            "1",
            "+1 with the slider ahead of the point along its rail, -1 behind it",
            -1.0,
            1.0,
            size=2,
        ),
    )

    def slider(self, leg: int, q: Symbol, p: Any) -> Symbol:
        """S_i (2,), m."""
        return getattr(p, LEGS[leg]).rail_origin + q * direction(
            getattr(p, LEGS[leg]).rail_angle
        )

    def closures(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """Half of |x - S_i|^2 - l^2, m^2."""
        return ca.vertcat(
            *(
                0.5
                * (
                    ca.sumsqr(x - self.slider(leg, q_a[leg], p))
                    - getattr(p, name).bar_length ** 2
                )
                for leg, name in enumerate(LEGS)
            )
        )

    def lagrangian(
        self, q_a: Symbol, x: Symbol, q_a_dot: Symbol, x_dot: Symbol, p: Any
    ) -> Symbol:
        """Point, sliders, and bars seen from their two ends."""
        energy = 0.5 * p.point_mass * ca.sumsqr(x_dot) + p.point_mass * ca.dot(
            p.gravity, x
        )
        for leg, name in enumerate(LEGS):
            link, S = getattr(p, name), self.slider(leg, q_a[leg], p)
            S_dot = q_a_dot[leg] * direction(link.rail_angle)
            energy += 0.5 * link.slider_mass * ca.sumsqr(
                S_dot
            ) + link.slider_mass * ca.dot(p.gravity, S)
            inertia = link.bar_mass * link.bar_length**2 / 12.0
            energy += rod(
                link.bar_mass,
                0.5,
                inertia,
                link.bar_length,
                (S, x),
                (S_dot, x_dot),
                p.gravity,
            )
        return energy

    def _along_and_off(self, leg: int, x: Symbol, p: Any) -> tuple[Symbol, Symbol]:
        """Of the point in the rail's frame, m."""
        d, r = (
            direction(getattr(p, LEGS[leg]).rail_angle),
            x - getattr(p, LEGS[leg]).rail_origin,
        )
        return ca.dot(r, d), d[0] * r[1] - d[1] * r[0]

    def inverse_geometric_model(self, x: Symbol, p: Any) -> Symbol:
        """The slider's way along the rail; nan where the bar is too short."""
        found = []
        for leg, name in enumerate(LEGS):
            along, off = self._along_and_off(leg, x, p)
            found.append(
                along
                + p.working_mode[leg]
                * ca.sqrt(getattr(p, name).bar_length ** 2 - off**2)
            )
        return ca.vertcat(*found)

    def nearest_joints(self, x: Symbol, p: Any) -> tuple[Symbol, Symbol]:
        """The same with its root kept above zero; a leg misses by its offset over the
        bar.
        """
        joints, extensions = [], []
        for leg, name in enumerate(LEGS):
            (along, off), length = (
                self._along_and_off(leg, x, p),
                getattr(p, name).bar_length,
            )
            joints.append(
                along
                + p.working_mode[leg] * ca.sqrt(ca.fmax(length**2 - off**2, LEAST))
            )
            extensions.append(off / length)
        return ca.vertcat(*joints), ca.vertcat(*extensions)

    def direct_geometric_model(
        self, q_a: Symbol, assembly_mode: Symbol, p: Any
    ) -> Symbol:
        """Where the bars' circles about the sliders meet."""
        left, right = (self.slider(leg, q_a[leg], p) for leg in range(2))
        return circles(
            left, p.left.bar_length, right, p.right.bar_length, assembly_mode, LEAST
        )

    def bodies(self, p: Any) -> Bodies:
        """For a simulator: sliders on their rails, bars on them, half of the point's
        mass on each bar's end.
        """
        links, ends = [], []
        for leg, name in enumerate(LEGS):
            link, zero = getattr(p, name), ca.SX.zeros(2)
            bar = loaded_rod(
                link.bar_mass,
                0.5 * link.bar_length,
                link.bar_mass * link.bar_length**2 / 12.0,
                link.bar_length,
                0.5 * p.point_mass,
            )
            links.append(
                Link(
                    f"q{leg + 1}",
                    GROUND,
                    link.rail_origin,
                    link.slider_mass,
                    zero,
                    ca.SX(0.0),
                    link.rail_angle,
                    prismatic=True,
                    viscous=link.viscous_friction,
                )
            )
            links.append(Link(f"bar{leg + 1}", 2 * leg, zero, *bar))
            ends.append(ca.vertcat(link.bar_length, 0.0))
        return Bodies(tuple(links), (Pin((1, 3), (ends[0], ends[1])),), p.gravity)

    def tree_joints(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """q1, angle of its bar to its rail, q2, that of the other."""
        bars = [x - self.slider(leg, q_a[leg], p) for leg in range(2)]
        angles = [
            ca.atan2(bar[1], bar[0]) - getattr(p, name).rail_angle
            for bar, name in zip(bars, LEGS, strict=True)
        ]
        return ca.vertcat(q_a[0], angles[0], q_a[1], angles[1])

    def tree_platform(self, joints: Symbol, p: Any) -> Symbol:
        """In the middle of the bars' ends."""
        left, right = (
            self.slider(leg, joints[2 * leg], p)
            + getattr(p, name).bar_length
            * direction(getattr(p, name).rail_angle + joints[2 * leg + 1])
            for leg, name in enumerate(LEGS)
        )
        return 0.5 * (left + right)

    def singularity_scale(self, p: Any) -> Symbol:
        """s is then the sine of the angle between the bars."""
        return p.left.bar_length * p.right.bar_length

    def singularity_length(self, p: Any) -> Symbol:
        """Geometric mean of the bars, m."""
        return (p.left.bar_length * p.right.bar_length) ** 0.5

    def type1_sines(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """Cosines of the angles between bar and rail: zero where the bar stands across
        its rail.
        """
        return ca.vertcat(
            *(
                ca.dot(
                    x - self.slider(leg, q_a[leg], p),
                    direction(getattr(p, name).rail_angle),
                )
                / getattr(p, name).bar_length
                for leg, name in enumerate(LEGS)
            )
        )

    def friction(self, q_a_dot: Symbol, p: Any) -> Symbol:
        """Viscous."""
        return ca.vertcat(*(getattr(p, leg).viscous_friction for leg in LEGS)) * q_a_dot


NUMBERS = {
    "left.rail_origin": [-0.1, 0.0],
    "left.rail_angle": 1.67,
    "left.bar_length": 0.2,
    "left.bar_mass": 0.1,
    "left.slider_mass": 0.3,
    "left.viscous_friction": 0.0,
    "right.rail_origin": [0.1, 0.0],
    "right.rail_angle": 1.52,
    "right.bar_length": 0.19,
    "right.bar_mass": 0.1,
    "right.slider_mass": 0.3,
    "right.viscous_friction": 0.0,
    "point_mass": 0.2,
    "gravity": [0.0, 0.0],
    "working_mode": [1, -1],
    "max_torque": 20.0,
    "max_joint_speed": 3.0,
    "max_platform_speed": 3.0,
    "min_type1_distance": 0.1,  # N, m/s
    "joint_min": [-0.4, -0.4],
    "joint_max": [0.4, 0.4],  # m
}
ROBOT = Robot.of(Biglide(), NUMBERS)
RESOLUTION = 1e-6  # m, of the sliders' encoders
# A slider's metres and newtons are other numbers than a motor's radians and newton metres.
SETTINGS: dict[str, Any] = {
    "observer.encoder_deviation": 2e-6,
    "observer.bias_deviation": 1e-4,
    "observer.bias_walk": 1e-4,
    "observer.torque_deviation": 0.5,
    "crossing_test.encoder_deviation": 1e-6,
    "crossing_test.torque_deviation": 0.02,
    "crossing_test.acceleration_deviation": 0.1,
    "torque_limit.min_torque": 10.0,
    "safe_stop.brake_gain": 20.0,
    "watch.max_joint_jump": 2e-3,
    "watch.max_joint_misfit": 2e-3,
    "watch.joint_margin": 5e-3,
}
