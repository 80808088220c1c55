"""A campaign's rows: of each trial one flat record of plain values by column."""

from __future__ import annotations

import math

Cell = bool | int | float | str | None
Row = dict[str, Cell]


def number(row: Row, column: str) -> float:
    """Return the number of a cell; nan where the row has none."""
    value = row.get(column)
    return math.nan if value is None else float(value)


def text(row: Row, column: str) -> str:
    """Return the text of a cell that every row has."""
    return str(row[column])


def failed_row(reason: str) -> Row:
    """Return the results of a trial that gave none."""
    return {"success": False, "reason": reason}
