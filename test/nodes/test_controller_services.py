"""The controller node in this process, never spun: what each watch period serves, and
what a late reset clears.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from closed_loop import s_of
from patience import PATIENCE
from rcl_interfaces.srv import DescribeParameters, GetParameters
from rclpy.serialization import serialize_message
from std_srvs.srv import SetBool, Trigger
from unserved import Unserved

from dextar_control.contract.clocks import UnsteppedClock
from dextar_control.contract.controller_parameters import CONTROLLER
from dextar_control.contract.errors import TrajectoryError
from dextar_control.contract.topics import JOINT_STATES
from dextar_control.control.phases import Phase
from dextar_control.nodekit.layouts import template
from dextar_control.nodes import messages
from dextar_control.nodes.controller import SERVED_PER_WATCH, ControllerNode
from dextar_control.planning.certificate import Certificate
from dextar_control.planning.planner import Plan
from dextar_control.planning.trajectory import Trajectory

SECOND = 1_000_000_000  # ns


class _Unspun(Unserved):
    """A controller that does something only when it is told to."""

    def __init__(self) -> None:
        values = ("lockstep:=true", "joint_states.healthy_time:=0.0")
        given = [part for value in values for part in ("-p", f"controller:{value}")]
        super().__init__(ControllerNode, *given)

    def turn(self) -> None:
        self.node._watch()


@pytest.fixture(scope="module")
def controller() -> Iterator[_Unspun]:
    unspun = _Unspun()
    yield unspun
    unspun.close()


def test_a_watch_period_serves_a_bounded_number_of_requests_however_many_there_are(
    controller: _Unspun,
) -> None:
    names = [spec.name for spec in CONTROLLER]
    asked = {
        "describe_parameters": (DescribeParameters, {"names": names}),
        "get_parameters": (GetParameters, {"names": names}),
        "enable": (SetBool, {"data": True}),
    }
    futures = [
        controller.call(kind, name, **fields)
        for name, (kind, fields) in asked.items()
        for _ in range(9)
    ]
    controller.arrive(*asked)
    served = []
    deadline = time.monotonic() + PATIENCE
    while sum(served) < len(futures):
        before = controller.node.polled_services.served
        controller.node._watch()
        served.append(controller.node.polled_services.served - before)
        assert time.monotonic() < deadline
    assert max(served) == SERVED_PER_WATCH
    controller.finish(*futures)


def test_a_reset_from_before_a_fault_does_not_clear_it(
    controller: _Unspun, trip: Plan
) -> None:
    node = controller.node
    q_a = node._loop.model.inverse_geometric_model(trip.trajectory.at(0.0).x)
    node._on_state(
        template(JOINT_STATES).pack(SECOND, [*q_a.tolist(), 0.0, 0.0, 0.0, 0.0])
    )
    late = controller.call(Trigger, "reset")
    controller.arrive("reset")
    node._loop.fault("the cause of this test")
    node._log_phase()
    refused = controller.finish(late)
    assert not refused.success
    assert (
        refused.message
        == "FAULT was latched after this call: the cause of this test; call again to"
        " clear it"
    )
    assert node._loop.phase is Phase.FAULT
    assert controller.finish(controller.call(Trigger, "reset")).success
    assert node._loop.phase is Phase.IDLE


def test_a_trajectory_counts_as_old_by_the_time_on_its_way(
    controller: _Unspun, trip: Plan
) -> None:
    reader = controller.node._reference
    raw = bytes(serialize_message(messages.stop_trajectory()))

    def check(trajectory: Trajectory) -> Certificate:
        raise AssertionError

    assert reader._read(check, raw, 1.0, 10.0, 1.0) is None
    with pytest.raises(
        TrajectoryError,
        match=r"it was served 1.5 s before it arrived; the limit is 1 s",
    ):
        reader._read(check, raw, 1.5, 10.0, 1.0)
    with pytest.raises(
        TrajectoryError, match="before this controller began; serve it again"
    ):
        reader._read(check, raw, 10.1, 10.0, 100.0)
    with pytest.raises(
        TrajectoryError,
        match=(
            r"it was served 60.0 s after it arrived; the limit is 1 s: .* serve it"
            r" again"
        ),
    ):
        reader._read(check, raw, -60.0, 10.0, 1.0)


class _Queue:
    """A subscription in which one stop waits, served and received at a time of the
    system clock, ns.
    """

    def __init__(self, served: int, received: int) -> None:
        self.handle = self
        self._waiting = [
            (
                bytes(serialize_message(messages.stop_trajectory())),
                {"source_timestamp": served, "received_timestamp": received},
            )
        ]

    def take_message(self, *_: Any) -> Any:
        return self._waiting.pop() if self._waiting else None


@pytest.mark.parametrize("step", [0, -60, 60])
@pytest.mark.parametrize(
    ("served", "note"),
    [
        (100.0, "stop"),  # s after the controller became active
        (98.5, "it was served 1.5 s before it arrived; the limit is 1 s"),
        (-0.5, "s before this controller began; serve it again"),
    ],
)
def test_a_system_clock_that_is_set_under_the_controller_makes_no_trajectory_older(
    controller: _Unspun, step: int, served: float, note: str
) -> None:
    reader, node = controller.node._reference, controller.node
    begun = 10_000 * SECOND
    system, steady = [begun], [5 * SECOND]
    reader._clock = UnsteppedClock(lambda: system[0], lambda: steady[0])
    reader.restart()
    arrived = 100.0 if served > 0.0 else 0.2
    steady[0] += round(arrived * SECOND)
    system[0] += round((arrived + step) * SECOND)  # set before it was served
    real = reader._subscription
    try:
        reader._subscription = _Queue(
            system[0] - round((arrived - served) * SECOND), system[0]
        )
        deadline = time.monotonic() + PATIENCE
        reader.note = "none"
        while reader.note in ("none", "checking"):
            reader.poll(node._loop, node.values, 0.0, 0.0, False)
            assert time.monotonic() < deadline
    finally:
        reader._subscription = real
    assert note in reader.note


def test_what_waits_when_the_controller_becomes_active_was_served_before(
    controller: _Unspun,
) -> None:
    reader = controller.node._reference
    real = reader._subscription
    try:
        now = time.time_ns()
        reader._subscription = _Queue(
            now + 60 * SECOND, now + 60 * SECOND
        )  # whatever the clocks say
        reader.restart()
    finally:
        reader._subscription = real
    assert (
        reader.note
        == "refused: it was served before this controller began; serve it again"
    )


def test_the_distance_to_the_locus_is_that_of_the_nearest_point_to_first_order(
    controller: _Unspun, trip: Plan
) -> None:
    """Against a search along the gradient's direction: close to the locus the first
    order is the distance.
    """
    from dextar_control.contract.settings import default_settings
    from dextar_control.control.loop import ControlLoop
    from dextar_control.nodes.controller_report import distance_to_locus

    model = controller.node._loop.model
    time_near = float(trip.certificate.crossing_times[0]) - 0.01
    x = trip.trajectory.at(time_near).x
    loop = ControlLoop(
        controller.node.robot,
        default_settings(),
        int(np.sign(s_of(model, x))),
        enabled=False,
    )
    loop.step(0.0, model.inverse_geometric_model(x))
    angles = np.linspace(-np.pi, np.pi, 721)
    reach = np.linspace(0.0, 0.02, 401)[1:]
    inside = np.sign(s_of(model, x))

    def reached(angle: float) -> float:
        rays = ((r, x + r * np.array([np.cos(angle), np.sin(angle)])) for r in reach)
        return next(
            (r for r, point in rays if inside * s_of(model, point) <= 0.0), np.inf
        )

    found = [reached(angle) for angle in angles]
    assert distance_to_locus(loop) == pytest.approx(min(found), rel=0.1)


def test_the_largest_error_is_that_of_the_trajectory_that_is_tracked(
    controller: _Unspun,
) -> None:
    node = controller.node

    def noted(phase: Phase, certificate: object, errors: list[float]) -> float:
        for error in errors:
            node._note_error(
                SimpleNamespace(
                    phase=phase,
                    certificate=certificate,
                    supervisor=SimpleNamespace(error=error),
                )
            )
        return node._largest_error

    first, second = object(), object()
    assert noted(Phase.TRACK, first, [1e-5, 3e-5, 2e-5]) == 3e-5
    assert noted(Phase.HOLD, first, [1e-3]) == 3e-5
    assert noted(Phase.CROSSING, second, [1e-5]) == 1e-5


@pytest.mark.parametrize(
    ("way", "told"), [(0.3e-3, False), (4e-3, True)], ids=["in time", "late"]
)
def test_a_motion_that_trips_says_whether_commands_came_too_late(
    controller: _Unspun, way: float, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    node, begin, now = controller.node, time.perf_counter(), time.time_ns()
    monkeypatch.setattr(
        time, "time_ns", lambda: now
    )  # a busy machine makes no state older
    node._loop.fault("before")
    node._log_phase()
    node._statistics.restart()
    for k in range(
        200
    ):  # every second state on its way for so long; they arrive a period apart
        node._statistics.arrived(now - round(1e9 * way * (k % 2)), begin + 1e-3 * k)
    node._loop.phase, node._loop.reason, node._loop.tripped = (
        Phase.SAFE_STOP,
        "torque 0.300 N m for 20 ms",
        "saturation",
    )
    node._lockstep = False
    try:
        node._log_phase()
    finally:
        node._lockstep = True
    late = (
        "commands came too late: 100 of the last 200 answers (50%) were late by more"
        " than a period of 1 ms, by 4.0 ms at most; "
    )
    assert node._loop.reason.startswith(
        f"{late if told else ''}torque 0.300 N m for 20 ms"
    )
    assert node._latched[0] == node._loop.reason
    node._loop.phase, node._loop.reason, node._loop.tripped = Phase.IDLE, "", ""
    node._log_phase()
