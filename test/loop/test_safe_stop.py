"""What a safe stop does from several hundred instants of a crossing, and the torques it
is made of.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from closed_loop import advance, running, s_of, state_of
from oracle import Oracle
from safe_stop_study import REST, intolerant

from dextar_control.contract.errors import StateError
from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.control.phases import Phase
from dextar_control.control.safe_stop import FADE, SafeStop
from dextar_control.control.verdicts import Verdict
from dextar_control.model.model import Model
from dextar_control.planning.planner import Plan
from dextar_sim.rig import Rig

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = default_settings()
LEAST = 200  # instants
PERIOD = 1e-3  # s
PUSHED = 0.02  # of the energy taken, that the lag of the joint filter may give back
# J that the encoder's noise may give a robot at rest: what the platform has at 1 mm/s
STIR = 1e-7


def _safe_stop(model: Model) -> SafeStop:
    stop = SafeStop(model)
    stop.configure(SETTINGS)
    return stop


@pytest.fixture(scope="module")
def stops() -> list[SimpleNamespace]:
    """Fast and slow trip, both ways, evenly spaced instants; a request and a watch in
    turn. In a process that may fork.
    """
    script = ROOT / "test" / "studies" / "safe_stop_study.py"
    answer = subprocess.run(
        [sys.executable, str(script), "--json", "--alternate"],
        check=True,
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    return [
        SimpleNamespace(**row) for row in json.loads(answer.stdout.splitlines()[-1])
    ]


def test_from_every_instant_the_torque_is_bounded_and_ends_when_it_was_declared(
    stops: list[SimpleNamespace],
) -> None:
    assert len({(row.trip, row.way, row.time) for row in stops}) >= LEAST
    for row in stops:
        assert row.peak_torque <= row.limit + 1e-12
        assert row.torque_time < row.over_time
        if not row.finished:
            assert row.over_time <= SETTINGS.safe_stop.brake_time + PERIOD


def test_from_every_instant_the_robot_comes_to_rest_clear_of_the_locus_on_a_known_side(
    stops: list[SimpleNamespace],
) -> None:
    for row in stops:
        assert row.end_speed < REST
        assert "at rest after" in row.told
        assert abs(row.end_s) >= SETTINGS.safe_stop.rest_above_abs_s
        assert row.side_right or not row.side_known
    assert sum(row.side_known for row in stops) >= 0.98 * len(
        stops
    )  # in the others it has to be told


def test_the_safe_stop_takes_energy_and_gives_none(
    stops: list[SimpleNamespace],
) -> None:
    assert sum(row.taken for row in stops) > 0.0
    for row in stops:
        assert row.pushed <= PUSHED * row.taken + STIR


def test_only_a_request_finishes_a_crossing(stops: list[SimpleNamespace]) -> None:
    """And only where the robot cannot come to rest before the locus."""
    assert not [row for row in stops if row.trigger == "watch" and row.finished]
    finished = [row for row in stops if row.finished]
    assert {row.trip for row in finished} == {"fast", "slow"}
    assert all(
        row.finished
        for row in stops
        if row.trigger == "stop" and abs(row.s) < SETTINGS.safe_stop.coast_below_abs_s
    )
    assert not [row for row in finished if abs(row.s) > 0.6]


def test_s_and_its_rate_follow_from_the_joints_on_either_side(
    uneven: RobotParameters, trip: Plan
) -> None:
    model, generator, seen = Model.of(uneven), np.random.default_rng(5), set()
    stop = _safe_stop(model)
    for x in trip.certificate.profile.x[::40]:
        s = s_of(model, x)
        if abs(s) < 0.05:
            continue
        x_dot, step = generator.normal(0.0, 0.3, 2), 1e-6
        kin = state_of(model, x, x_dot)
        ahead, behind = (
            abs(s_of(model, x + sign * step * x_dot)) for sign in (1.0, -1.0)
        )
        now = stop.braking(kin.q_a, kin.q_a_dot, x, 0.0, 1e9)
        assert now.s == pytest.approx(abs(s), abs=1e-12)
        assert now.rate == pytest.approx((ahead - behind) / (2.0 * step), abs=1e-6)
        seen.add(s > 0.0)
    assert seen == {True, False}


def test_braking_slows_every_direction_alike_and_takes_energy_from_a_robot_on_either_side(
    robot: RobotParameters, trip: Plan
) -> None:
    """By the oracle's dynamics: what the torque changes is -x_dot / brake_time_constant."""
    model, oracle, generator = Model.of(robot), Oracle(robot), np.random.default_rng(6)
    stop = _safe_stop(model)
    for x in trip.certificate.profile.x[::40]:
        s = s_of(model, x)
        if abs(s) < SETTINGS.safe_stop.rest_above_abs_s:
            continue
        x_dot = generator.normal(0.0, 0.3, 2)
        kin = state_of(model, x, x_dot)
        tau = stop.braking(kin.q_a, kin.q_a_dot, x, float(np.sign(s)), 1e9).tau
        changed = oracle.forward(kin.q_a, x, x_dot, tau) - oracle.forward(
            kin.q_a, x, x_dot, np.zeros(2)
        )
        np.testing.assert_allclose(
            changed,
            -x_dot / SETTINGS.safe_stop.brake_time_constant,
            rtol=1e-6,
            atol=1e-9,
        )
        for mode in (-1.0, 0.0, 1.0):
            now = stop.braking(kin.q_a, kin.q_a_dot, x, mode, 0.05)
            held, lasting = now.tau, now.lasting
            assert held @ kin.q_a_dot < 0.0
            assert np.abs(held).max() <= 0.05 + 1e-15
            assert lasting > 0.0


