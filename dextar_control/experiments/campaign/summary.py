"""Statistics of the rows of each case and combination, and the bars that they hold or
miss.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dextar_control.contract.plain_data import as_plain
from dextar_control.experiments.campaign.config import CampaignConfig
from dextar_control.experiments.campaign.ranges import BARS
from dextar_control.experiments.campaign.rows import Row, number, text
from dextar_control.symbols.types import Array


class BarVerdict(NamedTuple):
    """One bar of a case beside what was reached."""

    bar: str
    limit: float
    measured: float  # nan: no trial of the case measures it
    holds: bool


@dataclass(frozen=True)
class Group:
    """Holds the statistics of the rows of one case, law, estimator and plant.

    Shares are of all rows; a trial without a plan, a raised exception and a dead worker
    count as not crossed. Errors and torques are of the rows that have them; nan if none
    has.
    """

    case: str
    law: str
    estimator: str
    plant: str
    rows: int
    planned: float
    crossed: float
    success: float
    median_error: float  # m, over the rows, of the largest true error
    max_error: float  # m
    max_end_error: float  # m
    peak_ratio: float  # largest torque over the planned peak
    peak_ratio_near: float  # the same within |s| < 0.1
    saturated: float  # ticks, in the worst row
    saturated_rows: int
    bounces: int  # rows that were made to bounce
    recognised: float  # share of them that was called a bounce
    false_alarms: float  # crossings called bounces, in all rows
    wrong_crossed: float  # bounces called crossings, in all rows
    held_wrong: float  # rows at whose end the robot is held on the wrong side
    wrong_side_time: float  # s, the longest under a law on the wrong side
    stopped_after_crossing: float  # rows
    recognition_delay: float  # s, the longest
    torque_after_bounce: float  # largest from a bounce on, over the planned peak
    safe_after: (
        float  # share of the recognised bounces whose torque brakes or is gone in time
    )
    judged: bool = False
    verdicts: tuple[BarVerdict, ...] = ()

    @property
    def name(self) -> str:
        """Law and estimator in one word."""
        return f"{self.law}/{self.estimator}"

    @property
    def missed(self) -> list[BarVerdict]:
        """The bars that do not hold."""
        return [verdict for verdict in self.verdicts if not verdict.holds]


def summarise(config: CampaignConfig, rows: Iterable[Row]) -> list[Group]:
    """Summarise one group for each case, plant and combination, in the order of the
    campaign file.
    """
    sorted_rows: dict[tuple[str, str, str, str], list[Row]] = {}
    for row in rows:
        sorted_rows.setdefault(
            (
                text(row, "case"),
                text(row, "plant"),
                text(row, "law"),
                text(row, "estimator"),
            ),
            [],
        ).append(row)
    groups = []
    default = f"{config.default.law}/{config.default.estimator}"
    for name, case in config.cases.items():
        for plant in config.plants:
            for combination in config.combinations:
                found = sorted_rows.get(
                    (name, plant, combination.law, combination.estimator)
                )
                if not found:
                    continue
                group = _group(found)
                if plant in (
                    config.judged_plants or [config.default.plant]
                ) and combination.name in (case.judged or [default]):
                    verdicts = tuple(
                        _verdict(group, bar, limit) for bar, limit in case.bars.items()
                    )
                    group = dataclasses.replace(group, judged=True, verdicts=verdicts)
                groups.append(group)
    return groups


def crossed_all(row: Row) -> bool:
    """Tell whether the true robot crossed at each planned crossing."""
    planned = number(row, "crossings_planned")
    return planned > 0 and number(row, "crossed") >= planned


def real_time_factor(rows: Iterable[Row]) -> float:
    """Return simulated over wall time of a worker, which has one core: the median over
    the rows, nan without any.
    """
    times = [(number(row, "simulated_time"), number(row, "wall_time")) for row in rows]
    factors = [
        simulated / wall for simulated, wall in times if simulated > 0.0 and wall > 0.0
    ]
    return float(np.median(factors)) if factors else math.nan


def as_json(group: Group) -> dict[str, object]:
    """Return a group as plain data, with None for numbers that are not finite."""
    verdicts = [verdict._asdict() for verdict in group.verdicts]
    data: dict[str, object] = as_plain(
        {**dataclasses.asdict(group), "verdicts": verdicts}
    )
    return data


def _group(rows: list[Row]) -> Group:
    count = len(rows)
    saturated = _numbers(rows, "saturated")
    errors = _numbers(rows, "max_error")
    return Group(
        case=text(rows[0], "case"),
        law=text(rows[0], "law"),
        estimator=text(rows[0], "estimator"),
        plant=text(rows[0], "plant"),
        rows=count,
        planned=sum(bool(row.get("planned")) for row in rows) / count,
        crossed=sum(map(crossed_all, rows)) / count,
        success=sum(bool(row.get("success")) for row in rows) / count,
        median_error=float(np.median(errors)) if errors.size else math.nan,
        max_error=_largest(errors),
        max_end_error=_largest(_numbers(rows, "end_error")),
        peak_ratio=_largest(_numbers(rows, "peak_ratio")),
        peak_ratio_near=_largest(_numbers(rows, "peak_ratio_near")),
        saturated=_largest(saturated),
        saturated_rows=int(np.count_nonzero(saturated)),
        bounces=_numbers(rows, "recognised").size,
        recognised=_share(rows, "recognised"),
        false_alarms=_total(rows, "false_alarms"),
        wrong_crossed=_total(rows, "missed_bounces"),
        held_wrong=_total(rows, "held_wrong"),
        wrong_side_time=_largest(_numbers(rows, "wrong_side_time")),
        stopped_after_crossing=_total(rows, "stopped_after_crossing"),
        recognition_delay=_largest(_numbers(rows, "recognition_delay")),
        torque_after_bounce=_largest(_numbers(rows, "torque_after_bounce")),
        safe_after=_share(rows, "safe_after"),
    )


def _verdict(group: Group, bar: str, limit: float) -> BarVerdict:
    measured = float(getattr(group, BARS[bar].measure))
    holds = measured >= limit if bar.startswith("min_") else measured <= limit
    return BarVerdict(bar, limit, measured, holds)


def _numbers(rows: list[Row], name: str) -> Array:
    found = (row.get(name) for row in rows)
    return np.array([float(value) for value in found if value is not None])


def _share(rows: list[Row], name: str) -> float:
    values = _numbers(rows, name)
    return float(values.mean()) if values.size else math.nan


def _total(rows: list[Row], name: str) -> float:
    values = _numbers(rows, name)
    return float(values.sum()) if values.size else math.nan


def _largest(values: Array) -> float:
    return float(values.max()) if values.size else math.nan
