"""Write what a campaign leaves behind: columnar file, summary, failures, figures, and
the verdict on its bars.
"""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Sequence

from matplotlib.figure import Figure

from dextar_control.analysis.drawing import svg
from dextar_control.analysis.page import Cell, Column, render
from dextar_control.contract.errors import CampaignError
from dextar_control.contract.terminal import Terminal
from dextar_control.contract.words import counted
from dextar_control.experiments.campaign import design, reliability, report, summary
from dextar_control.experiments.campaign.config import CampaignConfig
from dextar_control.experiments.campaign.figure import draw_frontier, draw_summary
from dextar_control.experiments.campaign.pool import core_count
from dextar_control.experiments.campaign.rows import Row
from dextar_control.experiments.campaign.store import Store

EXIT_FAILED = 1
Reliability = dict[str, dict[str, reliability.Bin]]
PAGE_FILE = "report.html"
SHOWN_FAILURES, LISTED_FAILURES = 8, 200  # on the terminal, on the page
RESOLUTION = 150  # dots per inch


def judge(
    config: CampaignConfig,
    keys: Sequence[str],
    store: Store,
    console: Terminal,
    elapsed: float,
) -> int:
    """Write the results of the rows with these keys, print their table and the bars
    that are missed.

    Args:
        config: of the campaign.
        keys: of its rows, in their order.
        store: which holds them.
        console: for the table.
        elapsed: wall time of the rows that were run now, s.

    Returns:
        The exit code: 0 if all bars hold, 1 if one is missed.

    Raises:
        CampaignError: the results cannot be written.
    """
    rows = [store.rows[key] for key in keys if key in store.rows]
    groups = summary.summarise(config, rows)
    default = config.default
    default_name = f"{default.law} / {default.estimator} on {default.plant}"
    wanted = (default.law, default.estimator, default.plant)
    failed, others = (
        report.failures(
            row
            for row in rows
            if ((row["law"], row["estimator"], row["plant"]) == wanted) is judged
        )
        for judged in (True, False)
    )
    missed = report.missed_lines(groups)
    bars = sum(len(group.verdicts) for group in groups)
    speeds = {
        plant: summary.real_time_factor(row for row in rows if row["plant"] == plant)
        for plant in config.plants
    }
    verdict = _verdict(bars, missed, default_name)
    sure = reliability.reliability(rows)
    speed = ", ".join(
        f"{factor:.1f} x real time on {plant}"
        for plant, factor in speeds.items()
        if math.isfinite(factor)
    )
    try:
        store.write_table(keys)
        store.write_text(
            "summary.json",
            _json(config, groups, speeds, elapsed, bars - len(missed), bars),
        )
        store.write_text(
            "summary.md", _markdown(config, rows, groups, sure, verdict, missed, speed)
        )
        store.write_text(
            "failures.md", report.markdown_failures(failed, others, default_name)
        )
        figures = {}
        for plant in dict.fromkeys(group.plant for group in groups):
            name = (
                "figure"
                if plant == default.plant or len(config.plants) == 1
                else f"figure-{plant}"
            )
            figures[name] = draw_summary(config, groups, plant)
        others_drawn = (
            {"reliability": reliability.draw_reliability(sure)} if sure else {}
        )
        others_drawn |= (
            {"frontier": draw_frontier(config, groups)} if config.sweeps else {}
        )
        for name, figure in (figures | others_drawn).items():
            for kind in ("png", "svg"):
                figure.savefig(store.folder / f"{name}.{kind}", dpi=RESOLUTION)
        page = _page(
            config,
            rows,
            groups,
            sure,
            (verdict, missed),
            failed,
            speed,
            list(figures.values()),
            others_drawn,
        )
        store.write_text(PAGE_FILE, page)
    except OSError as error:
        raise CampaignError(
            f"cannot write the results into {store.folder}: {error.strerror or error}"
        ) from error
    console.print(
        report.terminal_table(groups, f"{len(rows)} rows, seed {config.seed}")
    )
    console.print(f"one core runs {speed}")
    for cells in failed[:SHOWN_FAILURES]:
        console.print(
            f"  {cells[0]}  {cells[1]}, point {cells[4]} ({cells[5]} mm), s after"
            f" {cells[8]}: {cells[10]}",
            soft_wrap=True,
        )
    if len(failed) > SHOWN_FAILURES:
        console.print(f"  and {len(failed) - SHOWN_FAILURES} more in failures.md")
    for line in [verdict, *missed]:
        console.print(line, soft_wrap=True)
    console.print(
        f"{store.folder}: rows.parquet summary.md summary.json failures.md figure.png"
        f" {PAGE_FILE}",
        soft_wrap=True,
    )
    return EXIT_FAILED if missed else 0


