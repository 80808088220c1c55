"""From recordings to a robot's own masses and friction: what they tell, what they do
not, and whether one robot explains them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dextar_control.analysis.run import Run
from dextar_control.contract.errors import CalibrationError, ParameterError
from dextar_control.contract.robot import RobotParameters, flatten
from dextar_control.identification.dynamics import (
    DynamicFit,
    fit_dynamics,
    rest_of,
    rows_of,
)
from dextar_control.identification.motion import (
    EXCITE,
    LEAST_RATE,
    LEAST_S,
    SHORTEST,
    SmoothMotion,
    motion_of,
)
from dextar_control.identification.quantities import (
    UNITS,
    Progress,
    Quantity,
    check_agreement,
    common_robot,
    quantity_in_words,
    rms_of,
)
from dextar_control.identification.recorded import MeasuredMotion, recorded_of
from dextar_control.identification.transmission import Stiffness, stiffnesses_of
from dextar_control.mechanisms import DETAILED_FIVE_BAR
from dextar_control.mechanisms.five_bar_locus import SIDES

LEAST_SPAN = 0.05  # rad, that each joint has to move
LEAST_INSTANTS = 50  # that tell something
LEAST_TURNING = 0.05  # share of them at which a joint turns one way
# combinations of masses and inertias that a five-bar's torques see without gravity
BODIES = 5
# standard deviation beyond which a motor's friction is not told, N m and N m s/rad
WIDEST = {"coulomb_friction": 5e-3, "viscous_friction": 5e-3}
WIDEST_GRAVITY = 1.0  # m/s^2
MOST_REST = 0.35  # of a joint's torque, RMS, that may stay unexplained
# share of a joint's torque by which recordings may be explained worse together than
# alone
MOST_APART = 0.05
# of the instants: where friction turns round, or a belt rings, the others scatter more
LEAST_USED = 0.25
# factor by which a combination of masses or inertias may differ from the description
MOST_FACTOR = 3.0
WEIGHT = 9.81  # m/s^2
STRIBECK_SPEED = 0.3  # rad/s over which a Stribeck peak falls off
# standard deviations, and N m, from which on such a peak is told
STRIBECK_SURE, STRIBECK_LEAST = 5.0, 2e-3


class TorquePrediction(NamedTuple):
    """How well an identification explains the torques of a recording that did not serve
    to find it.

    Attributes:
        path: of the bag.
        instants: how many tell something.
        torque: RMS of the commanded torques, N m.
        before, after: RMS of their rest by the description and by what was found, N m.
    """

    path: Path
    instants: int
    torque: float
    before: float
    after: float


@dataclass(frozen=True)
class Identification:
    """What recordings tell of a robot's masses, friction and gravity.

    Attributes:
        before, after: the descriptions.
        motions: that served.
        fit: what was found.
        stiffnesses: of the transmissions, as far as they are told.
        kept: in words, what the recordings do not tell.
        told: in words, the combinations that they do.
    """

    before: RobotParameters
    after: RobotParameters
    motions: list[SmoothMotion]
    fit: DynamicFit
    stiffnesses: list[Stiffness | None]
    kept: list[str]
    told: list[str]

    @property
    def quantities(self) -> list[Quantity]:
        """The description's masses and friction, number by number."""
        fit, found = self.fit, []
        for row, one in enumerate(fit.unknowns):
            before, after = float(fit.before[row]), float(fit.numbers[row])
            sure, note = float(fit.deviations[row]), ""
            if not fit.alone[row] and fit.combined[row]:
                note = "in combination"
            elif not fit.alone[row]:
                sure = 0.0
            found.append(Quantity(one.name, one.unit, before, after, sure, note))
        for side, leg, told in zip(
            SIDES, self.before.legs, self.stiffnesses, strict=True
        ):
            name, before = f"{side}.transmission_stiffness", leg.transmission_stiffness
            after, sure = (before, 0.0) if told is None else told
            found.append(Quantity(name, "N m/rad", before, after, sure))
        return found


def identify(
    runs: Sequence[Run], *, progress: Progress = lambda stage: None
) -> Identification:
    """Identify a robot's masses, friction and gravity by recorded runs of it.

    Args:
        runs: with torques, of one robot, whose description each of them has.
        progress: told what is being done.

    Raises:
        CalibrationError: the recordings cannot tell what is looked for, contradict each
            other or the description.
    """
    robot = common_robot(
        runs, lambda one: DETAILED_FIVE_BAR.values(flatten(one)), "description"
    )
    return identify_recorded(
        robot, [recorded_of(run, robot, EXCITE) for run in runs], progress=progress
    )


