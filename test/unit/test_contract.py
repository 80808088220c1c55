"""Robot description, parameters and CDR templates: what is taken, what is refused and
how.
"""

from __future__ import annotations

import importlib
import math
import re
from array import array
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from dextar_control.contract.controller_parameters import CONTROLLER
from dextar_control.contract.errors import ParameterError, StateError, TrajectoryError
from dextar_control.contract.node_parameters import PARAMETERS
from dextar_control.contract.parameters import Parameter, check_value
from dextar_control.contract.resources import (
    NODES_FILE,
    ROBOT_FILE,
    config_file,
    node_defaults,
)
from dextar_control.contract.robot import (
    ROBOT_KEYS,
    RobotParameters,
    flatten,
    from_flat,
    load_robot,
)
from dextar_control.contract.settings import (
    ESTIMATORS,
    LAWS,
    SETTING_NAMES,
    default_settings,
)
from dextar_control.contract.topics import (
    CONTROLLER_STATE,
    CRITERION,
    CRITERION_NAMES,
    JOINT_COMMANDS,
    JOINT_STATES,
    MARKERS,
    PHASES,
    READABLE_CRITERION,
    READABLE_STATE,
    SERVICES,
    TOPICS,
    Service,
    Topic,
)
from dextar_control.control import law
from dextar_control.control.phases import Phase
from dextar_control.estimation import estimator
from dextar_control.nodekit.cdr import from_time, to_time
from dextar_control.nodekit.layouts import template
from dextar_control.nodekit.node import qos
from dextar_control.nodes import messages
from dextar_control.planning.planner import Plan


def test_both_robot_files_load_and_come_back(robot: RobotParameters) -> None:
    for name in (ROBOT_FILE, "mockup.yaml"):
        again = load_robot(config_file(name))
        assert from_flat(flatten(again)) == again
    assert robot.base_distance == 0.118
    assert {leg.proximal_length for leg in robot.legs} | {
        leg.distal_length for leg in robot.legs
    } == {0.09}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"left.distal_length": -0.09},
            r"robot.left.distal_length = -0.09; it must be > 0",
        ),
        (
            {"right.distal_center": 1.5},
            r"robot.right.distal_center = 1.5; it must lie in \[0, 1\]",
        ),
        (
            {"end_effector_mass": float("nan")},
            r"robot.end_effector_mass = nan; it must be finite",
        ),
        (
            {"left.proximal_mass": -1.0},
            r"robot.left.proximal_mass = -1.0; it must be >= 0",
        ),
        (
            {"working_mode": (1, 2)},
            r"robot.working_mode = \[1, 2\]; each entry must be \+1 or -1",
        ),
        ({"gravity": 9.81}, r"robot.gravity = 9.81; it must be two numbers"),
        ({"max_torque": "strong"}, r"robot.max_torque = 'strong'; it must be a number"),
        (
            {"left.distal_length": 90.0},
            r"robot.left.distal_length = 90.0; 10 is the most, in SI units",
        ),
        (
            {"left.proximal_length": 9.1},
            r"robot.left.proximal_length = 9.1; the other links and the base are 0.388"
            r" m long together, so that the linkage cannot close",
        ),
        (
            {"left.proximal_inertia": 101250.0},
            r"robot.left.proximal_inertia = 101250.0; 100 is the most, in SI units",
        ),
        (
            {"gravity": (0.0, -98.1)},
            r"robot.gravity = \(0.0, -98.1\); 10 is the most, in SI units",
        ),
        (
            {"left.min_angle": -90.0},
            r"robot.left.min_angle = -90.0; 12.5664 is the most, in SI units",
        ),
        ({"left.distal_lenght": 0.09}, r"unknown robot parameter 'left.distal_lenght'"),
    ],
)
def test_a_wrong_robot_is_refused_with_value_and_limit(
    robot: RobotParameters, change: dict, message: str
) -> None:
    with pytest.raises(ParameterError, match=message):
        from_flat(flatten(robot) | change)


def test_a_missing_key_is_named(robot: RobotParameters) -> None:
    flat = flatten(robot)
    del flat["right.rotor_inertia"]
    with pytest.raises(
        ParameterError, match="robot parameter 'right.rotor_inertia' is missing"
    ):
        from_flat(flat)
    del flat["coulomb_speed"]
    with pytest.raises(
        ParameterError,
        match="robot parameters 'right.rotor_inertia', 'coulomb_speed' are missing",
    ):
        from_flat(flat)


def test_a_file_that_is_no_robot_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="No such file"):
        load_robot(tmp_path / "none.yaml")
    (tmp_path / "other.yaml").write_text("a: 1\n")
    with pytest.raises(
        ParameterError, match="'1' stands where 'ros__parameters:' under 'a' is wanted"
    ):
        load_robot(tmp_path / "other.yaml")


