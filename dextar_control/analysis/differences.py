"""In what several runs differ before they begin: law, estimator, robot, parameters; and
one run from the defaults.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from dextar_control.analysis.metrics import Metrics
from dextar_control.analysis.run import Run
from dextar_control.contract import resources
from dextar_control.contract.robot import PREFIX, flatten, load_robot

ABSENT = "–"
OWN_LINE = {"law", "estimator"}  # parameters that have one
# parameters that name where a run's files go
PLACES = {"recorder.output", "trajectory_server.drawing"}


class Difference(NamedTuple):
    """Something in which runs differ.

    Attributes:
        name: what, a parameter with its node's.
        values: of each run, as text.
        parameter: whether it is one.
    """

    name: str
    values: list[str]
    parameter: bool


def differing(runs: Sequence[Run], metrics: Sequence[Metrics]) -> list[Difference]:
    """List what differs between runs, the weightiest first, and their bags in any
    case.
    """
    told = [
        ("law", [one.law or "unknown" for one in metrics]),
        ("estimator", [one.estimator or "unknown" for one in metrics]),
        ("robot", [one.robot or "unknown" for one in metrics]),
        (
            "true motion",
            ["recorded" if run.truth is not None else "not recorded" for run in runs],
        ),
        ("planned crossings", [str(len(one.crossings)) for one in metrics]),
    ]
    found = [
        Difference(name, values, False) for name, values in told if len(set(values)) > 1
    ]
    every = [_parameters(run) for run in runs]
    for key in sorted({key for own in every for key in own}):
        values = [own.get(key, ABSENT) for own in every]
        if (
            any(not same_value(value, values[0]) for value in values)
            and key not in PLACES
            and key.partition(".")[2] not in OWN_LINE
        ):
            found.append(Difference(key, [value_text(value) for value in values], True))
    return [*found, Difference("bag", [shown_name(run) for run in runs], False)]


def _parameters(run: Run) -> dict[str, object]:
    """Collect the parameters by dotted names, with their node's before them; the
    controller's robot as ``robot``.
    """
    robot = run.parameters.get("controller", {})
    found = {
        key: value
        for key, value in robot.items()
        if key.startswith(PREFIX) and key != f"{PREFIX}name"
    }
    for node, values in run.parameters.items():
        found |= {
            f"{node}.{key}": value
            for key, value in values.items()
            if not key.startswith(PREFIX) or not same_value(value, robot.get(key))
        }
    return found


class NodeParameters(NamedTuple):
    """The parameters of a node: all as (name, value, whether it is not the default),
    and the changed ones as (name, value, default).
    """

    name: str
    entries: list[tuple[str, str, bool]]
    changed: list[tuple[str, str, str]]


def nodes_of(run: Run) -> list[NodeParameters]:
    """List the robot once, then each node's own parameters, with its robot where that
    is another one.
    """
    robots = {
        node: {key: value for key, value in values.items() if key.startswith(PREFIX)}
        for node, values in run.parameters.items()
    }
    robot = next(
        (values for values in (robots.get("controller"), *robots.values()) if values),
        {},
    )
    shipped = flatten(load_robot(resources.config_file(resources.ROBOT_FILE)))
    nodes = (
        [
            _node(
                "robot",
                {key.removeprefix(PREFIX): value for key, value in robot.items()},
                shipped,
            )
        ]
        if robot
        else []
    )
    for node in sorted(run.parameters):
        own = {
            key: value
            for key, value in run.parameters[node].items()
            if robots[node] != robot or key not in robot
        }
        defaults = resources.node_defaults(node) | {
            f"{PREFIX}{key}": value for key, value in shipped.items()
        }
        nodes.append(_node(node, own, defaults))
    return nodes


def _node(
    name: str, values: Mapping[str, object], defaults: Mapping[str, object]
) -> NodeParameters:
    changed = [
        key
        for key in sorted(values)
        if key in defaults and not same_value(values[key], defaults[key])
    ]
    return NodeParameters(
        name,
        [(key, value_text(values[key]), key in changed) for key in sorted(values)],
        [
            (key, value_text(values[key]), value_text(defaults[key]) or ABSENT)
            for key in changed
        ],
    )


def same_value(one: object, other: object) -> bool:
    """Tell whether two values of a parameter are equal; a list equals a tuple."""
    one, other = (
        list(value) if isinstance(value, (list, tuple)) else value
        for value in (one, other)
    )
    return bool(one == other)


def value_text(value: object) -> str:
    """Write a parameter's value as a page shows it."""
    return value if isinstance(value, str) else json.dumps(value)


def shown_name(run: Run) -> str:
    """Name a bag by its real folder and file."""
    path = run.path.resolve()
    return f"{path.parent.name}/{path.name}"
