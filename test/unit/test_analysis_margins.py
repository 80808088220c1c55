"""The margins of a run: the watches asked again of the bag are those that the
controller had.
"""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from closed_loop import running
from synthetic_run import FAR_TORQUE, robot, write_run

from dextar_control.analysis import compute_metrics, load_run
from dextar_control.analysis.margins import Margin, Margins, measure_margins
from dextar_control.analysis.page import render_report
from dextar_control.analysis.run import Control, CriterionRecord, Joints, Run
from dextar_control.analysis.timing import measure_timing
from dextar_control.analysis.tracking import tracked
from dextar_control.cli import main as cli
from dextar_control.contract.resources import node_defaults
from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.control.phases import WITHOUT_LAW
from dextar_control.planning.planner import plan_return_trip
from dextar_sim.rig import Rig

START, GOAL = np.array([0.0, 0.105]), np.array([0.0, 0.06])
CHANGES = {"trajectory.max_residual": 1.0}  # N
PUSH, PUSHED = 1.0, (0.34, 0.36)  # N along y, s


def driven() -> tuple[Run, dict[str, tuple[float, float, float]], float]:
    """A pushed trip in a plain loop as a bag would hold it: (run, (share, value, limit)
    per watch, longest time saturated).
    """
    body = robot()
    plan = plan_return_trip(body, START, GOAL, 0.33, 0.2)
    settings = default_settings(**CHANGES)
    loop = ControlLoop(body, settings, 1)
    rig = Rig(body, plant="cartesian", seed=0, encoder_resolution=131072)
    place = loop.model.place(START)
    rig.reset_joints(place.q_a, 1)
    loop.accept(plan.trajectory)
    nearest: dict[str, tuple[float, float, float]] = {}
    rows, longest = [], 0.0
    for k, (sample, tau) in enumerate(running(loop, rig, count=1400)):
        rows.append((round(sample.time * 1e9), sample.q_a, loop.tick, tau))
        if loop.phase not in WITHOUT_LAW:
            for name, (value, limit) in loop.watches.items():
                if limit == 0.0:  # where it does not bind
                    continue
                share = limit / value if name == "locus" else value / limit
                nearest[name] = max(
                    nearest.get(name, (-math.inf, 0.0, 0.0)),
                    (share, value, limit),
                    key=lambda one: one[0],
                )
            longest = max(longest, loop.supervisor._timers["saturation"])
        if PUSHED[0] <= k * 1e-3 < PUSHED[1]:
            rig.strike(np.array([0.0, PUSH * rig.period]))
    rig.close()
    stamps = np.array([stamp for stamp, *_ in rows])
    none, ticks = np.zeros((len(rows), 2)), [tick for *_, tick, _ in rows]

    def of(part: str, name: str) -> np.ndarray:
        return np.array(
            [np.array(getattr(getattr(tick, part), name)) for tick in ticks]
        )

    states = Joints(
        stamps, np.array([q_a for _, q_a, _, _ in rows]), none, none, stamps, stamps
    )
    commands = dataclasses.replace(states, effort=np.array([tau for *_, tau in rows]))
    control = Control(
        stamps,
        np.array([tick.reference_time for tick in ticks]),
        of("reference", "x"),
        of("reference", "x_dot"),
        of("reference", "x_ddot"),
        of("estimate", "x"),
        of("estimate", "x_dot"),
        of("output", "error"),
        of("output", "error_dot"),
        of("output", "u"),
        of("output", "force"),
    )
    criterion = CriterionRecord(
        stamps,
        of("output", "residual"),
        of("output", "s"),
        of("output", "sigma_min"),
        of("output", "weight"),
        of("estimate", "assembly_mode"),
        np.array([int(tick.phase) for tick in ticks]),
        of("estimate", "confidence"),
        np.zeros(len(rows)),
        of("output", "limit"),
        of("estimate", "innovation_square"),
        of("estimate", "innovation"),
        of("estimate", "b"),
        of("estimate", "d"),
    )
    parameters = node_defaults("controller") | CHANGES
    run = Run(
        Path("run.mcap"),
        states,
        commands,
        control,
        criterion,
        None,
        None,
        robot=body,
        parameters={"controller": parameters},
    )
    return run, nearest, longest


def by_name(margins: Margins) -> dict[str, Margin]:
    return {margin.name: margin for margin in margins.limits}


def test_the_watches_are_those_that_the_controller_had() -> None:
    run, nearest, longest = driven()
    track = tracked(run)
    margins = measure_margins(
        run, track, None, measure_timing(run, track), math.inf, math.nan
    )
    found = by_name(margins)
    assert longest > 1e-3  # the push drives the torque to its limit
    assert set(nearest) - {"finite"} <= set(found) and margins.unknown == []
    for name in set(nearest) - {"finite"}:
        share, value, limit = nearest[name]
        assert (found[name].value, found[name].limit) == pytest.approx(
            (value, limit), rel=1e-6, abs=1e-9
        ), name
        assert found[name].share == pytest.approx(
            max(share, 0.0), rel=1e-6, abs=1e-9
        ), name
    assert found["saturation"].lasted == pytest.approx(longest, abs=1e-6)
    assert found["saturation"].allowed == default_settings().torque_limit.time
    shares = [min(margin.share, 1.0) for margin in margins.limits]
    assert shares == sorted(shares, reverse=True)
    assert margins.innovation is not None and margins.innovation.square > 0.0
    assert margins.innovation.correlated > 1  # a push is no white noise
    assert len(margins.bias) == 2 and margins.least_confidence >= 0.5


def test_a_bag_from_before_the_observer_was_told_says_so(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap")
    run = load_run(tmp_path / "run.mcap")
    metrics = compute_metrics(run)
    found = by_name(metrics.margins)
    assert (
        found["tracking_error"].value == pytest.approx(2e-5)
        and found["tracking_error"].limit == 0.02
    )
    assert found["saturation"].value == pytest.approx(FAR_TORQUE)
    assert found["locus"].share == pytest.approx(
        0.5
    )  # |s| = 0.3 where 0.15 is the least
    assert (
        "joint_jump" not in found
        and metrics.margins.disturbance == []
        and metrics.margins.innovation is None
    )
    page = render_report(run, metrics)
    assert (
        "joint_jump needs the observer" in page
        and 'id="margins"' in page
        and "does not tell the observer" in page
    )
    told = json.loads(metrics.to_json())["margins"]
    assert {one["name"]: one["share"] for one in told["limits"]}[
        "locus"
    ] == pytest.approx(0.5)


def test_without_a_robot_only_what_the_nodes_watch_is_told(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap")
    run = dataclasses.replace(load_run(tmp_path / "run.mcap"), robot=None)
    margins = compute_metrics(run).margins
    assert set(by_name(margins)) == {"states"}
    assert "--robot" in margins.unknown[0]


def test_pdf_is_refused_at_once_where_no_browser_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(SystemExit) as ended:
        cli.main(["analyze", "no.mcap", "--pdf"])
    assert ended.value.code == 2
    assert "needs Chromium or Chrome" in capsys.readouterr().err
