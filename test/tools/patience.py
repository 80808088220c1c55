"""How long a test waits for what must happen. Nothing is timed by it: it only ends a
test that waits in vain, and a busy machine takes many times as long as an idle one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

PATIENCE = 180.0  # s


def until(
    condition: Callable[[], Any],
    what: str | Callable[[], str],
    act: Callable[[], Any] = lambda: time.sleep(0.02),
) -> None:
    """Do ``act`` until something holds; ``what`` says what is waited for, and what to
    look at where that is in vain.
    """
    deadline = time.monotonic() + PATIENCE
    while not condition():
        act()
        assert time.monotonic() < deadline, (
            f"waited {PATIENCE:.0f} s for {what if isinstance(what, str) else what()}"
        )
