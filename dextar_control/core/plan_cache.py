"""Plans kept by what was asked for: the robot's numbers, the request, and the sources that answered it.

A plan is kept in memory and, as arrays, in ``$XDG_CACHE_HOME/dextar/plans`` (``~/.cache/dextar/plans``), or where
``contract.caches`` finds a place. What is read back is certified again before it is served. A cache that cannot be read or
written never stops a plan.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from dextar_control.contract.caches import cache_folder
from dextar_control.contract.errors import DextarError
from dextar_control.contract.robot import RobotParameters, flatten
from dextar_control.core.certificate import Plan
from dextar_control.core.trajectory import Trajectory

MOST_IN_MEMORY = 128
MOST_ON_DISK = 1000
SUFFIX = ".npz"

_memory: OrderedDict[str, Plan] = OrderedDict()


@lru_cache(maxsize=1)
def _sources() -> str:
    """Digest of the core's sources: a plan is only as old as what made it."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).resolve().parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if hasattr(value, "value") and not isinstance(value, (int, float)):
        return value.value
    raise TypeError(f"a request cannot hold a {type(value).__name__}")


def key_of(robot: RobotParameters, request: Mapping[str, Any]) -> str:
    """Digest of a request: equal for equal numbers, robots and sources."""
    text = json.dumps([flatten(robot), request, _sources()], sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()


def forget() -> None:
    """Empty the memory; the disk keeps its plans."""
    _memory.clear()


def _read(path: Path) -> Trajectory | None:
    try:
        with np.load(path, allow_pickle=False) as arrays:
            knots, origins, coefficients = arrays["knots"], arrays["origins"], arrays["coefficients"]
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None
    sizes = knots.ndim == origins.ndim == 1 and coefficients.ndim == 3 and coefficients.shape[2] == 2
    if not sizes or not len(knots) - 1 == len(origins) == len(coefficients) > 0:
        return None
    if not all(np.isfinite(part).all() for part in (knots, origins, coefficients)):
        return None
    return Trajectory(knots, origins, coefficients)


def _write(path: Path, trajectory: Trajectory) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as stream:
                np.savez(stream, knots=trajectory.knots, origins=trajectory.origins, coefficients=trajectory.coefficients)
            os.replace(name, path)
        except OSError:
            Path(name).unlink(missing_ok=True)
            raise
        kept = sorted(path.parent.glob(f"*{SUFFIX}"), key=lambda file: file.stat().st_mtime)
        for old in kept[:-MOST_ON_DISK]:
            old.unlink(missing_ok=True)
    except OSError:
        return


def _remember(key: str, plan: Plan) -> Plan:
    _memory[key] = plan
    _memory.move_to_end(key)
    while len(_memory) > MOST_IN_MEMORY:
        _memory.popitem(last=False)
    return plan


def answered(
    robot: RobotParameters,
    request: Mapping[str, Any],
    compute: Callable[[], Plan],
    check: Callable[[Trajectory], Plan],
) -> Plan:
    """The plan of a request, from memory, from disk, or computed and kept.

    Args:
        request: everything that decides the plan beside the robot, in plain values and arrays.
        compute: makes the plan.
        check: certifies a trajectory that comes from the disk.

    Raises:
        DextarError: what ``compute`` raises; refusals are not kept.
    """
    key = key_of(robot, request)
    if key in _memory:
        return _remember(key, _memory[key])
    folder = cache_folder("plans")
    if folder is None:
        return _remember(key, compute())
    path = folder / f"{key}{SUFFIX}"
    trajectory = _read(path)
    if trajectory is not None:
        try:
            return _remember(key, check(trajectory))
        except DextarError:
            path.unlink(missing_ok=True)
    plan = compute()
    _write(path, plan.trajectory)
    return _remember(key, plan)
