"""A geometry comes back from what its encoders read, with deviations that hold; what
cannot be told is refused or said.
"""

from __future__ import annotations

import functools
import json
import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import synthetic_run as made
import yaml
from browser import looks_right
from closed_loop import running
from scipy.optimize import brentq

from dextar_control.analysis.load import load_run
from dextar_control.bags.writer import BagWriter, SerializedMessage
from dextar_control.cli import main as cli
from dextar_control.contract.errors import CalibrationError
from dextar_control.contract.robot import RobotParameters, flatten, load_robot
from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.experiments.campaign import self_calibration
from dextar_control.identification.calibration import (
    Calibration,
    Prediction,
    calibrate,
    calibrate_recorded,
    predict,
)
from dextar_control.identification.fit import Fit, fit
from dextar_control.identification.folds import Fold, find_folds
from dextar_control.identification.identification import TorquePrediction
from dextar_control.identification.linkage import NAMES, Linkage, described, numbers_of
from dextar_control.identification.recorded import recorded_of
from dextar_control.identification.report import (
    prediction_in_words,
    torque_prediction_in_words,
)
from dextar_control.mechanisms.five_bar_locus import Family
from dextar_control.model.model import Model
from dextar_control.planning.planner import Plan
from dextar_control.planning.tour import plan_tour
from dextar_sim.rig import Rig

ROBOT = made.robot()
NOMINAL = numbers_of(ROBOT)
LINKAGE = Linkage()
PERIOD = 1e-3  # s
FINE, COARSE = 2**17, 2**13  # counts a turn
LENGTHS = [row for row, name in enumerate(NAMES) if "encoder" not in name]
OFFSETS = [row for row, name in enumerate(NAMES) if name.endswith("offset")]
AXES = [
    [NAMES.index(f"{side}.axis.{axis}") for axis in "xy"] for side in ("left", "right")
]
LINKS = [row for row, name in enumerate(NAMES) if name.endswith("length")]
DISTAL = [row for row, name in enumerate(NAMES) if name.endswith("distal_length")]


@functools.cache
def tour() -> Plan:
    """Twelve crossings, eight of them stretched."""
    return plan_tour(ROBOT, 12)


@functools.cache
def path() -> np.ndarray:
    """(n, 2) of the tour, m, a row each period."""
    return np.array(
        [
            tour().trajectory.at(time).x
            for time in np.arange(0.0, tour().trajectory.duration, PERIOD)
        ]
    )


def wrong(
    generator: np.random.Generator, geometry: float = 3e-4, offset: float = 2e-3
) -> np.ndarray:
    """(14,) of a robot that is not the one described."""
    numbers = NOMINAL.copy()
    numbers[LENGTHS] += geometry * generator.uniform(-1.0, 1.0, len(LENGTHS))
    numbers[OFFSETS] += offset * generator.uniform(-1.0, 1.0, 2)
    return numbers


def read(
    numbers: np.ndarray,
    x: np.ndarray,
    counts: int = FINE,
    eccentricity: Sequence[float] = (0.0, 0.0),
) -> np.ndarray:
    """(n, 2) of the encoders of that robot, rad, whose end effector is at x (n, 2), m;
    nan where it does not reach.
    """
    model = Model.of(described(ROBOT, numbers))
    readings = np.array([model.place(row).q_a for row in x]) + numbers[OFFSETS]
    readings = readings + np.array(eccentricity) * np.sin(readings + 0.7)
    count = 2.0 * np.pi / counts
    return np.round(readings / count) * count


def as_kept(numbers: np.ndarray) -> np.ndarray:
    """The same robot turned, moved and scaled until what folds cannot tell is as
    described.
    """
    kept, turn = numbers.copy(), numbers[OFFSETS].mean()
    scale = NOMINAL[DISTAL].sum() / numbers[DISTAL].sum()
    cosine, sine = np.cos(turn), np.sin(turn)
    half = (
        0.5
        * scale
        * np.array([[cosine, -sine], [sine, cosine]])
        @ (numbers[AXES[1]] - numbers[AXES[0]])
    )
    kept[OFFSETS] -= turn
    kept[LINKS] *= scale
    kept[AXES[0]], kept[AXES[1]] = -half, half
    return kept


