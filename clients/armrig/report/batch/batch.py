"""A task for all runs of a folder, and the table of its results.

Each computed row is stored at once, so that a later start continues the batch.
"""

from __future__ import annotations

import hashlib
import os
import platform
from collections import Counter, deque
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import AbstractContextManager, suppress
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar

import msgspec
from armrig_core.errors import ArmrigError, InputError, OperationError
from armrig_core.process.imports import load_extra
from armrig_core.recording_file.opening import lock
from threadpoolctl import threadpool_info

from armrig.recordings.files.recording_summary import path_text
from armrig.report.batch.tasks import (
    Item,
    Kind,
    Report,
    Row,
    Task,
    Validate,
    columns_of,
    empty_row,
    items_in,
    name_of,
    row_of,
)

Count = Callable[[int, int, str], None]
"""Callback with the numbers of items done since the start and to do, and the last item's name."""
MOST_DEATHS = 2
"""An item is abandoned if this number of workers have died while the item ran alone."""

T = TypeVar("T", bound=Hashable)
R = TypeVar("R")
Open = Callable[[], AbstractContextManager[Executor]]
OTHER = (
    "contains results of another folder, task or selection, or of other options, versions or "
    "processors; choose another -o, or use --force to begin again"
)
"""Message if the header of earlier results differs from the header of this start."""
SUFFIX = ".progress"
"""Suffix of the file with the rows so far; the file's name begins with the name of the table."""
KEY = b"armrig.batch"
"""Key of the header in the table's metadata."""
GONE = "the scheduler is gone; results so far are kept: type the same command again to continue"


def batch(
    folder: Path,
    task: Task,
    table: Path,
    *,
    open_executor: Callable[[], AbstractContextManager[Executor]],
    at_once: int,
    rigs: Collection[str] = (),
    kinds: Collection[str] = (),
    anew: bool = False,
    count: Count = lambda done, total, name: None,
) -> tuple[list[Row], int]:
    """Do a task for each run of a folder, and write the results as one table.

    Results of an earlier start are kept if their files have not changed. A new start therefore
    continues a batch that was killed, and adds new recordings to a complete table. Returns the
    rows, one for each run, sorted by the run's name, and the number of rows that were kept.

    Parameters
    ----------
    open_executor : callable
        Function that opens an executor, as a context manager; see `armrig.report.batch.workers`.
    at_once : int
        Largest number of runs that the executor processes at the same time.
    rigs, kinds : collection of str
        Rigs and kinds of experiment to which the batch is limited; empty for all.
    anew : bool
        Discard earlier results; the old table stays until the new table is complete.

    Raises
    ------
    OperationError, ImportError, OSError
        The existing table belongs to another task; the disk is full; all workers are lost; pyarrow
        is not installed; or a file cannot be read or written.
    """
    load_extra("pyarrow.parquet", "parquet")  # a missing package is reported before the work
    items = items_in(folder, rigs=rigs, kinds=kinds)
    if not items:
        raise InputError(
            f"{folder}: no recording is of the chosen rigs and kinds; `armrig ls {folder}` lists "
            "all recordings"
        )
    header = header_of(task, folder, rigs, kinds)
    before = [] if anew else read_rows(table, header)
    with Progress(table, header, anew=anew) as progress:
        rows = still_right([*before, *progress.rows], items, columns_of(task))
        if isinstance(task, Report):  # a row whose PDF is missing is computed again
            rows = {
                name: r for name, r in rows.items() if Path(task.folder, str(r["report"])).exists()
            }
        left, done_before = [item for item in items if item.name not in rows], len(rows)
        function = partial(_row_in, task, environment())
        arrivals = results(function, left, open_executor, at_once=at_once)
        for item, row in arrivals:
            if isinstance(row, Exception):
                row = empty_row(task, item, problem=" ".join(str(row).split()))
            rows[item.name] = row
            progress.add(rows[item.name])
            count(len(rows) - done_before, len(left), item.name)
        write_table(table, task, header, rows.values())
        progress.path.unlink()
    return [rows[item.name] for item in items], done_before


