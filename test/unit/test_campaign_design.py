"""The trials of a campaign: each once, paired in their random numbers, with keys of
their content.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import pytest

from dextar_control.contract.robot import RobotParameters
from dextar_control.experiments.campaign import design
from dextar_control.experiments.campaign.config import CampaignConfig, load_config
from dextar_control.experiments.campaign.design import (
    CrossingPoint,
    Trial,
    code_digest,
    digest,
    row_key,
    trials_of,
)
from dextar_control.experiments.campaign.selection import select

ROOT = Path(__file__).resolve().parents[2]
POINTS = [
    CrossingPoint((0.01, 0.1), (1, -1), "stretched"),
    CrossingPoint((0.0, 0.05), (-1, -1), "folded"),
]


@pytest.fixture
def config() -> CampaignConfig:
    return load_config(ROOT / "config" / "campaign_small.yaml")


@pytest.fixture
def trials(config: CampaignConfig) -> list[Trial]:
    return list(trials_of(config, POINTS))


def test_every_case_meets_every_combination_on_its_plants(
    config: CampaignConfig, trials: list[Trial]
) -> None:
    per_place = sum(
        len(case.plants or config.plants)
        * sum(
            one.estimator in (case.estimators or [one.estimator])
            for one in config.combinations
        )
        for case in config.cases.values()
    )
    assert (
        len(trials) == len(POINTS) * len(config.directions) * config.seeds * per_place
    )


def test_trials_of_one_place_follow_each_other(trials: list[Trial]) -> None:
    places = [trial.place for trial in trials]
    assert places == sorted(places, key=places.index)


def test_laws_and_cases_meet_the_same_random_numbers_and_places_do_not(
    config: CampaignConfig,
) -> None:
    seeds: dict[tuple[int, int], set[int]] = {}
    for trial in trials_of(config, POINTS):
        seeds.setdefault(trial.place, set()).add(trial.seed)
    assert all(len(found) == config.seeds for found in seeds.values())
    assert len(set.union(*seeds.values())) == len(seeds) * config.seeds
    others = {trial.seed for trial in trials_of(select(config, seed=1), POINTS)}
    assert not others & set.union(*seeds.values())


def test_the_numbers_of_a_case_go_before_those_of_its_pair_and_of_all(
    config: CampaignConfig,
) -> None:
    data = config.model_dump()
    data["perturbation"] = {"masses": 0.1, "jitter": 0.1, "sample_loss": 0.1}
    data["combinations"] = [
        {
            "law": "consistent",
            "estimator": "observer",
            "perturbation": {"jitter": 0.2, "sample_loss": 0.2},
        }
    ]
    data["cases"] = {"one": {"perturbation": {"sample_loss": 0.3}, "duration": 2.0}}
    trial = next(trials_of(CampaignConfig.model_validate(data), POINTS))
    assert trial.perturbation == {"masses": 0.1, "jitter": 0.2, "sample_loss": 0.3}
    assert (trial.duration, trial.dwell) == (2.0, config.dwell)


def test_keys_are_of_the_content_and_of_all_of_it(
    robot: RobotParameters, trials: list[Trial]
) -> None:
    keys = [row_key(robot, "a:Rig", trial) for trial in trials]
    assert len(set(keys)) == len(trials)
    first = trials[0]
    reversed_order = dataclasses.replace(
        first, perturbation=dict(reversed(list(first.perturbation.items())))
    )
    assert row_key(robot, "a:Rig", reversed_order) == keys[0]
    changes = {
        "index": 5,
        "point": (0.0, 0.0),
        "working_mode": (1, 1),
        "family": "folded",
        "direction": -1,
        "case": "other",
        "perturbation": {"masses": 0.11},
        "law": "classic",
        "estimator": "dgm",
        "plant": "cartesian",
        "seed": 1,
        "duration": 1.0,
        "dwell": 0.1,
        "repeat": 9,
        "settings": {"near_locus.fade_abs_s": 0.2},
    }
    assert changes.keys() == Trial.__dataclass_fields__.keys()
    for name, value in changes.items():
        assert (
            row_key(robot, "a:Rig", dataclasses.replace(first, **{name: value}))
            != keys[0]
        ), name
    assert row_key(robot, "another:Rig", first) != keys[0]
    assert row_key(robot.replace(end_effector_mass=0.051), "a:Rig", first) != keys[0]


def test_a_trial_is_plain_data(trials: list[Trial]) -> None:
    for trial in trials:
        assert json.loads(json.dumps(trial.columns())) == trial.columns()
        assert digest(dataclasses.asdict(trial))


def test_the_digest_of_the_code_sees_every_room_of_the_mathematics(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = Path(design.__file__).resolve().parents[2]
    shutil.copytree(
        home, tmp_path / "copy", ignore=shutil.ignore_patterns("__pycache__")
    )
    monkeypatch.setattr(
        design,
        "__file__",
        str(tmp_path / "copy" / "experiments" / "campaign" / "design.py"),
    )
    seen = {code_digest("dextar_sim.rig:Rig", "campaign_fake")}
    for room in (
        "contract",
        "symbols",
        "mechanisms",
        "model",
        "planning",
        "estimation",
        "control",
    ):
        source = sorted((tmp_path / "copy" / room).glob("*.py"))[-1]
        source.write_text(
            source.read_text(encoding="utf-8") + "# another number\n", encoding="utf-8"
        )
        seen.add(code_digest("dextar_sim.rig:Rig", "campaign_fake"))
    assert len(seen) == 8


def test_the_digest_of_the_code_sees_the_rigs_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "own_rig"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "rig.py").write_text("class Rig: pass\n")
    (package / "sensors.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    before = code_digest("own_rig.rig:Rig", "campaign_fake")
    assert code_digest("own_rig.rig:Rig", "campaign_fake") == before
    (package / "sensors.py").write_text("NOISE = 1.0\n")
    assert code_digest("own_rig.rig:Rig", "campaign_fake") != before
