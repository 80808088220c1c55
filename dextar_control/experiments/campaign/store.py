"""A campaign's folder: its manifest, its rows, which are appended as they come, and the
columnar file in the end.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import cast

import pyarrow as pa
import pyarrow.parquet as pq

from dextar_control.contract.errors import CampaignError
from dextar_control.contract.plain_data import as_plain
from dextar_control.experiments.campaign.rows import Cell, Row, text

MANIFEST, ROWS, TABLE = "campaign.json", "rows.jsonl", "rows.parquet"


class Store:
    """Holds the folder of one campaign, for one process at a time; a context
    manager.
    """

    def __init__(self, folder: Path, manifest: Mapping[str, object]) -> None:
        """Open a folder, new or of the same campaign.

        Args:
            folder: made if it does not exist.
            manifest: plain data that say what the rows are of.

        Raises:
            CampaignError: the folder is another campaign's, is in use, or cannot be
                written.
        """
        self.folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = open(folder / ROWS, "a+b")
        except OSError as error:
            raise CampaignError(
                f"cannot write into {folder}: {error.strerror or error}; name another"
                " with --output"
            ) from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._file.close()
            raise CampaignError(f"another campaign is writing into {folder}") from error
        self._check(manifest)
        self.rows = self._kept()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def append(self, rows: Iterable[Row]) -> None:
        """Append rows with their ``key``; they are on the disk when this returns."""
        rows = list(rows)
        lines = "".join(
            json.dumps(as_plain(row), allow_nan=False) + "\n" for row in rows
        )
        try:
            self._file.write(lines.encode())
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise CampaignError(
                f"cannot write into {self.folder / ROWS}: {error.strerror or error}"
            ) from error
        self.rows.update({text(row, "key"): cast(Row, as_plain(row)) for row in rows})

    def write_table(self, keys: Iterable[str]) -> Path:
        """Write all rows as a Parquet file, in the order of the keys."""
        path = self.folder / TABLE
        rows = [self.rows[key] for key in keys if key in self.rows]
        part = path.with_suffix(".part")
        pq.write_table(as_table(rows), part, compression="zstd")
        part.replace(path)
        return path

    def write_text(self, name: str, content: str) -> Path:
        """Write a text file of the folder."""
        path = self.folder / name
        path.write_text(content, encoding="utf-8")
        return path

    def _check(self, manifest: Mapping[str, object]) -> None:
        path = self.folder / MANIFEST
        wanted = json.loads(json.dumps(manifest))
        if path.is_file():
            try:
                found = json.loads(path.read_text(encoding="utf-8"))
            except ValueError as error:
                raise CampaignError(f"{path} cannot be read: {error}") from error
            difference = _difference(found, wanted)
            if difference:
                raise CampaignError(
                    f"{self.folder} holds rows of another campaign: {difference}; name"
                    " another folder with --output"
                )
        elif self._file.tell():
            raise CampaignError(
                f"{self.folder} has rows without {MANIFEST}; name another folder with"
                " --output"
            )
        else:
            part = path.with_suffix(".part")
            part.write_text(json.dumps(wanted, indent=1) + "\n", encoding="utf-8")
            part.replace(path)

    def _kept(self) -> dict[str, Row]:
        """Read the rows of an earlier run, and cut off a last line that broke off."""
        self._file.seek(0)
        content = self._file.read()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            self._file.truncate(whole)
        return _rows(self.folder / ROWS, content[:whole])


def read_rows(folder: Path) -> dict[str, Row]:
    """Read the rows of a folder by key, without holding it; none if there is no such
    folder.

    Raises:
        CampaignError: a line is not a row.
    """
    path = folder / ROWS
    if not path.is_file():
        return {}
    content = path.read_bytes()
    return _rows(path, content[: content.rfind(b"\n") + 1])


def _rows(path: Path, content: bytes) -> dict[str, Row]:
    rows = {}
    for number, line in enumerate(content.splitlines(), start=1):
        try:
            row = json.loads(line)
            rows[row["key"]] = row
        except (ValueError, KeyError, TypeError) as error:
            raise CampaignError(
                f"{path}: line {number} is not a row; delete it and run again"
            ) from error
    return rows


def as_table(rows: list[Row]) -> pa.Table:
    """Make a table of rows, with nulls where rows lack a column."""
    names = dict.fromkeys(name for row in rows for name in row)
    columns = {name: _column([row.get(name) for row in rows]) for name in names}
    return pa.table(columns)


def _column(values: list[Cell]) -> pa.Array:
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int, float}:
        return pa.array(values, pa.float64())
    if len(kinds) > 1:
        return pa.array(
            [None if value is None else str(value) for value in values], pa.string()
        )
    return pa.array(values, pa.float64() if not kinds else None)


def _difference(found: object, wanted: object, where: str = "") -> str:
    """Say where two pieces of plain data differ first."""
    if isinstance(found, dict) and isinstance(wanted, dict):
        for key in {**wanted, **found}:
            name = f"{where}.{key}" if where else str(key)
            if key not in found or key not in wanted:
                return f"{name} is only {'here' if key in wanted else 'there'}"
            inner = _difference(found[key], wanted[key], name)
            if inner:
                return inner
        return ""
    return (
        ""
        if found == wanted
        else f"{where} is {_short(found)} there, {_short(wanted)} here"
    )


def _short(value: object) -> str:
    shown = json.dumps(value)
    return shown if len(shown) <= 60 else f"{shown[:57]}..."
