"""The campaign file: what it may hold, and one sentence for each mistake in it."""

from __future__ import annotations

import importlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator
from pydantic_core import PydanticCustomError

from dextar_control.campaign.ranges import BARS, PERTURBATIONS, Range
from dextar_control.contract.errors import ParameterError
from dextar_control.contract.resources import config_file, node_defaults

Share = Annotated[float, Field(allow_inf_nan=False)]
Numbers = dict[str, Share]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            raise _problem(f"it must be a mapping with some of: {', '.join(cls.model_fields)}")
        for key in data:
            if key not in cls.model_fields:
                raise _problem(f"unknown key '{key}'; known are: {', '.join(cls.model_fields)}")
        return data


class Points(_Section):
    """How many crossing points, and how many of them with the distal links folded."""

    count: int = Field(ge=1, le=100_000)
    folded: int = Field(default=0, ge=0)

    @model_validator(mode="after")
    def _folded_among_all(self) -> Points:
        if self.folded > self.count:
            raise _problem(f"folded = {self.folded} of count = {self.count}; it must be <= count")
        return self


class Combination(_Section):
    """A law with an estimator, and what only this pair gets."""

    law: str
    estimator: str
    perturbation: Numbers = {}
    settings: dict[str, float | str] = {}

    @property
    def name(self) -> str:
        """Law and estimator in one word."""
        return f"{self.law}/{self.estimator}"


class Default(_Section):
    """The combination and the plant that the bars are for."""

    law: str
    estimator: str
    plant: str


class Case(_Section):
    """One perturbation, and what the default combination must reach under it."""

    title: str = ""
    perturbation: Numbers = {}
    settings: dict[str, float | str] = {}
    duration: float | None = Field(default=None, gt=0.0, le=60.0, allow_inf_nan=False)
    dwell: float | None = Field(default=None, ge=0.0, le=60.0, allow_inf_nan=False)
    repeat: int | None = Field(default=None, ge=1, le=1000)
    plants: list[str] | None = Field(default=None, min_length=1)
    laws: list[str] | None = Field(default=None, min_length=1)
    estimators: list[str] | None = Field(default=None, min_length=1)
    bars: Numbers = {}

    @field_validator("bars")
    @classmethod
    def _known_bars(cls, bars: Numbers) -> Numbers:
        return _within(bars, BARS, "bar")


class CampaignConfig(_Section):
    """Everything a campaign is made of."""

    robot: str
    rig: str
    seed: int = Field(default=0, ge=0, lt=2**32)
    seeds: int = Field(default=1, ge=1, le=10_000)
    points: Points
    directions: list[int] = Field(default=[1, -1], min_length=1)
    plants: list[str] = Field(min_length=1)
    combinations: list[Combination] = Field(min_length=1)
    default: Default
    duration: float = Field(gt=0.0, le=60.0, allow_inf_nan=False)
    dwell: float = Field(ge=0.0, le=60.0, allow_inf_nan=False)
    repeat: int = Field(default=1, ge=1, le=1000)
    perturbation: Numbers = {}
    settings: dict[str, float | str] = {}
    cases: dict[str, Case] = Field(min_length=1)

    @field_validator("directions")
    @classmethod
    def _signs(cls, directions: list[int]) -> list[int]:
        for direction in directions:
            if direction not in (1, -1):
                raise _problem(f"direction {direction}; it must be 1 or -1, the sign of s after the first crossing")
        return _each_once(directions, "direction")

    @field_validator("plants")
    @classmethod
    def _plants_once(cls, plants: list[str]) -> list[str]:
        return _each_once(plants, "plant")

    @model_validator(mode="after")
    def _consistent(self) -> CampaignConfig:
        _each_once([combination.name for combination in self.combinations], "combination")
        sections: list[tuple[str, CampaignConfig | Combination | Case]] = [("", self)]
        sections += [(f"combination {combination.name}: ", combination) for combination in self.combinations]
        sections += [(f"case {name}: ", case) for name, case in self.cases.items()]
        settings = set(node_defaults("controller", config_file("crossing.yaml")))
        for where, section in sections:
            _within(section.perturbation, PERTURBATIONS, f"{where}perturbation")
            for key in section.settings:
                _known(key, settings, f"{where}setting")
        for name, case in self.cases.items():
            for plant in case.plants or []:
                _known(plant, self.plants, f"case {name}: plant")
            for law in case.laws or []:
                _known(law, {combination.law for combination in self.combinations}, f"case {name}: law")
            for estimator in case.estimators or []:
                _known(estimator, {combination.estimator for combination in self.combinations}, f"case {name}: estimator")
        return self


