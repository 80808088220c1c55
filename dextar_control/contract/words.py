"""Numbers are told with the nouns that they count."""

from __future__ import annotations


def counted(number: int, noun: str) -> str:
    """Return ``1 crossing`` or ``2 crossings``; a noun of more words must end in the
    one that is counted.
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
