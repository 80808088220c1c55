"""What time near the locus costs in torque, and what it buys: slow trips planned with several values of ``locus_time``.

    python test/locus_time_study.py [POINTS]

A row for each value: planned peak torque and time within |s| < 0.1, then how many trips end well (the campaign's bounds) as
planned, with masses ±20 %, with Coulomb friction of 0.02 N m that the model lacks, and tilted by 1 and 2 degrees. Plant ``cartesian``.
"""

from __future__ import annotations

import math
import sys
from functools import partial
from typing import Any

import numpy as np

from dextar_control.campaign.trial import Built, _drive, _judge, build, sample_points
from dextar_control.contract.resources import ROBOT_FILE, config_file
from dextar_control.contract.robot import load_robot
from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.planning.locus import locus_point
from dextar_control.planning.planner import plan_return_trip_through
from dextar_sim.rig import Rig

DURATION, DWELL, SEED = 2.0, 0.2, 77  # s of one way, s of rest, of the points
TIMES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)  # s
CASES: dict[str, tuple[dict[str, float], float]] = {  # perturbation, tilt in degrees
    "nominal": ({}, 0.0), "masses": ({"masses": 0.2}, 0.0), "friction": ({"coulomb": 0.02}, 0.0), "tilt 1": ({}, 1.0),
    "tilt 2": ({}, 2.0),
}  # fmt: skip


def main() -> None:
    known = load_robot(config_file(ROBOT_FILE))
    points = sample_points(known, int(sys.argv[1]) if len(sys.argv) > 1 else 12, 4, SEED)
    print("locus_time | planned | peak torque, N m | near, ms |", " | ".join(CASES))
    for locus_time in TIMES:
        ended: dict[str, list[bool]] = {name: [] for name in CASES}
        peaks, near = [], []
        for row, point in enumerate(points):
            robot = known.replace(working_mode=point.working_mode)
            trip = partial(plan_return_trip_through, robot, locus_point(robot, np.array(point.point)), 1, DURATION, DWELL)
            plan = trip(locus_time=locus_time)
            peaks.append(plan.certificate.peak_torque)
            near.append(np.mean([crossing.near_time for crossing in plan.certificate.crossings]))
            for name, (perturbation, tilt) in CASES.items():
                built = build(robot, perturbation, np.random.default_rng(row))
                built = built._replace(robot=built.robot.replace(gravity=(0.0, -9.81 * math.sin(math.radians(tilt)))))
                ended[name].append(ends_well(robot, plan, built))
        print(f"{locus_time:.2f} | {len(peaks)} | {np.median(peaks):.4f} | {1e3 * np.median(near):.0f} |",
              " | ".join(str(sum(rows)) for rows in ended.values()), flush=True)  # fmt: skip


def ends_well(robot: Any, plan: Any, built: Built) -> bool:
    loop, rig = ControlLoop(robot, default_settings(), -1), Rig(built.robot, plant="cartesian")
    try:
        return bool(_judge(loop, _drive(loop, plan, plan.certificate, rig, built, None), False)["success"])
    finally:
        rig.close()


if __name__ == "__main__":
    main()
