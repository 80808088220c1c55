"""Caches and logs lie in folders whose content may be lost. Where none can be written
the package works without, and says so.

The first folder that can be written is taken: the one that is asked for,
``$XDG_CACHE_HOME/dextar`` (``~/.cache/dextar``), or a folder in the temporary one that
is this user's alone.
"""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from dextar_control.contract.errors import ParameterError


def cache_folder(name: str, *preferred: Path) -> Path | None:
    """Return a folder that can be written, made where it does not exist; None where
    there is none.

    Args:
        name: of the cache.
        preferred: folders to try first.
    """
    return next(
        (folder for folder in (*preferred, *_folders(name)) if writable(folder)), None
    )


def writable(folder: Path) -> bool:
    """Return whether a file can be made in a folder, which is made where it does not
    exist.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"0")
            file.flush()
    except (OSError, ValueError):
        return False
    return True


def check_file(file: Path, option: str) -> None:
    """Refuse a file that cannot be written, before anything is done for it; what is
    there stays as it is.

    Args:
        file: to be written later.
        option: of the command line, that names it.

    Raises:
        ParameterError: says why, and what to name instead.
    """
    new = not file.exists()
    try:
        with file.open("ab"):
            pass
        if new:
            file.unlink()
    except (OSError, ValueError) as error:
        raise ParameterError(
            f"{option} {file} cannot be written:"
            f" {getattr(error, 'strerror', None) or error}; name a file in a folder"
            " that can"
        ) from error


def home() -> Path | None:
    """Return the user's home; None where the user has none."""
    try:
        return Path.home()
    except RuntimeError:
        return None


def prepare_environment() -> None:
    """Give matplotlib's settings and the nodes' logs a folder where theirs cannot be
    made, for this process and its children.
    """
    own = home() or Path("/nonexistent")
    config, cache, ros = (
        Path(os.environ.get(variable) or own / usual)
        for variable, usual in (
            ("XDG_CONFIG_HOME", ".config"),
            ("XDG_CACHE_HOME", ".cache"),
            ("ROS_HOME", ".ros"),
        )
    )
    _fall_back(
        "MPLCONFIGDIR", "matplotlib", config / "matplotlib", cache / "matplotlib"
    )
    _fall_back("ROS_LOG_DIR", "ros-logs", ros / "log")


def _fall_back(variable: str, name: str, *usual: Path) -> None:
    if os.environ.get(variable) or all(map(_can_be_made, usual)):
        return
    folder = cache_folder(name)
    if folder is not None:
        os.environ[variable] = str(folder)


def _can_be_made(folder: Path) -> bool:
    """Return whether a folder that another program would make could be made and
    written.
    """
    try:
        there = next(
            place
            for place in (folder, *folder.parents)
            if place.exists() or place.is_symlink()
        )
        return there.is_dir() and os.access(there, os.W_OK | os.X_OK)
    except OSError:
        return False


def _folders(name: str) -> Iterator[Path]:
    given, own = os.environ.get("XDG_CACHE_HOME"), home()
    if given:
        yield Path(given) / "dextar" / name
    elif own is not None:
        yield own / ".cache" / "dextar" / name
    private = _private()
    if private is not None:
        yield private / name


def _private() -> Path | None:
    """Return this user's own folder in the temporary one; None where somebody else made
    it or may write there.
    """
    try:
        folder = Path(tempfile.gettempdir()) / f"dextar-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return None
    ours = (
        stat.S_ISDIR(status.st_mode)
        and status.st_uid == os.getuid()
        and not status.st_mode & 0o077
    )
    return folder if ours else None