def identify_recorded(
    robot: RobotParameters,
    recordings: Sequence[MeasuredMotion],
    *,
    progress: Progress = lambda stage: None,
) -> Identification:
    """Identify a robot's masses, friction and gravity by recorded motions, wherever
    they come from.

    Raises:
        CalibrationError: as ``identify``.
    """
    for recorded in recordings:
        idle = [
            side
            for side, torque in zip(SIDES, recorded.torque.T, strict=True)
            if not np.nan_to_num(torque).any()
        ]
        if idle:
            raise CalibrationError(
                f"{recorded.path} has no torque of the {' and the '.join(idle)} motor:"
                " no joint_commands with an effort other than 0, which tells masses"
                f" and friction; {EXCITE}"
            )
    progress("looking for stretches that tell something")
    motions = [motion_of(robot, recorded) for recorded in recordings]
    _check_motion(motions)
    progress(f"fitting to {sum(len(motion.tells) for motion in motions)} instants")
    found = fit_dynamics(robot, motions)
    _check_agree(robot, motions, found)
    _check_explained(motions, found)
    _check_told(motions, found)
    _check_bounds(robot, found)
    stiffnesses = stiffnesses_of(robot, motions)
    numbers = {
        one.name: float(value)
        for one, value in zip(found.unknowns, found.numbers, strict=True)
    }
    gravity = numbers.pop("gravity.x"), numbers.pop("gravity.y")
    numbers |= {
        f"{side}.transmission_stiffness": told.value
        for side, told in zip(SIDES, stiffnesses, strict=True)
        if told is not None
    }
    try:
        after = robot.replace(**numbers, gravity=gravity)
    except ParameterError as error:
        raise CalibrationError(
            f"{_names(motions)} lead to no robot: {error}. Nothing was written"
        ) from error
    return Identification(
        robot,
        after,
        motions,
        found,
        stiffnesses,
        _kept(robot, found, stiffnesses),
        _told(found),
    )


def predict_torques(identification: Identification, run: Run) -> TorquePrediction:
    """Check an identification by a recording that did not serve to find it.

    Raises:
        CalibrationError: it tells nothing.
    """
    motion = motion_of(
        identification.before, recorded_of(run, identification.before, EXCITE)
    )
    if not len(motion.tells):
        raise CalibrationError(f"{run.path} cannot check: {_too_little([motion])}")
    rests = []
    for robot in (identification.before, identification.after):
        rows = rows_of(DETAILED_FIVE_BAR.values(flatten(robot)), motion)
        rests.append(rest_of(rows, rows.gap))
    counts = np.abs(rests[1]).max(axis=1) <= 5.0 * np.median(
        np.abs(rests[1]).max(axis=1)
    )
    return TorquePrediction(
        run.path,
        int(counts.sum()),
        rms_of(motion.filtered(motion.tau)[counts]),
        *(rms_of(rest[counts]) for rest in rests),
    )


def identified_lines(identification: Identification) -> list[str]:
    """Say what is known of the description's numbers, for its file."""
    return [
        (
            f"The robot '{identification.after.name}', its masses and friction"
            f" identified by {_names(identification.motions)}."
        ),
        *map(quantity_in_words, identification.quantities),
        *identification.told,
        *identification.kept,
    ]


def _names(motions: Sequence[SmoothMotion]) -> str:
    return ", ".join(str(motion.recorded.path) for motion in motions)


def _too_little(motions: Sequence[SmoothMotion]) -> str:
    count = sum(len(motion.tells) for motion in motions)
    return (
        f"too little motion: {count} instants tell something of masses and friction,"
        f" {LEAST_INSTANTS} are the least (each joint faster than {LEAST_RATE} rad/s,"
        f" |s| above {LEAST_S}, its side known, under a torque, states without a gap"
        f" for {SHORTEST} s around); {EXCITE}"
    )


