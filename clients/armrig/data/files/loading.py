"""Loading of a `Dataset` from a file: recognition of the file's kind, and choice of the columns."""

from __future__ import annotations

import codecs
import errno
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from armrig_core.bounded import decoded, read_bounded
from armrig_core.calls import checked_call
from armrig_core.errors import FileError, InputError
from armrig_core.recording_file.file_records import MAGIC
from numpy.typing import NDArray

from armrig.data.dataset import Dataset, require_size
from armrig.data.files import arrays, messages, text
from armrig.data.files.column_faults import treated
from armrig.data.files.parquet import read_parquet
from armrig.data.files.sampling_grid import Grid, grid_of, unit_grid
from armrig.data.files.stamps import time_columns, times_of
from armrig.data.files.table import Column, NoColumnError, Table, Vector, chosen, listed, shown
from armrig.data.signals import Mask, Signals
from armrig.data.step import DOUBT, Step
from armrig.numerics.quantities import plural

Array = NDArray[np.float64]
Data = TypeVar("Data")

MOST_BYTES = 1 << 27
"""Largest size of a file, in B; a text of a million rows of eight numbers each is smaller."""
SOURCE = "data"
"""Prefix of the hash in `source` if the file is not a recording."""
_MIN_KNOWN_INPUTS = 0.5  # share of the rows
_MAX_HELD = 3  # rows that a file leaves out in which u is held, if it is the same on both sides
_ONE_PAIR = 2
_MIN_TS = 1e-12  # in s


@checked_call
def load_data(
    path: str | PathLike[str],
    *,
    input: str = "u",
    signal: str = "y",
    time: str | None = None,
    Ts: float | None = None,
    decimal: Literal[",", "."] | None = None,
    resample: bool = False,
    hold_input: bool = False,
    mask_rails: bool = False,
    unwrap: float | None = None,
    topic: str | None = None,
) -> Dataset:
    """Load the data of a file other than a recording: a text table, .mat, .npz, Parquet or MCAP.

    Columns are chosen by name or by number from 1. The cells of a text are separated by semicolons,
    tabs, commas or blanks. A line of names is optional. Lines that begin with # or % are remarks.
    If semicolons separate the cells, the decimal mark may be a comma. An empty cell or NaN is a
    missing value. A sample without its output is marked missing. A sample without its input is left
    out, and a new experiment begins after it.

    Parameters
    ----------
    path : str or Path
        The file, of at most 128 MiB.
    input, signal : str
        Columns of u and y.
    time : str, optional
        Column of the times, in s unless its header names another unit; by default the column named
        t or time. Dates and times of day are also read. Rows that the times leave out are missing;
        a gap, or a time that goes back, begins a new experiment.
    Ts : float, optional
        Sampling time in s, used instead of the times. The default is the interval of the times. If
        `time` is not given, a number named Ts in a MAT-file or .npz has priority over the times.
    decimal : {",", "."}, optional
        Decimal mark of a text file. The default is the mark that all numbers of the file show.
    resample : bool, default False
        Interpolate rows at uneven times: y on straight lines, u held.
    hold_input : bool, default False
        Hold u where its cell is empty, for files that contain u only where it changes.
    mask_rails : bool, default False
        Mark samples of y at a rail of its converter as missing.
    unwrap : float, optional
        Range of a counter or angle that wraps, such as 65536 or 360; its jumps are removed from y.
    topic : str, optional
        Topic of an MCAP file of another program; the columns are the fields of its messages, such
        as `twist.linear.x`. The default of `time` is then the log time. Of several topics with
        commas, the last gives the times, and the newest values of the others are held.

    Returns
    -------
    Dataset
        Data with the name of y and the units from the file's header; `source` contains the hash of
        the file.

    Raises
    ------
    FileError
        The file cannot be read as data. The message names the problem and the remedy.
    OSError
        The file cannot be read.

    Examples
    --------
    >>> import armrig, numpy as np
    >>> rows = [[0, 1, 0.1], [0.01, 1, 0.1], [0.02, 4, np.nan]]
    >>> np.savetxt("mine.csv", rows, delimiter=",", header="t [s],u [V],alpha [rad]", comments="")
    >>> armrig.load_data("mine.csv", signal="alpha")
    <Dataset: 3 samples at 0.01 s; output alpha [rad]; 1 missing (33.3 %)>
    """
    columns = {"input": input, "signal": signal}
    how = Reading(time, Ts, resample, hold_input, mask_rails, unwrap)
    return _loaded(
        path, decimal, topic, lambda table, source: _dataset(table, columns, how, source)
    )


