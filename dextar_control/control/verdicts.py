"""Verdicts on the planned crossings: crossed or bounced, by the estimator's belief."""

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
TYPE1_END = 0.1  # distance to Type 1 at which a coasting robot is judged no further


class Verdict(IntEnum):
    """The verdict on a planned crossing."""

    UNDECIDED = 0
    CROSSED = 1
    BOUNCED = 2


class Passed(NamedTuple):
    """One planned crossing with its verdict."""

    planned_time: float  # since the trajectory's start, s
    verdict: Verdict
    confidence: float  # in the assembly mode that the verdict rests on, 0.5 to 1
    time: float  # of the verdict, since the trajectory's start, s; nan while undecided


class CrossingJudge:
    """Compares the believed assembly mode with the plan's, while a trajectory is
    tracked and after the law stopped acting.

    Args:
        model: of the robot.

    Attributes:
        passed: the planned crossings of the last trajectory, in their order.
    """

    def __init__(self, model: Model) -> None:
        self.passed: list[Passed] = []
        # of each block: since when it is unsure clear of the locus, s, and the largest
        # error since the side was known, m
        self._unsure: list[tuple[float, float] | None] = [None] * len(model.blocks)
        self._model = model
        self._times: list[float] = []
        self._signs: list[float] = []
        self._blocks: list[int] = []
        self._start = 0.0
        # s, until which a block's verdict stands while its side is kept
        self._settled = [-math.inf] * len(model.blocks)
        self._open: list[int] = []

    def configure(self, settings: Settings) -> None:
        """Take the settings that concern it, also while running."""
        told = settings.mode_check
        self._clear_s, self._sure = told.above_abs_s, told.confidence
        self._patience, self._suspect = told.unknown_time, told.unknown_error

    def begin(self, certificate: Certificate, start: float) -> None:
        """Begin a checked trajectory, tracked from ``start`` on, s."""
        self.passed = [
            Passed(float(time), Verdict.UNDECIDED, 0.5, math.nan)
            for time in certificate.crossing_times
        ]
        self._times = certificate.crossing_times.tolist()
        self._signs = certificate.crossing_signs.tolist()
        self._blocks = certificate.crossing_blocks.tolist()
        self._start, self._settled = start, [-math.inf] * len(self._model.blocks)

    def let_go(self, time: float) -> None:
        """Keep the crossing of each block that has begun to be judged, as the law stops
        acting at ``time``, s.

        A crossing that has succeeded is judged no further where the next one is nearer,
        through which the robot may coast.
        """
        self._unsure, self._open = [None] * len(self._model.blocks), []
        for block in range(len(self._model.blocks)):
            current = self._current(time, block)
            if current < 0:
                continue
            halfway = 0.5 * (self._times[current] + self._next(current, block))
            crossed = self.passed[current].verdict is Verdict.CROSSED
            if not (crossed and time - self._start > halfway):
                self._open.append(current)

    def close(self) -> None:
        """Judge no crossing any further."""
        self._open = []

    def compare(
        self,
        time: float,
        s_ref: list[float],
        estimator: Estimator,
        moving: bool,
        watched: Supervisor,
    ) -> str:
        """Give verdicts away from the locus, where the estimator is sure.

        An estimator that tells the side, but stays unsure of it for too long after the
        robot has left the plan, is a problem too: the robot may be on the other side.

        Args:
            time: of the sample, s.
            s_ref: of the reference, of each block of A_r.
            estimator: whose belief is compared.
            moving: whether a trajectory is tracked; otherwise a point is held.
            watched: knows the distance between reference and estimate.

        Returns:
            A sentence that says what is wrong; "" for nothing.
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
        """Take a sample at which a block's side is not known, clear of the locus or
        not; a sentence that says what is wrong, or "".
        """
        since, error = self._unsure[block] or (math.nan, 0.0)
        since = (time if math.isnan(since) else since) if clear else math.nan
        error = max(error, watched.error)
        self._unsure[block] = since, error
        if not (time - since > self._patience and error > self._suspect):
            return ""
        return (
            f"the side of the locus is not known for {time - since:.2f} s clear of it"
            f" (confidence {confidence:.3f}) after an error of {error:.4f} m; the"
            f" limits are {self._patience:g} s and {self._suspect:g} m"
        )

    def compare_afterwards(self, time: float, estimator: Estimator) -> str:
        """Give verdicts after the law stopped acting during a crossing; they may change
        as the robot coasts.

        They end where the robot comes near Type 1: behind it lies another working mode,
        which the model does not follow.

        Returns:
            That it bounced, where that is new; else "".
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
        """Return the index of a block's last planned crossing that has begun; -1 before
        the first and without a trajectory.
        """
        current = bisect.bisect_right(self._times, time - self._start + OPEN_BEFORE) - 1
        while current >= 0 and self._blocks[current] != block:
            current -= 1
        return current

    def _next(self, current: int, block: int) -> float:
        """Return the time of a block's next planned crossing since the trajectory's
        start, s; inf without one.
        """
        rest = slice(current + 1, None)
        coming = zip(self._times[rest], self._blocks[rest], strict=True)
        return next((at for at, of in coming if of == block), math.inf)

    def _judge(
        self, time: float, index: int, verdict: Verdict, confidence: float
    ) -> bool:
        """Set a verdict; whether it is another one than before."""
        if index < 0 or self.passed[index].verdict is verdict:
            return False
        self.passed[index] = self.passed[index]._replace(
            verdict=verdict, confidence=confidence, time=time - self._start
        )
        return True
