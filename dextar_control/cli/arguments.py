"""Commands share these arguments and the ranges of their numbers."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path


def number(
    low: float, high: float, unit: str = "", *, above: bool = False
) -> Callable[[str], float]:
    """Return what reads a number of an argument.

    Args:
        low, high: inclusive bounds.
        unit: of the number, for the message.
        above: whether the lower bound itself is refused.
    """

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high or (above and value == low):
            span = (
                f"be above {low:g} and at most {high:g}"
                if above
                else f"lie in {low:g} to {high:g}"
            )
            raise argparse.ArgumentTypeError(
                f"{text}; it must {span}{unit and f' {unit}'}"
            )
        return value

    return read


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return what reads a whole number of an argument, between inclusive bounds."""

    def read(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(
                f"{text}; it must be a whole number from {low} to {high}"
            )
        return int(text)

    return read


def add_bag(
    parser: argparse.ArgumentParser, what: str = "run", several: str | None = None
) -> None:
    """Add the argument that names one bag, or several where the words after its help
    say so.
    """
    nargs = None if several is None else "+"
    text = f"an .mcap file, or the {what}'s folder{several or ''}"
    parser.add_argument("bag", type=Path, nargs=nargs, help=text)


def add_output(
    parser: argparse.ArgumentParser,
    text: str,
    default: Path | None = None,
    metavar: str = "DIR",
) -> None:
    """Add ``--output``, the place of what the command writes."""
    parser.add_argument(
        "--output", type=Path, default=default, metavar=metavar, help=text
    )
