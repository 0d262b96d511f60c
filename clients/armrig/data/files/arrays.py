"""Arrays with names, as MATLAB and numpy save them, to columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from math import prod
from typing import IO, Any
from zipfile import ZipFile

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.mat_variables import DamageError, TooLongError, Unread, variables
from armrig.data.files.table import Column, Vector

MOST_BYTES = 1 << 28
"""Most that a packed file may hold unpacked, in B, each number taken for one of 8 B."""
_ALWAYS = 1 << 26
_LARGEST_RATIO = 100  # what was measured packs 5 to 20 times, a thousand times only what is all 0


def most_unpacked(packed: int) -> int:
    """Return how much a file of `packed` B may hold unpacked, in B: a small one holds little."""
    return min(MOST_BYTES, max(_ALWAYS, _LARGEST_RATIO * packed))


@dataclass(frozen=True, slots=True, kw_only=True)
class ArrayTable:
    """Columns that are numbers already."""

    columns: tuple[Column, ...]
    """Names, `X:1`, `X:2` … for those of a matrix X."""
    values: Sequence[Any]
    """One array a column, (N,), of any real type."""
    refused: Mapping[str, str]
    """What else the file holds, by name, and why it is no column of numbers."""
    Ts: float | None
    """Sampling time in s, of a number named Ts."""

    @property
    def notes(self) -> Sequence[str]:
        """Return nothing: all that there is holds values, or is refused."""
        return ()

    def numbers(self, i: int) -> Vector:
        """Return the values of column i, from 0; NaN where one is missing."""
        with np.errstate(invalid="ignore"):  # NaN of another kind than ours is NaN, too
            return np.array(self.values[i], dtype=np.float64)

    def place(self, k: int) -> str:
        """Return the number from 1 of instant k."""
        return f"row {k + 1}"


def table_of(arrays: Mapping[str, Any], refused: Mapping[str, str]) -> ArrayTable:
    """Return the columns of arrays; the longer side of a matrix is that of time.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Vectors, matrices, and numbers, of which that named Ts is the sampling time in s.
    refused : mapping of str to str
        What could not be read as an array, and why.
    """
    columns: list[Column] = []
    values: list[Any] = []
    others = dict(refused)
    Ts = None
    for name, array in arrays.items():
        if why := _no_columns(array):
            others[name] = why
            continue
        if array.size == 1:
            if name.rpartition(".")[2].casefold() == "ts":
                Ts = float(array.reshape(-1)[0])
            continue
        found = _columns(array)
        numbered = [name] if len(found) == 1 else [f"{name}:{i + 1}" for i in range(len(found))]
        columns += [Column(name=each) for each in numbered]
        values += found
    return ArrayTable(columns=tuple(columns), values=values, refused=others, Ts=Ts)


def _columns(array: Any) -> list[Any]:
    if array.ndim == 1:
        return [array]
    rows = array.T if array.shape[0] >= array.shape[1] else array
    return list(rows)


def _no_columns(array: Any) -> str:
    """Return why an array has no columns of real numbers; "" where it has."""
    if array.dtype.kind == "c":
        return "is complex; save its real part, if that is what was measured"
    if array.dtype.kind not in "buif":
        return "holds no numbers; save it as a vector of real numbers"
    if array.size == 0:
        return "is empty; save it with a value for each sample"
    if array.ndim > 2 or (array.ndim == 0 and array.size != 1):
        return f"has {array.ndim} dimensions; save it as a vector, or a matrix of columns"
    return ""


# The columns of a MAT-file: vectors and matrices, structures of them, and old iddata objects.


_FIELDS = {"OutputData": "y", "InputData": "u"}  # those of iddata, by our names
_AGAIN = "save it in MATLAB as save('data.mat', 'u', 'y', 'Ts', '-v7')"


def read_mat(data: bytes) -> ArrayTable:
    """Return the columns of a MAT-file of version 4 to 7.

    Raises
    ------
    FileError
        It is damaged, or too large once unpacked.
    """
    arrays: dict[str, Any] = {}
    refused: dict[str, str] = {}
    most = most_unpacked(len(data))
    try:
        for name, value in variables(data, most):
            _sort(name, value, arrays, refused)
    except DamageError as err:
        raise FileError(f"is a damaged MAT-file ({err}); {_AGAIN}") from err
    except TooLongError as err:
        raise FileError(f"unpacked it has more than {most >> 20} MiB; {_AGAIN}") from err
    return table_of(arrays, refused)


def _sort(name: str, value: Any, arrays: dict[str, Any], refused: dict[str, str]) -> None:
    """Put a variable, or the fields of a structure, where they belong."""
    while isinstance(value, list) and len(value) == 1:
        value = value[0]  # a cell of one experiment
    if isinstance(value, dict):
        for field, inner in value.items():
            _sort(f"{name}.{_FIELDS.get(field, field)}", inner, arrays, refused)
    elif isinstance(value, list):
        refused[name] = f"is a cell of {len(value)} values; save one of them"
    elif isinstance(value, Unread):
        refused[name] = value.why
    else:
        arrays[name] = value


# The arrays of a file that numpy.savez has written.


_PICKLED = "holds Python objects, which are programs and never loaded; save numbers instead"


def read_npz(data: bytes) -> ArrayTable:
    """Return the columns of an .npz; nothing that is pickled is loaded.

    Raises
    ------
    FileError
        It is a ZIP archive of other things, is damaged, or is too large once unpacked.
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
    except Exception as err:  # whatever a damaged archive makes of its reader
        raise FileError(
            f"is a damaged .npz: {type(err).__name__}; save it again with numpy.savez"
        ) from err
    if not (arrays or refused):
        raise FileError(
            "is a ZIP archive without arrays, such as an Excel workbook; save its sheet as CSV"
        )
    return table_of(arrays, refused)


def _size(archive: ZipFile, member: str) -> int:
    """Return what an array takes once its numbers have 8 B each, by its head."""
    with archive.open(member) as file:
        is_first = np.lib.format.read_magic(file) == (1, 0)
        # The third version has the form of the second, and names in UTF-8.
        head = (
            np.lib.format.read_array_header_1_0 if is_first else np.lib.format.read_array_header_2_0
        )
        shape, _, kind = head(file)
    return prod(shape) * max(8, kind.itemsize)


def _array(file: IO[bytes]) -> Any:
    """Return the array of an .npy; None where it would have to be unpickled."""
    try:
        return np.lib.format.read_array(file, allow_pickle=False)
    except ValueError as err:
        if "allow_pickle" in str(err):
            return None
        raise