def folds_of(readings: np.ndarray, bag: int = 0) -> list[Fold]:
    known = np.isfinite(readings).all(axis=1)
    return find_folds(
        LINKAGE,
        NOMINAL,
        ROBOT.working_mode,
        np.flatnonzero(known) * PERIOD,
        readings[known],
        bag,
    )


def deviations(found: Fit) -> np.ndarray:
    """(14,) standard, of the numbers."""
    return np.sqrt(np.diag(found.covariance))


def run_of(
    readings: np.ndarray,
    x: np.ndarray | None = None,
    noise: float = 2e-4,
    robot: RobotParameters = ROBOT,
) -> Any:
    """What a calibration reads of a bag; with the end effector seen each tenth period
    where its x (n, 2), m, is given.
    """
    stamps = np.arange(len(readings), dtype=np.int64) * 1_000_000 + made.START
    poses = None
    if x is not None:
        seen = x[::10] + noise * np.random.default_rng(5).standard_normal(
            (len(x[::10]), 2)
        )
        poses = SimpleNamespace(stamps=stamps[::10], x=seen)
    states = SimpleNamespace(stamps=stamps, position=readings)
    none = SimpleNamespace(stamps=stamps[:0], effort=np.zeros((0, 2)))
    return SimpleNamespace(
        path=Path("run.mcap"),
        states=states,
        robot=robot,
        poses=poses,
        commands=none,
        criterion=none,
        parameters={},
    )


def test_the_folds_are_the_crossings_and_say_nothing_against_the_true_robot() -> None:
    numbers = wrong(np.random.default_rng(1))
    folds = folds_of(read(numbers, path()))
    certificate = tour().certificate
    assert [fold.family.name.lower() for fold in folds] == [
        crossing.family for crossing in certificate.crossings
    ]
    assert (
        np.abs(
            np.array([fold.time for fold in folds]) - certificate.crossing_times
        ).max()
        < 0.005
    )
    found = fit(LINKAGE, numbers, folds, directions=())
    assert np.abs(found.gaps).max() < 3e-6
    assert (
        max(
            np.hypot(*(one.x - crossing.x))
            for one, crossing in zip(found.touches, certificate.crossings, strict=True)
        )
        < 2e-3
    )


def test_numbers_come_back_within_their_deviations() -> None:
    generator, shares, errors = np.random.default_rng(2), [], []
    free = [*LENGTHS, *OFFSETS]
    for _ in range(8):
        numbers = wrong(generator)
        found = fit(LINKAGE, NOMINAL, folds_of(read(numbers, path())))
        errors.append(np.abs(found.numbers - as_kept(numbers)))
        shares.append(errors[-1][free] <= 3.0 * deviations(found)[free])
    assert np.mean(shares) >= 0.95
    assert np.max(errors, axis=0)[LENGTHS].max() <= 20e-6
    assert np.median(errors, axis=0)[OFFSETS].max() <= 30e-6
    assert np.max(errors, axis=0)[OFFSETS].max() <= 80e-6


def test_a_tour_that_the_robot_was_driven_through_calibrates_it() -> None:
    numbers = wrong(np.random.default_rng(3))
    readings = driven(numbers)
    found = fit(LINKAGE, NOMINAL, folds_of(readings))
    assert found.used.sum() == 12
    assert np.abs(found.numbers - as_kept(numbers))[LENGTHS].max() <= 20e-6


def driven(numbers: np.ndarray) -> np.ndarray:
    """What the encoders read while the controller drives a robot through the tour that
    it takes for the described one.
    """
    loop = ControlLoop(
        ROBOT, default_settings(), -int(tour().certificate.crossing_signs[0])
    )
    rig = Rig(described(ROBOT, numbers), plant="cartesian", encoder_resolution=FINE)
    start = loop.model.place(tour().trajectory.at(0.0).x)
    rig.reset_joints(start.q_a, round(np.sign(start.s[0])))
    loop.schedule(tour().trajectory, tour().certificate)
    rows = [sample.q_a for sample, _ in running(loop, rig, count=len(path()))]
    rig.close()
    return np.array(rows)


