"""Time the plant's step beside raw PyBullet steps of the same scene: ``python -m
dextar_sim.bench``.

Prints one JSON object: microseconds for one sample period (substeps included).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable

import numpy as np
import pybullet as p

from dextar_control.contract.resources import (
    NODES_FILE,
    ROBOT_FILE,
    config_file,
    node_defaults,
)
from dextar_control.contract.robot import load_robot
from dextar_sim import world
from dextar_sim.plant import Plant

ROUNDS = 20
STEPS = 100  # of each kind in one round: the two take turns


def _time(work: Callable[[], object]) -> list[float]:
    times = []
    for _ in range(STEPS):
        begin = time.perf_counter()
        work()
        times.append(1e6 * (time.perf_counter() - begin))
    return times


def measure() -> dict[str, dict[str, float]]:
    """Return p50 and p99 of one period's step, ours and raw, microseconds."""
    values = node_defaults("plant", config_file(NODES_FILE))
    robot = load_robot(config_file(ROBOT_FILE))
    ours, bare = (
        Plant(
            robot,
            period=values["task.sample_period"],
            substeps=values["simulation.substeps"],
        )
        for _ in range(2)
    )
    world.set_step(bare._client, bare.period / bare.substeps)
    torque = [1e-3, -1e-3]

    def raw() -> None:
        for _ in range(bare.substeps):
            p.stepSimulation(physicsClientId=bare._client)

    def with_state() -> None:
        ours.step(torque)
        ours.state()

    times: dict[str, list[float]] = {"raw": [], "step": []}
    for _ in range(ROUNDS):
        for plant in (ours, bare):
            plant.reset(values["task.start"])
        times["raw"] += _time(raw)
        times["step"] += _time(with_state)
    ours.close()
    bare.close()
    return {
        name: {
            "p50": float(np.percentile(sample, 50)),
            "p99": float(np.percentile(sample, 99)),
        }
        for name, sample in times.items()
    }


if __name__ == "__main__":
    argparse.ArgumentParser(
        description="Time the plant's step beside raw PyBullet steps; one JSON object."
    ).parse_args()
    print(json.dumps(measure()))
    sys.exit(0)
