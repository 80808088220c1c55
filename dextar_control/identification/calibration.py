"""From recordings to a robot's own geometry: what they tell of it, what they do not,
and whether they explain each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from dextar_control.analysis.run import Run
from dextar_control.contract.errors import CalibrationError
from dextar_control.contract.robot import RobotParameters
from dextar_control.identification.fit import (
    EVERY,
    Direction,
    Fit,
    Places,
    directions_of,
    fit,
)
from dextar_control.identification.folds import Fold, find_folds, touch
from dextar_control.identification.linkage import (
    COMPLIANCE,
    NAMES,
    PER_TURN,
    Linkage,
    described,
    numbers_of,
)
from dextar_control.identification.motion import CUTOFF
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
from dextar_control.identification.transmission import SURE
from dextar_control.mechanisms.five_bar_locus import SIDES
from dextar_control.symbols.types import Array

SPARE = 2  # folds that are needed beyond the number of quantities
LEAST_SPAN = 0.05  # rad, that each joint has to move
# standard deviation of a quantity beyond which a recording does not tell it
WIDEST = {"m": 3e-4, "rad": 3e-3}
# change of a number beyond which the recordings contradict the description
MOST_MOVED = {"m": 5e-3, "rad": 0.1}
# m, RMS of the folds' gaps, without errors of the encoders, beyond which the numbers do
# not explain them
MOST_GAP = 1.5e-4
# m of a gap by which recordings may be explained worse together than alone
MOST_APART = 3e-5
MOST_PLACE_NOISE = 5e-3  # m, of a seen coordinate
# rad of an encoder's error once a turn that may be why nothing else is told
SUSPICIOUS = 1e-3
LEAST_USED = 2.0 / 3.0  # of the folds
# s between two joint states, beyond which no reading is known between them
POSE_GAP = 5e-3
FEWEST_PLACES = 50
UNLIKE = (
    "turns before the locus, encoders that slip, play, links that bend, or a bag of"
    " another robot look like this"
)
CHECK_POSES = "check their frame, unit and stamps, or leave them out (--no-pose)"
RECORD = (
    "record crossings spread over the locus: dextar demo --lockstep --tour 12 (on a rig"
    " dextar go --tour 12), also in other working modes, and where a tour ends early"
    " the other way round (--tour -12); several bags are taken together"
)


class CalibrationData(NamedTuple):
    """What a calibration takes of a bag.

    Attributes:
        path: of the bag.
        folds: in order of time; their times are s since the first state.
        places: of the end effector; None where none was seen.
        extremes: (2,) least and largest distance of the elbows by the description, m.
        spans: (2,) of the encoders' readings, rad.
    """

    path: Path
    folds: list[Fold]
    places: Places | None
    extremes: Array
    spans: Array


class Prediction(NamedTuple):
    """How well a calibration explains a recording that did not serve to find it.

    Attributes:
        path: of the bag.
        folds: how many there are.
        before, after: RMS of the folds' gaps by the description and by what was found,
            m; of those that count.
        places_before, places_after: RMS of the closures' gaps at the places of the end
            effector, m; nan without.
    """

    path: Path
    folds: int
    before: float
    after: float
    places_before: float
    places_after: float


@dataclass(frozen=True)
class Calibration:
    """What recordings tell of a robot's geometry.

    Attributes:
        before, after: the descriptions.
        recordings: that served.
        folds: of all of them.
        gaps_before, gaps_after: of the folds by both descriptions, m.
        fit: what was found.
        kept: in words, what the recordings do not tell, with its number.
    """

    before: RobotParameters
    after: RobotParameters
    recordings: list[CalibrationData]
    folds: list[Fold]
    gaps_before: Array
    gaps_after: Array
    fit: Fit
    kept: list[str]

    @property
    def quantities(self) -> list[Quantity]:
        """The description's geometry, number by number."""
        deviations = np.sqrt(np.maximum(np.diag(self.fit.covariance), 0.0))
        columns = numbers_of(self.before), self.fit.numbers, deviations
        rows = dict(zip(NAMES, np.column_stack(columns).tolist(), strict=True))
        found = [Quantity(one.name, one.unit, *rows[one.name]) for one in EVERY]
        for side, was, now in zip(
            SIDES, self.before.legs, self.after.legs, strict=True
        ):
            name, before = f"{side}.transmission_stiffness", was.transmission_stiffness
            value = now.transmission_stiffness
            if value != before:
                sure = rows[f"{side}.{COMPLIANCE}"][2] * value**2
                found.append(Quantity(name, "N m/rad", before, value, sure))
        return found

    @property
    def folded_told(self) -> bool:
        """Whether the recordings tell the difference of the distal lengths."""
        return any(
            one.name.endswith("left.distal_length") for one in self.fit.directions
        )


