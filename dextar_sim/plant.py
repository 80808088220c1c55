"""The five-bar as a PyBullet plant: two 2R legs, pinned together at the end effector.
No ROS here.
"""

from __future__ import annotations

from dextar_control.contract.robot import RobotParameters, flatten
from dextar_control.mechanisms import mechanism_named
from dextar_control.symbols.types import Numbers
from dextar_sim.body_plant import BodyPlant
from dextar_sim.effects import (
    NO_EFFECTS,
    Effects,
    JointEffects,
    has_joint_effects,
    without_rotors,
)
from dextar_sim.geometry import FiveBarPlacing, joints_dot_at
from dextar_sim.state import PlantState
from dextar_sim.urdf import bodies_of, urdf

FIVE_BAR = mechanism_named("five_bar")


class Plant(FiveBarPlacing, BodyPlant):
    """Simulates the five-bar, placed by the simulator's own geometry, which knows both
    assembly modes and says what does not reach.

    Args:
        robot: the description.
        period: duration of one step, s.
        substeps: physics steps in one step; friction is evaluated in each.
        window: open PyBullet's own window.
        max_torque: at which the motors saturate, N m; the robot's when None.
        effects: of drives and friction, beside what the robot's description says.

    Raises:
        ParameterError: period or substeps out of range, friction or a transmission too
            quick for the substep, no display.
    """

    def __init__(
        self,
        robot: RobotParameters,
        *,
        period: float = 1.0e-3,
        substeps: int = 4,
        window: bool = False,
        max_torque: float | None = None,
        effects: Effects = NO_EFFECTS,
    ) -> None:
        self.robot, self._links, acting = robot, robot, None
        if has_joint_effects(robot, effects):
            self._links = without_rotors(robot, effects)
            acting = JointEffects(robot, effects, period, substeps, ahead=True)
        super().__init__(
            FIVE_BAR,
            flatten(self._links),
            period=period,
            substeps=substeps,
            window=window,
            effects=acting,
            max_torque=robot.max_torque if max_torque is None else max_torque,
            sides=robot.sides,
        )

    def take_up(self, mass: float) -> None:
        """Load the end effector with a mass, kg, that moves with it."""
        loaded = {"end_effector_mass": self.robot.end_effector_mass + mass}
        self.robot, self._links = (
            self.robot.replace(**loaded),
            self._links.replace(**loaded),
        )
        self.become(flatten(self._links))

    def _begin_at(self, joints: Numbers, x_dot: Numbers) -> PlantState:
        return self._place(joints, joints_dot_at(self.robot, joints, x_dot))


def urdf_of(robot: RobotParameters) -> str:
    """Return the URDF of a five-bar to look at: both legs, without the pin that closes
    the loop.
    """
    return urdf(FIVE_BAR.name, bodies_of(FIVE_BAR, flatten(robot)), visual=True)
