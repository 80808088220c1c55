"""Effects of drives, transmissions and friction that act at the joints of a simulated
five-bar over one substep, on symbols.

Drive, transmission and friction are torques at the joints that hold over a substep.
Angles are taken half a substep ahead and rates at its begin, which is the leapfrog: a
spring keeps its energy as long as its frequency times the substep is below 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.robot import LegParameters, RobotParameters
from dextar_control.symbols.functions import (
    Fast,
    Library,
    cache_folder,
    in_place,
    named,
)
from dextar_control.symbols.types import Array, Numbers
from dextar_sim.drive import DRIVE, MEMORY, drive_step
from dextar_sim.friction import ELEMENTS, bristle_of, friction_torque
from dextar_sim.sensors import check_nonnegative
from dextar_sim.state import Motor, check_steps, proximal_inertia

FRICTIONS = "stick", "smooth"
ENCODERS = "motor", "link"
# N m/rad of the teeth where there is backlash and no other compliance is told.
GEAR_STIFFNESS = 1000.0
GEAR_DAMPING_RATIO = 0.1
# Frequency of a transmission times the substep, up to which it is followed.
FASTEST = 1.0


@dataclass(frozen=True)
class Effects:
    """Describes the drives beyond what the robot's description says, the same at each
    motor.

    Each field is the plant's parameter of its name, with its meaning and unit; see
    ``contract.node_parameters.PLANT``.
    """

    friction: str = "stick"
    encoder_at: str = "motor"
    backlash: float = 0.0
    cogging: float = 0.0
    cogging_periods: int = 24
    drive_lag: float = 0.0
    torque_step: float = 0.0

    def __post_init__(self) -> None:
        for name, known in (("friction", FRICTIONS), ("encoder_at", ENCODERS)):
            if getattr(self, name) not in known:
                raise ParameterError(
                    f"{name} = {getattr(self, name)!r}; it must be one of"
                    f" {', '.join(known)}"
                )
        numbers = {
            field.name: value
            for field in fields(self)
            if not isinstance(value := getattr(self, field.name), str)
        }
        check_nonnegative(**numbers)

    @property
    def of_drive(self) -> bool:
        """Whether a drive does more than pass on its torque."""
        return any((self.backlash, self.cogging, self.drive_lag, self.torque_step))


NO_EFFECTS = Effects()


class Compliance(NamedTuple):
    """The compliance of a leg's transmission: N m/rad and N m s/rad; 0 is rigid."""

    stiffness: float
    damping: float


def compliance(leg: LegParameters, effects: Effects) -> Compliance:
    """Return a leg's compliance: the description's, or that of teeth with backlash.

    Raises:
        ParameterError: a compliant transmission moves no rotor.
    """
    if not leg.transmission_stiffness and not effects.backlash:
        return Compliance(0.0, 0.0)
    if not leg.rotor_inertia:
        raise ParameterError(
            "rotor_inertia = 0 with a compliant transmission or backlash; it must be >"
            " 0: what turns behind it"
        )
    if not proximal_inertia(leg) > leg.rotor_inertia:
        raise ParameterError(
            "a massless proximal link behind a compliant transmission or backlash;"
            " proximal_inertia must be > 0"
        )
    if leg.transmission_stiffness:
        return Compliance(leg.transmission_stiffness, leg.transmission_damping)
    return Compliance(
        GEAR_STIFFNESS,
        2.0 * GEAR_DAMPING_RATIO * math.sqrt(GEAR_STIFFNESS * leg.rotor_inertia),
    )


def without_rotors(robot: RobotParameters, effects: Effects) -> RobotParameters:
    """Return the robot's links alone: without the rotors behind a compliant
    transmission, which turn by themselves, and without motor friction, which acts from
    outside.
    """
    changes: dict[str, float] = {}
    for side, leg in zip(robot.sides, robot.legs, strict=True):
        changes |= {f"{side}.viscous_friction": 0.0, f"{side}.coulomb_friction": 0.0}
        if compliance(leg, effects).stiffness:
            changes[f"{side}.rotor_inertia"] = 0.0
    return robot.replace(**changes)


def has_joint_effects(robot: RobotParameters, effects: Effects) -> bool:
    """Tell whether more acts at the joints than constant torques and smooth friction of
    the motors.
    """
    passive = [robot.pin_viscous_friction, robot.pin_coulomb_friction]
    for leg in robot.legs:
        passive += [
            leg.passive_viscous_friction,
            leg.passive_coulomb_friction,
            leg.transmission_stiffness,
        ]
        passive += [leg.coulomb_friction] if effects.friction == "stick" else []
    return effects.of_drive or any(passive)


