"""Tables of text: parted by semicolon, tab, comma or blanks, with a line of names or without."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.table import Column, Vector, shown, titled

_REMARKS = ("#", "%")
_MISSING = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none"})
_SEPARATORS = (";", "\t", ",")
_LONGEST_UNIT = 16  # characters
_PROBED = 20  # lines that show which separator it is


@dataclass(frozen=True, slots=True, kw_only=True)
class TextTable:
    """The rows of a text, not yet read as numbers: a column that nobody asks for may be words."""

    columns: tuple[Column, ...]
    """Names and units; without names where the text gives none."""
    rows: Sequence[str]
    """The lines that hold values, without the separator that ends each, if any does."""
    lines: Sequence[int]
    """The number from 1 of each row's line."""
    separator: str
    """Between the cells; "" are blanks."""
    notes: tuple[str, ...] = ()
    """What was made of lines that hold no values."""

    @property
    def refused(self) -> Mapping[str, str]:
        """Return nothing: all that there is are columns."""
        return {}

    @property
    def Ts(self) -> None:
        """A text does not say it beside its columns."""

    def numbers(self, i: int) -> Vector:
        """Return the values of column i, from 0; NaN where one is missing.

        Raises
        ------
        FileError
            One is no number; its line is named.
        """
        values = np.empty(len(self.rows))
        for k, row in enumerate(self.rows):
            cell = _cells(row, self.separator)[i]
            value = number(cell, self.separator)
            if value is None:
                raise FileError(self._no_number(i, k, cell))
            values[k] = value
        return values

    def place(self, k: int) -> str:
        """Return the line that instant k stands in."""
        return f"line {self.lines[k]}"

    def _no_number(self, i: int, k: int, cell: str) -> str:
        name = shown(self.columns[i].name) or str(i + 1)
        text = f"{self.place(k)}, column {name}: '{shown(cell.strip())}' is no number; "
        if "," in cell and self.separator != ";":
            return text + "write 0.5, or 0,5 where a semicolon parts the columns"
        return text + "leave a missing value empty, or write NaN; begin a remark's line with #"


def table_of(text: str) -> TextTable:
    """Return the table that a text holds.

    The separator is the semicolon, where one is in the first lines, else tab, else comma, else
    blanks. Lines that are empty, or begin with # or %, are remarks. The first other line is one
    of names where none of its cells is a number, and the one below it then one of units where it
    has none either. With a semicolon the decimals may have a comma.

    Raises
    ------
    FileError
        There is no row of values, or one has more cells or fewer than the others.
    """
    numbered = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith(_REMARKS)
    ]
    probed = [line for _, line in numbered[:_PROBED]]
    separator = next((s for s in _SEPARATORS if any(s in line for line in probed)), "")
    header: list[str] = []
    if probed and _are_names(first := _cells(probed[0], separator)):
        header = [cell.strip() for cell in first]
        del numbered[0]
    units, notes = [""] * len(header), []
    if header and numbered and _are_units(second := _cells(numbered[0][1], separator), header):
        units = [cell.strip().strip("[]()") for cell in second]
        notes = [f"read line {numbered.pop(0)[0]} as units"]
    if not numbered:
        names = f" below its names, {shown(', '.join(header))}" if header else ""
        raise FileError(f"there is no row of numbers{names}; a row for each sample is needed")
    lines, rows = [number for number, _ in numbered], [line for _, line in numbered]
    if header and not header[-1]:
        del header[-1]
    if _each_ends(rows, separator, width=len(header)):
        rows = [row.rstrip(" \r")[:-1] for row in rows]
    width = len(header) or len(_cells(rows[0], separator))
    for k, row in enumerate(rows):
        cells = len(_cells(row, separator))
        if cells != width:
            raise FileError(_ragged(lines[k], cells, width, separator, names=bool(header)))
    columns = [_column(*named) for named in zip(header, units, strict=False)]
    columns = columns or [Column(name="")] * width
    return TextTable(
        columns=tuple(columns), rows=rows, lines=lines, separator=separator, notes=tuple(notes)
    )


def number(cell: str, separator: str) -> float | None:
    """Return the number of a cell, NaN for a missing one, None for what is neither."""
    text = cell.strip()
    if text.casefold() in _MISSING:
        return float("nan")
    if "_" in text:  # 1_000 is a number of Python's
        return None
    try:
        return float(text.replace(",", ".") if separator == ";" else text)
    except ValueError:
        return None


def _cells(line: str, separator: str) -> list[str]:
    if not separator:
        return line.split()
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    except csv.Error as err:
        raise FileError(f"'{shown(line)}' cannot be parted into cells: {err}") from err


def _are_names(cells: Sequence[str]) -> bool:
    """Return whether none of the cells is a number; a row of values may hold a word or two."""
    return all(number(cell, ";") is None for cell in cells if cell.strip())


def _are_units(cells: Sequence[str], header: Sequence[str]) -> bool:
    """Return whether the cells may be units: words, as many as there are names, none long."""
    fits = len(cells) == len(header) and all(len(cell.strip()) <= _LONGEST_UNIT for cell in cells)
    return fits and any(cell.strip() for cell in cells) and _are_names(cells)


def _column(heading: str, unit: str) -> Column:
    """Return a column, of the unit below its name where that has none."""
    column = titled(heading)
    return column if column.unit else replace(column, unit=unit)


def _each_ends(rows: Sequence[str], separator: str, *, width: int) -> bool:
    """Return whether a separator ends each row, and no column begins behind it."""
    if not separator or not all(row.rstrip(" \r").endswith(separator) for row in rows):
        return False
    return not width or len(_cells(rows[0], separator)) == width + 1


def _ragged(line: int, cells: int, width: int, separator: str, *, names: bool) -> str:
    by = {"": "blanks", "\t": "tab", ";": "semicolon", ",": "comma"}[separator]
    whose = "the line of names" if names else "the first row"
    text = f"line {line} has {_count(cells)} (parted by {by}), {whose} {_count(width)}; give "
    text += "every row as many, and begin remarks with #"
    if separator == "," and width < cells <= 2 * width:
        text += "; where decimals have a comma, part the cells by semicolon"
    return text


def _count(cells: int) -> str:
    return "1 cell" if cells == 1 else f"{cells} cells"