def _verdict(bars: int, missed: Sequence[str], default_name: str) -> str:
    if not bars:
        return (
            f"no bars: none of the rows is of {default_name}, or the cases ask for"
            " nothing"
        )
    held = "all" if not missed else f"{bars - len(missed)} of"
    return f"{held} {bars} bars hold"


def _markdown(
    config: CampaignConfig,
    rows: Sequence[Row],
    groups: Sequence[summary.Group],
    sure: Reliability,
    verdict: str,
    missed: Sequence[str],
    speed: str,
) -> str:
    lines = [
        _what(config, rows),
        "",
        report.markdown_table(groups),
        "",
        report.LEGEND + ".",
        "",
        report.reliability_table(sure),
        "",
        *(reliability.in_words(estimator, bins) for estimator, bins in sure.items()),
        "",
        f"{verdict}; one core runs {speed}.",
        *(f"- {line}" for line in missed),
    ]
    return "\n".join(lines) + "\n"


def _what(config: CampaignConfig, rows: Sequence[Row]) -> str:
    return (
        f"{counted(len(rows), 'row')}: {counted(config.points.count, 'crossing point')}"
        f" ({config.points.folded} folded),"
        f" {counted(len(config.directions), 'direction')},"
        f" {counted(config.seeds, 'seed')} from {config.seed}; one way lasts"
        f" {config.duration:g} s unless the case says otherwise."
    )


def _page(
    config: CampaignConfig,
    rows: Sequence[Row],
    groups: Sequence[summary.Group],
    sure: Reliability,
    judged: tuple[str, Sequence[str]],
    failed: Sequence[Sequence[str]],
    speed: str,
    figures: Sequence[Figure],
    others: dict[str, Figure],
) -> str:
    """Put all of it on one page that opens offline."""
    verdict, missed = judged
    many = len({group.plant for group in groups}) > 1
    columns = [
        Column(name, text=index < 2) for index, name in enumerate(report.HEADINGS)
    ]
    shown = failed[:LISTED_FAILURES]
    return render(
        "campaign.html",
        {},
        title=f"campaign: {verdict}",
        heading=(
            f"{config.default.law} / {config.default.estimator}:"
            f" {counted(len(config.cases), 'case')}"
        ),
        subheading=_what(config, rows),
        verdict={
            "kind": "" if verdict.startswith("no") else "bad" if missed else "good",
            "word": f"{verdict[:1].upper()}{verdict[1:]}.",
        },
        missed=missed,
        groups=(
            columns,
            [
                [
                    Cell(cell, bool(group.missed) and index == len(columns) - 1)
                    for index, cell in enumerate(report.cells(group, many))
                ]
                for group in groups
            ],
        ),
        legend=report.LEGEND,
        frontier=svg(others["frontier"]) if "frontier" in others else "",
        drawn=[svg(figure) for figure in figures],
        reliability={
            "sentences": [
                reliability.in_words(estimator, bins)
                for estimator, bins in sure.items()
            ],
            "drawn": svg(others["reliability"]) if "reliability" in others else "",
            "legend": (
                "Clear of the locus, of the runs that stated a confidence of the range"
                " (grey, its mean marked), for how much of the time they were right;"
                " the axes are logarithmic in the chance to be wrong. Below the dashed"
                " line it is too sure."
            ),
        },
        failures=(
            [Column(name, text=True) for name in report.FAILURE_HEADINGS],
            [[Cell(cell) for cell in row] for row in shown],
        ),
        more=(
            f"And {len(failed) - len(shown)} more in failures.md."
            if len(failed) > len(shown)
            else ""
        ),
        footer=(
            f"Made by dextar campaign; one core runs {speed}. All numbers stand in"
            " summary.json and rows.parquet beside it."
        ),
    )


def _json(
    config: CampaignConfig,
    groups: Sequence[summary.Group],
    speeds: dict[str, float],
    elapsed: float,
    held: int,
    bars: int,
) -> str:
    content: dict[str, object] = {
        "version": design.version(),
        "seed": config.seed,
        "default": config.default.model_dump(),
        "bars": bars,
        "bars_held": held,
        "real_time_factor_per_core": {
            plant: factor if math.isfinite(factor) else None
            for plant, factor in speeds.items()
        },
        "elapsed": elapsed,
        "machine": {
            "cores": core_count(),
            "platform": platform.platform(),
            "python": platform.python_version(),
        },
        "groups": [summary.as_json(group) for group in groups],
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"
