"""The trajectory server: plans the return trip through the locus, says what it planned, serves it."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.srv import GetPlan
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from dextar_control.contract.errors import DextarError, TrajectoryError
from dextar_control.contract.node import DextarNode, Parameter, qos, run_node
from dextar_control.contract.topics import DIAGNOSTICS, TRAJECTORY
from dextar_control.core.certificate import certify, sample_times
from dextar_control.core.planner import PLAN_RESIDUAL, Plan, plan_approach, plan_crossing, plan_return_trip
from dextar_control.core.trajectory import Trajectory, join
from dextar_control.ros import messages

PARAMETERS = (
    Parameter("task.start", "A, m", size=2, live=True),
    Parameter("task.goal", "B, m", size=2, live=True),
    Parameter("duration", "of one way, s", 0.02, 60.0, live=True),
    Parameter("dwell", "at rest before, between and after, s", 0.01, 60.0, live=True),
    Parameter("repeat", "return trips", 1, 1000, live=True),
    Parameter("approach_speed", "peak speed of the way to the start, m/s", 1e-3, 2.0, live=True),
    Parameter("sample_period", "of the served trajectory's points, s", 1e-4, 0.02, live=True),
    Parameter("autostart", "serve the trip once it is planned and a controller is there"),
)

FRESH = 2.0  # s, age of the controller's diagnostics that still tells where the robot stands
AT_START = 1e-4  # m, closer than this needs no approach
DIAGNOSTICS_PERIOD = 1.0  # s
AUTOSTART_PERIOD = 0.1  # s


class TrajectoryServer(DextarNode):
    """Plans at start and on ``~/plan``; ``~/start`` serves the trip from where the robot stands.

    The way to A is a straight line that stays away from the locus; it is served with the trip as one
    trajectory. ``~/stop`` serves an empty trajectory: the controller stops safely.
    ``~/get_plan`` plans one way between any two poses (A and B where both are zero) and returns its path.
    """

    def __init__(self) -> None:
        super().__init__("trajectory_server", PARAMETERS, robot=True)
        self._plan: Plan | None = None
        self._served = 0
        self._error = ""
        self._controller: dict[str, str] = {}
        self._controller_time = -FRESH
        self._trajectory_publisher = self.create_publisher(MultiDOFJointTrajectory, TRAJECTORY.name, qos(TRAJECTORY))
        self.create_subscription(DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, qos(DIAGNOSTICS))
        self._replan()
        self.create_service(Trigger, "~/plan", self._on_plan)
        self.create_service(Trigger, "~/start", self._on_start)
        self.create_service(Trigger, "~/stop", self._on_stop)
        self.create_service(GetPlan, "~/get_plan", self._on_get_plan)
        self.create_timer(DIAGNOSTICS_PERIOD, self._diagnose, clock=self.steady_clock)
        self._stale = False
        self._waiting = self.values["autostart"]
        self.create_timer(AUTOSTART_PERIOD, self._autostart, clock=self.steady_clock)

    def on_parameters(self, changes: Mapping[str, Any]) -> None:
        """A changed task is planned again before it is served."""
        self._stale = True

    def _autostart(self) -> None:
        """Serve the planned trip once there is a controller, which refuses what is older than itself."""
        if self._waiting and self._plan is not None and self._controller:
            self._waiting = False
            self._serve(self._plan.trajectory)

    def _replan(self) -> str:
        """Plan the trip of the parameters; the certificate in words.

        Raises:
            DextarError: there is none within the limits.
        """
        values = self.values
        begin = time.perf_counter()
        self._plan = None
        self._plan = plan_return_trip(
            self.robot, np.array(values["task.start"]), np.array(values["task.goal"]),
            values["duration"], values["dwell"], values["repeat"],
        )  # fmt: skip
        self._stale = False
        text = "; ".join(self._plan.certificate.lines())
        self.get_logger().info(f"planned in {time.perf_counter() - begin:.2f} s: {text}")
        return text

    def _serve(self, trajectory: Trajectory) -> None:
        certificate = certify(self.robot, trajectory, max_residual=PLAN_RESIDUAL, period=self.values["sample_period"])
        times = np.union1d(sample_times(trajectory, self.values["sample_period"]), certificate.crossing_times)
        times = times[np.concatenate([[True], np.diff(times) > 2e-9])]
        self._trajectory_publisher.publish(messages.from_trajectory(trajectory, times))
        self._served += 1
        self.get_logger().info(f"served {len(times)} points over {trajectory.duration:.3f} s")

    def _from_robot(self) -> Trajectory:
        """The trip, with the way to its start before it.

        Raises:
            DextarError: no plan, no controller that holds, or no way to the start off the locus.
        """
        if self._plan is None or self._stale:
            self._replan()
        if self._plan is None:
            raise TrajectoryError("there is no plan")
        age = time.monotonic() - self._controller_time
        if age > FRESH:
            raise TrajectoryError(f"no word of the controller on {DIAGNOSTICS.name} for {FRESH:.1f} s")
        phase = self._controller.get("phase", "")
        if phase != "HOLD":
            raise TrajectoryError(f"the controller is in phase {phase}; a trip starts from HOLD")
        robot = np.array([float(self._controller["x"]), float(self._controller["y"])])
        start = self._plan.trajectory.at(0.0).x
        if not np.isfinite(robot).all():
            raise TrajectoryError("the controller has had no state yet")
        if float(np.hypot(*(robot - start))) < AT_START:
            return self._plan.trajectory
        return join([plan_approach(self.robot, robot, start, self.values["approach_speed"]), self._plan.trajectory])

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        wanted = f"{self.get_namespace().rstrip('/')}/controller"
        for status in message.status:
            if status.name == wanted:
                self._controller = {item.key: item.value for item in status.values}
                self._controller_time = time.monotonic()

    def _on_plan(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message, response.success, self._error = self._replan(), True, ""
        except DextarError as error:
            self._refuse(response, error)
        return response

    def _on_start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            trajectory = self._from_robot()
            self._serve(trajectory)
            response.success, self._error = True, ""
            response.message = f"served {trajectory.duration:.3f} s"
        except DextarError as error:
            self._refuse(response, error)
        return response

    def _refuse(self, response: Trigger.Response, error: DextarError) -> None:
        self._error = str(error)
        self.get_logger().error(self._error)
        response.success, response.message = False, self._error

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._trajectory_publisher.publish(messages.stop_trajectory())
        response.success, response.message = True, "stop served"
        return response

    def _on_get_plan(self, request: GetPlan.Request, response: GetPlan.Response) -> GetPlan.Response:
        ends = [request.start.pose.position, request.goal.pose.position]
        start, goal = (np.array([point.x, point.y]) for point in ends)
        if not start.any() and not goal.any():
            start, goal = np.array(self.values["task.start"]), np.array(self.values["task.goal"])
        try:
            plan = plan_crossing(self.robot, start, goal, self.values["duration"])
        except DextarError as error:
            self._error = str(error)
            self.get_logger().error(f"get_plan: {error}")
            return response
        response.plan = messages.to_path(plan.trajectory, plan.certificate.profile.time)
        return response

    def _diagnose(self) -> None:
        values: dict[str, object] = {"served": self._served, "error": self._error}
        if self._plan is not None:
            certificate = self._plan.certificate
            values |= {
                "crossing_times": certificate.crossing_times.tolist(),
                "residuals": certificate.residuals.tolist(),
                "multipliers": certificate.multipliers.tolist(),
                "peak_torque": certificate.peak_torque,
                "duration": certificate.duration,
            }
        level = DiagnosticStatus.WARN if self._error else DiagnosticStatus.OK
        self.publish_diagnostics(level, self._error or "planned", values)

    def close(self) -> None:
        """A last word."""
        self._diagnose()


def main(args: list[str] | None = None) -> int:
    """Console entry."""
    return run_node(TrajectoryServer, args)


if __name__ == "__main__":
    sys.exit(main())
