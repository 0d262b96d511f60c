"""Tables of text: cells separated by semicolon, tab, comma or blanks, with optional names."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.cells import (
    REWRITTEN,
    SEPARATORS,
    SWITCH,
    CellKind,
    contradicts,
    doubtful_cell,
    is_missing,
    kind,
    mark_of,
    number,
    quantity,
    split,
    sure_marks,
)
from armrig.data.files.instrument_headers import (
    PROBED_LINES,
    TIMES,
    Lines,
    columns_of,
    has_values,
    head_of,
    head_of_instrument,
    longest_run,
    share_of_units,
)
from armrig.data.files.named_values import json_rows, long_table, without_names
from armrig.data.files.table import Column, ReadingError, Table, Vector, shorten
from armrig.data.step import DOUBT, Step
from armrig.numerics.quantities import plural

_REMARK_MARKS = ("#", "%")
_RECEIPT = re.compile(r"\s*\d{1,2}:\d\d:\d\d(?:[.,]\d+)?\s*->")
_SWITCH_KINDS = {CellKind.SWITCH, CellKind.MISSING}
_TWO_NUMBERS = re.compile(r"\s*\d+ +[+-]?\d+\s*")
_BLOCK_CELLS = 1 << 20  # that are kept of adjacent columns, so that wide files are split once
_MAX_CELLS = 1 << 16  # of a line; the kind of each is looked at several times
_MAX_ROWS_WITHOUT_VALUE = 1000  # at the beginning of a column whose values have units


WAYS_OUT = (
    "; leave a missing value empty, or write NaN; begin a remark's line with #",
    "Give --decimal , or --decimal .",
)
"""Remedies for a cell without a number, and for a number whose mark may be either decimal mark."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TextTable(Table):
    """Rows of a text file, not yet converted to numbers: unused columns may contain words."""

    rows: Sequence[str]
    """Lines with values; a separator that ends every line is removed."""
    lines: Sequence[int]
    """Line number of each row, from 1."""
    separator: str
    """Separator of the cells; "" for blanks."""
    is_mixed: bool
    """True if a comma may be part of a number, because none separates the cells of the file."""
    decimal: str | None
    """Decimal mark that the user gave; None if the cells show it."""
    units_in_cells: Mapping[int, str] = field(default_factory=dict)
    """Unit that each value of a column is followed by, by the index of the column."""
    switches: Collection[int] = ()
    """Indices of the columns of a switch: True and on are 1, False and off are 0."""
    ways_out: tuple[str, str] = WAYS_OUT
    """Remedies that errors name, as `WAYS_OUT`."""
    _block: dict[int, list[str]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _marks: list[set[str]] = field(default_factory=list, init=False, repr=False, compare=False)

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
                raise self._not_a_number(i, k, cell)
            values[k] = value
        return values

    def texts(self, i: int) -> Sequence[str]:
        """Return the cells of column i, counted from 0; a number without its unit."""
        cells = self._cells(i)
        if i in self.switches:
            return [SWITCH.get(cell.strip().casefold(), cell) for cell in cells]
        if i not in self.units_in_cells:
            return cells
        unit, bare = self.units_in_cells[i], list[str]()
        for k, cell in enumerate(cells):
            value, named = quantity(cell)
            if named != unit and not is_missing(cell):
                text = f"has the unit {shorten(named)}" if named else "has no unit"
                text += (
                    f", the values above it {shorten(unit)}; give every value of the column the "
                )
                raise self._fault(i, k, cell, f"{text}same unit")
            bare.append(value)
        return bare

    def _cells(self, i: int) -> list[str]:
        """Return the cells of column i as they are in the file."""
        if i not in self._block:
            self._block.clear()
            width = min(len(self.columns) - i, max(1, _BLOCK_CELLS // max(1, len(self.rows))))
            rows = (split(row, self.separator)[i : i + width] for row in self.rows)
            cells = list(chain.from_iterable(rows))
            self._block.update((i + k, cells[k::width]) for k in range(width))
        return self._block[i]

    def place(self, k: int) -> str:
        """Return the line of instant k as text, such as `line 4`."""
        return f"line {self.lines[k]}"

    def _mark(self, i: int, cells: Sequence[str]) -> str:
        """Return the decimal mark of column i, or "" if both marks are decimal marks."""
        if self.decimal:
            if (k := contradicts(cells, self.decimal)) is not None:
                problem = f"has another decimal mark than --decimal {self.decimal}"
                raise self._fault(i, k, cells[k], problem)
            return self.decimal
        mark = mark_of(cells, self._sure_marks, mixed=self.is_mixed)
        if mark is None:
            k, readings = doubtful_cell(cells)
            problem = f"may be {readings}: a decimal mark, or a mark between thousands? "
            fault = self._fault(i, k, cells[k], problem, self.ways_out[1])
            raise ReadingError(str(fault), "--decimal ,")
        return mark

    def _sure_marks(self) -> set[str]:
        """Return the decimal marks that the columns prove."""
        if not self._marks:
            proofs = set[str]()
            for i in range(len(self.columns)):
                proofs |= sure_marks(quantity(cell)[0] for cell in self._cells(i))
            self._marks.append(proofs)
        return self._marks[0]

    def _not_a_number(self, i: int, k: int, cell: str) -> FileError:
        """Return the error for a cell without a number."""
        if k and not has_values(split(self.rows[k], self.separator)):
            text = "is not a number; the line is like a second line of names: cut the file there"
            return self._fault(i, k, cell, text)
        return self._fault(i, k, cell, "is not a number", self.ways_out[0])

    def _fault(self, i: int, k: int, cell: str, *texts: str) -> FileError:
        name = shorten(self.columns[i].name) or str(i + 1)
        place = f"{self.place(k)}, column {name}"
        return FileError(f"{place}: '{shorten(cell.strip())}' {''.join(texts)}")


def read_text(
    text: str, decimal: str | None = None, *, ways_out: tuple[str, str] = WAYS_OUT
) -> TextTable:
    """Return the table that a text contains; `ways_out` are the remedies that its errors name.

    Lines that are empty, or begin with # or %, are remarks; units below the names may begin with %.
    The last remark above the first row may contain the names, as `numpy.savetxt` writes them.
    A first line such as `sep=;` names the separator; otherwise the separator is that of the longest
    run of rows in the first 65 lines. The lines of words above the rows contain names, or names and
    units. Up to 30 lines above the names are left out. The numbers show the decimal mark, or
    `decimal` gives it.

    Headers of known instruments, JSON, `name=value`, long tables, and the times that the serial
    monitor of Arduino writes (`->`) are read, too.
    """
    receipts, is_mixed, separator = dict[int, str](), True, REWRITTEN
    if (head := json_rows(text)) is not None:
        decimal = decimal or "."
    else:
        lines = _without_remarks(text)
        _require_few_cells(lines[:PROBED_LINES])
        receipts, lines = _without_receipts(lines)
        head = without_names(lines)
        if head is None:
            head, is_mixed = head_of_instrument(text, lines), False
        if head is None:
            separator, lines = _separator(lines)
            head, is_mixed = head_of(lines, separator), separator != ","
    columns, notes, lines = head
    if not lines:
        shown_names = ", ".join(column.name for column in columns)
        below = f" below its names, {shorten(shown_names)}" * bool(columns)
        raise FileError(f"there is no row of numbers{below}; a row for each sample is needed")
    numbers, rows, width = _even_rows(lines, separator, len(columns))
    if not columns and (columns := _columns_in_remark(text, numbers[0] - 1, separator, width)):
        named = f"line {numbers[0] - 1}, a remark, is read as the names of the columns"
        is_sure = separator or any(column.name.casefold() in TIMES for column in columns)
        notes = [*notes, named if is_sure else Step(named, DOUBT)]
    columns = columns or [Column(name="")] * width
    if receipts:
        is_taken = any(column.name.casefold() in TIMES for column in columns)
        columns = [Column(name="received" if is_taken else "time"), *columns]
        mark = separator or " "
        rows = [f"{receipts[k]}{mark}{row}" for k, row in zip(numbers, rows, strict=True)]
    table = TextTable(
        columns=columns,
        notes=notes,
        rows=rows,
        lines=numbers,
        separator=separator,
        is_mixed=is_mixed,
        decimal=decimal,
        ways_out=ways_out,
    )
    if long := long_table(columns, _first_cells(table), table.texts):
        note, columns, rows = long
        notes = [*notes, note]
        table = replace(table, columns=columns, rows=rows, separator=REWRITTEN, notes=notes)
    return _with_plain_cells(table, _first_cells(table))


def _without_remarks(text: str) -> Lines:
    """Return the lines of a text that are neither empty nor remarks, with their numbers from 1.

    A line of units may begin with %, too. The line above it is no remark, as names are not.
    """
    lines, is_below_remark = list[tuple[int, str]](), True
    for k, line in enumerate(text.splitlines(), start=1):
        if start := line.lstrip()[:1]:
            is_below_remark = start in _REMARK_MARKS and (is_below_remark or not _is_units(line))
            if not is_below_remark:
                lines.append((k, line))
    return lines


def _columns_in_remark(text: str, k: int, separator: str, width: int) -> list[Column]:
    """Return the columns that line k names, a remark as numpy.savetxt writes it; [] for another.

    Between blanks, a remark of as many words as there are columns may be a sentence.
    """
    line = text.splitlines()[k - 1].strip() if k else ""
    cells = split(line.lstrip("".join(_REMARK_MARKS)).strip(), separator)
    names = [cell.strip().strip('"') for cell in cells]
    is_named = line[:1] in _REMARK_MARKS and len({*names}) == width == len(names) > 1
    is_named &= all(kind(name) is CellKind.WORD for name in names)
    return columns_of(names) if is_named else []


def _is_units(line: str) -> bool:
    """Return whether a line such as `%;degC` contains units; between blanks, all are known."""
    rows = [(mark, split(line, mark)) for mark in SEPARATORS if not mark or mark in line]
    return any(len(row) > 1 and share_of_units(row) >= (0.5 if mark else 1) for mark, row in rows)


def _require_few_cells(lines: Lines) -> None:
    """Refuse lines of so many cells that they are no samples of as many signals."""
    for k, line in lines:
        if any(len(line.split(mark or None, _MAX_CELLS)) > _MAX_CELLS for mark in SEPARATORS):
            raise FileError(
                f"line {k} has more than {_MAX_CELLS} cells; write a line for each sample, with a "
                "cell for each signal"
            )


def _without_receipts(lines: Lines) -> tuple[dict[int, str], Lines]:
    """Return the times before `->` by their line, and the lines without them."""
    if not lines or not _RECEIPT.match(lines[0][1]):
        return {}, lines
    parts = [(k, *line.rpartition("->")) for k, line in lines]
    bare_lines = [(k, line.strip(" ")) for k, _, _, line in parts if line.strip()]
    return {k: time.strip() or "NaN" for k, time, _, _ in parts}, bare_lines


def _separator(lines: Lines) -> tuple[str, Lines]:
    """Return the separator of the cells, "" for blanks, and the lines without Excel's `sep=`.

    The separator gives the longest run of rows; of equal runs, one below a line of as many cells.
    """
    declared = lines[0][1].strip('" \r') if lines else ""
    if declared.casefold() in {f"sep={mark}" for mark in SEPARATORS if mark}:
        return declared[-1], lines[1:]
    texts = [line for _, line in lines[:PROBED_LINES]]
    best = next(s for s in SEPARATORS if not s or any(s in text for text in texts))
    most = (0, False)
    for separator in SEPARATORS:
        probed = [split(text, separator) for text in texts]
        run = longest_run(probed)
        if separator == "," and run and any(map(_TWO_NUMBERS.fullmatch, probed[run.start])):
            continue  # decimal commas, and blanks between the cells
        if run and (width := len(probed[run[-1]])) > 1:
            size = len(run), run.start > 0 and len(probed[run.start - 1]) == width
            best, most = (separator, size) if size > most else (best, most)
    return best, lines


def _even_rows(
    lines: Lines, separator: str, names: int
) -> tuple[Sequence[int], Sequence[str], int]:
    """Return the line numbers, the rows, and the number of cells that each row has."""
    numbers, rows = zip(*lines, strict=True)
    width = names or len(split(rows[0], separator))
    # A separator at the end of each row is not followed by a column, unless a name follows it.
    ends = separator and (not names or len(split(rows[0], separator)) == width + 1)
    if ends and all(row.rstrip(" \r").endswith(separator) for row in rows):
        rows = tuple(row.rstrip(" \r")[:-1] for row in rows)
        width = names or width - 1
    for line, row in zip(numbers, rows, strict=True):
        if (cells := len(split(row, separator))) != width:
            whose = "the line of names" if names else "the first row"
            how = f" (separated by {SEPARATORS[separator]})" if separator in SEPARATORS else ""
            text = f"line {line} has {plural(cells, 'cell')}{how}, {whose} {plural(width, 'cell')}"
            more = "; if decimals have a comma, separate the cells by semicolon or tab"
            more *= separator == "," and width < cells <= 2 * width
            rule = "give every row the same number, and begin remarks with #"
            raise FileError(f"{text}; {rule}{more}")
    return numbers, rows, width


def _first_cells(table: TextTable) -> list[str]:
    """Return the first cell with a value of each column; "" if the first rows have none."""
    firsts = [""] * len(table.columns)
    for row in table.rows[:_MAX_ROWS_WITHOUT_VALUE]:
        cells = split(row, table.separator)
        firsts = [a or ("" if is_missing(b) else b) for a, b in zip(firsts, cells, strict=True)]
        if all(firsts):
            break
    return firsts


def _with_plain_cells(table: TextTable, firsts: Sequence[str]) -> TextTable:
    """Return the table with the units that are in its cells, and with its switches as numbers."""
    columns, notes = list(table.columns), list(table.notes)
    units, switches = dict[int, str](), list[int]()
    for i, (column, first) in enumerate(zip(columns, firsts, strict=True)):
        if kind(first) is CellKind.QUANTITY:
            units[i] = unit = quantity(first)[1]
            columns[i] = replace(column, unit=unit)
            if column.unit not in ("", unit):
                text = (
                    f"{shorten(column.name)}: the unit {shorten(unit)} of the values is read, not "
                )
                notes.append(Step(f"{text}{shorten(column.unit)} of the header", DOUBT))
        elif kind(first) is CellKind.SWITCH and _SWITCH_KINDS.issuperset(
            map(kind, {*table.texts(i)})
        ):
            switches.append(i)
    if switches:
        names = ", ".join(columns[i].name or str(i + 1) for i in switches)
        notes.append(f"read the words of a switch as 1 and 0: {shorten(names)}")
    return replace(table, columns=columns, notes=notes, units_in_cells=units, switches=switches)
