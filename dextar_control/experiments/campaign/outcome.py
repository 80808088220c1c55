"""Write what a campaign leaves behind: columnar file, summary, failures, figures, and
the verdict on its bars.
"""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

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
PAGE_FILE = "report.html"
SHOWN_FAILURES, LISTED_FAILURES = 8, 200  # on the terminal, on the page
RESOLUTION = 150  # dots per inch


@dataclass(frozen=True)
class Results:
    """The rows of a campaign, and what follows from them."""

    config: CampaignConfig
    rows: Sequence[Row]

    @cached_property
    def groups(self) -> list[summary.Group]:
        """The statistics of each case and combination."""
        return summary.summarise(self.config, self.rows)

    @cached_property
    def bins(self) -> dict[str, dict[str, reliability.Bin]]:
        """How sure each estimator was, and how often right."""
        return reliability.reliability(self.rows)

    @cached_property
    def speeds(self) -> dict[str, float]:
        """Real-time factor of one core on each plant that was measured."""
        factors = {
            plant: summary.real_time_factor(
                row for row in self.rows if row["plant"] == plant
            )
            for plant in self.config.plants
        }
        return {name: value for name, value in factors.items() if math.isfinite(value)}

    @property
    def speed(self) -> str:
        """The same in words."""
        return ", ".join(
            f"{factor:.1f} x real time on {plant}"
            for plant, factor in self.speeds.items()
        )

    @property
    def default_name(self) -> str:
        """The combination and the plant that the bars are for, in words."""
        default = self.config.default
        return f"{default.law} / {default.estimator} on {default.plant}"

    def failures(self, *, of_default: bool) -> list[list[str]]:
        """List the rows that failed, of the default combination or of the others."""
        default = self.config.default
        wanted = (default.law, default.estimator, default.plant)
        return report.failures(
            row
            for row in self.rows
            if ((row["law"], row["estimator"], row["plant"]) == wanted) is of_default
        )

    @cached_property
    def missed(self) -> list[str]:
        """A sentence for each bar that is missed."""
        return report.missed_lines(self.groups)

    @property
    def bars(self) -> int:
        """How many bars there are."""
        return sum(len(group.verdicts) for group in self.groups)

    @property
    def verdict(self) -> str:
        """How many bars hold, in words."""
        if not self.bars:
            return (
                f"no bars: none of the rows is of {self.default_name}, or the cases ask"
                " for nothing"
            )
        held = f"{self.bars - len(self.missed)} of" if self.missed else "all"
        return f"{held} {self.bars} bars hold"

    @property
    def extent(self) -> str:
        """What the campaign is made of, in a sentence."""
        config = self.config
        return (
            f"{counted(len(self.rows), 'row')}:"
            f" {counted(config.points.count, 'crossing point')}"
            f" ({config.points.folded} folded),"
            f" {counted(len(config.directions), 'direction')},"
            f" {counted(config.seeds, 'seed')} from {config.seed}; one way lasts"
            f" {config.duration:g} s unless the case says otherwise."
        )

    @property
    def confidence_sentences(self) -> list[str]:
        """A sentence on each estimator that states a confidence."""
        return [reliability.in_words(*item) for item in self.bins.items()]

    def figures(self) -> dict[str, Figure]:
        """Draw one figure for each plant, by the names of their files."""
        config, plants = (
            self.config,
            dict.fromkeys(group.plant for group in self.groups),
        )
        return {
            "figure"
            if plant == config.default.plant or len(config.plants) == 1
            else f"figure-{plant}": draw_summary(config, self.groups, plant)
            for plant in plants
        }

    def further_figures(self) -> dict[str, Figure]:
        """Draw reliability and frontier where the campaign has them."""
        found = {}
        if self.bins:
            found["reliability"] = reliability.draw_reliability(self.bins)
        if self.config.sweeps:
            found["frontier"] = draw_frontier(self.config, self.groups)
        return found


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
    results = Results(config, [store.rows[key] for key in keys if key in store.rows])
    try:
        store.write_table(keys)
        _write(results, store, elapsed)
    except OSError as error:
        raise CampaignError(
            f"cannot write the results into {store.folder}: {error.strerror or error}"
        ) from error
    title = f"{len(results.rows)} rows, seed {config.seed}"
    console.print(report.terminal_table(results.groups, title))
    console.print(f"one core runs {results.speed}")
    failed = results.failures(of_default=True)
    for cells in failed[:SHOWN_FAILURES]:
        console.print(
            f"  {cells[0]}  {cells[1]}, point {cells[4]} ({cells[5]} mm), s after"
            f" {cells[8]}: {cells[10]}",
            soft_wrap=True,
        )
    if len(failed) > SHOWN_FAILURES:
        console.print(f"  and {len(failed) - SHOWN_FAILURES} more in failures.md")
    for line in [results.verdict, *results.missed]:
        console.print(line, soft_wrap=True)
    console.print(
        f"{store.folder}: rows.parquet summary.md summary.json failures.md figure.png"
        f" {PAGE_FILE}",
        soft_wrap=True,
    )
    return EXIT_FAILED if results.missed else 0


