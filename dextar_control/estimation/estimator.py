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

from dextar_control.contract.settings import Estimation, Settings
from dextar_control.estimation.direct import DirectEstimator
from dextar_control.estimation.estimate import Estimator
from dextar_control.estimation.external import ExternalEstimator
from dextar_control.estimation.observing import ObserverEstimator
from dextar_control.model.model import Model
from dextar_control.symbols.record import Record


def make_estimator(
    model: Model, settings: Settings, min_type1: float, estimate: Record | None = None
) -> Estimator:
    """The estimator that the settings name.

    Args:
        model: of the robot, as the controller knows it.
        settings: of the controller.
        min_type1: the robot's least distance to Type 1.
        estimate: the record of ``estimation.records.ESTIMATE`` that it keeps; one of
            its own when None.

    Raises:
        ParameterError: a setting is out of its range, or the mechanism has no direct
            model for this estimator.
    """
    if settings.estimator in (Estimation.PLAIN, Estimation.DGM):
        return DirectEstimator(
            model, settings, estimate, held=settings.estimator is Estimation.DGM
        )
    if settings.estimator is Estimation.EXTERNAL:
        return ExternalEstimator(model, settings, min_type1, estimate)
    return ObserverEstimator(model, settings, min_type1, estimate)
