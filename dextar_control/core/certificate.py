"""What a trajectory does at and between its crossings, measured against the robot's limits."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dextar_control.contract.errors import TrajectoryError
from dextar_control.contract.robot import RobotParameters
from dextar_control.core.compiled import njit
from dextar_control.core.dynamics import criterion, friction, multipliers, wrenches
from dextar_control.core.kinematics import singularity, state_of_platform, type1_distance
from dextar_control.core.model import Array, Model, beyond_range, joint_range, make_model
from dextar_control.core.trajectory import Trajectory, evaluate

PLAN_RESIDUAL = 1e-9  # N, at the crossing of a plan
NEAR_LOCUS = 0.1  # |s| below which a torque counts as near the locus
SIDE = 0.3  # |s| of a plan before and after a crossing that is clear of the locus
LIMIT_ZONE = 0.01  # |s| below which the multipliers are taken from their neighbourhood: 0/0 on the locus
LIMIT_NODES = np.array([1.0, 2.0 / 3.0, 1.0 / 3.0])  # of that zone, where they are taken on either side of a crossing
ON_CROSSING = 1e-9  # s, closer to a crossing than this counts as on it
REST_SPEED = 1e-6  # m/s
REST_ACCELERATION = 1e-3  # m/s^2


class Profile(NamedTuple):
    """A trajectory sampled over time, with what the robot needs for it."""

    time: Array  # (m,) s
    x: Array  # (m, 2) m
    x_dot: Array  # (m, 2) m/s
    q_a: Array  # (m, 2) rad
    q_a_dot: Array  # (m, 2) rad/s
    s: Array  # (m,) singularity measure
    residual: Array  # (m,) t_s.w_d, N
    multipliers: Array  # (m, 2) lambda, N/m; its finite limit near the locus
    torque: Array  # (m, 2) N m; its finite limit near the locus
    type1: Array  # (m,) distance to Type 1


class Crossing(NamedTuple):
    """One crossing of a checked trajectory."""

    time: float  # s
    x: tuple[float, float]  # m
    x_dot: tuple[float, float]  # m/s
    family: str  # of the locus: "stretched" or "folded"
    sign: int  # of s after the crossing; 0 when it leaves the workspace there
    rate: float  # of s, 1/s
    speed: float  # along t_s, m/s
    residual: float  # |t_s.w_d|, N
    multipliers: tuple[float, float]  # limit on the locus, N/m
    torque: tuple[float, float]  # limit on the locus, N m
    near_time: float  # s within |s| < NEAR_LOCUS about the crossing


class Certificate(NamedTuple):
    """A checked trajectory: its crossings and its extremes."""

    crossing_times: Array  # (n,) s
    crossing_points: Array  # (n, 2) m
    crossing_signs: Array  # (n,) sign of s after the crossing
    crossing_speeds: Array  # (n,) along t_s, m/s
    residuals: Array  # (n,) |t_s.w_d| at the crossing, N
    multipliers: Array  # (n, 2) limit of lambda on the locus, N/m
    peak_torque: float  # N m
    peak_torque_near: float  # N m, within |s| < NEAR_LOCUS; nan without a crossing
    peak_joint_speed: float  # rad/s
    peak_platform_speed: float  # m/s
    least_type1: float
    duration: float  # s
    profile: Profile
    crossings: tuple[Crossing, ...] = ()
    least_s: float = float("nan")  # |s| at the start and the end

    def to_dict(self) -> dict[str, Any]:
        """Everything but the profile, in plain numbers and lists: what travels with the trajectory."""
        return {
            "duration": self.duration, "peak_torque": self.peak_torque, "peak_torque_near": self.peak_torque_near,
            "peak_joint_speed": self.peak_joint_speed, "peak_platform_speed": self.peak_platform_speed,
            "least_type1": self.least_type1, "least_s": self.least_s,
            "crossings": [crossing._asdict() for crossing in self.crossings],
        }  # fmt: skip

    def to_json(self) -> str:
        """``to_dict`` as JSON; a number that does not exist is null."""
        return json.dumps(_finite(self.to_dict()), allow_nan=False)

    def lines(self) -> list[str]:
        """The certificate in words, one fact a line."""
        text = [
            f"duration {self.duration:.3f} s, peak torque {self.peak_torque:.4f} N m"
            f", peak joint speed {self.peak_joint_speed:.2f} rad/s, peak platform speed {self.peak_platform_speed:.3f} m/s"
            f", distance to Type 1 {self.least_type1:.3f}"
        ]
        for index, crossing in enumerate(self.crossings):
            left, right = crossing.multipliers
            text.append(
                f"crossing {index + 1} ({crossing.family}, to s {'>' if crossing.sign > 0 else '<'} 0) at {crossing.time:.4f} s"
                f" in ({crossing.x[0]:.4f}, {crossing.x[1]:.4f}) m, {crossing.speed:.3f} m/s along t_s"
                f", {1e3 * crossing.near_time:.0f} ms within |s| < {NEAR_LOCUS}"
                f", residual {crossing.residual:.1e} N, multiplier ({left:.3f}, {right:.3f}) N/m"
                f", torque ({crossing.torque[0]:.4f}, {crossing.torque[1]:.4f}) N m"
            )
        return text


def _finite(value: Any) -> Any:
    """Plain data with None for each number that is not finite."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


