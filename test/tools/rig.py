"""A rig written out in a test process: joint states out, commands in, all paced by
stamps.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from patience import PATIENCE
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from dextar_control.contract.topics import (
    DIAGNOSTICS,
    JOINT_COMMANDS,
    JOINT_STATES,
    TRAJECTORY,
)
from dextar_control.nodekit.cdr import from_time, to_time
from dextar_control.nodekit.node import qos
from dextar_control.nodes.messages import from_trajectory
from dextar_control.nodes.trajectory_server import served_times
from dextar_control.planning.planner import Plan

# of one robot in lockstep: module and parameters
NODES = {
    "plant": ("dextar_sim.node", ("mode:=lockstep",)),
    "controller": ("dextar_control.nodes.controller", ("lockstep:=true",)),
    "trajectory_server": (
        "dextar_control.nodes.trajectory_server",
        ("task.dwell:=0.05",),
    ),
    "recorder": ("dextar_control.nodes.recorder", ()),
}


class Rig:
    """Joint states by hand, and everything a controller says."""

    def __init__(self) -> None:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("rig")
        self.commands: list[JointState] = []
        self._clients: dict[str, Any] = {}
        self.status: dict[
            str, dict[str, str]
        ] = {}  # by node name, and by its full name
        self.states = self.node.create_publisher(
            JointState, JOINT_STATES.name, qos(JOINT_STATES)
        )
        self.trajectories = self.node.create_publisher(
            MultiDOFJointTrajectory, TRAJECTORY.name, qos(TRAJECTORY)
        )
        self.node.create_subscription(
            JointState, JOINT_COMMANDS.name, self.commands.append, qos(JOINT_COMMANDS)
        )
        self.node.create_subscription(
            DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, qos(DIAGNOSTICS)
        )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            told = {"message": status.message, "level": str(status.level[0])}
            self.status[status.name] = self.status[status.name.rpartition("/")[2]] = (
                values | told
            )

    def until(self, condition: Callable[[], Any], what: str) -> None:
        """Spin until something holds."""
        deadline = time.monotonic() + PATIENCE
        while not condition():
            rclpy.spin_once(self.node, timeout_sec=0.05)
            assert time.monotonic() < deadline, f"{what}; {self.status}"

    def send(
        self, stamp: int, positions: Any, names: tuple[str, ...] = ("q11", "q21")
    ) -> None:
        """One joint state; stamp in ns."""
        message = JointState(
            name=list(names), position=[float(value) for value in positions]
        )
        message.header.stamp = to_time(stamp)
        self.states.publish(message)

    def answer(
        self, stamp: int, positions: Any, names: tuple[str, ...] = ("q11", "q21")
    ) -> JointState:
        """The command that answers one joint state."""
        self.send(stamp, positions, names)
        self.until(
            lambda: (
                self.commands and from_time(self.commands[-1].header.stamp) == stamp
            ),
            f"no answer to {stamp}",
        )
        return self.commands[-1]

    def hold(self, stamps: Iterable[int], positions: Any) -> JointState:
        """The last command that answers states of one pose at these stamps, ns."""
        return [self.answer(stamp, positions) for stamp in stamps][-1]

    def ask(self, kind: Any, name: str, **fields: Any) -> Any:
        """The answer to come of a service."""
        client = self._clients.get(name) or self.node.create_client(kind, name)
        self._clients[name] = client
        self.until(client.service_is_ready, f"no service {name}")
        return client.call_async(kind.Request(**fields))

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        """The answer of a service."""
        future = self.ask(kind, name, **fields)
        self.until(future.done, f"no answer of {name}")
        return future.result()

    def put(self, node: str, **values: Any) -> list[str]:
        """Set parameters by their service, a dot as two underscores; why each was
        refused, empty where it was not.
        """
        parameters = [
            Parameter(name.replace("__", "."), value=value).to_parameter_msg()
            for name, value in values.items()
        ]
        answer = self.call(
            SetParameters, f"{node}/set_parameters", parameters=parameters
        )
        return ["" if result.successful else result.reason for result in answer.results]

    def enable(self, data: bool = True) -> SetBool.Response:
        """The controller's answer to being enabled, or disabled."""
        return self.call(SetBool, "controller/enable", data=data)

    def reset(self) -> Trigger.Response:
        """The controller's answer to being reset."""
        return self.call(Trigger, "controller/reset")

    def serve(self, trip: Plan, start: int = 0) -> None:
        """A plan's trajectory as the server sends it, from a stamp on, ns; 0 is at
        once.
        """
        times = served_times(trip.trajectory, trip.certificate, 1e-3)
        self.trajectories.publish(from_trajectory(trip.trajectory, times, start))

    def change(self, transition: str) -> bool:
        """A lifecycle transition of the controller, by its label."""
        asked = Transition(label=transition)
        return bool(
            self.call(ChangeState, "controller/change_state", transition=asked).success
        )

    @property
    def lifecycle(self) -> str:
        """The controller's lifecycle state."""
        return str(self.call(GetState, "controller/get_state").current_state.label)

    def until_phase(self, *phases: str) -> None:
        """Spin until the controller tells one of these phases."""
        self.until(
            lambda: self.controller("phase") in phases, f"not in {' or '.join(phases)}"
        )

    def controller(self, key: str) -> str:
        """A value of the controller's diagnostics."""
        return self.status.get("controller", {}).get(key, "")

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown()


@contextlib.contextmanager
def controlled(*parameters: str) -> Iterator[Rig]:
    """A controller in lockstep with these NAME:=VALUE, and this process as its rig; it
    must end without a word too many.
    """
    arguments = [
        part
        for value in ("lockstep:=true", *parameters)
        for part in ("-p", f"controller:{value}")
    ]
    with (
        contextlib.closing(Rig()) as rig,
        ending_well(start("dextar_control.nodes.controller", *arguments)),
    ):
        rig.until(lambda: rig.controller("lifecycle"), "the controller did not start")
        yield rig


@contextlib.contextmanager
def ending_well(*processes: subprocess.Popen[str]) -> Iterator[None]:
    """Nodes that run meanwhile; then each, the last one first, must end with code 0 and
    without a traceback.
    """
    try:
        yield
    finally:
        ends = [stop(process) for process in reversed(processes)]
    for code, output in ends:
        assert code == 0, output
        assert "Traceback" not in output, output


def matched(rig: Rig) -> None:
    """Wait until a controller reads the states and its commands are read."""
    rig.until(
        lambda: (
            rig.node.count_subscribers("joint_states")
            and rig.node.count_publishers("joint_commands")
        ),
        "no match",
    )
    rig.until(
        lambda: rig.states.get_subscription_count() == 1, "nobody reads the states"
    )


def start(module: str, *arguments: str) -> subprocess.Popen[str]:
    """A node in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", module, "--ros-args", *arguments],
        text=True,
        env=dict(os.environ),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        cwd=Path(__file__).parents[2],
    )


def stop(
    process: subprocess.Popen[str], number: int = signal.SIGINT
) -> tuple[int, str]:
    """(exit code, output) of a node ended by a signal."""
    if process.poll() is None:
        process.send_signal(number)
    try:
        output, _ = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    return process.returncode, output
