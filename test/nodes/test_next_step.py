"""A refusal of the trajectory server ends with what to call, with the names of its own
namespace.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from patience import PATIENCE
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from dextar_control.contract.errors import TrajectoryError
from dextar_control.contract.robot import RobotParameters
from dextar_control.nodes.next_step import next_step
from dextar_control.nodes.trajectory_server import TrajectoryServer
from dextar_control.planning.planner import Plan
from dextar_control.planning.search import Progress

ENABLE = "dextar enable --namespace /left"


@pytest.mark.parametrize(
    ("lifecycle", "phase", "enabling", "step"),
    [
        ("active", "HOLD", "done", ""),
        ("active", "IDLE", "off", f"type {ENABLE}"),
        ("active", "IDLE", "waiting", "wait until it enables by itself"),
        (
            "active",
            "FAULT",
            "done",
            f"type dextar reset --namespace /left, then {ENABLE}",
        ),
        (
            "active",
            "SAFE_STOP",
            "done",
            f"once the robot rests type dextar reset --namespace /left, then {ENABLE}",
        ),
        (
            "active",
            "CROSSING",
            "done",
            "wait until it holds, or type dextar stop --namespace /left",
        ),
        ("inactive", "", "", "type ros2 lifecycle set /left/controller activate"),
        (
            "unconfigured",
            "",
            "",
            (
                "type ros2 lifecycle set /left/controller configure, then ros2"
                " lifecycle set /left/controller activate"
            ),
        ),
        ("activating", "", "", "wait, then ask again"),
        ("finalized", "", "", "start another controller"),
    ],
)
def test_every_state_has_its_way_to_a_held_robot(
    lifecycle: str, phase: str, enabling: str, step: str
) -> None:
    assert next_step("/left/controller", lifecycle, phase, enabling) == step


@pytest.fixture(scope="module")
def server() -> Iterator[TrajectoryServer]:
    arguments = ["--ros-args", "-r", "__ns:=/left", "-p", "autostart:=true"]
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    node = TrajectoryServer()
    yield node
    node.close()
    node.destroy_node()
    rclpy.try_shutdown()


def refusal(server: TrajectoryServer, **values: str) -> str:
    """What a start is refused with, once the controller has told this."""
    told = [KeyValue(key=key, value=value) for key, value in values.items()]
    server._on_diagnostics(
        DiagnosticArray(status=[DiagnosticStatus(name="/left/controller", values=told)])
    )
    with pytest.raises(TrajectoryError) as refused:
        server._check_robot()
    return str(refused.value)


def test_a_start_is_refused_with_phase_reason_and_what_to_call(
    server: TrajectoryServer,
) -> None:
    with pytest.raises(
        TrajectoryError,
        match="no word of /left/controller on /diagnostics for 2.0 s; see that it runs",
    ):
        server._check_robot()
    fault = refusal(
        server, lifecycle="active", phase="FAULT", reason="no state for 21 ms"
    )
    assert (
        fault
        == "the controller is in phase FAULT (no state for 21 ms); a trip starts from"
        f" HOLD: type dextar reset --namespace /left, then {ENABLE}"
    )
    two = (
        "2 publishers on /left/joint_commands; the limit is 1: end all but one (2 x"
        " /left/controller)"
    )
    assert f"phase IDLE ({two}); " in refusal(
        server, lifecycle="active", phase="IDLE", enabling="off", other_commanders=two
    )
    again = refusal(
        server, lifecycle="active", phase="FAULT", reason=two, other_commanders=two
    )
    assert again.count(two) == 1
    assert refusal(server, lifecycle="active", phase="IDLE", enabling="off").endswith(
        f"a trip starts from HOLD: type {ENABLE}"
    )
    assert refusal(server, lifecycle="inactive").endswith(
        ": type ros2 lifecycle set /left/controller activate"
    )
    assert refusal(server, lifecycle="active", phase="HOLD", x="nan", y="nan").endswith(
        "see that the rig or plant runs"
    )


def test_a_stop_while_a_trip_is_planned_gives_it_up_and_a_second_one_is_refused_meanwhile(
    server: TrajectoryServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    published: list[int] = []
    monkeypatch.setattr(
        server._trajectory_publisher,
        "publish",
        lambda message: published.append(len(message.points)),
    )
    monkeypatch.setattr(server, "_waiting", server._waiting)
    refused = []
    for stopped in (False, True):
        answers: list[tuple[object, object]] = []
        server._submit_trip(
            lambda served, error, answers=answers: answers.append((served, error))
        )
        if stopped:
            service = SimpleNamespace(
                send_response=lambda response, _: refused.append(response.message)
            )
            server._on_start(service, Trigger.Request(), None)
            assert server._on_stop(Trigger.Request(), Trigger.Response()).success
        deadline = time.monotonic() + PATIENCE
        while not answers:
            server._jobs.poll()
            assert time.monotonic() < deadline
        ((served, error),) = answers
        assert (
            served is None,
            str(error).startswith("the trip is not served: a stop was asked for"),
        ) == (stopped, stopped)
    assert published == [0]
    assert refused == [
        "another trip is being planned and starts then: wait, or type dextar stop"
        " --namespace /left"
    ]


def test_what_follows_the_plan_is_not_told_as_planning(
    server: TrajectoryServer, trip: Plan
) -> None:
    """A drawing takes longer than the pause between two lines about the progress."""

    def plan(_: RobotParameters, progress: Progress) -> Plan:
        progress(0.0, "one of many steps")
        return trip

    server._plan_of(SimpleNamespace(plan=plan))()
    assert server._jobs.stage == ""


def test_a_server_that_waits_to_serve_says_for_what(
    server: TrajectoryServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str] = []
    monkeypatch.setattr(
        server,
        "publish_diagnostics",
        lambda level, message, values: seen.append(values["waiting_for"]),
    )
    refusal(server, lifecycle="active", phase="IDLE", enabling="off")
    server._diagnose()
    assert seen == [
        f"the controller is in phase IDLE; a trip starts from HOLD: type {ENABLE}"
    ]
