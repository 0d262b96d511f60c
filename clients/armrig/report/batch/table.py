"""The table of a batch as a Parquet file, and what it says of how it was made."""

from __future__ import annotations

import os
import platform
from collections.abc import Collection, Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
from armrig_core.errors import OperationError

from armrig.recordings.export import imported
from armrig.recordings.recording_summary import shown_path
from armrig.report.batch.columns import Kind, columns_of
from armrig.report.batch.progress import OTHER, SUFFIX
from armrig.report.batch.rows import Row
from armrig.report.batch.tasks import Task, Validate, digest, name_of, sha256

KEY = b"armrig.batch"
"""Of the table's metadata, where its header stands."""


def header_of(
    task: Task, folder: Path, rigs: Collection[str], kinds: Collection[str]
) -> dict[str, str]:
    """Return what a table says of itself: nothing in it changes from one start to the next.

    Parameters
    ----------
    rigs, kinds : collection of str
        As for `batch`.
    """
    options = msgspec.to_builtins(task)
    if isinstance(task, Validate):
        options["model"] = f"sha256 {sha256(task.model)}"
    return {
        "task": name_of(task),
        "options": msgspec.json.encode(options).decode(),
        "digest": digest(task),
        "folder": shown_path(folder.resolve()),
        "rigs": " ".join(sorted(rigs)),
        "kinds": " ".join(sorted(kinds)),
        "armrig": version("armrig"),
        "numpy": version("numpy"),
        "scipy": version("scipy"),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
    }


def check_writable() -> None:
    """Refuse, before any work, where Parquet cannot be written.

    Raises
    ------
    ImportError
        pyarrow is not installed.
    """
    imported("pyarrow.parquet", "parquet")


def read_rows(path: Path, header: dict[str, str]) -> list[Row]:
    """Return the rows of an earlier table with this header; none where there is no table.

    Raises
    ------
    OperationError
        What is there is no table, or one with another header.
    """
    if not path.exists():
        return []
    pyarrow, parquet = imported("pyarrow", "parquet"), imported("pyarrow.parquet", "parquet")
    try:
        with path.open("rb") as file:  # for pyarrow a name must be UTF-8
            table = parquet.read_table(file)
        found = msgspec.json.decode((table.schema.metadata or {})[KEY], type=dict[str, str])
    except (pyarrow.ArrowException, KeyError, msgspec.DecodeError, OSError) as err:
        raise OperationError(
            f"{path} is there and is no table of armrig batch; give another -o"
        ) from err
    if found != header:
        raise OperationError(f"{path} {OTHER}")
    rows: list[Row] = table.to_pylist()
    return rows


def write_table(path: Path, task: Task, header: dict[str, str], rows: Iterable[Row]) -> None:
    """Write the table, in the order of the recordings' names, at once in place of one before.

    Raises
    ------
    OperationError
        The disk is full, or a row is not what it was when it was kept.
    """
    pyarrow, parquet = imported("pyarrow", "parquet"), imported("pyarrow.parquet", "parquet")
    ordered = sorted(rows, key=lambda row: str(row["recording"]))
    schema = pyarrow.schema(
        [(name, _type(pyarrow, kind)) for name, kind in columns_of(task).items()],
        metadata={KEY: msgspec.json.encode(header)},
    )
    made = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with made.open("wb") as file:
            parquet.write_table(pyarrow.Table.from_pylist(ordered, schema=schema), file)
        made.replace(path)
    except OSError as err:
        raise OperationError(
            f"{path}: {err.strerror or err}; all results are kept, and the same command writes it"
        ) from err
    except (pyarrow.ArrowException, TypeError) as err:
        raise OperationError(
            f"{path}{SUFFIX}: a row in it was changed by somebody; --force begins anew"
        ) from err
    finally:
        made.unlink(missing_ok=True)


def _type(pyarrow: Any, kind: Kind) -> Any:
    of_one = {
        "text": pyarrow.string(),
        "truth": pyarrow.bool_(),
        "count": pyarrow.int64(),
        "number": pyarrow.float64(),
    }
    return of_one[kind] if kind in of_one else pyarrow.list_(of_one[kind[:-1]])
