"""Columns of one or more tables at the instants of one clock, with values of other clocks held."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from armrig_core.errors import FileError
from numpy.typing import NDArray

from armrig.data.files.cells import is_missing, number
from armrig.data.files.stamps import Times
from armrig.data.files.table import ReadingError, Table, Vector, choose, remedy, shorten
from armrig.data.files.text import TextTable
from armrig.data.step import DOUBT, Step
from armrig.numerics import quantities
from armrig.numerics.quantities import plural
from armrig.numerics.stretches import Mask

Rows = NDArray[np.intp]
_MAX_LISTED = 4
_MAX_CELLS = 64  # that show whether a column contains numbers
NEAR = 0.5
"""Relative deviation of an interval of regular times from the usual one."""
EVEN = 0.05
"""Relative deviation of an interval of even times from the usual one."""
_MIN_REGULAR = 0.8  # share of near intervals
_MIN_OVERLAP = 0.5  # of the shorter record
_MAX_HELD = 3.0  # usual intervals for which a value of a regular clock is held
_MIN_UNUSED = 0.1  # share of values between the instants that a note names
_ROUNDING = 1e-6  # of an interval, between equal times of two clocks
_COARSE = 1 - 1e-6  # of the last digit, by which a coarse copy of times differs at most
_MAX_DRIFT = 0.01  # between two clocks of the same rows


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockTable(Table):
    """Columns of one or more tables at the instants of one clock."""

    sources: Sequence[tuple[Table, int, Rows]]
    """Table of each column, index of the column, and its row at each instant; -1 for no row."""
    clock: tuple[str, Table, Rows]
    """Beginning of the name of a place; the table of the clock, and its rows."""
    faults: Mapping[int, str] = field(default_factory=dict)
    """Reasons why columns have no value at the instants, by index."""

    def numbers(self, i: int) -> Vector:
        """Return the values of column i, counted from 0; NaN where a value is missing."""
        if i in self.faults:
            raise FileError(self.faults[i])
        table, k, rows = self.sources[i]
        return np.append(table.numbers(k), np.nan)[rows]

    def texts(self, i: int) -> Sequence[str]:
        """Return the cells of column i as text; () if the file contains numbers."""
        table, k, rows = self.sources[i]
        cells = table.texts(k)
        return [cells[row] if row >= 0 else "" for row in rows.tolist()] if len(cells) else ()

    def place(self, k: int) -> str:
        """Return the place of instant k in its file as text, such as `line 4`."""
        file, table, rows = self.clock
        return file + table.place(int(rows[k]))


def rows_of(table: Table, rows: Rows, *notes: str) -> ClockTable:
    """Return a table with these rows, and with further first notes; shorter columns stay."""
    longest = int(rows.max(initial=-1))
    return ClockTable(
        columns=table.columns,
        refused=table.refused,
        Ts=table.Ts,
        notes=[*notes, *table.notes],
        sources=[
            (table, i, rows if size > longest else np.arange(size))
            for i, size in enumerate(sizes_of(table))
        ],
        clock=("", table, rows),
        other_times=table.other_times,
    )


def few_rows(table: Table) -> Table:
    """Return some rows of a long text, without the conversion of the others."""
    if not isinstance(table, TextTable) or len(table.rows) < _MAX_CELLS:
        return table
    rows = np.unique(np.linspace(0, len(table.rows) - 1, _MAX_CELLS).astype(np.intp))
    lines = [table.lines[k] for k in rows]
    return replace(table, rows=[table.rows[k] for k in rows], lines=lines)


def sizes_of(table: Table) -> list[int]:
    """Return the number of rows of each column."""
    if isinstance(table, ClockTable):
        return [rows.size for *_, rows in table.sources]
    if isinstance(table, TextTable):
        return [len(table.rows)] * len(table.columns)
    return [len(column) for column in table.values]


def index_of(table: Table, wanted: str, option: str) -> int | None:
    """Return the index of a column, or of the first column of a matrix; None if there is none."""
    for name in (wanted, f"{wanted}:1"):
        with suppress(FileError):
            return choose(table, name, option)
    return None


def rows_with_value(table: Table, i: int, *, words: bool = False) -> Mask | None:
    """Return the rows in which a column has a value; None for words, if they are not asked for."""
    try:
        if not len(cells := table.texts(i)):
            return ~np.isnan(table.numbers(i))
    except FileError:  # such as values with several units
        return None
    has_value = ~np.array(list(map(is_missing, cells)), np.bool_)
    some = (cells[k] for k in np.flatnonzero(has_value)[:_MAX_CELLS])
    return has_value if words or all(number(cell, "") is not None for cell in some) else None


def names_of(table: Table, columns: Sequence[int]) -> str:
    """Return the names of columns for a message."""
    names = [shorten(table.columns[i].name) or f"column {i + 1}" for i in columns]
    more = names[_MAX_LISTED - 1 :] if len(names) > _MAX_LISTED else []
    return quantities.join_names(
        [*names[: _MAX_LISTED - 1], f"{len(more)} more"] if more else names
    )


# ---- values of one clock at the times of another


@dataclass(frozen=True, slots=True, kw_only=True)
class TableClock:
    """Times, and the columns that have a value at each of them."""

    at: int
    """Index of the column of times; below 0 for the times of another file."""
    name: str
    """Name of the times in messages."""
    label: str
    """Text by which the name of the times differs from the names of other times."""
    rows: Rows
    """Rows of the table that have a time, shape (N,)."""
    times: Times
    """Times of these rows."""
    columns: Sequence[int] = ()
    """Indices of the columns."""

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, in s from the origin of the clock."""
        t, begin = self.times.t, self.times.begin
        return begin + float(t.min()), begin + float(t.max())


