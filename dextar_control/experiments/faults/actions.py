"""Do each kind of fault to the nodes during one trip, and undo it after the trip."""

from __future__ import annotations

import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.client import Client
from rclpy.publisher import Publisher
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from dextar_control.contract.errors import NodesError
from dextar_control.contract.resources import node_defaults
from dextar_control.contract.topics import JOINT_COMMANDS
from dextar_control.experiments.faults.bag_check import finished
from dextar_control.experiments.faults.cases import FaultCase
from dextar_control.experiments.faults.events import CrossingRecord, Network
from dextar_control.experiments.faults.judgement import Evidence, Outcome
from dextar_control.experiments.faults.link import (
    FaultWindow,
    MessageLink,
    MessageShape,
    Transport,
)
from dextar_control.experiments.faults.monitor import parameters
from dextar_control.experiments.faults.stack import Stack
from dextar_control.nodekit.cdr import NANOSECONDS
from dextar_control.nodekit.layouts import template
from dextar_control.nodekit.node import qos

# s after a fault's end within which its outcome counts as its own; a stamp may be ahead
# by 0.05 s
REACTION = 0.06
START_PATIENCE = 60.0  # s
END_PATIENCE = 20.0  # s until a node that was sent SIGTERM has ended
SECOND_TORQUE = (0.05, -0.05)  # N m, of the second commander
SECOND_LASTS = 0.5  # s
MOST_PENDING = 40  # services asked and not answered
UNCOMPRESSED = {"bag.compression": "none"}  # what the full disk is reached by sooner
# that are set live
GAINS = {
    "feedback.natural_frequency": (45.0, 55.0),
    "feedback.damping_ratio": (0.9, 1.1),
}
REFUSED = (
    {"feedback.natural_frequency": 1e9},
    {"feedback.damping_ratio": -1.0},
    {"assembly_mode": -1},
    {"task__sample_period": 0.002},
)
CURVE = 0.12  # s of torque after a commander's last word that are kept for the figure

# Arguments: size, folder of the small disk, where the bag goes in the end, then the
# recorder's command.
SMALL_DISK = """
mount -t tmpfs -o size="$1" small "$2" || exit 70
disk=$2 out=$3; shift 3
"$@" & child=$!
trap 'kill -TERM $child' INT TERM
while kill -0 $child 2>/dev/null; do wait $child; code=$?; done
cp "$disk"/run.mcap "$out"
exit $code
"""


class Trouble(NamedTuple):
    """A robot that is no longer controlled as planned.

    Attributes:
        stamp: of the first state of which that is known, ns.
        outcome: what became of it.
    """

    stamp: int
    outcome: Outcome


class Action:
    """Does a fault of one kind: it is prepared, armed once the trip has begun, polled,
    released, and its damage repaired.

    Attributes:
        single: one crossing of the trip is faulted, not each.
        grace: after the instant of judgement, within which a stop still counts as this
            fault's, ns.
        refused: what was asked for was refused.
        took_effect: after the release, whether anything was done that somebody must
            have noticed.
    """

    single = False
    grace = 0
    refused = False
    took_effect = True

    def __init__(self, case: FaultCase, stack: Stack) -> None:
        self.case, self.stack = case, stack

    @property
    def done(self) -> bool:
        """Whether the trip may end."""
        return True

    def prepare(self, chance: random.Random) -> None:
        """Prepare the fault before the trip begins."""
        self.chance = chance

    def arm(self, times: Sequence[int]) -> None:
        """Take the ``times`` at which the faults are due, ns of the rig's clock; the
        trip has begun.
        """

    def poll(self, now: int) -> Trouble | None:
        """Act in each turn; return a trouble that only this action can know."""
        return None

    def release(self) -> None:
        """Do no more faults."""

    def restore(self) -> None:
        """Repair what ``Stack.recover`` does not."""

    def bags(self) -> list[Path]:
        """List the recordings that ended in this trip."""
        return []

    def broken_bags(self) -> list[str]:
        """Write a line for each of these that should have been finished and is not."""
        return []

    def extra(self, records: list[CrossingRecord], evidence: Evidence) -> None:
        """Add to the records what only this kind has."""


