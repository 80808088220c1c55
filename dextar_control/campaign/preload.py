"""Loaded by each worker process of this machine before it works."""

from __future__ import annotations

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C to the process that the user started: it ends its workers itself."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
