"""Run ``dextar campaign`` from its arguments."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from dextar_control.contract.terminal import Terminal, spoken_warnings
from dextar_control.experiments.campaign.config import load_config
from dextar_control.experiments.campaign.outcome import EXIT_FAILED, PAGE_FILE
from dextar_control.experiments.campaign.rerun import rerun
from dextar_control.experiments.campaign.run import TRIAL_MODULE, prepare, run_campaign
from dextar_control.experiments.campaign.selection import names, select


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
