"""Which files of a folder are one bag, in which order."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from dextar_control.bags.records import Hole, Scan
from dextar_control.contract.errors import BagError

METADATA_FILE = "metadata.yaml"
METADATA_ROOT = "rosbag2_bagfile_information"
OVERLAP = 1_000_000_000  # ns by which the log times of a split bag's files may overlap


def split_name(file: Path) -> tuple[str, int]:
    """(name, number) of a split bag's file, ``run_3.mcap``; the number is -1 where it has none."""
    name, _, last = file.stem.rpartition("_")
    return (name, int(last)) if name and last.isdecimal() else (file.stem, -1)


def in_order(files: Sequence[Path]) -> list[Path]:
    """Files of a split bag by their numbers."""
    return sorted(files, key=lambda file: (split_name(file)[1], file.name))


def one_bag_by_name(files: Sequence[Path]) -> bool:
    """Whether the names are those of one bag: a single file, or the files of a split one."""
    names = {split_name(file)[0] for file in files}
    return len(files) == 1 or (len(names) == 1 and all(split_name(file)[1] >= 0 for file in files))


def read_listing(folder: Path) -> dict[str, Any]:
    """What ``metadata.yaml`` says of the bag in its folder: at least ``relative_file_paths``, a list of names.

    Raises:
        BagError: it is no metadata.yaml of rosbag2.
        OSError: it cannot be read.
    """
    listing = folder / METADATA_FILE
    try:
        document = yaml.safe_load(listing.read_text(encoding="utf-8"))[METADATA_ROOT]
        names = [Path(name).name for name in document["relative_file_paths"]]
    except (yaml.YAMLError, RecursionError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise BagError(
            f"{listing} is no {METADATA_FILE} of rosbag2; the .mcap file beside it may be given instead, or dextar recover"
            " writes a new one"
        ) from error
    return {**document, "relative_file_paths": names}


def check_one_recording(scans: Sequence[Scan]) -> None:
    """Files that only their names hold together are of one recording: it began once, and goes on from file to file.

    Args:
        scans: of files that were read, in order.

    Raises:
        BagError: two of them are of different recordings.
    """
    filled = [scan for scan in scans if scan.first is not None]
    for one, next_one in zip(filled, filled[1:], strict=False):
        why = ""
        if one.started and next_one.started and one.started != next_one.started:
            why = f"the one began at {one.started}, the other at {next_one.started}"
        elif (one.last or 0) - (next_one.first or 0) > OVERLAP:
            why = f"the first ends {((one.last or 0) - (next_one.first or 0)) * 1e-9:.3f} s after the second begins"
        if why:
            raise BagError(f"{one.path} and {next_one.path} are of different recordings: {why}; name one of them")


def holes_of(scans: Sequence[Scan]) -> tuple[list[Hole], Path | None]:
    """(what is missing between the messages of a bag's files, the file whose end is missing where nothing comes after it)."""
    holes: list[Hole] = []
    waiting: list[Hole] = []  # without messages after them
    last: int | None = None
    for scan in scans:
        known = (*scan.inherited, *scan.holes)
        found = [Hole(hole.path, hole.chunks, last if hole.first is None else hole.first, hole.last) for hole in known]
        if (scan.cut or not scan.whole) and not (found and found[-1].last is None):
            found.append(Hole(scan.path, 0, last if scan.last is None else scan.last))
        if scan.first is not None:
            for hole in waiting:
                hole.last = scan.first
            holes, waiting, last = holes + waiting, [], scan.last
        for hole in found:
            (waiting if hole.last is None else holes).append(hole)
    return holes + [hole for hole in waiting if hole.chunks], waiting[-1].path if waiting else None
