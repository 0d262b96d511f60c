"""Loading of data from a file: choice of the columns."""

from __future__ import annotations

import errno
import hashlib
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path
from shlex import quote
from typing import Any, Literal

import numpy as np
from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import read_bounded
from armrig_core.process.calls import with_argument_checks

from armrig.data.columns import Vector
from armrig.data.dataset import Dataset, Signals
from armrig.data.files.clocks import on_one_clock
from armrig.data.files.imported_file import GridTable
from armrig.data.files.kinds import table_of
from armrig.data.files.placement import Reading, place, values_of
from armrig.data.files.stamps import time_columns
from armrig.data.files.table import (
    Column,
    NoColumnError,
    ReadingError,
    Table,
    choose,
    remedy,
    shorten,
)
from armrig.data.step import OTHER_COLUMNS, OTHER_INPUTS, Step
from armrig.numerics.quantities import plural

MOST_BYTES = 1 << 27
"""Largest size of a file, in B; a text of a million rows of eight numbers each is smaller."""
SOURCE = "data"
"""Prefix of the hash in `source` if the file is not a recording."""
_MAX_JUMPS, _MIN_JUMP = 1 / 3, 0.1  # of an input: share of the rows, and of the column's range


@with_argument_checks
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
        Data with the names and units from the file's header; `source` contains the hash of
        the file.

    Raises
    ------
    FileError
        The file cannot be read as data. The message names the problem and the remedy.
    OSError
        The file cannot be read.

    Examples
    --------
    >>> import numpy as np
    >>> rows = [[0, 1, 0.1], [0.01, 1, 0.1], [0.02, 4, np.nan]]
    >>> np.savetxt("mine.csv", rows, delimiter=",", header="t [s],u [V],alpha [rad]", comments="")
    >>> armrig.load_data("mine.csv", signal="alpha")
    <Dataset: 3 samples at 0.01 s; output alpha [rad]; 1 missing (33.3 %)>
    """
    how = Reading(time, Ts, decimal, resample, hold_input, mask_rails, unwrap, topic)
    with naming_file(Path(path)):
        inputs, outputs, fields = _samples(Path(path), input, signal, how)
        if (sizes := (len(inputs), len(outputs))) != (1, 1):
            raise InputError(
                f"{plural(sizes[0], 'input')} and {plural(sizes[1], 'output')} are named, but "
                "load_data reads one of each: use armrig.load_signals(path, inputs=…, outputs=…)"
            )
        of_u, of_y = inputs[0], outputs[0]
        return Signals(
            inputs=_names([of_u], "u", [of_y]) if of_u.name else None,
            outputs=of_y.name or "y",
            units=of_y.unit,
            input_units=of_u.unit,
            **fields,
        ).dataset()


@with_argument_checks
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
    r"""Load several inputs and outputs of a file, which is read as in `load_data`.

    The name of a matrix, such as u of a saved iddata structure,
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
    FileError, OSError
        As for `load_data`.

    Examples
    --------
    >>> import pathlib
    >>> lines = ["t,u1,u2,y1", *(f"{0.1 * k:.1f},{k % 2},{k % 3},{k % 5}" for k in range(50))]
    >>> _ = pathlib.Path("plant.csv").write_text("\n".join(lines))
    >>> armrig.load_signals("plant.csv", inputs=["u1", "u2"], outputs="y1")
    <Signals: 50 samples at 0.1 s; outputs y1; inputs u1, u2>
    """
    how = Reading(time, Ts, decimal, resample, hold_input, mask_rails, unwrap, topic)
    inputs, outputs = ([x] if isinstance(x, str) else list(x) for x in (inputs, outputs))
    with naming_file(Path(path)):
        of_u, of_y, fields = _samples(Path(path), inputs, outputs, how)
        return Signals(
            inputs=_names(of_u, "u", of_y),
            outputs=_names(of_y, "y", of_u),
            input_units=[column.unit for column in of_u],
            units=[column.unit for column in of_y],
            **fields,
        )


@contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """Begin the message of an error with the path of the file."""
    try:
        yield
    except ReadingError as err:
        raise ReadingError(f"{path}: {err}", err.option) from err
    except NoColumnError as err:
        raise NoColumnError(f"{path}: {err}") from err
    except InputError as err:
        text = str(err).replace("FILE", quote(str(path)))  # in a command that converts the file
        raise FileError(f"{path}: {text}") from err
    except OSError as err:
        if err.errno == errno.ENOENT and str(path).startswith("@"):
            raise FileError(
                f"{path}: is the name of a recording: use armrig.load({str(path)!r})"
            ) from err
        if err.errno != errno.EFBIG:
            raise
        msg = f"{path}: has more than {MOST_BYTES >> 20} MiB; cut it into several files"
        raise FileError(msg) from err


def _samples(
    path: Path, inputs: str | list[str], outputs: str | list[str], how: Reading
) -> tuple[list[Column], list[Column], dict[str, Any]]:
    """Return the columns of inputs and outputs, and the arguments of `Signals` without names."""
    data = read_bounded(path, MOST_BYTES)
    table = table_of(data, path.suffix.lower(), how.decimal, how.topic)
    output = outputs if isinstance(outputs, str) else next(iter(outputs), None)
    table = on_one_clock([(path.name, table)], output=output, time=how.time)
    of_u, of_y = _columns(table, {"input": inputs, "signal": outputs}, how)
    named_u, named_y = ([table.columns[i] for i in indices] for indices in (of_u, of_y))
    columns = {i: values_of(table, i, "input") for i in of_u}
    columns |= {i: values_of(table, i, "signal") for i in of_y}
    names = {i: table.columns[i].name or "u" * (i in of_u) or "y" for i in columns}
    grid, columns, put_in, history = place(table, columns, of_u, of_y, names, how, are_signals=True)
    others = _other_numbers(table, {*of_u, *of_y})
    if switching := [name for name, x in others.items() if _switches(x)]:
        text = f"not in the data, but switching like an input: {', '.join(switching)}"
        history.append(Step(text, OTHER_INPUTS))
    elif others:
        history.append(
            Step(f"{plural(len(others), 'other column')} not in the data", OTHER_COLUMNS)
        )
    u, y = (np.column_stack([columns[i] for i in indices]) for indices in (of_u, of_y))
    has_inputs = np.isfinite(u).all(axis=1)
    if not has_inputs.any():
        raise FileError("no row has a value of each input; leave an input out, or fill it in")
    # Each row without an input, and each break of the times, begins a new experiment.
    part = np.cumsum(~has_inputs) + np.searchsorted(grid.breaks, np.arange(grid.size), side="right")
    if count := int(np.count_nonzero(~has_inputs & ~put_in)):
        left_out = f"left out {plural(count, 'sample')} without an input"
        history.append(f"{left_out}; a new experiment begins after each gap")
    if count := int(np.count_nonzero(~has_inputs & put_in)):
        history.append(
            f"the input is not known in {plural(count, 'row')} that the file leaves out; a new "
            "experiment begins after each such gap (--hold-input holds it instead)"
        )
    fields = {
        "u": u[has_inputs],
        "y": y[has_inputs],
        "Ts": grid.Ts,
        "starts": np.flatnonzero(np.diff(part[has_inputs], prepend=-1)).tolist(),
        "source": f"{SOURCE}:{hashlib.sha256(data).hexdigest()}",
        "history": history,
    }
    return named_u, named_y, fields


def _other_numbers(table: Table, taken: Collection[int]) -> dict[str, Vector]:
    """Return the known numbers of other columns that change, by name; times are left out."""
    numbers = {}
    for i in sorted(set(range(len(table.columns))) - {*taken, *time_columns(table)}):
        x = np.empty(0)
        with suppress(FileError):  # words, or a mark that is not known
            x = table.numbers(i)
        x = x[np.isfinite(x)]
        steps = np.diff(x)
        if x.size and np.ptp(steps if steps.size else x) > 0:  # a counter is no signal
            numbers[table.columns[i].name or str(i + 1)] = x
    return numbers


def _switches(x: Vector) -> bool:
    """Return whether a signal holds its values and jumps, as an input does."""
    jumps = np.abs(np.diff(x))
    jumps = jumps[jumps > 0]
    return bool(0 < jumps.size <= _MAX_JUMPS * x.size and np.median(jumps) >= _MIN_JUMP * np.ptp(x))


def _columns(
    table: Table, columns: dict[str, str | list[str]], how: Reading
) -> tuple[list[int], list[int]]:
    """Return the indices of the inputs and of the outputs; an error names all missing columns."""
    chosen: dict[str, list[int]] = {role: [] for role in columns}
    missing: list[tuple[str, str, NoColumnError]] = []
    for role, wanted in columns.items():
        for name in [wanted] if isinstance(wanted, str) else wanted:
            try:
                of_matrix = [] if isinstance(wanted, str) else _matrix(table, name)
                chosen[role] += of_matrix or [choose(table, name, role)]
            except NoColumnError as err:
                missing.append((role, name, err))
    has_times = bool(
        how.time
        or how.Ts is not None
        or table.Ts is not None
        or time_columns(table)
        or isinstance(table, GridTable)
    )
    if len(missing) + (not has_times) > 1:
        text = " and ".join(f"{role} {shorten(name)}" for role, name, _ in missing)
        text += ": there are no such columns" if len(missing) > 1 else ": there is no such column"
        text += "" if has_times else ", and the sampling time is not known (or give --Ts, in s)"
        options = dict.fromkeys([*(role for role, *_ in missing), *([] if has_times else ["time"])])
        raise NoColumnError(f"{text}; {remedy(table, ' and --'.join(options))}")
    if missing:
        raise missing[0][-1]
    owners: dict[int, list[str]] = {}
    for role, indices in chosen.items():
        if not indices:
            raise FileError(f"give at least one {role}; {remedy(table, role)}")
        for i in indices:
            owners.setdefault(i, []).append(role)
    for i, roles in owners.items():
        if roles[1:]:
            raise FileError(
                f"{' and '.join(roles)} are both column {i + 1}; {remedy(table, roles[-1])}"
            )
    return chosen["input"], chosen["signal"]


def _matrix(table: Table, name: str) -> list[int]:
    """Return the indices of the columns of a matrix."""
    last = name.rpartition(".")[2]
    heads = [column.name.rpartition(":")[0].rpartition(".")[2] for column in table.columns]
    return [i for i, head in enumerate(heads) if head == last != ""]


def _names(columns: Sequence[Column], letter: str, others: Sequence[Column]) -> list[str]:
    """Return a name for each column: the last part of a field, u1 for `u:1`, or u1 for no name."""
    lasts = [column.name.rpartition(".")[2] for column in (*columns, *others)]
    names = [
        column.name if last and lasts.count(last) > 1 else last.replace(":", "")
        for column, last in zip(columns, lasts, strict=False)
    ]
    return [name or f"{letter}{k}" for k, name in enumerate(names, 1)]
