"""Columns of numbers from the named arrays of MAT-files and .npz files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from math import prod
from typing import IO, Any
from zipfile import ZipFile

import numpy as np
from armrig_core.errors import FileError, InputError

from armrig.data.files.mat_variables import (
    EMPTY,
    DamageError,
    StructureArray,
    TooLongError,
    Unread,
    variables,
)
from armrig.data.files.table import Column, Vector

MOST_BYTES = 1 << 28
"""Largest unpacked size of a file, in B; in an .npz, a number counts as at least 8 B."""
NO_NUMBERS = "contains no numbers; save it as a vector of real numbers"
"""Reason why a variable is not a column, and the remedy."""
_MIN_LIMIT_BYTES = 1 << 26
_MAX_RATIO = 100  # packing shrinks measured data by a factor of 5 to 20, zeros by 1000


def most_unpacked(packed: int) -> int:
    """Return the largest allowed unpacked size, in B, of a file of `packed` B."""
    return min(MOST_BYTES, max(_MIN_LIMIT_BYTES, _MAX_RATIO * packed))


@dataclass(frozen=True, slots=True, kw_only=True)
class ArrayTable:
    """Columns whose values are already numbers."""

    columns: tuple[Column, ...]
    """Names of the columns; the columns of a matrix X are named `X:1`, `X:2` …"""
    values: Sequence[Any]
    """An array (N,) of any real type for each column."""
    refused: Mapping[str, str]
    """Reason why a variable is not a column of numbers, by the name of the variable."""
    Ts: float | None
    """Sampling time in s, from a number named Ts."""
    notes: Sequence[str] = ()
    """Notes on how the columns were read."""

    def numbers(self, i: int) -> Vector:
        """Return the values of column i, counted from 0; NaN where a value is missing."""
        with np.errstate(invalid="ignore"):  # a signalling NaN is NaN, too
            return np.array(self.values[i], dtype=np.float64)

    def texts(self, i: int) -> None:
        """Return None: the columns are numbers."""

    def place(self, k: int) -> str:
        """Return the row of instant k as text; rows count from 1."""
        return f"row {k + 1}"


def table_of(arrays: Mapping[str, Any], refused: Mapping[str, str]) -> ArrayTable:
    """Return the columns of arrays as a table; time runs along the longer side of a matrix.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Vectors, matrices and numbers; the number named Ts is the sampling time in s.
    refused : mapping of str to str
        Reason why each unread variable is not an array, by the name of the variable.
    """
    columns: list[Column] = []
    values: list[Any] = []
    others = dict(refused)
    Ts = None
    for name, array in arrays.items():
        try:
            found = _columns(array)
        except InputError as err:
            others[name] = str(err)
            continue
        if array.size == 1:
            if name.rpartition(".")[2].casefold() == "ts":
                Ts = float(array.reshape(-1)[0])
            continue
        numbered = [name] if len(found) == 1 else [f"{name}:{i + 1}" for i in range(len(found))]
        columns += [Column(name=each) for each in numbered]
        values += found
    return ArrayTable(columns=tuple(columns), values=values, refused=others, Ts=Ts)


def _columns(array: Any) -> list[Any]:
    """Return the columns of an array of real numbers; refuse any other array with the reason."""
    if array.dtype.kind == "c":
        raise InputError("is complex; save its real part if only that part was measured")
    if array.dtype.kind not in "buif":
        raise InputError(NO_NUMBERS)
    if array.size == 0:
        raise InputError(EMPTY)
    if array.ndim > 2:
        raise InputError(
            f"has {array.ndim} dimensions; save it as a vector, or a matrix of columns"
        )
    if array.ndim < 2:
        return [array]
    rows = array.T if array.shape[0] >= array.shape[1] else array
    return list(rows)


# The columns of a MAT-file: vectors, matrices, structures with these, structures with time of
# Simulink, and old iddata objects.


_NAME_OF_FIELD = {"OutputData": "y", "InputData": "u"}  # fields of iddata
_SAVE_IN_MATLAB = "save it in MATLAB as save('data.mat', 'u', 'y', 'Ts', '-v7')"


def read_mat(data: bytes) -> ArrayTable:
    """Return the columns of a MAT-file of version 4 to 7.

    Raises
    ------
    FileError
        The file is damaged, or its unpacked size is too large.
    """
    arrays: dict[str, Any] = {}
    refused: dict[str, str] = {}
    most = most_unpacked(len(data))
    try:
        for name, value in variables(data, most):
            _sort(name, value, arrays, refused)
    except DamageError as err:
        raise FileError(f"is a damaged MAT-file ({err}); {_SAVE_IN_MATLAB}") from err
    except TooLongError as err:
        raise FileError(f"unpacked it has more than {most >> 20} MiB; {_SAVE_IN_MATLAB}") from err
    _add_common_time(arrays)
    return table_of(arrays, refused)


def _add_common_time(arrays: dict[str, Any]) -> None:
    """Add the array `time` if no array has this name, and all fields `time` are equal."""
    every = [np.ravel(x) for name, x in arrays.items() if name.endswith(".time")]
    is_same = every and all(np.array_equal(every[0], x) for x in every)
    if is_same and not any(name.casefold() in ("t", "time") for name in arrays):
        arrays["time"] = every[0]


def _sort(name: str, value: Any, arrays: dict[str, Any], refused: dict[str, str]) -> None:
    """Add a variable, or the fields of a structure, to the arrays or to the refused names."""
    while isinstance(value, list) and len(value) == 1:
        value = value[0]  # a cell array that contains one experiment
    if isinstance(value, dict) and {"time", "signals"} <= value.keys():
        value = _logged(value)
    if isinstance(value, dict):
        for field, inner in value.items():
            path = f"{name}.{_NAME_OF_FIELD.get(field, field)}".rstrip(".")
            _sort(path, inner, arrays, refused)
    elif isinstance(value, list):
        what = "an array" if isinstance(value, StructureArray) else "a cell"
        of = "structures" if isinstance(value, StructureArray) else "values"
        refused[name] = f"is {what} of {len(value)} {of}; save one of them"
    elif isinstance(value, str):
        refused[name] = NO_NUMBERS
    elif isinstance(value, Unread):
        refused[name] = value.why
    else:
        arrays[name] = value


def _logged(structure: dict[str, Any]) -> dict[str, Any]:
    """Return the times and the signals of a Simulink structure with time, by their labels.

    A signal without a label of its own is named `signals:2`. If it is the only signal, it has the
    name of the structure.
    """
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


# The arrays of a file of numpy.savez.


_PICKLED = "contains pickled Python objects, which can run code and are not loaded; save numbers"


def read_npz(data: bytes) -> ArrayTable:
    """Return the columns of an .npz; pickled objects are not loaded.

    Raises
    ------
    FileError
        The file is a ZIP archive without arrays, it is damaged, or its unpacked size is too large.
    """
    arrays: dict[str, Any] = {}
    refused: dict[str, str] = {}
    try:
        with ZipFile(BytesIO(data)) as archive:
            members = [m.filename for m in archive.infolist() if m.filename.endswith(".npy")]
            most = most_unpacked(len(data))
            if sum(_size(archive, member) for member in members) > most:
                msg = f"unpacked it has more than {most >> 20} MiB; save only input and "
                raise FileError(msg + "output")
            for member in members:
                with archive.open(member) as file:
                    array = _array(file)
                name = member.removesuffix(".npy")
                if array is None:
                    refused[name] = _PICKLED
                else:
                    arrays[name] = array
    except FileError:
        raise
    except Exception as err:  # a damaged archive can raise any exception in its reader
        raise FileError(
            f"is a damaged .npz: {type(err).__name__}; save it again with numpy.savez"
        ) from err
    if not (arrays or refused):
        raise FileError(
            "is a ZIP archive without arrays, such as an Excel workbook; save its sheet as CSV"
        )
    return table_of(arrays, refused)


def _size(archive: ZipFile, member: str) -> int:
    """Return the size of an array in B, from its header; each number is counted as at least 8 B."""
    with archive.open(member) as file:
        is_first = np.lib.format.read_magic(file) == (1, 0)
        # Version 3 has the form of version 2, with names in UTF-8.
        head = (
            np.lib.format.read_array_header_1_0 if is_first else np.lib.format.read_array_header_2_0
        )
        shape, _, kind = head(file)
    return prod(shape) * max(8, kind.itemsize)


def _array(file: IO[bytes]) -> Any:
    """Return the array of an .npy; None if it is pickled."""
    try:
        return np.lib.format.read_array(file, allow_pickle=False)
    except ValueError as err:
        if "allow_pickle" in str(err):
            return None
        raise
