"""Trajectories as they arrive at the controller: read and checked beside the loop, kept until they begin or are too old."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

from trajectory_msgs.msg import MultiDOFJointTrajectory

from dextar_control.contract.cdr import NANOSECONDS, from_time, read_message
from dextar_control.contract.errors import TrajectoryError
from dextar_control.contract.node import DextarNode, qos
from dextar_control.contract.topics import MAX_TRAJECTORY_POINTS, TRAJECTORY
from dextar_control.core.certificate import Certificate
from dextar_control.core.trajectory import Trajectory
from dextar_control.ros import messages


class Reference(NamedTuple):
    """A trajectory that was checked."""

    trajectory: Trajectory
    certificate: Certificate
    start: float | None  # in the time of the states, s; None is at once


class ReferenceReader:
    """Polled subscription of ``trajectory``: the newest one counts.

    One that was served before the controller was active, or long before it arrived, is refused: a latched or
    delayed trajectory moves nothing by surprise. Reading and checking take a thread of their own (a long one takes
    tenths of a second).

    Args:
        node: that subscribes.
        check: raises TrajectoryError for a trajectory that cannot be tracked.
    """

    def __init__(self, node: DextarNode, check: Callable[[Trajectory], Certificate]) -> None:
        self._node = node
        self._check = check
        self._subscription = node.create_polled_subscription(MultiDOFJointTrajectory, TRAJECTORY.name, qos(TRAJECTORY))
        self._checker = ThreadPoolExecutor(max_workers=1)
        self._checking: Future[Reference | None] | None = None
        self._since = time.time_ns()

    def restart(self, check: Callable[[Trajectory], Certificate]) -> None:
        """From now on, with this check: what was served until now counts no more."""
        self._since, self._check = time.time_ns(), check
        self.drop()
        while self._subscription.handle.take_message(MultiDOFJointTrajectory, True) is not None:
            pass

    def drop(self) -> None:
        """Forget what is being checked."""
        if self._checking is not None:
            self._checking.cancel()
            self._checking = None

    @property
    def checking(self) -> bool:
        """Whether an answer of ``poll`` is to come."""
        return self._checking is not None

    def poll(self, max_age: float) -> tuple[Reference | None] | None:
        """What was read and checked since the last call: a reference, or (None,) for a stop.

        Args:
            max_age: from where it was served to here, s.

        Raises:
            TrajectoryError: it is refused; names the value and the limit.
        """
        newest = None
        while (taken := self._subscription.handle.take_message(MultiDOFJointTrajectory, True)) is not None:
            newest = taken
        if newest is not None:
            raw, info = newest
            self.drop()
            self._checking = self._checker.submit(
                self._read, bytes(raw), info["source_timestamp"], info["received_timestamp"], max_age
            )
        if self._checking is None or not self._checking.done():
            return None
        checking, self._checking = self._checking, None
        return (checking.result(),)

    def _read(self, raw: bytes, served: int, arrived: int, max_age: float) -> Reference | None:
        if served < self._since:
            before = (self._since - served) / NANOSECONDS
            raise TrajectoryError(f"it was served {before:.1f} s before this controller began; serve it again")
        age = (arrived - served) / NANOSECONDS
        if age > max_age:
            raise TrajectoryError(f"it was served {age:.1f} s before it arrived; the limit is {max_age:g} s")
        message = read_message(raw, TRAJECTORY.type)
        if len(message.points) == 0:
            return None
        if len(message.points) > MAX_TRAJECTORY_POINTS:
            raise TrajectoryError(f"the trajectory has {len(message.points)} points; the limit is {MAX_TRAJECTORY_POINTS}")
        stamp = from_time(message.header.stamp)
        trajectory = messages.to_trajectory(message)
        return Reference(trajectory, self._check(trajectory), stamp / NANOSECONDS if stamp else None)

    def close(self) -> None:
        """Destroy the subscription; what is being checked is given up."""
        self._checker.shutdown(wait=False, cancel_futures=True)
        self._node.destroy_subscription(self._subscription)
