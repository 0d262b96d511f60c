"""Named columns of numbers, independent of the kind of file."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from armrig_core.errors import FileError
from armrig_core.process.printable import printable

from armrig.data.columns import Vector as Vector

NO_NUMBERS = "contains no numbers; save it as a vector of real numbers"
"""Reason why a variable is not a column, and the remedy."""
_MOST_BYTES = 1 << 28  # of an unpacked file, with at least 8 B for each number
_MIN_LIMIT_BYTES = 1 << 26
MIN_TS = 1e-12  # in s; 1/MIN_TS is the longest
_MAX_RATIO = 100  # packing shrinks measured data by a factor of 5 to 20, zeros by 1000
_MAX_LISTED_COLUMNS = 12
_MAX_SHOWN_CHARACTERS = 40  # of a text of the file that a message quotes
_MAX_NUMBER_DIGITS = 9  # of a number that chooses a column
_UNIT = re.compile(
    r"(?P<name>.+?)(?:\s*\[(?P<unit>[^][]*)\]|\s+\((?P<other>[^()]*)\)|\((?P<glued>[^()\d][^()]*)\))"
)


class NoColumnError(FileError):
    """A requested column does not exist."""


class ReadingError(FileError):
    """The file can be read only with an option of reading."""

    def __init__(self, text: str, option: str) -> None:
        """Set the message, and the option as a person types it."""
        super().__init__(text)
        self.option = option


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """Name and unit of a column."""

    name: str
    """Name, "" if the file contains no name."""
    unit: str = ""
    """Unit, from a header such as `u [V]` or `u (V)`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Columns of equal length, with a value or a missing value at each instant."""

    columns: Sequence[Column]
    """Names and units, in the file's order; the columns of a matrix X are named `X:1`, `X:2` …"""
    values: Sequence[Any] = ()
    """An array (N,) of any real type for each column."""
    refused: Mapping[str, str] = field(default_factory=dict)
    """Reason why a variable is not a column of numbers, by the name of the variable."""
    Ts: float | None = None
    """Sampling time in s, if the file states it outside the columns."""
    notes: Sequence[str] = ()
    """Notes on how the columns were read."""
    other_times: Collection[int] = ()
    """Indices of columns of times that are not those of the rows."""

    def numbers(self, i: int) -> Vector:
        """Return the values of column i, counted from 0; NaN where a value is missing."""
        with np.errstate(invalid="ignore"):  # a signalling NaN is NaN, too
            return np.array(self.values[i], dtype=np.float64)

    def texts(self, i: int) -> Sequence[str]:
        """Return the cells of column i as text; () if the file contains numbers."""
        return ()

    def place(self, k: int) -> str:
        """Return the place of instant k in the file as text, such as `line 4`."""
        return f"row {k + 1}"


def room(packed: int) -> int:
    """Return the largest allowed unpacked size, in B, of a file of `packed` B."""
    return min(_MOST_BYTES, max(_MIN_LIMIT_BYTES, _MAX_RATIO * packed))


def require_room(unpacked: int, packed: int) -> None:
    """Refuse a file whose unpacked size exceeds `room`."""
    if unpacked > (most := room(packed)):
        raise FileError(
            f"unpacked it has more than {most >> 20} MiB; save only input and output, or cut it "
            "into several files"
        )


def column_of(heading: str) -> Column:
    """Return the name and the unit of a heading such as `u [V]`, `u (V)` or `u(V)`."""
    parts = _UNIT.fullmatch(heading)
    if parts is None:
        return Column(name=heading)
    unit = parts["unit"] or parts["other"] or parts["glued"] or ""
    return Column(name=parts["name"].strip(), unit=unit.strip())


def choose(table: Table, wanted: str, option: str) -> int:
    """Return the index of a column, given by name or by number from 1, for an option `option`.

    The name may contain the unit; the name of a structure's field may be its last part. Lower and
    upper case are distinguished only if both exist. A name has priority over a number.
    """
    wanted = wanted.strip()
    title = column_of(wanted)
    named = [(i, column) for i, column in enumerate(table.columns) if column.name]
    folded = title.name.casefold()
    for matches in (
        [i for i, column in named if wanted == column.name or title == column],
        [i for i, column in named if folded == column.name.casefold()],
        [i for i, column in named if wanted == column.name.rpartition(".")[2]],
    ):
        if len(matches) == 1:
            return matches[0]
        if matches:
            numbers = " and ".join(str(i + 1) for i in matches[:_MAX_LISTED_COLUMNS])
            raise FileError(
                f"{option} {shorten(wanted)}: columns {numbers} have this name; give the number"
            )
    is_number = wanted.isdecimal() and len(wanted) <= _MAX_NUMBER_DIGITS
    if is_number and 1 <= int(wanted) <= len(table.columns):
        return int(wanted) - 1
    for name, why in table.refused.items():
        if wanted in (name, name.rpartition(".")[2]):
            raise FileError(f"{option} {shorten(wanted)}: {why}")
    raise NoColumnError(
        f"{option} {shorten(wanted)}: there is no such column; {remedy(table, option)}"
    )


def remedy(table: Table, option: str) -> str:
    """Return the remedy for a message: the option to give, with a list of the columns."""
    count = len(table.columns)
    if not count:
        refused = list(table.refused.items())[:_MAX_LISTED_COLUMNS]
        held = "; ".join(f"{shorten(name)} {why}" for name, why in refused)
        return "there is no column of numbers" + (f" ({held})" if held else "")
    if not any(column.name for column in table.columns):
        numbers = " or ".join(str(i + 1) for i in range(count))
        numbers = numbers if count <= 2 else f"a number from 1 to {count}"
        return f"its columns have no names: give --{option} {numbers}"
    if count == 1 and option != "time":
        return "it has one column, but an input and an output are needed"
    names = [f"{i} {shorten(c.name) or '(no name)'}" for i, c in enumerate(table.columns, 1)]
    more = f", … {count}" if count > _MAX_LISTED_COLUMNS else ""
    return f"give --{option} a name or a number of {', '.join(names[:_MAX_LISTED_COLUMNS])}{more}"


def shorten(text: str) -> str:
    """Return text of the file in printable form, shortened for a message."""
    short = len(text) <= _MAX_SHOWN_CHARACTERS
    return printable(text if short else f"{text[: _MAX_SHOWN_CHARACTERS - 1]}…")