def _usual(clock: TableClock) -> float:
    t = clock.times.t
    return float(np.median(np.abs(np.diff(t)))) if t.size > 1 else 0.0


def are_near(d: Vector, share: float) -> bool:
    """Return whether most intervals are near the usual one."""
    usual = float(np.median(d)) if d.size else 0.0
    return bool(usual and np.mean(np.abs(d - usual) <= share * abs(usual)) >= _MIN_REGULAR)


def are_same(a: TableClock, b: TableClock) -> bool:
    """Return whether two clocks have the same rows, perhaps in another unit."""
    if not np.array_equal(a.rows, b.rows):
        return False
    d = b.times.t - a.times.t
    if a.times.clock == b.times.clock:
        error = _rounding(a, b)
        # A coarse copy differs by less than its last digit, and not always by the same.
        digit = max(a.times.resolution, b.times.resolution) * (np.ptp(d) > error)
        if np.abs(d + b.times.begin - a.times.begin).max() <= max(error, _COARSE * digit):
            return True
    if a.label or b.label or (a.times.clock == b.times.clock and _overlap(a, b)):
        return False
    slope, level = np.polyfit(a.times.t, b.times.t, 1)
    apart = np.abs(b.times.t - slope * a.times.t - level).max()
    return bool(abs(slope - 1) <= _MAX_DRIFT and apart <= _usual(a))


def _rounding(a: TableClock, b: TableClock) -> float:
    """Return the largest difference, in s, of equal times."""
    largest = max(abs(a.times.begin), abs(b.times.begin))
    return _ROUNDING * _usual(a) + 2 * float(np.spacing(largest))


def _overlap(a: TableClock, b: TableClock) -> bool:
    """Return whether the records overlap by at least half of the shorter one."""
    (first, last), (other, end) = a.span, b.span
    shared = min(last, end) - max(first, other)
    return shared >= _MIN_OVERLAP * min(last - first, end - other)


