"""A run's numbers computed a second time, from the bag alone, with rosbags and numpy
and nothing of the package.

    python test/tools/independent_numbers.py runs/latest/run.mcap

prints them as JSON: the instants of the crossings, planned and true, the peak torque,
the RMS of the true tracking error. The geometry is read from the controller's
parameters in the bag's metadata record.
"""

from __future__ import annotations

import argparse
import json
import re
import struct
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

TRACKING = (3.0, 4.0)  # the controller's phases TRACK and CROSSING
NEAR = 0.1  # |s|


def metadata(path: Path) -> dict[str, str]:
    """The last metadata record ``dextar`` of an MCAP file: records are opcode, length,
    content; text has its length before it.
    """
    data, place, found = path.read_bytes(), 8, {}

    def text(at: int) -> tuple[str, int]:
        (length,) = struct.unpack_from("<I", data, at)
        return data[at + 4 : at + 4 + length].decode(), at + 4 + length

    while place + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, place)
        if opcode == 0x0C:
            name, at = text(place + 9)
            (size,) = struct.unpack_from("<I", data, at)
            at, end, entries = at + 4, at + 4 + size, {}
            while at < end:
                key, at = text(at)
                entries[key], at = text(at)
            if name == "dextar":
                found = entries
        place += 9 + length
    return found


def geometry(parameters: str) -> dict[str, float]:
    """Lengths in m and working mode from the flat YAML of the controller's
    parameters.
    """

    def number(key: str) -> float:
        return float(re.search(rf"^robot\.{key}: (.*)$", parameters, re.MULTILINE)[1])

    modes = re.search(
        r"^robot\.working_mode:((?:.|\n)*?)(?=^\w|\Z)", parameters, re.MULTILINE
    )[1]
    return {
        "base": number("base_distance"),
        "l1": np.array(
            [number("left.proximal_length"), number("right.proximal_length")]
        ),
        "l2": np.array([number("left.distal_length"), number("right.distal_length")]),
        "mode": np.array([float(sign) for sign in re.findall("-?1", modes)]),
    }


def measure(robot: dict, x: np.ndarray, q_a: np.ndarray) -> np.ndarray:
    """s = r_1 x r_2 / (l2_1 l2_2) of end effectors (n, 2) and active joints (n, 2)."""
    base = np.array([-0.5, 0.5]) * robot["base"]
    r_x = x[:, :1] - base - robot["l1"] * np.cos(q_a)
    r_y = x[:, 1:] - robot["l1"] * np.sin(q_a)
    return (r_x[:, 0] * r_y[:, 1] - r_y[:, 0] * r_x[:, 1]) / np.prod(robot["l2"])


def joints_of(robot: dict, x: np.ndarray) -> np.ndarray:
    """Active joints (n, 2) in the working mode, by the law of cosines."""
    d_x, d_y = x[:, :1] - np.array([-0.5, 0.5]) * robot["base"], x[:, 1:]
    distance = np.hypot(d_x, d_y)
    cosine = (distance**2 + robot["l1"] ** 2 - robot["l2"] ** 2) / (
        2.0 * robot["l1"] * distance
    )
    return np.arctan2(d_y, d_x) + robot["mode"] * np.arccos(cosine)


def quintic(
    time: float, knots: np.ndarray, x: np.ndarray, v: np.ndarray, a: np.ndarray
) -> np.ndarray:
    """The polynomial of degree five between two knots that meets position, velocity and
    acceleration at both.
    """
    row = min(
        max(int(np.searchsorted(knots, time, side="right")) - 1, 0), len(knots) - 2
    )
    h = knots[row + 1] - knots[row]
    u = (time - knots[row]) / h
    start, end = (
        (x[row], h * v[row], h * h * a[row]),
        (x[row + 1], h * v[row + 1], h * h * a[row + 1]),
    )
    weights = [
        1 - 10 * u**3 + 15 * u**4 - 6 * u**5,
        u - 6 * u**3 + 8 * u**4 - 3 * u**5,
        0.5 * (u**2 - 3 * u**3 + 3 * u**4 - u**5),
        10 * u**3 - 15 * u**4 + 6 * u**5,
        -4 * u**3 + 7 * u**4 - 3 * u**5,
        0.5 * (u**3 - 2 * u**4 + u**5),
    ]
    return sum(
        weight * part for weight, part in zip(weights, (*start, *end), strict=True)
    )


def planned_instants(
    robot: dict, knots: np.ndarray, x: np.ndarray, v: np.ndarray, a: np.ndarray
) -> list[float]:
    """Where s of the served trajectory changes sign, by bisection."""

    def s_at(time: float) -> float:
        point = quintic(time, knots, x, v, a)[None]
        return float(measure(robot, point, joints_of(robot, point))[0])

    s = measure(robot, x, joints_of(robot, x))
    found = []
    for row in np.flatnonzero(s[:-1] * s[1:] < 0.0):
        low, high = knots[row], knots[row + 1]
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if s_at(middle) * s[row] > 0.0 else (low, middle)
        found.append(float(0.5 * (low + high)))
    return found


