"""Statistics against numbers counted by hand, bars against both sides of their limits,
and files that can be read.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from browser import looks_right
from rich.console import Console

from dextar_control.experiments.campaign import reliability, report
from dextar_control.experiments.campaign.config import CampaignConfig, load_config
from dextar_control.experiments.campaign.figure import draw_frontier, draw_summary
from dextar_control.experiments.campaign.outcome import judge
from dextar_control.experiments.campaign.selection import select
from dextar_control.experiments.campaign.store import Store
from dextar_control.experiments.campaign.summary import (
    Group,
    as_json,
    real_time_factor,
    summarise,
)
from dextar_control.experiments.campaign.trial import CONFIDENCE_BINS

ROOT = Path(__file__).resolve().parents[2]
NAMES = {
    "case": "nominal",
    "plant": "pybullet",
    "law": "consistent",
    "estimator": "observer",
}
PLACE = {
    "index": 0,
    "point_x": 0.01,
    "point_y": 0.1,
    "working_mode": "+-",
    "family": "stretched",
    "direction": 1,
}
GOOD = (
    NAMES
    | PLACE
    | {
        "planned": True,
        "crossings_planned": 4,
        "crossed": 4,
        "success": True,
        "reason": "",
        "max_error": 1e-4,
        "end_error": 1e-5,
        "peak_ratio": 1.0,
        "peak_ratio_near": 0.5,
        "saturated": 0,
        "false_alarms": 0,
        "recognised": None,
        "simulated_time": 2.0,
        "wall_time": 0.1,
    }
)
ROWS: list[dict[str, Any]] = [
    GOOD,
    GOOD | {"max_error": 2e-4, "peak_ratio_near": 0.7},
    GOOD
    | {
        "max_error": 2e-2,
        "crossed": 3,
        "success": False,
        "reason": "did not cross",
        "saturated": 12,
        "false_alarms": 1,
    },
    NAMES
    | PLACE
    | {
        "planned": False,
        "plan_problem": "too fast",
        "success": False,
        "reason": "not planned",
    },
    NAMES | PLACE | {"success": False, "reason": "worker died"},
]


@pytest.fixture
def config() -> CampaignConfig:
    return select(
        load_config(ROOT / "config" / "campaign_small.yaml"),
        cases=["nominal", "bounced"],
    )


@pytest.fixture
def group(config: CampaignConfig) -> Group:
    (found,) = summarise(config, ROWS)
    return found


def test_a_group_counts_every_row_and_measures_those_that_have_numbers(
    group: Group,
) -> None:
    assert group.rows == 5
    assert (group.planned, group.crossed, group.success) == (3 / 5, 2 / 5, 2 / 5)
    assert (group.median_error, group.max_error) == (2e-4, 2e-2)
    assert (
        group.peak_ratio_near,
        group.saturated,
        group.saturated_rows,
        group.false_alarms,
    ) == (0.7, 12.0, 1, 1.0)
    assert group.bounces == 0
    assert math.isnan(group.recognised)
    assert real_time_factor(ROWS) == pytest.approx(20.0)


def test_a_bar_holds_up_to_its_limit_and_no_further(config: CampaignConfig) -> None:
    def missed(rows: list[dict[str, Any]]) -> list[str]:
        return [
            verdict.bar for group in summarise(config, rows) for verdict in group.missed
        ]

    limit = config.cases["nominal"].bars["max_error"]
    assert missed([GOOD]) == []
    assert missed([GOOD, GOOD, GOOD | {"max_error": limit}]) == []
    assert missed([GOOD, GOOD, GOOD | {"max_error": math.nextafter(limit, 1.0)}]) == [
        "max_error"
    ]
    assert set(missed(ROWS)) == {
        "min_success",
        "median_error",
        "max_error",
        "max_saturated",
        "max_false_alarms",
    }


def test_what_nothing_measures_does_not_hold(config: CampaignConfig) -> None:
    (group,) = summarise(config, [GOOD | {"case": "bounced"}])
    assert [verdict.bar for verdict in group.missed] == ["min_recognised"]
    assert "min_recognised is not measured" in report.missed_lines([group])[0]


def test_bars_are_for_the_default_combination_alone(config: CampaignConfig) -> None:
    groups = summarise(
        config,
        [
            GOOD,
            ROWS[2] | {"law": "classic", "estimator": "plain"},
            ROWS[2] | {"plant": "cartesian"},
        ],
    )
    assert [group.judged for group in groups] == [True, False, False]
    assert not any(group.missed for group in groups)


def test_a_case_may_name_the_combinations_that_its_bars_are_for(
    config: CampaignConfig,
) -> None:
    data = config.model_dump()
    data["cases"]["nominal"]["judged"] = ["classic/plain"]
    rows = [GOOD, ROWS[2] | {"law": "classic", "estimator": "plain"}]
    groups = summarise(CampaignConfig.model_validate(data), rows)
    assert [(group.name, group.judged) for group in groups] == [
        ("consistent/observer", False),
        ("classic/plain", True),
    ]


def test_a_summary_is_strict_json(group: Group) -> None:
    assert json.loads(json.dumps(as_json(group), allow_nan=False))["recognised"] is None


def test_the_reason_of_a_failure_is_listed() -> None:
    listed = report.failures(ROWS_WITH_KEYS)
    assert [cells[-1] for cells in listed] == [
        "did not cross",
        "too fast",
        "worker died",
    ]
    text = report.markdown_failures(listed, [], "the default")
    assert text.count("\n| ") == 1 + 3
    assert "10.0, 100.0" in text


def test_a_share_is_100_percent_only_if_it_is_all() -> None:
    assert [
        report.percent(share) for share in (1.0, 0.99999, 0.975, 0.0, math.nan)
    ] == ["100", "99.9", "97.5", "0", "-"]


def said(count: int, right: float, stated: float) -> list[dict[str, Any]]:
    """Rows that stated a confidence from 0.99 on, and were right for a share of the
    time.
    """
    bins = {
        f"{kind}_{odds:g}": 0.0
        for kind in ("said", "right", "stated")
        for odds in CONFIDENCE_BINS
    }
    told = {
        "said_0.99": 1,
        "right_0.99": right,
        "stated_0.99": stated,
        "called_crossed": 2,
        "called_bounced": 0,
    }
    return [GOOD | bins | told for _ in range(count)]


def test_wilsons_interval_is_that_of_the_books() -> None:
    assert reliability.wilson(0.5, 10) == pytest.approx((0.2366, 0.7634), abs=1e-4)
    assert reliability.wilson(1.0, 100) == pytest.approx((0.9630, 1.0), abs=1e-4)


def test_who_is_surer_than_right_is_told_so() -> None:
    good = reliability.reliability(said(200, 1.0, 0.995))["observer"]
    assert set(good) == {"0.99", "verdicts"} and good["verdicts"].runs == 400
    assert (good["0.99"].right, good["0.99"].runs, good["0.99"].stated) == (
        1.0,
        200,
        pytest.approx(0.995),
    )
    assert "nowhere surer" in reliability.in_words("observer", good)
    assert "nowhere surer" in reliability.in_words(
        "observer", reliability.reliability(said(20, 0.97, 0.995))["observer"]
    )
    bad = reliability.reliability(said(200, 0.95, 0.995))["observer"]
    assert bad["0.99"].most < 0.995
    assert (
        "worst from 0.99, where it states 99.50 % on average and 95.00 % is right"
        in reliability.in_words("observer", bad)
    )
    assert "| 95 (91" in report.reliability_table({"observer": bad})
    assert (
        reliability.draw_reliability({"observer": bad}).axes[0].get_xlabel()
        == "confidence stated"
    )


def test_a_sweep_is_a_case_for_each_level_and_a_small_figure() -> None:
    config = load_config(ROOT / "config" / "frontier.yaml")
    assert config.cases["passive_slow 0.001"].perturbation == {"passive": 1e-3}
    assert (
        config.cases["passive_slow 0.001"].duration == 2.0
        and config.cases["tilt 0.0873"].title == "tilt 5 degrees"
    )
    some = select(config, cases=["belt 150", "belt 50"])
    assert list(some.cases) == ["belt 150", "belt 50"] and some.sweeps[
        "belt"
    ].levels == [150, 50]
    rows = [
        GOOD | {"case": "belt 150", "plant": "cartesian"},
        ROWS[2] | {"case": "belt 50", "plant": "cartesian"},
    ]
    (axes,) = [
        axes
        for axes in draw_frontier(some, summarise(some, rows)).axes
        if axes.get_visible()
    ]
    assert [line.get_ydata().tolist() for line in axes.lines[:2]] == [
        [100.0, 0.0],
        [100.0, 0.0],
    ]


ROWS_WITH_KEYS = [row | {"key": f"{number:016x}"} for number, row in enumerate(ROWS)]


def test_the_outcome_is_in_its_folder(tmp_path: Path, config: CampaignConfig) -> None:
    others = [
        row | {"key": f"{row['key']}b", "law": "classic", "estimator": "plain"}
        for row in ROWS_WITH_KEYS
    ]
    with Store(tmp_path, {}) as store:
        store.append([*ROWS_WITH_KEYS, *others])
        console = Console(
            width=80, record=True, quiet=False, file=(tmp_path / "terminal").open("w")
        )
        assert judge(config, list(store.rows), store, console, 1.0) == 1
    table = pq.read_table(tmp_path / "rows.parquet")
    assert table.column("max_error").to_pylist()[:5] == [1e-4, 2e-4, 2e-2, None, None]
    assert str(table.schema.field("success").type) == "bool"
    assert str(table.schema.field("saturated").type) == "int64"
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert (summary["bars"], summary["bars_held"]) == (6, 1)
    assert "| consistent / observer |" in (tmp_path / "summary.md").read_text(
        encoding="utf-8"
    ).replace("**", "")
    assert "too fast" in (tmp_path / "failures.md").read_text(encoding="utf-8")
    for name in ("figure.png", "figure.svg"):
        assert (tmp_path / name).stat().st_size > 10_000
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert (
        "1 of 6 bars hold." in page
        and "max_error is 20.0 mm" in page
        and page.count("<svg") == 1
        and "http://"
        not in (
            page.replace("http://www.w3.org", "")
            .replace("http://purl.org", "")
            .replace("http://creativecommons.org", "")
        )
    )
    looks_right(tmp_path / "report.html")
    said = console.export_text()
    assert "1 of 6 bars hold" in said
    assert (
        "nominal, consistent / observer: max_error is 20.0 mm, the bar is 0.300 mm"
        in said
    )
    assert "…" not in said


def test_each_case_has_a_line_in_the_figure_and_each_combination_a_marker(
    config: CampaignConfig,
) -> None:
    rows = [
        GOOD,
        GOOD | {"law": "classic", "estimator": "plain"},
        GOOD | {"case": "bounced", "recognised": True},
    ]
    figure = draw_summary(config, summarise(config, rows), "pybullet")
    success, error, torque = figure.axes
    assert [label.get_text() for label in success.get_yticklabels()] == [
        "nominal",
        "bounced at the locus",
    ]
    assert not any(label.get_parse_math() for label in success.get_yticklabels())
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()][:2] == [
        "consistent / observer",
        "classic / plain",
    ]
    assert all(
        "(" in axes.get_xlabel() or "×" in axes.get_xlabel()
        for axes in (success, error, torque)
    )