@pytest.mark.parametrize(("before", "counts"), [(0.0, True), (5e-3, False)])
def test_where_the_robot_turned_back_tells_as_much_if_it_touched(
    before: float, counts: bool
) -> None:
    numbers = wrong(np.random.default_rng(4))
    model, at = Model.of(described(ROBOT, numbers)), tour().trajectory.at
    planned = tour().certificate.crossing_times[2]
    touches = brentq(
        lambda time: model.place(at(time).x).s[0], planned - 0.02, planned + 0.02
    )
    turned_at = touches - before
    x, turn, span = path().copy(), math.ceil(turned_at / PERIOD), 60
    for row in range(turn, turn + span):
        x[row] = at(2.0 * turned_at - row * PERIOD).x  # back as it came
    pieces = [x[: turn + span], path()[turn + span :]]
    folds = [
        fold
        for bag, piece in enumerate(pieces)
        for fold in folds_of(read(numbers, piece), bag)
    ]
    found = fit(LINKAGE, NOMINAL, folds)
    turned = int(
        np.argmin([abs(fold.time - turn * PERIOD) + fold.bag for fold in folds])
    )
    assert found.used[turned] == counts
    assert found.used.sum() == len(folds) - (not counts)
    assert np.abs(found.numbers - as_kept(numbers))[LENGTHS].max() <= 20e-6


def test_an_encoder_off_its_centre_is_allowed_for() -> None:
    numbers = wrong(np.random.default_rng(6))
    found = fit(
        LINKAGE, NOMINAL, folds_of(read(numbers, path(), eccentricity=(3e-4, -2e-4)))
    )
    assert 3e-5 <= found.encoder_error <= 1e-3
    assert deviations(found)[LENGTHS].max() > 1e-5
    assert (
        np.abs(found.numbers - as_kept(numbers))[LINKS]
        <= 4.0 * deviations(found)[LINKS]
    ).all()


def test_coarse_encoders_tell_less_and_say_so() -> None:
    numbers = wrong(np.random.default_rng(7))
    found = fit(LINKAGE, NOMINAL, folds_of(read(numbers, path(), COARSE)))
    assert deviations(found)[LENGTHS].max() > 1e-5
    assert (
        np.abs(found.numbers - as_kept(numbers))[LENGTHS]
        <= 3.0 * deviations(found)[LENGTHS]
    ).all()


def test_with_poses_every_number_comes_back() -> None:
    numbers = wrong(np.random.default_rng(8))
    found = calibrate([run_of(read(numbers, path()), path())])
    assert found.kept == []
    assert np.abs(found.fit.numbers - numbers)[LENGTHS].max() <= 40e-6
    assert (
        np.abs(found.fit.numbers - numbers)[:12]
        <= 3.5 * deviations(found.fit)[:12] + 1e-12
    ).all()
    assert found.fit.place_noise == pytest.approx(2e-4, rel=0.1)


def test_poses_that_jump_are_left_out() -> None:
    numbers = wrong(np.random.default_rng(9))
    run = run_of(read(numbers, path()), path())
    run.poses.x[::25] += 0.02
    found = calibrate([run])
    assert len(run.poses.x) - found.fit.places == pytest.approx(
        len(run.poses.x[::25]), abs=3
    )
    assert np.abs(found.fit.numbers - numbers)[LENGTHS].max() <= 40e-6


def calibrated(numbers: np.ndarray) -> Calibration:
    return calibrate([run_of(read(numbers, path()))])


def test_what_is_not_told_is_kept_and_said_with_its_number() -> None:
    found = calibrated(wrong(np.random.default_rng(10)))
    assert found.fit.numbers[DISTAL].sum() == pytest.approx(0.18, abs=1e-12)
    assert found.fit.numbers[OFFSETS].sum() == pytest.approx(0.0, abs=1e-12)
    text = " ".join(found.kept)
    assert "the distal lengths' sum was kept at 180.0000 mm" in text
    assert "(0.0000, 0.0000) mm" in text
    assert "the mean of the encoder offsets was kept at 0.0000 mrad" in text
    stretched = path()[: round(3.55 / PERIOD)]  # the first eight crossings
    found = calibrate([run_of(read(NOMINAL, stretched))])
    assert {fold.family for fold in found.folds} == {Family.STRETCHED}
    assert "kept at 90.0000 and 90.0000 mm" in " ".join(found.kept)


