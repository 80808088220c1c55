"""Compile the core once: ``python -m dextar_control.core.warmup``."""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from dextar_control.contract.resources import NODES_FILE, ROBOT_FILE, config_file, node_defaults
from dextar_control.contract.robot import load_robot
from dextar_control.contract.signals import run_command, tell
from dextar_control.core.dynamics import criterion_acceleration
from dextar_control.core.estimator import Pose
from dextar_control.core.kinematics import inverse_model, state_of_platform
from dextar_control.core.locus import sample_locus, singularity_gradient
from dextar_control.core.loop import ControlLoop
from dextar_control.core.planner import plan_approach, plan_crossing, plan_through, robot_at
from dextar_control.core.settings import Settings


def default_settings(**changes: object) -> Settings:
    """The controller settings of ``config/crossing.yaml``, with changes."""
    values = node_defaults("controller", config_file(NODES_FILE))
    return Settings.from_values(values | changes)


def warm_up() -> None:
    """Call every compiled function of the control loop and the planner once."""
    robot = load_robot(config_file(ROBOT_FILE))
    task = node_defaults("controller")
    start = np.array(task["task.start"])
    loop = ControlLoop(robot, default_settings(), int(task["assembly_mode"]))
    q_a = inverse_model(loop.model, start)
    kin = state_of_platform(loop.model, start, np.zeros(2))
    criterion_acceleration(loop.model, kin, 0.0)
    loop.accept(plan_approach(robot, start, start + np.array([1e-3, 0.0]), 0.1))
    plan_crossing(robot, start, np.array(task["task.goal"]), cache=False)
    point = sample_locus(robot, 4)[0]
    plan_through(robot_at(robot, point), point, 1, cache=False)
    for tick in range(3):
        loop.step(1e-3 * tick, q_a)
    loop.step(0.05, q_a)
    loop.stop()
    loop.step(0.06, q_a)
    idle = ControlLoop(robot, default_settings(), int(task["assembly_mode"]), enabled=False)
    idle.step(0.0, q_a)
    idle.enable()
    seeing = ControlLoop(robot, default_settings(estimator="external"), int(task["assembly_mode"]))
    for tick in range(3):
        seeing.step(1e-3 * tick, q_a, Pose(1e-3 * tick, start))


def rehearse(settings: Settings) -> None:
    """Call what a loop of these settings calls, whichever its law and estimator: its first state then compiles nothing."""
    robot = load_robot(config_file(ROBOT_FILE))
    task = node_defaults("controller")
    start = np.array(task["task.start"])
    loop = ControlLoop(robot, settings, int(task["assembly_mode"]))
    q_a = inverse_model(loop.model, start)
    for tick in range(3):
        loop.step(1e-3 * tick, q_a)
    singularity_gradient(loop.model, start)


def main(arguments: list[str] | None = None) -> int:
    """Console entry: compile, say how long it took; interrupted, 128 + the signal's number."""
    parser = argparse.ArgumentParser(
        prog="warmup", description="Compile the model and the control law, so that the nodes start at once. No topics, services"
        " or parameters.",
    )  # fmt: skip
    parser.parse_args(arguments)
    return run_command("warmup", _compile)


def _compile() -> int:
    begin = time.perf_counter()
    tell("compiling the model ...", sys.stdout)
    warm_up()
    tell(f"compiled in {time.perf_counter() - begin:.1f} s", sys.stdout)
    return 0


if __name__ == "__main__":
    sys.exit(main())
