"""From a bag to a run: no ROS installation, no model, only the file."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

import numpy as np
import yaml

from dextar_control.analysis.clock import clock_in_words, clock_of
from dextar_control.analysis.run import (
    Control,
    CriterionRecord,
    Floats,
    Joints,
    Poses,
    Run,
    ServedTrajectory,
    Stamps,
    TopicCounts,
    Truth,
)
from dextar_control.bags.damage import Hole, Unreadable, unreadable_lines
from dextar_control.bags.reader import Bag, read_bag
from dextar_control.bags.scan import Progress
from dextar_control.bags.series import Columns, Select, Series, Steady
from dextar_control.contract import topics
from dextar_control.contract.errors import BagError, ParameterError
from dextar_control.contract.former_names import present_names
from dextar_control.contract.node_parameters import parameters_of_node
from dextar_control.contract.robot import (
    JOINT_NAMES,
    ROBOT_KEYS,
    RobotParameters,
    from_flat,
)
from dextar_control.contract.words import counted
from dextar_control.control.verdicts import Verdict

if TYPE_CHECKING:
    from rosbags.typesys.stores import ros2_jazzy as ros

    DiagnosticArray = ros.diagnostic_msgs__msg__DiagnosticArray
    JointState = ros.sensor_msgs__msg__JointState
    JointTrajectory = ros.trajectory_msgs__msg__JointTrajectory
    PoseStamped = ros.geometry_msgs__msg__PoseStamped
    Trajectory = ros.trajectory_msgs__msg__MultiDOFJointTrajectory
    TrajectoryPoint = ros.trajectory_msgs__msg__MultiDOFJointTrajectoryPoint
    Vector3 = ros.geometry_msgs__msg__Vector3

Parameters = dict[str, dict[str, object]]
T = TypeVar("T")
NANOSECONDS = 1_000_000_000
PARAMETER_PREFIX = "parameters."
# most bytes of memory for each recorded second at 1 kHz while a run is loaded and
# measured
MEMORY = 250_000
# ns: where a stream lacks stamps so near to a hole, the hole is why
ANSWERED = 100_000_000
_KINDS = ("position", "velocity", "effort")
JOINT_COLUMNS = [f"{kind}.{name}" for kind in _KINDS for name in JOINT_NAMES]
_POINT_FIELDS = (
    ("positions", "velocities", "accelerations"),
    ("positions", "velocities"),
    ("positions", "velocities"),
    ("accelerations", "effort"),
)
_CONTROL_NAMES = [
    "points.0.time_from_start.sec",
    "points.0.time_from_start.nanosec",
    *(
        f"points.{point}.{kind}.{axis}"
        for point, kinds in enumerate(_POINT_FIELDS)
        for kind in kinds
        for axis in range(len(topics.PLATFORM_NAMES))
    ),
]
_POSE_NAMES = ["pose.position.x", "pose.position.y"]
_MOTION_NAMES = [
    "pose.pose.position.x",
    "pose.pose.position.y",
    "twist.twist.linear.x",
    "twist.twist.linear.y",
]


def load_run(
    path: str | Path,
    namespace: str | None = None,
    progress: Progress | None = None,
    robot: RobotParameters | None = None,
) -> Run:
    """Load a recorded run; also one that ``ros2 bag record`` made, whose parameters are
    then unknown.

    The columns lie in temporary files without names (in TMPDIR, about 1 MB for each
    recorded second at 1 kHz) that are mapped into memory, so that of memory of its own
    a run takes less than MEMORY for each recorded second, also while its metrics are
    computed; the plan that they compute anew comes on top where the trajectory is as
    long as the recording.

    Args:
        path: of the bag: a file, or a folder in rosbag2's layout.
        namespace: of the robot, where a bag of another recorder holds several; where it
            holds one, it must be that one's.
        progress: told the bytes read and those there are.
        robot: of a bag that does not say it, as that of another recorder; the bag's own
            counts.

    Raises:
        BagError: the file is missing, empty, foreign or holds no joint states of one
            robot, or of another than was named.
    """
    bag = read_bag(path, COLUMNS, SELECT, progress, tell=False)
    record = bag.metadata.get("dextar", {})
    try:
        resolved = _table_of(record, "contract", str)
        losses = _losses(_table_of(record, "topics", dict))
        parameters = _parameters(record)
    except (ValueError, RecursionError, yaml.YAMLError, ParameterError) as error:
        why = " ".join(str(error).split())
        bag.faults.append(
            f"{bag.path}: its metadata record 'dextar' cannot be read and is passed"
            f" over: {why}"
        )
        record, resolved, losses, parameters = {}, {}, {}, {}
    if bag.damage:
        warnings.warn(bag.damage, stacklevel=2)

    recorded = _namespace(resolved)
    if (
        namespace is not None
        and recorded is not None
        and namespace.strip("/") != recorded.strip("/")
    ):
        raise BagError(
            f"{bag.path} is of the robot in namespace '{recorded or '/'}', not"
            f" '{namespace}'"
        )
    try:
        run = _run(_Topics(bag, resolved, namespace), record, parameters, losses)
    except BagError as error:
        text = str(error) if str(bag.path) in str(error) else f"{bag.path}: {error}"
        raise BagError(f"{text} ({bag.damage})" if bag.damage else text) from error
    if robot is None or run.robot == robot:
        return run
    if run.robot is None:
        return replace(run, robot=robot)
    told = (
        f"{bag.path} says which robot it is of, and that counts: another description is"
        " for bags that do not"
    )
    warnings.warn(told, stacklevel=2)
    return run


def _table_of(record: dict[str, str], key: str, kind: type[T]) -> dict[str, T]:
    table = json.loads(record.get(key, "{}"))
    if not isinstance(table, dict) or not all(
        isinstance(value, kind) for value in table.values()
    ):
        raise ValueError(f"{key} = {table!r} is no table")
    return table


def _losses(
    table: Mapping[str, dict[str, object]],
) -> dict[str, dict[str, int | None]]:
    return {
        topic: {
            key: value if isinstance(value, int) else None
            for key, value in counts.items()
        }
        for topic, counts in table.items()
    }


def _parameters(record: dict[str, str]) -> Parameters:
    found = {
        key.removeprefix(PARAMETER_PREFIX): yaml.safe_load(text) or {}
        for key, text in record.items()
        if key.startswith(PARAMETER_PREFIX)
    }
    for node, values in found.items():
        if not isinstance(values, dict):
            raise ValueError(f"{values!r} is no table")
        found[node], _ = present_names(parameters_of_node(node), values)
    return found


class _Topics:
    """The topics of a bag that a run needs; what cannot be read of them is warned of
    once.
    """

    def __init__(
        self, bag: Bag, resolved: dict[str, str], namespace: str | None
    ) -> None:
        self.bag, self.resolved = bag, resolved
        self._namespace = namespace
        self._near: str | None = None
        self.used: list[Series] = []

    def of(self, topic: topics.Topic) -> Series:
        """Find the messages of a topic."""
        found = self.bag.series_of(
            topic.name, self.resolved, self._namespace, self._near
        )
        if topic is topics.JOINT_STATES:
            self._near = found.topic.removesuffix(f"/{topic.name}")
        self.used.append(found)
        return found

    def unreadable(self) -> dict[str, Unreadable]:
        """Warn of what could not be decoded of the topics in use, and return it per
        topic.
        """
        found = {
            one.topic: Unreadable(one.unreadable, len(one), one.why)
            for one in self.used
            if one.unreadable
        }
        for line in unreadable_lines(found):
            warnings.warn(line, stacklevel=4)
        for series in self.used:
            if series.untimed:
                warnings.warn(
                    f"{series.topic}: the time of {counted(series.untimed, 'message')}"
                    f" is none ({series.odd_time} ns); the other of its two times, or"
                    " that of the message before, stands for it",
                    stacklevel=4,
                )
        return found


def _run(
    bag_topics: _Topics,
    record: dict[str, str],
    parameters: Parameters,
    losses: dict[str, dict[str, int | None]],
) -> Run:
    bag, of = bag_topics.bag, bag_topics.of
    recorded = of(topics.JOINT_STATES)
    name = topics.JOINT_STATES.name
    if len(recorded) == 0:
        raise BagError(
            f"{bag.path} holds no message of {name}: not a run of this robot"
        )
    if recorded.readable == 0:
        why = recorded.why
        if recorded.untimed:
            why += f"; one has the time {recorded.odd_time} ns: the file is damaged"
        raise BagError(
            f"{bag.path}: none of {counted(len(recorded), 'message')} on"
            f" {recorded.topic} can be read: {why}"
        )
    served = of(topics.TRAJECTORY)
    clock = clock_of(recorded, served.places)
    steady = clock.steady if clock.steps else None
    states = _joints(recorded, steady)
    if np.isnan(states.position).all():
        raise BagError(
            f"{bag.path}: {name} never holds the joints {', '.join(JOINT_NAMES)} of"
            " this robot"
        )
    commands = _joints(of(topics.JOINT_COMMANDS), steady)
    control = _control(of(topics.CONTROLLER_STATE), steady)
    criterion = _criterion(of(topics.CRITERION), steady)
    truth = _truth(of(topics.SIM_END_EFFECTOR), of(topics.SIM_JOINT_STATES), steady)
    answers = {
        part_of.name: part.stamps
        for part_of, part in (
            (topics.JOINT_COMMANDS, commands),
            (topics.CONTROLLER_STATE, control),
            (topics.CRITERION, criterion),
            (topics.SIM_END_EFFECTOR, truth),
        )
        if part is not None
    }
    trajectory = _trajectory(served)
    diagnostics = _diagnostics(of(topics.DIAGNOSTICS), _namespace(bag_topics.resolved))
    poses, unreadable = (
        _poses(of(topics.EXTERNAL_POSE), steady),
        bag_topics.unreadable(),
    )
    for topic, stamps in answers.items():
        if len(stamps) and not np.isin(stamps, states.stamps).any():
            raise BagError(
                f"{bag.path}: none of the {len(stamps)} stamps of {topic} is one of the"
                f" {len(states.stamps)} of {name}: these are streams of different runs,"
                " or of different clocks"
            )
    run = Run(
        path=bag.path,
        states=states,
        commands=commands,
        control=control,
        criterion=criterion,
        truth=truth,
        poses=poses,
        holes=_holes(bag, states, list(answers.values())),
        trajectory=trajectory,
        diagnostics=diagnostics,
        parameters=parameters,
        robot=_robot(parameters),
        losses=losses,
        version=record.get("version", ""),
        record={
            key: text
            for key, text in record.items()
            if key not in ("contract", "topics")
            and not key.startswith(PARAMETER_PREFIX)
        },
        topics={
            name: TopicCounts(
                series.type, len(series), series.first, series.last, series.fallen
            )
            for name, series in bag.messages.items()
        },
        truncated=bag.truncated is not None,
        unreadable=unreadable,
        stamp_steps=clock.steps,
        clock_steps=clock.system_steps,
    )
    if text := clock_in_words(run.stamp_steps, run.clock_steps):
        warnings.warn(text, stacklevel=3)
    return run


def _joint_paths(message: JointState) -> dict[str, str]:
    wanted = [(kind, name) for kind in _KINDS for name in JOINT_NAMES]
    wanted += [("position", name) for name in topics.CRITERION_NAMES]
    return {
        f"{kind}.{name}": f"{kind}.{message.name.index(name)}"
        for kind, name in wanted
        if name in message.name
    }


def _control_paths(message: JointTrajectory) -> dict[str, str]:
    found = {name: name for name in _CONTROL_NAMES[:2]}
    for name in _CONTROL_NAMES[2:]:
        _, point, kind, _ = name.split(".")
        if int(point) < len(message.points) and len(
            getattr(message.points[int(point)], kind)
        ) == len(topics.PLATFORM_NAMES):
            found[name] = name
    return found


def _served(newest: Iterable[Trajectory]) -> list[Trajectory]:
    return list(islice((message for message in newest if len(message.points) > 1), 1))


def _last_statuses(newest: Iterable[DiagnosticArray]) -> list[DiagnosticArray]:
    """Keep the diagnostics that hold the last status of some node."""
    kept, seen = [], set[str]()
    for message in newest:
        names = {status.name for status in message.status}
        if names - seen:
            kept.append(message)
            seen |= names
    return kept


def _pose_paths(message: PoseStamped) -> dict[str, str]:
    """Take the position of a pose in the base frame, nothing of another."""
    in_base = message.header.frame_id == topics.BASE_FRAME
    return {name: name for name in _POSE_NAMES} if in_base else {}


# a series hands each function the messages of the type that it stands under
COLUMNS = cast(
    "dict[str, Columns]",
    {
        topics.JOINT_STATES.type: _joint_paths,
        topics.CONTROLLER_STATE.type: _control_paths,
        topics.EXTERNAL_POSE.type: _pose_paths,
        topics.SIM_END_EFFECTOR.type: lambda _: {name: name for name in _MOTION_NAMES},
    },
)
SELECT = cast(
    "dict[str, Select]",
    {topics.TRAJECTORY.type: _served, topics.DIAGNOSTICS.type: _last_statuses},
)


def _holes(bag: Bag, states: Joints, answers: Sequence[Stamps]) -> list[Hole]:
    """Convert the bag's holes to stamps: each goes from the last state that has all its
    answers to the first one that has them again.
    """
    found = []
    for hole in bag.holes:
        begin = end = None
        if hole.first is not None and (before := states.logged <= hole.first).any():
            last = int(states.stamps[before].max())
            near = (own[(own >= last - ANSWERED) & (own <= last)] for own in answers)
            begin = min([last, *(int(own[-1]) for own in near if len(own))])
        if hole.last is not None and (after := states.logged >= hole.last).any():
            first = int(states.stamps[after].min())
            near = (own[(own >= first) & (own <= first + ANSWERED)] for own in answers)
            end = max([first, *(int(own[0]) for own in near if len(own))])
        found.append(replace(hole, file=Path(hole.file).name, begin=begin, end=end))
    return found


def _joints(series: Series, steady: Steady | None) -> Joints:
    table = series.table(JOINT_COLUMNS, steady)
    position, velocity, effort = (table.values[:, 2 * k : 2 * k + 2] for k in range(3))
    return Joints(
        table.stamps, position, velocity, effort, table.published, table.logged
    )


def _control(series: Series, steady: Steady | None) -> Control:
    table = series.table(_CONTROL_NAMES, steady)
    time = (table.values[:, 0] * NANOSECONDS + table.values[:, 1]) / NANOSECONDS
    return Control(
        table.stamps, time, *(table.values[:, 2 * k : 2 * k + 2] for k in range(1, 10))
    )


def _criterion(series: Series, steady: Steady | None) -> CriterionRecord:
    table = series.table(
        [f"position.{name}" for name in topics.CRITERION_NAMES], steady
    )
    columns = dict(zip(topics.CRITERION_NAMES, table.values.T, strict=True))
    phase = _codes(columns.pop("phase"), range(len(topics.PHASES)), -1.0).astype(
        np.int64
    )
    columns["verdict"] = _codes(columns["verdict"], list(Verdict), np.nan)
    first = topics.CRITERION_NAMES.index(f"innovation_{JOINT_NAMES[0]}")
    innovation, bias, disturbance = (
        table.values[:, first + 2 * k : first + 2 * k + 2] for k in range(3)
    )
    return CriterionRecord(
        stamps=table.stamps,
        phase=phase,
        innovation=innovation,
        bias=bias,
        disturbance=disturbance,
        **{
            name: columns[name]
            for name in (
                "residual",
                "s",
                "sigma_min",
                "projection_weight",
                "assembly_mode",
                "mode_confidence",
                "verdict",
                "torque_limit",
                "innovation_square",
            )
        },
    )


def _codes(values: Floats, known: Iterable[int], unknown: float) -> Floats:
    """Return values (n,) where they are known codes, else ``unknown``."""
    return np.where(np.isin(values, [float(code) for code in known]), values, unknown)


def _truth(platform: Series, joints: Series, steady: Steady | None) -> Truth | None:
    motion, active = platform.table(_MOTION_NAMES, steady), _joints(joints, steady)
    if np.array_equal(motion.stamps, active.stamps):
        return (
            Truth(
                motion.stamps,
                motion.values[:, 0:2],
                motion.values[:, 2:4],
                active.position,
            )
            if len(motion.stamps)
            else None
        )
    common, rows, joint_rows = np.intersect1d(
        motion.stamps, active.stamps, assume_unique=True, return_indices=True
    )
    if len(common) == 0:
        if len(motion.stamps) and len(active.stamps):
            raise BagError(
                "the stamps of the true end effector and of the true joints have none"
                " in common"
            )
        return None
    x, x_dot = motion.values[rows, 0:2], motion.values[rows, 2:4]
    return Truth(common, x, x_dot, active.position[joint_rows])


def _poses(series: Series, steady: Steady | None) -> Poses | None:
    table = series.table(_POSE_NAMES, steady)
    seen = np.isfinite(table.values).all(axis=1)
    if len(table.stamps) and not seen.any():
        warnings.warn(
            f"{series.topic}: no pose counts: none is finite and in the frame"
            f" '{topics.BASE_FRAME}'",
            stacklevel=4,
        )
    return Poses(table.stamps[seen], table.values[seen]) if seen.any() else None


def _trajectory(series: Series) -> ServedTrajectory | None:
    selected = cast("list[Trajectory]", series.messages())
    if not selected:
        return None
    points = selected[0].points
    problems = (
        f"point {number} of {len(points)} has no {field}"
        for number, point in enumerate(points, start=1)
        for field in ("transforms", "velocities", "accelerations")
        if len(getattr(point, field)) == 0
    )
    if problem := next(problems, ""):
        warnings.warn(
            f"{series.topic}: the trajectory cannot be used: {problem}", stacklevel=4
        )
        return None
    clock = [point.time_from_start for point in points]

    def vectors(pick: Callable[[TrajectoryPoint], Vector3]) -> Floats:
        return np.array([(pick(point).x, pick(point).y) for point in points])

    return ServedTrajectory(
        np.array(
            [(one.sec * NANOSECONDS + one.nanosec) / NANOSECONDS for one in clock]
        ),
        vectors(lambda p: p.transforms[0].translation),
        vectors(lambda p: p.velocities[0].linear),
        vectors(lambda p: p.accelerations[0].linear),
    )


def _namespace(resolved: dict[str, str]) -> str | None:
    """Find the recorded robot's namespace ("" is the root) by a topic of its own; None
    where no name tells it.
    """
    for topic in (
        topics.JOINT_STATES,
        topics.JOINT_COMMANDS,
        topics.CONTROLLER_STATE,
        topics.CRITERION,
    ):
        name = resolved.get(topic.name, "")
        if name.endswith(f"/{topic.name}"):
            return name.removesuffix(f"/{topic.name}")
    return None


def _diagnostics(series: Series, namespace: str | None) -> Parameters:
    """Collect the last status per node name, where the namespace is known of its nodes
    alone.
    """
    last: Parameters = {}
    for message in cast("list[DiagnosticArray]", series.messages()):
        for status in message.status:
            where, _, node = status.name.rpartition("/")
            if namespace is not None and where != namespace:
                continue
            values: dict[str, object] = {one.key: one.value for one in status.values}
            level = status.level
            values["level"] = (
                level[0] if isinstance(level, (bytes, bytearray)) else int(level)
            )
            values["message"] = status.message
            last[node] = values
    return last


def _robot(parameters: Parameters) -> RobotParameters | None:
    """Return the controller's robot, else that of any node that has one."""
    for node in ("controller", *parameters):
        flat = {
            key.removeprefix("robot."): value
            for key, value in parameters.get(node, {}).items()
            if key.startswith("robot.")
        }
        try:
            return from_flat({key: flat[key] for key in ROBOT_KEYS if key in flat})
        except ParameterError:
            continue
    return None
