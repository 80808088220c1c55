"""Who may do what: the shipped SROS2 policy against the contract and against what
running nodes create.
"""

from __future__ import annotations

import fnmatch
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple
from xml.etree import ElementTree

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from patience import PATIENCE
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rig import start, stop

from dextar_control.check_rig.client import RigClient
from dextar_control.contract.errors import ParameterError
from dextar_control.contract.resources import config_file
from dextar_control.contract.topics import (
    DIAGNOSTICS,
    EFFORT_COMMANDS,
    GO,
    JOINT_COMMANDS,
    JOINT_STATES,
    READABLE_CRITERION,
    READABLE_STATE,
    SERVICES,
    SIM_END_EFFECTOR,
    SIM_JOINT_STATES,
    TOPICS,
    TRAJECTORY,
)
from dextar_control.nodekit.client import NodeClient
from dextar_control.nodekit.node import qos
from dextar_control.nodes.operator import OperatorClient
from dextar_control.security.policy import TRIPS, build_policy, policy_text

POLICY = config_file("sros2/policy.xml")
RIGHTS = (
    ("topic", "publish"),
    ("topic", "subscribe"),
    ("service", "reply"),
    ("service", "request"),
)
OF_ACTIONS = (("action", "execute"), ("action", "call"))
READABLE = {f"/{topic.name}" for topic in (READABLE_STATE, READABLE_CRITERION)}
MODULES = {
    "plant": ("dextar_sim.node", "external_pose.rate:=50.0"),
    "controller": (
        "dextar_control.nodes.controller",
        "estimator:=external",
        "publish.effort_array:=true",
    ),
    "trajectory_server": ("dextar_control.nodes.trajectory_server",),
    "recorder": ("dextar_control.nodes.recorder",),
    "markers": ("dextar_control.nodes.markers",),
    "panel": ("dextar_control.nodes.panel", "port:=0"),
}
# What every ROS node may have besides the contract.
EVERYWHERE = {"/rosout", "/parameter_events"}
LOOKERS_ON = {"/clock", "/tf", "/tf_static"}


class Grant(NamedTuple):
    """One name that one node may use in one way."""

    enclave: str
    node: str
    right: str
    name: str  # absolute


def _grants(root: ElementTree.Element) -> list[Grant]:
    """As sros2 reads a policy: names are relative to the profile's namespace, or below
    its node.
    """
    grants = []
    for enclave in root.findall("enclaves/enclave"):
        for profile in enclave.findall("profiles/profile"):
            base, node = profile.attrib["ns"].rstrip("/"), profile.attrib["node"]
            for group in profile:
                assert len(group.attrib) == 1
                right, qualifier = next(iter(group.attrib.items()))
                assert qualifier == "ALLOW"
                assert (group.tag.removesuffix("s"), right) in RIGHTS + OF_ACTIONS
                for entry in group:
                    text = entry.text or ""
                    name = text if text.startswith("/") else f"{base}/{text}"
                    name = f"{base}/{node}{text[1:]}" if text.startswith("~") else name
                    grants.append(Grant(enclave.attrib["path"], node, right, name))
    return grants


@pytest.fixture(scope="module")
def grants() -> list[Grant]:
    return _grants(ElementTree.parse(POLICY).getroot())


def _enclaves(grants: list[Grant], right: str, topic: str) -> set[str]:
    return {
        grant.enclave
        for grant in grants
        if grant.right == right and fnmatch.fnmatch(f"/{topic}", grant.name)
    }


def test_the_shipped_policy_is_what_the_contract_makes() -> None:
    assert POLICY.read_text(encoding="utf-8") == policy_text(), (
        "python -m dextar_control.security.policy makes it anew"
    )


def test_only_the_controllers_enclave_may_publish_commands(grants: list[Grant]) -> None:
    for topic in (JOINT_COMMANDS, EFFORT_COMMANDS):
        assert _enclaves(grants, "publish", topic.name) == {"/dextar/controller"}


def test_only_a_rig_tells_states_and_only_the_trajectory_server_tells_where_to_go(
    grants: list[Grant],
) -> None:
    assert _enclaves(grants, "publish", JOINT_STATES.name) == {
        "/dextar/plant",
        "/dextar/rig",
    }
    assert _enclaves(grants, "publish", TRAJECTORY.name) == {
        "/dextar/trajectory_server"
    }


