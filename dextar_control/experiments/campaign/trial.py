"""One trial: return trips through one crossing point in a plain loop, against one
perturbed plant.
"""

from __future__ import annotations

import dataclasses
import gc
import math
import time
from collections.abc import Mapping
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dextar_control.contract.errors import DextarError
from dextar_control.contract.robot import RobotParameters, flatten
from dextar_control.contract.settings import ESTIMATORS as ESTIMATORS
from dextar_control.contract.settings import LAWS as LAWS
from dextar_control.contract.settings import default_settings
from dextar_control.control.loop import ControlLoop
from dextar_control.control.phases import WITHOUT_LAW, Phase
from dextar_control.control.verdicts import Verdict
from dextar_control.estimation.estimate import ExternalPosition
from dextar_control.experiments.campaign.design import CrossingPoint, Trial
from dextar_control.experiments.campaign.rig import RigInterface, RigMaker
from dextar_control.experiments.campaign.rows import Row
from dextar_control.experiments.campaign.self_calibration import calibrated_description
from dextar_control.planning.certificate import Certificate
from dextar_control.planning.checks import clear_times
from dextar_control.planning.locus import locus_point, nearest_point, sample_locus
from dextar_control.planning.planner import (
    CrossingCriterion,
    Plan,
    plan_return_trip_through,
)
from dextar_control.symbols.types import Array

MAX_ERROR, END_ERROR = 5e-3, 1e-3  # m, true
# confidences from which the bins of the reliability table begin
CONFIDENCE_BINS = (0.5, 0.6, 0.8, 0.9, 0.99, 0.999)
NEAR_ABS_S = 0.1  # |s| that counts as near the locus
SIDE_TEST_ABS_S = 0.2  # |s| from which on the test of the side runs
SETTLE = 0.2  # s of holding after the trip
# s before and after the planned crossing between which a bounce is struck
STRIKE_SPREAD = 0.01
RESTITUTION = (0.6, 1.0)  # speed after over before, of a bounce
NO_TORQUE = 1e-3  # N m below which a torque counts as gone
RELEASE_TIME = 0.03  # s after recognition within which the torque is gone or brakes
INERTIAL_PARAMETERS = (
    *(
        f"{side}.{body}"
        for side in ("left", "right")
        for body in (
            "proximal_mass",
            "proximal_inertia",
            "distal_mass",
            "distal_inertia",
            "rotor_inertia",
        )
    ),
    "end_effector_mass",
)
GRAVITY = 9.81  # m/s^2
BELT_DAMPING = 0.05  # damping ratio of rotor and belt
PUSH_DURATION, PUSH_BEFORE = 0.02, 0.03  # s; until the planned crossing
# |s| of the plan from which on a robot on the other side counts as on the wrong one
WRONG_SIDE_ABS_S = 0.2
LINK_LENGTHS = (
    "left.proximal_length",
    "left.distal_length",
    "right.proximal_length",
    "right.distal_length",
)
RIG_OPTIONS = (
    "command_delay",
    "sample_loss",
    "jitter",
    "position_noise",
    "pose_rate",
    "pose_delay",
    "pose_noise",
    "pose_dropout",
    "backlash",
    "cogging",
    "drive_lag",
    "torque_step",
    "payload",
    "payload_time",
    "eccentricity",
    "homing_error",
    "stamp_error",
)


def sample_points(
    robot: RobotParameters, count: int, folded: int, seed: int
) -> list[CrossingPoint]:
    """Spread crossing points over the locus."""
    return [
        CrossingPoint(
            (float(place.x[0]), float(place.x[1])),
            (int(place.working_mode[0]), int(place.working_mode[1])),
            place.family.name.lower() if place.family else "",
        )
        for place in sample_locus(robot, count, seed, folded=folded)
    ]


