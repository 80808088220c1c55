"""The trajectory server plans a trip or a tour through the locus, tells and draws the
plan, and serves it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.srv import GetPlan
from rclpy.service import Service
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from dextar_control.contract.errors import DextarError, TrajectoryError
from dextar_control.contract.node_parameters import PARAMETERS
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.signals import EXIT_USAGE
from dextar_control.contract.topics import (
    DIAGNOSTICS,
    MAX_TRAJECTORY_POINTS,
    TRAJECTORY,
)
from dextar_control.nodekit.job_queue import Done, GivenUp, JobQueue
from dextar_control.nodekit.node import DextarNode, qos, run_node
from dextar_control.nodekit.services import type_of
from dextar_control.nodes import messages
from dextar_control.nodes.next_step import command, why_not
from dextar_control.nodes.task import Task, in_words, place_told, plan_from
from dextar_control.planning.certificate import Certificate
from dextar_control.planning.planner import Plan
from dextar_control.planning.profile import sample_times
from dextar_control.planning.search import Progress
from dextar_control.planning.trajectory import Trajectory
from dextar_control.symbols.types import Array

# s, age of the controller's diagnostics that still tells where the robot stands
FRESH = 2.0
COARSEST = 0.005  # s between the served points of a long tour
RESOLUTION = 130  # dots per inch of the drawing
MOST_TOLD = 60  # crossings that the diagnostics repeat each second
DIAGNOSTICS_PERIOD = 1.0  # s
POLL_PERIOD = 0.05  # s
TELL_PERIOD = 1.0  # s between two lines about the progress


class ServedTrip(NamedTuple):
    """A trajectory ready to be published."""

    plan: Plan
    task: Task
    certificate: Certificate  # of the whole, the way to the start included
    message: MultiDOFJointTrajectory


class TrajectoryServer(DextarNode):
    """Plans at start and on ``~/plan``; ``~/start`` serves the trip from where the
    robot stands.

    What is planned are the parameters of ``Task``. The way to its start, on one side of
    the locus, is served with the trip as one trajectory. ``~/stop`` serves an empty
    trajectory: the controller stops safely. A trip that is still being planned then is
    not served. ``~/get_plan`` plans one way between any two poses (A and B where both
    are zero) and returns its path.

    Planning runs in a thread of its own; the services that need it answer when it is
    done, ``~/stop`` at once.
    """

    NAME = "trajectory_server"
    PARAMETERS = PARAMETERS[NAME]

    def __init__(self) -> None:
        super().__init__()
        self._task = Task.from_values(self.values)
        self._planned: tuple[Task, Plan] | None = None
        self._drawn: tuple[Task, str] | None = None
        self._certificate: Certificate | None = None
        self._served = 0
        self._error = ""
        self._controller: dict[str, str] = {}
        self._controller_time = -FRESH
        self._jobs = JobQueue()
        self._told = (0.0, "")
        self._starting: object | None = None  # the trip that is planned to be served
        self._trajectory_publisher = self.create_publisher(
            MultiDOFJointTrajectory, TRAJECTORY.name, qos(TRAJECTORY)
        )
        self.create_subscription(
            DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, qos(DIAGNOSTICS)
        )
        self._requests = [
            (self.create_polled_service(Trigger, "~/plan"), self._on_plan),
            (self.create_polled_service(Trigger, "~/start"), self._on_start),
            (self.create_polled_service(GetPlan, "~/get_plan"), self._on_get_plan),
        ]
        self.create_service(Trigger, "~/stop", self._on_stop)
        self._waiting = self.values["autostart"]
        self._jobs.submit(self._plan_of(self._task), self._on_first_plan)
        self.create_timer(POLL_PERIOD, self._poll, clock=self.steady_clock)
        self.create_timer(DIAGNOSTICS_PERIOD, self._diagnose, clock=self.steady_clock)

    def on_parameters(self, changes: Mapping[str, ParameterValue]) -> None:
        """Take a changed task, which is planned before it is served."""
        self._task = Task.from_values(self.values)

    def _poll(self) -> None:
        """Take requests and results, and serve the trip once there is a controller,
        which refuses what is older than itself.
        """
        for service, answer in self._requests:
            while (
                taken := service.handle.service_take_request(type_of(service).Request)
            )[1] is not None:
                answer(service, *taken)
        self._jobs.poll()
        self._tell_progress()
        if self._waiting and self._planned is not None and not self._why_not():
            self._submit_trip(self._serve)
            self._waiting = False

    def _tell_progress(self) -> None:
        now, stage = time.monotonic(), self._jobs.stage
        if stage and stage != self._told[1] and now - self._told[0] > TELL_PERIOD:
            self._told = now, stage
            self.get_logger().info(f"planning, {self._jobs.fraction:.0%}: {stage}")
            self._diagnose()

    def _plan_of(
        self, wanted: Task, progress: Progress | None = None
    ) -> Callable[[], tuple[Task, Plan]]:
        """Return a job: the plan of a task, drawn where that is asked for and nobody
        waits.
        """
        drawing = "" if self._waiting else self.values["drawing"]

        def work() -> tuple[Task, Plan]:
            known = self._planned
            if known is not None and known[0] == wanted:
                plan = known[1]
            else:
                begin = time.perf_counter()
                plan = wanted.plan(self.robot, progress or self._jobs.progress)
                self._jobs.progress(1.0, "")  # what is left to do is no planning
                self.get_logger().info(
                    f"planned in {time.perf_counter() - begin:.2f} s:"
                    f" {in_words(plan.certificate)}"
                )
            if drawing and self._drawn != (wanted, drawing):
                _draw(self.robot, plan, drawing)
                self._drawn = wanted, drawing
            return wanted, plan

        return work

    def _trip(self, origin: Array, progress: Progress) -> Callable[[], ServedTrip]:
        """Return a job: the planned trip with the way from where the robot stands
        before it, as a message.
        """
        plan_now = self._plan_of(self._task, progress)
        names = "task.approach_speed", "trajectory.sample_period"
        speed, period = (self.values[name] for name in names)

        def work() -> ServedTrip:
            wanted, plan = plan_now()
            trajectory, certificate = plan_from(self.robot, origin, plan, speed)
            times = served_times(trajectory, certificate, period)
            return ServedTrip(
                plan, wanted, certificate, messages.from_trajectory(trajectory, times)
            )

        return work

    def _submit_trip(self, done: Done[ServedTrip]) -> None:
        """Plan the trip from where the robot stands, for ``done`` to serve it, unless
        ``~/stop`` is called before.
        """
        self._starting = starting = object()
        stopped = GivenUp(
            "the trip is not served: a stop was asked for while it was planned"
        )

        def progress(fraction: float, stage: str) -> None:
            if self._starting is not starting:
                raise stopped
            self._jobs.progress(fraction, stage)

        def planned(served: ServedTrip | None, error: DextarError | None) -> None:
            if self._starting is starting:
                self._starting = None
                done(served, error)
            else:
                done(None, error or stopped)

        self._jobs.submit(self._trip(self._origin(), progress), planned)

    def _origin(self) -> Array:
        """Return where the robot stands as far as is known, else A; (2,), m."""
        x = place_told(self._controller)
        return np.array(self._task.start) if x is None else x

    def _publish(self, served: ServedTrip) -> str:
        self._planned = served.task, served.plan
        self._certificate = served.certificate
        self._trajectory_publisher.publish(served.message)
        self._served += 1
        self._error = ""
        points, duration = len(served.message.points), served.certificate.duration
        text = f"served {points} points over {duration:.3f} s"
        self.get_logger().info(text)
        self._diagnose(whole=True)
        return text

    def _check_robot(self) -> None:
        """Raise TrajectoryError unless the controller holds the robot somewhere
        known.
        """
        if time.monotonic() - self._controller_time > FRESH:
            raise TrajectoryError(
                f"no word of {self._controller_name} on {DIAGNOSTICS.name} for"
                f" {FRESH:.1f} s; see that it runs"
            )
        if reason := self._why_not():
            raise TrajectoryError(reason)
        if place_told(self._controller) is None:
            raise TrajectoryError(
                "the controller has had no joint state yet; see that the rig or plant"
                " runs"
            )

    def _why_not(self) -> str:
        """Return why the controller would not take a trajectory now; empty when it
        would.
        """
        return why_not(self._controller_name, self._controller)

    @property
    def _controller_name(self) -> str:
        return f"{self.get_namespace().rstrip('/')}/controller"

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._controller_name:
                self._controller = {item.key: item.value for item in status.values}
                self._controller_time = time.monotonic()

    def _on_first_plan(
        self, planned: tuple[Task, Plan] | None, error: DextarError | None
    ) -> None:
        """Take the first plan; a server whose parameters have no plan ends as one with
        a wrong parameter does.
        """
        if error is not None:
            self._error = str(error)
            print(f"error: {error}", file=sys.stderr)
            self.finish(EXIT_USAGE)
            return
        self._take(planned)

    def _serve(self, served: ServedTrip | None, error: DextarError | None) -> str:
        """Publish a trip, or log why there is none; return that in words."""
        return self._note(error) if served is None else self._publish(served)

    def _take(self, planned: tuple[Task, Plan] | None) -> None:
        if planned is not None:
            self._planned, self._error = planned, ""
            self._certificate = planned[1].certificate
            self._diagnose(whole=True)

    def _note(self, error: DextarError | None) -> str:
        """Log a refusal, and return it in words."""
        self._error = str(error)
        self.get_logger().error(self._error)
        self._diagnose()
        return self._error

    def _on_plan(self, service: Service, _: Trigger.Request, header: object) -> None:
        def done(planned: tuple[Task, Plan] | None, error: DextarError | None) -> None:
            self._take(planned)
            message = (
                self._note(error)
                if planned is None
                else in_words(planned[1].certificate)
            )
            service.send_response(
                Trigger.Response(success=planned is not None, message=message), header
            )

        self._jobs.submit(self._plan_of(self._task), done)

    def _on_start(self, service: Service, _: Trigger.Request, header: object) -> None:
        def done(served: ServedTrip | None, error: DextarError | None) -> None:
            message = self._serve(served, error)
            service.send_response(
                Trigger.Response(success=served is not None, message=message), header
            )

        try:
            if self._starting is not None:
                stop = command(self._controller_name, "stop")
                raise TrajectoryError(
                    "another trip is being planned and starts then: wait, or type"
                    f" {stop}"
                )
            self._check_robot()
        except DextarError as error:
            done(None, error)
            return
        self._submit_trip(done)

    def _on_get_plan(
        self, service: Service, request: GetPlan.Request, header: object
    ) -> None:
        ends = [request.start.pose.position, request.goal.pose.position]
        start, goal = (np.array([point.x, point.y]) for point in ends)
        wanted = self._task
        if not start.any() and not goal.any():
            start, goal = np.array(wanted.start), np.array(wanted.goal)

        def done(plan: Plan | None, error: DextarError | None) -> None:
            response = GetPlan.Response()
            if plan is None:
                self._note(error)
            else:
                response.plan = messages.to_path(
                    plan.trajectory, plan.certificate.profile.time
                )
            service.send_response(response, header)

        self._jobs.submit(
            lambda: wanted.plan_between(self.robot, start, goal, self._jobs.progress),
            done,
        )

    def _on_stop(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        self._starting, self._waiting = None, False
        self._trajectory_publisher.publish(messages.stop_trajectory())
        response.success, response.message = True, "stop served"
        return response

    def _diagnose(self, whole: bool = False) -> None:
        """Publish how far planning is, and the certificate; with ``whole`` all its
        crossings, however many.
        """
        jobs = self._jobs
        planning = f"{jobs.fraction:.0%}, {jobs.stage}" if jobs.stage else ""
        values: dict[str, object] = {
            "served": self._served,
            "error": self._error,
            "planning": planning,
            "waiting_for": self._why_not() if self._waiting else "",
        }
        certificate = self._certificate
        if certificate is not None:
            told = (
                certificate
                if whole
                else certificate._replace(crossings=certificate.crossings[:MOST_TOLD])
            )
            values |= {
                "crossings": len(certificate.crossings),
                "peak_torque": certificate.peak_torque,
                "duration": certificate.duration,
                "certificate": told.to_json(),
            }
        trouble = self._error or self.too_many_publishers(
            self._trajectory_publisher.topic_name
        )
        level = DiagnosticStatus.WARN if trouble else DiagnosticStatus.OK
        state = "planning" if certificate is None or planning else "planned"
        self.publish_diagnostics(level, trouble or state, values)

    def close(self) -> None:
        """Give up a plan under way, publish diagnostics, and make the drawing that
        nobody waited for.
        """
        self._jobs.close()
        self._diagnose()
        if (
            self.values["autostart"]
            and self.values["drawing"]
            and self._planned is not None
            and self._drawn is None
        ):
            try:
                _draw(self.robot, self._planned[1], self.values["drawing"])
            except TrajectoryError as error:
                self.get_logger().error(str(error))


def served_times(
    trajectory: Trajectory, certificate: Certificate, period: float
) -> Array:
    """Return when a trajectory is sampled, (m,), s: every period, at its knots and at
    its crossings; a long one less often.

    Args:
        trajectory: that is served.
        certificate: of it.
        period: between two points, s.

    Raises:
        TrajectoryError: even COARSEST apart there are more than MAX_TRAJECTORY_POINTS.
    """
    while True:
        times: Array = np.union1d(
            sample_times(trajectory, period), certificate.crossing_times
        )
        times = times[np.concatenate([[True], np.diff(times) > 2e-9])]
        if len(times) <= MAX_TRAJECTORY_POINTS:
            return times
        if period >= COARSEST:
            raise TrajectoryError(
                f"the trajectory of {trajectory.duration:.0f} s has {len(times)} points"
                f" {1e3 * period:g} ms apart; the limit is {MAX_TRAJECTORY_POINTS}"
                " points: repeat it less often"
            )
        period = min(period * len(times) / MAX_TRAJECTORY_POINTS * 1.01, COARSEST)


def _draw(robot: RobotParameters, plan: Plan, drawing: str) -> None:
    """Draw a plan into a file.

    Raises:
        TrajectoryError: the picture cannot be written.
    """
    from dextar_control.analysis.plan_figure import draw_plan

    path = Path(drawing).expanduser()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        draw_plan(robot, plan).savefig(path, dpi=RESOLUTION)
    except (OSError, ValueError) as error:
        raise TrajectoryError(f"the plan cannot be drawn to {path}: {error}") from error


def main(args: list[str] | None = None) -> int:
    """Run the trajectory server; return the exit code."""
    return run_node(TrajectoryServer, args)


if __name__ == "__main__":
    sys.exit(main())
