"""Run a campaign from its file to its folder: plan, run what is missing, judge."""

from __future__ import annotations

import importlib
import itertools
import shlex
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from dextar_control.contract.resources import config_file
from dextar_control.contract.robot import flatten, load_robot
from dextar_control.contract.signals import exit_code
from dextar_control.contract.terminal import Steps, Terminal, TextColumn
from dextar_control.experiments.campaign import design
from dextar_control.experiments.campaign.config import CampaignConfig
from dextar_control.experiments.campaign.design import Trial
from dextar_control.experiments.campaign.outcome import judge
from dextar_control.experiments.campaign.pool import Pool, check_workers
from dextar_control.experiments.campaign.rig import resolve
from dextar_control.experiments.campaign.selection import check_names, own_names
from dextar_control.experiments.campaign.store import Store, read_rows
from dextar_control.experiments.campaign.worker import Job, plan_trials, run_trials

BATCH = 4  # trials that one call of a worker runs: about a second
TRIAL_MODULE = "dextar_control.experiments.campaign.trial"


@dataclass(frozen=True)
class Campaign:
    """Holds a campaign file with all that follows from it."""

    config: CampaignConfig
    job: Job
    trials: dict[str, Trial]  # by key, in the order in which they run

    @property
    def manifest(self) -> dict[str, object]:
        """What the rows of a folder are of."""
        return {
            "version": design.version(),
            "digest of the sources": self.job.code,
            "config": self.config.model_dump(),
            "robot": flatten(self.job.robot),
        }

    def folder(self, path: Path) -> Path:
        """Return where the campaign of a file goes unless it is told: the same campaign
        always into the same folder.
        """
        return Path("runs") / f"{path.stem}-{design.digest(self.manifest)[:8]}"


def prepare(
    config: CampaignConfig, path: Path, trial_module: str = TRIAL_MODULE
) -> Campaign:
    """Prepare the trials of a campaign.

    Args:
        config: checked by itself; the names of its rig's plants stand in ``PLANTS`` of
            the class or its module.
        path: of the campaign file; the robot file lies beside it or in ``config/``.
        trial_module: plans and runs a trial, and knows the names of laws and
            estimators.

    Raises:
        ParameterError: a law, an estimator, a plant or the rig does not exist.
    """
    physics = importlib.import_module(trial_module)
    rig = resolve(config.rig)
    plants = getattr(rig, "PLANTS", None) or getattr(
        sys.modules[rig.__module__], "PLANTS", config.plants
    )
    check_names(config, physics.LAWS, physics.ESTIMATORS, list(plants))
    beside = path.parent / config.robot
    robot = load_robot(beside if beside.is_file() else config_file(config.robot))
    points = physics.sample_points(
        robot, config.points.count, config.points.folded, config.seed
    )
    own = own_names(config)
    job = Job(
        robot,
        config.rig,
        trial_module,
        design.code_digest(config.rig, trial_module, own),
        own,
    )
    trials = {
        design.row_key(robot, config.rig, trial): trial
        for trial in design.trials_of(config, points)
    }
    return Campaign(config, job, trials)


def run_campaign(
    campaign: Campaign,
    folder: Path,
    console: Terminal,
    workers: int | None = None,
    scheduler: str | None = None,
) -> int:
    """Run the rows that the folder lacks, then judge all of them.

    Args:
        campaign: from ``prepare``.
        folder: of the results; rows that it has are kept.
        console: for progress and table.
        workers: processes on this machine, one for each core if None.
        scheduler: address of a running Dask scheduler instead.

    Returns:
        The exit code: 0 if all bars hold, 1 if one is missed, 128 + the signal's number
            (130: Ctrl-C) if interrupted.

    Raises:
        ParameterError: workers and scheduler contradict each other, or there are too
            few.
        CampaignError: the folder or the workers cannot be used.
    """
    check_workers(workers, scheduler)
    with Store(folder, campaign.manifest) as store:
        missing = {
            key: trial
            for key, trial in campaign.trials.items()
            if key not in store.rows
        }
        kept = len(campaign.trials) - len(missing)
        console.print(
            f"{len(campaign.trials)} rows into {folder}"
            + (f", {kept} are there" if kept else "")
        )
        begin = time.perf_counter()
        try:
            if missing:
                with Pool(workers, scheduler) as pool:
                    _run(campaign, missing, store, pool, console)
            return judge(
                campaign.config,
                list(campaign.trials),
                store,
                console,
                time.perf_counter() - begin,
            )
        except KeyboardInterrupt as interrupt:
            # also what was written as the signal came
            there = len(campaign.trials.keys() & read_rows(folder).keys())
            console.print(
                f"interrupted; {there} of {len(campaign.trials)} rows are kept in"
                f" {folder}. To go on:\n  {shlex.join(['dextar', *sys.argv[1:]])}",
                soft_wrap=True,
            )
            return exit_code(interrupt)


def _run(
    campaign: Campaign,
    missing: dict[str, Trial],
    store: Store,
    pool: Pool,
    console: Terminal,
) -> None:
    keys = {id(trial): key for key, trial in missing.items()}
    columns = (
        TextColumn("{task.description:<8}"),
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[said]}"),
    )
    places = [
        list(trials)
        for _, trials in itertools.groupby(
            missing.values(), key=lambda trial: trial.place
        )
    ]
    with Steps(*columns, console=console) as progress:
        task = progress.add_task(
            "planning", total=len(places), said=f"{pool.workers} workers"
        )
        for _ in pool.map(plan_trials, campaign.job, map(_distinct_plans, places)):
            progress.advance(task)
        succeeded = failed = 0
        task = progress.add_task("running", total=len(missing), said="")
        for trials, results in pool.map(run_trials, campaign.job, _batches(places)):
            rows = [
                {"key": keys[id(trial)], **result, **trial.columns()}
                for trial, result in zip(trials, results, strict=True)
            ]
            store.append(rows)
            good = sum(bool(row.get("success")) for row in rows)
            succeeded, failed = succeeded + good, failed + len(rows) - good
            progress.update(
                task, advance=len(rows), said=f"{succeeded} ok, {failed} failed"
            )


def _distinct_plans(trials: Iterable[Trial]) -> list[Trial]:
    """Choose one trial for each plan that trials with the same crossing point and
    direction need.
    """
    return list(
        {
            (trial.law, trial.duration, trial.dwell, trial.repeat): trial
            for trial in trials
        }.values()
    )


def _batches(places: Iterable[Sequence[Trial]]) -> Iterator[Sequence[Trial]]:
    for trials in places:
        for begin in range(0, len(trials), BATCH):
            yield trials[begin : begin + BATCH]