@checked_call
def load_signals(
    path: str | PathLike[str],
    *,
    inputs: str | Sequence[str],
    outputs: str | Sequence[str],
    time: str | None = None,
    Ts: float | None = None,
    decimal: Literal[",", "."] | None = None,
    resample: bool = False,
    hold_input: bool = False,
    mask_rails: bool = False,
    unwrap: float | None = None,
    topic: str | None = None,
) -> Signals:
    r"""Load several inputs and outputs of a file other than a recording.

    The file is read as in `load_data`. The name of a matrix, such as u of a saved iddata structure,
    chooses all columns of the matrix. If an input is missing at an instant, the instant is left
    out, and a new experiment begins after it. If an output is missing, the other outputs are kept.

    Parameters
    ----------
    path : str or Path
        The file, of at most 128 MiB.
    inputs, outputs : str or sequence of str
        Columns of the inputs and of the outputs, by name or by number from 1.
    time, Ts, decimal, resample, hold_input, mask_rails, unwrap, topic
        As for `load_data`.

    Returns
    -------
    Signals
        Data with the names and units from the file's header; `source` contains the hash of the
        file.

    Raises
    ------
    FileError
        The file cannot be read as data. The message names the problem and the remedy.
    OSError
        The file cannot be read.

    Examples
    --------
    >>> import armrig, pathlib
    >>> lines = ["t,u1,u2,y1", *(f"{0.1 * k:.1f},{k % 2},{k % 3},{k % 5}" for k in range(50))]
    >>> _ = pathlib.Path("plant.csv").write_text("\n".join(lines))
    >>> armrig.load_signals("plant.csv", inputs=["u1", "u2"], outputs="y1")
    <Signals: 50 samples at 0.1 s; outputs y1; inputs u1, u2>
    """
    how = Reading(time, Ts, resample, hold_input, mask_rails, unwrap)
    return _loaded(
        path, decimal, topic, lambda table, source: _signals(table, inputs, outputs, how, source)
    )


def _loaded(
    path: str | PathLike[str],
    decimal: str | None,
    topic: str | None,
    made: Callable[[Table, str], Data],
) -> Data:
    """Call `made` with the table in a file and the hash of the file, and return the result."""
    path = Path(path)
    try:
        data = read_bounded(path, MOST_BYTES)
        source = f"{SOURCE}:{hashlib.sha256(data).hexdigest()}"
        return made(table_of(data, path.suffix.lower(), decimal, topic), source)
    except FileError as err:
        raise FileError(f"{path}: {err}") from err
    except OSError as err:
        if err.errno != errno.EFBIG:
            raise
        raise FileError(
            f"{path}: has more than {MOST_BYTES >> 20} MiB; cut it into several files"
        ) from err


def _signals(
    table: Table,
    inputs: str | Sequence[str],
    outputs: str | Sequence[str],
    how: Reading,
    source: str,
) -> Signals:
    of_u, of_y = _columns_of(table, inputs, "input"), _columns_of(table, outputs, "signal")
    for what, option, of in (("input", "input", of_u), ("output", "signal", of_y)):
        if not of:
            raise FileError(f"give at least one {what}; {listed(table, option)}")
        if len(set(of)) < len(of):
            raise FileError(f"a column is given twice; {listed(table, option)}")
    taken = {*of_u, *of_y}
    if len(taken) < len(of_u) + len(of_y):
        raise FileError(f"a column is an input and an output; {listed(table, 'signal')}")
    rows = _rows(table, of_u, of_y, how)
    if not rows.u.size:
        raise FileError("no row has a value of each input; leave an input out, or fill it in")
    named_u, named_y = ([table.columns[i] for i in of] for of in (of_u, of_y))
    try:
        return Signals(
            u=rows.u,
            y=rows.y,
            Ts=rows.Ts,
            starts=rows.starts,
            inputs=_names(named_u, "u", named_y),
            outputs=_names(named_y, "y", named_u),
            input_units=[c.unit for c in named_u],
            units=[c.unit for c in named_y],
            source=source,
            history=rows.notes,
        )
    except InputError as err:
        raise FileError(str(err)) from err


