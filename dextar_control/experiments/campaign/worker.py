"""Run a few trials in a worker process, each of which may fail without the others."""

from __future__ import annotations

import importlib
import time
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

from dextar_control.contract.errors import CampaignError
from dextar_control.contract.robot import RobotParameters
from dextar_control.experiments.campaign.design import Trial, code_digest
from dextar_control.experiments.campaign.rig import RigMaker, resolve
from dextar_control.experiments.campaign.rows import Row, failed_row


class Job(NamedTuple):
    """What all the trials of a campaign share."""

    robot: RobotParameters
    rig: str  # module:Class
    trial: str  # the module that plans and runs a trial
    code: str  # digest of the sources
    own: tuple[str, ...] = ()  # laws and estimators of the user's own


def run_trials(job: Job, trials: Sequence[Trial]) -> list[Row]:
    """Return the results of each trial; one that raises yields a row with the
    reason.
    """
    rig = _prepared(job)
    run = importlib.import_module(job.trial).run_trial
    rows = []
    for trial in trials:
        begin = time.perf_counter()
        try:
            rows.append(dict(run(job.robot, trial, rig)))
        except (Exception, SystemExit) as error:
            rows.append(
                failed_row(_in_words(error))
                | {"wall_time": time.perf_counter() - begin}
            )
    return rows


def plan_trials(job: Job, trials: Sequence[Trial]) -> list[Row]:
    """Put the plans of the trials into the planner's cache; what cannot be planned says
    so when it is run.
    """
    _prepared(job)
    plan = importlib.import_module(job.trial).plan_trial
    for trial in trials:
        try:
            plan(job.robot, trial)
        except (Exception, SystemExit):
            continue
    return [{} for _ in trials]


def _in_words(error: BaseException) -> str:
    said = " ".join(str(error).split())
    return f"{type(error).__name__}: {said}" if said else type(error).__name__


@lru_cache(maxsize=8)
def _prepared(job: Job) -> RigMaker:
    mine = code_digest(job.rig, job.trial, job.own)
    if mine != job.code:
        raise CampaignError(
            f"a worker runs other code ({mine}) than this process ({job.code}); install"
            " the same version on all machines"
        )
    return resolve(job.rig)
