"""Columns of numbers from the named arrays of MAT-files, .npz files and Parquet files."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from typing import Any

import numpy as np
from armrig_core.errors import FileError, InputError
from armrig_core.process.imports import imported

from armrig.data.files.mat_variables import EMPTY, StructureArray, Unread, variables
from armrig.data.files.table import NO_NUMBERS, Column, Table, Vector, require_room, titled
from armrig.numerics.quantities import plural

_MAX_DIMENSIONS = 2
_TIME_NAMES = ("t", "time")
_NAME_OF_FIELD = {"OutputData": "y", "InputData": "u"}  # fields of iddata
_PICKLED = "contains pickled Python objects, which can run code and are not loaded; save numbers"
_NUMBERS = ("int", "uint", "float", "double", "halffloat", "decimal", "bool")  # of Parquet
_TIMES = ("timestamp", "duration")
_PER_SECOND = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}


def _table_of(arrays: Mapping[str, Any], refused: Mapping[str, str], packed: int) -> Table:
    """Return the columns of arrays; time runs along the longer side, a number named Ts is Ts."""
    require_room(8 * sum(array.size for array in arrays.values()), packed)
    columns: dict[str, Any] = {}
    others, Ts = dict(refused), None
    for name, array in arrays.items():
        try:
            found = _columns(array)
        except InputError as err:
            others[name] = str(err)
            continue
        if array.size > 1:
            several = len(found) > 1
            columns |= {f"{name}:{i}" if several else name: x for i, x in enumerate(found, 1)}
        elif name.rpartition(".")[2].casefold() == "ts":
            Ts = float(array.reshape(-1)[0])
    names = [Column(name=name) for name in columns]
    return Table(columns=names, values=[*columns.values()], refused=others, Ts=Ts)


def _columns(array: Any) -> list[Any]:
    """Return the columns of an array of real numbers; refuse any other array with the reason."""
    if array.dtype.kind == "c":
        raise InputError("is complex; save its real part if only that part was measured")
    if array.dtype.kind not in "buif":
        raise InputError(NO_NUMBERS)
    if array.size == 0:
        raise InputError(EMPTY)
    if array.ndim > _MAX_DIMENSIONS:
        raise InputError(
            f"has {array.ndim} dimensions; save it as a vector, or a matrix of columns"
        )
    if array.ndim < _MAX_DIMENSIONS:
        return [array]
    return list(array.T if array.shape[0] >= array.shape[1] else array)


# MAT-files: vectors, matrices, structures with these, structures with time of Simulink, and old
# iddata objects.


def read_mat(data: bytes) -> Table:
    """Return the columns of a MAT-file of version 4 to 7."""
    arrays: dict[str, Any] = {}
    refused: dict[str, str] = {}
    for name, value in variables(data):
        _sort(name, value, arrays, refused)
    times = [np.ravel(x) for name, x in arrays.items() if name.endswith(".time")]
    has_time = any(name.casefold() in _TIME_NAMES for name in arrays)
    if times and not has_time and all(np.array_equal(times[0], x) for x in times):
        arrays["time"] = times[0]
    return _table_of(arrays, refused, len(data))


def _sort(name: str, value: Any, arrays: dict[str, Any], refused: dict[str, str]) -> None:
    """Add a variable, or the fields of a structure, to the arrays or to the refused names."""
    while isinstance(value, list) and len(value) == 1:
        value = value[0]  # a cell array that contains one experiment
    if isinstance(value, dict):
        fields = _logged(value) if {"time", "signals"} <= value.keys() else value
        for field, inner in fields.items():
            path = f"{name}.{_NAME_OF_FIELD.get(field, field)}".rstrip(".")
            _sort(path, inner, arrays, refused)
    elif isinstance(value, list):
        are = isinstance(value, StructureArray)
        what = (
            f"an array of {plural(len(value), 'structure')}"
            if are
            else f"a cell of {plural(len(value), 'value')}"
        )
        refused[name] = f"is {what}; save one of them"
    elif isinstance(value, str):
        refused[name] = NO_NUMBERS
    elif isinstance(value, Unread):
        refused[name] = value.why
    else:
        arrays[name] = value


def _logged(structure: dict[str, Any]) -> dict[str, Any]:
    """Return the times and the signals of a Simulink structure with time, by their labels."""
    signals = structure["signals"]
    each = signals if isinstance(signals, list) else [signals]
    if not all(isinstance(signal, dict) and "values" in signal for signal in each):
        return structure
    found = {"time": structure["time"]}
    for k, signal in enumerate(each, 1):
        label = signal.get("label", "")
        name = label.strip(" <>") if isinstance(label, str) else ""  # Simulink inherits <label>
        if not name or name in found:
            name = f"signals:{k}" if len(each) > 1 else ""
        values = signal["values"]
        if getattr(values, "ndim", 0) == 3:  # a matrix at each time
            values = values.reshape(-1, values.shape[2], order="F")
        found[name] = values
    return found


def read_npz(data: bytes) -> Table:
    """Return the columns of an .npz; pickled objects are not loaded."""
    arrays: dict[str, Any] = {}
    refused: dict[str, str] = {}
    with np.load(BytesIO(data), allow_pickle=False) as archive:
        members = [m for m in archive.zip.infolist() if m.filename.endswith(".npy")]
        require_room(sum(member.file_size for member in members), len(data))
        for member in members:
            name = member.filename.removesuffix(".npy")
            try:
                arrays[name] = archive[member.filename]
            except ValueError as err:
                if "allow_pickle" not in str(err):
                    raise
                refused[name] = _PICKLED
    if not (arrays or refused):
        raise FileError(
            "is a ZIP archive without arrays, such as an Excel workbook; save its sheet as CSV"
        )
    return _table_of(arrays, refused, len(data))


def read_parquet(data: bytes) -> Table:
    """Return the columns of a Parquet file; time stamps are in s from the first time."""
    file = imported("pyarrow.parquet", "parquet").ParquetFile(BytesIO(data))
    kinds = {field.name: str(field.type) for field in file.schema_arrow}
    if len(kinds) < len(file.schema_arrow):
        raise FileError("two of its columns have the same name; rename one of them")
    # Texts are not read: in a small file, a text may be repeated a million times.
    names = [name for name, kind in kinds.items() if kind.startswith((*_NUMBERS, *_TIMES))]
    require_room(8 * file.metadata.num_rows * len(names), len(data))
    return Table(
        columns=[
            Column(name=name, unit="s") if kinds[name].startswith(_TIMES) else titled(name)
            for name in names
        ],
        values=[_numbers(column) for column in file.read(columns=names).columns],
        refused=dict.fromkeys(kinds.keys() - names, NO_NUMBERS),
    )


def _numbers(column: Any) -> Vector:
    """Return the values of a column of Parquet; NaN where a value is missing."""
    kind, per_second = str(column.type), 1
    if kind == "bool":
        column = column.cast("int8")
    elif kind.startswith(_TIMES):
        compute = imported("pyarrow.compute", "parquet")
        ticks, per_second = column.cast("int64"), _PER_SECOND[column.type.unit]
        column = compute.subtract(ticks, compute.min(ticks))  # exact
    values: Vector = column.cast("float64", safe=False).to_numpy()
    return values / per_second
