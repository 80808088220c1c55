"""Control of parallel robots through their Type 2 singularities; the planar five-bar
first.

Where things live, and which room may import which, stands in ``docs/rooms.md``.
From ``symbols`` to ``control`` there is no ROS and no simulator.

What most users need is here by name, and loaded when it is used: ``load_robot`` a
parameter file, ``Model`` its equations, ``plan_return_trip`` and ``plan_tour`` through
the locus, ``default_settings`` and ``ControlLoop`` to drive it, ``load_run`` and
``compute_metrics`` of what was recorded.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dextar_control.analysis.compute import compute_metrics as compute_metrics
    from dextar_control.analysis.load import load_run as load_run
    from dextar_control.contract.robot import load_robot as load_robot
    from dextar_control.contract.settings import default_settings as default_settings
    from dextar_control.control.loop import ControlLoop as ControlLoop
    from dextar_control.model.model import Model as Model
    from dextar_control.planning.planner import plan_return_trip as plan_return_trip
    from dextar_control.planning.tour import plan_tour as plan_tour

_MODULES = {
    "load_robot": "contract.robot",
    "Model": "model.model",
    "plan_return_trip": "planning.planner",
    "plan_tour": "planning.tour",
    "default_settings": "contract.settings",
    "ControlLoop": "control.loop",
    "load_run": "analysis.load",
    "compute_metrics": "analysis.compute",
}
__all__ = [
    "ControlLoop",
    "Model",
    "compute_metrics",
    "default_settings",
    "load_robot",
    "load_run",
    "plan_return_trip",
    "plan_tour",
]


def __getattr__(name: str) -> object:
    """Load one of ``__all__``."""
    if name not in _MODULES:
        raise AttributeError(
            f"module {__name__!r} has no attribute {name!r}; it offers"
            f" {', '.join(__all__)}"
        )
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
