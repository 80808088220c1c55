"""The SROS2 policy says what each node may publish, read, offer and call; everything
else is denied.

``python -m dextar_control.security.policy`` prints the file that
``config/sros2/policy.xml`` is, with ``--namespace /left`` the one for a robot whose
nodes live there.
"""

from __future__ import annotations

import argparse
import re
import sys
from dataclasses import dataclass
from xml.etree import ElementTree

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.topics import (
    DIAGNOSTICS,
    EFFORT_COMMANDS,
    EXTERNAL_POSE,
    GO,
    JOINT_COMMANDS,
    JOINT_STATES,
    NODES,
    READABLE_CRITERION,
    READABLE_STATE,
    SERVICES,
    TOPICS,
    Topic,
)

POLICY_VERSION = "0.2.0"  # of the schema that sros2 checks policies against
# What rclpy gives each node; a node that may not have these does not come up.
EVERY_NODE_PUBLISHES = ("/parameter_events", "/rosout")
PARAMETER_SERVICES = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
EVERY_NODE_OFFERS = ("get_type_description", *PARAMETER_SERVICES)
# What rclcpp's nodes and RViz read besides what they show.
VIEWERS_READ = ("/clock", "/parameter_events", "/rosout", "/tf", "/tf_static")
# The nodes of `ros2 ...`, each with its process id in its name.
COMMAND_LINE = "_ros2cli_*"
# Nodes whose parameters the recorder asks for.
PARAMETERS_OF = ("controller", "plant", "trajectory_server")
NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+|/")


@dataclass(frozen=True)
class NodeRights:
    """What the nodes of one name may do in the graph.

    Attributes:
        node: its name, which may end in ``*``.
        publishes: topics, relative to the namespace unless they begin with ``/``.
        reads: topics likewise.
        offers: services below the node's own name, besides those of every node.
        calls: services of others, ``node/service``.
        actions: that it offers, relative to the namespace.
        asks: actions of others.
    """

    node: str
    publishes: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    offers: tuple[str, ...] = ()
    calls: tuple[str, ...] = ()
    actions: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Enclave:
    """One identity: the key a process holds, and what it may do with it.

    Attributes:
        name: last part of the enclave's path.
        why: what it is for, in words.
        rights: of the nodes that run under it.
    """

    name: str
    why: str
    rights: tuple[NodeRights, ...]


def _names(*topics: Topic) -> tuple[str, ...]:
    return tuple(topic.name for topic in topics)


def _rights(
    node: str,
    *,
    publishes: tuple[str, ...] = (),
    reads: tuple[str, ...] = (),
    calls: tuple[str, ...] = (),
) -> NodeRights:
    """Return the rights that the contract gives one of our nodes, and these more."""
    ends = NODES[node]
    offers = (item.name.partition("/")[2] for item in SERVICES if item.node == node)
    return NodeRights(
        node,
        (*_names(*ends.publishes), *publishes),
        (*_names(*ends.reads), *reads),
        tuple(offers),
        calls,
    )


STATES = (JOINT_STATES,)
COMMANDS = (JOINT_COMMANDS, EFFORT_COMMANDS)
EVERY_SERVICE = (
    *(service.name for service in SERVICES),
    *(
        f"{node}/{name}"
        for node in (*PARAMETERS_OF, "recorder", "markers", "panel")
        for name in PARAMETER_SERVICES
    ),
)
TRIPS = (
    "controller/stop",
    "trajectory_server/start",
    "trajectory_server/stop",
    "trajectory_server/set_parameters_atomically",
)
OBSERVES = _names(*TOPICS, READABLE_STATE, READABLE_CRITERION)

