"""From a bag to a run: no ROS installation, no model, only the file."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dextar_control.analysis.bag import read_bag
from dextar_control.analysis.run import Control, Criterion, Floats, Joints, Run, Served, Stamps, Truth
from dextar_control.contract import topics
from dextar_control.contract.errors import BagError, ParameterError
from dextar_control.contract.robot import JOINT_NAMES, ROBOT_KEYS, RobotParameters, from_flat

NANOSECONDS = 1_000_000_000
PARAMETER_PREFIX = "parameters."
_POINT_FIELDS = (
    ("positions", "velocities", "accelerations"),
    ("positions", "velocities"),
    ("positions", "velocities"),
    ("accelerations", "effort"),
)


def load_run(path: str | Path) -> Run:
    """A recorded run.

    Raises:
        BagError: the file is missing, empty, foreign or holds no joint states.
    """
    bag = read_bag(path)
    record = bag.metadata.get("dextar", {})
    try:
        resolved: dict[str, str] = json.loads(record.get("contract", "{}"))
        losses = json.loads(record.get("topics", "{}"))
        parameters = {
            key.removeprefix(PARAMETER_PREFIX): yaml.safe_load(text) or {}
            for key, text in record.items()
            if key.startswith(PARAMETER_PREFIX)
        }
    except (ValueError, yaml.YAMLError) as error:
        raise BagError(f"{bag.path}: its metadata record 'dextar' cannot be read: {error}") from error

    def of(topic: topics.Topic) -> list[Any]:
        return bag.of(topic.name, resolved)

    states = _joints(bag.timed(topics.JOINT_STATES.name, resolved), JOINT_NAMES)
    if len(states.stamps) == 0:
        raise BagError(f"{bag.path} holds no message of {topics.JOINT_STATES.name}: not a run of this robot")
    return Run(
        path=bag.path,
        states=states,
        commands=_joints(bag.timed(topics.JOINT_COMMANDS.name, resolved), JOINT_NAMES),
        control=_control(of(topics.CONTROLLER_STATE)),
        criterion=_criterion(of(topics.CRITERION)),
        truth=_truth(of(topics.SIM_END_EFFECTOR), bag.timed(topics.SIM_JOINT_STATES.name, resolved)),
        trajectory=_trajectory(of(topics.TRAJECTORY)),
        diagnostics=_diagnostics(of(topics.DIAGNOSTICS), _namespace(resolved)),
        parameters=parameters,
        robot=_robot(parameters),
        losses=losses,
        version=record.get("version", ""),
        truncated=bag.truncated,
    )


def _nanoseconds(time: Any) -> int:
    return int(time.sec) * NANOSECONDS + int(time.nanosec)


def _in_order(messages: Sequence[Any]) -> tuple[list[Any], Stamps]:
    """Messages by rising stamp, the first of each stamp."""
    stamps = np.array([_nanoseconds(message.header.stamp) for message in messages], dtype=np.int64)
    unique, rows = np.unique(stamps, return_index=True)
    return [messages[row] for row in rows], unique


def _columns(messages: Sequence[Any], names: Sequence[str], pick: Callable[[Any], Any]) -> Floats:
    """One field of JointStates (n, k) by name; nan where a message does not have it."""
    table = np.full((len(messages), len(names)), np.nan)
    orders: dict[tuple[str, ...], list[int]] = {}
    for row, message in enumerate(messages):
        present = tuple(message.name)
        if present not in orders:
            orders[present] = [present.index(name) if name in present else -1 for name in names]
        values = pick(message)
        for column, index in enumerate(orders[present]):
            if 0 <= index < len(values):
                table[row, column] = values[index]
    return table


def _joints(timed: Sequence[tuple[int, Any]], names: Sequence[str]) -> Joints:
    ordered, stamps = _in_order([message for _, message in timed])
    first: dict[int, int] = {}
    for time, message in timed:
        first.setdefault(_nanoseconds(message.header.stamp), time)
    published = np.array([first[stamp] for stamp in stamps.tolist()], dtype=np.int64)
    return Joints(
        stamps=stamps,
        position=_columns(ordered, names, lambda message: message.position),
        velocity=_columns(ordered, names, lambda message: message.velocity),
        effort=_columns(ordered, names, lambda message: message.effort),
        published=published,
    )


def _control(messages: Sequence[Any]) -> Control:
    ordered, stamps = _in_order(messages)
    count = len(ordered)
    time = np.full(count, np.nan)
    table = np.full((9, count, 2), np.nan)
    for row, message in enumerate(ordered):
        index = 0
        for point, names in zip(message.points, _POINT_FIELDS, strict=False):
            for name in names:
                values = getattr(point, name)
                if len(values) == 2:
                    table[index, row] = values
                index += 1
        if len(message.points):
            time[row] = _nanoseconds(message.points[0].time_from_start) / NANOSECONDS
    return Control(stamps, time, *table)


def _criterion(messages: Sequence[Any]) -> Criterion:
    ordered, stamps = _in_order(messages)
    table = _columns(ordered, topics.CRITERION_NAMES, lambda message: message.position)
    phase = np.nan_to_num(table[:, 5], nan=-1.0).astype(np.int64)
    residual, s, sigma_min, weight, mode, _, confidence, verdict = table.T
    return Criterion(stamps, residual, s, sigma_min, weight, mode, phase, confidence, verdict)


def _truth(platform: Sequence[Any], joints: Sequence[tuple[int, Any]]) -> Truth | None:
    ordered, stamps = _in_order(platform)
    active = _joints(joints, JOINT_NAMES)
    common, rows, joint_rows = np.intersect1d(stamps, active.stamps, assume_unique=True, return_indices=True)
    if len(common) == 0:
        return None
    table = np.array(
        [
            (m.pose.pose.position.x, m.pose.pose.position.y, m.twist.twist.linear.x, m.twist.twist.linear.y)
            for m in ordered
        ]
    )[rows]
    return Truth(common, table[:, 0:2], table[:, 2:4], active.position[joint_rows])


def _trajectory(messages: Sequence[Any]) -> Served | None:
    for message in reversed(messages):
        if len(message.points) < 2:
            continue
        time = np.array([_nanoseconds(point.time_from_start) / NANOSECONDS for point in message.points])

        def vectors(pick: Callable[[Any], Any], points: Any = message.points) -> Floats:
            return np.array([(pick(point).x, pick(point).y) for point in points])

        return Served(
            time,
            vectors(lambda p: p.transforms[0].translation),
            vectors(lambda p: p.velocities[0].linear),
            vectors(lambda p: p.accelerations[0].linear),
        )
    return None


def _namespace(resolved: dict[str, str]) -> str | None:
    """The recorded robot's namespace ("" is the root) by a topic of its own; None when no name tells."""
    for topic in (topics.JOINT_STATES, topics.JOINT_COMMANDS, topics.CONTROLLER_STATE, topics.CRITERION):
        name = resolved.get(topic.name, "")
        if name.endswith(f"/{topic.name}"):
            return name.removesuffix(f"/{topic.name}")
    return None


def _diagnostics(messages: Sequence[Any], namespace: str | None) -> dict[str, dict[str, Any]]:
    """Last status per node name, of that namespace's nodes alone when it is known."""
    last: dict[str, dict[str, Any]] = {}
    for message in messages:
        for status in message.status:
            where, _, node = status.name.rpartition("/")
            if namespace is not None and where != namespace:
                continue
            values: dict[str, Any] = {entry.key: entry.value for entry in status.values}
            level = status.level
            values["level"] = level[0] if isinstance(level, (bytes, bytearray)) else int(level)
            values["message"] = status.message
            last[node] = values
    return last


def _robot(parameters: dict[str, dict[str, Any]]) -> RobotParameters | None:
    """The controller's robot, else any node's that has one."""
    for node in ("controller", *parameters):
        flat = {key.removeprefix("robot."): value for key, value in parameters.get(node, {}).items()
                if key.startswith("robot.")}  # fmt: skip
        try:
            return from_flat({key: flat[key] for key in ROBOT_KEYS})
        except (KeyError, ParameterError):
            continue
    return None
