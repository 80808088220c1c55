"""The robot description that plant, controller, planner and analysis share: data, no model."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dextar_control.contract.errors import ParameterError, StateError
from dextar_control.contract.yaml_text import load_parameters

PREFIX = "robot."  # of the robot's parameters in a node
JOINT_NAMES = ("q11", "q21")
SIM_JOINT_NAMES = ("q11", "q12", "q21", "q22")


def joint_positions(names: Sequence[str], positions: Sequence[float]) -> tuple[float, ...]:
    """Positions of q11 and q21, rad, by name: all that a controller uses of a joint state beside its stamp.

    Other joints, velocities and efforts may be there or not, and may be NaN. Of a name that stands there twice the first counts.

    Raises:
        StateError: a name is missing, sizes differ or a number is not finite.
    """
    missing = [name for name in JOINT_NAMES if name not in names]
    if missing:
        raise StateError(f"joint state names are {list(names)}; '{missing[0]}' is missing")
    if len(positions) != len(names):
        raise StateError(f"joint state has {len(positions)} positions for {len(names)} names")
    q_a = tuple(float(positions[names.index(name)]) for name in JOINT_NAMES)
    if not all(math.isfinite(angle) for angle in q_a):
        raise StateError(f"joint state positions are {list(q_a)}; they must be finite")
    return q_a


@dataclass(frozen=True)
class LegParameters:
    """One leg: motor, proximal link, passive elbow, distal link.

    Attributes:
        proximal_length, distal_length: link lengths in m, > 0.
        proximal_mass, distal_mass: kg, >= 0.
        proximal_center, distal_center: centre of mass as a fraction of the length
            from the link's first joint (motor, elbow), in [0, 1].
        proximal_inertia, distal_inertia: about the centre of mass, kg m^2, >= 0.
        rotor_inertia: reflected to the joint, kg m^2, >= 0.
        viscous_friction: at the active joint, N m s/rad, >= 0.
        coulomb_friction: at the active joint, N m, >= 0.
        min_angle, max_angle: range of the active joint, rad, on any turn; a whole turn or more is no bound.
    """

    proximal_length: float
    proximal_mass: float
    proximal_center: float
    proximal_inertia: float
    distal_length: float
    distal_mass: float
    distal_center: float
    distal_inertia: float
    rotor_inertia: float
    viscous_friction: float
    coulomb_friction: float
    min_angle: float
    max_angle: float


@dataclass(frozen=True)
class RobotParameters:
    """A planar five-bar: two legs (left, right) closed at the end effector.

    Attributes:
        name: of the description.
        base_distance: between the motor axes, which lie at (-+base_distance/2, 0), m.
        left, right: the legs.
        end_effector_mass: point mass at the end effector, kg.
        gravity: in the robot's plane, m/s^2, shape (2,).
        coulomb_speed: the friction torque is coulomb * tanh(q_dot / coulomb_speed), rad/s.
        working_mode: elbow side of (left, right): +1 left of the line base -> end effector, -1 right.
        max_torque: of each motor, N m.
        max_joint_speed: of each active joint, rad/s.
        max_platform_speed: of the end effector, m/s.
        min_type1_distance: least |sin| of the angle between proximal and distal link.
    """

    name: str
    base_distance: float
    left: LegParameters
    right: LegParameters
    end_effector_mass: float
    gravity: tuple[float, float]
    coulomb_speed: float
    working_mode: tuple[int, int]
    max_torque: float
    max_joint_speed: float
    max_platform_speed: float
    min_type1_distance: float

    def __post_init__(self) -> None:
        for key, value in flatten(self).items():
            _check(key, value)
        for side, leg in (("left", self.left), ("right", self.right)):
            if not leg.min_angle < leg.max_angle:
                raise ParameterError(
                    f"robot.{side}.min_angle = {leg.min_angle} with max_angle = {leg.max_angle}; it must be smaller"
                )
            if leg.proximal_inertia + leg.rotor_inertia + leg.proximal_mass * leg.proximal_center**2 <= 0.0:
                raise ParameterError(f"robot.{side}.rotor_inertia = 0 with a massless proximal link; it must be > 0")
        if self.end_effector_mass + self.left.distal_mass + self.right.distal_mass <= 0.0:
            raise ParameterError("robot.end_effector_mass = 0 with massless distal links; it must be > 0")

    @property
    def legs(self) -> tuple[LegParameters, LegParameters]:
        """(left, right)."""
        return self.left, self.right

    @property
    def sides(self) -> tuple[str, ...]:
        """Names of the legs, in the order of the active joints."""
        return "left", "right"

    @property
    def joint_range(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """(least, largest) angles of the active joints, rad."""
        return tuple(leg.min_angle for leg in self.legs), tuple(leg.max_angle for leg in self.legs)

    def replace(self, **changes: Any) -> RobotParameters:
        """A copy with dotted or plain keys changed, e.g. ``replace(**{"left.distal_mass": 0.1})``."""
        flat = flatten(self)
        for key, value in changes.items():
            if key not in flat:
                raise ParameterError(f"unknown robot parameter '{key}'")
            flat[key] = value
        return from_flat(flat)


_POSITIVE = {"base_distance", "proximal_length", "distal_length", "coulomb_speed", "max_torque",
             "max_joint_speed", "max_platform_speed"}  # fmt: skip
_FRACTION = {"proximal_center", "distal_center", "min_type1_distance"}
_FREE = {"gravity", "min_angle", "max_angle"}
_UNBOUND = {f"{side}.{bound}_angle": sign * math.pi for side in ("left", "right") for bound, sign in (("min", -1), ("max", 1))}


def _check(key: str, value: Any) -> None:
    name = key.rpartition(".")[2]
    full = f"robot.{key}"
    if name == "name":
        return
    if name == "working_mode":
        if any(side not in (-1, 1) for side in value):
            raise ParameterError(f"{full} = {list(value)}; each entry must be +1 or -1")
        return
    numbers = value if isinstance(value, (tuple, list)) else (value,)
    if not all(math.isfinite(number) for number in numbers):
        raise ParameterError(f"{full} = {value}; it must be finite")
    if name in _POSITIVE and value <= 0.0:
        raise ParameterError(f"{full} = {value}; it must be > 0")
    if name in _FRACTION and not 0.0 <= value <= 1.0:
        raise ParameterError(f"{full} = {value}; it must lie in [0, 1]")
    if name not in _FREE and name not in _POSITIVE and name not in _FRACTION and value < 0.0:
        raise ParameterError(f"{full} = {value}; it must be >= 0")


def flatten(robot: RobotParameters) -> dict[str, Any]:
    """Dotted keys (``left.distal_mass``) to values, in the order of the description."""
    flat: dict[str, Any] = {}
    for field in dataclasses.fields(robot):
        value = getattr(robot, field.name)
        if isinstance(value, LegParameters):
            flat.update({f"{field.name}.{key}": number for key, number in dataclasses.asdict(value).items()})
        else:
            flat[field.name] = value
    return flat


_LEG_KEYS = [field.name for field in dataclasses.fields(LegParameters)]
ROBOT_KEYS = [
    key
    for field in dataclasses.fields(RobotParameters)
    for key in ([f"{field.name}.{leg}" for leg in _LEG_KEYS] if field.name in ("left", "right") else [field.name])
]


def _convert(key: str, value: Any) -> Any:
    try:
        if key == "name":
            return str(value)
        if key == "working_mode":
            first, second = value
            if int(first) != first or int(second) != second:
                raise ValueError
            return (int(first), int(second))
        if key == "gravity":
            first, second = value
            return (float(first), float(second))
        if isinstance(value, bool):
            raise TypeError
        return float(value)
    except (TypeError, ValueError, OverflowError) as error:
        wanted = "two numbers" if key in ("working_mode", "gravity") else "a number"
        raise ParameterError(f"robot.{key} = {value!r}; it must be {wanted}") from error


def from_flat(flat: Mapping[str, Any]) -> RobotParameters:
    """A robot from dotted keys.

    Raises:
        ParameterError: a key is unknown or missing (a joint's range may be: then it has none), a value out of its range.
    """
    unknown = sorted(set(flat) - set(ROBOT_KEYS))
    if unknown:
        raise ParameterError(f"unknown robot parameter '{unknown[0]}'; known are: {', '.join(ROBOT_KEYS)}")
    flat = {**_UNBOUND, **flat}
    missing = [key for key in ROBOT_KEYS if key not in flat]
    if missing:
        raise ParameterError(f"robot parameter '{missing[0]}' is missing")
    values: dict[str, Any] = {key: _convert(key, flat[key]) for key in ROBOT_KEYS}
    for side in ("left", "right"):
        values[side] = LegParameters(**{key: values.pop(f"{side}.{key}") for key in _LEG_KEYS})
    return RobotParameters(**values)


def load_robot(path: str | Path) -> RobotParameters:
    """A robot from a ROS 2 parameter file (``/**: ros__parameters: robot:``).

    Raises:
        ParameterError: the file cannot be read or describes no valid robot.
    """
    values = load_parameters(path, what="robot file").get("/**", {})
    flat = {key.removeprefix(PREFIX): value for key, value in values.items() if key.startswith(PREFIX)}
    if not flat:
        found = f"'robot' is {values['robot']!r}" if "robot" in values else "no entry '/**: ros__parameters: robot:'"
        raise ParameterError(f"robot file {path}: {found}; a description such as config/dextar.yaml is wanted")
    try:
        return from_flat(flat)
    except ParameterError as error:
        raise ParameterError(f"robot file {path}: {error}") from error
