"""``ros2 run dextar NAME`` and ``dextar NAME`` start the package's executables; each
loads its module when it is called.

Loading takes seconds, and a Ctrl-C in them ends the process without a traceback; what
is loaded then takes the signals itself. Once it has ended, further signals change
nothing: a launcher repeats the Ctrl-C that the terminal has sent already, and the
interpreter's own end takes long enough to be hit.
"""

from __future__ import annotations

import importlib
import importlib.util
import signal
import sys
from collections.abc import Callable
from functools import partial

from dextar_control.contract import signals
from dextar_control.contract.topics import INTERFACES, WITHOUT_INTERFACES


def _run(module: str, code: Callable[[int], int]) -> int:
    with signals.loading(code):
        ended = int(importlib.import_module(module).main())
    signals.install(signal.SIG_IGN)
    return ended


def _node(module: str) -> int:
    return _run(module, lambda _: 0)  # as any node that is asked to end


def go_server() -> int:
    """Run the action ``go``, which needs its interface package."""
    if importlib.util.find_spec(INTERFACES) is None:
        signals.tell(f"error: {WITHOUT_INTERFACES}", sys.stderr)
        return signals.EXIT_USAGE
    return _node("dextar_control.nodes.go_server")


plant = partial(_node, "dextar_sim.node")
controller = partial(_node, "dextar_control.nodes.controller")
trajectory_server = partial(_node, "dextar_control.nodes.trajectory_server")
recorder = partial(_node, "dextar_control.nodes.recorder")
markers = partial(_node, "dextar_control.nodes.markers")
panel = partial(_node, "dextar_control.nodes.panel")
warmup = partial(_run, "dextar_control.control.prepare", signals.killed)

EXECUTABLES: dict[str, Callable[[], int]] = {
    "plant": plant,
    "controller": controller,
    "trajectory_server": trajectory_server,
    "recorder": recorder,
    "markers": markers,
    "go_server": go_server,
    "panel": panel,
    "warmup": warmup,
}


def dextar() -> int:
    """Run the command ``dextar``; ``dextar plant ...`` is what ``ros2 run dextar plant
    ...`` is.
    """
    run = EXECUTABLES.get(sys.argv[1]) if len(sys.argv) > 1 else None
    if run is None:
        return _run("dextar_control.cli.main", signals.killed)
    sys.argv[:2] = [f"dextar {sys.argv[1]}"]
    return run()