def dotted(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """The leaves of nested mappings by dotted name."""
    found: dict[str, Any] = {}
    for name, value in tree.items():
        whole = f"{prefix}{name}"
        found |= (
            dotted(value, f"{whole}.") if isinstance(value, dict) else {whole: value}
        )
    return found


@pytest.mark.parametrize("node", PARAMETERS)
def test_every_parameter_has_one_default_and_every_default_a_parameter(
    node: str,
) -> None:
    own = yaml.safe_load(config_file(NODES_FILE).read_text())[f"/**/{node}"][
        "ros__parameters"
    ]
    names = {spec.name for spec in PARAMETERS[node]}
    assert names >= set(dotted(own))
    defaults = node_defaults(node)
    for spec in PARAMETERS[node]:
        assert (
            check_value(spec, defaults[spec.name], defaults[spec.name])
            == defaults[spec.name]
        )


def test_each_parameter_is_described_by_a_short_sentence_of_its_own() -> None:
    described = {
        (spec.name, spec.description) for specs in PARAMETERS.values() for spec in specs
    } | set(ROBOT_KEYS.items())
    for name, text in described:
        assert (
            text[0].isupper()
            and text.endswith(".")
            and len(text.split()) > 3
            and len(text) <= 160
        ), f"{name}: {text}"
    assert len({text for _, text in described}) == len(described)


@pytest.mark.parametrize(
    "entry",
    [*TOPICS, READABLE_STATE, READABLE_CRITERION, *SERVICES],
    ids=lambda entry: entry.name,
)
def test_each_topic_and_service_is_described_in_sentences(
    entry: Topic | Service,
) -> None:
    assert (
        entry.meaning[0].isupper()
        and entry.meaning.endswith(".")
        and len(entry.meaning.split()) > 3
    )


@pytest.mark.parametrize("node", PARAMETERS)
def test_the_file_of_defaults_tells_each_parameters_unit(node: str) -> None:
    section = (
        config_file(NODES_FILE)
        .read_text()
        .partition(f"/**/{node}:")[2]
        .partition("\n/**")[0]
    )
    told, group = {}, ""
    for indent, name, value, unit in re.findall(
        r"^( {4,6})(\w+):([^#\n]*?)(?: # (.*))?$", section, re.MULTILINE
    ):
        if not value.strip():
            group = f"{name}."
            continue
        told[f"{group if len(indent) > 4 else ''}{name}"] = unit
    assert told == {
        spec.name: spec.unit.removesuffix("1")
        for spec in PARAMETERS[node]
        if spec.name in told
    }


def test_each_setting_of_the_loop_is_a_described_parameter() -> None:
    described = {spec.name: spec for spec in CONTROLLER}
    for name in SETTING_NAMES:
        value = attrgetter(name)(default_settings())
        assert described[name].live == isinstance(value, float)


@pytest.mark.parametrize(
    ("spec", "value", "default", "message"),
    [
        (
            Parameter("rate", "", (1.0, 10.0)),
            11.0,
            5.0,
            r"'rate' = 11.0; it must be <= 10",
        ),
        (Parameter("rate", "", (1.0, 10.0)), float("nan"), 5.0, "it must be finite"),
        (Parameter("rate", ""), "fast", 5.0, "it must be a number"),
        (Parameter("count", ""), 1.5, 5, "it must be an integer"),
        (Parameter("point", "", size=2), [1.0], [0.0, 0.0], "it must be 2 numbers"),
        (Parameter("point", "", size=2), [1.0], [], r"it must be 2 numbers or \[\]"),
        (
            Parameter("point", "", size=2),
            array("d", [float("nan"), 1.0]),
            [],
            r"'point' = \[nan, 1.0\]; it must be finite",
        ),
        (Parameter("points", ""), ["a"], [], "it must be numeric"),
        (Parameter("law", "", choices=("a", "b")), "c", "a", "it must be one of a, b"),
        (Parameter("flag", ""), 1, True, "it must be true or false"),
    ],
)
def test_a_parameter_out_of_bounds_is_named(
    spec: Parameter, value: object, default: object, message: str
) -> None:
    with pytest.raises(ParameterError, match=message):
        check_value(spec, value, default)


def test_an_integer_serves_where_a_float_is_meant() -> None:
    assert check_value(Parameter("rate", ""), 5, 1.0) == 5.0


@pytest.mark.parametrize(
    ("value", "taken"), [(None, []), ([], []), ([0, 1], [0.0, 1.0])]
)
def test_an_array_that_may_be_empty_is_one_of_floats(
    value: object, taken: list[float]
) -> None:
    cast = check_value(Parameter("point", "", size=2), value, [])
    assert cast == taken
    assert all(isinstance(number, float) for number in cast)


def test_every_law_and_estimator_that_is_named_is_there() -> None:
    assert tuple(law.LAWS) == LAWS
    assert tuple(estimator.ESTIMATORS) == ESTIMATORS


@pytest.mark.parametrize("entry", [*TOPICS, *SERVICES], ids=lambda entry: entry.name)
def test_types_of_topics_and_services_exist(entry: Topic | Service) -> None:
    package, kind, name = entry.type.split("/")
    assert hasattr(importlib.import_module(f"{package}.{kind}"), name)


def test_the_phases_are_the_loops_own() -> None:
    assert [(number, name) for number, name in enumerate(PHASES)] == [
        (phase.value, phase.name.lower()) for phase in Phase
    ]


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_the_table_says_what_the_nodes_offer_and_enforce(topic: Topic) -> None:
    profile = qos(topic)
    assert (profile.reliability.name == "RELIABLE") == topic.reliable
    assert (profile.durability.name == "TRANSIENT_LOCAL") == topic.latched
    assert profile.depth == topic.depth
    parameters = {
        node: {spec.name for spec in specs} for node, specs in PARAMETERS.items()
    }
    for limit in topic.timeouts:
        assert limit.parameter in parameters[limit.node]
        assert node_defaults(limit.node)[limit.parameter] > 0.0
    assert topic.unit and topic.stamp


def test_streams_come_at_the_rate_of_the_samples() -> None:
    for topic in TOPICS:
        drawing = node_defaults("markers")["rate"] if topic is MARKERS else 0.0
        rates = (
            drawing,
            5.0,
            node_defaults("plant")["simulation.clock_rate"],
            1.0 / node_defaults("plant")["task.sample_period"],
        )
        assert topic.rate in rates, topic.name


def test_joints_are_written_in_the_order_of_the_table() -> None:
    state = deserialize_message(template(JOINT_STATES).pack(0, [0.0] * 6), JointState)
    command = deserialize_message(
        template(JOINT_COMMANDS).pack(0, [0.0] * 2), JointState
    )
    platform = deserialize_message(
        template(CONTROLLER_STATE).pack(0, [0.0] * 18), JointTrajectory
    )
    assert tuple(state.name) == JOINT_STATES.joints
    assert tuple(command.name) == JOINT_COMMANDS.joints
    assert tuple(platform.joint_names) == CONTROLLER_STATE.joints
    assert CRITERION.joints == ()


def test_templates_are_the_middlewares_own_bytes() -> None:
    raw = template(CONTROLLER_STATE).pack(
        3_000_000_007, [float(i) for i in range(18)], 1_500_000_000
    )
    message = deserialize_message(raw, JointTrajectory)
    assert from_time(message.header.stamp) == 3_000_000_007
    assert list(message.joint_names) == ["x", "y"]
    assert list(message.points[0].positions) == [0.0, 1.0]
    assert list(message.points[1].velocities) == [8.0, 9.0]
    assert list(message.points[3].effort) == [16.0, 17.0]
    assert (
        message.points[0].time_from_start.sec,
        message.points[0].time_from_start.nanosec,
    ) == (1, 500_000_000)
    criterion = deserialize_message(
        template(CRITERION).pack(5, range(1, 1 + len(CRITERION_NAMES))), JointState
    )
    read = dict(zip(criterion.name, criterion.position, strict=True))
    assert (read["phase"], read["mode_confidence"], read["verdict"]) == (6.0, 7.0, 8.0)
    assert (read["torque_limit"], read["innovation_q11"], read["disturbance_q21"]) == (
        9.0,
        11.0,
        16.0,
    )


def test_a_template_reads_what_another_publisher_wrote() -> None:
    states = template(JOINT_STATES)
    message = JointState(
        name=["q11", "q21"], position=[1.0, 2.0], velocity=[3.0, 4.0], effort=[5.0, 6.0]
    )
    message.header.stamp = to_time(42)
    raw = bytes(serialize_message(message))
    states.learn(raw)
    assert states.unpack(raw) == (42, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    message.name = ["q21", "q11"]
    assert states.unpack(bytes(serialize_message(message))) is None


def test_joint_states_are_taken_by_name() -> None:
    message = JointState(name=["other", "q21", "q11"], position=[0.0, 2.0, 1.0])
    np.testing.assert_array_equal(messages.active_joints(message), [1.0, 2.0])


@pytest.mark.parametrize(
    ("names", "positions", "message"),
    [
        (["q11"], [1.0], "'q21' is missing"),
        (["q11", "q21"], [1.0], "1 positions for 2 names"),
        (["q11", "q21"], [1.0, float("nan")], "must be finite"),
    ],
)
def test_joint_states_that_cannot_be_used_are_refused(
    names: list[str], positions: list[float], message: str
) -> None:
    with pytest.raises(StateError, match=message):
        messages.active_joints(JointState(name=names, position=positions))


def test_a_trajectory_survives_its_message(trip: Plan) -> None:
    times = np.union1d(trip.certificate.profile.time, trip.certificate.crossing_times)
    times = times[np.concatenate([[True], np.diff(times) > 2e-9])]
    again = messages.to_trajectory(messages.from_trajectory(trip.trajectory, times))
    for time in np.linspace(0.0, trip.trajectory.duration, 301):
        np.testing.assert_allclose(
            again.at(time).x, trip.trajectory.at(time).x, atol=1e-9
        )


def test_a_foreign_trajectory_is_refused(trip: Plan) -> None:
    message = messages.from_trajectory(trip.trajectory, np.array([0.0, 0.5, 1.0]))
    message.joint_names = ["tool"]
    with pytest.raises(TrajectoryError, match=r"joint_names are \['tool'\]"):
        messages.to_trajectory(message)
    message = messages.from_trajectory(trip.trajectory, np.array([0.0, 0.5, 1.0]))
    message.points[1].velocities = []
    with pytest.raises(TrajectoryError, match="point 1 has 0 velocities; expected 1"):
        messages.to_trajectory(message)


def test_a_description_without_joint_ranges_has_none(robot: RobotParameters) -> None:
    flat = {
        key: value
        for key, value in flatten(robot).items()
        if not key.endswith("_angle")
    }
    legs = from_flat(flat).legs
    assert {(leg.min_angle, leg.max_angle) for leg in legs} == {(-math.pi, math.pi)}


def test_motor_axes_are_told_by_their_distance_or_each_by_its_place(
    robot: RobotParameters,
) -> None:
    old = {
        key: value for key, value in flatten(robot).items() if not key.endswith(".axis")
    }
    assert from_flat(old) == robot
    assert [leg.axis for leg in robot.legs] == [(-0.059, 0.0), (0.059, 0.0)]
    places = {"left.axis": (-0.06, 0.001), "right.axis": [0.058, -0.002]}
    placed = robot.replace(**places)
    assert [leg.axis for leg in placed.legs] == [(-0.06, 0.001), (0.058, -0.002)]
    assert placed.base_distance == pytest.approx(math.hypot(0.118, 0.003), abs=1e-15)
    assert (
        from_flat(
            {
                key: value
                for key, value in flatten(placed).items()
                if key != "base_distance"
            }
        )
        == placed
    )
    assert placed.replace(base_distance=0.118) == robot
    with pytest.raises(
        ParameterError,
        match=r"base_distance = 0.118 with motor axes 0.1180\d+ m apart; leave out",
    ):
        from_flat(old | places)
    with pytest.raises(ParameterError, match="is that of the right motor too"):
        robot.replace(**{"left.axis": (0.1, 0.0), "right.axis": (0.1, 0.0)})


@pytest.mark.parametrize(
    "key, value, said",
    [
        (
            "left.encoder_offset",
            4.0,
            r"left.encoder_offset = 4.0; it must lie in \[-pi, pi\]",
        ),
        (
            "right.transmission_stiffness",
            -1.0,
            "right.transmission_stiffness = -1.0; it must be >= 0",
        ),
        (
            "left.passive_coulomb_friction",
            -1.0,
            "left.passive_coulomb_friction = -1.0; it must be >= 0",
        ),
        (
            "left.transmission_damping",
            0.1,
            "left.transmission_damping = 0.1 without a transmission_stiffness",
        ),
        (
            "pin_coulomb_friction",
            float("inf"),
            "pin_coulomb_friction = inf; it must be finite",
        ),
        ("left.axis", (0.0,), r"left.axis = \(0.0,\); it must be two numbers"),
    ],
)
def test_what_a_description_may_leave_out_is_checked_where_it_is_said(
    robot: RobotParameters, key: str, value: Any, said: str
) -> None:
    flat = {name: number for name, number in flatten(robot).items() if name != key}
    if not key.endswith("axis"):
        assert from_flat(flat) == robot
    with pytest.raises(ParameterError, match=said):
        from_flat(flat | {key: value})


def test_a_misspelt_setting_is_named() -> None:
    with pytest.raises(
        ParameterError,
        match="unknown setting 'watch_torqe'; did you mean 'torque_limit.min_torque'?",
    ):
        default_settings(watch_torqe=10.0)
