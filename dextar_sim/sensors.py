"""What stands between plant and controller on a rig: encoders, camera, transport delay,
and the drives' watchdog.
"""

from __future__ import annotations

import math
import random
import sys
from collections import deque
from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from dextar_control.contract.errors import ParameterError
from dextar_control.symbols.types import Array, Numbers

Item = TypeVar("Item")


_ROUNDING = 1.0e-9  # share of a sample that a time may be off and still fall on it


def check_nonnegative(what: str = "", **values: float) -> None:
    """Refuse numbers that are negative or not finite.

    Args:
        what: they are of, before their names in the message.
        values: by name.

    Raises:
        ParameterError: one is not >= 0.
    """
    for name, value in values.items():
        if not (value >= 0.0 and math.isfinite(value)):
            raise ParameterError(f"{what} {name} = {value}; it must be >= 0".lstrip())


def check_probability(name: str, value: float) -> None:
    """Refuse what is no probability.

    Raises:
        ParameterError: the value does not lie in [0, 1].
    """
    if not 0.0 <= value <= 1.0:
        raise ParameterError(f"{name} = {value}; it must lie in [0, 1]")


class Encoder:
    """Gives quantised joint positions, and the velocity that a drive derives from them.

    Noise is added before quantisation; the velocity is the difference of quantised
    positions through a first-order low-pass of the given cutoff.

    Args:
        period: between two samples, s.
        resolution: counts per revolution; 0 is exact.
        velocity_cutoff: of the velocity's low-pass, Hz; 0 leaves the plain difference.
        position_noise: standard deviation, rad.
        offset: what each reads at zero, rad.
        homing_error: by which each is off, to one side or the other at random, rad.
        eccentricity: amplitude of an error over a turn, rad; where it vanishes is
            random.
        seed: of noise, sides and phases.

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
        offset: Numbers = (0.0, 0.0),
        homing_error: float = 0.0,
        eccentricity: float = 0.0,
        seed: int = 0,
    ) -> None:
        check_nonnegative(
            "encoder",
            resolution=resolution,
            velocity_cutoff=velocity_cutoff,
            position_noise=position_noise,
            homing_error=homing_error,
            eccentricity=eccentricity,
        )
        if not (period > 0.0 and math.isfinite(period)):
            raise ParameterError(f"encoder period = {period} s; it must be > 0")
        self._period = period
        self._count = 2.0 * math.pi / resolution if resolution else 0.0
        self._gain = (
            1.0 - math.exp(-2.0 * math.pi * velocity_cutoff * period)
            if velocity_cutoff
            else 1.0
        )
        self._noise = position_noise
        self._random = np.random.default_rng(seed)
        mounted = np.random.default_rng([seed, 1])
        sides = mounted.choice((-1.0, 1.0), len(offset)).tolist()
        self._offset = [
            at + homing_error * side for at, side in zip(offset, sides, strict=True)
        ]
        self._eccentricity = eccentricity
        self._phase = mounted.uniform(0.0, 2.0 * math.pi, len(offset)).tolist()
        self._is_off = bool(eccentricity or any(self._offset))
        self._last: list[float] | None = None
        self._velocity: list[float] = []

    def reset(self) -> None:
        """Forget the last sample, so that the next one is at rest; the noise goes
        on.
        """
        self._last = None

    def position(self, q_a: Numbers) -> list[float]:
        """Return measured positions, (n,), rad, of true ones, (n,), rad, without a
        sample for the velocity.
        """
        values: Numbers = q_a
        if self._is_off:
            values = [
                value + offset + self._eccentricity * math.sin(value + phase)
                for value, offset, phase in zip(
                    values, self._offset, self._phase, strict=True
                )
            ]
        if self._noise:
            values = [
                value + self._noise * self._random.standard_normal() for value in values
            ]
        count = self._count
        return (
            [count * round(float(value) / count) for value in values]
            if count
            else [float(value) for value in values]
        )

    def read(self, q_a: Numbers) -> tuple[Array, Array]:
        """Take one sample.

        Args:
            q_a: true joint positions, rad, shape (n,).

        Returns:
            Measured position (rad) and velocity (rad/s), each of shape (n,).
        """
        position = self.position(q_a)
        if self._last is None:
            self._velocity = [0.0] * len(position)
        else:
            gain, period = self._gain, self._period
            self._velocity = [
                velocity + gain * ((value - last) / period - velocity)
                for velocity, value, last in zip(
                    self._velocity, position, self._last, strict=True
                )
            ]
        self._last = position
        return np.array(position), np.array(self._velocity)


class StampError:
    """Draws the error of each sample's stamp, evenly distributed.

    Args:
        error: largest, s; below half of the period, so that stamps rise.
        period: between two samples, s.
        seed: of all of them.

    Raises:
        ParameterError: the error is out of its range.
    """

    def __init__(self, error: float, period: float, seed: int = 0) -> None:
        if not 0.0 <= error < 0.5 * period:
            raise ParameterError(
                f"stamp_error = {error} s; it must lie in [0, {0.5 * period:g}) s, half"
                " of the period"
            )
        self._error = error
        self._random = random.Random(seed)

    def next(self) -> float:
        """Return the error of the next sample's stamp, s."""
        return self._random.uniform(-self._error, self._error) if self._error else 0.0


class Measurement(NamedTuple):
    """An external measurement of the end effector.

    Attributes:
        sample: number of the one at which it was true.
        x: measured position, m.
    """

    sample: int
    x: tuple[float, float]


