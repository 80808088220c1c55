"""Run one row of a campaign again."""

from __future__ import annotations

from pathlib import Path

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.plain_data import as_plain
from dextar_control.contract.terminal import Terminal
from dextar_control.experiments.campaign.run import Campaign
from dextar_control.experiments.campaign.store import read_rows
from dextar_control.experiments.campaign.worker import run_trials

# results that differ from run to run
TIMES = {"wall_time", "cpu_time", "planning_time"}


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
