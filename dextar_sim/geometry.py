"""The simulator's own exact geometry of the five-bar's links and joints.

Angles are those of the contract's joints q11, q12, q21, q22: active joints from the x
axis of frame base, passive ones relative to their proximal link, counter-clockwise, in
rad.
"""

from __future__ import annotations

import math

from dextar_control.contract.errors import GeometryError
from dextar_control.contract.robot import LegParameters, RobotParameters
from dextar_control.symbols.types import Numbers
from dextar_sim.state import PlantState

Point = tuple[float, float]
_LEAST_SINE = 1.0e-9


def bases(robot: RobotParameters) -> tuple[Point, Point]:
    """Return the motor axes (left, right), m."""
    return robot.left.axis, robot.right.axis


def elbow(leg: LegParameters, q: float, base: Point) -> Point:
    """Return the elbow of a leg at active angle q (rad), m."""
    return base[0] + leg.proximal_length * math.cos(q), base[
        1
    ] + leg.proximal_length * math.sin(q)


def _intersection(
    first: Point, second: Point, radius_1: float, radius_2: float, side: int
) -> Point | None:
    """Return the common point of two circles left (side +1) or right (-1) of the line
    first -> second.
    """
    dx, dy = second[0] - first[0], second[1] - first[1]
    distance = math.hypot(dx, dy)
    reach = radius_1 + radius_2
    if (
        not abs(radius_1 - radius_2) <= distance <= reach
        or distance < _LEAST_SINE * reach
    ):
        return None
    along = (radius_1**2 - radius_2**2 + distance**2) / (2.0 * distance)
    across = side * math.sqrt(max(radius_1**2 - along**2, 0.0))
    ux, uy = dx / distance, dy / distance
    return first[0] + along * ux - across * uy, first[1] + along * uy + across * ux


def _distal_angle(q: float, elbow_point: Point, x: Numbers) -> float:
    """Return the angle of the distal link relative to the proximal one, in [-pi, pi],
    rad.
    """
    angle = math.atan2(x[1] - elbow_point[1], x[0] - elbow_point[0]) - q
    return math.remainder(angle, 2.0 * math.pi)


def joints_at(robot: RobotParameters, x: Numbers) -> list[float]:
    """Return the four joint angles with the end effector at x, in the robot's working
    mode.

    Args:
        robot: the description.
        x: end effector position, m, shape (2,).

    Returns:
        q11, q12, q21, q22 in rad.

    Raises:
        GeometryError: a leg does not reach x, or x lies on a motor axis.
    """
    if not all(math.isfinite(value) for value in x):
        raise GeometryError(f"end effector position {tuple(x)} m is not finite")
    joints: list[float] = []
    for side, leg, base, mode in zip(
        robot.sides, robot.legs, bases(robot), robot.working_mode, strict=True
    ):
        point = _intersection(
            base, (x[0], x[1]), leg.proximal_length, leg.distal_length, mode
        )
        if point is None:
            distance = math.hypot(x[0] - base[0], x[1] - base[1])
            least = abs(leg.proximal_length - leg.distal_length)
            raise GeometryError(
                f"end effector at ({x[0]:g}, {x[1]:g}) m is {distance:.6g} m from the"
                f" {side} motor axis; that leg reaches from {least:.6g} to"
                f" {leg.proximal_length + leg.distal_length:.6g}"
                f" m{' and not its own axis' if least == 0.0 else ''}"
            )
        q = math.atan2(point[1] - base[1], point[0] - base[0])
        joints += [q, _distal_angle(q, point, x)]
    return joints


def joints_of(robot: RobotParameters, q_a: Numbers, assembly_mode: int) -> list[float]:
    """Return the four joint angles at active angles q_a, in the given assembly mode.

    Args:
        robot: the description.
        q_a: active angles q11, q21 in rad.
        assembly_mode: sign of r_1 x r_2, r_i from elbow i to the end effector.

    Raises:
        GeometryError: the distal links do not meet, or both elbows coincide (folded: x
            is undefined).
    """
    if assembly_mode not in (-1, 1):
        raise GeometryError(f"assembly mode {assembly_mode}; it must be +1 or -1")
    left, right = (
        elbow(leg, q, base)
        for leg, q, base in zip(robot.legs, q_a, bases(robot), strict=True)
    )
    x = _intersection(
        left, right, robot.left.distal_length, robot.right.distal_length, assembly_mode
    )
    if x is None:
        raise GeometryError(
            f"at q_a = ({q_a[0]:g}, {q_a[1]:g}) rad the elbows are"
            f" {math.dist(left, right):.6g} m apart; the distal links reach at most"
            f" {robot.left.distal_length + robot.right.distal_length:.6g} m and leave"
            " the end effector undefined where the elbows coincide"
        )
    joints: list[float] = []
    for q, point in ((q_a[0], left), (q_a[1], right)):
        joints += [float(q), _distal_angle(q, point, x)]
    return joints


