"""Masses and friction come back from the torques of an exciting motion, with deviations
that hold; else it is refused or said.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic_run as made
import yaml
from browser import looks_right

from dextar_control.bags.writer import BagWriter, SerializedMessage
from dextar_control.cli import main as cli
from dextar_control.contract.errors import (
    CalibrationError,
    GeometryError,
    TrajectoryError,
)
from dextar_control.contract.robot import RobotParameters, flatten, load_robot
from dextar_control.experiments.campaign import self_calibration
from dextar_control.experiments.campaign.design import CrossingPoint, Trial
from dextar_control.experiments.campaign.self_calibration import record_motion
from dextar_control.experiments.campaign.trial import run_trial, sample_points
from dextar_control.identification.dynamics import DynamicFit
from dextar_control.identification.identification import (
    Identification,
    identify_recorded,
)
from dextar_control.identification.quantities import UNITS
from dextar_control.identification.recorded import MeasuredMotion
from dextar_control.mechanisms import DETAILED_FIVE_BAR, mechanism_named
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.model.regressor import regressors, sizes_of, unknowns_of
from dextar_control.planning.certificate import Plan
from dextar_control.planning.excitation import CLEAR_S, SPEED, TORQUE, plan_excitation
from dextar_control.planning.regular import straight
from dextar_control.planning.trajectory import Trajectory
from dextar_sim.rig import Rig

ROBOT = made.robot()
START = np.array([-0.025, 0.115])
ROUGH = {
    "left.proximal_mass": 0.17,
    "right.distal_mass": 0.07,
    "right.rotor_inertia": 2.3e-4,
    "end_effector_mass": 0.06,
    "left.coulomb_friction": 0.05,
    "right.coulomb_friction": 0.03,
    "left.passive_coulomb_friction": 0.01,
    "right.passive_coulomb_friction": 0.006,
    "pin_coulomb_friction": 0.01,
    "gravity": (0.5, -0.6),
}


@functools.cache
def exciting() -> Plan:
    return plan_excitation(ROBOT, START, 12.0, 0.2)


@functools.cache
def recorded(plant: str = "cartesian", **rig: Any) -> MeasuredMotion:
    """What a robot that is not the one described records of the exciting motion."""
    return record_motion(
        ROBOT, exciting(), Rig(ROBOT.replace(**ROUGH), plant=plant, **rig)
    )


@functools.cache
def plain() -> MeasuredMotion:
    return record_motion(ROBOT, exciting(), Rig(ROBOT, plant="cartesian"))


@functools.cache
def identified() -> Identification:
    return identify_recorded(ROBOT, [recorded()])


def true_numbers(robot: RobotParameters, found: DynamicFit) -> np.ndarray:
    return DETAILED_FIVE_BAR.values(flatten(robot))[[one.row for one in found.unknowns]]


def test_the_exciting_motion_keeps_clear_and_comes_back() -> None:
    plan = exciting()
    profile, way = plan.certificate.profile, plan.trajectory
    assert abs(profile.s).min() >= CLEAR_S
    assert np.ptp(np.sign(profile.s)) == 0.0
    assert plan.certificate.peak_torque <= 1.01 * TORQUE * ROBOT.max_torque
    assert (
        plan.certificate.peak_platform_speed <= 1.01 * SPEED * ROBOT.max_platform_speed
    )
    assert 10.0 <= way.duration <= 16.0
    for time in (0.0, way.duration):
        assert np.abs(way.at(time).x - START).max() < 1e-12
        assert not way.at(time).x_dot.any()


def test_the_exciting_motion_is_the_same_each_time_and_tells_more_than_a_line() -> None:
    short = plan_excitation(ROBOT, START, 5.0, 0.2)
    np.testing.assert_array_equal(
        short.trajectory.coefficients,
        plan_excitation(ROBOT, START, 5.0, 0.2).trajectory.coefficients,
    )
    assert (
        0.0 < plan_excitation(ROBOT, START, 0.1, 0.0).trajectory.duration < 2.0
    )  # of less than a loop one is left
    p = DETAILED_FIVE_BAR.values(flatten(ROBOT))

    def information(way: Trajectory) -> float:
        slopes = (
            regressors(DETAILED_FIVE_BAR)
            .batch("planned")(p, *way.table(np.linspace(0.0, way.duration, 1000)))
            .torque_slopes
        )
        rows = (slopes * sizes_of(DETAILED_FIVE_BAR, p) / 0.005).reshape(
            -1, slopes.shape[2]
        )
        return float(np.linalg.slogdet(np.eye(rows.shape[1]) + rows.T @ rows)[1])

    line = straight(START, START + [0.03, 0.02], 0.4)
    assert information(short.trajectory) > information(line) + 30.0


@pytest.mark.parametrize(
    ("start", "error"),
    [
        ((0.0, 0.0845), TrajectoryError),
        ((-0.025, 0.097), TrajectoryError),
        ((0.5, 0.5), GeometryError),
    ],
)
def test_an_exciting_motion_needs_room(
    start: tuple[float, float], error: type[Exception]
) -> None:
    with pytest.raises(error, match="start"):
        plan_excitation(ROBOT, np.array(start), 5.0, 0.2)


@pytest.mark.parametrize(
    "mechanism",
    [DETAILED_FIVE_BAR, mechanism_named("three_rrr")],
    ids=lambda one: one.name,
)
def test_the_equation_is_linear_in_what_is_looked_for(mechanism: Mechanism) -> None:
    names = [one.name for one in unknowns_of(mechanism)]
    assert not any(
        "length" in name or "center" in name or "speed" in name for name in names
    )
    assert {"gravity.x", "gravity.y"} < set(names)
    generator, n = np.random.default_rng(1), mechanism.n
    gap = regressors(mechanism).fast("gap")
    p = generator.uniform(0.5, 1.5, mechanism.symbols()[0].shape[0])
    for row, one in enumerate(unknowns_of(mechanism)):
        state = [generator.uniform(0.5, 1.5, n) for _ in range(5)]
        other = p.copy()
        other[one.row] += 3.0
        before, after = gap(p, *state), gap(other, *state)
        np.testing.assert_allclose(
            after.gap, before.gap + 3.0 * before.slopes[:, row], rtol=1e-9, atol=1e-9
        )


def test_the_described_robot_is_found_as_described() -> None:
    found = identify_recorded(ROBOT, [plain()])
    for one in found.fit.combinations:
        assert abs(one.after - one.before) <= 4.0 * one.deviation + 1e-6
    assert found.fit.rest[found.fit.used].std() < 2e-4
    assert "tilted" not in " ".join(found.told)
    assert found.after.gravity == pytest.approx((0.0, 0.0), abs=2e-3)


def test_numbers_come_back_within_their_deviations() -> None:
    found = identified()
    true = true_numbers(ROBOT.replace(**ROUGH), found.fit)
    errors = np.array(
        [
            abs(one.after - one.factors @ true) / one.deviation
            for one in found.fit.combinations
        ]
    )
    assert (errors <= 3.0).mean() >= 0.8
    assert errors.max() <= 6.0
    for name, value in ROUGH.items():
        if "coulomb" in name:
            assert abs(found.fit.value(name)[0] - value) <= 5e-4, name
    assert np.hypot(*(np.array(found.after.gravity) - ROUGH["gravity"])) <= 0.12
    assert "The robot is tilted by 4." in " ".join(found.told)
    assert (
        found.fit.rest[found.fit.used].std()
        < 0.1 * found.fit.rest_before[found.fit.used].std()
    )


def test_the_told_combinations_add_up_with_the_numbers_as_they_are_shown() -> None:
    found = identified()
    shown = {one.name: UNITS[one.unit][1] * one.after for one in found.quantities}
    for one in found.fit.combinations:
        first, *others = one.name.split()
        sum_of = shown[first] + sum(
            float(a) * shown[b] for a, b in zip(others[::2], others[1::2], strict=True)
        )
        assert sum_of == pytest.approx(
            UNITS[one.unit][1] * one.after, rel=0.02, abs=2.0
        )


def test_masses_stay_positive_and_what_is_not_told_is_said() -> None:
    found = identified()
    assert all(one.after > 0.0 for one in found.quantities if one.unit.startswith("kg"))
    kept = " ".join(found.kept)
    assert "Single masses and inertias are not told" in kept
    assert "left.transmission_stiffness is not told without" in kept
    assert "kept as rigid" in kept


def test_what_would_be_less_than_nothing_is_kept_at_its_bound_and_told() -> None:
    pushed = with_torque(
        lambda one: one.torque - 0.002 * np.gradient(one.readings, one.time, axis=0)
    )
    found = identify_recorded(ROBOT, [pushed])
    assert found.after.left.viscous_friction == 0.0
    assert "left.viscous_friction would be less than it can be" in " ".join(found.told)


def test_the_transmission_is_told_by_poses_beside_encoders_at_the_motors() -> None:
    belt = ROBOT.replace(
        **{
            f"{side}.transmission_{name}": value
            for side in ("left", "right")
            for name, value in (("stiffness", 100.0), ("damping", 0.014))
        }
    )
    rig = Rig(belt, plant="cartesian", pose_rate=100.0, pose_noise=2e-4)
    found = identify_recorded(ROBOT, [record_motion(ROBOT, exciting(), rig)])
    for told in found.stiffnesses:
        assert told is not None
        assert abs(told.value - 100.0) <= 4.0 * told.deviation
        assert told.deviation <= 40.0
    assert found.after.left.transmission_stiffness == found.stiffnesses[0].value
    assert (
        found.stiffnesses
        != identify_recorded(ROBOT, [plain()]).stiffnesses
        == [None, None]
    )


def with_torque(change: Callable[[MeasuredMotion], np.ndarray]) -> MeasuredMotion:
    return plain()._replace(torque=change(plain()))


def with_readings(change: Callable[[MeasuredMotion], np.ndarray]) -> MeasuredMotion:
    return plain()._replace(readings=change(plain()))


def part(rows: np.ndarray) -> MeasuredMotion:
    one = plain()
    return one._replace(
        time=one.time[rows],
        readings=one.readings[rows],
        torque=one.torque[rows],
        side=one.side[rows],
    )


def forwards() -> MeasuredMotion:
    """A left joint that turns forwards on and on, by its encoder."""
    one = recorded()
    readings = one.readings.copy()
    readings[:, 0] = np.maximum.accumulate(readings[:, 0]) + 0.3 * one.time
    return one._replace(readings=readings)


@pytest.mark.parametrize(
    ("one", "words"),
    [
        (
            lambda: with_readings(lambda one: 0.001 * one.readings),
            "too little motion: the .* encoder moves by .* rad; for",
        ),
        (
            lambda: part(np.arange(1200)),
            "too little motion: \\d+ instants tell something",
        ),
        (
            lambda: with_torque(lambda one: np.full_like(one.torque, np.nan)),
            "has no torque of the left and the right motor",
        ),
        (
            lambda: with_torque(lambda one: one.torque * [1.0, 0.0]),
            "has no torque of the right motor",
        ),
        (
            lambda: with_torque(lambda one: -one.torque),
            "put .* described as|no masses and friction explain",
        ),
        (lambda: with_torque(lambda one: 5.0 * one.torque), "put .* described as"),
        (
            lambda: with_torque(lambda one: one.torque[::-1]),
            "no masses and friction explain|put .* described as",
        ),
        (forwards, "one direction only: the left joint turns forwards"),
    ],
)
def test_what_a_recording_cannot_tell_is_refused_with_what_to_do(
    one: Callable[[], MeasuredMotion], words: str
) -> None:
    with pytest.raises(CalibrationError, match=words) as refusal:
        identify_recorded(ROBOT, [one()])
    assert "--excite" in str(refusal.value) or "Nothing was written" in str(
        refusal.value
    )


def test_bags_of_two_robots_do_not_go_together() -> None:
    with pytest.raises(
        CalibrationError,
        match=(
            r"contradict each other: .* alone leaves .* mN m .*, together .* one by one"
        ),
    ):
        identify_recorded(ROBOT, [plain(), recorded()])
    assert identify_recorded(
        ROBOT, [recorded(), recorded()]
    ).after.left.coulomb_friction == pytest.approx(0.05, abs=5e-4)


def test_a_robot_that_learnt_its_passive_friction_crosses_as_planned(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(self_calibration, "_exciting", lambda robot: exciting())
    point = sample_points(ROBOT, 4, 0, 3)[0]
    given = trial_of(point, {"passive": 0.01, "identified": 1.0})
    row = run_trial(ROBOT, given, Rig)
    assert row["identified"] is True
    assert row["success"] is True
    assert (
        row["max_error"]
        < 0.2 * run_trial(ROBOT, trial_of(point, {"passive": 0.01}), Rig)["max_error"]
    )


def trial_of(point: CrossingPoint, perturbation: dict[str, float]) -> Trial:
    return Trial(
        index=0,
        **point._asdict(),
        direction=1,
        case="",
        perturbation=perturbation,
        law="consistent",
        estimator="observer",
        plant="cartesian",
        seed=1,
        duration=0.33,
        dwell=0.2,
        repeat=1,
        settings={},
    )


def write_bag(file: Path, one: MeasuredMotion) -> Path:
    """A bag of joint states and commands that says its robot."""
    writer, clock = BagWriter(file), made.START
    flat = {
        f"robot.{key}": list(value) if isinstance(value, tuple) else value
        for key, value in flatten(ROBOT).items()
    }
    record = {
        "version": "1",
        "topics": json.dumps({}),
        "parameters.controller": yaml.safe_dump(flat | {"assembly_mode": 1}),
    }
    for time, reading, torque in zip(one.time, one.readings, one.torque, strict=True):
        stamp = made.START + round(1e9 * time)
        for topic, content in (
            ("/joint_states", made.joint_state(stamp, ["q11", "q21"], reading)),
            ("/joint_commands", made.joint_state(stamp, ["q11", "q21"], effort=torque)),
        ):
            if not writer.has_topic(topic):
                writer.add_topic(topic, content.__msgtype__, [])
            clock += 1000
            writer.add(
                SerializedMessage(
                    clock,
                    topic,
                    clock,
                    1,
                    bytes(made.TYPES.serialize_cdr(content, content.__msgtype__)),
                )
            )
    writer.close({"dextar": record})
    return file


def test_the_command_writes_a_robot_file_and_a_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "a.mcap", recorded())
    half = len(plain().time) // 2
    other = write_bag(
        tmp_path / "b.mcap",
        MeasuredMotion(
            *(
                values[half:] if isinstance(values, np.ndarray) else values
                for values in recorded()
            )
        ),
    )
    assert (
        cli.main(
            [
                "identify",
                str(bag),
                "--check",
                str(other),
                "--output",
                str(tmp_path / "out"),
            ]
        )
        == 0
    )
    robot = load_robot(tmp_path / "out" / "identified.yaml")
    assert robot.left.coulomb_friction == pytest.approx(0.05, abs=5e-4)
    assert robot.left.proximal_length == ROBOT.left.proximal_length
    page = (tmp_path / "out" / "identification.html").read_text(encoding="utf-8")
    assert str(other) in page
    looks_right(tmp_path / "out" / "identification.html")
    assert "The robot is tilted" in page
    said = capsys.readouterr().out.replace("\n", " ")
    assert "not used: of torques of" in said
    assert "left.coulomb_friction" in said


def test_the_command_writes_nothing_where_it_refuses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "a.mcap", part(np.arange(300)))
    assert cli.main(["identify", str(bag)]) == 1
    assert "--excite" in capsys.readouterr().err.replace("\n", " ")
    assert [file.name for file in tmp_path.iterdir()] == ["a.mcap"]
