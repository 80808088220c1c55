"""The trajectory server's parameters say what it is to plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dextar_control.contract.errors import ParameterError, TrajectoryError
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.robot import RobotParameters
from dextar_control.planning.between import check_ends
from dextar_control.planning.certificate import Certificate
from dextar_control.planning.checks import certify
from dextar_control.planning.excitation import plan_excitation
from dextar_control.planning.locus import locus_point
from dextar_control.planning.planner import (
    PLAN_RESIDUAL,
    CrossingCriterion,
    Plan,
    plan_approach,
    plan_crossing,
    plan_return_trip,
    plan_return_trip_through,
)
from dextar_control.planning.regular import side_of
from dextar_control.planning.search import Progress, silent
from dextar_control.planning.tour import plan_tour
from dextar_control.planning.trajectory import join
from dextar_control.symbols.types import Array

LEAST_DURATION = 0.02  # s
AT_START = 1e-4  # m, closer than this needs no approach
UNREACHED = (
    "let the trip begin where the robot stands (task.start of the trajectory server, A"
    " of the panel), or move the robot without torque and tell its side (assembly_mode"
    " of the controller)"
)
MOST_LINES = 24  # of a certificate in words
GROUP = "task."  # of the parameters


@dataclass(frozen=True)
class Task:
    """What to plan: a trip A -> B -> A, a return trip through ``point``, a tour, or an
    exciting motion.

    Attributes:
        start, goal: A and B, m.
        point: of the locus, m; None without.
        direction: sign of s after ``point``; 0 leads away from the side of A.
        tour: how many crossings are spread over the locus; the other way round where
            negative.
        tour_points: of a tour, m.
        tour_seed: of the random numbers that spread a tour's crossings.
        excite: about how long an exciting motion is, s; 0 is none.
        duration: of one way, s; None leaves it to the planner.
        dwell: rest before, between and after the motions, s.
        repeat: how often the trip, or the tour's lap, is repeated.
        locus_time: s; see ``plan_crossing``.
        criterion: that the motion satisfies at each crossing.
    """

    start: tuple[float, float]
    goal: tuple[float, float]
    point: tuple[float, float] | None
    direction: int
    tour: int
    tour_points: tuple[tuple[float, float], ...]
    tour_seed: int
    excite: float
    duration: float | None
    dwell: float
    repeat: int
    locus_time: float
    criterion: CrossingCriterion

    @classmethod
    def from_values(cls, values: Mapping[str, ParameterValue]) -> Task:
        """Return the task of parameter values, each of them checked by itself.

        Raises:
            ParameterError: they ask for several things at once, or contradict each
                other.
        """
        values = {
            name.removeprefix(GROUP): value
            for name, value in values.items()
            if name.startswith(GROUP)
        }
        asked = [
            f"{GROUP}{name} = {values[name]}"
            for name in ("point", "tour", "tour_points", "excite")
            if values[name]
        ]
        if len(asked) > 1:
            raise ParameterError(
                f"{' and '.join(asked)} are given; one may be (point: [], tour: 0,"
                f" tour_points: [], excite: 0 in the group {GROUP[:-1]} are off)"
            )
        if values["direction"] and not values["point"]:
            raise ParameterError(
                f"{GROUP}direction = {values['direction']} is given without a point; it"
                " must be 0"
            )
        if len(values["tour_points"]) % 2:
            raise ParameterError(
                f"{GROUP}tour_points has {len(values['tour_points'])} numbers; it must"
                " be pairs of x and y"
            )
        if 0.0 < values["duration"] < LEAST_DURATION:
            raise ParameterError(
                f"{GROUP}duration = {values['duration']} s; it must be 0 or >="
                f" {LEAST_DURATION}"
            )
        numbers = values["tour_points"]
        return cls(
            start=_pair(values["start"]),
            goal=_pair(values["goal"]),
            point=_pair(values["point"]) if values["point"] else None,
            direction=values["direction"],
            tour=values["tour"],
            tour_points=tuple(zip(numbers[::2], numbers[1::2], strict=True)),
            tour_seed=values["tour_seed"],
            excite=values["excite"],
            duration=values["duration"] or None,
            dwell=values["dwell"],
            repeat=values["repeat"],
            locus_time=values["locus_time"],
            criterion=CrossingCriterion[values["criterion"].upper()],
        )

    def check(self, robot: RobotParameters) -> None:
        """Check what is known before anything is planned: the ends of A -> B -> A.

        Raises:
            DextarError: an end is unreachable or too near to the locus, or both lie on
                one side.
        """
        if not (self.excite or self.tour or self.tour_points or self.point):
            check_ends(robot, np.array(self.start), np.array(self.goal))

    def plan(self, robot: RobotParameters, progress: Progress = silent) -> Plan:
        """Return the certified plan; a tour or an exciting motion begins in A, a trip
        through a point where the planner lets it begin.

        Args:
            robot: that is to move.
            progress: told how far planning is.

        Raises:
            DextarError: there is none within the limits; names the limit and what would
                do.
        """
        start = np.array(self.start)
        if self.excite:
            return plan_excitation(robot, start, self.excite, self.dwell, progress)
        if self.tour or self.tour_points:
            points = self.tour or [np.array(point) for point in self.tour_points]
            return plan_tour(
                robot,
                points,
                self.repeat,
                self.tour_seed,
                start=start,
                duration=self.duration,
                dwell=self.dwell,
                criterion=self.criterion,
                locus_time=self.locus_time,
                progress=progress,
            )
        if self.point is not None:
            place = locus_point(robot, np.array(self.point))
            direction = self.direction or -round(
                np.sign(side_of(robot, "task.start", start))
            )
            return plan_return_trip_through(
                robot,
                place,
                direction,
                self.duration,
                self.dwell,
                self.repeat,
                criterion=self.criterion,
                locus_time=self.locus_time,
                progress=progress,
            )
        return plan_return_trip(
            robot,
            start,
            np.array(self.goal),
            self.duration,
            self.dwell,
            self.repeat,
            criterion=self.criterion,
            locus_time=self.locus_time,
            progress=progress,
        )

    def plan_between(
        self,
        robot: RobotParameters,
        start: Array,
        goal: Array,
        progress: Progress = silent,
    ) -> Plan:
        """Return the certified plan of one way between two given places.

        Args:
            robot: that is to move.
            start, goal: positions of the end effector, (2,), m.
            progress: told how far planning is.

        Raises:
            DextarError: as ``plan``.
        """
        return plan_crossing(
            robot,
            start,
            goal,
            self.duration,
            criterion=self.criterion,
            locus_time=self.locus_time,
            progress=progress,
        )


def plan_from(robot: RobotParameters, origin: Array, plan: Plan, speed: float) -> Plan:
    """Return a planned trip with the way from where the robot stands before it.

    Args:
        robot: that is to move.
        origin: where it stands, (2,), m.
        plan: the trip.
        speed: peak speed of that way, m/s.

    Raises:
        DextarError: there is no such way on one side of the locus.
    """
    start, trajectory = plan.trajectory.at(0.0).x, plan.trajectory
    if float(np.hypot(*(origin - start))) >= AT_START:
        try:
            approach = plan_approach(robot, origin, start, speed)
        except TrajectoryError as error:
            raise TrajectoryError(f"{error}: {UNREACHED}") from error
        trajectory = join([approach, trajectory])
    return Plan(trajectory, certify(robot, trajectory, max_residual=PLAN_RESIDUAL))


def place_told(told: Mapping[str, str]) -> Array | None:
    """Return where the robot stands, (2,), m, by the controller's diagnostics; None
    where they do not say.
    """
    x = np.array([float(told.get(axis, "nan")) for axis in ("x", "y")])
    return x if np.isfinite(x).all() else None


def _pair(numbers: Sequence[float]) -> tuple[float, float]:
    return float(numbers[0]), float(numbers[1])


def in_words(certificate: Certificate) -> str:
    """Return a certificate on one line, cut where it grows long."""
    lines = certificate.lines()
    more = len(lines) - MOST_LINES
    return "; ".join([*lines[:MOST_LINES], *([f"and {more} more"] if more > 0 else [])])
