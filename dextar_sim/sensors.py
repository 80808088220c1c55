"""What stands between plant and controller on a rig: encoder, transport delay, drive-side watchdog."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from dextar_control.contract.errors import ParameterError

Item = TypeVar("Item")


class Encoder:
    """Quantised joint positions and the velocity a drive derives from them.

    Noise is added before quantisation; the velocity is the difference of quantised positions
    through a first-order low-pass of the given cutoff.

    Args:
        period: between two samples, s.
        resolution: counts per revolution; 0 is exact.
        velocity_cutoff: of the velocity's low-pass, Hz; 0 leaves the plain difference.
        position_noise: standard deviation, rad.
        seed: of the noise.

    Raises:
        ParameterError: a value is out of its range.
    """

    def __init__(
        self,
        period: float,
        *,
        resolution: int = 0,
        velocity_cutoff: float = 0.0,
        position_noise: float = 0.0,
        seed: int = 0,
    ) -> None:
        for name, value in (("resolution", resolution), ("velocity_cutoff", velocity_cutoff),
                            ("position_noise", position_noise)):  # fmt: skip
            if not (value >= 0.0 and math.isfinite(value)):
                raise ParameterError(f"encoder {name} = {value}; it must be >= 0")
        if not (period > 0.0 and math.isfinite(period)):
            raise ParameterError(f"encoder period = {period} s; it must be > 0")
        self._period = period
        self._count = 2.0 * math.pi / resolution if resolution else 0.0
        self._gain = 1.0 - math.exp(-2.0 * math.pi * velocity_cutoff * period) if velocity_cutoff else 1.0
        self._noise = position_noise
        self._random = np.random.default_rng(seed)
        self._last: np.ndarray | None = None
        self._velocity = np.zeros(2)

    def reset(self) -> None:
        """Forget the last sample: the next one is at rest. The noise goes on."""
        self._last = None

    def read(self, q_a: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """One sample.

        Args:
            q_a: true joint positions, rad, shape (n,).

        Returns:
            Measured position (rad) and velocity (rad/s), each of shape (n,).
        """
        position = np.array(q_a, dtype=float)
        if self._noise:
            position += self._noise * self._random.standard_normal(position.shape)
        if self._count:
            position = self._count * np.round(position / self._count)
        if self._last is None:
            self._velocity = np.zeros(position.shape)
        else:
            self._velocity = self._velocity + self._gain * ((position - self._last) / self._period - self._velocity)
        self._last = position
        return position.copy(), self._velocity.copy()


class CommandDelay(Generic[Item]):
    """What was put in comes out whole periods later; None before anything did.

    Args:
        periods: of delay; 0 passes through.

    Raises:
        ParameterError: periods is negative.
    """

    def __init__(self, periods: int) -> None:
        if periods < 0:
            raise ParameterError(f"command delay of {periods} periods; it must be >= 0")
        self.periods = periods
        self._line: deque[Item | None] = deque()
        self.reset()

    def reset(self) -> None:
        """Empty the line."""
        self._line = deque([None] * self.periods)

    def shift(self, item: Item | None) -> Item | None:
        """Put in this period's item, take out the one of ``periods`` ago."""
        self._line.append(item)
        return self._line.popleft()


class Command(NamedTuple):
    """A torque command.

    Attributes:
        stamp: of the state it answers, ns.
        torque: of the motors q11, q21, N m.
    """

    stamp: int
    torque: tuple[float, float]


class CommandHold:
    """The drive: holds the last command, saturates it, and lets go when it has grown old.

    A command's age is counted from the stamp of the state it answers, in simulated time, so that
    a controller that answers old states is caught like one that fell silent.

    Args:
        timeout: age beyond which there is no torque, ns.
        max_torque: saturation, N m.

    Attributes:
        refused: commands that were not finite.
        saturated: periods in which a held command exceeded max_torque.
        trips: times a held command grew too old.

    Raises:
        ParameterError: timeout or max_torque is not positive.
    """

    def __init__(self, timeout: int, max_torque: float) -> None:
        if timeout <= 0:
            raise ParameterError(f"command timeout of {timeout} ns; it must be > 0")
        if not (max_torque > 0.0 and math.isfinite(max_torque)):
            raise ParameterError(f"drive max_torque = {max_torque} N m; it must be > 0")
        self._timeout = timeout
        self._limit = max_torque
        self.refused = 0
        self.saturated = 0
        self.trips = 0
        self.reset()

    def reset(self) -> None:
        """Let go of the held command; the counters stay."""
        self._held: Command | None = None
        self._tripped = False

    def receive(self, command: Command) -> bool:
        """Hold this command from now on; False when it is not finite and the last one stays."""
        if not all(math.isfinite(value) for value in command.torque):
            self.refused += 1
            return False
        self._held = command
        return True

    def torque(self, stamp: int) -> tuple[float, float]:
        """Motor torque (N m) at a simulated time (ns); zero without a fresh command."""
        held = self._held
        if held is None:
            return 0.0, 0.0
        if stamp - held.stamp > self._timeout:
            self.trips += not self._tripped
            self._tripped = True
            return 0.0, 0.0
        self._tripped = False
        limit = self._limit
        first, second = (max(-limit, min(limit, value)) for value in held.torque)
        self.saturated += (first, second) != tuple(held.torque)
        return first, second
