"""A whole check has two parts: what a quiet watch tells, and the report once the
torques were sent or not.
"""

from __future__ import annotations

from collections.abc import Sequence

from dextar_control.check_rig.limits import Limits
from dextar_control.check_rig.report import (
    TORQUE_LINES,
    CheckLine,
    Result,
    in_order,
    skipped,
)
from dextar_control.check_rig.samples import Graph, JointSample
from dextar_control.check_rig.stream import judge_graph, judge_stream, judge_velocity
from dextar_control.check_rig.torque import TorqueTests
from dextar_control.contract.robot import RobotParameters

# Lines that must hold, as far as the controller needs them, before a torque is sent.
NEEDED_FOR_TORQUE = (
    "topics",
    "types",
    "QoS",
    "only commander",
    "states",
    "joint names",
    "array sizes",
    "finite numbers",
    "stamp period",
    "closes",
)


def watch_lines(
    graph: Graph,
    samples: Sequence[JointSample],
    robot: RobotParameters,
    limits: Limits,
    duration: float,
) -> list[CheckLine]:
    """Return the lines that need no torque, the velocity's apart.

    Args:
        graph: who stands at the topics.
        samples: of a quiet watch, in the order of their arrival.
        robot: whose links must close.
        limits: what is allowed.
        duration: of the watch, s.
    """
    return judge_graph(graph) + judge_stream(samples, robot, limits, duration)


def torque_obstacle(lines: Sequence[CheckLine]) -> str:
    """Return why no torque may be sent after these lines; empty when it may."""
    results = {line.name: line.result for line in lines}
    bad = [name for name in NEEDED_FOR_TORQUE if results.get(name) is Result.FAIL]
    bad = bad or [
        name
        for name in NEEDED_FOR_TORQUE
        if results.get(name) not in (Result.PASS, Result.NOTE)
    ]
    return (
        f"needs the line{'s' if len(bad) > 1 else ''} {', '.join(bad)}" if bad else ""
    )


def torque_tests(lines: Sequence[CheckLine], limits: Limits) -> TorqueTests:
    """Return the tests that may follow a quiet watch."""
    has_effort = any(
        line.name == "effort feedback" and line.result is Result.PASS for line in lines
    )
    return TorqueTests(limits, has_effort=has_effort)


def report(
    lines: Sequence[CheckLine],
    samples: Sequence[JointSample],
    torque: TorqueTests | str,
) -> list[CheckLine]:
    """Return all lines, in order.

    Args:
        lines: of the quiet watch.
        samples: of the quiet watch.
        torque: the finished tests, or why there were none.
    """
    stretches, all_lines = [samples], list(lines)
    if isinstance(torque, str):
        all_lines += [skipped(name, torque) for name in TORQUE_LINES]
    else:
        all_lines += torque.lines
        stretches += [trial.samples for trial in torque.trials]
    if not any(line.name == "velocity" for line in all_lines):
        all_lines.append(judge_velocity(stretches))
    return in_order(all_lines)
