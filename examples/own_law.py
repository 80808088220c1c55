"""A law of one's own: multipliers by damped least squares.

Eq. (4) divides by the least singular value of A_r. Damped, the division is by at least
2 DAMPING: nothing grows without bound near the locus, but the error along t_s is served
less and less there. The law's name is own_law:damped, in Python as on the command line:
``PYTHONPATH=examples dextar demo --law own_law:damped``.
"""

import casadi as ca
from crossing import A, B, drive

from dextar_control import load_robot, plan_return_trip
from dextar_control.contract.resources import ROBOT_FILE, config_file
from dextar_control.control.law import Answer, Asked
from dextar_sim.plant import Plant

DAMPING = 2e-3  # m, of singular values of A_r: those of the DexTAR reach 0.13


def damped(asked: Asked) -> Answer:
    """|A_r^T lambda - w_d|^2 + DAMPING^2 |lambda|^2 is least; then tau by Eq. (1)."""
    e = asked.here(asked.u)
    square = e.A_r @ e.A_r.T + DAMPING**2 * ca.SX.eye(e.A_r.shape[0])
    return Answer(e.w_b - e.B.T @ ca.solve(square, e.A_r @ e.w_d), e)


if __name__ == "__main__":
    robot = load_robot(config_file(ROBOT_FILE))
    plan = plan_return_trip(robot, A, B, duration=0.33, dwell=0.2)
    for law in ("consistent", "own_law:damped", "classic"):
        print(f"{law}:")
        drive(robot, plan, Plant(robot), law=law)
