"""The compiler behind the core: readable NumPy functions, compiled once by numba and cached.

numba keys its cache by the file of the compiled function, not by what that function calls, so the
cache folder carries a digest of all of the core's sources that hold compiled functions: no call ever
runs stale code.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

_HERE = Path(__file__).resolve().parent


def _cache_folder() -> Path:
    digest = hashlib.sha256()
    for source in sorted(_HERE.glob("*.py")):
        text = source.read_bytes()
        if b"njit" in text:
            digest.update(text)
    name = f"numba-{digest.hexdigest()[:16]}"
    beside = _HERE / "__pycache__"
    if os.access(beside if beside.exists() else _HERE, os.W_OK):
        return beside / name
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "dextar" / name


if "NUMBA_CACHE_DIR" not in os.environ:
    setattr(numba.config, "CACHE_DIR", str(_cache_folder()))  # noqa: B010  numba sets its options at run time


def njit(function: Function) -> Function:
    """Compile without the interpreter (and its lock); a division by zero gives inf or nan as in NumPy."""
    return cast(Function, numba.njit(cache=True, error_model="numpy", nogil=True)(function))
