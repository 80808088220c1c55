"""Whether the streams of a bag belong to one run."""

from __future__ import annotations

import numpy as np

from dextar_control.analysis.run import Run, Stamps
from dextar_control.contract import topics
from dextar_control.contract.errors import BagError

BLOCK = 4096  # stamps looked at together


def check_run(run: Run) -> None:
    """Check that the streams that answer the states carry their stamps.

    Raises:
        BagError: not one stamp of a stream is one of the states'.
    """
    streams = {
        topics.JOINT_COMMANDS.name: run.commands.stamps,
        topics.CONTROLLER_STATE.name: run.control.stamps,
        topics.CRITERION.name: run.criterion.stamps,
    }
    if run.truth is not None:
        streams[topics.SIM_END_EFFECTOR.name] = run.truth.stamps
    for name, stamps in streams.items():
        if len(stamps) and not _has_one_of(run.states.stamps, stamps):
            raise BagError(
                f"{run.path}: none of the {len(stamps)} stamps of {name} is one of the"
                f" {len(run.states.stamps)} of {topics.JOINT_STATES.name}: these are"
                " streams of different runs, or of different clocks"
            )


def _has_one_of(known: Stamps, stamps: Stamps) -> bool:
    """Tell whether one of the stamps is among the known ones, (n,) rising."""
    for first in range(0, len(stamps), BLOCK):
        part = stamps[first : first + BLOCK]
        if (
            known[np.minimum(np.searchsorted(known, part), len(known) - 1)] == part
        ).any():
            return True
    return False
