"""An estimator of one's own: a Luenberger observer over the platform's dynamics.

It predicts by the forward dynamics, which are regular on the locus, and corrects by
the joints through a damped inverse of J_inv: what they do not tell is left alone there.
Its name is own_estimator:Luenberger, in Python as on the command line.
"""

import numpy as np
from crossing import A, B, drive

from dextar_control import load_robot, plan_return_trip
from dextar_control.contract.resources import ROBOT_FILE, config_file
from dextar_control.estimation.estimate import Estimator
from dextar_control.symbols.types import Array
from dextar_sim.plant import Plant

DAMPING = 3.0  # 1/m, of singular values of J_inv: those of the DexTAR are about 10
GAIN, RATE_GAIN = 0.3, 30.0  # 1 and 1/s, of what the joints are off


class Luenberger(Estimator):
    """Constant gains; it cannot tell a crossing from a bounce."""

    def start(self, x: Array, q_a: Array, assembly_mode: int) -> None:
        """At rest."""
        self.believe(assembly_mode, 1.0)
        self.show(x, np.zeros(len(x)))

    def observe(self, dt: float, q_a: Array, tau: Array) -> None:
        """Predict, then correct."""
        model, x, x_dot = self.model, self.estimate.x, self.estimate.x_dot
        x_ddot = model.platform_dynamics(model.place(x).q_a, x, x_dot, tau).x_ddot
        x, x_dot = x + dt * (x_dot + 0.5 * dt * x_ddot), x_dot + dt * x_ddot
        expected = model.place(x).q_a
        J = model.state(expected, x, x_dot).J_inv
        off = np.remainder(q_a - expected + np.pi, 2.0 * np.pi) - np.pi
        step = J.T @ np.linalg.solve(J @ J.T + DAMPING**2 * np.eye(len(x)), off)
        self.show(x + GAIN * step, x_dot + RATE_GAIN * step)


if __name__ == "__main__":
    robot = load_robot(config_file(ROBOT_FILE))
    plan = plan_return_trip(robot, A, B, duration=0.33, dwell=0.2)
    for estimator in ("observer", "own_estimator:Luenberger", "dgm"):
        print(f"{estimator}:")
        drive(robot, plan, Plant(robot), estimator=estimator)