class FrictionElement(NamedTuple):
    """A place where two bodies rub; a sum of joint rates turns between them.

    Attributes:
        name: of the place.
        row: of each joint in that sum.
        viscous, coulomb: N m s/rad, N m.
        inertia: kg m^2, not above what any motion there moves.
    """

    name: str
    row: tuple[float, ...]
    viscous: float
    coulomb: float
    inertia: float


def friction_elements(
    robot: RobotParameters, effects: Effects
) -> list[FrictionElement]:
    """List those of the motors, the elbows and the pin that have friction.

    The least inertia is that of the two bodies turning freely against each other.
    """

    def between(one: float, other: float) -> float:
        return one * other / (one + other) if one + other > 0.0 else 0.0

    found, links = [], without_rotors(robot, effects).legs
    for i, (side, leg, link) in enumerate(
        zip(robot.sides, robot.legs, links, strict=True)
    ):
        alone = proximal_inertia(link)
        row = [0.0] * 4
        row[2 * i] = 1.0
        found.append(
            FrictionElement(
                f"{side} joint",
                tuple(row),
                leg.viscous_friction,
                leg.coulomb_friction,
                alone,
            )
        )
        row = [0.0] * 4
        row[2 * i + 1] = 1.0
        found.append(
            FrictionElement(
                f"{side} elbow",
                tuple(row),
                leg.passive_viscous_friction,
                leg.passive_coulomb_friction,
                between(alone, leg.distal_inertia),
            )
        )
    turns = between(robot.left.distal_inertia, robot.right.distal_inertia)
    found.append(
        FrictionElement(
            "pin",
            (-1.0, -1.0, 1.0, 1.0),
            robot.pin_viscous_friction,
            robot.pin_coulomb_friction,
            turns,
        )
    )
    return [each for each in found if each.viscous or each.coulomb]


@lru_cache
def acting(places: int) -> Library:
    """Return ``act``: the torques at the joints of a five-bar over one substep, and the
    memory that they leave behind.

    Args:
        places: that rub.
    """
    (memory_vector, memory), (drive_vector, drive) = MEMORY.symbols(), DRIVE.symbols()
    joints = ca.SX.sym("joints", 4)
    joints_dot = ca.SX.sym("joints_dot", 4)
    command = ca.SX.sym("command", 2)
    rows = ca.SX.sym("rows", 4 * places)
    element = ca.SX.sym("elements", places * len(ELEMENTS))
    bristles, h, lead = ca.SX.sym("bristles", places), ca.SX.sym("h"), ca.SX.sym("lead")
    held = joints + lead * joints_dot
    torque, after = drive_step(
        command, held[[0, 2]], joints_dot[[0, 2]], memory, drive, h
    )
    forces = ca.vertcat(torque[0], 0.0, torque[1], 0.0)
    bent = bristles
    if places:
        against = ca.reshape(rows, 4, places)
        numbers = dict(
            zip(
                ELEMENTS,
                ca.horzsplit(ca.reshape(element, places, len(ELEMENTS))),
                strict=True,
            )
        )
        rubbed, bent = friction_torque(against.T @ joints_dot, bristles, numbers, h)
        forces -= against @ rubbed
    given = {
        "joints": joints,
        "joints_dot": joints_dot,
        "command": command,
        "memory": memory_vector,
        "bristles": bristles,
        "drive": drive_vector,
        "rows": rows,
        "elements": element,
        "h": h,
        "lead": lead,
    }
    results = {
        "forces": forces,
        "memory_next": MEMORY.join(after),
        "bristles_next": bent,
    }
    return Library([in_place(named("act", given, results))], cache_folder())


