"""Message definitions and type hashes of installed ROS packages, as a bag carries
them.
"""

from __future__ import annotations

import functools
import json
import os
import re
import sys
from pathlib import Path

from dextar_control.contract.errors import BagError

SEPARATOR = "=" * 80
_FIELD_TYPE = re.compile(
    r"^\s*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+\w+", re.MULTILINE
)
_PRIMITIVES = frozenset(
    "bool byte char float32 float64 int8 uint8 int16 uint16 int32 uint32 int64 uint64"
    " string wstring".split()
)


def share_folders() -> list[Path]:
    """List every ``share`` folder that may hold message packages: those of
    AMENT_PREFIX_PATH first, then this Python's.
    """
    prefixes = [
        prefix
        for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
        if prefix
    ]
    return [Path(prefix) / "share" for prefix in [*prefixes, sys.prefix]]


def _interface_file(type_name: str, suffix: str) -> Path:
    try:
        package, kind, name = type_name.split("/")
    except ValueError:
        raise BagError(
            f"message type '{type_name}'; it must read package/msg/Type"
        ) from None
    for share in share_folders():
        path = share / package / kind / f"{name}{suffix}"
        if path.is_file():
            return path
    searched = ", ".join(map(str, share_folders()))
    raise BagError(
        f"no {name}{suffix} of message type '{type_name}' in any of: {searched}"
    )


def dependencies(type_name: str, text: str) -> list[str]:
    """List the full names of the message types that a definition uses, in order, each
    once.
    """
    package = type_name.split("/")[0]
    code = "\n".join(line.partition("#")[0] for line in text.splitlines())
    found: dict[str, None] = {}
    for match in _FIELD_TYPE.finditer(code):
        parts = match.group(1).split("/")
        if len(parts) == 1 and parts[0] in _PRIMITIVES:
            continue
        found[f"{package if len(parts) == 1 else parts[0]}/msg/{parts[-1]}"] = None
    return list(found)


@functools.cache
def definition(type_name: str) -> str:
    """Return the concatenated definition (``ros2msg``): the type's own text, then that
    of each dependency, depth first, each once.

    Raises:
        BagError: the package's ``share`` folder is not found.
    """
    seen = {type_name}

    def append(name: str) -> str:
        text = _interface_file(name, ".msg").read_text(encoding="utf-8")
        parts = [text]
        for dependency in dependencies(name, text):
            if dependency not in seen:
                seen.add(dependency)
                package, _, short = dependency.split("/")
                parts.append(
                    f"\n{SEPARATOR}\nMSG: {package}/{short}\n{append(dependency)}"
                )
        return "".join(parts)

    return append(type_name)


@functools.cache
def type_hash(type_name: str) -> str:
    """Return the type's REP-2016 hash, ``RIHS01_...``.

    Raises:
        BagError: the package's ``share`` folder is not found or names no hash.
    """
    path = _interface_file(type_name, ".json")
    for entry in json.loads(path.read_text(encoding="utf-8")).get("type_hashes", []):
        if entry["type_name"] == type_name:
            return str(entry["hash_string"])
    raise BagError(f"{path} names no hash of '{type_name}'")
