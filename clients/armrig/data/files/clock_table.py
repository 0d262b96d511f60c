"""Columns of one or more tables at the instants of one clock."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from armrig_core.errors import FileError
from numpy.typing import NDArray

from armrig.data.files.cells import is_missing, number
from armrig.data.files.table import Table, Vector, chosen, shown
from armrig.data.files.text import TextTable
from armrig.numerics.quantities import listed
from armrig.numerics.stretches import Mask

Rows = NDArray[np.intp]
_MAX_LISTED = 4
_MAX_CELLS = 64  # that show whether a column contains numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockTable(Table):
    """Columns of one or more tables at the instants of one clock."""

    sources: Sequence[tuple[Table, int, Rows]]
    """Table of each column, index of the column, and its row at each instant; -1 for no row."""
    clock: tuple[str, Table, Rows]
    """Beginning of the name of a place; the table of the clock, and its rows."""
    faults: Mapping[int, str] = field(default_factory=dict)
    """Reasons why columns have no value at the instants, by index."""
    other_times: Collection[int] = ()
    """Indices of columns of times that are not those of the rows."""

    def numbers(self, i: int) -> Vector:
        """Return the values of column i, counted from 0; NaN where a value is missing."""
        if i in self.faults:
            raise FileError(self.faults[i])
        table, k, rows = self.sources[i]
        return np.append(table.numbers(k), np.nan)[rows]

    def texts(self, i: int) -> Sequence[str]:
        """Return the cells of column i as text; () if the file contains numbers."""
        table, k, rows = self.sources[i]
        cells = table.texts(k)
        return [cells[row] if row >= 0 else "" for row in rows.tolist()] if len(cells) else ()

    def place(self, k: int) -> str:
        """Return the place of instant k in its file as text, such as `line 4`."""
        file, table, rows = self.clock
        return file + table.place(int(rows[k]))


def rows_of(table: Table, rows: Rows, *notes: str) -> ClockTable:
    """Return a table with these rows, and with further first notes; shorter columns stay."""
    longest = int(rows.max(initial=-1))
    return ClockTable(
        columns=table.columns,
        refused=table.refused,
        Ts=table.Ts,
        notes=[*notes, *table.notes],
        sources=[
            (table, i, rows if size > longest else np.arange(size))
            for i, size in enumerate(sizes_of(table))
        ],
        clock=("", table, rows),
        other_times=getattr(table, "other_times", ()),
    )


def few_rows(table: Table) -> Table:
    """Return some rows of a long text, without the conversion of the others."""
    if not isinstance(table, TextTable) or len(table.rows) < _MAX_CELLS:
        return table
    rows = np.unique(np.linspace(0, len(table.rows) - 1, _MAX_CELLS).astype(np.intp))
    lines = [table.lines[k] for k in rows]
    return replace(table, rows=[table.rows[k] for k in rows], lines=lines)


def sizes_of(table: Table) -> list[int]:
    """Return the number of rows of each column."""
    if isinstance(table, ClockTable):
        return [rows.size for *_, rows in table.sources]
    if isinstance(table, TextTable):
        return [len(table.rows)] * len(table.columns)
    return [len(column) for column in table.values]


def index_of(table: Table, wanted: str, what: str) -> int | None:
    """Return the index of a column, or of the first column of a matrix; None if there is none."""
    for name in (wanted, f"{wanted}:1"):
        with suppress(FileError):
            return chosen(table, name, what)
    return None


def rows_with_value(table: Table, i: int, *, words: bool = False) -> Mask | None:
    """Return the rows in which a column has a value; None for words, if they are not asked for."""
    if not len(cells := table.texts(i)):
        with suppress(FileError):
            return ~np.isnan(table.numbers(i))
        return None
    has_value = ~np.array(list(map(is_missing, cells)), np.bool_)
    some = (cells[k] for k in np.flatnonzero(has_value)[:_MAX_CELLS])
    return has_value if words or all(number(cell, "") is not None for cell in some) else None


def names_of(table: Table, columns: Sequence[int]) -> str:
    """Return the names of columns for a message."""
    names = [shown(table.columns[i].name) or f"column {i + 1}" for i in columns]
    more = names[_MAX_LISTED - 1 :] if len(names) > _MAX_LISTED else []
    return listed([*names[: _MAX_LISTED - 1], f"{len(more)} more"] if more else names)
