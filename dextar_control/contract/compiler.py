"""The compiler behind what must be fast: readable NumPy functions, compiled once by numba and cached.

numba keys its cache by the file of the compiled function, not by what that function calls, so the cache folder carries a digest
of all sources of a package that hold compiled functions: no call ever runs stale code. It lies beside the sources, or where
``caches`` finds a place; a cache beside the sources that can only be read is copied there. Without any, or on a full disk, each
process compiles anew.
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

_COSTS = "it is compiled anew at each start, in a minute or more"
_told: set[str] = set()


def compiler(package: Path, marker: str, **options: Any) -> Callable[[Function], Function]:
    """A decorator that compiles without the interpreter (and its lock).

    Args:
        package: folder of the sources.
        marker: a word in each source that holds compiled functions, and in no other.
        options: of numba.
    """
    folder = _cache_folder(package, marker)

    def compiled(function: Function) -> Function:
        dispatcher = numba.njit(nogil=True, **options)(function)
        if folder is not None:
            setattr(numba.config, "CACHE_DIR", str(folder))  # noqa: B010  numba sets its options at run time
            try:
                dispatcher.enable_caching()
                dispatcher._cache = _Forgiving(dispatcher._cache)
            except (OSError, RuntimeError) as error:
                _tell(f"the compiled model cannot be kept in {folder} ({error}), so {_COSTS}")
        return cast(Function, dispatcher)

    return compiled


def _tell(text: str) -> None:
    """One line on the error output, once."""
    if text not in _told:
        _told.add(text)
        print(f"dextar: {text}", file=sys.stderr, flush=True)


def _cache_folder(package: Path, marker: str) -> Path | None:
    digest = hashlib.sha256()
    for source in sorted(package.glob("*.py")):
        text = source.read_bytes()
        if marker.encode() in text:
            digest.update(text)
    name = f"numba-{digest.hexdigest()[:16]}"
    beside = package / "__pycache__" / name
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
            _tell(f"the compiled model cannot be kept in {self._cache.cache_path} ({error}), so {_COSTS}")
