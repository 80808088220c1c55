"""Messages of any type with every field filled, and their comparison with what another
reader decoded.
"""

from __future__ import annotations

import dataclasses
import math
import struct
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

TYPES = get_typestore(Stores.ROS2_JAZZY)
SPECIAL = (
    0.0,
    -0.0,
    math.inf,
    -math.inf,
    math.nan,
    5e-324,
    1.7976931348623157e308,
    0.1,
    2.0**53 + 2.0,
)
TEXTS = ("", "q11", "Gelenk über 0.1 µm", "日本語", "a\nb")
RANGES = {
    "int8": (-128, 127),
    "uint8": (0, 255),
    "byte": (0, 127),
    "char": (0, 255),
    "int16": (-(2**15), 2**15 - 1),
    "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
    "int64": (-(2**63), 2**63 - 1),
    "uint64": (0, 2**64 - 1),
}


def random_message(type_name: str, rng: np.random.Generator) -> Any:
    """A message whose numbers may be any bits of their type."""
    fields = {name: _value(kind, rng) for name, kind in TYPES.fielddefs[type_name][1]}
    return TYPES.types[type_name](**fields)


def _value(kind: Any, rng: np.random.Generator) -> Any:
    node, details = kind
    if node == Nodetype.NAME:
        return random_message(details, rng)
    if node == Nodetype.BASE:
        return _base(details[0], rng)
    inner, length = details
    count = length if node == Nodetype.ARRAY else int(rng.integers(0, 4))
    values = [_value(inner, rng) for _ in range(count)]
    if inner[0] == Nodetype.BASE and inner[1][0] != "string":
        name = {"byte": "uint8", "char": "uint8"}.get(inner[1][0], inner[1][0])
        return np.array(values, dtype=name)
    return values


def _base(name: str, rng: np.random.Generator) -> Any:
    if name == "string":
        return TEXTS[rng.integers(len(TEXTS))]
    if name == "bool":
        return bool(rng.integers(2))
    if name == "float64":
        if rng.random() < 0.4:
            return SPECIAL[rng.integers(len(SPECIAL))]
        return struct.unpack("<d", rng.bytes(8))[0]
    if name == "float32":
        return float(np.frombuffer(struct.pack("<f", rng.normal()), "<f4")[0])
    low, high = RANGES[name]
    return (
        int(rng.choice([low, high, 1]))
        if rng.random() < 0.5
        else int(
            rng.integers(
                low,
                high,
                dtype=np.dtype({"byte": "uint8", "char": "uint8"}.get(name, name)),
            )
        )
    )


def difference(mine: Any, theirs: Any, place: str = "") -> str:
    """Where plain data of another reader differs from a message of rosbags; "" nowhere.
    Numbers have to be the same bits.
    """
    if dataclasses.is_dataclass(mine):
        names = [name for name, _ in TYPES.fielddefs[mine.__msgtype__][1]]  # type: ignore[attr-defined]
        if sorted(names) != sorted(theirs):
            return f"{place} has the fields {sorted(theirs)}"
        found = (
            difference(getattr(mine, name), theirs[name], f"{place}.{name}")
            for name in names
        )
        return next(filter(None, found), "")
    if isinstance(mine, np.ndarray):
        mine = mine.tolist()
    if isinstance(mine, list):
        if len(mine) != len(theirs):
            return f"{place} has {len(theirs)} entries, not {len(mine)}"
        pairs = enumerate(zip(mine, theirs, strict=True))
        return next(
            (
                found
                for index, (a, b) in pairs
                if (found := difference(a, b, f"{place}[{index}]"))
            ),
            "",
        )
    if isinstance(mine, float):
        other = float(theirs)
        same = (math.isnan(mine) and math.isnan(other)) or struct.pack(
            "<d", mine
        ) == struct.pack("<d", other)
    elif isinstance(mine, int) and not isinstance(mine, bool):
        same = mine == int(theirs)
    else:
        same = mine == theirs
    return "" if same else f"{place} is {theirs!r}, not {mine!r}"