def joints_dot_at(
    robot: RobotParameters, joints: Numbers, x_dot: Numbers
) -> list[float]:
    """Return the four joint velocities, rad/s, with which both distal tips move at
    x_dot.

    Each leg: x_dot = l1 n_1 q_dot + l2 n_2 omega, with u along and n left of a link.
    The parts along u_2 and u_1 give q_dot = x_dot . u_2 / (l1 sin q_passive), omega =
    -x_dot . u_1 / (l2 sin q_passive).

    Args:
        robot: the description.
        joints: q11, q12, q21, q22 in rad.
        x_dot: end effector velocity, m/s, shape (2,).

    Raises:
        GeometryError: a leg is stretched or folded (Type 1) and x_dot is not zero.
    """
    if not any(x_dot):
        return [0.0] * 4
    rates: list[float] = []
    for side, leg, q, passive in zip(
        robot.sides, robot.legs, joints[::2], joints[1::2], strict=True
    ):
        sine = math.sin(passive)
        if abs(sine) < _LEAST_SINE:
            raise GeometryError(
                f"{side} leg: |sin| of its elbow angle is {abs(sine):.3g}; a velocity"
                " needs > 0"
            )
        distal = q + passive
        rate = (x_dot[0] * math.cos(distal) + x_dot[1] * math.sin(distal)) / (
            leg.proximal_length * sine
        )
        total = -(x_dot[0] * math.cos(q) + x_dot[1] * math.sin(q)) / (
            leg.distal_length * sine
        )
        rates += [rate, total - rate]
    return rates


def tip_of(robot: RobotParameters, joints: Numbers) -> Point:
    """Return the end effector, midway between both distal tips, m.

    Args:
        robot: the description.
        joints: q11, q12, q21, q22, rad.
    """
    x: list[float] = []
    y: list[float] = []
    for leg, base, q, passive in zip(
        robot.legs, bases(robot), joints[::2], joints[1::2], strict=True
    ):
        total = q + passive
        l1, l2 = leg.proximal_length, leg.distal_length
        x.append(base[0] + l1 * math.cos(q) + l2 * math.cos(total))
        y.append(base[1] + l1 * math.sin(q) + l2 * math.sin(total))
    return 0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1])


class FiveBarPlacing:
    """Puts a plant of the five-bar where it is to begin."""

    robot: RobotParameters

    def reset(self, x: Numbers, x_dot: Numbers = (0.0, 0.0)) -> PlantState:
        """Put the end effector at x in the robot's working mode, at time 0.

        Args:
            x: end effector position, (2,), m.
            x_dot: end effector velocity, (2,), m/s.

        Raises:
            GeometryError: a leg does not reach x, or cannot move at x_dot there.
            StateError: both legs are stretched or folded, which this plant excludes.
        """
        return self._begin_at(joints_at(self.robot, x), x_dot)

    def reset_joints(
        self, q_a: Numbers, assembly_mode: int, x_dot: Numbers = (0.0, 0.0)
    ) -> PlantState:
        """Put the active joints at q_a in the given assembly mode, at time 0.

        Args:
            q_a: active angles q11, q21, (2,), rad.
            assembly_mode: sign of r_1 x r_2, r_i from elbow i to the end effector.
            x_dot: end effector velocity, (2,), m/s.

        Raises:
            GeometryError: the distal links do not meet there, or the elbows coincide.
            StateError: both legs are stretched or folded, which this plant excludes.
        """
        return self._begin_at(joints_of(self.robot, q_a, assembly_mode), x_dot)

    def _begin_at(self, joints: Numbers, x_dot: Numbers) -> PlantState:
        raise NotImplementedError
