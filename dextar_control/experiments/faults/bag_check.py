"""Check that a bag can be read up to its last complete chunk, by this package's reader
and by mcap's.
"""

from __future__ import annotations

from pathlib import Path

from mcap.reader import NonSeekingReader

from dextar_control.bags.scan import MAGIC, PER_MESSAGE, Messages, Scan


def finished(path: Path) -> bool:
    """Tell whether the file ends as a whole one does."""
    return _scan(path)[0].whole


def unreadable(path: Path) -> list[str]:
    """Write one line when the bag does not begin as one or cannot be read up to its
    last complete chunk.
    """
    try:
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                return [f"{path.name} does not begin as an MCAP file"]
        (scan, ours), theirs = _scan(path), _read(path)
    except OSError as error:
        return [f"{path.name}: {error.strerror or error}"]
    if scan.damaged or ours != theirs:
        return [
            f"{path.name}: {scan.damaged} chunks are damaged; of {ours} messages in the"
            f" others mcap's reader gives {theirs}"
        ]
    return []


def _scan(path: Path) -> tuple[Scan, int]:
    scan = Scan(path)
    return scan, sum(
        len(found.numbers) // PER_MESSAGE
        for found in scan.records()
        if isinstance(found, Messages)
    )


def _read(path: Path) -> int:
    """Count the messages that mcap's reader gives before the file's end, or before it
    breaks off.
    """
    messages = 0
    with path.open("rb") as file:
        # cut off, or broken in any way: how far it was read is what counts
        try:
            for _ in NonSeekingReader(file).iter_messages(log_time_order=False):
                messages += 1
        except Exception:
            pass
    return messages
