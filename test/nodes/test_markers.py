"""The live display: what the markers show is the robot, and the node that draws stays
off the control path.
"""

from __future__ import annotations

import contextlib
import math
import signal
import subprocess
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from marker_picture import draw, shown
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rig import Rig, ending_well, start
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.topics import (
    BASE_FRAME,
    CONTROLLER_STATE,
    CRITERION,
    CRITERION_NAMES,
    JOINT_STATES,
    MARKERS,
    PHASES,
)
from dextar_control.nodekit.node import qos
from dextar_control.nodes import messages
from dextar_control.nodes.scene import Scene, View, to_array
from dextar_control.planning.planner import Plan

ROUNDING = 1e-9  # m; all is computed in double precision from lengths of 0.1 m
# m, of the drawn path from the true one between its points, 1 ms apart at most at 0.5
# m/s
CHORD = 2e-5
LIGHT_AND_DARK = ("#ffffff", "#303030")


def _legs(robot: RobotParameters, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(active joints, elbows) by the law of cosines, in the robot's working mode."""
    angles, places = [], []
    for leg, base, mode in zip(
        robot.legs, (-0.5, 0.5), robot.working_mode, strict=True
    ):
        motor = np.array([base * robot.base_distance, 0.0])
        reach = x - motor
        distance = math.hypot(*reach)
        cosine = (leg.proximal_length**2 + distance**2 - leg.distal_length**2) / (
            2 * leg.proximal_length * distance
        )
        angle = math.atan2(reach[1], reach[0]) + mode * math.acos(cosine)
        angles.append(angle)
        places.append(
            motor + leg.proximal_length * np.array([math.cos(angle), math.sin(angle)])
        )
    return np.array(angles), np.array(places)


def _view(robot: RobotParameters, x: np.ndarray, **scalars: float) -> View:
    return View(_legs(robot, x)[0], x, x + 1e-3, scalars, False)


def _points(marker: Marker) -> np.ndarray:
    return np.array([(point.x, point.y) for point in marker.points])


def _markers(scene: Scene, view: View) -> dict[tuple[str, int], Marker]:
    """As they arrive: through the middleware's own bytes."""
    message = to_array([*scene.still(), *scene.moving(view)], Time(sec=3))
    return shown([deserialize_message(serialize_message(message), MarkerArray)])


def test_the_links_join_motors_elbows_and_end_effector(
    uneven: RobotParameters, robot: RobotParameters
) -> None:
    for bot in (robot, uneven):
        x = np.array([-0.02, 0.11])
        _, elbows = _legs(bot, x)
        markers = _markers(Scene(bot), _view(bot, x))
        motors = np.array(
            [[-0.5 * bot.base_distance, 0.0], [0.5 * bot.base_distance, 0.0]]
        )
        np.testing.assert_allclose(
            _points(markers["linkage", 0])[0::2], motors, atol=ROUNDING
        )
        np.testing.assert_allclose(
            _points(markers["linkage", 0])[1::2], elbows, atol=ROUNDING
        )
        np.testing.assert_allclose(
            _points(markers["linkage", 1])[0::2], elbows, atol=ROUNDING
        )
        np.testing.assert_allclose(
            _points(markers["linkage", 1])[1::2], [x, x], atol=ROUNDING
        )
        np.testing.assert_allclose(
            _points(markers["end_effector", 0]), [x], atol=ROUNDING
        )


def test_at_every_point_of_the_drawn_locus_the_distal_links_are_aligned(
    robot: RobotParameters,
) -> None:
    for marker in (marker for marker in Scene(robot).still() if marker.ns == "locus"):
        for x in _points(marker):
            first, second = x - _legs(robot, x)[1]
            assert abs(first[0] * second[1] - first[1] * second[0]) < 1e-6 * math.hypot(
                *first
            ) * math.hypot(*second)


def test_the_path_begins_and_ends_as_planned_and_its_crossings_are_the_certified_ones(
    robot: RobotParameters, trip: Plan
) -> None:
    scene = Scene(robot)
    scene.set_path(trip.trajectory)
    markers = shown([to_array(scene.still(), Time())])
    path = _points(markers["path", 0])
    np.testing.assert_allclose(
        path[[0, -1]], [trip.trajectory.at(0.0).x] * 2, atol=ROUNDING
    )
    places = [crossing.x for crossing in trip.certificate.crossings]
    np.testing.assert_allclose(_points(markers["crossings", 0]), places, atol=CHORD)
    scene.set_path(None)
    assert not {name for name, _ in shown([to_array(scene.still(), Time())])} & {
        "path",
        "crossings",
    }


def test_t_s_is_drawn_across_the_aligned_links_and_fades_away_from_the_locus(
    robot: RobotParameters, trip: Plan
) -> None:
    """On the stretched locus A_r t_s = 0: t_s is perpendicular to both distal links."""
    scene = Scene(robot)
    x = np.array(trip.certificate.crossings[0].x)
    arrow = _markers(scene, _view(robot, x))["t_s", 0]
    tail, head = _points(arrow)
    np.testing.assert_allclose(tail, x, atol=ROUNDING)
    for link in x - _legs(robot, x)[1]:
        assert abs(link @ (head - tail)) < 1e-6 * math.hypot(*link) * math.hypot(
            *(head - tail)
        )
    far = _markers(scene, _view(robot, trip.trajectory.at(0.0).x))["t_s", 0]
    assert arrow.color.a > 0.95 > 0.2 > far.color.a > 0.0


def test_each_phase_is_written_out_and_a_fault_stands_out(
    robot: RobotParameters,
) -> None:
    scene, x = Scene(robot), np.array([-0.02, 0.11])
    colors = {}
    for number, phase in enumerate(PHASES):
        markers = _markers(
            scene, _view(robot, x, phase=float(number), s=0.25, residual=-0.5)
        )
        assert (
            markers["text", 0].text
            == f"{phase.upper().replace('_', ' ')}  s +0.250\nresidual -0.500 N"
        )
        color = markers["end_effector", 0].color
        colors[phase] = (color.r, color.g, color.b)
    assert colors["fault"] == colors["safe_stop"]
    assert colors["fault"] not in {
        colors[phase] for phase in PHASES if phase not in ("fault", "safe_stop")
    }


def test_without_an_estimate_the_direct_model_stands_in_and_nothing_drawn_is_not_a_number(
    robot: RobotParameters,
) -> None:
    x, unknown = np.array([-0.02, 0.11]), np.full(2, np.nan)
    q_a, _ = _legs(robot, x)
    for mode in (1.0, -1.0):
        markers = _markers(
            Scene(robot),
            View(q_a, unknown, unknown, {"assembly_mode": mode, "s": math.nan}, False),
        )
        assert not {name for name, _ in markers} & {"reference", "trail", "text"}
        for marker in markers.values():
            assert np.isfinite(_points(marker)).all()
            assert marker.header.frame_id == BASE_FRAME
        drawn = _points(markers["end_effector", 0])[0]
        assert (np.hypot(*(drawn - x)) < ROUNDING) == (mode == 1.0)
    lost = _markers(Scene(robot), View(unknown, unknown, unknown, {}, True))
    assert not {name for name, _ in lost} & {"linkage", "end_effector", "t_s"}


@pytest.mark.parametrize("background", LIGHT_AND_DARK)
def test_everything_drawn_can_be_told_from_the_background(
    robot: RobotParameters, trip: Plan, background: str
) -> None:
    """Each marker alone changes the picture by more than a shade."""
    scene = Scene(robot)
    scene.set_path(trip.trajectory)
    view = _view(robot, np.array(trip.certificate.crossings[0].x), phase=4.0, s=0.0)
    everything = shown(
        [
            to_array(
                [*scene.still(), *scene.moving(view, [view.x_hat, view.x_hat - 0.02])],
                Time(),
            )
        ]
    )
    empty = int(background[1:3], 16) / 255.0
    for key, marker in everything.items():
        figure = draw({key: marker} | {("frame", 0): _corners()}, background)
        figure.set_dpi(80.0)
        figure.canvas.draw()
        pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3] / 255.0
        contrast = np.abs(pixels.astype(float).mean(axis=2) - empty)
        assert (contrast > 0.15).sum() > 20, key


