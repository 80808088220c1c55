"""How often and how fast random requests are planned: ``python
test/studies/planner_bench.py 200``.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import NamedTuple

import numpy as np

from dextar_control.contract.errors import DextarError
from dextar_control.contract.resources import ROBOT_FILE, config_file
from dextar_control.contract.robot import RobotParameters, load_robot
from dextar_control.contract.signals import run_command
from dextar_control.planning.locus import MIN_END_S, WORKING_MODES
from dextar_control.planning.model import planning_model
from dextar_control.planning.planner import plan_crossing
from dextar_control.symbols.types import Array

DURATIONS = (0.3, 0.6)  # s
OPEN_SHARE = 0.25  # of the requests that leave their duration open


class RandomRequest(NamedTuple):
    """A random request: two places on the two sides in one working mode."""

    robot: RobotParameters
    start: Array  # (2,) m
    goal: Array  # (2,) m
    duration: float | None  # s


class Answer(NamedTuple):
    """What became of a request."""

    request: RandomRequest
    time: float  # s it took
    peak_torque: float  # N m; nan when refused
    refusal: str  # empty when planned


def random_requests(
    robot: RobotParameters, count: int, seed: int = 0
) -> list[RandomRequest]:
    """Places drawn evenly from the workspace until both are clear of Type 1 and Type 2
    and on two sides.
    """
    generator = np.random.default_rng(seed)
    reach = planning_model(robot).workspace[1][1]
    requests: list[RandomRequest] = []
    while len(requests) < count:
        at = robot.replace(
            working_mode=WORKING_MODES[generator.integers(len(WORKING_MODES))]
        )
        places = generator.uniform(-reach, reach, (2, 2))
        found = planning_model(at).sides(places)
        parted = np.abs(found.s).min() >= MIN_END_S and found.s[0] * found.s[1] < 0.0
        if not (parted and found.type1.min() >= robot.min_type1_distance):
            continue
        duration = (
            None
            if generator.uniform() < OPEN_SHARE
            else float(generator.uniform(*DURATIONS))
        )
        requests.append(RandomRequest(at, places[0], places[1], duration))
    return requests


def answer(request: RandomRequest) -> Answer:
    """Plan a request."""
    begin, peak, refusal = time.perf_counter(), float("nan"), ""
    try:
        peak = plan_crossing(
            request.robot, request.start, request.goal, request.duration
        ).certificate.peak_torque
    except DextarError as error:
        refusal = str(error)
    return Answer(request, time.perf_counter() - begin, peak, refusal)


def main(arguments: list[str] | None = None) -> int:
    """Console entry: plan random requests, print how many, how fast, and why not the
    others.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    return run_command("bench", lambda: _run(options.count, options.seed))


def _run(count: int, seed: int) -> int:
    robot = load_robot(config_file(ROBOT_FILE))
    answer(random_requests(robot, 1, seed + 1)[0])
    answers = [answer(request) for request in random_requests(robot, count, seed)]
    refused = [item for item in answers if item.refusal]
    times, peaks = (
        np.array([item.time for item in answers]),
        np.array([item.peak_torque for item in answers]),
    )
    median, longest = np.median(times), times.max()
    print(
        f"planned {len(answers) - len(refused)} of {len(answers)}; median {median:.3f}"
        f" s, longest {longest:.3f} s a request"
    )
    print(
        f"peak torque: median {np.nanmedian(peaks):.4f} N m, largest"
        f" {np.nanmax(peaks):.3f} N m"
    )
    for item in refused:
        print(
            f"refused, working mode {list(item.request.robot.working_mode)}:"
            f" {item.refusal}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
