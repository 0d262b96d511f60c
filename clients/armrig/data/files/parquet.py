"""Columns of numbers from a Parquet file."""

from __future__ import annotations

from io import BytesIO
from typing import Any

from armrig_core.errors import FileError

from armrig.data.files.arrays import MOST_BYTES, NO_NUMBERS, ArrayTable
from armrig.data.files.table import Column, Vector, titled
from armrig.data.optional_packages import MissingPackageError, imported

_NUMBERS = ("int", "uint", "float", "double", "halffloat", "decimal", "bool")
_TIMES = ("timestamp", "duration")
_PER_SECOND = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}


def read_parquet(data: bytes) -> ArrayTable:
    """Return the columns of a Parquet file; time stamps are in s from the first time.

    Raises
    ------
    FileError
        pyarrow is not installed, the file is damaged, or its unpacked size is too large.
    """
    try:
        parquet = imported("pyarrow.parquet", "parquet")
    except MissingPackageError as err:
        msg = "is Parquet: to read it, pip install 'armrig[parquet]', or save it as CSV"
        raise FileError(msg) from err
    try:
        file = parquet.ParquetFile(BytesIO(data))
        kinds = {field.name: str(field.type) for field in file.schema_arrow}
        is_double = len(kinds) < len(file.schema_arrow)
        # Texts are not read: in a small file, a text may be repeated a million times.
        names = [name for name, kind in kinds.items() if kind.startswith((*_NUMBERS, *_TIMES))]
        is_large = is_double or 8 * file.metadata.num_rows * len(names) > MOST_BYTES
        values = [] if is_large else [_values(x) for x in file.read(columns=names).columns]
    except Exception as err:  # a damaged file can raise any exception in its reader
        msg = f"is a damaged Parquet file ({type(err).__name__}); write it again"
        raise FileError(msg) from err
    if is_double:
        raise FileError("two of its columns have the same name; rename one of them")
    if is_large:
        raise FileError(f"unpacked it has more than {MOST_BYTES >> 20} MiB; cut it into files")
    columns = [
        Column(name=name, unit="s") if kinds[name].startswith(_TIMES) else titled(name)
        for name in names
    ]
    refused = dict.fromkeys(kinds.keys() - names, NO_NUMBERS)
    return ArrayTable(columns=tuple(columns), values=values, refused=refused, Ts=None)


def _values(column: Any) -> Vector:
    """Return the values of a column; NaN where a value is missing."""
    compute = imported("pyarrow.compute", "parquet")
    kind, per_second = str(column.type), 1
    if kind == "bool":
        column = column.cast("int8")
    elif kind.startswith(_TIMES):
        ticks, per_second = column.cast("int64"), _PER_SECOND[column.type.unit]
        column = compute.subtract(ticks, compute.min(ticks))  # exact
    values: Vector = column.cast("float64", safe=False).to_numpy()
    return values / per_second
