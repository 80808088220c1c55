"""Two motions uncontrollable at once: two five-bars that carry one body.

The body is pinned to the first end effector and slides, in a slot, over the second: no
further closure, so that A_r has two blocks, one a five-bar. Each has a Type 2 locus of
its own; where the robot is on both, the kernel of A_r has two dimensions. Only the
Lagrangian couples the blocks: the body's inertia takes part in both criteria. No machine
is meant: the five-bars are those of ``config/dextar.yaml``, every other number is ours,
declared as such.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from dextar_control.contract.resources import ROBOT_FILE, config_file
from dextar_control.contract.robot import flatten, load_robot
from dextar_control.mechanisms.five_bar import FiveBar
from dextar_control.mechanisms.mechanism import Constant, Coordinate, Mechanism
from dextar_control.mechanisms.planar import direction
from dextar_control.model.robot import Robot
from dextar_control.planning.locus import LocusPoint, nearest_point
from dextar_control.planning.model import planning_model
from dextar_control.symbols.types import Symbol

ARMS = ("first", "second")
FIVE_BAR = FiveBar()


class CarriedBody(Mechanism):
    """q_a of both five-bars' motors, x = (X1, Y1, X2, Y2) of their end effectors, each
    in its own five-bar's frame.
    """

    name = "carried_body"
    joints = tuple(
        Coordinate(f"{arm}.{joint.name}", joint.unit)
        for arm in ARMS
        for joint in FIVE_BAR.joints
    )
    coordinates = tuple(
        Coordinate(f"{arm}.{place.name}", place.unit)
        for arm in ARMS
        for place in FIVE_BAR.coordinates
    )
    parameters = (
        *(
            Constant(
                f"{arm}.{given.name}",
                given.unit,
                given.meaning,
                given.minimum,
                given.maximum,
                given.above,
                given.size,
            )
            for arm in ARMS
            for given in FIVE_BAR.parameters
        ),
        Constant(
            "second_origin",
            "m",
            "of the second five-bar's frame in the first one's",
            size=2,
        ),
        Constant("second_angle", "rad", "of that frame", -np.pi, np.pi),
        Constant("body_mass", "kg", "of the body", above=0.0),
        Constant(
            "body_center", "m", "its centre of mass from the pin, towards the slot"
        ),
        Constant("body_inertia", "kg m^2", "about its centre of mass", above=0.0),
    )

    def _each(self, method: str, p: Any, *arguments: Symbol) -> list[Any]:
        """What both five-bars' method answers, each to its half of the arguments."""
        return [
            getattr(FIVE_BAR, method)(
                *(argument[2 * arm : 2 * arm + 2] for argument in arguments),
                getattr(p, name),
            )
            for arm, name in enumerate(ARMS)
        ]

    def closures(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """Of both five-bars."""
        return ca.vertcat(*self._each("closures", p, q_a, x))

    def lagrangian(
        self, q_a: Symbol, x: Symbol, q_a_dot: Symbol, x_dot: Symbol, p: Any
    ) -> Symbol:
        """Of both five-bars and of the body, whose direction is that from the first end
        effector to the second.
        """
        turn = ca.horzcat(
            direction(p.second_angle), direction(p.second_angle + 0.5 * ca.pi)
        )
        along, along_dot = (
            p.second_origin + turn @ x[2:] - x[:2],
            turn @ x_dot[2:] - x_dot[:2],
        )
        distance = ca.norm_2(along)
        unit = along / distance
        rate = (unit[0] * along_dot[1] - unit[1] * along_dot[0]) / distance
        center_dot = x_dot[:2] + p.body_center * rate * ca.vertcat(-unit[1], unit[0])
        energy = (
            0.5 * p.body_mass * ca.sumsqr(center_dot) + 0.5 * p.body_inertia * rate**2
        )
        weight = p.body_mass * ca.dot(p.first.gravity, x[:2] + p.body_center * unit)
        return (
            energy + weight + sum(self._each("lagrangian", p, q_a, x, q_a_dot, x_dot))
        )

    def inverse_geometric_model(self, x: Symbol, p: Any) -> Symbol:
        """Of both five-bars."""
        return ca.vertcat(*self._each("inverse_geometric_model", p, x))

    def nearest_joints(self, x: Symbol, p: Any) -> tuple[Symbol, Symbol]:
        """Of both five-bars."""
        first, second = self._each("nearest_joints", p, x)
        return ca.vertcat(first[0], second[0]), ca.vertcat(first[1], second[1])

    def direct_geometric_model(
        self, q_a: Symbol, assembly_mode: Symbol, p: Any
    ) -> Symbol:
        """Of both five-bars, each in its assembly mode."""
        modes = ca.SX.ones(2) * assembly_mode
        return ca.vertcat(
            *(
                FIVE_BAR.direct_geometric_model(
                    q_a[2 * arm : 2 * arm + 2], modes[arm], getattr(p, name)
                )
                for arm, name in enumerate(ARMS)
            )
        )

    def mirror_image(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """Of both five-bars."""
        return ca.vertcat(*self._each("mirror_image", p, q_a, x))

    def singularity_of_joints(self, q_a: Symbol, p: Any) -> Symbol:
        """Of the five-bar that is nearer to its locus."""
        return ca.fmin(*self._each("singularity_of_joints", p, q_a))

    def singularity_scale(self, p: Any) -> Symbol:
        """Of each block."""
        return ca.vertcat(*self._each("singularity_scale", p))

    def singularity_length(self, p: Any) -> Symbol:
        """Geometric mean of the distal lengths, m."""
        first, second = self._each("singularity_length", p)
        return ca.sqrt(first * second)

    def type1_sines(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """Of both five-bars."""
        return ca.vertcat(*self._each("type1_sines", p, q_a, x))

    def friction(self, q_a_dot: Symbol, p: Any) -> Symbol:
        """Of all motors."""
        return ca.vertcat(*self._each("friction", p, q_a_dot))


DEXTAR = load_robot(config_file(ROBOT_FILE))
NUMBERS = {
    f"{arm}.{given.name}": flatten(DEXTAR)[given.name]
    for arm in ARMS
    for given in FIVE_BAR.parameters
} | {
    "second_origin": [0.25, 0.3],
    "second_angle": np.pi,  # the second five-bar stands on its head beside the first
    "body_mass": 0.2,
    "body_center": 0.12,
    "body_inertia": 1.5e-3,
    "max_torque": 0.5,
    "max_joint_speed": 40.0,
    "max_platform_speed": 3.0,
    "min_type1_distance": 0.15,
}
ROBOT = Robot.of(CarriedBody(), NUMBERS)
RESOLUTION = 2.0 * np.pi / 2**17  # rad, of the encoders


def place_of_both(near_first: list[float], near_second: list[float]) -> LocusPoint:
    """The place with each end effector on its five-bar's locus, near these places, m."""
    x = np.concatenate(
        [nearest_point(DEXTAR, np.array(near)).x for near in (near_first, near_second)]
    )
    found = planning_model(ROBOT).place(x)
    return LocusPoint(
        x,
        ROBOT.working_mode,
        None,
        found.t_s,
        found.gradient,
        float(found.type1[0]),
        1,
        0.0,
    )
