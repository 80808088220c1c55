"""What the demo's nodes would refuse at their start is refused before any of them is
started.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from dextar_control.cli import main as cli
from dextar_control.contract.resources import NODES_FILE, ROBOT_FILE, config_file
from dextar_control.contract.robot import flatten, load_robot, robot_text
from dextar_control.experiments import demo
from dextar_control.model.model import Model


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the nodes that would have been started; their start is refused as
    soon as it is waited for.
    """
    names: list[str] = []

    def refuse(*_: object) -> None:
        raise demo.NodesError("the trajectory server: there is no trip")

    monkeypatch.setattr(
        demo,
        "monitoring",
        lambda _: contextlib.nullcontext(SimpleNamespace()),
    )
    monkeypatch.setattr(demo.Processes, "start", lambda _, name, __: names.append(name))
    monkeypatch.setattr(demo, "_wait_until_ready", refuse)
    return names


def unfinished(*_: object) -> None:
    """A law or an estimator of a user's that cannot be built."""
    raise ValueError("not finished")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ("--duration", "-1"),
            "trajectory_server: parameter 'task.duration' = -1.0; it must be >= 0",
        ),
        (
            ("--duration", "nan"),
            "trajectory_server: parameter 'task.duration' = nan; it must be finite",
        ),
        (
            ("--duration", "0.001"),
            "trajectory_server: task.duration = 0.001 s; it must be 0 or >= 0.02",
        ),
        (
            ("--repeat", "0"),
            "trajectory_server: parameter 'task.repeat' = 0; it must be >= 1",
        ),
        (
            ("--tour", "-1001"),
            "trajectory_server: parameter 'task.tour' = -1001; it must be >= -1000",
        ),
        (
            ("--tour", "1001"),
            "trajectory_server: parameter 'task.tour' = 1001; it must be <= 1000",
        ),
        (
            ("-p", "trajectory_server.task.dwell:=0"),
            "trajectory_server: parameter 'task.dwell' = 0; it must be >= 0.01",
        ),
        (
            ("--tour", "2", "-p", "trajectory_server.task.point:=[0.0, 0.08]"),
            "are given; one may be",
        ),
        (
            ("-p", "controller.lwa:=classic"),
            "controller: unknown parameter 'lwa' for node controller",
        ),
        (
            ("-p", "plant.substepz:=4"),
            "plant: unknown parameter 'substepz' for node plant",
        ),
        (
            ("-p", "plant.simulation.substeps:=many"),
            "plant: parameter 'simulation.substeps' = 'many'; it must be a number",
        ),
        (
            ("-p", "trajectory_server.task.start:=[0.5, 0.5]"),
            "point (0.5000, 0.5000) m is",
        ),
        (
            ("-p", "plant.robot.base_distance:=0.9"),
            "the simulated robot cannot stand where its encoders read",
        ),
        (
            ("-p", "recorder.bag.compression:=rar"),
            "recorder: parameter 'bag.compression' = 'rar'; it must be one of",
        ),
        (
            ("-p", "trajectory_server.task.goal:=[-0.02, 0.12]"),
            "start and goal lie on the same side of the Type 2 locus",
        ),
        (
            ("--law", f"{__name__}:unfinished"),
            "fails as its equations are built: ValueError: not finished",
        ),
        (
            ("-p", f"controller.estimator:={__name__}:unfinished"),
            "cannot be made: ValueError: not finished",
        ),
    ],
)
def test_what_can_be_known_as_wrong_is_refused_before_there_is_a_folder(
    arguments: tuple[str, ...],
    said: str,
    started: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["demo", "--output", str(tmp_path / "runs"), *arguments]) == 2
    told = capsys.readouterr().err
    assert said in told and told.count("\n") == 1
    assert not started and not (tmp_path / "runs").exists()


