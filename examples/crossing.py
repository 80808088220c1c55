"""A crossing in a plain loop: plan, simulate, estimate, control; no ROS.

The DexTAR goes from A to B and back, each way through a Type 2 singularity. The plan
meets the criterion t_s . w_d = 0 where it crosses; the controller sees nothing of the
robot but the angles of its encoders.
"""

import numpy as np

from dextar_control import ControlLoop, default_settings, load_robot, plan_return_trip
from dextar_control.contract.resources import ROBOT_FILE, config_file
from dextar_control.model.exact_plant import ExactPlant
from dextar_control.model.robot import AnyRobot
from dextar_control.planning.certificate import Plan
from dextar_sim.plant import Plant

A, B = np.array([-0.025, 0.115]), np.array([0.01, 0.06])  # m
TURN = 2.0 * np.pi / 2**17  # rad, of one count of an encoder
HOLD = 0.1  # s, after the trip


def drive(
    robot: AnyRobot,
    plan: Plan,
    plant: ExactPlant | Plant,
    resolution: float = TURN,
    **settings: object,
) -> None:
    """Track a plan in a plain loop and print how the plant followed it."""
    start, side = plan.trajectory.at(0.0).x, np.sign(plan.certificate.profile.s[0])
    plant.reset(start)
    loop = ControlLoop(robot, default_settings(**settings), int(side), near=start)
    loop.accept(plan.trajectory)
    error = torque = 0.0  # the largest: m, N m
    while (state := plant.state()).time < plan.trajectory.duration + HOLD:
        tau = loop.step(state.time, np.round(state.q_a / resolution) * resolution)
        plant.step(tau)
        x_ref = plan.trajectory.at(state.time).x
        error = max(error, float(np.linalg.norm(x_ref - state.x)))
        torque = max(torque, float(np.abs(tau).max()))
    verdicts = ", ".join(passed.verdict.name.lower() for passed in loop.passed)
    unit = plan.certificate.joint.effort_unit
    print(f"the estimator says: {verdicts}; the loop is in phase {loop.phase.name}")
    print(
        f"largest true error {1e3 * error:.3f} mm, largest torque {torque:.4f} {unit}"
    )


def main() -> None:
    """There and back."""
    robot = load_robot(config_file(ROBOT_FILE))
    plan = plan_return_trip(robot, A, B, duration=0.33, dwell=0.2)
    print("\n".join(plan.certificate.lines()))
    drive(robot, plan, Plant(robot))


if __name__ == "__main__":
    main()
