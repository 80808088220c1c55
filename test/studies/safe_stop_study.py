"""Stops a robot at several hundred instants of its crossings and tells what became of
it, as a table and a figure.

    python test/studies/safe_stop_study.py --output runs/safe_stop

Each trip runs once; at each instant the process forks, and the copy stops its robot.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import pickle
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

from closed_loop import advance, running, s_of

from dextar_control.contract.resources import ROBOT_FILE, config_file, node_defaults
from dextar_control.contract.robot import RobotParameters, load_robot
from dextar_control.contract.settings import (
    SETTING_NAMES,
    Settings,
    default_settings,
)
from dextar_control.control.loop import ControlLoop
from dextar_control.control.phases import Phase
from dextar_control.planning.planner import Plan, plan_return_trip
from dextar_sim.rig import Rig

Answer = TypeVar("Answer")
TRIPS = {"fast": 0.33, "slow": 2.0}  # s of one way
TRIGGERS = (
    "stop",
    "watch",
)  # somebody's request; a watch that trips (the tracking error's)
DWELL = 0.2  # s at rest before, between and after the ways
PER_WAY = 26  # instants over each way, and as many again over its phase CROSSING
AFTER = 0.1  # s for which a stopped robot is looked at
# m/s of the end effector below which it rests: half of what the joints' 0.1 rad/s may
# leave it at |s| = 0.2
REST = 0.02


class Row(NamedTuple):
    """One stop. Times in s, from the instant at which it was asked for."""

    trip: str
    way: str
    trigger: str
    time: float  # from the planned crossing
    s: float  # true, at the instant
    speed: float  # true, of the end effector at the instant, m/s
    finished: bool  # the crossing went on first
    peak_torque: float  # N m, after the instant
    limit: float  # of it, N m
    # energy that the safe stop's torque gave the robot instead of taking it, J
    pushed: float
    taken: float  # and that it took, J
    distance: float  # run by the end effector, m
    rest_time: float  # to a true speed below REST for good; nan for never
    torque_time: float  # to the last torque
    over_time: float  # to the declared end
    end_s: float  # true
    end_speed: float  # true, m/s
    told: str  # by the loop
    side_known: bool
    side_right: bool  # believed and true sign of s agree


def branch(function: Callable[[], Answer]) -> Answer:
    """What a function returns, computed in a copy of this process: nothing here
    changes.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        with os.fdopen(writing, "wb") as stream:
            pickle.dump(function(), stream)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as stream:
        content = stream.read()
    os.waitpid(child, 0)
    answer: Answer = pickle.loads(content)
    return answer


def instants(plan: Plan, count: int) -> list[tuple[float, str]]:
    """Evenly spaced over each way, and again over the part of it in which |s| < 0.4,
    s.
    """
    profile, found = plan.certificate.profile, []
    half = 0.5 * plan.trajectory.duration
    for way, span in (
        ("out", (DWELL, half - 0.5 * DWELL)),
        ("back", (half + 0.5 * DWELL, 2.0 * half - DWELL)),
    ):
        near = profile.time[
            (np.abs(profile.s) < 0.4)
            & (profile.time > span[0])
            & (profile.time < span[1])
        ]
        for low, high in (span, (near[0], near[-1])):
            found += [
                (float(time), way)
                for time in low + (high - low) * (np.arange(count) + 0.5) / count
            ]
    return sorted(found)


def intolerant(settings: Settings) -> Settings:
    """Settings with which any tracking error begins a safe stop."""
    watch = replace(settings.watch, max_tracking_error=1e-12)
    return replace(settings, watch=watch)


