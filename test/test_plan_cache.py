"""Plans kept by content: answered at once, made again when anything differs, never in the way."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest

from dextar_control.contract.robot import RobotParameters
from dextar_control.core import plan_cache, planner
from dextar_control.core.planner import plan_crossing

START, GOAL = np.array([-0.025, 0.115]), np.array([0.01, 0.06])


@pytest.fixture
def searches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """An empty cache in tmp_path; one entry for each plan that is searched for."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    plan_cache.forget()
    count: list[str] = []
    search = planner._between

    def counted(*arguments: object) -> planner.Plan:
        count.append("search")
        return search(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(planner, "_between", counted)
    return count


def _files(folder: Path) -> list[Path]:
    return sorted((folder / "dextar" / "plans").glob("*.npz"))


def test_the_same_request_is_answered_from_memory_and_from_disk(
    robot: RobotParameters, searches: list[str], tmp_path: Path
) -> None:
    first = plan_crossing(robot, START, GOAL, 0.4)
    assert plan_crossing(robot, START.tolist(), tuple(GOAL), 0.4) is first
    plan_cache.forget()
    again = plan_crossing(robot, START, GOAL, 0.4)
    np.testing.assert_array_equal(again.trajectory.coefficients, first.trajectory.coefficients)
    assert again.certificate.to_dict() == first.certificate.to_dict()
    assert len(searches) == len(_files(tmp_path)) == 1


def test_another_number_anywhere_is_another_plan(robot: RobotParameters, searches: list[str]) -> None:
    plan_crossing(robot, START, GOAL, 0.4)
    plan_crossing(robot, START, GOAL, 0.41)
    plan_crossing(robot.replace(end_effector_mass=0.051), START, GOAL, 0.4)
    plan_crossing(robot, START + [1e-9, 0.0], GOAL, 0.4)
    assert len(searches) == 4


def test_the_cache_can_be_left_out(robot: RobotParameters, searches: list[str], tmp_path: Path) -> None:
    for _ in range(2):
        plan_crossing(robot, START, GOAL, 0.4, cache=False)
    assert len(searches) == 2
    assert not _files(tmp_path)


@pytest.mark.parametrize("content", [b"", b"not a plan", b"PK\x03\x04 cut off"])
def test_a_damaged_file_is_planned_again_and_replaced(
    robot: RobotParameters, searches: list[str], tmp_path: Path, content: bytes
) -> None:
    first = plan_crossing(robot, START, GOAL, 0.4)
    _files(tmp_path)[0].write_bytes(content)
    plan_cache.forget()
    again = plan_crossing(robot, START, GOAL, 0.4)
    assert len(searches) == 2
    np.testing.assert_array_equal(again.trajectory.coefficients, first.trajectory.coefficients)
    assert _files(tmp_path)[0].read_bytes() != content


def test_a_file_that_holds_another_motion_is_not_served(
    robot: RobotParameters, searches: list[str], tmp_path: Path
) -> None:
    first = plan_crossing(robot, START, GOAL, 0.4)
    trajectory = first.trajectory
    moved = trajectory.coefficients.copy()
    moved[:, 0] += 2e-3
    np.savez(_files(tmp_path)[0], knots=trajectory.knots, origins=trajectory.origins, coefficients=moved)
    plan_cache.forget()
    again = plan_crossing(robot, START, GOAL, 0.4)
    assert len(searches) == 2
    np.testing.assert_array_equal(again.trajectory.coefficients, trajectory.coefficients)


def test_a_cache_that_cannot_be_written_stops_nothing(
    robot: RobotParameters, searches: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    monkeypatch.setattr(tempfile, "tempdir", str(blocked))
    plan_crossing(robot, START, GOAL, 0.4)
    plan_cache.forget()
    plan_crossing(robot, START, GOAL, 0.4)
    assert len(searches) == 2
