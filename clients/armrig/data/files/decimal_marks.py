"""The decimal mark of a column of text, decided by all numbers of the file."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from armrig_core.errors import FileError

MISSING = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---"})
"""Texts of a missing value, in lower case."""
_NUMBER = re.compile(r"[+-]?(?P<whole>[\d.,]*?)(?:(?P<mark>[.,])(?P<part>\d*))?(?P<power>[eE].*)?")
_GROUPED = {
    mark: re.compile(rf"[+-]?\d{{1,3}}(?:{re.escape(mark)}\d{{3}})+(?!\d)") for mark in ".,"
}
_BETWEEN_GROUPS = re.compile(r"(?<=\d)['\u2019\u00a0\u202f\u2009 ](?=\d{3}(?!\d))")
_GROUP = 3  # digits
_LARGE = 100.0  # whole numbers from here on, without a mark, may lie below grouped thousands


def plain(cell: str) -> str:
    """Return the text of a cell with an ASCII minus and without blanks between thousands."""
    return _BETWEEN_GROUPS.sub("", cell.strip().replace("\N{MINUS SIGN}", "-"))


def number(cell: str, mark: str) -> float | None:
    """Return the number in a cell, NaN for a missing value, None for other text."""
    text = plain(cell)
    if text.casefold() in MISSING:
        return float("nan")
    if "_" in text:  # Python reads 1_000 as a number
        return None
    other = "," if mark == "." else "."
    if other in text and _GROUPED[other].match(text):
        text = text.replace(other, "")
    try:
        return float(text.replace(mark, "."))
    except ValueError:
        return None


def mark_of(column: Sequence[str], others: Iterable[Sequence[str]], *, mixed: bool) -> str | None:
    """Return the decimal mark of a column, or None if its numbers may be read with either mark.

    A cell such as 0,5 or 1,234.5 proves its mark; 1,493 may be thousands. The column decides, then
    the other columns of the file. If none proves a mark, a point is the mark. The exception is a
    column of whole numbers of three digits and of points before exactly three digits.

    Parameters
    ----------
    column : sequence of str
        Cells of the column.
    others : iterable of sequences of str
        Cells of the other columns.
    mixed : bool
        Whether commas and points may both be decimal marks of one column, as in a merged file.
    """
    cells = {plain(cell) for cell in column}
    doubtful = {mark for cell in cells if (mark := _doubtful(cell))}
    proved = _proved(cells)
    if len(proved) == 1 or not doubtful:
        return proved.pop() if len(proved) == 1 else "." if not (mixed and proved) else ""
    if len(proved) > 1:
        return None
    proved = set().union(*(_proved(map(plain, cells)) for cells in others))
    if len(proved) == 1:
        return proved.pop()
    if "," in doubtful:
        return None
    whole = [abs(float(cell)) for cell in cells if cell.lstrip("+-").isdecimal()]
    return None if whole and _LARGE <= max(whole) < 10**_GROUP else "."


def contradicts(column: Sequence[str], mark: str) -> int | None:
    """Return the index of the first cell that proves another decimal mark; None if none does."""
    other = {"," if mark == "." else "."}
    found = (k for k, cell in enumerate(column) if _proved([plain(cell)]) == other)
    return next(found, None)


def two_readings(cell: str) -> str:
    """Return the two numbers that a cell may mean, for a message."""
    text = plain(cell)
    return f"{text.replace(',', '.')} or {text.replace(',', '').replace('.', '')}"


def doubtful_cell(column: Sequence[str]) -> int:
    """Return the index of the first cell that may be read in two ways."""
    return next(k for k, cell in enumerate(column) if _doubtful(plain(cell)))


def _proved(cells: Iterable[str]) -> set[str]:
    """Return the decimal marks that cells prove."""
    found: set[str] = set()
    for cell in cells:
        parts = _NUMBER.fullmatch(cell)
        if parts is None or parts["mark"] is None or not any(map(str.isdecimal, cell)):
            continue
        other = "." if parts["mark"] == "," else ","
        if cell.count(parts["mark"]) > 1:
            found |= {other} if _GROUPED[parts["mark"]].fullmatch(cell) else set()
        elif other in cell or not _doubtful(cell):
            found.add(parts["mark"])
    return found


def _doubtful(cell: str) -> str:
    """Return the mark of a number that may be read in two ways, such as 1,493; otherwise ""."""
    parts = _NUMBER.fullmatch(cell)
    if parts is None or parts["mark"] is None or parts["power"]:
        return ""
    if not parts["whole"].isdecimal() or len(parts["part"]) != _GROUP:
        return ""
    return "" if parts["whole"][0] == "0" or len(parts["whole"]) > _GROUP else parts["mark"]


def refused(place: str, name: str, cell: str) -> FileError:
    """Return the error about a cell that may be read in two ways."""
    return FileError(
        f"{place}, column {name}: '{cell.strip()}' may be {two_readings(cell)}: a decimal mark, or "
        "a mark between thousands? Give --decimal , or --decimal ."
    )
