"""Plant, controller, planner and analysis share the robot description:
data, no model.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, TypeVar, get_type_hints

from dextar_control.contract.errors import ParameterError, StateError
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.yaml_text import dump_document, load_parameters

Described = TypeVar("Described")
PREFIX = "robot."  # of the robot's parameters in a node
JOINT_NAMES = ("q11", "q21")
SIM_JOINT_NAMES = ("q11", "q12", "q21", "q22")


def joint_positions(
    names: Sequence[str], positions: Sequence[float]
) -> tuple[float, ...]:
    """Return the positions of q11 and q21, rad, by name: all that a controller uses of
    a joint state beside its stamp.

    Other joints, velocities and efforts may be there or not, and may be NaN. Where a
    name stands there twice the first one counts.

    Args:
        names: of the joints, in the message's order.
        positions: of these joints, rad.

    Raises:
        StateError: a name is missing, sizes differ or a number is not finite.
    """
    missing = [name for name in JOINT_NAMES if name not in names]
    if missing:
        raise StateError(
            f"joint state names are {list(names)}; '{missing[0]}' is missing"
        )
    if len(positions) != len(names):
        raise StateError(
            f"joint state has {len(positions)} positions for {len(names)} names"
        )
    q_a = tuple(float(positions[names.index(name)]) for name in JOINT_NAMES)
    if not all(math.isfinite(angle) for angle in q_a):
        raise StateError(f"joint state positions are {list(q_a)}; they must be finite")
    return q_a


@dataclass(frozen=True)
class LegParameters:
    """One leg: motor, proximal link, passive elbow, distal link. Each field says what
    it is, for ``ROBOT_KEYS``.
    """

    axis: Annotated[
        tuple[float, float],
        "The {side} motor's axis stands at this point (x, y) of the robot's frame (m).",
    ]
    proximal_length: Annotated[
        float, "The {side} proximal link has this length (m, > 0)."
    ]
    proximal_mass: Annotated[
        float, "The {side} proximal link has this mass (kg, >= 0)."
    ]
    proximal_center: Annotated[
        float,
        "The {side} proximal link's mass centre is at this fraction of its length from"
        " the motor.",
    ]
    proximal_inertia: Annotated[
        float,
        "The {side} proximal link has this inertia about its centre of mass (kg m^2,"
        " >= 0).",
    ]
    distal_length: Annotated[float, "The {side} distal link has this length (m, > 0)."]
    distal_mass: Annotated[float, "The {side} distal link has this mass (kg, >= 0)."]
    distal_center: Annotated[
        float,
        "The {side} distal link's mass centre is at this fraction of its length from"
        " the elbow.",
    ]
    distal_inertia: Annotated[
        float,
        "The {side} distal link has this inertia about its centre of mass (kg m^2,"
        " >= 0).",
    ]
    rotor_inertia: Annotated[
        float,
        "The {side} motor's rotor has this inertia, reflected to the joint (kg m^2,"
        " >= 0).",
    ]
    viscous_friction: Annotated[
        float, "The {side} active joint has this viscous friction (N m s/rad, >= 0)."
    ]
    coulomb_friction: Annotated[
        float, "The {side} active joint has this Coulomb friction (N m, >= 0)."
    ]
    min_angle: Annotated[
        float,
        "The {side} active joint's range begins at this angle (rad); a whole turn is no"
        " bound.",
    ] = -math.pi
    max_angle: Annotated[
        float,
        "The {side} active joint's range ends at this angle (rad); a whole turn is no"
        " bound.",
    ] = math.pi
    encoder_offset: Annotated[
        float,
        "The {side} encoder reads this where the active joint is at zero (rad, -pi to"
        " pi).",
    ] = 0.0
    transmission_stiffness: Annotated[
        float,
        "The {side} transmission to the link has this stiffness (N m/rad); 0 is rigid.",
    ] = 0.0
    transmission_damping: Annotated[
        float, "The {side} transmission to the link has this damping (N m s/rad, >= 0)."
    ] = 0.0
    passive_viscous_friction: Annotated[
        float, "The {side} elbow has this viscous friction (N m s/rad, >= 0)."
    ] = 0.0
    passive_coulomb_friction: Annotated[
        float, "The {side} elbow has this Coulomb friction (N m, >= 0)."
    ] = 0.0


@dataclass(frozen=True, kw_only=True)
class RobotParameters:
    """A planar five-bar: two legs (left, right) closed at the end effector."""

    name: Annotated[str, "The robot's description has this name."]
    left: LegParameters
    right: LegParameters
    end_effector_mass: Annotated[
        float, "The end effector carries this point mass (kg, >= 0)."
    ]
    pin_viscous_friction: Annotated[
        float,
        "The pin between the distal links has this viscous friction (N m s/rad, >= 0).",
    ] = 0.0
    pin_coulomb_friction: Annotated[
        float, "The pin between the distal links has this Coulomb friction (N m, >= 0)."
    ] = 0.0
    gravity: Annotated[
        tuple[float, float],
        "Gravity has these components in the robot's plane (m/s^2), 9.81 sin(tilt) in"
        " all.",
    ]
    coulomb_speed: Annotated[
        float,
        "Coulomb friction changes sign as tanh(joint speed / this speed) (rad/s, > 0).",
    ]
    working_mode: Annotated[
        tuple[int, int],
        "Each elbow lies left (+1) or right (-1) of its line base -> end effector.",
    ]
    max_torque: Annotated[float, "Each motor gives at most this torque (N m, > 0)."]
    max_joint_speed: Annotated[
        float, "Each active joint may turn at most this fast (rad/s, > 0)."
    ]
    max_platform_speed: Annotated[
        float, "The end effector may move at most this fast (m/s, > 0)."
    ]
    min_type1_distance: Annotated[
        float, "The angle between proximal and distal link keeps at least this |sin|."
    ]

    def __post_init__(self) -> None:
        for key, value in flatten(self).items():
            _check(key, value)
        for side, leg in (("left", self.left), ("right", self.right)):
            if not leg.min_angle < leg.max_angle:
                raise ParameterError(
                    f"robot.{side}.min_angle = {leg.min_angle} with max_angle ="
                    f" {leg.max_angle}; it must be smaller"
                )
            if leg.transmission_damping and not leg.transmission_stiffness:
                raise ParameterError(
                    f"robot.{side}.transmission_damping = {leg.transmission_damping}"
                    " without a transmission_stiffness, which makes it rigid: give the"
                    " stiffness too, or leave the damping out"
                )
            if (
                leg.proximal_inertia
                + leg.rotor_inertia
                + leg.proximal_mass * leg.proximal_center**2
                <= 0.0
            ):
                raise ParameterError(
                    f"robot.{side}.rotor_inertia = 0 with a massless proximal link; it"
                    " must be > 0"
                )
        if self.base_distance <= 0.0:
            raise ParameterError(
                f"robot.left.axis = {self.left.axis} is that of the right motor too;"
                " they must differ"
            )
        sides = {
            f"{side}.{name}": float(getattr(leg, name))
            for side, leg in (("left", self.left), ("right", self.right))
            for name in ("proximal_length", "distal_length")
        }
        longest = max(sides, key=sides.__getitem__)
        others = sum(sides.values()) - sides[longest] + self.base_distance
        if sides[longest] >= others:
            raise ParameterError(
                f"robot.{longest} = {sides[longest]:g}; the other links and the base"
                f" are {others:g} m long together, so that the linkage cannot close"
            )
        if (
            self.end_effector_mass + self.left.distal_mass + self.right.distal_mass
            <= 0.0
        ):
            raise ParameterError(
                "robot.end_effector_mass = 0 with massless distal links; it must be > 0"
            )

    @property
    def legs(self) -> tuple[LegParameters, LegParameters]:
        """The left leg, then the right one."""
        return self.left, self.right

    @property
    def base_distance(self) -> float:
        """The distance between the motor axes, m."""
        return math.dist(self.left.axis, self.right.axis)

    @property
    def encoder_offset(self) -> tuple[float, float]:
        """The offsets of both encoders, (2,), rad: an encoder's reading less its offset
        is the joint's angle.
        """
        return self.left.encoder_offset, self.right.encoder_offset

    @property
    def sides(self) -> tuple[str, ...]:
        """The legs' names, in the order of the active joints."""
        return "left", "right"

    @property
    def joint_range(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The least and the largest angles of the active joints, (2,) each, rad."""
        return tuple(leg.min_angle for leg in self.legs), tuple(
            leg.max_angle for leg in self.legs
        )

    def replace(self, **changes: ParameterValue) -> RobotParameters:
        """Return a copy with dotted or plain keys changed, e.g.
        ``replace(**{"left.distal_mass": 0.1})``; see ``changed``.

        Raises:
            ParameterError: as ``from_flat``.
        """
        return from_flat(changed(flatten(self), changes))


_RULES: dict[str, tuple[str, Callable[[float], bool]]] = {
    **dict.fromkeys(
        (
            "proximal_length",
            "distal_length",
            "coulomb_speed",
            "max_torque",
            "max_joint_speed",
            "max_platform_speed",
        ),
        ("be > 0", lambda value: value > 0.0),
    ),
    **dict.fromkeys(
        ("proximal_center", "distal_center", "min_type1_distance"),
        ("lie in [0, 1]", lambda value: 0.0 <= value <= 1.0),
    ),
    **dict.fromkeys(
        ("axis", "gravity", "min_angle", "max_angle"), ("be finite", lambda _: True)
    ),
    "encoder_offset": ("lie in [-pi, pi]", lambda value: abs(value) <= math.pi),
}
_NOT_NEGATIVE = "be >= 0", lambda value: value >= 0.0
_PAIRS = ("working_mode", "gravity", "left.axis", "right.axis")
_AXES = ("left.axis", "right.axis")
_SAME_LENGTH = 1e-9  # m
_MOST = {
    "base_distance": 10.0,
    "axis": 10.0,
    "proximal_length": 10.0,
    "distal_length": 10.0,
    "proximal_mass": 100.0,
    "distal_mass": 100.0,
    "end_effector_mass": 100.0,
    "proximal_inertia": 100.0,
    "distal_inertia": 100.0,
    "rotor_inertia": 100.0,
    "gravity": 10.0,
    "min_angle": 4.0 * math.pi,
    "max_angle": 4.0 * math.pi,
}  # in SI units, either way: what is larger was meant in mm, g, g mm^2 or degrees


def _check(key: str, value: ParameterValue) -> None:
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
    if name in _MOST and max(map(abs, numbers)) > _MOST[name]:
        raise ParameterError(
            f"{full} = {value}; {_MOST[name]:g} is the most, in SI units (m, kg, kg"
            " m^2, m/s^2, rad)"
        )
    wanted, fits = _RULES.get(name, _NOT_NEGATIVE)
    if not fits(value):
        raise ParameterError(f"{full} = {value}; it must {wanted}")


def flatten(robot: RobotParameters) -> dict[str, ParameterValue]:
    """Return the values by dotted keys (``left.distal_mass``), in the order of the
    description.
    """
    flat: dict[str, ParameterValue] = {
        "name": robot.name,
        "base_distance": robot.base_distance,
    }
    for field in dataclasses.fields(robot):
        value = getattr(robot, field.name)
        if isinstance(value, LegParameters):
            flat.update(
                {
                    f"{field.name}.{key}": number
                    for key, number in dataclasses.asdict(value).items()
                }
            )
        else:
            flat[field.name] = value
    return flat


def _sentences(kind: type) -> dict[str, str]:
    hints = get_type_hints(kind, include_extras=True).items()
    return {
        name: hint.__metadata__[0]
        for name, hint in hints
        if hasattr(hint, "__metadata__")
    }


_LEG_KEYS = _sentences(LegParameters)
ROBOT_KEYS = {
    "name": _sentences(RobotParameters)["name"],
    "base_distance": (
        "The motors' axes are this far apart (m, > 0); a description may give it"
        " instead of both axes."
    ),
    **{
        f"{side}.{key}": text.format(side=side)
        for side in ("left", "right")
        for key, text in _LEG_KEYS.items()
    },
} | _sentences(RobotParameters)
"""Dotted keys of a description, in its order, and what each is in a sentence."""
_UNSAID = {
    f"{prefix}{field.name}": field.default
    for prefix, kind in (
        ("left.", LegParameters),
        ("right.", LegParameters),
        ("", RobotParameters),
    )
    for field in dataclasses.fields(kind)
    if field.default is not dataclasses.MISSING
}  # what a description need not say: no range, offset, compliance or passive friction


def _convert(key: str, value: ParameterValue) -> ParameterValue:
    try:
        if key == "name":
            return str(value)
        if key == "working_mode":
            first, second = value
            if int(first) != first or int(second) != second:
                raise ValueError
            return (int(first), int(second))
        if key in _PAIRS:
            first, second = value
            return (float(first), float(second))
        if isinstance(value, bool):
            raise TypeError
        return float(value)
    except (TypeError, ValueError, OverflowError) as error:
        wanted = "two numbers" if key in _PAIRS else "a number"
        raise ParameterError(f"robot.{key} = {value!r}; it must be {wanted}") from error


def changed(
    flat: Mapping[str, ParameterValue], changes: Mapping[str, ParameterValue]
) -> dict[str, ParameterValue]:
    """Return dotted keys with some changed.

    A new base_distance moves both axes to its ends, unless they are given too; where
    both axes are given base_distance is theirs.
    """
    merged = {**flat, **changes}
    if "base_distance" in changes:
        merged = {
            key: value
            for key, value in merged.items()
            if key not in _AXES or key in changes
        }
    elif all(key in merged for key in _AXES):
        merged.pop("base_distance", None)
    return merged


def _with_axes(flat: Mapping[str, ParameterValue]) -> dict[str, ParameterValue]:
    """Return the keys with both motor axes; one that is not given lies at
    (-+base_distance/2, 0).
    """
    found = dict(flat)
    if "base_distance" not in found:
        return found
    distance = _convert("base_distance", found.pop("base_distance"))
    if not (distance > 0.0 and math.isfinite(distance)):
        raise ParameterError(f"robot.base_distance = {distance}; it must be > 0")
    if all(key in found for key in _AXES):
        between = math.dist(*(_convert(key, found[key]) for key in _AXES))
        if not abs(between - distance) <= _SAME_LENGTH:
            raise ParameterError(
                f"robot.base_distance = {distance} with motor axes {between:.9g} m"
                " apart; leave out base_distance or the axes"
            )
    ends = {
        key: (sign * distance, 0.0)
        for key, sign in zip(_AXES, (-0.5, 0.5), strict=True)
    }
    return ends | found


def from_flat(flat: Mapping[str, ParameterValue]) -> RobotParameters:
    """Return a robot from dotted keys.

    Raises:
        ParameterError: a key is unknown or missing (base_distance serves for the
            motors' axes; ``_UNSAID`` lists what need not be there), or a value is out
            of its range.
    """
    unknown = sorted(set(flat) - set(ROBOT_KEYS))
    if unknown:
        close = get_close_matches(unknown[0], ROBOT_KEYS, n=1)
        raise ParameterError(
            f"unknown robot parameter '{unknown[0]}'; "
            + (
                f"did you mean '{close[0]}'?"
                if close
                else f"known are: {', '.join(ROBOT_KEYS)}"
            )
        )
    flat = {**_UNSAID, **_with_axes(flat)}
    wanted = [key for key in ROBOT_KEYS if key != "base_distance"]
    missing = [
        "base_distance" if key in _AXES else key for key in wanted if key not in flat
    ]
    if missing:
        names = list(dict.fromkeys(missing))
        told = (
            f" '{names[0]}' is"
            if len(names) == 1
            else f"s {', '.join(map(repr, names))} are"
        )
        raise ParameterError(f"robot parameter{told} missing")
    values: dict[str, ParameterValue] = {
        key: _convert(key, flat[key]) for key in wanted
    }
    for side in ("left", "right"):
        values[side] = LegParameters(
            **{key: values.pop(f"{side}.{key}") for key in _LEG_KEYS}
        )
    return RobotParameters(**values)


def load_robot(path: str | Path) -> RobotParameters:
    """Return the robot that a ROS 2 parameter file describes (``/**: ros__parameters:
    robot:``).

    Raises:
        ParameterError: the file cannot be read or describes no valid robot.
    """
    return robot_in(path, from_flat)


def robot_in(
    path: str | Path, make: Callable[[dict[str, ParameterValue]], Described]
) -> Described:
    """Return what is made of the robot's dotted keys in a ROS 2 parameter file.

    Args:
        path: of the file.
        make: takes the keys; what it refuses is told with the file.

    Raises:
        ParameterError: the file cannot be read or has no robot, or ``make`` refuses it.
    """
    values = load_parameters(path, what="robot file").get("/**", {})
    flat = {
        key.removeprefix(PREFIX): value
        for key, value in values.items()
        if key.startswith(PREFIX)
    }
    try:
        if not flat:
            found = (
                f"'robot' is {values['robot']!r}"
                if "robot" in values
                else "no entry '/**: ros__parameters: robot:'"
            )
            raise ParameterError(
                f"{found}; a description such as config/dextar.yaml is wanted"
            )
        return make(flat)
    except ParameterError as error:
        raise ParameterError(f"robot file {path}: {error}") from error


def robot_text(flat: Mapping[str, ParameterValue]) -> str:
    """Return a robot's dotted keys as the ROS 2 parameter file that ``load_robot``
    reads.
    """
    nested: dict[str, ParameterValue] = {}
    for name, value in flat.items():
        *groups, last = name.split(".")
        place = nested
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = list(value) if isinstance(value, tuple) else value
    return dump_document({"/**": {"ros__parameters": {"robot": nested}}})