def _tripped(
    robot: RobotParameters, trip: Plan, when: float, **changes: object
) -> tuple[Rig, ControlLoop]:
    """A robot whose tracking error is no longer tolerated at a time."""
    rig, loop = (
        Rig(robot, plant="cartesian"),
        ControlLoop(robot, default_settings(**changes), 1),
    )
    rig.reset_joints(loop.model.inverse_geometric_model(trip.trajectory.at(0.0).x), 1)
    loop.accept(trip.trajectory)
    advance(loop, rig, until=when)
    loop.configure(intolerant(loop.settings))
    advance(loop, rig, count=1)
    assert loop.phase is Phase.SAFE_STOP
    return rig, loop


def test_a_robot_that_stands_on_the_locus_is_let_go_after_the_time_to_coast(
    robot: RobotParameters, trip: Plan
) -> None:
    rig, loop = _tripped(robot, trip, float(trip.certificate.crossing_times[0]))
    rig.plant.reset(trip.certificate.crossing_points[0])
    begin, taus = loop.tick.time, []
    resting = rig.plant.state().q_a
    for tick in range(1, 700):
        taus.append(loop.step(begin + PERIOD * tick, resting))
    assert (np.array(taus) == 0.0).all()
    assert loop.stopped.coasted == pytest.approx(
        SETTINGS.safe_stop.coast_time, abs=2.0 * PERIOD
    )
    assert not loop.stopped.at_rest
    assert (
        loop.reason.endswith("side not known") and "let go after 0.50 s" in loop.reason
    )
    with pytest.raises(
        StateError,
        match=r"move it by hand to \|s\| >= 0.20, set assembly_mode .*, then reset",
    ):
        loop.reset()
    rig.close()


def test_a_crossing_that_was_made_stays_so_when_the_robot_coasts_through_the_next_one(
    robot: RobotParameters, trip: Plan
) -> None:
    rig, loop = _tripped(robot, trip, float(trip.certificate.crossing_times[1]) - 0.04)
    assert s_of(loop.model, rig.truth().x) < 0.0
    while loop.stopped is None:
        advance(loop, rig, count=1)
    assert s_of(loop.model, rig.truth().x) > 0.0  # back on the side of the start
    assert [passed.verdict for passed in loop.passed] == [
        Verdict.CROSSED,
        Verdict.UNDECIDED,
    ]
    assert "bounced" not in loop.reason
    rig.close()


def test_an_estimator_that_does_not_know_the_side_is_braked_in_the_joints_and_says_so(
    robot: RobotParameters, trip: Plan
) -> None:
    rig, loop = _tripped(
        robot, trip, float(trip.certificate.crossing_times[0]), estimator="dgm"
    )
    braked = False
    for _, tau in running(loop, rig):
        q_a_dot = loop.tick.estimate.q_a_dot
        if np.abs(q_a_dot).max() > FADE[1] and (tau != 0.0).any():
            np.testing.assert_allclose(
                tau, -SETTINGS.safe_stop.brake_gain * q_a_dot, atol=1e-12
            )
            braked = True
        if loop.stopped is not None:
            break
    assert braked and loop.stopped.at_rest and loop.reason.endswith("side not known")
    assert np.hypot(*rig.truth().x_dot) < REST
    rig.close()


def test_a_stop_is_reset_when_it_is_over_and_not_before(
    robot: RobotParameters, trip: Plan
) -> None:
    rig, loop = _tripped(robot, trip, 0.28)
    with pytest.raises(StateError, match="the safe stop is not over"):
        loop.reset()
    while loop.stopped is None:
        advance(loop, rig, count=1)
    loop.reset()
    assert loop.phase is Phase.IDLE
    loop.configure(SETTINGS)
    loop.enable()
    sample = rig.read()
    assert np.abs(loop.step(sample.time, sample.q_a)).max() < 0.02
    assert loop.phase is Phase.HOLD
    rig.close()


def test_disabling_takes_the_torque_of_a_safe_stop_away_and_keeps_it_latched(
    robot: RobotParameters, trip: Plan
) -> None:
    rig, loop = _tripped(robot, trip, 0.28)
    torque, before = np.zeros(2), loop.reason
    while not np.abs(torque).max() > 0.0:
        torque = advance(loop, rig, count=1)
    loop.disable()
    for _, torque in running(loop, rig, count=100):
        assert not torque.any()
    assert (loop.phase, loop.reason) == (
        Phase.SAFE_STOP,
        f"{before}; let go on request",
    )
    rig.close()
