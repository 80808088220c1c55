"""The tables that are made from the code when the site is built, so none can differ."""

from __future__ import annotations

import importlib
import math
import os
from collections.abc import Iterable

from dextar_control.analysis.crossings import CROSSING_METRICS
from dextar_control.analysis.metrics import METRICS
from dextar_control.analysis.registry import Metric
from dextar_control.cli.main import parser
from dextar_control.contract import resources
from dextar_control.contract.former_names import former_names
from dextar_control.contract.help import first_paragraph, rate
from dextar_control.contract.parameters import Parameter
from dextar_control.contract.robot import ROBOT_KEYS
from dextar_control.contract.topics import (
    NODES,
    PHASES,
    READABLE_CRITERION,
    READABLE_STATE,
    SERVICES,
    TOPICS,
    TimeOut,
    Topic,
)
from dextar_control.control.supervisor import WATCHES
from dextar_control.experiments.campaign.ranges import BARS, PERTURBATIONS, Range
from dextar_control.experiments.launch_arguments import ARGUMENTS

CLASSES = {
    "plant": "dextar_sim.node:PlantNode",
    "controller": "dextar_control.nodes.controller:ControllerNode",
    "trajectory_server": "dextar_control.nodes.trajectory_server:TrajectoryServer",
    "recorder": "dextar_control.nodes.recorder:RecorderNode",
    "markers": "dextar_control.nodes.markers:MarkerNode",
    "panel": "dextar_control.nodes.panel:PanelNode",
}
"""Where the class of each node stands."""


def table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown; the bars of |s| do not end its cells."""
    header = list(header)
    lines = [header, ["---"] * len(header)]
    lines += [[cell.replace("|", r"\|") for cell in row] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def code(*names: str) -> str:
    """Names as code."""
    return ", ".join(f"`{name}`" for name in names)


def node_class(name: str) -> type:
    """The class of a node."""
    module, _, kind = CLASSES[name].partition(":")
    return getattr(importlib.import_module(module), kind)


def parameters(node: str, specs: Iterable[Parameter]) -> str:
    """The parameters of a node."""
    defaults = resources.node_defaults(node)
    header = "parameter", "default", "range", "live", "what it is"
    return table(
        header,
        (
            [
                code(spec.name),
                shown(defaults[spec.name], spec.unit),
                allowed(spec),
                "yes" if spec.live else "",
                spec.description,
            ]
            for spec in specs
        ),
    )


def shown(default: object, unit: str) -> str:
    """A default as it is typed, with its unit."""
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, str):
        return code(default or '""')
    return f"{default} {unit}" if unit != "1" else str(default)


def allowed(spec: Parameter) -> str:
    """The choices or the range."""
    if spec.choices:
        own = f", or {code('module:attribute')} of your own" if spec.own else ""
        return code(*spec.choices) + own
    low, high = spec.bounds or (-math.inf, None)
    return bounds(low, math.inf if high is None else high)


def bounds(low: float, high: float) -> str:
    """A closed interval."""
    if math.isinf(low):
        return "" if math.isinf(high) else f"≤ {high:.10g}"
    return f"≥ {low:.10g}" if math.isinf(high) else f"{low:.10g} to {high:.10g}"


def former_parameters() -> str:
    """Every parameter that has been renamed, node by node."""
    rows = (
        [code(node), code(old), code(new)]
        for node in NODES
        for old, new in former_names(node_class(node).PARAMETERS).items()
    )
    return table(("node", "former name", "present name"), rows)


def watches() -> str:
    """What the controller watches, with the defaults of the limits' parameters."""
    defaults = resources.node_defaults("controller")

    def told(words: str, unit: str) -> str:
        parts = [
            f"{code(word)} ({defaults[word]})" if word in defaults else word
            for word in words.split()
        ]
        return " ".join([*parts, unit] if words != "none" else parts)

    header = "watch", "what is watched", "limit", "may be passed for", "why there"
    return table(
        header,
        (
            [
                code(watch.name),
                watch.value,
                told(watch.limit, watch.unit),
                told(watch.time, "s") if watch.time else "not at all",
                watch.reason,
            ]
            for watch in WATCHES
        ),
    )


def nodes() -> str:
    """What each node does, publishes and reads."""
    return table(
        ("node", "what it does", "publishes", "reads"),
        (
            [
                code(name),
                first_paragraph(node_class(name).__doc__),
                code(*(topic.name for topic in ends.publishes)),
                "every topic"
                if ends.reads == TOPICS
                else code(*(topic.name for topic in ends.reads)),
            ]
            for name, ends in NODES.items()
        ),
    )