def passed_on(robot: RobotParameters, recorded: MeasuredMotion) -> Array:
    """Compute the torques that the transmissions pass on to the links: the motors' less
    what turns their rotors.

    Friction of the motors is not taken off; where no torque is known it is 0.

    Returns:
        (m, 2) N m.
    """
    period = float(np.median(np.diff(recorded.time)))
    smooth = butter(2, min(CUTOFF, 0.4 / period), fs=1.0 / period, output="sos")
    readings, torque = (
        sosfiltfilt(smooth, rows, axis=0)
        for rows in (recorded.readings, np.nan_to_num(recorded.torque))
    )
    rates = np.gradient(readings, recorded.time, axis=0)
    inertia = np.array([leg.rotor_inertia for leg in robot.legs])
    passed = torque - inertia * np.gradient(rates, recorded.time, axis=0)
    return np.where(np.isfinite(recorded.torque), passed, 0.0)


def recording_of(
    linkage: Linkage, robot: RobotParameters, recorded: MeasuredMotion, bag: int = 0
) -> CalibrationData:
    """Take what a motion says by its encoders, and by a camera if there was one."""
    time, readings, numbers = recorded.time, recorded.readings, numbers_of(robot)
    passed = passed_on(robot, recorded)
    distance = np.hypot(*linkage.elbows(numbers, readings, passed).between.T)
    places = None
    if recorded.poses is not None:
        seen, x = recorded.poses
        after = np.clip(np.searchsorted(time, seen), 1, len(time) - 1)
        good = (
            (time[after] - time[after - 1] <= POSE_GAP)
            & (seen >= time[0])
            & (seen <= time[-1])
        )
        if good.sum() >= FEWEST_PLACES:
            columns = np.column_stack(
                [
                    np.interp(seen[good], time, column)
                    for column in np.hstack([readings, passed]).T
                ]
            )
            places = Places(columns[:, :2], columns[:, 2:], x[good])
    # the robot stayed on one side, which was known all along
    stayed = recorded.believed and bool(recorded.side[0]) and not np.ptp(recorded.side)
    folds = (
        []
        if stayed
        else find_folds(
            linkage, numbers, recorded.working_mode, time, readings, bag, passed
        )
    )
    extremes = np.array([distance.min(), distance.max()])
    return CalibrationData(
        recorded.path, folds, places, extremes, np.ptp(readings, axis=0)
    )


def calibrate(
    runs: Sequence[Run], *, poses: bool = True, progress: Progress = lambda stage: None
) -> Calibration:
    """Calibrate a robot's geometry by recorded runs of it.

    Args:
        runs: with crossings, of one robot, whose description each of them has.
        poses: use the external poses, if there are any.
        progress: told what is being done.

    Raises:
        CalibrationError: the recordings cannot tell what is looked for, contradict each
            other or the description.
    """
    robot = common_robot(runs, numbers_of, "geometry")
    return calibrate_recorded(
        robot,
        [recorded_of(run, robot, RECORD) for run in runs],
        poses=poses,
        progress=progress,
    )