def results(
    function: Callable[[T], R], items: Sequence[T], open_executor: Open, *, at_once: int
) -> Iterator[tuple[T, R | Exception]]:
    """Yield each item with its result, in the order in which the results arrive.

    No two items are equal. An ArmrigError of the function, and work that the executor cancels, end
    the batch. The result is an exception if the item was abandoned. If a worker dies, a new
    executor is opened. The executor does not report which item killed the worker. Therefore all
    items that ran when the worker died are repeated, one at a time. If the executor replaces its
    workers itself, only an item that it gave up is repeated.
    """
    waiting, alone, deaths = deque(items), deque[T](), Counter[T]()
    while waiting or alone:
        running: dict[Future[R], T] = {}
        done = SimpleQueue[Future[R]]()
        with open_executor() as workers, suppress(BrokenExecutor):
            while waiting or alone or running:
                source, most = (alone, 1) if alone else (waiting, at_once)
                while source and len(running) < most:
                    future = workers.submit(function, source[0])
                    running[future] = source.popleft()
                    future.add_done_callback(done.put)
                future = done.get()
                if future.cancelled():
                    raise OperationError(GONE)
                error = future.exception()
                if isinstance(error, BrokenExecutor | ArmrigError):
                    raise error
                if isinstance(error, ImportError | AttributeError):  # of a worker that came later
                    raise OperationError(f"a worker lacks this version of armrig: {error}")
                item = running.pop(future)
                if error is None:
                    yield item, future.result()
                else:
                    yield from _after_death([item], deaths, alone)
        yield from _after_death([*running.values()], deaths, alone)


def _after_death(items: list[T], deaths: Counter[T], alone: deque[T]) -> Iterator[tuple[T, Any]]:
    """Let the items of a dead worker run alone; yield an item that has killed too many workers."""
    if len(items) == 1:
        deaths[items[0]] += 1
        if deaths[items[0]] >= MOST_DEATHS:
            text = f"its process died {MOST_DEATHS} times: it was killed or ran out of memory"
            yield items.pop(), RuntimeError(text)
    alone.extend(items)


def _row_in(task: Task, expected: dict[str, str], item: Item) -> Row:
    """Return the row of an item; refuse to compute it in another environment."""
    if other := difference(expected):
        raise OperationError(f"the worker on {platform.node()} {other}")
    return row_of(task, item)


@cache
def environment() -> dict[str, str]:
    """Return what may change the last digits of a result: versions, machine and linear algebra."""
    kernels = {
        str(lib.get("architecture")) for lib in threadpool_info() if lib["user_api"] == "blas"
    }
    return {name: version(name) for name in ("armrig", "numpy", "scipy")} | {
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "OPENBLAS_CORETYPE": " ".join(sorted(kernels)),  # the variable that chooses it
    }


def difference(expected: dict[str, str]) -> str:
    """Return how this process differs from the `expected` environment, or "" if it is equal."""
    env = environment()
    others = [f"{k} {env.get(k)} instead of {v}" for k, v in expected.items() if env.get(k) != v]
    return f"has {' and '.join(others)}; give all machines the same" if others else ""


def header_of(
    task: Task, folder: Path, rigs: Collection[str], kinds: Collection[str]
) -> dict[str, str]:
    """Return the metadata by which a later start recognises the table of the same batch."""
    options = msgspec.to_builtins(task)
    if isinstance(task, Validate):
        options["model"] = f"sha256 {hashlib.sha256(task.model.encode()).hexdigest()}"
    return {
        "task": name_of(task),
        "options": msgspec.json.encode(options).decode(),
        "folder": path_text(folder.resolve()),
        "rigs": " ".join(sorted(rigs)),
        "kinds": " ".join(sorted(kinds)),
    } | environment()


def read_rows(path: Path, header: dict[str, str]) -> list[Row]:
    """Return the rows of the existing table; an empty list if there is no table.

    Raises
    ------
    OperationError
        The file is not a table of a batch, or its header differs from `header`.
    """
    if not path.exists():
        return []
    pyarrow, parquet = load_extra("pyarrow", "parquet"), load_extra("pyarrow.parquet", "parquet")
    try:
        with path.open("rb") as file:  # pyarrow accepts names in UTF-8 only
            table = parquet.read_table(file)
        stored_header = msgspec.json.decode((table.schema.metadata or {})[KEY], type=dict[str, str])
    except (pyarrow.ArrowException, KeyError, msgspec.DecodeError, OSError) as err:
        raise OperationError(
            f"{path} exists and is not a table of armrig batch; give another -o"
        ) from err
    if stored_header != header:
        raise OperationError(f"{path} {OTHER}")
    rows: list[Row] = table.to_pylist()
    return rows


