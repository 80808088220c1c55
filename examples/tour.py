"""Plan a tour: crossings spread over the Type 2 locus, one after the other without a
stop.

Each crossing meets the criterion t_s . w_d = 0; the tour as a whole is checked against
the robot's limits and drawn. Planning alone: nothing moves.

Run it with ``.venv/bin/python examples/tour.py [CROSSINGS] [FIGURE]``.
"""

import sys

from dextar_control import load_robot, plan_tour
from dextar_control.analysis.plan_figure import draw_plan
from dextar_control.contract.resources import ROBOT_FILE, config_file


def main(crossings: int = 6, figure: str = "tour.png") -> None:
    """Print a line about each crossing and write the figure."""
    robot = load_robot(config_file(ROBOT_FILE))
    tour = plan_tour(robot, crossings)
    certificate = tour.certificate
    for number, crossing in enumerate(certificate.crossings, start=1):
        x, y = crossing.x
        print(
            f"{number}: {crossing.time:6.3f} s at ({1e3 * x:6.1f}, {1e3 * y:6.1f}) mm,"
            f" {crossing.family}, {crossing.speed:.2f} m/s along t_s,"
            f" t_s.w_d = {crossing.residual:.0e} N"
        )
    print(
        f"{len(certificate.crossings)} crossings in {certificate.duration:.2f} s,"
        f" peak torque {certificate.peak_torque:.3f} of {robot.max_torque:g} N m"
    )
    draw_plan(robot, tour).savefig(figure)
    print(f"drawn in {figure}")


if __name__ == "__main__":
    main(*(kind(given) for kind, given in zip((int, str), sys.argv[1:], strict=False)))
