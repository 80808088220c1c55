"""Classes that a campaign file names."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from dextar_control.contract.errors import ParameterError


def resolve(name: str) -> Any:
    """What ``module:attribute`` names.

    Raises:
        ParameterError: there is no such module or attribute.
    """
    module, _, attribute = name.partition(":")
    if not module or not attribute:
        raise ParameterError(f"rig '{name}'; it must be of the form module:Class")
    try:
        with _quiet():
            return getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ParameterError(f"rig '{name}' cannot be loaded: {error}") from error


@contextmanager
def _quiet() -> Iterator[None]:
    """What a compiled library says on standard error while it is loaded goes
    nowhere.
    """
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
