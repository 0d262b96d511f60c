"""Cells of a line of text: how they are separated, and what a cell contains."""

from __future__ import annotations

import csv
import re
from enum import Enum, auto

from armrig_core.errors import FileError

from armrig.data.files.decimal_marks import is_missing, number
from armrig.data.files.table import shown

SEPARATORS = {";": "semicolon", "\t": "tab", ",": "comma", "": "blanks"}
"""Separators of the cells in a file, and their names."""
REWRITTEN = "\x1f"
"""Separator of the cells in a row that armrig composed; no cell contains it."""
SWITCH = {"true": "1", "false": "0", "on": "1", "off": "0"}
"""Numbers of the words of a switch."""

_QUANTITY = re.compile(
    r"(?P<number>[+-]?\s*(?!0[xX])(?:\d[\d.,'\u2019]*|[.,]\d+)(?:[eE][+-]?\d+)?)\s*"
    r"(?P<unit>(?![eE]$)(?:[^\W\d_]|[%‰°′″℃℉])(?:[^\d:;,]|(?<=[a-zA-Z^-])[1-4](?!\d)){0,15})"
)
_PLAIN_NUMBER = re.compile(r"[+-]?\s*\d[\d.,]*")  # with marks between thousands, too
_TIME = re.compile(r"\d+[-/.:](?:\d+|[A-Za-z]{3})[-/.: T]\s*\d.*|\d{1,3}:\d\d.*|\d{8}T\d.*")


class Kind(Enum):
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
        raise FileError(f"'{shown(line)}' cannot be split into cells: {err}") from err


def quantity(cell: str) -> tuple[str, str]:
    """Return the number and the unit of a cell such as `20 °C`; the unit is "" without one."""
    parts = _QUANTITY.fullmatch(cell.strip())
    return (parts["number"], parts["unit"].strip()) if parts else (cell, "")


def kind(cell: str) -> Kind:
    """Return the kind of the content of a cell."""
    text = cell.strip()
    if is_missing(text):
        return Kind.MISSING
    if number(text, "") is not None or _PLAIN_NUMBER.fullmatch(text):
        return Kind.NUMBER
    if text.casefold() in SWITCH:
        return Kind.SWITCH
    if _TIME.fullmatch(text):
        return Kind.TIME
    return Kind.QUANTITY if _QUANTITY.fullmatch(text) else Kind.WORD
