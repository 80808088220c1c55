"""One tick of the loop beside one call of pinocchio's ``constraintDynamics`` from
Python: ``python test/studies/bench_tick.py``.

The tick is a whole ``ControlLoop.step`` (observer, law, watches) along the nodes'
default trip. The two take turns in the same milliseconds. Prints one JSON object,
microseconds; ``DEXTAR_CC=`` (empty) measures the interpreted equations.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

from oracle import Oracle, pin

from dextar_control.contract.resources import ROBOT_FILE, config_file, node_defaults
from dextar_control.contract.robot import load_robot
from dextar_control.contract.settings import Settings
from dextar_control.control.loop import ControlLoop
from dextar_control.planning.planner import plan_return_trip

ROUNDS = 5
PERIOD = 1e-3  # s


def measure() -> dict[str, float]:
    """Microseconds of the best round (the one with the least median of the oracle), and
    ratios.
    """
    robot = load_robot(config_file(ROBOT_FILE))
    task = node_defaults("trajectory_server")
    trip = plan_return_trip(
        robot,
        np.array(task["task.start"]),
        np.array(task["task.goal"]),
        task["task.duration"],
        task["task.dwell"],
    )
    settings = Settings.from_values(node_defaults("controller"))
    loop = ControlLoop(robot, settings, 1)
    times = np.arange(0.0, trip.trajectory.duration, PERIOD)
    joints = [
        loop.model.inverse_geometric_model(trip.trajectory.at(t).x) for t in times
    ]
    dynamics = Oracle(robot).constraint_dynamics(joints[0], trip.trajectory.at(0.0).x)
    rounds = []
    for _ in range(ROUNDS):
        loop = ControlLoop(robot, settings, 1)
        loop.accept(trip.trajectory)
        spent = np.empty((len(times), 2))
        for k, (t, q_a) in enumerate(zip(times, joints, strict=True)):
            begin = time.perf_counter()
            loop.step(t, q_a)
            middle = time.perf_counter()
            dynamics()
            spent[k] = middle - begin, time.perf_counter() - middle
        assert loop.phase.name != "SAFE_STOP", loop.reason
        rounds.append(1e6 * spent)
    tick, oracle = min(rounds, key=lambda spent: float(np.median(spent[:, 1]))).T
    p50, p99 = np.percentile(tick, [50, 99])
    alone = float(np.median(oracle))
    return {
        "tick_p50": p50,
        "tick_p99": p99,
        "constraint_dynamics_p50": alone,
        "ratio": p50 / alone,
        "p99_over_p50": p99 / p50,
    }


if __name__ == "__main__":
    assert pin is not None
    print(
        json.dumps({name: round(float(value), 2) for name, value in measure().items()})
    )