def test_the_truth_is_told_by_the_plant_and_not_to_the_controller(
    grants: list[Grant],
) -> None:
    for topic in (SIM_END_EFFECTOR, SIM_JOINT_STATES):
        assert _enclaves(grants, "publish", topic.name) == {"/dextar/plant"}
        assert not _enclaves(grants, "subscribe", topic.name) & {
            "/dextar/controller",
            "/dextar/trajectory_server",
        }


def test_each_service_of_the_contract_is_offered_by_its_node_alone_and_called_by_the_operator(
    grants: list[Grant],
) -> None:
    for service in SERVICES:
        assert _enclaves(grants, "reply", service.name) == {f"/dextar/{service.node}"}
        trips = {"/dextar/go_server"} if service.name in TRIPS else set()
        assert (
            _enclaves(grants, "request", service.name)
            == {"/dextar/operator", "/dextar/panel"} | trips
        )


def test_the_action_is_offered_by_its_server_alone_and_called_by_the_operator(
    grants: list[Grant],
) -> None:
    assert _enclaves(grants, "execute", GO) == {"/dextar/go_server"}
    assert _enclaves(grants, "call", GO) == {"/dextar/operator"}


def test_nothing_is_allowed_that_neither_the_contract_nor_every_ros_node_has(
    grants: list[Grant],
) -> None:
    known = {
        topic.name if topic.name.startswith("/") else f"/{topic.name}"
        for topic in TOPICS
    }
    known |= READABLE | {"/markers", "/controller/transition_event"}
    for grant in grants:
        if grant.right in ("publish", "subscribe"):
            extra = (
                LOOKERS_ON
                if grant.enclave == "/dextar/viewer" and grant.right == "subscribe"
                else set()
            )
            assert grant.name in known | EVERYWHERE | extra, grant
        assert "*" not in grant.name.replace("/_ros2cli_*/", "/"), grant


def test_a_robot_in_a_namespace_has_its_own_enclaves_and_names(
    grants: list[Grant],
) -> None:
    left = _grants(build_policy("/left"))
    assert {grant.enclave for grant in left} == {
        f"/left{grant.enclave}" for grant in grants
    }
    assert _enclaves(left, "publish", "left/joint_commands") == {
        "/left/dextar/controller"
    }
    assert not _enclaves(left, "publish", "joint_commands")
    assert _enclaves(left, "publish", "diagnostics") == {
        f"/left{path}" for path in _enclaves(grants, "publish", "diagnostics")
    }


@pytest.mark.parametrize("namespace", ["left", "/left/", "/a b", ""])
def test_a_namespace_that_is_none_is_refused(namespace: str) -> None:
    with pytest.raises(
        ParameterError, match=re.escape(f"namespace '{namespace}'; it must be absolute")
    ):
        build_policy(namespace)
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "dextar_control.security.policy",
            "--namespace",
            namespace,
        ],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert "Traceback" not in done.stderr


class System(NamedTuple):
    """All nodes at once, each in its process and its enclave, seen from here."""

    node: Node
    status: dict[str, DiagnosticStatus]

    def created(self, name: str, right: str) -> set[str]:
        """What a running node has created."""
        kind = {
            "publish": "publisher",
            "subscribe": "subscriber",
            "reply": "service",
            "request": "client",
        }[right]
        try:
            found = getattr(self.node, f"get_{kind}_names_and_types_by_node")(name, "/")
        except rclpy.node.NodeNameNonExistentError:
            return set()
        return {entity for entity, _ in found}


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = Node("watcher", enable_rosout=False, start_parameter_services=False)
    system = System(node, {})

    def take(message: DiagnosticArray) -> None:
        system.status.update({status.name: status for status in message.status})

    node.create_subscription(DiagnosticArray, DIAGNOSTICS.name, take, qos(DIAGNOSTICS))
    output = tmp_path_factory.mktemp("run") / "run.mcap"
    processes = []
    try:
        for name, (module, *values) in MODULES.items():
            values += [f"output:={output}"] if name == "recorder" else []
            options = [part for value in values for part in ("-p", value)]
            processes.append(start(module, *options, "--enclave", f"/dextar/{name}"))
        deadline = time.monotonic() + PATIENCE
        while not (
            set(system.status) >= {f"/{name}" for name in MODULES}
            and node.count_publishers("joint_commands")
        ):
            rclpy.spin_once(node, timeout_sec=0.05)
            assert time.monotonic() < deadline, sorted(system.status)
        yield system
    finally:
        ends = [stop(process) for process in processes]
        node.destroy_node()
        rclpy.try_shutdown()
        for code, text in ends:
            assert code == 0, text
            assert "Traceback" not in text, text


