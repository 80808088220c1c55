"""The SROS2 policy: what each node may publish, read, offer and call, from the
contract; everything else is denied.

``python -m dextar_control.security.policy`` prints the file that
``config/sros2/policy.xml`` is, with ``--namespace /left`` the one for a robot whose
nodes live there.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable
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
COMMAND_LINE = (  # the nodes of `ros2 ...`, each with its process id in its name
    "_ros2cli_*"
)
PARAMETERS_OF = (
    "controller",
    "plant",
    "trajectory_server",
)  # that the recorder asks for
NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+|/")


@dataclass(frozen=True)
class Profile:
    """What the nodes of one name may do.

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
        profiles: of the nodes that run under it.
    """

    name: str
    why: str
    profiles: tuple[Profile, ...]


def _names(*topics: Topic) -> tuple[str, ...]:
    return tuple(topic.name for topic in topics)


def _offered_by(node: str) -> tuple[str, ...]:
    return tuple(
        service.name.partition("/")[2] for service in SERVICES if service.node == node
    )


def _profile(
    node: str,
    *,
    publishes: tuple[str, ...] = (),
    reads: tuple[str, ...] = (),
    calls: tuple[str, ...] = (),
) -> Profile:
    """One of the package's nodes: what the contract says of it, and what is not in
    there.
    """
    ends = NODES[node]
    return Profile(
        node,
        (*_names(*ends.publishes), *publishes),
        (*_names(*ends.reads), *reads),
        _offered_by(node),
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
        (_profile("plant"),),
    ),
    Enclave(
        "rig",
        "the driver of a real robot; its node is called rig",
        (Profile("rig", _names(*STATES, DIAGNOSTICS), _names(*COMMANDS)),),
    ),
    Enclave(
        "camera",
        "a camera that sees the end effector; its node is called camera",
        (Profile("camera", _names(EXTERNAL_POSE, DIAGNOSTICS)),),
    ),
    Enclave(
        "controller",
        "the only one that may command; check-rig commands in its stead, while it does"
        " not run",
        (
            _profile(
                "controller",
                publishes=(
                    "controller/transition_event",
                    *_names(READABLE_STATE, READABLE_CRITERION),
                ),
            ),
            Profile("check_rig", _names(*COMMANDS), _names(*STATES, DIAGNOSTICS)),
        ),
    ),
    Enclave(
        "trajectory_server",
        "tells the controller where to go",
        (_profile("trajectory_server"),),
    ),
    Enclave(
        "recorder",
        "reads everything and asks for parameters",
        (
            _profile(
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
    Enclave("markers", "draws what happens", (_profile("markers"),)),
    Enclave(
        "go_server",
        "offers the action go; it starts and stops trips, and may command no torque",
        (Profile("go_server", (), (DIAGNOSTICS.name,), (), TRIPS, actions=(GO,)),),
    ),
    Enclave(
        "panel",
        "the page in the browser, which asks as an operator does",
        (
            _profile("panel"),
            Profile(
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
                Profile(node, (), OBSERVES, (), EVERY_SERVICE, asks=(GO,))
                for node in ("demo", "operator", COMMAND_LINE)
            ),
        ),
    ),
    Enclave(
        "viewer",
        "RViz, PlotJuggler and the Foxglove bridge; they look on",
        tuple(
            Profile(node, (), (*OBSERVES, *VIEWERS_READ))
            for node in ("foxglove_bridge", "plotjuggler", "rviz", "rviz2")
        ),
    ),
)


def build_policy(namespace: str = "/") -> ElementTree.Element:
    """The policy as XML.

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
            enclaves, "enclave", path=enclave_path(enclave.name, namespace)
        )
        element.append(
            ElementTree.Comment(f" {enclave.why} ")
        )  # within: sros2 takes every child of enclaves for one
        profiles = ElementTree.SubElement(element, "profiles")
        for profile in enclave.profiles:
            _add_profile(profiles, profile, namespace)
    return policy


def enclave_path(name: str, namespace: str = "/") -> str:
    """Path of an enclave, as ``--enclave`` takes it."""
    return f"{namespace.rstrip('/')}/dextar/{name}"


def _add_profile(
    profiles: ElementTree.Element, profile: Profile, namespace: str
) -> None:
    element = ElementTree.SubElement(
        profiles, "profile", ns=namespace, node=profile.node
    )
    own = tuple(f"~/{name}" for name in (*EVERY_NODE_OFFERS, *profile.offers))
    _add(element, "topic", "publish", (*EVERY_NODE_PUBLISHES, *profile.publishes))
    _add(element, "topic", "subscribe", profile.reads)
    _add(element, "service", "reply", own)
    _add(element, "service", "request", profile.calls)
    _add(element, "action", "execute", profile.actions)
    _add(element, "action", "call", profile.asks)


def _add(
    profile: ElementTree.Element, kind: str, right: str, names: Iterable[str]
) -> None:
    names = sorted(set(names))
    if names:
        group = ElementTree.SubElement(profile, f"{kind}s", {right: "ALLOW"})
        for name in names:
            ElementTree.SubElement(group, kind).text = name


def policy_text(namespace: str = "/") -> str:
    """The policy as a file's text."""
    policy = build_policy(namespace)
    ElementTree.indent(policy)
    return (
        '<?xml version="1.0"'
        f' encoding="UTF-8"?>\n{ElementTree.tostring(policy, encoding="unicode")}\n'
    )


def main() -> int:
    """Print the policy."""
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