class PoseSensor:
    """Simulates a camera on the end effector, with its own rate, latency, noise and
    gaps.

    An exposure falls on the first sample at or after it is due; its result arrives at
    the first sample that is at least the delay later, in the order of the exposures.

    Args:
        period: between two samples, s.
        rate: exposures per second; 0 is no camera.
        delay: from the exposure to the arrival, s.
        noise: standard deviation of each coordinate, m.
        dropout: probability that an exposure gives nothing.
        outages: spans of time since the first sample (from, to) without exposures, s.
        seed: of noise and dropout.

    Raises:
        ParameterError: a value is out of its range.
    """

    def __init__(
        self,
        period: float,
        *,
        rate: float = 0.0,
        delay: float = 0.0,
        noise: float = 0.0,
        dropout: float = 0.0,
        outages: Sequence[tuple[float, float]] = (),
        seed: int = 0,
    ) -> None:
        if not (period > 0.0 and math.isfinite(period)):
            raise ParameterError(f"pose period = {period} s; it must be > 0")
        check_nonnegative("pose", rate=rate, delay=delay, noise=noise)
        if rate * period > 1.0 + _ROUNDING:
            raise ParameterError(
                f"pose rate = {rate} Hz; it must be <= {1.0 / period:g} Hz, that of the"
                " samples"
            )
        check_probability("pose dropout", dropout)
        for begin, end in outages:
            if not begin <= end:
                raise ParameterError(
                    f"pose outage from {begin} to {end} s; it must end after it begins"
                )
        self._interval = 1.0 / (rate * period) if rate else math.inf
        self._latency = math.ceil(delay / period - _ROUNDING)
        self._noise = noise
        self._dropout = dropout
        self._outages = [(begin / period, end / period) for begin, end in outages]
        self._random = np.random.default_rng(seed)
        self.reset()

    def reset(self) -> None:
        """Forget what is under way, and count the coming sample as the first; noise and
        dropout go on.
        """
        self._line: deque[Measurement] = deque()
        self._first: int | None = None
        self._exposures = 0
        self._due = 0

    def sense(self, sample: int, x: Numbers) -> Measurement | None:
        """Look at one sample, and return the measurement that arrives with it.

        Args:
            sample: its number, one more at each call.
            x: true end effector position then, m, shape (2,).
        """
        if self._first is None:
            self._first = sample
            self._due = sample if self._interval < math.inf else sys.maxsize
        if sample >= self._due:
            self._expose(sample, sample - self._first, x)
        line = self._line
        return (
            line.popleft()
            if line and sample >= line[0].sample + self._latency
            else None
        )

    def _expose(self, sample: int, age: int, x: Numbers) -> None:
        self._exposures += 1
        self._due = (
            sample - age + math.ceil(self._exposures * self._interval - _ROUNDING)
        )
        noise = self._noise * self._random.standard_normal(2)
        lost = self._random.random() < self._dropout
        if not lost and not any(begin <= age < end for begin, end in self._outages):
            self._line.append(
                Measurement(sample, (float(x[0] + noise[0]), float(x[1] + noise[1])))
            )


class CommandDelay(Generic[Item]):
    """Gives what was put in some periods ago; None before anything was.

    Args:
        periods: of delay; 0 passes through.

    Raises:
        ParameterError: periods is negative.
    """

    def __init__(self, periods: int) -> None:
        if periods < 0:
            raise ParameterError(f"command delay of {periods} periods; it must be >= 0")
        self.periods = periods
        self.reset()

    def reset(self) -> None:
        """Empty the line."""
        self._line: deque[Item | None] = deque([None] * self.periods)

    def shift(self, item: Item | None) -> Item | None:
        """Put in this period's item, take out the one of ``periods`` ago."""
        self._line.append(item)
        return self._line.popleft()


class TorqueCommand(NamedTuple):
    """A torque command.

    Attributes:
        stamp: of the state it answers, ns.
        torque: of the motors q11, q21, N m.
        arrival: when it came, ns of a steady clock; None where simulated time alone
            counts.
    """

    stamp: int
    torque: tuple[float, float]
    arrival: int | None = None


class Acknowledgement(NamedTuple):
    """Says in lockstep, in the place of a command, that none comes for this state.

    Attributes:
        stamp: of the state, ns.
    """

    stamp: int


class CommandHold:
    """Is the drive: it holds the last command, saturates it, and lets go of it when it
    has grown old.

    A command's age is counted from the stamp of the state it answers, in simulated
    time, so that a controller that answers old states is caught like one that fell
    silent. Where commands tell their arrival, the steady clock since then counts too:
    simulated time stands still while the machine does.

    Args:
        timeout: age beyond which there is no torque, by either clock, ns.
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
        self._held: TorqueCommand | None = None
        self._tripped = False

    def receive(self, command: TorqueCommand) -> bool:
        """Hold this command from now on; return False when it is not finite and the
        last one stays.
        """
        first, second = command.torque
        if not (math.isfinite(first) and math.isfinite(second)):
            self.refused += 1
            return False
        self._held = command
        return True

    def torque(self, stamp: int, now: int | None = None) -> tuple[float, float]:
        """Return the motor torque, (2,), N m; zero without a fresh command.

        Args:
            stamp: simulated time, ns.
            now: of the commands' arrivals' clock, ns; None counts simulated time alone.
        """
        held = self._held
        if held is None:
            return 0.0, 0.0
        silent = (
            now is not None
            and held.arrival is not None
            and now - held.arrival > self._timeout
        )
        if silent or stamp - held.stamp > self._timeout:
            self.trips += not self._tripped
            self._tripped = True
            return 0.0, 0.0
        self._tripped = False
        limit = self._limit
        first, second = held.torque
        if -limit <= first <= limit and -limit <= second <= limit:
            return first, second
        self.saturated += 1
        return max(-limit, min(limit, first)), max(-limit, min(limit, second))
