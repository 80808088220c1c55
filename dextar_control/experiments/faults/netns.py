"""Two network namespaces with a bad link between them, for processes that must not
notice that they share a machine.

The link is a relay in user space (``relay.py``), so that no traffic control of the
kernel is needed. Namespaces, interfaces and relay belong to processes of this one: the
kernel removes them when it ends, however it ends, and nothing of the machine's own
network is touched.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict
from typing import Literal, get_args

from dextar_control.experiments.faults.frames import (
    LinkError,
    LinkQuality,
    LinkStatistics,
)

Side = Literal["a", "b"]
Way = Literal["a_to_b", "b_to_a"]
SIDES: tuple[Side, Side] = ("a", "b")
ADDRESSES: dict[Side, str] = {"a": "10.77.0.1", "b": "10.77.0.2"}
HARDWARE: dict[Side, str] = {"a": "02:00:0a:4d:00:01", "b": "02:00:0a:4d:00:02"}
INTERFACE = "wire0"  # in both namespaces
MTU = 1500
TOOLS = ("ip", "unshare", "nsenter")
START_TIMEOUT = 20.0  # s
STOP_TIMEOUT = 5.0  # s between SIGTERM and SIGKILL
# What holds a namespace: no IPv6 (its router and address frames would be counted), then
# sleep until the input ends.
HOLDER = (
    "for which in all default; do echo 1 >/proc/sys/net/ipv6/conf/$which/disable_ipv6;"
    " done 2>/dev/null; ip link set lo up && echo ready && exec cat >/dev/null"
)


class FaultyLink:
    """Holds namespaces ``a`` and ``b`` as a context; frames between them are lost,
    late, out of order or doubled.

    Args:
        seed: of the faults; the n-th frame of a direction has the same fate each time.
        quality: fields of ``LinkQuality`` for both ways; ``set_quality`` tells them
            apart.

    Raises:
        LinkError: a quality out of its limits; on entering: no root, or a tool is
            missing.
    """

    def __init__(self, *, seed: int = 0, **quality: float) -> None:
        self._quality = LinkQuality(**quality)
        self._seed = seed
        self._holders: dict[str, subprocess.Popen[str]] = {}
        self._relay: subprocess.Popen[str] | None = None

    def __enter__(self) -> FaultyLink:
        try:
            self._open()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _open(self) -> None:
        missing = [tool for tool in TOOLS if shutil.which(tool) is None]
        if missing:
            raise LinkError(
                f"a faulty link needs {', '.join(missing)} of iproute2 and util-linux,"
                " which this machine has not"
            )
        for name in (*SIDES, "relay"):
            self._holders[name] = _start(["unshare", "--net", "sh", "-c", HOLDER])
        for holder in self._holders.values():
            if _answer(holder) != "ready":
                raise LinkError(
                    "network namespaces need root (CAP_SYS_ADMIN and CAP_NET_ADMIN):"
                    f" {_last_words(holder)}"
                )
        for side in SIDES:
            self._configure(
                "relay",
                f"link add dev end_{side} mtu {MTU} type veth peer name"
                f" {INTERFACE} mtu {MTU} address {HARDWARE[side]} netns"
                f" {self._holders[side].pid}\nlink set dev end_{side} up",
            )
            other = SIDES[1 - SIDES.index(side)]
            self._configure(
                side,
                f"address add {ADDRESSES[side]}/24 dev {INTERFACE}\nlink set dev"
                f" {INTERFACE} up\nroute add 224.0.0.0/4 dev {INTERFACE}\nneigh add"
                f" {ADDRESSES[other]} lladdr {HARDWARE[other]} dev {INTERFACE} nud"
                " permanent",
            )
        settings = {
            "interfaces": [f"end_{side}" for side in SIDES],
            "ends": [(self._holders[side].pid, INTERFACE) for side in SIDES],
            "quality": asdict(self._quality),
            "seed": self._seed,
        }
        module = [
            sys.executable,
            "-m",
            "dextar_control.experiments.faults.relay",
            json.dumps(settings),
        ]
        self._relay = _start([*self.inside("relay"), *module])
        if _answer(self._relay) != "ready":
            raise LinkError(
                "the relay between the namespaces did not start:"
                f" {_last_words(self._relay)}"
            )

    def _configure(self, name: str, commands: str) -> None:
        done = subprocess.run(
            [*self.inside(name), "ip", "-batch", "-"],
            input=commands + "\n",
            capture_output=True,
            text=True,
        )
        if done.returncode:
            raise LinkError(
                "the network namespace cannot be set up: ip says"
                f" {done.stderr.strip().splitlines()[0]}"
            )

    def inside(self, side: str) -> list[str]:
        """Return the command words that put what follows them on one side, or beside
        the relay.
        """
        holder = self._holders.get(side)
        if holder is None:
            raise LinkError(
                f"there is no side '{side}' of the link now; sides are a and b, while"
                " the context is entered"
            )
        return ["nsenter", f"--net=/proc/{holder.pid}/ns/net"]

    @staticmethod
    def environment() -> dict[str, str]:
        """Return the environment that a ROS process inside needs: discovery by
        multicast, and no shared memory past the link.
        """
        kept = {
            name: value
            for name, value in os.environ.items()
            if name not in ("ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS")
        }
        return kept | {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        }

    def set_quality(self, *ways: Way, **quality: float) -> dict[str, LinkStatistics]:
        """Give some ways, or both where none is named, a quality from the next frame
        on; return the counts so far, by way.

        Args:
            ways: ``a_to_b`` or ``b_to_a``.
            quality: fields of ``LinkQuality``: ``loss=1.0`` is an outage, nothing a
                link without faults.

        Raises:
            LinkError: the quality is out of its limits, or the relay is gone.
        """
        new = asdict(LinkQuality(**quality))
        return self._ask(dict.fromkeys(ways or get_args(Way), new))

    def statistics(self) -> dict[str, LinkStatistics]:
        """Return the counts of the frames so far, by direction.

        Raises:
            LinkError: the relay is gone.
        """
        return self._ask({})

    def _ask(
        self, qualities: Mapping[Way, Mapping[str, float]]
    ) -> dict[str, LinkStatistics]:
        relay = self._relay
        if relay is None or relay.poll() is not None or relay.stdin is None:
            raise LinkError("the relay between the namespaces is not running")
        relay.stdin.write(json.dumps(qualities) + "\n")
        relay.stdin.flush()
        answer = _answer(relay)
        if not answer:
            raise LinkError(
                "the relay between the namespaces does not answer:"
                f" {_last_words(relay)}"
            )
        return {
            name: LinkStatistics(**counts)
            for name, counts in json.loads(answer).items()
        }

    def helper_pids(self) -> list[int]:
        """Return the process ids of the relay and of what holds the namespaces."""
        return [process.pid for process in self._helpers()]

    def _helpers(self) -> list[subprocess.Popen[str]]:
        own = [self._relay] if self._relay is not None else []
        return [*own, *self._holders.values()]

    def close(self) -> None:
        """End relay and holders; the namespaces go with the last process in them."""
        for helper in self._helpers():
            _end(helper)
            for pipe in (helper.stdout, helper.stderr):
                if pipe is not None:
                    pipe.close()
        self._relay, self._holders = None, {}


def _start(command: list[str]) -> subprocess.Popen[str]:
    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _answer(process: subprocess.Popen[str]) -> str:
    """Return the next line that a helper says, empty when it says none."""
    assert process.stdout is not None
    ready, _, _ = select.select([process.stdout], [], [], START_TIMEOUT)
    return process.stdout.readline().strip() if ready else ""


def _last_words(process: subprocess.Popen[str]) -> str:
    _end(process)
    assert process.stderr is not None
    return (process.stderr.read().strip().splitlines() or ["nothing was said"])[-1]


def _end(process: subprocess.Popen[str]) -> None:
    """Close a process's input, and kill it when that does not end it."""
    if process.stdin is not None and not process.stdin.closed:
        with contextlib.suppress(OSError, ValueError):
            process.stdin.close()
    try:
        process.wait(timeout=STOP_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
