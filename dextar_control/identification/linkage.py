"""The elbows of a five-bar as functions of the numbers that a calibration looks for."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dextar_control.contract.robot import RobotParameters
from dextar_control.mechanisms.five_bar import FiveBar
from dextar_control.mechanisms.five_bar_locus import SIDES
from dextar_control.mechanisms.mechanism import Values
from dextar_control.symbols.functions import Batch, named
from dextar_control.symbols.types import Array

PER_TURN, COMPLIANCE = ("encoder_cosine", "encoder_sine"), "encoder_compliance"
PER_LEG = (
    "proximal_length",
    "distal_length",
    "axis.x",
    "axis.y",
    "encoder_offset",
    *PER_TURN,
    COMPLIANCE,
)
NAMES = tuple(f"{side}.{name}" for side in SIDES for name in PER_LEG)
"""Of the numbers. The link of an encoder that reads r while tau, N m, is passed on to
it stands at r - encoder_offset - encoder_cosine cos r - encoder_sine sin r -
encoder_compliance tau, rad: cosine and sine are an error that returns once a turn, as
of a disc off its centre, which no description has; the compliance, rad/(N m), is that
of a transmission behind the encoder.
"""
DISTAL = NAMES.index("left.distal_length"), NAMES.index("right.distal_length")


class Linkage:
    """Functions of the numbers of ``NAMES`` (16,); not for two threads at once.

    Attributes:
        elbows: (numbers, readings (n, 2), passed (n, 2) N m) -> left (n, 2) elbow,
            between (n, 2) from it to the right one, m, slopes (n, 2, 16) of that by the
            numbers, u (n, 2) along the left proximal link.
        closures: (numbers, readings, passed, x (n, 2)) -> gaps (n, 2) between the
            elbows' distances from x and the distal lengths, m, slopes (n, 2, 16) by the
            numbers, rods (n, 2, 2) by x.
    """

    def __init__(self) -> None:
        mechanism, g = FiveBar(), ca.SX.sym("numbers", len(NAMES))
        reading, passed, x = (ca.SX.sym(name, 2) for name in ("reading", "passed", "x"))
        names = [name.replace(".", "_") for name in PER_LEG]
        legs = [
            Values(**dict(zip(names, ca.vertsplit(part), strict=True)))
            for part in ca.vertsplit(g, len(PER_LEG))
        ]
        for leg in legs:
            vars(leg)["axis"] = ca.vertcat(leg.axis_x, leg.axis_y)
        p = Values(**dict(zip(SIDES, legs, strict=True)))
        q_a = [
            r
            - leg.encoder_offset
            - leg.encoder_cosine * ca.cos(r)
            - leg.encoder_sine * ca.sin(r)
            - leg.encoder_compliance * tau
            for r, tau, leg in zip(
                ca.vertsplit(reading), ca.vertsplit(passed), legs, strict=True
            )
        ]
        left, right = (mechanism.elbow(leg, angle, p) for leg, angle in enumerate(q_a))
        between = right - left
        u = (left - mechanism.base(0, p)) / legs[0].proximal_length
        gaps = ca.vertcat(
            *(
                ca.norm_2(x - elbow) - leg.distal_length
                for elbow, leg in zip((left, right), legs, strict=True)
            )
        )
        slopes = ca.jacobian(between, g)
        arguments = {"numbers": g, "reading": reading, "passed": passed}
        self.elbows = Batch(
            named(
                "elbows",
                arguments,
                {"left": left, "between": between, "slopes": slopes, "u": u},
            )
        )
        self.closures = Batch(
            named(
                "closures",
                arguments | {"x": x},
                {
                    "gaps": gaps,
                    "slopes": ca.jacobian(gaps, g),
                    "rods": ca.jacobian(gaps, x),
                },
            )
        )


def numbers_of(robot: RobotParameters) -> Array:
    """Return the numbers (16,) of a description, in m, rad and rad/(N m); its encoders
    err by their offsets and its transmissions alone.
    """
    return np.array(
        [
            number
            for leg in robot.legs
            for number in (
                leg.proximal_length,
                leg.distal_length,
                *leg.axis,
                leg.encoder_offset,
                0.0,
                0.0,
                1.0 / leg.transmission_stiffness if leg.transmission_stiffness else 0.0,
            )
        ]
    )


def described(robot: RobotParameters, numbers: Array) -> RobotParameters:
    """Return the robot with other numbers (16,), in m, rad and rad/(N m).

    Raises:
        ParameterError: a number is none that a description may have.
    """
    found, before = (
        dict(zip(NAMES, map(float, row), strict=True))
        for row in (numbers, numbers_of(robot))
    )
    changes: dict[str, float | tuple[float, float]] = {}
    for side in SIDES:
        changes |= {
            f"{side}.{name}": found[f"{side}.{name}"]
            for name in ("proximal_length", "distal_length", "encoder_offset")
        }
        changes[f"{side}.axis"] = found[f"{side}.axis.x"], found[f"{side}.axis.y"]
        if (compliance := found[f"{side}.{COMPLIANCE}"]) != before[
            f"{side}.{COMPLIANCE}"
        ]:
            changes[f"{side}.transmission_stiffness"] = 1.0 / compliance
    return robot.replace(**changes)