def quality(topic: Topic) -> str:
    """What is offered, and what the control path asks for where that is less."""
    offered = "reliable" if topic.reliable else "best effort"
    asked = "" if topic.read_reliable else ", read best effort"
    return f"{'latched, ' if topic.latched else ''}{offered} {topic.depth}{asked}"


def time_out(limit: TimeOut) -> str:
    """Default, outcome and the parameter that holds it."""
    value = 1e3 * resources.node_defaults(limit.node)[limit.parameter]
    return f"{value:g} ms: {limit.outcome} ({code(f'{limit.node}.{limit.parameter}')})"


def topics() -> str:
    """The contract's topics."""
    header = "topic", "type", "from → to", "QoS", "rate", "unit; joints", "stamp"
    return table(
        (*header, "time-out"),
        (
            [
                code(topic.name) + (" (optional)" if topic.optional else ""),
                topic.type,
                f"{topic.publisher} → {topic.subscriber}",
                quality(topic),
                rate(topic),
                topic.unit + (f"; {', '.join(topic.joints)}" if topic.joints else ""),
                topic.stamp,
                "; ".join(time_out(limit) for limit in topic.timeouts),
            ]
            for topic in TOPICS
        ),
    )


def services() -> str:
    """The contract's services."""
    rows = ([code(one.name), one.type, one.meaning] for one in SERVICES)
    return table(("service", "type", "what it does"), rows)


def topic_fields() -> str:
    """What each topic carries."""
    every = *TOPICS, READABLE_STATE, READABLE_CRITERION
    rows = ([code(topic.name), topic.meaning] for topic in every)
    return table(("topic", "what it carries"), rows)


def phases() -> str:
    """The controller's phases."""
    rows = (
        [str(number), code(name), meaning]
        for number, (name, meaning) in enumerate(PHASES.items())
    )
    return table(("number", "phase", "what the controller does"), rows)


def launch_arguments() -> str:
    """Of the launch files."""
    rows = (
        [code(name), code(one.default) if one.default else "", one.told]
        for name, one in ARGUMENTS.items()
    )
    return table(("argument", "default", "what it is"), rows)


def robot_keys() -> str:
    """The description of a robot, with the shipped one's numbers."""
    file = resources.config_file(resources.ROBOT_FILE)
    shipped = resources.node_defaults("controller", file)
    names = {key: f"robot.{key}" for key in ROBOT_KEYS}
    rows = (
        [code(names[key]), str(shipped.get(names[key], "")), text]
        for key, text in ROBOT_KEYS.items()
    )
    return table(("key", "the DexTAR's", "what it is"), rows)


def ranges(title: str, numbers: dict[str, Range]) -> str:
    """What a campaign file may say, within which limits."""
    rows = (
        [code(name), one.meaning, bounds(one.low, one.high)]
        for name, one in numbers.items()
    )
    return table((title, "what it is", "range"), rows)


def metrics(every: dict[str, Metric]) -> str:
    """The numbers of a run or of a crossing, as ``metrics.json`` has them."""
    rows = (
        [code(key), one.name, one.unit, one.definition] for key, one in every.items()
    )
    return table(("key", "name", "unit", "definition"), rows)


def commands() -> str:
    """Every command of ``dextar`` with its help, of a terminal of 80 columns."""
    os.environ["COLUMNS"] = "80"
    every = parser()._subparsers._group_actions[0].choices
    return "\n\n".join(
        f"## dextar {name}\n\n```text\n{one.format_help().rstrip()}\n```"
        for name, one in every.items()
    )


def tables() -> dict[str, str]:
    """Every table, by the name under which a page has it in double braces."""
    return {
        "nodes": nodes(),
        "topics": topics(),
        "topic_fields": topic_fields(),
        "services": services(),
        "phases": phases(),
        "phase_line": ", ".join(
            f"{number} {name}" for number, name in enumerate(PHASES)
        ),
        "former_parameters": former_parameters(),
        "watches": watches(),
        "launch_arguments": launch_arguments(),
        "commands": commands(),
        "perturbations": ranges("perturbation", PERTURBATIONS),
        "bars": ranges("bar", BARS),
        "robot_keys": robot_keys(),
        "metrics": metrics(METRICS),
        "crossing_metrics": metrics(CROSSING_METRICS),
        **{
            f"parameters_{name}": parameters(name, node_class(name).PARAMETERS)
            for name in NODES
        },
    }