def _corners() -> Marker:
    """Nothing, as wide as the robot."""
    return Marker(
        type=Marker.POINTS, points=[Point(x=-0.15, y=-0.1), Point(x=0.15, y=0.2)]
    )


class Display(Rig):
    """A rig, a controller's words and a display in this process."""

    def __init__(self) -> None:
        super().__init__()
        self.arrays: list[MarkerArray] = []
        self.criterion = self.node.create_publisher(
            JointState, CRITERION.name, qos(CRITERION)
        )
        self.state = self.node.create_publisher(
            JointTrajectory, CONTROLLER_STATE.name, qos(CONTROLLER_STATE)
        )
        self.node.create_subscription(
            MarkerArray, MARKERS.name, self.arrays.append, QoSProfile(depth=100)
        )

    def say(self, robot: RobotParameters, x: np.ndarray) -> None:
        """The topics of one tick."""
        self.send(1, _legs(robot, x)[0])
        self.criterion.publish(
            JointState(
                name=list(CRITERION_NAMES),
                position=[0.0, 0.4, 0.01, 0.0, 1.0, 3.0, 1.0] + [0.0] * 9,
            )
        )
        rows = [
            JointTrajectoryPoint(positions=[float(value) for value in row])
            for row in (x + 1e-3, x, x - x, x)
        ]
        self.state.publish(JointTrajectory(joint_names=["x", "y"], points=rows))