def test_a_bag_that_did_not_serve_is_predicted() -> None:
    numbers = wrong(np.random.default_rng(11))
    found = calibrated(numbers)
    other = predict(found, run_of(read(numbers, path()[::-1])))
    assert other.folds == 12
    assert other.before > 50e-6
    assert other.after < 3e-6


def behind_belts(numbers: np.ndarray, stiffness: float, known: float) -> Calibration:
    """By a tour of a robot with its encoders at the motors, of whose belts the
    description knows ``known``, N m/rad.
    """
    belts = {f"{side}.transmission_stiffness": stiffness for side in ("left", "right")}
    belts |= {f"{side}.transmission_damping": 0.017 for side in ("left", "right")}
    rig = Rig(
        described(ROBOT, numbers).replace(**belts),
        plant="cartesian",
        pose_rate=100.0,
        pose_noise=2e-4,
    )
    told = belts | {
        f"{side}.transmission_stiffness": known for side in ("left", "right")
    }
    described_so = ROBOT.replace(**told) if known else ROBOT
    recorded = self_calibration.record_motion(described_so, tour(), rig)
    return calibrate_recorded(described_so, [recorded], poses=known == 0.0)


def test_belts_of_the_file_are_taken_off_the_encoders() -> None:
    numbers = wrong(np.random.default_rng(13))
    found = behind_belts(numbers, 150.0, 150.0)
    assert np.abs(found.fit.numbers - as_kept(numbers))[LENGTHS].max() <= 30e-6
    assert "the transmissions were kept as 150 N m/rad and 150 N m/rad" in " ".join(
        found.kept
    )


def test_belts_that_no_file_knows_show_in_poses() -> None:
    numbers = wrong(np.random.default_rng(14))
    found = behind_belts(numbers, 150.0, 0.0)
    rows = [*LENGTHS, *OFFSETS]
    assert np.abs(found.fit.numbers - numbers)[LENGTHS].max() <= 80e-6
    assert (
        np.abs(found.fit.numbers - numbers)[rows] <= 3.5 * deviations(found.fit)[rows]
    ).all()
    told = [one for one in found.quantities if one.unit == "N m/rad"]
    assert told
    assert all(abs(one.after - 150.0) <= 4.0 * one.deviation for one in told)
    assert "rigid" in " ".join(calibrated(wrong(np.random.default_rng(14))).kept)


def test_a_tour_that_ends_early_is_made_up_for_the_other_way_round() -> None:
    numbers, signs = (
        NOMINAL.copy(),
        [-1, 1, 1, 1, 1, 1, -1, -1],
    )  # this one turns at its first crossing
    numbers[LENGTHS] += 5e-4 * np.array(signs)
    built, rigs = described(ROBOT, numbers), list[Rig]()

    def rig() -> Rig:
        rigs.append(Rig(built, plant="cartesian", pose_rate=100.0, pose_noise=2e-4))
        return rigs[-1]

    found, told = self_calibration.calibrated_description(
        ROBOT, rig, calibrated=True, identified=False
    )
    assert told == {"calibrated": True}
    assert len(rigs) == 2
    assert np.abs(numbers_of(found) - numbers)[LENGTHS].max() <= 60e-6


def short() -> np.ndarray:
    """The tour's way through its first three crossings."""
    return path()[: round((tour().certificate.crossing_times[2] + 0.1) / PERIOD)]


def believed(side: float) -> Any:
    """The whole tour, of which the controller believed that it stayed on one side; 0 is
    that it did not know.
    """
    run = run_of(read(NOMINAL, path()))
    run.criterion = SimpleNamespace(
        stamps=run.states.stamps, assembly_mode=np.full(len(path()), side)
    )
    return run


def test_a_robot_that_did_not_change_sides_crossed_nowhere_and_cannot_check() -> None:
    found = calibrated(wrong(np.random.default_rng(15)))
    with pytest.raises(CalibrationError, match="cannot check: no crossing"):
        predict(found, believed(-1.0))
    assert predict(found, believed(0.0)).folds == 12


