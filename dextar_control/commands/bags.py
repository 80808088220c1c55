"""What the commands that read bags share: an argument, and warnings as a user reads them."""

from __future__ import annotations

import argparse
import contextlib
import sys
import warnings
from collections.abc import Iterator


def add_namespace(parser: argparse.ArgumentParser) -> None:
    """The robot's namespace."""
    parser.add_argument(
        "--namespace", metavar="NAME", help="of the robot, where a bag of another recorder holds several, e.g. /left"
    )


@contextlib.contextmanager
def spoken_warnings(command: str) -> Iterator[None]:
    """Print each warning once, as one line on the error output, without the line of code that it comes from."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default", UserWarning)
        try:
            yield
        finally:
            for text in dict.fromkeys(str(warning.message) for warning in caught if issubclass(warning.category, UserWarning)):
                print(f"dextar {command}: {text}", file=sys.stderr)
