"""A two-motor driver with a switch for each fault: in simulated time, or as a process
of its own (``python fake_driver.py``).
"""

from __future__ import annotations

import argparse
import math
import time
from typing import Any

import numpy as np

RATE = 200.0
INERTIA = 2.0e-3  # kg m^2 of each motor, a free rotor
WATCHDOG = 0.1  # s
START = (2.125, 1.544)  # rad, the DexTAR's elbows 168 mm apart: it closes
LIMIT = 0.3  # N m
OLD = 10.0  # s
PAUSE_EVERY, PAUSE = 40, 0.2  # states, s: of the driver that jitters

FAULTS = (
    "none",
    "state_type",
    "command_type",
    "best_effort",
    "latched_reader",
    "names",
    "order",
    "slow",
    "jitter",
    "stamps_back",
    "stamps_old",
    "nan_position",
    "ignores_torque",
    "inverted",
    "no_watchdog",
    "accepts_nan",
    "clamps_nan",
    "dies_of_nan",
    "open",
    "no_velocity",
    "swapped_motors",
    "stamps_jump",
)


class FakeDriver:
    """Two free rotors behind a drive; ``step`` gives the state's fields, ``command``
    takes what a message says.
    """

    def __init__(self, fault: str = "none", rate: float = RATE) -> None:
        assert fault in FAULTS, fault
        self.fault = fault
        self.period = 1.0 / rate
        self.index = -1
        self.last = math.nan
        self.q = np.array(START)
        self.q_dot = np.zeros(2)
        self.torque = np.zeros(2)
        self.commanded_at = -math.inf
        self.alive = True
        self.viscous = 0.0  # N m s/rad
        self.count = 0.0  # of the encoders, rad

    def command(self, names: list[str], efforts: list[float], now: float) -> None:
        torque = np.array([efforts[names.index(name)] for name in ("q11", "q21")])
        if not np.isfinite(torque).all():
            if self.fault == "dies_of_nan":
                self.alive = False
            if self.fault == "clamps_nan":
                torque = np.full(2, LIMIT)
            elif self.fault != "accepts_nan":
                return
        if self.fault != "ignores_torque":
            self.torque = np.array(
                [
                    max(-LIMIT, min(value, LIMIT)) if value == value else value
                    for value in torque
                ]
            )
        self.commanded_at = now

    def step(self, now: float) -> dict[str, Any]:
        """On to now, s; the fields of the state then."""
        self.index += 1
        dt = self.period if math.isnan(self.last) else now - self.last
        self.last = now
        if now - self.commanded_at > WATCHDOG and self.fault != "no_watchdog":
            self.torque = np.zeros(2)
        sign = np.array([-1.0 if self.fault == "inverted" else 1.0, 1.0])
        torque = self.torque[::-1] if self.fault == "swapped_motors" else self.torque
        acceleration = (sign * torque - self.viscous * self.q_dot) / INERTIA
        self.q = self.q + dt * self.q_dot + 0.5 * dt**2 * acceleration
        self.q_dot = self.q_dot + dt * acceleration
        return self.fields()

    def fields(self) -> dict[str, Any]:
        names = ["q11", "q21"]
        q = self.count * np.round(self.q / self.count) if self.count else self.q
        position, velocity, effort = (
            q.tolist(),
            self.q_dot.tolist(),
            self.torque.tolist(),
        )
        if self.fault == "names":
            names = ["left", "right"]
        if self.fault == "order":
            names, position, velocity, effort = (
                values[::-1] for values in (names, position, velocity, effort)
            )
        if self.fault == "nan_position" and self.index % 50 == 7:
            position[0] = math.nan
        if self.fault == "open":
            position[0] += 1.0
        if self.fault == "no_velocity":
            velocity = []
        return {
            "name": names,
            "position": position,
            "velocity": velocity,
            "effort": effort,
        }

    def stamp(self, now: float) -> float:
        """Of the state of now, s."""
        if self.fault == "stamps_old":
            return now - OLD
        if self.fault == "stamps_back" and self.index % 20 == 11:
            return now - 4.5 * self.period
        if (
            self.fault == "stamps_jump"
        ):  # a clock that is set: 25 ms more from the 20th state on
            return now - 0.04 + 0.025 * (self.index >= 20)
        return now


def main() -> None:
    """The driver as a ROS node, until it is killed."""
    import rclpy
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    parser = argparse.ArgumentParser()
    parser.add_argument("fault", choices=FAULTS)
    driver = FakeDriver(parser.parse_args().fault)
    rclpy.init()
    node = rclpy.create_node("driver")
    offered = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
    asked = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    if driver.fault == "best_effort":
        offered.reliability = ReliabilityPolicy.BEST_EFFORT
    if driver.fault == "latched_reader":
        asked.reliability, asked.durability = (
            ReliabilityPolicy.RELIABLE,
            DurabilityPolicy.TRANSIENT_LOCAL,
        )
    wrong = driver.fault == "state_type"
    publisher = node.create_publisher(
        Float64MultiArray if wrong else JointState, "joint_states", offered
    )

    def take(message: Any) -> None:
        if driver.fault != "command_type":
            driver.command(list(message.name), list(message.effort), time.monotonic())

    node.create_subscription(
        Float64MultiArray if driver.fault == "command_type" else JointState,
        "joint_commands",
        take,
        asked,
    )
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(node)
    print("ready", flush=True)
    period = driver.period * (6.0 if driver.fault == "slow" else 1.0)
    deadline = time.monotonic()
    epoch = time.time() - deadline
    while driver.alive:
        deadline += period
        if deadline < time.monotonic() - 2.0 * PAUSE:
            deadline = time.monotonic()
        while (left := deadline - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left)
        if driver.fault == "jitter" and driver.index % PAUSE_EVERY == 0:
            time.sleep(PAUSE)
        now = time.monotonic()
        fields = driver.step(now)
        if wrong:
            publisher.publish(Float64MultiArray(data=fields["position"]))
            continue
        message = JointState(**fields)
        stamp = round(1e9 * driver.stamp(now + epoch))
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        publisher.publish(message)


if __name__ == "__main__":
    main()
