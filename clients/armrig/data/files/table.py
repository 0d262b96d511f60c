"""Columns of numbers with names, whatever kind of file they came from."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from armrig_core.errors import FileError
from armrig_core.printable import printable
from numpy.typing import NDArray

Vector = NDArray[np.float64]

_LISTED = 12  # columns that a message names
_WIDEST = 40  # characters of a file that a message repeats
_MOST_DIGITS = 9  # of the number of a column
_UNIT = re.compile(r"(?P<name>.+?)(?:\s*\[(?P<unit>[^][]*)\]|\s+\((?P<other>[^()]*)\))")


class NoColumnError(FileError):
    """A column that was asked for is not there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """What is known of a column beside its numbers."""

    name: str
    """Its name, "" where the file gives none."""
    unit: str = ""
    """Its unit, from a header such as `u [V]` or `u (V)`."""


class Table(Protocol):
    """Columns that all have a value, or none, at each instant."""

    @property
    def columns(self) -> Sequence[Column]:
        """Names and units, in the file's order."""

    @property
    def refused(self) -> Mapping[str, str]:
        """What else the file holds, by name, and why it is no column of numbers."""

    @property
    def Ts(self) -> float | None:
        """Sampling time in s, where the file says it beside the columns."""

    @property
    def notes(self) -> Sequence[str]:
        """What was made of what holds no values."""

    def numbers(self, i: int) -> Vector:
        """Return the values of column i, from 0; NaN where one is missing.

        Raises
        ------
        FileError
            One is no number; the first such place is named.
        """

    def place(self, k: int) -> str:
        """Return where in the file instant k stands."""


def titled(heading: str) -> Column:
    """Return the column that a header names, its unit apart: `u [V]` or `u (V)`."""
    found = _UNIT.fullmatch(heading)
    if found is None:
        return Column(name=heading)
    return Column(name=found["name"].strip(), unit=(found["unit"] or found["other"] or "").strip())


def chosen(table: Table, wanted: str, what: str) -> int:
    """Return the index of a column that was asked for by name, or by number from 1.

    Parameters
    ----------
    wanted : str
        Its name, with or without its unit; small and capital letters are only told apart where
        both are there. The number holds where no column has it for a name.
    what : str
        What it is for: input, signal or time; for the message.

    Raises
    ------
    NoColumnError
        There is no such column.
    FileError
        There are several.
    """
    asked = wanted.strip()
    for same in (_same, _same_but_for_case, _same_last_part):
        found = [i for i, column in enumerate(table.columns) if same(column, asked)]
        if len(found) == 1:
            return found[0]
        if found:
            numbers = " and ".join(str(i + 1) for i in found[:_LISTED])
            raise FileError(
                f"{what} {shown(asked)}: columns {numbers} are named so; give the number"
            )
    if asked.isdecimal() and len(asked) <= _MOST_DIGITS and 1 <= int(asked) <= len(table.columns):
        return int(asked) - 1
    if asked in table.refused:
        raise FileError(f"{what} {shown(asked)}: {table.refused[asked]}")
    raise NoColumnError(f"{what} {shown(asked)}: there is no such column; {listed(table, what)}")


def listed(table: Table, what: str) -> str:
    """Return which columns there are, and how to ask for one for input, signal or time."""
    count = len(table.columns)
    if not count:
        held = "; ".join(f"{shown(name)} {why}" for name, why in table.refused.items())
        return "there is no column of numbers" + (f" ({held})" if held else "")
    if not any(column.name for column in table.columns):
        numbers = " or ".join(str(i + 1) for i in range(count))
        numbers = numbers if count <= 2 else f"a number from 1 to {count}"
        return f"its columns have no names: give --{what} {numbers}"
    if count == 1 and what != "time":
        return "it has one column, and an input and an output are wanted"
    names = [f"{i} {shown(c.name) or '(no name)'}" for i, c in enumerate(table.columns, 1)]
    more = f", … {count}" if count > _LISTED else ""
    return f"give --{what} a name or a number of {', '.join(names[:_LISTED])}{more}"


def shown(text: str) -> str:
    """Return a text of the file as a message repeats it: not more than a line has room for."""
    return printable(text if len(text) <= _WIDEST else f"{text[: _WIDEST - 1]}…")


def _same(column: Column, asked: str) -> bool:
    return asked == column.name != "" or titled(asked) == column


def _same_but_for_case(column: Column, asked: str) -> bool:
    return column.name.casefold() == titled(asked).name.casefold() != ""


def _same_last_part(column: Column, asked: str) -> bool:
    """Return whether it is a field of a structure: `u` of `data.u`."""
    return "." in column.name and column.name.rpartition(".")[2] == asked
