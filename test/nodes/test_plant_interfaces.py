"""The plant under commanders that are not our controller: ros2_control's topics, in
their QoS and message layouts.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from patience import PATIENCE
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from rig import start, stop
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from dextar_control.contract.errors import StateError
from dextar_control.contract.topics import (
    DIAGNOSTICS,
    EFFORT_COMMANDS,
    JOINT_COMMANDS,
    JOINT_STATES,
)
from dextar_control.nodekit.cdr import to_time
from dextar_control.nodekit.node import qos
from dextar_sim.messages import read_efforts

HARDWARE_COMMANDS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
"""What joint_state_topic_hardware_interface publishes commands with; it reads states
with SensorDataQoS.
"""
TORQUE = [1.0e-4, -2.0e-4]
NONE = [0.0, 0.0]


class Commander:
    """Commands at each state, whatever ``make`` gives; keeps the efforts that come
    back.
    """

    def __init__(
        self, kind: Any, name: str, profile: QoSProfile, *parameters: str
    ) -> None:
        self.node = Node("bridge")
        self.efforts: list[list[float]] = []
        self.health: dict[str, str] = {}
        self.make: Callable[[], Any] = lambda: None
        self.commands = self.node.create_publisher(kind, name, profile)
        self.node.create_subscription(
            JointState, JOINT_STATES.name, self._on_state, qos_profile_sensor_data
        )
        self.node.create_subscription(
            DiagnosticArray, DIAGNOSTICS.name, self._on_health, qos(DIAGNOSTICS)
        )
        self.process = start(
            "dextar_sim.node", *(part for value in parameters for part in ("-p", value))
        )

    def _on_state(self, state: JointState) -> None:
        self.efforts.append(list(state.effort))
        message = self.make()
        if message is not None:
            self.commands.publish(message)

    def _on_health(self, array: DiagnosticArray) -> None:
        self.health = {item.key: item.value for item in array.status[0].values} | {
            "message": array.status[0].message
        }

    def until(self, condition: Callable[[], Any]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            rclpy.spin_once(self.node, timeout_sec=0.05)
            assert time.monotonic() < deadline, f"{self.efforts[-1:]} {self.health}"

    def until_effort(self, effort: list[float]) -> None:
        self.until(lambda: self.efforts and self.efforts[-1] == effort)

    def more(self, count: int) -> list[list[float]]:
        """The efforts of the next states."""
        seen = len(self.efforts)
        self.until(lambda: len(self.efforts) >= seen + count)
        return self.efforts[seen:]


@pytest.fixture
def run() -> Iterator[Callable[..., Commander]]:
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    made: list[Commander] = []

    def make(*arguments: Any) -> Commander:
        made.append(Commander(*arguments))
        return made[-1]

    yield make
    for commander in made:
        stop(commander.process)
        commander.node.destroy_node()
    rclpy.try_shutdown()


def by_own_clock(ahead: int = 0) -> JointState:
    """A command as joint_state_topic_hardware_interface stamps it: when it was sent."""
    message = JointState(name=["q21", "q11"], effort=TORQUE[::-1])
    message.header.stamp = to_time(time.time_ns() + ahead)
    return message


def test_commands_stamped_with_the_senders_clock_move_a_real_time_plant(
    run: Callable[..., Commander],
) -> None:
    commander = run(JointState, JOINT_COMMANDS.name, HARDWARE_COMMANDS)
    commander.make = by_own_clock
    commander.until_effort(TORQUE)
    commander.until(lambda: int(commander.health.get("commands_received", 0)) > 0)
    assert commander.health["commands_refused"] == "0"
    commander.make = lambda: None
    commander.until_effort(NONE)


def test_stamps_ahead_of_the_clock_are_refused(run: Callable[..., Commander]) -> None:
    commander = run(JointState, JOINT_COMMANDS.name, HARDWARE_COMMANDS)
    commander.make = lambda: by_own_clock(ahead=10**10)
    commander.until(lambda: int(commander.health.get("commands_refused", 0)) > 10)
    assert all(effort == NONE for effort in commander.efforts)
    assert "system clock" in stop(commander.process)[1]


def test_arrays_move_the_plant_and_fall_silent_with_their_sender(
    run: Callable[..., Commander],
) -> None:
    commander = run(
        Float64MultiArray,
        EFFORT_COMMANDS.name,
        HARDWARE_COMMANDS,
        "command_interface:=effort_array",
    )
    commander.make = lambda: Float64MultiArray(data=TORQUE)
    commander.until_effort(TORQUE)
    commander.make = lambda: None
    commander.until_effort(NONE)
    for bad in ([math.nan, 0.0], [math.inf, 0.0], [0.1], [0.1, 0.1, 0.1], []):
        commander.make = lambda bad=bad: Float64MultiArray(data=bad)
        assert all(effort == NONE for effort in commander.more(20))
    commander.until(lambda: int(commander.health.get("commands_refused", 0)) >= 5)
    commander.until(
        lambda: "effort_commands were refused" in commander.health["message"]
    )


def test_only_publishers_of_the_topic_in_use_count(
    run: Callable[..., Commander],
) -> None:
    commander = run(
        Float64MultiArray,
        EFFORT_COMMANDS.name,
        HARDWARE_COMMANDS,
        "command_interface:=effort_array",
    )
    other = [
        commander.node.create_publisher(JointState, JOINT_COMMANDS.name, 1)
        for _ in range(2)
    ]
    commander.make = lambda: Float64MultiArray(data=TORQUE)
    commander.until_effort(TORQUE)
    commander.until(lambda: commander.health.get("command_publishers") == "1")
    second = commander.node.create_publisher(Float64MultiArray, EFFORT_COMMANDS.name, 1)

    def both() -> Float64MultiArray:
        second.publish(Float64MultiArray(data=TORQUE))
        return Float64MultiArray(data=TORQUE)

    commander.make = both
    commander.until(lambda: commander.health.get("command_publishers") == "2")
    commander.until_effort(NONE)
    assert all(effort == NONE for effort in commander.more(500))
    assert other


def test_arrays_in_lockstep_are_refused() -> None:
    process = start(
        "dextar_sim.node",
        "-p",
        "command_interface:=effort_array",
        "-p",
        "mode:=lockstep",
    )
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2
    assert "in mode lockstep it must be joint_state" in output


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ([1.0], "1 efforts; expected 2"),
        ([1.0, 2.0, 3.0], "3 efforts"),
        ([1.0, math.nan], "not finite"),
    ],
)
def test_an_array_that_cannot_be_used_is_named(data: list[float], words: str) -> None:
    with pytest.raises(StateError, match=words):
        read_efforts(bytes(serialize_message(Float64MultiArray(data=data))))


def test_an_array_is_in_the_contracts_order() -> None:
    assert read_efforts(
        bytes(serialize_message(Float64MultiArray(data=TORQUE)))
    ) == tuple(TORQUE)
    assert EFFORT_COMMANDS.joints == JOINT_COMMANDS.joints
