"""One recorded run as arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dextar_control.bags.damage import Hole, Unreadable
from dextar_control.bags.series import Floats as Floats
from dextar_control.bags.series import Stamps as Stamps
from dextar_control.contract.robot import RobotParameters
from dextar_control.control.phases import Phase as Phase


def seconds(nanoseconds: Stamps) -> Floats:
    """Convert times (n,) from ns to s."""
    return np.asarray(nanoseconds, dtype=np.float64) * 1e-9


def rows_between(time: Floats, first: float, last: float) -> slice[int, int, None]:
    """Find the rows of rising times (n,), s, that lie in [first, last)."""
    begin, end = np.searchsorted(time, (first, last)).tolist()
    return slice(begin, end)


def number_of(value: object) -> float:
    """Read a recorded value as a number; nan where it is none."""
    try:
        return float(value) if isinstance(value, (int, float, str)) else math.nan
    except (ValueError, OverflowError):
        return math.nan


@dataclass(frozen=True)
class Joints:
    """Joint states or commands; columns in the order of the contract's joint names.

    Attributes:
        stamps: (n,) ns, rising; where their clock stepped back they are put in the
            order of record, and go on from there.
        position, velocity: (n, k) rad, rad/s; nan where not sent.
        effort: (n, k) N m; nan where not sent.
        published, logged: (n,) when the message was published and when the recorder had
            it, ns of the system clock.
    """

    stamps: Stamps
    position: Floats
    velocity: Floats
    effort: Floats
    published: Stamps
    logged: Stamps


@dataclass(frozen=True)
class Control:
    """The controller's state at each tick.

    Attributes:
        stamps: (n,) ns of the state answered.
        time: (n,) s since the trajectory's start; meaningless when not tracking.
        reference, reference_dot, reference_ddot: (n, 2) m, m/s, m/s^2.
        estimate, estimate_dot: (n, 2) m, m/s.
        error, error_dot: (n, 2) m, m/s.
        output: (n, 2) auxiliary acceleration, m/s^2.
        wrench: (n, 2) J_inv^T tau, N.
    """

    stamps: Stamps
    time: Floats
    reference: Floats
    reference_dot: Floats
    reference_ddot: Floats
    estimate: Floats
    estimate_dot: Floats
    error: Floats
    error_dot: Floats
    output: Floats
    wrench: Floats


@dataclass(frozen=True)
class CriterionRecord:
    """The crossing criterion at each tick, and what else the controller knew; all (n,)
    where no shape is told.

    Attributes:
        stamps: ns of the state answered.
        residual: t_s.w_d, N.
        s: singularity measure, estimated.
        sigma_min, projection_weight: 1.
        assembly_mode: +1 or -1, estimated.
        phase: a ``Phase``.
        mode_confidence: in the assembly mode, 0.5 to 1; nan when not recorded.
        verdict: a ``Verdict`` on the planned crossing that began last; nan when not
            recorded.
        torque_limit: at which the torques were cut, N m; nan when not recorded.
        innovation: (n, 2) of the observer: joints less those that it expected, rad;
            innovation_square: (n,) over its covariance; bias: (n, 2) what a wrong
            geometry adds to the joints, rad; disturbance: (n, 2) torques at the joints
            that the model lacks, N m. Nan when not recorded; 0 with estimators that
            have none.
    """

    stamps: Stamps
    residual: Floats
    s: Floats
    sigma_min: Floats
    projection_weight: Floats
    assembly_mode: Floats
    phase: NDArray[np.int64]
    mode_confidence: Floats
    verdict: Floats
    torque_limit: Floats
    innovation_square: Floats
    innovation: Floats
    bias: Floats
    disturbance: Floats


@dataclass(frozen=True)
class Truth:
    """Where the simulated end effector and joints really were.

    Attributes:
        stamps: (n,) ns.
        x, x_dot: (n, 2) m, m/s.
        q_a: (n, 2) active joints, rad.
    """

    stamps: Stamps
    x: Floats
    x_dot: Floats
    q_a: Floats


@dataclass(frozen=True)
class Poses:
    """External measurements of the end effector, in the base frame.

    Attributes:
        stamps: (n,) ns, when they were true.
        x: (n, 2) m.
    """

    stamps: Stamps
    x: Floats


@dataclass(frozen=True)
class ServedTrajectory:
    """The trajectory as it was served.

    Attributes:
        time: (m,) s.
        x, x_dot, x_ddot: (m, 2) m, m/s, m/s^2.
    """

    time: Floats
    x: Floats
    x_dot: Floats
    x_ddot: Floats


@dataclass(frozen=True)
class TopicCounts:
    """What a bag holds of one topic.

    Attributes:
        type: ``package/msg/Type``.
        count: of its messages.
        first, last: log times, ns of the recorder's system clock.
        fallen: by how much that clock fell back between them, ns.
    """

    type: str
    count: int
    first: int
    last: int
    fallen: int = 0


@dataclass(frozen=True, eq=False)
class Run:
    """Everything that the analysis knows of a run, from its bag alone.

    Attributes:
        truth: None in a rig's bag.
        poses: None where none was recorded.
        trajectory: the last one served with points, or None.
        diagnostics: per node name, the keys of its last status, with ``level`` (int)
            and ``message``.
        parameters: per node name, its parameters.
        robot: as the controller had it, or None.
        losses: per topic name, {received, lost, dropped}; lost is None when not known.
        record: what else the recorder wrote about the run: when it started and ended,
            its name, notes, versions ...
        topics: per topic name, how much of it there is.
        truncated: the end of the bag is missing.
        holes: what is missing before.
        unreadable: per topic name, what could not be decoded of what is needed.
        stamp_steps: by how much the clock of the states' stamps stepped back, each
            time, s.
        clock_steps: the same of the recorder's system clock.
    """

    path: Path
    states: Joints
    commands: Joints
    control: Control
    criterion: CriterionRecord
    truth: Truth | None
    trajectory: ServedTrajectory | None
    diagnostics: dict[str, dict[str, object]] = field(default_factory=dict)
    parameters: dict[str, dict[str, object]] = field(default_factory=dict)
    robot: RobotParameters | None = None
    losses: dict[str, dict[str, int | None]] = field(default_factory=dict)
    version: str = ""
    record: dict[str, str] = field(default_factory=dict)
    topics: dict[str, TopicCounts] = field(default_factory=dict)
    truncated: bool = False
    holes: list[Hole] = field(default_factory=list)
    unreadable: dict[str, Unreadable] = field(default_factory=dict)
    stamp_steps: list[float] = field(default_factory=list)
    clock_steps: list[float] = field(default_factory=list)
    poses: Poses | None = None

    def parameter(self, node: str, name: str) -> object:
        """Return a node's parameter as it was recorded; None where it was not."""
        return self.parameters.get(node, {}).get(name)