def built_robot(
    robot: RobotParameters,
    perturbation: Mapping[str, float],
    generator: np.random.Generator,
    sides: np.random.Generator,
) -> RobotParameters:
    """Return a robot as it was built and not as it was drawn.

    ``masses``: each mass and inertia is off by an evenly distributed share of up to
    this. ``geometry``: the four lengths and both coordinates of both motor axes, eight
    numbers, are off by up to this, m. ``geometry_signs``: by this.

    Args:
        generator: of how far things are off.
        sides: of the signs and directions of what is off by a given number.
    """
    changes: dict[str, float | tuple[float, float]] = {}
    flat = flatten(robot)
    shares = perturbation.get("masses", 0.0) * generator.uniform(
        -1.0, 1.0, len(INERTIAL_PARAMETERS)
    )
    for name, share in zip(INERTIAL_PARAMETERS, shares, strict=True):
        changes[name] = flat[name] * (1.0 + share)
    off = perturbation.get("geometry", 0.0) * generator.uniform(-1.0, 1.0, 8)
    off += perturbation.get("geometry_signs", 0.0) * sides.choice((-1.0, 1.0), 8)
    for name, shift in zip(LINK_LENGTHS, off[:4], strict=True):
        changes[name] = flat[name] + shift
    for side, leg, shift in zip(
        robot.sides, robot.legs, (off[4:6], off[6:8]), strict=True
    ):
        if shift.any():
            changes[f"{side}.axis"] = tuple((np.array(leg.axis) + shift).tolist())
    if tilt := perturbation.get("tilt"):
        way, pull = sides.uniform(0.0, 2.0 * math.pi), GRAVITY * math.sin(tilt)
        changes["gravity"] = (
            robot.gravity[0] + pull * math.cos(way),
            robot.gravity[1] + pull * math.sin(way),
        )
    if speed := perturbation.get("coulomb_speed"):
        changes["coulomb_speed"] = speed
    return robot.replace(
        **changes, **_friction_and_belt(robot, perturbation, 1.0, 1.0, belt=True)
    )


def controller_model(
    robot: RobotParameters, perturbation: Mapping[str, float]
) -> RobotParameters:
    """Return the controller's model, which knows of the perturbation the modelled share
    of the friction, and perhaps the belt.
    """
    changes = _friction_and_belt(
        robot,
        perturbation,
        perturbation.get("coulomb_modelled", 0.0),
        perturbation.get("passive_modelled", 0.0),
        belt=bool(perturbation.get("belt_modelled")),
    )
    return robot.replace(**changes) if changes else robot


def _friction_and_belt(
    robot: RobotParameters,
    perturbation: Mapping[str, float],
    coulomb: float,
    passive: float,
    *,
    belt: bool,
) -> dict[str, float]:
    """Return the changes that the perturbation makes with these shares of the
    friction.
    """
    changes: dict[str, float] = {}
    for side, leg in zip(robot.sides, robot.legs, strict=True):
        if "coulomb" in perturbation:
            changes[f"{side}.coulomb_friction"] = coulomb * perturbation["coulomb"]
        if "passive" in perturbation:
            changes[f"{side}.passive_coulomb_friction"] = changes[
                "pin_coulomb_friction"
            ] = passive * perturbation["passive"]
        if belt and perturbation.get("belt"):
            stiffness = perturbation["belt"]
            ratio = perturbation.get("belt_damping", BELT_DAMPING)
            changes[f"{side}.transmission_stiffness"] = stiffness
            changes[f"{side}.transmission_damping"] = (
                2.0 * ratio * math.sqrt(stiffness * leg.rotor_inertia)
            )
    return changes


def plan_trial(robot: RobotParameters, trial: Trial) -> Plan:
    """Plan the trip of a trial whose robot is not calibrated first, by what the
    controller knows of it.

    Those of one process that ask for the same share one.

    Raises:
        DextarError: there is none.
    """
    robot = controller_model(
        robot.replace(working_mode=trial.working_mode), trial.perturbation
    )
    return _plan_for(robot, trial)


def _plan_for(robot: RobotParameters, trial: Trial) -> Plan:
    criterion = (
        CrossingCriterion.ZERO_WRENCH
        if trial.law == "multi_model"
        else CrossingCriterion.RECIPROCAL
    )
    return _planned(
        robot,
        trial.point,
        trial.direction,
        trial.duration,
        trial.dwell,
        trial.repeat,
        criterion,
    )


