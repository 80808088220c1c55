"""A rig written out in a test process: joint states out, commands in, all paced by stamps."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectory

from dextar_control.contract.cdr import from_time, to_time
from dextar_control.contract.node import qos
from dextar_control.contract.topics import DIAGNOSTICS, JOINT_COMMANDS, JOINT_STATES, TRAJECTORY

PATIENCE = 60.0  # s until something that must happen counts as not happening: nothing is timed


class Rig:
    """Joint states by hand, and everything a controller says."""

    def __init__(self) -> None:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("rig")
        self.commands: list[JointState] = []
        self.status: dict[str, dict[str, str]] = {}
        self.states = self.node.create_publisher(JointState, JOINT_STATES.name, qos(JOINT_STATES))
        self.trajectories = self.node.create_publisher(MultiDOFJointTrajectory, TRAJECTORY.name, qos(TRAJECTORY))
        self.node.create_subscription(JointState, JOINT_COMMANDS.name, self.commands.append, qos(JOINT_COMMANDS))
        self.node.create_subscription(DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, qos(DIAGNOSTICS))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            self.status[status.name.rpartition("/")[2]] = values | {"message": status.message}

    def until(self, condition: Callable[[], Any], what: str) -> None:
        """Spin until something holds."""
        deadline = time.monotonic() + PATIENCE
        while not condition():
            rclpy.spin_once(self.node, timeout_sec=0.05)
            assert time.monotonic() < deadline, f"{what}; {self.status}"

    def send(self, stamp: int, positions: Any, names: tuple[str, ...] = ("q11", "q21")) -> None:
        """One joint state; stamp in ns."""
        message = JointState(name=list(names), position=[float(value) for value in positions])
        message.header.stamp = to_time(stamp)
        self.states.publish(message)

    def answer(self, stamp: int, positions: Any, names: tuple[str, ...] = ("q11", "q21")) -> JointState:
        """The command that answers one joint state."""
        self.send(stamp, positions, names)
        self.until(lambda: self.commands and from_time(self.commands[-1].header.stamp) == stamp, f"no answer to {stamp}")
        return self.commands[-1]

    def controller(self, key: str) -> str:
        """A value of the controller's diagnostics."""
        return self.status.get("controller", {}).get(key, "")

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown()


def start(module: str, *arguments: str) -> subprocess.Popen[str]:
    """A node in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", module, "--ros-args", *arguments], text=True, env=dict(os.environ),
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, cwd=Path(__file__).parents[1],
    )  # fmt: skip


def stop(process: subprocess.Popen[str], number: int = signal.SIGINT) -> tuple[int, str]:
    """(exit code, output) of a node ended by a signal."""
    if process.poll() is None:
        process.send_signal(number)
    try:
        output, _ = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    return process.returncode, output