class Plan(NamedTuple):
    """A served trajectory and what was checked about it."""

    trajectory: Trajectory
    certificate: Certificate


@njit
def _sample(model: Model, knots: Array, origins: Array, coefficients: Array, times: Array) -> Array:
    rows = np.empty((times.shape[0], 19))
    for k in range(times.shape[0]):
        point = evaluate(knots, origins, coefficients, times[k])
        kin = state_of_platform(model, point[0], point[1])
        w_b, w_d = wrenches(model, kin, point[2])
        rows[k, 0:2] = point[0]
        rows[k, 2:4] = point[1]
        rows[k, 4:6] = kin.q_a
        rows[k, 6:8] = kin.q_a_dot
        rows[k, 8] = singularity(model, kin.A_r)
        rows[k, 9] = criterion(model, kin, point[2])
        rows[k, 10:12] = multipliers(kin, w_d)
        rows[k, 12:14] = w_b + friction(model, kin.q_a_dot)
        rows[k, 14:16] = kin.B
        rows[k, 16] = type1_distance(model, kin)
        rows[k, 17:19] = point[2]
    return rows


def sample_profile(model: Model, trajectory: Trajectory, times: Array) -> Profile:
    """What the robot needs along a trajectory at times (m,), s.

    Within LIMIT_ZONE of the locus the multipliers are continued from either side of the crossing by a parabola:
    towards the value they tend to when the criterion holds.
    """
    times = np.asarray(times, dtype=np.float64)
    rows = _sample(model, trajectory.knots, trajectory.origins, trajectory.coefficients, times)
    s, lam = rows[:, 8], rows[:, 10:12].copy()
    inside = ~(np.abs(s) >= LIMIT_ZONE)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        first, last = max(start - 1, 0), min(stop, len(times) - 1)
        if not s[first] * s[last] < 0.0:
            continue
        turn = first + int(np.argmax(s[first:last] * s[first + 1 : last + 1] <= 0.0))
        step = times[turn + 1] - times[turn]
        middle = times[turn] + step * s[turn] / (s[turn] - s[turn + 1])
        reach = LIMIT_ZONE * (times[last] - times[first]) / abs(s[last] - s[first])
        ahead = times[start:stop] - middle
        sides = []
        for side in (-1.0, 1.0):
            nodes = side * reach * LIMIT_NODES
            near = _sample(model, trajectory.knots, trajectory.origins, trajectory.coefficients, middle + nodes)
            sides.append(np.stack([np.polyval(np.polyfit(nodes, near[:, 10 + leg], 2), ahead) for leg in range(2)], axis=1))
        weight = np.select([ahead < -ON_CROSSING, ahead > ON_CROSSING], [0.0, 1.0], 0.5)[:, None]
        lam[start:stop] = (1.0 - weight) * sides[0] + weight * sides[1]
    torque = rows[:, 12:14] - rows[:, 14:16] * lam
    return Profile(
        time=times, x=rows[:, 0:2], x_dot=rows[:, 2:4], q_a=rows[:, 4:6], q_a_dot=rows[:, 6:8], s=s,
        residual=rows[:, 9], multipliers=lam, torque=torque, type1=rows[:, 16],
    )  # fmt: skip


def find_crossings(model: Model, trajectory: Trajectory, times: Array, s: Array) -> Array:
    """Instants (n,), s, where s changes sign, by bisection between samples to machine precision."""

    def value(time: float) -> float:
        point = trajectory.at(time)
        return float(singularity(model, state_of_platform(model, point.x, point.x_dot).A_r))

    found: list[float] = []
    previous = 0
    for index in range(1, len(times)):
        if s[index] == 0.0 or not np.isfinite(s[index]):
            continue
        if s[previous] * s[index] < 0.0:
            low, high = times[previous], times[index]
            while True:
                middle = 0.5 * (low + high)
                if middle in (low, high):
                    break
                low, high = (middle, high) if value(middle) * s[previous] > 0.0 else (low, middle)
            found.append(low if abs(value(low)) < abs(value(high)) else high)
        previous = index
    return np.array(found)


