"""Two robots in one domain, each in its namespace and one with other topic names, cross at once in lockstep."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rig import Rig, start, stop
from std_srvs.srv import SetBool

from dextar_control.contract.node import qos
from dextar_control.contract.resources import node_defaults
from dextar_control.contract.topics import SIM_END_EFFECTOR

ROBOTS = ("/left", "/right")
RENAMED = ("-r", "joint_states:=drive/measured", "-r", "joint_commands:=drive/torque", "-r", "trajectory:=wanted")
NAMES = {"/left": ("joint_states", "joint_commands", "trajectory"), "/right": ("drive/measured", "drive/torque", "wanted")}
DURATIONS = {"/left": 0.33, "/right": 0.45}  # s, of one way
NODES = {
    "dextar_sim.node": ("mode:=lockstep", "start_paused:=true"),
    "dextar_control.ros.controller_node": ("lockstep:=true",),
    "dextar_control.ros.trajectory_server": ("autostart:=true",),
}
HIT = 1e-3  # m from the goal within which the true path must come: the law's error is a tenth of it


@pytest.fixture(scope="module")
def pair() -> Iterator[tuple[Rig, dict[str, list[tuple[float, float]]]]]:
    """Both robots after their trips, and the path that each end effector really took."""
    rig = Rig()
    paths: dict[str, list[tuple[float, float]]] = {name: [] for name in ROBOTS}
    processes: list[subprocess.Popen[str]] = []
    try:
        for robot in ROBOTS:
            rig.node.create_subscription(
                Odometry, f"{robot}/{SIM_END_EFFECTOR.name}",
                lambda m, path=paths[robot]: path.append((m.pose.pose.position.x, m.pose.pose.position.y)), qos(SIM_END_EFFECTOR),
            )  # fmt: skip
            for module, values in NODES.items():
                more = (f"duration:={DURATIONS[robot]}",) if "server" in module else ()
                parameters = [part for value in (*values, *more) for part in ("-p", value)]
                processes.append(start(module, "-r", f"__ns:={robot}", *(RENAMED if robot == "/right" else ()), *parameters))
        for robot in ROBOTS:
            rig.until(lambda robot=robot: _told(rig, robot, "trajectory") == "accepted", f"{robot} took no trajectory")
        for robot in ROBOTS:
            assert rig.call(SetBool, f"{robot}/plant/pause", SetBool.Request(data=False)).success
        for robot in ROBOTS:
            rig.until(lambda robot=robot: _told(rig, robot, "completed") == "1", f"{robot} did not end its trip")
        for robot in ROBOTS:
            assert rig.call(SetBool, f"{robot}/plant/pause", SetBool.Request(data=True)).success
        rig.status.clear()
        for robot in ROBOTS:
            rig.until(lambda robot=robot: f"{robot}/plant" in rig.status and f"{robot}/controller" in rig.status, "silent")
        yield rig, paths
    finally:
        ends = [stop(process) for process in processes]
        rig.close()
    for code, output in ends:
        assert code == 0, output
        assert "Traceback" not in output, output


def _told(rig: Rig, robot: str, key: str) -> str:
    return rig.status.get(f"{robot}/controller", {}).get(key, "")


@pytest.mark.parametrize("robot", ROBOTS)
def test_both_cross_to_the_goal_and_back(pair: tuple[Rig, dict[str, list[tuple[float, float]]]], robot: str) -> None:
    rig, paths = pair
    assert (_told(rig, robot, "verdicts"), _told(rig, robot, "phase")) == ("crossed crossed", "HOLD")
    assert float(_told(rig, robot, "duration")) == pytest.approx(2 * DURATIONS[robot] + 0.6, abs=1e-6)
    path, task = np.array(paths[robot]), node_defaults("trajectory_server")
    assert np.hypot(*(path - task["task.goal"]).T).min() < HIT
    assert np.hypot(*(path[-1] - task["task.start"])) < HIT


@pytest.mark.parametrize("robot", ROBOTS)
def test_neither_hears_the_other(pair: tuple[Rig, dict[str, list[tuple[float, float]]]], robot: str) -> None:
    rig, _ = pair
    for name in NAMES[robot]:
        topic = f"{robot}/{name}"
        ends = [*rig.node.get_publishers_info_by_topic(topic), *rig.node.get_subscriptions_info_by_topic(topic)]
        assert {end.node_namespace for end in ends} == {robot}
        assert len(ends) == 2
    plant, controller = rig.status[f"{robot}/plant"], rig.status[f"{robot}/controller"]
    assert (plant["commands_refused"], plant["command_publishers"]) == ("0", "1")
    assert controller["states"] == plant["commands_received"]
    assert (controller["missed_states"], controller["refused_states"]) == ("0", "0")
