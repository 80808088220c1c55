"""Certificates: a trajectory's crossings, its extremes and its profile."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dextar_control.contract.plain_data import as_plain
from dextar_control.mechanisms.mechanism import Coordinate
from dextar_control.model.robot import AnyRobot
from dextar_control.planning.model import states_model
from dextar_control.planning.profile import (
    ON_CROSSING,
    Profile,
    find_crossings,
    sample_profile,
    sample_times,
)
from dextar_control.planning.trajectory import Trajectory
from dextar_control.symbols.types import Array

PLAN_RESIDUAL = 1e-9  # N, at the crossing of a plan
NEAR_LOCUS = 0.1  # |s| below which a torque counts as near the locus


class Crossing(NamedTuple):
    """One crossing of a trajectory, by one block of A_r, whose s this is."""

    time: float  # s
    x: tuple[float, ...]  # m
    x_dot: tuple[float, ...]  # m/s
    # of the locus: "stretched" or "folded" for the five-bar; "" where there is one
    family: str
    sign: int  # of s after the crossing; 0 when it leaves the workspace there
    rate: float  # of s, 1/s
    speed: float  # along t_s, m/s
    residual: float  # |t_s.w_d|, N
    multipliers: tuple[float, ...]  # limit on the locus, N/m
    torque: tuple[float, ...]  # limit on the locus, N m
    near_time: float  # s within |s| < NEAR_LOCUS about the crossing


class Certificate(NamedTuple):
    """A trajectory's crossings and extremes.

    Where A_r has several blocks each crossing is of one: two at once are two crossings.
    """

    crossing_times: Array  # (k,) s
    crossing_blocks: NDArray[np.int64]  # (k,) of A_r, that loses a rank there
    crossing_points: Array  # (k, n) m
    crossing_signs: Array  # (k,) sign of s after the crossing
    residuals: Array  # (k,) |t_s.w_d| at the crossing, N
    multipliers: Array  # (k, n) limit of lambda on the locus, N/m
    peak_torque: float  # N m
    peak_torque_near: float  # N m, within |s| < NEAR_LOCUS; nan without a crossing
    # N m/s: the largest change of a torque from one sample to the next, over a period
    peak_torque_rate: float
    peak_joint_speed: float  # rad/s
    peak_platform_speed: float  # m/s
    least_type1: float
    duration: float  # s
    profile: Profile
    crossings: tuple[Crossing, ...] = ()
    least_s: float = float("nan")  # |s| at the start and the end
    # an active joint, whose units torques and joint speeds have
    joint: Coordinate = Coordinate("q_a", "rad")

    def to_dict(self) -> dict[str, object]:
        """Return the extremes and the crossings in plain numbers and lists, as they
        travel with the trajectory.
        """
        found: dict[str, object] = {
            name: value
            for name, value in self._asdict().items()
            if isinstance(value, float)
        }
        return found | {"crossings": [one._asdict() for one in self.crossings]}

    def to_json(self) -> str:
        """Return ``to_dict`` as JSON; a number that does not exist is null."""
        return json.dumps(as_plain(self.to_dict()), allow_nan=False)

    def lines(self) -> list[str]:
        """Return the certificate in words, one fact a line."""
        text = [
            f"duration {self.duration:.3f} s, peak torque {self.peak_torque:.4f}"
            f" {self.joint.effort_unit}, peak torque rate {self.peak_torque_rate:.2f}"
            f" {self.joint.effort_unit}/s, peak joint speed {self.peak_joint_speed:.2f}"
            f" {self.joint.unit}/s, peak platform speed {self.peak_platform_speed:.3f}"
            f" m/s, distance to Type 1 {self.least_type1:.3f}"
        ]
        for index, crossing in enumerate(self.crossings):
            family = f"{crossing.family}, " if crossing.family else ""
            which = f"{family}to s {'>' if crossing.sign > 0 else '<'} 0"
            text.append(
                f"crossing {index + 1} ({which}) at {crossing.time:.4f} s in"
                f" {_list(crossing.x)} m, {crossing.speed:.3f} m/s along t_s,"
                f" {1e3 * crossing.near_time:.0f} ms within |s| < {NEAR_LOCUS},"
                f" residual {crossing.residual:.1e} N, multiplier"
                f" {_list(crossing.multipliers, 3)} N/m, torque"
                f" {_list(crossing.torque)} {self.joint.effort_unit}"
            )
        return text


def _list(values: tuple[float, ...], digits: int = 4) -> str:
    return f"({', '.join(f'{value:.{digits}f}' for value in values)})"


class Plan(NamedTuple):
    """A trajectory and its certificate."""

    trajectory: Trajectory
    certificate: Certificate


def measure(
    robot: AnyRobot, trajectory: Trajectory, period: float = 1e-3
) -> Certificate:
    """Return the certificate of a trajectory, whose limits are not checked; its samples
    are at most ``period``, s, apart.
    """
    times = sample_times(trajectory, period)
    rough = sample_profile(robot, trajectory, times)
    every = sorted(
        (time, block)
        for block, s in enumerate(rough.s_blocks.T)
        for time in find_crossings(robot, trajectory, times, s, block)
    )
    crossings = np.array([time for time, _ in every])
    blocks = np.array([block for _, block in every], dtype=np.int64)
    profile = rough
    if every:
        profile = sample_profile(robot, trajectory, np.union1d(times, crossings))
    rows = np.searchsorted(profile.time, crossings)
    near = np.abs(profile.s) < NEAR_LOCUS
    after = np.minimum(
        np.searchsorted(times, crossings + ON_CROSSING, side="right"), len(times) - 1
    )
    signs = np.sign(rough.s_blocks[after, blocks])
    found = tuple(
        _crossing(robot, profile, *one)
        for one in zip(rows.tolist(), blocks.tolist(), signs.tolist(), strict=True)
    )
    return Certificate(
        crossing_times=crossings,
        crossing_blocks=blocks,
        crossing_points=profile.x[rows],
        crossing_signs=signs,
        residuals=np.array([crossing.residual for crossing in found]),
        multipliers=profile.multipliers[rows],
        peak_torque=float(np.abs(profile.torque).max()),
        peak_torque_near=(
            float(np.abs(profile.torque[near]).max()) if near.any() else float("nan")
        ),
        peak_torque_rate=_peak_rate(profile.time, profile.torque, period),
        peak_joint_speed=float(np.abs(profile.q_a_dot).max()),
        peak_platform_speed=float(np.linalg.norm(profile.x_dot, axis=1).max()),
        least_type1=float(profile.type1.min()),
        duration=trajectory.duration,
        profile=profile,
        crossings=found,
        least_s=float(np.abs(profile.s[[0, -1]]).min()),
        joint=states_model(robot).mechanism.joints[0],
    )


def _peak_rate(times: Array, values: Array, period: float) -> float:
    """Return the largest change of values (m, n) at times (m,), s, between samples
    evenly ``period``, s, apart, over it.
    """
    even = np.arange(times[0], times[-1] + period, period)
    sampled = [np.interp(even, times, value) for value in values.T]
    return float(np.abs(np.diff(sampled)).max() / period)


def _crossing(
    robot: AnyRobot, profile: Profile, row: int, block: int, sign: float
) -> Crossing:
    """Return the crossing of a block at one row of a profile."""
    model, s = states_model(robot), profile.s_blocks[:, block]
    x, x_dot = profile.x[row], profile.x_dot[row]
    found, far = model.place(x), np.flatnonzero(np.abs(s) >= NEAR_LOCUS)
    t_s = found.t_s.reshape(model.n, -1)[:, block]
    place = int(np.searchsorted(far, row))
    enter = profile.time[far[place - 1] + 1] if place > 0 else profile.time[0]
    leave = profile.time[far[place] - 1] if place < len(far) else profile.time[-1]
    near = slice(max(row - 1, 0), row + 2)
    span = np.ptp(profile.time[near])
    return Crossing(
        time=float(profile.time[row]),
        x=tuple(x.tolist()),
        x_dot=tuple(x_dot.tolist()),
        family=model.mechanism.family_name(found.A_r),
        sign=int(np.nan_to_num(sign)),
        rate=float(np.diff(s[near][[0, -1]])[0] / span) if span > 0.0 else float("nan"),
        speed=float(abs(t_s @ x_dot)),
        residual=float(abs(profile.criterion[row, block])),
        multipliers=tuple(profile.multipliers[row].tolist()),
        torque=tuple(profile.torque[row].tolist()),
        near_time=float(leave - enter),
    )
