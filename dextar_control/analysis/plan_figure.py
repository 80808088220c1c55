"""A plan before it runs: its path across the locus, and what it asks of the motors over time."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dextar_control.contract.robot import RobotParameters
from dextar_control.planning.certificate import Certificate, Plan
from dextar_control.planning.locus import Family, trace_locus
from dextar_control.planning.model import states_model

BLACK, GREY, LIGHT = "#000000", "#6b6b6b", "#b8b8b8"
LOCUS_STYLES = {Family.STRETCHED: ("dashed", "locus, stretched"), Family.FOLDED: ("dotted", "locus, folded")}
ARROW = 9e-3  # m, of a crossing's direction and of t_s
LABEL_GAP = 7e-3  # m, of a crossing's numbers from its point
SAME_PLACE = 1e-4  # m, crossings closer than this share a label
MARGIN = 0.03  # m around the path
MOST_LABELS = 12  # numbers of crossings in one label, the rest counted
HEADROOM = 1.2  # of the torque axis over the peak


def draw_plan(robot: RobotParameters, plan: Plan) -> Figure:
    """The figure of a plan: path to scale on the locus of its working mode, torques and s over time."""
    figure = Figure(figsize=(12.0, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    path = figure.add_subplot(grid[:, 0])
    torque = figure.add_subplot(grid[0, 1])
    measure = figure.add_subplot(grid[1, 1], sharex=torque)
    _path(path, robot, plan.certificate)
    _over_time(torque, measure, robot, plan.certificate)
    certificate = plan.certificate
    figure.suptitle(
        f"{robot.name}, working mode {list(robot.working_mode)}: {len(certificate.crossings)} crossings in"
        f" {certificate.duration:.2f} s, peak torque {certificate.peak_torque:.3f} N m (limit {robot.max_torque:g})",
        fontsize=10, parse_math=False,
    )
    return figure


def _path(axes: Any, robot: RobotParameters, certificate: Certificate) -> None:
    labelled = set()
    for arc in trace_locus(robot, (robot.working_mode,), robot.min_type1_distance):
        style, name = LOCUS_STYLES[arc.family]
        axes.plot(*arc.x.T, color=GREY, linestyle=style, linewidth=1.5, label=name if name not in labelled else None)
        labelled.add(name)
    x = certificate.profile.x
    axes.plot(*x.T, color=BLACK, linewidth=1.0, label="path", zorder=2)
    axes.plot(*x[0], "o", color=BLACK, markersize=8, zorder=5, label="start")
    axes.plot(*x[-1], "o", color=BLACK, markerfacecolor="none", markersize=13, zorder=5, label="end")
    for numbers, row in _places(certificate):
        crossing = certificate.crossings[row]
        point, velocity = np.array(crossing.x), np.array(crossing.x_dot)
        t_s = states_model(robot).place(point).t_s
        along, across = velocity / np.hypot(*velocity), np.array([-velocity[1], velocity[0]]) / np.hypot(*velocity)
        axes.plot(*np.stack([point - 0.6 * ARROW * t_s, point + 0.6 * ARROW * t_s]).T, color=LIGHT, linewidth=4.0, zorder=3)
        axes.annotate(
            "", point + ARROW * along, point, arrowprops={"arrowstyle": "-|>", "color": BLACK, "linewidth": 1.2}, zorder=6
        )
        axes.plot(*point, "s", color=BLACK, markerfacecolor="white", markersize=5, zorder=4)
        axes.text(
            *(point + LABEL_GAP * across), _numbers(numbers), fontsize=8, ha="center", va="center", zorder=7,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85},
        )  # fmt: skip
    axes.plot([], [], color=LIGHT, linewidth=4.0, label="$t_s$ at a crossing")
    motors = np.array([leg.axis for leg in robot.legs])
    axes.plot(*motors.T, "k^", markersize=9, zorder=4, label="motor axes")
    everything = np.vstack([x, motors])
    axes.set_xlim(everything[:, 0].min() - MARGIN, everything[:, 0].max() + MARGIN)
    axes.set_ylim(everything[:, 1].min() - MARGIN, everything[:, 1].max() + MARGIN)
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.set_title("(a) path; arrows: direction of the numbered crossings", fontsize=9)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.09), fontsize=8, ncols=4, frameon=False)


def _places(certificate: Certificate) -> list[tuple[list[int], int]]:
    """The numbers of the crossings that share a place and a direction, with the row of the first."""
    places: list[tuple[list[int], int]] = []
    for row, crossing in enumerate(certificate.crossings):
        for numbers, first in places:
            other = certificate.crossings[first]
            if crossing.sign == other.sign and np.hypot(*np.subtract(crossing.x, other.x)) < SAME_PLACE:
                numbers.append(row + 1)
                break
        else:
            places.append(([row + 1], row))
    return places


def _numbers(numbers: list[int]) -> str:
    shown = ", ".join(str(number) for number in numbers[:MOST_LABELS])
    return shown if len(numbers) <= MOST_LABELS else f"{shown} and {len(numbers) - MOST_LABELS} more"


def _over_time(torque: Any, measure: Any, robot: RobotParameters, certificate: Certificate) -> None:
    profile = certificate.profile
    for index, (name, style) in enumerate((("left", "-"), ("right", "--"))):
        torque.plot(profile.time, profile.torque[:, index], BLACK, linestyle=style, linewidth=1.0, label=f"{name} motor")
    ceiling = HEADROOM * certificate.peak_torque
    if robot.max_torque < ceiling:
        for limit in (-robot.max_torque, robot.max_torque):
            torque.axhline(limit, color=GREY, linewidth=0.8)
    torque.set_ylim(-ceiling, 1.3 * ceiling)
    torque.set_ylabel("planned torque (N m)")
    torque.set_title("(b) over time; dotted: crossings", fontsize=9)
    torque.legend(loc="upper right", fontsize=8, ncols=2)
    torque.tick_params(labelbottom=False)
    measure.plot(profile.time, profile.s, BLACK, linewidth=1.0)
    measure.axhline(0.0, color=GREY, linewidth=0.6)
    measure.set_ylim(-1.05, 1.05)
    measure.set_ylabel("s (1)")
    measure.set_xlabel("time (s)")
    measure.set_xlim(0.0, certificate.duration)
    for axes in (torque, measure):
        axes.grid(color="#e6e6e6", linewidth=0.5)
        for crossing in certificate.crossings:
            axes.axvline(crossing.time, color=GREY, linewidth=0.8, linestyle=(0, (1, 2)))
