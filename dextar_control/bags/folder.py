"""Which files of a folder are one bag, in which order, and how each is opened."""

from __future__ import annotations

import contextlib
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import yaml

from dextar_control.bags.compression import (
    SUFFIXES,
    ZSTD,
    plain_name,
    refuse_compressed,
    unpack,
)
from dextar_control.bags.damage import Hole
from dextar_control.bags.scan import MAGIC, Scan
from dextar_control.contract.errors import BagError

METADATA_FILE = "metadata.yaml"
METADATA_ROOT = "rosbag2_bagfile_information"
OVERLAP = 1_000_000_000  # ns by which the log times of a split bag's files may overlap
SQLITE = b"SQLite format 3\0"
SQLITE_SUFFIX = ".db3"  # by which rosbags knows such a file
# As recorders put it at the end of a file's name: 2026_01_30-12_00_00,
# 20260130T120000Z, 2026-01-30T12-00-00.
_TIME = re.compile(r"_*\d{4}[-_]?\d{2}[-_]?\d{2}[-_T]?\d{2}[-_]?\d{2}[-_]?\d{2}Z?$")


class Opened(NamedTuple):
    """A file of a bag that is open to be read.

    Attributes:
        file: as it is named.
        content: where its content lies: the file itself, or what was unpacked from it.
        storage: MAGIC or SQLITE.
    """

    file: Path
    content: Path
    storage: bytes


@contextlib.contextmanager
def opened(files: Sequence[Path]) -> Iterator[list[Opened]]:
    """Open the files of a bag; those that are compressed with zstd are unpacked into
    TMPDIR for as long as they are open.

    Raises:
        BagError: one is empty, compressed in another way, or neither MCAP nor sqlite3.
        OSError: one cannot be read or unpacked.
    """
    with contextlib.ExitStack() as stack:
        found = []
        for file in files:
            if file.exists() and not file.is_file():
                raise BagError(
                    f"{file} is a pipe or a device, and a bag is not read in one go:"
                    " copy it into a file first"
                )
            content, start = file, _start(file)
            if not start:
                raise BagError(f"{file} is empty")
            packed = start.startswith(ZSTD)
            if packed or (start.startswith(SQLITE) and file.suffix != SQLITE_SUFFIX):
                folder = stack.enter_context(
                    tempfile.TemporaryDirectory(prefix="dextar-")
                )
                content = Path(folder) / f"content{SQLITE_SUFFIX}"
                if packed:
                    start = _unpacked(file, content)
                else:
                    content.symlink_to(file.absolute())
            storage = next(
                (magic for magic in (MAGIC, SQLITE) if start.startswith(magic)), None
            )
            if storage is None:
                refuse_compressed(file, start)
                raise BagError(f"{file} is not an MCAP file, nor a sqlite3 bag")
            found.append(Opened(file, content, storage))
        yield found


def _unpacked(file: Path, content: Path) -> bytes:
    """Unpack a file and return its first bytes."""
    try:
        unpack(file, content)
    except OSError as error:
        why = error.strerror or error
        raise BagError(
            f"cannot unpack {file} into {tempfile.gettempdir()} (set TMPDIR to name"
            f" another): {why}"
        ) from error
    if start := _start(content):
        return start
    raise BagError(
        f"{file} is compressed with zstd and breaks off or is damaged before its first"
        " bytes"
    )


def _start(file: Path) -> bytes:
    with file.open("rb") as stream:
        return stream.read(len(SQLITE))


class BagFiles(NamedTuple):
    """The files of a folder that are one bag.

    Attributes:
        files: all that are there, in order.
        listed: those that ``metadata.yaml`` lists; empty where there is none, or where
            one of these is not there.
        fault: what is wrong with ``metadata.yaml``; "" nothing.
    """

    files: list[Path]
    listed: list[Path]
    fault: str


def files_of(folder: Path) -> BagFiles:
    """Find the files of a folder that are one bag: those that its ``metadata.yaml``
    lists, with others of that bag, or all there are.

    Raises:
        BagError: there is none, or there are several and their names are not those of
            one bag.
        OSError: ``metadata.yaml`` cannot be read.
    """
    there = [
        file
        for kind in ("mcap", "db3")
        for suffix in ("", *SUFFIXES)
        for file in folder.glob(f"*.{kind}{suffix}")
    ]
    fault, listed = f"there is no {METADATA_FILE}", list[Path]()
    if (folder / METADATA_FILE).is_file():
        try:
            listed = [folder / name for name in read_listing(folder).names]
            fault = "" if listed else f"{METADATA_FILE} lists no file"
        except BagError as error:
            fault = str(error)
    missing = [file for file in listed if not file.is_file()]
    more = sorted(
        file for file in there if file not in listed and of_one_bag(file, listed)
    )
    if missing:
        fault = (
            f"{METADATA_FILE} lists {_names(missing)}, which"
            f" {'is' if len(missing) == 1 else 'are'} not there"
        )
    elif more:
        fault = f"{METADATA_FILE} does not list {_names(more)}"
    if not fault:
        return BagFiles(listed, listed, "")
    own = [*(file for file in listed if file not in missing), *more] or there
    files = in_order(own)
    if not files:
        one = (
            f"{len(own)} files of different bags; name one of them"
            if own
            else "no .mcap or .db3 file"
        )
        raise BagError(f"folder {folder} holds {one}")
    return BagFiles(files, [] if missing else listed, fault)