class LinkAction(Action):
    """Does ``transport`` and ``window`` faults, by the injector."""

    def prepare(self, chance: random.Random) -> None:
        """Find the links."""
        super().prepare(chance)
        injector = self.stack.monitor.injector
        if injector is None:
            raise NodesError("no injector stands between rig and controller")
        ways = {"states": injector.states, "commands": injector.commands}
        self._links: list[MessageLink[bytes]] = [ways[way] for way in self.case.ways]
        self._before = [dict(link.counts) for link in self._links]
        if self.case.window is not None:
            self.grace = round((self.case.window.lasting + REACTION) * NANOSECONDS)

    def arm(self, times: Sequence[int]) -> None:
        """Put windows at the times, or change the transport from now on."""
        if self.case.window is not None:
            lasting = round(self.case.window.lasting * NANOSECONDS)
            for link in self._links:
                for at in times:
                    link.add(
                        FaultWindow(
                            at, at + lasting, MessageShape(self.case.window.shape)
                        )
                    )
        else:
            for link in self._links:
                link.configure(
                    Transport(**self.case.transport or {}), self.chance.randrange(2**31)
                )

    def release(self) -> None:
        """Make the links whole; the fault took effect if it touched a message."""
        for link in self._links:
            link.configure(Transport(), 0)
            link.clear_windows()
        transport = Transport(**self.case.transport or {})
        touched = ("dropped", "duplicated", "held_back", "lost_in_outage", "shaped")
        self.took_effect = bool(transport.delay or transport.jitter) or any(
            link.counts[kind] > before[kind]
            for link, before in zip(self._links, self._before, strict=True)
            for kind in touched
        )


class KillAction(Action):
    """Sends a signal to a node, and starts it again."""

    single = True
    grace = round(1.0 * NANOSECONDS)

    def arm(self, times: Sequence[int]) -> None:
        """Choose the first time, for the fault is done once."""
        assert self.case.kill is not None
        self._node, self._at, self._killed = self.case.kill.node, times[0], 0
        self._bag = self.stack.current_bag()
        self.took_effect = False

    @property
    def done(self) -> bool:
        """Whether the node is gone."""
        return bool(self._killed) and self.stack.processes.ended(self._node)

    def poll(self, now: int) -> Trouble | None:
        """Kill the node; a killed controller leaves a robot without torque."""
        assert self.case.kill is not None
        if not self._killed and now >= self._at:
            self._killed = now
            self.took_effect = True
            self.stack.processes.send(self._node, signal.Signals[self.case.kill.signal])
        return (
            Trouble(self._killed, Outcome.NO_TORQUE)
            if self._node == "controller" and self.done
            else None
        )

    def restore(self) -> None:
        """Start the node again."""
        if not self._killed:
            return
        if not self.stack.monitor.until(
            lambda: self.stack.processes.ended(self._node), END_PATIENCE
        ):
            raise NodesError(
                f"{self._node} did not end within {END_PATIENCE:.0f} s of its signal"
            )
        self.stack.restart(self._node)

    def bags(self) -> list[Path]:
        """Return the bag of a killed recorder."""
        if self._node != "recorder" or self._bag is None or not self._killed:
            return []
        self.stack.monitor.until(
            lambda: self.stack.processes.ended(self._node), END_PATIENCE
        )
        return [self._bag]

    def broken_bags(self) -> list[str]:
        """Write a line where the recorder did not finish its file although SIGTERM
        asked for it.
        """
        assert self.case.kill is not None
        if self.case.kill.signal != "SIGTERM":
            return []
        unfinished = [path for path in self.bags() if not finished(path)]
        return [
            f"{path.name} is not finished although SIGTERM asked for it"
            for path in unfinished
        ]

    def extra(self, records: list[CrossingRecord], evidence: Evidence) -> None:
        """Add the torque after the controller's last command, for the figure."""
        if self._node == "controller" and records:
            last = (
                evidence.command_stamps[-1]
                if len(evidence.command_stamps)
                else self._killed
            )
            age = (evidence.stamps - last) / NANOSECONDS
            near = (age >= -0.02) & (age <= CURVE)
            size = np.abs(evidence.torque[near]).max(axis=1, initial=0.0)
            records[0]["curve"] = [
                [round(float(t), 4), float(value)]
                for t, value in zip(age[near], size, strict=True)
            ]


