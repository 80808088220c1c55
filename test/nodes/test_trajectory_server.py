"""The trajectory server's services with a plant and a controller in lockstep, each in
its process, in a namespace.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from nav_msgs.srv import GetPlan
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rig import Rig, ending_well, start
from std_srvs.srv import Trigger

from dextar_control.planning.planner import PLAN_RESIDUAL

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
        watcher.until(
            lambda: watcher.controller("phase") == "HOLD",
            "the controller does not hold",
        )
        watcher.until(
            lambda: watcher.controller("x") not in ("", "nan"),
            "the controller had no state",
        )
        watcher.until(
            lambda: "trajectory_server" in watcher.status, "no trajectory server"
        )
        yield watcher


def _ask(rig: Rig, kind: type, name: str, request: object) -> Any:
    """The answer to come."""
    client = rig.node.create_client(kind, f"/left/{name}")
    rig.until(client.service_is_ready, f"no service {name}")
    return client.call_async(request)


def _call(rig: Rig, kind: type, name: str, request: object) -> Any:
    return rig.call(kind, f"/left/{name}", request)


def _set(rig: Rig, **values: object) -> list[tuple[bool, str]]:
    """Set parameters of the trajectory server's task in turn."""
    parameters = [
        Parameter(f"task.{name}", value=value).to_parameter_msg()
        for name, value in values.items()
    ]
    answer = _call(
        rig,
        SetParameters,
        "trajectory_server/set_parameters",
        SetParameters.Request(parameters=parameters),
    )
    return [(result.successful, result.reason) for result in answer.results]


def test_a_path_is_planned_on_request_and_a_bad_one_is_empty(robot: Rig) -> None:
    path = _call(robot, GetPlan, "trajectory_server/get_plan", GetPlan.Request()).plan
    assert path.poses[0].pose.position.x == pytest.approx(-0.025, abs=1e-9)
    assert path.poses[-1].pose.position.y == pytest.approx(0.06, abs=1e-9)
    asked = GetPlan.Request(start=PoseStamped(), goal=PoseStamped())
    asked.start.pose.position.x, asked.start.pose.position.y = 0.01, 0.06
    asked.goal.pose.position.x, asked.goal.pose.position.y = 0.02, 0.11
    path = _call(robot, GetPlan, "trajectory_server/get_plan", asked).plan
    ends = [
        (path.poses[row].pose.position.x, path.poses[row].pose.position.y)
        for row in (0, -1)
    ]
    assert ends == [
        pytest.approx((0.01, 0.06), abs=1e-9),
        pytest.approx((0.02, 0.11), abs=1e-9),
    ]
    same_side = GetPlan.Request(start=PoseStamped(), goal=PoseStamped())
    same_side.start.pose.position.y, same_side.goal.pose.position.y = 0.115, 0.12
    assert (
        len(_call(robot, GetPlan, "trajectory_server/get_plan", same_side).plan.poses)
        == 0
    )
    robot.until(
        lambda: "same side" in robot.status["trajectory_server"].get("error", ""),
        "the reason is not told",
    )


def test_the_trip_starts_with_an_approach_repeats_and_can_be_stopped(
    robot: Rig,
) -> None:
    answer = _call(robot, Trigger, "trajectory_server/plan", Trigger.Request())
    assert answer.success
    assert "crossing 4" in answer.message
    assert _call(robot, Trigger, "trajectory_server/start", Trigger.Request()).success
    robot.until(lambda: robot.controller("completed") == "1", "the trip did not end")
    assert robot.controller("phase") == "HOLD"
    assert float(robot.controller("x")) == pytest.approx(-0.025, abs=1e-4)
    assert _call(robot, Trigger, "trajectory_server/start", Trigger.Request()).success
    robot.until(
        lambda: robot.controller("phase") in ("TRACK", "CROSSING"),
        "the second trip did not start",
    )
    refused = _call(robot, Trigger, "trajectory_server/start", Trigger.Request())
    assert not refused.success
    assert (
        "a trip starts from HOLD: wait until it holds, or type dextar stop --namespace"
        " /left" in refused.message
    )
    assert _call(robot, Trigger, "trajectory_server/stop", Trigger.Request()).success
    robot.until(
        lambda: robot.controller("phase") == "SAFE_STOP", "the robot did not stop"
    )
    robot.until(
        lambda: (
            "SAFE_STOP"
            in _call(
                robot, Trigger, "trajectory_server/start", Trigger.Request()
            ).message
        ),
        "not known",
    )
    refused = _call(robot, Trigger, "trajectory_server/start", Trigger.Request())
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
    assert all(successful for successful, _ in _set(robot, tour=6, dwell=new, repeat=1))
    (refusal,) = _set(robot, point=[0.0, 0.0845])
    assert not refusal[0]
    assert (
        "task.point = [0.0, 0.0845] and task.tour = 6 are given; one may be"
        in refusal[1]
    )
    planned = _ask(robot, Trigger, "trajectory_server/plan", Trigger.Request())
    stopped = _ask(robot, Trigger, "trajectory_server/stop", Trigger.Request())
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
    assert all(successful for successful, _ in _set(robot, tour=0, point=[0.0, 0.05]))
    answer = _call(robot, Trigger, "trajectory_server/plan", Trigger.Request())
    assert not answer.success
    assert "off the Type 2 locus" in answer.message
    robot.until(
        lambda: "off the Type 2 locus" in robot.status["trajectory_server"]["error"],
        "the reason is not told",
    )
    assert robot.status["trajectory_server"]["served"] == served


def test_a_trip_needs_an_active_controller(robot: Rig) -> None:
    deactivate = ChangeState.Request(transition=Transition(label="deactivate"))
    assert _call(robot, ChangeState, "controller/change_state", deactivate).success
    robot.until(lambda: robot.controller("lifecycle") == "inactive", "not inactive")
    refused = _call(robot, Trigger, "trajectory_server/start", Trigger.Request())
    assert not refused.success
    assert (
        refused.message
        == "the controller is inactive; a trip needs an active one: type ros2 lifecycle"
        " set /left/controller activate"
    )