def calibrate_recorded(
    robot: RobotParameters,
    motions: Sequence[MeasuredMotion],
    *,
    poses: bool = True,
    progress: Progress = lambda stage: None,
) -> Calibration:
    """Calibrate a robot's geometry by recorded motions, wherever they come from.

    Raises:
        CalibrationError: as ``calibrate``.
    """
    linkage, numbers = Linkage(), numbers_of(robot)
    progress("looking for folds of the joints' motion")
    recordings = [
        recording_of(linkage, robot, motion, bag) for bag, motion in enumerate(motions)
    ]
    folds = [fold for recording in recordings for fold in recording.folds]
    seen = (
        [recording.places for recording in recordings if recording.places is not None]
        if poses
        else []
    )
    places = (
        Places(*(np.concatenate(parts) for parts in zip(*seen, strict=True)))
        if seen
        else None
    )
    wanted = directions_of(folds, places)
    _check_enough(robot, recordings, folds, wanted, places)
    progress(f"fitting {len(wanted)} quantities to {len(folds)} folds")
    found = fit(linkage, numbers, folds, places, wanted)
    _check_agree(linkage, numbers, recordings, found)
    plain = _plain(numbers, found)
    before, after = (
        np.array([touch(linkage, row, fold).gap for fold in folds])
        for row in (numbers, plain)
    )
    _check_places(found, places)
    _check_explained(found, after)
    _check_told(found)
    _check_bounds(robot, found)
    return Calibration(
        robot,
        described(robot, plain),
        recordings,
        folds,
        before,
        after,
        found,
        _kept(numbers, wanted),
    )


def predict(calibration: Calibration, run: Run) -> Prediction:
    """Check a calibration by a recording that did not serve to find it.

    Raises:
        CalibrationError: it has no fold.
    """
    linkage = Linkage()
    recording = recording_of(
        linkage, calibration.before, recorded_of(run, calibration.before, RECORD)
    )
    if not recording.folds:
        raise CalibrationError(
            f"{run.path} cannot check: {_no_fold(calibration.before, [recording])}"
        )
    numbers = numbers_of(calibration.before), numbers_of(calibration.after)
    gaps = np.array(
        [[touch(linkage, row, fold).gap for fold in recording.folds] for row in numbers]
    )
    counts = np.abs(gaps[1]) <= np.maximum(
        MOST_GAP * 3.0, 3.0 * np.nanmedian(np.abs(gaps[1]))
    )
    places = [
        (
            rms_of(linkage.closures(row, *recording.places).gaps)
            if recording.places
            else np.nan
        )
        for row in numbers
    ]
    return Prediction(
        run.path, len(recording.folds), *(rms_of(row[counts]) for row in gaps), *places
    )


def robot_lines(calibration: Calibration) -> list[str]:
    """Say what is known of the description's numbers, for its file."""
    return [
        (
            f"The robot '{calibration.after.name}', its geometry calibrated by"
            f" {int(calibration.fit.used.sum())} crossings of"
            f" {', '.join(str(one.path) for one in calibration.recordings)}."
        ),
        *map(quantity_in_words, calibration.quantities),
        *calibration.kept,
    ]


def _no_fold(robot: RobotParameters, recordings: Sequence[CalibrationData]) -> str:
    total, least = (
        robot.left.distal_length + sign * robot.right.distal_length for sign in (1, -1)
    )
    low = 1e3 * min(recording.extremes[0] for recording in recordings)
    high = 1e3 * max(recording.extremes[1] for recording in recordings)
    return (
        f"no crossing: the elbows, by the description, come {low:.2f} to {high:.2f} mm"
        f" near each other and nowhere turn back from {1e3 * total:.2f} mm (stretched"
        f" distal links) or {1e3 * abs(least):.2f} mm (folded ones), so that no length"
        f" can be told; {RECORD}"
    )