def _names(files: Sequence[Path]) -> str:
    return ", ".join(file.name for file in files)


def patterns(file: Path) -> dict[str, int]:
    """List the patterns of a split bag's names that a file's name fits, with ``#`` for
    the number, and its number in each.

    ``run_3.mcap`` is of ``run_#``, and rosbag2's later
    ``3_run_2026_01_30-12_00_00.mcap`` (number, name, time) of ``#_run``. A time behind
    the number is that of the file alone.
    """
    stem = Path(plain_name(file.name)).stem
    bare = _TIME.sub("", stem)
    found = {}
    for text in dict.fromkeys((bare, stem)):
        name, _, last = text.rpartition("_")
        if name and last.isdecimal() and not (text == stem != bare):
            found[f"{name}_#"] = int(last)
        first, _, name = text.partition("_")
        if first.isdecimal() and (name or text != stem):
            found[f"#_{name}"] = int(first)
    return found


def in_order(files: Sequence[Path]) -> list[Path] | None:
    """Put the files of one bag in the order of their numbers; None where their names
    are neither those of one split bag nor a single file's.
    """
    if len(files) <= 1:
        return list(files)
    read = [patterns(file) for file in files]
    for pattern in read[0]:
        numbers = [names.get(pattern) for names in read]
        if None not in numbers and len(set(numbers)) == len(files):
            return [
                file
                for _, file in sorted(
                    zip(numbers, files, strict=True), key=lambda pair: pair[0] or 0
                )
            ]
    return None


def of_one_bag(file: Path, others: Sequence[Path]) -> bool:
    """Tell whether a file's name is that of some other files' bag, in their format."""

    def known_as(file: Path) -> set[tuple[str, str]]:
        name = plain_name(file.name)
        return {
            (Path(name).suffix, pattern) for pattern in (*patterns(file),) or (name,)
        }

    return any(known_as(file) & known_as(other) for other in others)


class Listing(NamedTuple):
    """What ``metadata.yaml`` says of a bag.

    Attributes:
        names: of its files, as they are found in the folder.
        document: everything it says, by rosbag2's keys.
    """

    names: list[str]
    document: Mapping[str, object]


def read_listing(folder: Path) -> Listing:
    """Read what ``metadata.yaml`` says of the bag in its folder.

    Raises:
        BagError: it is no metadata.yaml of rosbag2.
        OSError: it cannot be read.
    """
    listing = folder / METADATA_FILE
    try:
        document = yaml.safe_load(listing.read_text(encoding="utf-8"))[METADATA_ROOT]
        names = [
            _there(folder, Path(name).name) for name in document["relative_file_paths"]
        ]
    except (
        yaml.YAMLError,
        RecursionError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
    ) as error:
        raise BagError(f"{METADATA_FILE} is none of rosbag2") from error
    return Listing(names, document)


def _there(folder: Path, name: str) -> str:
    """Return the name of a listed file; where only its unpacked or compressed content
    is there, the name of that.
    """
    plain = plain_name(name)
    others = (plain, *(f"{plain}{suffix}" for suffix in SUFFIXES))
    return next(
        (other for other in (name, *others) if (folder / other).is_file()), name
    )


def check_one_recording(scans: Sequence[Scan]) -> None:
    """Check that files are of one recording where only their names say so: it began
    once, and goes on from file to file.

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
            why = (
                f"the first ends {((one.last or 0) - (next_one.first or 0)) * 1e-9:.3f}"
                " s after the second begins"
            )
        if why:
            raise BagError(
                f"{one.path} and {next_one.path} are of different recordings: {why};"
                " name one of them"
            )


def holes_of(scans: Sequence[Scan]) -> tuple[list[Hole], str | None]:
    """Find the holes of a bag in its files.

    Args:
        scans: of files that were read, in order.

    Returns:
        What is missing between their messages, and the file whose end is missing where
        nothing comes after it, else None.
    """
    holes: list[Hole] = []
    waiting: list[Hole] = []  # without messages after them
    last: int | None = None
    for scan in scans:
        known = (*scan.inherited, *scan.holes)
        found = [
            replace(hole, first=last if hole.first is None else hole.first)
            for hole in known
        ]
        if (scan.cut or not scan.whole) and not (found and found[-1].last is None):
            found.append(
                Hole(str(scan.path), 0, last if scan.last is None else scan.last)
            )
        if scan.first is not None:
            for hole in waiting:
                hole.last = scan.first
            holes, waiting, last = holes + waiting, [], scan.last
        for hole in found:
            (waiting if hole.last is None else holes).append(hole)
    return holes + [hole for hole in waiting if hole.chunks], (
        waiting[-1].file if waiting else None
    )