@pytest.mark.parametrize("right", ["publish", "subscribe", "reply", "request"])
@pytest.mark.parametrize("name", MODULES)
def test_a_running_node_creates_what_it_is_permitted_and_nothing_else(
    system: System, grants: list[Grant], name: str, right: str
) -> None:
    """Of what is permitted only topics that the contract calls optional may be missing;
    a panel reads while somebody looks on.
    """
    permitted = {
        grant.name for grant in grants if grant.node == name and grant.right == right
    }
    optional = READABLE | {f"/{topic.name}" for topic in TOPICS if topic.optional}
    if name == "panel" and right == "subscribe":
        optional = permitted
    deadline = time.monotonic() + PATIENCE
    while not permitted - optional <= system.created(name, right) <= permitted:
        rclpy.spin_once(system.node, timeout_sec=0.05)
        if time.monotonic() > deadline:
            created = system.created(name, right)
            pytest.fail(
                f"not permitted: {sorted(created - permitted)}; missing:"
                f" {sorted(permitted - optional - created)}"
            )


def test_the_nodes_run_in_the_enclaves_of_the_policy(
    system: System, grants: list[Grant]
) -> None:
    found = {
        (name, path)
        for name, _, path in system.node.get_node_names_and_namespaces_with_enclaves()
    }
    mine = {(name, f"/dextar/{name}") for name in MODULES} | {
        ("operator", "/dextar/panel")
    }
    assert found == mine | {(system.node.get_name(), "/")}
    assert {(grant.node, grant.enclave) for grant in grants} >= mine


def test_commands_and_states_have_one_publisher_each(system: System) -> None:
    for topic in (JOINT_COMMANDS, EFFORT_COMMANDS, JOINT_STATES, TRAJECTORY):
        assert system.node.count_publishers(topic.name) == 1, topic.name


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("demo", lambda: NodeClient("demo")),
        ("operator", lambda: OperatorClient("", SimpleNamespace())),
        ("check_rig", lambda: RigClient("", "", "", arrays=False)),
    ],
    ids=["demo", "operator", "check_rig"],
)
def test_a_commands_own_node_creates_nothing_that_is_not_permitted(
    system: System, grants: list[Grant], name: str, make: Callable[[], Node]
) -> None:
    node = make()
    try:
        for _, right in RIGHTS:
            permitted = {
                grant.name
                for grant in grants
                if grant.node == name and grant.right == right
            }
            deadline = time.monotonic() + PATIENCE
            while right != "request" and not system.created(
                name, right
            ):  # it has a client or not, as it needs
                rclpy.spin_once(system.node, timeout_sec=0.05)
                assert time.monotonic() < deadline
            assert system.created(name, right) <= permitted
    finally:
        node.destroy_node()


def test_what_the_layouts_show_of_the_diagnostics_is_there(system: System) -> None:
    """Names and keys that no message definition knows."""
    foxglove, plotjuggler = (
        config_file(name).read_text() for name in ("foxglove.json", "plotjuggler.xml")
    )
    keys = re.findall(
        r'status\[:\]\{name==\\"([^\\]+)\\"\}\.values\[:\]\{key==\\"([^\\]+)\\"\}',
        foxglove,
    )
    levels = re.findall(r"/diagnostics/(\w+)/(/\w+)/level", plotjuggler)
    assert keys
    assert levels
    for name, key in keys:
        assert key in {item.key for item in system.status[name].values}
    for hardware, name in levels:
        assert system.status[name].hardware_id == hardware
