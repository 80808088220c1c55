"""When the controller gives torque and when it refuses it, over real DDS, with this
process as the rig.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from rig import Rig, controlled, matched
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header
from trajectory_msgs.msg import MultiDOFJointTrajectory

from dextar_control.contract.topics import (
    CRITERION,
    CRITERION_NAMES,
    EFFORT_COMMANDS,
    JOINT_COMMANDS,
    JOINT_STATES,
    TRAJECTORY,
)
from dextar_control.control.phases import Phase
from dextar_control.nodekit.cdr import from_time, to_time
from dextar_control.nodekit.node import qos
from dextar_control.planning.planner import Plan

MS = 1_000_000  # ns
HEALTHY = 50  # ms
PHASE = CRITERION_NAMES.index("phase")


@pytest.fixture(scope="module")
def process() -> Iterator[Rig]:
    with controlled("autostart:=false") as rig:
        yield rig


@pytest.fixture
def rig(process: Rig, q_a: np.ndarray) -> Iterator[Rig]:
    """A controller anew that enables itself after HEALTHY."""
    values = {
        "joint_states.healthy_time": 1e-3 * HEALTHY,
        "trajectory.wait_timeout": 30.0,
        "publish.effort_array": False,
    }
    assert not any(process.put("controller", **values))
    assert process.change("configure")
    assert process.change("activate")
    matched(process)
    process.until(lambda: process.controller("enabling") == "waiting", "not waiting")
    yield process
    assert process.change("deactivate")
    _clear(process, q_a)
    assert process.change("cleanup")
    process.until(
        lambda: process.node.count_publishers("joint_commands") == 0,
        "the publisher is still there",
    )
    process.commands.clear()
    process.status.clear()


def _clear(rig: Rig, q_a: np.ndarray) -> None:
    """Of an inactive controller: what a test latched."""
    assert not any(
        rig.put("controller", assembly_mode=1, joint_states__healthy_time=0.0)
    )
    assert rig.change("activate")
    matched(rig)
    rig.answer(MS, q_a)
    assert not any(rig.put("controller", assembly_mode=1))
    answer = rig.reset()
    assert answer.success, answer.message
    assert rig.change("deactivate")


def test_it_enables_itself_with_the_first_state_that_makes_them_healthy_and_only_once(
    rig: Rig, q_a: np.ndarray
) -> None:
    early = rig.enable()
    assert not early.success
    assert "healthy states for 0.00 s; 0.05 s are needed" in early.message
    rig.hold((k * MS for k in range(20)), q_a)
    refused = rig.enable()
    assert (refused.success, refused.message) == (
        False,
        "healthy states for 0.02 s; 0.05 s are needed",
    )
    push = q_a + [1e-4, 0.0]
    for k in range(20, HEALTHY):
        assert list(rig.answer(k * MS, push).effort) == [0.0, 0.0]
    rig.answer(HEALTHY * MS, push)
    assert rig.answer((HEALTHY + 1) * MS, push + [1e-4, 0.0]).effort[0] < 0.0
    rig.until_phase("HOLD")
    assert rig.controller("enabling") == "done"
    assert rig.enable(False).success
    for k in range(1, 3 * HEALTHY):
        assert list(rig.answer((HEALTHY + 1 + k) * MS, push).effort) == [0.0, 0.0]
    assert rig.enable().success


@pytest.mark.parametrize("trouble", ["gap", "refused", "backwards"])
def test_trouble_begins_the_healthy_time_anew(
    rig: Rig, q_a: np.ndarray, trouble: str
) -> None:
    rig.hold((k * MS for k in range(HEALTHY - 1)), q_a)
    first = HEALTHY - 1
    if trouble == "gap":
        first += 30
    else:
        count = rig.controller("refused_states")
        rig.send(
            first * MS if trouble == "refused" else 3 * MS,
            q_a * (np.nan if trouble == "refused" else 1.0),
        )
        rig.until(
            lambda: rig.controller("refused_states") not in ("", count), "not refused"
        )
    for k in range(HEALTHY):
        assert list(
            rig.answer((first + k) * MS, q_a + [1e-4 * (k % 2), 0.0]).effort
        ) == [0.0, 0.0]
    rig.answer((first + HEALTHY) * MS, q_a)
    rig.until_phase("HOLD")


def test_a_trajectory_that_comes_early_begins_with_the_first_held_state(
    rig: Rig, q_a: np.ndarray, trip: Plan
) -> None:
    rig.answer(0, q_a)
    rig.serve(trip)
    rig.until(lambda: rig.controller("trajectory") == "accepted", "not accepted")
    assert (rig.controller("phase"), rig.controller("waiting_for")) == (
        "IDLE",
        "the enabling",
    )
    seen: list[tuple[int, float]] = []
    rig.node.create_subscription(
        JointState,
        CRITERION.name,
        lambda m: seen.append((from_time(m.header.stamp), m.position[PHASE])),
        qos(CRITERION),
    )
    rig.until(lambda: rig.node.count_publishers("criterion"), "no criterion")
    rig.hold((k * MS for k in range(1, HEALTHY + 3)), q_a)
    rig.until(
        lambda: seen and seen[-1][0] == (HEALTHY + 2) * MS, "the phases are not told"
    )
    phases = dict(seen)
    assert {phase for stamp, phase in phases.items() if stamp < HEALTHY * MS} == {
        float(Phase.IDLE)
    }
    assert {phase for stamp, phase in phases.items() if stamp >= HEALTHY * MS} == {
        float(Phase.TRACK)
    }


def test_a_trajectory_waits_for_its_enabling_no_longer_than_its_time(
    rig: Rig, q_a: np.ndarray, trip: Plan
) -> None:
    assert rig.put("controller", trajectory__wait_timeout=0.03) == [""]
    rig.answer(0, q_a)
    rig.serve(trip)
    rig.until(lambda: rig.controller("waiting_for") == "the enabling", "not kept")
    tick = 0
    while not rig.controller("trajectory").startswith("refused"):
        tick += 1
        if tick % 40 == 0:
            tick += 25  # never healthy for long enough
        rig.answer(tick * MS, q_a)
        assert tick < 5000
    assert "to begin; the limit is 0.03 s" in rig.controller("trajectory")
    for k in range(1, HEALTHY + 30):
        rig.answer((tick + k) * MS, q_a)
    rig.until_phase("HOLD")


def test_a_start_too_far_ahead_is_refused_and_one_that_is_missed_dropped(
    rig: Rig, q_a: np.ndarray, trip: Plan
) -> None:
    rig.hold((k * MS for k in range(HEALTHY + 5)), q_a)
    rig.serve(trip, 40_000 * MS)
    rig.until(
        lambda: "the limit is 30 s" in rig.controller("trajectory"), "not refused"
    )
    rig.serve(trip, 20_000 * MS)
    rig.until(lambda: rig.controller("waiting_for") == "its start", "not accepted")
    assert rig.put("controller", trajectory__wait_timeout=0.01) == [""]
    for k in range(1, 60):
        rig.answer((HEALTHY + 4 + k) * MS, q_a)
    rig.until(
        lambda: "to begin; the limit is 0.01 s" in rig.controller("trajectory"),
        "not dropped",
    )
    assert rig.controller("phase") == "HOLD"


def test_a_reset_is_refused_while_the_cause_lasts(rig: Rig, q_a: np.ndarray) -> None:
    rig.hold((k * MS for k in range(HEALTHY + 2)), q_a)
    other = rig.node.create_publisher(
        JointState, JOINT_COMMANDS.name, qos(JOINT_COMMANDS)
    )
    rig.until_phase("FAULT")
    refused = rig.reset()
    assert not refused.success
    assert refused.message.startswith(
        "2 publishers on /joint_commands; the limit is 1: end all but one (/controller"
    )
    rig.node.destroy_publisher(other)
    rig.until(
        lambda: rig.controller("other_commanders") == "", "the other is still counted"
    )
    assert rig.reset().success
    assert rig.enable().success
    rig.answer((HEALTHY + 32) * MS, q_a)
    rig.until_phase("FAULT")
    refused = rig.reset()
    assert not refused.success
    assert (
        "healthy states for 0.00 s; 0.05 s are needed (last: no state for"
        in refused.message
    )
    rig.hold(((HEALTHY + 32 + k) * MS for k in range(1, HEALTHY + 1)), q_a)
    assert rig.reset().success
    assert rig.reset().success  # nothing to clear


def test_a_second_commander_is_told_before_torque_and_refuses_it(
    rig: Rig, q_a: np.ndarray
) -> None:
    other = rig.node.create_publisher(
        JointState, JOINT_COMMANDS.name, qos(JOINT_COMMANDS)
    )
    rig.until(lambda: rig.controller("other_commanders"), "not seen")
    assert rig.status["controller"]["level"] == "1"
    rig.hold((k * MS for k in range(HEALTHY + 5)), q_a)
    rig.until(lambda: rig.controller("enabling").startswith("refused"), "not refused")
    assert "2 publishers on /joint_commands" in rig.controller("enabling")
    assert rig.controller("phase") == "IDLE"
    assert "2 publishers" in rig.enable().message
    rig.node.destroy_publisher(other)
    rig.until(lambda: rig.controller("other_commanders") == "", "still counted")
    assert rig.enable().success


def test_the_effort_array_carries_the_commands_torques_and_is_watched_too(
    rig: Rig, q_a: np.ndarray
) -> None:
    assert rig.change("deactivate")
    assert rig.change("cleanup")
    assert not any(rig.put("controller", publish__effort_array=True))
    assert rig.change("configure")
    assert rig.change("activate")
    arrays: list[list[float]] = []
    reader = rig.node.create_subscription(
        Float64MultiArray,
        EFFORT_COMMANDS.name,
        lambda m: arrays.append(list(m.data)),
        qos(EFFORT_COMMANDS),
    )
    matched(rig)
    rig.until(lambda: rig.node.count_publishers(EFFORT_COMMANDS.name), "no array")
    for k in range(HEALTHY + 10):
        rig.answer(k * MS, q_a + [1e-4 * (k % 3), -2e-4 * (k % 2)])
    efforts = [list(command.effort) for command in rig.commands]
    rig.until(
        lambda: len(arrays) >= 10 and arrays[-1] == efforts[-1], "arrays are missing"
    )
    assert (
        arrays == efforts[-len(arrays) :]
    )  # the writer may have found this reader after the first
    assert arrays[-1] != [0.0, 0.0]
    other = rig.node.create_publisher(
        Float64MultiArray, EFFORT_COMMANDS.name, qos(EFFORT_COMMANDS)
    )
    rig.until_phase("FAULT")
    assert "2 publishers on /effort_commands" in rig.controller("reason")
    rig.until(lambda: arrays[-1] == [0.0, 0.0], "the array keeps its torque")
    rig.node.destroy_publisher(other)
    rig.node.destroy_subscription(reader)


def test_a_fault_outlives_cleanup_and_nothing_is_enabled_by_itself_after_it(
    rig: Rig, q_a: np.ndarray
) -> None:
    for k in range(HEALTHY + 5):
        rig.answer(k * MS, q_a)
    rig.until_phase("HOLD")
    rig.answer((HEALTHY + 1000) * MS, q_a)
    rig.until_phase("FAULT")
    reason = rig.controller("reason")
    for transition in ("deactivate", "cleanup", "configure"):
        assert rig.change(transition)
    assert not any(rig.put("controller", assembly_mode=1))
    assert rig.change("activate")
    matched(rig)
    rig.until(
        lambda: (
            rig.controller("phase") == "FAULT" and rig.controller("reason") == reason
        ),
        "the fault is gone",
    )
    for k in range(2 * HEALTHY):
        assert not any(rig.answer((HEALTHY + 2000 + k) * MS, q_a).effort)
    assert not any(rig.put("controller", assembly_mode=1))
    assert rig.reset().success
    rig.until_phase("IDLE")
    assert not any(rig.answer((3 * HEALTHY + 2000) * MS, q_a).effort)
    assert rig.controller("enabling") == "off"
    assert rig.enable().success


def test_a_second_publisher_of_states_is_told_and_named_and_a_fault_once_it_speaks(
    rig: Rig, q_a: np.ndarray
) -> None:
    """Its states are in order and could be the robot's: their numbers tell that there
    are two.
    """
    told = "2 publishers on /joint_states; the limit is 1: end all but one (2 x /rig)"
    rig.hold((k * MS for k in range(HEALTHY + 5)), q_a)
    rig.until_phase("HOLD")
    other = rig.node.create_publisher(JointState, JOINT_STATES.name, qos(JOINT_STATES))
    rig.until(lambda: other.get_subscription_count() == 1, "the other does not match")
    rig.until(lambda: rig.controller("state_publishers") == told, "not named")
    rig.until(lambda: f"{told}; one speaks" in rig.controller("message"), "not told")
    assert (rig.controller("phase"), rig.controller("level")) == ("HOLD", "1")
    message = JointState(
        name=["q11", "q21"],
        position=q_a.tolist(),
        header=Header(stamp=to_time((HEALTHY + 5) * MS)),
    )
    other.publish(message)
    rig.until_phase("FAULT")
    assert rig.controller("reason") == told
    for refused in (rig.reset(), rig.enable()):
        assert (refused.success, refused.message) == (False, told)
    rig.node.destroy_publisher(other)
    rig.until(lambda: rig.controller("state_publishers") == "", "still counted")
    rig.hold(((HEALTHY + 6 + k) * MS for k in range(HEALTHY + 5)), q_a)
    assert rig.reset().success


def test_a_state_that_cannot_be_used_is_told_with_who_sends_states(
    rig: Rig, q_a: np.ndarray
) -> None:
    """As of a second plant in lockstep, whose time begins at 0."""
    rig.hold(((k + 1) * MS for k in range(HEALTHY + 5)), q_a)
    rig.until_phase("HOLD")
    other = rig.node.create_publisher(JointState, JOINT_STATES.name, qos(JOINT_STATES))
    rig.until(lambda: other.get_subscription_count() == 1, "the other does not match")
    other.publish(JointState(name=["q11", "q21"], position=q_a.tolist()))
    rig.until_phase("FAULT")
    assert rig.controller("reason").startswith(
        "state at 0.000000 s is not after the last one at 0.055000 s; 2 publishers on"
    )
    assert "2 publishers on /joint_states" in rig.controller("last_trouble")
    rig.node.destroy_publisher(other)
    rig.until(lambda: rig.controller("state_publishers") == "", "still counted")


def test_a_second_server_of_trajectories_is_told(rig: Rig) -> None:
    other = rig.node.create_publisher(
        MultiDOFJointTrajectory, TRAJECTORY.name, qos(TRAJECTORY)
    )
    rig.until(
        lambda: "2 publishers on /trajectory" in rig.controller("message"), "not told"
    )
    rig.node.destroy_publisher(other)
    rig.until(lambda: "/trajectory" not in rig.controller("message"), "still counted")


def test_a_refusal_says_what_to_call_next(
    rig: Rig, q_a: np.ndarray, trip: Plan
) -> None:
    calls = "type dextar reset, then dextar enable"
    rig.hold((k * MS for k in range(HEALTHY + 5)), q_a)
    rig.until_phase("HOLD")
    assert rig.controller("next_step") == ""
    rig.answer((HEALTHY + 40) * MS, q_a)
    rig.until_phase("FAULT")
    rig.hold(((HEALTHY + 40 + k) * MS for k in range(1, HEALTHY + 5)), q_a)
    refused = rig.enable()
    assert not refused.success
    assert refused.message.startswith("phase FAULT no state for 36.0 ms")
    assert refused.message.endswith(f"; {calls}")
    rig.serve(trip)
    told = f"the controller is in FAULT: {calls}, then serve it again"
    rig.until(
        lambda: told in rig.controller("trajectory"), "not refused with what to call"
    )
    assert rig.reset().success
    nothing = rig.reset()  # nothing is latched any more
    assert (nothing.success, nothing.message) == (True, "phase IDLE")
    rig.until(
        lambda: rig.controller("next_step") == "type dextar enable", "no next step"
    )
    assert rig.enable().success
    refused = rig.reset()
    assert (refused.success, refused.message) == (
        False,
        "phase HOLD: there is nothing to reset",
    )