def _check_motion(motions: Sequence[SmoothMotion]) -> None:
    spans = np.max([motion.spans for motion in motions], axis=0)
    joint = int(spans.argmin())
    if spans[joint] < LEAST_SPAN:
        raise CalibrationError(
            f"{_names(motions)}: too little motion: the {SIDES[joint]} encoder moves by"
            f" {spans[joint]:.4f} rad; for {SIDES[joint]}.coulomb_friction and"
            f" {SIDES[joint]}.rotor_inertia {LEAST_SPAN} rad are the least; {EXCITE}"
        )
    rates = np.concatenate([motion.rates for motion in motions])
    if len(rates) < LEAST_INSTANTS:
        raise CalibrationError(f"{_names(motions)}: {_too_little(motions)}")
    for side, own in zip(SIDES, rates.T, strict=True):
        share = float(np.mean(own > 0.0))
        if not LEAST_TURNING <= share <= 1.0 - LEAST_TURNING:
            raise CalibrationError(
                f"{_names(motions)}: one direction only: the {side} joint turns"
                f" {'forwards' if share > 0.5 else 'backwards'} in"
                f" {max(share, 1.0 - share):.0%} of the motion, so that gravity hides"
                f" {side}.coulomb_friction; {EXCITE}"
            )


def _check_agree(
    robot: RobotParameters, motions: Sequence[SmoothMotion], found: DynamicFit
) -> None:
    for row, motion in enumerate(motions if len(motions) > 1 else []):
        if len(motion.tells) >= LEAST_INSTANTS:
            alone = np.median(np.abs(fit_dynamics(robot, [motion]).rest), axis=0)
            rows = found.which == row
            together, torque = (
                np.median(np.abs(found.rest[rows]), axis=0),
                rms_of(found.torque[rows]),
            )
            joint = int(np.argmax(together))
            check_agreement(
                motion.recorded.path,
                float(alone[joint]),
                float(together[joint]),
                MOST_APART * torque,
                "N m",
            )


def _check_told(motions: Sequence[SmoothMotion], found: DynamicFit) -> None:
    limits = {
        f"{side}.{name}": widest for side in SIDES for name, widest in WIDEST.items()
    }
    limits |= {"gravity.x": WIDEST_GRAVITY, "gravity.y": WIDEST_GRAVITY}
    units = {one.name: UNITS[one.unit] for one in found.unknowns}
    vague = []
    for name, widest in limits.items():
        (unit, scale), deviation = units[name], found.value(name)[1]
        if not deviation <= widest:
            vague.append(
                f"{name} to +-{scale * deviation:.2g} {unit} ({scale * widest:g} {unit}"
                " are needed)"
            )
    bodies = sum(one.unit.startswith("kg") for one in found.combinations)
    if bodies < BODIES:
        vague.append(
            f"{bodies} combinations of masses and inertias ({BODIES} are needed)"
        )
    if vague:
        rest = rms_of(found.rest[found.used]) / max(
            rms_of(found.torque[found.used]), 1e-9
        )
        raise CalibrationError(
            f"{_names(motions)}: the motion tells {'; '.join(vague)}: it is too slow,"
            f" too short or always the same, or what acts besides hides it ({rest:.0%}"
            f" of the torques that count are left over); {EXCITE}"
        )


def _check_explained(motions: Sequence[SmoothMotion], found: DynamicFit) -> None:
    used = float(found.used.mean())
    shares = [
        rms_of(rest) / max(rms_of(torque), 1e-9)
        for rest, torque in zip(found.rest.T, found.torque.T, strict=True)
    ]
    if max(shares) > MOST_REST or used < LEAST_USED:
        joint = int(np.argmax(shares))
        raise CalibrationError(
            f"no masses and friction explain {_names(motions)}: {max(shares):.0%} of"
            f" the {SIDES[joint]} torque are left over ({MOST_REST:.0%} at most) and"
            f" {used:.0%} of the instants agree ({LEAST_USED:.0%} at least): torques"
            " that are not those of the motors, another geometry (dextar calibrate) or"
            " pushes look like this. Nothing was written"
        )


