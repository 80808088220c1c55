"""Where the package's configuration lies: source tree, pip environment or ROS installation."""

from __future__ import annotations

import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from dextar_control.contract.errors import ParameterError

NODES_FILE = "crossing.yaml"
ROBOT_FILE = "dextar.yaml"


def share_folder() -> Path:
    """The folder that holds ``config/`` and ``launch/``.

    Raises:
        ParameterError: neither the source tree nor an installation holds it.
    """
    candidates = [Path(__file__).resolve().parents[2]]
    try:
        from ament_index_python.packages import get_package_share_directory

        candidates.append(Path(get_package_share_directory("dextar")))
    except (ImportError, LookupError, ValueError, OSError):
        pass
    candidates.append(Path(sys.prefix) / "share" / "dextar")
    for candidate in candidates:
        if (candidate / "config" / NODES_FILE).is_file():
            return candidate
    raise ParameterError(f"config/{NODES_FILE} not found in any of: {', '.join(map(str, candidates))}")


def config_file(name: str) -> Path:
    """Path of a file in ``config/``."""
    return share_folder() / "config" / name


def node_defaults(node: str, path: Path | None = None) -> dict[str, Any]:
    """Parameters of one node in a ROS 2 parameter file, dotted, ``/**`` first.

    Raises:
        ParameterError: the file cannot be read.
    """
    path = path or config_file(NODES_FILE)
    try:
        return dict(_node_defaults(node, path, path.stat().st_mtime_ns))
    except (OSError, yaml.YAMLError) as error:
        raise ParameterError(f"parameter file {path}: {error}") from error


@lru_cache(maxsize=64)
def _node_defaults(node: str, path: Path, _: int) -> dict[str, Any]:
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    values: dict[str, Any] = {}
    for section in ("/**", f"/**/{node}", node):
        values.update(_dotted(((document or {}).get(section) or {}).get("ros__parameters") or {}))
    return values


def _dotted(nested: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in nested.items():
        if isinstance(value, dict):
            flat.update(_dotted(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = value
    return flat
