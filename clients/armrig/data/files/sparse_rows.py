"""Rows that have a value of only one of several columns, as topics merged by time have."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.clock_table import Rows, known_rows, names_of, rows_of
from armrig.data.files.held_times import MIN_UNUSED, are_near, held_at, no_output
from armrig.data.files.stamps import time_columns, times_of
from armrig.data.files.table import Table, Vector
from armrig.data.step import DOUBT, Step
from armrig.numerics.quantities import plural
from armrig.numerics.stretches import Mask

_EVEN = 0.05  # relative deviation of an interval of even times from the usual one
_MAX_SHARED = 0.05  # share of rows with both values, of two columns in separate rows
_MIN_APART = 0.2  # share of rows that have only the one value, and of rows with only the other
_MIN_ROWS = 3


def complete_rows(table: Table, of_y: int | None, of_time: int | None) -> Table:
    """Return the rows with a value of the output if other columns have their values in other rows.

    A column that is written only where it changes has values in rows of the output, and stays.
    """
    times = [i for i in time_columns(table) if i != of_y] if of_time is None else [of_time]
    if of_y is None:
        masks = {i: known_rows(table, i) for i in range(len(table.columns)) if i not in times}
        counts = {i: np.count_nonzero(known) for i, known in masks.items() if known is not None}
        if not counts:
            return table
        output = max(counts, key=lambda i: counts[i])
    else:
        output = of_y
    known_y = known_rows(table, output)
    if known_y is None or known_y.all():
        return table
    read = _read_times(table, times, known_y.size)
    apart = []
    for i in range(len(table.columns)):
        known = None if i == output or i in times else known_rows(table, i)
        if known is not None and known.size == known_y.size and _are_apart(known, known_y, read):
            apart.append((i, np.flatnonzero(known)))
    if not apart:
        return table
    if of_y is None:
        raise no_output(table, [names_of(table, [i]) for i in (output, *(i for i, _ in apart))])
    rows, held, more = np.flatnonzero(known_y), dict[int, Rows](), 0
    t = np.arange(known_y.size, dtype=np.float64) if read is None else read
    for i, others in apart:
        k, _, skipped = held_at(t[rows], t[others], 0.0)
        held[i] = np.append(others, -1)[k]
        more = max(more, skipped if skipped > MIN_UNUSED * others.size else 0)
    columns, y = names_of(table, [*held]), names_of(table, [output])
    have = "has its" if len(held) == 1 else "have their"
    note = f"{columns} {have} values in other rows than {y}: held to the rows of {y}"
    note += f"; {plural(more, 'value')} between these rows are not used" * bool(more)
    return rows_of(table, rows, held=held, notes=[Step(note, DOUBT)])


def _read_times(table: Table, of_time: Sequence[int], N: int) -> Vector | None:
    """Return the times of the rows, None if they cannot be used."""
    with suppress(FileError):
        if of_time and (t := times_of(table, of_time[0]).t).size == N:
            return t
    return None


def _are_apart(a: Mask, b: Mask, t: Vector | None) -> bool:
    """Return whether two columns have their values in different rows."""
    both = np.count_nonzero(a & b)
    least = min(np.count_nonzero(a), np.count_nonzero(b))
    apart = min(np.count_nonzero(a & ~b), np.count_nonzero(b & ~a))
    if least < _MIN_ROWS or not apart:
        return False
    is_uneven = t is not None and not are_near(np.diff(t), _EVEN)
    return bool(both <= _MAX_SHARED * least or (is_uneven and apart >= _MIN_APART * a.size))
