"""Two robots in one domain, each in its namespace: a DexTAR and, with remapped topics,
the mock-up. In lockstep.
"""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Iterator

import pytest
from rclpy.node import Node
from rig import Rig, start, stop

from dextar_control.contract.resources import config_file
from dextar_control.contract.topics import CLOCK, SERVICES, TOPICS
from dextar_control.control.prepare import prepare
from dextar_control.mechanisms import mechanism_named

DURATION = {"left": 0.33, "right": 0.4}  # s of one way
MODULES = {
    "plant": (
        "dextar_sim.node",
        ("mode:=lockstep", "simulation.real_time_factor:=0.0"),
    ),
    "controller": ("dextar_control.nodes.controller", ("lockstep:=true",)),
    "trajectory_server": (
        "dextar_control.nodes.trajectory_server",
        ("autostart:=true",),
    ),
}
REMAPPED = (
    "-r",
    "joint_states:=encoders",
    "-r",
    "joint_commands:=drives",
    "-r",
    "trajectory:=wanted",
)


class Seen:
    """What two running robots look like from outside.

    Attributes:
        status: what every node said last, once both trips were over.
        topics: name to (type, reliable, latched) of each publisher of the left robot.
        services: name to type of each service of the left robot's nodes, those of
            parameters apart.
    """

    def __init__(self, node: Node, status: dict[str, dict[str, str]]) -> None:
        self.status = status
        self.topics: dict[str, set[tuple[str, bool, bool]]] = {}
        for topic in TOPICS:
            name = topic.name if topic.name.startswith("/") else f"/left/{topic.name}"
            ends = node.get_publishers_info_by_topic(name)
            profiles = [(end.topic_type, end.qos_profile) for end in ends]
            self.topics[topic.name] = {
                (
                    kind,
                    profile.reliability.name == "RELIABLE",
                    profile.durability.name == "TRANSIENT_LOCAL",
                )
                for kind, profile in profiles
            }
        self.services: dict[str, str] = {}
        for module in MODULES:
            for name, types in node.get_service_names_and_types_by_node(
                module, "/left"
            ):
                if not types[0].startswith(
                    ("rcl_interfaces/", "type_description_interfaces/")
                ):
                    self.services[name.removeprefix("/left/")] = types[0]


@pytest.fixture(scope="module")
def seen() -> Iterator[Seen]:
    """Both trips are over, everybody still runs."""
    prepare(mechanism_named("five_bar"))
    extra = {
        "left": (),
        "right": ("--params-file", str(config_file("mockup.yaml")), *REMAPPED),
    }

    def over() -> bool:
        assert all(process.poll() is None for process in processes), "a node ended"
        told = [rig.status.get(f"/{robot}/controller", {}) for robot in DURATION]
        return all(values.get("completed", "0") != "0" for values in told)

    with contextlib.closing(Rig()) as rig, contextlib.ExitStack() as ending:
        processes: list[subprocess.Popen[str]] = []
        for robot, duration in DURATION.items():
            for module, values in MODULES.values():
                own = [part for value in values for part in ("-p", value)]
                if module.endswith("server"):
                    own += ["-p", f"task.duration:={duration}"]
                process = start(module, "-r", f"__ns:=/{robot}", *extra[robot], *own)
                ending.callback(stop, process)
                processes.append(process)
        rig.until(over, "a trip is not over")
        completed = time.monotonic()  # the plants report once a second
        rig.until(lambda: time.monotonic() > completed + 2.5, "time stands still")
        yield Seen(rig.node, rig.status)


@pytest.mark.parametrize("robot", DURATION)
def test_each_robot_crosses_on_its_own_trajectory(seen: Seen, robot: str) -> None:
    controller = seen.status[f"/{robot}/controller"]
    assert controller["phase"] == "HOLD", controller
    assert (controller["crossings"], controller["crossed"]) == ("2", "2")
    dwells = float(controller["duration"]) - 2 * DURATION[robot]
    assert dwells == pytest.approx(0.6, abs=0.01)  # three of 0.2 s
    assert controller["saturated_ticks"] == "0"


@pytest.mark.parametrize("robot", DURATION)
def test_each_plant_hears_one_commander_and_refuses_nothing(
    seen: Seen, robot: str
) -> None:
    plant = seen.status[f"/{robot}/plant"]
    assert plant["command_publishers"] == "1"
    assert plant["commands_refused"] == "0"
    assert int(plant["commands_received"]) > 1000


def test_the_nodes_offer_what_the_contract_says(seen: Seen) -> None:
    """Depths are not told by discovery; what is optional is not there."""
    assert seen.topics == {
        topic.name: (
            set()
            if topic.optional and topic is not CLOCK
            else {(topic.type, topic.reliable, topic.latched)}
        )
        for topic in TOPICS
    }


def test_the_nodes_offer_the_contracts_services_and_no_others(seen: Seen) -> None:
    managed = "controller/change_state" in seen.services
    wanted = {item.name: item.type for item in SERVICES if item.node in MODULES}
    if not managed:
        wanted = {
            name: kind
            for name, kind in wanted.items()
            if not kind.startswith("lifecycle_msgs/")
        }
    assert seen.services == wanted