@lru_cache(maxsize=64)
def _planned(
    robot: RobotParameters,
    point: tuple[float, float],
    direction: int,
    duration: float,
    dwell: float,
    repeat: int,
    criterion: CrossingCriterion,
) -> Plan:
    place = locus_point(robot, np.array(point))
    return plan_return_trip_through(
        robot, place, direction, duration, dwell, repeat, criterion=criterion
    )


def run_trial(robot: RobotParameters, trial: Trial, rig: RigMaker) -> Row:
    """Run a trial, and return its row of results.

    Args:
        robot: as the controller knows it but for working mode and friction.
        trial: what to do.
        rig: makes the rig: ``rig(robot, **options)`` with reset_joints, read, write,
            truth, strike, close.
    """
    begin = time.perf_counter()
    perturbation = dict(trial.perturbation)
    generator = np.random.default_rng(trial.seed)
    sides = np.random.default_rng([trial.seed, 1])
    drawn, mode = robot, {"working_mode": trial.working_mode}
    built = built_robot(robot.replace(**mode), perturbation, generator, sides)
    options = _rig_options(perturbation)
    robot = controller_model(drawn.replace(**mode), perturbation)
    told = dict[str, bool]()
    try:
        if perturbation.get("calibrated") or perturbation.get("identified"):
            recorder = partial(
                rig,
                built.replace(working_mode=drawn.working_mode),
                plant=trial.plant,
                seed=trial.seed,
                **options,
            )
            robot, told = calibrated_description(
                controller_model(drawn, perturbation),
                recorder,
                calibrated=bool(perturbation.get("calibrated")),
                identified=bool(perturbation.get("identified")),
            )
            robot = robot.replace(**mode)
            x, y = nearest_point(robot, np.array(trial.point)).x.tolist()
            trial = dataclasses.replace(trial, point=(x, y))
        plan = _plan_for(robot, trial)
    except DextarError as error:
        return told | {
            "planned": False,
            "plan_problem": str(error),
            "success": False,
            "reason": f"not planned: {error}",
        }
    planning = time.perf_counter() - begin
    begin, begin_cpu = time.perf_counter(), time.process_time()
    loop = ControlLoop(
        robot,
        default_settings(
            **{"law": trial.law, "estimator": trial.estimator, **trial.settings}
        ),
        -trial.direction,
    )
    plant = rig(built, plant=trial.plant, seed=trial.seed, **options)
    gc.disable()  # a row makes no cycles, and its log is long
    try:
        strike = _strike_of(loop, plan, perturbation, generator, sides)
        log = _drive(loop, plan, plant, strike)
        saturated_drives = plant.saturated
    except DextarError as error:
        return told | {
            "planned": True,
            "success": False,
            "reason": str(error),
            "wall_time": time.perf_counter() - begin,
        }
    finally:
        plant.close()
        gc.enable()
    row = _judge(loop, log, bool(perturbation.get("bounce")))
    times: Row = {
        "saturated_drives": saturated_drives,
        "planning_time": planning,
        "simulated_time": len(log.time) * plant.period,
        "wall_time": time.perf_counter() - begin,
        "cpu_time": time.process_time() - begin_cpu,
    }
    return row | told | times


def _rig_options(perturbation: Mapping[str, float]) -> dict[str, float | str]:
    """Return the perturbation's options of the rig, by the rig's names."""
    options: dict[str, float | str] = {
        name: perturbation[name] for name in RIG_OPTIONS if name in perturbation
    }
    for name in ("encoder_resolution", "cogging_periods"):
        if name in perturbation:
            options[name] = int(perturbation[name])
    if perturbation.get("coulomb_speed"):
        options["friction"] = "smooth"
    if perturbation.get("link_encoder"):
        options["encoder_at"] = "link"
    return options


class Strike(NamedTuple):
    """A blow, or a push, which is a blow in each of several periods."""

    time: float  # s
    impulse: Array  # (2,) N s, of a blow, N of a push
    duration: float = 0.0  # s; 0 is one blow


class Log(NamedTuple):
    """What happened, a row each period."""

    time: Array  # (m,) s
    x: Array  # (m, 2) true, m
    x_ref: Array  # (m, 2) of the plan at that time, whether or not a sample came, m
    tau: Array  # (m, 2) commanded, N m
    power: Array  # (m,) of the commanded torques, W
    s: Array  # (m,) true
    s_ref: Array  # (m,) of the plan
    limp: Array  # (m,) no law acts
    mode: Array  # (m,) believed sign of s
    confidence: Array  # (m,) stated in it
    strike: float  # s; nan without


