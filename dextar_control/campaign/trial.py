"""One trial: a return trip through one crossing point in a plain loop, against one perturbed plant."""

from __future__ import annotations

from typing import Any

from dextar_control.campaign.design import CrossingPoint, Trial
from dextar_control.contract.errors import ParameterError
from dextar_control.contract.robot import RobotParameters
from dextar_control.core.law import Law
from dextar_control.core.settings import Estimation

LAWS = tuple(law.name.lower() for law in Law)
ESTIMATORS = tuple(estimator.name.lower() for estimator in Estimation)


def sample_points(robot: RobotParameters, count: int, folded: int, seed: int) -> list[CrossingPoint]:
    """Crossing points spread over the locus."""
    from dextar_control.core.locus import sample_locus

    return [
        CrossingPoint((float(place.x[0]), float(place.x[1])), place.working_mode, str(place.family))
        for place in sample_locus(robot, count, seed, folded=folded)
    ]


def plan_trial(robot: RobotParameters, trial: Trial) -> None:
    """Plan, and leave the plan in the planner's cache."""
    raise ParameterError("this version cannot run trials yet")


def run_trial(robot: RobotParameters, trial: Trial, rig: Any) -> dict[str, float | int | str | bool | None]:
    """One row of results.

    Args:
        robot: the controller's model.
        trial: what to run.
        rig: the class that the campaign file names.

    Returns:
        planned, plan_problem, crossings_planned, crossed, success, reason, max_error (m), end_error (m),
        planned_peak_torque (N m), peak_torque (N m), peak_ratio, peak_ratio_near, saturated (ticks), phase,
        called_crossed, called_bounced, called_undecided, false_alarms, simulated_time (s), wall_time (s); with a bounce
        recognised, recognition_delay (s), torque_after_bounce, safe_after. None where there is no number.
    """
    raise ParameterError("this version cannot run trials yet")
