"""Tables of text: cells separated by semicolon, tab, comma or blanks, with optional names."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.decimal_marks import contradicts, doubtful_cell, mark_of, number, refused
from armrig.data.files.table import Column, Vector, shown, titled

_REMARK_MARKS = ("#", "%")
_SEPARATORS = (";", "\t", ",")
_MAX_UNIT_CHARACTERS = 16
_PROBED_LINES = 20  # to find the separator


@dataclass(frozen=True, slots=True, kw_only=True)
class TextTable:
    """Rows of a text file, not yet converted to numbers: unused columns may contain words."""

    columns: tuple[Column, ...]
    """Names and units; "" if the text contains no names."""
    rows: Sequence[str]
    """Lines with values; a separator that ends every line is removed."""
    lines: Sequence[int]
    """Line number of each row, from 1."""
    separator: str
    """Separator of the cells; "" for blanks."""
    decimal: str | None
    """Decimal mark that the user gave, or None."""
    notes: tuple[str, ...] = ()
    """Notes on lines that contain no values: the line of units."""

    @property
    def refused(self) -> Mapping[str, str]:
        """Return an empty mapping: everything in a text file is a column."""
        return {}

    @property
    def Ts(self) -> None:
        """Return None, since a text file states no sampling time outside its columns."""

    def numbers(self, i: int) -> Vector:
        """Return the values of column i, counted from 0; NaN where a value is missing.

        Raises
        ------
        FileError
            A value is not a number; the message names its line.
        """
        cells = self.texts(i)
        mark = self.decimal or self._mark(i, cells)
        if self.decimal and (k := contradicts(cells, self.decimal)) is not None:
            name = shown(self.columns[i].name) or str(i + 1)
            raise FileError(
                f"{self.place(k)}, column {name}: '{shown(cells[k].strip())}' has another decimal "
                f"mark than --decimal {self.decimal}"
            )
        values = np.empty(len(cells))
        for k, cell in enumerate(cells):
            value = number(cell, mark) if mark else number(cell.replace(",", "."), ".")
            if value is None:
                raise FileError(self._no_number(i, k, cell))
            values[k] = value
        return values

    def texts(self, i: int) -> list[str]:
        """Return the cells of column i, counted from 0."""
        return [_cells(row, self.separator)[i] for row in self.rows]

    def _mark(self, i: int, cells: Sequence[str]) -> str:
        """Return the decimal mark of column i, or "" if both marks are decimal marks."""
        others = (self.texts(j) for j in range(len(self.columns)) if j != i)
        mark = mark_of(cells, others, mixed=self.separator != ",")
        if mark is None:
            k = doubtful_cell(cells)
            raise refused(self.place(k), shown(self.columns[i].name) or str(i + 1), cells[k])
        return mark

    def place(self, k: int) -> str:
        """Return the line of instant k as text, such as `line 4`."""
        return f"line {self.lines[k]}"

    def _no_number(self, i: int, k: int, cell: str) -> str:
        name = shown(self.columns[i].name) or str(i + 1)
        text = f"{self.place(k)}, column {name}: '{shown(cell.strip())}' is not a number; "
        return text + "leave a missing value empty, or write NaN; begin a remark's line with #"


def table_of(text: str, decimal: str | None = None) -> TextTable:
    """Return the table that a text contains.

    Lines that are empty, or begin with # or %, are remarks. A first line such as `sep=;` names the
    separator. Otherwise semicolon, tab, comma and blank are tried in this order on the first 20
    lines, which must have an equal number of cells. The
    first line that is not a remark contains names if none of its cells is a number. The line after
    the names contains units if none of its cells is a number. The numbers show the decimal mark, or
    `decimal` gives it.

    Raises
    ------
    FileError
        There is no row of values, or the rows have different numbers of cells.
    """
    numbered = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith(_REMARK_MARKS)
    ]
    declared = numbered[0][1].strip('" \r') if numbered else ""
    if declared.casefold() in {f"sep={mark}" for mark in _SEPARATORS}:
        del numbered[0]  # Excel's line
    else:
        declared = ""
    probed = [line for _, line in numbered[:_PROBED_LINES]]
    separator = declared[-1:] or _separator(probed)
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
        columns=tuple(columns),
        rows=rows,
        lines=lines,
        separator=separator,
        decimal=decimal,
        notes=tuple(notes),
    )


def _separator(lines: Sequence[str]) -> str:
    """Return the separator of the cells of these lines; "" for blanks."""
    present = [s for s in _SEPARATORS if any(s in line for line in lines)]
    for separator in (*present, ""):
        widths = {len(_cells(line.rstrip(f" \r{separator}"), separator)) for line in lines}
        if (
            len(widths) == 1
            and widths != {1}
            and any(_is_number(c) for c in _cells(lines[-1], separator))
        ):
            return separator
    return present[0] if present else ""


def _is_number(cell: str) -> bool:
    return bool(cell.strip()) and number(cell.replace(",", "."), ".") is not None


def _cells(line: str, separator: str) -> list[str]:
    if not separator:
        return line.split()
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    except csv.Error as err:
        raise FileError(f"'{shown(line)}' cannot be split into cells: {err}") from err


def _are_names(cells: Sequence[str]) -> bool:
    """Return whether the cells can be names: none of them is a number."""
    return not any(_is_number(cell) for cell in cells)


def _are_units(cells: Sequence[str], header: Sequence[str]) -> bool:
    """Return whether the cells can be units: short texts, not numbers, one for each name."""
    fits = all(len(cell.strip()) <= _MAX_UNIT_CHARACTERS for cell in cells)
    fits &= len(cells) == len(header)
    return fits and any(cell.strip() for cell in cells) and _are_names(cells)


def _column(heading: str, unit: str) -> Column:
    """Return a column, with `unit` if its heading has no unit."""
    column = titled(heading)
    return column if column.unit else replace(column, unit=unit)


def _each_ends(rows: Sequence[str], separator: str, *, width: int) -> bool:
    """Return whether every row ends with a separator that no column follows."""
    if not separator or not all(row.rstrip(" \r").endswith(separator) for row in rows):
        return False
    return not width or len(_cells(rows[0], separator)) == width + 1


def _ragged(line: int, cells: int, width: int, separator: str, *, names: bool) -> str:
    by = {"": "blanks", "\t": "tab", ";": "semicolon", ",": "comma"}[separator]
    whose = "the line of names" if names else "the first row"
    text = f"line {line} has {_count(cells)} (separated by {by}), {whose} {_count(width)}; give "
    text += "every row the same number, and begin remarks with #"
    if separator == "," and width < cells <= 2 * width:
        text += "; if decimals have a comma, separate the cells by semicolon or tab"
    return text


def _count(cells: int) -> str:
    return "1 cell" if cells == 1 else f"{cells} cells"