def _check_enough(
    robot: RobotParameters,
    recordings: Sequence[CalibrationData],
    folds: Sequence[Fold],
    wanted: Sequence[Direction],
    places: Places | None,
) -> None:
    names = ", ".join(str(recording.path) for recording in recordings)
    spans = np.max([recording.spans for recording in recordings], axis=0)
    if spans.min() < LEAST_SPAN:
        joint = int(spans.argmin())
        raise CalibrationError(
            f"{names}: too little motion: the {SIDES[joint]} encoder moves by"
            f" {spans[joint]:.4f} rad; for its offset and"
            f" {SIDES[joint]}.proximal_length {LEAST_SPAN} rad are the least; {RECORD}"
        )
    if not folds and places is None:
        raise CalibrationError(f"{names}: {_no_fold(robot, recordings)}")
    lacking = len(wanted) + SPARE - len(folds)
    if places is None and lacking > 0:
        raise CalibrationError(
            f"{names}: too few crossings: {len(folds)} for {len(wanted)} quantities"
            f" ({'; '.join(one.name for one in wanted)}); {lacking} more are needed;"
            f" {RECORD}"
        )


def _check_agree(
    linkage: Linkage, numbers: Array, recordings: Sequence[CalibrationData], found: Fit
) -> None:
    which = np.array([fold.bag for recording in recordings for fold in recording.folds])
    for bag, recording in enumerate(recordings if len(recordings) > 1 else []):
        wanted = directions_of(recording.folds, None)
        if len(recording.folds) >= len(wanted) + SPARE:
            alone = float(
                np.nanmedian(
                    np.abs(fit(linkage, numbers, recording.folds, None, wanted).gaps)
                )
            )
            check_agreement(
                recording.path,
                alone,
                float(np.nanmedian(np.abs(found.gaps[which == bag]))),
                MOST_APART,
                "m",
            )


def _check_places(found: Fit, places: Places | None) -> None:
    """Check that most often the end effector was seen where one geometry has it.

    Raises:
        CalibrationError: it was not.
    """
    count = 0 if places is None else len(places.x)
    if found.place_noise > MOST_PLACE_NOISE or found.places < LEAST_USED * count:
        told = (
            f"{found.places} of {count} external poses agree with any one geometry,"
            f" {LEAST_USED:.0%} have to"
            if not found.place_noise > MOST_PLACE_NOISE
            else (
                f"the external poses scatter by {1e3 * found.place_noise:.1f} mm"
                " (standard deviation) about any geometry's end effector;"
                f" {1e3 * MOST_PLACE_NOISE:g} mm is the most"
            )
        )
        raise CalibrationError(f"{told}: {CHECK_POSES}. Nothing was written")


def _check_told(found: Fit) -> None:
    vague = [
        (
            f"{direction.name} to +-{1e3 * deviation:.2g} {UNITS[direction.unit][0]}"
            if deviation < 100.0 * WIDEST[direction.unit]
            else f"{direction.name} not at all"
        )
        for direction, deviation in zip(found.directions, found.deviations, strict=True)
        if not deviation <= WIDEST[direction.unit]
    ]
    if vague:
        known = found.used & np.isfinite(found.gaps)
        x = 1e3 * np.array([one.x for one in found.touches]).reshape(-1, 2)[known]
        where = ""
        if len(x):
            low, high = x.min(axis=0), x.max(axis=0)
            where = (
                f", at x = {low[0]:.0f} to {high[0]:.0f} mm, y = {low[1]:.0f} to"
                f" {high[1]:.0f} mm,"
            )
        raise CalibrationError(
            f"{len(x)} crossings{where} tell {'; '.join(vague)}; {1e3 * WIDEST['m']:g}"
            f" mm and {1e3 * WIDEST['rad']:g} mrad are needed:"
            f" {_encoders(found) or 'they lie too close together, or all on one side'};"
            f" {RECORD}"
        )


def _encoders(found: Fit) -> str:
    """Say that the encoders err, where that may be why nothing is told."""
    if found.encoder_error < SUSPICIOUS:
        return ""
    return (
        f"the encoders seem to err by some {1e3 * found.encoder_error:g} mrad once a"
        " turn, as where a disc is off its centre; correct them, or record external"
        " poses too"
    )


