"""The controller as a managed node, over its services and real DDS, with this process
as the rig.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from rcl_interfaces.srv import DescribeParameters, ListParameters
from rig import Rig, controlled, matched

from dextar_control.contract.controller_parameters import CONTROLLER
from dextar_control.contract.robot import ROBOT_KEYS
from dextar_control.nodekit.cdr import from_time
from dextar_control.planning.planner import Plan

MS = 1_000_000  # ns
CYCLES = 15


@pytest.fixture(scope="module")
def asleep() -> Iterator[Rig]:
    """A controller that waits to be configured; each test leaves it so."""
    with controlled("autostart:=false", "joint_states.healthy_time:=0.0") as rig:
        yield rig


def test_every_parameter_is_open_until_configured_and_then_only_the_live_ones(
    asleep: Rig, q_a: np.ndarray
) -> None:
    assert asleep.lifecycle == "unconfigured"
    assert asleep.put("controller", law="classic", estimator="dgm") == ["", ""]
    assert asleep.change("configure")
    fixed = "'law' is fixed while the node is inactive; clean it up first"
    assert asleep.put(
        "controller", law="projected", feedback__natural_frequency=60.0
    ) == [
        fixed,
        "",
    ]
    assert asleep.change("activate")
    matched(asleep)
    asleep.answer(1 * MS, q_a)
    asleep.until_phase("HOLD")
    assert (asleep.controller("law"), asleep.controller("estimator")) == (
        "classic",
        "dgm",
    )
    assert "while the node is active" in asleep.put("controller", law="projected")[0]
    assert asleep.put("controller", law="magic", robot__max_torque=1.0) != ["", ""]
    assert asleep.change("deactivate")
    assert asleep.change("cleanup")
    assert asleep.put(
        "controller",
        law="consistent",
        estimator="observer",
        feedback__natural_frequency=50.0,
    ) == ["", "", ""]


def test_a_configuration_that_cannot_be_is_refused_and_the_next_one_taken(
    asleep: Rig,
) -> None:
    assert asleep.put("controller", crossing_test__unknown_below_abs_s=0.3) == [""]
    assert not asleep.change("configure")
    assert asleep.lifecycle == "unconfigured"
    assert asleep.node.count_publishers("joint_commands") == 0
    assert asleep.put("controller", crossing_test__unknown_below_abs_s=0.15) == [""]
    assert asleep.change("configure")
    assert asleep.change("cleanup")


@pytest.mark.parametrize("transition", ["activate", "deactivate", "cleanup", "juggle"])
def test_a_transition_that_the_state_does_not_have_is_refused_and_ends_nothing(
    asleep: Rig, transition: str
) -> None:
    assert not asleep.change(transition)
    assert asleep.lifecycle == "unconfigured"


def test_deactivating_takes_the_torque_away_at_once_and_answers_no_more(
    asleep: Rig, q_a: np.ndarray
) -> None:
    assert asleep.change("configure")
    assert asleep.change("activate")
    matched(asleep)
    asleep.answer(1 * MS, q_a)
    assert asleep.answer(2 * MS, q_a + [1e-3, 0.0]).effort[0] < 0.0
    assert asleep.change("deactivate")
    asleep.until(
        lambda: list(asleep.commands[-1].effort) == [0.0, 0.0], "no last command"
    )
    assert from_time(asleep.commands[-1].header.stamp) == 2 * MS
    for tick in range(3, 8):
        asleep.send(tick * MS, q_a)
        assert asleep.lifecycle == "inactive"
    assert not asleep.enable().success
    assert asleep.change("activate")
    again = asleep.answer(
        100 * MS, q_a + [1e-3, 0.0]
    )  # a new beginning: no gap, and no torque until it is asked for
    assert list(again.effort) == [0.0, 0.0]
    assert {from_time(command.header.stamp) for command in asleep.commands} == {
        1 * MS,
        2 * MS,
        100 * MS,
    }
    assert asleep.controller("phase") in ("", "IDLE")
    assert asleep.enable().success
    assert asleep.change("deactivate")
    assert asleep.change("cleanup")
    asleep.commands.clear()


def test_a_fault_stays_latched_over_deactivation(asleep: Rig, q_a: np.ndarray) -> None:
    assert asleep.change("configure")
    assert asleep.change("activate")
    matched(asleep)
    asleep.answer(1 * MS, q_a)
    asleep.answer(50 * MS, q_a)
    asleep.until_phase("FAULT")
    assert asleep.change("deactivate")
    assert asleep.change("activate")
    asleep.answer(60 * MS, q_a)
    asleep.until_phase("FAULT")
    assert "no state for 49.0 ms" in asleep.controller("reason")
    assert not asleep.enable().success
    assert asleep.reset().success
    assert asleep.enable().success
    assert asleep.change("deactivate")
    assert asleep.change("cleanup")


def test_it_may_be_configured_and_cleaned_up_again_and_again_while_states_come(
    asleep: Rig, q_a: np.ndarray
) -> None:
    """Also with another reliability: the subscription is another one each time."""
    stamp = 0
    for cycle in range(CYCLES):
        assert asleep.put("controller", lockstep=cycle % 2 == 0) == [""]
        assert asleep.change("configure")
        assert asleep.change("activate")
        matched(asleep)
        for _ in range(10):
            stamp += MS
            asleep.send(stamp, q_a)
        asleep.until(lambda: asleep.commands, "no answer")
        asleep.send(stamp + MS, q_a)
        assert asleep.change("deactivate")
        assert asleep.change("cleanup")
        asleep.until(
            lambda: asleep.node.count_publishers("joint_commands") == 0,
            "the publisher is still there",
        )
        asleep.commands.clear()
        stamp += 1000 * MS
    assert asleep.put("controller", lockstep=True) == [""]


def test_a_trajectory_from_while_it_was_not_active_moves_nothing(
    asleep: Rig, q_a: np.ndarray, trip: Plan
) -> None:
    assert asleep.change("configure")
    asleep.until(
        lambda: asleep.trajectories.get_subscription_count() == 1,
        "nobody reads the trajectory",
    )
    asleep.serve(trip)
    assert asleep.lifecycle == "inactive"
    assert asleep.change("activate")
    matched(asleep)
    for tick in range(1, 30):
        asleep.answer(tick * MS, q_a)
        assert asleep.lifecycle == "active"  # a watch period each at least
    asleep.until_phase("HOLD")
    asleep.until(
        lambda: "before this controller began" in asleep.controller("trajectory"),
        "it is not refused",
    )
    assert asleep.controller("phase") == "HOLD"
    asleep.serve(trip)
    asleep.until(
        lambda: asleep.controller("trajectory") == "accepted", "a new one is not taken"
    )
    assert asleep.change("deactivate")
    assert asleep.change("cleanup")


def test_no_parameter_is_without_description_and_range(asleep: Rig) -> None:
    listed = asleep.call(ListParameters, "controller/list_parameters").result.names
    described = asleep.call(
        DescribeParameters, "controller/describe_parameters", names=listed
    )
    told = {descriptor.name: descriptor for descriptor in described.descriptors}
    assert {spec.name for spec in CONTROLLER} <= told.keys()
    for spec in CONTROLLER:
        descriptor = told[spec.name]
        assert descriptor.description == spec.measured
        assert not descriptor.read_only
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        if spec.choices:
            assert all(
                choice in descriptor.additional_constraints for choice in spec.choices
            )
        elif spec.bounds is not None:
            assert (ranges[0].from_value, ranges[0].to_value) == spec.bounds
    robot = {
        name.removeprefix("robot."): each.description
        for name, each in told.items()
        if name.startswith("robot.")
    }
    assert robot and robot.items() <= ROBOT_KEYS.items()


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("feedback.natural_frequency", 1e4, "500"),
        ("joint_states.healthy_time", -1.0, "Min: 0.0"),
        ("joint_states.timeout", float("nan"), "value: nan"),
        ("assembly_mode", 0, "must be +1 or -1"),
        ("safe_stop.brake_time", "long", "a number"),
    ],
)
def test_a_live_change_out_of_range_is_refused_with_the_reason(
    asleep: Rig, name: str, value: object, words: str
) -> None:
    assert words in asleep.put("controller", **{name: value})[0]


def test_a_shut_down_controller_stays_without_torque(
    asleep: Rig, q_a: np.ndarray
) -> None:
    """The last test of this file: nothing leads out of finalized."""
    assert asleep.change("configure")
    assert asleep.change("activate")
    matched(asleep)
    asleep.answer(1 * MS, q_a)
    assert asleep.answer(2 * MS, q_a + [1e-3, 0.0]).effort[0] < 0.0
    assert asleep.change("shutdown")
    asleep.until(
        lambda: list(asleep.commands[-1].effort) == [0.0, 0.0], "no last command"
    )
    assert asleep.lifecycle == "finalized"
    assert not asleep.change("configure")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            "coast_s",
            "'coast_s' is now called 'safe_stop.coast_below_abs_s'; set that",
        ),
        (
            "safe_stop.brake_gian",
            "unknown parameter 'safe_stop.brake_gian'; did you mean"
            " 'safe_stop.brake_gain'?",
        ),
    ],
)
def test_a_name_that_is_no_longer_or_never_was_is_refused_with_the_one_to_set(
    asleep: Rig, name: str, said: str
) -> None:
    assert asleep.put("controller", **{name: 0.1}) == [said]