def _columns_of(table: Table, wanted: str | Sequence[str], what: str) -> list[int]:
    """Return the indices of the columns; the name of a matrix gives all columns of the matrix."""
    found: list[int] = []
    for name in [wanted] if isinstance(wanted, str) else wanted:
        parts = [
            i
            for i, column in enumerate(table.columns)
            if column.name.rpartition(":")[0].rpartition(".")[2] == name.rpartition(".")[2] != ""
        ]
        found += parts or [chosen(table, name, what)]
    return found


def _names(columns: Sequence[Column], letter: str, others: Sequence[Column]) -> list[str]:
    """Return a name for each column, such as u1 for `u:1` and for a first input without a name.

    The name of a field is its last part if no other column has the same last part.
    """
    last_parts = [column.name.rpartition(".")[2] for column in (*columns, *others)]
    parts = [
        column.name if last and last_parts.count(last) > 1 else last.replace(":", "")
        for column, last in zip(columns, last_parts, strict=False)
    ]
    return [name or f"{letter}{k}" for k, name in enumerate(parts, 1)]


@dataclass(frozen=True, slots=True)
class Reading:
    """Options of reading a table; the fields are arguments of `load_data`."""

    time: str | None
    Ts: float | None
    resample: bool
    hold_input: bool
    mask_rails: bool
    unwrap: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """Samples that have a value of each input."""

    u: Array
    """Inputs (N, nu)."""
    y: Array
    """Outputs (N, ny), NaN where missing."""
    Ts: float
    """Sampling time in s."""
    starts: list[int]
    """First sample of each experiment."""
    notes: list[str]
    """History steps: what was done to the rows, and which faults remain."""


def _rows(table: Table, of_u: Sequence[int], of_y: Sequence[int], how: Reading) -> Rows:
    """Return the samples of these columns on their grid of times."""
    columns = [_values(table, i, "input") for i in of_u] + [
        _values(table, i, "signal") for i in of_y
    ]
    sizes = [x.size for x in columns]
    if len(set(sizes)) > 1:
        if len(sizes) == _ONE_PAIR:
            raise FileError(
                f"the input has {sizes[0]} samples and the signal {sizes[1]}; both need the same "
                "number"
            )
        raise FileError(
            f"the columns have {min(sizes)} to {max(sizes)} samples; all need the same number"
        )
    grid = _grid(table, {*of_u, *of_y}, sizes[0], how)
    notes = [*table.notes, *grid.notes]
    for k, i in enumerate(of_y, len(of_u)):
        name = table.columns[i].name or "y"
        columns[k], said = treated(columns[k], name, mask_rails=how.mask_rails, unwrap=how.unwrap)
        notes += said
    given = np.column_stack(columns[: len(of_u)])
    if not how.hold_input:
        _check_inputs(given, [table.columns[i].name or "u" for i in of_u])
    u = np.column_stack([grid.placed(x, held=True) for x in given.T])
    y = np.column_stack([grid.placed(x, held=False) for x in columns[len(of_u) :]])
    put_in = np.ones(grid.size, np.bool_)
    put_in[grid.at if grid.times is None else slice(None)] = False
    held = _held(u, put_in, everywhere=how.hold_input)
    if how.hold_input and (count := int(np.isnan(given).any(axis=1).sum())):
        notes.append(f"held the input in {plural(count, 'row')} without a value of it")
    known = np.array(np.isfinite(held).all(axis=1))
    starts, left_out = _between_gaps(known, put_in, grid.breaks)
    return Rows(u=held[known], y=y[known], Ts=grid.Ts, starts=starts, notes=[*notes, *left_out])


def _check_inputs(u: Array, names: Sequence[str]) -> None:
    """Refuse an input that most rows lack: without these rows the data would be distorted."""
    known = np.isfinite(u).sum(axis=0)
    i = int(np.argmin(known))
    if 0 < known[i] < _MIN_KNOWN_INPUTS * u.shape[0]:
        raise FileError(
            f"{shown(names[i])} has a value in {known[i]} of {u.shape[0]} rows; if it is written "
            "only where it changes, give --hold-input"
        )


