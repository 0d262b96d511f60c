"""Import of foreign files: all their columns of numbers, on one grid of instants."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import read_bounded

from armrig.data.columns import MAX_SIZE, Vector
from armrig.data.files.clocks import on_one_clock
from armrig.data.files.imported_file import GridTable, Import, ImportedData, ImportedSource
from armrig.data.files.kinds import table_of
from armrig.data.files.loading import MOST_BYTES, naming_file
from armrig.data.files.placement import Reading, place, time_column
from armrig.data.files.table import Column, NoColumnError, Table, choose, remedy
from armrig.data.step import codes_of

_MAX_COLUMNS = 1000
_USUAL = {
    "input": ("u", "resample", "hold_input"),
    "signal": ("y", "mask_rails", "unwrap"),
}
"""Usual name of the inputs and outputs, and the options of reading that need to know them."""


def import_files(
    paths: Sequence[Path],
    how: Reading,
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
) -> ImportedData:
    """Return all columns of numbers of files on one grid of instants.

    Columns that are not numbers, or have no value, are left out, and the history names them. The
    rows of several files, or of a file with two clocks, are put on the clock of the output.

    Parameters
    ----------
    paths : sequence of Path
        Files, each of at most 128 MiB.
    how : Reading
        Options of reading.
    inputs, outputs : sequence of str, optional
        Columns by name or number. An input is held between the times of its rows, in gaps with
        `hold_input`, and for `resample`.

    Raises
    ------
    FileError
        A file cannot be read as data. The message names the problem and the remedy.
    """
    tables, sources = list[tuple[str, Table]](), list[ImportedSource]()
    contents = [read_bounded(path, MOST_BYTES) for path in paths]
    for path, content in zip(paths, contents, strict=True):
        with naming_file(path):
            table = table_of(content, path.suffix.lower(), how.decimal, how.topic)
            if isinstance(table, GridTable):
                raise FileError("was imported already")
        tables.append((path.name, table))
        digest = hashlib.sha256(content).hexdigest()
        sources.append(ImportedSource(name=path.name, sha256=digest))
    with naming_file(paths[0]):
        return _on_grid(tables, tuple(sources), how, inputs, outputs)


def _on_grid(
    tables: Sequence[tuple[str, Table]],
    sources: tuple[ImportedSource, ...],
    how: Reading,
    inputs: Sequence[str],
    outputs: Sequence[str],
) -> ImportedData:
    table = on_one_clock(tables, output=outputs[0] if outputs else None, time=how.time)
    of_u, of_y = _roles(table, "input", inputs, how), _roles(table, "signal", outputs, how)
    at = time_column(table, {*of_u, *of_y}, how)
    columns, notes = _numbers(table, {at, *table.other_times}, {*of_u, *of_y})
    if not columns:
        raise FileError(f"it has no column of numbers to import; {remedy(table, 'signal')}")
    names = _names(table, [*columns])
    # Inputs that are written only where they change are refused, unless they are held.
    grid, placed, put_in, history = place(table, columns, of_u, of_y, names, how, notes)
    rows = np.flatnonzero(~put_in)
    options = {k: str(v) for k, v in how._asdict().items() if v is not None and v is not False}
    return ImportedData(
        facts=Import(
            sources=sources,
            options=options,
            columns=tuple(Column(name=names[i], unit=table.columns[i].unit) for i in placed),
            inputs=tuple(names[i] for i in of_u) if inputs else (),
            outputs=tuple(names[i] for i in of_y) if outputs else (),
            clock="" if at is None else table.columns[at].name or str(at + 1),
            breaks=tuple(map(int, grid.breaks)),
            history=tuple(zip(map(str, history), codes_of(history), strict=True)),
        ),
        Ts=grid.Ts,
        at=rows,
        size=grid.size,
        values=np.column_stack([x[rows] for x in placed.values()]),
    )


def _roles(table: Table, role: str, wanted: Sequence[str], how: Reading) -> list[int]:
    """Return the indices of the inputs or outputs: those wanted, or the column of the usual name.

    Without such a column, the options that need it are refused.
    """
    usual, *options = _USUAL[role]
    try:
        return [choose(table, name, role) for name in wanted or [usual]]
    except NoColumnError:
        if wanted:
            raise
        for option in options:
            if getattr(how, option):
                flag = option.replace("_", "-")
                raise FileError(f"--{flag} needs --{role} NAME; {remedy(table, role)}") from None
        return []


def _numbers(
    table: Table, times: set[int | None], needed: set[int]
) -> tuple[dict[int, Vector], list[str]]:
    """Return the columns of numbers by index, and notes on the columns that are left out."""
    columns, left_out = dict[int, Vector](), list[str]()
    for i, column in enumerate(table.columns):
        if i in times:
            continue
        try:
            values = table.numbers(i)
            if not np.isfinite(values).any():
                raise InputError("has no value")
            if not (np.abs(values[~np.isnan(values)]) <= MAX_SIZE).all():
                raise InputError(f"has a value beyond {MAX_SIZE:g}")
        except InputError as err:
            if i in needed:
                raise
            left_out.append(f"left out column {column.name or i + 1}: {err}")
            continue
        columns[i] = values
        if len(columns) > _MAX_COLUMNS:
            raise FileError(f"has more than {_MAX_COLUMNS} columns of numbers; save fewer")
    left_out += [f"left out {name}: it {why}" for name, why in table.refused.items()]
    return columns, left_out


def _names(table: Table, indices: Sequence[int]) -> dict[int, str]:
    """Return a name for each column: its own, or column_ and its number in the file.

    A repeated name gets the number.
    """
    names, used = dict[int, str](), set[str]()
    for i in indices:
        name = table.columns[i].name or f"column_{i + 1}"
        names[i] = f"{name}:{i + 1}" if name in used else name
        used.add(names[i])
    return names
