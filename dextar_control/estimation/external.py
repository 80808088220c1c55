"""The estimator ``external``: the observer fused with positions of a camera, which
arrive late, or wrong, or not at all.

Between the positions, and when they stop, it is the observer. How it takes a position:
``estimation.out_of_sequence``.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.settings import Settings
from dextar_control.estimation.estimate import ExternalPosition
from dextar_control.estimation.observing import ObserverEstimator
from dextar_control.estimation.out_of_sequence import (
    SAME_TIME,
    USED,
    PositionLimits,
    PositionOutcome,
    SampleHistory,
)
from dextar_control.model.model import Model
from dextar_control.symbols.record import Record
from dextar_control.symbols.types import Array


class ExternalEstimator(ObserverEstimator):
    """The estimator ``external``.

    Attributes:
        outcomes: number of positions by their outcome.
        outages: number of times that the positions stopped.
    """

    takes_poses = True

    def __init__(
        self,
        model: Model,
        settings: Settings,
        min_type1: float,
        estimate: Record | None = None,
    ) -> None:
        if (count := len(model.blocks)) > 1:
            raise ParameterError(
                "estimator external needs an A_r of one block; that of"
                f" {model.mechanism.name} has {count}"
            )
        self.outcomes: Counter[PositionOutcome] = Counter()
        self.outages = 0
        self._forget()
        super().__init__(model, settings, min_type1, estimate)
        self._history = SampleHistory(self.observer)

    def configure(self, settings: Settings) -> None:
        """See ``Estimator``.

        Raises:
            ParameterError: a number of the group ``external`` is not positive.
        """
        told = settings.external
        for name, value in vars(told).items():
            if not value > 0.0:
                raise ParameterError(f"external.{name} = {value}; it must be > 0")
        super().configure(settings)
        self._limits = PositionLimits(told.position_deviation, told.position_gate**2)
        self._gate, self._timeout = told.position_gate, told.timeout

    def _forget(self) -> None:
        self._waiting: list[tuple[ExternalPosition, float]] = []
        self._last_stamp = -np.inf
        self._silence = 0.0
        self._silent = False
        self._absence = 0.0
        self._last_outcome = PositionOutcome.TAKEN
        self.note = ""

    def _begin(self, x: Array, q_a: Array, assembly_mode: int, speed: float) -> None:
        super()._begin(x, q_a, assembly_mode, speed)
        self._forget()
        self._history.begin()

    def take_pose(self, pose: ExternalPosition, time: float) -> None:
        """See ``Estimator``; the position is used with the sample of ``time``, which
        has to follow.
        """
        age = time - pose.time
        if self._silent:
            self._absence, self._silent = self._silence, False
        self._silence = 0.0
        if not np.isfinite([age, *pose.x]).all():
            self._refuse(
                PositionOutcome.NOT_FINITE,
                f"external position {tuple(pose.x)} m at {pose.time} s is not finite",
            )
        elif age < -SAME_TIME:
            self._refuse(
                PositionOutcome.FUTURE,
                f"external position of {pose.time:.6f} s is {-1e3 * age:.3f} ms ahead"
                f" of the state at {time:.6f} s",
            )
        elif not pose.time > self._last_stamp:
            self._refuse(
                PositionOutcome.OUT_OF_ORDER,
                f"external position of {pose.time:.6f} s is not after the last one, of"
                f" {self._last_stamp:.6f} s",
            )
        else:
            self._last_stamp = pose.time
            self._waiting.append((pose, max(age, 0.0)))

    def observe(self, dt: float, q_a: Array, tau: Array) -> None:
        """See ``Estimator``: q_a (n,), rad, tau (n,), N m; then the positions that
        have come.
        """
        self._history.take_sample(tau, dt, q_a)
        self._silence += dt
        for pose, age in self._waiting:
            self._take(pose, age)
        self._waiting.clear()
        if self._silence > self._timeout and not self._silent:
            self._silent = True
            self.outages += 1
            self._last_outcome = PositionOutcome.TAKEN
            self.note = (
                f"no external position for {self._silence:.3f} s (limit {self._timeout}"
                " s): the encoders serve alone"
            )
        self.observer.tell_side()

    def _take(self, pose: ExternalPosition, age: float) -> None:
        x = np.array(pose.x, dtype=np.float64)
        outcome = self._history.take_position(
            self._limits, age, x, self._last_outcome in USED
        )
        where = (
            f"external position ({pose.x[0]:.4f}, {pose.x[1]:.4f}) m of"
            f" {pose.time:.6f} s"
        )
        if outcome is PositionOutcome.TOO_OLD:
            self._refuse(
                outcome,
                f"{where} is {1e3 * age:.1f} ms old; the last"
                f" {1e3 * self._history.reach:.1f} ms are kept",
            )
        elif outcome is PositionOutcome.JUMP:
            off = self._history.distances
            self._refuse(
                outcome,
                f"{where} is {1e3 * off.length:.1f} mm from the estimate,"
                f" {off.estimate:.1f} deviations, and {off.image:.1f} from its mirror"
                f" image; the limit is {self._gate:g}",
            )
        elif outcome in USED:
            self._use(outcome, where)
        else:
            self.outcomes[outcome] += 1

    def _use(self, outcome: PositionOutcome, where: str) -> None:
        self.outcomes[outcome] += 1
        self._last_outcome = outcome
        self.note = ""
        if self._absence > 0.0:
            self.note = f"external positions are back after {self._absence:.3f} s"
        elif outcome is PositionOutcome.SWAPPED:
            self.note = (
                f"{where} fits the mirror image of the estimate,"
                f" {1e3 * self._history.distances.length:.1f} mm away: the assembly"
                f" mode is {self.observer.belief.mode:+.0f}"
            )
        self._absence = 0.0

    def _refuse(self, outcome: PositionOutcome, text: str) -> None:
        """Count a refused position; note it where the last had another outcome."""
        self.outcomes[outcome] += 1
        if outcome is not self._last_outcome:
            self.note = text
        self._last_outcome = outcome