class JointEffects:
    """Computes all effects at the joints of one five-bar, and keeps their memory from
    substep to substep.

    Args:
        robot: the whole description.
        effects: what that does not say.
        period: s.
        substeps: in one period.
        ahead: the angles come half a substep ahead already.

    Attributes:
        forces: (4,) at q11, q12, q21, q22, after ``act``, N m.

    Raises:
        ParameterError: friction or a transmission is too quick for the substep.
    """

    def __init__(
        self,
        robot: RobotParameters,
        effects: Effects,
        period: float,
        substeps: int,
        *,
        ahead: bool,
    ) -> None:
        check_steps(period, substeps, [])
        self._h = h = period / substeps
        found = friction_elements(robot, effects)
        transmissions = [compliance(leg, effects) for leg in robot.legs]
        _check_transmissions(robot, effects, period, substeps)
        check_steps(period, substeps, [_motor(each, robot, effects) for each in found])
        library, count = acting(len(found)), len(found)
        stick = effects.friction == "stick"
        elements = np.array(
            [
                [each.viscous for each in found],
                [each.coulomb for each in found],
                *np.array(
                    [
                        bristle_of(each.inertia, h) if stick else (0.0, 0.0)
                        for each in found
                    ]
                )
                .reshape(count, 2)
                .T,
                [robot.coulomb_speed] * count,
            ]
        )
        drive = DRIVE.make()
        drive.stiffness, drive.damping = np.array(transmissions).T
        drive.inertia = [leg.rotor_inertia or 1.0 for leg in robot.legs]
        for name in (
            "backlash",
            "cogging",
            "cogging_periods",
            "drive_lag",
            "torque_step",
        ):
            setattr(drive, name, float(getattr(effects, name)))
        self._memory, self._bristles = MEMORY.make(), np.zeros(count)
        self.joints = np.zeros(4)
        self.joints_dot = np.zeros(4)
        self._command = np.zeros(2)
        self._act: Fast = library.fast(
            "act",
            joints=self.joints,
            joints_dot=self.joints_dot,
            command=self._command,
            memory=self._memory.numbers,
            memory_next=self._memory.numbers,
            bristles=self._bristles,
            bristles_next=self._bristles,
            drive=drive.numbers,
            rows=np.array([each.row for each in found]).reshape(-1),
            elements=elements.reshape(-1),
            h=np.array([h]),
            lead=np.array([0.0 if ahead else 0.5 * h]),
        )
        self.forces: Array = self._act.results.forces
        self._compliant = np.array([bool(each.stiffness) for each in transmissions])
        self._at_motor = effects.encoder_at == "motor" and bool(self._compliant.any())

    def reset(self, q_a: Numbers, q_a_dot: Numbers) -> None:
        """Begin with rotors that turn with the links, no torque and unbent friction;
        q_a, (2,), rad, and its rates, rad/s.
        """
        self._memory.numbers[:], self._bristles[:] = 0.0, 0.0
        self._memory.rotor = np.asarray(q_a) + 0.5 * self._h * np.asarray(q_a_dot)
        self._memory.rotor_dot = q_a_dot

    def act(self, command: Numbers) -> None:
        """Compute the forces over the coming substep under motor commands, (2,), N m,
        from ``joints`` and ``joints_dot`` at its begin.
        """
        self._command[:] = command
        self._act.run()

    @property
    def motor_torque(self) -> Array:
        """Torque of the motors at the end of the last substep, (2,), N m."""
        return np.array(self._memory.torque)

    def encoder_angles(self, q_a: Numbers) -> list[float]:
        """Return the angles of the encoders' discs, (2,), rad, at joint angles ``q_a``,
        (2,), rad.
        """
        if not self._at_motor:
            return list(q_a)
        rotor = self._memory.rotor - 0.5 * self._h * self._memory.rotor_dot
        encoded: list[float] = np.where(self._compliant, rotor, q_a).tolist()
        return encoded


def _motor(place: FrictionElement, robot: RobotParameters, effects: Effects) -> Motor:
    """Return a place of friction as its steepness is checked; sticking friction brings
    a steepness that is sound by itself.
    """
    smooth = effects.friction == "smooth"
    if not place.inertia > 0.0:
        raise ParameterError(
            f"friction at the {place.name} acts on links without inertia;"
            " distal_inertia must be > 0"
        )
    return Motor(
        place.name.removesuffix(" joint"),
        place.viscous + (place.coulomb / robot.coulomb_speed if smooth else 0.0),
        place.inertia,
    )


def _check_transmissions(
    robot: RobotParameters, effects: Effects, period: float, substeps: int
) -> None:
    links = without_rotors(robot, effects).legs
    for side, leg, link in zip(robot.sides, robot.legs, links, strict=True):
        stiffness, damping = compliance(leg, effects)
        if not stiffness:
            continue
        moved = proximal_inertia(link)
        mobility = 1.0 / leg.rotor_inertia + 1.0 / moved
        quickest = max(math.sqrt(stiffness * mobility), damping * mobility)
        if not quickest * period / substeps <= FASTEST:
            raise ParameterError(
                f"{side} transmission of {stiffness:g} N m/rad and {damping:g} N m"
                f" s/rad is too quick for substeps of {period / substeps:g} s; substeps"
                f" must be >= {math.ceil(quickest * period / FASTEST)}"
            )
