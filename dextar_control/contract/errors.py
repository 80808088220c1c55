"""The package raises these errors for a caller's mistake."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class DextarError(Exception):
    """Root of the package's errors; its text is one sentence that names the value and
    the limit.

    Args:
        text: the sentence.
        instead: values that would do, by the names of those that do not.
    """

    def __init__(self, *text: object, **instead: object) -> None:
        super().__init__(*text)
        self.instead = instead


class ParameterError(DextarError):
    """A parameter is missing, unknown or out of its range."""


class GeometryError(DextarError):
    """A configuration does not exist, or is too close to one that does not."""


class TrajectoryError(DextarError):
    """A trajectory breaks the crossing criterion, the workspace or a limit."""


class StateError(DextarError):
    """A joint state or command cannot be used: names, sizes, non-finite numbers."""


class BagError(DextarError):
    """A recording cannot be written or read."""


class CampaignError(DextarError):
    """A campaign's folder, workers or scheduler cannot be used."""


class NodesError(DextarError):
    """Nodes are not there, do not answer, or did not do what was asked of them; the
    message says which, and why or what to do.
    """


class CalibrationError(DextarError):
    """Recordings do not tell what was asked of them, or contradict it."""


def lacking(what: str, extra: str, error: ImportError) -> ParameterError:
    """Return the error that tells which optional library is missing and how to install
    it.

    Args:
        what: needs it.
        extra: of setup.py, that brings it.
        error: of its import.
    """
    how = (
        f"install it by make setup EXTRAS={extra}, or pip install '.[{extra}]', in the"
        " source folder"
    )
    return ParameterError(
        f"{what} needs the package {error.name or extra}, which cannot be imported:"
        f" {how} ({error})"
    )


@contextmanager
def bag_errors(doing: str) -> Iterator[None]:
    """Turn what the operating system refuses into a sentence.

    Args:
        doing: what is done, such as ``write run.csv``.

    Raises:
        BagError: it cannot be done.
    """
    try:
        yield
    except OSError as error:
        raise BagError(f"cannot {doing}: {error.strerror or error}") from error
