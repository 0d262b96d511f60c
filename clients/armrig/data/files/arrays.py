"""Arrays with names, as MATLAB and numpy save them, to columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

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
