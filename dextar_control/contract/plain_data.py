"""Data that come from files and from ROS have these types, and JSON knows data in this
form.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeAlias, cast, overload

Plain: TypeAlias = "None | bool | int | float | str | list[Plain] | dict[str, Plain]"
"""What a JSON or YAML document holds."""
# A parameter has the type of its default in a YAML file, which no type checker reads.
ParameterValue: TypeAlias = Any  # type: ignore[explicit-any]
"""A node parameter's value: bool, int, float, str or a list of one of these."""


@overload
def as_plain(value: Mapping[str, object]) -> dict[str, Plain]: ...
@overload
def as_plain(value: object) -> Plain: ...
def as_plain(value: object) -> Plain:
    """Return mappings, lists and Python's own numbers, with None for each number that
    is not finite; numpy's numbers become Python's.
    """
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: as_plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return cast(Plain, value)
