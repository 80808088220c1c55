"""``--help`` of a node prints its docstring, the contract's tables and its parameters.
No ROS here.
"""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Iterable
from typing import ClassVar, Protocol

from dextar_control.contract import resources
from dextar_control.contract.parameters import Parameter
from dextar_control.contract.topics import NODES, SERVICES, Topic

WIDTH = 79
BESIDE = 22  # columns of a name in a list


def first_paragraph(text: str | None) -> str:
    """Return the first paragraph of a docstring on one line; an empty text
    without one.
    """
    return " ".join(
        inspect.cleandoc(text or "").split("\n\n")[0].replace("``", "").split()
    )


class DescribedNode(Protocol):
    """A node's class, of which the help tells beside its docstring.

    Attributes:
        NAME: node name; empty where the package's tables do not know it.
        PARAMETERS: the node's parameters.
        ROBOT: whether the node takes the robot description.
    """

    NAME: ClassVar[str]
    PARAMETERS: ClassVar[tuple[Parameter, ...]]
    ROBOT: ClassVar[bool]


def node_help(node: type[DescribedNode]) -> str:
    """Return all that ``--help`` prints of a node."""
    about = textwrap.fill(first_paragraph(node.__doc__), WIDTH)
    name = node.NAME
    if name not in NODES:
        command = f"ros2 run dextar {name}" if name else node.__name__
        return f"usage: {command} [-h] [--ros-args ROS_ARGUMENT ...]\n\n{about}"
    ends = NODES[name]
    parts = [
        f"usage: ros2 run dextar {name} [-h] [--ros-args ROS_ARGUMENT ...]",
        about,
        _section(
            f"options of dextar {name}",
            (_item(*pair) for pair in getattr(node, "SHORT", ())),
        ),
        _section("publishes", (_topic(topic, name) for topic in ends.publishes)),
        _section("reads", map(_topic, ends.reads)),
        _section(
            "services, beside those of every node",
            (
                _item(
                    f"~/{service.name.partition('/')[2]}",
                    f"{service.type}: {service.meaning}",
                )
                for service in SERVICES
                if service.node == name
            ),
        ),
        _parameters(name, node.PARAMETERS, node.ROBOT),
        textwrap.fill(
            "A parameter is set with --ros-args -p NAME:=VALUE, beside a parameter"
            f" file (--params-file FILE) with -p {name}:NAME:=VALUE; one that is live"
            f" also while the node runs, with ros2 param set /{name} NAME VALUE. A name"
            " is remapped with -r OLD:=NEW, the namespace is set with -r"
            " __ns:=/NAMESPACE.",
            WIDTH,
            break_on_hyphens=False,
        ),
    ]
    return "\n\n".join(part for part in parts if part)


def rate(topic: Topic) -> str:
    """Return a topic's nominal rate in words."""
    return topic.rate_text or (f"{topic.rate:g} Hz" if topic.rate else "on change")


def _section(title: str, items: Iterable[str]) -> str:
    lines = list(items)
    return "\n".join([f"{title}:", *lines]) if lines else ""


def _item(name: str, text: str) -> str:
    """Return a name with its text beside it, or below where the name is long."""
    lines = textwrap.wrap(
        text, WIDTH - BESIDE - 2, break_on_hyphens=False, break_long_words=False
    )
    if len(name) < BESIDE:
        lines[0] = f"{name:<{BESIDE}}{lines[0]}"
    else:
        lines = [name, " " * BESIDE + lines[0], *lines[1:]]
    return textwrap.indent(
        "\n".join([lines[0], *(" " * BESIDE + line.strip() for line in lines[1:])]),
        "  ",
    )


def _topic(topic: Topic, node: str = "") -> str:
    """Return one line on a topic, which names the parameter of this node that switches
    it on.
    """
    owner, _, parameter = topic.switch.partition(".")
    switch = f" (only with {parameter})" if parameter and owner == node else ""
    return _item(topic.name, f"{topic.type}, {rate(topic)}{switch}")


def _parameters(node: str, specs: Iterable[Parameter], robot: bool) -> str:
    """A section for each group."""
    defaults = resources.node_defaults(node)
    sections: dict[str, list[str]] = {"": []}
    for spec in specs:
        lines = sections.setdefault(spec.group, [])
        lines.append(
            f"  {spec.name} = {_value(defaults[spec.name])}{_unit(spec)}{_limits(spec)}"
        )
        words = textwrap.wrap(_words(spec), WIDTH - 6, break_on_hyphens=False)
        lines += [textwrap.indent(line, " " * 6) for line in words]
    if robot:
        file = resources.config_file(resources.ROBOT_FILE)
        sections["robot"] = [
            f"  robot.* = those of {file}",
            "      A whole parameter file describes the robot; it is fixed.",
        ]
    heading = "parameters, with default, unit where a number has one, range"
    return "\n\n".join(
        _section(f"parameters {group}.*" if group else heading, lines)
        for group, lines in sections.items()
    )


def _words(spec: Parameter) -> str:
    """Return the description and what may be chosen behind it."""
    return spec.description + (f" It is {spec.allowed}." if spec.allowed else "")


def _value(default: object) -> str:
    """Return a default as it is typed behind NAME:=."""
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, str):
        return default or '""'
    return str(list(default)) if isinstance(default, (list, tuple)) else str(default)


def _unit(spec: Parameter) -> str:
    return "" if spec.unit in ("", "1") else f" {spec.unit}"


def _limits(spec: Parameter) -> str:
    """Return the range, how many numbers there are, and whether it is live, in
    brackets.
    """
    words = []
    if spec.bounds:
        low, high = spec.bounds
        words.append(f">= {low:.10g}" if high is None else f"{low:.10g} to {high:.10g}")
    if spec.size:
        words.append(f"{spec.size} numbers")
    if spec.live:
        words.append("live")
    return f" ({'; '.join(words)})" if words else ""
