"""Trajectories checked against the criterion, the workspace and the robot's limits."""

from __future__ import annotations

import numpy as np

from dextar_control.contract.errors import TrajectoryError
from dextar_control.model.model import Model, check_geometry
from dextar_control.model.robot import AnyRobot, Robot
from dextar_control.planning.certificate import Certificate, measure
from dextar_control.planning.model import states_model
from dextar_control.planning.profile import Profile
from dextar_control.planning.trajectory import Trajectory, in_words
from dextar_control.symbols.types import Array

SIDE = 0.3  # |s| of a plan before and after a crossing that is clear of the locus
GEOMETRY_PLACES = (
    10  # of a trajectory, at which the geometric models are held against the closures
)
REST_SPEED = 1e-6  # m/s
REST_ACCELERATION = 1e-3  # m/s^2


def certify(
    robot: AnyRobot,
    trajectory: Trajectory,
    *,
    max_residual: float,
    crossings: int | None = None,
    period: float = 1e-3,
) -> Certificate:
    """A trajectory checked against the criterion, the workspace and the robot's limits.

    Args:
        max_residual: of the criterion at a crossing, N.
        crossings: at how many instants there must be one; any number when None.
        period: of the samples, s.

    Raises:
        TrajectoryError: names the value, the limit and where.
        ParameterError: the mechanism's geometric model leaves its closures open on the
            way.
    """
    certificate = measure(robot, trajectory, period)
    profile, joint = certificate.profile, certificate.joint

    def fail(
        what: str, value: float, limit: float, unit: str, row: int
    ) -> TrajectoryError:
        at = f"{profile.time[row]:.4f} s, {in_words(profile.x[row])}"
        return TrajectoryError(
            f"{what} is {value:.4g} {unit}; the limit is {limit:.4g} {unit} (at {at})"
        )

    unreachable = ~np.isfinite(profile.q_a).all(axis=1)
    if unreachable.any():
        row = int(np.argmax(unreachable))
        raise TrajectoryError(
            f"point {in_words(profile.x[row])} at {profile.time[row]:.4f} s lies"
            " outside the workspace"
        )
    if isinstance(robot, Robot):  # of a mechanism that may be its user's own
        check_geometry(
            states_model(robot), profile.x[:: max(len(profile.x) // GEOMETRY_PLACES, 1)]
        )
    if certificate.least_type1 < robot.min_type1_distance:
        row = int(np.argmin(profile.type1))
        raise fail(
            "the distance to Type 1",
            certificate.least_type1,
            robot.min_type1_distance,
            "(least |sin|)",
            row,
        )
    check_joint_range(robot, profile)
    for index, residual in enumerate(certificate.residuals):
        if not residual <= max_residual:
            row = int(np.searchsorted(profile.time, certificate.crossing_times[index]))
            refusal = fail(
                f"the criterion's residual |t_s.w_d| at crossing {index + 1}",
                residual,
                max_residual,
                "N",
                row,
            )
            raise TrajectoryError(f"{refusal}{_rubbing(robot, profile, row)}")
    times = np.unique(certificate.crossing_times)
    if crossings is not None and len(times) != crossings:
        instants = ", ".join(f"{time:.4f} s" for time in times) or "none"
        raise TrajectoryError(
            f"the trajectory crosses the locus {len(times)} times ({instants}); it must"
            f" {crossings} times"
        )
    limits = (
        (
            "the peak torque",
            np.abs(profile.torque).max(axis=1),
            robot.max_torque,
            joint.effort_unit,
        ),
        (
            "the peak joint speed",
            np.abs(profile.q_a_dot).max(axis=1),
            robot.max_joint_speed,
            f"{joint.unit}/s",
        ),
        (
            "the peak platform speed",
            np.linalg.norm(profile.x_dot, axis=1),
            robot.max_platform_speed,
            "m/s",
        ),
    )
    for what, values, limit, unit in limits:
        row = int(np.nanargmax(values))
        if not values[row] <= limit:
            raise fail(what, float(values[row]), limit, unit, row)
    return certificate


def _rubbing(robot: AnyRobot, profile: Profile, row: int) -> str:
    """What friction of joints without a motor takes along t_s on the locus; nothing
    without.
    """
    model, at, x_dot = (
        Model.of(robot),
        (profile.q_a[row], profile.x[row]),
        profile.x_dot[row],
    )
    there, back = (
        model.wrenches(*at, sign * x_dot, np.zeros(model.n)).w_d for sign in (1.0, -1.0)
    )
    force = (
        float(np.abs(model.place(profile.x[row]).t_s.T @ (there - back)).max()) / 2.0
    )
    told = (
        "; there the friction of joints without a motor, as described, takes"
        f" {force:.3g} N along t_s, where only inertia can"
    )
    return f"{told} balance it: check the description" if force > 0.0 else ""


def beyond_range(robot: AnyRobot, q_a: Array) -> Array:
    """How far each active joint (..., n), rad (m), is outside its range, rad (m);
    negative inside.

    An angle counts on any turn: a range of a whole turn is no bound.
    """
    low, high = (np.array(bounds) for bounds in robot.joint_range)
    off, turns = (
        q_a - 0.5 * (low + high),
        [joint.unit == "rad" for joint in states_model(robot).mechanism.joints],
    )
    on_one_turn = np.where(
        turns, off - 2.0 * np.pi * np.floor((off + np.pi) / (2.0 * np.pi)), off
    )
    return np.asarray(np.abs(on_one_turn) - 0.5 * (high - low))


def check_joint_range(robot: AnyRobot, profile: Profile) -> None:
    """Raise TrajectoryError where an active joint leaves its range; names the joint,
    its angle and the range.
    """
    beyond = beyond_range(robot, profile.q_a)
    row, leg = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
    if beyond[row, leg] > 0.0:
        low, high = (bounds[leg] for bounds in robot.joint_range)
        unit = states_model(robot).mechanism.joints[leg].unit
        what = "angle" if unit == "rad" else "position"
        raise TrajectoryError(
            f"the {robot.sides[leg]} joint's {what} is {profile.q_a[row, leg]:.4g}"
            f" {unit}, {beyond[row, leg]:.4g} {unit} outside its range; the limits are"
            f" {low:.4g} and {high:.4g} {unit} (at {profile.time[row]:.4f} s,"
            f" {in_words(profile.x[row])})"
        )


def check_rest(trajectory: Trajectory) -> None:
    """Raise TrajectoryError unless the trajectory starts and ends at rest."""
    for name, time in (("start", 0.0), ("end", trajectory.duration)):
        point = trajectory.at(time)
        speed, acceleration = (
            float(np.linalg.norm(point.x_dot)),
            float(np.linalg.norm(point.x_ddot)),
        )
        if speed > REST_SPEED:
            raise TrajectoryError(
                f"the {name} moves at {speed:.4g} m/s; it must rest (limit"
                f" {REST_SPEED:.0e} m/s)"
            )
        if acceleration > REST_ACCELERATION:
            raise TrajectoryError(
                f"the {name} accelerates at {acceleration:.4g} m/s^2; it must rest"
                f" (limit {REST_ACCELERATION:.0e} m/s^2)"
            )


def clear_times(certificate: Certificate, index: int) -> tuple[float, float]:
    """Times before and after a planned crossing at which the plan is clear of the
    locus.

    Its |s| is SIDE there, or where it does not come so far before the neighbouring
    crossings the largest.
    """
    time, s = certificate.profile.time, certificate.profile.s
    neighbours = [time[0], *certificate.crossing_times.tolist(), time[-1]]
    first, row, last = np.searchsorted(time, neighbours[index : index + 3]).tolist()
    before, after = np.abs(s[first:row][::-1]), np.abs(s[row : last + 1])
    return float(time[row - 1 - _clear_row(before)]), float(
        time[row + _clear_row(after)]
    )


def _clear_row(clearance: np.ndarray) -> int:
    clear = np.flatnonzero(clearance >= SIDE)
    return (
        int(clear[0])
        if len(clear)
        else int(np.argmax(clearance))
        if len(clearance)
        else 0
    )
