"""Trajectories that arrive at the controller are read and checked beside the loop, and
kept until they begin or are too old.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

from trajectory_msgs.msg import MultiDOFJointTrajectory

from dextar_control.contract.errors import DextarError, TrajectoryError
from dextar_control.contract.topics import MAX_TRAJECTORY_POINTS, TRAJECTORY
from dextar_control.control.loop import ControlLoop
from dextar_control.nodekit.cdr import NANOSECONDS, from_time, read_message
from dextar_control.nodekit.node import DextarNode, qos
from dextar_control.nodes import messages
from dextar_control.nodes.next_step import next_step
from dextar_control.nodes.task import in_words
from dextar_control.planning.certificate import Certificate
from dextar_control.planning.trajectory import Trajectory


class Reference(NamedTuple):
    """A trajectory that was checked."""

    trajectory: Trajectory
    certificate: Certificate
    start: float | None  # in the time of the states, s; None is at once


class Waiting(NamedTuple):
    """An accepted trajectory that has not begun."""

    reference: Reference
    since: float  # s of the caller's clock; nan until there is one
    scheduled: bool  # for its start; otherwise it waits for the automatic enabling


class ReferenceReader:
    """Reads ``trajectory`` by polling; the newest one counts.

    A trajectory that was served before the controller was active, or long before it
    arrived, is refused: a latched or delayed one moves nothing by surprise. One that
    has waited too long to begin is dropped. Reading and checking, which take tenths of
    a second for a long one, have a thread of their own.

    How old it is when it arrives is the difference of two times of the system clocks,
    the server's and this machine's; how long the controller has been active is measured
    on a clock that does not step. So a system clock that is set while both run costs at
    most the trajectory that is on its way.

    Args:
        node: that subscribes, and whose log tells what became of a trajectory.

    Attributes:
        note: what became of the last one: none, checking, accepted, stop or refused,
            with the reason.
        arrived: how many have been read.
        waiting: the one that is accepted and has not begun.
    """

    def __init__(self, node: DextarNode) -> None:
        self._node = node
        self._subscription = node.create_polled_subscription(
            MultiDOFJointTrajectory, TRAJECTORY.name, qos(TRAJECTORY)
        )
        self._checker = ThreadPoolExecutor(max_workers=1)
        self._checking: Future[Reference | None] | None = None
        self._clock = node.unstepped_clock
        self._since = self._clock.now()
        self.note = "none"
        self.arrived = 0
        self.waiting: Waiting | None = None

    def restart(self) -> None:
        """Forget every trajectory that was served until now."""
        self._since = self._clock.now()
        self.drop()
        if self._newest() is not None:
            self.refuse("it was served before this controller began; serve it again")

    def drop(self) -> None:
        """Forget what waits and what is being checked."""
        self.waiting = None
        if self._checking is not None:
            self._checking.cancel()
            self._checking = None

    def refuse(self, reason: str) -> None:
        """Tell that the last trajectory is refused, or that the waiting
        one is dropped.
        """
        self.waiting = None
        self.note = f"refused: {reason}"
        self._node.get_logger().error(f"trajectory refused: {reason}")

    def poll(
        self,
        loop: ControlLoop,
        limits: Mapping[str, float],
        clock: float,
        now: float,
        keep: bool,
    ) -> bool:
        """Read, check, hand over to the loop, and drop what has waited too long; return
        whether ``note`` changed.

        Args:
            loop: that tracks the trajectory.
            limits: the parameters ``trajectory.max_age`` and
                ``trajectory.wait_timeout``, s.
            clock: by which waiting is measured, s; nan while there is none.
            now: of the last state, s; nan before the first.
            keep: whether the loop cannot take one yet, but is going to.
        """
        before = self.note
        try:
            if (taken := self._take(loop, limits["trajectory.max_age"])) is not None:
                before = ""
                self._admit(
                    loop, taken[0], limits["trajectory.wait_timeout"], clock, now, keep
                )
            self._drop_old(loop, limits["trajectory.wait_timeout"], clock)
        except DextarError as error:
            before = ""
            self.refuse(str(error))
        return self.note != before

    def begin(self, loop: ControlLoop) -> None:
        """Hand over the trajectory that was kept until the loop holds."""
        waiting = self.waiting
        if waiting is None or waiting.scheduled:
            return
        try:
            loop.schedule(*waiting.reference)
            self.waiting = waiting._replace(scheduled=True)
        except TrajectoryError as error:
            self.refuse(str(error))

    def _take(
        self, loop: ControlLoop, max_age: float
    ) -> tuple[Reference | None] | None:
        """Return what was read and checked: a reference, or (None,) for a stop; None
        where nothing was.
        """
        if (newest := self._newest()) is not None:
            raw, info = newest
            if self._checking is not None:
                self._checking.cancel()
            self.arrived += 1
            received = info["received_timestamp"]
            age = (
                (received or time.time_ns()) - info["source_timestamp"]
            ) / NANOSECONDS
            active = (self._clock.arrival(received) - self._since) / NANOSECONDS
            self._checking = self._checker.submit(
                self._read, loop.check, bytes(raw), age, active, max_age
            )
        if self._checking is None:
            return None
        if not self._checking.done():
            self.note = "checking"
            return None
        checking, self._checking = self._checking, None
        return (checking.result(),)

    def _newest(self) -> tuple[bytes, Mapping[str, int]] | None:
        """Return the last message that waits, with the middleware's information on it;
        those before it are passed over.
        """
        newest = None
        while (
            taken := self._subscription.handle.take_message(
                MultiDOFJointTrajectory, True
            )
        ) is not None:
            newest = taken
        return newest

    def _read(
        self,
        check: Callable[[Trajectory], Certificate],
        raw: bytes,
        age: float,
        active: float,
        max_age: float,
    ) -> Reference | None:
        """Check a message's age, then its trajectory; return None for a stop.

        Args:
            check: gives the certificate, or refuses.
            raw: the message.
            age: when it arrived, since it was served, s.
            active: for how long the controller was, when it arrived, s.
            max_age: s.
        """
        if age > active:
            raise TrajectoryError(
                f"it was served {age - active:.1f} s before this controller began;"
                " serve it again"
            )
        if age > max_age:
            raise TrajectoryError(
                f"it was served {age:.1f} s before it arrived; the limit is {max_age:g}"
                " s: serve it again, and if that does not help synchronise the clock"
                " of the server's machine with this one's"
            )
        if age < -max_age:
            raise TrajectoryError(
                f"it was served {-age:.1f} s after it arrived; the limit is {max_age:g}"
                " s: if this machine's clock was set back just now serve it again,"
                " else synchronise the clock of the server's machine with this one's"
            )
        message: MultiDOFJointTrajectory = read_message(raw, TRAJECTORY.type)
        if len(message.points) == 0:
            return None
        if len(message.points) > MAX_TRAJECTORY_POINTS:
            raise TrajectoryError(
                f"the trajectory has {len(message.points)} points; the limit is"
                f" {MAX_TRAJECTORY_POINTS}"
            )
        stamp = from_time(message.header.stamp)
        trajectory = messages.to_trajectory(message)
        return Reference(
            trajectory, check(trajectory), stamp / NANOSECONDS if stamp else None
        )

    def _admit(
        self,
        loop: ControlLoop,
        reference: Reference | None,
        limit: float,
        clock: float,
        now: float,
        keep: bool,
    ) -> None:
        if reference is None:
            self.note, self.waiting = "stop", None
            loop.stop("stopped by the trajectory server")
            return
        if reference.start is not None and reference.start - now > limit:
            raise TrajectoryError(
                f"the trajectory starts {reference.start - now:.1f} s from now; the"
                f" limit is {limit:g} s"
            )
        if not keep:
            self._schedule(loop, reference)
        self.note, self.waiting = "accepted", Waiting(reference, clock, not keep)
        self._node.get_logger().info(
            f"trajectory accepted: {in_words(reference.certificate)}"
        )

    def _schedule(self, loop: ControlLoop, reference: Reference) -> None:
        """Hand over to the loop; a refusal because of its phase says what to call."""
        try:
            loop.schedule(*reference)
        except TrajectoryError as error:
            step = next_step(
                self._node.get_fully_qualified_name(), "active", loop.phase.name
            )
            raise TrajectoryError(
                f"{error}: {step}, then serve it again" if step else str(error)
            ) from error

    def _drop_old(self, loop: ControlLoop, limit: float, clock: float) -> None:
        waiting = self.waiting
        if waiting is None:
            return
        if loop.certificate is waiting.reference.certificate:
            self.waiting = None
        elif math.isnan(waiting.since):
            self.waiting = waiting._replace(since=clock)
        elif clock - waiting.since > limit:
            if waiting.scheduled:
                loop.stop("")  # while it holds only what waits is dropped
            raise TrajectoryError(
                f"it has waited {clock - waiting.since:.1f} s to begin; the limit is"
                f" {limit:g} s"
            )

    def close(self) -> None:
        """Destroy the subscription; what is being checked is given up."""
        self._checker.shutdown(wait=False, cancel_futures=True)
        self._node.destroy_subscription(self._subscription)
