"""One clock for the rows of one or more tables: columns of other clocks are held."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import PurePath

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.clock_table import (
    EVEN,
    NEAR,
    ClockTable,
    TableClock,
    are_near,
    few_rows,
    index_of,
    names_of,
    on_master,
    rows_of,
    rows_with_value,
    sizes_of,
)
from armrig.data.files.stamps import (
    BETWEEN_WORDS,
    DATE_NAMES,
    TIME_NAMES,
    Times,
    base_and_unit,
    has_nanoseconds,
    is_time,
    time_columns,
    times_of,
)
from armrig.data.files.table import Column, ReadingError, Table, remedy, shorten
from armrig.data.step import DOUBT, Step
from armrig.numerics import quantities
from armrig.numerics.quantities import plural
from armrig.numerics.stretches import Mask

_WORD = "|".join(sorted(TIME_NAMES | {"stamp"}, key=len, reverse=True))
_WORD = f"(?:{_WORD.replace('_', BETWEEN_WORDS)})"
_LABELLED = (
    re.compile(rf"{_WORD}(?:[\s_./:-]+|(?=\d+$))(?P<label>.+)"),
    re.compile(rf"(?P<label>.+?)[\s_./:-]+{_WORD}"),
)
_MIN_FALLING = 0.9  # share of the intervals of times in falling order
_MIN_ORDER = 0.8  # mean sign of the intervals of times, some of which go back
_MIN_ROWS = 3
_COUNTERS = frozenset({"k", "n", "i", "no", "nr", "id", "index", "row", "sample", "entry_id"})
_MAX_SHARED = 0.05  # share of rows with both values, of two columns in separate rows
_MIN_ALONE = 10  # rows of uneven times with only one of the values: a merged file has many
_MIN_APART = 0.2  # share of rows that have only the one value, and of rows with only the other


def on_one_clock(
    tables: Sequence[tuple[str, Table]], *, output: str | None, time: str | None
) -> Table:
    """Return a table whose rows are the instants of one clock, the clock of the output.

    The columns of other clocks have their newest value at or before each instant; the first notes
    of the table name them. Rows in falling order of time are turned round.

    Parameters
    ----------
    tables : sequence of (str, Table)
        Name and table of each file; a single table of one clock in rising order is returned.
    output : str or None
        Column of the output, by name or by number from 1; the default is y.
    time : str or None
        Column of times that the user gave. Its clock is the clock of the rows of a single file,
        whose columns keep their places. By default a column named `time` contains the times.

    Raises
    ------
    FileError
        The clock of the output is not known, or the times of two files cannot be compared.
    """
    single = [(name, _of_file(table, output, time)) for name, table in tables]
    return single[0][1] if len(single) == 1 else _join(single, output, time)


def _of_file(table: Table, output: str | None, time: str | None) -> Table:
    of_y = index_of(table, output or "y", "signal")
    of_time = None if time is None else index_of(table, time, "time")
    table, of_time = _on_one_column(table, of_y, of_time)
    named = [i for i in time_columns(table) if i != of_y] if of_time is None else [of_time]
    table = _in_order(table, of_y, named, is_sure=of_time is not None)
    clocks = _sparse_clocks(table, of_y, named)
    return (on_master(table, clocks, of_y, None)[0] or table) if clocks else table


# ---- several columns of times


def _on_one_column(table: Table, of_y: int | None, of_time: int | None) -> tuple[Table, int | None]:
    """Return the table with one column of times for all its rows, and this column if it is sure."""
    labels = _labels(table, of_y, of_time)
    columns = [
        replace(c, unit="") if labels.get(i) == c.unit.casefold() != "" else c
        for i, c in enumerate(table.columns)
    ]
    plain = replace(table, columns=columns) if columns != table.columns else table
    clocks = dict[int, TableClock]()
    for at, label in labels.items() if len(labels) > 1 else ():
        heading = table.columns[at].name + f" ({label})" * (columns[at] != table.columns[at])
        clock = _clock(plain, at, label, shorten(heading) or f"column {at + 1}")
        if clock is not None and (at == of_time or _is_clock(plain, clock)):
            clocks[at] = clock
    # Times without names are beside their signals, and no counter.
    if not any(c.name for c in columns) and (
        0 not in clocks
        or min(np.diff([*clocks, len(columns)])) < 2
        or any(np.all(np.diff(clock.times.t) == 1) for clock in clocks.values())
    ):
        return table, of_time
    owners = _owners(plain, clocks, of_y, of_time)
    view, master = on_master(plain, owners, of_y, of_time) if owners else (None, None)
    if view is not None and master is not None:
        others = {clock.at for clock in owners} - {master.at}
        columns = [Column(name="") if i in others else c for i, c in enumerate(columns)]
        if of_time is None and master.at not in time_columns(table):
            columns[master.at] = Column(name="time", unit=base_and_unit(columns[master.at])[1])
        return replace(view, columns=columns, other_times=others), master.at
    return table, of_time


def _labels(table: Table, of_y: int | None, of_time: int | None) -> dict[int, str]:
    """Return the columns that may contain times, each with a label, "" for plain names.

    The label of times is the name of the column to which they belong, or another text by which
    they differ from other times.
    """
    columns = table.columns
    names = [column.name.casefold() for column in columns]
    labels, doubtful = dict[int, str](), dict[int, str]()
    for i, column in enumerate(columns):
        others = {*names[:i], *names[i + 1 :]}
        base, unit = base_and_unit(column)
        label = column.unit.casefold()
        if i == of_y or (i and has_nanoseconds(table, i - 1)):
            continue
        if not any(names):
            labels[i] = str(i + 1)
        elif is_time(column):
            is_label = label and not unit and (label in others or names[i] in others)
            labels[i] = label if is_label else names[i] if names[i] in others else ""
        elif parts := next(filter(None, (x.fullmatch(base) for x in _LABELLED)), None):
            label = parts["label"]
            is_certain = label in others or (label.isdecimal() and base != f"t{label}")
            (labels if is_certain else doubtful)[i] = label
        elif i == of_time:
            labels[i] = ""
    # Temperatures may be named T_in and T1.
    labels |= doubtful if of_time in doubtful or not labels else {}
    return labels if any(names) or len(names) > _MIN_ROWS else {}


def _clock(table: Table, at: int, label: str = "", name: str = "") -> TableClock | None:
    """Return the times of a column with the rows that have one; None for words."""
    with suppress(FileError):
        if (has_time := rows_with_value(table, at, words=True)) is not None:
            rows = np.flatnonzero(has_time)
            times = times_of(table if has_time.all() else rows_of(table, rows), at)
            return TableClock(at=at, name=name, label=label, rows=rows, times=times)
    return None


def _is_clock(table: Table, clock: TableClock) -> bool:
    """Return whether times are in order; a signal may have a name as of times."""
    column, d = table.columns[clock.at], np.diff(clock.times.t)
    names = {c.name.casefold() for c in table.columns}
    is_certain = clock.label in names or (column.name not in ("", "T") and is_time(column))
    is_ordered = d.any() and abs(np.sign(d[d != 0]).mean()) > _MIN_ORDER
    return bool(d.size >= _MIN_ROWS - 1 and is_ordered and (is_certain or are_near(d, NEAR)))


def _owners(
    table: Table, clocks: Mapping[int, TableClock], of_y: int | None, of_time: int | None
) -> list[TableClock]:
    """Return the clocks with the columns of numbers that belong to each; [] without two.

    They are those that its label names, or those at its right, or, if the last column contains
    times, those at its left. A value without a time is refused.
    """
    sizes, owned, faults = sizes_of(table), dict[int, list[int]](), list[str]()
    is_left = 0 not in clocks and len(sizes) - 1 in clocks
    for i, column in enumerate(table.columns if len(clocks) > 1 else ()):
        name = column.name.casefold()
        skipped = i in clocks or is_time(column) or name in DATE_NAMES
        skipped = skipped or (i > 0 and has_nanoseconds(table, i - 1))
        fitting = [at for at in clocks if sizes[at] == sizes[i] and not skipped]
        if fitting and (has_value := rows_with_value(table, i)) is not None:
            labels = {at: clocks[at].label for at in fitting}
            at = min(fitting, key=lambda at: (labels[at] != name, (at > i) != is_left, abs(at - i)))
            has_value[clocks[at].rows] = False
            owned.setdefault(at, []).append(i)
            if has_value.any():
                faults.append(
                    f"{table.place(int(np.argmax(has_value)))}: {names_of(table, [i])} has a value "
                    f"here, but {clocks[at].name} has no time; add the time, or delete the value"
                )
    if len(owned) < 2:
        return []
    if faults:
        raise FileError(faults[0])
    owners = [replace(clocks[at], columns=columns) for at, columns in owned.items()]
    if of_time is not None and of_time in clocks and of_time not in owned:
        # The user prefers another column of times of the same rows.
        k = next((k for k, clock in enumerate(owners) if of_y in clock.columns), 0)
        owners[k] = replace(clocks[of_time], columns=owners[k].columns)
    return owners


# ---- order, and rows with one of several values


def _in_order(table: Table, of_y: int | None, named: Sequence[int], *, is_sure: bool) -> Table:
    """Return the rows in rising order of time if they are in falling order, or in none."""
    columns = table.columns
    # Numbers of rows, too, show which row is the oldest.
    counters = [i for i, c in enumerate(columns) if c.name.casefold() in _COUNTERS and i != of_y]
    is_first = of_y != 0 and len(columns) > 1 and not any(c.name for c in columns)
    at = next(iter([*named, *counters, *[0] * is_first]), None)
    if at is None or ((few := _clock(few_rows(table), at)) and np.all(np.diff(few.times.t) >= 0)):
        return table
    if (clock := _clock(table, at)) is None or clock.rows.size < _MIN_ROWS:
        return table
    d = np.diff(clock.times.t)
    d = d[d != 0]
    # A temperature may be named T, and a column without a name may be a signal.
    is_sure = is_sure or (at in named and columns[at].name not in ("T", ""))
    if d.size and np.mean(d < 0) >= _MIN_FALLING and (is_sure or are_near(d, EVEN)):
        column = "time" if at in named else names_of(table, [at])
        text = f"rows in falling order of {column}: turned round"
        note = text if is_sure else Step(text, DOUBT)
        return rows_of(table, np.arange(sizes_of(table)[at])[::-1], note)
    if [*named] != [at] or not d.size or np.mean(d < 0) <= 1 - _MIN_FALLING:
        return table
    order = np.argsort(clock.times.t)
    d_sorted = np.diff(clock.times.t[order])
    # A clock that begins again gives equal times, or uneven ones.
    if not are_near(d_sorted, NEAR) or d_sorted.min() <= 0:
        return table
    note = Step("rows in no order of time: sorted by time", DOUBT)
    return rows_of(table, clock.rows[order], note)


def _sparse_clocks(table: Table, of_y: int | None, named: Sequence[int]) -> list[TableClock]:
    """Return the clocks of columns that have their values in other rows than the output.

    A column that is written only where it changes has values in rows of the output, and stays.
    """
    masks = {
        i: mask
        for i in range(len(table.columns))
        if i not in named and (mask := rows_with_value(table, i)) is not None
    }
    y = of_y if of_y is not None else max(masks, key=lambda i: masks[i].sum(), default=-1)
    if y not in masks or masks[y].all():
        return []
    N, clock = masks[y].size, _clock(table, named[0]) if named else None
    is_timed = clock is not None and clock.rows.size == N
    t = clock.times.t if clock and is_timed else np.arange(N, dtype=np.float64)
    is_even = are_near(np.diff(t), EVEN)
    apart = [i for i, x in masks.items() if x.size == N and _are_apart(x, masks[y], is_even)]
    name = names_of(table, named[:1]) if named else "the rows"
    clocks = list[TableClock]()
    for i in (y, *apart):
        view = rows_of(table, rows := np.flatnonzero(masks[i]))
        times = Times(t=t[rows], resolution=0.0, name=name, place=view.place)
        clocks.append(TableClock(at=-1, name=name, label="", rows=rows, times=times, columns=[i]))
    return clocks


def _are_apart(a: Mask, b: Mask, is_even: bool) -> bool:
    """Return whether two columns have their values in different rows."""
    both, alone = np.count_nonzero(a & b), min(map(np.count_nonzero, (a & ~b, b & ~a)))
    is_shared = both > _MAX_SHARED * (least := both + alone)
    is_apart = not is_shared or (not is_even and alone >= max(_MIN_ALONE, _MIN_APART * a.size))
    return bool(least >= _MIN_ROWS and alone and is_apart)


# ---- several files


def _join(tables: Sequence[tuple[str, Table]], output: str | None, time: str | None) -> Table:
    """Return the columns of several files at the times of one of them."""
    clocks = [_file_clock(-1 - k, *file, time) for k, file in enumerate(tables)]
    plain = [t.columns[i].name for (_, t), c in zip(tables, clocks, strict=True) for i in c.columns]
    # The times of the master are put in as column 0 below.
    columns, sources = [Column(name=time or "time", unit="s")], [(tables[0][1], 0, clocks[0].rows)]
    for k, ((file, table), clock) in enumerate(zip(tables, clocks, strict=True)):
        clocks[k] = replace(clock, columns=range(len(columns), len(columns) + len(clock.columns)))
        for i in clock.columns:
            name = table.columns[i].name
            is_known = name and plain.count(name) == 1
            name = name if is_known else f"{PurePath(file).stem}.{name or i + 1}"
            columns.append(replace(table.columns[i], name=name))
            sources.append((table, i, clock.rows))
    joined = ClockTable(
        columns=columns,
        refused={name: why for _, table in tables for name, why in table.refused.items()},
        notes=[note for _, table in tables for note in table.notes],
        sources=sources,
        clock=("", tables[0][1], clocks[0].rows),
    )
    of_y = index_of(joined, output or "y", "signal") or None
    view, master = on_master(joined, clocks, of_y, None)
    if view is None:
        files = quantities.join_names([file for file, _ in tables])
        view = rows_of(joined, master.rows, f"the rows of {files} have equal times")
    if view.faults:
        raise FileError(next(iter(view.faults.values())))
    t = Table(columns=columns[:1], values=[master.times.t])
    file, table = next(x for x, c in zip(tables, clocks, strict=True) if c is master)
    return replace(
        view,
        notes=[*view.notes, *master.times.notes],
        sources=[(t, 0, master.rows), *view.sources[1:]],
        clock=(f"{file}, ", table, master.rows),
    )


def _file_clock(at: int, file: str, table: Table, time: str | None) -> TableClock:
    """Return the clock of a file's rows, with all columns but the times."""
    of_time = None if time is None else index_of(table, time, "time")
    named = time_columns(table) if of_time is None else [of_time]
    if not named and table.Ts is None:
        raise ReadingError(
            f"{file} has no column of times to compare with those of the other files; "
            f"{remedy(table, 'time')}",
            "--time NAME",
        )
    sizes, name = sizes_of(table), file
    t = (table.Ts or 0.0) * np.arange(max(sizes, default=0), dtype=np.float64)
    times = Times(t=t, resolution=0.0, name="the times", place=table.place)
    if named:
        name = f"{table.columns[named[0]].name} of {file}"
        try:
            times = times_of(table, named[0])
        except FileError as err:
            raise FileError(f"{file}, {err}") from err
    if times.t.size < 2:
        raise FileError(f"{file} has {plural(times.t.size, 'row')}; at least 2 are needed")
    columns = [
        i
        for i, size in enumerate(sizes)
        if size == times.t.size and i not in named and not is_time(table.columns[i])
    ]
    rows = np.arange(times.t.size)
    return TableClock(
        at=at, name=shorten(name), label=file, rows=rows, times=times, columns=columns
    )
