"""The parameters with which nodes would start, checked by the nodes' own rules before
any of them is started.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.node_parameters import PARAMETERS
from dextar_control.contract.parameters import names_in_use, present_names, settled
from dextar_control.contract.resources import node_defaults
from dextar_control.nodekit.node import DextarNode
from dextar_control.nodes.controller import ControllerNode
from dextar_control.nodes.markers import MarkerNode
from dextar_control.nodes.panel import PanelNode
from dextar_control.nodes.recorder import RecorderNode
from dextar_control.nodes.task import Task
from dextar_control.nodes.trajectory_server import TrajectoryServer

NODES = ControllerNode, TrajectoryServer, RecorderNode, MarkerNode, PanelNode
KINDS: dict[str, type[DextarNode]] = {kind.NAME: kind for kind in NODES}


def _full_name(node: str, namespace: str) -> str:
    return f"{namespace.rstrip('/')}/{node}"


def as_files_spell(
    node: str, changes: Mapping[str, Any], *files: Path, namespace: str = ""
) -> dict[str, Any]:
    """Changes of parameters under the names that the files use for them, so that they
    override the files also where those are of the release before.

    Args:
        node: its name.
        changes: by present names.
        files: parameter files, later ones over earlier ones.
        namespace: of the node.
    """
    given = node_defaults(_full_name(node, namespace), *files)
    return names_in_use(PARAMETERS.get(node, ()), changes, given)


def check_start(
    node: str, changes: Mapping[str, Any], *files: Path, namespace: str = ""
) -> dict[str, Any]:
    """The values of a node's parameters.

    Args:
        node: its name.
        changes: of single parameters, over those of the files.
        files: parameter files, later ones over earlier ones.
        namespace: of the node.

    Raises:
        ParameterError: one is unknown or cannot be used, or they contradict each other;
            names the node.
    """
    full, specs = _full_name(node, namespace), PARAMETERS.get(node, ())
    try:
        given, _ = present_names(specs, node_defaults(full, *files) | dict(changes))
        kind = KINDS.get(node)
        values = settled(node, specs, given, robot=kind is None or kind.ROBOT)
        if kind is TrajectoryServer:
            Task.from_values(values)
    except ParameterError as error:
        raise ParameterError(f"{node}: {error}") from error
    return values