def write_table(path: Path, task: Task, header: dict[str, str], rows: Iterable[Row]) -> None:
    """Write the table, sorted by the recordings' names; it replaces an earlier table atomically.

    Raises
    ------
    OperationError
        The disk is full, or somebody changed a stored row.
    """
    pyarrow, parquet = load_extra("pyarrow", "parquet"), load_extra("pyarrow.parquet", "parquet")
    ordered = sorted(rows, key=lambda row: str(row["recording"]))
    schema = pyarrow.schema(
        [(name, _type(pyarrow, kind)) for name, kind in columns_of(task).items()],
        metadata={KEY: msgspec.json.encode(header)},
    )
    new_file = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with new_file.open("wb") as file:
            parquet.write_table(pyarrow.Table.from_pylist(ordered, schema=schema), file)
        new_file.replace(path)
    except OSError as err:
        raise OperationError(
            f"{path}: {err.strerror or err}; all results are kept: repeat the command to write "
            "the table"
        ) from err
    except (pyarrow.ArrowException, TypeError) as err:
        raise OperationError(
            f"{path}{SUFFIX}: somebody changed a row of this file; --force discards it and begins "
            "again"
        ) from err
    finally:
        new_file.unlink(missing_ok=True)


def _type(pyarrow: Any, kind: Kind) -> Any:
    name = {"text": "string", "truth": "bool_", "count": "int64", "number": "float64"}.get(kind)
    return getattr(pyarrow, name)() if name else pyarrow.list_(_type(pyarrow, kind[:-1]))


class Progress(AbstractContextManager["Progress"]):
    """An open file with one row per line; the first line contains the header of the task."""

    def __init__(self, table: Path, header: dict[str, str], *, anew: bool = False) -> None:
        """Open the file, or create it; with `anew` the rows of an earlier start are discarded.

        Raises
        ------
        OperationError
            The file belongs to another task, is not a regular file, or is used by another process;
            or the disk is full.
        OSError
            The file cannot be opened.
        """
        self.path = table.with_name(table.name + SUFFIX)
        if self.path.exists() and not self.path.is_file():  # such as a link to an endless device
            raise OperationError(
                f"{self.path} exists and is not a file; remove it, or give another -o"
            )
        self._file = self.path.open("a+b")
        try:
            lock(self._file)
        except BlockingIOError as err:
            self._file.close()
            raise OperationError(
                f"{self.path}: another armrig batch uses it; wait for its end, or give another -o"
            ) from err
        self._file.seek(0)
        content = self._file.read()
        complete_lines, _, torn = content.rpartition(b"\n")
        first, *lines = complete_lines.split(b"\n") if complete_lines else [b""]
        self.rows: list[Row] = []
        """Rows of an earlier start."""
        if anew or not first:
            self._file.truncate(0)
            self.add(header)
            return
        if _decode_line(first) != header:
            self._file.close()
            raise OperationError(f"{self.path} {OTHER}")
        if torn:  # the process was killed within a line
            self._file.truncate(len(content) - len(torn))
        self.rows = [row for line in lines if (row := _decode_line(line)) is not None]

    def add(self, row: Row) -> None:
        """Store a row; a stored row is not lost if this process dies."""
        try:
            self._file.write(msgspec.json.encode(row) + b"\n")
            self._file.flush()
        except OSError as err:
            raise OperationError(
                f"{self.path}: {err.strerror}; results so far are kept: repeat the command to "
                "continue"
            ) from err

    def __exit__(self, *_: object) -> None:
        """Close the file without removing it."""
        with suppress(OSError):  # the error of a full disk was reported before
            self._file.close()


def still_right(
    rows: Iterable[Row], items: Iterable[Item], columns: Collection[str]
) -> dict[str, Row]:
    """Return the rows, by name, of the items whose files have not changed.

    An item without a returned row is computed again. A row with a problem is left out, because a
    killed process or a full disk may have caused the problem. A row without all columns is left
    out. The row of a report is left out if its validation recording has changed.
    """
    state = {item.name: (item.bytes, item.modified_ns) for item in items}
    validated_by = {item.name: Path(item.validation).name for item in items}
    return {
        row["recording"]: row
        for row in rows
        if row.keys() == set(columns)
        and not row["problem"]
        and state.get(name := str(row["recording"])) == (row["bytes"], row["modified_ns"])
        and row.get("validated_by", validated_by[name]) == validated_by[name]
    }


def _decode_line(line: bytes) -> dict[str, object] | None:
    try:
        return msgspec.json.decode(line, type=dict[str, object])
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None
