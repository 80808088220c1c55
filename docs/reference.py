"""The tables of the documentation that are made from the code when the site is built, so that none can differ from it."""

from __future__ import annotations

import importlib
from collections.abc import Iterable

from dextar_control import cli
from dextar_control.contract import help as node_help
from dextar_control.contract import resources, tables as contract
from dextar_control.contract.parameters import Parameter
from dextar_control.contract.robot import ROBOT_KEYS
from dextar_control.contract.topics import NODES, PHASES, READABLE_CRITERION, READABLE_STATE, TOPICS
from dextar_control.control.supervisor import WATCHES
from dextar_control.ros.launch_arguments import ARGUMENTS

CLASSES = {
    "plant": "dextar_sim.node:PlantNode",
    "controller": "dextar_control.ros.controller_node:ControllerNode",
    "trajectory_server": "dextar_control.ros.trajectory_server:TrajectoryServer",
    "recorder": "dextar_control.ros.recorder_node:RecorderNode",
    "markers": "dextar_control.ros.marker_node:MarkerNode",
    "panel": "dextar_control.ros.panel_node:PanelNode",
}
"""Where the class of each node stands."""


def table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown; a | within a cell is |s|, not the cell's end."""
    lines = [list(header)]
    lines += [["---"] * len(lines[0]), *([cell.replace("|", r"\|") for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def node_class(name: str) -> type:
    """The class of a node."""
    module, _, kind = CLASSES[name].partition(":")
    return getattr(importlib.import_module(module), kind)


def parameters(node: str, specs: Iterable[Parameter]) -> str:
    """The parameters of a node, with default, unit, range, and whether they are live."""
    defaults = resources.node_defaults(node)
    rows = [
        [f"`{spec.name}`", _shown(defaults[spec.name]), spec.unit, _range(spec), "yes" if spec.live else "", spec.description]
        for spec in specs
    ]
    return table(("parameter", "default", "unit", "range", "live", "what it is"), rows)


def _shown(default: object) -> str:
    if isinstance(default, bool):
        return str(default).lower()
    return f"`{default}`" if isinstance(default, str) and default else '`""`' if default == "" else str(default)


def _range(spec: Parameter) -> str:
    if spec.choices:
        return ", ".join(f"`{choice}`" for choice in spec.choices)
    low, high = spec.minimum, spec.maximum
    if low is None:
        return "" if high is None else f"≤ {high:.10g}"
    return f"≥ {low:.10g}" if high is None else f"{low:.10g} to {high:.10g}"


def watches() -> str:
    """What the controller watches at every sample, with the parameters of each limit and their defaults."""
    defaults = resources.node_defaults("controller")

    def told(words: str) -> str:
        """The words of a limit, with the default behind each parameter."""
        parts = [f"`{word}` ({defaults[word]})" if word in defaults else word for word in words.split()]
        return " ".join(parts)

    rows = [
        [f"`{watch.name}`", watch.value, told(watch.limit) + (f" {watch.unit}" if watch.unit else ""),
         told(watch.time) + " s" if watch.time else "not at all", watch.reason]
        for watch in WATCHES
    ]  # fmt: skip
    return table(("watch", "what is watched", "limit", "may be passed for", "why there"), rows)


def nodes() -> str:
    """What each node does, publishes and reads."""
    rows = [
        [f"`{name}`", node_help.first_paragraph(node_class(name).__doc__),
         ", ".join(f"`{topic.name}`" for topic in ends.publishes),
         "every topic" if name == "recorder" else ", ".join(f"`{topic.name}`" for topic in ends.reads)]
        for name, ends in NODES.items()
    ]  # fmt: skip
    return table(("node", "what it does", "publishes", "reads"), rows)


def commands() -> str:
    """Every command of ``dextar`` with its help."""
    parser = cli._parser()
    subparsers = next(action.choices for action in parser._actions if hasattr(action, "choices") and action.choices)
    parts = []
    for name, one in subparsers.items():
        one.formatter_class = lambda prog: __import__("argparse").HelpFormatter(prog, width=79)
        parts.append(f"## dextar {name}\n\n```text\n{one.format_help().rstrip()}\n```")
    return "\n\n".join(parts)


def tables() -> dict[str, str]:
    """Every table, by the name that the pages use."""
    every = {
        "nodes": nodes(),
        "topics": table(
            ("topic", "type", "from → to", "QoS", "rate", "unit; joints", "stamp", "time-out"), contract.topic_rows()
        ),
        "topic_fields": table(("topic", "what it carries"),
                              ([f"`{topic.name}`", topic.meaning] for topic in (*TOPICS, READABLE_STATE, READABLE_CRITERION))),
        "phase_line": contract.phase_line(),
        "services": "\n".join(contract.service_table()),
        "phases": table(("number", "phase", "what the controller does"),
                        ([str(number), f"`{name}`", text] for number, (name, text) in enumerate(PHASES.items()))),
        "watches": watches(),
        "launch_arguments": table(("argument", "default", "what it is"),
                                  ([f"`{name}`", f"`{one.default}`" if one.default else "", one.told]
                                   for name, one in ARGUMENTS.items())),
        "robot_keys": table(("key", "what it is"), ([f"`robot.{key}`", text] for key, text in ROBOT_KEYS.items())),
        "commands": commands(),
    }  # fmt: skip
    return every | {f"parameters_{name}": parameters(name, node_class(name).PARAMETERS) for name in NODES}
