"""Columns of numbers from the named arrays of MAT-files, .npz files and Parquet files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from io import BytesIO
from typing import Any

import numpy as np
from armrig_core.errors import FileError, InputError
from armrig_core.process.imports import load_extra

from armrig.data.files.mat_variables import EMPTY, StructureArray, Unread, Value, variables
from armrig.data.files.table import (
    MIN_TS,
    NO_NUMBERS,
    Column,
    Table,
    Vector,
    column_of,
    require_room,
    shorten,
)
from armrig.data.step import DOUBT, Step
from armrig.numerics.quantities import plural

_MAX_DIMENSIONS = 2
_TIME_NAMES = ("t", "time")
_NAME_OF_FIELD = {"OutputData": "y", "InputData": "u", "SamplingInstants": "time"}  # of iddata
_UNIT_OF_FIELD = {"OutputData": "OutputUnit", "InputData": "InputUnit"}
_TICKS_PER_SECOND = {"nanoseconds": 10**9, "microseconds": 10**6, "milliseconds": 1000, "": 1}
_SECONDS = {"seconds": 1, "minutes": 60, "hours": 3600, "days": 86400, "weeks": 604_800}
_SECONDS |= {"months": 2_628_000, "years": 31_536_000}  # MATLAB's year has 365 days
# Fields of each channel of dSPACE ControlDesk, QUARC, and Simulink.
_LABELS, _VALUES, _UNITS = ("Name", "name", "label"), ("Data", "data", "values"), ("Unit", "unit")
_PICKLED = "contains pickled Python objects, which can run code and are not loaded; save numbers"
_NUMBERS = ("int", "uint", "float", "double", "halffloat", "decimal", "bool")  # of Parquet
_TIMES = ("timestamp", "duration")


@dataclass(frozen=True, slots=True)
class _NamedArrays:
    """Arrays of a file by their names, and facts about them."""

    arrays: dict[str, Any] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)
    units: dict[str, Sequence[str]] = field(default_factory=dict)
    """Units of the columns of an array."""
    notes: list[str] = field(default_factory=list)

    def table(self, packed: int) -> Table:
        """Return the columns; time runs along the longer side, a number named Ts is Ts."""
        require_room(8 * sum(array.size for array in self.arrays.values()), packed)
        columns, values, Ts = list[Column](), list[Any](), set[float]()
        for name, array in self.arrays.items():
            try:
                vectors = _columns(array)
            except InputError as err:
                self.refused[name] = str(err)
                continue
            title, n = column_of(name), len(vectors)
            units = self.units.get(name, ())
            units = units if len(units) == n and any(units) else (title.unit,) * n
            if array.size > 1:
                for k, vector in enumerate(vectors):
                    is_time = vector.dtype.kind in "mM"
                    label = title.name if n == 1 else f"{title.name}:{k + 1}"
                    columns.append(Column(name=label, unit="s" if is_time else units[k]))
                    values.append(_seconds(vector) if is_time else vector)
            elif name.rpartition(".")[2].casefold() == "ts" and array.dtype.kind != "M":
                is_time = array.dtype.kind == "m"
                Ts.add(float((array / np.timedelta64(1, "s") if is_time else array).item()))
        if wrong := [x for x in Ts if not MIN_TS <= x <= 1 / MIN_TS]:  # NaN, too
            self.refused["Ts"] = f"is {wrong[0]:g}, which is no sampling time in s"
            Ts.clear()
        if len(Ts) > 1:
            self.refused["Ts"] = f"has several values: {', '.join(f'{x:g}' for x in sorted(Ts))}"
        return Table(
            columns=columns,
            values=values,
            refused=self.refused,
            Ts=Ts.pop() if len(Ts) == 1 else None,
            notes=self.notes,
        )


def _columns(array: Any) -> list[Any]:
    """Return the columns of an array of real numbers or times; refuse any other array."""
    if array.dtype.kind == "c":
        raise InputError("is complex; save its real part if only that part was measured")
    if array.dtype.kind not in "buifmM":
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


def _seconds(times: Any) -> Vector:
    """Return datetime64 or timedelta64 as seconds from the earliest time; NaN if missing."""
    if np.datetime_data(times.dtype)[0] in "YM":  # no fixed number of seconds
        times = times.astype("M8[D]")
    valid_times = times[~np.isnat(times)]
    elapsed = times - (valid_times.min() if valid_times.size else times[:1])  # exact
    return np.asarray(elapsed / np.timedelta64(1, "s"), np.float64)


# MAT-files: vectors, matrices, structures with these, structures with time of Simulink, captures of
# dSPACE, arrays of structures with names, old iddata objects, and structures of their fields.


def read_mat(data: bytes) -> Table:
    """Return the columns of a MAT-file of version 4 to 7."""
    contents = _NamedArrays()
    for name, value in variables(data):
        _sort(name, value, contents)
    arrays, units = contents.arrays, contents.units
    times = [name for name, x in arrays.items() if name.endswith(".time") and x.size]
    has_time = any(name.casefold() in _TIME_NAMES for name in arrays)
    if times and not has_time and _are_equal([arrays[name] for name in times]):
        first, *others = times
        named = {"time" if name == first else name: arrays[name] for name in arrays}
        arrays = {name: x for name, x in named.items() if name not in others}
        units = units | {"time": units[first]}
    return replace(contents, arrays=arrays, units=units).table(len(data))


def _are_equal(arrays: Sequence[Any]) -> bool:
    return all(np.array_equal(np.ravel(arrays[0]), np.ravel(x)) for x in arrays)


def _sort(name: str, value: Value, contents: _NamedArrays, units: Sequence[str] = ()) -> None:
    """Add a variable, or the fields of a structure, to the arrays or to the refused names."""
    value = _only(value)
    if isinstance(value, dict) or _are_channels(value):
        fields = _fields(value, contents) if isinstance(value, dict) else _channels(value, "")
        for key, inner, units_of in fields:
            _sort(f"{name}.{key}".rstrip("."), inner, contents, units_of)
    elif isinstance(value, list):
        are = isinstance(value, StructureArray)
        kind = (
            f"an array of {plural(len(value), 'structure')}"
            if are
            else f"a cell of {plural(len(value), 'value')}"
        )
        contents.refused[name] = f"is {kind}; save one of them"
    elif isinstance(value, str):
        contents.refused[name] = NO_NUMBERS
    elif isinstance(value, Unread):
        contents.refused[name] = value.why
    else:
        contents.arrays[name], contents.units[name] = value, units


def _only(value: Value) -> Value:
    """Return the only value of a cell array, such as a single experiment."""
    while isinstance(value, list) and len(value) == 1:
        value = value[0]
    return value


def _texts(value: Value) -> list[str]:
    """Return the texts of a cell array, or one text; "" for other values."""
    return [x if isinstance(x, str) else "" for x in _as_list(_only(value))]


def _as_list(value: Value) -> list[Value]:
    return value if isinstance(value, list) else [value]


def _fields(
    structure: dict[str, Value], contents: _NamedArrays
) -> Iterator[tuple[str, Value, Any]]:
    """Iterate over the names, values and units of the columns of a structure."""
    times, signals, X, Y = map(structure.get, ("time", "signals", "X", "Y"))
    if times is not None and _are_channels(_as_list(signals), named=False):
        yield "time", times, ()
        yield from _channels(signals, "signals", "time")
    elif _are_channels(_as_list(X), named=False) and _are_channels(_as_list(Y), named=False):
        yield from _capture(_as_list(X), _as_list(Y))
    else:
        fields = _in_seconds(structure, contents.notes)
        if "OutputData" in fields:  # the other fields of an iddata are facts
            names = (name for name in (*_NAME_OF_FIELD, "Ts") if np.size(fields.get(name, ())))
            fields = {name: fields[name] for name in names}
        for name, value in fields.items():
            units = structure.get(_UNIT_OF_FIELD.get(name, ""))
            yield _NAME_OF_FIELD.get(name, name), value, _texts(units)


def _are_channels(values: Value, *, named: bool = True) -> bool:
    """Return whether all values are structures with values and, if `named`, a name."""
    return isinstance(values, list) and all(
        isinstance(x, dict) and _first(x, _VALUES) is not None and (not named or _first(x, _LABELS))
        for x in values
    )


def _first(structure: dict[str, Value], names: Sequence[str]) -> Value:
    return next((structure[name] for name in names if name in structure), None)


def _channels(values: Value, field: str, *taken: str) -> Iterator[tuple[str, Value, Any]]:
    """Iterate over the names, values and units of the channels in a field."""
    names = list(taken)
    for k, channel in enumerate(channels := _as_list(values), 1):
        label = _first(channel, _LABELS)
        name = label.strip(" <>") if isinstance(label, str) else ""  # Simulink inherits <label>
        if not name or name in names:
            name = f"{field}:{k}" if len(channels) > 1 else ""
        names.append(name)
        x = _first(channel, _VALUES)
        if getattr(x, "ndim", 0) == 3:  # a matrix at each time
            x = x.reshape(-1, x.shape[2], order="F")
        yield name, x, _texts(_first(channel, _UNITS))


def _capture(X: list[Value], Y: list[Value]) -> Iterator[tuple[str, Value, Any]]:
    """Iterate over the time and the channels of a capture; refuse channels on another clock."""
    rasters = [int(np.ravel(channel.get("XIndex", 1))[0]) for channel in Y]
    usual = Counter(rasters).most_common(1)[0][0]
    clock = X[usual - 1]
    times = _first(clock, _VALUES)
    yield "time", times, _texts(_first(clock, _UNITS) or "s")
    for raster, (name, values, units) in zip(rasters, _channels(Y, "Y", "time"), strict=True):
        if not _are_equal([times, _first(X[raster - 1], _VALUES)]):
            values = Unread(
                f"has the times X({raster}).Data, and most channels have X({usual}).Data; record "
                "both in the same raster"
            )
        yield name, values, units


def _in_seconds(structure: dict[str, Value], notes: list[str]) -> dict[str, Value]:
    """Return the fields of an iddata with its Ts and its times in s."""
    clock = {x: _only(structure[x]) for x in ("Ts", "SamplingInstants") if x in structure}
    unit = _only(structure.get("TimeUnit"))
    if "foh" in _texts(structure.get("InterSample")):
        notes.append(Step("InterSample is foh, but u is read as held over Ts (zoh)", DOUBT))
    if not (clock and isinstance(unit, str)):
        return structure
    unit = unit.casefold()
    ticks, seconds = _TICKS_PER_SECOND.get(unit, 1), _SECONDS.get(unit, 1)
    if unit not in (*_TICKS_PER_SECOND, *_SECONDS):
        raise FileError(
            f"TimeUnit is '{shorten(unit)}', allowed are nanoseconds to years; in MATLAB, set "
            "TimeUnit and Ts of the data to seconds, and save them again"
        )
    for name, value in clock.items():
        if isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and value.size:
            clock[name] = value.astype(np.float64) * seconds / ticks
            if ticks != seconds:
                subject = f"Ts = {value.item():g}" if value.size == 1 else "times in"
                notes.append(f"{subject} {unit}, by TimeUnit")
    return structure | clock


def read_npz(data: bytes) -> Table:
    """Return the columns of an .npz; pickled objects are not loaded."""
    contents = _NamedArrays()
    with np.load(BytesIO(data), allow_pickle=False) as archive:
        members = [m for m in archive.zip.infolist() if m.filename.endswith(".npy")]
        require_room(sum(member.file_size for member in members), len(data))
        for member in members:
            name = member.filename.removesuffix(".npy")
            try:
                contents.arrays[name] = archive[member.filename]
            except ValueError as err:
                if "allow_pickle" not in str(err):
                    raise
                contents.refused[name] = _PICKLED
    if not (contents.arrays or contents.refused):
        raise FileError(
            "is a ZIP archive without arrays, such as an Excel workbook; save its sheet as CSV"
        )
    return contents.table(len(data))


def read_parquet(data: bytes) -> Table:
    """Return the columns of a Parquet file; time stamps are in s from the first time."""
    file = load_extra("pyarrow.parquet", "parquet").ParquetFile(BytesIO(data))
    kinds = {field.name: str(field.type) for field in file.schema_arrow}
    if len(kinds) < len(file.schema_arrow):
        raise FileError("two of its columns have the same name; rename one of them")
    # Texts are not read: in a small file, a text may be repeated a million times.
    names = [name for name, kind in kinds.items() if kind.startswith((*_NUMBERS, *_TIMES))]
    require_room(8 * file.metadata.num_rows * len(names), len(data))
    return Table(
        columns=[
            Column(name=name, unit="s") if kinds[name].startswith(_TIMES) else column_of(name)
            for name in names
        ],
        values=[_numbers(column) for column in file.read(columns=names).columns],
        refused=dict.fromkeys(kinds.keys() - names, NO_NUMBERS),
    )


def _numbers(column: Any) -> Vector:
    """Return the values of a column of Parquet; NaN where a value is missing."""
    kind = str(column.type)
    if kind.startswith(_TIMES):
        return _seconds(column.to_numpy())
    column = column.cast("int8") if kind == "bool" else column
    numbers: Vector = column.cast("float64", safe=False).to_numpy()
    return numbers
