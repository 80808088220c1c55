"""Run ``dextar campaign`` from its arguments: all of it, or one row again."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.plain_data import as_plain
from dextar_control.contract.terminal import Terminal, spoken_warnings
from dextar_control.experiments.campaign.config import load_config
from dextar_control.experiments.campaign.outcome import EXIT_FAILED, PAGE_FILE
from dextar_control.experiments.campaign.run import (
    TRIAL_MODULE,
    Campaign,
    prepare,
    run_campaign,
)
from dextar_control.experiments.campaign.selection import names, select
from dextar_control.experiments.campaign.store import read_rows
from dextar_control.experiments.campaign.worker import run_trials

# results that differ from run to run
TIMES = {"wall_time", "cpu_time", "planning_time"}


def run_command(
    arguments: argparse.Namespace,
    trial_module: str = TRIAL_MODULE,
    printed: Callable[[Path], Path] | None = None,
) -> int:
    """Run a campaign, or one of its rows; return the exit code.

    Args:
        arguments: of the command line.
        trial_module: plans and runs a trial.
        printed: makes a PDF of a page beside it, where the arguments ask for one.

    Raises:
        DextarError: the campaign file, an argument, the folder or the workers cannot be
            used.
    """
    console = Terminal()
    with spoken_warnings("campaign"):
        config = load_config(arguments.config)
    config = select(
        config,
        seed=arguments.seed,
        points=arguments.points,
        cases=names(arguments.cases),
        laws=names(arguments.laws),
        estimators=names(arguments.estimators),
    )
    campaign = prepare(config, arguments.config, trial_module)
    folder = arguments.output or campaign.folder(arguments.config)
    if arguments.row is not None:
        return rerun(campaign, folder, arguments.row, console)
    code = run_campaign(
        campaign, folder, console, arguments.workers, arguments.scheduler
    )
    if arguments.pdf and printed is not None and code <= EXIT_FAILED:
        console.print(f"{printed(folder / PAGE_FILE)}", soft_wrap=True)
    return code


def rerun(campaign: Campaign, folder: Path, key: str, console: Terminal) -> int:
    """Run one row again in this process, and compare it with the recorded one.

    Args:
        campaign: from ``prepare``.
        folder: of the recorded rows.
        key: of the row, or its beginning.
        console: for the row.

    Returns:
        The exit code: 0 if it equals the recorded row or none is recorded, 1 if it
            differs.

    Raises:
        ParameterError: no row, or more than one, has a key that begins so.
    """
    found = [one for one in campaign.trials if one.startswith(key)]
    if len(found) != 1:
        counted = f"{len(found)} rows have" if found else "no row of this campaign has"
        raise ParameterError(
            f"row '{key}': {counted} a key that begins so; the keys stand in the"
            " campaign's rows.parquet"
        )
    trial = campaign.trials[found[0]]
    row = as_plain(
        {"key": found[0], **run_trials(campaign.job, [trial])[0], **trial.columns()}
    )
    width = max(map(len, row))
    for name, value in row.items():
        console.print(f"{name:<{width}}  {value}", soft_wrap=True)
    recorded = read_rows(folder).get(found[0])
    if recorded is None:
        console.print(f"this row is not recorded in {folder}", soft_wrap=True)
        return 0
    different = [
        name
        for name in {**recorded, **row}
        if name not in TIMES and recorded.get(name) != row.get(name)
    ]
    for name in different:
        console.print(f"{name}: recorded {recorded.get(name)}, now {row.get(name)}")
    console.print(
        "differs from the recorded row"
        if different
        else "equal to the recorded row, bit for bit"
    )
    return 1 if different else 0
