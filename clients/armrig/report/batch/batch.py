"""A task done for all runs of a folder, and the table that comes of it."""

from __future__ import annotations

from collections.abc import Callable, Collection
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from armrig_core.errors import InputError

from armrig.report.batch.columns import columns_of
from armrig.report.batch.items import Item, items_in
from armrig.report.batch.progress import Progress, still_right
from armrig.report.batch.rows import Row, row_of
from armrig.report.batch.running import results
from armrig.report.batch.table import check_writable, header_of, read_rows, write_table
from armrig.report.batch.tasks import Report, Task

Count = Callable[[int, int, str], None]
"""Takes how many this start has done, how many it has to do, and the name of the one done."""


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
