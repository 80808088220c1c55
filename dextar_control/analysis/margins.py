"""How near to its limits a run came: the controller's watches asked again of the bag,
and what the observer says of itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dextar_control.analysis.run import Floats, Phase, Run, Stamps, number_of, seconds
from dextar_control.analysis.timing import MOST_LATE, Timing
from dextar_control.analysis.tracking import Tracked
from dextar_control.contract.errors import ParameterError
from dextar_control.contract.resources import node_defaults
from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.settings import Settings
from dextar_control.control.law import OUTPUT
from dextar_control.control.phases import WITHOUT_LAW
from dextar_control.control.supervisor import (
    LAST,
    NAMES,
    WATCHES,
    Supervisor,
    timer_after,
    watch_of,
)
from dextar_control.estimation.records import ESTIMATE
from dextar_control.model.model import Model
from dextar_control.planning.certificate import Certificate
from dextar_control.symbols.functions import Batch
from dextar_control.symbols.record import Field, Layout

ROWS = 1024  # ticks that are looked at together
LAGS = 50  # samples over which the innovation is compared with itself
# a number is finite or not: to that limit nothing comes near
ASKED = [watch for watch in WATCHES if watch.name != "finite"]
SURE = 1.96  # deviations of a 95 % interval


@dataclass(frozen=True)
class Margin:
    """How near the run came to one limit.

    Attributes:
        name, what, unit: of what is watched.
        value, limit: where it was nearest; nan where the bag does not tell.
        share: of the limit that was reached, 1 at the limit; for ``locus``, a least
            distance, the limit over the value.
        time: s since the trajectory's start; nan where it is of the whole run.
        s: estimated then.
        lasted: longest time that the limit was passed, as the watch counts it, s.
        allowed: how long it may be, s; 0: not at all.
        note: what else there is to say.
    """

    name: str
    what: str
    unit: str
    value: float
    limit: float
    share: float
    time: float = math.nan
    s: float = math.nan
    lasted: float = 0.0
    allowed: float = 0.0
    note: str = ""


@dataclass(frozen=True)
class Innovation:
    """Whether the observer errs as it believes, over the tracked ticks.

    Attributes:
        samples: with an innovation.
        square: mean of its square over its covariance; ``expected`` where the observer
            is right, above where it trusts itself too much, below where it is told more
            noise than there is.
        low, high: 95 % of such means of independent innovations of an observer that is
            right.
        rms: root mean square of the innovation, rad.
        scatter: standard deviation of the samples about a smooth motion, by the steps
            of the innovation, rad.
        correlation: of the innovation with that of the next sample, mean of the joints;
            0 where the observer takes all there is.
        correlated: samples after which it is within ``bound`` for the first time; LAGS
            where it never is.
        bound: 95 % of the correlations of white noise lie within.
        correlations: with that of 1, 2 .. LAGS samples later.
    """

    samples: int
    square: float
    expected: float
    low: float
    high: float
    rms: float
    scatter: float
    correlation: float
    correlated: int
    bound: float
    correlations: list[float]


@dataclass(frozen=True)
class Margins:
    """How near a run came to its limits, and what its observer says of itself.

    Attributes:
        limits: those that the bag tells of, the nearest first.
        unknown: those that it does not, each with the reason.
        least_confidence: in the assembly mode, under a law and outside of crossings:
            from a verdict on one to the next phase CROSSING; and when, s.
        disturbance: largest torque at each joint that the observer says the model
            lacks, N m; empty where the bag does not tell.
        bias: the largest angle that the observer says a wrong geometry adds to each
            joint, rad; the same.
        innovation: None where the bag does not tell.
    """

    limits: list[Margin] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    least_confidence: float = math.nan
    least_confidence_time: float = math.nan
    disturbance: list[float] = field(default_factory=list)
    bias: list[float] = field(default_factory=list)
    innovation: Innovation | None = None


class _Ticks(NamedTuple):
    """A stretch of ticks under a law, (m,) each, with the tick before it as the first
    where there is one.
    """

    state: NDArray[np.intp]  # rows of states, control, criterion
    control: NDArray[np.intp]
    criterion: NDArray[np.intp]
    tau: Floats  # (m, 2) N m, nan where none was recorded
    fresh: slice[int, None, None]  # those that were not in the stretch before


def has_values(values: Floats) -> bool:
    """Tell whether a bag has a quantity of the observer, (n, ...), units alike: older
    bags lack it, and other estimators write 0.
    """
    return bool(np.isfinite(values).all() and values.any())


def measure_margins(
    run: Run,
    track: Tracked | None,
    plan: Certificate | None,
    timing: Timing,
    torque_limit: float,
    late_share: float,
) -> Margins:
    """Measure how near a run came to its limits.

    Args:
        torque_limit: of a crossing trajectory, N m, where the bag does not say it at
            each tick.
        late_share: of the steps, those without a command in time; nan where it is not
            known.
    """
    if track is None:
        return Margins()
    criterion = run.criterion
    law = np.isin(criterion.phase, WITHOUT_LAW + (-1,), invert=True)
    first = plan.crossing_times.min(initial=math.inf) if plan is not None else math.inf
    decided = (criterion.verdict > 0.0) | (
        criterion.stamps < track.start + 1e9 * min(first, track.time[-1])
    )
    outside = (
        law
        & (criterion.phase != Phase.CROSSING)
        & decided
        & np.isfinite(criterion.mode_confidence)
    )
    found, unknown = _node_limits(run, timing, late_share), []
    settings = _settings(run)
    if run.robot is None:
        unknown.append(
            "what is watched at every tick needs the robot's description (--robot FILE"
            " gives it)"
        )
    else:
        found += _watches(
            run, run.robot, settings, track, criterion.stamps[law], torque_limit
        )
        if not has_values(criterion.bias):
            unknown.append(
                "joint_jump needs the observer's bias, which this bag does not hold"
            )
    if (side := _side(run, settings, track, plan)) is not None:
        found.append(side)
    least = least_time = math.nan
    if outside.any():
        row = int(np.argmin(np.where(outside, criterion.mode_confidence, np.inf)))
        least = float(criterion.mode_confidence[row])
        least_time = (criterion.stamps[row] - track.start) * 1e-9
    rows = np.isin(criterion.stamps, track.stamps)
    return Margins(
        limits=sorted(
            found,
            key=lambda margin: (
                -min(margin.share, 1.0),
                -margin.lasted / (margin.allowed or 1.0),
            ),
        ),
        unknown=unknown,
        least_confidence=least,
        least_confidence_time=least_time,
        disturbance=_largest(criterion.disturbance[rows]),
        bias=_largest(criterion.bias[rows]),
        innovation=_innovation(
            criterion.innovation[rows], criterion.innovation_square[rows]
        ),
    )


def _largest(values: Floats) -> list[float]:
    return (
        [float(value) for value in np.abs(values).max(axis=0)]
        if len(values) and has_values(values)
        else []
    )


def _settings(run: Run) -> Settings:
    """Return the controller's settings as they were recorded, with defaults for those
    that its version did not have.
    """
    defaults = node_defaults("controller")
    try:
        return Settings.from_values(defaults | run.parameters.get("controller", {}))
    except (ParameterError, TypeError, ValueError):
        return Settings.from_values(defaults)


def _parameter(run: Run, node: str, name: str) -> float:
    recorded = number_of(run.parameter(node, name))
    return float(node_defaults(node)[name]) if math.isnan(recorded) else recorded


def _node_limits(run: Run, timing: Timing, late_share: float) -> list[Margin]:
    stamps = run.states.stamps
    limits = [
        (
            "states",
            "longest time between two states, by their stamps",
            "s",
            float(np.diff(stamps).max()) * 1e-9 if len(stamps) > 1 else math.nan,
            _parameter(run, "controller", "joint_states.timeout"),
        )
    ]
    if timing.lockstep is False:
        limits += [
            (
                "commands",
                "longest time between two commands, by the system clock",
                "s",
                timing.command_period.maximum,
                _parameter(run, "plant", "drive.command_timeout"),
            ),
            (
                "late",
                "share of the steps without a command in time",
                "1",
                late_share,
                MOST_LATE,
            ),
        ]
    return [
        Margin(name, what, unit, value, limit, value / limit)
        for name, what, unit, value, limit in limits
        if math.isfinite(value)
    ]


def _side(
    run: Run, settings: Settings, track: Tracked, plan: Certificate | None
) -> Margin | None:
    """Measure the longest time clear of the locus without knowing the side."""
    criterion = run.criterion
    if (
        plan is None
        or not np.isfinite(criterion.mode_confidence).any()
        or settings.estimator in ("dgm", "plain")
    ):
        return None
    time = seconds(criterion.stamps - track.start)
    s = np.interp(time, plan.profile.time, plan.profile.s.reshape(-1))
    inside = (time >= track.time[0]) & (time <= track.time[-1])
    unsure = (
        inside
        & (np.abs(s) >= settings.mode_check.above_abs_s)
        & (criterion.mode_confidence < settings.mode_check.confidence)
    )
    begins, ends = (
        np.flatnonzero(np.diff(np.concatenate([[0], unsure, [0]]).astype(int)))
        .reshape(-1, 2)
        .T
    )
    spans = time[ends - 1] - time[begins]
    longest = int(spans.argmax()) if len(spans) else -1
    value, row = (float(spans[longest]), ends[longest] - 1) if len(spans) else (0.0, -1)
    return Margin(
        "side",
        "longest time clear of the locus without knowing the side",
        "s",
        value,
        settings.mode_check.unknown_time,
        value / settings.mode_check.unknown_time,
        float(time[row]) if row >= 0 else math.nan,
        float(criterion.s[row]) if row >= 0 else math.nan,
        note=(
            "ends a motion only after an error of"
            f" {1e3 * settings.mode_check.unknown_error:g} mm"
        ),
    )


def _watches(
    run: Run,
    robot: RobotParameters,
    settings: Settings,
    track: Tracked,
    stamps: Stamps,
    torque_limit: float,
) -> list[Margin]:
    """Ask the supervisor's watches again, by its own function, at each tick under a
    law.
    """
    model = Model.of(robot)
    supervisor = Supervisor(robot, model)
    supervisor.configure(settings)
    watch, joints = Batch(watch_of(model.mechanism)), model.library.batch("state")
    sides = model.library.batch("inverse_geometric_model")
    best: dict[str, Margin] = {}
    timers, lasted = dict.fromkeys(NAMES, 0.0), dict.fromkeys(NAMES, 0.0)
    for ticks in _stretches(run, stamps):
        x, x_dot = (
            run.control.estimate[ticks.control],
            run.control.estimate_dot[ticks.control],
        )
        found = sides(model.p, x)
        q_a = found.q_a + np.nan_to_num(run.criterion.bias[ticks.criterion])
        q_a_dot = joints(model.p, found.q_a, x, x_dot).q_a_dot
        q_meas = run.states.position[ticks.state] - np.array(robot.encoder_offset)
        phase, error = (
            run.criterion.phase[ticks.criterion],
            run.control.error[ticks.control],
        )
        limit = np.where(
            np.isin(phase, (Phase.TRACK, Phase.CROSSING)),
            torque_limit,
            robot.max_torque,
        )
        recorded = run.criterion.torque_limit[ticks.criterion]
        limit = np.where(recorded > 0.0, recorded, limit)
        dt, known = np.full(len(phase), 1e-3), np.zeros(len(phase))
        dt[1:] = seconds(np.diff(run.states.stamps[ticks.state]))
        known[1:] = np.diff(ticks.state) == 1
        answer = watch(
            model.p,
            supervisor.places["bounds"],
            Layout("last", 2, LAST).rows(
                known=known,
                q_meas=_before(q_meas),
                q_a=_before(q_a),
                q_a_dot=_before(q_a_dot),
                tau=_before(ticks.tau),
            ),
            Layout("estimate", 2, ESTIMATE).rows(
                **_zeros(ESTIMATE)
                | {"x": x, "x_dot": x_dot, "q_a": q_a, "q_a_dot": q_a_dot}
            ),
            Layout("output", 2, OUTPUT).rows(
                **_zeros(OUTPUT)
                | {
                    "error": error,
                    "s": run.criterion.s[ticks.criterion],
                    "tau": ticks.tau,
                    "finite": 1.0,
                }
            ),
            q_meas,
            dt[:, None],
            limit[:, None],
            (phase == Phase.CROSSING)[:, None].astype(float),
        )
        values, limits, passed = answer.values, answer.limits, answer.passed > 0.0
        distance = np.hypot(*error.T)
        recovers = (
            run.criterion.mode_confidence[ticks.criterion]
            >= settings.mode_check.confidence
        )
        recovers &= distance < _before(distance)
        passed[:, NAMES.index("saturation")] &= ~recovers
        time = seconds(run.criterion.stamps[ticks.criterion] - track.start)
        for column, one in [(NAMES.index(one.name), one) for one in ASKED]:
            share = _share(
                one.name, values[ticks.fresh, column], limits[ticks.fresh, column]
            )
            row = int(np.argmax(share))
            if one.name not in best or share[row] > best[one.name].share:
                at = row + ticks.fresh.start
                best[one.name] = Margin(
                    one.name,
                    one.value,
                    one.unit,
                    float(values[at, column]),
                    float(limits[at, column]),
                    float(share[row]),
                    float(time[at]),
                    float(run.criterion.s[ticks.criterion[at]]),
                    0.0,
                    max(supervisor.times[one.name], 0.0),
                )
            over = passed[ticks.fresh, column]
            if best[one.name].allowed and (over.any() or timers[one.name] > 0.0):
                for step, trips in zip(
                    dt[ticks.fresh].tolist(), over.tolist(), strict=True
                ):
                    timers[one.name] = timer_after(timers[one.name], step, trips)
                    lasted[one.name] = max(lasted[one.name], timers[one.name])
    if not has_values(run.criterion.bias):
        best.pop("joint_jump", None)
    return [
        replace(margin, share=max(margin.share, 0.0), lasted=lasted[name])
        for name, margin in best.items()
    ]


def _zeros(fields: Iterable[Field]) -> dict[str, float | Floats]:
    return dict.fromkeys((one.name for one in fields), 0.0)


def _before(values: Floats) -> Floats:
    """Return the values (m, ...) of the tick before each; the first has its own."""
    return np.concatenate([values[:1], values[:-1]])


def _share(name: str, values: Floats, limits: Floats) -> Floats:
    if name == "locus":
        values, limits = limits, values  # the nearer the worse
    with np.errstate(divide="ignore", invalid="ignore"):
        shares: Floats = np.nan_to_num(values / limits, nan=0.0, posinf=0.0)
    return shares


def _stretches(run: Run, stamps: Stamps) -> Iterator[_Ticks]:
    """Yield the ticks of these stamps that states, control and criterion have, in
    order.
    """
    known = np.isin(stamps, run.control.stamps) & np.isin(stamps, run.states.stamps)
    stamps = stamps[known]
    for begin in range(0, len(stamps), ROWS):
        first = max(begin - 1, 0)
        own = stamps[first : begin + ROWS]
        tau = np.full((len(own), 2), np.nan)
        rows = np.minimum(
            np.searchsorted(run.commands.stamps, own),
            max(len(run.commands.stamps) - 1, 0),
        )
        if len(run.commands.stamps):
            answered = run.commands.stamps[rows] == own
            tau[answered] = run.commands.effort[rows[answered]]
        state, control, criterion = (
            np.searchsorted(part.stamps, own)
            for part in (run.states, run.control, run.criterion)
        )
        yield _Ticks(state, control, criterion, tau, slice(begin - first, None))


def _innovation(innovation: Floats, squares: Floats) -> Innovation | None:
    """Judge innovations (n, k), rad, and their normalised squares (n,)."""
    count, size = innovation.shape
    if count <= 2 * LAGS or not has_values(innovation):
        return None
    centred = innovation - innovation.mean(axis=0)
    power = np.maximum((centred**2).mean(axis=0), 1e-300)
    correlations = [
        float(((centred[lag:] * centred[:-lag]).sum(axis=0) / count / power).mean())
        for lag in range(1, LAGS + 1)
    ]
    bound, spread = SURE / math.sqrt(count * size), SURE * math.sqrt(2.0 * size / count)
    within = np.flatnonzero(np.abs(correlations) < bound)
    return Innovation(
        samples=count,
        square=float(squares.mean()),
        expected=float(size),
        low=size - spread,
        high=size + spread,
        rms=float(np.sqrt((innovation**2).mean())),
        scatter=float(np.sqrt(0.5 * (np.diff(innovation, axis=0) ** 2).mean())),
        correlation=correlations[0],
        correlated=int(within[0]) + 1 if len(within) else LAGS,
        bound=bound,
        correlations=correlations,
    )