def sample_times(trajectory: Trajectory, period: float) -> Array:
    """Times of at most ``period`` apart, with every knot among them."""
    count = int(np.ceil(trajectory.duration / period - 1e-9)) + 1
    grid = np.linspace(0.0, trajectory.duration, max(count, 2))
    knots = trajectory.knots
    if len(knots) > len(grid):
        return knots
    merged = np.union1d(grid, knots)
    keep = np.concatenate([[True], np.diff(merged) > 1e-9])
    return merged[keep]


def measure(model: Model, trajectory: Trajectory, period: float = 1e-3) -> Certificate:
    """A trajectory's crossings and extremes, limits unchecked."""
    times = sample_times(trajectory, period)
    rough = sample_profile(model, trajectory, times)
    crossings = find_crossings(model, trajectory, times, rough.s)
    profile = sample_profile(model, trajectory, np.union1d(times, crossings)) if len(crossings) else rough
    rows = np.searchsorted(profile.time, crossings)
    near = np.abs(profile.s) < NEAR_LOCUS
    after = np.minimum(np.searchsorted(times, crossings + ON_CROSSING, side="right"), len(times) - 1)
    far = np.flatnonzero(np.abs(profile.s) >= NEAR_LOCUS)
    signs = np.sign(rough.s[after])
    found = tuple(_crossing(model, profile, far, int(row), float(sign)) for row, sign in zip(rows, signs, strict=True))
    return Certificate(
        crossing_times=crossings,
        crossing_points=profile.x[rows],
        crossing_signs=signs,
        crossing_speeds=np.array([crossing.speed for crossing in found]),
        residuals=np.abs(profile.residual[rows]),
        multipliers=profile.multipliers[rows],
        peak_torque=float(np.abs(profile.torque).max()),
        peak_torque_near=float(np.abs(profile.torque[near]).max()) if near.any() else float("nan"),
        peak_joint_speed=float(np.abs(profile.q_a_dot).max()),
        peak_platform_speed=float(np.hypot(*profile.x_dot.T).max()),
        least_type1=float(profile.type1.min()),
        duration=trajectory.duration,
        profile=profile,
        crossings=found,
        least_s=float(np.abs(profile.s[[0, -1]]).min()),
    )


def _crossing(model: Model, profile: Profile, far: NDArray[np.int64], row: int, sign: float) -> Crossing:
    """The crossing at one row of a profile, whose rows ``far`` lie away from the locus."""
    x, x_dot = profile.x[row], profile.x_dot[row]
    A_r = state_of_platform(model, x, x_dot).A_r
    r_1 = A_r[0] / np.linalg.norm(A_r[0])
    place = int(np.searchsorted(far, row))
    enter = profile.time[far[place - 1] + 1] if place > 0 else profile.time[0]
    leave = profile.time[far[place] - 1] if place < len(far) else profile.time[-1]
    near = slice(max(row - 1, 0), row + 2)
    span = np.ptp(profile.time[near])
    return Crossing(
        time=float(profile.time[row]), x=_pair(x), x_dot=_pair(x_dot),
        family="stretched" if A_r[0] @ A_r[1] < 0.0 else "folded", sign=int(np.nan_to_num(sign)),
        rate=float(np.diff(profile.s[near][[0, -1]])[0] / span) if span > 0.0 else float("nan"),
        speed=float(abs(r_1[0] * x_dot[1] - r_1[1] * x_dot[0])), residual=float(abs(profile.residual[row])),
        multipliers=_pair(profile.multipliers[row]), torque=_pair(profile.torque[row]), near_time=float(leave - enter),
    )  # fmt: skip