def load_config(path: str | Path) -> CampaignConfig:
    """A campaign from its YAML file.

    Raises:
        ParameterError: the file cannot be read, or something in it is unknown, missing or out of its range.
    """
    try:
        document = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ParameterError(f"campaign file {path}: {error.strerror or error}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ParameterError(f"campaign file {path}: {' '.join(str(error).split())}") from error
    return _validated(document, f"campaign file {path}")


def select(
    config: CampaignConfig,
    *,
    seed: int | None = None,
    points: int | None = None,
    cases: list[str] | None = None,
    laws: list[str] | None = None,
    estimators: list[str] | None = None,
) -> CampaignConfig:
    """A campaign with what the command line changes; with both laws and estimators each law meets each estimator.

    Raises:
        ParameterError: a case is not of this campaign, or nothing is left to run.
    """
    data = config.model_dump()
    if seed is not None:
        data["seed"] = seed
    if points is not None:
        data["points"] = {"count": points, "folded": min(round(config.points.folded / config.points.count * points), points)}
    if cases is not None:
        for case in cases:
            _known(case, config.cases, "case", ParameterError)
        data["cases"] = {name: data["cases"][name] for name in config.cases if name in cases}
    if laws is not None and estimators is not None:
        known = {combination.name: combination.model_dump() for combination in config.combinations}
        pairs = [(law, estimator) for law in laws for estimator in estimators]
        data["combinations"] = [known.get(f"{law}/{estimator}", {"law": law, "estimator": estimator}) for law, estimator in pairs]
    else:
        for key, wanted in (("law", laws), ("estimator", estimators)):
            for name in wanted or []:
                _known(name, {combination[key] for combination in data["combinations"]}, key, ParameterError)
            if wanted is not None:
                data["combinations"] = [item for item in data["combinations"] if item[key] in wanted]
    for key in ("law", "estimator"):
        left = {item[key] for item in data["combinations"]}
        for case in data["cases"].values():
            if case[f"{key}s"] is not None:
                case[f"{key}s"] = [name for name in case[f"{key}s"] if name in left]
        data["cases"] = {name: case for name, case in data["cases"].items() if case[f"{key}s"] != []}
    if not data["cases"]:
        raise ParameterError("none of the cases has a law and an estimator among those chosen")
    return _validated(data, "command line")


def check_names(config: CampaignConfig, laws: Collection[str], estimators: Collection[str], plants: Collection[str]) -> None:
    """Raise for a law, an estimator or a plant that does not exist."""
    for law in [combination.law for combination in config.combinations] + [config.default.law]:
        _known(law, laws, "law", ParameterError)
    for estimator in [combination.estimator for combination in config.combinations] + [config.default.estimator]:
        _known(estimator, estimators, "estimator", ParameterError)
    for plant in [*config.plants, config.default.plant]:
        _known(plant, plants, "plant", ParameterError)


def resolve(name: str) -> Any:
    """What ``module:attribute`` names.

    Raises:
        ParameterError: there is no such module or attribute.
    """
    module, _, attribute = name.partition(":")
    if not module or not attribute:
        raise ParameterError(f"rig '{name}'; it must be of the form module:Class")
    try:
        return getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ParameterError(f"rig '{name}' cannot be loaded: {error}") from error


def _validated(data: Any, source: str) -> CampaignConfig:
    try:
        return CampaignConfig.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"] if part not in ("float", "str"))
        if first["type"] == "dextar":
            said = first["msg"]
        elif first["type"] == "missing":
            said = "it is missing"
        else:
            said = f"{first['input']!r} is not valid: {first['msg'][0].lower()}{first['msg'][1:]}"
        raise ParameterError(f"{source}: {where}: {said}" if where else f"{source}: {said}") from error


def _problem(text: str) -> PydanticCustomError:
    return PydanticCustomError("dextar", "{text}", {"text": text})


def _within(numbers: Numbers, ranges: Mapping[str, Range], what: str) -> Numbers:
    for key, value in numbers.items():
        _known(key, ranges, what)
        low, high, _ = ranges[key]
        if not low <= value <= high:
            raise _problem(f"{what} {key} = {value:g}; it must lie in [{low:g}, {high:g}]")
    return numbers


def _known(name: str, known: Collection[str], what: str, error: type[Exception] | None = None) -> None:
    if name not in known:
        said = f"unknown {what} '{name}'; known are: {', '.join(known if isinstance(known, (list, dict)) else sorted(known))}"
        raise error(said) if error else _problem(said)


def _each_once(items: list[Any], what: str) -> list[Any]:
    for item in items:
        if items.count(item) > 1:
            raise _problem(f"{what} {item} stands there {items.count(item)} times; it must be there once")
    return items


def names(text: str | None) -> list[str] | None:
    """The names of a comma-separated argument."""
    return None if text is None else [item.strip() for item in text.split(",") if item.strip()]
