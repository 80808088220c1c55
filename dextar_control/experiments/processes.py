"""The one way to start, watch, log and end a stack of nodes.

Each node is a process of its own with a log of its own. It is a new interpreter, or a
fork of this process where that has loaded what all nodes need.
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from dextar_control.contract import signals
from dextar_control.contract.errors import NodesError
from dextar_control.contract.resources import NODES_FILE, ROBOT_FILE, config_file
from dextar_control.executables import EXECUTABLES

MODULES = {
    "plant": "dextar_sim.node",
    "controller": "dextar_control.nodes.controller",
    "trajectory_server": "dextar_control.nodes.trajectory_server",
    "recorder": "dextar_control.nodes.recorder",
    "panel": "dextar_control.nodes.panel",
}
# the commander first; the recorder last, which keeps what the others say at their end
STOP_ORDER = "trajectory_server", "panel", "controller", "plant", "recorder"
PR_SET_PDEATHSIG = 1  # of Linux' prctl
LIBC = ctypes.CDLL(None)
STOP_TIMEOUT = 15.0  # s until a node that does not end is killed


class _Fork:
    """A fork of this process, used like a Popen; no thread and no ROS may run yet."""

    def __init__(self, run: Callable[[], None], name: str) -> None:
        self._process = multiprocessing.get_context("fork").Process(
            target=run, name=name
        )
        # Ctrl-C reaches a new process once that takes it for itself: see _be_node.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, signals.ENDING)
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self.pid = self._process.pid or 0

    def poll(self) -> int | None:
        return self._process.exitcode

    def send_signal(self, sig: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, sig)

    def wait(self, timeout: float | None = None) -> int:
        self._process.join(timeout)
        code = self._process.exitcode
        if code is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout or 0.0)
        return code


def end_with_parent(number: int = signal.SIGTERM) -> None:
    """Have the kernel send this process a signal when its parent dies, however it
    dies.
    """
    LIBC.prctl(PR_SET_PDEATHSIG, number)


def node_arguments(
    name: str,
    values: Iterable[str],
    files: Sequence[Path] | None = None,
    remappings: Iterable[str] = (),
) -> list[str]:
    """List the ROS arguments of a node.

    Args:
        name: of the node.
        values: NAME:=VALUE of single parameters, over those of the files.
        files: parameter files; the shipped ones when None.
        remappings: OLD:=NEW of topics.
    """
    if files is None:
        files = [config_file(ROBOT_FILE), config_file(NODES_FILE)]
    # with the node's name: a plain -p counts as /**, which a file's section for the
    # node overrides
    return [
        *(part for path in files for part in ("--params-file", str(path))),
        *(part for value in values for part in ("-p", f"{name}:{value}")),
        *(part for rule in remappings for part in ("-r", rule)),
    ]


class Processes:
    """Runs the nodes of one stack, by name; leaving it as a context ends them.

    Args:
        folder: of the logs.
        prefix: command words before a node's own, by name: where it is to run.
        modules: run in the place of a node's own, by name.
        forked: nodes are forks of this process; prefix and modules have no effect then.

    Attributes:
        exits: exit codes of the nodes that ended since ``forget``.
    """

    def __init__(
        self,
        folder: Path,
        *,
        prefix: Mapping[str, Sequence[str]] | None = None,
        modules: Mapping[str, str] | None = None,
        forked: bool = False,
    ) -> None:
        self.exits: dict[str, int] = {}
        self._allowed: set[str] = set()
        self._folder, self._forked = folder, forked
        self._prefix = prefix or {}
        self._modules = {**MODULES, **(modules or {})}
        self._running: dict[str, subprocess.Popen[bytes] | _Fork] = {}
        self._offsets: dict[str, int] = {}

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop_all()

    def start(
        self,
        name: str,
        arguments: Sequence[str] = (),
        *,
        wrap: Sequence[str] = (),
        limit: Callable[[], None] | None = None,
    ) -> None:
        """Start one node.

        Args:
            name: of the node.
            arguments: ROS arguments, see ``node_arguments``.
            wrap: command words before Python's.
            limit: called in the new process before the node.
        """
        self.exits.pop(name, None)
        self._allowed.discard(name)
        log = self.log_path(name)
        if self._forked:
            self._running[name] = _Fork(lambda: _be_node(name, arguments, log), name)
            return

        def prepare() -> None:
            end_with_parent()
            if limit is not None:
                limit()

        command = [
            *(*self._prefix.get(name, ()), *wrap),
            *(sys.executable, "-m", self._modules[name]),
            *("--ros-args", *arguments),
        ]
        with log.open("ab") as output:
            self._running[name] = subprocess.Popen(
                command,
                stdout=output,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
                preexec_fn=prepare,
            )

    def log_path(self, name: str) -> Path:
        """Return where a node's output goes, over all its lives."""
        return self._folder / f"{name}.log"

    def send(self, name: str, number: int) -> None:
        """Send one node a signal that is to end it."""
        self.may_end(name)
        if (process := self._running.get(name)) is not None:
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(number)

    def pid(self, name: str) -> int:
        """Return the process id of a node that runs."""
        return self._running[name].pid

    def may_end(self, name: str) -> None:
        """Allow this node to end: ``check`` does not complain of it."""
        self._allowed.add(name)

    def ended(self, name: str) -> bool:
        """Tell whether a node has ended, or was never started; its exit code is then in
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
        for name, code in self.exits.items():
            if name not in self._allowed:
                raise NodesError(self.describe_end(name, code))

    def describe_end(self, name: str, code: int) -> str:
        """Say in words how a node ended."""
        if code < 0:
            return f"{name} was killed by {signal.Signals(-code).name}"
        return f"{name} ended with exit code {code}: {self.last_words(name)}"

    def last_words(self, name: str) -> str:
        """Return the last line of a node's log that tells of an error, or its last."""
        lines = self._text(name, 0).strip().splitlines()
        telling = [line for line in lines if "error" in line.lower()]
        return (telling or lines or ["nothing"])[-1]

    def forget(self) -> None:
        """Begin anew: exit codes and logs count from here on."""
        self.exits, self._allowed = {}, set()
        self._offsets = {
            log.stem: log.stat().st_size for log in self._folder.glob("*.log")
        }

    def logs(self) -> dict[str, str]:
        """Return what each node printed since ``forget``."""
        return {
            name: self._text(name, self._offsets.get(name, 0))
            for name in self._modules
            if self.log_path(name).exists()
        }

    def _text(self, name: str, offset: int) -> str:
        with self.log_path(name).open("rb") as file:
            file.seek(offset)
            return file.read().decode(errors="replace")

    def stop(self, *names: str) -> dict[str, int]:
        """End nodes one after another with SIGINT, with SIGKILL where that does not;
        return the exit codes of those that were started.
        """
        codes: dict[str, int] = {}
        for name in names:
            process = self._running.pop(name, None)
            if process is None:
                codes |= {name: self.exits[name]} if name in self.exits else {}
                continue
            process.send_signal(signal.SIGINT)
            try:
                codes[name] = process.wait(timeout=STOP_TIMEOUT)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                codes[name] = process.wait()
        return codes

    def stop_all(self) -> dict[str, int]:
        """End all nodes in ``STOP_ORDER``; return the exit codes of those started."""
        return self.stop(*STOP_ORDER)


def _be_node(name: str, arguments: Sequence[str], log: Path) -> None:
    """Run a node in a process just forked."""
    end_with_parent()
    os.setsid()
    for stream in (1, 2):
        os.dup2(os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644), stream)
    signals.install(signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, signals.ENDING)
    sys.argv = [name, "--ros-args", *arguments]
    sys.exit(EXECUTABLES[name]())


def processor_time(pid: int) -> float:
    """Return the processor time of a process with all its threads so far, s."""
    stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii")
    fields = stat.rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