@pytest.fixture
def display() -> Iterator[tuple[Display, subprocess.Popen[str]]]:
    process = start("dextar_control.nodes.markers")
    with contextlib.closing(Display()) as display, ending_well(process):
        display.until(
            lambda: display.node.count_subscribers("joint_states"), "no marker node"
        )
        yield display, process


def test_the_node_draws_what_the_topics_say_until_it_is_switched_off_or_ends(
    display: tuple[Display, subprocess.Popen[str]], robot: RobotParameters, trip: Plan
) -> None:
    screen, process = display
    x = np.array([-0.02, 0.11])
    screen.trajectories.publish(
        messages.from_trajectory(
            trip.trajectory, np.linspace(0.0, trip.trajectory.duration, 500)
        )
    )

    def seen(*names: str) -> bool:
        screen.say(robot, x)
        return set(names) <= {name for name, _ in shown(screen.arrays)}

    def readers() -> int:
        return sum(
            map(
                screen.node.count_subscribers,
                (JOINT_STATES.name, CRITERION.name, CONTROLLER_STATE.name),
            )
        )

    screen.until(
        lambda: seen(
            "linkage", "locus", "path", "crossings", "t_s", "end_effector", "text"
        ),
        "not drawn",
    )
    markers = shown(screen.arrays)
    np.testing.assert_allclose(_points(markers["end_effector", 0]), [x], atol=ROUNDING)
    assert markers["text", 0].text.startswith("TRACK  s +0.400")
    stamps = [array.markers[0].header.stamp for array in screen.arrays]
    assert all((a.sec, a.nanosec) <= (b.sec, b.nanosec) for a, b in pairwise(stamps))
    assert screen.node.count_publishers("joint_commands") == 0
    assert screen.put("markers", enabled=False) == [""]
    screen.until(lambda: not shown(screen.arrays), "the display was not cleared")
    screen.until(lambda: not readers(), "it still reads")
    screen.arrays.clear()
    assert screen.put("markers", enabled=True) == [""]
    screen.until(lambda: seen("linkage", "locus", "path"), "not drawn again")
    process.send_signal(signal.SIGINT)
    screen.until(
        lambda: not shown(screen.arrays), "the display was not cleared at the end"
    )
