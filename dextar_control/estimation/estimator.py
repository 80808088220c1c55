"""Estimators by their names.

- ``plain``: the direct model everywhere.
- ``dgm``: the paper's, the direct model with its precautions around the locus
  (``estimation.direct``). It takes the reference's assembly mode for the robot's: after
  a crossing it is not sure at all.
- ``observer``: a filter over the Cartesian dynamics (``estimation.observer``); tells
  crossed from bounced.
- ``external``: the observer fused with an external position measurement
  (``estimation.external``).
"""

from __future__ import annotations

from collections.abc import Callable

from dextar_control.contract.errors import DextarError, ParameterError
from dextar_control.contract.plug_in import chosen
from dextar_control.contract.settings import Settings
from dextar_control.estimation.direct import DirectEstimator, PlainEstimator
from dextar_control.estimation.estimate import Estimator
from dextar_control.estimation.external import ExternalEstimator
from dextar_control.estimation.observing import ObserverEstimator
from dextar_control.model.model import Model
from dextar_control.symbols.record import Record

ESTIMATORS: dict[str, Callable[[Model, Settings, float, Record | None], Estimator]] = {
    "plain": PlainEstimator,
    "dgm": DirectEstimator,
    "observer": ObserverEstimator,
    "external": ExternalEstimator,
}
"""The estimators of this package by their names."""


def make_estimator(
    model: Model, settings: Settings, min_type1: float, estimate: Record | None = None
) -> Estimator:
    """Make the estimator that the settings name: of ``ESTIMATORS``, or ``module:class``
    of one's own.

    Args:
        model: of the robot, as the controller knows it.
        settings: of the controller.
        min_type1: the robot's least distance to Type 1.
        estimate: the record of ``estimation.records.ESTIMATE`` that it keeps; one of
            its own when None.

    Raises:
        ParameterError: there is no such estimator, it cannot be made, a setting is out
            of its range, or the mechanism has no direct model for this estimator.
    """
    name = settings.estimator
    make = chosen("estimator", name, ESTIMATORS)
    try:
        made = make(model, settings, min_type1, estimate)
    except DextarError:
        raise
    except Exception as error:
        if name in ESTIMATORS:
            raise
        raise ParameterError(
            f"estimator {name!r} cannot be made: {type(error).__name__}: {error}"
        ) from error
    if not isinstance(made, Estimator):
        raise ParameterError(
            f"estimator {name!r} makes a {type(made).__name__}; it must be a class"
            " derived from estimation.estimate.Estimator"
        )
    return made
