"""The columns of a MAT-file: vectors and matrices, structures of them, and old iddata objects."""

from __future__ import annotations

from typing import Any

from armrig_core.errors import FileError

from armrig.data.files.arrays import ArrayTable, most_unpacked, table_of
from armrig.data.files.mat_variables import DamageError, TooLongError, Unread, variables

_FIELDS = {"OutputData": "y", "InputData": "u"}  # those of iddata, by our names
_AGAIN = "save it in MATLAB as save('data.mat', 'u', 'y', 'Ts', '-v7')"


def read(data: bytes) -> ArrayTable:
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
