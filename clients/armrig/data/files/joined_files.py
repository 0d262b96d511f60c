"""Columns of several files at the times of one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePath

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.clock_table import ClockTable, Rows, index_of, names_of, sizes_of
from armrig.data.files.held_times import Clock, newest_rows, no_output, rounding, usual_interval
from armrig.data.files.stamps import Times, is_time, time_columns, times_of
from armrig.data.files.table import Column, ReadingError, Table, listed, shown
from armrig.data.step import DOUBT, Step
from armrig.numerics import quantities
from armrig.numerics.quantities import plural


def joined_files(
    tables: Sequence[tuple[str, Table]], output: str | None, time: str | None
) -> Table:
    """Return the columns of several files at the times of one of them."""
    clocks = [_file_clock(name, table, time) for name, table in tables]
    # Each column of numbers or words, but for the times, with its file.
    entries = [(k, i) for k, clock in enumerate(clocks) for i in clock.columns]
    plain = [tables[k][1].columns[i].name for k, i in entries]
    columns = [Column(name=time or "time", unit="s")]
    columns += [
        replace(tables[k][1].columns[i], name=name)
        if name and plain.count(name) == 1
        else replace(tables[k][1].columns[i], name=f"{PurePath(tables[k][0]).stem}.{name or i + 1}")
        for (k, i), name in zip(entries, plain, strict=True)
    ]
    of_y = index_of(joined := Table(columns=columns), output or "y", "signal") or None
    same = all(_are_equal(clocks[0].times, clock.times) for clock in clocks[1:])
    at_time = [
        k for k, (_, t) in enumerate(tables) if time and index_of(t, time, "time") is not None
    ]
    if len(at_time) == 1 or same:
        of_master = at_time[0] if len(at_time) == 1 else 0
    elif of_y is None:
        raise no_output(joined, [clock.name for clock in clocks])
    else:
        of_master = entries[of_y - 1][0]
    master, rows, notes = clocks[of_master], list[Rows](), list[str]()
    if same:
        names = quantities.listed([name for name, _ in tables])
        notes.append(f"the rows of {names} have equal times")
    y = names_of(joined, [of_y or entries.index(next(e for e in entries if e[0] == of_master)) + 1])
    for k, clock in enumerate(clocks):
        if same or k == of_master:
            rows.append(clock.rows)
            continue
        held = names_of(joined, [j for j, (of, _) in enumerate(entries, 1) if of == k])
        others, more = newest_rows(master, clock, held, y)
        rows.append(others)
        text = f"{held} held from {clock.name} to the times of {y}, {master.name}{more}"
        text += "; both are taken to begin together" * (not clock.times.clock)
        notes.append(Step(text, DOUBT))
    t = Table(columns=columns[:1], values=[master.times.t])
    name, table = tables[of_master]
    return ClockTable(
        columns=columns,
        refused={key: why for _, other in tables for key, why in other.refused.items()},
        notes=[*notes, *(x for _, other in tables for x in other.notes), *master.times.notes],
        sources=[(t, 0, master.rows), *((tables[k][1], i, rows[k]) for k, i in entries)],
        clock=(f"{name}, ", table, master.rows),
    )


def _file_clock(file: str, table: Table, time: str | None) -> Clock:
    """Return the clock of a file's rows, with all columns but the times."""
    given = None if time is None else index_of(table, time, "time")
    named = time_columns(table) if given is None else [given]
    if not named and table.Ts is None:
        raise ReadingError(
            f"{file} has no column of times to compare with those of the other files; "
            f"{listed(table, 'time')}",
            "--time NAME",
        )
    N = max(sizes_of(table), default=0)
    if named:
        try:
            times, name = times_of(table, named[0]), f"{table.columns[named[0]].name} of {file}"
        except FileError as err:
            raise FileError(f"{file}, {err}") from err
    else:
        t = (table.Ts or 0.0) * np.arange(N, dtype=np.float64)
        times = Times(t=t, resolution=0.0, name="the times", place=table.place)
        name = file
    if times.t.size < 2:
        raise FileError(f"{file} has {plural(times.t.size, 'row')}; at least 2 are needed")
    return Clock(
        at=named[0] if named else -1,
        name=shown(name),
        label=file,
        rows=np.arange(times.t.size),
        times=times,
        columns=[
            i
            for i, size in enumerate(sizes_of(table))
            if size == times.t.size and i not in named and not is_time(table.columns[i])
        ],
    )


def _are_equal(a: Times, b: Times) -> bool:
    """Return whether all times of two files are equal."""
    if a.t.size != b.t.size or a.clock != b.clock:
        return False
    error = rounding(a, b, usual_interval(a.t))
    return bool(np.abs(b.t - a.t + (b.begin - a.begin)).max() <= error)
