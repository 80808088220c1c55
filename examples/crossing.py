"""A crossing in a plain loop: plan, simulate, estimate, control; no ROS.

The DexTAR goes from A to B and back to A, each way through a Type 2 singularity. The
plan meets the criterion t_s . w_d = 0 where it crosses; the controller sees nothing of
the robot but the two angles of its encoders.

Run it with ``.venv/bin/python examples/crossing.py``.
"""

import numpy as np

from dextar_control import ControlLoop, default_settings, load_robot, plan_return_trip
from dextar_control.contract.resources import ROBOT_FILE, config_file
from dextar_sim.plant import Plant

A, B = np.array([-0.025, 0.115]), np.array([0.01, 0.06])  # m
TURN = 2.0 * np.pi / 2**17  # rad, of one count of an encoder
HOLDING = 0.1  # s, after the trip


def main() -> None:
    """Print what was planned and how the robot followed it."""
    robot = load_robot(config_file(ROBOT_FILE))
    plan = plan_return_trip(robot, A, B, duration=0.33, dwell=0.2)
    print("\n".join(plan.certificate.lines()))

    plant = Plant(robot)
    plant.reset(A.tolist())
    loop = ControlLoop(robot, default_settings(), assembly_mode=1)
    loop.accept(plan.trajectory)

    error, torque = 0.0, 0.0  # the largest: m, N m
    while (state := plant.state()).time < plan.trajectory.duration + HOLDING:
        q_a = np.round(state.q_a / TURN) * TURN
        tau = loop.step(state.time, q_a)
        plant.step(tau.tolist())
        x_ref = plan.trajectory.at(state.time).x
        error = max(error, float(np.linalg.norm(x_ref - state.x)))
        torque = max(torque, float(np.abs(tau).max()))
    plant.close()

    verdicts = ", ".join(passed.verdict.name.lower() for passed in loop.passed)
    print(
        f"the estimator's verdicts: {verdicts}; the loop is in phase {loop.phase.name}"
    )
    print(f"largest true error {1e3 * error:.3f} mm, largest torque {torque:.4f} N m")


if __name__ == "__main__":
    main()
