"""One test with torque is a sequence of torques, watched at each state and kept for
judgement.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from dextar_control.check_rig.limits import Limits
from dextar_control.check_rig.samples import NANOSECOND, Array, JointSample
from dextar_control.contract.errors import StateError
from dextar_control.contract.robot import JOINT_NAMES, joint_positions

Torque = tuple[float, float]
NO_TORQUE: Torque = (0.0, 0.0)
NAN_TORQUE: Torque = (math.nan, math.nan)
SPEED_WINDOW = 0.01  # s, over which a speed is taken from positions
# of a pulse, without a state or an answer, after which a test is worth repeating
DISTURBED = 0.25
STALL_PERIODS = 5  # without a state, at least, before the stream counts as stopped


class Segment(NamedTuple):
    """A part of a trial, in which every state has the same answer.

    Attributes:
        name: for judgement.
        torque: of the motors, N m; None answers nothing.
        duration: s.
    """

    name: str
    torque: Torque | None
    duration: float


def pulse(joint: int, torque: float) -> Torque:
    """Return the torques, N m, of which one motor has this one."""
    return (torque, 0.0) if joint == 0 else (0.0, torque)


def doublet(joint: int, limits: Limits) -> list[Segment]:
    """Return +, -, - and + for equal times: each sign is tried, and a free joint comes
    back to where and how it was.
    """
    up, down = pulse(joint, limits.torque), pulse(joint, -limits.torque)
    return [
        Segment("rest", NO_TORQUE, limits.pulse),
        Segment("up", up, limits.pulse),
        Segment("down", down, 2.0 * limits.pulse),
        Segment("up again", up, limits.pulse),
        Segment("rest after", NO_TORQUE, limits.pulse),
    ]


def silence(joint: int, limits: Limits) -> list[Segment]:
    """Return torque, then no command, shaped so that a drive that lets go in time
    leaves the joint nearly at rest.
    """
    up, down = pulse(joint, limits.torque), pulse(joint, -limits.torque)
    swing = 0.5 * (limits.pulse + limits.watchdog)
    watch = limits.watchdog_limit + max(10.0 * limits.period, 0.5 * limits.pulse)
    return [
        Segment("rest", NO_TORQUE, limits.pulse),
        Segment("down", down, swing),
        Segment("up", up, limits.pulse),
        Segment("silent", None, watch),
        Segment("down again", down, swing),
        Segment("rest after", NO_TORQUE, limits.pulse),
    ]


def nan_and_on(joint: int, limits: Limits) -> list[Segment]:
    """Return NaN while there is no torque, then a doublet to see whether the driver
    goes on.
    """
    return [
        Segment("rest", NO_TORQUE, limits.pulse),
        Segment("nan", NAN_TORQUE, limits.pulse),
        *doublet(joint, limits),
    ]


@dataclass
class TorqueTrial:
    """Answers states segment by segment, and stops at once when the robot leaves its
    limits.

    Attributes:
        joint: under test.
        segments: in their order.
        samples: all states so far.
        answers: to each of them, N m; None for none.
        places: of each of them, index of its segment.
        sent: when the last command before a silence went out, ns of the system clock.
        trouble: why it was ended before its time; empty otherwise.
        worst_delay: longest time without a state, or from a state's arrival to its
            answer, s.
        finished: no further torque is wanted.
    """

    joint: int
    segments: Sequence[Segment]
    limits: Limits
    samples: list[JointSample] = field(default_factory=list)
    answers: list[Torque | None] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    sent: int = 0
    trouble: str = ""
    worst_delay: float = 0.0
    finished: bool = False
    _start: int = 0
    _origin: Array | None = None
    _last: Array | None = None
    _recent: deque[tuple[JointSample, Array]] = field(default_factory=deque)

    def __post_init__(self) -> None:
        self._ends = np.cumsum([segment.duration for segment in self.segments])

    def update(self, now: int, sample: JointSample | None) -> Torque | None:
        """Return what to command now, N m, in answer to a state; None for nothing.

        Args:
            now: system clock, ns.
            sample: a new state; None when there is none.
        """
        if not self._start:
            self._start = now
        if sample is None:
            last = self.samples[-1].arrival if self.samples else self._start
            limit = max(self.limits.max_gap, STALL_PERIODS * self.limits.period)
            if NANOSECOND * (now - last) > limit:
                self._end(
                    f"no state for {1e3 * NANOSECOND * (now - last):.0f} ms; the limit"
                    f" is {1e3 * limit:.0f} ms"
                )
            return None
        before = self.samples[-1].arrival if self.samples else sample.arrival
        self.worst_delay = max(
            self.worst_delay,
            NANOSECOND * (sample.arrival - before),
            NANOSECOND * (now - sample.arrival),
        )
        self._watch(sample)
        place = int(
            np.searchsorted(self._ends, NANOSECOND * (now - self._start), side="right")
        )
        if place == len(self.segments):
            self.finished = True
        answer = NO_TORQUE if self.finished else self.segments[place].torque
        self.samples.append(sample)
        self.answers.append(answer)
        self.places.append(min(place, len(self.segments) - 1))
        if answer is not None and not any(
            segment.torque is None for segment in self.segments[: place + 1]
        ):
            self.sent = now
        return answer

    @property
    def disturbed(self) -> bool:
        """Whether states or answers were away for so long that the torques were not
        those that were meant.
        """
        return self.worst_delay > DISTURBED * self.limits.pulse

    def of(self, name: str, share: float = 0.0) -> list[JointSample]:
        """Return the states of a segment after this share of its duration."""
        place = next(
            index for index, segment in enumerate(self.segments) if segment.name == name
        )
        begin = self._ends[place] - (1.0 - share) * self.segments[place].duration
        since = self._start + begin / NANOSECOND
        pairs = zip(self.samples, self.places, strict=True)
        return [
            sample for sample, at in pairs if at == place and sample.arrival >= since
        ]

    def _end(self, trouble: str) -> None:
        self.trouble = self.trouble or trouble
        self.finished = True

    def _watch(self, sample: JointSample) -> None:
        """End the test when the controller could not use the state, or a joint is too
        far from the start or too quick.
        """
        try:
            q_a = np.array(joint_positions(sample.names, sample.position))
        except StateError as error:
            self._end(str(error))
            return
        if self._origin is None or self._last is None:
            self._origin = self._last = q_a
        self._last = q_a = np.unwrap([self._last, q_a], axis=0)[1]
        move = np.abs(q_a - self._origin)
        worst = int(np.argmax(move))
        if move[worst] > self.limits.max_move:
            self._end(
                f"{JOINT_NAMES[worst]} moved {move[worst]:.3f} rad; the limit is"
                f" {self.limits.max_move:g} rad"
            )
        self._watch_speed(sample, q_a)

    def _watch_speed(self, sample: JointSample, q_a: Array) -> None:
        """Watch the speed over a window; of stamps and arrivals the longer time counts,
        because states arrive in bursts.
        """
        window = round(max(SPEED_WINDOW, 3.0 * self.limits.period) / NANOSECOND)
        while (
            len(self._recent) > 1
            and sample.arrival - self._recent[1][0].arrival >= window
        ):
            self._recent.popleft()
        if self._recent:
            before, start = self._recent[0]
            elapsed = max(sample.arrival - before.arrival, sample.stamp - before.stamp)
            if elapsed >= window:
                speed = np.abs(q_a - start) / (NANOSECOND * elapsed)
                worst = int(np.argmax(speed))
                if speed[worst] > self.limits.max_speed:
                    limit = f"{self.limits.max_speed:g} rad/s"
                    self._end(
                        f"{JOINT_NAMES[worst]} turned at {speed[worst]:.2f} rad/s; the"
                        f" limit is {limit}"
                    )
        self._recent.append((sample, q_a))
