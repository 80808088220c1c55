"""The controller node over real DDS, with this process as the rig."""

from __future__ import annotations

import contextlib
import itertools
import math
import re
import signal
import time
from collections.abc import Iterator

import numpy as np
import pytest
from closed_loop import turn_round
from geometry_msgs.msg import PoseStamped
from patience import PATIENCE
from rig import Rig, controlled, matched, start, stop
from sensor_msgs.msg import JointState

from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.settings import default_settings
from dextar_control.contract.topics import CRITERION, EXTERNAL_POSE, JOINT_COMMANDS
from dextar_control.control.verdicts import Verdict
from dextar_control.nodekit.cdr import to_time
from dextar_control.nodekit.node import qos
from dextar_control.nodes import messages
from dextar_control.planning.planner import Plan
from dextar_control.planning.trajectory import Trajectory
from dextar_sim.plant import Plant

MODULE = "dextar_control.nodes.controller"
MS = 1_000_000  # ns
RESTITUTION = 0.8  # speed along t_s after the blow over that before
STOPPED = 0.15  # s after the blow


@pytest.fixture
def rig() -> Iterator[Rig]:
    with _controller() as rig:
        yield rig


@contextlib.contextmanager
def _controller(*parameters: str) -> Iterator[Rig]:
    """A controller in lockstep that holds, and this process as its rig."""
    with controlled("joint_states.healthy_time:=0.0", *parameters) as rig:
        rig.until_phase("HOLD")
        matched(rig)
        yield rig


def _serve(rig: Rig, trajectory: Trajectory, note: str) -> None:
    times = np.linspace(0.0, trajectory.duration, 200)
    rig.trajectories.publish(messages.from_trajectory(trajectory, times))
    rig.until(
        lambda: rig.controller("trajectory").startswith(note),
        f"the trajectory was not {note}",
    )


def test_states_are_answered_by_name_with_their_stamp(
    rig: Rig, q_a: np.ndarray
) -> None:
    held = rig.answer(7 * MS, q_a)
    assert list(held.name) == ["q11", "q21"]
    np.testing.assert_allclose(held.effort, 0.0, atol=1e-9)
    straight = rig.answer(8 * MS, q_a + [1e-4, 0.0])
    swapped = rig.answer(9 * MS, [q_a[1], q_a[0] + 1e-4], ("q21", "q11"))
    assert straight.effort[0] < 0.0
    assert swapped.effort[0] < 0.0


@pytest.mark.parametrize(
    ("positions", "names", "message"),
    [
        ([1.0], ("q11",), "'q21' is missing"),
        ([1.0, 2.0, 3.0], ("q11", "q21"), "3 positions for 2 names"),
        ([math.nan, 1.0], ("q11", "q21"), "must be finite"),
    ],
)
def test_a_state_that_cannot_be_used_is_a_fault_without_torque(
    rig: Rig,
    q_a: np.ndarray,
    positions: list[float],
    names: tuple[str, ...],
    message: str,
) -> None:
    rig.answer(1 * MS, q_a)
    rig.send(2 * MS, positions, names)
    rig.until_phase("FAULT")
    assert message in rig.controller("reason")
    assert list(rig.answer(3 * MS, q_a + 0.01).effort) == [0.0, 0.0]


def test_a_gap_between_stamps_is_a_fault_until_reset_and_enable(
    rig: Rig, q_a: np.ndarray
) -> None:
    rig.answer(1 * MS, q_a)
    assert list(rig.answer(22 * MS, q_a + 0.01).effort) == [0.0, 0.0]
    rig.until_phase("FAULT")
    assert "no state for 21.0 ms; the limit is 20.0 ms" in rig.controller("reason")
    assert rig.controller("missed_states") == "20"
    assert rig.reset().success
    assert list(rig.answer(23 * MS, q_a).effort) == [0.0, 0.0]
    assert rig.enable().success
    for tick in range(24, 80):
        still = rig.answer(tick * MS, q_a)
    assert rig.answer(80 * MS, q_a + [1e-3, 0.0]).effort[0] < still.effort[0]


def test_states_that_stop_coming_take_the_torque_away_and_then_are_a_fault_that_lasts(
    q_a: np.ndarray,
) -> None:
    """On the steady clock, without a further state; nothing is asked of when."""
    with controlled(
        "lockstep:=false",
        "joint_states.healthy_time:=0.0",
        "joint_states.stall_timeout:=0.1",
    ) as rig:
        rig.until_phase("HOLD")
        matched(rig)
        rig.answer(time.time_ns(), q_a)
        rig.until_phase("FAULT")
        assert re.fullmatch(
            r"no state for \d+ ms; the limit is 100 ms", rig.controller("reason")
        )
        assert list(rig.commands[-1].effort) == [0.0, 0.0]
        assert rig.controller("stalls") == "1"
        refused = rig.reset()
        assert not refused.success
        assert re.fullmatch(
            r"no state for \d+ ms; the limit is 20.0 ms: see that the rig or plant"
            r" runs",
            refused.message,
        )
        assert "latency_p50_us" in rig.status["controller"]