def on_master(
    table: Table, clocks: Sequence[TableClock], of_y: int | None, of_time: int | None
) -> tuple[ClockTable | None, TableClock]:
    """Return the table at the times of one clock, and this clock; None if all are the same.

    The master is the clock of the column `of_time`, or else that of the output. The other columns
    have their newest value; those of a clock that cannot be compared have a fault.
    """
    master = min(clocks, key=lambda c: (c.at != of_time, of_y not in c.columns))
    others = [clock for clock in clocks if clock is not master and not are_same(master, clock)]
    if not others:
        return None, master
    if master.at != of_time and of_y not in master.columns:
        groups = [names_of(table, clock.columns) for clock in clocks]
        raise ReadingError(
            f"it has several clocks, those of {quantities.join_names(groups)}: "
            f"{remedy(table, 'signal')}, the output to whose times the other columns are held",
            "--signal NAME",
        )
    y = [of_y] if of_y is not None and of_y in master.columns else master.columns
    signal, notes, faults = names_of(table, y), list[str](), dict[int, str]()
    view = rows_of(table, master.rows)
    sources = [*view.sources]
    for clock in others:
        names, rows = names_of(table, clock.columns), np.full(master.rows.size, -1)
        try:
            rows, more = _newest_rows(master, clock, names, signal)
        except FileError as err:
            faults |= dict.fromkeys(clock.columns, str(err))
        else:
            have = "has its" if len(clock.columns) == 1 else "have their"
            is_other = clock.at != master.at
            have += (
                f" own times, {clock.name}" if is_other else f" values in other rows than {signal}"
            )
            is_assumed = is_other and clock.at < 0 and not clock.times.clock
            more += "; both are taken to begin together" * is_assumed
            to = f"held to the times of {signal}, {master.name}"
            notes.append(Step(f"{names} {have}: {to}{more}", DOUBT))
        for i in {clock.at, *clock.columns} - {master.at}:
            if i >= 0:
                sources[i] = (table, i, rows)
    return replace(view, sources=sources, faults=faults, notes=[*notes, *view.notes]), master


def _newest_rows(
    master: TableClock, other: TableClock, columns: str, signal: str
) -> tuple[Rows, str]:
    """Return the row of another clock at each time of a master, -1 for none, and facts.

    Raises FileError if the two clocks cannot be compared.
    """
    if master.times.clock != other.times.clock or not _overlap(master, other):
        ranges = [
            f"{c.name} goes from {c.span[0]:.10g} to {c.span[1]:.10g} {c.times.clock or 's'}"
            for c in (other, master)
        ]
        raise FileError(
            f"{' and '.join(ranges)}: {columns} cannot be held to the times of {signal}. Write "
            "both times from the same beginning, with their units in the names; if they belong to "
            f"the same rows, delete {other.name}"
        )
    for clock in (other, master):
        d = np.diff(clock.times.t)
        if np.any(d < 0) and np.any(d > 0):
            first = int(np.argmax(d < 0 if np.median(d) > 0 else d > 0)) + 1
            raise FileError(
                f"{clock.times.place(first)}: {clock.name} goes back here, so {columns} cannot be "
                f"held to the times of {signal}; cut the file there"
            )
    t, error = master.times.t, _rounding(master, other)
    order = np.argsort(other.times.t, kind="stable")
    others = other.times.t[order] + (other.times.begin - master.times.begin)
    k = np.searchsorted(others, t + error, side="right") - 1
    rows, more = np.where(k >= 0, other.rows[order[k]], -1), ""
    between = np.count_nonzero((others >= t.min()) & (others <= t.max()))
    is_far = (k >= 0) & (t - others[k] > _MAX_HELD * _usual(other) + error)
    is_far &= are_near(np.diff(others), NEAR)
    rows[is_far] = -1
    skipped = int(between - np.unique(rows[rows >= 0]).size)
    if skipped > _MIN_UNUSED * others.size:
        more += f"; {plural(skipped, 'value')} of {columns} between these times are not used"
    if far := int(np.count_nonzero(is_far)):
        more += f"; not known in {plural(far, 'row')}, over {_MAX_HELD:g} intervals after a value"
    return rows, more
