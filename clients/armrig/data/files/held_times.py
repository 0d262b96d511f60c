"""Values of one clock, held to the times of another clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.clock_table import Rows
from armrig.data.files.stamps import Times
from armrig.data.files.table import ReadingError, Table, Vector, listed
from armrig.numerics import quantities
from armrig.numerics.quantities import plural

NEAR = 0.5
"""Relative deviation of an interval of regular times from the usual one."""
MIN_UNUSED = 0.1
"""Share of values between the instants that a note names."""
_MIN_REGULAR = 0.8  # share of near intervals
_MIN_OVERLAP = 0.5  # of the shorter record
_MAX_HELD = 3.0  # usual intervals for which a value of a regular clock is held
_ROUNDING = 1e-6  # of an interval, between equal times of two clocks


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock:
    """Times, and the columns that have a value at each of them."""

    at: int
    """Index of the column of times."""
    name: str
    """Name of the column of times in messages."""
    label: str
    """Text in the name of the times by which they differ from other times."""
    rows: Rows
    """Rows of the table that have a time, shape (N,)."""
    times: Times
    """Times of these rows."""
    columns: Sequence[int] = ()
    """Indices of the columns."""


def are_near(d: Vector, share: float) -> bool:
    """Return whether most intervals are near the usual one."""
    usual = float(np.median(d)) if d.size else 0.0
    return bool(usual and np.mean(np.abs(d - usual) <= share * abs(usual)) >= _MIN_REGULAR)


def no_output(table: Table, names: Sequence[str]) -> ReadingError:
    """Return the error of a table whose clocks need an output."""
    return ReadingError(
        f"it has several clocks, {quantities.listed(names)}: {listed(table, 'signal')}, the output "
        "to whose times the other columns are held",
        "--signal NAME",
    )


def rounding(a: Times, b: Times, usual: float) -> float:
    """Return the largest difference, in s, of equal times."""
    return _ROUNDING * usual + 2 * float(np.spacing(max(abs(a.begin), abs(b.begin))))


def overlap(a: Times, b: Times) -> bool:
    """Return whether the records overlap by at least half of the shorter one."""
    (first, last), (other, end) = _span(a), _span(b)
    shared = min(last, end) - max(first, other)
    return shared >= _MIN_OVERLAP * min(last - first, end - other)


def _span(times: Times) -> tuple[float, float]:
    """Return the first and the last time, in s from the origin of the clock."""
    return times.begin + float(times.t.min()), times.begin + float(times.t.max())


def newest_rows(master: Clock, other: Clock, columns: str, signal: str) -> tuple[Rows, str]:
    """Return the row of another clock at each time of a master, -1 for none, and facts.

    Raises FileError if the two clocks cannot be compared.
    """
    a, b = master.times, other.times
    if a.clock != b.clock or not overlap(a, b):
        ranges = [
            f"{clock.name} goes from {first:.10g} to {last:.10g} {clock.times.clock or 's'}"
            for clock in (other, master)
            for first, last in [_span(clock.times)]
        ]
        raise FileError(
            f"{' and '.join(ranges)}: {columns} cannot be held to the times of {signal}. Write "
            "both times from the same beginning, with their units in the names; if they belong to "
            f"the same rows, delete {other.name}"
        )
    for clock in (other, master):
        d = np.diff(clock.times.t)
        if np.any(d < 0) and np.any(d > 0):
            k = int(np.argmax(d < 0 if np.median(d) > 0 else d > 0)) + 1
            raise FileError(
                f"{clock.times.place(k)}: {clock.name} goes back here, so {columns} cannot be held "
                f"to the times of {signal}; cut the file there"
            )
    rows, k, skipped = held_at(a.t, b.t + (b.begin - a.begin), rounding(a, b, usual_interval(a.t)))
    more = ""
    if skipped > MIN_UNUSED * b.t.size:
        more += f"; {plural(skipped, 'value')} of {columns} between these times are not used"
    if k:
        more += f"; not known in {plural(k, 'row')}, over {_MAX_HELD:g} intervals after a value"
    return np.append(other.rows, -1)[rows], more


def usual_interval(t: Vector) -> float:
    """Return the usual interval of times, in s."""
    return float(np.median(np.abs(np.diff(t)))) if t.size > 1 else 0.0


def held_at(t: Vector, others: Vector, error: float) -> tuple[Rows, int, int]:
    """Return the index of the newest of other times at each time, -1 for none.

    The second result counts the times that are too far from the last of regular other times, the
    third one the other times that are used nowhere.
    """
    order = np.argsort(others, kind="stable")
    k = np.searchsorted(others[order], t + error, side="right") - 1
    rows = np.where(k >= 0, order[k], -1)
    d = np.diff(others[order])
    far = (k >= 0) & (t - others[order][k] > _MAX_HELD * usual_interval(others[order]) + error)
    far &= are_near(d, NEAR)
    rows[far] = -1
    between = np.count_nonzero((others >= t.min()) & (others <= t.max()))
    return rows, int(np.count_nonzero(far)), int(between - np.unique(rows[rows >= 0]).size)
