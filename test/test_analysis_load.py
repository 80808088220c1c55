"""Loading a bag: contents, cut-off files, foreign files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from synthetic_run import MISSED, START, TICKS, TRUE_OFFSET, effort_at, joints_of, path, robot, write_run

from dextar_control.analysis.load import load_run
from dextar_control.contract.errors import BagError


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("run") / "run.mcap"
    write_run(file)
    return file


def test_every_stream_comes_back_by_name_and_stamp(bag: Path) -> None:
    run = load_run(bag)
    assert run.states.stamps[0] == START
    assert len(run.states.stamps) == TICKS
    assert tuple(run.states.position[100]) == joints_of(path(0.1)[0] + TRUE_OFFSET)
    assert len(run.commands.stamps) == TICKS - len(MISSED)
    assert tuple(run.commands.effort[0]) == effort_at(0)
    assert np.isnan(run.commands.position).all()
    assert run.control.time[250] == 0.25
    assert tuple(run.control.reference[250]) == (0.0, path(0.25)[0])
    assert tuple(run.control.output[250]) == (0.0, path(0.25)[2])
    assert tuple(run.control.wrench[250]) == (0.0, 1.0)
    assert run.criterion.assembly_mode[0] == 1.0
    assert run.truth is not None
    assert run.truth.x.shape == (TICKS, 2)
    assert run.trajectory is not None
    assert run.trajectory.x_ddot[10, 1] == path(0.01)[2]
    assert run.diagnostics["plant"]["late_commands"] == "7"
    assert run.robot == robot()
    assert not run.truncated


def test_a_rigs_bag_has_no_truth(tmp_path: Path) -> None:
    write_run(tmp_path / "rig.mcap", truth=False)
    assert load_run(tmp_path / "rig.mcap").truth is None


@pytest.mark.parametrize("share", [0.55, 0.9, 0.999])
def test_a_cut_off_file_loads_up_to_its_last_complete_chunk(bag: Path, tmp_path: Path, share: float) -> None:
    cut = tmp_path / "cut.mcap"
    content = bag.read_bytes()
    cut.write_bytes(content[: int(share * len(content))])
    with pytest.warns(UserWarning, match="last complete chunk"):
        run = load_run(cut)
    assert run.truncated
    assert 0 < len(run.states.stamps) <= TICKS
    assert run.robot == robot()


def test_a_file_without_end_record_keeps_every_sample(bag: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(bag.read_bytes()[:-20])
    with pytest.warns(UserWarning, match="last complete chunk"):
        assert len(load_run(cut).states.stamps) == TICKS


@pytest.mark.parametrize(
    ("content", "sentence"),
    [(b"", "is empty"), (b"PK\x03\x04 something else entirely", "not an MCAP file"), (b"\x89MCAP0\r\n", "no ROS 2 message")],
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_unusable_file_is_named_in_one_sentence(tmp_path: Path, content: bytes, sentence: str) -> None:
    file = tmp_path / "strange.mcap"
    file.write_bytes(content)
    with pytest.raises(BagError, match=sentence) as caught:
        load_run(file)
    assert str(file) in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="No such file"):
        load_run(tmp_path / "none.mcap")


def test_the_analysis_needs_neither_ros_nor_the_simulator() -> None:
    code = "import sys, dextar_control.analysis.report; print([n for n in ('rclpy', 'pybullet') if n in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
