"""In what several runs differ before they begin: law, estimator, robot, parameters; and
one run from the defaults.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from dextar_control.analysis.metrics import Metrics
from dextar_control.analysis.run import Run
from dextar_control.contract import resources
from dextar_control.contract.robot import PREFIX, flatten, load_robot

ABSENT = "–"
OWN_LINE = {"law", "estimator"}  # parameters that have one
PLACES = {
    "recorder.output",
    "trajectory_server.drawing",
}  # parameters that name where a run's files go


class Difference(NamedTuple):
    """One thing in which runs differ.

    Attributes:
        name: what, a parameter with its node's.
        values: of each run, as text.
        parameter: whether it is one.
    """

    name: str
    values: list[str]
    parameter: bool


def differing(runs: Sequence[Run], metrics: Sequence[Metrics]) -> list[Difference]:
    """What differs, the weightiest first; the bags in any case."""
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
            any(not same(value, values[0]) for value in values)
            and key not in PLACES
            and key.partition(".")[2] not in OWN_LINE
        ):
            found.append(Difference(key, [text(value) for value in values], True))
    return [*found, Difference("bag", [shown_name(run) for run in runs], False)]


def _parameters(run: Run) -> dict[str, Any]:
    """By dotted names, a node's before its own; the controller's robot as ``robot``."""
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
            if not key.startswith(PREFIX) or not same(value, robot.get(key))
        }
    return found


class Node(NamedTuple):
    """The parameters of a node: (name, value, whether it is not the default), and
    (name, value, default) of those.
    """

    name: str
    entries: list[tuple[str, str, bool]]
    changed: list[tuple[str, str, str]]


def nodes_of(run: Run) -> list[Node]:
    """The robot once, then each node's own parameters, its robot too where it is
    another.
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


def _node(name: str, values: Mapping[str, Any], defaults: Mapping[str, Any]) -> Node:
    changed = [
        key
        for key in sorted(values)
        if key in defaults and not same(values[key], defaults[key])
    ]
    return Node(
        name,
        [(key, text(values[key]), key in changed) for key in sorted(values)],
        [(key, text(values[key]), text(defaults[key]) or ABSENT) for key in changed],
    )


def same(one: Any, other: Any) -> bool:
    """Whether two values of a parameter are; lists and tuples are alike."""
    one, other = (
        list(value) if isinstance(value, (list, tuple)) else value
        for value in (one, other)
    )
    return bool(one == other)


def text(value: Any) -> str:
    """A parameter's value as a page shows it."""
    return value if isinstance(value, str) else json.dumps(value)


def shown_name(run: Run) -> str:
    """Real folder and file of a bag."""
    path = run.path.resolve()
    return f"{path.parent.name}/{path.name}"
