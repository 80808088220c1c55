"""What time near the locus costs in torque, and what it buys: slow trips planned with
several values of ``locus_time``.

    python test/studies/locus_time_study.py [POINTS]

A row for each value: planned peak torque and time within |s| < 0.1, then how many trips
end well (the campaign's bounds) as planned, with masses ±20 %, with smoothed Coulomb
friction of 0.02 N m that the model lacks, and tilted by 1 and 2 degrees. Plant
``cartesian``.
"""

from __future__ import annotations

import math
import sys

import numpy as np

from dextar_control.contract.resources import ROBOT_FILE, config_file
from dextar_control.contract.robot import RobotParameters, load_robot
from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.experiments.campaign.trial import (
    _drive,
    _judge,
    built_robot,
    sample_points,
)
from dextar_control.planning.certificate import Plan
from dextar_control.planning.locus import locus_point
from dextar_control.planning.planner import plan_return_trip_through
from dextar_sim.rig import Rig

DURATION, DWELL, SEED = 2.0, 0.2, 77  # s of one way, s of rest, of the points
TIMES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)  # s
CASES: dict[str, dict[str, float]] = {
    "nominal": {},
    "masses": {"masses": 0.2},
    "friction": {"coulomb": 0.02, "coulomb_speed": 0.05},
    "tilt 1": {"tilt": math.radians(1.0)},
    "tilt 2": {"tilt": math.radians(2.0)},
}


def main() -> None:
    known = load_robot(config_file(ROBOT_FILE))
    points = sample_points(
        known, int(sys.argv[1]) if len(sys.argv) > 1 else 12, 4, SEED
    )
    print(
        "locus_time | peak torque, N m | near, ms |",
        " | ".join(CASES),
        f"| of {len(points)}",
    )
    for locus_time in TIMES:
        ended, peaks, near = dict.fromkeys(CASES, 0), [], []
        for row, point in enumerate(points):
            robot = known.replace(working_mode=point.working_mode)
            place = locus_point(robot, np.array(point.point))
            plan = plan_return_trip_through(
                robot, place, 1, DURATION, DWELL, locus_time=locus_time
            )
            peaks.append(plan.certificate.peak_torque)
            near.append(
                np.mean([crossing.near_time for crossing in plan.certificate.crossings])
            )
            for name, perturbation in CASES.items():
                generators = (np.random.default_rng([row, k]) for k in range(2))
                ended[name] += ends_well(
                    robot, plan, built_robot(robot, perturbation, *generators)
                )
        print(
            f"{locus_time:.2f} | {np.median(peaks):.4f} |"
            f" {1e3 * np.median(near):.0f} |",
            " | ".join(map(str, ended.values())),
            flush=True,
        )


def ends_well(robot: RobotParameters, plan: Plan, built: RobotParameters) -> bool:
    loop, rig = (
        ControlLoop(robot, default_settings(), -1),
        Rig(built, plant="cartesian"),
    )
    try:
        return bool(_judge(loop, _drive(loop, plan, rig, None), False)["success"])
    finally:
        rig.close()


if __name__ == "__main__":
    main()
