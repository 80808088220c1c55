"""The nodes' processes: started, killed, started again, each with its log."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from dextar_control.contract.errors import DextarError

MODULES = {
    "plant": "dextar_sim.node",
    "controller": "dextar_control.nodes.controller",
    "trajectory_server": "dextar_control.nodes.trajectory_server",
    "recorder": "dextar_control.nodes.recorder",
}
PR_SET_PDEATHSIG = 1  # of Linux' prctl
STOP_TIMEOUT = 15.0  # s until a node that does not end is killed


class NodesError(DextarError):
    """The nodes could not be started, or not be brought to where they are needed; the
    message says which and why.
    """


def end_with_parent() -> None:
    """Have the kernel send SIGTERM to this process when its parent dies, however it
    dies.
    """
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


class Processes:
    """Nodes by name.

    Args:
        folder: of the logs.
        arguments: ROS arguments of each node.
        prefix: command words before a node's own, by name: where it is to run.
        modules: run in the place of a node's own, by name.

    Attributes:
        exits: exit codes of the nodes that ended since ``forget``.
    """

    def __init__(
        self,
        folder: Path,
        arguments: Mapping[str, Sequence[str]],
        prefix: Mapping[str, Sequence[str]] | None = None,
        modules: Mapping[str, str] | None = None,
    ) -> None:
        self.exits: dict[str, int] = {}
        self._wanted: set[str] = set()
        self._folder = folder
        self._arguments = arguments
        self._prefix = prefix or {}
        self._modules = {**MODULES, **(modules or {})}
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._offsets: dict[str, int] = {}

    def start(
        self,
        name: str,
        extra: Sequence[str] = (),
        wrap: Sequence[str] = (),
        limit: Callable[[], None] | None = None,
    ) -> None:
        """Start one node.

        Args:
            name: of the node.
            extra: further ROS arguments.
            wrap: command words before Python's.
            limit: called in the new process before the node.
        """

        def prepare() -> None:
            end_with_parent()
            if limit is not None:
                limit()

        self.exits.pop(name, None)
        self._wanted.discard(name)
        command = [
            *self._prefix.get(name, ()),
            *wrap,
            sys.executable,
            "-m",
            self._modules[name],
        ]
        with self.log_path(name).open("ab") as log:
            self._running[name] = subprocess.Popen(
                [*command, "--ros-args", *self._arguments[name], *extra],
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
                preexec_fn=prepare,
            )

    def log_path(self, name: str) -> Path:
        """Where a node's output goes, over all its lives."""
        return self._folder / f"{name}.log"

    def send(self, name: str, number: int) -> None:
        """Send one node a signal that is to end it."""
        self.may_end(name)
        with contextlib.suppress(ProcessLookupError):
            self._running[name].send_signal(number)

    def pid(self, name: str) -> int:
        """Of a node that runs."""
        return self._running[name].pid

    def may_end(self, name: str) -> None:
        """This node's end is part of a fault."""
        self._wanted.add(name)

    def ended(self, name: str) -> bool:
        """Whether a node has ended, or was never started; its exit code is then in
        ``exits``.
        """
        process = self._running.get(name)
        if process is None:
            return True
        code = process.poll()
        if code is None:
            return False
        self.exits[name] = code
        del self._running[name]
        return True

    def check(self) -> None:
        """Raise NodesError when a node has ended that nobody ended."""
        for name in list(self._running):
            self.ended(name)
        for name in self.exits:
            if name not in self._wanted:
                raise NodesError(
                    f"{name} ended with code {self.exits[name]}:"
                    f" {self.last_words(name)}"
                )

    def last_words(self, name: str) -> str:
        """The last telling line of a node's log."""
        lines = self._text(name, 0).strip().splitlines()
        telling = [line for line in lines if "error" in line.lower()]
        return (telling or lines or ["nothing"])[-1]

    def forget(self) -> None:
        """Exit codes and logs count from here on."""
        self.exits, self._wanted = {}, set()
        self._offsets = {
            name: self.log_path(name).stat().st_size
            for name in MODULES
            if self.log_path(name).exists()
        }

    def logs(self) -> dict[str, str]:
        """What each node printed since ``forget``."""
        return {
            name: self._text(name, self._offsets.get(name, 0))
            for name in MODULES
            if self.log_path(name).exists()
        }

    def _text(self, name: str, offset: int) -> str:
        with self.log_path(name).open("rb") as file:
            file.seek(offset)
            return file.read().decode(errors="replace")

    def stop(self, name: str) -> None:
        """End one node with SIGINT; SIGKILL when it does not."""
        process = self._running.pop(name, None)
        if process is None:
            return
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=STOP_TIMEOUT)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def stop_all(self) -> None:
        """Commander first, recorder last."""
        for name in ("trajectory_server", "controller", "plant", "recorder"):
            self.stop(name)


def processor_time(pid: int) -> float:
    """Processor time of a process with all its threads so far, s."""
    fields = (
        Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    )
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
