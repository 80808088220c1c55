"""``dextar check-rig``: every requirement is judged by itself, in simulated time, and a
few of them over DDS.

The drivers are ``fake_driver``'s, each broken in one way. In simulated time limits are
tight and results exact; with real processes they are generous, because the machine may
be busy, and the faults are far outside them.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fake_driver
import numpy as np
import pytest
import rclpy
from fake_driver import INERTIA, START, WATCHDOG, FakeDriver
from patience import PATIENCE
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rig import ending_well, start
from sensor_msgs.msg import JointState

from dextar_control.check_rig.check import (
    report,
    torque_obstacle,
    torque_tests,
    watch_lines,
)
from dextar_control.check_rig.limits import Limits
from dextar_control.check_rig.report import (
    LINES,
    TORQUE_LINES,
    CheckLine,
    Result,
    has_failed,
)
from dextar_control.check_rig.samples import Endpoint, Graph, JointSample
from dextar_control.check_rig.stream import elbow_distance
from dextar_control.check_rig.torque import TorqueTests
from dextar_control.cli import main as cli
from dextar_control.contract.errors import GeometryError, ParameterError, StateError
from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.settings import default_settings
from dextar_control.contract.topics import JOINT_COMMANDS, JOINT_STATES
from dextar_control.control.loop import ControlLoop
from dextar_control.mechanisms.five_bar import FiveBar
from dextar_control.model.model import Model
from dextar_control.nodekit.node import qos
from dextar_control.nodes import messages

ROOT = Path(__file__).resolve().parents[2]
STATE = "sensor_msgs/msg/JointState"
LIMITS = Limits(
    rate=200.0, watchdog=WATCHDOG, max_torque=0.3, max_gap=0.02, jitter=0.002
)
PERIOD = 5_000_000  # ns
WAY, THOUGHT = (
    200_000,
    100_000,
)  # ns from a stamp to its arrival, and from there to the command
BEGIN = 1_700_000_000 * 10**9
WATCHED = 400  # states

GRAPH = Graph(
    "/joint_states",
    "/joint_commands",
    STATE,
    STATE,
    (Endpoint("/driver", STATE, True),),
    (Endpoint("/driver", STATE, False),),
    (),
)


class SimulatedRig:
    """A driver in simulated time, each state on its way for ``WAY``."""

    def __init__(self, driver: FakeDriver) -> None:
        self.driver = driver
        self.now = BEGIN
        self.commands: list[tuple[float, float]] = []

    def sample(self) -> JointSample | None:
        """One period on; None from a dead driver."""
        self.now += PERIOD
        if not self.driver.alive:
            return None
        fields = self.driver.step(1.0e-9 * self.now)
        stamp = self.now + round(1e9 * (self.driver.stamp(0.0)))
        values = (
            tuple(fields[key]) for key in ("name", "position", "velocity", "effort")
        )
        return JointSample(self.now + WAY, stamp, *values)

    def run(self, tests: TorqueTests) -> None:
        for _ in range(10_000):
            sample = self.sample()
            at = self.now + WAY + THOUGHT
            answer = tests.update(at, sample)
            if answer is not None:
                self.commands.append(answer)
                self.driver.command(["q11", "q21"], list(answer), 1.0e-9 * at)
            if tests.finished:
                return
        raise AssertionError("the tests never end")


def watch(driver: FakeDriver) -> tuple[SimulatedRig, list[JointSample]]:
    rig = SimulatedRig(driver)
    samples = [sample for _ in range(WATCHED) if (sample := rig.sample())]
    return rig, samples


def check(
    robot: RobotParameters, fault: str, graph: Graph = GRAPH, limits: Limits = LIMITS
) -> tuple[dict[str, CheckLine], SimulatedRig]:
    """The whole of ``dextar check-rig`` without DDS."""
    return check_driver(robot, FakeDriver(fault), graph, limits)


def check_driver(
    robot: RobotParameters,
    driver: FakeDriver,
    graph: Graph = GRAPH,
    limits: Limits = LIMITS,
) -> tuple[dict[str, CheckLine], SimulatedRig]:
    rig, samples = watch(driver)
    lines = watch_lines(graph, samples, robot, limits, WATCHED / LIMITS.rate)
    torque: TorqueTests | str = torque_obstacle(lines)
    if not torque:
        torque = torque_tests(lines, limits)
        rig.run(torque)
    return {line.name: line for line in report(lines, samples, torque)}, rig


def results(lines: dict[str, CheckLine], result: Result) -> set[str]:
    return {name for name, line in lines.items() if line.result is result}


def test_a_sound_driver_passes_every_line(robot: RobotParameters) -> None:
    lines, rig = check(robot, "none")
    assert list(lines) == list(LINES)
    assert results(lines, Result.PASS) == set(LINES)
    assert rig.commands[-1] == (0.0, 0.0)
    numbers = lines["response q11"].numbers
    moved = 0.5 * LIMITS.torque / INERTIA * LIMITS.pulse**2
    assert numbers["up"] == pytest.approx(
        moved, rel=0.01
    )  # the pulses are cut to whole periods
    assert numbers["down"] == pytest.approx(-moved, rel=0.01)


@pytest.mark.parametrize(
    ("fault", "failing"),
    [
        ("order", set()),
        ("no_velocity", set()),
        ("names", {"joint names"}),
        ("nan_position", {"finite numbers"}),
        ("stamps_back", {"stamps rise"}),
        ("stamps_jump", {"longest gap"}),
        ("stamps_old", {"stamp age"}),
        ("open", {"closes"}),
        ("ignores_torque", {"response q11", "response q21"}),
        ("inverted", {"response q11"}),
        ("swapped_motors", {"response q11", "response q21"}),
        ("no_watchdog", {"watchdog"}),
        ("accepts_nan", {"refuses NaN"}),
        ("clamps_nan", {"refuses NaN"}),
        ("dies_of_nan", {"refuses NaN"}),
    ],
)
def test_each_fault_fails_its_own_line_alone(
    robot: RobotParameters, fault: str, failing: set[str]
) -> None:
    """What cannot be tried any more is skipped; everything else passes."""
    lines, rig = check(robot, fault)
    assert results(lines, Result.FAIL) == failing
    assert all(line.measured for line in lines.values() if line.result is Result.SKIP)
    if not failing:
        assert results(lines, Result.SKIP) <= {"velocity"}
    assert not rig.commands or rig.commands[-1] == (0.0, 0.0)
    assert np.nanmax(np.abs([(0.0, 0.0), *rig.commands])) <= LIMITS.torque


Fields = dict[str, Any]


class ChangedDriver(FakeDriver):
    """A sound driver whose states are changed before they are sent."""

    def __init__(self, change: Callable[[Fields, int], Fields]) -> None:
        super().__init__()
        self._change = change

    def fields(self) -> Fields:
        return self._change(super().fields(), self.index)


def put(**fields: Any) -> Callable[[Fields, int], Fields]:
    return lambda state, _: state | fields


def third_joint(state: Fields, _: int) -> Fields:
    """As a joint_state_broadcaster sends a gripper of which nothing is measured."""
    return {
        key: [*values, "gripper" if key == "name" else math.nan]
        for key, values in state.items()
    }


def twice(state: Fields, _: int) -> Fields:
    return {key: [*values, values[0]] for key, values in state.items()}


def every_other_order(state: Fields, index: int) -> Fields:
    return {key: values[::-1] for key, values in state.items()} if index % 2 else state


def wrapping(state: Fields, _: int) -> Fields:
    """Encoders of one turn, whose end lies a hundredth of a rad from where the robot
    stands.
    """
    ends = np.array(START) + [0.01, -0.01]
    return state | {
        "position": (
            (
                ends
                - 2.0 * np.pi
                + np.remainder(np.array(state["position"]) - ends, 2.0 * np.pi)
            ).tolist()
        )
    }


def one_joint(state: Fields, index: int) -> Fields:
    """As two broadcasters on one topic, each with one of the joints."""
    return {key: values[index % 2 : index % 2 + 1] for key, values in state.items()}


def other_turn(state: Fields, _: int) -> Fields:
    return state | {
        "position": [
            state["position"][0] + 2.0 * math.pi,
            state["position"][1] - 4.0 * math.pi,
        ]
    }


def no_zero(state: Fields, _: int) -> Fields:
    return {
        key: values if key == "name" else [value or -0.0 for value in values]
        for key, values in state.items()
    }


NEITHER = {"watchdog"}  # cannot be seen without effort


@pytest.mark.parametrize(
    ("change", "noted", "skipped"),
    [
        (
            put(effort=[math.nan, math.nan]),
            {"finite numbers", "effort feedback"},
            NEITHER,
        ),
        (put(velocity=[math.nan, math.nan]), {"finite numbers"}, {"velocity"}),
        (put(velocity=[math.inf, 0.0]), {"finite numbers"}, {"velocity"}),
        (put(velocity=[], effort=[]), {"effort feedback"}, {"velocity", *NEITHER}),
        (put(effort=[0.0]), {"array sizes", "effort feedback"}, NEITHER),
        (put(velocity=[0.0, 0.0, 0.0]), {"array sizes"}, {"velocity"}),
        (third_joint, {"finite numbers"}, set()),
        (twice, {"joint names"}, set()),
        (every_other_order, set(), set()),
        (wrapping, set(), set()),
        (other_turn, set(), set()),
        (no_zero, set(), set()),
        (
            lambda state, _: (
                state | {"velocity": [-value for value in state["velocity"]]}
            ),
            {"velocity"},
            set(),
        ),
    ],
    ids=[
        "effort NaN",
        "velocity NaN",
        "velocity infinite",
        "positions alone",
        "one effort",
        "three velocities",
        "third joint",
        "a name twice",
        "order changes",
        "encoder wraps",
        "other turns",
        "minus zero",
        "velocity of the other sign",
    ],
)
def test_what_the_controller_does_without_is_a_remark(
    robot: RobotParameters,
    change: Callable[[Fields, int], Fields],
    noted: set[str],
    skipped: set[str],
) -> None:
    """Every line that is left is judged, those with torque too, and with the numbers of
    a sound driver.
    """
    lines, rig = check_driver(robot, ChangedDriver(change))
    assert (
        results(lines, Result.NOTE),
        results(lines, Result.SKIP),
        results(lines, Result.FAIL),
    ) == (noted, skipped, set())
    moved = 0.5 * LIMITS.torque / INERTIA * LIMITS.pulse**2
    assert lines["response q11"].numbers["up"] == pytest.approx(moved, rel=0.01)
    assert rig.commands[-1] == (0.0, 0.0)
    assert not has_failed(lines.values())


def test_the_remarks_say_what_is_not_as_it_should_be(robot: RobotParameters) -> None:
    lines, _ = check_driver(robot, ChangedDriver(third_joint))
    said = lines["finite numbers"].measured
    assert (
        f"other joints' positions in {WATCHED}, velocities in {WATCHED}, efforts in"
        f" {WATCHED} of {WATCHED} states" in said
    )
    lines, _ = check_driver(robot, ChangedDriver(twice))
    assert "takes the first q11" in lines["joint names"].measured


@pytest.mark.parametrize("seed", range(40))
def test_the_check_fails_a_state_where_the_controller_refuses_it_and_only_there(
    robot: RobotParameters, seed: int
) -> None:
    """Names, sizes and numbers at random, judged here and by the controller's own
    reader.
    """
    random = np.random.default_rng(seed)
    names = [
        str(name)
        for name in random.permutation(["q11", "q21", "gripper", "q11", "left/q11"])[
            : random.integers(1, 6)
        ]
    ]
    if random.random() < 0.6:
        names = [str(name) for name in random.permutation(["q11", "q21", *names])]
    size = len(names)

    def numbers(sound: float) -> list[float]:
        count = size if random.random() < sound else int(random.integers(0, size + 2))
        return [
            float(
                random.choice(
                    [1.5, -0.0, 7.0, math.nan, math.inf], p=[0.7, 0.1, 0.1, 0.05, 0.05]
                )
            )
            for _ in range(count)
        ]

    fields = {
        "name": names,
        "position": numbers(0.8),
        "velocity": numbers(0.3),
        "effort": numbers(0.3),
    }
    try:
        messages.active_joints(JointState(**fields))
        taken = True
    except StateError:
        taken = False
    samples = [
        JointSample(
            BEGIN + PERIOD * k,
            BEGIN + PERIOD * k,
            *(tuple(values) for values in fields.values()),
        )
        for k in range(50)
    ]
    failing = results(judge(robot, samples), Result.FAIL) & {
        "joint names",
        "array sizes",
        "finite numbers",
    }
    assert bool(failing) is not taken, (fields, failing)


def test_two_broadcasters_with_a_joint_each_fail_with_the_reason(
    robot: RobotParameters,
) -> None:
    lines, rig = check_driver(robot, ChangedDriver(one_joint))
    assert results(lines, Result.FAIL) == {"joint names"}
    assert (
        f"{WATCHED} of {WATCHED} states without both" in lines["joint names"].measured
    )
    assert "two publishers" in lines["joint names"].measured
    assert not rig.commands


def test_a_drive_that_tells_nan_efforts_under_nan_alone_has_taken_it(
    robot: RobotParameters,
) -> None:
    class Leaks(FakeDriver):
        def command(self, names: list[str], efforts: list[float], now: float) -> None:
            self.leaks = not np.isfinite(efforts).all()
            super().command(names, efforts, now)

        def fields(self) -> Fields:
            return super().fields() | (
                {"effort": [math.nan, math.nan]}
                if getattr(self, "leaks", False)
                else {}
            )

    lines, _ = check_driver(robot, Leaks())
    assert results(lines, Result.FAIL) == {"refuses NaN"}
    assert lines["refuses NaN"].numbers["odd"] > 0


def test_repeated_stamps_are_judged_by_the_healthy_time_that_enabling_needs(
    robot: RobotParameters,
) -> None:
    even = [0.005 * index for index in range(401)]

    def repeating(every: int) -> dict[str, CheckLine]:
        return judge(
            robot,
            stream(
                even,
                [
                    0.005 * (index - (index % every == every - 1))
                    for index in range(401)
                ],
            ),
        )

    seldom, often = (
        repeating(150),
        repeating(50),
    )  # 0.75 s and 0.25 s apart; 0.5 s are needed
    assert (seldom["stamps rise"].result, often["stamps rise"].result) == (
        Result.NOTE,
        Result.FAIL,
    )
    assert "never 0.5 s without" in often["stamps rise"].measured


def test_a_driver_that_does_not_stamp_is_not_taken_for_a_lockstep_plant(
    robot: RobotParameters,
) -> None:
    lines = judge(robot, stream([0.005 * index for index in range(200)], [0.0] * 200))
    assert "does not stamp each state" in lines["states"].measured
    assert "lockstep" not in lines["states"].measured


def test_the_working_mode_and_the_side_are_the_controllers(
    robot: RobotParameters,
) -> None:
    """At random poses that close: the line passes where a loop takes the joints for its
    first state, on the side it expects.
    """
    random = np.random.default_rng(3)
    settings, low, high = (
        default_settings(),
        0.0,
        sum(leg.distal_length for leg in robot.legs),
    )
    seen: set[Result] = set()
    for q_a in random.uniform(-np.pi, np.pi, (60, 2)):
        if not low < elbow_distance(robot, q_a[None])[0] < high:
            continue
        taken = {}
        for mode in (1, -1):
            with contextlib.suppress(StateError, GeometryError):
                ControlLoop(robot, settings, mode, enabled=False).step(0.0, q_a)
                taken[mode] = True
        samples = [
            sample._replace(position=tuple(q_a))
            for sample in stream([0.005 * k for k in range(50)])
        ]
        expected = Result.PASS if 1 in taken else Result.NOTE if taken else Result.FAIL
        assert judge(robot, samples)["mode and range"].result is expected, q_a
        seen.add(expected)
    assert {Result.PASS, Result.FAIL} <= seen


def test_a_joint_outside_its_range_fails_as_it_would_trip_the_controller(
    robot: RobotParameters,
) -> None:
    narrow = robot.replace(**{"left.min_angle": 0.0, "left.max_angle": START[0] - 0.06})
    line = judge(narrow, stream([0.005 * k for k in range(50)]))["mode and range"]
    assert line.result is Result.FAIL
    assert line.numbers["beyond"] == pytest.approx(0.06)
    wider = narrow.replace(**{"left.max_angle": START[0] - 0.04})
    assert (
        judge(wider, stream([0.005 * k for k in range(50)]))["mode and range"].result
        is Result.PASS
    )


def test_best_effort_states_are_a_remark(robot: RobotParameters) -> None:
    lines, rig = check(
        robot, "none", GRAPH._replace(drivers=(Endpoint("/driver", STATE, False),))
    )
    assert results(lines, Result.NOTE) == {"QoS"}
    assert not has_failed(lines.values())
    assert rig.commands


def test_two_publishers_of_states_are_named(robot: RobotParameters) -> None:
    lines, _ = check(
        robot, "none", GRAPH._replace(drivers=(Endpoint("/plant", STATE, True),) * 2)
    )
    assert "2 publishers (2 x /plant)" in lines["topics"].measured
    assert "end all but one" in lines["topics"].measured


@pytest.mark.parametrize(
    ("change", "failing"),
    [
        ({"drivers": ()}, {"topics"}),
        ({"drivers": (GRAPH.drivers[0], Endpoint("/other", STATE, True))}, {"topics"}),
        ({"readers": ()}, {"topics"}),
        ({"drivers": (Endpoint("/driver", "std_msgs/msg/String", True),)}, {"types"}),
        ({"readers": (Endpoint("/driver", "std_msgs/msg/String", True),)}, {"types"}),
        (
            {"readers": (Endpoint("/driver", STATE, True, "wants transient local"),)},
            {"QoS"},
        ),
        ({"commanders": (Endpoint("/somebody", STATE, True),)}, {"only commander"}),
    ],
)
def test_what_is_wrong_in_the_graph_fails_its_own_line_and_nothing_is_commanded(
    robot: RobotParameters, change: dict[str, Any], failing: set[str]
) -> None:
    lines, rig = check(robot, "none", GRAPH._replace(**change))
    assert results(lines, Result.FAIL) == failing
    assert results(lines, Result.SKIP) == set(TORQUE_LINES)
    assert rig.commands == []
    assert all(next(iter(failing)) in lines[name].measured for name in TORQUE_LINES)


def stream(
    arrivals: list[float], stamps: list[float] | None = None
) -> list[JointSample]:
    """States at rest with these arrivals and stamps, s."""
    taken = arrivals if stamps is None else stamps
    fields = (("q11", "q21"), START, (0.0, 0.0), (0.0, 0.0))
    return [
        JointSample(BEGIN + round(1e9 * a), BEGIN + round(1e9 * s), *fields)
        for a, s in zip(arrivals, taken, strict=True)
    ]


def judge(robot: RobotParameters, samples: list[JointSample]) -> dict[str, CheckLine]:
    return {line.name: line for line in watch_lines(GRAPH, samples, robot, LIMITS, 1.0)}


def test_rate_jitter_and_gaps_are_those_of_the_arrivals(robot: RobotParameters) -> None:
    even = [0.005 * index for index in range(401)]
    lines = judge(robot, stream(even))
    assert lines["rate"].numbers["rate"] == pytest.approx(200.0)
    assert (
        lines["jitter"].numbers["p99"],
        lines["longest gap"].numbers["gap"],
    ) == pytest.approx((0.0, 0.005))
    slow = judge(robot, stream([1.06 * time_ for time_ in even]))
    assert results(slow, Result.FAIL) == {"rate"}
    assert slow["rate"].numbers["rate"] == pytest.approx(200.0 / 1.06)
    # Every 20th state 2.5 ms late: a tenth of the intervals is off by that, the rate is
    # not, and no gap is long.
    shaky = judge(
        robot,
        stream(
            [time_ + 0.0025 * (index % 20 == 10) for index, time_ in enumerate(even)],
            even,
        ),
    )
    assert results(shaky, Result.FAIL) == {"jitter"}
    assert shaky["jitter"].numbers["p99"] == pytest.approx(0.0025)
    # One of 400 intervals 21 ms: less than one in a hundred.
    gap = judge(
        robot,
        stream([time_ + 0.016 * (index > 200) for index, time_ in enumerate(even)]),
    )
    assert results(gap, Result.FAIL) == {"longest gap"}
    assert gap["longest gap"].numbers["gap"] == pytest.approx(0.021)


def test_stamps_of_another_pace_are_found(robot: RobotParameters) -> None:
    even = [0.005 * index for index in range(401)]
    lines = judge(robot, stream(even, [-0.05 + 1.06 * time_ - 0.12 for time_ in even]))
    assert "stamp period" in results(lines, Result.FAIL)
    assert lines["stamp period"].numbers["ratio"] == pytest.approx(1.06)
    ahead = judge(robot, stream(even, [time_ + 0.006 for time_ in even]))
    assert results(ahead, Result.FAIL) == {"stamp age"}
    assert ahead["stamp age"].numbers["median"] == pytest.approx(-0.006)


def test_a_lockstep_plant_is_told_from_a_dead_driver(robot: RobotParameters) -> None:
    repeated = judge(robot, stream([0.5 * index for index in range(4)], [0.0] * 4))
    assert repeated["states"].result is Result.FAIL
    assert "lockstep" in repeated["states"].measured
    silent = judge(robot, [])
    assert silent["states"].result is Result.FAIL
    assert "none in" in silent["states"].measured
    assert results(silent, Result.FAIL) == {"states"}


def test_the_watchdogs_time_runs_from_the_last_command(robot: RobotParameters) -> None:
    """The state after which the drive has let go is the first one more than its
    time-out after that command.
    """
    lines, _ = check(robot, "none")
    way = PERIOD - WAY - THOUGHT  # the last command comes before the next step by this
    periods = math.ceil((WATCHDOG * 1e9 - way) / PERIOD + 1e-9) + (
        math.remainder(WATCHDOG * 1e9 - way, PERIOD) == 0.0
    )
    assert lines["watchdog"].numbers["time"] == pytest.approx(
        1e-9 * (way + periods * PERIOD + WAY), abs=1e-6
    )


def test_a_drive_that_lets_go_late_fails(robot: RobotParameters) -> None:
    declared = WATCHDOG - 0.02
    limits = Limits(**{**vars(LIMITS), "watchdog": declared})
    lines, _ = check(robot, "none", limits=limits)
    assert results(lines, Result.FAIL) == {"watchdog"}
    assert results(lines, Result.SKIP) == set()


@pytest.mark.parametrize(
    ("change", "words"),
    [({"max_move": 0.01}, "moved"), ({"max_speed": 0.1}, "turned at")],
    ids=["move", "speed"],
)
def test_a_robot_that_leaves_its_limits_gets_no_more_torque(
    robot: RobotParameters, change: dict[str, float], words: str
) -> None:
    lines, rig = check(robot, "none", limits=Limits(**{**vars(LIMITS), **change}))
    assert results(lines, Result.FAIL) == {"response q11"}
    assert words in lines["response q11"].measured
    assert results(lines, Result.SKIP) == {"response q21", "watchdog", "refuses NaN"}
    torques = [max(map(abs, torque)) for torque in rig.commands]
    assert torques[-1] == 0.0
    assert torques[-2] == LIMITS.torque


def test_states_that_stop_under_torque_end_it(robot: RobotParameters) -> None:
    rig, samples = watch(FakeDriver())
    tests = torque_tests(watch_lines(GRAPH, samples, robot, LIMITS, 2.0), LIMITS)
    for _ in range(30):
        last = tests.update(rig.now + WAY + THOUGHT, rig.sample())
    assert last == (LIMITS.torque, 0.0)
    assert tests.update(rig.now + 10_000_000, None) is None
    assert tests.update(rig.now + 40_000_000, None) == (0.0, 0.0)
    assert tests.finished
    assert "no state for" in tests.lines[0].measured


def test_a_test_that_the_machine_disturbs_is_repeated(robot: RobotParameters) -> None:
    rig, samples = watch(FakeDriver())
    limits = Limits(**{**vars(LIMITS), "max_gap": 1.0})
    tests = torque_tests(watch_lines(GRAPH, samples, robot, limits, 2.0), limits)
    for index in range(200):
        at = rig.now + PERIOD + WAY + THOUGHT
        answer = tests.update(at, rig.sample())
        if index == 30:
            rig.now += 350_000_000  # nobody ran for 0.35 s, the whole of + and -
        rig.driver.command(["q11", "q21"], list(answer), 1.0e-9 * at)
        assert not tests.lines or index > 130
    rig.run(tests)
    assert {line.name for line in tests.lines if line.result is Result.PASS} == set(
        TORQUE_LINES
    )
    assert "(try 2)" in tests.lines[0].measured
    assert not any("(try" in line.measured for line in tests.lines[1:])


def test_friction_and_a_coarse_encoder_hide_no_movement(robot: RobotParameters) -> None:
    driver = FakeDriver()
    driver.viscous, driver.count = 0.02, 2.0 * math.pi / 2**13
    rig, samples = watch(driver)
    tests = torque_tests(watch_lines(GRAPH, samples, robot, LIMITS, 2.0), LIMITS)
    rig.run(tests)
    assert {line.name for line in tests.lines if line.result is Result.PASS} == set(
        TORQUE_LINES
    )


def test_the_elbows_are_where_the_mechanism_has_them(uneven: RobotParameters) -> None:
    q_a = np.random.default_rng(1).uniform(-np.pi, np.pi, (50, 2))
    model = Model.of(uneven)
    p, five_bar = model.mechanism.named(model.p), FiveBar()
    elbows = [
        [np.array(five_bar.elbow(leg, row[leg], p)).ravel() for leg in range(2)]
        for row in q_a
    ]
    expected = [np.hypot(*(right - left)) for left, right in elbows]
    np.testing.assert_allclose(elbow_distance(uneven, q_a), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"torque": 0.4}, "test torque = 0.4 N m; it must be <= 0.3"),
        ({"torque": 0.0}, "torque = 0.0; it must be > 0"),
        ({"watchdog": math.nan}, "watchdog = nan"),
        ({"pulse": 0.01}, "pulse = 0.01 s at 200.0 Hz; it must be >= 0.1 s"),
    ],
)
def test_limits_that_make_no_sense_are_refused(
    change: dict[str, float], words: str
) -> None:
    with pytest.raises(ParameterError, match=words):
        Limits(**{**vars(LIMITS), **change})


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--torque", "5"], "torque = 5.0 N m; it must be <= 0.3 N m"),
        (["--rate", "0"], "rate = 0.0; it must be > 0"),
        (["--duration", "0.01"], "duration = 0.01 s"),
        (["--duration", "nan"], "duration = nan s"),
        (["--duration", "inf"], "duration = inf s"),
        (["--wait", "nan"], "wait = nan s"),
        (["--states", "joint states"], "joint states"),
        (["--robot", "nowhere.yaml"], "No such file"),
        (
            ["--json", "nowhere/report.json"],
            "--json nowhere/report.json cannot be written: No such file or directory",
        ),
    ],
)
def test_wrong_arguments_end_with_one_sentence(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["check-rig", *arguments]) == 2
    text = capsys.readouterr().err
    assert words in text
    assert len(text.strip().splitlines()) == 1


# -- over DDS
# ---------------------------------------------------------------------------------------------------------

GENEROUS = (
    "--wait",
    str(PATIENCE),
    "--duration",
    "1.5",
    "--rate",
    "200",
    "--rate-tolerance",
    "0.6",
    "--jitter",
    "0.15",
    "--max-gap",
    "4",
    "--max-age",
    "5",
    "--watchdog",
    str(WATCHDOG),
    "--watchdog-margin",
    "0.4",
    "--max-move",
    "2",
    "--max-speed",
    "10",
)
"""Limits that a busy machine keeps: a driver of 200 Hz may come at 80 Hz, and 0.15 s
off its time once in a hundred.
"""


def check_rig(*arguments: str, **options: Any) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [
            sys.executable,
            "-m",
            "dextar_control.cli.main",
            "check-rig",
            *GENEROUS,
            *arguments,
        ],
        cwd=ROOT,
        text=True,
        **{
            "stdin": subprocess.DEVNULL,
            "stdout": subprocess.PIPE,
            "stderr": subprocess.STDOUT,
            **options,
        },
    )


def outcome(
    tmp_path: Path, *arguments: str
) -> tuple[int, dict[str, dict[str, Any]], str]:
    """(exit code, lines of the report, output) of one check."""
    file = tmp_path / "report.json"
    process = check_rig("--json", str(file), *arguments)
    text, _ = process.communicate(timeout=2 * PATIENCE)
    return process.returncode, reported(file), text


def reported(file: Path) -> dict[str, dict[str, Any]]:
    """The lines of a report by name; none where it was not written."""
    lines = json.loads(file.read_text())["lines"] if file.exists() else []
    return {line["name"]: line for line in lines}


def named(lines: dict[str, dict[str, Any]], result: str) -> set[str]:
    return {name for name, line in lines.items() if line["result"] == result}


@pytest.fixture
def driver() -> Iterator[Callable[[str], None]]:
    processes: list[subprocess.Popen[bytes]] = []

    def begin(fault: str) -> None:
        command = [sys.executable, fake_driver.__file__, fault]
        processes.append(subprocess.Popen(command, stdout=subprocess.PIPE))
        assert processes[-1].stdout.readline() == b"ready\n"

    yield begin
    for process in processes:
        process.kill()
        process.wait()


def test_the_plant_passes_every_line(tmp_path: Path) -> None:
    """At 200 Hz; its stamps fall behind the clock by each overrun, so their age says
    nothing here.
    """
    with ending_well(
        start(
            "dextar_sim.node",
            "-r",
            "__ns:=/left",
            "-p",
            "task.sample_period:=0.005",
            "-p",
            "drive.command_timeout:=0.1",
        )
    ):
        code, lines, text = outcome(
            tmp_path, "--namespace", "/left", "--yes", "--max-age", "1e3"
        )
    assert named(lines, "PASS") == set(LINES), text
    assert code == 0


def test_the_plant_passes_with_arrays_too(tmp_path: Path) -> None:
    with ending_well(
        start(
            "dextar_sim.node",
            "-p",
            "task.sample_period:=0.005",
            "-p",
            "drive.command_timeout:=0.1",
            "-p",
            "command_interface:=effort_array",
            "-r",
            "joint_states:=measured",
            "-r",
            "effort_commands:=wanted",
        )
    ):
        remapped = ("--states", "measured", "--commands", "wanted")
        code, lines, text = outcome(
            tmp_path,
            "--yes",
            "--max-age",
            "1e3",
            "--command-interface",
            "effort_array",
            *remapped,
        )
    assert named(lines, "PASS") == set(LINES), text
    assert code == 0


@pytest.mark.parametrize(
    ("fault", "failing", "torque"),
    [("accepts_nan", {"refuses NaN"}, True), ("latched_reader", {"QoS"}, False)],
)
def test_a_broken_driver_fails_on_its_line_over_dds(
    tmp_path: Path,
    driver: Callable[[str], None],
    fault: str,
    failing: set[str],
    torque: bool,
) -> None:
    driver(fault)
    code, lines, text = outcome(tmp_path, "--yes" if torque else "--no-torque")
    assert named(lines, "FAIL") == failing, text
    assert code == 1


def test_states_offered_best_effort_are_read_and_noted_over_dds(
    tmp_path: Path, driver: Callable[[str], None]
) -> None:
    driver("best_effort")
    code, lines, text = outcome(tmp_path, "--no-torque")
    assert (named(lines, "NOTE"), named(lines, "FAIL"), code) == (
        {"QoS"},
        set(),
        0,
    ), text
    assert "1 noted" in text


def test_who_looks_at_the_wrong_topic_is_told_the_right_one(
    tmp_path: Path, driver: Callable[[str], None]
) -> None:
    driver("none")
    code, lines, text = outcome(
        tmp_path, "--states", "measured", "--yes", "--wait", "3"
    )
    assert code == 1
    assert named(lines, "FAIL") == {"topics", "states"}
    assert "Other topics of that type: /joint_states" in " ".join(text.split())


def test_states_of_another_type_are_no_states(
    tmp_path: Path, driver: Callable[[str], None]
) -> None:
    driver("state_type")
    code, lines, _ = outcome(tmp_path, "--yes", "--wait", "3")
    assert code == 1
    assert named(lines, "FAIL") == {"types", "states"}
    assert "Float64MultiArray" in lines["types"]["measured"]


def test_a_lockstep_plant_is_named(tmp_path: Path) -> None:
    with ending_well(start("dextar_sim.node", "-p", "mode:=lockstep")):
        code, lines, _ = outcome(tmp_path, "--yes", "--duration", "2")
    assert code == 1
    assert named(lines, "FAIL") == {"states"}
    assert "lockstep" in lines["states"]["measured"]


@pytest.fixture
def listener() -> Iterator[tuple[Node, list[JointState]]]:
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node, heard = Node("listener"), []
    node.create_subscription(
        JointState, JOINT_COMMANDS.name, heard.append, qos(JOINT_COMMANDS)
    )
    yield node, heard
    node.destroy_node()
    rclpy.try_shutdown()


def until(node: Node, condition: Callable[[], Any]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        rclpy.spin_once(node, timeout_sec=0.05)
        assert time.monotonic() < deadline


def test_a_second_commander_is_reported_and_nothing_is_commanded(
    tmp_path: Path,
    driver: Callable[[str], None],
    listener: tuple[Node, list[JointState]],
) -> None:
    node, heard = listener
    other = node.create_publisher(JointState, JOINT_COMMANDS.name, qos(JOINT_COMMANDS))
    driver("none")
    code, lines, text = outcome(tmp_path, "--yes")
    rclpy.spin_once(node, timeout_sec=0.1)
    assert named(lines, "FAIL") == {"only commander"}, text
    assert "/listener" in lines["only commander"]["measured"]
    assert (code, heard) == (1, [])
    assert other


def answered(process: subprocess.Popen[str], master: int, answer: str) -> str:
    """What stood on the terminal when the question was asked; it is answered now."""
    shown = b""
    while b"to go on" not in shown:
        shown += os.read(master, 4096)
    os.write(master, f"{answer}\n".encode())
    return " ".join(shown.decode().split())


def drain(master: int, node: Node) -> None:
    """Read a terminal to its end."""
    try:
        while os.read(master, 4096):
            rclpy.spin_once(node, timeout_sec=0.0)
    except OSError:  # how Linux tells that the other side has gone
        os.close(master)


def test_without_a_yes_the_robot_never_moves(
    tmp_path: Path,
    driver: Callable[[str], None],
    listener: tuple[Node, list[JointState]],
) -> None:
    node, heard = listener
    driver("none")
    file = tmp_path / "report.json"
    master, slave = pty.openpty()
    process = check_rig("--json", str(file), stdin=slave, stdout=slave, stderr=slave)
    os.close(slave)
    question = answered(process, master, "no")
    assert "0.005" in question
    assert "emergency stop" in question
    drain(master, node)
    assert process.wait(PATIENCE) == 0
    lines = reported(file)
    assert named(lines, "SKIP") == set(TORQUE_LINES)
    assert heard == []


@pytest.mark.parametrize(
    "number",
    [signal.SIGINT, signal.SIGTERM, signal.SIGHUP],
    ids=["SIGINT", "SIGTERM", "SIGHUP"],
)
def test_a_signal_under_torque_leaves_zero_torque(
    driver: Callable[[str], None], listener: tuple[Node, list[JointState]], number: int
) -> None:
    """The torque was allowed by a yes on the terminal for the one, by --yes for the
    other.
    """
    node, heard = listener
    driver("none")
    master, slave = pty.openpty()
    process = check_rig(
        *(["--yes"] if number != signal.SIGINT else []),
        stdin=slave,
        stdout=slave,
        stderr=slave,
    )
    os.close(slave)
    if number == signal.SIGINT:
        answered(process, master, "yes")
    until(node, lambda: any(max(message.effort) > 0.0 for message in heard))
    process.send_signal(number)
    drain(master, node)
    assert process.wait(PATIENCE) == 128 + number
    before = -1
    while len(heard) > before:  # what waits for the listener is heard first
        before = len(heard)
        for _ in range(10):
            rclpy.spin_once(node, timeout_sec=0.05)
    assert list(heard[-1].effort) == [0.0, 0.0]


def test_a_second_driver_under_torque_ends_it(
    tmp_path: Path,
    driver: Callable[[str], None],
    listener: tuple[Node, list[JointState]],
) -> None:
    node, heard = listener
    driver("none")
    file = tmp_path / "report.json"
    process = check_rig("--yes", "--json", str(file), "--pulse", "2")
    until(node, lambda: any(max(message.effort) > 0.0 for message in heard))
    other = node.create_publisher(JointState, JOINT_STATES.name, qos(JOINT_STATES))
    text, _ = process.communicate(timeout=2 * PATIENCE)
    lines = reported(file)
    assert process.returncode == 1, text
    assert lines["topics"]["result"] == "FAIL"
    assert "2 publishers of states while torque was sent" in lines["topics"]["measured"]
    assert "another publisher of joint states came" in lines["refuses NaN"]["measured"]
    until(node, lambda: list(heard[-1].effort) == [0.0, 0.0])
    assert other
