"""Export of a recording to CSV, MATLAB, Parquet, pandas and xarray, always with the same columns.

Each sample that was due has a row. If the sample is missing, or shows no angle, the angle is NaN.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np
from armrig_core.process.imports import load_extra
from numpy.typing import NDArray

from armrig.data.files.imported_file import ImportedData
from armrig.recordings.recording import Recording, export_columns, export_metadata

_BLOCK_ROWS = 65_536  # rows of a CSV file that are converted to text in one step


def write_csv(recording: Recording, path: Path, *, raw: bool = False) -> None:
    """Write the columns as CSV, with their names in the first line; a missing value is nan.

    Numbers are written with all their digits. `armrig identify` reads the file.
    """
    _write_csv(export_columns(recording, raw=raw), path)


def _write_csv(table: dict[str, NDArray[Any]], path: Path) -> None:
    columns = [c.astype(np.uint8) if c.dtype == np.bool_ else c for c in table.values()]
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(table)
        for begin in range(0, columns[0].size, _BLOCK_ROWS):
            some = [map(repr, c[begin : begin + _BLOCK_ROWS].tolist()) for c in columns]
            file.writelines(",".join(row) + "\n" for row in zip(*some, strict=True))


def write_mat(
    recording: Recording,
    path: Path,
    *,
    output: str | None = None,
    raw: bool = False,
) -> None:
    """Write a MAT-file of version 5 that contains u, y and Ts for iddata, and all columns.

    Use it in MATLAB with `load run.mat; z = iddata(y, u, Ts);`. Each column is (N, 1). y is the
    output, by default the first channel, with NaN for an unknown value. `sha256` is the hash of the
    recording.
    """
    from scipy.io import savemat

    table = export_columns(recording, raw=raw)
    output = recording.first if output is None else output
    recording.channel(output)  # an unknown name is refused
    # Octave and MATLAB compute with doubles and logical values only.
    kinds = {name: np.bool_ if c.dtype == np.bool_ else np.float64 for name, c in table.items()}
    variables: dict[str, Any] = {name: column.astype(kinds[name]) for name, column in table.items()}
    variables |= {"u": variables[recording.description.input.name], "y": variables[output]}
    variables["Ts"] = recording.Ts
    about = {"sha256": recording.sha256, "output": output, "run_id": recording.manifest.run_id}
    with path.open("wb") as file:
        savemat(file, {**variables, **about}, oned_as="column", do_compression=True)


def write_imported_columns(data: ImportedData, path: Path) -> None:
    """Write imported columns as CSV, MAT-file or Parquet, by the suffix of `path`.

    The first column, t, is the time in s. Each instant has a row; a missing value is NaN. The names
    of the variables of a MAT-file contain letters, digits and underscores only.
    """
    columns = data.on_grid()
    match path.suffix.lower():
        case ".csv":
            _write_csv(columns, path)
        case ".mat":
            from scipy.io import savemat

            names = [
                re.sub(r"\W", "_", f"x{c}" if c[:1].isdigit() else c, flags=re.A) for c in columns
            ]
            variables = dict(zip(names, columns.values(), strict=True)) | {"Ts": data.Ts}
            with path.open("wb") as file:
                savemat(
                    file,
                    variables,
                    oned_as="column",
                    do_compression=True,
                    long_field_names=True,
                )
        case _:
            units = {f"unit_{c.name}": c.unit for c in data.facts.columns}
            _write_parquet(columns, {"Ts": repr(data.Ts), "unit_t": "s"} | units, path)


def write_parquet(recording: Recording, path: Path, *, raw: bool = False) -> None:
    """Write the columns as a Parquet file, with units, Ts, hash and run in its metadata.

    Raises ImportError if pyarrow is not installed.
    """
    _write_parquet(export_columns(recording, raw=raw), export_metadata(recording), path)


def _write_parquet(columns: dict[str, NDArray[Any]], about: dict[str, str], path: Path) -> None:
    pyarrow = load_extra("pyarrow", "parquet")
    parquet = load_extra("pyarrow.parquet", "parquet")
    table = pyarrow.table(columns)
    parquet.write_table(table.replace_schema_metadata(about), str(path))
