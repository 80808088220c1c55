"""Analysis of one bag from file to files, and its summary in words."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.table import Table

from dextar_control.analysis.clock import clock_in_words
from dextar_control.analysis.compute import compute_metrics
from dextar_control.analysis.crossings import NOT_BEGUN, crossed_in_words
from dextar_control.analysis.load import load_run
from dextar_control.analysis.metrics import Metrics, saturated
from dextar_control.analysis.registry import number
from dextar_control.bags.damage import damage_lines
from dextar_control.bags.scan import Progress
from dextar_control.contract.errors import bag_errors
from dextar_control.contract.robot import RobotParameters
from dextar_control.contract.words import counted

RESOLUTION = 150  # dots per inch
NOTHING = "nothing recorded"
BEYOND_BRIEF = "estimated error", "peak near the locus"
WAITED = "none: each step waited for it"


def analyze(
    path: str | Path,
    output_dir: str | Path | None = None,
    formats: Sequence[str] = (),
    width: float | None = None,
    progress: Callable[[str], None] = lambda stage: None,
    namespace: str | None = None,
    reading: Progress | None = None,
    robot: RobotParameters | None = None,
    judged: Callable[[Metrics], object] = lambda metrics: None,
) -> Metrics:
    """Write ``metrics.json``, ``figure.png`` and ``report.html`` of a bag, next to it
    or into a folder.

    Args:
        path: of the bag.
        output_dir: the folder; made where it does not exist.
        formats: of a figure for a paper, ``paper.<format>``: png, svg, pdf.
        width: of that figure, mm; a column of a two-column page when None.
        progress: told what is being done.
        namespace: of the robot, where a bag of another recorder holds several.
        reading: told the bytes read and those there are.
        robot: of a bag that does not say it.
        judged: told the metrics, before anything is drawn.

    Raises:
        BagError: the bag cannot be read, or the results cannot be written.
    """
    progress("reading the bag")
    run = load_run(path, namespace, reading, robot)
    progress("computing the metrics")
    metrics = compute_metrics(run)
    judged(metrics)
    # imported here, for what draws takes longer to load than a bag takes to judge
    from dextar_control.analysis.figure import draw_run
    from dextar_control.analysis.page import render_report
    from dextar_control.analysis.paper_figure import COLUMN, write_paper

    folder = Path(output_dir) if output_dir is not None else run.path.parent
    with bag_errors(f"write the analysis to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        text, page = folder / "metrics.json", folder / "report.html"
        text.write_text(metrics.to_json() + "\n", encoding="utf-8", errors="replace")
        progress("drawing figure.png")
        draw_run(run, metrics).savefig(folder / "figure.png", dpi=RESOLUTION)
        progress("writing report.html")
        written = render_report(run, metrics)
        page.write_text(written, encoding="utf-8", errors="replace")
        if formats:
            progress("drawing the figure for a paper")
            write_paper(run, metrics, folder, list(formats), width or COLUMN)
    return metrics


def summary_table(metrics: Metrics) -> Table:
    """Make the summary of a run a table for a terminal."""
    table = Table(show_header=False, title=metrics.title, title_justify="left")
    for name, value in summary_lines(metrics):
        table.add_row(name, value)
    return table


def brief_table(metrics: Metrics) -> Table:
    """Make a shorter table, for somebody who wants to know whether the run went well
    and, if it did not, why.
    """
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    usual = {
        "saturated commands": "0",
        "states without command": f"0 of {metrics.states}",
        "steps without it in time": WAITED,
        "lost in recording": "none",
    }
    for name, value in summary_lines(metrics):
        if name not in BEYOND_BRIEF and value != usual.get(name):
            table.add_row(name, value)
    return table


def summary_lines(metrics: Metrics) -> list[tuple[str, str]]:
    """List the summary of a run as (what, value) pairs."""
    verdict = {True: "success", False: "FAILED", None: "not decidable"}[metrics.success]
    estimated = metrics.shown("max_estimated_error", "")
    lines = [
        ("crossed", _crossed(metrics)),
        ("estimator says", _verdicts(metrics)),
        ("true error", _true_error(metrics)),
        ("estimated error", f"{estimated} max" if estimated else NOTHING),
        ("peak torque", _torque(metrics, "", "the plan's")),
        ("peak near the locus", _torque(metrics, "_near", "the plan's peak")),
        ("saturated commands", saturated(metrics)),
        (
            "loop rate (system clock)",
            (
                f"{number(metrics.loop_rate, '.0f')} Hz median,"
                f" {number(metrics.mean_rate, '.0f')} Hz mean{_pace(metrics)}"
            ),
        ),
        ("states without command", f"{metrics.missed} of {metrics.states}"),
        ("steps without it in time", _late(metrics)),
        ("lost in recording", _lost(metrics)),
        ("verdict", verdict),
    ]
    lines += [
        ("bag", text)
        for text in damage_lines(metrics.holes, metrics.truncated, metrics.unreadable)
    ]
    if stepped := clock_in_words(metrics.stamp_steps, metrics.clock_steps):
        lines.append(("clock", stepped))
    return lines + [("", reason) for reason in metrics.reasons]


def _crossed(metrics: Metrics) -> str:
    if not metrics.crossings:
        return (
            "no crossing is planned"
            if math.isfinite(metrics.planned_peak_torque)
            else "unknown without a plan"
        )
    return crossed_in_words(metrics.crossings, "planned") or "unknown without truth"


def _lost(metrics: Metrics) -> str:
    text = ", ".join(
        f"{topic}: {'unknown' if count is None else count}"
        for topic, count in metrics.lost.items()
        if count != 0
    )
    text = text or ("none" if metrics.lost else "not counted")
    if metrics.truncated and metrics.lost:
        text += (
            " by the last count; the end is missing, and what was lost there is unknown"
        )
    if metrics.holes and metrics.lost:
        text += "; what a damaged file no longer holds is not counted"
    return text


def _verdicts(metrics: Metrics) -> str:
    verdicts = [crossing.verdict for crossing in metrics.crossings]
    if not verdicts or None in verdicts:
        return NOTHING
    text = ", ".join(
        f"{verdicts.count(word)} {word}" for word in ("crossed", "bounced", "undecided")
    )
    if later := verdicts.count(NOT_BEGUN):
        text += f", {later} not begun"
    wrong = [
        str(row)
        for row, crossing in enumerate(metrics.crossings, 1)
        if crossing.verdict_correct is False
    ]
    if wrong:
        return f"{text}; WRONG at crossing {', '.join(wrong)}"
    if any(crossing.verdict_correct for crossing in metrics.crossings):
        return f"{text}; agrees with the truth"
    return text


def _pace(metrics: Metrics) -> str:
    factor = metrics.mean_rate * metrics.timing.stamp_period
    return (
        f"; {factor:.2f} × real time"
        if metrics.timing.lockstep and math.isfinite(factor)
        else ""
    )


def _late(metrics: Metrics) -> str:
    if metrics.timing.lockstep:
        return WAITED
    if metrics.late_ticks is None:
        return "not counted"
    share = (
        f" ({metrics.late_ticks / metrics.plant_steps:.0%})"
        if metrics.plant_steps
        else ""
    )
    return (
        f"{metrics.late_ticks} of {metrics.plant_steps}{share};"
        f" {counted(metrics.late_commands or 0, 'command')} came later"
    )


def _true_error(metrics: Metrics) -> str:
    if metrics.start_stamp is None:
        return "no trajectory was tracked"
    if metrics.truth_share == 0.0:
        return "unknown without truth"
    last = metrics.shown("final_true_error")
    return f"{metrics.shown('max_true_error')} max, {last} at the end"


def _torque(metrics: Metrics, near: str, of: str) -> str:
    text = metrics.shown(f"peak_torque{near}", NOTHING)
    ratio = number(getattr(metrics, f"torque_ratio{near}"), ".2f", "")
    return f"{text}, {ratio} × {of}" if ratio else text