def test_encoders_that_begin_anew_each_turn_are_read_on() -> None:
    readings = read(NOMINAL, path())
    middle = float(np.median(readings[:, 0]))
    wrapped = readings - 2.0 * np.pi * (readings > [middle, 9.0])
    read_on = recorded_of(run_of(wrapped), ROBOT, "").readings
    assert (
        np.abs(np.diff(wrapped, axis=0)).max()
        > 6.0
        > 0.5
        > np.abs(np.diff(read_on, axis=0)).max()
    )
    assert np.abs(np.exp(1j * read_on) - np.exp(1j * readings)).max() < 1e-9


def test_a_check_that_the_numbers_do_not_explain_says_so() -> None:
    one = Prediction(Path("b.mcap"), 9, 8e-4, 7e-6, np.nan, np.nan)
    assert "do not hold" not in prediction_in_words(one)
    assert "do not hold" in prediction_in_words(one._replace(after=7e-4))
    other = TorquePrediction(Path("b.mcap"), 300, 0.1, 0.04, 0.002)
    assert "do not hold" not in torque_prediction_in_words(other)
    assert "do not hold" in torque_prediction_in_words(other._replace(after=0.03))


def slipped(readings: np.ndarray) -> np.ndarray:
    """An encoder that slips again and again."""
    readings = readings.copy()
    for begin in range(600, 5400, 600):
        readings[begin:, 0] += 0.008
    return readings


@pytest.mark.parametrize(
    ("run", "words"),
    [
        (
            lambda: run_of(read(NOMINAL, short())),
            "too few crossings: [34] for 5 quantities .* more are needed; record",
        ),
        (
            lambda: run_of(read(NOMINAL, path()[:150])),
            "too little motion: the left encoder moves by .* rad",
        ),
        (
            lambda: run_of(read(NOMINAL, path()[200:290])),
            "no crossing: the elbows, .* nowhere turn back",
        ),
        (
            lambda: run_of(
                np.concatenate([read(NOMINAL, path()[: round(1.1 / PERIOD)])] * 4)
            ),
            "not at all|to \\+-",
        ),
        (
            lambda: run_of(slipped(read(NOMINAL, path()))),
            "no geometry explains|tell left.proximal_length to .* mm",
        ),
        (
            lambda: run_of(read(NOMINAL, path(), eccentricity=(2e-3, -2e-3))),
            "the encoders seem to err by some [13] mrad",
        ),
        (
            lambda: run_of(read(NOMINAL, path()), path() + 0.008),
            "put left.axis.x .8.* mm from the description",
        ),
        (
            lambda: run_of(read(NOMINAL, path()), path(), noise=0.02),
            "external poses scatter",
        ),
        (lambda: run_of(read(NOMINAL, path()), robot=None), "does not say which robot"),
        (
            lambda: run_of(read(NOMINAL, path()[:60]) * [1.0, np.nan]),
            "0 joint states have both angles; 50 are the least",
        ),
        (
            lambda: run_of(read(NOMINAL, path()[:20])),
            "20 joint states have both angles; 50 are the least",
        ),
        (
            lambda: run_of(read(NOMINAL, path()), 0.0 * path() + [0.02, 0.08]),
            "external poses(?: agree .*)?: check their frame",
        ),
        (
            lambda: run_of(read(NOMINAL, path()), path() * [-1.0, 1.0]),
            "external poses (scatter|agree) .* check their frame",
        ),
        (lambda: believed(1.0), "no crossing"),
    ],
)
def test_what_a_bag_cannot_tell_is_refused_with_what_to_do(
    run: Any, words: str
) -> None:
    with pytest.raises(CalibrationError, match=words):
        calibrate([run()])


def test_bags_of_two_geometries_do_not_go_together() -> None:
    readings = read(NOMINAL, short())
    other = ROBOT.replace(**{"left.proximal_length": 0.091})
    with pytest.raises(CalibrationError, match="another geometry"):
        calibrate([run_of(readings), run_of(readings, robot=other)])


def test_bags_of_two_robots_of_one_description_do_not_go_together() -> None:
    runs = [
        run_of(read(wrong(np.random.default_rng(seed)), path())) for seed in (16, 17)
    ]
    with pytest.raises(
        CalibrationError,
        match=(
            r"contradict each other: .* alone leaves .* mm .*, together .* one by one"
        ),
    ):
        calibrate(runs)
    assert (
        calibrate(
            [runs[0], run_of(read(wrong(np.random.default_rng(16)), path()[::-1]))]
        ).fit.used.sum()
        == 24
    )