def _pair(values: Array) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def certify(
    robot: RobotParameters,
    trajectory: Trajectory,
    *,
    max_residual: float,
    crossings: int | None = None,
    period: float = 1e-3,
) -> Certificate:
    """A trajectory checked against the criterion, the workspace and the robot's limits.

    Args:
        max_residual: of the criterion at a crossing, N.
        crossings: how many there must be; any number when None.
        period: of the samples, s.

    Raises:
        TrajectoryError: names the value, the limit and where.
    """
    model = make_model(robot)
    certificate = measure(model, trajectory, period)
    profile = certificate.profile

    def fail(what: str, value: float, limit: float, unit: str, row: int) -> TrajectoryError:
        x, y = profile.x[row]
        return TrajectoryError(
            f"{what} is {value:.4g} {unit}; the limit is {limit:.4g} {unit} (at {profile.time[row]:.4f} s, ({x:.4f}, {y:.4f}) m)"
        )

    unreachable = ~np.isfinite(profile.q_a).all(axis=1)
    if unreachable.any():
        row = int(np.argmax(unreachable))
        x, y = profile.x[row]
        raise TrajectoryError(f"point ({x:.4f}, {y:.4f}) m at {profile.time[row]:.4f} s lies outside the workspace")
    if certificate.least_type1 < robot.min_type1_distance:
        row = int(np.argmin(profile.type1))
        raise fail("the distance to Type 1", certificate.least_type1, robot.min_type1_distance, "(least |sin|)", row)
    check_joint_range(robot, profile)
    for index, residual in enumerate(certificate.residuals):
        if not residual <= max_residual:
            row = int(np.searchsorted(profile.time, certificate.crossing_times[index]))
            raise fail(f"the criterion's residual |t_s.w_d| at crossing {index + 1}", residual, max_residual, "N", row)
    if crossings is not None and len(certificate.crossing_times) != crossings:
        instants = ", ".join(f"{time:.4f} s" for time in certificate.crossing_times) or "none"
        raise TrajectoryError(
            f"the trajectory crosses the locus {len(certificate.crossing_times)} times ({instants}); it must {crossings} times"
        )
    limits = (
        ("the peak torque", np.abs(profile.torque).max(axis=1), robot.max_torque, "N m"),
        ("the peak joint speed", np.abs(profile.q_a_dot).max(axis=1), robot.max_joint_speed, "rad/s"),
        ("the peak platform speed", np.hypot(*profile.x_dot.T), robot.max_platform_speed, "m/s"),
    )
    for what, values, limit, unit in limits:
        row = int(np.nanargmax(values))
        if not values[row] <= limit:
            raise fail(what, float(values[row]), limit, unit, row)
    return certificate


def check_joint_range(robot: RobotParameters, profile: Profile) -> None:
    """Raise TrajectoryError where an active joint leaves its range; names the joint, its angle and the range."""
    beyond = beyond_range(joint_range(robot), profile.q_a)
    row, leg = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
    if beyond[row, leg] > 0.0:
        low, high = robot.legs[leg].min_angle, robot.legs[leg].max_angle
        x, y = profile.x[row]
        raise TrajectoryError(
            f"the {('left', 'right')[leg]} joint's angle is {profile.q_a[row, leg]:.4g} rad, {beyond[row, leg]:.4g} rad outside"
            f" its range; the limits are {low:.4g} and {high:.4g} rad (at {profile.time[row]:.4f} s, ({x:.4f}, {y:.4f}) m)"
        )


def check_rest(trajectory: Trajectory) -> None:
    """Raise TrajectoryError unless the trajectory starts and ends at rest."""
    for name, time in (("start", 0.0), ("end", trajectory.duration)):
        point = trajectory.at(time)
        speed, acceleration = float(np.hypot(*point.x_dot)), float(np.hypot(*point.x_ddot))
        if speed > REST_SPEED:
            raise TrajectoryError(f"the {name} moves at {speed:.4g} m/s; it must rest (limit {REST_SPEED:.0e} m/s)")
        if acceleration > REST_ACCELERATION:
            raise TrajectoryError(
                f"the {name} accelerates at {acceleration:.4g} m/s^2; it must rest (limit {REST_ACCELERATION:.0e} m/s^2)"
            )


def clear_times(certificate: Certificate, index: int) -> tuple[float, float]:
    """Times before and after a planned crossing at which the plan is clear of the locus.

    Its |s| is SIDE there, or where it does not come so far before the neighbouring crossings the largest.
    """
    time, s = certificate.profile.time, certificate.profile.s
    neighbours = [time[0], *certificate.crossing_times.tolist(), time[-1]]
    first, row, last = np.searchsorted(time, neighbours[index : index + 3]).tolist()
    before, after = np.abs(s[first:row][::-1]), np.abs(s[row : last + 1])
    return float(time[row - 1 - _clear_row(before)]), float(time[row + _clear_row(after)])


def _clear_row(clearance: np.ndarray) -> int:
    clear = np.flatnonzero(clearance >= SIDE)
    return int(clear[0]) if len(clear) else int(np.argmax(clearance)) if len(clearance) else 0
