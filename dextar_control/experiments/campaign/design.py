"""The trials of a campaign: plain data that determine one row each, with a key of their
content.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import importlib.util
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dextar_control.contract.robot import RobotParameters, flatten
from dextar_control.experiments.campaign.config import CampaignConfig
from dextar_control.experiments.campaign.rows import Row

KEY_LENGTH = 16  # hexadecimal digits of a row's key


class CrossingPoint(NamedTuple):
    """A place on the Type 2 locus where the robot is to cross."""

    point: tuple[float, float]  # m
    working_mode: tuple[int, int]
    family: str  # stretched | folded


@dataclass(frozen=True)
class Trial:
    """Holds everything that determines one row.

    Attributes:
        index: of the crossing point.
        point: where the robot is to cross, m.
        working_mode: elbow side of (left, right).
        family: of the locus: stretched or folded.
        direction: sign of s after the first crossing.
        case: name of the perturbation.
        perturbation: its numbers (``ranges.PERTURBATIONS``).
        law, estimator, plant: names.
        seed: of all that is random in this row.
        duration: of one way, s.
        dwell: at rest before, between and after the ways, s.
        repeat: return trips.
        settings: changes to the controller's parameters.
    """

    index: int
    point: tuple[float, float]
    working_mode: tuple[int, int]
    family: str
    direction: int
    case: str
    perturbation: Mapping[str, float]
    law: str
    estimator: str
    plant: str
    seed: int
    duration: float
    dwell: float
    repeat: int
    settings: Mapping[str, float]

    @property
    def place(self) -> tuple[int, int]:
        """Crossing point and direction: what trials with the same plans share."""
        return self.index, self.direction

    def columns(self) -> Row:
        """Return one flat cell for each attribute; mappings as JSON text."""
        cells = dataclasses.asdict(self)
        cells["point_x"], cells["point_y"] = cells.pop("point")
        cells["working_mode"] = "".join(
            "+" if side > 0 else "-" for side in self.working_mode
        )
        for name in ("perturbation", "settings"):
            cells[name] = json.dumps(cells[name], sort_keys=True)
        return cells


def trials_of(
    config: CampaignConfig, points: Sequence[CrossingPoint]
) -> Iterator[Trial]:
    """Give the trials, those with the same crossing point and direction one after the
    other.

    The seed of a row depends on the campaign's seed, the point, the direction and the
    row's number among the seeds alone: laws, estimators and cases meet the same random
    numbers.
    """
    for index, point in enumerate(points):
        for direction in config.directions:
            for number in range(config.seeds):
                sequence = np.random.SeedSequence(
                    [config.seed, index, int(direction > 0), number]
                )
                seed = int(sequence.generate_state(1)[0])
                yield from _at(config, index, point, direction, seed)


def _at(
    config: CampaignConfig, index: int, point: CrossingPoint, direction: int, seed: int
) -> Iterator[Trial]:
    for name, case in config.cases.items():
        for plant in case.plants or config.plants:
            for combination in config.combinations:
                if case.laws is not None and combination.law not in case.laws:
                    continue
                if (
                    case.estimators is not None
                    and combination.estimator not in case.estimators
                ):
                    continue
                yield Trial(
                    index=index,
                    point=point.point,
                    working_mode=point.working_mode,
                    family=point.family,
                    direction=direction,
                    case=name,
                    perturbation=config.perturbation
                    | combination.perturbation
                    | case.perturbation,
                    law=combination.law,
                    estimator=combination.estimator,
                    plant=plant,
                    seed=seed,
                    duration=(
                        config.duration if case.duration is None else case.duration
                    ),
                    dwell=config.dwell if case.dwell is None else case.dwell,
                    repeat=config.repeat if case.repeat is None else case.repeat,
                    settings=config.settings | combination.settings | case.settings,
                )


def row_key(robot: RobotParameters, rig: str, trial: Trial) -> str:
    """Return a digest of all that determines a row: the trial, the robot, the rig and
    the package's version.
    """
    return digest([dataclasses.asdict(trial), flatten(robot), rig, version()])[
        :KEY_LENGTH
    ]


def digest(content: object) -> str:
    """Return the SHA-256 of plain data, independent of the order of keys."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def version() -> str:
    """Return the version of the installed package."""
    try:
        return importlib.metadata.version("dextar")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


# Rooms that a row comes from.
NUMBERS = (
    "contract",
    "symbols",
    "mechanisms",
    "model",
    "planning",
    "estimation",
    "control",
    "identification",
)


def code_digest(rig: str, trial: str, own: Sequence[str] = ()) -> str:
    """Return a digest of the sources that a row's numbers come from: contract,
    mathematics, the trial, the rig's package and the user's own.

    Args:
        rig: ``module:Class``.
        trial: the module that runs a trial.
        own: laws and estimators of the user's own, ``module:attribute``.
    """
    home = Path(__file__).resolve().parents[2]
    sources = [source for room in NUMBERS for source in home.glob(f"{room}/*.py")]
    for module, whole_folder in (
        (trial, False),
        *((name.partition(":")[0], True) for name in (rig, *own)),
    ):
        spec = importlib.util.find_spec(module)
        if spec is not None and spec.origin is not None:
            origin = Path(spec.origin)
            packaged = whole_folder and "." in module
            sources += origin.parent.glob("*.py") if packaged else [origin]
    content = hashlib.sha256()
    for source in sorted(set(sources)):
        content.update(source.name.encode() + source.read_bytes())
    return content.hexdigest()[:KEY_LENGTH]
