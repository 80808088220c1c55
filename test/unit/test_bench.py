"""The bench tells runs apart by their joint states."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

from synthetic_run import PERIOD, START, TYPES, joint_state

from dextar_control.bags.writer import BagWriter, SerializedMessage
from dextar_control.experiments.bench_stack import fingerprint

KIND = "sensor_msgs/msg/JointState"


def fingerprint_of(folder: Path, states: Sequence[tuple[int, float]]) -> str:
    """Return the fingerprint of a run of these states: tick and q11, rad."""
    folder.mkdir()
    writer = BagWriter(folder / "run.mcap")
    writer.add_topic("/joint_states", KIND, [])
    for row, (tick, q11) in enumerate(states):
        state = joint_state(START + tick * PERIOD, ["q11", "q21"], (q11, 0.0))
        raw = bytes(TYPES.serialize_cdr(state, KIND))
        writer.add(SerializedMessage(START + row, "/joint_states", START, 1, raw))
    writer.close({})
    end = {"start_stamp": START, "tracked_until": 0.003}
    (folder / "metrics.json").write_text(json.dumps(end))
    return fingerprint(folder)


def test_a_state_sent_again_counts_once_and_every_other_difference_shows(
    tmp_path: Path,
) -> None:
    states = [(0, 0.1), (1, 0.2), (2, 0.3)]
    once = fingerprint_of(tmp_path / "once", states)
    assert fingerprint_of(tmp_path / "again", [*states[:2], *states[1:]]) == once
    assert fingerprint_of(tmp_path / "later", [*states, (4, 0.5)]) == once
    others = [
        [(0, 0.1), (1, math.nextafter(0.2, 1.0)), (2, 0.3)],
        [(0, 0.1), (2, 0.3)],
        [*states, (3, 0.3)],
        [*states[:2], (1, 0.25), states[2]],
    ]
    for row, other in enumerate(others):
        assert fingerprint_of(tmp_path / str(row), other) != once
