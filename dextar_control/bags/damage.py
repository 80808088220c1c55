"""What a damaged or cut-off bag lacks: one sentence, without its stop, for each kind of
damage.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dextar_control.contract.words import counted


@dataclass
class Hole:
    """Where messages are missing in the middle of a recording, because a file is
    damaged.

    Attributes:
        file: by its path, or its name alone.
        chunks: damaged ones; 0 where the end of the file is missing, or its records
            lost their order.
        first, last: log times, ns, of the messages before and after it; None where
            there is none.
        begin, end: stamps, ns, between which a state or its answers may be missing;
            None where no state is on that side, or where they were not looked for.
    """

    file: str
    chunks: int
    first: int | None
    last: int | None = None
    begin: int | None = None
    end: int | None = None

    def meets(self, begin: float, end: float) -> bool:
        """Tell whether something between two stamps, ns, may be missing."""
        return (self.begin is None or self.begin < end) and (
            self.end is None or self.end > begin
        )


@dataclass(frozen=True)
class Unreadable:
    """Messages of a needed topic that cannot be decoded.

    Attributes:
        count: of these messages.
        messages: all of the topic.
        reason: what is wrong with the first of them.
    """

    count: int
    messages: int
    reason: str


def hole_in_words(hole: Hole) -> str:
    """Say where a bag has a hole, and how long it is."""
    what = counted(hole.chunks, "damaged chunk") if hole.chunks else "the missing end"
    if hole.first is None or hole.last is None:
        length = f"{'before' if hole.first is None else 'after'} all other messages"
    else:
        length = f"for {(hole.last - hole.first) * 1e-9:.3f} s"
    return f"no message is left of {what} of {hole.file}, {length}"


def missing_end_in_words(
    file: str = "the bag", unit: str = "chunk", *, recovered: bool = False
) -> str:
    """Say that the end of a file is missing; ``recovered``, that it was made from one
    whose end was.
    """
    was = (
        "was recovered from a file that breaks off or" if recovered else "breaks off or"
    )
    return f"{file} {was} is damaged: read up to its last complete {unit}"


def unreadable_lines(unreadable: Mapping[str, Unreadable]) -> list[str]:
    """Say what could not be decoded, a line for each topic."""
    return [
        f"{one.count} of {counted(one.messages, 'message')} on {topic} cannot be read"
        f" and count as not recorded: {one.reason}"
        for topic, one in unreadable.items()
    ]


def damage_lines(
    holes: Sequence[Hole], truncated: bool, unreadable: Mapping[str, Unreadable]
) -> list[str]:
    """Say all that a bag lacks, a line for each damage."""
    return [
        *map(hole_in_words, holes),
        *[missing_end_in_words()] * truncated,
        *unreadable_lines(unreadable),
    ]