def test_a_second_commander_is_a_fault(rig: Rig, q_a: np.ndarray) -> None:
    rig.answer(1 * MS, q_a)
    other = rig.node.create_publisher(
        JointState, JOINT_COMMANDS.name, qos(JOINT_COMMANDS)
    )
    rig.until_phase("FAULT")
    assert "2 publishers on /joint_commands; the limit is 1" in rig.controller("reason")
    rig.node.destroy_publisher(other)
    assert list(rig.answer(2 * MS, q_a + 0.01).effort) == [0.0, 0.0]


def test_a_repeated_state_is_answered_again_and_not_after_a_fault(
    rig: Rig, q_a: np.ndarray
) -> None:
    rig.answer(1 * MS, q_a)
    first = rig.answer(2 * MS, q_a + [1e-3, 0.0])
    count = len(rig.commands)
    rig.send(2 * MS, q_a)
    rig.until(lambda: len(rig.commands) > count, "no second answer")
    assert rig.commands[-1].effort == first.effort
    rig.send(3 * MS, [math.nan, 0.0])
    rig.until_phase("FAULT")
    count = len(rig.commands)
    rig.send(2 * MS, q_a)
    rig.until(lambda: len(rig.commands) > count, "no third answer")
    assert list(rig.commands[-1].effort) == [0.0, 0.0]


def test_trajectories_are_taken_or_refused_with_the_number(
    rig: Rig, q_a: np.ndarray, trip: Plan
) -> None:
    rig.answer(1 * MS, q_a)
    _serve(rig, trip.trajectory.scaled(0.1), "refused")
    assert "limit is" in rig.controller("trajectory")
    wrong = messages.from_trajectory(
        trip.trajectory, np.linspace(0.0, trip.trajectory.duration, 30)
    )
    wrong.points[3].velocities = []
    rig.trajectories.publish(wrong)
    rig.until(
        lambda: "point 3 has 0 velocities" in rig.controller("trajectory"),
        "not refused",
    )
    rig.serve(trip)
    rig.until(lambda: rig.controller("trajectory") == "accepted", "not accepted")
    rig.answer(2 * MS, q_a)
    rig.until_phase("TRACK")
    rig.trajectories.publish(messages.stop_trajectory())
    rig.until_phase("SAFE_STOP")


def test_a_latched_trajectory_from_before_moves_nothing(
    trip: Plan, q_a: np.ndarray
) -> None:
    rig = Rig()
    rig.serve(trip)
    process = start(MODULE, "-p", "controller:lockstep:=true")
    try:
        rig.until(
            lambda: rig.controller("trajectory").startswith("refused"),
            "the old trajectory was not refused",
        )
        assert "before this controller began" in rig.controller("trajectory")
    finally:
        code, _ = stop(process, signal.SIGTERM)
        rig.close()
    assert code == 0


def _pose(stamp: int, x: float, y: float, frame: str = "base") -> PoseStamped:
    message = PoseStamped()
    message.header.stamp, message.header.frame_id = to_time(stamp), frame
    message.pose.position.x, message.pose.position.y, message.pose.orientation.w = (
        x,
        y,
        1.0,
    )
    return message


def test_an_external_pose_is_used_or_refused_with_the_numbers(
    q_a: np.ndarray, trip: Plan
) -> None:
    """Frame, numbers, order, jump and silence: each one message, and no tick is
    lost.
    """
    x, y = trip.trajectory.at(0.0).x.tolist()
    with _controller("estimator:=external") as rig:
        publisher = rig.node.create_publisher(
            PoseStamped, EXTERNAL_POSE.name, qos(EXTERNAL_POSE)
        )
        rig.until(
            lambda: publisher.get_subscription_count() == 1, "nobody reads the pose"
        )
        tick = itertools.count(1)

        def answer_until(words: str) -> None:
            """Some states, less than external.timeout, then what the controller makes of
            them.
            """
            for _ in range(20):
                for _ in range(20):
                    rig.answer(next(tick) * MS, q_a)
                rig.status.clear()
                rig.until(
                    lambda: rig.controller("states") == str(len(rig.commands)),
                    "no diagnostics of all states",
                )
                if words in rig.controller("pose_note"):
                    return
            raise AssertionError(f"not told: {words}; {rig.controller('pose_note')}")

        answer_until("no external position for")
        publisher.publish(_pose(next(tick) * MS, x, y, "camera"))
        answer_until("in frame 'camera'; it must be in frame 'base'")
        publisher.publish(_pose(next(tick) * MS, math.nan, y))
        answer_until(f"(nan, {y}) m is not finite")
        stamp = next(tick) * MS
        publisher.publish(_pose(stamp, x, y))
        answer_until("external positions are back")
        publisher.publish(_pose(stamp, x, y))
        answer_until("is not after the last one")
        publisher.publish(_pose(next(tick) * MS, x + 0.02, y))
        answer_until("from the estimate")
        assert rig.controller("phase") == "HOLD"
        assert rig.controller("refused_poses") == "2"