def _strike_of(
    loop: ControlLoop,
    plan: Plan,
    perturbation: Mapping[str, float],
    generator: np.random.Generator,
    sides: np.random.Generator,
) -> Strike | None:
    """Return what hits the robot at the first crossing, if anything does.

    A push acts along t_s, or across it. A bounce turns the motion round: of the planned
    velocity the part along t_s, which the joints do not show, where the distal links
    are stretched; where they are folded, and t_s leads along the locus, all of it.
    """
    crossing = float(plan.certificate.crossing_times[0])
    if perturbation.get("push"):
        along = loop.model.place(plan.trajectory.at(crossing).x).t_s * sides.choice(
            (-1.0, 1.0)
        )
        along = (
            np.array([-along[1], along[0]])
            if perturbation.get("push_across")
            else along
        )
        begin = crossing - perturbation.get("push_before", PUSH_BEFORE)
        return Strike(
            begin,
            perturbation["push"] * along,
            perturbation.get("push_duration", PUSH_DURATION),
        )
    if not perturbation.get("bounce"):
        return None
    moment = (
        round((crossing + generator.uniform(-STRIKE_SPREAD, STRIKE_SPREAD)) * 1000.0)
        / 1000.0
    )
    point = plan.trajectory.at(moment)
    place = loop.model.place(point.x)
    turned = point.x_dot
    if place.A_r[0] @ place.A_r[1] < 0.0:
        turned = (place.t_s @ point.x_dot) * place.t_s
    if perturbation.get("blow"):
        duration = perturbation.get("blow_duration", PUSH_DURATION)
        return Strike(
            moment - duration,
            -perturbation["blow"] * turned / np.linalg.norm(turned),
            duration,
        )
    mass = loop.model.platform_dynamics(place.q_a, point.x, point.x_dot, np.zeros(2)).M
    return Strike(moment, -(1.0 + generator.uniform(*RESTITUTION)) * (mass @ turned))


def _drive(
    loop: ControlLoop, plan: Plan, rig: RigInterface, strike: Strike | None
) -> Log:
    start, certificate = plan.trajectory.at(0.0).x, plan.certificate
    place = loop.model.place(start)
    rig.reset_joints(place.q_a, round(np.sign(place.s[0])))
    loop.schedule(plan.trajectory, certificate)
    period = rig.period
    count = round((plan.trajectory.duration + SETTLE) / period)
    states, x_refs, taus, limp, beliefs = [], [], [], [], []
    x_ref, tau, began = start, np.zeros(2), math.nan
    first, last, impulse = 0, 0, np.zeros(2)
    if strike is not None:
        first = round(strike.time / period)
        last = first + max(round(strike.duration / period), 1)
        impulse = strike.impulse * (period if strike.duration else 1.0)
    for index in range(count):
        sample, truth = rig.read(), rig.truth()
        if sample is not None:
            pose = (
                None
                if sample.pose is None
                else ExternalPosition(sample.pose.time, sample.pose.x)
            )
            tau = loop.step(sample.time, sample.q_a, pose)
            x_ref = loop.tick.x_ref if loop.tick is not None else start
            began = sample.time if math.isnan(began) else began
        limp.append(loop.phase in WITHOUT_LAW)
        if (
            sample is None or limp[index]
        ) and began <= index * period:  # the trip goes on without sample or robot
            x_ref = plan.trajectory.at(index * period - began).x
        if first <= index < last:
            rig.strike(impulse)
        estimate = None if loop.tick is None else loop.tick.estimate
        beliefs.append(
            (0.0, 0.5)
            if estimate is None
            else (estimate.assembly_mode, estimate.confidence)
        )
        states.append(truth.numbers)
        x_refs.append(x_ref)
        taus.append(tau)
        rig.write(None if sample is None else tau)
    numbers, tau_log = np.array(states), np.array(taus)
    joints, x, q_a_dot = (
        numbers[:, truth.layout.places[name][0]] for name in ("joints", "x", "q_a_dot")
    )
    return Log(
        time=period * np.arange(count, dtype=np.float64),
        x=x,
        x_ref=np.array(x_refs),
        tau=tau_log,
        power=(tau_log * q_a_dot).sum(axis=1),
        s=np.sin(joints[:, 2] + joints[:, 3] - joints[:, 0] - joints[:, 1]),
        s_ref=np.interp(
            np.arange(count) * period - began,
            certificate.profile.time,
            certificate.profile.s.reshape(-1),
        ),
        limp=np.array(limp),
        mode=np.array(beliefs)[:, 0],
        confidence=np.array(beliefs)[:, 1],
        strike=math.nan if strike is None else strike.time,
    )


