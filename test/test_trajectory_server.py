"""The trajectory server's services with a plant and a controller in lockstep, each in its process, in a namespace."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator

import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.srv import GetPlan
from rig import Rig, start, stop
from std_srvs.srv import Trigger

NAMESPACE = ("-r", "__ns:=/left")
NODES = {
    "dextar_sim.node": ("-p", "plant:mode:=lockstep", "-p", "plant:task.start:=[-0.01, 0.12]"),
    "dextar_control.ros.controller_node": ("-p", "controller:lockstep:=true"),
    "dextar_control.ros.trajectory_server": ("-p", "trajectory_server:repeat:=2", "-p", "trajectory_server:dwell:=0.05"),
}


@pytest.fixture(scope="module")
def robot() -> Iterator[Rig]:
    """Three nodes in namespace /left, the robot away from A."""
    watcher = Rig()
    processes: list[subprocess.Popen[str]] = []
    try:
        for module, arguments in NODES.items():
            # in a namespace a plain -p reaches the node: no parameter file has a section of its own for it
            plain = [part.partition(":")[2] if index % 2 else part for index, part in enumerate(arguments)]
            processes.append(start(module, *NAMESPACE, *plain))
        watcher.until(lambda: watcher.controller("phase") == "HOLD", "the controller does not hold")
        watcher.until(lambda: watcher.controller("x") not in ("", "nan"), "the controller had no state")
        watcher.until(lambda: "trajectory_server" in watcher.status, "no trajectory server")
        yield watcher
    finally:
        ends = [stop(process) for process in reversed(processes)]
        watcher.close()
    for code, output in ends:
        assert code == 0, output
        assert "Traceback" not in output, output


def _call(rig: Rig, kind: type, name: str, request: object) -> object:
    client = rig.node.create_client(kind, f"/left/{name}")
    rig.until(client.service_is_ready, f"no service {name}")
    future = client.call_async(request)
    rig.until(future.done, f"no answer of {name}")
    return future.result()


def test_a_path_is_planned_on_request_and_a_bad_one_is_empty(robot: Rig) -> None:
    path = _call(robot, GetPlan, "trajectory_server/get_plan", GetPlan.Request()).plan
    assert path.poses[0].pose.position.x == pytest.approx(-0.025, abs=1e-9)
    assert path.poses[-1].pose.position.y == pytest.approx(0.06, abs=1e-9)
    same_side = GetPlan.Request(start=PoseStamped(), goal=PoseStamped())
    same_side.start.pose.position.y, same_side.goal.pose.position.y = 0.115, 0.12
    assert len(_call(robot, GetPlan, "trajectory_server/get_plan", same_side).plan.poses) == 0
    robot.until(lambda: "same side" in robot.status["trajectory_server"].get("error", ""), "the reason is not told")


def test_the_trip_starts_with_an_approach_repeats_and_can_be_stopped(robot: Rig) -> None:
    answer = _call(robot, Trigger, "trajectory_server/plan", Trigger.Request())
    assert answer.success
    assert "crossing 4" in answer.message
    assert _call(robot, Trigger, "trajectory_server/start", Trigger.Request()).success
    robot.until(lambda: robot.controller("completed") == "1", "the trip did not end")
    assert robot.controller("phase") == "HOLD"
    assert float(robot.controller("x")) == pytest.approx(-0.025, abs=1e-4)
    assert _call(robot, Trigger, "trajectory_server/start", Trigger.Request()).success
    robot.until(lambda: robot.controller("phase") in ("TRACK", "CROSSING"), "the second trip did not start")
    refused = _call(robot, Trigger, "trajectory_server/start", Trigger.Request())
    assert not refused.success
    assert "a trip starts from HOLD" in refused.message
    assert _call(robot, Trigger, "trajectory_server/stop", Trigger.Request()).success
    robot.until(lambda: robot.controller("phase") == "SAFE_STOP", "the robot did not stop")
