"""A campaign file says what it means, and each mistake in it gets one sentence with the
value and the limit.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from dextar_control.contract.errors import ParameterError
from dextar_control.experiments.campaign.config import CampaignConfig, load_config
from dextar_control.experiments.campaign.ranges import BARS
from dextar_control.experiments.campaign.rig import resolve
from dextar_control.experiments.campaign.selection import check_names, names, select
from dextar_control.experiments.campaign.summary import Group

ROOT = Path(__file__).resolve().parents[2]
CAMPAIGNS = sorted((ROOT / "config").glob("campaign*.yaml")) + [
    ROOT / "config" / "rig.yaml"
]
SMALL = ROOT / "config" / "campaign_small.yaml"
SWEEP = {"title": "belt", "number": "belt", "levels": [150, 50]}


def changed(**changes: Any) -> dict[str, Any]:
    """The small campaign's document with values replaced at dotted keys; None
    removes.
    """
    document = yaml.safe_load(SMALL.read_text(encoding="utf-8"))
    for path, value in changes.items():
        *parents, last = path.split("__")
        section = document
        for parent in parents:
            section = section[parent]
        if value is None:
            del section[last]
        else:
            section[last] = value
    return document


def loaded(tmp_path: Path, document: Any) -> CampaignConfig:
    path = tmp_path / "campaign.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return load_config(path)


@pytest.mark.parametrize("path", CAMPAIGNS, ids=lambda path: path.stem)
def test_shipped_campaigns_are_valid_and_their_default_is_among_what_they_run(
    path: Path,
) -> None:
    config = load_config(path)
    assert (config.default.law, config.default.estimator) in [
        (one.law, one.estimator) for one in config.combinations
    ]
    assert config.default.plant in config.plants
    assert any(case.bars for case in config.cases.values())


def test_the_big_campaign_is_as_large_as_the_claims() -> None:
    config = load_config(ROOT / "config" / "campaign.yaml")
    assert config.points.count >= 40
    assert config.points.folded >= 8
    assert (
        2 * (config.cases["nominal"].repeat or config.repeat) == 10
    )  # crossings in a row, both ways in turn


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"points__count": 0}, "points.count: 0 is not valid"),
        (
            {"points": {"count": 8, "folded": 9}},
            "folded = 9 of count = 8; it must be <= count",
        ),
        ({"directions": [1, 2]}, "direction 2; it must be 1 or -1"),
        ({"directions": [1, 1]}, "direction 1 stands there 2 times"),
        (
            {"duration": -0.3},
            "duration: -0.3 is not valid: input should be greater than 0",
        ),
        ({"duration": "fast"}, "duration: 'fast' is not valid"),
        ({"duration": float("nan")}, "duration: nan is not valid"),
        ({"duration": None}, "duration: it is missing"),
        ({"seed": True}, "seed: True is not valid"),
        ({"speed": 3}, "unknown key 'speed'; known are: robot, rig, seed"),
        ({"cases__masses__color": "red"}, "cases.masses: unknown key 'color'"),
        (
            {"cases__masses__perturbation": {"mases": 0.1}},
            "case masses: unknown perturbation 'mases'; known are: masses",
        ),
        (
            {"cases__masses__perturbation": {"masses": 1.5}},
            "case masses: perturbation masses = 1.5; it must lie in [0, 0.9]",
        ),
        (
            {"cases__masses__bars": {"min_succes": 1.0}},
            "unknown bar 'min_succes'; known are: min_success",
        ),
        (
            {"cases__masses__bars": {"min_success": 98}},
            "bar min_success = 98; it must lie in [0, 1]",
        ),
        (
            {"cases__masses__plants": ["mujoco"]},
            "case masses: unknown plant 'mujoco'; known are: pybullet, cartesian",
        ),
        (
            {"cases__masses__settings": {"zoen": 0.1}},
            "case masses: unknown setting 'zoen'",
        ),
        (
            {"cases__masses__settings": {"law": "classic"}},
            "cases.masses.settings.law: 'classic' is not valid",
        ),
        ({"settings": {"law": 0.0}}, "unknown setting 'law'"),
        ({"settings": {"assembly_mode": -1.0}}, "unknown setting 'assembly_mode'"),
        (
            {"settings": {"near_locus.fade_abs_s": "wide"}},
            "settings.near_locus.fade_abs_s: 'wide' is not valid",
        ),
        (
            {"cases__bounced__estimators": ["dgn"]},
            "case bounced: unknown estimator 'dgn'",
        ),
        (
            {"cases__bounced__judged": ["consistent"]},
            "case bounced: unknown combination 'consistent'",
        ),
        ({"cases": {}}, "cases: it must have at least one of cases or sweeps"),
        (
            {"sweeps": {"belt": SWEEP | {"levels": [50, 50]}}},
            "sweeps.belt.levels: level 50 stands there 2 times",
        ),
        (
            {"sweeps": {"belt": SWEEP | {"levels": [float("nan")]}}},
            "sweeps.belt.levels.0: nan is not valid",
        ),
        (
            {"sweeps": {"belt": SWEEP | {"scale": 0.0}}},
            "sweeps.belt.scale: 0.0 is not valid",
        ),
        ({"default__plant": None}, "default.plant: it is missing"),
    ],
    ids=str,
)
def test_a_mistake_gets_one_sentence(
    tmp_path: Path, changes: dict[str, Any], said: str
) -> None:
    with pytest.raises(ParameterError) as caught:
        loaded(tmp_path, changed(**changes))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: [", "campaign file"),
        ("- 1", "it must be a mapping"),
        ("", "it must be a mapping"),
    ],
)
def test_a_file_that_is_no_campaign_gets_one_sentence(
    tmp_path: Path, text: str, said: str
) -> None:
    path = tmp_path / "broken.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ParameterError, match=said) as caught:
        load_config(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"nowhere\.yaml: No such file"):
        load_config(tmp_path / "nowhere.yaml")


def test_names_that_do_not_exist_are_refused_with_those_that_do() -> None:
    config = load_config(SMALL)
    laws, estimators = (
        ["consistent", "projected", "classic"],
        ["observer", "dgm", "plain"],
    )
    check_names(config, laws, estimators, ["pybullet", "cartesian"])
    with pytest.raises(
        ParameterError, match="unknown law 'classic'; known are: consistent, projected"
    ):
        check_names(config, laws[:2], estimators, ["pybullet", "cartesian"])
    with pytest.raises(
        ParameterError, match="unknown estimator 'dgm'; known are: observer"
    ):
        check_names(config, laws, estimators[:1], ["pybullet", "cartesian"])
    with pytest.raises(
        ParameterError, match="unknown plant 'cartesian'; known are: pybullet"
    ):
        check_names(config, laws, estimators, ["pybullet"])


@pytest.mark.parametrize(
    "name", ["nowhere:Rig", "dextar_control:Nothing", "dextar_control", ":Rig"]
)
def test_a_rig_that_cannot_be_loaded_is_named(name: str) -> None:
    with pytest.raises(ParameterError, match=f"rig = '{name}'"):
        resolve(name)


def test_the_command_line_selects() -> None:
    config = load_config(SMALL)
    chosen = select(
        config,
        seed=7,
        points=4,
        cases=["delay", "nominal"],
        laws=["consistent", "classic"],
    )
    assert (chosen.seed, chosen.points.count, chosen.points.folded) == (7, 4, 1)
    assert list(chosen.cases) == ["nominal", "delay"]
    assert [one.name for one in chosen.combinations] == [
        "consistent/observer",
        "classic/plain",
    ]


def test_laws_with_estimators_make_every_pair_and_keep_what_the_file_says_of_one() -> (
    None
):
    config = load_config(ROOT / "config" / "campaign.yaml")
    chosen = select(config, laws=["consistent", "classic"], estimators=["external"])
    assert [one.name for one in chosen.combinations] == [
        "consistent/external",
        "classic/external",
    ]
    assert chosen.combinations[0].perturbation["pose_rate"] > 0.0


def test_a_case_for_other_estimators_is_left_out() -> None:
    config = load_config(SMALL)
    assert "bounced" not in select(config, estimators=["dgm"]).cases
    with pytest.raises(ParameterError, match="none of the cases"):
        select(config, cases=["bounced"], estimators=["dgm"])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            {"cases": ["masses", "mass"]},
            "unknown case 'mass'; known are: nominal, masses",
        ),
        ({"laws": ["best"]}, "unknown law 'best'"),
        ({"points": 0}, "points.count: 0"),
        ({"seed": -1}, "seed: -1"),
    ],
    ids=str,
)
def test_a_mistake_on_the_command_line_gets_one_sentence(
    arguments: dict[str, Any], said: str
) -> None:
    with pytest.raises(ParameterError) as caught:
        select(load_config(SMALL), **arguments)
    assert said in str(caught.value)


def test_names_are_split_at_commas() -> None:
    assert names(None) is None
    assert names("a, b,") == ["a", "b"]


def test_every_bar_has_something_that_measures_it() -> None:
    assert {bar.measure for bar in BARS.values()} <= set(Group.__dataclass_fields__)
