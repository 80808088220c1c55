"""The action ``go`` does for programs what ``dextar go`` does. This module loads only
where ``dextar_interfaces`` is installed.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable

from dextar_interfaces.action import Go
from rclpy.action.server import ActionServer, CancelResponse, ServerGoalHandle
from rclpy.executors import Executor, MultiThreadedExecutor

from dextar_control.contract.errors import DextarError, ParameterError
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.signals import Interrupted, StopSignal
from dextar_control.contract.topics import GO
from dextar_control.nodekit.client import TICK
from dextar_control.nodekit.node import RunnableNode, run_node
from dextar_control.nodes.operator import OperatorClient, TripFollower, task_values

LAST_RESULT = 1.0  # s in which the result of a trip that a signal ended is sent


class GoalStop:
    """True once the goal's client cancels it, or a signal asks this process to end."""

    def __init__(self, goal: ServerGoalHandle, signals: StopSignal | None) -> None:
        self._goal, self._signals = goal, signals

    def __bool__(self) -> bool:
        return bool(self._signals) or self._goal.is_cancel_requested

    def check(self) -> None:
        """Raise ``Interrupted`` once it is true."""
        if self:
            raise Interrupted


class GoServer(OperatorClient, RunnableNode):
    """Offers the action go, which starts a trip of the robot whose nodes run in this
    namespace and follows it to its end.

    It takes one goal at a time. Cancelling it is a safe stop, and so is the end of this
    process while a trip is under way. A goal that cannot be is aborted, and the
    result's message says why and what to do.
    """

    NAME = "go_server"

    def __init__(self) -> None:
        self.signals: StopSignal | None = None
        self.busy = threading.Lock()
        super().__init__("", name=self.NAME)
        self._server = ActionServer(
            self, Go, GO, self._execute, cancel_callback=lambda _: CancelResponse.ACCEPT
        )
        self.get_logger().info(f"action {self.full(GO)}")

    def turn(self) -> None:
        """Wait a moment; another thread hears meanwhile."""
        time.sleep(TICK)

    def _execute(self, goal: ServerGoalHandle) -> Go.Result:
        result = Go.Result()
        if not self.busy.acquire(blocking=False):
            goal.abort()
            result.message = (
                f"another goal of {self.full(GO)} is under way: cancel it, or wait"
                " until it ends"
            )
            return result
        lines: list[str] = []
        good = False
        try:
            self.stop = GoalStop(goal, self.signals)
            good = self._go(goal, result, lines.append)
        except DextarError as error:
            lines.append(str(error))
        except Interrupted:
            pass  # the lines say how it was stopped
        finally:
            self.busy.release()
        result.message = "\n".join(lines)
        self.get_logger().info(result.message)
        if good:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return result

    def _go(
        self, goal: ServerGoalHandle, result: Go.Result, say: Callable[[str], None]
    ) -> bool:
        """Start the goal's trip and follow it; return whether it was done and every
        planned crossing crossed.
        """

        def show(text: str, share: float) -> None:
            told = (
                self.controller
                if trip.begun
                else {"phase": text.split(":")[0].upper()}
                | {key: self.controller[key] for key in ("s", "mode_confidence")}
            )
            goal.publish_feedback(
                Go.Feedback(
                    phase=told["phase"],
                    crossing=int(told.get("begun", 0)),
                    crossings=int(told.get("crossings", 0)),
                    s=float(told["s"]),
                    confidence=float(told["mode_confidence"]),
                    progress=share,
                )
            )

        self.status.clear()  # of nodes that may have ended
        trip = TripFollower(self, show, say)
        good = trip.run(values_of(goal.request))
        result.done, result.bag = trip.done, trip.bag
        result.verdicts = [verdict for verdict, _ in trip.verdicts]
        result.confidences = [float(confidence) for _, confidence in trip.verdicts]
        if trip.begun:
            result.largest_error = float(self.controller["largest_error"])
        return good

    def close(self) -> None:
        """Take no more goals."""
        self._server.destroy()


def values_of(request: Go.Goal) -> dict[str, ParameterValue]:
    """Return the trajectory server's parameters that a goal asks for.

    Raises:
        ParameterError: the task is unknown, or a tour without crossings.
    """
    if not Go.Goal.AS_SET <= request.task <= Go.Goal.POINT:
        raise ParameterError(
            f"task = {request.task}; it must be 0 (as set), 1 (trip), 2 (tour) or 3"
            " (point)"
        )
    tour = {Go.Goal.TRIP: 0, Go.Goal.TOUR: request.crossings}.get(request.task)
    if request.task == Go.Goal.TOUR and not tour:
        raise ParameterError(
            "crossings = 0 for a tour; it must be 1 to 1000, or negative for the other"
            " way round"
        )
    return task_values(
        {
            "tour": tour,
            "point": request.point.tolist() if request.task == Go.Goal.POINT else None,
            "excite": None,
            "duration": None if request.duration < 0.0 else request.duration,
            "repeat": request.repeat or None,
        }
    )


def spin(node: GoServer, _: Executor, stop: StopSignal) -> None:
    """Serve goals until a signal; a trip that is under way then is stopped first."""
    node.signals = stop
    executor = MultiThreadedExecutor(num_threads=2)  # a trip takes one, the other hears
    executor.add_node(node)
    deadline = None
    while deadline is None or time.monotonic() < deadline:
        executor.spin_once(timeout_sec=TICK)
        if deadline is None and stop and not node.busy.locked():
            deadline = time.monotonic() + LAST_RESULT
    executor.shutdown()


def main(args: list[str] | None = None) -> int:
    """Serve the action; return the exit code."""
    return run_node(GoServer, args, spin)


if __name__ == "__main__":
    sys.exit(main())
