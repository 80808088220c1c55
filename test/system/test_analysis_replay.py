"""Animations show where the robot was, in files and in PyBullet."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pybullet as p
import pytest
from PIL import Image
from synthetic_run import (
    NEAR_TORQUE,
    START,
    TRUE_OFFSET,
    effort_at,
    joints_of,
    path,
    robot,
    write_run,
)

from dextar_control.analysis import Run, load_run
from dextar_control.analysis.animate import _Scene, animate, find_ffmpeg
from dextar_control.analysis.motion import frames_of
from dextar_control.cli import main as cli
from dextar_control.contract.errors import ParameterError
from dextar_sim.replay import Player, read_motion

ROUNDING = 1e-12
GAP = 5e-8  # m: PyBullet keeps the offsets of links in single precision, 7e-9 at 0.1


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("replay") / "run.mcap"
    write_run(file)
    return file


@pytest.fixture(scope="module")
def run(bag: Path) -> Run:
    return load_run(bag)


def ignore(done: int, total: int) -> None:
    pass


def test_frames_are_the_recorded_motion_at_their_times(run: Run) -> None:
    motion = frames_of(run, 0.01, 0.2, 0.4)
    assert motion.true
    assert motion.time == pytest.approx(np.arange(0.2, 0.4001, 0.01))
    for frame, time in enumerate(motion.time):
        y = path(round(time, 3))[0] + TRUE_OFFSET
        assert motion.x[frame] == pytest.approx([0.0, y], abs=ROUNDING)
        assert motion.q_a[frame] == pytest.approx(joints_of(y), abs=ROUNDING)
        assert tuple(motion.torque[frame]) == effort_at(round(1e3 * time))
    assert motion.phase == ["TRACK"] * 21


def test_a_peak_between_two_frames_is_in_the_torques_course(run: Run) -> None:
    motion = frames_of(run, 0.01, 0.2, 0.4)
    assert np.abs(motion.torque).max() < NEAR_TORQUE  # the frames pass over it
    assert np.abs(motion.course).max() == NEAR_TORQUE
    assert (motion.course_time[0], motion.course_time[-1]) == pytest.approx((0.2, 0.4))


def test_the_drawn_linkage_has_the_robots_lengths(run: Run) -> None:
    motion = frames_of(run, 0.05)
    for frame in range(len(motion.time)):
        links = motion.chain(frame)
        lengths = np.hypot(*np.diff(links, axis=0).T)
        assert lengths == pytest.approx([0.09, 0.09, 0.09, 0.09], abs=1e-9)
        assert links[[0, 4]].tolist() == [[-0.059, 0.0], [0.059, 0.0]]


def test_t_s_is_across_the_stretched_distal_links_at_the_crossing(run: Run) -> None:
    motion = frames_of(run, 1e-3)
    frame = int(np.abs(motion.s).argmin())
    assert abs(motion.s[frame]) < 0.01
    assert (
        abs(motion.t_s[frame] @ [1.0, 0.0]) < 0.01
    )  # on the axis the distal links lie level


def test_a_rigs_bag_is_replayed_from_the_estimate(tmp_path: Path) -> None:
    write_run(tmp_path / "rig.mcap", truth=False)
    motion = frames_of(load_run(tmp_path / "rig.mcap"), 0.01)
    assert not motion.true
    assert motion.x[30] == pytest.approx(
        [0.0, path(round(motion.time[30], 3))[0]], abs=ROUNDING
    )


def test_a_gif_has_every_frame_in_its_time(bag: Path, tmp_path: Path) -> None:
    file = tmp_path / "out" / "replay.gif"
    arguments = [
        "replay",
        str(bag),
        "--output",
        str(file),
        "--speed",
        "0.5",
        "--fps",
        "10",
        "--from",
        "0.1",
        "--to",
        "0.5",
    ]
    assert cli.main(arguments) == 0
    with Image.open(file) as picture:
        assert picture.n_frames == 9  # 0.4 s at 0.05 s a frame, both ends
        assert picture.size == (960, 480)
        assert picture.info["duration"] == 100
        frames = []
        for number in (0, 4, 8):
            picture.seek(number)
            frames.append(np.asarray(picture.convert("L"), dtype=float))
    for one, other in ((0, 1), (1, 2)):
        assert (
            np.abs(frames[one] - frames[other]) > 60
        ).sum() > 300  # links, cursors and words have moved
    assert all((frame < 128).mean() > 0.01 for frame in frames)


def test_a_webp_is_dark_where_that_is_asked_for(bag: Path, tmp_path: Path) -> None:
    file = tmp_path / "replay.webp"
    arguments = [
        "replay",
        str(bag),
        "--output",
        str(file),
        "--fps",
        "5",
        "--from",
        "0.3",
        "--to",
        "0.4",
        "--dark",
    ]
    assert cli.main(arguments) == 0
    with Image.open(file) as picture:
        assert picture.n_frames == 3
        assert (
            max(
                picture.convert("L").getpixel((955, 475)),
                picture.convert("L").getpixel((2, 475)),
            )
            < 40
        )


def test_no_time_is_minus_nought(run: Run) -> None:
    motion = frames_of(run, 0.1, 0.0, 0.1)
    scene = _Scene(
        motion._replace(time=motion.time - 4e-4, s=motion.s * 0.0 - 1e-5), 1.0
    )
    scene.show(0)
    assert scene._title.get_text().split()[0] == "0.000"
    assert "s = +0.000" in scene._title.get_text()


def test_an_animation_that_breaks_off_leaves_the_file_that_was_there(
    run: Run, tmp_path: Path
) -> None:
    file = tmp_path / "replay.gif"
    file.write_text("before")

    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        animate(frames_of(run, 0.1), file, 1.0, 10, stop)
    assert [entry.name for entry in tmp_path.iterdir()] == ["replay.gif"]
    assert file.read_text() == "before"


def test_an_mp4_has_every_frame(run: Run, tmp_path: Path) -> None:
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    motion = frames_of(run, 0.02, 0.2, 0.3)
    animate(motion, tmp_path / "replay.mp4", 0.4, 20, ignore)
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "replay.mp4"))
    assert frames == len(motion.time)
    assert seconds == pytest.approx(frames / 20, abs=0.02)


def test_an_mp4_without_ffmpeg_is_refused_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(
        ParameterError, match="apt install ffmpeg, or pip install imageio-ffmpeg"
    ):
        find_ffmpeg()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--output", "x.avi"], "whose name ends in .gif, .webp, .mp4"),
        (
            ["--output", "x.gif", "--speed", "0.001"],
            "a .gif may have 1500: raise --speed",
        ),
        (["--from", "7", "--to", "8"], "its motion is from 0.000 to 1.000 s"),
        (["--window"], "needs a display, and DISPLAY is not set"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_sentence(
    bag: Path,
    arguments: list[str],
    words: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    assert cli.main(["replay", str(bag), *arguments]) == 2
    said, error = capsys.readouterr()
    assert words in error
    assert error.count("\n") == 1
    assert said == ""  # no progress before a refusal


def test_pybullet_shows_the_end_effector_where_it_was(run: Run, tmp_path: Path) -> None:
    motion = frames_of(run, 0.02)
    motion.write(tmp_path / "motion.npz", 0.5)
    player = Player(read_motion(tmp_path / "motion.npz"), window=False)
    try:
        tip = robot().left.distal_length
        for frame in (0, 17, len(motion.time) - 1):
            player.show(frame)
            for link in (1, 3):
                state = p.getLinkState(
                    player.loop.body,
                    player.loop.joints[link],
                    computeForwardKinematics=True,
                    physicsClientId=player.client,
                )
                x, _ = p.multiplyTransforms(
                    state[4], state[5], [tip, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]
                )
                assert x[:2] == pytest.approx(motion.x[frame], abs=GAP)
    finally:
        player.close()


def test_the_windows_program_plays_a_motion_file_to_its_end(
    run: Run, tmp_path: Path
) -> None:
    frames_of(run, 0.05).write(tmp_path / "motion.npz", 0.5)
    command = [
        sys.executable,
        "-m",
        "dextar_sim.replay",
        "--direct",
        str(tmp_path / "motion.npz"),
    ]
    assert subprocess.run(command, check=False, capture_output=True).returncode == 0
    bad = subprocess.run(
        [*command[:-1], str(tmp_path / "none.npz")],
        check=False,
        capture_output=True,
        text=True,
    )
    assert bad.returncode == 2
    assert "cannot read the motion" in bad.stderr and "Traceback" not in bad.stderr


def test_time_zero_is_the_trajectorys_start(run: Run) -> None:
    assert run.states.stamps[0] == START
    assert frames_of(run, 0.1).time[0] == pytest.approx(0.0, abs=1e-9)
