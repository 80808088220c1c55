"""What is watched at every sample while a law acts, and why at that limit: the table ``WATCHES``.

A watch compares a number with its limit. One that has a time lets the number pass the limit for that long: the time counts
up while it does and down at RECOVERY of that pace else, so that what swings about a limit is seen too. The first watch of
the table that trips ends the motion in a safe stop (``core.safe_stop``) and says so in one sentence.

The estimator's opinion of the assembly mode is watched by ``core.verdicts``; what needs a clock or the network (age of the
states, a second commander) by who has them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dextar_control.contract.robot import RobotParameters
from dextar_control.core.compiled import njit
from dextar_control.core.dgm import wrap
from dextar_control.core.kinematics import inverse_geometric_model
from dextar_control.core.law import ERROR, FINITE, Q_HAT, SCALARS, TAU, X_HAT
from dextar_control.core.model import Array, JointRange, Model, beyond_range, joint_range, pack, unpack
from dextar_control.core.settings import Settings

RECOVERY = 0.25  # of the pace at which a watch's time counts up, down again
LONG_STEP = 5e-3  # s since the last sample, over which its estimate does not say where the joints are now
SIDES = ("left", "right")


class Watch(NamedTuple):
    """One number that is watched."""

    name: str
    value: str  # what it is
    unit: str
    limit: str  # what makes its limit: a parameter, or one of the robot's with one
    time: str  # the parameter that says how long it may pass the limit; empty: not at all
    reason: str  # of the defaults; "good runs" are those of the campaign that succeed


WATCHES = (
    Watch("joint_jump", "a joint beside where the last sample expected it", "rad", "max_joint_jump", "",
          "0.0012 in good runs, 0.015 when struck at the locus; an encoder that slips by more is seen at once"),
    Watch("finite", "numbers of estimate and law that are not finite", "", "none", "",
          "such a number is never commanded"),
    Watch("tracking_error", "distance between reference and estimate", "m", "max_tracking_error", "",
          "2.4 mm in good runs with consistent and observer, 5 mm is a failure; at 20 mm the plan is over"),
    Watch("joint_speed", "a joint from one sample to the next, over the time between", "rad/s",
          "robot.max_joint_speed x speed_margin", "speed_time",
          "a plan may use all of the robot's limit, and an error adds to it"),
    Watch("platform_speed", "speed of the estimate", "m/s", "robot.max_platform_speed x speed_margin", "speed_time",
          "as the joints'; the time is for the direct model, whose speed is without bound for a sample on the locus"),
    Watch("joint_range", "a joint's way out of its range", "rad", "joint_margin", "",
          "a plan may go to the end of the range; an error of 5 mm is 0.05 rad"),
    Watch("estimator", "a joint beside that of the estimated platform", "rad", "max_joint_misfit", "misfit_time",
          "0.0052 in good runs, with a geometry 0.2 mm off; an estimate that has lost the robot passes 0.02 at the locus"),
    Watch("locus", "|s| of the estimate outside of phase CROSSING", "", "locus_s (at least)", "",
          "plans keep 0.4 there, approaches 0.2; the robots of good runs kept 0.36. Who comes nearer was pushed or is lost"),
    Watch("saturation", "the larger torque", "N m", "what it is cut at", "watch_time",
          "good runs do not touch it; a robot on the other side or against a stop stays there"),
    Watch("torque_rate", "change of a torque since the last sample, over the time between", "N m/s",
          "robot.max_torque x max_torque_rate", "torque_rate_time",
          "65 N m/s for 3 ms in good runs; a loop that swings between its limits does so at each sample"),
)  # fmt: skip
(
    JOINT_JUMP, NOT_FINITE, TRACKING_ERROR, JOINT_SPEED, PLATFORM_SPEED, JOINT_RANGE, ESTIMATOR, LOCUS, SATURATION, TORQUE_RATE,
) = range(len(WATCHES))  # fmt: skip
COUNT = len(WATCHES)
Q_LAST, Q_HAT_LAST, TAU_LAST, MEMORY = 0, 2, 6, 8  # rows of the last sample: joints; q_a, q_a_dot estimated; torque; size
LIMITS, TIMES, VALUES, TIMERS = range(4)  # rows of the table of numbers


@njit
def evaluate(
    packed: Array, bounds: JointRange, table: Array, memory: Array, estimate: Array, output: Array, q_meas: Array, dt: float
) -> int:
    """The numbers of one sample into the table, and the first watch that trips; -1 for none.

    Args:
        table: (4, COUNT) limits, times in s for which they may be passed, and the values and timers, which are written.
        memory: (MEMORY,) of the last sample, nan where there was none; written.
        estimate, output: rows, see ``law``.
        q_meas: (2,) rad, on any turn.
        dt: since the last sample, s.
    """
    model = unpack(packed)
    limits, times, values, timers = table[LIMITS], table[TIMES], table[VALUES], table[TIMERS]
    values[:] = 0.0
    finite = np.isfinite(estimate).all() and output[FINITE] == 1.0
    values[NOT_FINITE] = 0.0 if finite else 1.0
    values[JOINT_RANGE] = beyond_range(bounds, q_meas).max()
    implied = inverse_geometric_model(model, estimate[X_HAT : X_HAT + 2])
    for i in range(2):
        if np.isfinite(memory[Q_LAST]):
            values[JOINT_SPEED] = max(values[JOINT_SPEED], abs(wrap(q_meas[i] - memory[Q_LAST + i])) / dt)
            if dt <= LONG_STEP:
                expected = memory[Q_HAT_LAST + i] + dt * memory[Q_HAT_LAST + 2 + i]
                values[JOINT_JUMP] = max(values[JOINT_JUMP], abs(wrap(q_meas[i] - expected)))
        if finite:
            values[ESTIMATOR] = max(values[ESTIMATOR], abs(wrap(q_meas[i] - implied[i])))
            values[SATURATION] = max(values[SATURATION], abs(output[TAU + i]))
            if np.isfinite(memory[Q_LAST]):
                values[TORQUE_RATE] = max(values[TORQUE_RATE], abs(output[TAU + i] - memory[TAU_LAST + i]) / dt)
    if finite:
        values[TRACKING_ERROR] = np.hypot(output[ERROR], output[ERROR + 1])
        values[PLATFORM_SPEED] = np.hypot(estimate[X_HAT + 2], estimate[X_HAT + 3])
        values[LOCUS] = abs(output[SCALARS + 1])
    memory[Q_LAST : Q_LAST + 2] = q_meas
    memory[Q_HAT_LAST : Q_HAT_LAST + 4] = estimate[Q_HAT : Q_HAT + 4]
    memory[TAU_LAST : TAU_LAST + 2] = output[TAU : TAU + 2]
    tripped = -1
    for k in range(COUNT):
        if k == LOCUS:
            passed = values[k] < limits[k]
        elif k == SATURATION:
            passed = values[k] >= limits[k]
        else:
            passed = not values[k] <= limits[k]
        if times[k] >= 0.0:
            timers[k] = timers[k] + dt if passed else max(timers[k] - RECOVERY * dt, 0.0)
            passed = timers[k] > times[k]
        if passed and tripped < 0:
            tripped = k
    return tripped


class Supervisor:
    """Watches one robot under a law.

    Args:
        robot: the controller's model of it.
        model: the same, packed numbers' source.
    """

    def __init__(self, robot: RobotParameters, model: Model) -> None:
        self._robot = robot
        self._packed = pack(model)
        self._range = joint_range(robot)
        self._table = np.zeros((4, COUNT))
        self._memory = np.full(MEMORY, np.nan)
        self._locus_s = 0.0
        self._tripped = -1

    def configure(self, settings: Settings) -> None:
        """Take the limits, also while running."""
        limits, times = self._table[LIMITS], self._table[TIMES]
        times[:] = -1.0
        limits[TRACKING_ERROR] = settings.max_tracking_error
        limits[JOINT_SPEED] = settings.speed_margin * self._robot.max_joint_speed
        limits[PLATFORM_SPEED] = settings.speed_margin * self._robot.max_platform_speed
        times[JOINT_SPEED] = times[PLATFORM_SPEED] = settings.speed_time
        limits[JOINT_RANGE] = settings.joint_margin
        limits[JOINT_JUMP] = settings.max_joint_jump
        limits[ESTIMATOR], times[ESTIMATOR] = settings.max_joint_misfit, settings.misfit_time
        limits[TORQUE_RATE], times[TORQUE_RATE] = settings.max_torque_rate * self._robot.max_torque, settings.torque_rate_time
        times[SATURATION] = settings.watch_time
        self._locus_s = settings.locus_s

    def begin(self) -> None:
        """Another trajectory: the times count anew."""
        self._table[TIMERS] = 0.0

    def forget(self) -> None:
        """The robot was left to itself: what follows is not compared with what was before."""
        self._table[TIMERS], self._table[VALUES] = 0.0, 0.0
        self._memory[:] = np.nan

    def check(
        self, estimate: Array, output: Array, q_a: Array, dt: float, torque_limit: float, crossing: bool
    ) -> str:
        """What is wrong with one sample, in a sentence with value and limit; empty for nothing.

        Args:
            estimate, output: rows, see ``law``.
            q_a: (2,) measured, rad.
            dt: since the last sample, s.
            torque_limit: at which the torques were cut, N m.
            crossing: the reference is near the locus because a crossing is planned there.
        """
        table = self._table
        table[LIMITS, LOCUS] = 0.0 if crossing else self._locus_s
        table[LIMITS, SATURATION] = torque_limit
        self._tripped = evaluate(self._packed, self._range, table, self._memory, estimate, output, q_a, dt)
        return "" if self._tripped < 0 else self._sentence(self._tripped, q_a)

    @property
    def tripped(self) -> str:
        """Name of the watch that tripped at the last sample; empty for none."""
        return "" if self._tripped < 0 else WATCHES[self._tripped].name

    @property
    def estimate_lost(self) -> bool:
        """Whether what tripped at the last sample says that the estimate is not the robot's."""
        return self._tripped in (NOT_FINITE, JOINT_JUMP, ESTIMATOR)

    @property
    def saturated(self) -> bool:
        """Whether a torque of the last sample was cut."""
        return bool(self._table[VALUES, SATURATION] >= self._table[LIMITS, SATURATION])

    @property
    def watches(self) -> dict[str, tuple[float, float]]:
        """Each watch's last value and its limit, by name; zero limits do not bind."""
        limits, _, values, _ = self._table.tolist()
        return {watch.name: (values[k], limits[k]) for k, watch in enumerate(WATCHES)}

    def _sentence(self, k: int, q_a: Array) -> str:
        limits, times, values, timers = self._table[:, k].tolist()
        if k == NOT_FINITE:
            return "the law gave a number that is not finite"
        if k == TRACKING_ERROR:
            return f"tracking error {values:.4f} m; the limit is {limits} m"
        if k == JOINT_RANGE:
            leg = int(np.argmax(beyond_range(self._range, q_a)))
            low, high = self._robot.legs[leg].min_angle, self._robot.legs[leg].max_angle
            return (
                f"the {SIDES[leg]} joint is {values:.3f} rad outside its range of {low:.4g} to {high:.4g} rad;"
                f" the limit is {limits:.4g} rad"
            )
        if k == JOINT_JUMP:
            return f"a joint jumped by {values:.4f} rad in one sample; the limit is {limits:.4g} rad"
        if k == LOCUS:
            return f"the robot is at |s| = {values:.3f} of the locus without a planned crossing; the limit is {limits:.4g}"
        what, unit = {
            JOINT_SPEED: ("joint speed {:.1f} rad/s", "rad/s"),
            PLATFORM_SPEED: ("platform speed {:.2f} m/s", "m/s"),
            ESTIMATOR: ("the joints are {:.4f} rad from the estimate's", "rad"),
            SATURATION: ("torque {:.3f} N m", "N m"),
            TORQUE_RATE: ("the torque changes by {:.0f} N m/s", "N m/s"),
        }[k]
        limit = f"{limits:.3f}" if k == SATURATION else f"{limits:.4g}"
        return f"{what.format(values)} for {1e3 * timers:.0f} ms; the limit is {limit} {unit} for {1e3 * times:.0f} ms"
