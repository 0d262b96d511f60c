"""One clock for the rows of one or more tables: columns of other clocks are held."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.clock_table import (
    Rows,
    few_rows,
    index_of,
    known_rows,
    names_of,
    rows_of,
    sizes_of,
)
from armrig.data.files.held_times import (
    NEAR,
    Clock,
    are_near,
    newest_rows,
    no_output,
    overlap,
    rounding,
    usual_interval,
)
from armrig.data.files.joined_files import joined_files
from armrig.data.files.sparse_rows import complete_rows
from armrig.data.files.stamps import (
    DATE_NAMES,
    TIME_NAMES,
    base_and_unit,
    has_nanoseconds,
    is_time,
    time_columns,
    times_of,
)
from armrig.data.files.table import Column, Table, Vector, shown
from armrig.data.step import DOUBT, Step

_WORD = f"(?:{'|'.join(map(re.escape, sorted(TIME_NAMES | {'stamp'}, key=len, reverse=True)))})"
_LABELLED = (
    re.compile(rf"{_WORD}[\s_./:-]+(?P<label>.+)"),
    re.compile(rf"(?P<label>.+?)[\s_./:-]+{_WORD}"),
    re.compile(rf"{_WORD}(?P<label>\d+)"),
)
_SAMPLED_ROWS = 64  # pairs of rows that show the order
_MIN_FALLING = 0.9  # share of these pairs
_MIN_ORDER = 0.8  # mean sign of the intervals of times, some of which go back
_EVEN = 0.05  # relative deviation of an interval of even times from the usual one
_MAX_DRIFT = 0.01  # between two clocks of the same rows
_COARSE = 1 - 1e-6  # of the last digit, by which a coarse copy of times differs at most
_MIN_ROWS = 3
_COUNTERS = frozenset({"k", "n", "i", "no", "nr", "id", "index", "row", "sample", "entry_id"})


def on_one_clock(
    tables: Sequence[tuple[str, Table]], *, output: str | None, time: str | None
) -> Table:
    """Return a table whose rows are the instants of one clock, the clock of the output.

    The columns of other clocks have their newest value at or before each instant; the first notes
    of the table name them. Rows in falling order of time are turned round.

    Parameters
    ----------
    tables : sequence of (str, Table)
        Name and table of each file.
    output : str or None
        Column of the output, by name or by number from 1; the default is y.
    time : str or None
        Column of times that the user gave. Its clock is the clock of the rows.

    Returns
    -------
    Table
        If one table has one clock and complete rows in rising order, this table. Otherwise
        another table; the columns of a single file keep their places, `time` chooses the times in
        it, and without `time` a column named `time` contains them.

    Raises
    ------
    FileError
        The clock of the output is not known, or the times of two files cannot be compared.
    """
    single = [(name, _of_file(table, output, time)) for name, table in tables]
    return single[0][1] if len(single) == 1 else joined_files(single, output, time)


def _of_file(table: Table, output: str | None, time: str | None) -> Table:
    of_y = index_of(table, output or "y", "signal")
    of_time = None if time is None else index_of(table, time, "time")
    clocks = _clocks(table, of_y, of_time)
    if len(clocks) > 1:
        table, of_time = _on_master(table, clocks, of_y, of_time)
    if of_time is None:
        table = _with_finest_times(table, [i for i in time_columns(table) if i != of_y])
    table = _in_order(table, of_y, of_time)
    return complete_rows(table, of_y, of_time)


def _in_order(table: Table, of_y: int | None, of_time: int | None) -> Table:
    """Return the rows in rising order of time if they are in falling order, or in none."""
    columns, is_unnamed = table.columns, not any(column.name for column in table.columns)
    named = [i for i in time_columns(table) if i != of_y] if of_time is None else [of_time]
    # Numbers of rows, too, show which row is the oldest.
    counters = [i for i, c in enumerate(columns) if c.name.casefold() in _COUNTERS and i != of_y]
    at = named or counters or [0] * (is_unnamed and of_y != 0 and len(columns) > 1)
    falls = [_share_of_falls(table, i, is_sure=i == of_time) for i in at]
    if not at or min(falls) < 1 - _MIN_FALLING:
        return table
    if min(falls) >= _MIN_FALLING:
        what = "time" if named else names_of(table, at[:1])
        text = f"rows in falling order of {what}: turned round"
        notes = [text if named or counters else Step(text, DOUBT)]
        return rows_of(table, np.arange(sizes_of(table)[at[0]])[::-1], notes=notes)
    clock = _clock(table, at[0], "") if named[:1] and not named[1:] else None
    order = np.argsort(clock.times.t) if clock else np.empty(0, np.intp)
    # A clock that begins again gives equal times, or uneven ones.
    if clock is None or not are_near(d := np.diff(clock.times.t[order]), NEAR) or d.min() <= 0:
        return table
    notes = [Step("rows in no order of time: sorted by time", DOUBT)]
    return rows_of(table, clock.rows[order], notes=notes)


def _share_of_falls(table: Table, i: int, *, is_sure: bool) -> float:
    """Return the share of rows after which times fall; a few pairs of rows show it."""
    d, name = _some_intervals(table, i), table.columns[i].name
    d = d[d != 0]
    # A temperature may be named T, and a column without a name may be a signal.
    is_even = is_sure or name not in ("T", "") or are_near(d, NEAR if not name else _EVEN)
    if not d.size or not is_even or (name.casefold() in _COUNTERS and not np.all(d == -1)):
        return 0.0
    return float(np.mean(d < 0))


def _some_intervals(table: Table, i: int) -> Vector:
    """Return intervals of times between adjacent rows; none if the times cannot be read."""
    size = sizes_of(table)[i]
    if size >= _MIN_ROWS:
        at = np.unique(np.linspace(0, size - 2, min(size - 1, _SAMPLED_ROWS)).astype(np.intp))
        pairs = np.column_stack([at, at + 1]).ravel()
        for view in (few_rows, rows_of):  # few rows may not show the decimal mark
            with suppress(FileError):
                return np.diff(times_of(view(table, pairs), i).t)[::2]
    return np.empty(0)


# ---- several columns of times


def _labels(table: Table, of_y: int | None, of_time: int | None = None) -> dict[int, str]:
    """Return the columns that may contain times, each with a label, "" for plain names.

    The label of times is the name of the column to which they belong, or another text by which
    they differ from other times.
    """
    columns = table.columns
    names = [column.name.casefold() for column in columns]
    allowed = [
        i for i in range(len(names)) if i != of_y and not (i and has_nanoseconds(table, i - 1))
    ]
    if not any(names):
        return {i: str(i + 1) for i in allowed} if len(names) > _MIN_ROWS else {}
    labels, doubtful = dict[int, str](), dict[int, str]()
    for i in allowed:
        others = {*names[:i], *names[i + 1 :]}
        base, unit = base_and_unit(columns[i])
        label = columns[i].unit.casefold()
        if i == of_time or is_time(columns[i]):
            is_label = label and not unit and (label in others or names[i] in others)
            labels[i] = label if is_label else names[i] if names[i] in others else ""
        elif parts := next(filter(None, (x.fullmatch(base) for x in _LABELLED)), None):
            label = parts["label"]
            is_certain = label in others or (label.isdecimal() and base != f"t{label}")
            (labels if is_certain else doubtful)[i] = label
    # Temperatures may be named T_in and T1.
    labels |= doubtful if not labels and len(doubtful) > 1 else {}
    return dict(sorted(labels.items()))


def _unlabelled(table: Table) -> list[Column]:
    """Return the columns of a table without labels in place of a unit, such as A in `time (A)`."""
    labels = _labels(table, None)
    return [
        replace(column, unit="") if labels.get(i) == column.unit.casefold() != "" else column
        for i, column in enumerate(table.columns)
    ]


def _clocks(table: Table, of_y: int | None, of_time: int | None) -> list[Clock]:
    """Return the clocks of the columns; [] if fewer than two columns contain times."""
    labels = _labels(table, of_y, of_time)
    if not any(column.name for column in table.columns):
        signs = {i: np.sign(_some_intervals(table, i)) for i in labels}
        labels = {i: labels[i] for i, sign in signs.items() if sign.size == abs(sign.sum()) > 0}
    if len(labels) < 2:
        return []
    clocks = dict[int, Clock]()
    names = {column.name.casefold() for column in table.columns}
    for at, label in labels.items():
        if (clock := _clock(table, at, label)) is None or clock.rows.size < _MIN_ROWS:
            continue
        # A signal may have a name as of times, but it does not rise regularly.
        column, d = table.columns[at], np.diff(clock.times.t)
        is_certain = label in names or (column.name not in ("", "T") and is_time(column))
        order = abs(np.sign(d[d != 0]).mean()) if d.any() else 0.0
        is_ordered = order == 1 or (label in names and order > _MIN_ORDER)
        if at == of_time or (is_ordered and (is_certain or are_near(d, NEAR))):
            clocks[at] = clock
    if not any(names) and not _are_beside(list(clocks.values()), len(table.columns)):
        return []
    owned = _owned(table, list(clocks.values()))
    owners = [replace(clocks[at], columns=columns) for at, columns in owned.items()]
    for clock in owners if len(owners) > 1 else []:
        _require_times(table, clock)
    if len(owners) > 1 and of_time in clocks and of_time not in owned:
        # The user prefers another column of times of the same rows.
        k = next((k for k, clock in enumerate(owners) if of_y in clock.columns), 0)
        owners[k] = replace(clocks[of_time], columns=owners[k].columns)
    return owners


def _with_finest_times(table: Table, named: Sequence[int]) -> Table:
    """Return a table in which the finest of several columns of the same times is the only one."""
    clocks = [_clock(table, i, "") for i in named] if len(named) > 1 else []
    complete = [clock for clock in clocks if clock is not None]
    if not complete or len(complete) < len(named):
        return table
    finest = min(complete, key=lambda clock: clock.times.resolution)
    if not all(_are_same(finest, clock) for clock in complete):
        return table
    others = {*named} - {finest.at}
    columns = [Column(name="") if i in others else c for i, c in enumerate(table.columns)]
    note = f"{names_of(table, named)} are the same times: {finest.name} is used"
    return rows_of(table, finest.rows, columns=columns, other_times=others, notes=[note])


def _clock(table: Table, at: int, label: str) -> Clock | None:
    """Return the times of a column with the rows that have one; None for words."""
    column = table.columns[at]
    heading = f"{column.name} ({column.unit})" if label == column.unit.casefold() else column.name
    name = shown(heading.removesuffix(" ()")) or f"column {at + 1}"
    with suppress(FileError):
        if (known := known_rows(table, at, words=True)) is not None:
            rows = np.flatnonzero(known)
            times = times_of(rows_of(table, rows, columns=_unlabelled(table)), at)
            return Clock(at=at, name=name, label=label, rows=rows, times=times)
    return None


def _are_beside(clocks: Sequence[Clock], count: int) -> bool:
    """Return whether columns without names are times of signals side by side, and no counter."""
    at = [clock.at for clock in clocks]
    steps = [np.diff(clock.times.t) for clock in clocks]
    return (
        at[:1] == [0]
        and at[-1] < count - 1
        and all(b > a + 1 for a, b in pairwise(at))
        and all(np.all(d != 0) and not np.all(d == 1) for d in steps)
    )


def _require_times(table: Table, clock: Clock) -> None:
    """Refuse a value without a time."""
    for i in clock.columns:
        if (known := known_rows(table, i)) is not None and known.any():
            known[clock.rows] = False
            if known.any():
                raise FileError(
                    f"{table.place(int(np.argmax(known)))}: {names_of(table, [i])} has a value "
                    f"here, but {clock.name} has no time; add the time, or delete the value"
                )


def _owned(table: Table, clocks: Sequence[Clock]) -> dict[int, list[int]]:
    """Return the columns of numbers that belong to each column of times.

    They are those that its label names, or those at its right, or, if the last column contains
    times, those at its left.
    """
    sizes, times = sizes_of(table), {clock.at: clock.label for clock in clocks}
    owned: dict[int, list[int]] = {}
    is_left = sizes[1:] and 0 not in times and len(sizes) - 1 in times
    for i, column in enumerate(table.columns):
        skipped = i in times or is_time(column) or column.name.casefold() in DATE_NAMES
        if skipped or (i and has_nanoseconds(table, i - 1)) or known_rows(table, i) is None:
            continue
        fitting = [at for at in times if sizes[at] == sizes[i]]
        named = [at for at in fitting if times[at] and times[at] == column.name.casefold()]
        left, right = ([at for at in fitting if (at < i) == k] for k in (True, False))
        order = [*named, *right[:1], *left[::-1]] if is_left else [*named, *left[::-1], *right]
        if order:
            owned.setdefault(order[0], []).append(i)
    return owned


def _on_master(
    table: Table, clocks: Sequence[Clock], of_y: int | None, of_time: int | None
) -> tuple[Table, int | None]:
    """Return a table at the times of one clock, and the column of these times."""
    ranked = sorted(clocks, key=lambda c: (c.at != of_time, of_y not in c.columns))
    master = ranked[0]
    others = [clock for clock in ranked[1:] if not _are_same(master, clock)]
    if not others:
        return table, of_time
    if master.at != of_time and of_y not in master.columns:
        raise no_output(table, [clock.name for clock in clocks])
    signal = names_of(table, [of_y] if of_y in master.columns else master.columns)
    held, notes, faults = dict[int, Rows](), list[str](), dict[int, str]()
    for clock in others:
        names, at = names_of(table, clock.columns), [clock.at, *clock.columns]
        try:
            rows, more = newest_rows(master, clock, names, signal)
        except FileError as err:
            held |= dict.fromkeys(at, np.full(master.rows.size, -1))
            faults |= dict.fromkeys(clock.columns, str(err))
            continue
        held |= dict.fromkeys(at, rows)
        have = "has its" if len(clock.columns) == 1 else "have their"
        text = f"{names} {have} own times, {clock.name}: held to the times of {signal}, "
        notes.append(Step(f"{text}{master.name}{more}", DOUBT))
    columns = _unlabelled(table)
    for clock in clocks:
        if clock.at != master.at:
            columns[clock.at] = Column(name="")
    if of_time is None and master.at not in time_columns(table):
        columns[master.at] = Column(name="time", unit=base_and_unit(columns[master.at])[1])
    view = rows_of(
        table,
        master.rows,
        columns=columns,
        held=held,
        faults=faults,
        other_times=[clock.at for clock in clocks if clock.at != master.at],
        notes=notes,
    )
    return view, master.at


def _are_same(a: Clock, b: Clock) -> bool:
    """Return whether two columns are the times of the same rows, perhaps in another unit."""
    if not np.array_equal(a.rows, b.rows):
        return False
    usual = usual_interval(a.times.t)
    d = b.times.t - a.times.t
    if a.times.clock == b.times.clock:
        shift = b.times.begin - a.times.begin
        error = rounding(a.times, b.times, usual)
        # A coarse copy differs by less than its last digit, and not always by the same.
        digit = max(a.times.resolution, b.times.resolution) * (np.ptp(d) > error)
        if np.abs(d + shift).max() <= max(error, _COARSE * digit):
            return True
    if a.label or b.label or (a.times.clock == b.times.clock and overlap(a.times, b.times)):
        return False
    slope, level = np.polyfit(a.times.t, b.times.t, 1)
    apart = np.abs(b.times.t - slope * a.times.t - level).max()
    return bool(abs(slope - 1) <= _MAX_DRIFT and apart <= usual)