def stopped(
    rig: Rig, loop: ControlLoop, trigger: str, crossing: float, names: tuple[str, str]
) -> Row:
    """One stop, from now on."""
    model, truth = loop.model, rig.truth()
    begin, s = rig.time, s_of(model, truth.x)
    if trigger == "stop":
        loop.stop()
        finished = loop.phase is not Phase.SAFE_STOP
    else:
        loop.configure(intolerant(loop.settings))
        finished = False
    rows: list[list[float]] = []
    over, limit, power = np.nan, loop.torque_limit, []
    for _, tau in running(loop, rig):
        truth = rig.truth()
        rows.append(
            [
                rig.time - begin,
                *truth.x,
                float(np.hypot(*truth.x_dot)),
                float(np.abs(tau).max()),
            ]
        )
        if loop.phase is Phase.SAFE_STOP:
            power.append(float(tau @ truth.q_a_dot))
        if np.isnan(over) and loop.stopped is not None:
            over = rig.time
        if rig.time + rig.period >= over + AFTER:
            break
    table, tick = np.array(rows), loop.tick
    assert tick is not None
    moving, pushing = (
        np.flatnonzero(table[:, 3] >= REST),
        np.flatnonzero(table[:, 4] > 0.0),
    )
    end_s = s_of(model, table[-1, 1:3])
    last = int(moving[-1]) + 1 if len(moving) else 0
    pushed, taken = (
        rig.period * float(np.maximum(sign * np.array(power), 0.0).sum())
        for sign in (1.0, -1.0)
    )
    return Row(
        *names,
        trigger,
        begin - crossing,
        s,
        float(table[0, 3]),
        finished,
        float(table[:, 4].max()),
        limit,
        pushed,
        taken,
        float(np.hypot(*np.diff(table[:, 1:3], axis=0).T).sum()),
        float(table[last, 0]) if last < len(table) else np.nan,
        float(table[pushing[-1], 0]) if len(pushing) else 0.0,
        float(over - begin),
        end_s,
        float(table[-1, 3]),
        loop.reason.rpartition("; ")[2],
        loop.mode_known,
        tick.assembly_mode * end_s > 0.0,
    )


def study(
    robot: RobotParameters,
    count: int = PER_WAY,
    plant: str = "pybullet",
    *,
    alternate: bool = False,
    built: dict[str, float] | None = None,
    delay: float = 0.0,
    **changes: Any,
) -> list[Row]:
    """All stops: both trips, both ways, at each instant both triggers, or one in turn.

    Args:
        built: what the true robot has otherwise.
        delay: of the commands, s.
        changes: of the controller's settings.
    """
    task, rows = node_defaults("trajectory_server"), []
    for trip, duration in TRIPS.items():
        plan = plan_return_trip(
            robot,
            np.array(task["task.start"]),
            np.array(task["task.goal"]),
            duration,
            DWELL,
        )
        rig = Rig(robot.replace(**(built or {})), plant=plant, command_delay=delay)
        loop = ControlLoop(robot, default_settings(**changes), 1)
        rig.reset_joints(
            loop.model.inverse_geometric_model(plan.trajectory.at(0.0).x), 1
        )
        loop.accept(plan.trajectory)
        waiting = instants(plan, count)
        while waiting:
            time, way = waiting[0]
            if rig.time >= time - 1e-9:
                crossing = float(plan.certificate.crossing_times[int(way == "back")])
                chosen = TRIGGERS if not alternate else TRIGGERS[len(rows) % 2 :][:1]
                rows += [
                    branch(partial(stopped, rig, loop, trigger, crossing, (trip, way)))
                    for trigger in chosen
                ]
                waiting.pop(0)
                continue
            advance(loop, rig, count=1)
        rig.close()
    return rows


def summarise(rows: list[Row]) -> list[list[str]]:
    """Of each trip, trigger and place of the trigger: how many, and the worst of
    them.
    """
    table = []
    places = (
        ("|s| >= 0.4", 0.4, 9.0),
        ("0.2 to 0.4", 0.2, 0.4),
        ("|s| < 0.2", 0.0, 0.2),
    )
    for trip in TRIPS:
        for trigger in TRIGGERS:
            for name, low, high in places:
                group = [
                    row
                    for row in rows
                    if (row.trip, row.trigger) == (trip, trigger)
                    and low <= abs(row.s) < high
                ]
                if not group:
                    continue
                table.append(
                    [
                        trip,
                        trigger,
                        name,
                        str(len(group)),
                        f"{max(row.peak_torque for row in group):.3f}",
                        (
                            f"{1e3 * np.median([row.distance for row in group]):.0f} /"
                            f" {1e3 * max(row.distance for row in group):.0f}"
                        ),
                        (
                            f"{np.median([row.rest_time for row in group]):.2f} /"
                            f" {max(row.rest_time for row in group):.2f}"
                        ),
                        f"{max(row.over_time for row in group):.2f}",
                        f"{min(abs(row.end_s) for row in group):.2f}",
                        f"{sum(abs(row.end_s) < 0.2 for row in group)}",
                        f"{max(row.end_speed for row in group):.4f}",
                        f"{sum(row.side_known for row in group)}",
                        (
                            f"{sum(row.side_known and not row.side_right for row in group)}"
                        ),
                    ]
                )
    return table