ENCLAVES = (
    Enclave(
        "plant",
        "the simulated rig, the only one that knows the truth",
        (_rights("plant"),),
    ),
    Enclave(
        "rig",
        "the driver of a real robot; its node is called rig",
        (NodeRights("rig", _names(*STATES, DIAGNOSTICS), _names(*COMMANDS)),),
    ),
    Enclave(
        "camera",
        "a camera that sees the end effector; its node is called camera",
        (NodeRights("camera", _names(EXTERNAL_POSE, DIAGNOSTICS)),),
    ),
    Enclave(
        "controller",
        "the only one that may command; check-rig commands in its stead, while it does"
        " not run",
        (
            _rights(
                "controller",
                publishes=(
                    "controller/transition_event",
                    *_names(READABLE_STATE, READABLE_CRITERION),
                ),
            ),
            NodeRights("check_rig", _names(*COMMANDS), _names(*STATES, DIAGNOSTICS)),
        ),
    ),
    Enclave(
        "trajectory_server",
        "tells the controller where to go",
        (_rights("trajectory_server"),),
    ),
    Enclave(
        "recorder",
        "reads everything and asks for parameters",
        (
            _rights(
                "recorder",
                reads=EVERY_NODE_PUBLISHES,
                calls=tuple(
                    f"{node}/{name}"
                    for node in PARAMETERS_OF
                    for name in ("get_parameters", "list_parameters")
                ),
            ),
        ),
    ),
    Enclave("markers", "draws what happens", (_rights("markers"),)),
    Enclave(
        "go_server",
        "offers the action go; it starts and stops trips, and may command no torque",
        (NodeRights("go_server", (), (DIAGNOSTICS.name,), (), TRIPS, actions=(GO,)),),
    ),
    Enclave(
        "panel",
        "the page in the browser, which asks as an operator does",
        (
            _rights("panel"),
            NodeRights(
                "operator", (), (*OBSERVES, "/parameter_events"), (), EVERY_SERVICE
            ),
        ),
    ),
    Enclave(
        "operator",
        "whoever starts, stops and tunes the nodes: the demo, `dextar go` and its like,"
        " `ros2 ...`; it may command no torque",
        (
            *(
                NodeRights(node, (), OBSERVES, (), EVERY_SERVICE, asks=(GO,))
                for node in ("demo", "operator", COMMAND_LINE)
            ),
        ),
    ),
    Enclave(
        "viewer",
        "RViz, PlotJuggler and the Foxglove bridge; they look on",
        tuple(
            NodeRights(node, (), (*OBSERVES, *VIEWERS_READ))
            for node in ("foxglove_bridge", "plotjuggler", "rviz", "rviz2")
        ),
    ),
)


def build_policy(namespace: str = "/") -> ElementTree.Element:
    """Return the policy as XML.

    Args:
        namespace: of the nodes; enclaves lie in it too, so that two robots do not share
            keys.

    Raises:
        ParameterError: the namespace is no absolute ROS name.
    """
    if not NAMESPACE.fullmatch(namespace):
        raise ParameterError(
            f"namespace '{namespace}'; it must be absolute, of letters, digits and _,"
            " e.g. /left"
        )
    policy = ElementTree.Element("policy", version=POLICY_VERSION)
    enclaves = ElementTree.SubElement(policy, "enclaves")
    for enclave in ENCLAVES:
        element = ElementTree.SubElement(
            enclaves,
            "enclave",
            path=f"{namespace.rstrip('/')}/dextar/{enclave.name}",
        )
        # Within its element: sros2 takes every child of enclaves for one.
        element.append(ElementTree.Comment(f" {enclave.why} "))
        profiles = ElementTree.SubElement(element, "profiles")
        for rights in enclave.rights:
            _add_profile(profiles, rights, namespace)
    return policy


def _add_profile(
    profiles: ElementTree.Element, rights: NodeRights, namespace: str
) -> None:
    profile = ElementTree.SubElement(
        profiles, "profile", ns=namespace, node=rights.node
    )
    own = tuple(f"~/{name}" for name in (*EVERY_NODE_OFFERS, *rights.offers))
    for kind, right, names in (
        ("topic", "publish", (*EVERY_NODE_PUBLISHES, *rights.publishes)),
        ("topic", "subscribe", rights.reads),
        ("service", "reply", own),
        ("service", "request", rights.calls),
        ("action", "execute", rights.actions),
        ("action", "call", rights.asks),
    ):
        if names:
            group = ElementTree.SubElement(profile, f"{kind}s", {right: "ALLOW"})
            for name in sorted(set(names)):
                ElementTree.SubElement(group, kind).text = name


def policy_text(namespace: str = "/") -> str:
    """Return the policy as a file's text."""
    policy = build_policy(namespace)
    ElementTree.indent(policy)
    text = ElementTree.tostring(policy, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def main() -> int:
    """Print the policy; the exit code."""
    parser = argparse.ArgumentParser(
        description="Print the SROS2 policy of this package's nodes."
    )
    parser.add_argument(
        "--namespace", default="/", help="of the nodes, e.g. /left (default: /)"
    )
    try:
        print(policy_text(parser.parse_args().namespace), end="")
    except ParameterError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
