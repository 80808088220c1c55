"""What calibration and identification share: numbers before and after, in words and in
a robot's file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dextar_control.analysis.run import Run
from dextar_control.contract.errors import CalibrationError
from dextar_control.contract.robot import RobotParameters, flatten, robot_text
from dextar_control.symbols.types import Array

UNITS = {
    "m": ("mm", 1e3),
    "rad": ("mrad", 1e3),
    "kg": ("g", 1e3),
    "kg m^2": ("kg mm^2", 1e6),
    "N m": ("mN m", 1e3),
    "N m s/rad": ("mN m s/rad", 1e3),
    "m/s^2": ("m/s^2", 1.0),
    "N m/rad": ("N m/rad", 1.0),
}
"""In which people read them."""
Progress = Callable[[str], None]


# times what a recording alone leaves, that it may leave together with others
WORSE = 3.0


class Quantity(NamedTuple):
    """A number of a description, before and after.

    Attributes:
        name, unit: of the description.
        before, after: in that unit.
        deviation: standard; 0 of a number that was kept.
        note: what else is to be said of it.
    """

    name: str
    unit: str
    before: float
    after: float
    deviation: float
    note: str = ""

    @property
    def cells(self) -> list[str]:
        """Name, before, after, standard deviation and unit, as people read them."""
        unit, scale = UNITS[self.unit]
        sure = f"{scale * self.deviation:.4f}" if self.deviation else "kept"
        return [
            self.name,
            f"{scale * self.before:.4f}",
            _rounded(scale * self.after),
            self.note or sure,
            unit,
        ]


def _rounded(number: float) -> str:
    """Round a number, without a sign where it rounds to zero."""
    return f"{round(number, 4) + 0.0:.4f}"


def quantity_in_words(quantity: Quantity) -> str:
    """Say name, change and standard deviation of a quantity."""
    unit, scale = UNITS[quantity.unit]
    now = f"{quantity.name} {_rounded(scale * quantity.after)} {unit}"
    if quantity.deviation == 0.0:
        return f"{now}, kept"
    sure = quantity.note or f"+- {scale * quantity.deviation:.4f}"
    return f"{now} {sure}, was {scale * quantity.before:.4f}"


def write_robot(robot: RobotParameters, lines: Iterable[str], file: Path) -> None:
    """Write a description as every node takes it, with what is known of its numbers on
    top.

    Raises:
        OSError: it cannot be written.
    """
    flat = {
        key: value for key, value in flatten(robot).items() if key != "base_distance"
    }
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(
        "".join(f"# {' '.join(line.split())}\n" for line in lines) + robot_text(flat),
        encoding="utf-8",
    )


def common_robot(
    runs: Sequence[Run], numbers_of: Callable[[RobotParameters], Array], what: str
) -> RobotParameters:
    """Find the description that all runs have.

    Args:
        runs: that were recorded.
        numbers_of: gives the numbers (k,), in SI units, in which they have to agree.
        what: these are, in words.

    Raises:
        CalibrationError: one has none, or another one.
    """
    robots = []
    for run in runs:
        if run.robot is None:
            raise CalibrationError(
                f"{run.path} does not say which robot it is of; give its description"
                " with --robot"
            )
        robots.append(run.robot)
    for run, robot in zip(runs[1:], robots[1:], strict=True):
        if not np.array_equal(numbers_of(robot), numbers_of(robots[0])):
            raise CalibrationError(
                f"{run.path} was recorded with another {what} of the robot than"
                f" {runs[0].path}; take bags of one together"
            )
    return robots[0]


def check_agreement(
    path: Path, alone: float, together: float, least: float, unit: str
) -> None:
    """Check that several recordings are explained together about as well as one of them
    alone.

    Args:
        path: of one of them.
        alone, together: what the numbers by it alone, and those by all, leave of it, in
            SI units.
        least: that is no sign of anything.
        unit: m or N m.

    Raises:
        CalibrationError: they are not.
    """
    name, scale = UNITS[unit]
    if together > max(WORSE * alone, least):
        raise CalibrationError(
            f"the recordings contradict each other: {path} alone leaves"
            f" {scale * alone:.3g} {name} unexplained, together with the others"
            f" {scale * together:.3g} {name}, as where robots differ or one was changed"
            " in between; take them one by one. Nothing was written"
        )


def rms_of(values: Array) -> float:
    """Compute the root of the mean square of values (n, ...), units alike; nan ones do
    not count.
    """
    return (
        float(np.sqrt(np.nanmean(np.square(values))))
        if np.isfinite(values).any()
        else np.nan
    )
