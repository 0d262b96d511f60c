"""Variables of a MAT-file of version 4 to 7, read from its bytes.

scipy.io is not used, because a damaged or hostile file can crash its compiled reader, and thus the
whole program. Each array is a view of the file's bytes, so that a false size in the file allocates
no memory. The format is MathWorks' "MAT-File Format", R2019b.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np

from armrig.data.files.table import require_room, room
from armrig.numerics.quantities import plural

_HEADER_BYTES = 128  # before the first element of version 5
_MAX_DEPTH = 8  # of nested structures; iddata has three levels
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
_NUMBERS |= {12: "i8", 13: "u8"}
_CELL, _STRUCTURE, _OBJECT, _TEXT, _SPARSE = 1, 2, 3, 4, 5
_TWO_BYTE_CHARACTERS = (4, 17)  # types of a text's element: UTF-16; all others are UTF-8
_LAST_NUMBER = 15
_COMPLEX = 0x0800
_VERSION_4_NUMBERS = ("f8", "f4", "i4", "i2", "u2", "u1")
_MAX_NAME_BYTES = 4096
EMPTY = "is empty; save it with a value for each sample"
"""Reason why a variable without values is not a column, and the remedy."""
_OPAQUE = (
    "is an object that only MATLAB reads; in MATLAB: u = data.u; y = data.y; Ts = data.Ts; "
    "save('data.mat', 'u', 'y', 'Ts', '-v7')"
)

Elements = Iterator[tuple[int, memoryview]]
"""Kind and bytes of each element."""
Value = Any
"""An array, a text, a list (cell array), a dict with the fields of a structure, or `Unread`."""


class StructureArray(list[Value]):
    """Several structures with the same fields, each a dict."""


@dataclass(frozen=True, slots=True)
class Unread:
    """Reason why a variable is not an array of real numbers, and the remedy."""

    why: str


class MatDamageError(Exception):
    """The bytes of the file are not a valid MAT-file."""


def variables(data: bytes) -> Iterator[tuple[str, Value]]:
    """Iterate over the names and values of a MAT-file; a damaged element raises any exception."""
    unpacked = 0
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        yield from _old_variables(memoryview(data))
        return
    for kind, body in _elements(memoryview(data)[_HEADER_BYTES:], order, padded=False):
        if kind == _MATRIX:
            yield _matrix(body, order)
        elif kind == _COMPRESSED:
            plain = zlib.decompressobj().decompress(body, room(len(data)) + 1 - unpacked)
            unpacked += len(plain)
            require_room(unpacked, len(data))
            for inner, matrix in _elements(memoryview(plain), order):
                if inner == _MATRIX:
                    yield _matrix(matrix, order)


def _elements(data: memoryview, order: str, *, padded: bool = True) -> Elements:
    at = 0
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        at += 8
        if kind >> 16:  # a short element: length and kind share 4 B, and the next 4 B are its data
            kind, length, begin = kind & 0xFFFF, kind >> 16, at - 4
            if length > 4:
                raise MatDamageError("a short element of more than 4 B")
        else:
            begin = at
            at += -(-length // 8) * 8 if padded else length
        if begin + length > len(data):
            raise MatDamageError("it ends too early")
        yield kind, data[begin : begin + length]


def _matrix(body: memoryview, order: str, depth: int = 0) -> tuple[str, Value]:
    """Return the name and the value of an array of any MATLAB class."""
    parts = _elements(body, order)
    flags = _numbers(parts, order)
    if flags.size < 1 or depth > _MAX_DEPTH:
        raise MatDamageError("an array without a class, or nested too deeply")
    kind = int(flags[0]) & 0xFF
    if not 1 <= kind <= _LAST_NUMBER:
        return _name(parts), Unread(_OPAQUE)
    shape = tuple(_numbers(parts, order).tolist())
    if len(shape) > 32:  # the limit of numpy 1
        raise MatDamageError(f"an array of {len(shape)} dimensions; at most 32 are allowed")
    name = _name(parts)
    if kind == _CELL:
        return name, _inner(parts, order, depth)
    if kind in (_STRUCTURE, _OBJECT):
        if kind == _OBJECT:
            _name(parts)  # skips the name of the class
        return name, _structure(parts, shape, order, depth)
    if kind == _SPARSE:
        return name, Unread("is sparse; save full(…) of it")
    if kind == _TEXT:
        return name, _characters(parts, order)
    if int(flags[0]) & _COMPLEX:
        return name, Unread("is complex; save its real part if only that part was measured")
    return name, _reshape(_numbers(parts, order), shape)


def _structure(parts: Elements, shape: tuple[int, ...], order: str, depth: int) -> Value:
    width = _numbers(parts, order)
    _, names = _next(parts)
    if width.size != 1 or not 0 < int(width[0]) <= _MAX_NAME_BYTES:
        raise MatDamageError("a structure without names")
    size = int(width[0])
    fields = [_text(names[i : i + size]) for i in range(0, len(names), size)]
    values = _inner(parts, order, depth)
    every = range(0, len(values), len(fields) or 1)
    structures = StructureArray(dict(zip(fields, values[i:], strict=False)) for i in every)
    return dict(zip(fields, values, strict=False)) if prod(shape) == 1 else structures


def _characters(parts: Elements, order: str) -> str:
    kind, body = _next(parts)
    utf_16 = "utf-16-le" if order == "<" else "utf-16-be"
    encoding = utf_16 if kind in _TWO_BYTE_CHARACTERS else "utf-8"
    return bytes(body[:_MAX_NAME_BYTES]).decode(encoding, "replace")


def _inner(parts: Elements, order: str, depth: int) -> list[Value]:
    """Return the values of nested arrays; MATLAB writes a field never assigned as 0 B."""
    return [
        _matrix(body, order, depth + 1)[1] if len(body) else Unread(EMPTY)
        for kind, body in parts
        if kind == _MATRIX
    ]


def _numbers(parts: Elements, order: str) -> Any:
    """Return the next element as a vector; the element states its numeric type."""
    kind, body = _next(parts)
    if kind not in _NUMBERS or len(body) % int(_NUMBERS[kind][1]):
        raise MatDamageError(f"an element of kind {kind} instead of numbers")
    return np.frombuffer(body, dtype=order + _NUMBERS[kind])


def _next(parts: Elements) -> tuple[int, memoryview]:
    return next(parts, (0, memoryview(b"")))


def _name(parts: Elements) -> str:
    return _text(_next(parts)[1])


def _text(data: memoryview) -> str:
    return bytes(data).partition(b"\0")[0].decode("ascii", "replace")


def _reshape(values: Any, shape: tuple[int, ...]) -> Any:
    """Return values, stored column by column, as an array of the given shape."""
    if len(shape) < 2 or any(n < 0 for n in shape) or prod(shape) != values.size:
        raise MatDamageError(f"{plural(values.size, 'number')} in a shape of {shape}")
    # A shape with a 0 and numbers above 2^60 is not a shape of numpy.
    return values.reshape(shape if values.size else 0, order="F")


def _old_variables(data: memoryview) -> Iterator[tuple[str, Value]]:
    """Iterate over the variables of version 4; each has a header of 20 B, a name and numbers."""
    at = 0
    while at + 20 <= len(data):
        order = "<" if 0 <= struct.unpack_from("<i", data, at)[0] < 1000 else ">"
        kind, rows, columns, imaginary, length = struct.unpack_from(f"{order}5i", data, at)
        form, number, matrix_type = kind // 100, kind // 10 % 10, kind % 10
        is_valid = form in (0, 10) and number < len(_VERSION_4_NUMBERS) and matrix_type < 3
        if not is_valid or min(rows, columns) < 0 or not 0 < length <= _MAX_NAME_BYTES:
            raise MatDamageError("no header of version 4")
        at += 20 + length
        type_ = np.dtype(order + _VERSION_4_NUMBERS[number])
        size = rows * columns * type_.itemsize
        name, body = _text(data[at - length : at]), data[at : at + size]
        at += size * (2 if imaginary else 1)
        if at > len(data):
            raise MatDamageError("it ends too early")
        if matrix_type or imaginary:
            yield name, Unread("is not a full real matrix; save it as a full real matrix")
        else:
            yield name, _reshape(np.frombuffer(body, dtype=type_), (rows, columns))
    if at == 0:
        raise MatDamageError("it has no header")
