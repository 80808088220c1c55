"""A mechanism that contradicts itself is refused in one sentence that names it."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from dextar_control.contract.errors import GeometryError, ParameterError
from dextar_control.contract.robot import RobotParameters, flatten
from dextar_control.mechanisms import MECHANISMS, mechanism_named
from dextar_control.mechanisms.five_bar import FiveBar
from dextar_control.mechanisms.mechanism import Coordinate
from dextar_control.model.equations import equations
from dextar_control.model.model import Model, check_geometry
from dextar_control.symbols.types import Symbol


def test_an_unknown_mechanism_is_named_with_those_there_are() -> None:
    with pytest.raises(
        ParameterError, match="'delta'; it must be one of five_bar, three_rrr"
    ):
        mechanism_named("delta")


@pytest.mark.parametrize(
    "change, said",
    [
        ({"left.axis": None}, "'left.axis' of the mechanism five_bar is missing"),
        (
            {"left.distal_mass": -0.1},
            r"robot\.left\.distal_mass = -0\.1; it must lie in \[0, inf\] kg",
        ),
        (
            {"right.proximal_length": 0.0},
            r"robot\.right\.proximal_length = 0\.0; it must be > 0 m",
        ),
        ({"gravity": [0.0]}, r"robot\.gravity = \[0\.0\]; it must be 2 finite numbers"),
        (
            {"coulomb_speed": float("nan")},
            "coulomb_speed = nan; it must be 1 finite number",
        ),
        (
            {"end_effector_mass": True},
            "end_effector_mass = True; it must be 1 finite number",
        ),
        (
            {"end_effector_mass": "heavy"},
            "end_effector_mass = 'heavy'; it must be 1 finite number",
        ),
    ],
)
def test_a_parameter_that_is_missing_or_out_of_bounds_is_named(
    change: dict[str, Any], said: str, robot: RobotParameters
) -> None:
    values = {
        key: value
        for key, value in (flatten(robot) | change).items()
        if value is not None
    }
    with pytest.raises(ParameterError, match=said):
        Model(mechanism_named("five_bar"), values)


class _OneCoordinate(FiveBar):
    name = "one_coordinate"
    coordinates = (Coordinate("x", "m"),)


class _OneClosure(FiveBar):
    name = "one_closure"

    def closures(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        return super().closures(q_a, x, p)[0]


class _IdleMotor(FiveBar):
    name = "idle_motor"

    def closures(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        return super().closures(ca.vertcat(q_a[0], 0.3), x, p)


class _IdleCoordinate(FiveBar):
    name = "idle_coordinate"

    def closures(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        return super().closures(q_a, ca.vertcat(x[0], 0.1), p)


class _WrongModel(FiveBar):
    name = "wrong_model"

    def inverse_geometric_model(self, x: Symbol, p: Any) -> Symbol:
        return super().inverse_geometric_model(x, p) + 1e-3


@pytest.mark.parametrize(
    "mechanism, said",
    [
        (
            _OneCoordinate(),
            "one_coordinate has 2 active joints, 1 coordinates and 2 closures",
        ),
        (
            _OneClosure(),
            "one_closure has 2 active joints, 2 coordinates and 1 closures",
        ),
        (_IdleMotor(), "B of mechanism idle_motor is singular everywhere"),
        (
            _IdleCoordinate(),
            (
                "A_r of mechanism idle_coordinate is singular everywhere: a closure has"
                " no coordinate of its own"
            ),
        ),
    ],
)
def test_closures_that_do_not_fit_are_refused(mechanism: FiveBar, said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        equations(mechanism)


def test_a_geometric_model_that_leaves_the_loops_open_is_refused(
    robot: RobotParameters,
) -> None:
    with pytest.raises(
        ParameterError,
        match=r"inverse geometric model of wrong_model leaves its closures open by",
    ):
        check_geometry(Model(_WrongModel(), flatten(robot)), np.array([[0.0, 0.115]]))


def test_a_place_out_of_reach_names_what_does_not_reach(robot: RobotParameters) -> None:
    with pytest.raises(
        GeometryError,
        match=(
            r"0\.2190 m from the left motor axis; the leg reaches 0\.0000 to 0\.1800 m"
        ),
    ):
        Model(mechanism_named("five_bar"), flatten(robot)).inverse_geometric_model(
            np.array([0.16, 0.0])
        )
    said = mechanism_named("three_rrr").unreached(
        np.array([0.5, 0.0, 0.0]), np.array([0.0, np.nan, 0.0]), None
    )
    assert said == "x = [0.5, 0.0, 0.0] is out of reach: q21 has no angle there"


@pytest.mark.parametrize("name", MECHANISMS)
def test_a_mechanism_says_units_and_meaning_of_each_parameter(name: str) -> None:
    mechanism = mechanism_named(name)
    names = [parameter.name for parameter in mechanism.parameters]
    assert len(set(names)) == len(names)
    assert all(
        parameter.unit and parameter.meaning for parameter in mechanism.parameters
    )
    assert mechanism.symbols()[0].numel() == sum(
        parameter.size for parameter in mechanism.parameters
    )
