"""What tests of every folder share. Nothing here loads ROS or the planner before a test
asks for it.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ.setdefault("MPLBACKEND", "Agg")

from dextar_control.contract import terminal
from dextar_control.contract.resources import ROBOT_FILE, config_file, node_defaults
from dextar_control.contract.robot import RobotParameters, load_robot

if TYPE_CHECKING:
    from dextar_control.planning.planner import Plan


@pytest.fixture(scope="session")
def robot() -> RobotParameters:
    """The DexTAR of ``config/``."""
    return load_robot(config_file(ROBOT_FILE))


@pytest.fixture(scope="session")
def uneven(robot: RobotParameters) -> RobotParameters:
    """Unequal links, off-centre masses and gravity in the plane."""
    return robot.replace(
        **{
            "left.proximal_length": 0.085,
            "left.distal_length": 0.095,
            "left.distal_center": 0.4,
            "right.proximal_length": 0.093,
            "right.distal_length": 0.088,
            "right.distal_mass": 0.11,
            "right.proximal_center": 0.45,
            "right.distal_inertia": 7.1e-5,
            "gravity": (0.7, -9.81),
        }
    )


def _between_a_and_b(robot: RobotParameters, duration: float | None = None) -> Plan:
    """A return trip between the A and B of ``config/``; duration of one way in s."""
    from dextar_control.planning.planner import plan_return_trip

    task = node_defaults("trajectory_server")
    return plan_return_trip(
        robot,
        np.array(task["task.start"]),
        np.array(task["task.goal"]),
        duration or task["task.duration"],
        task["task.dwell"],
    )


@pytest.fixture(scope="session")
def trip(robot: RobotParameters) -> Plan:
    """The fast return trip between the A and B of ``config/``."""
    return _between_a_and_b(robot)


@pytest.fixture(scope="session")
def slow_trip(robot: RobotParameters) -> Plan:
    """The same trip at 2 s each way."""
    return _between_a_and_b(robot, 2.0)


@pytest.fixture(scope="session")
def q_a(robot: RobotParameters, trip: Plan) -> np.ndarray:
    """The active joints (2,), rad, where the trip starts."""
    from dextar_control.model.model import Model

    return Model.of(robot).inverse_geometric_model(trip.trajectory.at(0.0).x)


@pytest.fixture(scope="session")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run made by hand, in a bag that is whole; only read."""
    from synthetic_run import write_run

    file = tmp_path_factory.mktemp("good") / "run.mcap"
    write_run(file)
    return file


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command tells no step between, however slow the machine is."""
    monkeypatch.setattr(terminal, "LINE_PERIOD", math.inf)
