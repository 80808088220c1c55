"""Markers draw the robot and what it is about to do: linkage, locus, path and t_s, in
frame base.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.topics import BASE_FRAME, PHASES
from dextar_control.planning.locus import Family, trace_locus
from dextar_control.planning.model import planning_model
from dextar_control.planning.trajectory import Trajectory
from dextar_control.symbols.types import Array

Color = tuple[float, float, float]
# Legible on a dark and on a white background, and in grey by their lightness.
PROXIMAL: Color = (0.35, 0.40, 0.47)
DISTAL: Color = (0.55, 0.61, 0.70)
JOINT: Color = (0.75, 0.78, 0.82)
STRETCHED: Color = (0.90, 0.45, 0.10)
FOLDED: Color = (0.62, 0.40, 0.78)
PATH: Color = (0.15, 0.50, 0.85)
REFERENCE: Color = (0.10, 0.62, 0.45)
KERNEL: Color = (0.85, 0.15, 0.20)
STALE: Color = (0.50, 0.50, 0.50)
PHASE_COLORS: dict[str, Color] = {
    "idle": STALE,
    "approach": PATH,
    "hold": JOINT,
    "track": PATH,
    "crossing": STRETCHED,
    "safe_stop": KERNEL,
    "fault": KERNEL,
}

LINK, LINE, FINE = 6e-3, 1.5e-3, 1.0e-3  # m
DOT, JOINT_SIZE, EFFECTOR = 5e-3, 9e-3, 8e-3  # m
KERNEL_LENGTH = 0.03  # m
KERNEL_SHAFT, KERNEL_HEAD = 2.5e-3, 6e-3  # m
FAINTEST = 0.15  # opacity of t_s far from the locus
TEXT_HEIGHT = 1e-2  # m, of each of its two lines
TEXT_AT = (0.0, -0.045)  # m, below the motors and the folded locus
TEXT = (("phase", "s"), ("sigma_min", "residual"))
SCALARS = {
    "s": "s {:+.3f}",
    "sigma_min": "sigma_min {:.3f}",
    "residual": "residual {:+.3f} N",
}
LAYER = 1e-3  # m between what lies over each other, towards the viewer
PATH_POINTS = 1500
# s, after which a display forgets them when this node is gone.
STILL_LIFETIME, MOVING_LIFETIME = 4.0, 1.0


class View(NamedTuple):
    """What is known of the robot at one instant; nan and empty where nothing is."""

    q_a: Array  # (2,) rad, measured
    x_hat: Array  # (2,) m, estimated
    x_ref: Array  # (2,) m
    scalars: dict[str, float]  # of the criterion topic
    stale: bool  # no state has come for a while


class Scene:
    """Markers of one robot.

    Args:
        robot: its geometry and working mode.

    Attributes:
        motors: (2, 2) axes, m.
        workspace: corners (2,) of a box that holds every place it reaches, m.
        arcs: of the locus in that working mode.
        path: (m, 2) of the trajectory that is served, m; empty without one.
        crossings: (k, 2) of it with the locus, m.
    """

    def __init__(self, robot: RobotParameters) -> None:
        self._model = planning_model(robot)
        self.arcs = trace_locus(robot, (robot.working_mode,), robot.min_type1_distance)
        self.motors = self.linkage(np.zeros(2), np.zeros(2))[[0, 4]]
        self.workspace = self._model.workspace
        self.path = np.empty((0, 2))
        self.crossings = np.empty((0, 2))

    def set_path(self, trajectory: Trajectory | None) -> None:
        """Take over the trajectory that is served; None for none."""
        self.path, self.crossings = np.empty((0, 2)), np.empty((0, 2))
        if trajectory is None:
            return
        self.path = trajectory.table(
            np.linspace(0.0, trajectory.duration, PATH_POINTS)
        )[0]
        s = self._model.sides(self.path).s[:, 0]
        before = np.flatnonzero(s[:-1] * s[1:] < 0.0)
        share = (s[before] / (s[before] - s[before + 1]))[:, None]
        self.crossings = (1.0 - share) * self.path[before] + share * self.path[
            before + 1
        ]

    def platform(self, view: View) -> Array:
        """Return where to draw the end effector, (2,), m: the estimate, else the direct
        model in the believed assembly mode.
        """
        if np.isfinite(view.x_hat).all():
            return view.x_hat
        return self._model.direct_geometric_model(
            view.q_a, view.scalars.get("assembly_mode", 1.0), np.zeros(2)
        )

    def linkage(self, q_a: Array, x: Array) -> Array:
        """Return motor, elbow, end effector, elbow and motor, (5, 2), m.

        Args:
            q_a: active joints, (2,), rad.
            x: end effector, (2,), m.
        """
        linkage: Array = self._model.mechanism.linkage(q_a, x, self._model.numbers)
        return linkage

    def still(self) -> list[Marker]:
        """Return the markers of base, locus, path and its crossings."""
        lines, spheres, strip = Marker.LINE_LIST, Marker.SPHERE_LIST, Marker.LINE_STRIP
        markers = [
            _marker("base", 0, lines, self.motors, STALE, LINE),
            _marker("base", 1, spheres, self.motors, JOINT, 1.4 * JOINT_SIZE),
            _marker("path", 0, strip, self.path, PATH, FINE, 1),
            _marker("crossings", 0, spheres, self.crossings, KERNEL, DOT, 1),
        ]
        for number, arc in enumerate(self.arcs):
            color = STRETCHED if arc.family is Family.STRETCHED else FOLDED
            markers.append(_marker("locus", number, strip, arc.x[::4], color, LINE))
        return [_living(marker, STILL_LIFETIME) for marker in markers]

    def moving(
        self, view: View, trail: Sequence[Array] = (), *, text: bool = True
    ) -> list[Marker]:
        """Return the markers of links, joints, end effector, reference, t_s, trail and
        two lines of text.

        Args:
            view: the instant.
            trail: end effector positions before it, (2,) each, the oldest first, m.
            text: whether to write phase and scalars.
        """
        x = self.platform(view)
        points, opacity = self.linkage(view.q_a, x), 0.4 if view.stale else 1.0
        proximal, distal = points[[0, 1, 4, 3]], points[[1, 2, 3, 2]]
        elbows = points[[1, 3]]
        phase = self.phase(view)
        color = STALE if view.stale else PHASE_COLORS.get(phase, STALE)
        past = np.array(trail).reshape(-1, 2)
        lines, spheres, strip = Marker.LINE_LIST, Marker.SPHERE_LIST, Marker.LINE_STRIP
        rows = (
            ("linkage", 0, lines, proximal, PROXIMAL, LINK, 3, opacity),
            ("linkage", 1, lines, distal, DISTAL, 0.7 * LINK, 4, opacity),
            ("linkage", 2, spheres, elbows, JOINT, JOINT_SIZE, 5, opacity),
            ("end_effector", 0, spheres, x[None], color, EFFECTOR, 6, opacity),
            ("reference", 0, spheres, view.x_ref[None], REFERENCE, DOT, 2, 1.0),
            ("trail", 0, strip, past, JOINT, FINE, 2, 1.0),
        )
        markers = [
            *(_marker(*row) for row in rows),
            self._kernel(view, x),
        ]
        if text:
            markers.append(self._text(view, phase))
        return [_living(marker, MOVING_LIFETIME) for marker in markers]

    def phase(self, view: View) -> str:
        """Return the phase's name; empty where it is not known."""
        number = view.scalars.get("phase", np.nan)
        names = list(PHASES)
        return names[int(number)] if 0 <= number < len(names) else ""

    def kernel(self, view: View, x: Array) -> tuple[Array, float]:
        """Return t_s, (2,), the direction that the torques cannot hold on the locus,
        and s.

        Args:
            view: the instant.
            x: end effector, (2,), m.
        """
        state = self._model.state(view.q_a, x, np.zeros(2))
        return state.t_s, float(state.s[0])

    def _kernel(self, view: View, x: Array) -> Marker:
        """Return t_s as an arrow that fades with the distance to the locus."""
        t_s, s = self.kernel(view, x)
        opacity = max(FAINTEST, 1.0 - 2.0 * abs(s)) if np.isfinite(s) else 0.0
        ends = np.stack([x, x + KERNEL_LENGTH * t_s])
        marker = _marker("t_s", 0, Marker.ARROW, ends, KERNEL, KERNEL_SHAFT, 7, opacity)
        marker.scale = Vector3(x=KERNEL_SHAFT, y=KERNEL_HEAD, z=KERNEL_HEAD)
        return marker

    def _text(self, view: View, phase: str) -> Marker:
        at = np.array([TEXT_AT])
        kind, color = Marker.TEXT_VIEW_FACING, STALE if view.stale else DISTAL
        marker = _marker("text", 0, kind, at, color, TEXT_HEIGHT, 8)
        marker.scale = Vector3(z=TEXT_HEIGHT)
        marker.points, marker.pose.position = [], marker.points[0]
        told = {
            name: form.format(value)
            for name, form in SCALARS.items()
            if np.isfinite(value := view.scalars.get(name, np.nan))
        }
        told |= {"phase": phase.upper().replace("_", " ")} if phase else {}
        lines = (
            "  ".join(told[name] for name in line if name in told) for line in TEXT
        )
        marker.text = (
            "no joint states" if view.stale else "\n".join(filter(None, lines))
        )
        if not marker.text:
            marker.action = Marker.DELETE
        return marker


