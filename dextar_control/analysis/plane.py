"""What a run's figures show in the plane: locus, path, crossings with t_s, linkage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dextar_control.analysis.crossings import NOT_BEGUN
from dextar_control.analysis.metrics import Metrics
from dextar_control.analysis.run import Floats, Run
from dextar_control.analysis.tracking import tracked
from dextar_control.contract.robot import RobotParameters
from dextar_control.planning.locus import trace_locus
from dextar_control.planning.model import states_model

T_S_LENGTH = 6.0e-3  # m, half of what is drawn of t_s
MARGIN = 0.012  # m around everything
# share of the size of what is worth seeing, within which an arc of the locus is shown
# whole
NEAR_BY = 0.25
MOST_NUMBERS = 4  # of crossings at one place, the rest as dots
SAME_PLACE = 1e-3  # m, crossings nearer than this share their marks
WORST_FIRST = ("bounced", "undecided", "", "crossed")  # verdicts


class Place(NamedTuple):
    """Crossings at one point of the plane."""

    numbers: list[int]  # from 1
    x: Floats  # (2,) m
    t_s: Floats  # (2, 2) ends of a segment along t_s, m; nan without a robot
    # the estimator's; of several that differ the worst; "" where there is none
    verdict: str


class Plane(NamedTuple):
    """What a figure of a run shows in the plane; all in m.

    Attributes:
        locus: (family, (n, 2)) of each arc in the run's working mode.
        planned, true, estimated: (n, 2); true is empty without truth.
        places: of the crossings.
        linkage: (5, 2) motor, elbow, end effector, elbow, motor at the first crossing,
            or at the path's start; empty without a robot.
        motors: (k, 2) their axes.
        ends: A and B of a trip as in the paper, or the start of a tour, each with its
            place (2,).
        low, high: (2,) corners of what is worth seeing.
    """

    locus: list[tuple[str, Floats]]
    planned: Floats
    true: Floats
    estimated: Floats
    places: list[Place]
    linkage: Floats
    motors: Floats
    ends: list[tuple[str, Floats]]
    low: Floats
    high: Floats

    @property
    def empty(self) -> bool:
        """Whether there is nothing to draw."""
        return not (
            self.locus
            or len(self.planned)
            or len(self.true)
            or len(self.estimated)
            or len(self.linkage)
        )


def plane_of(run: Run, metrics: Metrics) -> Plane:
    """Collect everything that is drawn of a run in the plane."""
    none, track = np.zeros((0, 2)), tracked(run)
    planned = run.trajectory.x if run.trajectory is not None else none
    true = estimated = none
    if track is not None:
        estimated = run.control.estimate[np.isin(run.control.stamps, track.stamps)]
        if run.truth is not None:
            true = run.truth.x[
                (run.truth.stamps >= track.stamps[0])
                & (run.truth.stamps <= track.stamps[-1])
            ]
    places = _places(run.robot, metrics)
    linkage = none
    if run.robot is not None and (places or len(planned)):
        x = places[0].x if places else planned[0]
        linkage = chain(run.robot, x, states_model(run.robot).place(x).q_a)
    locus = locus_of(run.robot)
    low, high = corners(
        [planned if len(planned) else estimated, linkage], [arc for _, arc in locus]
    )
    motors = (
        np.array([leg.axis for leg in run.robot.legs])
        if run.robot is not None
        else none
    )
    return Plane(
        locus,
        planned,
        true,
        estimated,
        places,
        linkage,
        motors,
        ends_of(planned, len(places)),
        low,
        high,
    )


def corners(seen: Sequence[Floats], arcs: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Find a rectangle around what is worth seeing.

    Args:
        seen: (n, 2) each, m; what is worth it.
        arcs: (n, 2) each, m, of the locus; those near by are shown whole.

    Returns:
        Its lower left and upper right corners, (2,) each, m.
    """
    known = [part[np.isfinite(part).all(axis=1)] for part in seen]
    everything = np.concatenate(
        [part for part in known if len(part)] or [np.zeros((1, 2))]
    )
    low, high = everything.min(axis=0), everything.max(axis=0)
    rest = NEAR_BY * float((high - low).max())
    near = [
        arc for arc in arcs if (arc >= low - rest).all() and (arc <= high + rest).all()
    ]
    everything = np.concatenate([everything, *near])
    return everything.min(axis=0) - MARGIN, everything.max(axis=0) + MARGIN


def ends_of(path: Floats, places: int) -> list[tuple[str, Floats]]:
    """Name the ends of a path (n, 2), m: A and B of a trip as in the paper, the start
    of a tour through several places.
    """
    if not len(path):
        return []
    if places > 1:
        return [("start", path[0])]
    return [("A", path[0]), ("B", path[np.hypot(*(path - path[0]).T).argmax()])]


def locus_of(robot: RobotParameters | None) -> list[tuple[str, Floats]]:
    """Trace the Type 2 locus in the robot's working mode, as (family, points (n, 2),
    m).
    """
    if robot is None:
        return []
    arcs = trace_locus(robot, (robot.working_mode,), robot.min_type1_distance)
    return [(arc.family.name.lower(), arc.x) for arc in arcs]


def chain(robot: RobotParameters, x: Floats, q_a: Floats) -> Floats:
    """Return motor, elbow, end effector, elbow and motor, (5, 2), m, for an end
    effector x (2,), m, and active joints q_a (2,), rad.
    """
    model = states_model(robot)
    linkage: Floats = model.mechanism.linkage(q_a, x, model.numbers)
    return linkage


def t_s_at(robot: RobotParameters, x: Floats) -> Floats:
    """Return the weak direction of A_r, (2,), 1, at an end effector x (2,), m: on the
    locus it is t_s.
    """
    t_s: Floats = states_model(robot).place(x).t_s
    return t_s


def _places(robot: RobotParameters | None, metrics: Metrics) -> list[Place]:
    places: list[Place] = []
    for number, crossing in enumerate(metrics.crossings, start=1):
        x = np.array(crossing.point)
        said = crossing.verdict or ""
        verdict = "" if said == NOT_BEGUN else said
        for row, place in enumerate(places):
            if np.hypot(*(place.x - x)) < SAME_PLACE:
                place.numbers.append(number)
                places[row] = place._replace(
                    verdict=min(place.verdict, verdict, key=WORST_FIRST.index)
                )
                break
        else:
            ends = np.full((2, 2), np.nan)
            if robot is not None:
                along = T_S_LENGTH * t_s_at(robot, x)
                ends = np.stack([x - along, x + along])
            places.append(Place([number], x, ends, verdict))
    return places


def numbers_in_words(numbers: Sequence[int]) -> str:
    """Write the numbers of crossings at one place."""
    return ", ".join(map(str, numbers[:MOST_NUMBERS])) + (
        " …" if len(numbers) > MOST_NUMBERS else ""
    )


def crossing_title(number: int, outcome: str) -> str:
    """Write a crossing's number, and what became of it where it was not crossed."""
    return str(number) if outcome == "crossed" else f"{number} {outcome}"
