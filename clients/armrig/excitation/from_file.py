"""Inputs from a text file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import read_text
from armrig_core.process.calls import with_argument_checks
from armrig_core.rig.description import Input

from armrig.data.columns import interval
from armrig.data.files.text import TextTable
from armrig.data.files.text import read_text as read_table
from armrig.excitation.levels import HIGHEST_V, LOWEST_V, Vector, require_levels
from armrig.numerics.checks import require_numbers
from armrig.numerics.quantities import plural

# An input file has no missing value, and no option for its decimal mark.
_WAYS_OUT = ("", "Write 0.5 for a half")
MOST_BYTES = 1 << 26
"""Largest size of a file, in bytes. A million rows of two numbers need half of this size."""
_U = Input()
MAX_TIME_ERROR = 0.01  # share of Ts; the rounding of times in a text file is smaller


@with_argument_checks
def input_from_file(
    path: str | Path,
    Ts: float,
    *,
    low: float = LOWEST_V,
    high: float = HIGHEST_V,
    input: Input = _U,
) -> Vector:
    """Return the input (N,) from a text file, and check the times in the file against Ts.

    A row contains u in V, or t in s and u in V. The first row may contain the names t and u. With
    these names, the columns may have any order. Separators, decimal marks and remarks are those of
    `armrig.load_data`: a decimal comma is read if semicolon or tab separates the columns.

    Parameters
    ----------
    path : str or Path
        Text file.
    Ts : float
        Sampling time of the run, in s. According to section 3.2 of the handout, the time vector
        "must agree with the chosen step size". The expected time of sample k is the time of the
        first sample plus k Ts. The time in the file may differ from the expected time by at most a
        hundredth of Ts.
    low, high : float
        Allowed interval of u in V, 0 <= low < high <= 5.
    input : Input, optional
        Input of the rig's description. A column with its name has the input's own value.

    Raises
    ------
    ValueError
        A row is not numeric, its t does not agree with Ts, or its u is outside [low, high]. The
        message names its line.
    OSError
        The file cannot be read.

    Examples
    --------
    >>> import armrig, numpy as np
    >>> rows = [[0, 1], [0.01, 1], [0.02, 4]]
    >>> np.savetxt("mine.csv", rows, delimiter=",", header="t,u", comments="")
    >>> armrig.input_from_file("mine.csv", Ts=0.01)
    array([1., 1., 4.])
    """
    return from_text(_text(path), Ts, name=path, low=low, high=high, input=input)


def _text(path: str | Path) -> str:
    try:
        return read_text(Path(path), MOST_BYTES)
    except FileError as err:
        raise InputError(f"{path}: {err}, as a CSV") from err


def has_named_columns(path: Path) -> bool:
    """Return whether a column of an input file has another name than t and u."""
    table = read_table(_text(path), ways_out=_WAYS_OUT)
    names = {column.name.strip("\"'").lower() for column in table.columns}
    return bool(names - {"", "t", "u"})


def from_text(
    text: str,
    Ts: float,
    *,
    name: str | Path,
    low: float = LOWEST_V,
    high: float = HIGHEST_V,
    input: Input = _U,
) -> Vector:
    """Return the input (N,) from `text`, the content of the file `name`; see `input_from_file`."""
    require_levels(low=low, high=high)
    require_numbers(Ts=Ts)
    interval(Ts)
    t, u, table = _columns(name, text, input)
    if t is not None:
        _require_times(name, t, table, Ts)
    outside = ~((u >= low) & (u <= high))
    if outside.any():
        k = int(np.argmax(outside))
        raise InputError(
            f"{name}: {np.count_nonzero(outside)} of {u.size} values outside {low:g} to {high:g} "
            f"V, first in {table.place(k)}: u={u[k]:g} V (sample {k}); scale or shift the signal"
        )
    return u


def reference_from_file(path: str | Path, Ts: float, unit: str) -> Vector:
    """Return the reference (N,) from a text file, and check the times in the file against Ts.

    A row contains r, or t in s and r; the first row may contain the names t and r.

    Raises InputError if a row is not numeric, or its t does not agree with Ts.
    """
    t, r, table = _columns(path, _text(path), Input(name="r", unit=unit))
    if t is not None:
        _require_times(path, t, table, Ts)
    return r


def _require_times(path: str | Path, t: Vector, table: TextTable, Ts: float) -> None:
    due = t[0] + Ts * np.arange(t.size)
    wrong = ~(np.abs(t - due) <= MAX_TIME_ERROR * Ts)  # also finds NaN
    if wrong.any():
        k = int(np.argmax(wrong))
        raise InputError(
            f"{path}, {table.place(k)}: t={t[k]:.9g} s, but Ts={Ts:g} s gives {due[k]:.9g} s; "
            "the time vector must agree with the step size. Sample u again, or play it with "
            f"another Ts (the file's times are {np.median(np.diff(t)):.6g} s apart)"
        )


def _columns(name: str | Path, text: str, input: Input) -> tuple[Vector | None, Vector, TextTable]:
    """Return t, or None, and u in V, and their table."""
    try:
        table = read_table(text, ways_out=_WAYS_OUT)
        values = [table.numbers(i) for i in range(len(table.columns))]
    except FileError as err:
        raise InputError(f"{name}: {err}") from err
    width, names = len(values), [column.name.strip("\"'").lower() for column in table.columns]
    if width > 2:
        raise InputError(f"{name}: {plural(width, 'column')}; give u in V, or t in s and u in V")
    input_name = input.name.lower()
    is_own = input_name != "u" and input_name in names
    u, titles = (input_name if is_own else "u"), ["t", "u"][-width:]
    if any(names) and sorted(names) != sorted(["t", u][-width:]):
        also = f" (or {input.name} in {input.unit})" if input_name != "u" else ""
        raise InputError(
            f"{name}: columns {', '.join(names)}; name them t and u{also}, or one column u, or "
            "leave the names out: u drives the motor"
        )
    units = {"t": "s", u: input.unit if is_own else "V"}
    for title, column in zip(names, table.columns, strict=True):
        if column.unit not in ("", units.get(title)):
            raise InputError(f"{name}: {title} in {column.unit}; give t in s and {u} in {units[u]}")
    if (
        width == 2
        and not any(names)
        and all(re.fullmatch(r"\s*-?\d+,\d+\s*", x) for x in table.rows)
    ):
        raise InputError(
            f"{name}: a comma separates what may be one number (0,5); name the columns t and u in "
            "the first row, or separate them by a semicolon"
        )
    columns = dict(zip(names if any(names) else titles, values, strict=True))
    return columns.get("t"), input.volts(columns[u]) if is_own else columns["u"], table