def to_array(markers: Iterable[Marker], stamp: object) -> MarkerArray:
    """Return one message of markers, each with this stamp
    (builtin_interfaces/msg/Time).
    """
    array = MarkerArray(markers=list(markers))
    for marker in array.markers:
        marker.header.stamp = stamp
    return array


def wipe() -> list[Marker]:
    """Return the marker that makes a display forget everything."""
    marker = Marker(action=Marker.DELETEALL)
    marker.header.frame_id = BASE_FRAME
    return [marker]


def _marker(
    name: str,
    number: int,
    kind: int,
    points: Array,
    color: Color,
    size: float,
    layer: int = 0,
    opacity: float = 1.0,
) -> Marker:
    """Return a marker through points, (n, 2), m; one with a point that is not finite,
    or with too few, is deleted.
    """
    marker = Marker(ns=name, id=number, type=kind, action=Marker.ADD)
    marker.header.frame_id = BASE_FRAME
    marker.pose.orientation.w = 1.0
    least = 1 if kind in (Marker.SPHERE_LIST, Marker.TEXT_VIEW_FACING) else 2
    if len(points) < least or not np.isfinite(points).all():
        marker.action = Marker.DELETE
    else:
        marker.points = [
            Point(x=float(x), y=float(y), z=LAYER * layer) for x, y in points
        ]
    flat = kind in (Marker.LINE_LIST, Marker.LINE_STRIP)
    marker.scale = Vector3(x=size) if flat else Vector3(x=size, y=size, z=size)
    marker.color = ColorRGBA(r=color[0], g=color[1], b=color[2], a=opacity)
    return marker


def _living(marker: Marker, seconds: float) -> Marker:
    marker.lifetime = Duration(sec=int(seconds), nanosec=int(seconds % 1.0 * 1e9))
    return marker
