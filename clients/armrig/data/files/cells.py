"""Cells of a line of text: how they are separated, what a cell contains, and its decimal mark."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Sequence
from enum import Enum, auto

from armrig_core.errors import FileError

from armrig.data.files.table import shorten

SEPARATORS = {";": "semicolon", "\t": "tab", ",": "comma", "": "blanks"}
"""Separators of the cells in a file, and their names."""
REWRITTEN = "\x1f"
"""Separator of the cells in a row that armrig composed; no cell contains it."""
SWITCH = {"true": "1", "false": "0", "on": "1", "off": "0"}
"""Numbers of the words of a switch."""
_NOT_WORDS = frozenset({"inf", "infinity", *SWITCH})

_QUANTITY = re.compile(
    r"(?P<number>[+-]?\s*(?!0[xX])(?:\d[\d.,'\u2019]*|[.,]\d+)(?:[eE][+-]?\d+)?)\s*"
    r"(?P<unit>(?![eE]$)(?:[^\W\d_]|[%‰°′″℃℉])(?:[^\d:;,]|(?<=[a-zA-Z^-])[1-4](?!\d)){0,15})"
)
_LETTERS = re.compile(r"[^\W\d_]+")
_PLAIN_NUMBER = re.compile(r"[+-]?\s*\d[\d.,]*")  # with marks between thousands, too
_TIME = re.compile(r"\d+[-/.:](?:\d+|[A-Za-z]{3})[-/.: T]\s*\d.*|\d{1,3}:\d\d.*|\d{8}T\d.*")
_MISSING = frozenset(
    {"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---", "unavailable", "unknown"}
)
_NUMBER = re.compile(r"[+-]?(?P<whole>[\d.,]*?)(?:(?P<mark>[.,])(?P<part>\d*))?(?P<power>[eE].*)?")
_OTHER = {".": ",", ",": "."}
_GROUPED = {
    mark: re.compile(rf"[+-]?\d{{1,3}}(?:{re.escape(mark)}\d{{3}})+(?!\d)") for mark in _OTHER
}
_BETWEEN_GROUPS = re.compile(r"(?<=\d)['\u2019\u00a0\u202f\u2009 ](?=\d{3}(?!\d))")
_GROUP = 3  # digits
_LARGE = 100.0  # whole numbers from here on, without a mark, may lie below grouped thousands


class CellKind(Enum):
    """Kind of the content of a cell."""

    MISSING = auto()
    NUMBER = auto()
    QUANTITY = auto()
    """A number with a unit, such as `20 °C`."""
    TIME = auto()
    """A date or a time of day."""
    SWITCH = auto()
    """True, False, on or off."""
    WORD = auto()


def split(line: str, separator: str) -> list[str]:
    """Return the cells of a line; the separator "" means blanks."""
    if not separator:
        return line.split()
    if '"' not in line or separator == REWRITTEN:
        return line.split(separator)
    try:
        # Not strict=True, which refuses blanks after a quote.
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    except csv.Error as err:
        raise FileError(f"'{shorten(line)}' cannot be split into cells: {err}") from err


def quantity(cell: str) -> tuple[str, str]:
    """Return the number and the unit of a cell such as `20 °C`; the unit is "" without one."""
    parts = _QUANTITY.fullmatch(cell.strip())
    return (parts["number"], parts["unit"].strip()) if parts else (cell, "")


def kind(cell: str) -> CellKind:
    """Return the kind of the content of a cell."""
    text = cell.strip()
    if is_missing(text):
        return CellKind.MISSING
    if _LETTERS.fullmatch(text) and text.casefold() not in _NOT_WORDS:
        return CellKind.WORD  # first, because a line may have thousands of words
    if number(text, "") is not None or _PLAIN_NUMBER.fullmatch(text):
        return CellKind.NUMBER
    if text.casefold() in SWITCH:
        return CellKind.SWITCH
    if _TIME.fullmatch(text):
        return CellKind.TIME
    return CellKind.QUANTITY if _QUANTITY.fullmatch(text) else CellKind.WORD


# ---- decimal marks


def number(cell: str, mark: str) -> float | None:
    """Return the number in a cell, NaN if missing, None for other text; "" means both marks."""
    text = _plain(cell)
    if text.casefold() in _MISSING:
        return float("nan")
    if "_" in text:  # Python reads 1_000 as a number
        return None
    grouped = _OTHER.get(mark)
    if grouped and grouped in text and _GROUPED[grouped].match(text):
        text = text.replace(grouped, "")
    try:
        return float(text.replace(mark or ",", "."))
    except ValueError:
        return None


def is_missing(cell: str) -> bool:
    """Return whether a cell contains no value."""
    return cell.strip().casefold() in _MISSING


def mark_of(column: Iterable[str], of_file: Callable[[], set[str]], *, mixed: bool) -> str | None:
    """Return the decimal mark of a column, or None if its numbers may be read with either mark.

    A cell such as 0,5 or 1,234.5 proves its mark; 1,493 may be thousands. The column decides, then
    the marks that all columns of the file prove. If none proves a mark, a point is the mark. There
    are two exceptions: all numbers have a point before exactly three digits, or the other numbers
    are whole and have three digits. If `mixed`, a comma does not separate the cells. A column may
    then contain both marks, as in a merged file, and the result is "".
    """
    cells = {_plain(cell) for cell in set(column)}
    marks = {cell: _mark(cell) for cell in cells}
    doubtful = {mark for mark, is_sure in marks.values() if not is_sure}
    proved = sure_marks(cells)
    if len(proved) == 1 or not doubtful:
        return proved.pop() if len(proved) == 1 else "" if mixed and proved else "."
    if proved:
        return None
    if len(proved := of_file()) == 1:
        return next(iter(proved))
    plain = [cell for cell in cells if marks[cell][1] and cell.casefold() not in _MISSING]
    if "," in doubtful or (mixed and not plain):
        return None
    numbers = [abs(float(cell)) for cell in plain if cell.lstrip("+-").isdecimal()]
    return None if numbers and _LARGE <= max(numbers) < 10**_GROUP else "."


def sure_marks(cells: Iterable[str]) -> set[str]:
    """Return the decimal marks that cells prove."""
    return {mark for mark, is_sure in map(_mark, map(_plain, cells)) if is_sure} - {""}


def contradicts(column: Iterable[str], mark: str) -> int | None:
    """Return the index of the first cell that proves another decimal mark; None if none does."""
    return next((k for k, cell in enumerate(column) if sure_marks([cell]) == {_OTHER[mark]}), None)


def doubtful_cell(column: Sequence[str]) -> tuple[int, str]:
    """Return the index of the first cell that may be read in two ways, and the two numbers."""
    k = next(k for k, cell in enumerate(column) if not _mark(_plain(cell))[1])
    text = _plain(column[k])
    return k, f"{text.replace(',', '.')} or {text.replace(',', '').replace('.', '')}"


def _plain(cell: str) -> str:
    """Return the text of a cell with an ASCII minus, without blanks after it or in thousands."""
    text = _BETWEEN_GROUPS.sub("", cell.strip().replace("\N{MINUS SIGN}", "-"))
    return text[0] + text[1:].lstrip() if text[:1] in ("+", "-") else text


def _mark(cell: str) -> tuple[str, bool]:
    """Return the decimal mark of a number, "" without one, and whether it is certain."""
    parts = _NUMBER.fullmatch(cell)
    mark = parts["mark"] if parts and any(map(str.isdecimal, cell)) else None
    if parts is None or mark is None:
        return "", True
    if cell.count(mark) > 1:
        return (_OTHER[mark] if _GROUPED[mark].fullmatch(cell) else ""), True
    integer = parts["whole"]
    can_be_grouped = integer.isdecimal() and integer[0] != "0" and len(integer) <= _GROUP
    return mark, bool(parts["power"]) or len(parts["part"]) != _GROUP or not can_be_grouped