def _write(results: Results, store: Store, elapsed: float) -> None:
    """Write texts, figures and page into the folder."""
    store.write_text("summary.json", _json(results, elapsed))
    store.write_text("summary.md", _markdown(results))
    failed, others = (results.failures(of_default=of) for of in (True, False))
    store.write_text(
        "failures.md", report.markdown_failures(failed, others, results.default_name)
    )
    figures, further = results.figures(), results.further_figures()
    for name, figure in (figures | further).items():
        for kind in ("png", "svg"):
            figure.savefig(store.folder / f"{name}.{kind}", dpi=RESOLUTION)
    store.write_text(PAGE_FILE, _page(results, failed, figures, further))


def _markdown(results: Results) -> str:
    lines = [
        results.extent,
        "",
        report.markdown_table(results.groups),
        "",
        report.LEGEND + ".",
        "",
        report.reliability_table(results.bins),
        "",
        *results.confidence_sentences,
        "",
        f"{results.verdict}; one core runs {results.speed}.",
        *(f"- {line}" for line in results.missed),
    ]
    return "\n".join(lines) + "\n"


def _page(
    results: Results,
    failed: Sequence[Sequence[str]],
    figures: dict[str, Figure],
    further: dict[str, Figure],
) -> str:
    """Put all of it on one page that opens offline."""
    config, groups, verdict = results.config, results.groups, results.verdict
    many = len({group.plant for group in groups}) > 1
    last = len(report.HEADINGS) - 1
    judged = "bad" if results.missed else "good"
    drawn = {name: svg(figure) for name, figure in further.items()}
    shown = failed[:LISTED_FAILURES]
    return render(
        "campaign.html",
        {},
        title=f"campaign: {verdict}",
        heading=(
            f"{config.default.law} / {config.default.estimator}:"
            f" {counted(len(config.cases), 'case')}"
        ),
        subheading=results.extent,
        verdict={
            "kind": judged if results.bars else "",
            "word": f"{verdict[:1].upper()}{verdict[1:]}.",
        },
        missed=results.missed,
        groups=(
            [Column(name, text=i < 2) for i, name in enumerate(report.HEADINGS)],
            [
                [
                    Cell(cell, bool(group.missed) and i == last)
                    for i, cell in enumerate(report.cells(group, many))
                ]
                for group in groups
            ],
        ),
        legend=report.LEGEND,
        frontier=drawn.get("frontier", ""),
        drawn=[svg(figure) for figure in figures.values()],
        reliability={
            "sentences": results.confidence_sentences,
            "drawn": drawn.get("reliability", ""),
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
            f"Made by dextar campaign; one core runs {results.speed}. All numbers stand"
            " in summary.json and rows.parquet beside it."
        ),
    )


def _json(results: Results, elapsed: float) -> str:
    config = results.config
    content: dict[str, object] = {
        "version": design.version(),
        "seed": config.seed,
        "default": config.default.model_dump(),
        "bars": results.bars,
        "bars_held": results.bars - len(results.missed),
        "real_time_factor_per_core": {
            plant: results.speeds.get(plant) for plant in config.plants
        },
        "elapsed": elapsed,
        "machine": {
            "cores": core_count(),
            "platform": platform.platform(),
            "python": platform.python_version(),
        },
        "groups": [summary.as_json(group) for group in results.groups],
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"
