"""A mechanism of one's own: sliders on parallel rails, whose bars meet in one point.

Closures, Lagrangian and inverse geometric model are stated; all else follows. A slider
runs ahead of the point, one behind: with the bars in one line the robot is singular.
"""

import casadi as ca
import numpy as np
from crossing import drive

from dextar_control.mechanisms.mechanism import Constant, Coordinate, Mechanism, Values
from dextar_control.model.exact_plant import ExactPlant
from dextar_control.model.robot import Robot
from dextar_control.planning.locus import nearest_point
from dextar_control.planning.planner import plan_return_trip_through
from dextar_control.symbols.types import Symbol as S

NUMBERS = {"rails": [-0.1, 0.1], "bars": [0.2, 0.19], "bar_mass": 0.1, "tip_mass": 0.3}
LIMITS = {"max_torque": 20.0, "max_joint_speed": 3.0, "max_platform_speed": 3.0}


class Biglide(Mechanism):
    """Uniform bars from the sliders at (rails, q_a) to x, a point mass at each end."""

    name = "biglide"
    joints = Coordinate("q1", "m"), Coordinate("q2", "m")
    coordinates = Coordinate("x", "m"), Coordinate("y", "m")
    parameters = (
        Constant("rails", "m", "where they stand along x", size=2),
        Constant("bars", "m", "their lengths", above=0.0, size=2),
        *(Constant(m, "kg", "of each", above=0.0) for m in ("bar_mass", "tip_mass")),
    )

    def closures(self, q_a: S, x: S, p: Values) -> S:
        """Half of what the bars' squared lengths are off, m^2."""
        return 0.5 * ((x[0] - p.rails) ** 2 + (x[1] - q_a) ** 2 - p.bars**2)

    def lagrangian(self, q_a: S, x: S, q_a_dot: S, x_dot: S, p: Values) -> S:
        """Kinetic energy, J; that of a rod is m/6 (v1.v1 + v1.v2 + v2.v2)."""
        tips = ca.sumsqr(q_a_dot) + ca.sumsqr(x_dot)
        rods = tips + ca.sum1(q_a_dot) * x_dot[1] + ca.sumsqr(x_dot)
        return p.tip_mass / 2.0 * tips + p.bar_mass / 6.0 * rods

    def nearest_joints(self, x: S, p: Values) -> tuple[S, S]:
        """Ahead and behind by Pythagoras; the span across over each bar's length."""
        across = x[0] - p.rails
        along = ca.sqrt(ca.fmax(p.bars**2 - across**2, 1e-12))
        return x[1] + ca.vertcat(along[0], -along[1]), across / p.bars

    def singularity_scale(self, p: Values) -> S:
        """For s to be the sine of the angle between the bars."""
        return p.bars[0] * p.bars[1]


if __name__ == "__main__":
    robot = Robot.of(Biglide(), {"min_type1_distance": 0.1, **NUMBERS, **LIMITS})
    place = nearest_point(robot, np.zeros(2))
    plan = plan_return_trip_through(robot, place, +1, duration=0.3, dwell=0.1)
    drive(robot, plan, ExactPlant(robot), resolution=1e-6)
