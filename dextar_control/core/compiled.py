"""The compiler behind the core: readable NumPy functions, compiled once by numba and cached.

numba keys its cache by the file of the compiled function, not by what that function calls, so the
cache folder carries a digest of all of the core's sources that hold compiled functions: no call ever
runs stale code. It lies beside the sources, or where ``contract.caches`` finds a place; a cache beside
the sources that can only be read is copied there. Without any, or on a full disk, the core is compiled
anew by each process.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

from dextar_control.contract.caches import cache_folder, copy_of

Function = TypeVar("Function", bound=Callable[..., Any])

_HERE = Path(__file__).resolve().parent
_COSTS = "it is compiled anew at each start, in a minute or more"
_told: set[str] = set()


def _tell(text: str) -> None:
    """One line on the error output, once."""
    if text not in _told:
        _told.add(text)
        print(f"dextar: {text}", file=sys.stderr, flush=True)


def _cache_folder() -> Path | None:
    digest = hashlib.sha256()
    for source in sorted(_HERE.glob("*.py")):
        text = source.read_bytes()
        if b"njit" in text:
            digest.update(text)
    name = f"numba-{digest.hexdigest()[:16]}"
    beside = _HERE / "__pycache__" / name
    wanted = os.environ.get("NUMBA_CACHE_DIR")
    folder = cache_folder(name, Path(wanted) if wanted else beside)
    if folder is None:
        _tell(f"no folder for the compiled model can be written, so {_COSTS}; NUMBA_CACHE_DIR may name one")
    elif folder != beside and not wanted:
        for part in beside.glob("*"):
            copy_of(part, folder / part.name)
    return folder


class _Forgiving:
    """numba's cache of one function, which a full disk or a broken file does not turn into an error of the function."""

    def __init__(self, cache: Any) -> None:
        self._cache = cache

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)

    def load_overload(self, *arguments: Any) -> Any:
        """What is kept; nothing where it cannot be read, and then nothing of it is kept."""
        try:
            return self._cache.load_overload(*arguments)
        except Exception:  # a broken pickle raises almost anything
            with contextlib.suppress(OSError):
                self._cache.flush()
            return None

    def save_overload(self, *arguments: Any) -> None:
        """Keep it where that can be done."""
        try:
            self._cache.save_overload(*arguments)
        except OSError as error:
            _tell(f"the compiled model cannot be kept in {numba.config.CACHE_DIR} ({error}), so {_COSTS}")


_FOLDER = _cache_folder()
if _FOLDER is not None:
    setattr(numba.config, "CACHE_DIR", str(_FOLDER))  # noqa: B010  numba sets its options at run time


def njit(function: Function) -> Function:
    """Compile without the interpreter (and its lock); a division by zero gives inf or nan as in NumPy."""
    compiled = numba.njit(error_model="numpy", nogil=True)(function)
    if _FOLDER is not None:
        try:
            compiled.enable_caching()
            compiled._cache = _Forgiving(compiled._cache)
        except (OSError, RuntimeError) as error:
            _tell(f"the compiled model cannot be kept in {_FOLDER} ({error}), so {_COSTS}")
    return cast(Function, compiled)
