"""The package's configuration lies in the source tree, a pip environment or a ROS
installation.
"""

from __future__ import annotations

import sys
from functools import lru_cache
from pathlib import Path

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.yaml_text import load_parameters, parameters_of

NODES_FILE = "crossing.yaml"
ROBOT_FILE = "dextar.yaml"
MIDDLEWARE_FILE = "fastdds.xml"


def share_folder() -> Path:
    """Return the folder that holds ``config/`` and ``launch/``.

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
    raise ParameterError(
        f"config/{NODES_FILE} not found in any of: {', '.join(map(str, candidates))}"
    )


def config_file(name: str) -> Path:
    """Return the path of a file in ``config/``."""
    return share_folder() / "config" / name


def node_defaults(node: str, *paths: Path) -> dict[str, ParameterValue]:
    """Return the parameters of one node from ROS 2 parameter files, dotted, as the node
    itself would get them.

    Args:
        node: its name, with its namespace where it has one.
        paths: of the files, later ones over earlier ones; ``config/crossing.yaml`` if
            none is given.

    Raises:
        ParameterError: a file cannot be read, or ROS 2 would not take it.
    """
    files = paths or (config_file(NODES_FILE),)
    return dict(_node_defaults(node, tuple((path, _version(path)) for path in files)))


def _version(path: Path) -> tuple[int, int]:
    """Return what differs once the file has changed: its time and size."""
    try:
        status = path.stat()
    except OSError:
        return 0, 0
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=64)
def _node_defaults(
    node: str, files: tuple[tuple[Path, tuple[int, int]], ...]
) -> dict[str, ParameterValue]:
    return parameters_of(node, load_parameters(*(path for path, _ in files)))
