"""Loading of a `Dataset` from a file: recognition of the file's kind, and choice of the columns."""

from __future__ import annotations

import codecs
import errno
import hashlib
from collections.abc import Callable, Sequence
from math import isclose
from os import PathLike
from pathlib import Path
from typing import TypeVar

import numpy as np
from armrig_core.bounded import decoded, read_bounded
from armrig_core.calls import checked_call
from armrig_core.errors import FileError, InputError
from armrig_core.recording_file.file_records import MAGIC

from armrig.data.dataset import Dataset, require_size
from armrig.data.files import arrays, messages, text
from armrig.data.files.parquet import read_parquet
from armrig.data.files.table import Column, NoColumnError, Table, Vector, chosen, listed, shown
from armrig.data.signals import Mask, Signals

Data = TypeVar("Data")

MOST_BYTES = 1 << 27
"""Largest size of a file, in B; a text of a million rows of eight numbers each is smaller."""
SOURCE = "data"
"""Prefix of the hash in `source` if the file is not a recording."""
_TIME_NAMES = ("t", "time")
MAX_TS_DEVIATION = 0.05  # largest relative deviation of the given Ts from Ts in the file


@checked_call
def load_data(
    path: str | PathLike[str],
    *,
    input: str = "u",
    signal: str = "y",
    time: str | None = None,
    Ts: float | None = None,
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
        t or time. The times must be equidistant.
    Ts : float, optional
        Sampling time in s, used instead of the times. The default is the interval of the times. If
        `time` is not given, a number named Ts in a MAT-file or .npz has priority over the times.
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
    return _loaded(path, lambda table, source: _dataset(table, columns, time, Ts, source), topic)


@checked_call
def load_signals(
    path: str | PathLike[str],
    *,
    inputs: str | Sequence[str],
    outputs: str | Sequence[str],
    time: str | None = None,
    Ts: float | None = None,
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
    time : str, optional
        Column of the times, as for `load_data`.
    Ts : float, optional
        Sampling time in s, as for `load_data`.
    topic : str, optional
        Topic of an MCAP file of another program, as for `load_data`.

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

    def made(table: Table, source: str) -> Signals:
        return _signals(table, inputs, outputs, time, Ts, source)

    return _loaded(path, made, topic)


def _loaded(
    path: str | PathLike[str], made: Callable[[Table, str], Data], topic: str | None
) -> Data:
    """Call `made` with the table in a file and the hash of the file, and return the result."""
    path = Path(path)
    try:
        data = read_bounded(path, MOST_BYTES)
        source = f"{SOURCE}:{hashlib.sha256(data).hexdigest()}"
        return made(table_of(data, path.suffix.lower(), topic), source)
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
    time: str | None,
    Ts: float | None,
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
    notes = list(table.notes)
    if Ts is None:
        Ts = _sampling_time(table, time, taken)
    else:
        notes += _other_times(table, time, taken, Ts)
    values = [_values(table, i, "input") for i in of_u] + [
        _values(table, i, "signal") for i in of_y
    ]
    sizes = sorted({x.size for x in values})
    if len(sizes) > 1:
        raise FileError(
            f"the columns have {sizes[0]} to {sizes[-1]} samples; all need the same number"
        )
    u, y = (np.column_stack(x) for x in (values[: len(of_u)], values[len(of_u) :]))
    known = np.array(np.isfinite(u).all(axis=1))
    if not known.any():
        raise FileError("no row has a value of each input; leave an input out, or fill it in")
    named_u, named_y = ([table.columns[i] for i in of] for of in (of_u, of_y))
    starts, left_out = _between_gaps(known)
    try:
        return Signals(
            u=u[known],
            y=y[known],
            Ts=Ts,
            starts=starts,
            inputs=_names(named_u, "u"),
            outputs=_names(named_y, "y"),
            input_units=[c.unit for c in named_u],
            units=[c.unit for c in named_y],
            source=source,
            history=[*notes, *left_out],
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


def _names(columns: Sequence[Column], letter: str) -> list[str]:
    """Return a name for each column, such as u1 for `u:1` and for a first input without a name."""
    names = [column.name.rpartition(".")[2].replace(":", "") for column in columns]
    return [name or f"{letter}{k}" for k, name in enumerate(names, 1)]


def _between_gaps(known: Mask) -> tuple[list[int], list[str]]:
    """Return the first row of each experiment, counted in the known rows, and history steps."""
    begins = known & ~np.append(False, known[:-1])
    left_out = int(known.size - np.count_nonzero(known))
    count = "1 sample" if left_out == 1 else f"{left_out} samples"
    step = f"left out {count} without an input; a new experiment begins after each gap"
    return np.flatnonzero(begins[known]).tolist(), [step] if left_out else []


def _dataset(
    table: Table,
    columns: dict[str, str],
    time: str | None,
    Ts: float | None,
    source: str,
) -> Dataset:
    has_times = time is not None or Ts is not None or table.Ts is not None or _named_times(table)
    at = _chosen(table, columns, has_times=bool(has_times))
    if at["input"] == at["signal"]:
        raise FileError(
            f"input and signal are both column {at['input'] + 1}; {listed(table, 'signal')}"
        )
    notes = list(table.notes)
    if Ts is None:
        Ts = _sampling_time(table, time, set(at.values()))
    else:
        notes += _other_times(table, time, set(at.values()), Ts)
    u, y = (_values(table, i, what) for what, i in at.items())
    if u.size != y.size:
        raise FileError(
            f"the input has {u.size} samples and the signal {y.size}; both need the same number"
        )
    for name, x in (("input", u), ("signal", y)):
        try:
            require_size(name, x[~np.isnan(x)])
        except ValueError as err:
            raise FileError(str(err)) from err
    known = np.array(np.isfinite(u))
    of_u, of_y = (table.columns[i] for i in at.values())
    starts, left_out = _between_gaps(known)
    return Dataset(
        u=u[known],
        y=y[known],
        Ts=Ts,
        valid=~np.isnan(y[known]),
        starts=starts,
        output=of_y.name or "y",
        unit=of_y.unit,
        input_unit=of_u.unit,
        source=source,
        history=[*notes, *left_out],
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


def _named_times(table: Table) -> list[int]:
    """Return the indices of the columns named t or time."""
    return [i for i, c in enumerate(table.columns) if c.name.casefold() in _TIME_NAMES]


def _other_times(table: Table, time: str | None, taken: set[int], Ts: float) -> list[str]:
    """Return a note if the sampling time in the file differs from the given Ts."""
    try:
        said = _sampling_time(table, time, taken)
    except FileError:
        return []  # the times cannot be read, and the given Ts replaces them
    if isclose(said, Ts, rel_tol=MAX_TS_DEVIATION):
        return []
    return [f"used the given Ts = {Ts:g} s, although the times are {said:g} s apart"]


def _sampling_time(table: Table, time: str | None, taken: set[int]) -> float:
    """Return Ts from the column of times, or the Ts that the file states."""
    if time is not None:
        i = chosen(table, time, "time")
    elif table.Ts is not None:
        return table.Ts
    else:
        named = [i for i in _named_times(table) if i not in taken]
        if len(named) != 1:
            msg = "the sampling time is not known: give it in s (--Ts)"
            if len(table.columns) > len(taken):
                msg += f", or the column of times: {listed(table, 'time')}"
            raise FileError(msg)
        i = named[0]
    return sampling_time(table.numbers(i), table.columns[i], table.place)


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


def table_of(data: bytes, suffix: str, topic: str | None = None) -> Table:
    """Return the table in a file, whose kind is recognised by its first bytes.

    Only a MAT-file of version 4 is recognised by its suffix, because it begins with numbers. The
    topic chooses the messages of an MCAP file.

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
    return text.table_of(content)


# Sampling time from a column of times.


MAX_INTERVAL_DEVIATION = 0.05
"""Largest allowed deviation of an interval from the median interval, as a share of the median."""
_SECONDS = {"": 1.0, "s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6}
_SECONDS |= {"min": 60.0, "h": 3600.0}
_MAX_DIGITS = 12


def sampling_time(t: Vector, column: Column, place: Callable[[int], str]) -> float:
    """Return the sampling time Ts, in s, of equidistant times.

    The times of a file often have few digits. Ts is therefore the mean interval, rounded to the
    fewest digits with which multiples of Ts still fit the times.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times in the column's unit; in s if the column has no unit.
    place : callable
        Function that returns the place of instant k in the file.

    Raises
    ------
    FileError
        The unit is unknown, a time is missing, there is only one time, or an interval differs from
        the median interval by more than a twentieth.
    """
    name = f"the times in column {column.name}" if column.name else "the times"
    if column.unit.casefold() not in _SECONDS:
        known = ", ".join(unit for unit in _SECONDS if unit)
        raise FileError(
            f"{name} are in {column.unit}, known units are {known}; give Ts in s (--Ts)"
        )
    missing = ~np.isfinite(t)
    if missing.any():
        msg = f"{place(int(np.argmax(missing)))}: {name} have no value here; add it, or give "
        raise FileError(msg + "Ts in s (--Ts)")
    if t.size < 2:
        raise FileError(
            f"{name}: a sampling time needs at least 2 times, got {t.size}; give Ts in s (--Ts)"
        )
    t = t * _SECONDS[column.unit.casefold()]
    intervals = np.diff(t)
    usual = float(np.median(intervals))
    wrong = ~(np.abs(intervals - usual) <= MAX_INTERVAL_DEVIATION * usual)
    if wrong.any() or usual <= 0:
        k = int(np.argmax(wrong)) + 1
        raise FileError(
            f"{place(k)}: {name} go from {t[k - 1]:.9g} to {t[k]:.9g} s, the usual interval is "
            f"{usual:.6g} s; sample evenly, cut the file, or give Ts in s (--Ts) if the times are "
            "wrong"
        )
    return _roundest(t)


def _roundest(t: Vector) -> float:
    k = np.arange(t.size)
    mean = float(t[-1] - t[0]) / (t.size - 1)
    apart = 1.1 * float(np.ptp(t - mean * k)) + 1e-9 * mean
    for digits in range(1, _MAX_DIGITS):
        rounded = float(f"{mean:.{digits}g}")
        if float(np.ptp(t - rounded * k)) <= apart:
            return rounded
    return mean
