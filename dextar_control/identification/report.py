"""A calibration or an identification in files and in words: the robot's file, a page, a
table for a terminal.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from dextar_control.analysis.page import Cell, Column, render
from dextar_control.analysis.registry import number
from dextar_control.analysis.web_figures import residuals
from dextar_control.contract.errors import bag_errors
from dextar_control.contract.words import counted
from dextar_control.identification.calibration import (
    MOST_GAP,
    Calibration,
    Prediction,
    robot_lines,
)
from dextar_control.identification.identification import (
    Identification,
    TorquePrediction,
    identified_lines,
)
from dextar_control.identification.quantities import (
    UNITS,
    Quantity,
    rms_of,
    write_robot,
)
from dextar_control.mechanisms.five_bar_locus import SIDES

ROBOT_FILE, PAGE_FILE = "calibrated.yaml", "calibration.html"
IDENTIFIED_FILE, IDENTIFICATION_FILE = "identified.yaml", "identification.html"
MM, UM, MNM = 1e3, 1e6, 1e3
UNHELD = (
    ": the numbers do not hold there; another robot, a change in between or too short a"
    " recording look like this"
)
TORQUES = (
    "What of the commanded torques masses, friction and gravity do not explain, where"
    " the joints turn, clear of the locus. Crosses lie more than four deviations off"
    " and do not count."
)
OBSERVATION = (
    "At a crossing the distal links are aligned: the elbows are as far apart as the"
    " distal lengths' sum (stretched) or difference (folded). The gap is what the"
    " encoders say of that distance less what the lengths say. A crossing that does not"
    " count lies more than four deviations off: the robot turned or bounced off before"
    " it touched the locus, or was disturbed."
)


def write_calibration(
    calibration: Calibration, predictions: Sequence[Prediction], folder: Path
) -> None:
    """Write the robot's file and the page.

    Raises:
        BagError: they cannot be written.
    """
    page = render_calibration(calibration, predictions)
    with bag_errors(f"write the results to {folder}"):
        write_robot(calibration.after, robot_lines(calibration), folder / ROBOT_FILE)
        (folder / PAGE_FILE).write_text(page, encoding="utf-8", errors="replace")


def short_name(bag: Path) -> str:
    """Name a bag by its folder and file, by which runs differ."""
    return "/".join(bag.parts[-2:])


def summary(title: str, quantities: Sequence[Quantity]) -> Table:
    """Make what was found a table for a terminal."""
    table = Table(title=title, title_justify="left")
    for name in ("", "before", "after", "+-", ""):
        table.add_column(name, justify="left" if not name else "right")
    for quantity in quantities:
        table.add_row(*quantity.cells)
    return table


def quantity_table(
    quantities: Sequence[Quantity],
) -> tuple[list[Column], list[list[Cell]]]:
    """Make what was found a table for the page."""
    columns = [
        Column("quantity", text=True),
        Column("before"),
        Column("after"),
        Column("standard deviation"),
        Column("unit", text=True),
    ]
    return columns, [[Cell(text) for text in quantity.cells] for quantity in quantities]


def prediction_in_words(prediction: Prediction) -> str:
    """Say what a calibration is worth on a bag that did not serve to find it."""
    text = (
        f"{prediction.path}, not used: gaps of {counted(prediction.folds, 'crossing')}"
        f" {UM * prediction.before:.0f} um RMS before, {UM * prediction.after:.2f} um"
        " after"
    )
    if np.isfinite(prediction.places_after):
        text += (
            f"; at the poses {MM * prediction.places_before:.3f} mm before,"
            f" {MM * prediction.places_after:.3f} mm after"
        )
    return text + (
        UNHELD if prediction.after > max(0.5 * prediction.before, MOST_GAP) else ""
    )


def fit_in_words(calibration: Calibration) -> str:
    """Say how well the folds, and the places, are explained."""
    fit, used = calibration.fit, calibration.fit.used
    before, after = (
        rms_of(gaps[used]) for gaps in (calibration.gaps_before, calibration.gaps_after)
    )
    text = (
        f"{counted(int(used.sum()), 'crossing')} with gaps of"
        f" {number(UM * before, '.0f')} um RMS before and {number(UM * after, '.2f')}"
        " um after"
    )
    if others := len(used) - int(used.sum()):
        text += (
            f"; {counted(others, 'outlier')} left out, as where a robot turns back"
            " before it crosses"
        )
    if fit.places:
        text += f"; {fit.places} poses with {MM * fit.place_noise:.3f} mm of noise"
    if fit.encoder_error:
        text += (
            f"; the encoders seem to err by {1e3 * fit.encoder_error:.2g} mrad once a"
            " turn, which is allowed for"
        )
    return text


def render_calibration(
    calibration: Calibration, predictions: Sequence[Prediction]
) -> str:
    """Render the page of a calibration."""
    fit, folds = calibration.fit, calibration.folds
    figures = {
        when: residuals(
            UM * gaps, UM * spreads, fit.used, f"gap {when} (µm)", "crossing"
        )
        for when, gaps, spreads in (
            ("before", calibration.gaps_before, 0.0 * fit.spreads),
            ("after", calibration.gaps_after, fit.spreads),
        )
    }
    rows = [
        [
            Cell(str(index + 1)),
            Cell(short_name(calibration.recordings[fold.bag].path)),
            Cell(f"{fold.time:.3f}"),
            Cell(fold.family.name.lower()),
            *(Cell(number(MM * value, ".2f")) for value in one.x),
            Cell(number(UM * calibration.gaps_before[index], ".1f")),
            Cell(number(UM * calibration.gaps_after[index], ".2f")),
            Cell(number(UM * fit.spreads[index], ".2f")),
            Cell("yes" if used else "no", not used),
        ]
        for index, (fold, one, used) in enumerate(
            zip(folds, fit.touches, fit.used, strict=True)
        )
    ]
    checked = [
        [
            Cell(str(one.path)),
            Cell(str(one.folds)),
            *(Cell(number(UM * gap, ".2f")) for gap in (one.before, one.after)),
            *(
                Cell(number(MM * gap, ".3f"))
                for gap in (one.places_before, one.places_after)
            ),
        ]
        for one in predictions
    ]
    return render(
        "identification.html",
        figures,
        title=f"{calibration.after.name}: geometry calibrated",
        heading=(
            f"{calibration.after.name}: geometry by"
            f" {', '.join(short_name(one.path) for one in calibration.recordings)}"
        ),
        sentence=fit_in_words(calibration),
        verdict="Calibrated.",
        quantities=quantity_table(calibration.quantities),
        kept=calibration.kept,
        told=(
            "What was looked for, with standard deviations by the scatter of the"
            " recordings."
        ),
        directions=(
            calibration.kept
            and [
                f"{direction.name}: ± {UNITS[direction.unit][1] * deviation:.4f}"
                f" {UNITS[direction.unit][0]}"
                for direction, deviation in zip(
                    fit.directions, fit.deviations, strict=True
                )
            ]
        ),
        observed="Crossing by crossing",
        observation=OBSERVATION,
        observations=(
            [
                Column("crossing"),
                Column("bag", text=True),
                Column("time", "s"),
                Column("links", text=True),
                Column("x", "mm"),
                Column("y", "mm"),
                Column("gap before", "µm"),
                Column("gap after", "µm"),
                Column("its deviation", "µm"),
                Column("counts", text=True),
            ],
            rows,
        ),
        predictions=(
            [
                Column("bag", text=True),
                Column("crossings"),
                Column("RMS gap before", "µm"),
                Column("after", "µm"),
                Column("RMS at the poses before", "mm"),
                Column("after", "mm"),
            ],
            checked,
        ),
        footer=(
            f"Made by dextar calibrate. {ROBOT_FILE} beside this page is a robot file"
            " for every node."
        ),
    )


def write_identification(
    identification: Identification,
    predictions: Sequence[TorquePrediction],
    folder: Path,
) -> None:
    """Write the robot's file and the page.

    Raises:
        BagError: they cannot be written.
    """
    page, lines = (
        render_identification(identification, predictions),
        identified_lines(identification),
    )
    with bag_errors(f"write the results to {folder}"):
        write_robot(identification.after, lines, folder / IDENTIFIED_FILE)
        file = folder / IDENTIFICATION_FILE
        file.write_text(page, encoding="utf-8", errors="replace")


def torque_prediction_in_words(prediction: TorquePrediction) -> str:
    """Say what an identification is worth on a bag that did not serve to find it."""
    most = max(0.5 * prediction.before, 0.1 * prediction.torque)
    return (
        f"{prediction.path}, not used: of torques of {MNM * prediction.torque:.1f} mN m"
        f" RMS ({counted(prediction.instants, 'instant')})"
        f" {MNM * prediction.before:.2f} mN m were unexplained before,"
        f" {MNM * prediction.after:.2f} mN m after"
        f"{UNHELD if prediction.after > most else ''}"
    )


def torque_fit_in_words(identification: Identification) -> str:
    """Say how well the torques are explained."""
    fit, used = identification.fit, identification.fit.used
    before, after, torque = (
        MNM * rms_of(rows[used]) for rows in (fit.rest_before, fit.rest, fit.torque)
    )
    text = (
        f"{counted(int(used.sum()), 'instant')} with torques of {torque:.1f} mN m RMS,"
        f" of which {before:.2f} mN m were unexplained before, {after:.2f} mN m after"
    )
    if others := len(used) - int(used.sum()):
        text += (
            f"; {counted(others, 'outlier')} left out, as where friction turns round, a"
            " belt rings, the robot was pushed, or the geometry is wrong: see dextar"
            " calibrate"
        )
    return text


def render_identification(
    identification: Identification, predictions: Sequence[TorquePrediction]
) -> str:
    """Render the page of an identification."""
    fit = identification.fit
    names = ", ".join(short_name(one.recorded.path) for one in identification.motions)
    none = np.zeros(len(fit.rest))
    figures = {
        f"{side}-{when}": residuals(
            MNM * rest[:, joint], none, fit.used, f"{side}, {when} (mN m)", "instant"
        )
        for joint, side in enumerate(SIDES)
        for when, rest in (("before", fit.rest_before), ("after", fit.rest))
    }
    checked = [
        [
            Cell(str(one.path)),
            Cell(str(one.instants)),
            *(
                Cell(number(MNM * value, ".2f"))
                for value in (one.torque, one.before, one.after)
            ),
        ]
        for one in predictions
    ]
    return render(
        "identification.html",
        figures,
        title=f"{identification.after.name}: masses and friction identified",
        heading=f"{identification.after.name}: masses and friction by {names}",
        verdict="Identified.",
        sentence=torque_fit_in_words(identification),
        quantities=quantity_table(identification.quantities),
        kept=identification.kept,
        told=(
            "What the torques see together (base parameters), with standard deviations"
            " by the scatter of the recordings."
        ),
        directions=identification.told,
        observed="Instant by instant",
        observation=TORQUES,
        observations=None,
        predictions=(
            [
                Column("bag", text=True),
                Column("instants"),
                Column("RMS torque", "mN m"),
                Column("unexplained before", "mN m"),
                Column("after", "mN m"),
            ],
            checked,
        ),
        footer=(
            f"Made by dextar identify. {IDENTIFIED_FILE} beside this page is a robot"
            " file for every node."
        ),
    )
