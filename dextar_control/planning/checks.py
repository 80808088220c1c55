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
GEOMETRY_PLACES = 10  # of a trajectory, at which the geometric models are checked
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
    """Check a trajectory against the criterion, the workspace and the robot's limits.

    Args:
        robot: of any mechanism.
        trajectory: to be checked.
        max_residual: of the criterion at a crossing, N.
        crossings: number of instants at which it must cross; any number when None.
        period: of the samples, s.

    Raises:
        TrajectoryError: a check failed; names the value, the limit and where.
        ParameterError: the mechanism contradicts itself on the way.
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
            raise TrajectoryError(f"{refusal}{_passive_friction(robot, profile, row)}")
    times = np.unique(certificate.crossing_times)
    if crossings is not None and len(times) != crossings:
        instants = ", ".join(f"{time:.4f} s" for time in times) or "none"
        raise TrajectoryError(
            f"the trajectory crosses the locus {len(times)} times ({instants}); it must"
            f" {crossings} times"
        )
    torque, joint_speed = (
        np.abs(values).max(axis=1) for values in (profile.torque, profile.q_a_dot)
    )
    platform_speed = np.linalg.norm(profile.x_dot, axis=1)
    for what, values, limit, unit in (
        ("torque", torque, robot.max_torque, joint.effort_unit),
        ("joint speed", joint_speed, robot.max_joint_speed, f"{joint.unit}/s"),
        ("platform speed", platform_speed, robot.max_platform_speed, "m/s"),
    ):
        row = int(np.nanargmax(values))
        if not values[row] <= limit:
            raise fail(f"the peak {what}", float(values[row]), limit, unit, row)
    return certificate


def _passive_friction(robot: AnyRobot, profile: Profile, row: int) -> str:
    """Return the part of a sentence that says how much friction of joints without a
    motor takes along t_s on the locus; "" without such friction.
    """
    model, q_a, x = Model.of(robot), profile.q_a[row], profile.x[row]
    there, back = (
        model.wrenches(q_a, x, sign * profile.x_dot[row], np.zeros(model.n)).w_d
        for sign in (1.0, -1.0)
    )
    force = float(np.abs(model.place(x).t_s.T @ (there - back)).max()) / 2.0
    if not force > 0.0:
        return ""
    return (
        "; there the friction of joints without a motor, as described, takes"
        f" {force:.3g} N along t_s, where only inertia can balance it: check the"
        " description"
    )


def beyond_range(robot: AnyRobot, q_a: Array) -> Array:
    """Return the distance of each active joint (..., n), rad (m), from its range, rad
    (m); negative inside.

    An angle counts on any turn: a range of a whole turn is no bound.
    """
    low, high = (np.array(bounds) for bounds in robot.joint_range)
    turns = [joint.unit == "rad" for joint in states_model(robot).mechanism.joints]
    off = q_a - 0.5 * (low + high)
    on_one_turn = off - 2.0 * np.pi * np.floor((off + np.pi) / (2.0 * np.pi))
    return np.asarray(np.abs(np.where(turns, on_one_turn, off)) - 0.5 * (high - low))


def check_joint_range(robot: AnyRobot, profile: Profile) -> None:
    """Check that the active joints stay in their ranges.

    Raises:
        TrajectoryError: one does not; names the joint, its position and the range.
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
    """Check that a trajectory starts and ends at rest.

    Raises:
        TrajectoryError: it does not.
    """
    for name, time in (("start", 0.0), ("end", trajectory.duration)):
        point = trajectory.at(time)
        speed = float(np.linalg.norm(point.x_dot))
        acceleration = float(np.linalg.norm(point.x_ddot))
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
    """Return the times, s, before and after a planned crossing at which the plan is
    clear of the locus: its |s| is SIDE there, or the largest that it has before the
    neighbouring crossings.
    """
    time, s = certificate.profile.time, certificate.profile.s
    neighbours = [time[0], *certificate.crossing_times.tolist(), time[-1]]
    first, row, last = np.searchsorted(time, neighbours[index : index + 3]).tolist()
    before = _clear_row(np.abs(s[first:row][::-1]))
    after = _clear_row(np.abs(s[row : last + 1]))
    return float(time[row - 1 - before]), float(time[row + after])


def _clear_row(clearance: Array) -> int:
    """Return the first row of |s| (m,) that is SIDE, or else the largest."""
    return int(np.argmax(np.minimum(clearance, SIDE))) if len(clearance) else 0