def s_around_crossing(
    certificate: Certificate, log: Log, index: int
) -> tuple[float, float]:
    """Return the true s before and after a planned crossing, where the plan is clear of
    the locus.
    """
    first, last = np.searchsorted(log.time, clear_times(certificate, index))
    return float(log.s[max(first - 1, 0)]), float(log.s[min(last, len(log.s) - 1)])


def _judge(loop: ControlLoop, log: Log, bounced: bool) -> Row:
    certificate = loop.certificate
    if certificate is None:
        return {
            "planned": True,
            "success": False,
            "reason": f"the trip did not begin: {loop.refusal}",
        }
    error = np.hypot(*(log.x_ref - log.x).T)
    peak = np.abs(log.tau).max(axis=1)
    count = len(certificate.crossing_times)
    crossed = []
    for index in range(count):
        before, after = s_around_crossing(certificate, log, index)
        sign = certificate.crossing_signs[index]
        crossed.append(before * sign < 0.0 < after * sign)
    verdicts = [passed.verdict for passed in loop.passed]
    truths = [
        _on_side(log, passed.time, sign)
        for passed, sign in zip(loop.passed, certificate.crossing_signs, strict=True)
    ]
    near = np.abs(log.s) < NEAR_ABS_S
    wrong = (
        np.logical_not(log.limp)
        & (np.abs(log.s_ref) > WRONG_SIDE_ABS_S)
        & (log.s * log.s_ref < 0.0)
    )
    planned = certificate.peak_torque
    reason = _reason(loop, crossed, error)
    row: Row = {
        "planned": True,
        "plan_problem": "",
        "crossings_planned": count,
        "crossed": sum(crossed),
        "success": not reason,
        "reason": reason,
        "max_error": float(error.max()),
        "end_error": float(error[-1]),
        "planned_peak_torque": planned,
        "peak_torque": float(peak.max()),
        "peak_ratio": float(peak.max() / planned),
        "peak_ratio_near": (
            float(peak[near].max() / planned) if near.any() else math.nan
        ),
        "saturated": loop.saturated_ticks,
        "phase": loop.phase.name,
        "called_crossed": verdicts.count(Verdict.CROSSED),
        "called_bounced": verdicts.count(Verdict.BOUNCED),
        "called_undecided": (
            count - verdicts.count(Verdict.CROSSED) - verdicts.count(Verdict.BOUNCED)
        ),
        "false_alarms": sum(
            v is Verdict.BOUNCED and was
            for v, was in zip(verdicts, truths, strict=True)
        ),
        "missed_bounces": sum(
            v is Verdict.CROSSED and not was
            for v, was in zip(verdicts, truths, strict=True)
        ),
        "held_wrong": (
            loop.phase is Phase.HOLD and bool(log.s[-1] * log.s_ref[-1] < 0.0)
        ),
        "wrong_side_time": float(wrong.sum() * (log.time[1] - log.time[0])),
        "stopped_after_crossing": crossed[0] and loop.phase in WITHOUT_LAW,
        "recognised": None,
        **_stated_confidences(log),
    }
    return (
        row | _bounce(loop, log, certificate.crossing_signs[0], truths[0], planned)
        if bounced
        else row
    )


