"""Place of the rows of a table on the grid of instants."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from armrig_core.errors import FileError

from armrig.data.columns import Matrix, require_size
from armrig.data.files.column_faults import repetition_notes, stuck_notes, treat_faults
from armrig.data.files.imported_file import GridTable
from armrig.data.files.sampling_grid import Grid, grid_of, unit_grid
from armrig.data.files.stamps import time_columns, times_of
from armrig.data.files.table import MIN_TS, ReadingError, Table, Vector, choose, remedy, shorten
from armrig.data.step import DOUBT, Step
from armrig.numerics.quantities import plural
from armrig.numerics.stretches import Mask, stretches

_MIN_KNOWN_INPUTS = 0.5  # share of the rows
_MAX_HELD = 3  # rows that a file leaves out in which u is held, if it is the same on both sides


class Reading(NamedTuple):
    """Options of reading a file; the fields are arguments of `load_data`."""

    time: str | None
    Ts: float | None
    decimal: str | None
    resample: bool
    hold_input: bool
    mask_rails: bool
    unwrap: float | None
    topic: str | None


def place(
    table: Table,
    columns: Mapping[int, Vector],
    of_u: Sequence[int],
    of_y: Sequence[int],
    names: Mapping[int, str],
    how: Reading,
    notes: Sequence[str] = (),
    *,
    are_signals: bool = False,
) -> tuple[Grid, dict[int, Vector], Mask, list[str]]:
    """Return a grid, the columns at its instants, the instants without a row, and the history.

    The columns are named by their index. The inputs `of_u` and the outputs `of_y` are
    treated as the options say. If `are_signals` is True, the history also names values that stay.
    """
    sizes = {x.size for x in columns.values()}
    if len(sizes) > 1:
        rule = "all need the same number" if are_signals else "save columns of one length"
        text = f"the columns have {min(sizes)} to {plural(max(sizes), 'sample')}"
        raise FileError(f"{text}; {rule}")
    columns, grid = dict(columns), _grid_of_rows(table, {*of_u, *of_y}, sizes.pop(), how)
    history = [*table.notes, *grid.notes, *notes]
    for i in of_u if are_signals else ():
        history += repetition_notes(columns[i], names[i])
    for i in of_y:
        if are_signals:
            u = np.column_stack([columns[j] for j in of_u])
            history += repetition_notes(columns[i], names[i]) or stuck_notes(
                columns[i], names[i], u
            )
        columns[i], steps = treat_faults(
            columns[i], names[i], mask_rails=how.mask_rails, unwrap=how.unwrap
        )
        history += steps
    placed = {i: grid.place(x, held=i in of_u) for i, x in columns.items()}
    put_in = np.ones(grid.size, np.bool_)
    put_in[grid.at if grid.times is None else slice(None)] = False
    if of_u:
        u = np.column_stack([placed[i] for i in of_u])
        history += _hold_inputs(u, put_in, [names[i] for i in of_u], how)
        placed |= dict(zip(of_u, u.T, strict=True))
    return grid, placed, put_in, history


def _hold_inputs(u: Matrix, put_in: Mask, names: Sequence[str], how: Reading) -> list[str]:
    """Hold missing inputs, everywhere or in short gaps of the file; return history steps."""
    unknown = np.isnan(u) & ~put_in[:, np.newaxis]
    for x, missing, name in zip(u.T, unknown.T, names, strict=True):
        rows = x.size - np.count_nonzero(put_in)
        filled = int(rows - np.count_nonzero(missing))
        # Without most of the rows the data would be distorted.
        if not how.hold_input and filled < _MIN_KNOWN_INPUTS * rows:
            raise ReadingError(
                f"{shorten(name)} has a value in {filled} of {rows} rows; if it is written only "
                "where it changes, give --hold-input",
                "--hold-input",
            )
        for gap in stretches(np.isnan(x)):
            if gap.start and (how.hold_input or _is_short(x, gap, put_in)):
                x[gap] = x[gap.start - 1]
    count = int(np.count_nonzero(unknown.any(axis=1)))
    if not (how.hold_input and count):
        return []
    return [f"held the input in {plural(count, 'row')} without a value of it"]


def _is_short(x: Vector, gap: slice, put_in: Mask) -> bool:
    """Return whether the file leaves out these few rows, with one value of x on both sides."""
    same = gap.stop < x.size and x[gap.start - 1] == x[gap.stop]
    return bool(same and put_in[gap].all() and gap.stop - gap.start <= _MAX_HELD)


def _grid_of_rows(table: Table, taken: Collection[int], N: int, how: Reading) -> Grid:
    """Return the grid of the rows, from a column of times, the Ts of the file, or the given Ts."""
    Ts = how.Ts
    if Ts is not None and not MIN_TS <= Ts <= 1 / MIN_TS:
        allowed = f"and from {MIN_TS:g} to {1 / MIN_TS:g}" if 0 < Ts < np.inf else "and > 0"
        raise FileError(f"Ts={Ts} must be finite {allowed}, in s")
    if isinstance(table, GridTable):
        return _grid_of_import(table, how)
    if how.time is None and Ts is None and table.Ts is not None:
        return unit_grid(N, table.Ts)
    at = time_column(table, taken, how)
    if at is not None:
        try:
            times = times_of(table, at)
            if times.t.size != N:
                raise FileError(f"{times.name} are {times.t.size}, for {plural(N, 'sample')}")
            return grid_of(times, Ts=Ts, resample=how.resample)
        except FileError as err:
            if Ts is None or how.resample:
                raise
            text = f"used the given Ts = {Ts:g} s, because the times cannot be used: {err}"
            return replace(unit_grid(N, Ts), notes=[Step(text, DOUBT)])
    if Ts is not None and not how.resample:
        return unit_grid(N, Ts)
    of_file = f" (Ts {table.refused['Ts']})" if "Ts" in table.refused else ""
    msg = f"the sampling time is not known{of_file}: give it in s (--Ts)"
    if len(table.columns) > len(taken):
        msg += f", or the column of times: {remedy(table, 'time')}"
    raise ReadingError(msg, "--time NAME")


def time_column(table: Table, taken: Collection[int], how: Reading) -> int | None:
    """Return the index of the column of times; None without a single such column."""
    if how.time is not None:
        return choose(table, how.time, "time")
    at = [i for i in time_columns(table) if i not in taken]
    return at[0] if len(at) == 1 else None


def _grid_of_import(table: GridTable, how: Reading) -> Grid:
    """Return the grid of imported rows; refuse options that only an import takes."""
    flags = [name for name in ("time", "Ts", "resample", "topic") if getattr(how, name)]
    if flags:
        raise FileError(
            f"--{flags[0]}: imported data have their times, {table.grid.Ts:g} s apart; import the "
            "original file again with this option"
        )
    return table.grid


def values_of(table: Table, i: int, role: str) -> Vector:
    """Return the values of a column, NaN where missing; refuse infinities and empty columns."""
    values = table.numbers(i)
    infinite = np.isinf(values)
    if infinite.any():
        k = int(np.argmax(infinite))
        raise FileError(
            f"{table.place(k)}: the {role} is {values[k]} here, and infinite in "
            f"{plural(infinite.sum(), 'sample')} in all; leave an unknown value empty, or write NaN"
        )
    if np.isnan(values).all():
        msg = f"the {role}, column {i + 1}, has no value in any of {values.size} rows; "
        raise FileError(msg + remedy(table, role))
    require_size(role, values[~np.isnan(values)])
    return values
