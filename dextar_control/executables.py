"""The package's executables, as ``ros2 run dextar NAME`` and pip's scripts start them; each loads its module when it is called.

Loading takes seconds, and a Ctrl-C in them ends the process without a traceback; what is loaded then takes the signals itself.
"""

from __future__ import annotations

import importlib

from dextar_control.contract import signals


def _node(module: str) -> int:
    with signals.loading(lambda _: 0):  # as any node that is asked to end
        return int(importlib.import_module(module).main())


def plant() -> int:
    """The simulated rig."""
    return _node("dextar_sim.node")


def controller() -> int:
    """The controller."""
    return _node("dextar_control.ros.controller_node")


def trajectory_server() -> int:
    """The trajectory server."""
    return _node("dextar_control.ros.trajectory_server")


def recorder() -> int:
    """The recorder."""
    return _node("dextar_control.ros.recorder_node")


def markers() -> int:
    """The markers."""
    return _node("dextar_control.ros.marker_node")


def warmup() -> int:
    """The equations' compilation."""
    with signals.loading():
        from dextar_control.control.prepare import main

        return main()


def dextar() -> int:
    """The command ``dextar``."""
    with signals.loading():
        from dextar_control.cli import main

        return main()
