"""The scripts in ``examples/``: each is short, runs by itself and says what it found."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import biglide
import numpy as np
import pytest

from dextar_control.model.model import Model
from dextar_control.model.robot import Robot

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
MOST_LINES = 60
FOUND = {
    "crossing.py": r"says: crossed, crossed; .* HOLD\nlargest true error 0\.0",
    "tour.py": r"\n6 crossings in .* of 0\.3 N m\ndrawn in tour\.png",
    "read_bag.py": r"crossing 2: crossed, error .* mm at most\n.*law consistent",
    "own_law.py": r"own_law:damped:\nthe estimator says: crossed, crossed; .* HOLD",
    "own_mechanism.py": r"says: crossed, crossed; .* HOLD\nlargest true error 0\.0.* N\n",
    "own_estimator.py": r"Luenberger:\nthe estimator says: undecided, undecided; .* HOLD",
}
STATES = 20
RELATIVE = 1e-9  # two exact formulations in float64


def test_the_examples_are_these() -> None:
    assert {file.name for file in EXAMPLES.glob("*.py")} == set(FOUND)


@pytest.mark.parametrize("name", FOUND)
def test_an_example_is_short(name: str) -> None:
    lines = (EXAMPLES / name).read_text(encoding="utf-8").splitlines()
    assert len(lines) <= MOST_LINES, f"{name} has {len(lines)} lines"


@pytest.mark.parametrize("name", FOUND)
def test_an_example_runs_by_itself(name: str, good: Path, tmp_path: Path) -> None:
    given = [str(good)] if name == "read_bag.py" else []
    answer = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *given],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert answer.returncode == 0, answer.stderr
    assert re.search(FOUND[name], answer.stdout), answer.stdout


def test_the_mechanism_of_ones_own_is_a_biglide(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its equations, by defaults of ``Mechanism``, are those of the full one, which has
    an oracle of its own.
    """
    monkeypatch.syspath_prepend(str(EXAMPLES))
    import own_mechanism as own

    limits = {"min_type1_distance": 0.1, **own.LIMITS}
    plain = Model.of(Robot.of(own.Biglide(), {**own.NUMBERS, **limits}))
    mass, bar = own.NUMBERS["tip_mass"], own.NUMBERS["bar_mass"]
    full = biglide.ROBOT.replace(point_mass=mass).replace(
        **{
            f"{leg}.{name}": value
            for leg, x, length in zip(
                ("left", "right"),
                own.NUMBERS["rails"],
                own.NUMBERS["bars"],
                strict=True,
            )
            for name, value in (
                ("rail_origin", [x, 0.0]),
                ("rail_angle", np.pi / 2),
                ("bar_length", length),
                ("bar_mass", bar),
                ("slider_mass", mass),
            )
        }
    )
    other, generator = Model.of(full), np.random.default_rng(0)
    for _ in range(STATES):
        x, x_dot = generator.uniform(-0.05, 0.05, 2), generator.normal(0.0, 1.0, 2)
        tau, q_a = generator.normal(0.0, 5.0, 2), other.place(x).q_a
        np.testing.assert_allclose(plain.place(x).q_a, q_a, rtol=RELATIVE)
        np.testing.assert_allclose(
            plain.place(x).type1, other.place(x).type1, rtol=1e-6
        )
        np.testing.assert_allclose(plain.place(x).s, other.place(x).s, rtol=RELATIVE)
        found, expected = (
            model.platform_dynamics(q_a, x, x_dot, tau).x_ddot
            for model in (plain, other)
        )
        scale = np.abs(expected).max()
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=RELATIVE * scale)
        q_a = plain.inverse_geometric_model(x)
        closed = plain.close(q_a, float(np.sign(plain.place(x).s[0])), x + 1e-3)
        np.testing.assert_allclose(closed, x, rtol=0.0, atol=1e-9)


def test_law_and_estimator_of_ones_own_serve_the_real_nodes_in_lockstep(
    tmp_path: Path,
) -> None:
    command = [
        *(sys.executable, "-m", "dextar_control.cli.main", "demo", "--lockstep"),
        *("--law", "own_law:damped", "--estimator", "own_estimator:Luenberger"),
        *("--output", str(tmp_path)),
    ]
    paths = str(EXAMPLES), os.environ.get("PYTHONPATH")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    answer = subprocess.run(
        command,
        cwd=EXAMPLES.parent,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr
    metrics = json.loads((tmp_path / "latest" / "metrics.json").read_text())
    assert metrics["law"] == "own_law:damped"
    assert metrics["estimator"] == "own_estimator:Luenberger"
    assert [crossing["outcome"] for crossing in metrics["crossings"]] == 2 * ["crossed"]
