"""A driver is allowed this much."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.resources import node_defaults


@dataclass(frozen=True)
class Limits:
    """Limits of the check, and the size of its torques.

    Attributes:
        rate: expected of the states, Hz.
        rate_tolerance: of mean rate and stamp period, relative.
        jitter: 99th percentile of an arrival interval's distance from the period, s.
        max_gap: longest time between two arrivals, s.
        max_age: median age of a state at arrival, s.
        ahead: by which a stamp may lie ahead of this machine's clock, s.
        closing: by which the distal links may miss each other, m.
        watchdog: the drive's declared time-out, s.
        watchdog_margin: for the way of a command and of a state, beyond two periods, s.
        healthy_time: for which states must come as they should before the controller
            enables, s.
        joint_margin: by which a joint may be outside its range, rad.
        assembly_mode: sign of s where the controller expects the robot to stand.
        torque: of the tests, N m.
        pulse: shortest time at one torque, s.
        max_move: of a joint from where a test began, rad; more ends the tests.
        max_speed: of a joint, rad/s; more ends the tests.
        max_torque: of the robot's motors, N m: ``torque`` must not exceed it.

    Raises:
        ParameterError: a value is out of its range.
    """

    rate: float
    watchdog: float
    max_torque: float
    max_gap: float
    jitter: float
    rate_tolerance: float = 0.05
    max_age: float = 0.05
    ahead: float = 0.005
    closing: float = 1.0e-3
    watchdog_margin: float = 0.01
    healthy_time: float = field(
        default_factory=lambda: float(
            node_defaults("controller")["joint_states.healthy_time"]
        )
    )
    joint_margin: float = field(
        default_factory=lambda: float(node_defaults("controller")["watch.joint_margin"])
    )
    assembly_mode: int = field(
        default_factory=lambda: int(node_defaults("controller")["assembly_mode"])
    )
    torque: float = 0.005
    pulse: float = 0.1
    max_move: float = 0.1
    max_speed: float = 1.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name not in FREE and not (math.isfinite(value) and value > 0.0):
                raise ParameterError(f"{item.name} = {value}; it must be > 0")
        if self.torque > self.max_torque:
            raise ParameterError(
                f"test torque = {self.torque} N m; it must be <= {self.max_torque} N m,"
                " the robot's max_torque"
            )
        if self.pulse * self.rate < MIN_SAMPLES:
            raise ParameterError(
                f"pulse = {self.pulse} s at {self.rate} Hz; it must be >="
                f" {MIN_SAMPLES / self.rate:g} s, {MIN_SAMPLES} states"
            )

    @property
    def period(self) -> float:
        """The period of the states, s."""
        return 1.0 / self.rate

    @property
    def watchdog_limit(self) -> float:
        """The longest time from the last command to a state without torque, s: the
        drive looks, and tells, once in a period.
        """
        return self.watchdog + self.watchdog_margin + 2.0 * self.period


# Limits that are the controller's own parameters, and in their ranges.
FREE = ("healthy_time", "joint_margin", "assembly_mode")
# States in one pulse at the expected rate, so that a response can be judged.
MIN_SAMPLES = 20
# States of a whole doublet that must have come.
MIN_DOUBLET = 30
# Of the test torque: an effort may miss its command by this, and below it counts as
# none.
EFFORT_SHARE = 0.2
# rad that the first pulse must move a joint: four counts of an encoder of 2^17.
MIN_MOVE = 2.0e-4
# The integral of the velocity may miss the change of position over VELOCITY_WINDOW by
# this share and this angle, rad: a drive's velocity is filtered, so it lags.
VELOCITY_SHARE, VELOCITY_FLOOR = 0.2, 2.0e-3
VELOCITY_WINDOW = 0.05  # s
# Share of the windows with movement that may miss: a stamp taken late spoils one, a
# wrong velocity all.
VELOCITY_MISSES = 0.2
# New states from which a stream can be judged.
MIN_STATES = 20
