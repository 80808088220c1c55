"""The campaign file: what it may hold, with one sentence for each mistake in it."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import (
    Field,
    FiniteFloat,
    ValidationInfo,
    field_validator,
    model_validator,
)

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.former_names import present_names, renamed_in_words
from dextar_control.contract.parameters import nearest_in_words
from dextar_control.contract.settings import SETTINGS
from dextar_control.contract.validation import Section, problem, unknown, validate
from dextar_control.contract.yaml_text import load_document
from dextar_control.experiments.campaign.ranges import BARS, PERTURBATIONS, Range

Item = TypeVar("Item")
Numbers = dict[str, Annotated[float, Field(allow_inf_nan=False)]]


class Points(Section):
    """Says how many crossing points there are, and how many of them with the distal
    links folded.
    """

    count: int = Field(ge=1, le=100_000)
    folded: int = Field(default=0, ge=0)

    @model_validator(mode="after")
    def _folded_among_all(self) -> Points:
        if self.folded > self.count:
            raise problem(
                f"folded = {self.folded} of count = {self.count}; it must be <= count"
            )
        return self


class Combination(Section):
    """Names a law with an estimator, and what only this pair gets."""

    law: str
    estimator: str
    perturbation: Numbers = {}
    settings: Numbers = {}

    @property
    def name(self) -> str:
        """Law and estimator in one word."""
        return f"{self.law}/{self.estimator}"


class Default(Section):
    """Names the combination and the plant that the bars are for; ``judged_plants``
    names others, or more.
    """

    law: str
    estimator: str
    plant: str


class Case(Section):
    """Describes one perturbation, and what the default combination, or those that it
    names, must reach under it.
    """

    title: str = ""
    perturbation: Numbers = {}
    settings: Numbers = {}
    duration: float | None = Field(default=None, gt=0.0, le=60.0, allow_inf_nan=False)
    dwell: float | None = Field(default=None, ge=0.0, le=60.0, allow_inf_nan=False)
    repeat: int | None = Field(default=None, ge=1, le=1000)
    plants: list[str] | None = Field(default=None, min_length=1)
    laws: list[str] | None = Field(default=None, min_length=1)
    estimators: list[str] | None = Field(default=None, min_length=1)
    bars: Numbers = {}
    judged: list[str] | None = Field(default=None, min_length=1)

    @field_validator("bars")
    @classmethod
    def _known_bars(cls, bars: Numbers) -> Numbers:
        return _within(bars, BARS, "bar")


class Sweep(Section):
    """Gives one number of the perturbation several levels, each a case named ``<sweep>
    <level>``.

    Attributes:
        number: of ``ranges.PERTURBATIONS``.
        levels: that it takes.
        unit, scale: in which a level times the scale is drawn.
        asked: the level up to which (of a stiffness: down to which) all is to be borne.
        perturbation, settings, duration: of all its cases.
    """

    title: str
    number: str
    levels: list[FiniteFloat] = Field(min_length=1)
    unit: str = ""
    scale: float = Field(default=1.0, gt=0.0, allow_inf_nan=False)
    asked: FiniteFloat | None = None
    perturbation: Numbers = {}
    settings: Numbers = {}
    duration: float | None = Field(default=None, gt=0.0, le=60.0, allow_inf_nan=False)

    @field_validator("number")
    @classmethod
    def _known_number(cls, number: str) -> str:
        _known(number, PERTURBATIONS, "perturbation")
        return number

    @field_validator("levels")
    @classmethod
    def _levels_once(cls, levels: list[float]) -> list[float]:
        _each_once([f"{level:g}" for level in levels], "level")
        return levels

    def shown(self, level: float) -> str:
        """Write a level as it is drawn, to three digits."""
        return f"{float(f'{level * self.scale:.3g}'):g}"

    def case(self, level: float) -> Case:
        """Return the case of one level."""
        title = f"{self.title} {self.shown(level)} {self.unit}".strip()
        numbers = self.perturbation | {self.number: level}
        return Case(
            title=title,
            perturbation=numbers,
            settings=self.settings,
            duration=self.duration,
        )


class CampaignConfig(Section):
    """Holds everything that a campaign is made of; the cases of its sweeps are among
    the cases.
    """

    robot: str
    rig: str
    seed: int = Field(default=0, ge=0, lt=2**32)
    seeds: int = Field(default=1, ge=1, le=10_000)
    points: Points
    directions: list[int] = Field(default=[1, -1], min_length=1)
    plants: list[str] = Field(min_length=1)
    combinations: list[Combination] = Field(min_length=1)
    default: Default
    judged_plants: list[str] | None = Field(default=None, min_length=1)
    duration: float = Field(gt=0.0, le=60.0, allow_inf_nan=False)
    dwell: float = Field(ge=0.0, le=60.0, allow_inf_nan=False)
    repeat: int = Field(default=1, ge=1, le=1000)
    perturbation: Numbers = {}
    settings: Numbers = {}
    sweeps: dict[str, Sweep] = {}
    cases: dict[str, Case] = Field(default={}, validate_default=True)

    @field_validator("cases")
    @classmethod
    def _with_sweeps(
        cls, cases: dict[str, Case], info: ValidationInfo
    ) -> dict[str, Case]:
        swept = {
            sweep_case(name, level): sweep.case(level)
            for name, sweep in info.data.get("sweeps", {}).items()
            for level in sweep.levels
        }
        if not cases and not swept:
            raise problem("it must have at least one of cases or sweeps")
        return swept | cases

    @field_validator("directions")
    @classmethod
    def _signs(cls, directions: list[int]) -> list[int]:
        for direction in directions:
            if direction not in (1, -1):
                raise problem(
                    f"direction {direction}; it must be 1 or -1, the sign of s after"
                    " the first crossing"
                )
        return _each_once(directions, "direction")

    @field_validator("plants")
    @classmethod
    def _plants_once(cls, plants: list[str]) -> list[str]:
        return _each_once(plants, "plant")

    @model_validator(mode="after")
    def _consistent(self) -> CampaignConfig:
        _each_once(
            [combination.name for combination in self.combinations], "combination"
        )
        sections: list[tuple[str, CampaignConfig | Combination | Case]] = [("", self)]
        sections += [
            (f"combination {combination.name}: ", combination)
            for combination in self.combinations
        ]
        sections += [(f"case {name}: ", case) for name, case in self.cases.items()]
        settings = {spec.name: spec for spec in SETTINGS if not spec.choices}
        for where, section in sections:
            _within(section.perturbation, PERTURBATIONS, "perturbation", where)
            for key in section.settings:
                if key not in settings:
                    near = nearest_in_words(key, [*settings.values()])
                    raise problem(f"{where}unknown setting '{key}'{near}")
        laws = list(dict.fromkeys(combination.law for combination in self.combinations))
        estimators = list(
            dict.fromkeys(combination.estimator for combination in self.combinations)
        )
        for plant in self.judged_plants or []:
            _known(plant, self.plants, "plant", "judged_plants: ")
        for name, case in self.cases.items():
            for chosen, known, what in (
                (case.plants, self.plants, "plant"),
                (case.laws, laws, "law"),
                (case.estimators, estimators, "estimator"),
                (
                    case.judged,
                    [combination.name for combination in self.combinations],
                    "combination",
                ),
            ):
                for item in chosen or []:
                    _known(item, known, what, f"case {name}: ")
        return self


def sweep_case(sweep: str, level: float) -> str:
    """Return the name of the case of one level of a sweep."""
    return f"{sweep} {level:g}"


def load_config(path: str | Path) -> CampaignConfig:
    """Load a campaign from its YAML file.

    Raises:
        ParameterError: the file cannot be read, or something in it is unknown, missing
            or out of its range.
    """
    document, source = load_document(path, "campaign file"), f"campaign file {path}"
    try:
        renamed = _take_present_names(document)
    except ParameterError as error:
        raise ParameterError(f"{source}: {error}") from error
    if renamed:
        warnings.warn(f"{source}: {renamed_in_words(renamed)}", stacklevel=2)
    return validate(CampaignConfig, document, source)


def _take_present_names(part: Any) -> dict[str, str]:
    """Put present names for former ones in all mappings ``settings`` of a document;
    those that were given, with the present ones.
    """
    renamed: dict[str, str] = {}
    if isinstance(part, list):
        for item in part:
            renamed |= _take_present_names(item)
    if isinstance(part, dict):
        for key, value in part.items():
            if key == "settings" and isinstance(value, dict):
                part[key], found = present_names(SETTINGS, value)
                renamed |= found
            else:
                renamed |= _take_present_names(value)
    return renamed


def _within(
    numbers: Numbers, ranges: Mapping[str, Range], what: str, where: str = ""
) -> Numbers:
    for key, value in numbers.items():
        _known(key, ranges, what, where)
        low, high = ranges[key][:2]
        if not low <= value <= high:
            raise problem(
                f"{where}{what} {key} = {value:g}; it must lie in [{low:g}, {high:g}]"
            )
    return numbers


def _known(name: str, known: Collection[str], what: str, where: str = "") -> None:
    if name not in known:
        raise problem(f"{where}{unknown(name, known, what)}")


def _each_once(items: list[Item], what: str) -> list[Item]:
    for item in items:
        if items.count(item) > 1:
            raise problem(
                f"{what} {item} stands there {items.count(item)} times; it must be"
                " there once"
            )
    return items
