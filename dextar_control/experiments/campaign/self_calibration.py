"""Calibrate and identify a simulated robot by its own recordings: a tour that
calibrates it, a motion that identifies it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np

from dextar_control.contract.errors import CalibrationError
from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.experiments.campaign.rig import RigInterface
from dextar_control.identification.calibration import calibrate_recorded
from dextar_control.identification.identification import identify_recorded
from dextar_control.identification.recorded import MeasuredMotion
from dextar_control.planning.certificate import Plan
from dextar_control.planning.excitation import plan_excitation
from dextar_control.planning.tour import plan_tour

CROSSINGS, TOURS = 12, 3  # of a tour; at most
START = np.array([-0.025, 0.115])  # m, of the exciting motion: the A of every trip
EXCITE, DWELL = 20.0, 0.2  # s


def record_motion(
    robot: RobotParameters, plan: Plan, rig: RigInterface
) -> MeasuredMotion:
    """Run a plan in a plain loop, and return what its bag would tell.

    Args:
        robot: as the controller knows it.
        plan: of it.
        rig: see ``trial.run_trial``; it is closed at the end.
    """
    start = ControlLoop(robot, default_settings(), 1).model.place(
        plan.trajectory.at(0.0).x
    )
    side = round(float(np.sign(start.s[0])))
    loop = ControlLoop(robot, default_settings(), side)
    rig.reset_joints(start.q_a + np.array(robot.encoder_offset), side)
    loop.schedule(plan.trajectory, plan.certificate)
    time, readings, torques, sides, seen, places = [], [], [], [], [], []
    try:
        for _ in range(round((plan.trajectory.duration + DWELL) / rig.period)):
            sample, torque = rig.read(), None
            if sample is not None:
                torque = loop.step(sample.time, sample.q_a)
                time.append(sample.time)
                readings.append(sample.q_a)
                torques.append(torque)
                sides.append(
                    0.0
                    if loop.tick is None
                    else float(loop.tick.estimate.assembly_mode)
                )
                if sample.pose is not None:
                    seen.append(sample.pose.time)
                    places.append(sample.pose.x)
            rig.write(torque)
    finally:
        rig.close()
    poses = (np.array(seen), np.array(places)) if seen else None
    return MeasuredMotion(
        Path("recorded"),
        robot.working_mode,
        np.array(time),
        np.array(readings),
        np.array(torques),
        np.array(sides),
        poses,
    )


def calibrated_description(
    robot: RobotParameters,
    rig: Callable[[], RigInterface],
    *,
    calibrated: bool,
    identified: bool,
) -> tuple[RobotParameters, dict[str, bool]]:
    """Return the description after a recorded tour and an exciting motion, and whether
    each fit was told enough.

    Args:
        robot: as it is drawn, in the working mode of the recordings.
        rig: makes the rig that records.
        calibrated, identified: by which of the two.
    """
    found, told = robot, dict[str, bool]()
    if calibrated:
        found, told["calibrated"] = _calibrated(robot, rig)
    if identified:
        try:
            found = identify_recorded(
                found, [record_motion(robot, _exciting(robot), rig())]
            ).after
            told["identified"] = True
        except CalibrationError:
            told["identified"] = False
    return found, told


def _calibrated(
    robot: RobotParameters, rig: Callable[[], RigInterface]
) -> tuple[RobotParameters, bool]:
    """Return the calibrated description, and whether there is one.

    Where a tour ended too early to tell anything another one goes the other way round,
    and both are taken together; where it told all but the difference of the distal
    lengths another one is recorded with what it told.
    """
    told, motions = False, list[MeasuredMotion]()
    for _ in range(TOURS):
        motions.append(
            record_motion(robot, _tour(robot, CROSSINGS * (-1) ** len(motions)), rig())
        )
        try:
            calibration = calibrate_recorded(robot, motions)
        except CalibrationError:
            continue
        robot, told, motions = calibration.after, True, []
        if calibration.folded_told:
            break
    return robot, told


@lru_cache(maxsize=4)
def _tour(robot: RobotParameters, crossings: int = CROSSINGS) -> Plan:
    return plan_tour(robot, crossings)


@lru_cache(maxsize=4)
def _exciting(robot: RobotParameters) -> Plan:
    return plan_excitation(robot, START, EXCITE, DWELL)