def write_bag(
    file: Path, readings: np.ndarray, x: np.ndarray | None = None, frame: str = "base"
) -> Path:
    """A bag of joint states that says its robot; with poses of each tenth x (n, 2), m,
    in a frame.
    """
    writer, clock = BagWriter(file), made.START
    flat = {
        f"robot.{key}": list(value) if isinstance(value, tuple) else value
        for key, value in flatten(ROBOT).items()
    }
    record = {
        "version": "1",
        "topics": json.dumps({}),
        "parameters.controller": yaml.safe_dump(flat),
    }
    contents: list[tuple[str, Any]] = []
    for tick, reading in enumerate(readings):
        stamp = made.START + tick * made.PERIOD
        contents.append(
            ("/joint_states", made.joint_state(stamp, ["q11", "q21"], reading))
        )
        if x is not None and tick % 10 == 0:
            contents.append(("/external_pose", pose(stamp, x[tick], frame)))
    for topic, content in contents:
        kind = content.__msgtype__
        if not writer.has_topic(topic):
            writer.add_topic(topic, kind, [])
        clock += 1000
        writer.add(
            SerializedMessage(
                clock, topic, clock, 1, bytes(made.TYPES.serialize_cdr(content, kind))
            )
        )
    writer.close({"dextar": record})
    return file


def pose(stamp: int, x: np.ndarray, frame: str) -> Any:
    header = made.message(
        "std_msgs/msg/Header",
        stamp=made.message(
            "builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9
        ),
        frame_id=frame,
    )
    point = made.message("geometry_msgs/msg/Point", x=float(x[0]), y=float(x[1]), z=0.0)
    turn = made.message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    return made.message(
        "geometry_msgs/msg/PoseStamped",
        header=header,
        pose=made.message("geometry_msgs/msg/Pose", position=point, orientation=turn),
    )


@pytest.mark.parametrize("frame", ["base", "camera"])
def test_poses_in_the_robots_frame_are_read_from_a_bag(
    tmp_path: Path, frame: str
) -> None:
    part = path()[:400]
    with warnings.catch_warnings(record=True) as told:
        run = load_run(write_bag(tmp_path / "a.mcap", read(NOMINAL, part), part, frame))
    assert ["in the frame 'base'" in str(one.message) for one in told] == [True] * (
        frame != "base"
    )
    if frame == "base":
        assert run.poses is not None
        assert np.array_equal(run.poses.x, part[::10])
        assert np.array_equal(run.poses.stamps, run.states.stamps[::10])
    else:
        assert run.poses is None


def test_the_command_writes_a_robot_file_and_a_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers = wrong(np.random.default_rng(12))
    bag, other = (
        write_bag(tmp_path / name, read(numbers, x))
        for name, x in (("a.mcap", path()), ("b.mcap", path()[::-1]))
    )
    assert (
        cli.main(
            [
                "calibrate",
                str(bag),
                "--check",
                str(other),
                "--output",
                str(tmp_path / "out"),
            ]
        )
        == 0
    )
    robot = load_robot(tmp_path / "out" / "calibrated.yaml")
    assert np.abs(numbers_of(robot) - as_kept(numbers))[LENGTHS].max() <= 20e-6
    assert (
        robot.replace(
            **{
                key: flatten(ROBOT)[key]
                for key in flatten(ROBOT)
                if "length" in key or "axis" in key
            }
            | {"left.encoder_offset": 0.0, "right.encoder_offset": 0.0}
        )
        == ROBOT
    )
    page = (tmp_path / "out" / "calibration.html").read_text(encoding="utf-8")
    looks_right(tmp_path / "out" / "calibration.html")
    assert "180.0000 mm" in page
    assert str(other) in page
    assert "12 crossings with gaps of" in capsys.readouterr().out.replace("\n", " ")


def test_the_command_writes_nothing_where_it_refuses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "a.mcap", read(NOMINAL, short()))
    assert cli.main(["calibrate", str(bag)]) == 1
    assert "dextar demo --lockstep --tour 12" in capsys.readouterr().err.replace(
        "\n", " "
    )
    assert [file.name for file in tmp_path.iterdir()] == ["a.mcap"]
    assert cli.main(["calibrate", str(tmp_path / "none.mcap")]) == 2
