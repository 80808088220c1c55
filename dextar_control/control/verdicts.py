"""Crossed or bounced: what became of each planned crossing, as the estimator sees
it.
"""

from __future__ import annotations

import bisect
import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from dextar_control.contract.settings import Settings
from dextar_control.control.supervisor import Supervisor
from dextar_control.estimation.estimate import Estimator
from dextar_control.model.model import Model
from dextar_control.planning.certificate import Certificate

OPEN_BEFORE = 0.02  # s before a planned crossing from which on it counts as begun
TYPE1_END = (
    0.1  # distance to Type 1 at which a robot without control is followed no further
)


class Verdict(IntEnum):
    """What became of a planned crossing, as the estimator sees it."""

    UNDECIDED = 0
    CROSSED = 1
    BOUNCED = 2


class Passed(NamedTuple):
    """One planned crossing and what the estimator made of it."""

    planned_time: float  # since the trajectory's start, s
    verdict: Verdict
    confidence: float  # in the assembly mode that the verdict rests on, 0.5 to 1
    time: float  # of the verdict, since the trajectory's start, s; nan while undecided


class CrossingJudge:
    """Compares the believed assembly mode with the plan's, while a trajectory is
    tracked and after the robot was let go.

    Attributes:
        passed: the planned crossings of the last trajectory, in their order.
    """

    def __init__(self, model: Model) -> None:
        self.passed: list[Passed] = []
        self._unsure: list[tuple[float, float] | None] = [None] * len(
            model.blocks
        )  # since when clear of the locus, s, and the
        # largest error since the side was known, m
        self._model = model
        self._times: list[float] = []
        self._signs: list[float] = []
        self._blocks: list[int] = []
        self._start = 0.0
        self._settled = [-math.inf] * len(
            model.blocks
        )  # s; until then what was said of a block stands while its side is kept
        self._open: list[int] = []

    def configure(self, settings: Settings) -> None:
        """Take the settings that concern it, also while running."""
        told = settings.mode_check
        self._clear_s, self._sure = told.above_abs_s, told.confidence
        self._patience, self._suspect = told.unknown_time, told.unknown_error

    def begin(self, certificate: Certificate, start: float) -> None:
        """A checked trajectory is tracked from ``start`` on, s."""
        self.passed = [
            Passed(float(time), Verdict.UNDECIDED, 0.5, math.nan)
            for time in certificate.crossing_times
        ]
        self._times, self._signs = (
            certificate.crossing_times.tolist(),
            certificate.crossing_signs.tolist(),
        )
        self._blocks = certificate.crossing_blocks.tolist()
        self._start, self._settled = start, [-math.inf] * len(self._model.blocks)

    def let_go(self, time: float) -> None:
        """The robot is let go while it moves: the crossing of each block that has begun
        is still to be judged.

        But for one that it has crossed where it is nearer to the next one: it may coast
            through that.
        """
        self._unsure, self._open = [None] * len(self._model.blocks), []
        for block in range(len(self._model.blocks)):
            current = self._current(time, block)
            if current < 0:
                continue
            halfway = 0.5 * (self._times[current] + self._next(current, block))
            if not (
                self.passed[current].verdict is Verdict.CROSSED
                and time - self._start > halfway
            ):
                self._open.append(current)

    def close(self) -> None:
        """What the robot does from now on is no part of a crossing."""
        self._open = []

    def compare(
        self,
        time: float,
        s_ref: list[float],
        estimator: Estimator,
        moving: bool,
        watched: Supervisor,
    ) -> str:
        """Away from the locus: a verdict where the estimator is sure. What is wrong, or
        nothing.

        An estimator that tells the side and stays unsure of it for too long is wrong
        too where the robot has not followed the plan since: it may be on the other
        side. Who was sent back at the locus did not follow it, and who did was not.

        Args:
            time: of the sample, s.
            s_ref: of the reference, of each block of A_r.
            estimator: whose belief is compared.
            moving: a trajectory is tracked; otherwise a point is held.
            watched: with the distance between reference and estimate.
        """
        problem, modes = "", estimator.modes
        for block, s in enumerate(s_ref):
            mode, confidence = modes[block]
            if not confidence >= self._sure:
                clear = abs(s) >= self._clear_s and estimator.tells_side
                problem = (
                    self._doubted(block, time, clear, confidence, watched) or problem
                )
                continue
            if self._unsure[block]:
                self._unsure[block] = None
            if abs(s) < self._clear_s or (
                mode * s >= 0.0 and time < self._settled[block]
            ):
                continue
            current = self._current(time, block)
            if mode * s < 0.0:
                self._judge(time, current, Verdict.BOUNCED, confidence)
                problem = (
                    f"bounced: the robot is at s = {estimator.estimate.s:+.2f}, the"
                    f" reference at {s:+.2f} (confidence {confidence:.3f})"
                )
                continue
            if moving and current >= 0:
                if not (
                    s * self._signs[current] > 0.0
                    and abs(estimator.estimate.s) >= self._clear_s
                ):
                    continue
                self._judge(time, current, Verdict.CROSSED, confidence)
            self._settled[block] = (
                self._start + self._next(current, block) - OPEN_BEFORE
            )
        return problem

    def _doubted(
        self,
        block: int,
        time: float,
        clear: bool,
        confidence: float,
        watched: Supervisor,
    ) -> str:
        """One more sample with a side that is not known, clear of the locus or not:
        what is wrong, or nothing.
        """
        since, error = self._unsure[block] or (math.nan, 0.0)
        since, error = (
            (time if math.isnan(since) else since) if clear else math.nan,
            max(error, watched.error),
        )
        self._unsure[block] = since, error
        if not (time - since > self._patience and error > self._suspect):
            return ""
        return (
            f"the side of the locus is not known for {time - since:.2f} s clear of it"
            f" (confidence {confidence:.3f}) after an error of {error:.4f} m; the"
            f" limits are {self._patience:g} s and {self._suspect:g} m"
        )

    def compare_afterwards(self, time: float, estimator: Estimator) -> str:
        """The side on which a robot ends that was let go during a crossing: it may
        change as it coasts.

        Until it comes near Type 1: behind that lies another working mode, which the
            model does not follow.

        Returns:
            That it bounced, where that is news; else nothing.
        """
        news, estimate = "", estimator.estimate
        for current in self._open:
            mode, confidence = estimator.modes[self._blocks[current]]
            if not (confidence >= self._sure and abs(estimate.s) >= self._clear_s):
                continue
            if not self._model.type1_distance(np.array(estimate.x)) >= TYPE1_END:
                self._open = []
                break
            same = mode * self._signs[current] > 0.0
            verdict = Verdict.CROSSED if same else Verdict.BOUNCED
            if self._judge(time, current, verdict, confidence) and not same:
                news = f"bounced (s = {estimate.s:+.2f}, confidence {confidence:.3f})"
        return news

    def _current(self, time: float, block: int) -> int:
        """Index of a block's last planned crossing that has begun; -1 before the first
        and without a trajectory.
        """
        current = bisect.bisect_right(self._times, time - self._start + OPEN_BEFORE) - 1
        while current >= 0 and self._blocks[current] != block:
            current -= 1
        return current

    def _next(self, current: int, block: int) -> float:
        """When a block's next planned crossing is, since the trajectory's start, s; inf
        without.
        """
        coming = zip(
            self._times[current + 1 :], self._blocks[current + 1 :], strict=True
        )
        return next((at for at, of in coming if of == block), math.inf)

    def _judge(
        self, time: float, index: int, verdict: Verdict, confidence: float
    ) -> bool:
        """Whether the verdict is another one than before."""
        if index < 0 or self.passed[index].verdict is verdict:
            return False
        self.passed[index] = self.passed[index]._replace(
            verdict=verdict, confidence=confidence, time=time - self._start
        )
        return True
