"""What the loop is told: law, estimator, gains and limits. The values stand in
``config/crossing.yaml``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from difflib import get_close_matches

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.parameters import Parameter
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.plug_in import is_own, one_of
from dextar_control.contract.resources import NODES_FILE, config_file, node_defaults

LAWS = ("classic", "projected", "consistent", "multi_model", "joint_space")
"""Ours by their names, which ``control.law`` has."""
ESTIMATORS = ("plain", "dgm", "observer", "external")
"""Ours by their names, which ``estimation.estimator`` has."""


SETTINGS = (
    Parameter(
        "law",
        "The control law computes the torques from the tracking error; the laws differ"
        " near the Type 2 locus.",
        choices=LAWS,
        own=True,
    ),
    Parameter(
        "estimator",
        "The estimator finds the platform's state and assembly mode from the encoders;"
        " external also takes measured positions.",
        choices=ESTIMATORS,
        own=True,
    ),
    Parameter(
        "natural_frequency",
        "The feedback gives the tracking error this natural frequency; the proportional"
        " gain K_p is its square.",
        1.0,
        500.0,
        unit="rad/s",
        live=True,
    ),
    Parameter(
        "damping_ratio",
        "The feedback gives the tracking error this damping ratio; the derivative gain"
        " is K_d = 2 damping_ratio natural_frequency.",
        0.1,
        5.0,
        unit="1",
        live=True,
    ),
    Parameter(
        "integral_frequency",
        "The integral gain is K_i = integral_frequency natural_frequency^2; 0 switches"
        " the integral term off.",
        0.0,
        50.0,
        unit="1/s",
        live=True,
    ),
    Parameter(
        "zone",
        "Along the weak direction the laws consistent and joint_space fade from planned"
        " multipliers to feedback around this |s|.",
        0.0,
        0.9,
        unit="1",
        live=True,
    ),
    Parameter(
        "zone_width",
        "The fading of the laws consistent and joint_space spans this width in |s|, at"
        " most twice zone.",
        0.0,
        0.9,
        unit="1",
        live=True,
    ),
    Parameter(
        "band",
        "The laws projected and multi_model replace the regular inverse dynamics where"
        " |s| is below this.",
        0.0,
        0.9,
        unit="1",
        live=True,
    ),
    Parameter(
        "hold_zone",
        "The estimator dgm does not call the direct geometric model where the"
        " reference's |s| is below this; phase CROSSING reaches hold_width farther.",
        0.0,
        0.9,
        unit="1",
        live=True,
    ),
    Parameter(
        "hold_width",
        "The estimator dgm fades the direct geometric model in over this width of |s|"
        " outside hold_zone.",
        0.0,
        0.9,
        unit="1",
        live=True,
    ),
    Parameter(
        "filter_bandwidth",
        "The estimators dgm and plain, and the safe stop with any estimator, filter the"
        " joints with this bandwidth.",
        10.0,
        2000.0,
        unit="rad/s",
        live=True,
    ),
    Parameter(
        "return_time",
        "The estimator dgm fades the direct geometric model in over this time after the"
        " reference has left hold_zone.",
        0.0,
        1.0,
        unit="s",
        live=True,
    ),
    Parameter(
        "encoder_deviation",
        "The observer takes an encoder sample to have at least this standard"
        " deviation.",
        1e-7,
        0.1,
        unit="rad",
        live=True,
    ),
    Parameter(
        "scatter_gain",
        "The observer adds this many times the variance of the scatter that it sees in"
        " the encoder samples to theirs; 0 adds none.",
        0.0,
        1e6,
        unit="1",
        live=True,
    ),
    Parameter(
        "bias_deviation",
        "At its start the observer takes the joint angle bias that a wrong geometry"
        " causes to have this standard deviation.",
        1e-9,
        0.1,
        unit="rad",
        live=True,
    ),
    Parameter(
        "bias_walk",
        "The observer lets the joint angle bias drift as a random walk of this"
        " deviation as the joints move.",
        0.0,
        0.1,
        unit="rad/sqrt(rad)",
        live=True,
    ),
    Parameter(
        "torque_deviation",
        "The observer takes the torque of each sample to be off by this standard"
        " deviation (friction, motors).",
        1e-6,
        10.0,
        unit="N m",
        live=True,
    ),
    Parameter(
        "acceleration_deviation",
        "The observer takes the modelled platform acceleration of each sample to be off"
        " by this standard deviation (masses).",
        0.0,
        1e3,
        unit="m/s^2",
        live=True,
    ),
    Parameter(
        "disturbance_deviation",
        "At its start the observer takes the disturbance torque at a joint, which the"
        " model lacks, to have this standard deviation.",
        0.0,
        10.0,
        unit="N m",
        live=True,
    ),
    Parameter(
        "disturbance_walk",
        "The observer lets the disturbance torques drift as a random walk of this"
        " deviation; with disturbance_deviation 0 too it estimates none.",
        0.0,
        100.0,
        unit="N m/sqrt(s)",
        live=True,
    ),
    Parameter(
        "shock_gate",
        "The observer assumes an impact when the innovation of the joints exceeds this"
        " many standard deviations.",
        1.0,
        1e6,
        unit="deviations",
        live=True,
    ),
    Parameter(
        "shock_speed",
        "The observer takes an impact to change the platform's velocity by this"
        " standard deviation.",
        0.0,
        100.0,
        unit="m/s",
        live=True,
    ),
    Parameter(
        "passage_armed",
        "The observer takes the assembly mode as unknown once |s| falls below this,"
        " which must be less than passage_begin.",
        0.0,
        0.9,
        unit="1",
        live=True,
    ),
    Parameter(
        "passage_begin",
        "The observer begins its sequential test of crossed against bounced at this"
        " |s|.",
        0.0,
        0.9,
        unit="1",
        live=True,
    ),
    Parameter(
        "passage_log_odds",
        "The test of crossed against bounced decides when its log-odds reach this"
        " magnitude.",
        0.1,
        20.0,
        unit="1",
        live=True,
    ),
    Parameter(
        "passage_encoder_deviation",
        "The test of crossed against bounced takes an encoder sample to have at least"
        " this standard deviation.",
        1e-7,
        0.1,
        unit="rad",
        live=True,
    ),
    Parameter(
        "passage_bias_deviation",
        "The test of crossed against bounced takes the joint angle bias to have this"
        " standard deviation.",
        1e-9,
        0.1,
        unit="rad",
        live=True,
    ),
    Parameter(
        "passage_torque_deviation",
        "The test of crossed against bounced takes the torque of each sample to be off"
        " by this standard deviation.",
        1e-6,
        10.0,
        unit="N m",
        live=True,
    ),
    Parameter(
        "passage_acceleration_deviation",
        "The test of crossed against bounced takes the modelled platform acceleration"
        " to be off by this standard deviation.",
        0.0,
        1e3,
        unit="m/s^2",
        live=True,
    ),
    Parameter(
        "passage_disturbance",
        "The test of crossed against bounced allows for the disturbance torque"
        " estimated before it, up to this at each joint.",
        0.0,
        10.0,
        unit="N m",
        live=True,
    ),
    Parameter(
        "pose_deviation",
        "The estimator external takes each coordinate of a measured position to have"
        " this standard deviation.",
        1e-6,
        0.1,
        unit="m",
        live=True,
    ),
    Parameter(
        "pose_gate",
        "The estimator external refuses a position farther than this many standard"
        " deviations from its estimate and the mirror image.",
        1.0,
        1e3,
        unit="deviations",
        live=True,
    ),
    Parameter(
        "pose_timeout",
        "The estimator external warns when no measured position has come for this long,"
        " and uses the encoders alone.",
        1e-3,
        10.0,
        unit="s",
        live=True,
    ),
    Parameter(
        "friction_compensation",
        "The controller feeds this fraction of the modelled joint friction forward.",
        0.0,
        1.5,
        unit="1",
        live=True,
    ),
    Parameter(
        "disturbance_compensation",
        "The controller compensates this fraction of the disturbance torques that the"
        " observer estimates.",
        0.0,
        1.5,
        unit="1",
        live=True,
    ),
    Parameter(
        "max_tracking_error",
        "A safe stop begins when the estimated platform is farther than this from its"
        " reference.",
        1e-4,
        0.2,
        unit="m",
        live=True,
    ),
    Parameter(
        "max_start_distance",
        "A trajectory is refused when it starts farther than this from the point that"
        " the robot holds.",
        1e-5,
        0.05,
        unit="m",
        live=True,
    ),
    Parameter(
        "max_residual",
        "A trajectory is refused when the residual of the crossing criterion exceeds"
        " this at one of its crossings.",
        1e-12,
        10.0,
        unit="N",
        live=True,
    ),
    Parameter(
        "verdict_s",
        "The believed assembly mode is compared with the plan's where the reference's"
        " |s| is at least this.",
        0.0,
        0.9,
        unit="1",
        live=True,
    ),
    Parameter(
        "verdict_confidence",
        "The believed assembly mode counts as known from this probability on.",
        0.6,
        0.99999999,
        unit="1",
        live=True,
    ),
    Parameter(
        "side_time",
        "A safe stop begins when the assembly mode stays unknown this long away from"
        " the locus after an error above side_error.",
        0.0,
        1e3,
        unit="s",
        live=True,
    ),
    Parameter(
        "side_error",
        "An unknown assembly mode is tolerated while the tracking error since it was"
        " last known has not exceeded this.",
        0.0,
        0.2,
        unit="m",
        live=True,
    ),
    Parameter(
        "watch_ratio",
        "On a crossing trajectory each torque is limited to this multiple of the"
        " planned peak torque, or to watch_torque where that is larger.",
        1.0,
        1e6,
        unit="1",
        live=True,
    ),
    Parameter(
        "watch_torque",
        "On a crossing trajectory the torque limit is at least this, and grows by at"
        " most this for an estimated disturbance.",
        0.0,
        100.0,
        unit="N m",
        live=True,
    ),
    Parameter(
        "watch_time",
        "A safe stop begins when a torque stays at its limit this long while the mode"
        " is unknown or the error does not shrink.",
        0.0,
        10.0,
        unit="s",
        live=True,
    ),
    Parameter(
        "brake_gain",
        "The safe stop damps each joint with this gain where the assembly mode is"
        " unknown.",
        0.0,
        10.0,
        unit="N m s/rad",
        live=True,
    ),
    Parameter(
        "brake_time",
        "The safe stop takes its torque away this long after it began, even if the"
        " robot still moves.",
        0.0,
        10.0,
        unit="s",
        live=True,
    ),
    Parameter(
        "brake_constant",
        "The safe stop lets the velocity decay with this time constant where the"
        " assembly mode is known.",
        0.005,
        1.0,
        unit="s",
        live=True,
    ),
    Parameter(
        "coast_s",
        "The safe stop coasts without torque where |s| is below this.",
        0.02,
        0.9,
        unit="1",
        live=True,
    ),
    Parameter(
        "stop_s",
        "The safe stop brakes only where the robot would come to rest at an |s| of at"
        " least this.",
        0.02,
        0.9,
        unit="1",
        live=True,
    ),
    Parameter(
        "coast_time",
        "The safe stop gives no more torque after it has coasted for this long in all.",
        0.0,
        10.0,
        unit="s",
        live=True,
    ),
    Parameter(
        "rest_time",
        "The safe stop is over when the joints have rested for this long.",
        0.01,
        10.0,
        unit="s",
        live=True,
    ),
    Parameter(
        "speed_margin",
        "A speed may reach this multiple of the robot's max_joint_speed or"
        " max_platform_speed.",
        1.0,
        10.0,
        unit="1",
        live=True,
    ),
    Parameter(
        "speed_time",
        "A safe stop begins when a speed exceeds what speed_margin allows for this"
        " long.",
        0.0,
        10.0,
        unit="s",
        live=True,
    ),
    Parameter(
        "joint_margin",
        "A safe stop begins when a joint is farther than this outside its range.",
        0.0,
        1.0,
        unit="rad",
        live=True,
    ),
    Parameter(
        "max_joint_jump",
        "A safe stop begins when a joint is farther than this from where the last"
        " estimate expected it.",
        1e-4,
        3.2,
        unit="rad",
        live=True,
    ),
    Parameter(
        "max_joint_misfit",
        "A measured joint may differ by this from the joint angle of the estimated"
        " platform.",
        1e-4,
        3.2,
        unit="rad",
        live=True,
    ),
    Parameter(
        "misfit_time",
        "A safe stop begins when a joint exceeds max_joint_misfit for this long.",
        0.0,
        10.0,
        unit="s",
        live=True,
    ),
    Parameter(
        "locus_s",
        "A safe stop begins when the estimated |s| falls below this outside phase"
        " CROSSING.",
        0.0,
        0.9,
        unit="1",
        live=True,
    ),
    Parameter(
        "max_torque_rate",
        "A torque may change at this rate, relative to the robot's max_torque.",
        1.0,
        1e6,
        unit="1/s",
        live=True,
    ),
    Parameter(
        "torque_rate_time",
        "A safe stop begins when a torque exceeds max_torque_rate for this long.",
        0.0,
        10.0,
        unit="s",
        live=True,
    ),
)
"""The controller's parameters that the loop takes, which name the fields of
``Settings``.
"""


@dataclass(frozen=True)
class Settings:
    """Gains and limits of the loop, SI; each field is the parameter of its name in
    ``SETTINGS``, which says what it is.
    """

    law: str
    estimator: str
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
    def from_values(cls, values: Mapping[str, ParameterValue]) -> Settings:
        """Return the settings of parameter values; other keys are ignored.

        Raises:
            ParameterError: a value is missing, or law or estimator is unknown.
        """
        missing = [field.name for field in fields(cls) if field.name not in values]
        if missing:
            raise ParameterError(f"setting '{missing[0]}' is missing")
        taken = {field.name: values[field.name] for field in fields(cls)}
        for name, ours in (("law", LAWS), ("estimator", ESTIMATORS)):
            if taken[name] not in ours and not is_own(str(taken[name])):
                raise ParameterError(
                    f"{name} = {taken[name]!r}; it must be {one_of(ours)}"
                )
        return cls(**taken)


def default_settings(**changes: object) -> Settings:
    """The controller settings of ``config/crossing.yaml``, with changes.

    Raises:
        ParameterError: there is no setting of this name.
    """
    unknown = sorted({*changes} - {field.name for field in fields(Settings)})
    if unknown:
        near = get_close_matches(
            unknown[0], [field.name for field in fields(Settings)], 1
        )
        raise ParameterError(
            f"unknown setting '{unknown[0]}'{f'; {near[0]} is one' if near else ''}"
        )
    return Settings.from_values(
        node_defaults("controller", config_file(NODES_FILE)) | changes
    )