def _held(u: Array, put_in: Mask, *, everywhere: bool) -> Array:
    """Return u with its last value where it is missing.

    Without `everywhere`, only in a few rows that the file leaves out, with one u on both sides.
    """
    held = u.copy()
    for column in held.T:
        known = np.isfinite(column)
        last = np.maximum.accumulate(np.where(known, np.arange(column.size), -1))
        after = np.minimum.accumulate(np.where(known, np.arange(column.size), column.size)[::-1])[
            ::-1
        ]
        fill = ~known & (last >= 0)
        if not everywhere:
            inside = fill & (after < column.size)
            same = column[last] == column[np.minimum(after, column.size - 1)]
            fill = inside & put_in & same & (after - last <= _MAX_HELD + 1)
        column[fill] = column[last[fill]]
    return held


def _between_gaps(known: Mask, put_in: Mask, breaks: Sequence[int]) -> tuple[list[int], list[str]]:
    """Return the first row of each experiment, counted in the known rows, and history steps."""
    begins = known & ~np.append(False, known[:-1])
    for k in breaks:
        after = np.flatnonzero(known[k:])
        begins[k + after[:1]] = True
    steps = []
    if left_out := int(np.count_nonzero(~known & ~put_in)):
        steps.append(
            f"left out {plural(left_out, 'sample')} without an input; a new experiment begins "
            "after each gap"
        )
    if unknown := int(np.count_nonzero(~known & put_in)):
        steps.append(
            f"the input is not known in {plural(unknown, 'row')} that the file leaves out; a new "
            "experiment begins after each such gap (--hold-input holds it instead)"
        )
    return np.flatnonzero(begins[known]).tolist(), steps


def _dataset(
    table: Table,
    columns: dict[str, str],
    how: Reading,
    source: str,
) -> Dataset:
    has_times = how.time or how.Ts is not None or table.Ts is not None or time_columns(table)
    at = _chosen(table, columns, has_times=bool(has_times))
    if at["input"] == at["signal"]:
        raise FileError(
            f"input and signal are both column {at['input'] + 1}; {listed(table, 'signal')}"
        )
    rows = _rows(table, [at["input"]], [at["signal"]], how)
    u, y = rows.u[:, 0], rows.y[:, 0]
    for name, x in (("input", u), ("signal", y)):
        try:
            require_size(name, x[~np.isnan(x)])
        except ValueError as err:
            raise FileError(str(err)) from err
    of_u, of_y = (table.columns[i] for i in at.values())
    return Dataset(
        u=u,
        y=y,
        Ts=rows.Ts,
        valid=~np.isnan(y),
        starts=rows.starts,
        output=of_y.name or "y",
        unit=of_y.unit,
        input_unit=of_u.unit,
        source=source,
        history=rows.notes,
    )


def _chosen(table: Table, columns: dict[str, str], *, has_times: bool) -> dict[str, int]:
    """Return the index of each requested column; an error names all columns that do not exist."""
    at: dict[str, int] = {}
    missing: dict[str, NoColumnError] = {}
    for what, wanted in columns.items():
        try:
            at[what] = chosen(table, wanted, what)
        except NoColumnError as err:
            missing[what] = err
    if len(missing) + (not has_times) > 1:
        said = " and ".join(f"{what} {shown(columns[what])}" for what in missing)
        said += ": there are no such columns" if len(missing) > 1 else ": there is no such column"
        said += "" if has_times else ", and the sampling time is not known (or give --Ts, in s)"
        options = " and --".join([*missing, *(() if has_times else ("time",))])
        raise FileError(f"{said}; {listed(table, options)}")
    for refused in missing.values():
        raise refused
    return at


