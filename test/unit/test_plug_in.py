"""Laws, estimators and mechanisms of one's own: found by ``module:attribute``, refused in
one sentence, and the same for the loop, the nodes and the campaign.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.parameters import check_value
from dextar_control.contract.plug_in import chosen
from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.settings import SETTINGS, default_settings
from dextar_control.control.law import LAWS
from dextar_control.control.loop import ControlLoop
from dextar_control.estimation.estimator import ESTIMATORS
from dextar_control.experiments.campaign.design import code_digest
from dextar_control.experiments.campaign.selection import check_names, own_names
from dextar_control.mechanisms import MECHANISMS, mechanism_named

ROOT = Path(__file__).resolve().parents[2]
OWN = """
from dextar_control.control.law import Answer
from dextar_control.estimation.estimate import Estimator

NUMBER = 3

def law(asked):
    e = asked.here(asked.u)
    return Answer(e.inverse_dynamics, e)

def fails(asked):
    return asked.nothing

def short(asked):
    return law(asked)._replace(tau=asked.u[0])

class Half(Estimator):
    pass

class NoEstimator:
    def __init__(self, *arguments):
        pass
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of a module ``of_ones_own``."""
    file = tmp_path / "of_ones_own.py"
    file.write_text(OWN, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "of_ones_own", raising=False)
    return file


@pytest.fixture
def examples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "examples"))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("best", "law = 'best'; it must be one of classic, .*, or module:attribute of"),
        ("of_ones_own", "law = 'of_ones_own'; it must be one of classic"),
        (":law", "law = ':law'; it must be one of classic"),
        ("of_ones_own:no", "law = 'of_ones_own:no' cannot be loaded: AttributeError"),
        ("nowhere:law", "No module named 'nowhere'; PYTHONPATH has to name the folder"),
        ("of_ones_own:NUMBER", "is of type int; it must be a function or a class"),
    ],
)
def test_a_name_that_is_none_is_told_with_those_there_are(
    own: Path, name: str, said: str
) -> None:
    with pytest.raises(ParameterError, match=said):
        chosen("law", name, LAWS)


def test_a_module_that_fails_is_told(own: Path) -> None:
    own.write_text("1 / 0", encoding="utf-8")
    with pytest.raises(ParameterError, match="cannot be loaded: ZeroDivisionError"):
        chosen("law", "of_ones_own:law", LAWS)


@pytest.mark.parametrize("name", ["law", "estimator"])
def test_a_node_takes_a_name_of_ones_own_and_no_misspelt_one(name: str) -> None:
    (spec,) = (spec for spec in SETTINGS if spec.name == name)
    assert check_value(spec, "my_lab.laws:mine", "") == "my_lab.laws:mine"
    with pytest.raises(
        ParameterError, match=f"parameter '{name}' = 'mine'; it must be"
    ):
        check_value(spec, "mine", "")
    with pytest.raises(ParameterError, match=f"{name} = 'mine'; it must be one of"):
        default_settings(**{name: "mine"})


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"law": "of_ones_own:fails"}, "fails as its equations are built: Attribute"),
        ({"law": "of_ones_own:short"}, r"answers tau of shape \(1, 1\), e of type"),
        ({"estimator": "of_ones_own:Half"}, "cannot be made: TypeError: .* abstract"),
        ({"estimator": "of_ones_own:NoEstimator"}, "makes a NoEstimator; it must be"),
    ],
)
def test_a_loop_refuses_what_is_no_law_or_estimator(
    robot: RobotParameters, own: Path, settings: dict[str, Any], said: str
) -> None:
    with pytest.raises(ParameterError, match=said):
        ControlLoop(robot, default_settings(**settings), 1)


def test_a_law_of_ones_own_that_says_what_ours_says_answers_the_same(
    robot: RobotParameters, own: Path, q_a: np.ndarray
) -> None:
    torques = []
    for law in ("classic", "of_ones_own:law"):
        loop = ControlLoop(robot, default_settings(law=law), 1)
        steps = [loop.step(1e-3 * k, q_a + 1e-4 * k) for k in range(20)]
        torques.append(np.array(steps))
    np.testing.assert_array_equal(torques[0], torques[1])
    assert np.abs(torques[0]).max() > 0.0


def test_a_loop_may_change_to_a_law_of_ones_own_and_back(
    robot: RobotParameters, own: Path, q_a: np.ndarray
) -> None:
    loop = ControlLoop(robot, default_settings(), 1)
    for k, law in enumerate(("consistent", "of_ones_own:law", "consistent")):
        loop.configure(default_settings(law=law))
        assert np.isfinite(loop.step(1e-3 * k, q_a)).all()


def test_a_robots_file_names_a_mechanism_of_ones_own(examples: None, own: Path) -> None:
    name = "own_mechanism:Biglide"
    assert mechanism_named(name).name == "biglide"
    assert mechanism_named(name) is mechanism_named(name)
    with pytest.raises(ParameterError, match=f"one of {', '.join(MECHANISMS)}, or"):
        mechanism_named("hexapod")
    with pytest.raises(ParameterError, match="derived from mechanisms.mechanism"):
        mechanism_named("of_ones_own:NoEstimator")


class Names:
    """A campaign's names of laws and estimators."""

    def __init__(self, *pairs: tuple[str, str]) -> None:
        self.combinations = [type("", (), {"law": a, "estimator": b}) for a, b in pairs]
        self.default, self.plants = self.combinations[0], ["cartesian"]
        self.default.plant = "cartesian"


def test_a_campaign_takes_them_and_a_row_depends_on_their_text(own: Path) -> None:
    config: Any = Names(("of_ones_own:law", "observer"), ("classic", "dgm"))
    wrong: Any = Names(("classic", "nowhere:Half"))
    check_names(config, LAWS, ESTIMATORS, ["cartesian"])
    assert own_names(config) == ("of_ones_own:law",)
    with pytest.raises(ParameterError, match="estimator = 'nowhere:Half' cannot be"):
        check_names(wrong, LAWS, ESTIMATORS, ["cartesian"])
    rig, trial = "dextar_sim.rig:Rig", "dextar_control.experiments.campaign.trial"
    digests = [code_digest(rig, trial), code_digest(rig, trial, own_names(config))]
    own.write_text(f"{OWN}\n# changed\n", encoding="utf-8")
    digests.append(code_digest(rig, trial, own_names(config)))
    assert len(set(digests)) == 3