class CommanderAction(Action):
    """Publishes a torque on the command topic as a second commander."""

    single = True
    grace = round(1.0 * NANOSECONDS)

    def arm(self, times: Sequence[int]) -> None:
        """Choose the first time, for the fault is done once."""
        self._at, self._sent, self._begun = times[0], 0, 0
        self._publisher: Publisher | None = None
        self._template = template(JOINT_COMMANDS)

    @property
    def done(self) -> bool:
        """Whether it was there for long enough."""
        return bool(self._begun) and self.stack.monitor.now >= self._begun + round(
            SECOND_LASTS * NANOSECONDS
        )

    def poll(self, now: int) -> Trouble | None:
        """Answer the newest state, as the controller does."""
        if now >= self._at and now > self._sent:
            if self._publisher is None:
                self._begun = now
                self._publisher = self.stack.monitor.create_publisher(
                    JointState, JOINT_COMMANDS.name, qos(JOINT_COMMANDS)
                )
            self._publisher.publish(self._template.pack(now, SECOND_TORQUE))
            self._sent = now
        return None

    def release(self) -> None:
        """Leave the topic; the fault took effect if anything was commanded."""
        self.took_effect = bool(self._begun)
        monitor = self.stack.monitor
        if self._publisher is not None:
            monitor.destroy_publisher(self._publisher)
            self._publisher = None
            monitor.until(
                lambda: monitor.count_publishers(JOINT_COMMANDS.name) <= 1, END_PATIENCE
            )


class FloodAction(Action):
    """Calls more services than anybody needs, of every node."""

    def prepare(self, chance: random.Random) -> None:
        """Make the clients of services that change nothing."""
        super().prepare(chance)
        monitor = self.stack.monitor
        self._calls: list[tuple[Client, object]] = [
            (monitor.client(SetBool, "controller/enable"), SetBool.Request(data=True)),
            (
                monitor.client(GetParameters, "controller/get_parameters"),
                GetParameters.Request(names=["law", "near_locus.fade_abs_s"]),
            ),
            (
                monitor.client(SetParameters, "controller/set_parameters"),
                SetParameters.Request(),
            ),
            (monitor.client(Trigger, "plant/step"), Trigger.Request()),
            (
                monitor.client(GetParameters, "plant/get_parameters"),
                GetParameters.Request(names=["mode"]),
            ),
            (
                monitor.client(GetParameters, "trajectory_server/get_parameters"),
                GetParameters.Request(names=["task.repeat"]),
            ),
        ]
        if not monitor.until(
            lambda: all(client.service_is_ready() for client, _ in self._calls),
            START_PATIENCE,
        ):
            raise NodesError("not every service is there to be flooded")
        self._pending: list[tuple[str, Future]] = []
        self._sent = self._answered = 0
        self._begun = 0.0

    def arm(self, times: Sequence[int]) -> None:
        """Begin now."""
        self._begun = time.monotonic()

    def poll(self, now: int) -> Trouble | None:
        """Call as many services as are due."""
        self._count()
        due = int(self.case.flood * (time.monotonic() - self._begun))
        while self._begun and self._sent < due and len(self._pending) < MOST_PENDING:
            client, request = self._calls[self._sent % len(self._calls)]
            self._pending.append((client.srv_name, client.call_async(request)))
            self._sent += 1
        return None

    def _count(self) -> None:
        left = [(name, future) for name, future in self._pending if not future.done()]
        self._answered += len(self._pending) - len(left)
        self._pending = left

    def release(self) -> None:
        """Wait for the answers; the fault took effect if anything was asked."""
        self._begun = 0.0
        self.took_effect = self._sent > 0
        self.stack.monitor.until(
            lambda: all(future.done() for _, future in self._pending), END_PATIENCE
        )
        self._count()
        self.stack.answers += [f"{name} did not answer" for name, _ in self._pending]
        self.stack.answers.append(f"{self._answered} of {self._sent} calls answered")
        if self._answered == self._sent:
            self.stack.answers.append("every call was answered")


class ParameterAction(Action):
    """Sets a gain that may be changed live, and a value that must be refused, while the
    robot crosses.
    """

    def arm(self, times: Sequence[int]) -> None:
        """Take the times, at each of which both are asked."""
        self._times, self.refused, self._asked = list(times), False, 0
        self._futures: list[tuple[Future, bool]] = []

    @property
    def done(self) -> bool:
        """Whether all were asked."""
        return not self._times

    def poll(self, now: int) -> Trouble | None:
        """Ask for one valid and one invalid change at each time."""
        if self._times and now >= self._times[0]:
            self._times.pop(0)
            name, (low, high) = self.chance.choice(list(GAINS.items()))
            self._ask({name: self.chance.uniform(low, high)}, valid=True)
            self._ask(self.chance.choice(REFUSED), valid=False)
        return None

    def _ask(self, values: Mapping[str, int | float], *, valid: bool) -> None:
        client = self.stack.monitor.client(SetParameters, "controller/set_parameters")
        request = SetParameters.Request(parameters=parameters(values))
        self._futures.append((client.call_async(request), valid))
        self._asked += 1

    def release(self) -> None:
        """Take the answers; a valid change refused or an invalid one taken is a fault
        of the controller.
        """
        self.stack.monitor.until(
            lambda: all(future.done() for future, _ in self._futures), END_PATIENCE
        )
        right = 0
        for future, valid in self._futures:
            result = future.result().results[0] if future.done() else None
            if (
                result is None
                or result.successful != valid
                or not (valid or result.reason)
            ):
                self.stack.answers.append(
                    f"a {'valid' if valid else 'wrong'} value was answered by {result}"
                )
            else:
                right += 1
                self.refused |= not valid
        if right == self._asked:
            self.stack.answers.append("each answer as it should be")

    def restore(self) -> None:
        """Set the gains of the parameter file again."""
        defaults = node_defaults("controller")
        self.stack.monitor.change_parameters(
            "controller", **{name: float(defaults[name]) for name in GAINS}
        )


