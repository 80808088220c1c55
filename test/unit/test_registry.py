"""Each number of a run is named, given a unit and defined in one place."""

from __future__ import annotations

import math

import pytest

from dextar_control.analysis.crossings import CROSSING_METRICS, CrossingMetrics
from dextar_control.analysis.metrics import METRICS, Metrics
from dextar_control.analysis.registry import SCALES, Metric
from dextar_control.analysis.timing import Timing

# results that are more than a number, which their own classes describe
STRUCTURES = {"crossings", "timing", "margins", "phases", "holes", "unreadable"}
UNITS = {"", "1", "m", "m/s", "s", "ns", "Hz", "N", "N m"}
EVERY = [*METRICS.values(), *CROSSING_METRICS.values()]


def test_each_number_of_metrics_json_is_in_the_registry() -> None:
    own = set(Metrics.__dataclass_fields__) - STRUCTURES
    timing = {f"timing.{name}" for name in Timing.__dataclass_fields__}
    assert set(METRICS) == own | timing
    assert set(CROSSING_METRICS) == set(CrossingMetrics.__dataclass_fields__)


@pytest.mark.parametrize("metric", EVERY, ids=lambda metric: metric.name)
def test_a_definition_is_a_sentence_and_a_format_suits_its_unit(metric: Metric) -> None:
    assert metric.definition.endswith(".") and metric.definition[0] not in " ."
    assert metric.unit in UNITS
    assert not metric.shown or metric.shown in SCALES
    assert metric.form == "" or format(1, metric.form)


def test_no_two_numbers_of_one_kind_have_one_name() -> None:
    for metrics in (METRICS, CROSSING_METRICS):
        names = [metric.name for metric in metrics.values()]
        assert len(names) == len(set(names))


def test_a_number_is_shown_in_its_unit_and_one_not_known_by_its_stand_in() -> None:
    error, ratio = METRICS["max_true_error"], METRICS["torque_ratio"]
    assert error.text(2.5e-5) == "0.025 mm" and ratio.text(1.5) == "1.500"
    assert error.number(math.nan) == "-" and error.text(None, "unknown") == "unknown"
    assert METRICS["missed"].text(0) == "0"
