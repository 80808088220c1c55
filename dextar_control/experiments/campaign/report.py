"""Tell a campaign in words: its table for a terminal and for a file, and the trials
that failed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from rich import box
from rich.table import Table

from dextar_control.experiments.campaign.ranges import BARS
from dextar_control.experiments.campaign.reliability import VERDICTS, Bin
from dextar_control.experiments.campaign.rows import Row, number, text
from dextar_control.experiments.campaign.summary import Group
from dextar_control.experiments.campaign.trial import CONFIDENCE_BINS

HEADINGS = (
    "case",
    "law / estimator",
    "n",
    "cross %",
    "ok %",
    "med. mm",
    "max mm",
    "end mm",
    "near ×",
    "sat.",
    "called %",
    "false",
    "bars",
)
LEGEND = (
    "cross: the true robot crossed at each planned crossing; ok: besides, its true"
    " error stayed < 5 mm and ended < 1 mm; med., max: over the trials, of each one's"
    " largest true error; end: largest at the end; near: largest torque within |s| <"
    " 0.1 over the planned peak; sat.: saturated ticks of the worst trial; called:"
    " bounces that were called so; false: crossings that were called bounces"
)
FAILURE_HEADINGS = (
    "row",
    "case",
    "law / estimator",
    "plant",
    "point",
    "x, y (mm)",
    "mode",
    "family",
    "s after",
    "max error (mm)",
    "reason",
)


def terminal_table(groups: Sequence[Group], title: str) -> Table:
    """Make the summary for a terminal, a section for each case, without the columns
    that have no number.
    """
    many = len({group.plant for group in groups}) > 1
    rows = [cells(group, many) for group in groups]
    shown = [
        index
        for index in range(1, len(HEADINGS))
        if any(row[index] != "-" for row in rows)
    ]
    table = Table(
        title=title,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 0, 0, 1),
        collapse_padding=True,
    )
    for index in shown:
        table.add_column(
            HEADINGS[index],
            justify="left" if index == 1 else "right",
            vertical="bottom",
            overflow="fold",
            no_wrap=index == 1,
        )
    case = ""
    for group, row in zip(groups, rows, strict=True):
        if group.case != case:
            case = group.case
            table.add_section()
            table.add_row(case, style="italic")
        style = "bold red" if group.missed else "bold" if group.judged else None
        table.add_row(
            *(row[index] if index > 1 else f" {row[index]}" for index in shown),
            style=style,
        )
    return table


def markdown_table(groups: Sequence[Group]) -> str:
    """Write the summary for a file."""
    many = len({group.plant for group in groups}) > 1
    rows = []
    for group in groups:
        row = cells(group, many)
        rows.append(
            [
                f"**{cell}**" if group.judged and index < 2 else cell
                for index, cell in enumerate(row)
            ]
        )
    return _markdown(HEADINGS, rows, left=2)


def cells(group: Group, with_plant: bool) -> list[str]:
    """List one group in the order of ``HEADINGS``."""
    name = f"{group.law} / {group.estimator}" + (
        f" / {group.plant}" if with_plant else ""
    )
    return [
        group.case,
        name,
        str(group.rows),
        percent(group.crossed),
        percent(group.success),
        mm(group.median_error),
        mm(group.max_error),
        mm(group.max_end_error),
        _number(group.peak_ratio_near, ".2f"),
        _number(group.saturated, ".0f"),
        percent(group.recognised),
        _number(group.false_alarms, ".0f"),
        _bars(group),
    ]


def reliability_table(found: dict[str, dict[str, Bin]]) -> str:
    """Write how often the estimators that tell the side were right, by the confidence
    that they stated.
    """
    names = [*(f"{odds:g}" for odds in CONFIDENCE_BINS), VERDICTS]
    lines = [
        [estimator, *(_share_right(bins.get(name)) for name in names)]
        for estimator, bins in found.items()
    ]
    headings = (
        "right % (95 % interval; of), at a confidence from",
        *names[:-1],
        "at its verdicts",
    )
    return _markdown(headings, lines, left=1) if lines else ""


def _share_right(one: Bin | None) -> str:
    return (
        "-"
        if one is None
        else (
            f"{percent(one.right)} ({percent(one.least)}–{percent(one.most)};"
            f" {one.runs})"
        )
    )


def missed_lines(groups: Iterable[Group]) -> list[str]:
    """Write one sentence for each bar that does not hold."""
    return [
        f"{group.case}, {group.law} / {group.estimator}: {verdict.bar} is"
        f" {_bar_value(verdict.bar, verdict.measured)}, the bar is"
        f" {_bar_value(verdict.bar, verdict.limit)}"
        for group in groups
        for verdict in group.missed
    ]


def failures(rows: Iterable[Row]) -> list[list[str]]:
    """List the cells of each row that is no success, in the order of
    ``FAILURE_HEADINGS``.
    """
    return [
        [
            text(row, "key"),
            text(row, "case"),
            f"{row['law']} / {row['estimator']}",
            text(row, "plant"),
            text(row, "index"),
            f"{1e3 * number(row, 'point_x'):.1f}, {1e3 * number(row, 'point_y'):.1f}",
            text(row, "working_mode"),
            text(row, "family"),
            f"{number(row, 'direction'):+.0f}",
            mm(number(row, "max_error")),
            reason_of(row),
        ]
        for row in rows
        if not row.get("success")
    ]


def reason_of(row: Row) -> str:
    """Say why a row is no success."""
    return str(row.get("plan_problem") or row.get("reason") or "no reason given")


def markdown_failures(
    judged: Sequence[list[str]], others: Sequence[list[str]], judged_name: str
) -> str:
    """Write the trials that failed, those that the bars are for first."""
    parts = []
    for title, found in ((judged_name, judged), ("the other combinations", others)):
        parts.append(f"## {title}: {len(found)} failed\n")
        if found:
            parts.append(
                _markdown(FAILURE_HEADINGS, found, left=len(FAILURE_HEADINGS)) + "\n"
            )
    return "\n".join(parts)


def percent(share: float) -> str:
    """Write a share in percent; it is 100 only if it is all."""
    if not math.isfinite(share):
        return "-"
    shown = f"{100.0 * share:.1f}"
    return "99.9" if shown == "100.0" and share < 1.0 else shown.removesuffix(".0")


def mm(length: float) -> str:
    """Write a length, m, in mm."""
    return _number(1e3 * length, ".3f" if abs(length) < 1e-2 else ".1f")


def _bars(group: Group) -> str:
    if not group.judged or not group.verdicts:
        return "-"
    held = len(group.verdicts) - len(group.missed)
    return f"{held}/{len(group.verdicts)}"


def _bar_value(bar: str, value: float) -> str:
    if not math.isfinite(value):
        return "not measured"
    unit = BARS[bar].unit
    if unit == "mm":
        return f"{mm(value)} mm"
    return f"{percent(value)} %" if unit == "%" else f"{value:.3g}"


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "-"


def _markdown(headings: Sequence[str], rows: Iterable[Sequence[str]], left: int) -> str:
    """Write a table whose first columns are aligned to the left."""
    rule = "|".join(["---"] * left + ["---:"] * (len(headings) - left))
    lines = [[*headings], *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    drawn = [f"| {' | '.join(line)} |" for line in lines]
    return "\n".join([drawn[0], f"|{rule}|", *drawn[1:]])