class DiskAction(Action):
    """Lets the disk under the recorder become full while the robot crosses."""

    def prepare(self, chance: random.Random) -> None:
        """Start another recorder on a small disk of its own, or with a limit on the
        file's size where no such disk can be made.
        """
        super().prepare(chance)
        stack = self.stack
        stack.processes.stop("recorder")
        stack.monitor.until(lambda: False, 0.3)
        self._bag = stack.bag()
        size = round(1e6 * self.case.disk * chance.uniform(0.5, 1.0))
        stack.monitor.status.pop("recorder", None)
        if can_mount():
            disk = stack.folder / "small_disk"
            disk.mkdir(exist_ok=True)
            wrap = [
                "unshare",
                "--mount",
                "sh",
                "-c",
                SMALL_DISK,
                "small_disk",
                str(size),
                str(disk),
                str(self._bag),
            ]
            stack.start_recorder(
                wrap=wrap, path=disk / "run.mcap", parameters=UNCOMPRESSED
            )
        else:
            limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (size, size))
            stack.start_recorder(path=self._bag, limit=limit, parameters=UNCOMPRESSED)
        stack.processes.may_end("recorder")
        if not stack.monitor.until(
            lambda: (
                "recorder" in stack.monitor.status or stack.processes.ended("recorder")
            ),
            START_PATIENCE,
        ):
            raise NodesError("the recorder on the small disk did not start")

    @property
    def done(self) -> bool:
        """Whether the recorder has given up."""
        return self.stack.processes.ended("recorder")

    def release(self) -> None:
        """Wait until the recorder has filled the disk, also after a robot that stopped
        early.
        """
        self.took_effect = self.stack.monitor.until(lambda: self.done, END_PATIENCE)

    def restore(self) -> None:
        """Start a recorder with room."""
        self.stack.processes.stop("recorder")
        self.stack.restart("recorder")

    def bags(self) -> list[Path]:
        """Return what was saved from the small disk."""
        return [self._bag] if self.done else []


class NetworkAction(Action):
    """Makes the link between two network namespaces bad, which the parent process
    holds.
    """

    def arm(self, times: Sequence[int]) -> None:
        """Make the link bad from now on."""
        self._counts = self._ask(self.case.network or {})

    def release(self) -> None:
        """Make the link whole; the fault took effect if it touched a frame."""
        after = self._ask({})
        late = bool({"delay", "jitter"} & set(self.case.network or {}))
        self.took_effect = late or any(
            after[key] > self._counts[key]
            for key in ("dropped", "duplicated", "reordered")
        )

    @staticmethod
    def _ask(quality: dict[str, float]) -> dict[str, int]:
        event: Network = {"event": "network", "quality": quality}
        print(json.dumps(event), flush=True)
        counts: dict[str, int] = json.loads(sys.stdin.readline())
        return counts


def can_mount() -> bool:
    """Tell whether this process may mount a disk in a namespace of its own."""
    if os.geteuid() != 0 or shutil.which("unshare") is None:
        return False
    return (
        subprocess.run(
            ["unshare", "--mount", "true"], capture_output=True, check=False
        ).returncode
        == 0
    )


KINDS: dict[str, Callable[[FaultCase, Stack], Action]] = {
    "transport": LinkAction,
    "window": LinkAction,
    "kill": KillAction,
    "commander": CommanderAction,
    "flood": FloodAction,
    "parameters": ParameterAction,
    "disk": DiskAction,
    "network": NetworkAction,
}


def make_action(case: FaultCase, stack: Stack) -> Action:
    """Return the action that does a case's fault."""
    return KINDS[case.kind](case, stack)