def test_a_file_given_with_params_is_held_to_the_same_rules(
    started: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = config_file(NODES_FILE).read_text(encoding="utf-8")
    file = tmp_path / "params.yaml"
    file.write_text(
        text.replace("    law: consistent", "    lwa: consistent"), encoding="utf-8"
    )
    assert (
        cli.main(["demo", "--output", str(tmp_path / "runs"), "--params", str(file)])
        == 2
    )
    assert "controller: unknown parameter 'lwa'" in capsys.readouterr().err
    assert not started and not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "law consistent, estimator observer, each step waits"),
        (("--lockstep", "--law", "classic"), "law classic, estimator observer, as"),
    ],
)
def test_the_first_line_names_law_and_estimator_whether_they_were_given_or_not(
    arguments: tuple[str, ...],
    said: str,
    started: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["demo", "--output", str(tmp_path), *arguments]) == 2
    assert capsys.readouterr().out.startswith(said) and started


def test_the_demo_tells_once_what_is_now_called_otherwise_in_its_files_and_arguments(
    started: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "params.yaml"
    file.write_text(
        "/**/controller:\n  ros__parameters: {max_residual: 0.02}\n"
        "/**/plant:\n  ros__parameters: {substeps: 4}\n",
        encoding="utf-8",
    )
    typed = "--params", str(file), "-p", "controller.natural_frequency:=70.0"
    assert cli.main(["demo", "--output", str(tmp_path), *typed]) == 2
    told = [
        line
        for line in capsys.readouterr().err.splitlines()
        if "parameters have been renamed" in line
    ]
    assert len(told) == 1 and started
    for name in (
        "max_residual is now trajectory.max_residual",
        "substeps is now simulation.substeps",
        "natural_frequency is now feedback.natural_frequency",
    ):
        assert name in told[0]


def test_the_latest_run_stays_the_one_that_began_where_a_start_is_refused(
    started: list[str], tmp_path: Path
) -> None:
    (tmp_path / "earlier").mkdir()
    (tmp_path / "latest").symlink_to("earlier")
    assert cli.main(["demo", "--output", str(tmp_path)]) == 2
    assert started == list(demo.NODES)
    assert (tmp_path / "latest").resolve() == tmp_path / "earlier"


def test_a_simulated_robot_of_its_own_stands_where_its_encoders_read_the_start(
    started: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = dict[str, list[str]]()
    monkeypatch.setattr(
        demo.Processes,
        "start",
        lambda _, name, arguments: given.setdefault(name, arguments),
    )
    drawn, file = load_robot(config_file(ROBOT_FILE)), tmp_path / "true.yaml"
    true = drawn.replace(**{"right.axis": (0.06, 0.001), "left.encoder_offset": 0.01})
    file.write_text(
        robot_text(
            {
                key: value
                for key, value in flatten(true).items()
                if key != "base_distance"
            }
        ),
        encoding="utf-8",
    )
    cli.main(
        [
            "demo",
            "--output",
            str(tmp_path),
            "--plant-robot",
            str(file),
            "-p",
            "plant.robot.right.encoder_offset:=-0.02",
        ]
    )
    true = true.replace(**{"right.encoder_offset": -0.02})
    assert [name for name, own in given.items() if str(file) in own] == ["plant"]
    (start,) = (
        yaml.safe_load(part.partition(":=")[2])
        for part in given["plant"]
        if "task.start:=" in part
    )
    reading = Model.of(true).place(np.array(start)).q_a + true.encoder_offset
    assert reading == pytest.approx(
        Model.of(drawn).place(np.array([-0.025, 0.115])).q_a, abs=1e-9
    )
    given.clear()
    cli.main(
        [
            "demo",
            "--output",
            str(tmp_path),
            "-p",
            "trajectory_server.task.start:=[-0.03, 0.11]",
        ]
    )
    assert any("task.start:=[-0.03" in part for part in given["plant"])
    given.clear()
    cli.main(
        [
            "demo",
            "--output",
            str(tmp_path),
            "-p",
            "plant.robot.left.coulomb_friction:=0.05",
        ]
    )
    assert not any("task.start" in part for part in given["plant"])
