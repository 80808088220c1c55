"""The nodes that faults are done to, the recorder among them, and what an operator does
to recover the robot.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from std_srvs.srv import SetBool, Trigger

from dextar_control.contract.errors import NodesError
from dextar_control.contract.validation import validate
from dextar_control.contract.yaml_text import assignment
from dextar_control.control.phases import Phase
from dextar_control.experiments.faults.cases import FaultConfig
from dextar_control.experiments.faults.injector import REMAPPINGS
from dextar_control.experiments.faults.link import Transport
from dextar_control.experiments.faults.monitor import StackMonitor
from dextar_control.experiments.processes import Processes, node_arguments
from dextar_control.nodekit.cdr import NANOSECONDS
from dextar_control.nodekit.client import start_ros

START_TIMEOUT = 120.0  # s, on a busy machine
RECOVERY_PATIENCE = 30.0  # s until a robot that does not come back to HOLD is given up
LAST_WORDS = 0.3  # s
LEASE_PATIENCE = 60.0  # s
HOLD_WAIT = 0.1  # s


@dataclass(frozen=True)
class SessionRequest:
    """What a session is asked for.

    Attributes:
        folder: of logs and bags.
        clock: ``lockstep`` or ``realtime``.
        cases: name and count of faulted crossings of each case, in this order.
        config: the cases' file as plain data.
        seed: of all chance.
        injector: whether one stands between rig and controller.
        record: whether a recorder runs beside.
        prefix: command words before a node's own, by name.
        plant: further parameters of the plant, NAME:=VALUE.
        modules: run in the place of a node's own, by name: another driver or
            controller.
    """

    folder: str
    clock: str
    cases: dict[str, int]
    config: dict[str, object]
    seed: int
    injector: bool
    record: bool
    prefix: dict[str, list[str]] = field(default_factory=dict)
    plant: list[str] = field(default_factory=list)
    modules: dict[str, str] = field(default_factory=dict)


class Stack:
    """Runs the nodes of one request, with a monitor beside them.

    Attributes:
        folder: of logs and bags.
        config: of the cases.
        lockstep: the rig waits for the answer to each state.
        processes: the nodes.
        monitor: hears and asks them.
        answers: what they said to what was asked of them in this trip.
    """

    def __init__(self, request: SessionRequest) -> None:
        self.request = request
        self.folder = Path(request.folder)
        self.config = validate(FaultConfig, request.config, "cases")
        self.lockstep = request.clock == "lockstep"
        self.bags = 0
        self._arguments = self._node_arguments()
        self.processes = Processes(
            self.folder, prefix=request.prefix, modules=request.modules
        )
        self.answers: list[str] = []
        start_ros()
        self.monitor = StackMonitor(injector=request.injector, lockstep=self.lockstep)

    def _node_arguments(self) -> dict[str, list[str]]:
        trip = self.config.trip
        values = {
            "plant": [
                assignment("mode", self.request.clock),
                assignment("simulation.real_time_factor", 0.0),
                assignment("simulation.start_paused", True),
                *self.request.plant,
            ],
            "controller": [assignment("lockstep", self.lockstep)],
            "trajectory_server": [
                assignment("task.duration", trip.duration),
                assignment("task.dwell", trip.dwell),
            ],
            "recorder": [assignment("topics.reliable", self.lockstep)],
        }
        remapped = {"plant": REMAPPINGS} if self.request.injector else {}
        return {
            name: node_arguments(name, own, remappings=remapped.get(name, ()))
            for name, own in values.items()
        }

    def bag(self) -> Path:
        """Return the path of the next recording, in a folder of its own: a bag's
        metadata belong to it alone.
        """
        self.bags += 1
        path = self._bag_path()
        path.parent.mkdir()
        return path

    def _bag_path(self) -> Path:
        return self.folder / f"bag-{self.bags}" / "run.mcap"

    def current_bag(self) -> Path | None:
        """Return the path of the recording under way."""
        return self._bag_path() if self.bags else None

    def start_recorder(
        self,
        *,
        wrap: Sequence[str] = (),
        path: Path | None = None,
        limit: Callable[[], None] | None = None,
        parameters: Mapping[str, str] | None = None,
    ) -> Path:
        """Start the recorder; return the path of its bag."""
        path = path or self.bag()
        extra = [
            part
            for item in {"output": path, **(parameters or {})}.items()
            for part in ("-p", f"recorder:{assignment(*item)}")
        ]
        arguments = [*self._arguments["recorder"], *extra]
        self.processes.start("recorder", arguments, wrap=wrap, limit=limit)
        return path

    def begin(self) -> None:
        """Start the nodes, let the time run and bring the robot to HOLD."""
        names = ["plant", "controller", "trajectory_server"]
        if self.request.record:
            self.start_recorder()
            names.append("recorder")
        for name in names:
            if name != "recorder":
                self.processes.start(name, self._arguments[name])

        def ready() -> bool:
            self.processes.check()
            planned = self.monitor.get("trajectory_server", "crossings")
            return bool(planned) and all(name in self.monitor.status for name in names)

        if not self.monitor.until(ready, START_TIMEOUT):
            heard = ", ".join(sorted(self.monitor.status)) or "none"
            raise NodesError(
                f"the nodes were not ready within {START_TIMEOUT:.0f} s; heard of:"
                f" {heard}"
            )
        self.monitor.call(SetBool, "plant/pause", data=False)
        if not self.recover():
            raise NodesError(
                "the controller does not hold:"
                f" {self.monitor.get('controller', 'reason')}"
            )

    def holding(self) -> bool:
        """Tell whether the controller says, and its answers show, that it holds."""
        return (
            self.monitor.get("controller", "phase") == Phase.HOLD.name
            and self.monitor.phase == Phase.HOLD
        )

    def recover(self, *, disable: bool = False) -> bool:
        """Recover the robot as an operator does: tell the side, reset, put the robot at
        its start, enable; tell whether it then holds.

        The drives take commands again once one commander alone has spoken for a while,
        whoever the middleware still counts as publisher: that is waited for.

        Args:
            disable: also a robot that holds, because its controller does not know the
                side.
        """
        monitor = self.monitor
        if monitor.injector is not None:
            monitor.injector.clear()
            for link in (monitor.injector.states, monitor.injector.commands):
                link.configure(Transport(), 0)
        monitor.until(
            lambda: monitor.get("plant", "commands_taken") != "False", LEASE_PATIENCE
        )
        if disable:
            monitor.call(SetBool, "controller/enable", data=False)
            monitor.until(lambda: not self.holding(), 1.0)
        deadline = time.monotonic() + RECOVERY_PATIENCE
        while (
            not monitor.until(self.holding, HOLD_WAIT) and time.monotonic() < deadline
        ):
            monitor.change_parameters("controller", assembly_mode=1)
            # first: a safe stop that brakes would push the robot from its start
            monitor.call(Trigger, "controller/reset")
            monitor.call(Trigger, "plant/reset")
            self.linger(HOLD_WAIT)
            monitor.change_parameters("controller", assembly_mode=1)
            monitor.call(SetBool, "controller/enable", data=True)
        return self.holding()

    def restart(self, name: str) -> None:
        """Start a node that ended; a controller is without torque until it is
        enabled.
        """
        monitor = self.monitor
        monitor.wait(LAST_WORDS)  # of the one that ended
        monitor.status.pop(name, None)
        bag: Path | None = None
        if name == "recorder":
            bag = self.start_recorder()
        else:
            without_torque = ["-p", "controller:enabled:=false"]
            extra = without_torque if name == "controller" else []
            self.processes.start(name, [*self._arguments[name], *extra])
        if name == "plant" and monitor.injector is not None:
            monitor.injector.forget_rig()

        def ready() -> bool:
            self.processes.check()
            if bag is not None and not bag.exists():
                return False
            return name in monitor.status and (
                name != "trajectory_server" or bool(monitor.get(name, "crossings"))
            )

        if not monitor.until(ready, START_TIMEOUT):
            raise NodesError(f"{name} did not come back within {START_TIMEOUT:.0f} s")
        if name == "plant":
            monitor.call(SetBool, "plant/pause", data=False)

    def linger(self, seconds: float) -> None:
        """Let the rig's clock go on for some time, s, or the steady one where it does
        not.
        """
        until = self.monitor.now + round(seconds * NANOSECONDS)
        patience = 10.0 * seconds + 1.0 if self.lockstep else max(1.5 * seconds, 0.5)
        self.monitor.until(lambda: self.monitor.now >= until, patience)
