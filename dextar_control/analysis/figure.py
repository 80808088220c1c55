"""A run as the paper's Figure 4, with the truth beside the estimate."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dextar_control.analysis.geometry import active_joints, singularity_measure
from dextar_control.analysis.metrics import Metrics
from dextar_control.analysis.run import Run
from dextar_control.analysis.thin import thin, thin_path
from dextar_control.analysis.tracking import Tracked, plan_of, tracked
from dextar_control.contract.errors import DextarError
from dextar_control.contract.robot import RobotParameters
from dextar_control.core.kinematics import elbows, inverse_geometric_model
from dextar_control.core.model import make_model

BLACK, GREY, LIGHT, ACCENT = "#000000", "#6b6b6b", "#b8b8b8", "#a3260f"
LEGEND_ROOM = 0.22  # of an axis, kept free above its curves
GRID = 400  # points a side, of the locus
MOST_LINKAGES = 2  # drawn
VERDICT_MARKS = {"crossed": ("o", BLACK), "bounced": ("X", ACCENT)}  # what the estimator says of a crossing
VERDICT_HEIGHT = -0.92  # of their marks, on the axis of s
HEADROOM = 1.4  # of the torque axis over the larger of plan and limit
ERROR_CEILING = 10.0e-3  # m, of the error axis


def draw_run(run: Run, metrics: Metrics) -> Figure:
    """The figure of one run: path to scale, torques, errors, criterion and s over time."""
    figure = Figure(figsize=(13.0, 8.6), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(4, 2, width_ratios=(1.0, 1.25))
    path = figure.add_subplot(grid[:, 0])
    torque = figure.add_subplot(grid[0, 1])
    error = figure.add_subplot(grid[1, 1], sharex=torque)
    residual = figure.add_subplot(grid[2, 1], sharex=torque)
    measure = figure.add_subplot(grid[3, 1], sharex=torque)
    track = tracked(run)
    try:
        plan = plan_of(run)
    except DextarError:
        plan = None
    _path(path, run, metrics, track)
    if track is not None:
        _torques(torque, run, metrics, track, plan)
        _errors(error, run, metrics, track)
        _criterion(residual, measure, run, metrics, track, plan)
        duration = metrics.duration if np.isfinite(metrics.duration) else track.time[-1]
        torque.set_xlim(0.0, duration)
    for axes in (torque, error, residual, measure):
        for crossing in metrics.crossings:
            axes.axvline(crossing.planned_time, color=GREY, linewidth=0.8, linestyle=(0, (1, 2)))
        axes.grid(color="#e6e6e6", linewidth=0.5)
        if axes.get_legend_handles_labels()[1]:
            low, high = axes.get_ylim()
            axes.set_ylim(low, high + LEGEND_ROOM * (high - low))
            axes.legend(loc="upper right", fontsize=7, framealpha=0.9, ncols=6)
    for axes in (torque, error, residual):
        axes.tick_params(labelbottom=False)
    measure.set_xlabel("time since the trajectory's start (s)")
    figure.suptitle(_title(metrics), fontsize=10, color=ACCENT if metrics.success is False else BLACK)
    return figure


def _title(metrics: Metrics) -> str:
    law = f"{metrics.robot or 'robot unknown'}, law: {metrics.law or 'unknown'}, estimator: {metrics.estimator or 'unknown'}"
    verdict = {True: "crossed as planned", False: "FAILED", None: "not decidable"}[metrics.success]
    lines = [f"{law} - {verdict}", *metrics.reasons[:3]]
    return "\n".join(textwrap.shorten(line, 150) for line in lines)


def _path(axes: Any, run: Run, metrics: Metrics, track: Tracked | None) -> None:
    places = list(dict.fromkeys((round(c.point[0], 4), round(c.point[1], 4)) for c in metrics.crossings))
    if run.robot is not None:
        _locus(axes, run.robot)
        for point in places[:MOST_LINKAGES]:
            _linkage(axes, run.robot, np.array(point))
        half = 0.5 * run.robot.base_distance
        axes.plot([-half, half], [0.0, 0.0], "k^", markersize=9, zorder=4)
    if run.trajectory is not None:
        x = run.trajectory.x
        axes.plot(*x.T, color=GREY, linewidth=3.0, alpha=0.6, label="planned")
        far = x[np.hypot(*(x - x[0]).T).argmax()]
        for name, point in (("A", x[0]), ("B", far)) if len(places) < 2 else (("start", x[0]),):
            axes.plot(*point, "ko", markersize=5, zorder=5)
            axes.annotate(name, point, xytext=(7, 4), textcoords="offset points", weight="bold")
    if run.truth is not None and track is not None:
        inside = (run.truth.stamps >= track.stamps[0]) & (run.truth.stamps <= track.stamps[-1])
        path = run.truth.x[inside]
        axes.plot(*path[thin_path(path)].T, color=BLACK, linewidth=1.0, label="true")
    elif track is not None:
        inside = np.isin(run.control.stamps, track.stamps)
        path = run.control.estimate[inside]
        axes.plot(*path[thin_path(path)].T, color=BLACK, linewidth=1.0, linestyle="--", label="estimated")
    for crossing in metrics.crossings:
        marker, color = VERDICT_MARKS.get(crossing.verdict or "", ("s", BLACK))
        axes.plot(*crossing.point, marker, color=color, markerfacecolor="white", markersize=6, zorder=5)
    axes.set_aspect("equal")
    _path_limits(axes, run)
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.set_title("(a) path, linkage at a planned crossing, Type 2 locus", fontsize=9)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="lower right", fontsize=7)


def _path_limits(axes: Any, run: Run) -> None:
    """The robot and the plan, not where a failed run went."""
    points = [np.zeros((1, 2))]
    if run.trajectory is not None:
        points.append(run.trajectory.x)
    if run.robot is not None:
        reach = 0.5 * run.robot.base_distance + 0.6 * max(leg.proximal_length for leg in run.robot.legs)
        points.append(np.array([[-reach, -0.03], [reach, 0.03]]))
    everything = np.concatenate(points)
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.15 * max(high - low) + 1e-3
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)


def _locus(axes: Any, robot: RobotParameters) -> None:
    reach = 0.5 * robot.base_distance + max(leg.proximal_length + leg.distal_length for leg in robot.legs)
    side = np.linspace(-reach, reach, GRID)
    x = np.stack(np.meshgrid(side, side), axis=-1)
    s = singularity_measure(robot, x, active_joints(robot, x))
    axes.contour(side, side, np.ma.masked_invalid(s), levels=[0.0], colors=[GREY], linestyles=["dashed"], linewidths=1.0)
    axes.plot([], [], color=GREY, linestyle="dashed", linewidth=1.0, label="Type 2 locus")


def _linkage(axes: Any, robot: RobotParameters, point: np.ndarray) -> None:
    model = make_model(robot)
    left, right = elbows(model, inverse_geometric_model(model, point))
    chain = np.array([model.base[0], left, point, right, model.base[1]])
    axes.plot(*chain.T, color=LIGHT, linewidth=2.5, marker="o", markersize=4, zorder=1)


def _curve(axes: Any, time: Any, values: Any, metrics: Metrics, color: str, **style: Any) -> None:
    """A line through the rows that show it."""
    rows = thin(time, values, [crossing.planned_time for crossing in metrics.crossings])
    axes.plot(time[rows], values[rows], color, **style)


def _torques(axes: Any, run: Run, metrics: Metrics, track: Tracked, plan: Any) -> None:
    for index, (name, line) in enumerate((("τ1", "-"), ("τ2", "--"))):
        _curve(axes, track.torque_time, track.torque[:, index], metrics, BLACK, linestyle=line, linewidth=1.0,
               label=f"{name} commanded")  # fmt: skip
        if plan is not None:
            axes.plot(plan.profile.time, plan.profile.torque[:, index], ACCENT, linestyle=line, linewidth=0.6,
                      label=f"{name} planned")  # fmt: skip
    planned = metrics.planned_peak_torque
    if np.isfinite(planned) and np.isfinite(metrics.peak_torque):
        ceiling = HEADROOM * min(max(planned, metrics.peak_torque), max(3.0 * planned, 1e-6))
        if run.robot is not None and run.robot.max_torque < ceiling:
            axes.axhline(run.robot.max_torque, color=GREY, linewidth=0.8)
            axes.axhline(-run.robot.max_torque, color=GREY, linewidth=0.8)
        axes.set_ylim(-ceiling, ceiling)
    axes.set_ylabel("torque (N m)")
    axes.set_title("(b) along the trajectory; dotted: planned crossings", fontsize=9)


def _errors(axes: Any, run: Run, metrics: Metrics, track: Tracked) -> None:
    estimated = track.estimated_error
    _curve(axes, track.time, 1e3 * estimated, metrics, GREY, linestyle="--", linewidth=1.0, label="estimated")
    largest = estimated
    if len(track.true_error):
        _curve(axes, track.true_time, 1e3 * track.true_error, metrics, BLACK, linewidth=1.0, label="true")
        largest = np.concatenate([estimated, track.true_error])
    finite = largest[np.isfinite(largest)]
    axes.set_ylim(0.0, 1.15e3 * min(max(finite.max() if finite.size else 0.0, 1e-5), ERROR_CEILING))
    axes.set_ylabel("tracking error (mm)")


def _criterion(residual: Any, measure: Any, run: Run, metrics: Metrics, track: Tracked, plan: Any) -> None:
    time = (run.criterion.stamps - track.start) * 1e-9
    _curve(residual, time, run.criterion.residual, metrics, BLACK, linewidth=1.0, label="seen")
    if plan is not None:
        residual.plot(plan.profile.time, plan.profile.residual, ACCENT, linewidth=0.6, label="planned")
        ceiling = 3.0 * max(float(np.nanmax(np.abs(plan.profile.residual))), 1e-3)
        low, high = residual.get_ylim()
        residual.set_ylim(max(low, -ceiling), min(high, ceiling))
        measure.plot(plan.profile.time, plan.profile.s, ACCENT, linewidth=0.6, label="planned")
    residual.set_ylabel(r"$t_s\cdot w_d$ (N)")
    _curve(measure, time, run.criterion.s, metrics, GREY, linestyle="--", linewidth=1.0, label="estimated")
    if len(track.true_s):
        _curve(measure, track.true_time, track.true_s, metrics, BLACK, linewidth=1.0, label="true")
    if np.isfinite(run.criterion.mode_confidence).any():
        _curve(measure, time, run.criterion.mode_confidence, metrics, LIGHT, linewidth=1.0, zorder=1, label="confidence")
    for verdict, (marker, color) in VERDICT_MARKS.items():
        times = [crossing.verdict_time for crossing in metrics.crossings if crossing.verdict == verdict]
        if times:
            measure.plot(times, [VERDICT_HEIGHT] * len(times), marker, color=color, markerfacecolor="white", markersize=5,
                         label=f"says {verdict}")  # fmt: skip
    measure.axhline(0.0, color=GREY, linewidth=0.6)
    measure.set_ylim(-1.05, 1.05)
    measure.set_ylabel("s (1)")