def _check_bounds(robot: RobotParameters, found: DynamicFit) -> None:

    def fail(what: str, limit: str) -> CalibrationError:
        return CalibrationError(
            f"the recordings put {what}; {limit}: correct the description first."
            " Nothing was written"
        )

    for sum_of in found.combinations:
        unit, scale = UNITS[sum_of.unit]
        size = float(np.abs(sum_of.factors) @ found.before) * (MOST_FACTOR - 1.0)
        most = size / MOST_FACTOR if sum_of.after < sum_of.before else size
        if sum_of.unit.startswith("kg") and not abs(
            sum_of.after - sum_of.before
        ) <= max(most, 3.0 * sum_of.deviation):
            raise fail(
                f"{sum_of.name} at {scale * sum_of.after:.4g} {unit}, described as"
                f" {scale * sum_of.before:.4g}",
                f"within a factor of {MOST_FACTOR:g} it can be this robot",
            )
    for one, value in zip(found.unknowns, found.numbers, strict=True):
        if one.unit == "N m" and value > robot.max_torque:
            raise fail(
                f"{one.name} at {value:.3g} N m",
                f"the motors give {robot.max_torque:g} N m",
            )
    pull = float(np.hypot(found.value("gravity.x")[0], found.value("gravity.y")[0]))
    if pull > 1.05 * WEIGHT:
        raise fail(f"gravity at {pull:.2f} m/s^2", f"{WEIGHT} m/s^2 is the most")


def _told(found: DynamicFit) -> list[str]:
    """Say which combinations are told, and what else is worth a line."""
    lines = []
    for one in found.combinations:
        unit, scale = UNITS[one.unit]
        if np.count_nonzero(one.factors) > 1:
            now, wide, was = (
                f"{scale * number:.4f}"
                for number in (one.after, one.deviation, one.before)
            )
            lines.append(f"{one.name}: {now} +- {wide} {unit}, was {was}")
    (x, x_sure), (y, y_sure) = found.value("gravity.x"), found.value("gravity.y")
    pull, pull_sure = float(np.hypot(x, y)), max(x_sure, y_sure)
    if pull > 3.0 * pull_sure:
        tilt = np.degrees(np.arcsin(min(pull / WEIGHT, 1.0)))
        lines.append(
            f"The robot is tilted by {tilt:.2f} deg +-"
            f" {np.degrees(pull_sure / WEIGHT):.2f}, downhill at"
            f" {np.degrees(np.arctan2(y, x)):.0f} deg of its frame."
        )
    late = [
        f"{round(1e3 * value, 2) + 0.0:.2f} +- {1e3 * sure:.2f}"  # 0.00 without a sign
        for value, sure in zip(found.delay, found.delay_deviation, strict=True)
    ]
    lines.append(
        f"The drives answer {', '.join(late)} ms late, which is allowed for; no robot"
        " file says it."
    )
    for side, rates, rest in zip(SIDES, found.rates.T, found.rest.T, strict=True):
        shape = np.sign(rates) * np.exp(-np.abs(rates) / STRIBECK_SPEED)
        shape, left = shape[found.used], rest[found.used]
        size = float(shape @ left / (shape @ shape))
        sure = float((left - size * shape).std() / np.sqrt(shape @ shape))
        if size > max(STRIBECK_SURE * sure, STRIBECK_LEAST):
            lines.append(
                f"The {side} joint rubs more when slow, by {1e3 * size:.1f} +-"
                f" {1e3 * sure:.1f} mN m at rest (Stribeck, over {STRIBECK_SPEED:g}"
                " rad/s); no robot file says it."
            )
    lines += [
        f"{name} would be less than it can be, and was kept at its least: not all that"
        " acts is modelled."
        for name in found.bound
    ]
    return lines


def _kept(
    robot: RobotParameters, found: DynamicFit, stiffnesses: Sequence[Stiffness | None]
) -> list[str]:
    kept, together = [], []
    for row, one in enumerate(found.unknowns):
        unit, scale = UNITS[one.unit]
        if found.combined[row]:
            together += [one.name] * (not found.alone[row])
        elif not found.alone[row]:
            kept.append(
                f"{one.name} is not told: it was kept at"
                f" {scale * found.before[row]:.4f} {unit}."
            )
    if together:
        kept.append(
            "Single masses and inertias are not told, only combinations of them; what"
            f" these ask for was shared out evenly among {', '.join(together)}."
        )
    for side, leg, told in zip(SIDES, robot.legs, stiffnesses, strict=True):
        if told is None:
            was = (
                f"at {leg.transmission_stiffness:g} N m/rad"
                if leg.transmission_stiffness
                else "as rigid"
            )
            kept.append(
                f"{side}.transmission_stiffness is not told without encoders at the"
                " motor and external poses that show the link lag behind: it was kept"
                f" {was}."
            )
    return kept