def test_a_bounce_is_called_one_on_the_topic_and_ends_in_a_safe_stop(
    robot: RobotParameters, trip: Plan
) -> None:
    """The controller over DDS against a plant that is struck at the locus: verdict,
    confidence, diagnostics.
    """
    plant = Plant(robot)
    seen: list[dict[str, float]] = []
    with _controller() as rig:
        rig.node.create_subscription(
            JointState,
            CRITERION.name,
            lambda m: seen.append(dict(zip(m.name, m.position, strict=True))),
            qos(CRITERION),
        )
        try:
            plant.reset(trip.trajectory.at(0.0).x)
            rig.serve(trip)
            rig.until(
                lambda: rig.controller("trajectory") == "accepted", "not accepted"
            )
            blow = turn_round(
                robot, trip, float(trip.certificate.crossing_times[0]), RESTITUTION
            )
            for tick in range(1, round(1e3 * (blow.time + STOPPED))):
                plant.step(rig.answer(tick * MS, plant.state().q_a).effort)
                if abs(1e-3 * tick - blow.time) < 0.5e-3:
                    plant.apply_impulse(blow.impulse)
            rig.until_phase("SAFE_STOP")
            rig.until(
                lambda: seen and seen[-1]["verdict"] == float(Verdict.BOUNCED),
                "not on the topic",
            )
        finally:
            plant.close()
    assert "bounced" in rig.controller("reason")
    assert rig.controller("verdicts") == "bounced undecided"
    assert (
        rig.controller("begun"),
        rig.controller("bounced"),
        rig.controller("estimator"),
    ) == ("1", "1", "observer")
    assert seen[-1]["mode_confidence"] >= default_settings().mode_check.confidence
    assert min(row["mode_confidence"] for row in seen) == pytest.approx(0.5, abs=0.1)
    assert {row["verdict"] for row in seen} == {
        float(Verdict.UNDECIDED),
        float(Verdict.BOUNCED),
    }


def test_gains_may_change_live_and_only_within_their_range(rig: Rig) -> None:
    assert rig.put("controller", feedback__natural_frequency=50.0) == [""]
    assert "500" in rig.put("controller", feedback__natural_frequency=5000.0)[0]
    assert rig.put("controller", robot__max_torque=10.0) != [""]


@pytest.mark.parametrize(
    ("module", "override", "message"),
    [
        (
            MODULE,
            "controller:near_locus.fade_abs_s:=3.0",
            "'near_locus.fade_abs_s' = 3.0; it must be <= 0.9",
        ),
        (
            MODULE,
            "controller:law:=magic",
            (
                "'law' = 'magic'; it must be one of classic, projected, consistent,"
                " multi_model"
            ),
        ),
        (
            MODULE,
            "controller:estimator:=magic",
            "'estimator' = 'magic'; it must be one of plain, dgm, observer, external",
        ),
        (
            MODULE,
            "controller:crossing_test.unknown_below_abs_s:=0.3",
            "crossing_test.unknown_below_abs_s = 0.3 with"
            " crossing_test.begin_below_abs_s = 0.2; it must be smaller",
        ),
        (MODULE, "controller:zoen:=0.1", "unknown parameter 'zoen'"),
        (
            MODULE,
            "controller:robot.left.distal_length:=-0.09",
            "robot.left.distal_length = -0.09; it must be > 0",
        ),
        (
            MODULE,
            "controller:robot.left.distal_lenght:=0.09",
            "unknown parameter 'robot.left.distal_lenght'",
        ),
        (
            "dextar_control.nodes.trajectory_server",
            "trajectory_server:task.goal:=[0.0, 0.12]",
            "same side",
        ),
        (
            "dextar_control.nodes.trajectory_server",
            "trajectory_server:task.start:=[0.0, 0.3]",
            "the leg reaches",
        ),
        (
            "dextar_control.nodes.trajectory_server",
            "trajectory_server:task.duration:=0.1",
            "the limit is 0.3 N m",
        ),
        (
            "dextar_control.nodes.trajectory_server",
            "trajectory_server:task.point:=[0.0, 0.05]",
            "off the Type 2 locus",
        ),
        (
            "dextar_control.nodes.trajectory_server",
            "trajectory_server:task.direction:=1",
            "direction = 1 is given without a point",
        ),
        (
            "dextar_control.nodes.trajectory_server",
            "trajectory_server:task.criterion:=none",
            "one of reciprocal, zero_wrench",
        ),
        (
            "dextar_sim.node",
            "plant:simulation.substeps:=0",
            "'simulation.substeps' = 0",
        ),
        (
            "dextar_control.nodes.recorder",
            "recorder:output:=/proc/none/run.mcap",
            "/proc/none",
        ),
    ],
)
def test_a_wrong_parameter_ends_the_node_with_one_line(
    module: str, override: str, message: str
) -> None:
    process = start(module, "-p", override)
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2, output
    assert message in output
    assert "Traceback" not in output
