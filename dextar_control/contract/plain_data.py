"""Data as JSON knows it."""

from __future__ import annotations

import math
from typing import Any


def as_plain(value: Any) -> Any:
    """Mappings, lists and Python's own numbers, with None for each number that is not
    finite; numpy's become Python's.
    """
    if isinstance(value, dict):
        return {key: as_plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_plain(item) for item in value]
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value
