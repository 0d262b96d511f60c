"""The variables of a MAT-file: vectors and matrices, structures of them, and old iddata objects."""

from __future__ import annotations

import struct
import warnings
import zlib
from io import BytesIO
from typing import Any

import numpy as np

from armrig.data.files.arrays import MOST_BYTES, ArrayTable, table_of
from armrig.data.files.table import DataFileError

_HEADER = 128  # B before the first element of version 5
_MATRIX, _COMPRESSED = 14, 15
_MOST_MATRICES = 1000  # scipy's reader calls itself for each one inside another
_FIELDS = {"OutputData": "y", "InputData": "u"}  # those of iddata, by our names
_AGAIN = "save it in MATLAB as save('data.mat', 'u', 'y', 'Ts', '-v7')"
_OPAQUE = (
    "is an object that only MATLAB reads; there u = data.u; y = data.y; Ts = data.Ts; "
    "save('data.mat', 'u', 'y', 'Ts', '-v7')"
)


def read(data: bytes) -> ArrayTable:
    """Return the columns of a MAT-file of version 4 to 7.

    Raises
    ------
    DataFileError
        It is damaged, too large once unpacked, or holds too many arrays.
    """
    from scipy.io import loadmat

    try:
        plain = _unpacked(data) if data[126:128] in (b"IM", b"MI") else data
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            variables = loadmat(BytesIO(plain))
    except DataFileError:
        raise
    except Exception as err:  # whatever a damaged file makes of its reader
        msg = f"is a damaged MAT-file: {type(err).__name__}; {_AGAIN}"
        raise DataFileError(msg) from err
    arrays: dict[str, Any] = {}
    refused: dict[str, str] = {}
    for name, value in variables.items():
        if not str(name).startswith("__"):
            _sort(str(name), value, arrays, refused)
    return table_of(arrays, refused)


def _sort(name: str, value: Any, arrays: dict[str, Any], refused: dict[str, str]) -> None:
    """Put a variable, or the fields of a structure, where they belong."""
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    if isinstance(value, (MatlabOpaque, MatlabFunction)):
        refused[name] = _OPAQUE
    elif not isinstance(value, np.ndarray):
        refused[name] = "is sparse; save full(…) of it"
    elif value.dtype.names is None:
        arrays[name] = value
    elif value.size != 1:
        refused[name] = f"is an array of {value.size} structures; save one of them"
    else:
        fields = value.reshape(-1)[0]
        for field in value.dtype.names:
            inner = fields[field]
            while isinstance(inner, np.ndarray) and inner.dtype.hasobject and inner.size == 1:
                inner = inner.reshape(-1)[0]  # a cell of one experiment
            if isinstance(inner, np.ndarray) and inner.dtype.names is None:
                arrays[f"{name}.{_FIELDS.get(field, field)}"] = inner


def _unpacked(data: bytes) -> bytes:
    """Return a file of version 5 without compression; refuse what would overwhelm its reader."""
    order = "<" if data[126:128] == b"IM" else ">"
    parts, at, size = [data[:_HEADER]], _HEADER, _HEADER
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        if kind == _COMPRESSED:
            unpacking = zlib.decompressobj()
            part = unpacking.decompress(data[at + 8 : at + 8 + length], max(MOST_BYTES - size, 1))
            if unpacking.unconsumed_tail:
                msg = f"unpacked it has more than {MOST_BYTES >> 20} MiB; {_AGAIN}"
                raise DataFileError(msg)
        else:
            part = data[at : at + 8 + length]
        parts.append(part)
        size += len(part)
        at += 8 + length
    plain = b"".join(parts)
    _count_matrices(plain, order)
    return plain


def _count_matrices(data: bytes, order: str) -> None:
    """Refuse more arrays than scipy's reader may find inside each other.

    It goes from one element to the next and into each matrix, whatever length that one claims, so
    this does the same.
    """
    at, matrices = _HEADER, 0
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        at += 8
        if kind == _MATRIX:
            matrices += 1
        elif kind <= 0xFFFF:  # others have kind and length in 4 B, and their values in 4 more
            at += -(-length // 8) * 8
        if matrices > _MOST_MATRICES:
            msg = f"holds more than {_MOST_MATRICES} arrays, one inside another; {_AGAIN}"
            raise DataFileError(msg)
