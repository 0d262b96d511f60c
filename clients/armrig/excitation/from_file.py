"""Inputs from a text file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import read_text
from armrig_core.process.calls import checked_call

from armrig.data.columns import interval
from armrig.excitation.levels import HIGHEST_V, LOWEST_V, Vector, require_levels
from armrig.numerics.checks import require_numbers

_SEPARATORS = str.maketrans(",;", "  ")
MOST_BYTES = 1 << 26
"""Largest size of a file, in bytes. A million rows of two numbers need half of this size."""
MAX_TIME_ERROR = 0.01  # share of Ts; the rounding of times in a text file is smaller


@checked_call
def from_csv(
    path: str | Path, Ts: float, *, low: float = LOWEST_V, high: float = HIGHEST_V
) -> Vector:
    """Return the input (N,) from a text file, and check the times in the file against Ts.

    A row contains u in V, or t in s and u in V. The first row may contain the names t and u. With
    these names, the columns may have any order. Columns are separated by comma, semicolon or white
    space. A line that begins with # is skipped.

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

    Raises
    ------
    ValueError
        A row is not numeric, its t does not agree with Ts, or its u is outside [low, high]. The
        message names the first such row.
    OSError
        The file cannot be read.

    Examples
    --------
    >>> import armrig, numpy as np
    >>> rows = [[0, 1], [0.01, 1], [0.02, 4]]
    >>> np.savetxt("mine.csv", rows, delimiter=",", header="t,u", comments="")
    >>> armrig.from_csv("mine.csv", Ts=0.01)
    array([1., 1., 4.])
    """
    path = Path(path)
    try:
        text = read_text(path, MOST_BYTES)
    except FileError as err:
        raise InputError(f"{path}: {err}, as a CSV") from err
    return from_text(text, Ts, name=path, low=low, high=high)


def from_text(
    text: str, Ts: float, *, name: str | Path, low: float = LOWEST_V, high: float = HIGHEST_V
) -> Vector:
    """Return the input (N,) from `text`, the content of the file `name`; see `from_csv`."""
    require_levels(low=low, high=high)
    require_numbers(Ts=Ts)
    interval(Ts)
    (t, u), rows = _table(name, text)
    if t is not None:
        _require_times(name, t, rows, Ts)
    outside = ~((u >= low) & (u <= high))
    if outside.any():
        k = int(np.argmax(outside))
        raise InputError(
            f"{name}: {np.count_nonzero(outside)} of {u.size} values outside {low:g} to {high:g} "
            f"V, first in row {rows[k]}: u={u[k]:g} V (sample {k}); scale or shift the signal"
        )
    return u


def _require_times(path: str | Path, t: Vector, rows: list[int], Ts: float) -> None:
    due = t[0] + Ts * np.arange(t.size)
    wrong = ~(np.abs(t - due) <= MAX_TIME_ERROR * Ts)  # also finds NaN
    if wrong.any():
        k = int(np.argmax(wrong))
        raise InputError(
            f"{path}, row {rows[k]}: t={t[k]:.9g} s, but Ts={Ts:g} s gives {due[k]:.9g} s; "
            "the time vector must agree with the step size. Sample u again, or play it with "
            f"another Ts (the file's times are {np.median(np.diff(t)):.6g} s apart)"
        )


def _table(path: str | Path, text: str) -> tuple[tuple[Vector | None, Vector], list[int]]:
    """Return (t, u) and the line number of each row, counted from 1; t may be None."""
    given = [
        (k, line)
        for k, line in enumerate(text.splitlines(), start=1)
        if line.translate(_SEPARATORS).strip() and not line.lstrip().startswith("#")
    ]
    cells = [line.translate(_SEPARATORS).split() for _, line in given]
    names: list[str] = []
    if cells and not _is_number(cells[0][0]):
        names = [name.strip("\"'").lower() for name in cells.pop(0)]
        del given[0]
    if not cells:
        raise InputError(
            f"{path}: no row of numbers; give one row for each sample: u in V, or two columns, "
            "t in s and u in V"
        )
    width = len(cells[0])
    for (row, _), words in zip(given, cells, strict=True):
        if len(words) != width or width > 2:
            raise InputError(
                f"{path}, row {row}: {len(words)} columns; give u, or t and u, in every row "
                "(with a point, not a comma, before the decimals)"
            )
        if not all(map(_is_number, words)):
            msg = f"{path}, row {row}: {' '.join(words)!r} must be one number in each column"
            raise InputError(msg)
    columns = ["t", "u"][-width:]
    if sorted(names) not in ([], columns):
        raise InputError(
            f"{path}: columns {', '.join(names)}; name them t and u, or one column u, or leave the "
            "names out: u drives the motor"
        )
    if width == 2 and not names and all(re.fullmatch(r"\s*-?\d+,\d+\s*", x) for _, x in given):
        raise InputError(
            f"{path}: a comma separates what may be one number (0,5); name the columns t and u in "
            "the first row, or separate them by a semicolon and write 0.5"
        )
    numbers = dict(zip(names or columns, np.array(cells, dtype=np.float64).T.copy(), strict=True))
    return (numbers.get("t"), numbers["u"]), [row for row, _ in given]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
