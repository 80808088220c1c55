"""Check the parameters with which nodes would start by the nodes' own rules, before any
of them is started.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.former_names import (
    present_names,
    present_parameters,
    present_sections,
)
from dextar_control.contract.node_parameters import parameters_of_node
from dextar_control.contract.parameters import settled
from dextar_control.nodekit.node import DextarNode
from dextar_control.nodes.controller import ControllerNode
from dextar_control.nodes.markers import MarkerNode
from dextar_control.nodes.panel import PanelNode
from dextar_control.nodes.recorder import RecorderNode
from dextar_control.nodes.task import Task
from dextar_control.nodes.trajectory_server import TrajectoryServer

NODES = ControllerNode, TrajectoryServer, RecorderNode, MarkerNode, PanelNode
KINDS: dict[str, type[DextarNode]] = {kind.NAME: kind for kind in NODES}


def check_start(
    node: str, changes: Mapping[str, object], *files: Path, namespace: str = ""
) -> dict[str, object]:
    """Return the values of a node's parameters.

    Args:
        node: its name.
        changes: of single parameters, over those of the files.
        files: parameter files, later ones over earlier ones.
        namespace: of the node.

    Raises:
        ParameterError: one is unknown or cannot be used, or they contradict each other;
            names the node.
    """
    specs, kind = parameters_of_node(node), KINDS.get(node)
    try:
        given = present_parameters(f"{namespace.rstrip('/')}/{node}", *files)
        given |= present_names(specs, changes)[0]
        values = settled(node, specs, given, robot=kind is None or kind.ROBOT)
        if kind is TrajectoryServer:
            Task.from_values(values)
    except ParameterError as error:
        raise ParameterError(f"{node}: {error}") from error
    return values


def renamed_in_files(node: str, *files: Path) -> dict[str, str]:
    """Return the former names that parameter files use for a node, with the present
    ones.

    Args:
        node: its name.
        files: parameter files.

    Raises:
        ParameterError: as ``present_sections``.
    """
    renamed: dict[str, str] = {}
    for path in files:
        renamed |= present_sections(node, path)[1]
    return renamed
