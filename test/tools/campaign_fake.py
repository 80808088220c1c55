"""Trials without physics, for the campaign's machinery, and its command on top of
them.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from pathlib import Path
from typing import Any

from dextar_control.contract.robot import RobotParameters
from dextar_control.experiments.campaign.design import CrossingPoint, Trial

LAWS = ("consistent", "classic")
ESTIMATORS = ("observer", "dgm")
MODULE = "campaign_fake"


class Rig:
    """Nothing to drive."""

    PLANTS = ("pybullet", "cartesian")


def sample_points(
    robot: RobotParameters, count: int, folded: int, seed: int
) -> list[CrossingPoint]:
    chance = random.Random(seed)
    return [
        CrossingPoint(
            (chance.uniform(-0.1, 0.1), chance.uniform(0.0, 0.1)),
            (1, -1),
            "folded" if n < folded else "stretched",
        )
        for n in range(count)
    ]


def plan_trial(robot: RobotParameters, trial: Trial) -> None:
    if trial.case == "raises":
        raise RuntimeError("no plan")


def run_trial(robot: RobotParameters, trial: Trial, rig: Any) -> dict[str, Any]:
    log = Path(os.environ["CAMPAIGN_FAKE_LOG"])
    met_before = log.is_file() and f"{trial.case} {trial.index}\n" in log.read_text(
        encoding="utf-8"
    )
    with log.open("a", encoding="utf-8") as file:
        file.write(f"{trial.case} {trial.index}\n")
    if trial.index == 0 and (
        trial.case == "exits" or trial.case == "exits_once" and not met_before
    ):
        os._exit(3)
    if trial.index == 0 and trial.case == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if trial.index == 0 and trial.case == "raises":
        raise ValueError("the plant is\nupside down")
    if trial.case == "slow":
        time.sleep(0.05)
    error = (
        1e-3
        * random.Random(trial.seed).random()
        * (10.0 if trial.law == "classic" else 1.0)
    )
    crossings = 2 * trial.repeat
    crossed = crossings if error < 5e-3 else 0
    return {
        "planned": True,
        "plan_problem": "",
        "crossings_planned": crossings,
        "crossed": crossed,
        "success": error < 5e-3,
        "reason": "" if error < 5e-3 else "did not cross",
        "max_error": error,
        "end_error": 0.1 * error,
        "planned_peak_torque": 0.09,
        "peak_torque": 0.1,
        "peak_ratio": 1.1,
        "peak_ratio_near": 0.5 + 100.0 * error,
        "saturated": 0,
        "phase": "HOLD",
        "false_alarms": 0,
        "simulated_time": 1.0,
        "wall_time": 0.05,
        "cpu_time": time.process_time(),
        "planning_time": time.perf_counter(),
        "recognised": True if trial.perturbation.get("bounce") else None,
    }


if __name__ == "__main__":
    from dextar_control.cli import campaign
    from dextar_control.cli import main as cli
    from dextar_control.experiments.campaign.command import run_command

    campaign.run = lambda arguments: run_command(arguments, MODULE)
    sys.exit(cli.main(["campaign", *sys.argv[1:]]))
