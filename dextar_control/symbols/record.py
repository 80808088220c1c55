"""Records: numbers by name, on symbols and in an array, laid out once.

A fast function takes and gives whole records, one contiguous vector each. Both sides of
it address the numbers by the same names: ``Layout.symbols`` where the function is
written, ``Record`` where it is called. No index is written anywhere else.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dextar_control.symbols.types import Array, Slice, Symbol

# A float or an array: the layout says which.
Value: TypeAlias = Any  # type: ignore[explicit-any]


class Field(NamedTuple):
    """One quantity of a record.

    Attributes:
        name: by which it is addressed.
        unit: SI; of a platform coordinate m, of a joint that joint's.
        meaning: in a few words.
        rows, columns: its shape; "n" stands for the degrees of freedom, "3n" for
            three times as many.
    """

    name: str
    unit: str
    meaning: str
    rows: int | str = 1
    columns: int | str = 1


class Record:
    """The numbers of one record, whose fields are attributes: views of ``numbers``, in
    shapes (size,) or (rows, columns), or floats. Each layout has its own class.

    Args:
        numbers: the array that holds them, (size,); zeros when None.
    """

    __slots__ = ("_view", "numbers")
    layout: Layout

    def __init__(self, numbers: Array | None = None) -> None:
        self.numbers = np.zeros(self.layout.size) if numbers is None else numbers
        self._view = self.numbers.data

    def __getattr__(self, name: str) -> Value:  # what the class does not know
        raise AttributeError(f"a record '{self.layout.name}' has no field '{name}'")

    if TYPE_CHECKING:

        def __setattr__(self, name: str, value: Value) -> None:
            """Each layout's class has its fields."""

    def copy(self) -> Record:
        """Return a record of the same numbers in an array of its own."""
        return type(self)(self.numbers.copy())

    def take(self, other: Record) -> None:
        """Copy the numbers of another record."""
        self.numbers[:] = other.numbers


def _property(
    field: Field, place: int | Slice, shape: tuple[int, ...] | None
) -> property:
    if shape is None:

        def read(self: Record) -> Value:
            return self._view[place]

        def write(self: Record, value: Value) -> None:
            self._view[place] = value

    elif len(shape) == 1:

        def read(self: Record) -> Value:
            return self.numbers[place]

        def write(self: Record, value: Value) -> None:
            self.numbers[place] = value

    else:

        def read(self: Record) -> Value:
            return self.numbers[place].reshape(shape, order="F")

        def write(self: Record, value: Value) -> None:
            self.numbers[place] = np.ravel(value, order="F")

    return property(read, write, doc=f"{field.meaning}, {field.unit}.")


class Layout:
    """The layout of one kind of record for a number of degrees of freedom.

    Args:
        name: of the kind.
        n: degrees of freedom.
        fields: in order.

    Attributes:
        size: of all fields together.
        places: of each field, its index (of a scalar) or slice, and its shape (None for
            a scalar).
    """

    def __init__(self, name: str, n: int, fields: tuple[Field, ...]) -> None:
        self.name, self.n, self.fields = name, n, fields
        self.places: dict[str, tuple[int | Slice, tuple[int, ...] | None]] = {}
        start = 0
        for field in fields:
            rows, columns = self._count(field.rows), self._count(field.columns)
            size = rows * columns
            if field.rows == 1 and field.columns == 1:
                self.places[field.name] = start, None
            else:
                shape = (rows,) if field.columns == 1 else (rows, columns)
                self.places[field.name] = slice(start, start + size), shape
            start += size
        self.size = start
        members = {
            field.name: _property(field, *self.places[field.name]) for field in fields
        }
        self._class: type[Record] = type(
            name.title().replace("_", ""),
            (Record,),
            {"__slots__": (), "layout": self, **members},
        )

    def _count(self, size: int | str) -> int:
        return size if isinstance(size, int) else int(size[:-1] or "1") * self.n

    def make(self, **values: ArrayLike) -> Record:
        """Return a record of zeros but for ``values``, in the fields' shapes such as
        (n,) and units such as rad.
        """
        record: Record = self._class()
        for name, value in values.items():
            setattr(record, name, value)
        return record

    def of(self, numbers: Array) -> Record:
        """Return the record whose numbers are in this array (size,), in the fields'
        units such as rad.
        """
        record: Record = self._class(numbers)
        return record

    def rows(self, **columns: ArrayLike) -> Array:
        """Return many records as a table (m, size), in the fields' units such as rad.

        Args:
            columns: of each field, (m,), or (m, k) where it has k numbers, a matrix
                column by column; or one number for all.
        """
        many = max(np.shape(one)[0] for one in columns.values() if np.ndim(one))
        table = np.empty((many, self.size))
        for name, column in columns.items():
            table[:, self.places[name][0]] = column
        return table

    def indices(self, *names: str) -> NDArray[np.int64]:
        """Return the indices (k,), 1, of these fields' numbers in the vector,
        rising.
        """
        every = np.arange(self.size)
        return np.sort(
            np.concatenate(
                [np.atleast_1d(every[self.places[name][0]]) for name in names]
            )
        )

    def symbols(self, name: str = "") -> tuple[Symbol, dict[str, Symbol]]:
        """Return (a vector of symbols (size,), its fields by name)."""
        vector = ca.SX.sym(name or self.name, self.size)
        return vector, self.split(vector)

    def split(self, vector: Symbol) -> dict[str, Symbol]:
        """Return the fields, by name, of a vector on symbols (size,)."""
        parts = {}
        for name, (place, shape) in self.places.items():
            part = vector[place]
            parts[name] = (
                part if shape is None or len(shape) == 1 else ca.reshape(part, *shape)
            )
        return parts

    def join(self, fields: Mapping[str, Symbol | float]) -> Symbol:
        """Return the vector on symbols (size,) of all fields."""
        return ca.vertcat(
            *(ca.vec(ca.densify(ca.SX(fields[field.name]))) for field in self.fields)
        )
