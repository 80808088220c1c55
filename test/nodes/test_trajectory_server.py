"""The trajectory server's services with a plant and a controller in lockstep, each in
its process, in a namespace.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from geometry_msgs.msg import PoseStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from nav_msgs.srv import GetPlan
from rig import Rig, ending_well, start
from std_srvs.srv import Trigger

from dextar_control.planning.planner import PLAN_RESIDUAL

SERVER = "/left/trajectory_server"
PLAN = f"{SERVER}/get_plan"
NAMESPACE = ("-r", "__ns:=/left")
NODES = {
    "dextar_sim.node": (
        "-p",
        "plant:mode:=lockstep",
        "-p",
        "plant:simulation.real_time_factor:=0.0",
        "-p",
        "plant:task.start:=[-0.01, 0.12]",
    ),
    "dextar_control.nodes.controller": ("-p", "controller:lockstep:=true"),
    "dextar_control.nodes.trajectory_server": (
        "-p",
        "trajectory_server:task.repeat:=2",
        "-p",
        "trajectory_server:task.dwell:=0.05",
    ),
}


@pytest.fixture(scope="module")
def drawing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("plans") / "new" / "plan.png"


@pytest.fixture(scope="module")
def robot(drawing: Path) -> Iterator[Rig]:
    """Three nodes in namespace /left, the robot away from A."""
    with contextlib.closing(Rig()) as watcher, contextlib.ExitStack() as stack:
        for module, arguments in NODES.items():
            # in a namespace a plain -p reaches the node: no parameter file has a
            # section of its own for it
            plain = [
                part.partition(":")[2] if index % 2 else part
                for index, part in enumerate(arguments)
            ]
            extra = ("-p", f"drawing:={drawing}") if "server" in module else ()
            stack.enter_context(ending_well(start(module, *NAMESPACE, *plain, *extra)))
        watcher.until_phase("HOLD")
        watcher.until(
            lambda: watcher.controller("x") not in ("", "nan"),
            "the controller had no state",
        )
        watcher.until(
            lambda: "trajectory_server" in watcher.status, "no trajectory server"
        )
        yield watcher


def test_a_path_is_planned_on_request_and_a_bad_one_is_empty(robot: Rig) -> None:
    path = robot.call(GetPlan, PLAN).plan
    assert path.poses[0].pose.position.x == pytest.approx(-0.025, abs=1e-9)
    assert path.poses[-1].pose.position.y == pytest.approx(0.06, abs=1e-9)
    start, goal = PoseStamped(), PoseStamped()
    start.pose.position.x, start.pose.position.y = 0.01, 0.06
    goal.pose.position.x, goal.pose.position.y = 0.02, 0.11
    path = robot.call(GetPlan, PLAN, start=start, goal=goal).plan
    ends = [
        (path.poses[row].pose.position.x, path.poses[row].pose.position.y)
        for row in (0, -1)
    ]
    assert ends == [
        pytest.approx((0.01, 0.06), abs=1e-9),
        pytest.approx((0.02, 0.11), abs=1e-9),
    ]
    start.pose.position.y, goal.pose.position.y = 0.115, 0.12
    start.pose.position.x = goal.pose.position.x = 0.0
    assert not robot.call(GetPlan, PLAN, start=start, goal=goal).plan.poses
    robot.until(
        lambda: "same side" in robot.status["trajectory_server"].get("error", ""),
        "the reason is not told",
    )


def test_the_trip_starts_with_an_approach_repeats_and_can_be_stopped(
    robot: Rig,
) -> None:
    answer = robot.call(Trigger, "/left/trajectory_server/plan")
    assert answer.success
    assert "crossing 4" in answer.message
    assert robot.call(Trigger, "/left/trajectory_server/start").success
    robot.until(lambda: robot.controller("completed") == "1", "the trip did not end")
    assert robot.controller("phase") == "HOLD"
    assert float(robot.controller("x")) == pytest.approx(-0.025, abs=1e-4)
    assert robot.call(Trigger, "/left/trajectory_server/start").success
    robot.until_phase("TRACK", "CROSSING")
    refused = robot.call(Trigger, "/left/trajectory_server/start")
    assert not refused.success
    assert (
        "a trip starts from HOLD: wait until it holds, or type dextar stop --namespace"
        " /left" in refused.message
    )
    assert robot.call(Trigger, "/left/trajectory_server/stop").success
    robot.until_phase("SAFE_STOP")
    robot.until(
        lambda: (
            "SAFE_STOP" in robot.call(Trigger, "/left/trajectory_server/start").message
        ),
        "not known",
    )
    refused = robot.call(Trigger, "/left/trajectory_server/start")
    assert "phase SAFE_STOP (stopped by the trajectory server" in refused.message
    assert (
        "type dextar reset --namespace /left, then dextar enable --namespace /left"
        in refused.message
    )


def test_a_tour_is_planned_beside_the_services_drawn_and_certified(
    robot: Rig, drawing: Path
) -> None:
    assert drawing.read_bytes().startswith(b"\x89PNG")
    before = drawing.stat().st_mtime_ns
    new = 0.05 + 1e-6 * os.getpid()  # s of dwelling that no cached tour has
    assert not any(robot.put(SERVER, task__tour=6, task__dwell=new, task__repeat=1))
    (refusal,) = robot.put(SERVER, task__point=[0.0, 0.0845])
    assert (
        "task.point = [0.0, 0.0845] and task.tour = 6 are given; one may be" in refusal
    )
    planned = robot.ask(Trigger, "/left/trajectory_server/plan")
    stopped = robot.ask(Trigger, "/left/trajectory_server/stop")
    robot.until(stopped.done, "no stop while it plans")
    assert not planned.done()
    robot.until(planned.done, "no plan")
    assert planned.result().success, planned.result().message
    assert "crossing 6" in planned.result().message
    robot.until(
        lambda: robot.status["trajectory_server"].get("crossings") == "6",
        "the certificate is not told",
    )
    certificate = json.loads(robot.status["trajectory_server"]["certificate"])
    assert [crossing["sign"] for crossing in certificate["crossings"]] == [-1, 1] * 3
    assert (
        max(crossing["residual"] for crossing in certificate["crossings"])
        < PLAN_RESIDUAL
    )
    assert drawing.stat().st_mtime_ns > before


def test_a_point_without_a_plan_is_told_and_served_is_nothing(robot: Rig) -> None:
    served = robot.status["trajectory_server"]["served"]
    assert not any(robot.put(SERVER, task__tour=0, task__point=[0.0, 0.05]))
    answer = robot.call(Trigger, "/left/trajectory_server/plan")
    assert not answer.success
    assert "off the Type 2 locus" in answer.message
    robot.until(
        lambda: "off the Type 2 locus" in robot.status["trajectory_server"]["error"],
        "the reason is not told",
    )
    assert robot.status["trajectory_server"]["served"] == served


def test_a_trip_needs_an_active_controller(robot: Rig) -> None:
    deactivate = Transition(label="deactivate")
    assert robot.call(
        ChangeState, "/left/controller/change_state", transition=deactivate
    ).success
    robot.until(lambda: robot.controller("lifecycle") == "inactive", "not inactive")
    refused = robot.call(Trigger, "/left/trajectory_server/start")
    assert not refused.success
    assert (
        refused.message
        == "the controller is inactive; a trip needs an active one: type ros2 lifecycle"
        " set /left/controller activate"
    )