def _check_explained(found: Fit, gaps: Array) -> None:
    used, count = int(found.used.sum()), len(gaps)
    rms = rms_of(gaps[found.used])
    none_spare = not found.places and used <= len(found.directions)
    if count and (used < LEAST_USED * count or rms > MOST_GAP or none_spare):
        raise CalibrationError(
            f"no geometry explains the recordings: {used} of {count} crossings"
            f" agree{f', with gaps of {1e6 * rms:.0f} um RMS' if rms >= 0.0 else ''};"
            f" {LEAST_USED:.0%} have to, with {1e6 * MOST_GAP:.0f} um at most:"
            f" {_encoders(found) or UNLIKE}"
            f"{f'; so do wrong external poses: {CHECK_POSES}' if found.places else ''}."
            f" Nothing was written{f'; {RECORD}' if not used else ''}"
        )


def _check_bounds(robot: RobotParameters, found: Fit) -> None:
    moved = found.numbers - numbers_of(robot)
    for direction in EVERY:
        change = float(moved[NAMES.index(direction.name)])
        unit, scale = UNITS[direction.unit]
        if not abs(change) <= MOST_MOVED[direction.unit]:
            raise CalibrationError(
                f"the recordings put {direction.name} {scale * change:+.2f} {unit} from"
                f" the description; within {scale * MOST_MOVED[direction.unit]:g}"
                f" {unit} it can be this robot: correct the description first. Nothing"
                " was written"
            )


def _plain(numbers: Array, found: Fit) -> Array:
    """Return the numbers (16,) as a description has them: without encoders' errors once
    a turn, and with transmissions' compliances only where they are told.
    """
    deviations: Array = np.sqrt(np.diag(found.covariance))
    plain: Array = found.numbers.copy()
    for row, name in enumerate(NAMES):
        if name.endswith(PER_TURN):
            plain[row] = 0.0
        elif (
            name.endswith(COMPLIANCE) and not plain[row] > SURE * deviations[row] > 0.0
        ):
            plain[row] = numbers[row]
    return plain


def _kept(numbers: Array, wanted: Sequence[Direction]) -> list[str]:
    if len(wanted) == len(EVERY):
        return []
    value = dict(zip(NAMES, numbers, strict=True))
    middle = [
        500.0 * (value[f"left.axis.{axis}"] + value[f"right.axis.{axis}"])
        for axis in "xy"
    ]
    lengths = [1e3 * value[f"{side}.distal_length"] for side in SIDES]
    stiffness = " and ".join(
        f"{1.0 / c:g} N m/rad" if (c := value[f"{side}.{COMPLIANCE}"]) else "rigid"
        for side in SIDES
    )
    kept = [
        (
            "The scale is not seen without an external pose: the distal lengths' sum"
            f" was kept at {sum(lengths):.4f} mm."
        ),
        (
            "Where the robot stands is not seen: the middle of its motor axes was kept"
            f" at ({middle[0]:.4f}, {middle[1]:.4f}) mm."
        ),
        (
            "How it is turned is not seen: the mean of the encoder offsets was kept at"
            f" {500.0 * sum(value[f'{side}.encoder_offset'] for side in SIDES):.4f}"
            " mrad."
        ),
        (
            "How far links lag behind their motors is not seen without an external"
            f" pose: the transmissions were kept as {stiffness}. If encoders sit at the"
            " motors, before belts, the robot file needs their stiffness, or these"
            " numbers bear its lag."
        ),
    ]
    if not any(direction.name.endswith("left.distal_length") for direction in wanted):
        kept.append(
            "How the distal lengths share their sum is not seen without two crossings"
            f" of folded links: they were kept at {lengths[0]:.4f} and {lengths[1]:.4f}"
            " mm, and near folded links the robot stays as wrong as that. Record some"
            " with this file as the robot (four of --tour 12 are such), and calibrate"
            " by that bag."
        )
    return kept