def _grid(table: Table, taken: set[int], N: int, how: Reading) -> Grid:
    """Return the grid of the rows, from a column of times, the Ts of the file, or the given Ts."""
    if how.Ts is not None and not _MIN_TS <= how.Ts <= 1 / _MIN_TS:
        allowed = f"and from {_MIN_TS:g} to {1 / _MIN_TS:g}" if 0 < how.Ts < np.inf else "and > 0"
        raise FileError(f"Ts={how.Ts} must be finite {allowed}, in s")
    if how.time is not None:
        at = [chosen(table, how.time, "time")]
    elif how.Ts is None and table.Ts is not None:
        return unit_grid(N, table.Ts)
    else:
        at = [i for i in time_columns(table) if i not in taken]
    if len(at) == 1:
        name = table.columns[at[0]].name
        named = f"the times in column {shown(name)}" if name else "the times"
        try:
            times = times_of(table, at[0])
            if times.t.size != N:
                raise FileError(f"{named} are {times.t.size}, for {plural(N, 'sample')}")
            return grid_of(times, named, table.place, Ts=how.Ts, resample=how.resample)
        except FileError as err:
            if how.Ts is None or how.resample:
                raise
            text = f"used the given Ts = {how.Ts:g} s, because the times cannot be used: {err}"
            return replace(unit_grid(N, how.Ts), notes=(Step(text, DOUBT),))
    if how.Ts is not None and not how.resample:
        return unit_grid(N, how.Ts)
    msg = "the sampling time is not known: give it in s (--Ts)"
    if len(table.columns) > len(taken):
        msg += f", or the column of times: {listed(table, 'time')}"
    raise FileError(msg)


def _values(table: Table, i: int, what: str) -> Vector:
    """Return the values of a column, NaN where missing; refuse infinities and empty columns."""
    values = table.numbers(i)
    infinite = np.isinf(values)
    if infinite.any():
        k = int(np.argmax(infinite))
        raise FileError(
            f"{table.place(k)}: the {what} is {values[k]} here, and infinite in "
            f"{infinite.sum()} samples in all; leave an unknown value empty, or write NaN"
        )
    if np.isnan(values).all():
        msg = f"the {what}, column {i + 1}, has no value in any of {values.size} rows; "
        raise FileError(msg + listed(table, what))
    return values


# Recognition of a file's kind by its first bytes.


_KNOWN_KINDS = "armrig reads tables of text, .mat (to -v7), .npz, Parquet and MCAP"
_SAVE_IN_MATLAB = "save it in MATLAB with save('data.mat', 'u', 'y', '-v7')"
_UTF_16 = 'is saved as UTF-16, like Excel\'s "Unicode text"; save it as "CSV UTF-8"'
_REFUSED_KINDS = (
    (b"MATLAB 7.3", f"is a MAT-file of version 7.3, which only MATLAB reads; {_SAVE_IN_MATLAB}"),
    (b"\x89HDF\r\n", f"is HDF5, which armrig does not read; if MATLAB wrote it, {_SAVE_IN_MATLAB}"),
    (b"# Created by Octave", "is Octave's text format; in Octave: save -v7 data.mat u y"),
    (b"\xd0\xcf\x11\xe0", "is an old Excel workbook; save its sheet as CSV"),
    (b"\x93NUMPY", "is an .npy, an array without a name; save it with numpy.savez(…, u=u, y=y)"),
    (b"\x1f\x8b", "is packed with gzip; unpack it first (gunzip)"),
    (codecs.BOM_UTF16_LE, _UTF_16),
    (codecs.BOM_UTF16_BE, _UTF_16),
)


def table_of(
    data: bytes, suffix: str, decimal: str | None = None, topic: str | None = None
) -> Table:
    """Return the table in a file, whose kind is recognised by its first bytes.

    Only a MAT-file of version 4 is recognised by its suffix, because it begins with numbers.
    `decimal` is the decimal mark of a text, or None if the text itself shows it. `topic` chooses
    the messages of an MCAP file.

    Raises
    ------
    FileError
        The file is of a kind that armrig does not read, or it is damaged.
    """
    for beginning, what in _REFUSED_KINDS:
        if data.startswith(beginning):
            raise FileError(what)
    if data.startswith(MAGIC):
        return messages.table_of(data, topic)
    if topic is not None:
        raise FileError(f"topic {topic}: only MCAP files have topics; leave out --topic")
    if data.startswith(b"PAR1"):
        return read_parquet(data)
    if data.startswith(b"PK\x03\x04"):
        return arrays.read_npz(data)
    if data.startswith(b"MATLAB 5.0") or (suffix == ".mat" and b"\0" in data[:128]):
        return arrays.read_mat(data)
    if b"\0" in data:
        raise FileError(f"is not text, and not of another known kind; {_KNOWN_KINDS}")
    try:
        content = decoded(data)
    except FileError as err:
        raise FileError(f'{err} (in Excel: "CSV UTF-8")') from err
    return text.table_of(content, decimal)
