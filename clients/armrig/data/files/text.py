"""Tables of text: cells separated by semicolon, tab, comma or blanks, with optional names."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.decimal_marks import contradicts, doubtful_cell, mark_of, number
from armrig.data.files.table import Column, Table, Vector, shown, titled
from armrig.numerics.quantities import plural

_REMARK_MARKS = ("#", "%")
_SEPARATORS = {";": "semicolon", "\t": "tab", ",": "comma", "": "blanks"}
_MAX_UNIT_CHARACTERS = 16
_QUANTITY = re.compile(r"[+-]?\d[\d.,]*\s*[^\d\s/^.,]")  # 2 s, but not the unit 1/s
_PROBED_LINES = 20  # to find the separator


@dataclass(frozen=True, slots=True, kw_only=True)
class WaysOut:
    """Remedies that the errors of a text name."""

    not_a_number: str = "; leave a missing value empty, or write NaN; begin a remark's line with #"
    """Follows "is not a number"."""
    doubtful_mark: str = "Give --decimal , or --decimal ."
    """For a number whose comma or point may be either mark."""


_OF_DATA = WaysOut()


@dataclass(frozen=True, slots=True, kw_only=True)
class TextTable(Table):
    """Rows of a text file, not yet converted to numbers: unused columns may contain words."""

    rows: Sequence[str]
    """Lines with values; a separator that ends every line is removed."""
    lines: Sequence[int]
    """Line number of each row, from 1."""
    separator: str
    """Separator of the cells; "" for blanks."""
    decimal: str | None
    """Decimal mark that the user gave, or None."""
    ways_out: WaysOut = _OF_DATA
    """Remedies that errors name."""

    def numbers(self, i: int) -> Vector:
        """Return the values of column i, counted from 0; NaN where a value is missing."""
        cells = self.texts(i)
        mark = self._mark(i, cells)
        if mark == "." and not any("_" in cell for cell in cells):
            try:
                return np.array(list(map(float, cells)))
            except ValueError:
                pass  # a missing value, thousands, or another text
        values = np.empty(len(cells))
        for k, cell in enumerate(cells):
            value = number(cell, mark)
            if value is None:
                raise self._fault(i, k, cell, "is not a number", self.ways_out.not_a_number)
            values[k] = value
        return values

    def texts(self, i: int) -> list[str]:
        """Return the cells of column i, counted from 0."""
        return [_cells(row, self.separator)[i] for row in self.rows]

    def place(self, k: int) -> str:
        """Return the line of instant k as text, such as `line 4`."""
        return f"line {self.lines[k]}"

    def _mark(self, i: int, cells: Sequence[str]) -> str:
        """Return the decimal mark of column i, or "" if both marks are decimal marks."""
        if self.decimal:
            if (k := contradicts(cells, self.decimal)) is not None:
                said = f"has another decimal mark than --decimal {self.decimal}"
                raise self._fault(i, k, cells[k], said)
            return self.decimal
        others = (self.texts(j) for j in range(len(self.columns)) if j != i)
        mark = mark_of(cells, others, mixed=self.separator != ",")
        if mark is None:
            k, readings = doubtful_cell(cells)
            said = f"may be {readings}: a decimal mark, or a mark between thousands? "
            raise self._fault(i, k, cells[k], said, self.ways_out.doubtful_mark)
        return mark

    def _fault(self, i: int, k: int, cell: str, *said: str) -> FileError:
        name = shown(self.columns[i].name) or str(i + 1)
        return FileError(f"{self.place(k)}, column {name}: '{shown(cell.strip())}' {''.join(said)}")


def read_text(text: str, decimal: str | None = None, *, ways_out: WaysOut = _OF_DATA) -> TextTable:
    """Return the table that a text contains; `ways_out` are the remedies that its errors name.

    Lines that are empty, or begin with # or %, are remarks. A first line such as `sep=;` names the
    separator. Otherwise semicolon, tab, comma and blank are tried in this order on the first 20
    lines, which must have an equal number of cells. The first line that is not a remark contains
    names if none of its cells is a number. The line after the names contains units if none of its
    cells is a number. The numbers show the decimal mark, or `decimal` gives it.
    """
    numbered = [
        (k, line)
        for k, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith(_REMARK_MARKS)
    ]
    declared = numbered[0][1].strip('" \r') if numbered else ""
    if declared.casefold() in {f"sep={mark}" for mark in _SEPARATORS if mark}:
        del numbered[0]  # Excel's line
        separator = declared[-1]
    else:
        separator = _separator([line for _, line in numbered[:_PROBED_LINES]])
    header: list[str] = []
    if numbered and _are_names(first := _cells(numbered[0][1], separator)):
        header = [cell.strip() for cell in first]
        del numbered[0]
    units, notes = [""] * len(header), []
    if header and numbered and _are_units(second := _cells(numbered[0][1], separator), header):
        units = [cell.strip().strip("[]()") for cell in second]
        notes = [f"read line {numbered.pop(0)[0]} as units"]
    if not numbered:
        names = f" below its names, {shown(', '.join(header))}" if header else ""
        raise FileError(f"there is no row of numbers{names}; a row for each sample is needed")
    lines, rows = zip(*numbered, strict=True)
    if header and not header[-1]:
        del header[-1]
    width = len(header) or len(_cells(rows[0], separator))
    # A separator at the end of each row is not followed by a column, unless a name follows it.
    ends = separator and (not header or len(_cells(rows[0], separator)) == width + 1)
    if ends and all(row.rstrip(" \r").endswith(separator) for row in rows):
        rows = tuple(row.rstrip(" \r")[:-1] for row in rows)
        width = len(header) or width - 1
    for k, row in enumerate(rows):
        if (cells := len(_cells(row, separator))) != width:
            raise FileError(_ragged(lines[k], cells, width, separator, names=bool(header)))
    columns = [titled(heading) for heading in header] or [Column(name="")] * width
    units += [""] * (width - len(units))
    return TextTable(
        columns=[c if c.unit else replace(c, unit=u) for c, u in zip(columns, units, strict=False)],
        notes=notes,
        rows=rows,
        lines=lines,
        separator=separator,
        decimal=decimal,
        ways_out=ways_out,
    )


def _separator(lines: Sequence[str]) -> str:
    """Return the separator of the cells of these lines; "" for blanks."""
    present = [s for s in _SEPARATORS if not s or any(s in line for line in lines)]
    for separator in present:
        widths = {len(_cells(line.rstrip(f" \r{separator}"), separator)) for line in lines}
        if len(widths) == 1 and widths != {1} and not _are_names(_cells(lines[-1], separator)):
            return separator
    return present[0]


def _cells(line: str, separator: str) -> list[str]:
    if not separator:
        return line.split()
    if '"' not in line:
        return line.split(separator)
    try:
        # Not strict=True, which refuses blanks after a quote.
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    except csv.Error as err:
        raise FileError(f"'{shown(line)}' cannot be split into cells: {err}") from err


def _are_names(cells: Sequence[str]) -> bool:
    """Return whether the cells can be names: none of them is a number."""
    return not any(cell.strip() and number(cell, "") is not None for cell in cells)


def _are_units(cells: Sequence[str], header: Sequence[str]) -> bool:
    """Return whether the cells can be units: short texts, not numbers, one for each name."""
    fits = all(len(cell.strip()) <= _MAX_UNIT_CHARACTERS for cell in cells)
    fits &= not any(_QUANTITY.match(cell.strip()) for cell in cells)
    fits &= len(cells) == len(header)
    return fits and any(cell.strip() for cell in cells) and _are_names(cells)


def _ragged(line: int, cells: int, width: int, separator: str, *, names: bool) -> str:
    whose = "the line of names" if names else "the first row"
    text = f"line {line} has {plural(cells, 'cell')} (separated by {_SEPARATORS[separator]}), "
    text += f"{whose} {plural(width, 'cell')}; give every row the same number, and begin remarks "
    more = "; if decimals have a comma, separate the cells by semicolon or tab"
    return text + "with #" + more * (separator == "," and width < cells <= 2 * width)
