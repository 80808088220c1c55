"""Twenty places of the 3-RRR's locus there and back, both ways, with the masses as
known and a fifth off: run as a script.

Each also with a blow on the locus that turns the motion along t_s round, after which
some robots bounce and some cross all the same, by their motion along the strong
directions: whether what is said of it is so.

    python test/studies/three_rrr_places.py [--pybullet]

On the exact plant, or with --pybullet on PyBullet's bodies. Prints a row a plan, and
what the largest error and the largest torque near the locus were.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

from plain_loop import PERIOD, Run, drive, exact_plant, heavier, pybullet_plant

from dextar_control.contract.resources import config_file
from dextar_control.control.verdicts import Verdict
from dextar_control.model.robot import load_any_robot
from dextar_control.planning.locus import spread_places
from dextar_control.planning.planner import plan_return_trip_through

LOW, HIGH = [-0.12, -0.12, -0.1], [0.12, 0.12, 0.1]  # m
SHARES = (1.0, 1.2, 0.8)  # of the known masses and inertias


def opinion(run: Run, direction: int) -> str:
    """What the loop says of the first crossing, and whether the true side was that one
    when it said so.
    """
    passed = run.loop.passed[0]
    if passed.verdict is Verdict.UNDECIDED:
        return "undecided"
    side = run.s[min(round(passed.time / PERIOD), len(run.s) - 1)]
    right = (side * direction > 0.0) == (passed.verdict is Verdict.CROSSED)
    return f"{'rightly' if right else 'WRONGLY'} {passed.verdict.name.lower()}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description="Twenty places of the 3-RRR's locus, there and back."
    )
    parser.add_argument(
        "--pybullet",
        action="store_true",
        help="on PyBullet's bodies instead of the exact plant",
    )
    plant_of = pybullet_plant if parser.parse_args().pybullet else exact_plant
    robot = load_any_robot(config_file("three_rrr.yaml"))
    found: dict[float, list[tuple[bool, float, float, int]]] = {
        share: [] for share in SHARES
    }
    ends: dict[float, list[str]] = {share: [] for share in SHARES}
    for place in spread_places(robot, LOW, HIGH, 20):
        for direction in (1, -1):
            plan = plan_return_trip_through(robot, place, direction, None, 0.1)
            peak = plan.certificate.peak_torque
            words = [
                f"{np.round(place.x, 4)} m, to s {direction:+d}, Type 1"
                f" {place.type1:.2f}, {plan.trajectory.duration:.2f} s"
            ]
            for share in SHARES:
                run = drive(robot, plan, heavier(robot, share), plant_of=plant_of)
                crossed = (
                    run.sides == [-direction, direction, -direction]
                    and run.loop.completed == 1
                )
                told = sum(
                    passed.verdict.name == "CROSSED" for passed in run.loop.passed
                )
                found[share].append(
                    (crossed, 1e3 * run.error.max(), run.near_torque / peak, told)
                )
                blow = float(plan.certificate.crossing_times[0])
                turned = drive(
                    robot, plan, heavier(robot, share), turned=blow, plant_of=plant_of
                )
                ends[share].append(end := opinion(turned, direction))
                error, torque = found[share][-1][1:3]
                words.append(
                    f"{share}: {'crossed' if crossed else 'NOT'} {error:.3f} mm"
                    f" {torque:.2f} {end}"
                )
            print(" | ".join(words), flush=True)
    for share, rows in found.items():
        crossed, error, torque, told = np.array(rows, dtype=float).T
        print(
            f"masses x {share}: crossed {int(crossed.sum())} of {len(rows)}, called so"
            f" {int(told.sum())} of {2 * len(rows)}; true error median"
            f" {np.median(error):.3f}, max {error.max():.3f} mm; torque near the locus"
            f" over the planned peak median {np.median(torque):.2f}, max"
            f" {torque.max():.2f}; struck: {dict(Counter(ends[share]))}"
        )


if __name__ == "__main__":
    main()