def _stated_confidences(log: Log) -> Row:
    """For each bin of confidence: whether the run stated it clear of the locus, for
    which share of that time the side was right, and the mean of what it stated.
    """
    told = (np.abs(log.s) >= SIDE_TEST_ABS_S) & (log.mode != 0.0)
    bins = np.digitize(log.confidence, CONFIDENCE_BINS) - 1
    when = {f"{low:g}": told & (bins == k) for k, low in enumerate(CONFIDENCE_BINS)}

    def mean(values: Array, found: NDArray[np.bool_]) -> float:
        return float(values[found].mean()) if found.any() else 0.0

    right = (log.mode * log.s > 0.0).astype(np.float64)
    return {
        **{f"said_{low}": int(found.any()) for low, found in when.items()},
        **{f"right_{low}": mean(right, found) for low, found in when.items()},
        **{f"stated_{low}": mean(log.confidence, found) for low, found in when.items()},
    }


def _on_side(log: Log, time_of_verdict: float, sign: float) -> bool:
    """Tell whether the true robot was on the planned side when the verdict fell; true
    where none did.
    """
    if math.isnan(time_of_verdict):
        return True
    return bool(
        log.s[min(int(np.searchsorted(log.time, time_of_verdict)), len(log.s) - 1)]
        * sign
        > 0.0
    )


def _reason(loop: ControlLoop, crossed: list[bool], error: Array) -> str:
    if not all(crossed):
        first = crossed.index(False) + 1
        ended = (
            f"; {loop.phase.name}: {loop.reason}" if loop.phase in WITHOUT_LAW else ""
        )
        return f"crossing {first} of {len(crossed)} did not happen{ended}"
    if loop.phase is not Phase.HOLD:
        return f"{loop.phase.name}: {loop.reason}"
    if not error.max() < MAX_ERROR:
        return (
            f"true error {1e3 * error.max():.2f} mm; the limit is"
            f" {1e3 * MAX_ERROR:g} mm"
        )
    if not error[-1] < END_ERROR:
        return (
            f"true error at the end {1e3 * error[-1]:.2f} mm; the limit is"
            f" {1e3 * END_ERROR:g} mm"
        )
    return ""


def _turned(log: Log, sign: float) -> bool:
    """Tell whether the true robot went back from the locus after the blow, before it
    came well clear of it on the other side.

    One that was only slowed crosses late, and one that was left standing near the locus
    is on neither side.
    """
    s = sign * log.s[int(np.searchsorted(log.time, log.strike)) :]
    there = np.flatnonzero(s >= 2.0 * SIDE_TEST_ABS_S)
    before = s[: int(there[0])] if len(there) else s
    back = np.maximum.accumulate(before) - before
    return bool(((before <= -NEAR_ABS_S) & (back >= NEAR_ABS_S)).any())


def _bounce(
    loop: ControlLoop, log: Log, sign: float, on_side: bool, planned: float
) -> Row:
    """Judge a run that was struck; ``recognised`` is None when the blow did not turn
    the robot round.

    Args:
        sign: of s behind the planned crossing.
        on_side: whether it was on the planned side when the last verdict fell.
    """
    called = loop.passed[0].verdict
    missed = called is Verdict.CROSSED and not on_side
    if not _turned(log, sign):
        false = called is Verdict.BOUNCED and on_side
        return {
            "reason": "the blow did not turn the robot round",
            "success": not (missed or false),
        }
    # it may have coasted across since
    named = called is Verdict.BOUNCED or ("bounced" in loop.reason and not missed)
    stopped = np.flatnonzero(log.limp)
    struck = int(np.searchsorted(log.time, log.strike))
    after = np.abs(log.tau[struck:]).max(axis=1)
    row: Row = {
        "recognised": named,
        "success": named,
        "reason": (
            ""
            if named
            else f"the bounce was not recognised; {loop.phase.name}: {loop.reason}"
        ),
        "torque_after_bounce": float(after.max() / planned),
    }
    if named:
        moment = int(stopped[0])
        late = moment + round(RELEASE_TIME / (log.time[1] - log.time[0]))
        gone = (np.abs(log.tau[late:]).max(axis=1) < NO_TORQUE) | (
            log.power[late:] <= 0.0
        )
        row["release_delay"] = float(log.time[moment] - log.strike)
        # the torque's watch often lets go before the side is sure
        if called is Verdict.BOUNCED:
            row["recognition_delay"] = loop.passed[0].time - log.strike
        row["safe_after"] = bool(gone.all())
    return row