HEAD = [
    "trip",
    "trigger",
    "where",
    "stops",
    "peak N m",
    "distance mm",
    "rest s",
    "over s",
    "least |s|",
    "left < 0.2",
    "speed",
    "side known",
    "wrong",
]


def draw(rows: list[Row], path: Path) -> None:
    """Over the instant of the stop: largest torque, distance run, time to rest, |s| at
    the end.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        4, 4, figsize=(13, 9), sharey="row", sharex="col", constrained_layout=True
    )
    quantities = (
        ("largest torque (N m)", lambda row: row.peak_torque),
        ("distance run (mm)", lambda row: 1e3 * row.distance),
        ("time to rest (s)", lambda row: row.rest_time),
        ("|s| at the end", lambda row: abs(row.end_s)),
    )
    columns = [(trip, way) for trip in TRIPS for way in ("out", "back")]
    for column, (trip, way) in enumerate(columns):
        axes[0, column].set_title(f"{trip}, {way}")
        axes[-1, column].set_xlabel("stopped at (s from the crossing)")
        axes[-1, column].xaxis.set_major_locator(plt.MaxNLocator(4))
        for line, (label, value) in enumerate(quantities):
            axis = axes[line, column]
            for trigger, marker, colour in (
                ("stop", "o", "black"),
                ("watch", "x", "0.5"),
            ):
                group = [
                    row
                    for row in rows
                    if (row.trip, row.way, row.trigger) == (trip, way, trigger)
                ]
                axis.plot(
                    [row.time for row in group],
                    [value(row) for row in group],
                    marker,
                    color=colour,
                    ms=4,
                    label=trigger,
                )
            if column == 0:
                axis.set_ylabel(label)
            if line == 0:
                axis.axhline(
                    rows[0].limit if trip == "fast" else rows[-1].limit,
                    color="0.6",
                    lw=0.8,
                    ls="--",
                )
            if line == 3:
                axis.axhspan(0.0, 0.2, color="0.9", zorder=0)
    axes[0, 0].legend(loc="best", fontsize=8)
    figure.savefig(path, dpi=120)


def _value(text: str) -> float | str:
    """A number, or the name of a law or an estimator."""
    try:
        return float(text)
    except ValueError:
        return text


def main() -> int:
    """Console entry."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--output", type=Path, help="folder for stops.csv and figure.png"
    )
    parser.add_argument("--json", action="store_true", help="the rows as JSON alone")
    parser.add_argument(
        "--count",
        type=int,
        default=PER_WAY,
        help="instants over a way, and again over its crossing",
    )
    parser.add_argument(
        "--alternate", action="store_true", help="one trigger at each instant, in turn"
    )
    parser.add_argument("--plant", default="pybullet", help="pybullet or cartesian")
    parser.add_argument("--delay", type=float, default=0.0, help="of the commands, s")
    names = (
        ("set", "a setting of the controller"),
        ("built", "a number of the true robot: left.coulomb_friction=0.05"),
    )
    for name, what in names:
        parser.add_argument(
            f"--{name}", action="append", default=[], metavar="NAME=VALUE", help=what
        )
    chosen = parser.parse_args()
    changes, built = (
        {
            name: _value(text)
            for name, _, text in (item.partition("=") for item in items)
        }
        for items in (chosen.set, chosen.built)
    )
    unknown = sorted(set(changes) - set(SETTING_NAMES))
    if unknown:
        parser.error(f"unknown setting '{unknown[0]}'")
    rows = study(
        load_robot(config_file(ROBOT_FILE)),
        chosen.count,
        chosen.plant,
        alternate=chosen.alternate,
        built=built,
        delay=chosen.delay,
        **changes,
    )
    if chosen.json:
        json.dump([row._asdict() for row in rows], sys.stdout, default=float)
        return 0
    for cells in [HEAD, *summarise(rows)]:
        print(" | ".join(f"{cell:>11}" for cell in cells))
    if chosen.output is not None:
        chosen.output.mkdir(parents=True, exist_ok=True)
        with (chosen.output / "stops.csv").open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerows([Row._fields, *rows])
        draw(rows, chosen.output / "figure.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
