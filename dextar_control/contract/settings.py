"""What the loop is told: law, estimator, gains and limits. The values stand in
``config/crossing.yaml``.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import get_type_hints

from dextar_control.contract.controller_parameters import CONTROLLER
from dextar_control.contract.controller_parameters import ESTIMATORS as ESTIMATORS
from dextar_control.contract.controller_parameters import LAWS as LAWS
from dextar_control.contract.errors import ParameterError
from dextar_control.contract.former_names import present_names, renamed_in_words
from dextar_control.contract.parameters import nearest_in_words
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.plug_in import is_own, one_of
from dextar_control.contract.resources import NODES_FILE, config_file, node_defaults


@dataclass(frozen=True)
class TrajectorySettings:
    """Which trajectories are taken."""

    max_start_distance: float
    max_residual: float


@dataclass(frozen=True)
class FeedbackSettings:
    """The gains of the tracking error."""

    natural_frequency: float
    damping_ratio: float
    integral_frequency: float


@dataclass(frozen=True)
class CompensationSettings:
    """What is fed forward of what the model or the observer knows."""

    friction: float
    disturbance: float


@dataclass(frozen=True)
class NearLocusSettings:
    """How the laws change near the Type 2 locus."""

    fade_abs_s: float
    fade_width_abs_s: float
    replace_below_abs_s: float


@dataclass(frozen=True)
class DgmSettings:
    """The estimator dgm, which calls the direct geometric model."""

    hold_below_abs_s: float
    fade_width_abs_s: float
    fade_time: float


@dataclass(frozen=True)
class JointFilterSettings:
    """The filter of the joints without an observer."""

    bandwidth: float


@dataclass(frozen=True)
class ObserverSettings:
    """The noise that the observer takes samples and model to have."""

    encoder_deviation: float
    scatter_gain: float
    bias_deviation: float
    bias_walk: float
    torque_deviation: float
    acceleration_deviation: float
    disturbance_deviation: float
    disturbance_walk: float
    impact_gate: float
    impact_speed: float


@dataclass(frozen=True)
class CrossingTestSettings:
    """The sequential test of crossed against bounced."""

    unknown_below_abs_s: float
    begin_below_abs_s: float
    log_odds: float
    encoder_deviation: float
    bias_deviation: float
    torque_deviation: float
    acceleration_deviation: float
    max_disturbance: float


@dataclass(frozen=True)
class ExternalSettings:
    """The estimator external, which takes measured positions."""

    position_deviation: float
    position_gate: float
    timeout: float


@dataclass(frozen=True)
class ModeCheckSettings:
    """When the believed assembly mode counts, and how long it may be unknown."""

    above_abs_s: float
    confidence: float
    unknown_time: float
    unknown_error: float


@dataclass(frozen=True)
class TorqueLimitSettings:
    """The limit of the torques on a crossing trajectory."""

    peak_ratio: float
    min_torque: float
    time: float


@dataclass(frozen=True)
class WatchSettings:
    """What begins a safe stop."""

    max_tracking_error: float
    speed_margin: float
    speed_time: float
    joint_margin: float
    max_joint_jump: float
    max_joint_misfit: float
    joint_misfit_time: float
    min_abs_s: float
    max_torque_rate: float
    torque_rate_time: float


@dataclass(frozen=True)
class SafeStopSettings:
    """How the robot is brought to rest."""

    brake_gain: float
    brake_time: float
    brake_time_constant: float
    coast_below_abs_s: float
    rest_above_abs_s: float
    coast_time: float
    rest_time: float


@dataclass(frozen=True)
class Settings:
    """Gains and limits of the loop, SI.

    A field of a group is the controller's parameter ``GROUP.FIELD``, which says what it
    is.
    """

    law: str
    estimator: str
    trajectory: TrajectorySettings
    feedback: FeedbackSettings
    compensation: CompensationSettings
    near_locus: NearLocusSettings
    dgm: DgmSettings
    joint_filter: JointFilterSettings
    observer: ObserverSettings
    crossing_test: CrossingTestSettings
    external: ExternalSettings
    mode_check: ModeCheckSettings
    torque_limit: TorqueLimitSettings
    watch: WatchSettings
    safe_stop: SafeStopSettings

    @classmethod
    def from_values(cls, values: Mapping[str, ParameterValue]) -> Settings:
        """Return the settings of parameter values by dotted name; other keys are
        ignored.

        Raises:
            ParameterError: a value is missing, or law or estimator is unknown.
        """
        missing = [name for name in SETTING_NAMES if name not in values]
        if missing:
            raise ParameterError(f"setting '{missing[0]}' is missing")
        taken: dict[str, ParameterValue] = {}
        for group, kind in GROUPS.items():
            names = [field.name for field in fields(kind)]
            taken[group] = kind(*(values[f"{group}.{name}"] for name in names))
        for name, ours in (("law", LAWS), ("estimator", ESTIMATORS)):
            taken[name] = value = values[name]
            if value not in ours and not is_own(str(value)):
                raise ParameterError(f"{name} = {value!r}; it must be {one_of(ours)}")
        return cls(**taken)


GROUPS = {
    name: kind
    for name, kind in get_type_hints(Settings).items()
    if isinstance(kind, type) and is_dataclass(kind)
}
"""The classes of the groups."""
SETTING_NAMES = (
    "law",
    "estimator",
    *(
        f"{group}.{field.name}"
        for group, kind in GROUPS.items()
        for field in fields(kind)
    ),
)
"""The controller's parameters that the loop takes."""
SETTINGS = tuple(spec for spec in CONTROLLER if spec.name in SETTING_NAMES)
"""What is told of them."""


def default_settings(**changes: object) -> Settings:
    """Return the controller settings of ``config/crossing.yaml``, with changes.

    A setting of a group is changed by its dotted name:
    ``default_settings(law="classic", **{"watch.max_tracking_error": 0.05})``.

    Raises:
        ParameterError: there is no setting of this name.
    """
    present, renamed = present_names(CONTROLLER, changes)
    if renamed:
        warnings.warn(renamed_in_words(renamed), DeprecationWarning, stacklevel=2)
    for name in present:
        if name not in SETTING_NAMES:
            near = nearest_in_words(name, SETTINGS)
            raise ParameterError(f"unknown setting '{name}'{near}")
    return Settings.from_values(
        node_defaults("controller", config_file(NODES_FILE)) | present
    )
