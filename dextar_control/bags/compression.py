"""Files and messages that were compressed as a whole, beside MCAP's own compression."""

from __future__ import annotations

from pathlib import Path

import zstandard

from dextar_control.contract.errors import BagError

SUFFIXES = (".zstd", ".zst")  # rosbag2 writes the first
ZSTD = b"\x28\xb5\x2f\xfd"
OTHERS = {
    b"\x1f\x8b": ("gzip", "gunzip"),
    b"BZh": ("bzip2", "bunzip2"),
    b"\xfd7zXZ\0": ("xz", "unxz"),
    b"\x04\x22\x4d\x18": ("lz4", "unlz4"),
}
PIECE = 1 << 20  # bytes


def plain_name(name: str) -> str:
    """Return a file's name without the suffix that tells that it is compressed."""
    return next(
        (name.removesuffix(suffix) for suffix in SUFFIXES if name.endswith(suffix)),
        name,
    )


def refuse_compressed(file: Path, start: bytes) -> None:
    """Refuse a file that is compressed in a way that rosbag2 does not use.

    Args:
        file: that was opened.
        start: its first bytes.

    Raises:
        BagError: it is; the message says how to unpack it.
    """
    for magic, (kind, command) in OTHERS.items():
        if start.startswith(magic):
            raise BagError(
                f"{file} is not an MCAP file but one compressed with {kind}: unpack it"
                f" ({command} {file.name})"
            )


def unpack(file: Path, target: Path) -> None:
    """Unpack a zstd file as far as it goes: of a file that breaks off, what is before
    its end.

    Raises:
        OSError: it cannot be read or written.
    """
    with file.open("rb") as source, target.open("wb") as sink:
        reader = zstandard.ZstdDecompressor().stream_reader(
            source, read_across_frames=True
        )
        try:
            while piece := reader.read(PIECE):
                sink.write(piece)
        except zstandard.ZstdError:
            return


def unpack_message(data: bytes) -> bytes | None:
    """Unpack a message that rosbag2 compressed by itself; None where it is damaged."""
    frame = zstandard.ZstdDecompressor().decompressobj()
    try:
        content = frame.decompress(data)
    except zstandard.ZstdError:
        return None
    return content if frame.eof else None
