"""A robot of any mechanism: its numbers and limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.robot import RobotParameters, robot_in
from dextar_control.mechanisms import mechanism_named
from dextar_control.mechanisms.mechanism import Constant, Mechanism

LIMITS = (
    Constant(
        "max_torque", "N m (N of a prismatic joint)", "of each active joint", above=0.0
    ),
    Constant(
        "max_joint_speed",
        "rad/s (m/s of a prismatic joint)",
        "of each active joint",
        above=0.0,
    ),
    Constant(
        "max_platform_speed",
        "m/s",
        "of the platform, all coordinates together",
        above=0.0,
    ),
    Constant("min_type1_distance", "1", "least distance of a leg to Type 1", 0.0, 1.0),
)


@dataclass(frozen=True)
class Robot:
    """A mechanism with its numbers and limits, as ``RobotParameters`` is the five-bar.

    Attributes:
        mechanism: the equations.
        items: the mechanism's numbers by their dotted names, lists as tuples.
        max_torque: of each active joint, N m (N).
        max_joint_speed: of each active joint, rad/s (m/s).
        max_platform_speed: of all coordinates together, m/s.
        min_type1_distance: that each leg keeps.
        joint_range: (least, largest) positions of the active joints; a whole turn is no
            bound.
    """

    mechanism: Mechanism
    items: tuple[tuple[str, object], ...]
    max_torque: float
    max_joint_speed: float
    max_platform_speed: float
    min_type1_distance: float
    joint_range: tuple[tuple[float, ...], tuple[float, ...]]

    @classmethod
    def of(cls, mechanism: Mechanism, values: Mapping[str, object]) -> Robot:
        """Return the robot of values by dotted names: the mechanism's parameters,
        LIMITS, and where the joints have bounds ``joint_min`` and ``joint_max``.

        Raises:
            ParameterError: a number is missing or out of its bounds, or unknown.
        """
        mechanism.values(values)
        known = {
            "name",
            "mechanism",
            "joint_min",
            "joint_max",
            *(number.name for number in (*LIMITS, *mechanism.parameters)),
        }
        if unknown := sorted({*values} - known):
            raise ParameterError(
                f"unknown robot parameter '{unknown[0]}' of the mechanism"
                f" {mechanism.name}"
            )
        missing = [limit.name for limit in LIMITS if limit.name not in values]
        if missing:
            raise ParameterError(
                f"robot parameter '{missing[0]}' of the mechanism {mechanism.name} is"
                " missing"
            )
        limits = {limit.name: limit.check(values[limit.name])[0] for limit in LIMITS}
        low, high = (
            tuple(
                Constant(name, "rad or m", "of the joints", size=mechanism.n).check(
                    values.get(name, [bound] * mechanism.n)
                )
            )
            for name, bound in (("joint_min", -math.pi), ("joint_max", math.pi))
        )
        for joint, least, largest in zip(mechanism.joints, low, high, strict=True):
            if not least < largest:
                raise ParameterError(
                    f"robot.joint_min = {least} with joint_max = {largest} of"
                    f" {joint.name}; it must be smaller"
                )
        given = {number.name: values[number.name] for number in mechanism.parameters}
        items = tuple(
            (name, tuple(value) if isinstance(value, list) else value)
            for name, value in given.items()
        )
        return cls(mechanism, items, **limits, joint_range=(low, high))

    @property
    def numbers(self) -> dict[str, object]:
        """The mechanism's parameters by their dotted names."""
        return dict(self.items)

    @property
    def sides(self) -> tuple[str, ...]:
        """Names of the active joints."""
        return tuple(joint.name for joint in self.mechanism.joints)

    @property
    def encoder_offset(self) -> tuple[float, ...]:
        """The offsets of the active joints, rad (m): none."""
        return (0.0,) * self.mechanism.n

    @property
    def working_mode(self) -> tuple[int, ...]:
        """The working mode of the legs, where the mechanism has such a parameter."""
        return tuple(
            int(side)
            for side in cast("tuple[float, ...]", self.numbers.get("working_mode", ()))
        )

    def replace(self, **changes: object) -> Robot:
        """Return a copy with numbers or limits changed, by their dotted names."""
        low, high = self.joint_range
        now = (
            self.numbers
            | {limit.name: getattr(self, limit.name) for limit in LIMITS}
            | {"joint_min": low, "joint_max": high}
        )
        unknown = sorted(set(changes) - set(now))
        if unknown:
            raise ParameterError(
                f"unknown robot parameter '{unknown[0]}'; known are: {', '.join(now)}"
            )
        return Robot.of(self.mechanism, now | changes)


AnyRobot = RobotParameters | Robot


def load_any_robot(path: str | Path) -> Robot:
    """Return the robot of a ROS 2 parameter file that names its mechanism, such as
    ``config/three_rrr.yaml``.

    Raises:
        ParameterError: the file cannot be read, names no mechanism that there is, or a
            number is missing or out of its bounds.
    """

    def make(flat: dict[str, ParameterValue]) -> Robot:
        if "mechanism" not in flat:
            raise ParameterError("robot.mechanism is missing; it names the mechanism")
        return Robot.of(mechanism_named(flat["mechanism"]), flat)

    return robot_in(path, make)
