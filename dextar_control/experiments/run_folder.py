"""The folder of one run of the demo or of faults."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

from dextar_control.contract.errors import BagError


def make_run_folder(output: Path, prefix: str = "") -> Path:
    """Make a new folder, named after the time in UTC.

    Raises:
        BagError: it cannot be made.
    """
    stamp = prefix + datetime.now(timezone.utc).strftime("%Y%m%dT%H%M%SZ")
    folder, number = output / stamp, 1
    try:
        while folder.exists():
            number += 1
            folder = output / f"{stamp}-{number}"
        folder.mkdir(parents=True)
    except OSError as error:
        raise BagError(
            f"run folder {folder} cannot be made: {error.strerror}; name another with"
            " --output"
        ) from error
    return folder
