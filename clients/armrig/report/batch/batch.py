"""A task done for all runs of a folder, and the table that comes of it."""

from __future__ import annotations

import os
import platform
from collections import Counter, deque
from collections.abc import Callable, Collection, Generator, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from armrig_core.errors import InputError, OperationError

from armrig.recordings.export import imported
from armrig.recordings.recording_summary import shown_path
from armrig.report.batch.items import Item, items_in
from armrig.report.batch.progress import OTHER, SUFFIX, Progress, still_right
from armrig.report.batch.rows import Kind, Row, columns_of, row_of
from armrig.report.batch.tasks import Report, Task, Validate, digest, name_of, sha256

Count = Callable[[int, int, str], None]
"""Takes how many this start has done, how many it has to do, and the name of the one done."""
MOST_DEATHS = 2
"""So many workers may die of an item that runs alone; then it is given up."""

T = TypeVar("T", bound=Hashable)
R = TypeVar("R")
Open = Callable[[], AbstractContextManager[Executor]]
KEY = b"armrig.batch"
"""Of the table's metadata, where its header stands."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """What a batch came to."""

    table: Path
    """The Parquet file."""
    rows: tuple[Row, ...]
    """A row for each run, by name."""
    done_before: int
    """Results that an earlier start had left, of files that have not changed."""

    @property
    def problems(self) -> list[Row]:
        """Rows of runs that nothing came of."""
        return [row for row in self.rows if row["problem"]]


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
) -> Batch:
    """Do a task for each run of a folder, and write what comes of it as one table.

    Results that an earlier start has left count, where their files have not changed: a batch that
    was killed goes on, and one that was complete takes in what is new.

    Parameters
    ----------
    folder : Path
        Of the recordings.
    table : Path
        Parquet file to write.
    open_executor : callable
        Gives the workers; see `armrig.report.batch.workers`.
    at_once : int
        Runs that are handed to them and not back yet.
    rigs, kinds : collection of str
        Only these rigs, and kinds of experiment; empty for all.
    anew : bool
        Results that are there do not count; the table stays until the new one is complete.

    Raises
    ------
    OperationError, ImportError, OSError
        What is there is of another task, or the disk is full; the workers are gone; pyarrow is
        missing; a file cannot be read or written.
    """
    check_writable()
    items = items_in(folder, rigs=rigs, kinds=kinds)
    if not items:
        raise InputError(
            f"{folder}: no recording in it is asked for; `armrig ls {folder}` lists what is there"
        )
    header = header_of(task, folder, rigs, kinds)
    before = [] if anew else read_rows(table, header)
    with Progress(table, header, anew=anew) as progress:
        rows = still_right([*before, *progress.rows], items, columns_of(task))
        if isinstance(task, Report):  # a row without its PDF is none
            rows = {
                name: r for name, r in rows.items() if Path(task.folder, str(r["report"])).exists()
            }
        left, done_before = [item for item in items if item.name not in rows], len(rows)
        came = results(partial(row_of, task), left, open_executor, at_once=at_once)
        for item, row in came:
            rows[item.name] = row if isinstance(row, dict) else _problem(task, item, row)
            progress.add(rows[item.name])
            count(len(rows) - done_before, len(left), item.name)
        write_table(table, task, header, rows.values())
        progress.remove()
    ordered = tuple(rows[item.name] for item in items)
    return Batch(table=table, rows=ordered, done_before=done_before)


def _problem(task: Task, item: Item, error: Exception) -> Row:
    row: Row = dict.fromkeys(columns_of(task))
    known = {"recording": item.name, "bytes": item.bytes, "modified_ns": item.modified_ns}
    return row | known | {"problem": " ".join(str(error).split()), "doubts": []}


def results(
    function: Callable[[T], R], items: Sequence[T], open_executor: Open, *, at_once: int
) -> Iterator[tuple[T, R | Exception]]:
    """Give each item with its result, in the order in which they come.

    Where a worker dies its executor is opened anew. Of whose work it died cannot be told from
    outside, so what ran then runs again, one at a time.

    Parameters
    ----------
    function : callable
        Raises nothing itself; it is sent to the workers.
    items : sequence
        Each once.
    open_executor : callable
        Gives one that is open.
    at_once : int
        How many are handed over and not back yet.

    Yields
    ------
    item, result
        Or what the executor has raised in its place.

    Raises
    ------
    OperationError
        The executor has dropped its work.
    """
    waiting, alone = deque(items), deque[T]()
    deaths: Counter[T] = Counter()
    while waiting or alone:
        with open_executor() as workers:
            ran = yield from _until_a_death(workers, function, waiting, alone, at_once)
        if len(ran) == 1:
            deaths[ran[0]] += 1
            if deaths[ran[0]] >= MOST_DEATHS:
                text = f"the process that worked on it died, {MOST_DEATHS} times: it was killed, "
                yield ran.pop(), RuntimeError(f"{text}or ran out of memory")
        alone.extend(ran)


def _until_a_death(
    workers: Executor, function: Callable[[T], R], waiting: deque[T], alone: deque[T], at_once: int
) -> Generator[tuple[T, R | Exception], None, list[T]]:
    """Give results until all is done, or a worker dies; return what ran then."""
    running: dict[Future[R], T] = {}
    while waiting or alone or running:
        source, most = (alone, 1) if alone else (waiting, at_once)
        while source and len(running) < most:
            try:
                future = workers.submit(function, source[0])
            except BrokenExecutor:  # it died with nothing to do
                return [*running.values()]
            running[future] = source.popleft()
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in sorted(done, key=_is_broken):
            if _is_broken(future):
                return [*running.values()]
            item = running.pop(future)
            yield item, future.exception() or future.result()  # type: ignore[misc]
    return []


def _is_broken(future: Future[R]) -> bool:
    try:
        return isinstance(future.exception(), BrokenExecutor)
    except CancelledError as err:
        msg = "the cluster has dropped its work: its scheduler or all workers are gone; what is "
        raise OperationError(f"{msg}done is kept, and the same command goes on from there") from err


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