def read(path: Path) -> dict[str, list]:
    """(stamp in ns, message) per topic."""
    store = get_typestore(Stores.ROS2_JAZZY)
    found: dict[str, list] = {}
    with AnyReader([path], default_typestore=store) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if hasattr(message, "header"):
                stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                found.setdefault(connection.topic, []).append((stamp, message))
    return found


def pick(message: object, kind: str, name: str) -> float:
    return getattr(message, kind)[message.name.index(name)]


def numbers(path: Path) -> dict[str, object]:
    """Everything, under the names of ``metrics.json``."""
    robot = geometry(metadata(path)["parameters.controller"])
    topics = read(path)
    busy = {
        stamp
        for stamp, message in topics["/criterion"]
        if pick(message, "position", "phase") in TRACKING
    }
    states = {}
    for stamp, message in topics["/controller_state"]:
        begun = message.points[0].time_from_start
        if stamp in busy:
            states.setdefault(
                stamp,
                (
                    stamp - begun.sec * 10**9 - begun.nanosec,
                    message.points[0].positions,
                ),
            )
    last = states[max(states)][0]
    ticks = sorted(
        stamp for stamp, (start, _) in states.items() if abs(start - last) < 10**6
    )
    start = int(np.median([states[stamp][0] for stamp in ticks]))

    served = [
        message for _, message in topics["/trajectory"] if len(message.points) > 1
    ][-1].points
    knots = np.array(
        [
            (p.time_from_start.sec * 10**9 + p.time_from_start.nanosec) / 1e9
            for p in served
        ]
    )
    x = np.array(
        [(p.transforms[0].translation.x, p.transforms[0].translation.y) for p in served]
    )
    v = np.array([(p.velocities[0].linear.x, p.velocities[0].linear.y) for p in served])
    a = np.array(
        [(p.accelerations[0].linear.x, p.accelerations[0].linear.y) for p in served]
    )
    planned = planned_instants(robot, knots, x, v, a)

    commands = {}
    for stamp, message in topics["/joint_commands"]:
        commands.setdefault(
            stamp, [pick(message, "effort", name) for name in ("q11", "q21")]
        )
    torque = np.array(
        [
            commands[stamp]
            for stamp in sorted(commands)
            if ticks[0] <= stamp <= ticks[-1]
        ]
    )
    result: dict[str, object] = {
        "start_stamp": start,
        "planned_time": planned,
        "peak_torque": float(np.abs(torque).max()),
    }
    if "/sim/end_effector" not in topics:
        return result
    place, joints = {}, {}
    for stamp, message in topics["/sim/end_effector"]:
        place.setdefault(
            stamp, (message.pose.pose.position.x, message.pose.pose.position.y)
        )
    for stamp, message in topics["/sim/joint_states"]:
        joints.setdefault(
            stamp, [pick(message, "position", name) for name in ("q11", "q21")]
        )
    known = [stamp for stamp in ticks if stamp in place and stamp in joints]
    errors = [np.hypot(*(states[stamp][1] - np.array(place[stamp]))) for stamp in known]
    result |= {
        "rms_true_error": float(np.sqrt(np.mean(np.square(errors)))),
        "max_true_error": float(np.max(errors)),
        "final_true_error": float(errors[-1]),
    }

    stamps = sorted(stamp for stamp in place if stamp in joints and stamp >= ticks[0])
    time = np.array([stamp - start for stamp in stamps]) * 1e-9
    s = measure(
        robot,
        np.array([place[stamp] for stamp in stamps]),
        np.array([joints[stamp] for stamp in stamps]),
    )
    rows = np.flatnonzero((s[:-1] * s[1:] <= 0.0) & (s[:-1] != s[1:]))
    zeros = time[rows] - s[rows] * (time[rows + 1] - time[rows]) / (
        s[rows + 1] - s[rows]
    )
    result["true_time"] = (
        [float(zeros[np.abs(zeros - moment).argmin()]) for moment in planned]
        if len(zeros)
        else []
    )

    instants = (
        np.array(
            [
                stamp - start
                for stamp in sorted(commands)
                if ticks[0] <= stamp <= ticks[-1]
            ]
        )
        * 1e-9
    )
    near = np.abs(np.interp(instants, time, s)) < NEAR
    result["peak_torque_near"] = float(np.abs(torque[near]).max())
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("bag", type=Path, help="the .mcap file of one run")
    given = parser.parse_args()
    if not given.bag.is_file():
        parser.error(f"{given.bag} is no file")
    print(json.dumps(numbers(given.bag), indent=2))
