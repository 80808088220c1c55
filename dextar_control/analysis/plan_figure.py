"""A plan before it runs: its path across the locus, and what it asks of the motors over
time; of any mechanism.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dextar_control.analysis.curves import Curve, Panel
from dextar_control.analysis.drawing import (
    SCREEN,
    draw_line,
    draw_locus,
    draw_panel,
    draw_places,
    finish_plane,
    mark,
)
from dextar_control.analysis.plane import T_S_LENGTH, Place, corners, locus_of
from dextar_control.analysis.run import Floats
from dextar_control.contract import style
from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.style import LIGHT, LINES, Line
from dextar_control.contract.words import counted
from dextar_control.model.robot import AnyRobot
from dextar_control.planning.certificate import Certificate, Plan
from dextar_control.planning.model import StatesModel, states_model

SIZE = (12.0, 6.4)  # inches
ARROW = 14e-3  # m, of a crossing's direction
SAME_PLACE = 1e-4  # m, a path whose ends are closer than this returns to its start
HEADROOM = 1.15  # of the torque axis over the peak
GRID = 90  # points along each axis where a locus has no closed form


@SCREEN.settings()
def draw_plan(robot: AnyRobot, plan: Plan) -> Figure:
    """Draw a plan: its path to scale on the locus of its working mode, torques and s
    over time.
    """
    certificate = plan.certificate
    figure = Figure(figsize=SIZE, layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(0.85, 1.0))
    _path(figure.add_subplot(grid[:, 0]), robot, certificate)
    first = figure.add_subplot(grid[0, 1])
    panels, times = _panels(robot, certificate), certificate.crossing_times.tolist()
    for axes, panel in zip(
        (first, figure.add_subplot(grid[1, 1], sharex=first)), panels, strict=True
    ):
        draw_panel(axes, panel, times, panel is panels[-1])
    axes.axhline(0.0, **SCREEN.line(Line("mid", (), 0.9)))
    axes.set_xlim(0.0, certificate.duration)
    axes.set_xlabel(f"{style.label('time')}; dotted: crossings")
    name = robot.name if isinstance(robot, RobotParameters) else robot.mechanism.name
    mode = ", ".join(f"{side:+d}" for side in robot.working_mode)
    title = (
        f"{name}: {counted(len(certificate.crossings), 'crossing')} in"
        f" {certificate.duration:.2f} s, peak torque {certificate.peak_torque:.3f} of"
        f" {robot.max_torque:g} {certificate.joint.effort_unit}, peak torque rate"
        f" {certificate.peak_torque_rate:.1f} {certificate.joint.effort_unit}/s"
    )
    figure.suptitle(
        f"{title}; working mode {mode}" if mode else title,
        x=0.01,
        ha="left",
        weight="bold",
        parse_math=False,
    )
    return figure


def _path(axes: Axes, robot: AnyRobot, certificate: Certificate) -> None:
    model, x, crossings = (
        states_model(robot),
        certificate.profile.x,
        certificate.crossings,
    )
    locus = locus_of(robot) if isinstance(robot, RobotParameters) else []
    draw_locus(axes, locus, SCREEN)
    at = np.array(crossings[0].x) if crossings else x[0]
    links = np.asarray(model.mechanism.linkage(model.place(at).q_a, at, model.numbers))
    draw_line(
        axes,
        links,
        LINES["linkage", 0],
        "robot at the first crossing" if crossings else "robot",
        SCREEN,
        zorder=2,
    )
    if len(links):
        mark(axes, links, "o", 2.6, SCREEN, zorder=2)
    draw_line(axes, x[:, :2], Line("ink", (), 1.4), "path", SCREEN, zorder=3)
    places = []
    for number, crossing in enumerate(crossings, start=1):
        point, velocity = np.array(crossing.x[:2]), np.array(crossing.x_dot[:2])
        along = T_S_LENGTH * model.place(np.array(crossing.x)).t_s[:2]
        ends_of_t_s = np.stack([point - along, point + along])
        places.append(Place([number], point, ends_of_t_s, ""))
        if speed := float(np.hypot(*velocity)):
            tip = point + ARROW * velocity / speed
            axes.annotate(
                "",
                (tip[0], tip[1]),
                (point[0], point[1]),
                zorder=6,
                arrowprops={
                    "arrowstyle": "-|>",
                    "color": LIGHT["ink"],
                    "linewidth": 1.2,
                },
            )
    ends = [("start", x[0, :2]), ("end", x[-1, :2])]
    if np.hypot(*(x[-1, :2] - x[0, :2])) < SAME_PLACE:
        ends.pop()
    draw_places(axes, places, ends, SCREEN)
    low, high = corners([x[:, :2], links, *(arc for _, arc in locus)], [])
    if not isinstance(robot, RobotParameters):
        _contour(axes, model, at, low, high)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    finish_plane(axes)


def _contour(
    axes: Axes, model: StatesModel, at: Floats, low: Floats, high: Floats
) -> None:
    """Draw the locus in the plane through a place (n,), whose other coordinates are
    kept.
    """
    across, up = np.linspace(low[0], high[0], GRID), np.linspace(low[1], high[1], GRID)
    places = np.tile(at, (GRID * GRID, 1))
    places[:, :2] = np.stack(np.meshgrid(across, up), axis=-1).reshape(-1, 2)
    s = model.sides(places).s[:, 0].reshape(GRID, GRID)
    if np.isfinite(s).any() and np.nanmin(s) < 0.0 < np.nanmax(s):
        line = SCREEN.line(LINES["stretched", 0])
        axes.contour(
            across,
            up,
            np.ma.masked_invalid(s),
            levels=[0.0],
            colors=[line["color"]],
            linestyles=[line["linestyle"]],
            linewidths=[line["linewidth"]],
        )
        axes.plot(
            [],
            [],
            label=(
                "Type 2 locus as the platform is turned there"
                if len(at) > 2
                else "Type 2 locus"
            ),
            **line,
        )


def _panels(robot: AnyRobot, certificate: Certificate) -> list[Panel]:
    profile, ceiling = certificate.profile, HEADROOM * certificate.peak_torque
    tall = max(1.05, 1.05 * float(np.nanmax(np.abs(profile.s))))
    torques = [
        Curve(
            f"τ{part + 1}, {side}",
            profile.time,
            profile.torque[:, part],
            "commanded",
            part,
        )
        for part, side in enumerate(robot.sides)
    ]
    return [
        Panel(
            "torque",
            f"planned torque ({certificate.joint.effort_unit})",
            torques,
            -ceiling,
            ceiling,
            limit=robot.max_torque,
        ),
        Panel(
            "s",
            style.label("s"),
            [Curve("s", profile.time, profile.s, "seen")],
            -tall,
            tall,
        ),
    ]
