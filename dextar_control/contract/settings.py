"""What the loop is told: law, estimator, gains and limits. The values stand in ``config/crossing.yaml``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from difflib import get_close_matches
from enum import IntEnum
from typing import Any, TypeVar

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.resources import NODES_FILE, config_file, node_defaults

Choice = TypeVar("Choice", bound=IntEnum)


class Law(IntEnum):
    """Which torques near the locus; see ``control.law``."""

    CLASSIC = 0
    PROJECTED = 1
    CONSISTENT = 2
    MULTI_MODEL = 3
    JOINT_SPACE = 4


class Estimation(IntEnum):
    """Which estimator; see ``estimation.estimator``."""

    PLAIN = 0
    DGM = 1
    OBSERVER = 2
    EXTERNAL = 3


@dataclass(frozen=True)
class Settings:
    """Gains and limits of the loop.

    Attributes:
        law: from an error to torques near the locus.
        estimator: of the platform state.
        natural_frequency: of the tracking error, rad/s; K_p is its square.
        damping_ratio: K_d = 2 damping_ratio natural_frequency.
        integral_frequency: K_i = integral_frequency natural_frequency^2, 1/s; 0 is off.
        zone, zone_width: |s| in the middle of the transition of ``consistent`` and ``joint_space``, and its width.
        band: |s| within which ``projected`` and ``multi_model`` take their other model.
        filter_bandwidth: of the joint filter of the direct estimators, and of the safe stop with any, rad/s.
        hold_zone, hold_width: |s| around the locus that counts as a crossing (phase CROSSING); the estimator ``dgm``
            does not call the direct model below hold_zone.
        return_time: over which ``dgm`` takes the direct model again after a crossing, s.
        encoder_deviation: of a joint sample, rad, as the observer is told; it may see it scatter more.
        scatter_gain: how many times what it sees counts, in variance; 0 is off.
        bias_deviation: of the joint angles that a wrong geometry explains, rad.
        bias_walk: of their random walk as the joints move, rad/sqrt(rad).
        torque_deviation: of a sample's torque (friction, motors), N m.
        acceleration_deviation: of a sample's platform acceleration (masses), m/s^2.
        disturbance_deviation: of the torque at a joint that the model lacks (friction, tilt, payload) at the start, N m.
        disturbance_walk: of its random walk, N m/sqrt(s); with both at 0 none is estimated.
        shock_gate: innovation of the joints, in standard deviations, from which on the observer allows for a blow ...
        shock_speed: ... that may have changed the platform's speed by this, m/s.
        passage_armed: |s| within which the observer takes the assembly mode for unknown.
        passage_begin: |s| at which its test of crossed against bounced begins.
        passage_log_odds: that decide it.
        passage_encoder_deviation, passage_bias_deviation, passage_torque_deviation, passage_acceleration_deviation: as the above,
            of the test's filters: a model that is worse than these makes the test unsure.
        passage_disturbance: torque at a joint that the model may lack (friction, tilt, payload), N m; the test's filters
            allow for what it lacked while the side was known, up to this.
        pose_deviation: of an external position, m.
        pose_gate: distance between an external position and the estimate, in standard deviations, beyond which
            it is refused.
        pose_timeout: without an external position, after which its absence is told, s.
        friction_compensation: fraction of the modelled joint friction that is fed forward.
        disturbance_compensation: fraction of the estimated disturbance torque that is taken off the law's.
        max_tracking_error: platform error that ends a motion in a safe stop, m.
        max_start_distance: between the robot and a trajectory's start, m.
        max_residual: of the criterion at a crossing of an accepted trajectory, N.
        verdict_s: |s| of the reference outside which a believed assembly mode is compared with the plan's.
        verdict_confidence: in the believed assembly mode from which on it counts.
        side_time, side_error: clear of the locus without knowing the side, after which a motion or a hold ends in a safe stop, s,
            where since the side was known the estimate has been farther from the reference than this, m.
        watch_ratio, watch_torque: while a crossing trajectory is tracked the torque is held below the larger of
            ratio x planned peak and watch_torque (N m).
        watch_time: at a torque limit that ends a motion in a safe stop, s: a robot that bounced asks for it.
        brake_gain: of the safe stop where the side is not known, N m s/rad.
        brake_time: after which the safe stop's torque is gone, s.
        brake_constant: of the safe stop where it is known: in which the velocity falls to its e-th part, s.
        coast_s: |s| within which the safe stop coasts.
        stop_s: |s| clear of which it comes to rest.
        coast_time: of coasting, after which it gives no torque any more, s.
        rest_time: for which the joints rest until it counts as over, s.
        speed_margin, speed_time: times the robot's speed limits beyond which a motion is stopped, and after how long, s.
        joint_margin: by which a joint may leave its range, rad.
        max_joint_jump: of a joint beside where the last sample's estimate expected it, rad.
        max_joint_misfit, misfit_time: of a joint beside that of the estimated platform, rad, and for how long, s.
        locus_s: |s| of the estimate nearer than which it may come in phase CROSSING only.
        max_torque_rate, torque_rate_time: of a torque, in the robot's max_torque per second, and for how long, s.
    """

    law: Law
    estimator: Estimation
    natural_frequency: float
    damping_ratio: float
    integral_frequency: float
    zone: float
    zone_width: float
    band: float
    filter_bandwidth: float
    hold_zone: float
    hold_width: float
    return_time: float
    encoder_deviation: float
    scatter_gain: float
    bias_deviation: float
    bias_walk: float
    torque_deviation: float
    acceleration_deviation: float
    disturbance_deviation: float
    disturbance_walk: float
    shock_gate: float
    shock_speed: float
    passage_armed: float
    passage_begin: float
    passage_log_odds: float
    passage_encoder_deviation: float
    passage_bias_deviation: float
    passage_torque_deviation: float
    passage_acceleration_deviation: float
    passage_disturbance: float
    pose_deviation: float
    pose_gate: float
    pose_timeout: float
    friction_compensation: float
    disturbance_compensation: float
    max_tracking_error: float
    max_start_distance: float
    max_residual: float
    verdict_s: float
    verdict_confidence: float
    side_time: float
    side_error: float
    watch_ratio: float
    watch_torque: float
    watch_time: float
    brake_gain: float
    brake_time: float
    brake_constant: float
    coast_s: float
    stop_s: float
    coast_time: float
    rest_time: float
    speed_margin: float
    speed_time: float
    joint_margin: float
    max_joint_jump: float
    max_joint_misfit: float
    misfit_time: float
    locus_s: float
    max_torque_rate: float
    torque_rate_time: float

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> Settings:
        """Settings from parameter values; law and estimator by name or as enums, other keys are ignored.

        Raises:
            ParameterError: a value is missing, or law or estimator is unknown.
        """
        missing = [field.name for field in fields(cls) if field.name not in values]
        if missing:
            raise ParameterError(f"setting '{missing[0]}' is missing")
        taken = {field.name: values[field.name] for field in fields(cls)}
        taken["law"] = choice(Law, "law", taken["law"])
        taken["estimator"] = choice(Estimation, "estimator", taken["estimator"])
        return cls(**taken)


def choice(kind: type[Choice], name: str, value: Any) -> Choice:
    """A member of an enum by its name in lower case, or as it is.

    Raises:
        ParameterError: there is none; names those there are.
    """
    if isinstance(value, kind):
        return value
    known = {member.name.lower(): member for member in kind}
    if str(value) not in known:
        raise ParameterError(f"{name} = {value!r}; it must be one of {', '.join(known)}")
    return known[str(value)]


def default_settings(**changes: object) -> Settings:
    """The controller settings of ``config/crossing.yaml``, with changes.

    Raises:
        ParameterError: there is no setting of this name.
    """
    unknown = sorted({*changes} - {field.name for field in fields(Settings)})
    if unknown:
        near = get_close_matches(unknown[0], [field.name for field in fields(Settings)], 1)
        raise ParameterError(f"unknown setting '{unknown[0]}'{f'; {near[0]} is one' if near else ''}")
    return Settings.from_values(node_defaults("controller", config_file(NODES_FILE)) | changes)
