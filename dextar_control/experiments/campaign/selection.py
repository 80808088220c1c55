"""Change a campaign as the command line asks, and check that the names in it exist."""

from __future__ import annotations

from collections.abc import Collection

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.plug_in import chosen, is_own
from dextar_control.contract.validation import unknown, validate
from dextar_control.experiments.campaign.config import CampaignConfig, sweep_case


def select(
    config: CampaignConfig,
    *,
    seed: int | None = None,
    points: int | None = None,
    cases: list[str] | None = None,
    laws: list[str] | None = None,
    estimators: list[str] | None = None,
) -> CampaignConfig:
    """Return a campaign with what the command line changes; with both laws and
    estimators each law meets each estimator.

    Raises:
        ParameterError: a case is not of this campaign, or nothing is left to run.
    """
    data = config.model_dump()
    if seed is not None:
        data["seed"] = seed
    if points is not None:
        data["points"] = {
            "count": points,
            "folded": min(
                round(config.points.folded / config.points.count * points), points
            ),
        }
    if cases is not None:
        for case in cases:
            _check(case, config.cases, "case")
        data["cases"] = {
            name: data["cases"][name] for name in config.cases if name in cases
        }
        for name, sweep in config.sweeps.items():
            data["sweeps"][name]["levels"] = [
                level for level in sweep.levels if sweep_case(name, level) in cases
            ]
        data["sweeps"] = {
            name: sweep for name, sweep in data["sweeps"].items() if sweep["levels"]
        }
    if laws is not None and estimators is not None:
        known = {
            combination.name: combination.model_dump()
            for combination in config.combinations
        }
        data["combinations"] = [
            known.get(f"{law}/{estimator}", {"law": law, "estimator": estimator})
            for law in laws
            for estimator in estimators
        ]
    else:
        for key, wanted in (("law", laws), ("estimator", estimators)):
            for name in wanted or []:
                _check(
                    name,
                    {combination[key] for combination in data["combinations"]},
                    key,
                )
            if wanted is not None:
                data["combinations"] = [
                    item for item in data["combinations"] if item[key] in wanted
                ]
    for key in ("law", "estimator"):
        left = {item[key] for item in data["combinations"]}
        for case in data["cases"].values():
            if case[f"{key}s"] is not None:
                case[f"{key}s"] = [name for name in case[f"{key}s"] if name in left]
        data["cases"] = {
            name: case for name, case in data["cases"].items() if case[f"{key}s"] != []
        }
    pairs = {f"{item['law']}/{item['estimator']}" for item in data["combinations"]}
    for case in data["cases"].values():
        case["judged"] = [
            name for name in case["judged"] or [] if name in pairs
        ] or None
    if not data["cases"]:
        raise ParameterError(
            "none of the cases has a law and an estimator among those chosen"
        )
    return validate(CampaignConfig, data, "command line")


def check_names(
    config: CampaignConfig,
    laws: Collection[str],
    estimators: Collection[str],
    plants: Collection[str],
) -> None:
    """Raise for a law, an estimator or a plant that does not exist; a law or an
    estimator of one's own is loaded.
    """
    pairs = _pairs(config)
    for what, found, known in (
        ("law", {law for law, _ in pairs}, laws),
        ("estimator", {estimator for _, estimator in pairs}, estimators),
    ):
        for name in sorted(found):
            if is_own(name):
                chosen(what, name, {})
            else:
                _check(name, known, what)
    for plant in [*config.plants, config.default.plant]:
        _check(plant, plants, "plant")


def own_names(config: CampaignConfig) -> tuple[str, ...]:
    """Laws and estimators of a campaign that are its user's own."""
    return tuple(
        sorted({name for pair in _pairs(config) for name in pair if is_own(name)})
    )


def _pairs(config: CampaignConfig) -> list[tuple[str, str]]:
    default = config.default.law, config.default.estimator
    return [*((one.law, one.estimator) for one in config.combinations), default]


def _check(name: str, known: Collection[str], what: str) -> None:
    if name not in known:
        raise ParameterError(unknown(name, known, what))


def names(text: str | None) -> list[str] | None:
    """Split a comma-separated argument into its names."""
    return (
        None
        if text is None
        else [item.strip() for item in text.split(",") if item.strip()]
    )
