"""What a name stands for: one of ours, or ``module:attribute`` of the user's own code,
which Python has to find (PYTHONPATH).
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping
from typing import TypeVar, cast

from dextar_control.contract.errors import ParameterError

Thing = TypeVar("Thing")
OWN = re.compile(r"([A-Za-z_]\w*)(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")
FORM = "module:attribute of your own"


def is_own(name: str) -> bool:
    """Return whether a name has the form of one's own: ``module:attribute``."""
    return OWN.fullmatch(name) is not None


def short_name(name: str) -> str:
    """Return a name without its module."""
    return name.rpartition(":")[2]


def chosen(what: str, name: str, ours: Mapping[str, Thing]) -> Thing:
    """One of ours by its name, or what ``module:attribute`` names.

    Args:
        what: is chosen, for messages.
        name: of it.
        ours: by their names.

    Raises:
        ParameterError: there is none of that name (it says which there are), or the
            module cannot be loaded.
    """
    if name in ours:
        return ours[name]
    if not is_own(name):
        raise ParameterError(f"{what} = {name!r}; it must be {one_of(ours)}")
    module, _, attribute = name.partition(":")
    try:
        found: object = getattr(importlib.import_module(module), attribute)
    except Exception as error:  # of code that is not ours
        absent = isinstance(error, ModuleNotFoundError)
        how = "; PYTHONPATH has to name the folder that it is in" if absent else ""
        raise ParameterError(
            f"{what} = {name!r} cannot be loaded: {type(error).__name__}: {error}{how}"
        ) from error
    if not callable(found):
        raise ParameterError(
            f"{what} = {name!r} is of type {type(found).__name__}; it must be a"
            " function or a class"
        )
    return cast(Thing, found)


def one_of(ours: Mapping[str, Thing] | tuple[str, ...]) -> str:
    """Which names there are, in words."""
    return f"one of {', '.join(ours)}, or {FORM}" if ours else FORM
