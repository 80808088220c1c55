"""``external``: the observer fused with positions that a camera measures, which arrive late, or wrong, or not at all.

Between the positions, and when they stop, it is the observer. What it does with one: ``core.hindsight``.
"""

from __future__ import annotations

from collections import Counter
from enum import IntEnum

import numpy as np

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.robot import RobotParameters
from dextar_control.core import hindsight
from dextar_control.core.compiled import njit
from dextar_control.core.estimator import ObserverEstimator, Pose, row_of
from dextar_control.core.hindsight import SAME_TIME, History, Sight, make_history, take_position, take_sample
from dextar_control.core.model import Array, unpack
from dextar_control.core.observer import MODE, unpack_filter
from dextar_control.core.settings import Settings


class Fate(IntEnum):
    """What became of a position."""

    TAKEN = hindsight.TAKEN
    STRUCK = hindsight.STRUCK  # shows a blow along t_s near the locus
    AGAINST = hindsight.AGAINST  # fits the mirror image of the estimate alone: counts against its assembly mode
    SWAPPED = hindsight.SWAPPED  # did so often enough, or near the locus: the estimate has moved to the image
    EARLY = hindsight.EARLY  # from before the first sample
    TOO_OLD = hindsight.TOO_OLD
    JUMP = hindsight.JUMP
    NOT_FINITE = 7
    OUT_OF_ORDER = 8
    FUTURE = 9


USED = (Fate.TAKEN, Fate.STRUCK, Fate.AGAINST, Fate.SWAPPED)


@njit
def _take_sample(
    packed: Array, tuning: Array, filters: Array, belief: Array, history: History, tau: Array, dt: float, q_meas: Array,
    row: Array,
) -> float:  # fmt: skip
    model = unpack(packed)
    take_sample(model, tuning, filters, belief, history, tau, dt, q_meas)
    return row_of(model, unpack_filter(filters[0]), belief, row)


@njit
def _take_position(
    packed: Array, tuning: Array, sight: Sight, filters: Array, belief: Array, history: History, age: float, x_meas: Array,
    trusted: bool, distances: Array, row: Array,
) -> tuple[int, float]:  # fmt: skip
    model = unpack(packed)
    fate = take_position(model, tuning, sight, filters, belief, history, age, x_meas, trusted, distances)
    return fate, row_of(model, unpack_filter(filters[0]), belief, row)


class ExternalEstimator(ObserverEstimator):
    """``external``.

    Attributes:
        fates: how many positions had which fate.
        outages: how often the positions stopped.
    """

    def __init__(self, robot: RobotParameters, settings: Settings) -> None:
        self.fates: Counter[Fate] = Counter()
        self.outages = 0
        self._history = make_history()
        self._distances = np.zeros(3)
        self._forget()
        super().__init__(robot, settings)

    def configure(self, settings: Settings) -> None:
        """See ``Estimator``.

        Raises:
            ParameterError: pose_deviation, pose_gate or pose_timeout is not positive.
        """
        for name in ("pose_deviation", "pose_gate", "pose_timeout"):
            if not getattr(settings, name) > 0.0:
                raise ParameterError(f"{name} = {getattr(settings, name)}; it must be > 0")
        super().configure(settings)
        self._sight = Sight(settings.pose_deviation, settings.pose_gate**2)
        self._gate, self._timeout = settings.pose_gate, settings.pose_timeout

    def _forget(self) -> None:
        self._waiting: list[tuple[Pose, float]] = []
        self._last_stamp = -np.inf
        self._silence = 0.0
        self._silent = False
        self._absence = 0.0
        self._last_fate = Fate.TAKEN
        self.note = ""

    def _begin(self, x: Array, q_a: Array, assembly_mode: int, speed: float) -> None:
        super()._begin(x, q_a, assembly_mode, speed)
        self._forget()
        hindsight.begin(self._history, self._filters, self._belief)

    def take_pose(self, pose: Pose, time: float) -> None:
        """See ``Estimator``; it is used with the sample of that time, which has to follow."""
        age = time - pose.time
        if self._silent:
            self._absence, self._silent = self._silence, False
        self._silence = 0.0
        if not np.isfinite([age, *pose.x]).all():
            self._refuse(Fate.NOT_FINITE, f"external position {tuple(pose.x)} m at {pose.time} s is not finite")
        elif age < -SAME_TIME:
            self._refuse(
                Fate.FUTURE, f"external position of {pose.time:.6f} s is {-1e3 * age:.3f} ms ahead of the state at {time:.6f} s"
            )
        elif not pose.time > self._last_stamp:
            self._refuse(
                Fate.OUT_OF_ORDER,
                f"external position of {pose.time:.6f} s is not after the last one, of {self._last_stamp:.6f} s",
            )
        else:
            self._last_stamp = pose.time
            self._waiting.append((pose, max(age, 0.0)))

    def _advance(self, dt: float, q_a: Array, tau: Array) -> None:
        self.s = _take_sample(
            self._packed, self._tuning, self._filters, self._belief, self._history, tau, dt, q_a, self.row
        )
        self._silence += dt
        for pose, age in self._waiting:
            self._take(pose, age)
        self._waiting.clear()
        if self._silence > self._timeout and not self._silent:
            self._silent = True
            self.outages += 1
            self._last_fate = Fate.TAKEN
            self.note = f"no external position for {self._silence:.3f} s (limit {self._timeout} s): the encoders serve alone"

    def _take(self, pose: Pose, age: float) -> None:
        code, self.s = _take_position(
            self._packed, self._tuning, self._sight, self._filters, self._belief, self._history, age,
            np.ascontiguousarray(pose.x, dtype=np.float64), self._last_fate in USED, self._distances, self.row,
        )  # fmt: skip
        fate = Fate(code)
        where = f"external position ({pose.x[0]:.4f}, {pose.x[1]:.4f}) m of {pose.time:.6f} s"
        if fate is Fate.TOO_OLD:
            self._refuse(fate, f"{where} is {1e3 * age:.1f} ms old; the last {1e3 * self._reach():.1f} ms are kept")
        elif fate is Fate.JUMP:
            off, off_image, distance = self._distances
            self._refuse(
                fate,
                f"{where} is {1e3 * distance:.1f} mm from the estimate, {off:.1f} deviations, and {off_image:.1f} from"
                f" its mirror image; the limit is {self._gate:g}",
            )
        elif fate in USED:
            self._use(fate, where)
        else:
            self.fates[fate] += 1

    def _reach(self) -> float:
        """Age of the oldest sample that is kept, s."""
        newest, count = self._history.ends
        return float(self._history.time[newest] - self._history.time[(newest - count + 1) % len(self._history.time)])

    def _use(self, fate: Fate, where: str) -> None:
        self.fates[fate] += 1
        self._last_fate = fate
        self.note = ""
        if self._absence > 0.0:
            self.note = f"external positions are back after {self._absence:.3f} s"
        elif fate is Fate.SWAPPED:
            self.note = (
                f"{where} fits the mirror image of the estimate, {1e3 * self._distances[2]:.1f} mm away:"
                f" the assembly mode is {self._belief[MODE]:+.0f}"
            )
        self._absence = 0.0

    def _refuse(self, fate: Fate, text: str) -> None:
        """Count it, and say so once in a row."""
        self.fates[fate] += 1
        if fate is not self._last_fate:
            self.note = text
        self._last_fate = fate
