"""Values of one clock, held to the times of another clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.clock_table import ClockTable, Rows, names_of, rows_of
from armrig.data.files.stamps import Times
from armrig.data.files.table import ReadingError, Table, Vector, listed
from armrig.data.step import DOUBT, Step
from armrig.numerics import quantities
from armrig.numerics.quantities import plural

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
class Clock:
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


def _usual(clock: Clock) -> float:
    t = clock.times.t
    return float(np.median(np.abs(np.diff(t)))) if t.size > 1 else 0.0


def are_near(d: Vector, share: float) -> bool:
    """Return whether most intervals are near the usual one."""
    usual = float(np.median(d)) if d.size else 0.0
    return bool(usual and np.mean(np.abs(d - usual) <= share * abs(usual)) >= _MIN_REGULAR)


def are_same(a: Clock, b: Clock) -> bool:
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


def _rounding(a: Clock, b: Clock) -> float:
    """Return the largest difference, in s, of equal times."""
    largest = max(abs(a.times.begin), abs(b.times.begin))
    return _ROUNDING * _usual(a) + 2 * float(np.spacing(largest))


def _overlap(a: Clock, b: Clock) -> bool:
    """Return whether the records overlap by at least half of the shorter one."""
    (first, last), (other, end) = a.span, b.span
    shared = min(last, end) - max(first, other)
    return shared >= _MIN_OVERLAP * min(last - first, end - other)


def on_master(
    table: Table, clocks: Sequence[Clock], of_y: int | None, of_time: int | None
) -> tuple[ClockTable | None, Clock]:
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
            f"it has several clocks, those of {quantities.listed(groups)}: "
            f"{listed(table, 'signal')}, the output to whose times the other columns are held",
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


def _newest_rows(master: Clock, other: Clock, columns: str, signal: str) -> tuple[Rows, str]:
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
